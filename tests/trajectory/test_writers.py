"""Writing a trajectory: bytes that follow from the values, JSON that always closes, files that are whole."""

from __future__ import annotations

import csv
import errno
import io
import json
import math
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pytest
from hypothesis import given

from facetrack_cli.core.errors import OutputError
from facetrack_cli.core.files import FileSink, StreamSink, temporary_path
from facetrack_cli.trajectory.reader import read_trajectory
from facetrack_cli.trajectory.trajectory import COLUMNS, DECIMALS, FLOATS, FrameResult, Trajectory, one_part
from facetrack_cli.trajectory.writers import FORMATS, WRITERS, RunSummary, as_written, csv_frames
from tests.support import results, trajectories
from tests.support.results import file_rows, part, rows_of, target
from tests.support.sinks import Alone

HEADER = (
    "frame,time_s,target,part,x,y,w,h,angle,confidence,status,std_x,std_y,cov_xy,std_w,std_h,particles,ess,"
    "identity,identity_prob"
)


def result(index: int = 7, x: float = 1.25, *, status: str = "tracked", cov: float = 4.0) -> FrameResult:
    nose = part("nose", x, -2.0, 25, 13, status, 0.5, (cov, 0.0, 9.0), 61.25)
    lip = part("lip", 3.0, 4.0, 13, 13, "lost", 0.0, (0.0, 0.0, 0.0), 1.0, angle=-7.5)
    return results.result(index, [target("face", [nose, lip], 100)])


def lines(rows: Trajectory) -> str:
    """The rows as CSV, without the header."""
    return "".join(csv_frames(rows))


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


def write(path: Path, form: str, frames: list[FrameResult], footer: RunSummary | None = None) -> None:
    writer = WRITERS[form](Alone(path), {"seed": 3})  # type: ignore[index]
    for each in frames:
        writer.write(each.rows)
    writer.close(footer or RunSummary())


def corrected() -> FrameResult:
    """A frame in which a correction gave one part and said that another is not visible; a third is tracked on."""
    parts = [
        part("nose", 1.25, -2.0, 25, 13, "init", 1.0, (4.0, 0.0, 9.0), 61.25, by_hand=True),
        part("lip", status="absent", by_hand=True),
        part("chin", 3.0, 4.0, 13, 13, "tracked", 0.5),
    ]
    gone = target("hand", [part("lip", status="absent")])
    return results.result(7, [target("face", parts, 100), gone])


# --- rows and numbers ---


def test_columns_are_the_schema() -> None:
    assert ",".join(COLUMNS) == HEADER
    fields = [name for name in COLUMNS if name not in ("target", "part")]
    own = ["names", "which", *fields, "by_hand", "corners", "header", "diagnostics", "path"]
    assert sorted(Trajectory.__dataclass_fields__) == sorted(own)


def test_a_row_for_each_part_also_when_lost() -> None:
    nose, lip = rows_of(result().rows)
    assert (nose.frame, nose.time_s, nose.target, nose.part, nose.status) == (7, 0.28, "face", "nose", "tracked")
    assert (nose.std_x, nose.std_y, nose.particles) == (2.0, 3.0, 100)
    assert (lip.part, lip.status, lip.angle) == ("lip", "lost", -7.5)


def test_csv_has_fixed_decimals() -> None:
    first, second = lines(result().rows).splitlines()
    assert first == "7,0.2800,face,nose,1.250,-2.000,25.000,13.000,,0.5000,tracked,2.000,3.000,0.000,,,100,61.2,,"
    assert second == "7,0.2800,face,lip,3.000,4.000,13.000,13.000,-7.50,0.0000,lost,0.000,0.000,0.000,,,100,1.0,,"


def test_an_absent_part_has_a_row_without_a_place() -> None:
    _, lip, _, hand = rows_of(corrected().rows)
    assert (lip.x, lip.y, lip.w, lip.h, lip.status, lip.by_hand) == (None, None, None, None, "absent", True)
    assert (hand.particles, hand.by_hand) == (None, False)
    written = lines(corrected().rows).splitlines()
    assert written[1] == "7,0.2800,face,lip,,,,,,,absent,,,,,,100,,,"
    assert written[3] == "7,0.2800,hand,lip,,,,,,,absent,,,,,,,,,"


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
    line = lines(one_part("f", "p", [0], time_s=[value], x=[value], y=[value], angle=[value]))
    assert "-" not in line
    assert line.startswith("0,0.0000,f,p,0.000,0.000,")


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_left_empty(value: float, tmp_path: Path) -> None:
    row = one_part("f", "p", [0], time_s=[0.0], x=[value], y=[1.0])
    assert lines(row).startswith("0,0.0000,f,p,,1.000,")
    write(tmp_path / "t.json", "json", [result(x=value)])
    part = json.loads((tmp_path / "t.json").read_text())["frames"][0]["targets"][0]["parts"][0]
    assert "x" not in part
    assert part["y"] == -2.0


def test_a_covariance_that_rounding_made_negative_has_no_spread() -> None:
    assert result(cov=-1e-15).rows.std_x[0] == 0.0


# --- what is written is read back ---


def plain(path: Path) -> list[dict[str, Any]]:
    """The rows of a file by the csv and json of Python: known values alone, text as it stands there."""
    if path.suffix == ".csv":
        with path.open(encoding="utf-8", newline="") as file:
            found = []
            for line in csv.DictReader(file):
                row: dict[str, Any] = {key: value for key, value in line.items() if value}
                found.append(row | {name: float(row[name]) for name in ("frame", *FLOATS) if name in row})
            return found
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".json":
        frames = json.loads(text)["frames"]
    else:
        frames = [record for line in text.split("\n") if line and (record := json.loads(line))["type"] == "frame"]
    found = []
    for frame in frames:
        for one in frame["targets"]:
            for own in one["parts"]:
                row = {**frame, **one, **own}
                found.append({key: row[key] for key in (*COLUMNS, "by_hand") if row.get(key) is not None})
    return found


@pytest.mark.parametrize("form", FORMATS)
@given(given_rows=trajectories.trajectories())
def test_what_is_written_is_read_back(
    tmp_path_factory: pytest.TempPathFactory, form: str, given_rows: Trajectory
) -> None:
    path = trajectories.write(tmp_path_factory.getbasetemp() / f"round.{form}", given_rows)
    expected = as_written(given_rows)
    for name, decimals in DECIMALS.items():
        values, kept = getattr(given_rows, name), getattr(expected, name)
        np.testing.assert_allclose(kept, values, rtol=0, atol=0.5001 * 10**-decimals, err_msg=name)
    rows = [vars(row) for row in rows_of(expected)]
    kept_of = [name for name in (*COLUMNS, "by_hand") if form != "csv" or name != "by_hand"]
    assert plain(path) == [
        {name: row[name] for name in kept_of if row[name] not in ("", None) and row[name] is not False} for row in rows
    ]
    back = read_trajectory(path)
    assert back.names == expected.names
    for name in ("which", "frame", *FLOATS, "status", "identity", "cov_xy"):
        np.testing.assert_array_equal(getattr(back, name), getattr(expected, name), name)
    np.testing.assert_array_equal(back.by_hand, expected.by_hand & (form != "csv"))
    assert back.corners is expected.corners is None
    diagnostics = {name: found for name, one in expected.diagnostics.items() if (found := trajectories.known(one))}
    assert {name: trajectories.known(one) for name, one in back.diagnostics.items()} == (
        {} if form == "csv" else diagnostics
    )
    assert lines(back) == lines(given_rows), "the same bytes again"
    again = trajectories.write(path.with_stem("again"), back)
    assert form == "csv" or again.read_bytes() == path.read_bytes()


# --- JSON ---


def test_json_is_one_object_with_a_line_a_frame(tmp_path: Path) -> None:
    path = tmp_path / "t.json"
    footer = RunSummary(warnings=("cut",), complete=False, stopped="interrupted", lost_frames={"face/lip": 2})
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
        "std_x": 2.0, "std_y": 3.0, "cov_xy": 0.0, "ess": 61.2,
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
    sink = Alone(path)
    writer = WRITERS["csv"](sink, {})
    writer.write(result().rows)
    assert path.read_text() == "old"
    writer.close(RunSummary())
    assert path.read_text().startswith(HEADER)
    assert [p.name for p in tmp_path.iterdir()] == ["t.csv"]


def test_a_discarded_file_leaves_nothing(tmp_path: Path) -> None:
    sink = Alone(tmp_path / "t.csv")
    sink.write("x")
    sink.discard()
    sink.discard()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"cannot be written: No such file .*--out"):
        Alone(tmp_path / "none" / "t.csv")


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("room", [3000, 70_000, 200_000])
def test_a_full_disk_keeps_whole_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: str, room: int) -> None:
    def small(self: FileSink) -> BinaryIO:
        return Disk(room, temporary_path(self.path))

    monkeypatch.setattr(Alone, "_open", small)
    path = tmp_path / f"t.{form}"
    writer = WRITERS[form](Alone(path), {})  # type: ignore[index]
    with pytest.raises(OutputError, match="disk is full"):
        for i in range(3000):
            writer.write(result(i).rows)
    with pytest.raises(OutputError, match="disk is full"):
        writer.close(RunSummary(complete=False, stopped="disk full"))

    text = path.read_text()
    assert len(text) <= room
    if form == "csv":
        kept = file_rows(path)
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

    with pytest.raises(BrokenPipeError):
        StreamSink(Closed()).write("x")


def test_python_csv_agrees_with_ours() -> None:
    line = lines(one_part('a "b", c', "p", [0], time_s=[0.0], x=[1.0], y=[2.0]))
    assert next(csv.reader([line]))[2] == 'a "b", c'
