"""Statistics of runs, their bands, and the permutation test that decides."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.evaluation.goldens import bands, goldens, permutation_test
from facetrack_cli.evaluation.goldens.bands import Statistic
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
STATISTICS = bands.choose(RECORDED)
VALUES = bands.measure(RECORDED, STATISTICS)


def judged(first, count=4, **change):
    tested = [run(seed, **change) for seed in range(first, first + count)]
    return bands.judge(STATISTICS, VALUES, bands.measure(tested, STATISTICS))


def test_statistics_cover_every_frame_but_the_first_once():
    for name in ("x", "step"):
        spans = [s for s in STATISTICS if (s.quantity, s.series) == (name, "face/nose")]
        assert [f for s in spans for f in range(s.first, s.last + 1)] == list(range(1, 101))
    assert Statistic("x", "face/nose", 1, 25) in STATISTICS and Statistic("std_x", "face/nose", 1, 25) in STATISTICS
    assert not {"w", "h"} & {s.quantity for s in STATISTICS}, "sizes that never change say nothing"


def test_a_statistic_is_the_mean_in_its_unit():
    table = RECORDED[0]
    nose = table.parts[0]
    row = dict(zip(STATISTICS, bands.measure([table], STATISTICS)[0], strict=True))
    assert row[Statistic("x", "face/nose", 1, 25)] == round(nose.x[1:26].mean() / 0.05)
    assert row[Statistic("std_y", "face/nose", 26, 50)] == round(np.log(nose.std_y[26:51] + 0.05).mean() / 0.01)
    steps = np.hypot(np.diff(nose.x), np.diff(nose.y))
    assert row[Statistic("step", "face/nose", 1, 25)] == round(np.log(steps[:25] + 0.05).mean() / 0.01)
    assert row[Statistic("lost", "face/nose", 76, 100)] == round((nose.status[76:] == "lost").mean() / 0.005)


def test_sizes_that_change_are_measured_and_what_is_never_told_is_not():
    t = np.arange(60)
    boxes = [one_part("face", "box", t, x=t + s, y=t, w=20 + t / 10, h=np.full(60, 5.0)) for s in (0.0, 0.1)]
    assert {s.quantity for s in bands.choose(boxes)} == {"x", "y", "w", "step", "lost"}


@pytest.mark.parametrize(
    ("change", "quantity"),
    [({"x": -1.0}, "x"), ({"std": 1.3}, "std_x"), ({"step": 0.7}, "step"), ({"lost": 0.4}, "lost")],
)
def test_changes_are_seen_and_named(change, quantity):
    verdict = judged(0, **change)
    assert not verdict.passed and verdict.closest > 1 and verdict.p < 1e-3
    assert quantity in {d.statistic.quantity for d in verdict.deviations}
    for one in verdict.deviations:
        assert one.far > 1 and (one.together or not one.low <= one.value <= one.high), one


def test_a_jump_is_named_with_its_frames_and_part():
    verdict = judged(0, jump=("mouth_left",))
    worst = verdict.deviations[0]
    assert worst.statistic == Statistic("x", "face/mouth_left", 51, 75)
    assert worst.value - (worst.low + worst.high) / 2 == pytest.approx(12 * 10 / 25, abs=1.0)
    assert str(worst).startswith("mean x ") and " px, band " in str(worst)


def test_unseen_seeds_pass():
    verdicts = [judged(first) for first in range(0, 24, 4)]
    assert all(v.passed and v.closest <= 1 and not v.deviations and v.p > 1e-3 for v in verdicts)


def test_a_lost_run_among_the_tested_passes_when_recorded_ones_were_lost_too():
    def lost(table):
        return replace(table, x=table.x + 150 * (table.frame > 50))

    recorded = [lost(table) if i % 5 == 0 else table for i, table in enumerate(RECORDED)]
    values = bands.measure(recorded, STATISTICS)
    tested = [run(s) for s in range(4)]
    one_lost = bands.measure([lost(tested[0]), *tested[1:]], STATISTICS)
    assert bands.judge(STATISTICS, values, one_lost).passed
    shifted = bands.measure([lost(run(0, x=-1.0)), *(run(s, x=-1.0) for s in range(1, 4))], STATISTICS)
    assert not bands.judge(STATISTICS, values, shifted).passed, "and a shift of the others is seen all the same"


def test_runs_without_a_value_differ_from_those_with():
    missing = bands.measure([run(s) for s in range(4)], STATISTICS)
    missing[:, 3] = math.nan
    assert not bands.judge(STATISTICS, VALUES, missing).passed
    same = VALUES.copy()
    same[:, 3] = math.nan
    assert bands.judge(STATISTICS, same, missing).passed, "as recorded"


def test_a_tracker_without_chance_has_a_band_for_rounding_alone():
    recorded = VALUES[:1]
    assert bands.alike(recorded) and bands.runs_to_test(STATISTICS, recorded) == 1
    assert bands.judge(STATISTICS, recorded, recorded).passed
    off = recorded.copy()
    off[:, 0] += 1.5 / 0.05
    verdict = bands.judge(STATISTICS, recorded, off)
    assert [d.statistic for d in verdict.deviations] == [STATISTICS[0]]
    assert verdict.deviations[0].high == pytest.approx(recorded[0, 0] * 0.05 + 1.0)


def test_more_runs_are_tested_where_seeds_differ_more():
    quiet = np.round(VALUES.mean(axis=0) + (VALUES - VALUES.mean(axis=0)) / 4)
    assert bands.runs_to_test(STATISTICS, quiet) == 4
    noisy = quiet.copy()
    columns = [i for i, s in enumerate(STATISTICS) if s.quantity in ("std_x", "std_y")]
    noisy[:, columns] += np.random.default_rng(0).normal(0, 12, (40, 1))
    assert bands.runs_to_test(STATISTICS, noisy) > 4


# --- the test itself -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("test", ["largest", "joint"])
@pytest.mark.parametrize("tails", ["normal", "cauchy", "lost"])
def test_false_alarms_are_as_rare_as_told(test, tails, monkeypatch):
    """The rank of the tested runs among the picks is uniform, whatever the tails."""
    monkeypatch.setattr(permutation_test, "SPLITS", 400)
    monkeypatch.setattr(permutation_test, "ALPHA", 0.05)
    rng = np.random.default_rng(3)
    picks = permutation_test.picks_of(4, 30)
    failed = 0
    for _ in range(300):
        values = rng.standard_cauchy((34, 12)) if tails == "cauchy" else rng.normal(size=(34, 12))
        if tails == "lost":
            values += 50.0 * (rng.random((34, 1)) < 0.2)
        z = permutation_test.bend(permutation_test.place(values, np.full(12, 0.01)).z)
        found = getattr(permutation_test, test)(z, picks)
        far = found.far.max() if test == "largest" else found.far
        assert (far > 1) == (found.p <= 0.05 + 1e-9)
        failed += far > 1
    assert failed / 300 < 0.05 + 3 * math.sqrt(0.05 * 0.95 / 300)
    assert failed / 300 > 0.01, "nor is it idle"


def test_the_first_pick_is_the_tested_runs_and_each_has_as_many():
    picks = permutation_test.picks_of(4, 40)
    assert picks.shape == (permutation_test.SPLITS, 44) and (picks.sum(axis=1) == 4).all()
    assert picks[0].tolist() == [1.0] * 4 + [0.0] * 40
    np.testing.assert_array_equal(picks, permutation_test.picks_of(4, 40))


@given(st.floats(-50, 50))
def test_bend_is_undone_and_keeps_order(v):
    bent = float(permutation_test.bend(np.array([v]))[0])
    assert permutation_test.unbend(bent) == pytest.approx(v, rel=1e-6, abs=1e-9)
    assert abs(bent) <= abs(v) and permutation_test.bend(np.array([v + 0.1]))[0] > bent


def test_together_sees_what_each_statistic_hides():
    rng = np.random.default_rng(1)
    both = rng.normal(size=(44, 1)) @ np.ones((1, 2)) + 0.1 * rng.normal(size=(44, 2))
    both[:4, 0] += 0.8
    both[:4, 1] -= 0.8
    picks = permutation_test.picks_of(4, 40)
    assert permutation_test.largest(both, picks).far.max() < 1
    found = permutation_test.joint(both, picks)
    assert found.far > 1 and found.shares == pytest.approx([0.5, 0.5], abs=0.2)


# --- paths ---------------------------------------------------------------------------------------------------------


def test_the_first_frame_off_the_path_is_told():
    recorded = goldens.paths_of(RECORDED)
    assert list(recorded) == ["face/nose", "face/mouth_left"]
    assert goldens.first_leave(recorded, [run(s) for s in range(4)]) is None
    leave = goldens.first_leave(recorded, [run(s, jump=("mouth_left",)) for s in range(4)])
    assert leave is not None and (leave.frame, leave.series) == (60, "face/mouth_left")
    assert leave.distance == pytest.approx(12, abs=3) and 0.5 <= leave.reach < 5
    assert "frame 60" in str(leave)


def test_a_path_where_no_run_has_a_position_is_no_place_to_leave():
    t = np.arange(20)
    gone = [one_part("face", "nose", t, x=np.where(t > 9, math.nan, t), y=t)] * 3
    recorded = goldens.paths_of(gone)
    path = recorded["face/nose"]
    assert path.x[10:] == [None] * 10 and None not in path.x[:10] and np.isfinite(path.reach).all()
    assert goldens.first_leave(recorded, gone) is None
