"""Pairing a trajectory with its ground truth: names, frames, images; a mismatch is an error with a remedy."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.evaluation.rows import match
from facetrack_cli.trajectory.trajectory import joined, one_part


def box(frames, target="head", part="box", **columns):
    """On a smooth path, a pixel or two a frame."""
    t, size = np.asarray(frames), np.full(len(frames), 30.0)
    path = {"x": 160 + 40 * np.sin(t / 23), "y": 120 + 30 * np.sin(t / 17), "w": size, "h": size}
    return one_part(target, part, frames, **{**path, **columns})


def table(*parts, name="run.csv", **header):
    return joined(parts, path=Path(name), header=header)


def truth(frames, target="", **columns):
    return table(box(frames, target, **columns), name="gt.txt")


def pairs(ours, theirs, **options):
    return match(ours, theirs, **{"partial": False, "select": None, **options})


T = np.arange(50)
HEAD, FACE = table(box(range(50))), table(*(box(range(9), "face", part) for part in ("nose", "chin")))
TWO = table(box(range(50)), box(range(50), "hand"))
TRACK, TRUE = (box(range(50), status=np.where(T % 9, *words)) for words in (("tracked", "lost"), ("visible", "hidden")))
CUT = table(box(range(100)).take(np.delete(np.arange(100), [40, 41])))
SIZED = table(box(range(50)), source={"size": [320, 240]})
FAR = truth(range(50), x=T + 640, y=np.full(50, 20.0))
ODD = truth(range(50), "head", status=np.where(T == 7, "Hidden", "visible"))
OTHERS = table(box(range(50), "1"), box(range(50), "2"), name="gt.txt")
SHIFTED = replace(truth(range(3, 103)), header={"shift": 4})


@pytest.mark.parametrize(
    ("ours", "theirs", "message"),
    [
        (HEAD, ODD, "gt.txt: frame 7, head/box: status 'Hidden' is none of visible, hidden, absent; correct it"),
        (TWO, truth(range(50)), "gt.txt: .*head/box, hand/box; choose .* --target NAME/PART"),
        (FACE, truth(range(9)), "gt.txt: .* has face/nose, face/chin; .* or give ground truth of its points"),
        (HEAD, OTHERS, "no part in common .* has 1/box, 2/box, the trajectory head/box"),
        (table(box(range(50), "a", "nose")), truth(range(50), "b"), "no part in common.*not measured by boxes"),
        (CUT, truth(range(100)), "run.csv: no row of head/box in frame 40 and 1 more"),
        (SIZED, FAR, "50 of its 50 places are outside of the image of 320x240"),
        (table(box(range(100))), SHIFTED, r"shifted by 3\? --shift 1;"),  # the remedy counts from the file
    ],
)
def test_tables_that_do_not_belong_together(ours, theirs, message):
    with pytest.raises(InputError, match=message):
        pairs(ours, theirs)


def test_what_looks_as_if_it_did_not_belong_together():
    assert pairs(table(TRACK), table(TRUE, name="gt.txt")) and pairs(table(TRACK), table(TRACK, name="gt.txt"))
    assert pairs(HEAD, FAR)  # a CSV does not say how large its image was
    assert pairs(SIZED, replace(truth(range(50)), status=np.where(T < 40, "absent", "visible")))
    (pair,) = pairs(CUT, truth(range(100)), partial=True)
    assert len(pair.ours) == 98


def test_truth_without_names_goes_to_the_only_boxes_or_to_those_that_are_chosen():
    point = one_part("head", "nose", range(50), x=T, y=T)
    (pair,) = pairs(table(point, box(range(50))), truth(range(50)))
    assert (pair.ours.name, pair.is_box, len(pair.truth)) == ("head/box", True, 50)
    assert np.array_equal(pair.ours.frame, pair.truth.frame)
    for select in ("hand", "hand/box"):
        (pair,) = pairs(TWO, truth(range(50)), select=select)
        assert pair.ours.name == "hand/box"
    with pytest.raises(UsageError, match="choose among"):
        pairs(TWO, truth(range(50)), select="foot")


def test_names_are_paired_and_the_rest_is_noted():
    nose, lip, eye = (box(range(50), "face", part) for part in ("nose", "lip", "eye"))
    notes = []
    found = pairs(table(nose, lip), table(eye, nose, name="gt.csv"), note=notes.append)
    assert [(pair.ours.name, pair.is_box) for pair in found] == [("face/nose", False)]
    assert notes == ["gt.csv: face/eye is not in the trajectory, and left out", "gt.csv: says nothing of face/lip"]
    notes.clear()
    (pair,) = pairs(HEAD, truth(range(50), "1"), note=notes.append)
    assert (pair.ours.target, pair.truth.target) == ("head", "head")
    assert notes == ["1 of the ground truth is taken for head: both have one target"]


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        (range(1, 101), r"frames 1\.\.100, the trajectory 0\.\.99: shifted by 1\? --shift -1; .*the 99 that both"),
        (range(200, 300), r"frames 200\.\.299, the .*: shifted by 200\? --shift -200; if not, name its own"),
        (range(200, 250), r"if it is moved, --shift N; if not, name its own"),
        (range(61), r"frames 0\.\.60, the trajectory 0\.\.99: .*; if not, --partial measures the 61 that both have"),
        (range(1), r"frames 0 alone"),
        (range(0, 90, 10), r"frames 0\.\.80"),
        (range(10, 100, 10), r"frames 10\.\.90"),
    ],
)
def test_frames_that_do_not_agree(frames, message):
    with pytest.raises(InputError, match=message) as refused:
        pairs(table(box(range(100))), truth(frames))
    assert str(refused.value).startswith("gt.txt: ") and "\n" not in str(refused.value)


@pytest.mark.parametrize("frames", [range(0, 100, 10), range(5, 100, 10), range(9, 100, 10), range(3, 96, 7)])
def test_sparse_truth_need_not_touch_both_ends(frames):
    (pair,) = pairs(table(box(range(100))), truth(frames))
    assert pair.truth.frame.tolist() == list(frames) == pair.ours.frame.tolist()


@given(st.sets(st.integers(0, 60), min_size=1), st.sets(st.integers(0, 60), min_size=1))
def test_partial_is_the_intersection(mine, others):
    ours, theirs = table(box(sorted(mine))), truth(sorted(others))
    if not mine & others:
        with pytest.raises(InputError, match="if not, name its own"):
            pairs(ours, theirs, partial=True)
        return
    (pair,) = pairs(ours, theirs, partial=True)
    assert pair.ours.frame.tolist() == pair.truth.frame.tolist() == sorted(mine & others)
    assert np.array_equal(pair.ours.x, pair.truth.x)
