"""The table of results: bytes that follow from the values, JSON that always closes, and a reader that says where."""

from __future__ import annotations

import csv
import errno
import io
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.files import FileSink, ReaderGoneError, StreamSink, beside
from facetrack_cli.core.types import Frame, PartResult, Result, TargetResult
from facetrack_cli.trajectory.csv_reader import read_csv
from facetrack_cli.trajectory.row import COLUMNS, DECIMALS, FORMATS, Footer, Row, rows
from facetrack_cli.trajectory.writers import WRITERS, csv_lines

HEADER = "frame,time_s,target,part,x,y,w,h,angle,confidence,status,std_x,std_y,particles,ess,identity,identity_prob"


def result(index: int = 7, x: float = 1.25, *, status: str = "tracked", cov: float = 4.0) -> Result:
    part = PartResult("nose", x, -2.0, 25, 13, status, 0.5, (cov, 0.0, 9.0), 61.25)  # type: ignore[arg-type]
    other = PartResult("lip", 3.0, 4.0, 13, 13, "lost", 0.0, (0.0, 0.0, 0.0), 1.0, angle=-7.5)
    frame = Frame(index, index / 25, np.zeros((4, 6, 3), np.uint8))
    return Result(frame, (TargetResult("face", (part, other), 100, np.zeros((1, 2, 2))),))


class Disk(io.BytesIO):
    """A file on a disk with room for `room` bytes; it takes what fits and then fails, as write(2) does."""

    def __init__(self, room: int, path: Path) -> None:
        super().__init__()
        self.room, self.path = room, path

    def write(self, data: object) -> int:
        blob = bytes(data)  # type: ignore[call-overload]
        end = self.tell() + len(blob)
        fits = max(0, min(len(blob), max(self.room, len(self.getvalue())) - self.tell()))
        if end > self.room and fits == 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(blob[:fits])

    def close(self) -> None:
        if not self.closed:
            self.path.write_bytes(self.getvalue())
        super().close()


def write(path: Path, form: str, results: list[Result], footer: Footer | None = None) -> None:
    writer = WRITERS[form](FileSink(path), {"seed": 3})  # type: ignore[index]
    for each in results:
        writer.write(each)
    writer.close(footer or Footer())


def corrected() -> Result:
    """A frame in which a correction gave one part and said that another is not to be seen; a third is tracked on."""
    nan = math.nan
    parts = (
        PartResult("nose", 1.25, -2.0, 25, 13, "init", 1.0, (4.0, 0.0, 9.0), 61.25, by_hand=True),
        PartResult("lip", nan, nan, nan, nan, "absent", by_hand=True),
        PartResult("chin", 3.0, 4.0, 13, 13, "tracked", 0.5),
    )
    frame = Frame(7, 7 / 25, np.zeros((4, 6, 3), np.uint8))
    gone = TargetResult("hand", (replace(parts[1], by_hand=False),), None, np.zeros((0, 1, 2)))
    return Result(frame, (TargetResult("face", parts, 100, np.zeros((1, 3, 2))), gone))


# --- rows and numbers ---


def test_columns_are_the_schema() -> None:
    assert ",".join(COLUMNS) == HEADER
    assert ",".join(Row._fields) == f"{HEADER},by_hand", "JSON alone says what was given by hand"


def test_a_row_for_each_part_also_when_lost() -> None:
    nose, lip = rows(result())
    assert (nose.frame, nose.time_s, nose.target, nose.part, nose.status) == (7, 0.28, "face", "nose", "tracked")
    assert (nose.std_x, nose.std_y, nose.particles) == (2.0, 3.0, 100)
    assert (lip.part, lip.status, lip.angle) == ("lip", "lost", -7.5)


def test_csv_has_fixed_decimals() -> None:
    first, second = csv_lines(rows(result())).splitlines()
    assert first == "7,0.2800,face,nose,1.250,-2.000,25.000,13.000,,0.5000,tracked,2.000,3.000,100,61.2,,"
    assert second == "7,0.2800,face,lip,3.000,4.000,13.000,13.000,-7.50,0.0000,lost,0.000,0.000,100,1.0,,"


def test_an_absent_part_has_a_row_without_a_place() -> None:
    _, lip, _, hand = rows(corrected())
    assert (lip.x, lip.y, lip.w, lip.h, lip.status, lip.by_hand) == (None, None, None, None, "absent", True)
    assert (hand.particles, hand.by_hand) == (None, False)
    lines = csv_lines(rows(corrected())).splitlines()
    assert lines[1] == "7,0.2800,face,lip,,,,,,,absent,,,100,,,"
    assert lines[3] == "7,0.2800,hand,lip,,,,,,,absent,,,,,,"


@pytest.mark.parametrize("form", ["json", "jsonl"])
def test_json_says_what_was_given_by_hand(form: str, tmp_path: Path) -> None:
    path = tmp_path / f"t.{form}"
    write(path, form, [corrected()])
    text = path.read_text()
    assert '"confidence":1.0000,"status":"init","by_hand":true,"std_x"' in text
    assert '{"part":"lip","status":"absent","by_hand":true}' in text
    assert text.count("by_hand") == 2, "the key is there where it is true"
    assert '{"target":"hand","parts":[{"part":"lip","status":"absent"}]}' in text


@pytest.mark.parametrize("value", [-0.0, -0.00004, np.float64(-1e-9), np.float32(-1e-5)])
def test_no_negative_zero(value: float) -> None:
    line = csv_lines([Row(0, value, "f", "p", value, value, angle=value)])
    assert "-" not in line
    assert line.startswith("0,0.0000,f,p,0.000,0.000,")


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_left_empty(value: float, tmp_path: Path) -> None:
    assert csv_lines([Row(0, 0.0, "f", "p", value, 1.0)]).startswith("0,0.0000,f,p,,1.000,")
    write(tmp_path / "t.json", "json", [result(x=value)])
    part = json.loads((tmp_path / "t.json").read_text())["frames"][0]["targets"][0]["parts"][0]
    assert "x" not in part
    assert part["y"] == -2.0


def test_a_covariance_that_rounding_made_negative_has_no_spread() -> None:
    assert next(rows(result(cov=-1e-15))).std_x == 0.0


names = st.text(st.characters(blacklist_categories=["Cs", "Cc"]), min_size=1).filter(lambda s: s == s.strip())
numbers = st.none() | st.floats(-1e6, 1e6)


@given(
    st.lists(
        st.builds(
            Row,
            frame=st.integers(0, 10**9),
            time_s=numbers,
            target=names,
            part=names,
            x=numbers,
            y=numbers,
            w=numbers,
            h=numbers,
            angle=numbers,
            confidence=numbers,
            status=st.sampled_from(["init", "visible", ""]),
            std_x=numbers,
            std_y=numbers,
            particles=st.none() | st.integers(0, 10**6),
            ess=numbers,
            identity=names | st.just(""),
            identity_prob=numbers,
            by_hand=st.just(False),
        )
    )
)
def test_what_is_written_is_read_back(tmp_path_factory: pytest.TempPathFactory, given_rows: list[Row]) -> None:
    path = tmp_path_factory.getbasetemp() / "round.csv"
    path.write_text(HEADER + "\n" + csv_lines(given_rows), encoding="utf-8", newline="")
    back = read_csv(path)
    for row, again in zip(given_rows, back, strict=True):
        for name, value, read in zip(Row._fields, row, again, strict=True):
            if isinstance(value, float):
                assert read == pytest.approx(value, abs=0.5001 * 10 ** -DECIMALS[name]), name
            else:
                assert read == value, name
    assert csv_lines(back) == csv_lines(given_rows)


# --- JSON ---


def test_json_is_one_object_with_a_line_a_frame(tmp_path: Path) -> None:
    path = tmp_path / "t.json"
    footer = Footer(warnings=("cut",), complete=False, stopped="interrupted", lost_frames={"face/lip": 2})
    write(path, "json", [result(7), result(8)], footer)
    text = path.read_text()
    data = json.loads(text)
    assert (data["schema"], data["version"], data["seed"]) == ("facetrack-trajectory", 1, 3)
    assert [frame["frame"] for frame in data["frames"]] == [7, 8]
    assert sum(line.startswith('{"frame":') for line in text.splitlines()) == 2
    assert (data["complete"], data["stopped"], data["frames_tracked"]) == (False, "interrupted", 2)
    assert (data["warnings"], data["lost_frames"]) == (["cut"], {"face/lip": 2})
    target = data["frames"][0]["targets"][0]
    assert target["target"] == "face"
    assert target["parts"][0] == {
        "part": "nose", "x": 1.25, "y": -2.0, "w": 25.0, "h": 13.0, "confidence": 0.5, "status": "tracked",
        "std_x": 2.0, "std_y": 3.0, "ess": 61.2,
    }  # fmt: skip


def test_json_without_a_frame_is_valid(tmp_path: Path) -> None:
    write(tmp_path / "t.json", "json", [])
    assert json.loads((tmp_path / "t.json").read_text())["frames"] == []


def test_json_lines_have_header_frames_and_footer(tmp_path: Path) -> None:
    write(tmp_path / "t.jsonl", "jsonl", [result(7), result(8)])
    lines = [json.loads(line) for line in (tmp_path / "t.jsonl").read_text().splitlines()]
    assert [line["type"] for line in lines] == ["header", "frame", "frame", "footer"]
    assert lines[0]["schema"] == "facetrack-trajectory"
    assert lines[-1]["frames_tracked"] == 2


def test_the_same_results_give_the_same_bytes(tmp_path: Path) -> None:
    for form in FORMATS:
        for name in ("a", "b"):
            write(tmp_path / f"{name}.{form}", form, [result(i, i / 3) for i in range(50)])
        assert (tmp_path / f"a.{form}").read_bytes() == (tmp_path / f"b.{form}").read_bytes()


# --- files and streams ---


def test_a_file_appears_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("old")
    sink = FileSink(path)
    writer = WRITERS["csv"](sink, {})
    writer.write(result())
    assert path.read_text() == "old"
    writer.close(Footer())
    assert path.read_text().startswith(HEADER)
    assert [p.name for p in tmp_path.iterdir()] == ["t.csv"]


def test_a_discarded_file_leaves_nothing(tmp_path: Path) -> None:
    sink = FileSink(tmp_path / "t.csv")
    sink.write("x")
    sink.discard()
    sink.discard()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"cannot be written: No such file .*--out"):
        FileSink(tmp_path / "none" / "t.csv")


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("room", [3000, 70_000, 200_000])
def test_a_full_disk_keeps_whole_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str, room: int) -> None:
    def small(self: FileSink) -> BinaryIO:
        return Disk(room, beside(self.path))

    monkeypatch.setattr(FileSink, "_open", small)
    path = tmp_path / f"t.{form}"
    writer = WRITERS[form](FileSink(path), {})  # type: ignore[index]
    with pytest.raises(OutputError, match="disk is full"):
        for i in range(3000):
            writer.write(result(i))
    with pytest.raises(OutputError, match="disk is full"):
        writer.close(Footer(complete=False, stopped="disk full"))

    text = path.read_text()
    assert len(text) <= room
    if form == "csv":
        kept = read_csv(path)
        indices = [row.frame for row in kept[::2]]
        assert text.endswith("\n")
        assert len(kept) == 2 * len(indices)
        assert len(text) > room - 200
    elif form == "json":
        data = json.loads(text)
        indices = [frame["frame"] for frame in data["frames"]]
        assert (data["complete"], data["frames_tracked"]) == (False, len(indices))
    else:
        lines = [json.loads(line) for line in text.splitlines()]
        indices = [line["frame"] for line in lines[1:-1]]
        assert (lines[-1]["type"], lines[-1]["frames_tracked"]) == ("footer", len(indices))
    assert indices == list(range(len(indices)))
    assert len(text) > room - 1200
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_dev_full_is_a_full_disk() -> None:
    if not Path("/dev/full").exists():
        pytest.skip("this system has no /dev/full")
    with open("/dev/full", "wb", buffering=0) as stream:  # noqa: PTH123 -- a device, not a path of ours
        sink = StreamSink(stream)  # type: ignore[arg-type]
        with pytest.raises(OutputError, match=r"standard output: the disk is full"):
            sink.write("x")


def test_a_reader_that_left_is_not_an_output_error() -> None:
    class Closed(io.BytesIO):
        def write(self, data: object) -> int:
            raise BrokenPipeError

    with pytest.raises(ReaderGoneError):
        StreamSink(Closed()).write("x")


# --- reading ---


def saved(tmp_path: Path, text: str | bytes) -> Path:
    path = tmp_path / "truth.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_optional_columns_may_be_missing_and_order_is_free(tmp_path: Path) -> None:
    path = saved(tmp_path, "part,x,y,frame,target,mine\nnose,1.5,2,4,face,whatever\n")
    assert read_csv(path) == [Row(4, None, "face", "nose", 1.5, 2.0)]


def test_bom_crlf_and_blank_lines_are_fine(tmp_path: Path) -> None:
    path = saved(tmp_path, "\ufeffframe,target,part,x,y,status\r\n0,face,nose,1,2,hidden\r\n\r\n")
    assert read_csv(path) == [Row(0, None, "face", "nose", 1.0, 2.0, status="hidden")]


def test_a_part_that_is_absent_has_no_place(tmp_path: Path) -> None:
    path = saved(tmp_path, "frame,target,part,x,y,status\n0,face,nose,,,absent\n")
    assert read_csv(path)[0].x is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"truth\.csv: is empty; .*header"),
        ("\n", r"truth\.csv: is empty"),
        ("a,b\n1,2\n", r"truth\.csv:1: the header has no column frame, target, part, x, y; it should read frame,"),
        ("frame;target;part;x;y\n", r"truth\.csv:1: the header has no column"),
        ("frame,target,part,x,y,x\n", r"truth\.csv:1: column x is there twice"),
        ("frame,target,part,x,y\n0,f,p,1\n0,f,p,1,2\n", r"truth\.csv:2: 4 values under 5 columns; .*empty between"),
        ("frame,target,part,x,y\n0,f,p,1\n", r"truth\.csv:2: is no whole line, and the last; .* remove this line"),
        ("frame,target,part,x,y\n0,f,p,1_0,2\n", r"truth\.csv:2: column x: '1_0' is no finite number; "),
        ("frame,target,part,x,y\n0,f,p,1,2\n1,f,p,1,two\n", r"truth\.csv:3: column y: 'two' is no finite number; "),
        ("frame,target,part,x,y\n0,f,p,nan,2\n", r"truth\.csv:2: column x: 'nan' is no finite number; "),
        ("frame,target,part,x,y\n0,f,p,1e999,2\n", r"truth\.csv:2: column x: '1e999' is no finite number; "),
        ("frame,target,part,x,y\n1.5,f,p,1,2\n", r"truth\.csv:2: column frame: '1.5' is no whole number"),
        ("frame,target,part,x,y\n-1,f,p,1,2\n", r"truth\.csv:2: column frame: '-1' is no whole number"),
        ("frame,target,part,x,y\n,f,p,1,2\n", r"truth\.csv:2: column frame: '' is no whole number"),
        ("frame,target,part,x,y\n0,f,,1,2\n", r"truth\.csv:2: column part is empty; name the part"),
        (b"frame,target,part,x,y\n0,f,\xff,1,2\n", r"truth\.csv: byte 26 is not UTF-8"),
        (b"\x00\x01\x02", r"truth\.csv:"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read_csv(saved(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.csv: cannot be read: No such file"):
        read_csv(tmp_path / "none.csv")
    with pytest.raises(InputError, match="cannot be read: Is a directory"):
        read_csv(tmp_path)


def test_python_csv_agrees_with_ours(tmp_path: Path) -> None:
    line = csv_lines([Row(0, 0.0, 'a "b", c', "p", 1.0, 2.0)])
    assert next(csv.reader([line]))[2] == 'a "b", c'
