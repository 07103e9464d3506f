"""Measures of a face: examples worked out by hand, their laws, the spread by Monte Carlo, what is lost, the tables."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.face_points import GROUPS, LINES, MESH, POINTS
from facetrack_cli.trajectory.formats.tables import Clip, write_csv_wide, write_measures
from facetrack_cli.trajectory.head import SHAPE, head_pose, rotation_of, with_eyes
from facetrack_cli.trajectory.measures import LENGTH, MEASURES
from facetrack_cli.trajectory.trajectory import joined, one_part
from tests.support.face_shape import moving_face

FIVE = ("nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower")
ENDS = ("", "_std", "_noise")
OF_FIVE = (
    "mouth_opening", "lips_rounded", "mouth_width", "smile", "smile_left", "smile_right", "roll", "yaw", "pitch",
    "thrust", "talking",
)  # fmt: skip


def values(table):
    return {name: one.value for name, one in table.measures["face"].items()}


def test_groups_lines_and_the_mesh_name_the_same_28_points():
    assert len(POINTS) == len(set(POINTS)) == 28
    assert set(POINTS) == set(MESH) and len(set(MESH.values())) == 28
    assert {part for line in LINES for part in line} == set(POINTS) - set(GROUPS["nose"])


def test_a_face_that_is_drawn_by_hand():
    """The points of tests/support/face_shape.py, 100 pixels between the eyes: read off and divided by 100."""
    found = values(moving_face(2, open=[0, 0.3], smile=[0, 0.1], brows=[0, 0.05], shut=[0, 0.5], looks=[0, 0.1]))
    assert list(found) == [one.name for one in MEASURES]
    expected = {
        "mouth_opening": (0.25, 0.55),
        "lips_apart": (0.01, 0.31),
        "lips_pressed": (0.01 - 0.25, 0.31 - 0.55),
        "lips_rounded": (0.25 / 0.8, 0.55 / 0.8),
        "mouth_width": (0.8, 0.8),
        **dict.fromkeys(
            ("smile", "smile_left", "smile_right"),
            (1.125 - 1.1, 1.275 - 1.0),  # the middle of the lips sinks by .15, the corners rise by .1
        ),
        "jaw_sideways": (0, 0),
        "brow_raise": (0.4, 0.45),
        "brow_inner": (0.3, 0.3),
        "brow_outer": (0.25, 0.25),
        **dict.fromkeys(("eye_opening", "eye_opening_left", "eye_opening_right"), (0.15 / 0.5, 0.075 / 0.5)),
        "eyes_differ": (0, 0),
        "gaze_x": (0, 0.1 / 0.5),
        "gaze_y": (0.01 / 0.5, 0.01 / 0.5),
        "roll": (0, 0),
        "thrust": (0, 0),
    }
    for name, wanted in expected.items():
        np.testing.assert_allclose(found[name], wanted, atol=1e-6, err_msg=name)


def test_without_eyes_the_unit_is_that_of_the_box_and_other_measures_are_not_there():
    whole, five = moving_face(3, open=[0, 0.1, 0.2]), moving_face(3, open=[0, 0.1, 0.2], names=FIVE)
    assert list(values(five)) == [*OF_FIVE]
    np.testing.assert_allclose(values(five)["mouth_opening"], values(whole)["mouth_opening"], rtol=1e-6)
    assert {one.unit for one in five.measures["face"].values()} == {LENGTH, "degrees", "ratio", "share", "probability"}
    points = joined([part for part in five.parts if part.part != "box"])
    assert list(values(points)) == ["lips_rounded", "roll", "yaw", "pitch"], "nothing says how large the face is"
    assert not values(joined([part for part in five.parts if part.part == "box"]))


def test_where_a_point_is_lost_or_hidden_its_measures_are_nan():
    table = moving_face(4)
    names = np.array([part for _, part in table.names])[table.which]
    for status in ("lost", "absent", "hidden"):
        gone = np.where((names == "lip_lower") & (table.frame == 2), status, "tracked")
        found = values(replace(table, status=gone))
        lip = {"mouth_opening", "lips_pressed", "lips_rounded", "smile", "smile_left", "smile_right"}
        assert {name for name, value in found.items() if np.isnan(value[2])} == lip
        assert all(np.isfinite(value[[0, 1, 3]]).all() for value in found.values())
    eye = np.where((names == "eye_left_inner") & (table.frame == 2), "lost", "tracked")
    lost = {name for name, value in values(replace(table, status=eye)).items() if np.isnan(value[2])}
    eyes = {"eye_opening", "eye_opening_left", "eyes_differ", "gaze_x", "gaze_y"}
    assert lost == {*eyes, "brow_raise", "brow_inner", "brow_outer"}, "without an eye the box is the unit"


@settings(max_examples=8)
@given(st.floats(-180, 180), st.floats(40, 400), st.floats(-500, 500), st.floats(-500, 500), st.integers(0, 99))
def test_nothing_changes_where_the_frame_is_moved_turned_or_scaled(roll, unit, x, y, seed):
    rng = np.random.default_rng(seed)
    moves = {name: rng.uniform(0.05, 0.3, 3) for name in ("open", "smile", "brows", "shut")}
    upright = moving_face(3, **moves).measures["face"]
    turned = moving_face(3, roll=roll, unit=unit, place=(x, y), std=unit / 200, **moves).measures["face"]
    for name in upright.keys() - {"roll", "yaw", "pitch"}:
        np.testing.assert_allclose(turned[name].value, upright[name].value, rtol=0.02, atol=1e-3, err_msg=name)
        # the least spread of a point that tells the pose is half a pixel
        np.testing.assert_allclose(turned[name].std, upright[name].std, rtol=0.1, err_msg=name)
    apart = turned["roll"].value - roll
    np.testing.assert_allclose((apart + 180) % 360 - 180, 0, atol=5)  # which is Euler's, of a face that is flat


@pytest.mark.parametrize("yaw", [-35, 20])
def test_lengths_stay_where_the_head_turns(yaw):
    """The generic face of head_pose.py, turned; its mouth has depth, so that its measures are not quite the same."""
    spread = {name: np.full(2, 0.5) for name in ("std_x", "std_y")}

    def part(name):
        at = [rotation_of(np.radians([0.0, angle, 0.0])) @ np.array(SHAPE[name]) for angle in (0, yaw)]
        x, y = (300 + 2 * np.array([one[i] for one in at]) for i in (0, 1))
        return one_part("face", name, [0, 1], time_s=[0.0, 0.04], x=x, y=y, **spread)

    found = values(joined([part(name) for name in SHAPE]))
    np.testing.assert_allclose(found["yaw"], (0, yaw), atol=1)
    for name in ("mouth_opening", "mouth_width"):
        assert found[name][1] == pytest.approx(found[name][0], rel=0.03), name


def test_the_spread_is_what_noise_of_the_points_makes():
    table = moving_face(2000, noise=0.8, std=0.8, roll=10.0, open=np.full(2000, 0.3), smile=np.full(2000, 0.05))
    for name, one in table.measures["face"].items():
        if one.unit not in ("degrees", "probability"):  # tests/trajectory/test_head_pose.py has those
            assert np.std(one.value) == pytest.approx(np.median(one.std), rel=0.06), name


def test_the_covariance_and_the_spread_of_the_box_count():
    table = moving_face(1, names=FIVE, std=2.0)
    part = {one.part: one for one in table.parts}
    lip = replace(part["lip_lower"], std_y=np.array([3.0]))
    sized = replace(part["box"], std_w=np.array([10.0]))
    known = joined([lip, sized, *(one for name, one in part.items() if name not in ("lip_lower", "box"))])
    one = known.measures["face"]["mouth_opening"]
    by_box = 0.25 * 10 / (100 / 0.363)  # a share of the opening, as that of the width
    assert one.std[0] == pytest.approx(np.hypot(np.hypot(2, 3) / 100, by_box), rel=1e-4)
    # of a distance along the diagonal, x and y that vary together add
    left = one_part("face", "mouth_left", [0], x=[0.0], y=[0.0], std_x=[1.0], std_y=[1.0], cov_xy=[0.8])
    right = one_part("face", "mouth_right", [0], x=[60.0], y=[60.0], std_x=[0.0], std_y=[0.0])
    box = one_part("face", "box", [0], x=[0.0], y=[0.0], w=[100 / 0.363], h=[100.0])
    wide = joined([left, right, box]).measures["face"]["mouth_width"]
    assert wide.value[0] == pytest.approx(0.6 * np.sqrt(2)) and wide.std[0] == pytest.approx(np.sqrt(1.8) / 100)


def test_the_centre_of_an_eye_is_between_its_corners():
    table = moving_face(2, std=2.0, names=(*GROUPS["eyes"], "nose"))
    found = {part.part: part for part in with_eyes(table.of_target("face"))}
    left = found["eye_left"]
    np.testing.assert_allclose((left.x[0], left.y[0], left.std_x[0]), (270, 200, 2 / np.sqrt(2)))
    tied = [replace(part, cov_xy=np.full(2, 0.8)) for part in table.parts]
    assert with_eyes(tied)[-1].cov_xy.tolist() == [0.4, 0.4]
    assert list(left.status) == ["tracked"] * 2 and len(with_eyes(found.values())) == len(found)
    assert head_pose(moving_face(2).of_target("face")).std[0, 0] < head_pose(moving_face(2, names=FIVE).parts).std[0, 0]


def test_the_tables_have_each_measure_with_its_spread():
    one, two = moving_face(3, open=[0, 0.1, 0.2]), moving_face(3, names=FIVE)
    two = joined([part.renamed("other", part.part) for part in two.parts])
    both = joined([*one.parts, *two.parts])
    rows = list(csv.DictReader(io.StringIO(write_measures([Clip("", both)]))))
    assert [(row["frame"], row["target"]) for row in rows] == [(f, t) for f in "012" for t in ("face", "other")]
    assert list(rows[0])[3:] == [f"{one.name}{end}" for one in MEASURES for end in ENDS]
    assert rows[2]["mouth_opening"] == "0.3500" and rows[2]["time_s"] == "0.0400000"
    assert float(rows[2]["mouth_opening_std"]) == pytest.approx(0.0072, abs=2e-4)
    assert rows[3]["eye_opening"] == "" and rows[3]["mouth_opening"] == "0.2500"
    wide = next(csv.DictReader(io.StringIO(write_csv_wide(both))))
    assert wide["face_mouth_opening"] == "0.2500" and "other_eye_opening" not in wide and "other_smile_std" in wide
    with pytest.raises(InputError, match="a measure needs parts of a face"):
        write_measures([Clip("", joined([part for part in one.parts if part.part == "box"]))])


def test_the_noise_is_less_than_the_spread_unless_the_head_moves():
    t = np.arange(200)
    one = moving_face(200, std=2.0, noise=0.2, open=0.1 * (t > 100)).measures["face"]["mouth_opening"]
    assert (one.noise > 0).all() and (one.noise < one.std).all()
    table = moving_face(200, std=2.0, noise=0.2, open=0.1 * (t > 100))
    column = [
        float(row["mouth_opening_noise"]) for row in csv.DictReader(io.StringIO(write_measures([Clip("", table)])))
    ]
    np.testing.assert_allclose(column, one.noise, atol=1e-4)
    nearer = moving_face(200, std=2.0, noise=0.2)
    grown = replace(nearer, w=np.where(np.arange(len(nearer)) % 200 >= 140, nearer.w * 1.4, nearer.w))
    grown = grown.measures["face"]["mouth_opening"]
    assert grown.doubt[170] > 2 * one.doubt[170], "the head comes nearer"
    moved = np.sqrt(grown.doubt[170] ** 2 - (0.15 * grown.std[170]) ** 2)
    assert moved == pytest.approx(np.hypot(grown.std[170], 0.2 * grown.value[170])), "so may its unit be off"


def test_a_length_that_is_hardly_known_is_absent():
    vague = moving_face(20, std=12.0).measures["face"]
    assert "eye_opening" not in vague and "mouth_opening" not in vague and "roll" in vague
