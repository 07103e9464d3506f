"""Corrections along the clip: what is said holds, what rows depend on, and what a target takes from the first frame."""

import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given as examples
from hypothesis import settings
from hypothesis import strategies as st

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Correction, Frame, Start, TargetStart
from facetrack_cli.editor.fixer import Fixer, save
from facetrack_cli.engine.corrected import CorrectedTarget, is_complete
from facetrack_cli.engine.loop import track
from facetrack_cli.engine.target import FrameModel
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.finished import open_run
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.start.init_file import read_init
from facetrack_cli.trajectory.reader import CORRECTED
from facetrack_cli.trajectory.writers import csv_frames
from tests.support.results import parts_of
from tests.support.samples import FOLDER, TrackClip

PARTS = ("nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower")
FEW = ("filter.particles=12",)


class Clip(TrackClip):
    def point(self, frame, part):
        row = self.truth[frame, part]
        return row.x, row.y

    def points(self, frame, parts=PARTS):
        return {part: self.point(frame, part) for part in parts}

    def box(self, frame, part="box"):
        row = self.truth[frame, part]
        return row.x - (row.w - 1) / 2, row.y - (row.h - 1) / 2, row.w, row.h


FACE, HEAD, ZOOM = Clip("expressions", 32), Clip("textured", 30), Clip("zoom", 24)
BOX = FACE.start.targets["face"].box
NOSE = {"nose": (160.0, 138.0)}


def run(config, clip, *corrections, seed=0, overrides=(), start=None, stop=None):
    start = replace(start or clip.start, corrections=corrections)
    return list(track(build_tracker(load_recipe(config, overrides), start), iter(clip.frames[:stop]), seed))


def lines(results, first=0):
    return ["".join(csv_frames(result.rows)) for result in results if result.frame.index >= first]


def part(result, name, target=0):
    return next(one for one in parts_of(result.targets[target]) if one.part == name)


def statuses(result):
    return [one.status for one in parts_of(result.targets[0])]


def given(frame, target="face", **said):
    box, points = said.pop("box", None), said.pop("points", {})
    return Correction(frame, target, box=box, points=points, **said)


# --- laws, whatever is corrected and in whatever order --------------------------------------------------------------

LAST = 13
RECIPES = st.sampled_from(("sir", "auxiliary_prior", "factorized", "factorized_transition"))
WAYS = ("given", "kept", "absent", "open")


@st.composite
def correction(draw, frame, ways=WAYS):
    """Of the face at a frame: each part is given, kept, absent or not spoken of, and something is corrected."""
    way = dict(zip(PARTS, draw(st.lists(st.sampled_from(ways), min_size=5, max_size=5)), strict=True))
    if not {"given", "absent"} & {*way.values()}:
        way[draw(st.sampled_from(PARTS))] = "given"
    off = st.sampled_from((-6.0, -1.5, 0.0, 0.25, 3.0))
    places = {name: tuple(round(v + draw(off), 3) for v in FACE.point(frame, name)) for name in PARTS}
    absent = tuple(name for name in PARTS if way[name] == "absent")
    whole = not {"absent", "open"} & {*way.values()}
    return Correction(
        frame,
        "face",
        None,
        {name: places[name] for name in PARTS if way[name] == "given"},
        {name: places[name] for name in PARTS if way[name] == "kept"} if len(absent) < 5 else {},
        True if len(absent) == 5 else absent,
        draw(st.sampled_from((None, False, True) if whole else (None, False))),
    )


@st.composite
def corrections(draw, first=1, last=LAST, most=3, ways=WAYS):
    frames = draw(st.lists(st.integers(first, last), max_size=most, unique=True))
    return tuple(draw(correction(frame, ways)) for frame in sorted(frames))


def hidden(those):
    """Of each frame, the parts without a place."""
    found, now = [], set()
    for frame in range(LAST + 1):
        for one in those:
            if one.frame == frame:
                gone = set(PARTS) if one.absent is True else {*one.absent}
                now = gone | (now - {*one.points, *one.kept} if not is_complete(one, PARTS) else set())
        found.append(now)
    return found


@examples(RECIPES, corrections())
def test_what_is_said_holds_and_what_comes_before_stays(config, those):
    put = run(config, FACE, *those, overrides=FEW, stop=LAST + 1)
    first = min((one.frame for one in those), default=LAST + 1)
    assert lines(put)[:first] == lines(run(config, FACE, overrides=FEW, stop=first))
    for result, gone in zip(put, hidden(those), strict=True):
        [said] = [one for one in those if one.frame == result.frame.index] or [Correction(0, "face")]
        by_hand = {*said.points, *(gone if said.frame else ())}  # also what is still absent
        assert np.isfinite(result.targets[0].cloud).all()
        for one in parts_of(result.targets[0]):
            assert (one.status == "absent") == (one.x is None) == (one.part in gone)
            assert (one.status == "init") == (result.frame.index == 0 or one.part in said.points)
            assert one.by_hand == (one.part in by_hand)
            for places in (said.points, said.kept):
                assert (one.x, one.y) == places.get(one.part, (one.x, one.y))


@examples(RECIPES, st.data())
def test_what_follows_a_complete_correction_depends_on_nothing_before_it(config, data):
    at = data.draw(st.integers(4, LAST - 1))
    last = data.draw(correction(at, ("given", "kept", "absent")))
    ways = [(*data.draw(corrections(1, at - 1)), last) for _ in range(2)]
    after = data.draw(corrections(at + 1))
    one, other = (lines(run(config, FACE, *way, *after, overrides=FEW, stop=LAST + 1), at) for way in ways)
    assert one == other
    [target] = build_tracker(load_recipe(config, FEW), replace(FACE.start, corrections=(last, *after)))
    assert lines(track((replace(target, first=FACE.frames[0]),), iter(FACE.frames[at : LAST + 1]), 0)) == one


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    words = ["run", FOLDER / "expressions.mp4", "-o", folder, "--set", FEW[0], "--stop", LAST + 1, "--no-video", "-q"]
    assert main([*map(str, words), "--overwrite", "--format", "json,csv"]) == 0
    return folder


@examples(those=corrections(most=4), order=st.randoms(use_true_random=False))
@settings(max_examples=settings().max_examples // 10)
def test_a_run_put_right_is_a_whole_run_from_the_init_file_that_is_written(made, those, order):
    """Also that file, read, begins as it says; and of complete corrections the order of making does not matter."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(shutil.copytree(made, name, dirs_exist_ok=True))
        fixer = Fixer(open_run(folder), lambda index: FACE.frames[index])
        for one in order.sample(those, len(those)):
            fixer.put([one])
        assert fixer.corrections == those or not all(is_complete(one, PARTS) for one in those)
        save(fixer)
        fixer.close()
        if not those:
            return
        start = read_init(folder / CORRECTED)
        assert start.corrections == fixer.corrections == open_run(folder).start.corrections
        # the recorded run has a detector, and that file has none
        start = replace(start, detector=open_run(folder).start.detector)
        again = run("face", FACE, *start.corrections, overrides=FEW, start=start, stop=LAST + 1)
        assert (folder / "trajectory.csv").read_text().split("\n", 1)[1] == "".join(lines(again))


RESUMED = [
    ("histogram", None), ("contour_correlation", False), ("skin_ncc", True), ("mil", None), ("adaptive", False),
    ("adaptive_robust", None),
]  # fmt: skip


@pytest.mark.parametrize(("config", "learn"), RESUMED)
def test_a_part_of_a_run_tracked_anew_is_what_the_whole_run_has(config, learn):
    clip = ZOOM if config in ("skin_ncc", "adaptive", "adaptive_robust") else HEAD
    [name] = clip.start.targets
    last = given(12, name, box=clip.box(12), learn=learn)
    whole = run(config, clip, given(6, name, box=clip.box(12), learn=learn), last, stop=16)
    [target] = build_tracker(load_recipe(config), replace(clip.start, corrections=(last,)))
    assert isinstance(target, CorrectedTarget)
    part_of = track((replace(target, first=clip.frames[0]),), iter(clip.frames[12:16]), 0)
    assert lines(part_of) == lines(whole, 12)


# --- random numbers ------------------------------------------------------------------------------------------------


def test_no_correction_draws_the_numbers_of_another_correction_or_target():
    """On an image that stands still, where whoever draws the same goes the same way."""
    start, at = Start(0, dict.fromkeys(("anna", "ben"), FACE.start.targets["face"]), "two.yaml"), FACE.points(0)

    def ways(*places):
        """Of each target and frame, the places of two targets that begin alike, and are corrected alike."""
        said = tuple(given(frame, name, points=at) for frame, name in places)
        tracker = build_tracker(load_recipe("factorized_transition", FEW), replace(start, corrections=said))
        results = list(track(tracker, (Frame(i, i / 25, FACE.frames[0].bgr) for i in range(16)), 0))
        return ([result.targets[k].rows.x.tolist() for result in results] for k in (0, 1))

    def apart(one, other):
        return all(a != b for a, b in zip(one, other, strict=True))

    anna, ben = ways((4, "anna"), (4, "ben"))
    assert anna[4] == ben[4] and apart(anna[5:], ben[5:])
    anna, _ = ways((4, "anna"), (10, "anna"))
    assert anna[4] == anna[10] and apart(anna[5:10], anna[11:])
    for frame in (1, 2):  # the second target's stream is called by its place, 1, a correction's by its frame as well
        anna, ben = ways((frame, "anna"))
        assert anna[frame] == ben[0] and anna[frame + 1] != ben[1]


# --- places --------------------------------------------------------------------------------------------------------


def test_a_target_may_be_gone_and_come_back():
    away = run("histogram", HEAD, given(4, "head", absent=("box",)), given(12, "head", box=HEAD.box(12)), stop=14)
    assert [statuses(r)[0] for r in away[3:]] == ["tracked"] + ["absent"] * 8 + ["init", "tracked"]
    start = replace(HEAD.start, corrections=(given(1, "head", absent=True),))
    [target], rng = build_tracker(load_recipe("histogram"), start), np.random.default_rng(0)
    state, _ = target.begin(rng, HEAD.frames[0])
    assert target.footprint(state, ahead=False) is not None
    state, _ = target.advance(rng, state, HEAD.frames[1], ())
    assert target.footprint(state, ahead=False) is None, "it covers nothing"


def test_a_part_that_is_kept_where_it_is_not_is_lost_at_once():
    said = given(20, points=FACE.points(20, ("mouth_left",)), kept={"nose": (40.0, 40.0)})
    put = run("factorized", FACE, said, stop=21)
    assert [part(put[i], "nose").status for i in (19, 20)] == ["tracked", "lost"]
    assert part(put[20], "nose").confidence < 0.3 and part(put[20], "lip_upper").status == "tracked"


# --- boxes that place points ---------------------------------------------------------------------------------------


def test_a_box_places_what_is_there_and_leaves_out_what_is_absent():
    whole = run("factorized", FACE, given(15, box=BOX), stop=17)
    put = run("factorized", FACE, given(15, box=BOX, absent=("lip_upper",)), stop=17)
    assert statuses(put[15]) == ["init", "init", "init", "absent", "init"] and statuses(put[16])[3] == "absent"
    for name in PARTS:
        one, two = part(whole[15], name), part(put[15], name)
        assert one.by_hand and two.by_hand and np.hypot(*np.subtract((one.x, one.y), FACE.point(15, name))) < 12
        assert (two.x, two.y) == ((None, None) if name == "lip_upper" else (one.x, one.y))
    outside = given(15, box=(-42.0, 100.0, 130.0, 130.0), absent=("mouth_left",))
    assert statuses(run("factorized", FACE, outside, stop=16)[15]) == ["init", "absent", "init", "init", "init"]


def test_a_box_beside_points_says_nothing_of_the_others():
    """They stay where the tracker sees them, as without the box."""
    assert not is_complete(given(15, box=BOX, points=NOSE), PARTS)
    assert is_complete(given(15, box=BOX), PARTS) and is_complete(given(15, box=BOX, points=NOSE), ("box",))
    both, points = (run("factorized", FACE, given(9, points=NOSE, **more), stop=12) for more in ({"box": BOX}, {}))
    assert lines(both) == lines(points)


def test_a_box_cannot_place_parts_that_no_cascade_knows():
    points = {"nose": (160, 140), "chin": (160, 180)}
    more = {
        "start": Start(0, {"face": TargetStart(points=points)}, "own.yaml"),
        "overrides": ("target.parts=[nose,chin]",),
    }
    with pytest.raises(InputError, match=r"own.yaml: the correction of face at frame 9: no cascade can place chin"):
        run("factorized_transition", FACE, given(9, box=BOX), **more)
    for fine in (given(9, box=BOX, absent=True), given(9, box=BOX, points=points)):
        run("factorized_transition", FACE, fine, **more, stop=10)


AT_ONCE = dict.fromkeys(PARTS, (160.0, 140.0))
REFUSED = [
    ("factorized", "has nase; what is followed is nose", given(5, points={"nase": (3, 3)})),
    ("histogram", "has no box, which the recipe follows", given(5, points={"nose": (3, 3)})),
    ("histogram", "the box of face at frame 5 is smaller than", given(5, box=(3, 3, 2, 2))),
    ("factorized", "cannot be learned, or kept, there", given(5, points=NOSE, absent=("lip_upper",), learn=True)),
    ("factorized", "there; leave learn out", given(2, absent=("lip_upper",)), given(5, points=NOSE, learn=True)),
    ("mil", "there; leave learn out", given(5, box=(30, 30, 40, 40), learn=False)),
    ("factorized", "would put mouth_left outside the frame", given(15, box=(-42.0, 100.0, 130.0, 130.0))),
    ("sir", "all points of face are in one place; move them apart", given(2, points=AT_ONCE, learn=True)),
]


@pytest.mark.parametrize(("config", "says", "those"), [(config, says, those) for config, says, *those in REFUSED])
def test_corrections_that_the_recipe_cannot_follow_are_refused(config, says, those):
    with pytest.raises(InputError, match=says) as refused:
        run(config, FACE, *those, stop=16)
    assert "expressions.init.yaml: " in str(refused.value)


def test_colours_are_not_learned_anew():
    anew = given(5, "left_hand", box=(80.0, 120.0, 33.0, 71.0), learn=True)
    with pytest.raises(InputError, match="left_hand at frame 5: what it looks like cannot be learned"):
        run("head_hands_cloud", Clip("signing", 1), anew)


# --- what is learned, and what is taken from the first frame --------------------------------------------------------


def begun(config, clip):
    """A target, and its state after the first frame."""
    [target] = build_tracker(load_recipe(config), clip.start)
    state, _ = target.begin(np.random.default_rng(0), clip.frames[0])
    return target, state


def test_what_is_given_is_learned_anew_and_the_others_keep_what_the_first_frame_taught():
    target, first = begun("factorized", FACE)
    x0 = np.array([FACE.point(30, name) for name in PARTS])
    chosen = np.array([False, True, False, False, True])
    likelihood, frame = target.likelihood, FACE.frames[30]
    learned = likelihood.relearn(first.learned, frame, x0, chosen)
    here, before = (likelihood.distances(each, frame, x0[None])[0] for each in (learned, first.learned))
    np.testing.assert_allclose(here[chosen], 0, atol=1e-6)
    np.testing.assert_array_equal(here[~chosen], before[~chosen])
    assert before[chosen].min() > 0.01
    whole = likelihood.init(frame, x0)
    np.testing.assert_array_equal(learned.sigma, np.where(chosen, whole.sigma, first.learned.sigma))
    said = {"points": FACE.points(29, PARTS[1:3]), "kept": FACE.points(29, (PARTS[0], *PARTS[3:]))}
    ways = [lines(run("factorized", FACE, given(29, **said, learn=learn)), 30) for learn in (None, False, True)]
    assert ways[0] != ways[1] != ways[2] != ways[0]


def test_a_part_learned_anew_is_judged_by_what_it_looks_like_now():
    """In frame 30 the light is another: at the ground truth, the new template is the better one."""
    target, first = begun("factorized", FACE)
    kept, anew = (
        target.restart(
            np.random.default_rng(0), FACE.frames[30], first, TargetStart(points=FACE.points(30)), relearned=parts
        )[0].judgement
        for parts in ((), ("lip_lower",))
    )
    np.testing.assert_array_equal(anew.good[:4], kept.good[:4])
    assert anew.confidence[4] == 1.0 and anew.bad[4] != kept.bad[4]
    assert anew.status == (*kept.status[:4], "init")


def test_absent_parts_say_nothing_and_follow_the_others_in_the_shape_of_the_first_frame():
    """They say neither what they look like, nor how they moved, nor what shape they make."""
    away = np.array([name in ("nose", "lip_upper") for name in PARTS])
    target, first = begun("factorized", FACE)
    place = TargetStart(points=FACE.points(10, [name for name in PARTS if name not in ("nose", "lip_upper")]))
    state, _ = target.restart(np.random.default_rng(1), FACE.frames[10], first, place, ("nose", "lip_upper"))
    x = state.particles.x
    shape = np.array([FACE.start.targets["face"].points[name] for name in PARTS])
    following = x[:, ~away].mean(axis=1, keepdims=True) + shape[away] - shape[~away].mean(0)
    np.testing.assert_allclose(x[:, away], following, atol=1e-9)
    model = FrameModel(target, state, FACE.frames[11], (), target.motion)
    x = x + np.random.default_rng(2).normal(0, 2, x.shape)
    before, after = x.copy(), target.follow(x, away)
    np.testing.assert_array_equal(x, before)
    assert (after[:, ~away] == x[:, ~away]).all() and (after[:, away] != x[:, away]).all()
    for said in (model.log_likelihood(x, x), model.log_transition(x, x + 1)):
        assert not said[..., away].any() and said[..., ~away].any(axis=0).all()
    elsewhere = x.copy()
    elsewhere[:, away] += 30
    np.testing.assert_array_equal(model.log_prior(elsewhere), model.log_prior(x))
    elsewhere[:, ~away] += np.arange(6).reshape(3, 2)
    assert (model.log_prior(elsewhere) != model.log_prior(x)).any()


def test_a_cloud_fills_the_box_that_is_given():
    few = [f"targets.{name}.filter.particles=60" for name in ("head", "left_hand", "right_hand")]
    said = given(2, "left_hand", box=(80.0, 120.0, 33.0, 71.0))
    put = run("head_hands_cloud", Clip("signing", 3), said, overrides=few)
    [hand] = [one for one in put[2].targets if one.rows.target == "left_hand"]
    assert (hand.rows.w[0], hand.rows.h[0]) == pytest.approx((33, 71))
    assert np.ptp(hand.cloud[:, 0, 0]) <= 33 and np.ptp(hand.cloud[:, 0, 1]) > 50


@pytest.mark.parametrize(("learn", "scale"), [(None, 1.0), (True, 1.0), (False, 1.5)])
def test_a_face_under_affine_maps_is_learned_anew_unless_it_is_said_otherwise(learn, scale):
    left, top, w, h = ZOOM.box(0)
    put = run("adaptive_velocity", ZOOM, given(2, box=(left, top, 1.5 * w, 1.5 * h), learn=learn), stop=3)
    assert put[2].targets[0].rows.diagnostics["face"].get("scale") == pytest.approx([scale], rel=1e-3)


def test_what_is_given_is_certain_though_nothing_is_learned():
    far = {name: (x + 25, y) for name, (x, y) in FACE.points(5).items()}
    put = run("factorized", FACE, given(5, points=far, learn=False), stop=7)
    assert {part(put[5], name).confidence for name in PARTS} == {1.0}
    assert min(part(put[6], name).confidence for name in PARTS) < 0.9


def test_what_is_confirmed_is_certain_and_all_else_is_as_it_was():
    put, plain = (run("factorized", FACE, *said, stop=15) for said in ([given(13, confirmed=("lip_lower",))], ()))
    for result, before in zip(put, plain, strict=True):
        for one, same in zip(parts_of(result.targets[0]), parts_of(before.targets[0]), strict=True):
            sure = result.frame.index == 13 and one.part == "lip_lower"
            assert vars(one) == vars(same) | ({"confidence": 1.0, "by_hand": True} if sure else {})
    assert {part(plain[13], name).confidence < 1 for name in ("lip_lower", "mouth_right")} == {True}


@pytest.mark.parametrize(("said", "status"), [({}, "init"), ({"learn": False}, "init"), (None, "tracked")])
def test_where_nothing_judges_nothing_is_certain(said, status):
    said = {"confirmed": True} if said is None else {"box": HEAD.box(5), **said}
    put = run("contour_correlation", HEAD, given(5, "head", **said), overrides=("likelihood.contour=null",), stop=7)
    seen = [(part(r, "box").status, part(r, "box").confidence) for r in put[4:7]]
    assert seen == [("tracked", None), (status, None), ("tracked", None)]
