"""Measures of faces and hands: examples worked out by hand, laws, spread; events, by a plain enumeration."""

import csv
import io
import math
from dataclasses import replace
from datetime import UTC, datetime
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.face_points import GROUPS, LINES, MESH, POINTS
from facetrack_cli.trajectory.formats.tables import Clip, write_boris, write_csv_wide, write_measures
from facetrack_cli.trajectory.head import SHAPE, head_pose, rotation_of, with_eyes
from facetrack_cli.trajectory.measures import LENGTH, MEASURES, SHARE, Chain, Measured, events_of
from facetrack_cli.trajectory.trajectory import joined, one_part
from tests.support.face_shape import moving_face
from tests.twins import hidden_markov

FIVE = ("nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower")
ENDS = ("", "_std", "_noise")
OF_FIVE = (
    "mouth_opening", "lips_rounded", "mouth_width", "smile", "smile_left", "smile_right", "roll", "yaw", "pitch",
    "thrust", "talking",
)  # fmt: skip


def lines_of(text):
    return list(csv.DictReader(io.StringIO(text)))


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


def test_without_times_there_are_measures_and_no_events():
    table = moving_face(60)
    timeless = replace(table, time_s=np.full(len(table), np.nan))
    ours, theirs = values(timeless), values(table)
    np.testing.assert_array_equal(ours["mouth_opening"], theirs["mouth_opening"])
    assert not timeless.events and timeless._repr_html_()
    project = write_boris([Clip("a", timeless)], datetime(2024, 1, 2, tzinfo=UTC))
    assert '"length":{"a":0.0}' in project


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
        if one.unit not in ("degrees", "probability"):  # tests/trajectory/test_head.py has those
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
    rows = lines_of(write_measures([Clip("", both)]))
    assert [(row["frame"], row["target"]) for row in rows] == [(f, t) for f in "012" for t in ("face", "other")]
    assert list(rows[0])[3:] == [f"{one.name}{end}" for one in MEASURES for end in ENDS]
    assert rows[2]["mouth_opening"] == "0.3500" and rows[2]["time_s"] == "0.0400000"
    assert float(rows[2]["mouth_opening_std"]) == pytest.approx(0.0072, abs=2e-4)
    assert rows[3]["eye_opening"] == "" and rows[3]["mouth_opening"] == "0.2500"
    wide = lines_of(write_csv_wide(both))[0]
    assert wide["face_mouth_opening"] == "0.2500" and "other_eye_opening" not in wide and "other_smile_std" in wide
    with pytest.raises(InputError, match="a measure needs parts of a face"):
        write_measures([Clip("", joined([part for part in one.parts if part.part == "box"]))])


def test_the_noise_is_less_than_the_spread_unless_the_head_moves():
    table = moving_face(200, std=2.0, noise=0.2, open=0.1 * (np.arange(200) > 100))
    one = table.measures["face"]["mouth_opening"]
    assert (one.noise > 0).all() and (one.noise < one.std).all()
    column = [float(line["mouth_opening_noise"]) for line in lines_of(write_measures([Clip("", table)]))]
    np.testing.assert_allclose(column, one.noise, atol=1e-4)
    nearer = moving_face(200, std=2.0, noise=0.2)
    grown = replace(nearer, w=np.where(np.arange(len(nearer)) % 200 >= 140, nearer.w * 1.4, nearer.w))
    grown = grown.measures["face"]["mouth_opening"]
    assert grown.doubt[170] > 2 * one.doubt[170], "the head comes nearer"
    moved = np.sqrt(grown.doubt[170] ** 2 - (0.15 * grown.std[170]) ** 2)
    assert moved == pytest.approx(np.hypot(grown.std[170], 0.2 * grown.value[170])), "so may its unit be off"
    vague = moving_face(20, std=12.0).measures["face"]
    assert "eye_opening" not in vague and "mouth_opening" not in vague and "roll" in vague, "hardly known"


N, SIDE = 60, 100.0  # a face of 100 pixels, at 25 frames/s


def one(target, x, y, side=SIDE, *, lost=()):
    """Rows of a box; places are lost in some frames."""
    frame = np.arange(N)
    x, y = (np.broadcast_to(np.asarray(v, float), N) for v in (x, y))
    status = np.where(np.isin(frame, lost), "lost", "tracked")
    spread = np.full(N, 2.0)
    return one_part(
        target, "box", frame, time_s=frame / 25, x=x, y=y, w=np.full(N, side), h=np.full(N, side), status=status,
        std_x=spread, std_y=spread, particles=np.full(N, 9.0),
    )  # fmt: skip


def table(left, right, **lost):
    """A head at (300, 100), and hands of 40 pixels at x of each frame, 260 down, with the noise of a tracker."""
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 1.0, (2, 2, N))
    pairs = zip(("left_hand", "right_hand"), (left, right), noise, strict=True)
    hands = [one(name, x + off[0], 260 + off[1], 40.0, lost=lost.get(name, ())) for name, x, off in pairs]
    return joined([one("head", 300, 100), *hands])


def way(*stops):
    """The x of each frame, along straight lines between (frame, x)."""
    return np.interp(np.arange(N), *np.array(stops, float).T)


MOVES = way((0, 100), (20, 100), (30, 260), (59, 260))  # 16 pixels a frame are 4 face sizes a second
STAYS = np.full(N, 600.0)


def test_speed_is_in_sizes_of_the_face_and_what_is_held_is_told_from_what_moves():
    found = table(MOVES, STAYS).measures["left_hand"]
    speed, held = found["speed"], found["held"]
    assert (speed.unit, held.unit) == ("face sizes a second", "probability")
    assert speed.value[24:27] == pytest.approx(4, abs=0.5) and (speed.value[np.r_[2:17, 34:58]] < 0.7).all()
    assert (held.value[23:28] < 0.01).all() and (held.value[np.r_[2:17, 34:58]] > 0.8).all()
    np.testing.assert_array_equal(held.value > 0.5, speed.value < 1)
    assert ((speed.value > 1) & (speed.value < 2)).any(), "also of speeds that are nearly holds"
    assert 0.02 < speed.std[0] < 0.5
    still = table(np.full(N, 100.0), STAYS).measures["left_hand"]["speed"].value
    assert np.median(still) < 0.3  # what noise alone makes of a speed is taken off
    gaps = table(MOVES, STAYS, left_hand=range(22, 28), right_hand=range(20, 40)).measures
    assert (gaps["left_hand"]["held"].value[22:28] < 0.05).all(), "a short time lost is bridged"
    assert np.isnan(gaps["right_hand"]["held"].value[20:40]).all(), "a long one is not known"


def test_hands_touch_where_their_boxes_meet_and_the_face_where_one_is_on_it():
    together = table(way((0, 100), (20, 100), (30, 280), (59, 280)), way((0, 600), (20, 600), (30, 310), (59, 310)))
    left, right = (together.measures[name] for name in ("left_hand", "right_hand"))
    assert (left["touches_hand"].value[:24] < 0.01).all() and (left["touches_hand"].value[32:] > 0.7).all()
    np.testing.assert_array_equal(left["touches_hand"].value, right["touches_hand"].value)
    assert (left["touches_face"].value < 0.01).all()  # it is 110 pixels below
    up = joined([one("head", 300, 100), one("left_hand", 310, np.linspace(300, 120, N), 40)])
    face = up.measures["left_hand"]["touches_face"].value
    assert face[0] < 0.01 < 0.99 < face[-1] and "touches_hand" not in up.measures["left_hand"]
    assert up.measures["head"] == {}
    hand, head = one("left_hand", 100, 260, 40.0), one("head", 300, 100)
    for heads in ([], [head, one("other", 500, 100)], [one("head", 300, 100, lost=range(N))]):
        rows = joined([hand, *heads])
        assert all(not found for found in rows.measures.values()) and rows.events == (), "not of one head"


def test_holds_movements_and_contacts_are_intervals_with_probabilities():
    rows = table(MOVES, way((0, 600), (40, 600), (45, 290), (59, 290)))
    mine = [event for event in rows.events if event.target == "left_hand"]
    phases = [(event.value, event.first_frame, event.last_frame) for event in mine if event.tier == "phases"]
    assert [name for name, *_ in phases] == ["hold", "movement", "hold"]
    assert [first for _, first, _ in phases[1:]] == [pytest.approx(20, abs=2), pytest.approx(31, abs=2)]
    assert all(one[2] + 1 == other[1] for one, other in pairwise(phases))
    [contact] = [event for event in mine if event.value == "hand"]
    assert contact.first_frame == pytest.approx(45, abs=1) and contact.last_frame == N - 1
    assert all(0.5 < event.probability <= 1 for event in mine) and contact.begin_s == contact.first_frame / 25
    lines = lines_of(write_measures([Clip("", rows)]))
    assert {line["target"] for line in lines} == {"left_hand", "right_hand"}
    assert float(lines[0]["held"]) > 0.5 and lines[0]["held_std"] == "" != lines[0]["speed_std"]


def test_an_interval_of_a_moment_is_part_of_those_around_it():
    on_off = way((0, 100), (30, 100), (31, 275), (32, 100), (59, 100))
    touching = table(on_off, np.full(N, 300.0))
    assert touching.measures["left_hand"]["touches_hand"].value[31] > 0.8
    assert not [event for event in touching.events if event.value == "hand"]
    quiet = table(np.full(N, 100.0), STAYS).events
    assert [(event.value, event.first_frame, event.last_frame) for event in quiet] == [("hold", 0, N - 1)] * 2


STD = 0.05


def measured(name, value, std=STD, rate=25.0, doubt=None):
    t, value = np.arange(len(value)), np.asarray(value, float)
    std = np.broadcast_to(np.asarray(std, float), len(value))
    doubt = SHARE * std if doubt is None else np.broadcast_to(doubt, len(value))
    return Measured(name, "", t, t / rate, value, std, doubt)


def events(std=STD, rate=25.0, doubt=None, **signals):
    """The events of signals (T,), by time."""
    found = {name: measured(name, value, std, rate, doubt) for name, value in signals.items()}
    return sorted(event for kind in events_of("face", found).values() for event in kind)


def spans(found):
    return [(one.value, one.first_frame, one.last_frame) for one in found]


def bumps(frames, starts, length, height=0.3, rest=0.25):
    value = np.full(frames, rest)
    for start in starts:
        value[start : start + length] += height
    return value


def noise(seed, frames, kept=0.0):
    """Noise of unit variance, of which a share stays from frame to frame."""
    rng = np.random.default_rng(seed)
    value, steps = np.empty(frames), rng.normal(size=frames)
    value[0] = steps[0]
    for t in range(1, frames):
        value[t] = kept * value[t - 1] + math.sqrt(1 - kept**2) * steps[t]
    return value


@pytest.mark.parametrize("states", [2, 3])
def test_posteriors_and_visits_are_those_of_all_paths_together(states):
    rng = np.random.default_rng(states)
    time_s = np.array([0.0, 0.04, 0.08, 0.24, 0.28, 0.32])  # with a pause
    chain = Chain.of(rng.normal(0, 2, (6, states)), time_s, [0.3, 0.1, 0.2][:states])
    assert np.exp(chain.share).sum() == pytest.approx(1) and np.allclose(np.exp(chain.move).sum(axis=2), 1)
    found = hidden_markov.paths(chain.log_p, chain.share, chain.move)
    for t in range(6):
        for state in range(states):
            assert chain.posterior[t, state] == pytest.approx(hidden_markov.posterior(found, t, state))
    for first, stop in ((0, 2), (1, 4), (2, 6), (0, 6)):
        for wanted in ((states - 1,), (0, states - 1), tuple(range(states))):
            assert chain.visits(first, stop, wanted) == pytest.approx(hidden_markov.visits(found, first, stop, wanted))
    # what was sure says nothing of a time long after it
    late = Chain.of(np.array([[-50.0, 0], *[[0, 0]] * 2000]), np.arange(2001) * 0.04, [3.0, 1.0])
    assert late.posterior[1, 1] > 0.9 and late.posterior[-1] == pytest.approx([0.75, 0.25], abs=0.01)


def test_a_mouth_is_open_from_where_it_opens_to_where_it_shuts_or_the_clip_or_a_pause_ends():
    value = bumps(200, (50, 120), 20) + 0.005 * noise(0, 200)
    value[57] += 0.1
    first, second = events(mouth_opening=value)
    assert spans([first, second]) == [("open", 50, 69), ("open", 120, 139)]
    assert (first.tier, first.target) == ("mouth", "face") and min(first.probability, second.probability) > 0.99
    assert (first.begin_s, first.peak_s, first.end_s) == pytest.approx((2.0, 57 / 25, 70 / 25))
    value = bumps(200, (0, 160), 40) + 0.002 * noise(1, 200)
    assert spans(events(mouth_opening=value)) == [("open", 0, 39), ("open", 160, 199)]
    paused = bumps(200, (80,), 40) + 0.002 * noise(1, 200)
    paused[90:100] = np.nan
    found = events(mouth_opening=paused)
    assert [one.value for one in found] == ["open", "open"], "nothing is said of what lies between"
    assert found[0].last_frame < 90 and found[1].first_frame >= 100


def test_frames_beside_lost_ones_and_what_does_not_move_say_nothing():
    value = np.full(200, 0.25)
    value[100:110], value[95:100], value[110:115] = np.nan, 0.6, 0.6
    for still in (value, np.full(50, 0.3), np.linspace(0.3, 0.31, 50), np.full(50, np.nan), np.zeros(4), [0.3]):
        assert [*events(mouth_opening=still), *events(eye_opening=still), *events(yaw=still)] == []


def test_what_the_spread_explains_is_no_event():
    value = bumps(200, (50,), 20, height=0.12) + 0.005 * noise(6, 200)
    assert spans(events(mouth_opening=value)) == [("open", 50, 69)]
    doubtful = np.where((np.arange(200) >= 45) & (np.arange(200) < 75), 0.3, STD)
    assert events(std=doubtful, mouth_opening=value) == [], "a spread that is larger just then"
    assert events(doubt=0.12, mouth_opening=value) == [], "a head that moves"


def test_blinks_are_short_longer_ones_are_shut_eyes_one_eye_winks_and_a_smile_is_held():
    slow = 0.05 * np.sin(np.arange(400) / 60)
    value = np.maximum(0.3 + slow + bumps(400, (50, 130, 300), 4, height=-0.25, rest=0.0) + 0.01 * noise(2, 400), 0.02)
    assert spans(events(eye_opening=value)) == [("blink", 50, 53), ("blink", 130, 133), ("blink", 300, 303)]
    asleep = bumps(400, (100,), 20, height=-0.25, rest=0.3) + 0.01 * noise(3, 400)
    assert spans(events(eye_opening=asleep)) == [("shut", 100, 119)]
    value = bumps(300, (100,), 10, height=0.25, rest=0.0) + bumps(300, (200,), 10, height=-0.25, rest=0.0)
    found = events(std=0.03, eyes_differ=value + 0.01 * noise(3, 300))
    assert [(one.tier, one.first_frame) for one in found] == [("wink_left", 100), ("wink_right", 200)]
    value = bumps(300, (100,), 40, height=0.2, rest=0.8) + bumps(300, (200,), 4, height=0.2, rest=0.0)
    [(name, first, last)] = spans(events(mouth_width=value + 0.01 * noise(3, 300)))
    assert (name, first, last) == ("smile", pytest.approx(100, abs=2), pytest.approx(139, abs=2))


def test_a_nod_goes_down_and_back_and_needs_the_eyes_and_a_shake_turns_both_ways():
    t = np.arange(400)
    pitch = 5.0 + 0.5 * noise(4, 400, 0.8)
    for start in (60, 150):
        pitch += 20 * np.where((t >= start) & (t < start + 12), np.sin(np.pi * (t - start) / 12), 0.0)
    found = events(std=2.0, pitch=pitch, eye_opening=np.full(400, 0.3))
    assert [one.value for one in found] == ["nod", "nod"]
    assert all(abs(one.first_frame - start) <= 4 for one, start in zip(found, (60, 150), strict=True))
    assert events(std=2.0, pitch=pitch) == []
    turn = np.where((t >= 100) & (t < 124), 25 * np.sin(2 * np.pi * (t - 100) / 24), 0.0)
    glance = np.where((t >= 250) & (t < 262), 25 * np.sin(np.pi * (t - 250) / 12), 0.0)
    [shake] = events(std=2.0, yaw=turn + glance + 0.5 * noise(5, 400))
    assert shake.value == "shake" and abs(shake.first_frame - 100) <= 4 and abs(shake.last_frame - 123) <= 4


def test_a_mouth_talks_where_it_swings_quickly():
    t = np.arange(250)
    talks = 0.05 * np.sin(2 * np.pi * t / 8) * ((t >= 75) & (t < 175))
    table = moving_face(250, open=0.1 + talks)
    [speech] = [one for one in table.events if one.tier == "speech"]
    assert speech.value == "talks" and abs(speech.first_frame - 75) < 20 and abs(speech.last_frame - 174) < 20
    yawns = moving_face(250, open=0.4 * ((t >= 75) & (t < 175)))
    assert [one.tier for one in yawns.events] == ["mouth"]


@pytest.mark.parametrize(("frames", "kept", "seeds"), [(100, 0.0, 20), (500, 0.5, 8)])
def test_noise_makes_hardly_an_event(frames, kept, seeds):
    sizes = {"mouth_opening": 0.015, "mouth_width": 0.03, "eye_opening": 0.03, "pitch": 3.0, "yaw": 3.0}
    eyes = {"eye_opening": np.full(frames, 0.3)}
    for name, size in sizes.items():
        values = ({**eyes, name: 0.3 + size * noise(seed, frames, kept)} for seed in range(seeds))
        assert sum(len(events(std=2 * size, **value)) for value in values) <= seeds / 10, name


@pytest.mark.parametrize("low", [-0.6, -1.5])
def test_rows_that_are_far_off_do_not_open_the_mouth_of_all_others(low):
    rng = np.random.default_rng(1)
    value, off = 0.24 + 0.01 * noise(3, 1800), rng.random(1800) < 0.06  # as where something goes by
    value[off] += low * rng.random(off.sum())
    found = spans(events(std=0.02, doubt=0.01, mouth_opening=value))
    assert all(last - first < 10 for _, first, last in found)


def test_each_shot_of_a_film_has_its_own_rest():
    value = np.concatenate([np.full(100, 0.2), bumps(100, (50,), 20, rest=0.5)])
    film, later = measured("mouth_opening", value), np.arange(200) >= 100
    film = film._replace(frame=film.frame + 400 * later, time_s=film.time_s + 16 * later)
    assert spans(events_of("face", {"mouth_opening": film})["mouth"]) == [("open", 550, 569)]
