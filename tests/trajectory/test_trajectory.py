"""The type of all trajectories, and what a tracker reports beside their rows: declared, read back, refused."""

import json
import math
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.trajectory.diagnostics import AFFINE, KNOWN, POSTERIOR, SCALE, Diagnostic, Diagnostics
from facetrack_cli.trajectory.reader import read_trajectory
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
from facetrack_cli.trajectory.views import choose, enclose
from facetrack_cli.trajectory.writers import SCHEMA
from tests.support import results, trajectories
from tests.support.results import result, rows_of
from tests.support.trajectories import known

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
@given(rows=trajectories.trajectories(), data=st.data())
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


# --- diagnostics

REPORTED = {
    "affine": (1.0, 0.123456, -0.0, 1.0, 10.0, 20.12345),
    "scale": 1.25,
    "error": 0.5,
    "noise": 2.0,
    "posterior": {"ben": 0.0625, "anna": 0.93754, "none": -0.0},
    "entropy": 0.23,
}
FOCUS = Diagnostic("focus", "sharpness of the window", "px", least=0, decimals=6)
SPREAD = Diagnostic("spread", "over both axes", shape=(2,), least=-1, most=1, decimals=(1, 2))
VOTES = Diagnostic("votes", shape=None)


def target(reported, name="face", who=None, sure=None):
    box = results.part("box", 3.0, 2.0, 4.0, 4.0, "tracked", 0.5)
    return results.target(name, [box], 77, identity=who, identity_prob=sure, reported=reported)


def test_a_declaration_that_cannot_be_is_refused():
    for wrong in ({"name": ""}, {"shape": (2, 3)}, {"decimals": -1}, {"shape": (3,), "decimals": (1, 2)}):
        with pytest.raises(ValueError, match=r"diagnostic '.*' needs"):
            Diagnostic(**{"name": "focus", **wrong})


def test_values_become_arrays_and_what_is_not_known_nan():
    found = Diagnostics.of(
        (FOCUS, SPREAD, VOTES, SCALE),
        [3, 5, 9],
        [
            {"focus": 2, "votes": {"a": 1.0}},
            {"spread": np.array([0.5, -0.25]), "votes": {"b": 0.5, "a": math.nan}},
            {"focus": np.float32(0.5), "spread": None, "mine": 1},
        ],
    )
    assert found.frame.tolist() == [3, 5, 9] and set(found.values) == {"focus", "spread", "votes"}
    assert found.labels == {"votes": ("a", "b")}
    np.testing.assert_array_equal(found.get("focus"), [2, np.nan, 0.5])
    np.testing.assert_array_equal(found.get("spread"), [[np.nan] * 2, [0.5, -0.25], [np.nan] * 2])
    np.testing.assert_array_equal(found.get("votes"), [[1, np.nan], [np.nan, 0.5], [np.nan] * 2])
    assert np.isnan(found.get("scale")).all() and found.get("scale").shape == (3,)
    assert [found.row(frame) for frame in (2, 3, 5, 9, 10)] == [None, 0, 1, 2, None]
    part = found.between(4, 9)
    assert part.frame.tolist() == [5] and known(part) == {5: {"spread": [0.5, -0.25], "votes": {"b": 0.5}}}
    assert found.between(6, 9).frame.size == 0 and found.between(0, 99).frame.tolist() == [3, 5, 9]
    # what comes first may declare less
    joined = Diagnostics.joined([Diagnostics.of((SCALE,), [1], [{"scale": 2.0}]), found.between(3, 5), part])
    assert joined.frame.tolist() == [1, 3, 5] and known(joined) == {1: {"scale": 2.0}, **known(found.between(3, 6))}
    again = Diagnostics.of(joined.declared, joined.frame.tolist(), joined.records())
    assert known(again) == known(joined) and joined.declared == found.declared, "in the tracker's order"


@pytest.mark.parametrize(
    ("one", "value", "why"),
    [
        (FOCUS, -0.001, "focus -0.001 is not a number from 0 to inf"),
        (FOCUS, math.inf, "focus inf is not a number"),
        (Diagnostic("tilt", least=-5, most=5), -6, "tilt -6 is not a number from -5 to 5"),
        (POSTERIOR, {"anna": 1.01}, "posterior {'anna': 1.01} is not an object of names and numbers from 0 to 1"),
        (POSTERIOR, [1.0], "posterior [1.0] is not an object of names and numbers"),
        (SPREAD, [0.5], "spread [0.5] is not a list of 2 numbers"),
    ],
)
def test_a_value_that_does_not_fit_is_refused_with_its_place(one, value, why):
    with pytest.raises(ValueError, match=re.escape(why)) as caught:
        Diagnostics.of((one,), [3, 4], [{}, {one.name: value}])
    assert caught.value.args[0] == 1


def members(path, found):
    """What stands of the diagnostics in the file of one frame."""
    rows = replace(result(0, [target(None)]).rows, diagnostics={"face": found})
    text = trajectories.write(path, rows).read_text()
    return text[text.index('"particles":77') + 14 : text.index(',"parts":[')]


def test_the_members_of_a_target_stand_after_its_identity_and_what_is_not_known_is_left_out(tmp_path):
    path = tmp_path / "t.json"
    declared = tuple(KNOWN.values())
    assert members(path, Diagnostics.of(declared, [0], [{}])) == ""
    assert members(path, Diagnostics.of(declared, [1], [REPORTED])) == "", "those of another frame"
    odd = {"scale": [math.nan], "noise": [math.inf], "error": [-math.inf], "affine": [(1, 0, 0, math.nan, 1, 1)]}
    odd_values = {name: np.array(values, float) for name, values in odd.items()}
    assert members(path, Diagnostics(declared, np.array([0]), odd_values)) == ""
    some = Diagnostics.of(declared, [0], [{"posterior": {"a": math.nan, 'say "b"': 1.0}}])
    assert members(path, some) == ',"posterior":{"say \\"b\\"":1.0000}'
    assert members(path, target({}).rows.diagnostics["face"]) == ""
    trajectories.write(path, result(0, [target(REPORTED, who="anna", sure=0.93754)]).rows)
    assert (
        '{"target":"face","particles":77,"identity":"anna","identity_prob":0.9375,'
        '"posterior":{"ben":0.0625,"anna":0.9375,"none":0.0000},"entropy":0.2300,"scale":1.2500,"noise":2.0000,'
        '"error":0.5000,"affine":[1.00000,0.12346,0.00000,1.00000,10.000,20.123],"parts":[{"part":"box",'
    ) in path.read_text()


def test_those_that_a_tracker_declares_have_their_decimals_and_stand_after_the_known_ones(tmp_path):
    value = {"focus": 2.5, "spread": (0.25, -0.5), "votes": {"a": 3}, "scale": 1.0, "posterior": {"a": 1.0}}
    order = (VOTES, SPREAD, FOCUS, AFFINE, SCALE, POSTERIOR)
    for declared in (order, (*order[3:], FOCUS, VOTES, SPREAD)):
        assert members(tmp_path / "t.json", Diagnostics.of(declared, [0], [value])) == (
            ',"posterior":{"a":1.0000},"votes":{"a":3.0000},"scale":1.0000,"focus":2.500000,"spread":[0.2,-0.50]'
        )


def test_who_it_is_from_either_file(tmp_path):
    """Anna, of whom it is sure from frame 10 on; and a second target of which nothing is reported."""
    found = []
    for i in range(30):
        p = 0.3 if i < 3 else 0.6 if i < 10 else 0.95
        reported = {**REPORTED, "posterior": {"anna": p, "ben": 1 - p}}
        face = target(reported, who="ben" if i < 3 else "anna", sure=max(p, 1 - p))
        found.append(result(i, [face, target(None, "other")]))
    for form in ("json", "csv"):
        rows = successive([one.rows for one in found])
        table = read_trajectory(trajectories.write(tmp_path / f"t.{form}", rows, {"seed": 3}))
        face, other = table.parts
        assert face.target == "face" and face.identity[[0, 2, 3, 29]].tolist() == ["ben", "ben", "anna", "anna"]
        assert not (other.identity != "").any() and table.beliefs("other")[1] == ()
        assert table.recognised("face", "anna") == 10
        assert table.recognised("face", "ben") is None and table.recognised("face", "carl") is None
        assert table.recognised("face", "ben", level=0.6) == 0 and table.recognised("other", "anna") is None
        frame, names, p = table.beliefs("face")
        assert frame.tolist() == list(range(30)) and p[:, names.index("anna")][-1] == 0.95
        assert set(table.diagnostics) == ({"face"} if form == "json" else set())
        chosen = [set(choose(table, name).diagnostics) for name in ("face/box", "other")]
        assert chosen == [set(table.diagnostics), set()]
    assert np.isnan(p[0, names.index("anna")]), "the CSV knows the probability of the most likely alone"


def file(folder, *targets, **header):
    """A file of frames with one target each, of which this is said."""
    whole = [[{"target": "face", "parts": [{"part": "box", "x": 1, "y": 2}], **one}] for one in targets]
    frames = [{"frame": i, "time_s": i / 25, "targets": one} for i, one in enumerate(whole)]
    path = folder / "one.json"
    path.write_text(json.dumps({"schema": SCHEMA, "frames": frames, **header}))
    return path


@pytest.mark.parametrize(
    ("said", "declared", "why"),
    [
        ({"scale": "1"}, [], "frame 1, face: scale '1' is not a number.*; correct it, or leave it"),
        ({"posterior": {"": 1}}, [], "frame 1, face: posterior {'': 1} is not an object of names and"),
        ({"focus": 1}, 5, "diagnostics is not as facetrack run writes it.*; make the run again"),
        ({"focus": 1}, [{"name": "focus"}, {"name": "b", "shape": 3}], "diagnostics.1.shape is not as"),
        ({"focus": 1}, [{"name": "b", "shape": [2, 3]}], "diagnostics.0.* is not as .*needs a name, and a shape"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path, said, declared, why):
    with pytest.raises(InputError, match=rf"one\.json: {why}") as caught:
        read_trajectory(file(tmp_path, {}, said, diagnostics=declared))
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 1000


def test_a_declaration_of_a_later_version_is_read_and_a_known_name_keeps_its_meaning(tmp_path):
    more = [{"name": "scale", "shape": [2]}, {"name": "focus", "colour": "red"}]
    path = file(tmp_path, {"scale": 1.5, "focus": 2.5}, diagnostics=more)
    found = read_trajectory(path).diagnostics["face"]
    assert found.declared == (SCALE, Diagnostic("focus")) and known(found) == {0: {"scale": 1.5, "focus": 2.5}}
