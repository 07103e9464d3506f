"""Reading CSV and JSON: columns in any order, what a plain reading of the file gives, and what is wrong with a file."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from facetrack_cli.core.errors import InputError
from facetrack_cli.trajectory.reader import read_trajectory
from facetrack_cli.trajectory.trajectory import COLUMNS
from facetrack_cli.trajectory.writers import SCHEMA
from tests.support.results import file_rows

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
        (
            "\ufeffframe,target,part,x,y,status\r\n0,face,nose,1,2,hidden\r\n\r\n",
            {"frame": 0, "x": 1.0, "y": 2.0, "status": "hidden"},
        ),
        ("frame,target,part,x,y,status\n0,face,nose,,,absent\n", {"frame": 0, "status": "absent"}),
    ],
)
def test_columns_in_any_order_other_line_ends_and_what_is_not_known(tmp_path, text, known):
    assert file_rows(saved(tmp_path, text)) == [row(**known)]


def test_a_column_hidden_says_what_an_empty_status_does_not(tmp_path):
    cells = (("", "1"), ("", " True "), ("", "0"), ("", "false"), ("", ""), ("visible", "1"), ("hidden", "0"))
    rows = "".join(f"{n},face,nose,1,2,{status},{hidden}\n" for n, (status, hidden) in enumerate(cells))
    found = read_trajectory(saved(tmp_path, f"frame,target,part,x,y,status,hidden\n{rows}"))
    assert found.status.tolist() == ["hidden", "hidden", "", "", "", "visible", "hidden"]


HEAD = "frame,target,part,x,y"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("\n", r"truth\.csv: is empty; .*header"),
        (f"{HEAD},hidden\n0,f,p,1,2,0\n1,f,p,1,2,yes\n", ":3: column hidden: 'yes' is no 0, 1, true or false; correct"),
        (f"{HEAD},hidden,hidden\n", r":1: column hidden is there twice"),
        ("a,b\n1,2\n", r":1: the header has no column frame, target, part, x, y; it should read frame,"),
        (f"{HEAD},x\n", r":1: column x is there twice"),
        (f"{HEAD}\n0,f,p,1\n0,f,p,1,2\n", r":2: 4 values under 5 columns; .*empty between"),
        (f"{HEAD}\n0,f,p,1\n", r":2: 4 values under 5 columns; .*cut short"),
        (f"{HEAD}\n0,f,p,1_0,2\n", r":2: column x: '1_0' is no finite number; "),
        (f"{HEAD}\n0,f,p,1,2\n1,f,p,1,two\n", r":3: column y: 'two' is no finite number; "),
        (f"{HEAD}\n0,f,p,1e999,2\n", "frame 0, f/p: x inf is no number from -1e\\+06 to 1e\\+06; correct it"),
        (f"{HEAD}\n1.5,f,p,1,2\n", r":2: column frame: '1.5' is no whole number"),
        (f"{HEAD}\n\u0663,f,p,1,2\n", r":2: column frame: '\u0663' is no whole number"),
        (f"{HEAD}\n{'9' * 19},f,p,1,2\n", r":2: column frame: '9{19}' is no whole number"),
        (f"{HEAD}\n0,f,,1,2\n", ":2: column part: '' is no name; correct it"),
        (f"{HEAD}\n0,f,p,1,2\n1, ,p,1,2\n", ":3: column target: '' is no name; correct it"),
        (f"{HEAD},identity_prob\n1,face,box,1,2,1.5\n", "face/box: identity_prob 1.5 is no number from 0 to 1"),
        (b"frame,target,part,x,y\n0,f,\xff,1,2\n", r"truth\.csv: byte 26 is not UTF-8"),
        (b"\x00\x01\x02", r"truth\.csv:"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path, text, message):
    with pytest.raises(InputError, match=message) as caught:
        read_trajectory(saved(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match=r"none\.csv: cannot be read: No such file"):
        read_trajectory(tmp_path / "none.csv")
    with pytest.raises(InputError, match="cannot be read: Is a directory; name a trajectory or"):
        read_trajectory(tmp_path)


# --- JSON ---

PART = {"part": "nose", "x": 1.5, "y": 2, "confidence": 0.5, "status": "tracked"}
TARGET = {"target": "face", "particles": 100, "parts": [PART, {"part": "chin", "x": None, "y": None}]}


def write(folder, *targets, **frame):
    frames = [{"frame": i, "time_s": i / 25, "targets": [TARGET, *targets], **frame} for i in range(3)]
    path = folder / "one.json"
    path.write_text(json.dumps({"schema": SCHEMA, "frames": frames}))
    return path


OTHER = {"target": "other", "parts": [PART]}


def other(**change):
    return {**OTHER, "parts": [{**PART, **change}]}


@pytest.mark.parametrize(
    ("target", "frame", "why"),
    [
        (other(x="1"), {}, r"frames\.0\.targets\.1\.parts\.0\.x is not as facetrack run writes it .*valid number"),
        (other(x=10**400), {}, r"frames\.0\.targets\.1\.parts\.0\.x is not"),
        (other(mine=1), {}, r"parts\.0\.mine is not .*extra"),
        (other(status=None), {}, r"parts\.0\.status is not .*string"),
        (other(by_hand=1), {}, r"parts\.0\.by_hand is not .*boolean"),
        (other(x=float("inf")), {}, "frame 0, other/nose: x inf is no number"),
        (other(angle=float("inf")), {}, "frame 0, other/nose: angle inf is no number"),
        (other(y=-1e7), {}, "frame 0, other/nose: y -10000000 is no number from"),
        (other(w=-1), {}, "frame 0, other/nose: w -1 is no number from 0 to .*; correct it"),
        (other(part=["a"]), {}, r"parts\.0\.part is not .*string"),
        (other(part=""), {}, r"parts\.0\.part is not .*at least 1 char"),
        (OTHER | {"particles": "9"}, {}, r"targets\.1\.particles is not .*number"),
        (OTHER | {"identity": 5}, {}, r"targets\.1\.identity is not .*string"),
        (OTHER | {"identity_prob": 1.5}, {}, r"frame 0, other/nose: identity_prob 1\.5 is no number from 0 to 1; corr"),
        (OTHER | {"target": None}, {}, r"targets\.1\.target is not .*string"),
        (OTHER | {"parts": [{"x": 1, "y": 2}]}, {}, r"parts\.0\.part is not .*required"),
        (OTHER | {"parts": "nose"}, {}, r"targets\.1\.parts is not .*list"),
        (TARGET, {}, "frame 0 has two rows of face/nose"),
        (OTHER, {"frame": -1}, r"frames\.0\.frame is not"),
        (OTHER, {"frame": True}, r"frames\.0\.frame is not .*integer"),
        (OTHER, {"frame": 10**30}, r"frames\.0\.frame is not"),
        (OTHER, {"targets": []}, "has a header and no rows"),
    ],
)
def test_what_is_wrong_with_json_is_said_in_one_line(tmp_path, target, frame, why):
    with pytest.raises(InputError, match=rf"one\.json: .*{why}") as caught:
        read_trajectory(write(tmp_path, target, **frame))
    assert "\n" not in str(caught.value)


def test_what_a_target_says_is_said_of_each_part(tmp_path):
    more = {"particles": 50, "identity": "me", "identity_prob": 0.5, "time_s": 9, "mine": [1]}
    table = read_trajectory(write(tmp_path, {"target": "other", "parts": [PART, {**PART, "part": "chin"}], **more}))
    for part in table.of_target("other"):
        assert part.particles.tolist() == [50] * 3 and part.identity.tolist() == ["me"] * 3
        assert part.identity_prob.tolist() == [0.5] * 3
        assert part.time_s.tolist() == [0, 0.04, 0.08], "the time is the frame's"
    assert not (table.parts[0].identity != "").any() and np.isnan(table.find("face", "chin").x).all()
    empty = read_trajectory(write(tmp_path, {"target": "other", "parts": []}))
    assert empty.targets == ("face",) and len(empty) == 6


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


def test_files_of_a_newer_facetrack_are_refused(tmp_path):
    path = tmp_path / "new.json"
    path.write_text(json.dumps({"schema": SCHEMA, "version": 2, "frames": []}))
    with pytest.raises(InputError, match="is of version 2, and this facetrack reads 1; update facetrack"):
        read_trajectory(path)
