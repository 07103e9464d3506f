"""The spread over seeds, and where runs part ways."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.evaluation.experiments.repeat import HOLD, Leave, spread_of, spreads, target_size
from facetrack_cli.trajectory.trajectory import joined, one_part


def runs(seeds=10, frames=60, noise=0.5, random=1):
    """(S, T, 2): runs that walk along one line, with independent noise."""
    line = np.stack([np.linspace(50, 110, frames), np.full(frames, 80.0)], axis=1)
    return line + np.random.default_rng(random).normal(0, noise, (seeds, frames, 2))


def spread(positions, limit=10.0, first=100, truth=np.nan):
    frames = np.arange(first, first + positions.shape[1])
    return spread_of("face", "nose", range(len(positions)), frames, positions, limit, truth)


def test_runs_that_stay_together():
    positions = runs()
    one = spread(positions)
    assert one.parting is None and one.leaves == () and not one.away.any()
    assert np.allclose(one.mean, positions.mean(axis=0))
    assert np.allclose(one.std, positions.std(axis=0) * np.sqrt(10 / 9))
    assert one.typical == pytest.approx(np.median(np.sqrt((one.std**2).sum(axis=1))))
    far = np.hypot(*np.moveaxis(positions - np.median(positions, axis=0), 2, 0)).max(axis=0)
    assert np.array_equal(one.from_median, far)


def test_leaving_in_an_example_by_hand():
    """The median is (0, 0), the limit is 10: the seed 2 is 11 away, later 13, by 5 along x and 12 along y."""
    positions = np.zeros((5, 12, 2))
    positions[2, 3:8, 0] = 11  # away in 5 frames, 103 to 107
    positions[2, 10:] = (5, 12)
    positions[1, 1:5, 0] = 50  # away in 4 frames
    positions[0, 6:, 1] = -10  # at the limit
    one = spread(positions)
    assert one.leaves == (Leave(frame=103, seed=2, farthest_px=13.0),) and one.parting == 103
    assert np.flatnonzero(one.away[2]).tolist() == [3, 4, 5, 6, 7, 10, 11]
    assert np.flatnonzero(one.away[1]).tolist() == [1, 2, 3, 4], "an excursion is seen, though it is no parting"
    assert not one.away[[0, 3, 4]].any()
    assert spread(positions[:, : 3 + HOLD - 1]).leaves == (), "it has not been away for long enough"


def test_runs_leave_in_the_order_of_frames():
    positions = runs()
    positions[7, 20:40, 0] += 30  # frames 120 to 139
    positions[3, 50:, 1] -= 25
    positions[9, 20:, 1] += 30
    one = spread(positions)
    assert [(leave.seed, leave.frame) for leave in one.leaves] == [(7, 120), (9, 120), (3, 150)]
    assert [leave.farthest_px for leave in one.leaves] == pytest.approx([30, 30, 25], abs=2.5)
    assert one.parting == 120


def test_each_run_has_its_error_at_the_end():
    positions = runs(6)
    positions[[1, 4], 20:] += (0, 40)
    truth = np.stack([np.linspace(50, 110, 60), np.full(60, 120.0)], axis=1)
    errors = spread(positions, truth=truth).errors
    assert errors[[0, 2, 3, 5]] == pytest.approx(40, abs=1) and errors[[1, 4]].max() < 1.5, "the many may be wrong"
    truth[-HOLD:] = np.nan
    assert np.isnan(spread(positions, truth=truth).errors).all()


def test_identical_runs():
    same = spread(np.repeat(runs(1), 4, axis=0))
    assert same.std.max() == same.from_median.max() == 0 and same.leaves == ()


def test_a_run_without_positions_has_left():
    positions = runs(5)
    positions[2, 30:] = np.nan
    one = spread(positions)
    assert [(leave.seed, leave.frame) for leave in one.leaves] == [(2, 130)]
    assert np.isfinite(one.mean).all() and np.isfinite(one.std).all() and np.isfinite(one.from_median).all()


@given(st.integers(0, 10**6), st.permutations(range(8)), st.floats(-50, 50))
def test_the_order_of_seeds_and_the_place_do_not_matter(random, order, shift):
    positions = runs(8, 40, 1.0, random)
    positions[:3, 20:] += 25
    one, other = spread(positions), spread(positions[list(order)] + shift)
    assert np.array_equal(one.away[list(order)], other.away)
    assert one.parting == other.parting


def table(x, w=None):
    frame = np.arange(x.shape[0])
    box = {} if w is None else {"w": np.full(len(x), w), "h": np.full(len(x), w)}
    parts = [one_part("face", name, frame, x=x + dx, y=x * 0.0, **box) for name, dx in (("nose", 0), ("chin", 40))]
    return joined(parts if w is None else parts[:1], path=Path("run"))


def test_lengths_are_the_targets_own():
    tables = [table(np.zeros(30) + s) for s in range(3)]
    assert target_size(tables, "face") == 40
    assert target_size([table(np.zeros(3), w=25.0)], "face") == 25
    assert target_size([table(np.zeros(3), w=np.nan)], "face") == 1.0
    assert [one.limit for one in spreads([0, 1, 2], tables, 0.25)] == [10, 10]


def test_runs_of_unequal_length_count_as_far_as_all_go():
    tables = [table(np.zeros(30)), table(np.ones(20)), table(np.ones(25))]
    truth = one_part(
        "face", "chin", np.arange(10, 30), x=np.full(20, 40.0), y=np.zeros(20), status=np.full(20, "visible")
    )
    nose, chin = spreads([0, 1, 2], tables, 0.25, truth)
    assert nose.frame.tolist() == list(range(20)) and (nose.target, nose.part) == ("face", "nose")
    assert nose.std[:, 0] == pytest.approx(1 / np.sqrt(3))
    assert np.isnan(nose.errors).all() and chin.errors.tolist() == [0, 1, 1]
