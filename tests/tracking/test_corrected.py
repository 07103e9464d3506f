"""Corrections along the clip: where a target begins again, what that depends on, and what is absent."""

from dataclasses import replace

import numpy as np
import pytest

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Correction, Start, TargetStart
from facetrack_cli.engine.corrected import CorrectedTarget
from facetrack_cli.engine.loop import track
from facetrack_cli.engine.spaces import BoxSpace, Estimate, PointSpace
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.trackers.appearance.space import AffineSpace
from facetrack_cli.trackers.skin.cloud import CloudSpace
from facetrack_cli.trajectory.trajectory import joined
from facetrack_cli.trajectory.writers import csv_frames
from tests.support.results import parts_of
from tests.support.samples import TrackClip

PARTS = ("nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower")


class Clip(TrackClip):
    def point(self, frame, part):
        row = self.truth[frame, part]
        return row.x, row.y

    def points(self, frame, parts=PARTS):
        return {part: self.point(frame, part) for part in parts}

    def box(self, frame, part="box"):
        row = self.truth[frame, part]
        return row.x - (row.w - 1) / 2, row.y - (row.h - 1) / 2, row.w, row.h


@pytest.fixture(scope="module")
def face():
    return Clip("expressions", 40)


@pytest.fixture(scope="module")
def head():
    return Clip("textured", 30)


@pytest.fixture(scope="module")
def zoom():
    return Clip("zoom", 24)


def run(config, clip, *corrections, seed=0, overrides=(), start=None):
    start = replace(start or clip.start, corrections=corrections)
    return list(track(build_tracker(load_recipe(config, overrides), start), iter(clip.frames), seed))


def lines(results, first=0):
    return ["".join(csv_frames(result.rows)) for result in results if result.frame.index >= first]


def part(result, name, target=0):
    return next(one for one in parts_of(result.targets[target]) if one.part == name)


def given(frame, target="face", **said):
    box, points = said.pop("box", None), said.pop("points", {})
    return Correction(frame, target, TargetStart(box=box, points=points), **said)


def test_what_is_given_stands_where_it_says_and_the_others_where_they_were(face):
    plain = run("factorized", face)
    put = run("factorized", face, given(20, points={"mouth_left": (130.25, 150.5)}))
    assert lines(put)[:20] == lines(plain)[:20]
    assert lines(put, 21) != lines(plain, 21)
    moved = part(put[20], "mouth_left")
    assert (moved.x, moved.y, moved.status, moved.confidence, moved.by_hand) == (130.25, 150.5, "init", 1.0, True)
    for name in PARTS:
        if name != "mouth_left":
            here, there = part(put[20], name), part(plain[20], name)
            assert (here.x, here.y) == (round(there.x, 3), round(there.y, 3))
            assert (here.status, here.by_hand) == ("tracked", False)
    assert not any(one.by_hand for result in put for one in parts_of(result.targets[0]) if result.frame.index != 20)


@pytest.mark.parametrize("config", ["sir", "auxiliary_prior", "factorized", "factorized_robust"])
def test_what_follows_a_complete_correction_does_not_depend_on_what_was_before(config, face):
    last = given(25, points=face.points(25, PARTS[:2]), kept=face.points(25, PARTS[2:]))
    one = run(config, face, last)
    other = run(config, face, given(10, points={"nose": (100.0, 90.0)}), last)
    assert lines(one, 25) == lines(other, 25)
    assert lines(one)[10:25] != lines(other)[10:25]
    assert lines(run(config, face, last, seed=1), 26) != lines(one, 26)


RESUMED = [
    ("sir", "face"), ("auxiliary_prior", "face"), ("independent", "face"), ("factorized", "face"), ("prior", "absent"),
    ("histogram", "head"), ("contour_correlation", "head"), ("skin_ncc", "zoom"), ("mil", "head"),
    ("adaptive", "zoom"), ("adaptive_robust", "zoom"),
]  # fmt: skip
BY_DAY = [("factorized", "face"), ("histogram", "head"), ("adaptive", "zoom")]  # tried with every `learn` by day


@pytest.mark.parametrize(
    ("config", "which", "learn"),
    [
        pytest.param(*one, learn, marks=[] if learn is None or one in BY_DAY else pytest.mark.nightly)
        for one in RESUMED
        for learn in (None, True, False)
    ],
)
def test_a_part_of_a_run_tracked_anew_is_what_the_whole_run_has(config, which, learn, face, head, zoom):
    name = "face"
    if which in ("face", "absent"):
        clip, config = face, "factorized" if which == "absent" else config
        hidden = ("lip_lower",) if which == "absent" else ()
        if hidden and learn:
            pytest.skip("what is absent cannot be learned")
        seen = [one for one in PARTS if one not in hidden]
        said = {"points": face.points(15, seen[:1]), "kept": face.points(15, seen[1:]), "absent": hidden}
    else:
        clip = head if which == "head" else zoom
        [name] = clip.start.targets
        said = {"box": clip.box(15)}
    if config == "mil" and learn is False:
        pytest.skip("OpenCV's trackers begin again in any case")
    correction = given(15, name, **said, learn=learn)
    whole = run(config, clip, given(6, name, **said | {"absent": ()} if which != "absent" else said), correction)
    [target] = build_tracker(load_recipe(config), replace(clip.start, corrections=(correction,)))
    assert isinstance(target, CorrectedTarget)
    part_of = list(track((replace(target, first=clip.frames[0]),), iter(clip.frames[15:]), 0))
    assert lines(part_of) == lines(whole, 15)


def test_only_the_corrected_target_changes_and_it_keeps_its_own_numbers(face):
    two = Start(0, {"anna": face.start.targets["face"], "ben": face.start.targets["face"]}, "two.yaml")
    plain = run("factorized", face, start=two)
    put = run("factorized", face, given(12, "ben", points=face.points(12)), start=two)

    def of(results, target):
        return ["".join(csv_frames(joined(result.rows.of_target(target)))) for result in results]

    assert of(put, "anna") == of(plain, "anna")
    assert of(put, "ben")[:12] == of(plain, "ben")[:12]
    assert all(a != b for a, b in zip(of(put, "ben")[12:], of(plain, "ben")[12:], strict=True))
    target = build_tracker(
        load_recipe("factorized"), replace(two, corrections=(given(12, "ben", points=face.points(12)),))
    )[1]
    again = list(
        track(
            (build_tracker(load_recipe("factorized"), two)[0], replace(target, first=face.frames[0])),
            iter(face.frames[12:]),
            0,
        )
    )
    assert of(again, "ben") == of(put, "ben")[12:]


def test_a_lost_box_that_is_put_right_is_followed_again(head):
    [name] = head.start.targets
    left, top, w, h = head.box(10)
    wrong = given(10, name, box=(left - 90, top - 20, w, h))
    lost = run("histogram", head, wrong)
    found = run("histogram", head, wrong, given(18, name, box=head.box(18)))

    def off(results):
        true = np.array([(head.truth[i, "box"].x, head.truth[i, "box"].y) for i in range(18, 30)])
        return np.hypot(*(np.array([(part(r, "box").x, part(r, "box").y) for r in results[18:30]]) - true).T)

    assert off(lost).min() > 40
    assert off(found).max() < 12


def test_absent_parts_have_no_place_and_the_others_go_on(face):
    hidden = run("factorized", face, given(10, absent=("nose",)), given(30, points={"nose": face.point(30, "nose")}))
    nose = [part(result, "nose") for result in hidden]
    assert [one.status for one in nose[9:11]] == ["tracked", "absent"]
    assert {one.status for one in nose[10:30]} == {"absent"}
    assert {(one.x, one.y, one.w, one.h, one.confidence) for one in nose[10:30]} == {(None,) * 5}
    assert (nose[10].by_hand, nose[11].by_hand) == (True, False)
    assert (nose[30].status, nose[31].status) == ("init", "tracked")
    assert "10,0.4000,face,nose,,,,,,,absent,,,,,,100,,," in lines(hidden)[10]
    for name in PARTS[1:]:
        off = [np.hypot(part(r, name).x - face.point(r.frame.index, name)[0],
                        part(r, name).y - face.point(r.frame.index, name)[1]) for r in hidden[10:]]  # fmt: skip
        assert np.mean(off) < (6.0 if name == "lip_lower" else 2.0)  # the lower lip strays in any case
    cloud = hidden[25].targets[0].cloud
    first = face.start.targets["face"].points
    shape = np.array(first["nose"]) - np.mean([first[one] for one in PARTS[1:]], axis=0)
    np.testing.assert_allclose(cloud[:, 0], cloud[:, 1:].mean(axis=1) + shape, atol=1e-9)


@pytest.mark.parametrize("config", ["sir", "auxiliary_prior", "independent", "factorized_transition"])
def test_every_filter_leaves_out_what_is_absent(config, face):
    results = run(config, face, given(5, absent=("lip_upper", "nose")))
    for result in results[5:]:
        assert [one.status == "absent" for one in parts_of(result.targets[0])] == [True, False, False, True, False]
        assert np.isfinite(result.targets[0].cloud).all()


def test_a_target_may_be_gone_and_come_back(face, head):
    gone = run("factorized", face, given(8, absent=True), given(20, points=face.points(20, PARTS[:3])))
    assert {one.status for result in gone[8:20] for one in parts_of(result.targets[0])} == {"absent"}
    assert gone[10].targets[0].cloud.shape == (0, 5, 2)
    assert {one.particles for one in parts_of(gone[10].targets[0])} == {None}
    assert [one.status for one in parts_of(gone[20].targets[0])] == ["init"] * 3 + ["absent"] * 2
    [name] = head.start.targets
    away = run("histogram", head, given(4, name, absent=("box",)), given(12, name, box=head.box(12)))
    assert [part(r, "box").status for r in away[3:14]] == ["tracked"] + ["absent"] * 8 + ["init", "tracked"]


def test_the_points_of_a_box_given_alone_are_placed_by_the_picture(face):
    results = run("factorized", face, given(20, box=face.start.targets["face"].box))
    for name in PARTS:
        one = part(results[20], name)
        x, y = face.point(20, name)
        assert (one.status, one.by_hand) == ("init", True)
        assert np.hypot(one.x - x, one.y - y) < 12


def test_a_target_that_is_gone_covers_nothing():
    [target] = build_tracker(
        load_recipe("histogram"), Start(0, {"a": TargetStart(box=(5, 5, 20, 20))}, "a", (given(3, "a", absent=True),))
    )
    frame = Clip("textured", 1).frames[0]
    state, _ = target.begin(np.random.default_rng(0), frame)
    assert target.footprint(state, ahead=False) is not None
    state, _ = target.advance(np.random.default_rng(0), state, replace_index(frame, 3), ())
    assert target.footprint(state, ahead=False) is None


def replace_index(frame, index):
    return type(frame)(index, index / 25, frame.bgr)


REFUSED = [
    ("factorized", given(5, points={"nase": (3, 3)}), "has nase, which is no part that is followed; these are nose"),
    ("factorized", given(5, absent=("lip",)), "has lip"),
    ("histogram", given(5, points={"nose": (3, 3)}), "has no box, which the recipe follows"),
    ("histogram", given(5, box=(3, 3, 2, 2)), "the box of face at frame 5 is smaller than"),
    ("factorized", given(5, points={"nose": (3, 3)}, absent=("lip_upper",), learn=True), "lip_upper cannot be learned"),
    ("mil", given(5, box=(30, 30, 40, 40), learn=False), "begin again in any case"),
]


@pytest.mark.parametrize(("config", "correction", "says"), REFUSED)
def test_corrections_that_the_recipe_cannot_follow_are_refused(config, correction, says, face):
    with pytest.raises(InputError, match=says) as refused:
        run(config, face, correction)
    assert "expressions.init.yaml: " in str(refused.value)


@pytest.mark.parametrize("box", [(10.0, 20.0, 60.0, 80.0), (0.5, -3.0, 15.0, 20.0)])
def test_spaces_place_a_box_and_give_its_centre_and_size_again(box):
    for space in (BoxSpace((30.0, 40.0)), AffineSpace((30.0, 40.0)), CloudSpace()):
        state = space.at(box)
        np.testing.assert_allclose(state[0, :2], (box[0] + (box[2] - 1) / 2, box[1] + (box[3] - 1) / 2))
        if not isinstance(space, CloudSpace):
            np.testing.assert_allclose(space.windows(Estimate(state, np.zeros((1, 2, 2)))), [box[2:]])
    with pytest.raises(TypeError, match="points"):
        PointSpace(np.ones((1, 2))).at(box)


def test_a_part_that_is_kept_where_it_is_not_is_lost_at_once(face):
    put = run(
        "factorized", face, given(20, points={"mouth_left": face.point(20, "mouth_left")}, kept={"nose": (40.0, 40.0)})
    )
    assert [part(put[i], "nose").status for i in (19, 20)] == ["tracked", "lost"]
    assert part(put[20], "nose").confidence < 0.3
    assert part(put[20], "lip_upper").status == "tracked"


def test_what_is_given_is_learned_anew_and_the_others_keep_what_the_first_frame_taught(face):
    [target] = build_tracker(load_recipe("factorized"), face.start)
    first, _ = target.begin(np.random.default_rng(0), face.frames[0])
    x0 = np.array([face.point(30, name) for name in PARTS])
    chosen = np.array([False, True, False, False, True])
    likelihood, frame = target.likelihood, face.frames[30]
    learned = likelihood.relearn(first.learned, frame, x0, chosen)
    here = likelihood.distances(learned, frame, x0[None])[0]
    before = likelihood.distances(first.learned, frame, x0[None])[0]
    np.testing.assert_allclose(here[chosen], 0, atol=1e-6)
    np.testing.assert_array_equal(here[~chosen], before[~chosen])
    assert before[chosen].min() > 0.01
    whole = likelihood.init(frame, x0)
    np.testing.assert_array_equal(learned.sigma, np.where(chosen, whole.sigma, first.learned.sigma))
    said = {
        "points": face.points(30, ("mouth_left", "lip_lower")),
        "kept": face.points(30, ("nose", "mouth_right", "lip_upper")),
    }
    ways = [lines(run("factorized", face, given(30, **said, learn=learn)), 31) for learn in (None, False, True)]
    assert ways[0] != ways[1] != ways[2] != ways[0]


def test_a_part_learned_anew_is_judged_by_what_it_looks_like_now(face):
    """In frame 30 the light is another: at the ground truth, the new template is the better one."""
    [target] = build_tracker(load_recipe("factorized"), face.start)
    first, _ = target.begin(np.random.default_rng(0), face.frames[0])
    place = TargetStart(points=face.points(30))
    kept, _ = target.restart(np.random.default_rng(0), face.frames[30], first, place)
    anew, _ = target.restart(np.random.default_rng(0), face.frames[30], first, place, anew=("lip_lower",))
    np.testing.assert_array_equal(anew.judgement.good[:4], kept.judgement.good[:4])
    assert anew.judgement.confidence[4] == 1.0
    assert anew.judgement.bad[4] != kept.judgement.bad[4]
    assert anew.judgement.status == (*kept.judgement.status[:4], "init")


def test_what_is_kept_and_learned_anew_is_still_where_the_tracker_was(face):
    said = {"points": face.points(30, PARTS[:2]), "kept": face.points(30, PARTS[2:])}
    put = run("factorized", face, given(30, **said, learn=True))
    assert [one.status for one in parts_of(put[30].targets[0])] == ["init"] * 2 + ["tracked"] * 3
