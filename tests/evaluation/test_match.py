"""Pairing a trajectory with its ground truth: names, frames, images; a mismatch is an error with a remedy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.evaluation.rows import Pair, match
from facetrack_cli.trajectory.trajectory import Trajectory, joined, one_part


def box(frames: range, target: str = "head", part: str = "box", **columns: object) -> Trajectory:
    """On a smooth path, a pixel or two a frame."""
    t, size = np.asarray(frames), np.full(len(frames), 30.0)
    path = {"x": 160 + 40 * np.sin(t / 23), "y": 120 + 30 * np.sin(t / 17), "w": size, "h": size}
    return one_part(target, part, frames, **{**path, **columns})


def table(*those: Trajectory, name: str = "run.csv", **header: object) -> Trajectory:
    return joined(those, path=Path(name), header=header)


def truth(frames: range, target: str = "", **columns: object) -> Trajectory:
    return table(box(frames, target, **columns), name="gt.txt")


def pairs(ours: Trajectory, theirs: Trajectory, **given: object) -> list[Pair]:
    return match(ours, theirs, **{"partial": False, "select": None, **given})  # type: ignore[arg-type]


# --- status ---


def test_a_status_that_truth_cannot_have_is_named_with_its_place() -> None:
    status = np.where(np.arange(50) == 7, "Hidden", "visible")
    message = r"gt.txt: frame 7, head/box: status 'Hidden' is none of visible, hidden, absent; correct it"
    with pytest.raises(InputError, match=message):
        pairs(table(box(range(50))), truth(range(50), "head", status=status))


def test_trajectory_and_truth_the_wrong_way_round() -> None:
    track, true = (
        box(range(50), status=np.where(np.arange(50) % 9, *words))
        for words in (("tracked", "lost"), ("visible", "hidden"))
    )
    assert pairs(table(track), table(true, name="gt.txt")) and pairs(table(track), table(track, name="gt.txt"))
    with pytest.raises(InputError, match=r"run.csv: is a trajectory, and gt.txt is ground truth.*the other way round"):
        pairs(table(true, name="gt.txt"), table(track))


def test_truth_that_is_lost_all_along() -> None:
    with pytest.raises(InputError, match=r"gt.txt: calls every row lost.*name a ground truth file"):
        pairs(table(box(range(50))), truth(range(50), "head", status=["lost"] * 50))


# --- names ---


def test_truth_without_names_goes_to_the_only_boxes() -> None:
    point = one_part("head", "nose", range(50), x=np.arange(50), y=np.arange(50))
    (pair,) = pairs(table(point, box(range(50))), truth(range(50)))
    assert (pair.ours.name, pair.is_box, len(pair.truth)) == ("head/box", True, 50)
    assert np.array_equal(pair.ours.frame, pair.truth.frame)


def test_truth_without_names_and_several_boxes_needs_a_choice() -> None:
    ours = table(box(range(50)), box(range(50), "hand"))
    with pytest.raises(InputError, match=r"gt.txt: .*head/box, hand/box; choose .* --target NAME/PART"):
        pairs(ours, truth(range(50)))
    for select in ("hand", "hand/box"):
        (pair,) = pairs(ours, truth(range(50)), select=select)
        assert pair.ours.name == "hand/box"
    with pytest.raises(UsageError, match="choose among"):
        pairs(ours, truth(range(50)), select="foot")


def test_boxes_are_no_truth_of_points() -> None:
    ours = table(*(box(range(9), "face", part) for part in ("nose", "chin")))
    with pytest.raises(
        InputError, match=r"gt.txt: holds boxes, and run.csv points, face/nose, face/chin; give ground truth"
    ):
        pairs(ours, truth(range(9)))


def test_names_are_paired_and_the_rest_is_noted() -> None:
    nose, lip, eye = (box(range(50), "face", part) for part in ("nose", "lip", "eye"))
    notes: list[str] = []
    found = pairs(table(nose, lip), table(eye, nose, name="gt.csv"), note=notes.append)
    assert [(pair.ours.name, pair.is_box) for pair in found] == [("face/nose", False)]
    assert len(notes) == 2
    assert "face/eye is not in the trajectory" in notes[0]
    assert "says nothing of face/lip" in notes[1]


def test_one_target_on_both_sides_pairs_whatever_its_name() -> None:
    notes: list[str] = []
    (pair,) = pairs(table(box(range(50))), truth(range(50), "1"), note=notes.append)
    assert (pair.ours.target, pair.truth.target) == ("head", "head")
    assert notes == ["1 of the ground truth is taken for head: both have one target"]


def test_nothing_in_common_lists_both_sides() -> None:
    theirs = table(box(range(50), "1"), box(range(50), "2"), name="gt.txt")
    with pytest.raises(InputError, match=r"no part in common .* has 1/box, 2/box, the trajectory head/box"):
        pairs(table(box(range(50))), theirs)
    with pytest.raises(InputError, match=r"no part in common"):
        pairs(table(box(range(50), "a", "nose")), truth(range(50), "b"))


# --- frames ---


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (range(1, 101), r"frames 1\.\.100, the trajectory 0\.\.99: shifted by one\? --shift -1; .*the 99 that both"),
        (range(7, 107), r"shifted by 7\? --shift -7"),
        (range(200, 300), r"no frame in common; if it counts from another frame, --shift -200"),
        (range(200, 250), r"no frame in common; move ground truth by --shift N"),
        (range(61), r"ends at frame 60, the trajectory goes on to 99: --partial measures the 61 that both have"),
        (range(101), r"ends at frame 100, the trajectory ends at 99"),
        (range(5, 100), r"begins at frame 5, the trajectory at 0: --partial measures the 95"),
        (range(5, 61), r"begins at frame 5"),
        (range(1), r"ends at frame 0, the trajectory goes on to 99"),
        (range(0, 90, 10), r"ends at frame 80"),
        (range(10, 100, 10), r"begins at frame 10"),
    ],
)
def test_frames_that_do_not_agree(given: range, message: str) -> None:
    with pytest.raises(InputError, match=message) as said:
        pairs(table(box(range(100))), truth(given))
    assert str(said.value).startswith("gt.txt: ")
    assert "\n" not in str(said.value)


def test_the_remedy_counts_from_the_file() -> None:
    moved = replace(truth(range(3, 103)), header={"shift": 4})
    with pytest.raises(InputError, match=r"shifted by 3\? --shift 1;"):
        pairs(table(box(range(100))), moved)


@pytest.mark.parametrize("given", [range(0, 100, 10), range(5, 100, 10), range(9, 100, 10), range(3, 96, 7)])
def test_sparse_truth_need_not_touch_both_ends(given: range) -> None:
    (pair,) = pairs(table(box(range(100))), truth(given))
    assert pair.truth.frame.tolist() == list(given) == pair.ours.frame.tolist()


def test_a_frame_that_the_trajectory_lacks() -> None:
    cut = box(range(100)).take(np.delete(np.arange(100), [40, 41]))
    with pytest.raises(InputError, match=r"run.csv: no row of head/box in frame 40 and 1 more"):
        pairs(table(cut), truth(range(100)))
    (pair,) = pairs(table(cut), truth(range(100)), partial=True)
    assert len(pair.ours) == 98


@given(st.sets(st.integers(0, 60), min_size=1), st.sets(st.integers(0, 60), min_size=1))
def test_partial_is_the_intersection(mine: set[int], others: set[int]) -> None:
    def at(frames: set[int], target: str) -> Trajectory:
        f = sorted(frames)
        return one_part(target, "box", f, x=np.array(f) * 2.0, y=np.array(f) * 3.0, w=np.full(len(f), 9), h=f)

    ours, theirs = table(at(mine, "head")), table(at(others, ""), name="gt.txt")
    if not mine & others:
        with pytest.raises(InputError, match="no frame in common"):
            pairs(ours, theirs, partial=True)
        return
    (pair,) = pairs(ours, theirs, partial=True)
    assert pair.ours.frame.tolist() == pair.truth.frame.tolist() == sorted(mine & others)
    assert np.array_equal(pair.ours.x, pair.truth.x)
    assert np.array_equal(pair.truth.x, pair.truth.frame * 2.0)


# --- images ---


def test_truth_outside_of_the_picture() -> None:
    frames, size = range(50), np.full(50, 20.0)
    ours = table(box(frames), source={"size": [320, 240]})
    far = table(one_part("", "box", frames, x=np.arange(50) + 640, y=size, w=size, h=size), name="gt.txt")
    with pytest.raises(InputError, match=r"50 of its 50 places are outside of the image of 320x240"):
        pairs(ours, far)
    assert pairs(table(box(frames)), far)  # a CSV does not say how large its image was
    absent = np.where(np.arange(50) < 40, "absent", "visible")
    assert pairs(ours, replace(truth(frames), status=absent))
