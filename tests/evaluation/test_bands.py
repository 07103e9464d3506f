"""Statistics of runs, and the bands in which new runs must lie."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from facetrack_cli.evaluation.goldens import bands
from facetrack_cli.evaluation.goldens.bands import Band, Statistic
from facetrack_cli.trajectory.trajectory import joined, one_part

PARTS = ("nose", "mouth_left")


def run(seed, frames=101, **change):
    """A made-up run: parts wander about a known path; spread, ess and confidence vary about known levels."""
    rng = np.random.default_rng(seed)
    found = []
    t = np.arange(frames)
    for k, part in enumerate(PARTS):
        noise = rng.normal(size=(2, frames)) * change.get("step", 1.0)
        std = np.exp(0.3 * rng.normal(size=(2, frames))) * change.get("std", 1.0)
        status = np.where(rng.random(frames) < change.get("lost", 0.02), "lost", "tracked")
        x = 100 + 20 * np.sin(t / 20) + noise[0] + change.get("x", 0.0)
        if part in change.get("jump", ()):
            x = x + np.where((t >= 60) & (t < 70), 12.0, 0.0)
        found.append(
            one_part(
                "face", part, t, x=x, y=80.0 + 10 * k + noise[1], w=np.full(frames, 25.0), h=np.full(frames, 25.0),
                std_x=std[0], std_y=std[1], ess=np.exp(2 + 0.3 * rng.normal(size=frames)),
                confidence=np.clip(0.8 + 0.1 * rng.normal(size=frames), 0, 1), status=status,
            )
        )  # fmt: skip
    return joined(found, path=Path("made.csv"))


RECORDED = [run(seed) for seed in range(1000, 1040)]
STATISTICS = bands.select_statistics(RECORDED, {})
VALUES = bands.measure(RECORDED, STATISTICS, {})
BANDS = bands.bands_of(STATISTICS, VALUES)


def judged(first, **change):
    tested = [run(seed, **change) for seed in range(first, first + 4)]
    return bands.judge(BANDS, bands.measure(tested, STATISTICS, {}))


def test_statistics_cover_every_frame_but_the_first_once_and_then_the_whole_clip():
    for name in ("x", "step"):
        *spans, whole = [s for s in STATISTICS if (s.quantity, s.series) == (name, "face/nose")]
        assert [f for s in spans for f in range(s.first, s.last + 1)] == list(range(1, 101))
        assert whole[2:] == (1, 100) and Statistic("", name, 1, 100) in STATISTICS
    assert not {"w", "h"} & {s.quantity for s in STATISTICS}, "sizes that never change say nothing"


def test_a_statistic_is_the_mean_of_its_quantity():
    nose, mouth = RECORDED[0].parts
    row = dict(zip(STATISTICS, bands.measure(RECORDED[:1], STATISTICS, {})[0], strict=True))
    assert row[Statistic("face/nose", "x", 1, 25)] == pytest.approx(nose.x[1:26].mean())
    assert row[Statistic("face/nose", "std_y", 26, 50)] == pytest.approx(np.log(nose.std_y[26:51] + 0.05).mean())
    steps = np.hypot(np.diff(nose.x), np.diff(nose.y))
    assert row[Statistic("face/nose", "step", 1, 25)] == pytest.approx(np.log(steps[:25] + 0.05).mean())
    lost = [(part.status[1:] == "lost").mean() for part in (nose, mouth)]
    assert row[Statistic("", "lost", 1, 100)] == pytest.approx(np.mean(lost))


def test_sizes_that_change_are_measured_and_what_is_never_told_is_not():
    t = np.arange(60)
    boxes = [one_part("face", "box", t, x=t + s, y=t, w=20 + t / 10, h=np.full(60, 5.0)) for s in (0.0, 0.1)]
    assert {s.quantity for s in bands.select_statistics(boxes, {})} == {"x", "y", "w", "step", "lost"}


@pytest.mark.parametrize(
    ("change", "quantity"),
    [({"x": -1.5}, "x"), ({"std": 1.3}, "std_x"), ({"step": 0.7}, "step"), ({"lost": 0.2}, "lost")],
)
def test_changes_are_seen_and_named(change, quantity):
    farthest, left = judged(0, **change)
    assert farthest > 1 and quantity in {one.band.quantity for one in left}
    for one in left:
        (low, high), band = one.shown
        assert one.far > 1 and (high < band[0] or low > band[1]), one


def test_a_jump_is_named_with_its_frames_and_part():
    _, left = judged(0, jump=("mouth_left",))
    assert left[0].band.statistic == Statistic("face/mouth_left", "x", 51, 75)
    (low, _), band = left[0].shown
    assert low - sum(band) / 2 == pytest.approx(12 * 10 / 25, abs=1.0)
    assert str(left[0]).startswith("mean x ") and " px, band " in str(left[0])


def test_unseen_seeds_pass():
    assert not any(judged(first)[1] for first in range(0, 80, 4))


def test_a_seed_that_is_lost_does_not_fail_and_a_shift_of_all_does():
    away = VALUES[:4].copy()
    away[0] += 50.0
    assert bands.judge(BANDS, away)[1] == []
    away[1:] += 50.0
    assert bands.judge(BANDS, away)[1]


@pytest.mark.parametrize(
    ("recorded", "tested", "left"),
    [
        ([1, 2, 3], [math.nan] * 2, True),
        ([1, 2, math.nan], [math.nan] * 2, False),
        ([1, 2, 3], [math.nan, 9.0], False),
        ([math.nan] * 3, [1, 2], True),
        ([math.nan] * 3, [math.nan, 2], False),
    ],
)
def test_runs_without_a_value_differ_from_runs_that_all_have_one(recorded, tested, left):
    (band,) = bands.bands_of([Statistic("a", "x", 1, 2)], np.array([recorded], float).T)
    assert bool(bands.judge([band], np.array([tested], float).T)[1]) == left


def test_the_band_is_the_range_widened():
    (band,) = bands.bands_of([Statistic("a", "x", 1, 2)], np.linspace(0, 10, 11)[:, None])
    assert band == Band("a", "x", 1, 2, -0.9, 10.9, 0)


def test_a_tracker_without_chance_has_a_band_for_rounding_alone():
    assert bands.deterministic(VALUES[:1]) and not bands.deterministic(VALUES)
    single = bands.bands_of(STATISTICS, VALUES[:1])
    assert bands.judge(single, VALUES[:1])[1] == []
    off = VALUES[:1].copy()
    off[:, 0] += 1.5
    _, left = bands.judge(single, off)
    assert [one.band.statistic for one in left] == [STATISTICS[0]]
    assert left[0].band.high == pytest.approx(VALUES[0, 0] + 1.0, abs=1e-4)
