"""Spans of head motion on tracks whose motion is known."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from facetrack_cli.trajectory.head import KINDS, head_motion
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
    spans = sorted(
        span for of, found in head_motion(parts).items() if of != "still" and kind in (None, of) for span in found
    )
    return [label for *_, label in spans]


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
    moved = head_motion(make(clock(10), noise=1.0))
    assert moved.pop("still") == [(0, 249, "still")] and not any(moved.values())


@MAKE
@pytest.mark.parametrize(
    ("axis", "speed", "label"), [("x", 0.3, "right"), ("x", -0.3, "left"), ("y", 0.3, "down"), ("y", -0.3, "up")]
)
def test_a_slow_pan_has_its_direction(make, axis, speed, label):
    t = clock(8)
    pan = speed * np.clip(t - 3, 0, 2)
    parts = make(t, **{axis: pan}, noise=0.7)
    assert labels(parts) == [label]
    [(first, last, _)] = head_motion(parts)["horizontal" if axis == "x" else "vertical"]
    assert first / 25 == pytest.approx(3, abs=0.25) and last / 25 == pytest.approx(5, abs=0.25)


def test_tilt_turns_as_seen_in_the_picture_and_may_pass_180_degrees():
    t = clock(6)
    turn = np.clip(t - 2, 0, 0.8)
    for rate, label in ((25, "clockwise"), (-25, "counterclockwise")):
        assert labels(points(t, degrees=rate * turn, noise=0.5)) == [label]
    of_box = box(t, angle=(170 + 30 * turn + 180) % 360 - 180)
    assert labels(of_box) == ["clockwise"]
    assert "tilt" in head_motion(of_box) and "tilt" not in head_motion(box(t))


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
    moved = head_motion(points(t, x=rush, lost=gone))
    assert moved.pop("still") == [(0, 99, "still"), (150, 249, "still")] and not any(moved.values())


def test_times_count_not_frames():
    """A clip of half the frames while it pans: the same span in seconds."""
    t = np.concatenate([np.arange(0, 3, 0.04), np.arange(3, 5, 0.08), np.arange(5, 8, 0.04)])
    [(first, last, _)] = head_motion(points(t, x=0.3 * np.clip(t - 3, 0, 2)))["horizontal"]
    assert t[first] == pytest.approx(3, abs=0.25) and t[last] == pytest.approx(5, abs=0.25)


@pytest.mark.parametrize("seed", range(6))
def test_spans_of_a_kind_never_overlap(seed):
    """Wild motion of all sorts, with parts lost at random."""
    rng = np.random.default_rng(seed)
    t = clock(20)
    x, y = np.cumsum(rng.normal(0, 0.04, (2, len(t))), axis=1) + 0.1 * np.sin(rng.uniform(5, 25, (2, 1)) * t)
    lost = {name: rng.random(len(t)) < 0.05 for name in POINTS}
    moved = head_motion(points(t, x=x, y=y, degrees=20 * np.sin(3 * t), scale=np.exp(0.3 * np.sin(2 * t)), lost=lost))
    assert tuple(moved) == KINDS and sum(map(len, moved.values())) > 5
    for spans in moved.values():
        assert all(one[1] < other[0] for one, other in pairwise(spans))
        assert all(0 <= first <= last < len(t) for first, last, _ in spans)


def test_a_single_point_has_neither_tilt_nor_size_nor_speed():
    t = clock(6)
    point = [one_part("face", "nose", np.arange(len(t)), time_s=t, x=200 + 40 * np.clip(t - 2, 0, 1), y=t * 0)]
    # without a size, nobody knows how fast it is
    assert head_motion(point) == {"horizontal": [], "vertical": [], "still": []}


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_few_rows_are_survived(rows):
    t = clock(10)[:rows]
    for parts in (points(t), box(t), [part.take(slice(0, 0)) for part in points(t)]):
        assert not any(head_motion(parts).values())
