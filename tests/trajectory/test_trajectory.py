"""The type of all trajectories: its parts, rows and frames, and trajectories put together from others."""

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.trajectory.diagnostics import AFFINE, SCALE, Diagnostics
from facetrack_cli.trajectory.trajectory import (
    COLUMNS,
    FLOATS,
    SEEN,
    TEXTS,
    Collector,
    build,
    joined,
    one_part,
    recorded,
    successive,
)
from facetrack_cli.trajectory.views import enclose
from tests.support import results
from tests.support.results import rows_of
from tests.support.trajectories import known, trajectories

ARRAYS = ("which", "frame", *FLOATS, *TEXTS, "by_hand", "cov_xy", "corners")
NOSE, LIP, HAND = ("face", "nose"), ("face", "lip"), ("hand", "box")


def some():
    """Nose and lip in frames 2, 3 and 5, the lip not in 3; the hand in 3 and 4."""
    return build(
        [NOSE, LIP, HAND],
        [0, 0, 0, 1, 1, 2, 2],
        [2, 3, 5, 2, 5, 3, 4],
        x=[20.0, 30, 50, 21, 51, 32, 42],
        time_s=[0.2, math.nan, 0.5, 0.2, 0.5, 0.3, 0.4],
        status=["init", "tracked", "lost", "init", "absent", "init", "tracked"],
        header={"seed": 3},
        diagnostics={"hand": Diagnostics.of((SCALE,), [3, 4], [{"scale": 1.0}, {"scale": 1.5}])},
        path=Path("run"),
    )


def same(one, other):
    """Asserts that they have the same rows under the same names, and the same diagnostics."""
    assert one.names == other.names
    for name in ARRAYS:
        a, b = getattr(one, name), getattr(other, name)
        assert (a is None) == (b is None), name
        if a is not None:
            np.testing.assert_array_equal(a, b, name)
    assert {name: known(found) for name, found in one.diagnostics.items()} == {
        name: known(found) for name, found in other.diagnostics.items()
    }


# --- building ---


def test_rows_come_in_any_order_and_what_is_not_given_is_not_known():
    rows = build([NOSE, LIP], [1, 0, 1, 0], [7, 9, 3, 4], x=[1, 2, 3, 4], status=["a", "b", "c", "d"], y=None)
    assert (rows.names, rows.which.tolist(), rows.frame.tolist()) == ((NOSE, LIP), [0, 0, 1, 1], [4, 9, 3, 7])
    assert (rows.x.tolist(), rows.status.tolist(), len(rows)) == ([4, 2, 3, 1], ["d", "b", "c", "a"], 4)
    for name in {*FLOATS} - {"x"}:
        assert np.isnan(getattr(rows, name)).all() and getattr(rows, name).dtype == np.float64, name
    assert not rows.by_hand.any() and not (rows.identity != "").any()
    assert rows.corners is None and rows.header == rows.diagnostics == {} and rows.path == Path()
    with pytest.raises(InputError, match=r"t\.csv: frame 4 has two rows of face/lip; keep one row of them"):
        build([NOSE, LIP], [1] * 4, [4, 2, 9, 4], path=Path("t.csv"))


# --- names, parts and rows ---


def test_names_are_those_of_targets_and_parts():
    rows = some()
    assert rows.targets == ("face", "hand")
    assert (rows.target, rows.part, rows.name) == ("face", "nose", "face/nose")
    assert [one.name for one in rows.parts] == ["face/nose", "face/lip", "hand/box"]
    assert [one.name for one in rows.of_target("face")] == ["face/nose", "face/lip"]
    assert rows.of_target("nobody") == () and rows.find("hand", "nose") is None
    lip = rows.find("face", "lip")
    assert lip is not None and lip.frame.tolist() == [2, 5] and lip.which.tolist() == [0, 0]
    assert lip.parts == (lip,) and lip.header == {"seed": 3} and lip.path == Path("run")
    same(lip.renamed("a", "b"), replace(lip, names=(("a", "b"),)))
    assert [len(part) for part in rows.take(rows.which == 1).parts] == [0, 2, 0], "a part without rows is a part"
    some_frames = rows.between(3, 5)
    assert (some_frames.which.tolist(), some_frames.frame.tolist()) == ([0, 2, 2], [3, 3, 4])
    assert known(some_frames.diagnostics["hand"]) == {3: {"scale": 1.0}, 4: {"scale": 1.5}}
    assert known(rows.between(4, 9).diagnostics["hand"]) == {4: {"scale": 1.5}}
    assert (some_frames.names, some_frames.header, some_frames.path) == (rows.names, {"seed": 3}, Path("run"))


@settings(max_examples=10)
@given(rows=trajectories(), data=st.data())
def test_parts_frames_and_stretches_hold_every_row_once(rows, data):
    rows = replace(rows, corners=np.arange(8.0 * len(rows)).reshape(-1, 4, 2))
    same(joined(rows.parts, diagnostics=rows.diagnostics), rows)
    frames = rows.frames.tolist()
    assert sum(len(rows.at(frame)) for frame in frames) == len(rows)
    for frame in frames:
        np.testing.assert_array_equal(rows.at(frame).x, rows.x[rows.frame == frame])
    cut = data.draw(st.sampled_from([*frames, frames[-1] + 1]))
    pieces = [rows.between(0, cut), rows.between(cut, frames[-1] + 1)]
    same(successive(pieces, like=rows), rows)
    log = Collector()
    for frame in frames:
        log.add(rows.between(frame, frame + 1))
    same(log.trajectory(), rows)


# --- who it is, geometry, corrections ---


@pytest.mark.parametrize(
    ("status", "by_hand", "expected"),
    [
        ("it", "", "00"),
        ("itit", "", "0010"),
        ("iaat", "", "0100"),
        ("aait", "", "0010"),
        ("vava", "", "0101"),
        ("ttat", "1", "1010"),
        ("taat", "   1", "0101"),
    ],
)
def test_rows_that_corrections_gave(status, by_hand, expected):
    words = {"i": "init", "t": "tracked", "a": "absent", "v": "visible"}
    hand = [char == "1" for char in by_hand.ljust(len(status))]
    one = one_part("face", "nose", range(len(status)), status=[words[char] for char in status], by_hand=hand)
    assert "".join(str(int(flag)) for flag in one.corrected) == expected
    met = replace(one, header={"seams": [{"frame": n} for n in range(len(status))]})
    assert not met.corrected[(one.status == "init") & ~one.by_hand].any(), "chunks of a clip meet there"
    box = replace(one.renamed("hand", "box"), particles=np.full(len(status), 9.0))
    assert not box.corrected[(one.status == "absent") & ~one.by_hand].any(), "the tracker itself calls it absent"


# --- for other libraries ---


def test_a_data_frame_has_the_rows_in_the_order_of_the_file(monkeypatch):
    pandas = pytest.importorskip("pandas")
    columns = some().to_pandas()
    assert tuple(columns) == COLUMNS and pandas.isna(columns.y).all()
    assert columns.frame.tolist() == [2, 2, 3, 3, 4, 5, 5]
    assert columns.target.tolist() == ["face", "face", "face", "hand", "hand", "face", "face"]
    assert columns.part.tolist() == ["nose", "lip", "nose", "box", "box", "nose", "lip"]
    assert columns.x.tolist() == [20, 21, 30, 32, 42, 50, 51] == [row.x for row in rows_of(some())]
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(UsageError, match=r"facetrack\[pandas\]"):
        some().to_pandas()


def test_intervals_are_spans_of_frames_without_a_gap():
    status = ["init", "tracked", "lost", "lost", "tracked", "lost"]
    table = build([("face", "nose")], [0] * 6, [3, 4, 5, 6, 9, 12], status=status)
    assert table.intervals("lost") == {"face/nose": [(5, 7), (12, 13)]}
    assert table.intervals(*SEEN) == {"face/nose": [(3, 5), (9, 10)]}
    assert some().intervals(*SEEN) == {"face/nose": [(2, 4)], "face/lip": [(2, 3)], "hand/box": [(3, 5)]}


# --- put together ---


def test_parts_are_joined_in_their_order_and_one_stays_as_it_is():
    nose, hand = one_part(*NOSE, [1, 2], x=[1, 2]), one_part(*HAND, [2, 3], x=[3, 4], status=["tracked"] * 2)
    whole = joined(
        [hand, nose], path=Path("t.csv"), header={"seed": 1}, diagnostics={"hand": some().diagnostics["hand"]}
    )
    assert whole.names == (HAND, NOSE) and whole.x.tolist() == [3, 4, 1, 2] and whole.which.tolist() == [0, 0, 1, 1]
    assert (whole.path, whole.header, set(whole.diagnostics)) == (Path("t.csv"), {"seed": 1}, {"hand"})
    assert whole.status.tolist() == ["tracked", "tracked", "", ""]
    same(joined([nose], path=Path("t.csv")), nose)
    with pytest.raises(InputError, match="frame 1 has two rows of face/nose"):
        joined([nose, hand, nose])

    square = np.array([[(0, 0), (1, 0), (1, 1), (0, 1)]], float)
    corners = joined([one_part(*NOSE, [1]), one_part(*HAND, [1], corners=square)]).corners
    assert corners is not None and np.isnan(corners[0]).all()
    np.testing.assert_array_equal(corners[1], square[0])


def test_points_without_windows_are_left_out_of_the_box_where_others_have_some():
    places = {"nose": (50.0, 40.0, 11.0), "mouth_left": (40.0, 60.0, 11.0), "eye": (10.0, 10.0, None)}
    nose, mouth, eye = (
        one_part("face", name, [3], x=[x], y=[y], w=side and [side], h=side and [side])
        for name, (x, y, side) in places.items()
    )
    assert nose.boxes.tolist() == [[45, 35, 11, 11]], "its centre is between the first and the last pixel"
    assert enclose([nose, eye, mouth]).boxes.tolist() == enclose([nose, mouth]).boxes.tolist()
    assert enclose([nose, eye], "points").boxes.tolist() != enclose([nose], "points").boxes.tolist()


def frame(index):
    """A face, of which more is reported from frame 3 on, and a hand in every second frame."""
    reported = {"scale": 1.0 + index} | ({"noise": 0.5, "posterior": {f"p{index}": 1.0}} if index > 2 else {})
    face = results.target("face", [results.part("nose", index, 1), results.part("lip", index, 2)], reported=reported)
    hand = results.target("hand", [results.part("box", index, 3)], reported={"scale": 9.0})
    return results.result(index, [face, hand] if index % 2 else [face]).rows


@pytest.mark.parametrize("count", [1, 501])
def test_a_collector_gives_what_it_was_given(count):
    log = Collector()
    for index in range(1, count + 1):
        log.add(frame(index))
    rows = log.trajectory(header={"seed": 3}, path=Path("clip"))
    assert rows.header == {"seed": 3} and rows.path == Path("clip") and rows.names == (NOSE, LIP, HAND)
    every = np.arange(1, count + 1)
    for part in rows.of_target("face"):
        assert part.frame.tolist() == part.x.tolist() == every.tolist()
    assert rows.of_target("hand")[0].frame.tolist() == every[::2].tolist()
    face = rows.diagnostics["face"]
    assert face.frame.tolist() == every.tolist() and face.get("scale").tolist() == (every + 1.0).tolist()
    assert np.isnan(face.get("noise")[:2]).all() and (face.get("noise")[2:] == 0.5).all()
    assert face.labels.get("posterior", ()) == tuple(f"p{index}" for index in range(3, count + 1))
    same(log.trajectory(), rows)
    log.add(frame(count + 1))
    assert log.trajectory().frames.tolist() == [*every.tolist(), count + 1], "and it may go on"


def test_what_was_recorded_is_said_of_each_target_of_a_frame():
    turned = (0.0, -1.0, 1.0, 0.0, 30.0, 40.0)  # a quarter turn
    declared = (SCALE, AFFINE)
    values = [{"scale": 1.0 + at, "affine": turned} for at in range(2)]
    rows = joined(
        [one_part(*NOSE, [2], x=[1], y=[1]), one_part(*LIP, [2, 3], x=[2, 2], y=[2, 2]),
         one_part(*HAND, [2, 3, 4], x=[30.0] * 3, y=[40.0] * 3, w=[20.0] * 3, h=[10.0] * 3)],
        diagnostics={"hand": Diagnostics.of(declared, [2, 3], values)},
    )  # fmt: skip
    face, hand = recorded(2, rows.at(2))
    assert face.rows.names == (NOSE, LIP) and face.rows.corners is None and face.rows.diagnostics == {}
    assert face.cloud.shape == (0, 2, 2) and face.notes == ()
    np.testing.assert_allclose(hand.rows.corners, [[(35, 30), (35, 50), (25, 50), (25, 30)]], atol=1e-9)
    face, hand = recorded(3, rows.at(3))
    assert face.rows.names == (LIP,) and known(hand.rows.diagnostics["hand"]) == {
        3: {"scale": 2.0, "affine": list(turned)}
    }, "what is reported of this frame alone"
    (hand,) = recorded(4, rows.at(4))
    assert hand.rows.diagnostics == {} and hand.rows.corners is None
    assert recorded(9, rows.at(9)) == ()
