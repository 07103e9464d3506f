"""Spans of head motion on tracks whose motion is known."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from facetrack_cli.trajectory.head import KINDS, head_motion, kinds_of
from facetrack_cli.trajectory.trajectory import one_part

POINTS = {"nose": (0, -30), "mouth_left": (-25, 8), "mouth_right": (25, 8), "lip_upper": (0, 0), "lip_lower": (0, 15)}
SIZE = 100.0  # twice the largest distance, that of the corners of the mouth


def points(time_s, x=0.0, y=0.0, degrees=0.0, scale=1.0, noise=0.0, seed=0, lost=None):
    """Five parts around (200 + x, 150 + y), turned and scaled; x and y in units of the target's size."""
    t = len(time_s)
    rng = np.random.default_rng(seed)
    turn, scale = np.radians(np.broadcast_to(degrees, t)), np.broadcast_to(scale, t)
    x, y = 200 + SIZE * np.broadcast_to(x, t), 150 + SIZE * np.broadcast_to(y, t)
    found = []
    for name, (px, py) in POINTS.items():
        there = np.stack([px * np.cos(turn) - py * np.sin(turn), px * np.sin(turn) + py * np.cos(turn)])
        px_t, py_t = scale * there + [x, y] + noise * rng.normal(size=(2, t))
        status = np.full(t, "tracked", dtype="<U8")
        if lost and name in lost:
            status[lost[name]] = "lost"
        found.append(one_part("face", name, np.arange(t), time_s=time_s, x=px_t, y=py_t, status=status))
    return found


def box(time_s, x=0.0, y=0.0, side=100.0, noise=0.0, seed=0, **columns):
    t = len(time_s)
    nx, ny = noise * np.random.default_rng(seed).normal(size=(2, t))
    side = np.broadcast_to(side, t)
    x, y = 200 + 100 * np.broadcast_to(x, t) + nx, 150 + 100 * np.broadcast_to(y, t) + ny
    return [one_part("face", "box", np.arange(t), time_s=time_s, x=x, y=y, w=side, h=side, **columns)]


def labels(parts, kind=None):
    return [span.label for span in head_motion(parts) if span.label != "still" and kind in (None, span.kind)]


def clock(seconds, fps=25.0):
    return np.arange(round(seconds * fps)) / fps


MAKE = pytest.mark.parametrize("make", [points, box])


@MAKE
@pytest.mark.parametrize(("noise", "seed"), [(0.0, 0), (0.5, 0), (1.5, 1), (4.0, 2)])
def test_noise_alone_gives_nothing(make, noise, seed):
    assert labels(make(clock(60), noise=noise, seed=seed)) == []


def test_noise_that_lasts_over_frames_gives_nothing():
    """Particle noise is not white: half of each frame's error stays for the next one."""
    rng = np.random.default_rng(3)
    x, y = np.zeros((2, 1500))
    for t in range(1, 1500):
        x[t], y[t] = 0.5 * np.array([x[t - 1], y[t - 1]]) + 0.012 * rng.normal(size=2)
    assert labels(box(clock(60), x=x, y=y)) == []


@MAKE
def test_what_stands_still_is_still_throughout(make):
    (span,) = head_motion(make(clock(10), noise=1.0))
    assert span == ("still", "still", 0, 249)


@MAKE
@pytest.mark.parametrize(
    ("axis", "speed", "label"), [("x", 0.3, "right"), ("x", -0.3, "left"), ("y", 0.3, "down"), ("y", -0.3, "up")]
)
def test_a_slow_pan_has_its_direction(make, axis, speed, label):
    t = clock(8)
    pan = speed * np.clip(t - 3, 0, 2)
    spans = [s for s in head_motion(make(t, **{axis: pan}, noise=0.7)) if s.kind != "still"]
    assert [s.label for s in spans] == [label]
    assert spans[0].first / 25 == pytest.approx(3, abs=0.25) and spans[0].last / 25 == pytest.approx(5, abs=0.25)


def test_tilt_turns_as_seen_in_the_picture_and_may_pass_180_degrees():
    t = clock(6)
    turn = np.clip(t - 2, 0, 0.8)
    for rate, label in ((25, "clockwise"), (-25, "counterclockwise")):
        assert labels(points(t, degrees=rate * turn, noise=0.5)) == [label]
    of_box = box(t, angle=(170 + 30 * turn + 180) % 360 - 180)
    assert labels(of_box) == ["clockwise"]
    assert "tilt" in kinds_of(of_box) and "tilt" not in kinds_of(box(t))


@MAKE
@pytest.mark.parametrize(("rate", "label"), [(0.3, "approach"), (-0.3, "recede")])
def test_size_tells_approach(make, rate, label):
    t = clock(8)
    grown = np.exp(rate * np.clip(t - 3, 0, 1.5))
    parts = make(t, noise=0.3, **({"scale": grown} if make is points else {"side": 100 * grown}))
    assert labels(parts) == [label]


def test_an_open_mouth_alone_is_no_motion():
    t = clock(8)
    parts = points(t, noise=0.3)
    talking = 12 * (np.sin(2 * np.pi * 2.5 * t) > 0)
    assert labels([*parts[:4], replace(parts[4], y=parts[4].y + talking)]) == []


def test_parts_that_get_lost_and_return_make_no_motion():
    t = clock(10)
    away = {"nose": slice(50, 90), "lip_lower": slice(80, 140), "mouth_left": slice(120, 200)}
    assert labels(points(t, degrees=8, noise=0.5, lost=away)) == []


def test_nothing_is_said_of_what_is_lost():
    t = clock(10)
    gone = dict.fromkeys(POINTS, slice(100, 150))
    rush = 2.0 * np.clip(t - 4.4, 0, 1)
    spans = head_motion(points(t, x=rush, lost=gone))
    assert [(s.label, s.first, s.last) for s in spans] == [("still", 0, 99), ("still", 150, 249)]


def test_times_count_not_frames():
    """A clip of half the frames while it pans: the same span in seconds."""
    t = np.concatenate([np.arange(0, 3, 0.04), np.arange(3, 5, 0.08), np.arange(5, 8, 0.04)])
    (span,) = [s for s in head_motion(points(t, x=0.3 * np.clip(t - 3, 0, 2))) if s.kind == "horizontal"]
    assert t[span.first] == pytest.approx(3, abs=0.25) and t[span.last] == pytest.approx(5, abs=0.25)


@pytest.mark.parametrize("seed", range(6))
def test_spans_of_a_kind_never_overlap(seed):
    """Wild motion of all sorts, with parts lost at random."""
    rng = np.random.default_rng(seed)
    t = clock(20)
    x, y = np.cumsum(rng.normal(0, 0.04, (2, len(t))), axis=1) + 0.1 * np.sin(rng.uniform(5, 25, (2, 1)) * t)
    lost = {name: rng.random(len(t)) < 0.05 for name in POINTS}
    spans = head_motion(points(t, x=x, y=y, degrees=20 * np.sin(3 * t), scale=np.exp(0.3 * np.sin(2 * t)), lost=lost))
    assert len(spans) > 5
    for kind in KINDS:
        mine = [span for span in spans if span.kind == kind]
        assert all(one.last < other.first for one, other in pairwise(mine))
        assert all(0 <= one.first <= one.last < len(t) for one in mine)


def test_a_single_point_has_neither_tilt_nor_size_nor_speed():
    t = clock(6)
    point = [one_part("face", "nose", np.arange(len(t)), time_s=t, x=200 + 40 * np.clip(t - 2, 0, 1), y=t * 0)]
    assert kinds_of(point) == ("horizontal", "vertical", "still")
    assert head_motion(point) == []  # without a size, nobody knows how fast it is


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_few_rows_are_survived(rows):
    t = clock(10)[:rows]
    assert head_motion(points(t)) == [] and head_motion(box(t)) == []
    assert head_motion([part.take(slice(0, 0)) for part in points(t)]) == []
