"""Ground truth and results of benchmarks: what each format means, how it is known, and one line for what is broken."""

import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.trajectory.formats import TRUTH_FORMATS
from facetrack_cli.trajectory.formats.boxes import (
    read_mot,
    read_results,
    read_truth,
    read_vot,
    recognise,
    write_got10k,
    write_mot,
    write_otb,
    write_vot,
)
from facetrack_cli.trajectory.trajectory import COLUMNS, one_part

PTS = "version: 1\nn_points:  2\n{\n1 1\n3 4.5\n}\n"
MOT_GT = "1,3,11,21,30,40,1,1,1\n2,3,12,21,30,40,1,1,0\n"


def write(folder, text, name="gt.txt"):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def refused(path, form, message):
    with pytest.raises(InputError, match=message) as error:
        read_truth(path, form)
    assert str(error.value).startswith(str(path)) and "\n" not in str(error.value)


# --- which format a file has ---


@pytest.mark.parametrize(
    ("text", "form"),
    [
        ("1,2,3,4\n", "otb"),
        ("nan,nan,nan,nan\n1,2,3,4\n", "otb"),
        ("1\n1,2,3,4\n", "vot"),
        ("1,2,3,4\n2\n0\n", "vot"),
        ("1,2,3,4,5,6,7,8\n", "vot"),
        ("m1,2,3,4,5\n", "vot"),
        ("frame,h,w,y,x,note\n0,1,2,3,4,a\n", "boxes"),
        ("frame,x,y,w,h,target\n0,1,2,3,4,a\n", "boxes"),
        (",".join(COLUMNS), "facetrack"),
        ('{"schema": 1}', "facetrack"),
        (MOT_GT, "mot"),
        ("1,-1,3,4,5,6,-1,-1,-1,-1\n", None),
        (PTS, "pts"),
    ],
)
@pytest.mark.parametrize(("before", "after"), [("\ufeff", ""), ("\n", "\n\n")])
def test_a_file_is_known_by_its_shape(tmp_path, text, form, before, after):
    path = write(tmp_path, before + text + after)
    if form is None:
        refused(path, "auto", "or give --truth-format")
    else:
        assert recognise(path) == (path, form)


TEXTS = {
    "facetrack": "frame,target,part,x,y\n3,a,b,1,2\n",
    "boxes": "frame,x,y,w,h\n3,1,2,3,4\n",
    "otb": "1,2,3,4\n" * 4,
    "got10k": "1,2,3,4\n" * 4,
    "mot": "4,1,1,2,3,4,1,1,1\n",
    "vot": "1,2,3,4,5,6,7,8\n" * 4,
    "pts": PTS,
    "cvat": "<annotations><track label='a'><points frame='3' points='1,2'/></track></annotations>",
}
"""Of each format a file of frame 3."""


@pytest.mark.parametrize(
    ("inside", "form"),
    [
        ("gt/gt.txt", "mot"),
        ("groundtruth_rect.txt", "otb"),
        ("groundtruth.txt", "vot"),
        ("groundtruth.csv", "boxes"),
        ("annot/000001.pts", "pts"),
        ("000001.pts", "pts"),
        ("trajectory.csv", "facetrack"),
    ],
)
def test_a_folder_is_looked_into(tmp_path, inside, form):
    write(tmp_path, TEXTS[form], inside)
    assert recognise(tmp_path)[1] == form and read_truth(tmp_path).parts


@pytest.mark.parametrize("form", TRUTH_FORMATS[1:])
def test_shift_is_added_to_every_frame(tmp_path, form):
    path = write(tmp_path, TEXTS[form], "000004.pts" if form == "pts" else "gt.txt")
    plain, moved = (read_truth(path, form, shift=shift) for shift in (0, -5))
    assert (plain.parts[0].frame[-1], moved.parts[0].frame[-1], moved.header["shift"]) == (3, -2, -5)
    assert moved.header["read_as"]
    with pytest.raises(UsageError, match="--shift -100000000000000000000: no clip has so many frames"):
        read_truth(path, form, shift=-(10**20))


@pytest.mark.parametrize(
    ("form", "text", "message"),
    [
        ("auto", "\ufeff\r\n \r\n", "is empty; name another file"),
        ("auto", b"1,\x00\n", "is binary"),
        ("auto", b"1,2,3,4\n\xff\xfe", ":2: is not UTF-8 text; save it as UTF-8"),
        ("auto", "frame;x;y;w;h\n", ":1: 'frame;x;y;w;h' begins no ground truth.*; commas stand between columns"),
        ("auto", "1,2,3,4\n5,6,7\n", ":2: '5,6,7' is no line of left,top,width,height"),
        ("auto", "1,2,3,4\n1,2,3_0,4\n", ":2: '1,2,3_0,4' is no line of"),
        ("auto", "1,2,3,4\n\n1,2,3,4\n", ":2: is blank"),
        ("auto", "1,2,3,4\n1,nan,3,4\n", ":2: .* is no box"),
        ("auto", "1,2,3,4\n1,2,0,4\n", ":2: .* is no box"),
        ("auto", "1,2,3,4\n1,2,3e9,4\n", ":2: .* is no box"),
        ("boxes", "frame,target,part,x,y,w,h\n0,a,box,1,2,3,4\n", ":1: .* with which x, y are centres"),
        ("boxes", "1,2,3,4\n", ":1: .* is a header without frame, x, y, w, h"),
        ("boxes", "frame,x,y,w,h\n", "has a header and no rows"),
        ("boxes", "frame,x,y,w,h\n1,1,2,3,4\n\n1,1,2,3,4\n", "frame 1 has two rows of /box; keep one row"),
        ("boxes", "frame,x,y,w,h\n1.5,1,2,3,4\n", ":2: .* no frame that is a whole number"),
        ("mot", "1,2,3,4\n", ":1: .* has 4 values; MOTChallenge text has"),
        ("mot", "0,1,1,1,9,9,1,1,1\n", ":1: .* a whole number from 1 up"),
        ("mot", "1,1,1,1,9,9,0,1,1\n", "no row counts; write 1"),
        ("mot", "1,2,20,9,8,8,1,2,1\n1,4,40,9,8,8,1,3,1\n", "no row counts; write 1"),
        ("vot", "1,2,3,4\nm1,2,3,4,5\n", ":2: 'm1,2,3,4,5' is no line of .*masks and other polygons are not read"),
        ("vot", "1,2,3,4\n2\n", ":2: .* a failure, comes after a 1"),
        ("vot", "1,2,3,4,5,6,7,nan\n", ":1: .* is none of left,top"),
        ("pts", "1 2\n3 4\n", ":1: .* begins no .pts file"),
        ("pts", PTS.replace("3 4.5", "3"), ":5: '3' is no line of x y"),
        ("pts", PTS.replace("3 4.5", "nan 5"), ":5: .* is no point"),
        ("pts", PTS.replace("3 4.5\n", ""), "has not the 2 points between braces that it says; was it cut short"),
        ("pts", "version: 1\nn_points: 0\n{\n}\n", "has not the 0 points"),
        ("facetrack", "1,2,3,4\n", ":1: the header has no column, or two, called frame"),
    ],
)
def test_what_is_broken_is_said_in_one_line(tmp_path, form, text, message):
    refused(write(tmp_path, text), form, message)


@pytest.mark.parametrize("form", TRUTH_FORMATS)
def test_what_is_no_file_is_refused(tmp_path, form):
    for path in (tmp_path, tmp_path / "no.txt"):
        refused(path, form, r"folder|cannot be read")
    with pytest.raises(InputError, match=r"a{300}: .*; .*"):
        read_truth(tmp_path / ("a" * 300), form)
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe")
        refused(tmp_path / "pipe", form, "pipe: is a pipe, and can be read only once; save it in a file")


@given(
    cells=st.lists(st.sampled_from([*"0123{}:x;\t\x0b\x85\u0661", "nan", "-1", "1e9", "1e400", "", "m1"]), max_size=40),
    form=st.sampled_from(TRUTH_FORMATS),
)
def test_whatever_it_is_there_is_a_table_or_one_line(tmp_path, cells, form):
    path = write(tmp_path, ",".join(cells).replace("2,", "2\n"))
    try:
        parts = read_truth(path, form).parts
    except InputError as error:
        assert str(error).startswith(str(path)) and "\n" not in str(error)
        return
    for part in parts:
        assert len(part) and (np.diff(part.frame) > 0).all() and (np.isnan(part.x) == np.isnan(part.y)).all()
        assert not np.isinf([part.x, part.y, part.w, part.h]).any()


# --- there and back ---


def decimals(low, high, places):
    return st.integers(low * 10**places, high * 10**places).map(lambda n: n / 10**places)


# as a trajectory's CSV has it: centre and size with 3 decimals, and a confidence
PLACE = st.tuples(*[decimals(-50, 2000, 3)] * 2, *[decimals(1, 300, 3)] * 2, st.one_of(st.none(), decimals(0, 1, 4)))
ROWS = st.lists(st.one_of(st.none(), PLACE), min_size=1, max_size=12)


def track(frames, rows, target="head"):
    known = np.array([[np.nan] * 5 if r is None else [np.nan if v is None else v for v in r] for r in rows])
    status = ["lost" if i % 3 else "tracked" for i in range(len(rows))]
    place = dict(zip(("x", "y", "w", "h", "confidence"), known.T, strict=True))
    return one_part(target, "box", frames, **place, status=status)


def agree(a, b, *more):
    assert a.frame.tolist() == b.frame.tolist()
    for name in ("x", "y", "w", "h", *more):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=0, atol=1e-9)


@given(rows=ROWS, first=st.integers(0, 500), form=st.sampled_from(["otb", "got10k"]))
def test_otb_and_got10k_there_and_back(tmp_path, rows, first, form):
    part = track(range(first, first + len(rows)), rows)
    text = write_otb(part)
    assert text.count("\n") == len(rows)
    back = read_truth(write(tmp_path, text), form, shift=first)
    agree(back, part)
    assert (back.status == "absent").tolist() == [row is None for row in rows]
    assert write_got10k(part) == text.replace("nan", "0"), "where nothing is known"
    if all(row is not None for row in rows):  # as the toolkits load it
        np.testing.assert_allclose(np.loadtxt(tmp_path / "gt.txt", delimiter=",", ndmin=2)[:, 2:], part.boxes[:, 2:])


@given(rows=ROWS, gaps=st.lists(st.integers(1, 4), min_size=12, max_size=12), first=st.integers(0, 9))
def test_vot_there_and_back(tmp_path, rows, gaps, first):
    frames = (np.cumsum(gaps)[: len(rows)] + first).tolist()
    part = track(frames, rows)
    lines = write_vot(part).split("\n")
    assert len(lines) == frames[-1] + 2 and lines[frames[0]] == "1"
    back = read_vot(write(tmp_path, write_vot(part)))
    agree(back.take(slice(1, None)), part.take(slice(1, None)))
    assert back.frame[0] == frames[0]
    assert back.status.tolist() == ["init"] + ["lost" if row is None else "tracked" for row in rows[1:]]


# --- what each means ---


MEANINGS = [  # the first box, from pixel 0, and what is visible, hidden or absent
    ("boxes", "w,frame,h,x,y,who\n10,5,20,0,1,ann\n,7,,,,ann\n10,6,20,2,1,ann\n", [5, 6, 7], [0, 1, 10, 20], "vva"),
    ("otb", "1\t1\t11\t21\n0\t0\t0\t0\nNaN\tNaN\tNaN\tNaN\n", [0, 1, 2], [0, 0, 11, 21], "vaa"),
    ("otb", "\ufeff1,2,3,4\r5,6,7,8\r\n", [0, 1], [0, 1, 3, 4], "vv"),
    ("otb", "1,2,3,4\r\n5,6,7,8\n\n \n", [0, 1], [0, 1, 3, 4], "vv"),
    ("got10k", "1,1,11,21\n-1,-1,-1,-1\n5,5,0,9\n", [0, 1, 2], [0, 0, 11, 21], "vaa"),
    ("mot", MOT_GT + "3,3,13,21,30,40,0,1,1\n1,9,1,1,5,5,0,1,1\n", [0, 1], [10, 20, 30, 40], "vh"),  # flags 0
    ("mot", "1,3,9,9,8,8,1,-13.07,2.5,0\n", [0], [8, 8, 8, 8], "v"),  # a place in the world, no class
    ("mot", "1,3,9,9,8,8,1,1,0.1\n2,3,9,9,8,8,1,1,0\n3,3,9,9,8,8,1,1,.8\n", [0, 1, 2], [8, 8, 8, 8], "vhv"),
    ("vot", "10,20,30,40\nnan,nan,nan,nan\n0\n2,0,6,2,4,8,0,6\n", [0, 1, 2, 3], [10, 20, 30, 40], "vaav"),
]


@pytest.mark.parametrize(("form", "text", "frames", "first", "status"), MEANINGS)
def test_frames_pixels_and_what_is_absent(tmp_path, form, text, frames, first, status):
    table = read_truth(write(tmp_path, text), form)
    assert (table.frame.tolist(), table.boxes[0].tolist()) == (frames, first)
    assert [name[0] for name in table.status.tolist()] == [*status]
    assert (table.x[0], table.y[0]) == (first[0] + (first[2] - 1) / 2, first[1] + (first[3] - 1) / 2)
    assert table.part == "box" and table.target == ("3" if form == "mot" else "")
    assert (np.isnan(table.x) == (table.status == "absent")).all() and np.isnan(table.angle).all()


def test_got10k_has_labels_beside_it(tmp_path):
    path = write(tmp_path, "1,2,3,4\n" * 3 + "-1,-1,-1,-1\n", "groundtruth.txt")
    write(tmp_path, "0\n1\n0\n0\n", "absence.label")
    write(tmp_path, "8\n0\n0\n0\n", "cover.label")
    assert recognise(tmp_path) == (path, "got10k")
    table = read_truth(tmp_path)
    assert table.status.tolist() == ["visible", "absent", "hidden", "absent"]
    assert np.isnan(table.x).tolist() == [0, 1, 0, 1]
    write(tmp_path, "0\n1\n", "absence.label")
    with pytest.raises(InputError, match=r"absence.label: has 2 lines, groundtruth.txt beside it 4"):
        read_truth(tmp_path)
    refused(write(tmp_path, "-1,-1,-1,-1\n"), "otb", ":1: .* is no box")


def test_what_has_no_room_in_a_format():
    part = track([4, 5, 9], [(5.0, 5.0, 3.0, 3.0, None)] * 3)
    with pytest.raises(InputError, match="head/box: no row between frames 5 and 9"):
        write_otb(part)
    assert write_vot(part) == "0\n0\n0\n0\n1\n4,4,3,3\n0\n0\n0\n4,4,3,3\n"
    with pytest.raises(InputError, match="frames 0 to 1000000000 have no room in VOT text"):
        write_vot(track([0, 10**9], [(9.0, 9.0, 3.0, 3.0, None)] * 2))
    point = one_part("face", "nose", [3], x=[1.0], y=[2.0])
    for writes in (write_otb, write_vot, lambda part: write_mot([part])):
        with pytest.raises(InputError, match="face/nose: frame 3 has no w and h"):
            writes(point)


def test_mot_has_numbers_for_names_what_is_visible_and_confidences_or_flags(tmp_path):
    place = (5.0, 5.0, 3.0, 3.0, None)
    lines = write_mot([track([0, 1], [place] * 2, name) for name in ("head", "hand")]).splitlines()
    assert lines == [f"{frame},{ident},5,5,3,3,-1,1,{2 - frame},-1" for frame in (1, 2) for ident in (1, 2)]
    assert write_mot([track([0], [place], "7")]) == "1,7,5,5,3,3,-1,1,1,-1\n"
    columns = dict(zip("xywh", np.full((4, 4), [[5.0], [5.0], [3.0], [3.0]]), strict=True))
    status = ["init", "tracked", "hidden", "lost"]
    run = one_part("1", "box", range(4), **columns, status=status, confidence=[1, 0.9, 0.4, 0])
    ends = [line.split(",", 6)[6] for line in write_mot([run]).splitlines()]
    assert ends == ["1,1,1,-1", "0.9,1,1,-1", "0.4,1,0,-1", "0,1,0,-1"]
    status = ["visible", "hidden", "", "visible"]
    truth = one_part("1", "box", range(4), **columns, status=status, confidence=[0.5] * 4)
    assert [line.split(",", 6)[6] for line in write_mot([truth]).splitlines()] == ["1,1,1", "1,1,0", "1,1,1", "1,1,1"]
    path = write(tmp_path, "1,1,1,1,9,9,0.5,-1,-1,-1\n2,1,1,1,9,9,0,-1,-1,-1\n3,1,1,1,9,9,-1,-1,-1,-1\n")
    np.testing.assert_equal(read_mot(path).confidence, [0.5, 0, np.nan])
    flagged = read_mot(path, results=False)
    assert flagged.frame.tolist() == [0, 2] and np.isnan(flagged.confidence).all()
    back = read_mot(write(tmp_path, write_mot([truth])))
    assert back.status.tolist() == ["visible", "hidden", "visible", "visible"]
    agree(truth, back)


@pytest.mark.parametrize("tail", ["{flag},{kind},1", "{flag},{kind},-1,-1"])
def test_mot_class_1_alone_counts(tmp_path, tail):
    rows = [(1, 1, 1), (2, 1, 2), (3, 0, 7), (4, 1, 3), (5, 0, 4), (6, 0, 1)]  # id, flag, class
    lines = [f"1,{ident},{10 * ident},9,8,8,{tail.format(flag=flag, kind=kind)}" for ident, flag, kind in rows]
    table = read_mot(write(tmp_path, "\n".join(lines)))
    assert [(part.target, *part.status) for part in table.parts] == [("1", "visible"), ("2", "hidden"), ("3", "hidden")]
    assert table.header["read_as"].endswith("3 rows of flag 0 or other classes left out")
    only = read_mot(write(tmp_path, lines[1].replace(",1,2,", ",1,9,")))
    assert only.status.tolist() == ["visible"], "a single class is what counts"


def test_vot_polygons_have_corners_and_their_upright_box(tmp_path):
    corners = np.array([[[0, 0], [4, 0], [4, 4], [0, 4]], [[2, 0], [6, 2], [4, 8], [0, 6.125]]], float)
    low, high = corners.min(axis=1), corners.max(axis=1)
    (x, y), (w, h) = (low + (high - low - 1) / 2).T, (high - low).T
    part = one_part("a", "box", [0, 1], x=x, y=y, w=w, h=h, corners=corners)
    assert write_vot(part) == "1\n2,0,6,2,4,8,0,6.125\n"
    back = read_vot(write(tmp_path, write_vot(part)))
    assert np.array_equal(back.corners[1], corners[1]) and np.isnan(back.corners[0]).all()
    assert back.boxes[1].tolist() == [0, 0, 6, 8]


def test_pts_are_counted_from_one(tmp_path):
    for number in (1, 3):
        points = "\n".join(f"{k + number} {2 * k}" for k in range(1, 69))
        write(tmp_path, f"version: 1\nn_points:  68\n{{\n{points}\n}}\n", f"{number:06d}.pts")
    table = read_truth(tmp_path)
    assert len(table.parts) == 68 + 5 and table.targets == ("face",)
    # iBUG, from 1: the tip of the nose, the corners of the mouth, the middles of the lips' outer borders
    for name, number in {"nose": 31, "mouth_left": 49, "mouth_right": 55, "lip_upper": 52, "lip_lower": 58}.items():
        for part in (table.find("face", name), table.find("face", f"point_{number:02d}")):
            assert part.frame.tolist() == [0, 2] and part.x.tolist() == [number, number + 2]
            assert part.y.tolist() == [2 * number - 1] * 2


def test_pts_of_other_sizes_and_nan(tmp_path):
    text = "version: 1\nn_points: 2\n{\n1 1\nnan nan\n}"
    table = read_truth(write(tmp_path, text, "clip_12.pts"))
    assert [(part.name[5:], *part.status) for part in table.parts] == [("point_01", "visible"), ("point_02", "absent")]
    assert table.frames.tolist() == [11]
    write(tmp_path, "version: 1\nn_points: 1\n{\n1 1\n}", "clip_13.pts")
    with pytest.raises(InputError, match=r"clip_13.pts: has not the 2 points of clip_12.pts"):
        read_truth(tmp_path)
    write(tmp_path, text, "other_12.pts")
    with pytest.raises(InputError, match="not numbered by their frames"):
        read_truth(tmp_path)


# --- results of others ---


@pytest.mark.parametrize(
    ("text", "status", "left", "confidence"),
    [
        ("5,6,10,20\nnan,nan,nan,nan\n", ["", ""], 4, np.nan),
        ("1\n5,6,10,20\n2\n", ["init", "tracked", "lost"], 5, np.nan),
        ("frame,x,y,w,h\n0,5,6,10,20\n", [""], 5, np.nan),
        ("1,3,5,6,10,20,0,-1,-1,-1\n2,3,5,6,10,20,1,-1,-1,-1\n", ["", ""], 4, 0),
    ],
)
def test_results_of_others(tmp_path, text, status, left, confidence):
    table = read_results(write(tmp_path, text, "MIL.txt"))
    first = int(np.flatnonzero(np.isfinite(table.x))[0])
    assert table.status.tolist() == status and table.boxes[first].tolist() == [left, left + 1, 10, 20]
    np.testing.assert_equal(table.confidence[first], confidence)
    assert table.header["read_as"]


def test_results_are_read_as_told_and_ours_as_ever(tmp_path):
    assert read_results(write(tmp_path, "5,6,10,20\n"), "vot").boxes.tolist() == [[5, 6, 10, 20]]
    ours = write(tmp_path, "frame,target,part,x,y,status\n0,face,nose,1,2,visible\n", "trajectory.csv")
    assert read_results(tmp_path).path == ours and read_results(tmp_path).status.tolist() == ["visible"]
    assert "read_as" not in read_results(ours).header
    for broken in ("", "1,2,3\n"):
        with pytest.raises(InputError, match=r"a trajectory begins with|it should read frame,time_s,target"):
            read_results(write(tmp_path, broken))


def test_the_truth_beside_a_result_of_vot_is_vot_s(tmp_path):
    truth, result = write(tmp_path, "1,2,3,4\n"), read_results(write(tmp_path, "1\n1,2,3,4\n", "result.txt"))
    assert read_truth(truth).boxes[0].tolist() == [0, 1, 3, 4]
    assert read_truth(truth, beside=result).boxes[0].tolist() == [1, 2, 3, 4]
    assert read_truth(truth, "otb", beside=result).boxes[0].tolist() == [0, 1, 3, 4], "as the user says"
    named = write(tmp_path, "frame,x,y,w,h\n0,1,2,3,4\n", "named.csv")
    assert read_truth(named, beside=result).header["read_as"].startswith("boxes")
    write(tmp_path, "fps=30\n", "sequence")
    assert read_truth(truth).boxes[0].tolist() == [1, 2, 3, 4], "VOT keeps such a file beside"
