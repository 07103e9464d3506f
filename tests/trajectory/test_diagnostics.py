"""What a tracker reports beside its rows: declared, written where known, read back, refused with its place."""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from facetrack_cli.core.errors import InputError
from facetrack_cli.trajectory.diagnostics import AFFINE, KNOWN, POSTERIOR, SCALE, Diagnostic, Diagnostics
from facetrack_cli.trajectory.reader import read_trajectory
from facetrack_cli.trajectory.trajectory import successive
from facetrack_cli.trajectory.views import choose
from facetrack_cli.trajectory.writers import SCHEMA
from tests.support import results, trajectories
from tests.support.results import result
from tests.support.trajectories import known

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
