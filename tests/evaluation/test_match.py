"""Pairing a trajectory with its ground truth: names, frames, lags, images; a mismatch is an error with a remedy."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.evaluation.match import match
from facetrack_cli.evaluation.rows import Pair
from facetrack_cli.trajectory.formats.read import read_truth
from facetrack_cli.trajectory.trajectory import Trajectory, joined, one_part

SAMPLES = Path(__file__).parents[2] / "sample_videos"


def walk(frames: range, seed: int = 0, size: float = 30.0) -> dict[str, np.ndarray]:
    """A smooth path that does not repeat itself, a pixel or two a frame."""
    t = np.arange(-200, 2000)
    rng = np.random.default_rng(seed)
    steps = np.convolve(rng.normal(0, 6, (2, t.size)).ravel(), np.ones(15) / 15, "same").reshape(2, -1)
    x, y = 160 + np.cumsum(steps - steps.mean(axis=1, keepdims=True), axis=1)
    at = np.searchsorted(t, np.asarray(frames))
    full = np.full(len(frames), size)
    return {"x": x[at], "y": y[at], "w": full, "h": full}


def box(frames: range, target: str = "head", part: str = "box", noise: float = 0.0, **columns: object) -> Trajectory:
    path = walk(frames)
    rng = np.random.default_rng(5)
    path["x"] = path["x"] + rng.normal(0, noise, len(frames))
    path["y"] = path["y"] + rng.normal(0, noise, len(frames))
    return one_part(target, part, frames, **{**path, **columns})


def table(*those: Trajectory, name: str = "run.csv", **header: object) -> Trajectory:
    return joined(those, path=Path(name), header=header)


def truth(frames: range, target: str = "", **columns: object) -> Trajectory:
    return table(box(frames, target, **columns), name="gt.txt")


def pairs(ours: Trajectory, theirs: Trajectory, **given: object) -> list[Pair]:
    return match(ours, theirs, **{"partial": False, "select": None, "check_shift": True, **given})  # type: ignore[arg-type]


def renumbered(one: Trajectory, first: int) -> Trajectory:
    return replace(one, frame=one.frame - one.frame[0] + first)


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


def test_truth_without_names_and_no_boxes() -> None:
    point = one_part("head", "nose", range(50), x=np.arange(50), y=np.arange(50))
    with pytest.raises(InputError, match=r"no part of run\.csv has w and h"):
        pairs(table(point), truth(range(50)))


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


# --- lags ---


def cut(lag: int, noise: float, count: int = 250) -> tuple[Trajectory, Trajectory]:
    """A trajectory whose frame t is frame t + lag of the ground truth, both numbered from 0."""
    first = max(lag, 0)
    ours = renumbered(box(range(first, first + count), noise=noise), 0)
    theirs = renumbered(box(range(first - lag, first - lag + count), ""), 0)
    return table(ours), table(theirs, name="gt.txt")


@pytest.mark.parametrize("lag", [6, 20, 30, -8, -12, -30])
@pytest.mark.parametrize("noise", [0.3, 1.5])
def test_rows_of_other_frames_are_noticed(lag: int, noise: float) -> None:
    ours, theirs = cut(lag, noise)
    with pytest.raises(InputError, match=r"was either file cut and renumbered\? --shift") as said:
        pairs(ours, theirs)
    (told,) = re.findall(r"--shift (-?\d+) --partial", str(said.value))
    assert int(told) == -lag
    assert len(pairs(ours, theirs, check_shift=False)[0].ours) == 250
    moved = replace(theirs, frame=theirs.frame - lag)
    (pair,) = pairs(ours, moved, partial=True)  # the remedy is one
    assert np.median(np.hypot(pair.ours.x - pair.truth.x, pair.ours.y - pair.truth.y)) < 2 * noise


def trackers(x: np.ndarray) -> dict[str, np.ndarray]:
    """What trackers do to a track (T, 2) without being cut."""
    t, rng = len(x), np.random.default_rng(3)
    smooth = x.copy()
    for i in range(1, t):
        smooth[i] = smooth[i - 1] + 0.25 * (x[i] - smooth[i - 1])
    lost = x + rng.normal(0, 1, x.shape)
    lost[t // 2 :] = lost[t // 2]
    jumpy = np.where((np.arange(t) // 15 % 3 == 1)[:, None], x + 30, x)
    return {
        "good": x + rng.normal(0, 1, x.shape),
        "one behind": np.concatenate([x[:1], x[:-1]]),
        "three behind": np.concatenate([x[:1].repeat(3, axis=0), x[:-3]]),
        "ten behind": np.concatenate([x[:1].repeat(10, axis=0), x[:-10]]),
        "smooth": smooth,
        "lost half of the time": lost,
        "still": x[:1].repeat(t, axis=0),
        "off": x + np.array([9, -6]),
        "ahead along a straight path": x + np.array([8, 2]),
        "jumpy": jumpy,
        "drifting": x + np.cumsum(rng.normal(0, 1, x.shape), axis=0),
    }


def paths() -> dict[str, np.ndarray]:
    t = np.arange(240)
    samples = read_truth(SAMPLES / "expressions.truth.csv").parts[1]
    walked = walk(range(240))
    return {
        "walk": np.stack([walked["x"], walked["y"]], axis=1),
        "sample": np.stack([samples.x, samples.y], axis=1),
        "period of 24": np.stack([100 + 30 * np.sin(t * np.pi / 12), 80 + 10 * np.cos(t * np.pi / 12)], axis=1),
        "straight": np.stack([50 + t, 80 + t / 4], axis=1),
        "at rest": np.full((240, 2), 90.0),
        "stop and go": np.stack([50 + np.cumsum(t // 40 % 2 * 2.0), np.full(240, 80.0)], axis=1),
    }


@pytest.mark.parametrize("path", paths())
@pytest.mark.parametrize("tracker", trackers(np.zeros((20, 2))))
def test_bad_trackers_are_not_taken_for_a_cut(path: str, tracker: str) -> None:
    x = paths()[path]
    found = trackers(x)[tracker]
    frames, size = range(len(x)), np.full(len(x), 30.0)
    theirs = one_part("", "box", frames, x=x[:, 0], y=x[:, 1], w=size, h=size)
    ours = one_part("head", "box", frames, x=found[:, 0], y=found[:, 1], w=size, h=size)
    assert len(pairs(table(ours), table(theirs))) == 1


@pytest.mark.parametrize("lag", [-1, -3, 1])
def test_so_small_a_lag_may_be_the_tracker_itself(lag: int) -> None:
    assert pairs(*cut(lag, 0.1))


@pytest.mark.parametrize("clip", ["expressions", "occlusion"])
@pytest.mark.parametrize("lag", [6, 15, -15])
def test_a_cut_sample_is_noticed(clip: str, lag: int) -> None:
    known = read_truth(SAMPLES / f"{clip}.truth.csv")
    rng = np.random.default_rng(0)
    first, count = max(lag, 0), len(known.frames) - abs(lag)

    def part(one: Trajectory, at: int, noise: float) -> Trajectory:
        return renumbered(replace(one, x=one.x + rng.normal(0, noise, len(one))).take(np.arange(at, at + count)), 0)

    ours = table(*(part(one, first, 0.7) for one in known.parts))
    theirs = table(*(part(one, first - lag, 0.0) for one in known.parts))
    assert len(pairs(ours, ours)) == 5
    with pytest.raises(InputError, match=rf"--shift {-lag} --partial"):
        pairs(ours, theirs)


def test_hidden_and_lost_rows_do_not_speak_for_a_lag() -> None:
    ours, theirs = cut(15, 0.5)
    assert pairs(ours, replace(theirs, status=np.full(250, "hidden")))
    assert pairs(replace(ours, status=np.full(250, "lost")), theirs)


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
