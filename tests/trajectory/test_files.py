"""Reading and writing: columns in any order, what is wrong with a file, bytes that follow from values, whole files."""

import errno
import io
import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings

from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.files import temporary_path
from facetrack_cli.trajectory import reader
from facetrack_cli.trajectory.diagnostics import KNOWN, Diagnostic
from facetrack_cli.trajectory.reader import read_trajectory
from facetrack_cli.trajectory.trajectory import COLUMNS, DECIMALS, FLOATS, one_part
from facetrack_cli.trajectory.writers import FORMATS, SCHEMA, WRITERS, RunSummary, as_written, csv_frames
from tests.support import results, trajectories
from tests.support.results import file_rows, part, target
from tests.support.sinks import Alone

# --- CSV ---


def row(**columns):
    """A row of face/nose, as `file_rows` has it."""
    blank = dict.fromkeys(COLUMNS) | {"target": "face", "part": "nose", "status": "", "identity": "", "by_hand": False}
    return SimpleNamespace(**(blank | columns))


def saved(tmp_path, text):
    path = tmp_path / "truth.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize(
    ("text", "known"),
    [
        ("part,x,y,frame,target,mine\n nose,1.5, 2 ,4,face ,whatever\n", {"frame": 4, "x": 1.5, "y": 2.0}),
        ("\ufeffframe,target,part,x,y\r\n0,face,nose,1,2\r\n\r\n", {"frame": 0, "x": 1.0, "y": 2.0}),
        ("frame,target,part,x,y,status\n0,face,nose,,,absent\n", {"frame": 0, "status": "absent"}),
    ],
)
def test_columns_in_any_order_other_line_ends_and_what_is_not_known(tmp_path, text, known):
    assert file_rows(saved(tmp_path, text)) == [row(**known)]


def test_a_folder_that_is_no_run_is_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read: Is a directory; name a trajectory or"):
        read_trajectory(tmp_path)


HEAD = "frame,target,part,x,y"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("\n", r":1: the header has no column, or two, called frame, target, part, x, y; it should read frame,"),
        (f"{HEAD},hidden\n", ":1: column hidden is not read; write hidden in its column status"),
        (f"{HEAD},w,w\n", ":1: the header has no column, or two, called w; it"),
        (f"{HEAD}\n0,f,p,1\n", r":2: 4 values under 5 columns; .*cut short"),
        (f"{HEAD}\n0,f,p,1_0,2\n", r":2: column x: '1_0' is no finite number; "),
        (f"{HEAD}\n0,f,p,1,2\n1,f,p,1,two\n", r":3: column y: 'two' is no finite number; "),
        (f"{HEAD}\n\u0663,f,p,1,2\n", r":2: column frame: '\u0663' is no whole number"),
        (f"{HEAD}\n0,f,,1,2\n", ":2: column part: '' is no name; correct it"),
        (f"{HEAD}\n0,f,p,1,2\n1, ,p,1,2\n", ":3: column target: '' is no name; correct it"),
        (f"{HEAD},identity_prob\n1,face,box,1,2,1.5\n", "face/box: identity_prob 1.5 is no number from 0 to 1"),
        (b"frame,target,part,x,y\n0,f,\xff,1,2\n", r"truth\.csv: byte 26 is not UTF-8"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path, text, message):
    with pytest.raises(InputError, match=message) as caught:
        read_trajectory(saved(tmp_path, text))
    assert "\n" not in str(caught.value)


# --- JSON ---

PART = {"part": "nose", "x": 1.5, "y": 2, "confidence": 0.5, "status": "tracked"}
TARGET = {"target": "face", "particles": 100, "parts": [PART, {"part": "chin", "x": None, "y": None}]}


OTHER = {"target": "other", "parts": [PART]}


def other(**change):
    return {**OTHER, "parts": [{**PART, **change}]}


@pytest.mark.parametrize(
    ("target", "frame", "why"),
    [
        (other(x="1"), {}, r"frames\.0\.targets\.1\.parts\.0\.x is not as facetrack run writes it .*valid number"),
        (other(mine=1), {}, r"parts\.0\.mine is not .*extra"),
        (other(x=float("inf")), {}, "frame 0, other/nose: x inf is no number"),
        (other(y=-1e7), {}, "frame 0, other/nose: y -10000000 is no number from"),
        (other(w=-1), {}, "frame 0, other/nose: w -1 is no number from 0 to .*; correct it"),
        (OTHER | {"identity_prob": 1.5}, {}, r"frame 0, other/nose: identity_prob 1\.5 is no number from 0 to 1; corr"),
        (OTHER | {"parts": [{"x": 1, "y": 2}]}, {}, r"parts\.0\.part is not .*required"),
        (TARGET, {}, "frame 0 has two rows of face/nose"),
        (OTHER, {"frame": 10**30}, r"frames\.0\.frame is not"),
        (OTHER, {"targets": [{"target": "face", "parts": []}]}, "has a header and no rows"),
    ],
)
def test_what_is_wrong_with_json_is_said_in_one_line(tmp_path, target, frame, why):
    frames = [{"frame": i, "time_s": i / 25, "targets": [TARGET, target], **frame} for i in range(3)]
    (tmp_path / "one.json").write_text(json.dumps({"schema": SCHEMA, "frames": frames}))
    with pytest.raises(InputError, match=rf"one\.json: .*{why}") as caught:
        read_trajectory(tmp_path / "one.json")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_json_lines_that_end_or_were_cut_off(tmp_path, end):
    frames = [{"type": "frame", "frame": i, "time_s": 0, "targets": [TARGET]} for i in range(3)]
    head = {"type": "header", "schema": SCHEMA, "version": 1, "seed": 3}
    path = tmp_path / "cut.jsonl"
    lines = [json.dumps(record) for record in (head, *frames, {"type": "footer", "complete": False, "stopped": "no"})]
    path.write_text(end.join(lines), newline="")
    assert read_trajectory(path).header == head | {"complete": False, "stopped": "no"}
    path.write_text(end.join(lines[:-1]), newline="")
    assert read_trajectory(path).header == head and read_trajectory(path).frames.tolist() == [0, 1, 2]
    path.write_text(end.join(lines[:-1])[:-9], newline="")
    said = r"cut\.jsonl:4: is not JSON: .*cut short\? of a \.jsonl remove this line"
    with pytest.raises(InputError, match=said):
        read_trajectory(path)
    path.write_text("\n".join([json.dumps(head | {"version": 2}), *lines[1:]]))
    with pytest.raises(InputError, match="is of version 2, and this facetrack reads 1; update facetrack"):
        read_trajectory(path)


HEADER = (
    "frame,time_s,target,part,x,y,w,h,angle,confidence,status,std_x,std_y,cov_xy,std_w,std_h,particles,ess,"
    "identity,identity_prob"
)


def result(index=7, x=1.25, *, status="tracked", cov=4.0):
    nose = part("nose", x, -2.0, 25, 13, status, 0.5, (cov, 0.0, 9.0), 61.25)
    lip = part("lip", 3.0, 4.0, 13, 13, "lost", 0.0, (0.0, 0.0, 0.0), 1.0, angle=-7.5)
    return results.result(index, [target("face", [nose, lip], 100)])


def lines(rows):
    """The rows as CSV, without the header."""
    return "".join(csv_frames(rows))


class Disk(io.FileIO):
    """A file on a disk with room for `room` bytes; it takes what fits and then fails, as write(2) does."""

    def __init__(self, room, path):
        super().__init__(path, "w")
        self.room = room

    def write(self, data):
        fits = bytes(data)[: max(self.room - self.tell(), 0)]
        if len(data) and not fits:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(fits)


def write(path, form, frames, footer=None):
    writer = WRITERS[form](Alone(path), {"seed": 3})
    for each in frames:
        writer.write(each.rows)
    writer.close(footer or RunSummary())


def test_csv_has_a_row_for_each_part_with_fixed_decimals_and_finite_numbers_alone(tmp_path):
    assert ",".join(COLUMNS) == HEADER
    first, second = lines(result().rows).splitlines()
    assert first == "7,0.2800,face,nose,1.250,-2.000,25.000,13.000,,0.5000,tracked,2.000,3.000,0.000,,,100,61.2,,"
    assert second == "7,0.2800,face,lip,3.000,4.000,13.000,13.000,-7.50,0.0000,lost,0.000,0.000,0.000,,,100,1.0,,"
    for value in (-0.0, -0.00004, np.float32(-1e-5)):
        line = lines(one_part("f", "p", [0], time_s=[value], x=[value], y=[value], angle=[value]))
        assert line.startswith("0,0.0000,f,p,0.000,0.000,") and "-" not in line
    for value in (math.nan, math.inf, -math.inf):
        assert lines(result(x=value).rows).startswith("7,0.2800,face,nose,,-2.000,")
        write(tmp_path / "t.json", "json", [result(x=value)])
        assert '{"part":"nose","y":-2.000,' in (tmp_path / "t.json").read_text()


@pytest.mark.parametrize("form", ["json", "jsonl"])
def test_what_was_given_by_hand_and_what_is_absent(form, tmp_path):
    by_hand = [
        part("nose", 1.25, -2.0, 25, 13, "init", 1.0, (4.0, 0.0, 9.0), 61.25, by_hand=True),
        part("lip", status="absent", by_hand=True),
        part("chin", 3.0, 4.0, 13, 13, "tracked", 0.5),
    ]
    frame = results.result(7, [target("face", by_hand, 100), target("hand", [part("lip", status="absent")])])
    written = lines(frame.rows).splitlines()
    assert written[1] == "7,0.2800,face,lip,,,,,,,absent,,,,,,100,,,"
    assert written[3] == "7,0.2800,hand,lip,,,,,,,absent,,,,,,,,,"
    write(tmp_path / f"t.{form}", form, [frame])
    text = (tmp_path / f"t.{form}").read_text()
    assert '"confidence":1.0000,"status":"init","by_hand":true,"std_x"' in text
    assert '{"part":"lip","status":"absent","by_hand":true}' in text
    assert text.count("by_hand") == 2, "the key is there where it is true"
    assert '{"target":"hand","parts":[{"part":"lip","status":"absent"}]}' in text


# --- what is written is read back ---


OWN = (
    Diagnostic("focus", "sharpness of the window", "px", least=0, decimals=6),
    Diagnostic("spread", "over both axes", shape=(2,), least=-1, most=1, decimals=(1, 2)),
    Diagnostic("votes", shape=None),
)


@pytest.mark.parametrize("form", FORMATS)
@settings(max_examples=settings().max_examples // 2)
@given(given_rows=trajectories.trajectories((*KNOWN.values(), *OWN)))
def test_what_is_written_is_read_back(tmp_path_factory, monkeypatch, form, given_rows):
    monkeypatch.setattr(reader, "_BLOCK", 2)
    header = {"diagnostics": [one.record() for one in OWN]}
    path = trajectories.write(tmp_path_factory.getbasetemp() / f"round.{form}", given_rows, header)
    expected = as_written(given_rows)
    for name, decimals in DECIMALS.items():
        values, kept = getattr(given_rows, name), getattr(expected, name)
        np.testing.assert_allclose(kept, values, rtol=0, atol=0.5001 * 10**-decimals, err_msg=name)
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
    assert all(set(one.declared) <= {*KNOWN.values(), *OWN} for one in back.diagnostics.values())
    again = trajectories.write(path.with_stem("again"), back, header)
    assert form == "csv" or again.read_bytes() == path.read_bytes()


# --- JSON ---


def test_json_is_one_object_with_a_line_a_frame(tmp_path):
    footer = RunSummary(warnings=("cut",), complete=False, stopped="interrupted", lost_frames={"face/lip": 2})
    for frames in ([result(7), result(8)], []):
        write(tmp_path / "t.json", "json", frames, footer)
        write(tmp_path / "t.jsonl", "jsonl", frames, footer)
        text = (tmp_path / "t.json").read_text()
        assert sum(line.startswith('{"frame":') for line in text.splitlines()) == len(frames)
        data, found = json.loads(text), [json.loads(line) for line in (tmp_path / "t.jsonl").read_text().splitlines()]
        assert [line.pop("type") for line in found] == ["header", *["frame"] * len(frames), "footer"]
        assert data.pop("frames") == found[1:-1] and data == {**found[0], **found[-1]}
        assert (data["schema"], data["version"], data["seed"]) == ("facetrack-trajectory", 1, 3)
        assert (data["complete"], data["stopped"], data["frames_tracked"]) == (False, "interrupted", len(frames))
        assert (data["warnings"], data["lost_frames"]) == (["cut"], {"face/lip": 2}) and "source_sha256" not in data
        if frames:  # by another program, with the keys in another order
            lines = (tmp_path / "t.jsonl").read_text().splitlines()
            sorted_keys = (json.dumps(json.loads(line), sort_keys=True) + "\n" for line in lines)
            (tmp_path / "u.jsonl").write_text("".join(sorted_keys))
            assert len(read_trajectory(tmp_path / "u.jsonl")) == len(read_trajectory(tmp_path / "t.json"))


@pytest.mark.parametrize(
    ("path", "name"), [("/a/b.mp4", "b.mp4"), ("/a/frames", "a/frames"), ("/frames", "frames"), (".", ".")]
)
def test_a_clip_has_the_name_of_its_file_or_of_its_folder_and_that_above(path, name):
    assert reader.Header.clip_name.fget(SimpleNamespace(source=SimpleNamespace(path=path))) == name


# --- files ---


def test_a_file_appears_when_it_is_whole_or_not_at_all(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("old")
    writer = WRITERS["csv"](Alone(path), {})
    writer.write(result().rows)
    assert path.read_text() == "old"
    writer.close(RunSummary())
    assert path.read_text().startswith(HEADER)
    sink = Alone(path)
    sink.write("x")
    for _ in range(2):
        sink.discard()
    assert [p.name for p in tmp_path.iterdir()] == ["t.csv"]
    with pytest.raises(OutputError, match=r"cannot be written: No such file .*choose another place"):
        Alone(tmp_path / "none" / "t.csv")


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("room", [3000, 150_000])
def test_a_full_disk_keeps_whole_frames(tmp_path, monkeypatch, form, room):
    def small(self):
        return Disk(room, temporary_path(self.path))

    monkeypatch.setattr(Alone, "_open", small)
    path = tmp_path / f"t.{form}"
    writer = WRITERS[form](Alone(path), {})
    with pytest.raises(OutputError, match="disk is full"):
        for i in range(3000):
            writer.write(result(i).rows)
    with pytest.raises(OutputError, match="disk is full"):
        writer.close(RunSummary(complete=False, stopped="disk full"))

    text = path.read_text()
    assert room - 1200 < len(text) <= room and [p.name for p in tmp_path.iterdir()] == [path.name]
    if form == "csv":
        indices = [row.frame for row in file_rows(path)[::2]]
        assert text.endswith("\n") and len(text) > room - 200 and len(file_rows(path)) == 2 * len(indices)
    else:
        records = [json.loads(line) for line in text.splitlines()] if form == "jsonl" else []
        data = records[-1] if records else json.loads(text)
        indices = [frame["frame"] for frame in (records[1:-1] if records else data["frames"])]
        assert (data["complete"], data["frames_tracked"]) == (False, len(indices))
    assert indices == list(range(len(indices)))
