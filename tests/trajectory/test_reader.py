"""Reading CSV and JSON: columns in any order, what a plain reading of the file gives, and what is wrong with a file."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.trajectory import reader as module
from facetrack_cli.trajectory.reader import MAX_PIXELS, read_trajectory
from facetrack_cli.trajectory.trajectory import COLUMNS, FLOATS, TEXTS
from facetrack_cli.trajectory.writers import SCHEMA
from tests.support.results import file_rows

# --- CSV ---


def row(**columns: Any) -> SimpleNamespace:
    """A row of face/nose, as `file_rows` has it."""
    blank = dict.fromkeys(COLUMNS) | {"target": "face", "part": "nose", "status": "", "identity": "", "by_hand": False}
    return SimpleNamespace(**(blank | columns))


def saved(tmp_path: Path, text: str | bytes) -> Path:
    path = tmp_path / "truth.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_optional_columns_may_be_missing_and_order_is_free(tmp_path: Path) -> None:
    path = saved(tmp_path, "part,x,y,frame,target,mine\nnose,1.5,2,4,face,whatever\n")
    assert file_rows(path) == [row(frame=4, x=1.5, y=2.0)]


def test_bom_crlf_and_blank_lines_are_fine(tmp_path: Path) -> None:
    path = saved(tmp_path, "\ufeffframe,target,part,x,y,status\r\n0,face,nose,1,2,hidden\r\n\r\n")
    assert file_rows(path) == [row(frame=0, x=1.0, y=2.0, status="hidden")]


def test_a_column_hidden_says_what_an_empty_status_does_not(tmp_path: Path) -> None:
    cells = (("", "1"), ("", " True "), ("", "0"), ("", "false"), ("", ""), ("visible", "1"), ("hidden", "0"))
    rows = "".join(f"{n},face,nose,1,2,{status},{hidden}\n" for n, (status, hidden) in enumerate(cells))
    found = read_trajectory(saved(tmp_path, f"frame,target,part,x,y,status,hidden\n{rows}"))
    assert found.status.tolist() == ["hidden", "hidden", "", "", "", "visible", "hidden"]


def test_a_part_that_is_absent_has_no_place(tmp_path: Path) -> None:
    path = saved(tmp_path, "frame,target,part,x,y,status\n0,face,nose,,,absent\n")
    assert file_rows(path) == [row(frame=0, status="absent")]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"truth\.csv: is empty; .*header"),
        ("\n", r"truth\.csv: is empty"),
        (
            "frame,target,part,x,y,hidden\n0,face,nose,1,2,0\n1,face,nose,1,2,yes\n",
            r"truth\.csv:3: column hidden: 'yes' is none of 0, 1, true and false; correct it or leave it empty",
        ),
        ("frame,target,part,x,y,hidden,hidden\n", r"truth\.csv:1: column hidden is there twice"),
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
        ("frame,target,part,x,y\n0,f,p,1,2\n1, ,p,1,2\n", r"truth\.csv:3: column target is empty; name the target"),
        ("frame,target,part,x,y\n", r"truth\.csv: has a header and no rows"),
        ("frame,target,part,x,y\n3,f,p,1,2\n3,f,p,1,2\n", r"truth\.csv: frame 3 has two rows of f/p; keep one row"),
        (b"frame,target,part,x,y\n0,f,\xff,1,2\n", r"truth\.csv: byte 26 is not UTF-8"),
        (b"\x00\x01\x02", r"truth\.csv:"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        read_trajectory(saved(tmp_path, text))
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.csv: cannot be read: No such file"):
        read_trajectory(tmp_path / "none.csv")
    with pytest.raises(InputError, match=r"is a folder without a trajectory\.csv or \.json; name the file"):
        read_trajectory(tmp_path)


CELLS: dict[str, st.SearchStrategy[str]] = {
    "frame": st.integers(0, 40).map(str),
    "target": st.sampled_from(["face", " face", "other"]),
    "part": st.sampled_from(["nose", "a, b"]),
    "status": st.sampled_from(["", "tracked", " lost "]),
    "particles": st.sampled_from(["", "100", " 7"]),
    "identity": st.sampled_from(["", " anna", "ben "]),
    **dict.fromkeys(("w", "h", "std_x", "std_y", "std_w", "std_h"), st.sampled_from(["", "1.5", " 2 ", "1e3"])),
    "identity_prob": st.sampled_from(["", "0.5", " 1 "]),
}
NUMBER = st.sampled_from(["", "1.5", "-2", "1e3"])
STRANGE = st.sampled_from(["", " ", "nan", "inf", "two", "1_0", " 3 ", "-1", "1.0", "9" * 19, "٣", "2"])


def plain(lines: list[dict[str, str]]) -> list[dict[str, Any]]:
    """The rows of CSV lines, one by one; ValueError, with where it is, for what no such file may have."""
    found = []
    for at, line in enumerate(lines, 2):
        known: dict[str, Any] = {}
        for name, cell in line.items():
            text = cell.strip()
            if name in ("frame", "particles"):
                if not (text.isascii() and text.isdigit() and len(text) <= 18) and (text or name == "frame"):
                    raise ValueError(f":{at}: column {name}: {text!r} is no whole number from 0 up")
                known[name] = int(text) if text else math.nan
            elif name in ("target", "part"):
                if not text:
                    raise ValueError(f":{at}: column {name} is empty")
                known[name] = text
            elif name in TEXTS:
                known[name] = text
            else:
                try:
                    known[name] = float(text.replace("_", "no number")) if text else math.nan
                except ValueError:
                    known[name] = math.inf
                if math.isinf(known[name]) or text == "nan":
                    raise ValueError(f":{at}: column {name}: {text!r} is no finite number")
        found.append(known)
    for name, low, high, why in (
        *((name, -MAX_PIXELS, MAX_PIXELS, "is farther out than any image") for name in ("x", "y")),
        *((name, 0, MAX_PIXELS, "") for name in ("w", "h", "std_x", "std_y", "std_w", "std_h")),
        ("identity_prob", 0, 1, "is no probability"),
    ):
        for one in found:
            if not (math.isnan(value := one.get(name, math.nan)) or low <= value <= high):
                raise ValueError(f": frame {one['frame']}, {one['target']}/{one['part']}: {name} {value:.15g} {why}")
    keys = [(one["frame"], one["target"], one["part"]) for one in found]
    if len(set(keys)) < len(keys):
        raise ValueError(" has two rows of ")
    if not found:
        raise ValueError(": has a header and no rows")
    return found


@given(data=st.data())
def test_a_csv_is_what_a_plain_reading_gives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, data: st.DataObject
) -> None:
    columns = data.draw(st.permutations(COLUMNS))
    columns = [c for c in columns if c in ("frame", "target", "part", "x", "y") or data.draw(st.booleans())]
    rows = [{c: data.draw(CELLS.get(c, NUMBER)) for c in columns} for _ in range(data.draw(st.integers(0, 7)))]
    if rows and data.draw(st.booleans()):
        data.draw(st.sampled_from(rows))[data.draw(st.sampled_from(columns))] = data.draw(STRANGE)
    path = tmp_path / "one.csv"
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)
    monkeypatch.setattr(module, "_BLOCK", 2)
    try:
        expected = plain(rows)
    except ValueError as e:
        with pytest.raises(InputError) as caught:
            read_trajectory(path)
        assert str(path) in str(caught.value) and str(e) in str(caught.value)
        return
    found = read_trajectory(path)
    assert found.names == tuple(dict.fromkeys((one["target"], one["part"]) for one in expected))
    expected.sort(key=lambda one: (found.names.index((one["target"], one["part"])), one["frame"]))
    assert [found.names[i] for i in found.which] == [(one["target"], one["part"]) for one in expected]
    for name in ("frame", *FLOATS, *TEXTS):
        blank = "" if name in TEXTS else math.nan
        np.testing.assert_array_equal(getattr(found, name), [one.get(name, blank) for one in expected], name)
    assert not found.by_hand.any() and found.corners is None


# --- JSON ---

PART = {"part": "nose", "x": 1.5, "y": 2, "confidence": 0.5, "status": "tracked"}
TARGET = {"target": "face", "particles": 100, "parts": [PART, {"part": "chin", "x": None, "y": None}]}


def write(folder: Path, *targets: Any, **frame: Any) -> Path:
    frames = [{"frame": i, "time_s": i / 25, "targets": [TARGET, *targets], **frame} for i in range(3)]
    path = folder / "one.json"
    path.write_text(json.dumps({"schema": SCHEMA, "frames": frames}))
    return path


def test_json_gives_columns(tmp_path: Path) -> None:
    table = read_trajectory(write(tmp_path, {"target": "other", "parts": [PART]}))
    assert [s.name for s in table.parts] == ["face/nose", "face/chin", "other/nose"]
    nose, chin, other = table.parts
    assert nose.frame.tolist() == [0, 1, 2]
    assert nose.time_s.tolist() == [0, 0.04, 0.08]
    assert (nose.x[1], nose.y[1], nose.confidence[1], nose.status[1], nose.particles[1]) == (
        1.5,
        2,
        0.5,
        "tracked",
        100,
    )
    assert np.isnan(chin.x).all() and np.isnan(chin.ess).all() and (chin.status == "").all()
    assert np.isnan(other.particles).all()


@pytest.mark.parametrize(
    ("target", "frame", "why"),
    [
        ({"target": "other", "parts": [{**PART, "x": "1"}]}, {}, "record 0 of frames .*: x '1' is no number"),
        ({"target": "other", "parts": [{**PART, "x": True}]}, {}, "x True is no number"),
        ({"target": "other", "parts": [{**PART, "x": 10**400}]}, {}, "record 0 of frames .*: x 10{59} is no number"),
        ({"target": "other", "parts": [{**PART, "mine": 1}]}, {}, "unknown key 'mine'"),
        ({"target": "other", "parts": [{**PART, "particles": 50}]}, {}, "unknown key 'particles'"),
        ({"target": "other", "parts": [{**PART, "identity": "me"}]}, {}, "unknown key 'identity'"),
        ({"target": "other", "parts": [{**PART, "time_s": 9}]}, {}, "unknown key 'time_s'"),
        ({"target": "other", "parts": [{**PART, "status": None}]}, {}, "status None is no name"),
        ({"target": "other", "parts": [{**PART, "by_hand": 1}]}, {}, "by_hand 1 is neither true nor false"),
        ({"target": "other", "particles": "9", "parts": [PART]}, {}, "particles '9' is no number"),
        ({"target": "other", "parts": [{**PART, "x": float("inf")}]}, {}, "frame 0, other/nose: x inf is no finite"),
        ({"target": "other", "parts": [{**PART, "y": -1e7}]}, {}, "frame 0, other/nose: y -10000000 is farther out"),
        ({"target": "other", "parts": [{**PART, "w": -1}]}, {}, "frame 0, other/nose: w -1 is negative; correct it"),
        ({"target": "other", "parts": [{**PART, "part": ["a"]}]}, {}, r"part \['a'\] is no name"),
        ({"target": "other", "parts": [{**PART, "part": ""}]}, {}, "part '' is no name"),
        ({"target": None, "parts": [PART]}, {}, "target None is no name"),
        ({"target": "other", "parts": [{**PART, "status": 5}]}, {}, "status 5 is no name"),
        ({"target": "other", "parts": [{"x": 1, "y": 2}]}, {}, "'part'"),
        ({"target": "other", "parts": "nose"}, {}, "is not as facetrack writes it"),
        ({"target": "other"}, {}, "'parts'"),
        (TARGET, {}, "frame 0 has two rows of face/nose"),
        ({"target": "other", "parts": []}, {"frame": -1}, "frame -1 is no whole number"),
        ({"target": "other", "parts": []}, {"frame": 1.0}, "frame 1.0 is no whole number"),
        ({"target": "other", "parts": []}, {"frame": True}, "frame True is no whole number"),
        ({"target": "other", "parts": []}, {"frame": 10**30}, "is no whole number"),
        ({"target": "other", "parts": []}, {"targets": []}, "has a header and no rows"),
    ],
)
def test_what_is_wrong_with_json_is_said_in_one_line(
    tmp_path: Path, target: Any, frame: dict[str, Any], why: str
) -> None:
    with pytest.raises(InputError, match=rf"one\.json: .*{why}") as caught:
        read_trajectory(write(tmp_path, target, **frame))
    assert "\n" not in str(caught.value)


def test_what_a_target_says_is_said_of_each_part(tmp_path: Path) -> None:
    more = {"particles": 50, "identity": "me", "identity_prob": 0.5, "time_s": 9, "mine": [1]}
    table = read_trajectory(write(tmp_path, {"target": "other", "parts": [PART, {**PART, "part": "chin"}], **more}))
    for part in table.of_target("other"):
        assert part.particles.tolist() == [50] * 3 and part.identity.tolist() == ["me"] * 3
        assert part.identity_prob.tolist() == [0.5] * 3
        assert part.time_s.tolist() == [0, 0.04, 0.08], "the time is the frame's"
    assert not (table.parts[0].identity != "").any()


def test_a_target_without_parts_has_no_rows(tmp_path: Path) -> None:
    table = read_trajectory(write(tmp_path, {"target": "other", "parts": []}))
    assert table.targets == ("face",) and len(table) == 6


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_the_ending_of_json_lines_is_part_of_the_header(tmp_path: Path, end: str) -> None:
    frames = [{"type": "frame", "frame": i, "time_s": 0, "targets": [TARGET]} for i in range(3)]
    head = {"type": "header", "schema": SCHEMA, "version": 1, "seed": 3}
    path = tmp_path / "whole.jsonl"
    records = [head, *frames, {"type": "footer", "complete": False, "stopped": "interrupted"}]
    path.write_text(end.join(json.dumps(record) for record in records), newline="")
    header = read_trajectory(path).header
    assert header == head | {"complete": False, "stopped": "interrupted"}
    path.write_text(end.join(json.dumps(record) for record in records[:-1]), newline="")
    assert read_trajectory(path).header == head


def test_a_run_that_was_killed_says_how_to_read_it(tmp_path: Path) -> None:
    frames = [{"type": "frame", "frame": i, "time_s": 0, "targets": [TARGET]} for i in range(3)]
    lines = [json.dumps(record) for record in ({"type": "header", "schema": SCHEMA, "version": 1}, *frames)]
    path = tmp_path / "cut.jsonl"
    path.write_text("\n".join(lines)[:-9])
    with pytest.raises(
        InputError, match=r"cut\.jsonl:4: is not JSON: is no whole record; remove this line: .*cut short"
    ):
        read_trajectory(path)
    path.write_text("\n".join(lines[:-1]))
    assert read_trajectory(path).frames.tolist() == [0, 1]


def test_files_of_a_newer_facetrack_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "new.json"
    path.write_text(json.dumps({"schema": SCHEMA, "version": 2, "frames": []}))
    with pytest.raises(InputError, match="is of version 2, and this facetrack reads 1; update facetrack"):
        read_trajectory(path)
