"""Tables for spreadsheets and data frames, read back by csv, pandas and pyarrow."""

import builtins
import csv
import io
import json

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facetrack_cli.core.errors import UsageError
from facetrack_cli.core.numbers import csv_text
from facetrack_cli.trajectory.formats.keypoints import write_dlc
from facetrack_cli.trajectory.formats.tables import write_parquet, write_wide
from facetrack_cli.trajectory.trajectory import COLUMNS, FLOATS, joined, one_part


def part(target, name, frames, *, seed=0, lost=()):
    rng, t = np.random.default_rng(seed), len(frames)
    return one_part(
        target, name, frames, time_s=np.array(frames) / 25, x=np.round(rng.uniform(0, 640, t), 3),
        y=np.round(rng.uniform(0, 480, t), 3), w=np.full(t, 20.5), h=np.full(t, 10.0), particles=np.full(t, 200.0),
        confidence=np.round(rng.uniform(0, 1, t), 4), status=["lost" if f in lost else "tracked" for f in frames],
    )  # fmt: skip


def read(text):
    return list(csv.DictReader(io.StringIO(text.removeprefix("\ufeff"))))


def test_a_row_a_frame_with_the_parts_side_by_side():
    table = joined([part("face", "nose", [3, 4, 6], lost=[4]), part("head", "box", [4, 5])])
    found = read(write_wide(table))
    assert [row["frame"] for row in found] == ["3", "4", "5", "6"]
    assert list(found[0]) == [
        "frame", "time_s", *(f"face_nose_{c}" for c in ("x", "y", "w", "h", "confidence", "status")),
        *(f"head_{c}" for c in ("x", "y", "w", "h", "confidence", "status")),
    ]  # fmt: skip
    assert [row["face_nose_status"] for row in found] == ["tracked", "lost", "", "tracked"]
    assert found[0]["head_x"] == "" and found[2]["face_nose_x"] == "" and found[1]["time_s"] == "0.1600"


@settings(max_examples=30)
@given(st.integers(1, 4), st.integers(1, 9), st.integers(0, 2**32))
def test_every_number_of_a_wide_table_comes_back(parts, frames, seed):
    made = [part("face", f"p{k}", range(k, k + frames), seed=seed + k) for k in range(parts)]
    found = pd.read_csv(io.StringIO(write_wide(joined(made))), index_col="frame")
    for one in made:
        rows = found.loc[one.frame]
        for name in ("x", "y", "w", "h", "confidence", "status"):
            np.testing.assert_array_equal(rows[f"face_{one.part}_{name}"], getattr(one, name))


def test_no_table_has_a_text_that_a_spreadsheet_takes_for_a_formula():
    names = ["=1+1", "+1+1", "-1+1", "@SUM(A1)", " =1+1", '=HYPERLINK("x","y")']
    for name in names:
        rows = joined([part(name, one, [0, 1]) for one in ("nose", name)])
        for text in (write_wide(rows), write_dlc(rows), write_dlc(rows, scorer=name), csv_text([name], [[name]])):
            cells = [cell for line in csv.reader(io.StringIO(text.removeprefix("\ufeff"))) for cell in line]
            assert f"_{name}" in "".join(cells) and not any(cell.strip()[:1] in {*"=+@"} for cell in cells)
    assert csv_text(["a", "b", "c"], [["-1.5", -2, "-"], ["+1e3", None, "-nan"]]) == "a,b,c\n-1.5,-2,_-\n+1e3,,-nan\n"


def test_spreadsheets_see_other_alphabets_and_no_formulas():
    plain = write_wide(part("face", "nose", [0]))
    assert plain.startswith("frame,")
    text = write_wide(joined([part("Fräulein", "nose", [0]), part("=1+1", "box", [0]), part("a,b", 'c"d', [0])]))
    assert text.startswith("\ufeff")
    assert {"Fräulein_nose_x", "_=1+1_x", 'a,b_c"d_x'} <= set(read(text)[0])


def test_parquet_has_types_nulls_and_the_header():
    pa = pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    from pyarrow import parquet

    table = joined(
        [part("face", "nose", [0, 1, 2]), part("face", "lip", [1])], header={"seed": 3, "source": {"fps": 25}}
    )
    found = parquet.read_table(pa.BufferReader(write_parquet(table)))
    assert found.column_names == list(COLUMNS)
    kinds = {field.name: field.type for field in found.schema}
    assert kinds["frame"] == pa.int64() == kinds["particles"]
    assert all(kinds[name] == pa.float64() for name in FLOATS if name != "particles")
    assert all(kinds[name] == pa.dictionary(pa.int32(), pa.string()) for name in ("target", "part", "status"))
    assert json.loads(found.schema.metadata[b"facetrack"]) == table.header
    rows = found.to_pylist()
    assert [(row["frame"], row["part"]) for row in rows] == [(0, "nose"), (1, "nose"), (1, "lip"), (2, "nose")]
    assert rows[0]["x"] == table.parts[0].x[0] and rows[0]["std_x"] is None and rows[0]["identity"] is None


def test_without_pyarrow_one_line_says_what_to_install(monkeypatch):
    load = builtins.__import__

    def missing(name, *args, **more):
        if name.startswith("pyarrow"):
            raise ImportError(name)
        return load(name, *args, **more)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(UsageError, match=r"Parquet needs pyarrow; install it: pip install 'facetrack\[parquet\]'"):
        write_parquet(part("face", "nose", [0]))
