"""Laws of corrections along the clip, whatever they are and in whatever order somebody makes them."""

import tempfile
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facetrack_cli.__main__ import main
from facetrack_cli.core.types import Correction, TargetStart
from facetrack_cli.editor.history import Fixer
from facetrack_cli.editor.save import save
from facetrack_cli.engine.corrected import is_complete
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.run_folder.finished import open_run
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.start.init_file import read_init, write_init
from facetrack_cli.trajectory.header import CORRECTED
from tests.support.samples import FOLDER
from tests.tracking.test_corrected import PARTS, Clip, lines, part, run

LAST = 13
FEW = ("filter.particles=12",)
CLIP = Clip("expressions", LAST + 1)
RECIPES = ("sir", "auxiliary_prior", "factorized", "factorized_transition")
_WAYS = ("given", "kept", "absent", "open")


@st.composite
def correction(draw, frame, ways=_WAYS):
    """Of the face at a frame: each part is given, kept, absent or not spoken of, and something is corrected."""
    way = dict(zip(PARTS, draw(st.lists(st.sampled_from(ways), min_size=5, max_size=5)), strict=True))
    if not {"given", "absent"} & {*way.values()}:
        way[draw(st.sampled_from(PARTS))] = "given"
    off = st.sampled_from((-6.0, -1.5, 0.0, 0.25, 3.0))

    def there(name):
        x, y = CLIP.point(frame, name)
        return round(x + draw(off), 3), round(y + draw(off), 3)

    places = {name: there(name) for name in PARTS}
    absent = tuple(name for name in PARTS if way[name] == "absent")
    whole = not {"absent", "open"} & {*way.values()}
    return Correction(
        frame,
        "face",
        TargetStart(points={name: places[name] for name in PARTS if way[name] == "given"}),
        {name: places[name] for name in PARTS if way[name] == "kept"} if len(absent) < 5 else {},
        True if len(absent) == 5 else absent,
        draw(st.sampled_from((None, False, True) if whole else (None, False))),
    )


@st.composite
def corrections(draw, first=1, last=LAST, most=3, ways=_WAYS):
    frames = draw(st.lists(st.integers(first, last), max_size=most, unique=True))
    return tuple(draw(correction(frame, ways)) for frame in sorted(frames))


def hidden(those):
    """Of each frame, the parts without a place."""
    found, now = [], set()
    for frame in range(LAST + 1):
        for one in those:
            if one.frame == frame:
                gone = set(PARTS) if one.absent is True else {*one.absent}
                now = gone | (now - {*one.given.points, *one.kept} if not is_complete(one, PARTS) else set())
        found.append(now)
    return found


@given(st.sampled_from(RECIPES), corrections())
@settings(max_examples=30)
def test_what_is_said_holds_and_what_comes_before_stays(config, those):
    put = run(config, CLIP, *those, overrides=FEW)
    first = min((one.frame for one in those), default=LAST + 1)
    assert lines(put)[:first] == lines(run(config, CLIP, overrides=FEW))[:first]
    for result, gone in zip(put, hidden(those), strict=True):
        [said] = [one for one in those if one.frame == result.frame.index] or [Correction(0, "face")]
        by_hand = {*said.given.points, *(gone if said.frame else ())}  # also what is still absent
        for name in PARTS:
            one = part(result, name)
            assert (one.status == "absent") == (one.x is None) == (name in gone)
            assert (one.status == "init") == (result.frame.index == 0 or name in said.given.points)
            assert one.by_hand == (name in by_hand)
            for places in (said.given.points, said.kept):
                if name in places:
                    assert (one.x, one.y) == places[name]


@given(st.sampled_from(RECIPES), st.data())
@settings(max_examples=20)
def test_what_follows_a_complete_correction_depends_on_nothing_before_it(config, data):
    at = data.draw(st.integers(4, LAST - 1))
    last = data.draw(correction(at, ("given", "kept", "absent")))
    ways = [(*data.draw(corrections(1, at - 1)), last) for _ in range(2)]
    after = data.draw(corrections(at + 1))
    one, other = (lines(run(config, CLIP, *way, *after, overrides=FEW), at) for way in ways)
    assert one == other
    start = replace(CLIP.start, corrections=(last, *after))
    [target] = build_tracker(load_recipe(config, FEW), start)
    assert lines(track((replace(target, first=CLIP.frames[0]),), iter(CLIP.frames[at:]), 0)) == one


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    words = ["run", FOLDER / "expressions.mp4", "-o", folder, "--set", FEW[0], "--stop", LAST + 1, "--no-video", "-q"]
    assert main([*map(str, words), "--overwrite", "--format", "json,csv"]) == 0
    return folder


@given(those=corrections(most=4), order=st.randoms(use_true_random=False))
@settings(max_examples=settings().max_examples // 5)
def test_a_run_put_right_is_a_whole_run_from_the_init_file_that_is_written(made, those, order):
    """Also that file, read, begins as it says; and of complete corrections the order of making does not matter."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file in made.iterdir():
            (folder / file.name).write_bytes(file.read_bytes())
        shuffled = list(those)
        order.shuffle(shuffled)
        fixer = Fixer(open_run(folder), lambda index: CLIP.frames[index])
        for one in shuffled:
            fixer.put([one])
        whole = all(is_complete(one, PARTS) for one in those)
        assert not whole or fixer.corrections == those
        save(fixer)
        fixer.close()
        wanted = fixer.corrections
        if not those:
            return
        start = read_init(folder / CORRECTED)
        assert start.corrections == wanted
        start = replace(
            start, detector=open_run(folder).start.detector
        )  # which the recorded run has, and not that file
        again = list(track(build_tracker(load_recipe("face", FEW), start), iter(CLIP.frames), 0))
        assert (folder / "trajectory.csv").read_text().split("\n", 1)[1] == "".join(lines(again))
        assert open_run(folder).start.corrections == wanted


@given(corrections(most=4))
@settings(max_examples=30)
def test_an_init_file_says_what_it_was_made_of(those):
    start = replace(CLIP.start, corrections=those)
    for suffix in ("yaml", "json"):
        with tempfile.TemporaryDirectory() as name:
            path = Path(name) / f"c.init.{suffix}"
            write_init(path, start)
            assert read_init(path).corrections == those
