"""facetrack suggest: recipes tried on the first seconds of a clip, without ground truth."""

import json
import shlex
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Frame, Start, TargetStart
from facetrack_cli.evaluation.experiments.suggest import MARGIN, Trial, is_grey, suggest
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.video.writer import VideoWriter

SAMPLES = Path(__file__).parents[2] / "sample_videos"
BOX = (40.0, 30.0, 24.0, 24.0)


def sway(frames=14, gone=None):
    """A textured square that moves over a textured ground, and is gone from frame `gone` on."""
    rng = np.random.default_rng(1)
    ground = np.repeat(np.repeat(rng.integers(60, 120, (12, 16, 3), np.uint8), 8, 0), 8, 1)
    square = np.repeat(np.repeat(rng.integers(120, 255, (6, 6, 3), np.uint8), 4, 0), 4, 1)
    for i in range(frames):
        image = ground.copy()
        if gone is None or i < gone:
            image[30:54, 40 + i : 64 + i] = square
        yield Frame(i, i / 25, image)


def trials(names, frames):
    start = Start(0, {"face": TargetStart(BOX)}, "--box")
    return suggest([(name, load_recipe(name)) for name in names], list(frames), start, "clip")


def test_a_track_that_is_right_comes_back_where_it_began():
    [one] = trials(["correlation_filter"], sway())
    assert one.agreement > 0.85 and one.lost == 0 and one.score == one.agreement and one.ms > 0


def test_time_lost_counts_and_the_best_comes_first():
    [one] = trials(["correlation_filter"], sway(20, gone=8))
    assert one.lost > 0.3 and one.score < one.agreement
    both = trials(["fixed_template", "correlation_filter"], sway())
    assert both[0].score + MARGIN >= both[1].score
    assert Trial("a", 0.8, 0.25, 1.0, 0.0, 1.0).score == pytest.approx(0.6)


def test_recipes_that_cannot_begin_are_left_out():
    grey = [Frame(one.index, one.time_s, np.repeat(one.bgr[:, :, :1], 3, axis=2)) for one in sway()]
    assert [one.recipe for one in trials(["skin", "correlation_filter"], grey)] == ["correlation_filter"]
    with pytest.raises(InputError, match="no recipe can begin here"):
        trials(["skin"], grey)


def test_a_grey_clip_is_told():
    colour = next(sway())
    grey = Frame(0, 0.0, np.repeat(colour.bgr[:, :, :1], 3, axis=2))
    assert is_grey(grey) and not is_grey(colour)


@pytest.fixture
def clip(tmp_path):
    path = tmp_path / "a clip.mp4"
    with VideoWriter(path, (128, 96), Fraction(25)) as video:
        for frame in sway():
            video.write(frame.bgr, frame.time_s)
    return path


def test_the_table_ends_with_the_command_to_run(clip, capsys):
    asked = ["suggest", str(clip), "--box", "40,30,24,24", "--config", "correlation_filter", "--config", "ncc"]
    assert main([*asked, "--frames", "12", "-q"]) == 0
    out, err = capsys.readouterr()
    lines = out.splitlines()
    assert "frames 0 to 11" in lines[0] and lines[2].split()[:3] == ["recipe", "agreement", "lost"]
    assert err == ""
    assert lines[-1] == "hands: not looked for"
    words = shlex.split(lines[-2].removeprefix("take: "))
    assert words[:3] == ["facetrack", "run", str(clip)] and words[3:5] == ["--config", lines[4].split()[0]]
    assert main([*words[1:], "--no-video", "--stop", "3", "-q", "-o", str(clip.parent / "out")]) == 0
    assert main([*asked, "--frames", "12", "--json", "-q"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (
        told["frames"] == 12
        and told["hands_seen"] is None
        and {one["recipe"] for one in told["trials"]} == {"correlation_filter", "ncc"}
    )
    assert told["trials"][0]["score"] + MARGIN >= told["trials"][1]["score"]


def test_what_cannot_be_tried(clip, capsys):
    assert main(["suggest", str(clip), "--frames", "12", "-q"]) == 3
    assert "no face found" in capsys.readouterr().err
    twice = ["--config", "ncc", "--config", "ncc", "--box", "40,30,24,24"]
    assert main(["suggest", str(clip), *twice]) == 2
    assert "given twice" in capsys.readouterr().err
    assert main(["suggest", str(Path("none.mp4")), "--box", "1,1,20,20"]) == 3


@pytest.mark.one_in(2)
@pytest.mark.parametrize(("name", "says"), [("signing", "with hands: "), ("expressions", "too few to follow")])
def test_hands_are_looked_for_beside_a_face(name, says, capsys):
    assert main(["suggest", str(SAMPLES / f"{name}.mp4"), "--frames", "30", "-q"]) == 0
    *_, take, hands = capsys.readouterr().out.splitlines()
    assert take.startswith("take: facetrack run ") and hands.startswith("hands: ") and says in hands
    assert ("--config signer" in hands) == (name == "signing")
