"""Which rows a calibration is fitted to, and what it takes as right."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import to_dict
from facetrack_cli.trajectory.trajectory import joined, one_part
from tests.support.samples import FOLDER, from_tools

calibrate = from_tools("calibration_fit")
CLIPS = [FOLDER / f"{name}.mp4" for name in ("occlusion", "expressions")]
GONE = Path("gone.mp4")


def part(name, x, y, **columns):
    """A part at (x, y) in each frame, the first of which was given."""
    n = len(x)
    known = {"confidence": np.full(n, 0.5), "std_x": np.ones(n), "std_y": np.ones(n), "ess": np.full(n, 50.0)}
    known |= {"particles": np.full(n, 100.0), "status": ["init", *["tracked"] * (n - 1)]} | columns
    return one_part("face", name, np.arange(n), x=np.asarray(x, float), y=np.full(n, float(y)), **known)


def face(off, **columns):
    """Two points 40 apart and a box of 60 by 60; all are off by so much in each frame."""
    off, n = np.asarray(off, float), len(off)
    points = [part("left", 30 + off, 50, **columns), part("right", 70 + off, 50, **columns)]
    box = part("box", 50 + off, 40, w=np.full(n, 60.0), h=np.full(n, 60.0), **columns)
    return joined([*points, box])


def true(n, status=None, named=True):
    whole = face(np.zeros(n), status=status or ["visible"] * n)
    if named:
        return whole
    box = whole.find("face", "box")
    return joined([box.renamed("", box.part)])


def test_right_is_less_than_a_quarter_of_the_size():
    found = calibrate.collect([([face([0, 9.9, 10.1, 14.9, 15.1])], true(5))])
    assert found["points"].right.tolist() == [True, False, False, False] * 2  # of 40 pixels; the first frame was given
    assert found["box"].right.tolist() == [True, True, True, False]  # of 60


def test_hidden_rows_count_by_their_place_and_absent_ones_are_wrong():
    status = ["visible", "hidden", "hidden", "absent", "lost"]
    found = calibrate.collect([([face([0, 0, 20, 0, 0])], true(5, status))])["box"]
    assert found.right.tolist() == [True, False, False] and found.visible.tolist() == [False] * 3


def test_boxes_without_names_are_those_of_the_only_box():
    found = calibrate.collect([([face([0, 0, 20])], true(3, named=False))])
    assert list(found) == ["box"] and found["box"].right.tolist() == [True, False]


def test_a_long_clip_and_many_seeds_weigh_no_more():
    long, short = face(np.zeros(2000)), face([0, 0, 0])
    found = calibrate.collect([([long, long], true(2000)), ([short], true(3))])["points"]
    assert np.bincount(found.clip).tolist() == [calibrate.MAX_ROWS, 4]
    assert np.bincount(found.clip, found.weight) == pytest.approx([1, 1])


def test_clips_of_one_kind_weigh_as_one_clip():
    clips = [([face([0, 0, 0])], true(3)) for _ in range(3)]
    found = calibrate.collect(clips, [0, 1, 0])["points"]
    assert found.clips == [0, 1] and np.bincount(found.clip, found.weight) == pytest.approx([1, 1])
    kinds = {Path("a-0"): clips[0], Path("b-0"): clips[1], Path("a-1"): clips[2]}
    known = calibrate.of_runs("face", kinds, 1, lambda path: path.name[0])
    assert known.fitted["points"].sample.clip.tolist() == found.clip.tolist()


def test_without_confidence_there_is_nothing_to_collect():
    with pytest.raises(InputError, match="both a confidence and known ground truth"):
        calibrate.collect([([face([0, 0], confidence=np.full(2, np.nan))], true(2))])
    with pytest.raises(UsageError, match="kcf gives no confidence"):
        calibrate.uncalibrated(load_recipe("kcf"))


def test_the_tool_leaves_out_a_clip_that_cannot_run(monkeypatch, capsys):
    tool = from_tools("calibrations")
    monkeypatch.setattr(tool, "ProcessPoolExecutor", ThreadPoolExecutor)
    found = tool.fit(load_recipe("independent", {"filter.particles": 20}), [GONE, *CLIPS], 1, 1, None)
    assert found.clips == ("expressions.mp4", "occlusion.mp4")
    assert capsys.readouterr().err.count("gone.mp4 is left out: ") == 1


def test_targets_lose_their_calibration_to_be_calibrated():
    keys = {f"targets.{name}.confidence.calibration": "x.json" for name in ("head", "left_hand", "right_hand")}
    raw = calibrate.uncalibrated(load_recipe("head_hands_cloud", keys))
    assert to_dict(raw) == to_dict(load_recipe("head_hands_cloud"))
    one = calibrate.uncalibrated(load_recipe("sir", {"confidence.calibration": "x.json"}))
    assert to_dict(one) == to_dict(load_recipe("sir")) and one.name == "sir"
