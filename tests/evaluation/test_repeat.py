"""The spread over seeds, and where runs part ways."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from facetrack_cli.evaluation.experiments.repeat import HOLD, spread_of, spreads, stretches, target_size
from facetrack_cli.trajectory.trajectory import joined, one_part


def runs(seeds=10, frames=60, noise=0.5, random=1):
    """(S, T, 2): runs that walk along one line, with independent noise."""
    line = np.stack([np.linspace(50, 110, frames), np.full(frames, 80.0)], axis=1)
    return line + np.random.default_rng(random).normal(0, noise, (seeds, frames, 2))


def spread(positions, limit=10.0, first=100, truth=None):
    frames = np.arange(first, first + positions.shape[1])
    return spread_of("face", "nose", range(len(positions)), frames, positions, limit, truth)


def test_one_crowd():
    positions = runs()
    one = spread(positions)
    assert one.parting is None and one.leaves == () and not one.away.any()
    assert [group.seeds for group in one.groups] == [tuple(range(10))]
    assert np.allclose(one.mean, positions.mean(axis=0))
    assert np.allclose(one.std, positions.std(axis=0) * np.sqrt(10 / 9))
    assert one.spread.shape == (60,) and not one.identical
    far = np.hypot(*np.moveaxis(positions - np.median(positions, axis=0), 2, 0)).max(axis=0)
    assert np.array_equal(one.from_median, far)


def test_a_run_leaves_and_comes_back():
    positions = runs()
    positions[7, 20:40, 0] += 30  # frames 120 to 139
    positions[3, 50:, 1] -= 25
    positions[5, 10 : 10 + HOLD - 1, 0] += 50  # too short to count
    one = spread(positions)
    assert [(leave.seed, leave.frame, leave.back) for leave in one.leaves] == [(7, 120, 140), (3, 150, None)]
    assert [leave.farthest for leave in one.leaves] == pytest.approx([30, 25], abs=2.5)
    assert one.parting == 120
    assert [group.seeds for group in one.groups] == [(0, 1, 2, 4, 5, 6, 7, 8, 9), (3,)]
    assert one.away[5, 10 : 10 + HOLD - 1].all(), "an excursion is seen, though it is no parting"


@pytest.mark.parametrize("seeds", [10, 11])
def test_two_halves_part_ways(seeds):
    """The median of all lies between two halves; that must not make all runs leave, nor the halves take turns."""
    positions = runs(seeds)
    half = [s for s in range(seeds) if s % 2]
    positions[half, 30:, 1] += np.linspace(0, 60, 30)
    one = spread(positions, limit=10)
    assert {leave.seed for leave in one.leaves} == set(half)
    assert all(leave.back is None for leave in one.leaves)
    # 2 pixels a frame, and 10 pixels from the median are the limit; it is half-way between halves of one size
    assert 134 <= one.parting <= (137 if seeds % 2 else 142)
    assert sorted(group.seeds for group in one.groups) == [tuple(s for s in range(seeds) if not s % 2), tuple(half)]


def test_groups_are_told_with_their_error():
    positions = runs(6)
    positions[[1, 4], 20:] += (0, 40)
    truth = np.stack([np.linspace(50, 110, 60), np.full(60, 120.0)], axis=1)
    large, small = spread(positions, truth=truth).groups
    assert (large.seeds, small.seeds) == ((0, 2, 3, 5), (1, 4))
    assert large.error == pytest.approx(40, abs=1) and small.error < 1.5, "the many may be wrong"
    assert small.y == pytest.approx(120, abs=1)
    truth[-HOLD:] = np.nan
    assert [group.error for group in spread(positions, truth=truth).groups] == [None, None]


def test_identical_and_single_runs():
    same = np.repeat(runs(1), 4, axis=0)
    assert spread(same).identical and spread(same).std.max() == 0
    single = spread(same[:1])
    assert single.identical and single.std.max() == 0 and len(single.groups) == 1


def test_a_run_without_positions_has_left():
    positions = runs(5)
    positions[2, 30:] = np.nan
    one = spread(positions)
    assert [(leave.seed, leave.frame) for leave in one.leaves] == [(2, 130)]
    assert [group.seeds for group in one.groups] == [(0, 1, 3, 4), (2,)]
    assert np.isfinite(one.mean).all() and np.isfinite(one.std).all() and np.isfinite(one.from_median).all()


@given(hnp.arrays(np.bool_, st.integers(1, 60)), st.integers(1, 6))
def test_stretches_are_what_a_state_machine_finds(mask, hold):
    inside, expected = False, []
    for t in range(len(mask)):
        run = mask[t : t + hold]
        if len(run) == hold and (run == (not inside)).all():
            inside = not inside
            if inside:
                expected.append((t, None))
            else:
                expected[-1] = (expected[-1][0], t)
    assert stretches(mask, hold) == expected


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
    truth = one_part("face", "chin", np.arange(10, 30), x=np.full(20, 40.0), y=np.zeros(20))
    nose, chin = spreads([0, 1, 2], tables, truth=[truth])
    assert nose.frame.tolist() == list(range(20)) and nose.name == "face/nose"
    assert nose.std[:, 0] == pytest.approx(1 / np.sqrt(3))
    assert nose.groups[0].error is None and chin.groups[0].error == pytest.approx(2 / 3)
