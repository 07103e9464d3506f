"""Whether hands are held still and what they touch, on made rows whose motion is known."""

import csv
import io
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.trajectory.formats.eaf import write_eaf
from facetrack_cli.trajectory.formats.tables import Clip, write_measures
from facetrack_cli.trajectory.trajectory import joined, one_part

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


def test_a_short_time_lost_is_bridged_and_a_long_one_is_not_known():
    found = table(MOVES, STAYS, left_hand=range(22, 28), right_hand=range(20, 40)).measures
    assert (found["left_hand"]["held"].value[22:28] < 0.05).all()
    assert np.isnan(found["right_hand"]["held"].value[20:40]).all()


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


def test_an_interval_of_a_moment_is_part_of_those_around_it():
    on_off = way((0, 100), (30, 100), (31, 275), (32, 100), (59, 100))
    touching = table(on_off, np.full(N, 300.0))
    assert touching.measures["left_hand"]["touches_hand"].value[31] > 0.8
    assert not [event for event in touching.events if event.value == "hand"]
    quiet = table(np.full(N, 100.0), STAYS).events
    assert [(event.value, event.first_frame, event.last_frame) for event in quiet] == [("hold", 0, N - 1)] * 2


def test_elan_and_tables_have_them():
    rows = table(MOVES, way((0, 600), (40, 600), (45, 290), (59, 290)))
    text = write_eaf(rows, Path("/videos/clip.mp4"), Path("/videos"), written=datetime(2024, 1, 1, tzinfo=UTC))
    for tier in ("phases@left_hand", "hand_contact@right_hand"):
        assert f'TIER_ID="{tier}"' in text
    assert "face_contact@left_hand" not in text, "a tier that would be empty is none"
    assert text.count("VALUE>hold<") == 4 and text.count("VALUE>movement<") == 2 and text.count("VALUE>hand<") == 2
    lines = list(csv.DictReader(io.StringIO(write_measures([Clip("", rows)]))))
    assert {line["target"] for line in lines} == {"left_hand", "right_hand"}
    assert float(lines[0]["held"]) > 0.5 and lines[0]["held_std"] == "" != lines[0]["speed_std"]


def test_hands_without_one_head_have_no_measures():
    hand = one("left_hand", 100, 260, 40.0)
    assert joined([hand]).measures == {"left_hand": {}}
    two = joined([hand, one("head", 300, 100), one("other", 500, 100)])
    assert all(not found for found in two.measures.values())
    lost = joined([hand, one("head", 300, 100, lost=range(N))])
    assert lost.measures["left_hand"] == {} and lost.events == ()
