"""Each format means what its benchmark says, and writers invert readers."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.trajectory.formats.boxes import (
    read_boxes,
    read_got10k,
    read_mot,
    read_otb,
    read_vot,
    write_got10k,
    write_mot,
    write_otb,
    write_vot,
)
from facetrack_cli.trajectory.formats.pts import read_pts
from facetrack_cli.trajectory.formats.read import read_results, read_truth, recognise
from facetrack_cli.trajectory.select import enclose
from facetrack_cli.trajectory.trajectory import Trajectory, one_part


def write(folder: Path, text: str, name: str = "gt.txt") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def decimals(low: int, high: int, places: int) -> st.SearchStrategy[float]:
    return st.integers(low * 10**places, high * 10**places).map(lambda n: n / 10**places)


# as a trajectory's CSV has it: centre and size with 3 decimals; or a row without a place
PLACE = st.tuples(*[decimals(-50, 2000, 3)] * 2, *[decimals(1, 300, 3)] * 2, st.one_of(st.none(), decimals(0, 1, 4)))
ROWS = st.lists(st.one_of(st.none(), PLACE), min_size=1, max_size=12)


def track(frames: list[int], rows: list[tuple[float, ...] | None], target: str = "head") -> Trajectory:
    known = np.array([[np.nan] * 5 if r is None else [np.nan if v is None else v for v in r] for r in rows])
    status = ["lost" if i % 3 else "tracked" for i in range(len(rows))]
    x, y, w, h, confidence = known.T
    return one_part(target, "box", frames, x=x, y=y, w=w, h=h, confidence=confidence, status=status)


def agree(a: Trajectory, b: Trajectory) -> None:
    assert a.frame.tolist() == b.frame.tolist()
    for name in ("x", "y", "w", "h"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=0, atol=1e-9)


@given(rows=ROWS, first=st.integers(0, 500), form=st.sampled_from(["otb", "got10k"]))
def test_otb_and_got10k_there_and_back(
    tmp_path: Path, rows: list[tuple[float, ...] | None], first: int, form: str
) -> None:
    one = track(list(range(first, first + len(rows))), rows)
    text = write_otb(one)
    assert text.count("\n") == len(rows)
    back = {"otb": read_otb, "got10k": read_got10k}[form](write(tmp_path, text), shift=first)
    agree(back.parts[0], one)
    assert (back.parts[0].status == "absent").tolist() == [row is None for row in rows]
    if all(row is not None for row in rows):  # as the toolkits load it
        np.testing.assert_allclose(np.loadtxt(tmp_path / "gt.txt", delimiter=",", ndmin=2)[:, 2:], one.boxes[:, 2:])


@given(rows=ROWS, gaps=st.lists(st.integers(1, 4), min_size=12, max_size=12), places=st.integers(0, 9))
def test_vot_there_and_back(tmp_path: Path, rows: list[tuple[float, ...] | None], gaps: list[int], places: int) -> None:
    frames = (np.cumsum(gaps)[: len(rows)] + places).tolist()
    one = track(frames, rows)
    text = write_vot(one)
    assert text.count("\n") == frames[-1] + 1
    assert text.split("\n")[frames[0]] == "1"
    (back,) = read_vot(write(tmp_path, text)).parts
    agree(back.take(np.arange(1, len(back))), one.take(np.arange(1, len(one))))
    assert back.frame[0] == frames[0]
    assert back.status.tolist() == ["init"] + ["lost" if row is None else "tracked" for row in rows[1:]]


@given(rows=st.lists(PLACE, min_size=1, max_size=8), others=st.lists(PLACE, min_size=1, max_size=8))
def test_mot_there_and_back(tmp_path: Path, rows: list[tuple[float, ...]], others: list[tuple[float, ...]]) -> None:
    pair = (
        track(list(range(3, 3 + len(rows))), list(rows), "7"),
        track([2 * i for i in range(len(others))], list(others), "2"),
    )
    path = write(tmp_path, write_mot(pair))
    found = {one.target: one for one in read_mot(path, results=True).parts}
    assert sorted(found) == ["2", "7"]
    for one in pair:
        agree(found[one.target], one)
        np.testing.assert_allclose(found[one.target].confidence, one.confidence, atol=1e-9)
    lines = [line.split(",") for line in path.read_text().splitlines()]
    assert all(len(line) == 10 for line in lines)
    assert [int(line[0]) for line in lines] == sorted(int(line[0]) for line in lines)


def test_boxes_are_counted_from_zero(tmp_path: Path) -> None:
    path = write(tmp_path, "w,frame,h,x,y,who\n10,5,20,0,1,ann\n,7,,,,ann\n10,6,20,2,1,ann\n")
    (one,) = read_boxes(path).parts
    assert one.frame.tolist() == [5, 6, 7]
    assert one.boxes[:2].tolist() == [[0, 1, 10, 20], [2, 1, 10, 20]]
    assert one.x[0] == 4.5
    assert one.status.tolist() == ["visible", "visible", "absent"]


def test_otb_is_counted_from_one_and_zeros_are_absent(tmp_path: Path) -> None:
    (one,) = read_otb(write(tmp_path, "1\t1\t11\t21\n0\t0\t0\t0\nNaN\tNaN\tNaN\tNaN\n")).parts
    assert (one.target, one.part) == ("", "box")
    assert one.boxes[0].tolist() == [0, 0, 11, 21]
    assert (one.x[0], one.y[0]) == (5, 10)
    assert one.status.tolist() == ["visible", "absent", "absent"]


def test_got10k_has_its_own_ways_to_say_absent(tmp_path: Path) -> None:
    text = "1,1,11,21\n-1,-1,-1,-1\n5,5,0,9\n"
    assert read_got10k(write(tmp_path, text)).parts[0].status.tolist() == ["visible", "absent", "absent"]
    with pytest.raises(InputError, match=":2: the box has a negative size"):
        read_otb(write(tmp_path, text))


def test_formats_without_frame_numbers_have_no_room_for_gaps() -> None:
    one = track([4, 5, 9], [(5.0, 5.0, 3.0, 3.0, None)] * 3)
    with pytest.raises(InputError, match="head/box: no row between frames 5 and 9"):
        write_otb(one)
    assert write_vot(one) == "0\n0\n0\n0\n1\n4,4,3,3\n0\n0\n0\n4,4,3,3\n"


@pytest.mark.parametrize("writer", [write_otb, write_vot, lambda one: write_mot([one])])
def test_points_are_no_boxes(writer: object) -> None:
    with pytest.raises(InputError, match="face/nose: frame 3 has no w and h"):
        writer(one_part("face", "nose", [3], x=[1.0], y=[2.0]))  # type: ignore[operator]


def test_points_without_windows_are_left_out_where_others_have_some(tmp_path: Path) -> None:
    nose = one_part("face", "nose", [3], x=[50.0], y=[40.0], w=[11.0], h=[11.0])
    mouth = one_part("face", "mouth_left", [3], x=[40.0], y=[60.0], w=[11.0], h=[11.0])
    eye = one_part("face", "eye_left_upper", [3], x=[10.0], y=[10.0])
    assert enclose([nose, eye, mouth]).boxes.tolist() == enclose([nose, mouth]).boxes.tolist()
    assert enclose([nose, eye], "points").boxes.tolist() != enclose([nose], "points").boxes.tolist()


def test_mot_flags_and_visibility(tmp_path: Path) -> None:
    rows = "1,3,11,21,30,40,1,1,1\n2,3,12,21,30,40,1,1,0\n3,3,13,21,30,40,0,1,1\n1,9,1,1,5,5,0,1,1\n"
    found = read_mot(write(tmp_path, rows))
    (one,) = found.parts
    assert (one.target, one.part) == ("3", "box")
    assert one.frame.tolist() == [0, 1]
    assert one.boxes[0].tolist() == [10, 20, 30, 40]
    assert one.status.tolist() == ["visible", "hidden"]
    assert "2 rows of flag 0 left out" in found.header["read_as"]


def test_mot_tells_confidences_from_flags(tmp_path: Path) -> None:
    path = write(tmp_path, "1,1,1,1,9,9,0.5,-1,-1,-1\n2,1,1,1,9,9,0,-1,-1,-1\n3,1,1,1,9,9,-1,-1,-1,-1\n")
    (one,) = read_mot(path).parts
    np.testing.assert_equal(one.confidence, [0.5, 0, np.nan])
    (flagged,) = read_mot(path, results=False).parts
    assert flagged.frame.tolist() == [0, 2]
    assert np.isnan(flagged.confidence).all()


def test_mot_numbers_targets_that_have_names() -> None:
    pair = [track([0], [(5.0, 5.0, 3.0, 3.0, None)], name) for name in ("head", "hand")]
    assert write_mot(pair) == "1,1,5,5,3,3,-1,1,1,-1\n1,2,5,5,3,3,-1,1,1,-1\n"


def test_mot_results_say_what_is_visible_and_truth_has_nine_values(tmp_path: Path) -> None:
    place = {name: np.full(4, value) for name, value in (("x", 5.0), ("y", 5.0), ("w", 3.0), ("h", 3.0))}
    run = one_part(
        "1", "box", range(4), **place, status=["init", "tracked", "hidden", "lost"], confidence=[1, 0.9, 0.4, 0]
    )
    last = [line.split(",")[6:] for line in write_mot([run]).splitlines()]
    assert last == [["1", "1", "1", "-1"], ["0.9", "1", "1", "-1"], ["0.4", "1", "0", "-1"], ["0", "1", "0", "-1"]]
    status = ["visible", "hidden", "", "visible"]
    truth = one_part("1", "box", range(4), **place, status=status, confidence=[0.5] * 4)
    text = write_mot([truth])
    assert [line.split(",")[6:] for line in text.splitlines()] == [["1", "1", one] for one in ("1", "0", "1", "1")]
    (back,) = read_mot(write(tmp_path, text)).parts
    assert back.status.tolist() == ["visible", "hidden", "visible", "visible"]
    agree(truth, back)


@pytest.mark.parametrize("tail", ["{flag},{kind},1", "{flag},{kind},-1,-1"])
def test_mot_class_1_alone_counts(tmp_path: Path, tail: str) -> None:
    rows = [(1, 1, 1), (2, 1, 2), (3, 0, 7), (4, 1, 3), (5, 0, 4), (6, 0, 1)]  # id, flag, class
    lines = [f"1,{ident},{10 * ident},9,8,8,{tail.format(flag=flag, kind=kind)}" for ident, flag, kind in rows]
    found = read_mot(write(tmp_path, "\n".join(lines)))
    assert [(one.target, str(one.status[0])) for one in found.parts] == [
        ("1", "visible"),
        ("2", "hidden"),
        ("3", "hidden"),
    ]
    for said in ("1 rows of flag 0 left out", "2 rows of other classes left out", "2 rows of other classes not judged"):
        assert said in found.header["read_as"]
    only = [line.replace(",1,2,", ",1,9,") for line in lines[1:2]]
    assert read_mot(write(tmp_path, "\n".join(only))).status.tolist() == ["visible"], "a single class is what counts"
    with pytest.raises(InputError, match="has the classes 2, 3, and 1 alone counts"):
        read_mot(write(tmp_path, "\n".join([lines[1], lines[3]])))


def test_mot_coordinates_of_the_world_are_no_classes(tmp_path: Path) -> None:
    found = read_mot(write(tmp_path, "1,1,9,9,8,8,1,-13.07,2.5,0\n1,2,9,9,8,8,1,2,4.1,0\n"))
    assert found.targets == ("1", "2") and found.status.tolist() == ["visible"] * 2


def test_mot_says_that_little_is_visible(tmp_path: Path) -> None:
    found = read_mot(write(tmp_path, "1,1,9,9,8,8,1,1,0.1\n2,1,9,9,8,8,1,1,0\n3,1,9,9,8,8,1,1,.8\n"))
    assert found.status.tolist() == ["visible", "hidden", "visible"]
    assert found.header["read_as"].endswith("1 rows of a visibility below .5 count as visible")


def test_got10k_has_zeros_where_nothing_is_known(tmp_path: Path) -> None:
    one = track([0, 1], [(5.0, 5.0, 3.0, 3.0, None), None])
    assert write_got10k(one) == "5,5,3,3\n0,0,0,0\n" and write_otb(one) == "5,5,3,3\nnan,nan,nan,nan\n"
    assert read_got10k(write(tmp_path, write_got10k(one))).status.tolist() == ["visible", "absent"]


def binary(*regions: bytes) -> bytes:
    return struct.pack("<hI", 1, len(regions)) + b"".join(regions)


CODE, BOX = struct.pack("<BI", 0, 1), struct.pack("<B4f", 1, 10.5, 20, 30, 40.25)
POLYGON = struct.pack("<BH8f", 2, 4, 2, 0, 6, 2, 4, 8, 0, 6.125)


def test_binary_results_of_vot_are_read_as_its_text(tmp_path: Path) -> None:
    path = tmp_path / "clip_001.bin"
    path.write_bytes(binary(CODE, BOX, POLYGON, struct.pack("<BI", 0, 2)))
    text = write(tmp_path, "1\n10.5,20,30,40.25\n2,0,6,2,4,8,0,6.125\n2\n")
    assert recognise(path) == (path, "vot")
    found, same = read_results(path), read_vot(text)
    assert found.status.tolist() == same.status.tolist() == ["init", "tracked", "tracked", "lost"]
    np.testing.assert_array_equal(found.boxes, same.boxes)
    np.testing.assert_array_equal(found.corners, same.corners)
    assert found.header["read_as"] == "VOT result: pixels from 0"


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (binary(CODE, BOX)[:-1], "is no binary result of vot-toolkit, or is cut short; let the toolkit write text"),
        (binary(CODE, BOX) + b"x", "is cut short"),
        (b"1,2,3,4\n", "is no binary result"),
        (binary(CODE, b"\x09"), "is no binary result"),
        (struct.pack("<hI", 1, 2**32 - 1), "is cut short"),
        (binary(), "is cut short"),
        (binary(CODE, struct.pack("<BhhHHH2H", 3, 0, 0, 2, 1, 2, 0, 2)), ":2: a mask; masks are not read"),
        (binary(CODE, struct.pack("<B2f", 4, 1, 2)), ":2: 2 values"),
    ],
)
def test_binary_results_that_cannot_be_read(tmp_path: Path, data: bytes, said: str) -> None:
    path = tmp_path / "clip_001.bin"
    path.write_bytes(data)
    with pytest.raises(InputError, match=said) as error:
        read_vot(path)
    assert str(path) in str(error.value) and "\n" not in str(error.value)


def test_the_truth_beside_a_result_of_vot_is_vot_s(tmp_path: Path) -> None:
    truth, result = write(tmp_path, "1,2,3,4\n"), read_results(write(tmp_path, "1\n1,2,3,4\n", "result.txt"))
    assert read_truth(truth).boxes[0].tolist() == [0, 1, 3, 4]
    assert read_truth(truth, beside=result).boxes[0].tolist() == [1, 2, 3, 4]
    assert read_truth(truth, "otb", beside=result).boxes[0].tolist() == [0, 1, 3, 4], "as the user says"
    named = write(tmp_path, "frame,x,y,w,h\n0,1,2,3,4\n", "named.csv")
    assert read_truth(named, beside=result).header["read_as"].startswith("boxes")
    write(tmp_path, "fps=30\n", "sequence")
    assert read_truth(truth).boxes[0].tolist() == [1, 2, 3, 4], "VOT keeps such a file beside"


def test_vot_truth(tmp_path: Path) -> None:
    text = "10,20,30,40\nnan,nan,nan,nan\n0\n2,0,6,2,4,8,0,6\n"
    found = read_vot(write(tmp_path, text))
    (one,) = found.parts
    assert one.frame.tolist() == [0, 1, 2, 3]
    assert one.status.tolist() == ["visible", "absent", "absent", "visible"]
    assert one.boxes[0].tolist() == [10, 20, 30, 40]
    assert one.boxes[3].tolist() == [0, 0, 6, 8]
    assert one.corners is not None
    assert one.corners[3].tolist() == [[2, 0], [6, 2], [4, 8], [0, 6]]
    assert np.isnan(one.corners[:3]).all()
    assert np.isnan(one.angle).all()


def test_vot_polygons_are_written_as_such(tmp_path: Path) -> None:
    corners = np.array([[[0, 0], [4, 0], [4, 4], [0, 4]], [[2, 0], [6, 2], [4, 8], [0, 6.125]]], float)
    low, high = corners.min(axis=1), corners.max(axis=1)
    w, h = (high - low).T
    one = one_part("a", "box", [0, 1], x=low[:, 0] + (w - 1) / 2, y=low[:, 1] + (h - 1) / 2, w=w, h=h, corners=corners)
    assert write_vot(one) == "1\n2,0,6,2,4,8,0,6.125\n"
    (back,) = read_vot(write(tmp_path, write_vot(one))).parts
    assert back.corners is not None
    assert np.array_equal(back.corners[1], corners[1])


def test_pts_are_counted_from_one(tmp_path: Path) -> None:
    for number in (1, 3):
        points = "\n".join(f"{k + number} {2 * k}" for k in range(1, 69))
        write(tmp_path, f"version: 1\nn_points:  68\n{{\n{points}\n}}\n", f"{number:06d}.pts")
    found = read_pts(tmp_path)
    assert len(found.parts) == 68 + 5
    assert found.targets == ("face",)
    # iBUG, from 1: the tip of the nose, the corners of the mouth, the middles of the lips' outer borders
    named = {"nose": 31, "mouth_left": 49, "mouth_right": 55, "lip_upper": 52, "lip_lower": 58}
    for part, number in named.items():
        one, same = found.find("face", part), found.find("face", f"point_{number:02d}")
        assert one is not None
        assert same is not None
        assert one.frame.tolist() == same.frame.tolist() == [0, 2]
        assert one.x.tolist() == same.x.tolist() == [number, number + 2]
        assert one.y.tolist() == [2 * number - 1] * 2


def test_pts_of_other_sizes_and_nan(tmp_path: Path) -> None:
    write(tmp_path, "version: 1\nn_points: 2\n{\n1 1\nnan nan\n}", "clip_12.pts")
    found = read_pts(tmp_path / "clip_12.pts")
    assert [one.name for one in found.parts] == ["face/point_01", "face/point_02"]
    assert [one.status.tolist() for one in found.parts] == [["visible"], ["absent"]]
    assert found.parts[0].frame.tolist() == [11]
    write(tmp_path, "version: 1\nn_points: 1\n{\n1 1\n}", "clip_13.pts")
    with pytest.raises(InputError, match=r"clip_13.pts: has 1 points, clip_12.pts 2"):
        read_pts(tmp_path)
    write(tmp_path, "version: 1\nn_points: 2\n{\n1 1\n2 2\n}", "other_12.pts")
    with pytest.raises(InputError, match=r"other_12.pts: frame 12 is also in clip_12.pts"):
        read_pts(tmp_path)


def test_vot_has_no_room_for_frames_far_on() -> None:
    far = track([0, 10**9], [(9.0, 9.0, 3.0, 3.0, None)] * 2)
    with pytest.raises(InputError, match="frame 1000000000 is too far on for VOT text, which has a line a frame"):
        write_vot(far)
