"""Truth files known by their shape, and one clear line for whatever is broken."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.cli.options import TRUTH_FORMATS
from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.trajectory.formats.read import _READERS, read_results, read_truth, recognise
from facetrack_cli.trajectory.trajectory import COLUMNS

PTS = "version: 1\nn_points:  2\n{\n1 1\n3 4.5\n}\n"
FORMATS = ("auto", *_READERS)
MOT_GT = "1,3,11,21,30,40,1,1,1\n2,3,12,21,30,40,1,1,0\n"


def write(folder: Path, text: str | bytes, name: str = "gt.txt") -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize(
    ("text", "form"),
    [
        ("1,2,3,4\n", "otb"),
        ("1\t2\t3\t4\n", "otb"),
        ("1 2 3 4\n", "otb"),
        ("1, 2, 3, 4\n", "otb"),
        ("nan,nan,nan,nan\n1,2,3,4\n", "otb"),
        ("1\n1,2,3,4\n", "vot"),
        ("1,2,3,4\n2\n0\n", "vot"),
        ("1,2,3,4,5,6,7,8\n", "vot"),
        ("m1,2,3,4,5\n", "vot"),
        ("frame,x,y,w,h\n0,1,2,3,4\n", "boxes"),
        ("frame,h,w,y,x,note\n0,1,2,3,4,a\n", "boxes"),
        (",".join(COLUMNS), "facetrack"),
        ("x,y,part,target,frame\n", "facetrack"),
        ('{"schema": 1}', "facetrack"),
        (MOT_GT, "mot"),
        ("1,-1,3,4,5,6,-1,-1,-1,-1\n", None),
        ("1,1,3,4,5,6,-1,-1,-1,-1\n", "mot"),
        ("1 1 3 4 5 6 .5\n", "mot"),
        (PTS, "pts"),
    ],
)
@pytest.mark.parametrize(("before", "after"), [("", ""), ("\ufeff", ""), ("", "\n\n"), ("\n", "")])
def test_a_file_is_known_by_its_shape(tmp_path: Path, text: str, form: str | None, before: str, after: str) -> None:
    path = write(tmp_path, before + text + after)
    if form is None:
        with pytest.raises(InputError, match="name its kind by --truth-format"):
            recognise(path)
    else:
        assert recognise(path) == (path, form)


def test_labels_beside_tell_got10k(tmp_path: Path) -> None:
    path = write(tmp_path, "1,2,3,4\n" * 3, "groundtruth.txt")
    write(tmp_path, "0\n1\n0\n", "absence.label")
    write(tmp_path, "8\n0\n0\n", "cover.label")
    assert recognise(tmp_path) == (path, "got10k")
    found = read_truth(tmp_path)
    assert found.parts[0].status.tolist() == ["visible", "absent", "hidden"]
    assert np.isnan(found.parts[0].x).tolist() == [False, True, False]
    assert "absence.label and cover.label" in found.header["read_as"]
    write(tmp_path, "0\n1\n", "absence.label")
    with pytest.raises(InputError, match=r"absence.label: has 2 lines, groundtruth.txt beside it 3"):
        read_truth(tmp_path)


@pytest.mark.parametrize(
    ("inside", "text", "form"),
    [
        ("gt/gt.txt", MOT_GT, "mot"),
        ("groundtruth_rect.txt", "1,2,3,4\n", "otb"),
        ("groundtruth.txt", "1,2,3,4,5,6,7,8\n", "vot"),
        ("groundtruth.csv", "frame,x,y,w,h\n0,1,2,3,4\n", "boxes"),
        ("annot/000001.pts", PTS, "pts"),
        ("000001.pts", PTS, "pts"),
        ("trajectory.csv", "frame,target,part,x,y\n0,a,b,1,2\n", "facetrack"),
    ],
)
def test_a_folder_is_looked_into(tmp_path: Path, inside: str, text: str, form: str) -> None:
    write(tmp_path, text, inside)
    assert recognise(tmp_path)[1] == form
    assert read_truth(tmp_path).parts


@pytest.mark.parametrize("form", FORMATS[1:])
def test_shift_is_added_to_every_frame(tmp_path: Path, form: str) -> None:
    texts = {
        "facetrack": "frame,target,part,x,y\n3,a,b,1,2\n",
        "boxes": "frame,x,y,w,h\n3,1,2,3,4\n",
        "mot": "4,1,1,2,3,4,1,1,1\n",
        "pts": PTS,
        "cvat": "<annotations><track label='a'><points frame='3' points='1,2'/></track></annotations>",
    }
    name = "000004.pts" if form == "pts" else "gt.txt"
    path = write(tmp_path, texts.get(form, "1,2,3,4\n" * 4), name)
    plain, moved = (read_truth(path, form, shift=shift) for shift in (0, -5))
    assert plain.parts[0].frame[-1] == 3
    assert moved.parts[0].frame[-1] == -2
    assert moved.header["shift"] == -5
    assert moved.header["read_as"]


@pytest.mark.parametrize(
    ("form", "text", "message"),
    [
        ("auto", "", "is empty"),
        ("auto", "\ufeff\r\n \r\n", "is empty"),
        ("auto", b"\x00\x00\x01\xba mpeg", "is binary"),
        ("auto", b"1,2,3,4\n\xff\xfe", ":2: is not UTF-8 text; save it as UTF-8"),
        ("auto", "1,2,3,4\n".encode("utf-16"), "is UTF-16 text; save it as UTF-8"),
        ("auto", "frame;x;y;w;h\n", ":1: semicolons between the columns; write commas"),
        ("auto", "frame\ttarget\tpart\tx\ty\n", ":1: tabs between the columns; write commas"),
        ("auto", "1,2,3,4,5\n", ":1: five numbers a line; put the header frame,x,y,w,h on top"),
        ("auto", "1,2,3\n", ":1: 3 values a line"),
        ("auto", "hello world\n", ":1: 'hello world' begins no ground truth file"),
        ("auto", "1,5 2,5 3,5 4,5\n", ":1: .* write decimals with a point"),
        ("auto", "1,5;2,5;3,5;4,5\n", ":1: semicolons .* decimals with a point"),
        ("auto", "1,2,3,4\n5,6,7\n", ":2: 3 values instead of 4; a line holds left,top,width,height"),
        ("auto", "1,2,3,4\n1 2 3 4\n", ":2: '1 2 3 4' is no number"),
        ("auto", "1,2,3,4\n1,2,x,4\n", ":2: 'x' is no number"),
        ("auto", "1,2,3,4\n1,2,3_0,4\n", ":2: '3_0' is no number"),
        ("auto", "1,2,3,4\n\n1,2,3,4\n", ":2: is blank"),
        ("auto", "1,2,3,4\n1,nan,3,4\n", ":2: nan in a box that is known by half"),
        ("auto", "1,2,3,4\n1,,3,4\n", ":2: nan in a box that is known by half"),
        ("auto", "1,2,3,4\n1,2,-3,4\n", ":2: the box has a negative size"),
        ("auto", "1,2,3,4\n1,2,0,4\n", ":2: the box has no area"),
        ("auto", "1,2,3,4\n1,2,3e9,4\n", ":2: the box is farther out than any image"),
        ("auto", "1,2,3,4\n1,2,inf,4\n", ":2: inf is no number"),
        ("otb", "frame,x,y,w,h\n0,1,2,3,4\n", ":1: 5 values instead of 4.* that of boxes: leave --truth-format out"),
        ("boxes", "frame,target,part,x,y,w,h\n0,a,box,1,2,3,4\n", ":1: .* and with them x, y are centres"),
        ("boxes", "1,2,3,4\n", ":1: the header has no column frame, x, y, w, h"),
        ("boxes", "frame,x,y,w,h\n", "has a header and no rows"),
        ("boxes", "frame,x,y,w,h\n1,1,2,3,4\n\n1,1,2,3,4\n", ":4: the same frame as in line 2"),
        ("boxes", "frame,x,y,w,h\n-1,1,2,3,4\n", ":2: frame -1 is no whole number from 0 up"),
        ("boxes", "frame,x,y,w,h\n1.5,1,2,3,4\n", ":2: frame 1.5 is no whole number"),
        ("boxes", "frame,x,y,w,h\n1e300,1,2,3,4\n", ":2: frame 1e[+]300 is no whole number"),
        ("boxes", "frame,x,y,w,h\n,1,2,3,4\n", ":2: frame nan is no whole number"),
        ("mot", "1,2,3,4\n", ":1: 4 values; MOTChallenge text has"),
        ("mot", "0,1,1,1,9,9,1,1,1\n", ":1: frame 0 is no whole number from 1 up"),
        ("mot", MOT_GT + "2,3,1,1,9,9,1,1,1\n", ":3: the same frame and id as in line 2"),
        ("mot", "1,1,1,1,9,9,0,1,1\n", "every row has the flag 0"),
        ("mot", "1,1,1,1,9,9,1,1,1\n2,1,1,1,-9,9,1,1,1\n", ":2: the box has a negative size"),
        ("vot", "1,2,3,4\nm1,2,3,4,5\n", ":2: a mask; masks are not read"),
        ("vot", "1,2,3,4,5,6\n", ":1: a polygon of 3 corners"),
        ("vot", "1,2\n", ":1: 2 values; a line holds left"),
        ("vot", "1,2,3,4\n7\n", ":2: 7 is no code of VOT"),
        ("vot", "1,2,3,4\n2\n", ":2: the code 2, a failure, in a file without a 1"),
        ("vot", "1,2,3,4,5,6,7,nan\n", ":1: nan in a polygon"),
        ("pts", "1 2\n3 4\n", ":1: a .pts file begins with"),
        ("pts", PTS.replace("3 4.5", "3 x"), ":5: 'x' is no number; a line holds x y"),
        ("pts", PTS.replace("3 4.5", "3"), ":5: 1 value instead of 2; a line holds x y"),
        ("pts", PTS.replace("3 4.5", "nan 5"), ":5: nan in half a point"),
        ("pts", PTS.replace("3 4.5", "3 5e9"), ":5: the point is farther out"),
        (
            "pts",
            PTS.replace("3 4.5\n", ""),
            "1 points between the braces, and n_points says 2; was the file cut short?",
        ),
        ("pts", PTS.replace("}", ""), "2 points between the braces, and n_points says 2"),
        ("pts", PTS + "1 2\n", "2 points between the braces, and n_points says 2"),
        ("facetrack", "1,2,3,4\n", ":1: the header has no column frame"),
    ],
)
def test_what_is_broken_is_said_in_one_line(tmp_path: Path, form: str, text: str | bytes, message: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(InputError, match=message) as said:
        read_truth(path, form)
    assert str(said.value).startswith(str(path))
    assert "\n" not in str(said.value)


@pytest.mark.parametrize("form", FORMATS)
def test_folders_and_missing_files(tmp_path: Path, form: str) -> None:
    for path in (tmp_path, tmp_path / "no.txt"):
        with pytest.raises(InputError, match=r"folder|no such file|cannot be read") as said:
            read_truth(path, form)
        assert str(said.value).startswith(str(path))


@pytest.mark.parametrize("form", FORMATS)
def test_names_that_the_system_refuses_and_pipes(tmp_path: Path, form: str) -> None:
    with pytest.raises(InputError, match=r"a{300}: .*; .*"):
        read_truth(tmp_path / ("a" * 300), form)
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe")
        with pytest.raises(InputError, match="pipe: is a pipe, and can be read only once; save it in a file"):
            read_truth(tmp_path / "pipe", form)


@pytest.mark.parametrize("between", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("end", ["", "\n", "\r\n", "\n\n \n"])
def test_line_ends_and_blank_ends(tmp_path: Path, between: str, end: str) -> None:
    (found,) = read_truth(write(tmp_path, f"\ufeff1,2,3,4{between}5,6,7,8{end}")).parts
    assert found.boxes.tolist() == [[0, 1, 3, 4], [4, 5, 7, 8]]


@given(
    text=st.one_of(
        st.text(alphabet="0123456789.,-+einfam \t\r\n{}:xywh;\x0b\x85\u0661_", max_size=60),
        st.lists(st.sampled_from(["1", "2", "0", "nan", "-1", "1e9", "1e400", "", "m1"]), min_size=1, max_size=30).map(
            lambda cells: ",".join(cells).replace("2,", "2\n")
        ),
    ),
    form=st.sampled_from(FORMATS),
)
def test_whatever_it_is_there_is_a_table_or_one_line(tmp_path: Path, text: str, form: str) -> None:
    path = write(tmp_path, text)
    try:
        found = read_truth(path, form)
    except InputError as said:
        assert "\n" not in str(said)
        assert str(said).startswith(str(path))
        return
    for one in found.parts:
        assert len(one) > 0
        assert (np.diff(one.frame) > 0).all()
        assert np.isnan(one.x).tolist() == np.isnan(one.y).tolist()
        assert not np.isinf([one.x, one.y, one.w, one.h]).any()


def test_the_option_s_formats_are_those_that_are_read() -> None:
    assert TRUTH_FORMATS == FORMATS


@pytest.mark.parametrize(
    ("text", "status", "left", "confidence"),
    [
        ("5,6,10,20\nnan,nan,nan,nan\n", ["", ""], 4, np.nan),
        ("1\n5,6,10,20\n2\n", ["init", "tracked", "lost"], 5, np.nan),
        ("frame,x,y,w,h\n0,5,6,10,20\n", [""], 5, np.nan),
        ("1,3,5,6,10,20,0,-1,-1,-1\n2,3,5,6,10,20,1,-1,-1,-1\n", ["", ""], 4, 0),
    ],
)
def test_results_of_others(tmp_path: Path, text: str, status: list[str], left: float, confidence: float) -> None:
    table = read_results(write(tmp_path, text, "MIL.txt"))
    (found,) = table.parts
    assert found.status.tolist() == status
    first = int(np.flatnonzero(np.isfinite(found.x))[0])
    assert found.boxes[first].tolist() == [left, left + 1, 10, 20]
    np.testing.assert_equal(found.confidence[first], confidence)
    assert table.header["read_as"]


def test_results_are_read_as_told_and_ours_as_ever(tmp_path: Path) -> None:
    path = write(tmp_path, "5,6,10,20\n")
    assert read_results(path, "vot").parts[0].boxes.tolist() == [[5, 6, 10, 20]]
    ours = write(tmp_path, "frame,target,part,x,y,status\n0,face,nose,1,2,visible\n", "trajectory.csv")
    assert read_results(tmp_path).path == ours and read_results(tmp_path).parts[0].status.tolist() == ["visible"]
    assert "read_as" not in read_results(ours).header
    for broken in ("", "1,2,3\n"):
        with pytest.raises(InputError, match=r"a trajectory begins with|it should read frame,time_s,target"):
            read_results(write(tmp_path, broken))


def test_a_shift_beyond_any_clip_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--shift -100000000000000000000: no clip has so many frames"):
        read_truth(write(tmp_path, "1,2,3,4\n"), shift=-(10**20))
