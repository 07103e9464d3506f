"""Reading trajectories as arrays: whole columns at once give what row by row gives, and the same errors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.trajectory import table as module
from facetrack_cli.trajectory.table import Series, Table, read_trajectory
from facetrack_cli.trajectory.writers import COLUMNS, SCHEMA

NAMES = [name for name in Series.__dataclass_fields__ if name != "corners"]


def outcome(path: Path, monkeypatch: pytest.MonkeyPatch, quick: bool) -> Table | str:
    """The table of a file, or what is wrong with it, by columns or row by row."""
    with monkeypatch.context() as patch:
        if not quick:
            patch.setattr(module, "_csv_columns", lambda _: None)
            patch.setattr(module, "_json_columns", lambda _: None)
        try:
            return read_trajectory(path)
        except InputError as e:
            return str(e)


def assert_same(one: Table | str, other: Table | str) -> None:
    if isinstance(one, str) or isinstance(other, str):
        assert one == other
        return
    assert [s.name for s in one.series] == [s.name for s in other.series]
    for a, b in zip(one.series, other.series, strict=True):
        for name in NAMES:
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name), name)


CELLS: dict[str, st.SearchStrategy[str]] = {
    "frame": st.integers(0, 40).map(str),
    "target": st.sampled_from(["face", " face", "other"]),
    "part": st.sampled_from(["nose", "a, b"]),
    "status": st.sampled_from(["", "tracked", " lost "]),
    "particles": st.sampled_from(["", "100"]),
    "identity": st.just(""),
}
NUMBER = st.sampled_from(["", "1.5", "-2", "1e3"])
STRANGE = st.sampled_from(["", " ", "nan", "inf", "two", "1_0", " 3 ", "-1", "1.0", "9" * 19, "٣"])


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(data=st.data())
def test_csv_by_columns_is_csv_by_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, data: st.DataObject) -> None:
    columns = data.draw(st.permutations(COLUMNS))
    columns = [c for c in columns if c in ("frame", "target", "part", "x", "y") or data.draw(st.booleans())]
    rows = [[data.draw(CELLS.get(c, NUMBER)) for c in columns] for _ in range(data.draw(st.integers(0, 5)))]
    if rows and data.draw(st.booleans()):
        data.draw(st.sampled_from(rows))[data.draw(st.integers(0, len(columns) - 1))] = data.draw(STRANGE)
    lines = [",".join(f'"{cell}"' if "," in cell else cell for cell in row) for row in [columns, *rows]]
    path = tmp_path / "one.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    monkeypatch.setattr(module, "_BLOCK", 2)
    assert_same(outcome(path, monkeypatch, True), outcome(path, monkeypatch, False))


PART = {"part": "nose", "x": 1.5, "y": 2, "confidence": 0.5, "status": "tracked"}
TARGET = {"target": "face", "particles": 100, "parts": [PART, {"part": "chin", "x": None, "y": None}]}


def write(folder: Path, *targets: Any, **frame: Any) -> Path:
    frames = [{"frame": i, "time_s": i / 25, "targets": [TARGET, *targets], **frame} for i in range(3)]
    path = folder / "one.json"
    path.write_text(json.dumps({"schema": SCHEMA, "frames": frames}))
    return path


def test_json_gives_columns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_BLOCK", 2)
    monkeypatch.setattr(module, "_json_rows", None)  # nothing here asks for rows
    table = read_trajectory(write(tmp_path, {"target": "other", "parts": [PART]}))
    assert [s.name for s in table.series] == ["face/nose", "face/chin", "other/nose"]
    nose, chin, other = table.series
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
        ({"target": "other", "parts": [{**PART, "x": 10**400}]}, {}, "too large"),
        ({"target": "other", "parts": [{**PART, "mine": 1}]}, {}, "'mine'"),
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


@pytest.mark.parametrize("extra", [{"particles": 50}, {"identity": "me", "identity_prob": 0.5}, {"time_s": 9}])
def test_json_by_columns_is_json_by_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, extra: dict[str, Any]
) -> None:
    for other in (
        {"target": "other", "parts": [{**PART, **extra}]},
        {"target": "other", "parts": [PART], **extra},
        {"target": "other", "parts": [{**PART, "status": None}]},
        {"target": "other", "parts": []},
    ):
        path = write(tmp_path, other)
        assert_same(outcome(path, monkeypatch, True), outcome(path, monkeypatch, False))


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
