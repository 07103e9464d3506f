"""Calibration: from what is known of a row to the probability that it is right, and which rows that is fitted to."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.evaluation.accuracy import ELLIPSE_90
from facetrack_cli.trajectory.trajectory import joined, one_part
from tests.support.samples import from_tools

fitting = from_tools("calibration_fit")
Sample, figures, fit, pool = fitting.Sample, fitting.figures, fitting.fit, fitting.pool
fit_isotonic, fit_logistic = fitting.fit_isotonic, fitting.fit_logistic


def logistic(z):
    return 1 / (1 + np.exp(-z))


def sample(probability, rows=400, clips=20, random=1):
    """Rows of which one is right with `probability(known)`; features are drawn evenly."""
    rng, n = np.random.default_rng(random), rows * clips
    c = rng.random(n)
    known = {"confidence": c, "log_odds": np.log((c + 0.01) / (1.01 - c)), "spread": rng.uniform(-6, 2, n)}
    known |= {"ess": rng.uniform(-3, 0, n), "lost": (rng.random(n) < 0.2) * 1.0}
    known["size"] = np.random.default_rng(1000 + random).uniform(1, 7, n)
    right = rng.random(n) < probability(known)
    return Sample(known, right, np.ones(n, np.bool_), np.repeat(np.arange(clips), rows), rng.chisquare(2, n))


def naive_pool(y, weight):
    """max over a <= i of min over b >= i of the weighted mean of y[a..b] (Barlow et al., 1972)."""
    n, mean = len(y), lambda a, b: np.average(y[a : b + 1], weights=weight[a : b + 1])
    return np.array([max(min(mean(a, b) for b in range(i, n)) for a in range(i + 1)) for i in range(n)])


@given(st.lists(st.tuples(st.floats(0, 1), st.floats(0.1, 10)), min_size=1, max_size=12))
def test_pool_is_the_twin_and_never_falls(pairs):
    y, weight = np.array(pairs).T
    found = pool(y, weight)
    np.testing.assert_allclose(found, naive_pool(y, weight), atol=1e-12)
    assert np.all(np.diff(found) >= 0)
    assert np.sum(weight * found) == pytest.approx(np.sum(weight * y))
    np.testing.assert_allclose(pool(found, weight), found, atol=1e-12)


def test_logistic_recovers_what_rows_were_drawn_by():
    def probability(known):
        return logistic(-3 + 4 * known["confidence"] - 0.8 * known["spread"])

    whole = sample(probability, rows=2000, clips=100)
    found = fit_logistic(("confidence", "spread"), whole)
    assert found.intercept == pytest.approx(-3, abs=0.15)
    assert found.coefficients == pytest.approx({"confidence": 4, "spread": -0.8}, abs=0.15)


@given(st.integers(0, 10_000), st.integers(1, 6), st.integers(2, 4))
def test_no_map_falls_with_confidence_or_rises_with_spread(random, rows, clips):
    drawn = sample(lambda known: np.full(len(known["ess"]), 0.5), rows, clips, random)
    for name, candidate in fitting.CANDIDATES.items():
        made = candidate(drawn)
        known = {feature: np.full(9, values.mean()) for feature, values in drawn.known.items()}
        for feature, sign in fitting.RISES.items():
            span = drawn.known[feature]
            p = fitting.probability(made, {**known, feature: np.linspace(span.min() - 1, span.max() + 1, 9)})
            assert np.all((p > 0) & (p < 1)), name
            assert not sign or np.all(sign * np.diff(p) >= 0), (name, feature)


def test_clips_weigh_alike_however_long():
    def often(rows, clip, share):
        one = sample(lambda known: np.full(len(known["ess"]), share), rows, 1, clip)
        return Sample(one.known, one.right, one.visible, np.full(rows, clip), one.far)

    both = fitting.joined([often(4000, 0, 0.9), often(400, 1, 0.1)])
    p = fitting.probability(fit_logistic(("confidence",), both), both.known)
    assert np.average(p, weights=both.weight) == pytest.approx(0.5, abs=0.03)


@pytest.mark.parametrize(
    "probability",
    [
        lambda known: logistic(-4 + 7 * known["confidence"] ** 4),
        lambda known: logistic(-4 + 3 * known["confidence"] - 1.5 * known["spread"] - known["lost"]),
    ],
)
def test_the_calibrated_are_nearer_to_the_truth_on_clips_never_seen(probability):
    seen, held = sample(probability, clips=12), sample(probability, clips=12, random=2)
    found = fit(seen)
    raw, after = figures(held, held.known["confidence"]), figures(held, fitting.probability(found.map, held.known))
    assert after.ece < 0.04 < 0.15 < raw.ece and after.brier < raw.brier
    assert found.checked["ece"] < 0.04 and found.checked["ece_raw"] > 0.15
    assert found.losses[found.name] == min(found.losses.values())


def test_each_clip_is_checked_by_the_map_of_the_others():
    whole = sample(lambda known: known["confidence"], rows=60, clips=4)
    p = fitting.left_out(whole, fitting.CANDIDATES["isotonic of confidence"])
    mine = whole.clip == 2
    others = fit_isotonic("confidence", whole.take(~mine))
    np.testing.assert_array_equal(p[mine], fitting.probability(others, whole.take(mine).known))


def test_figures_by_hand():
    known = {name: np.array([0.05, 0.95, 0.95]) for name in fitting.RISES}
    three = Sample(known, np.array([False, True, False]), np.ones(3, np.bool_), np.array([0, 1, 1]), np.ones(3))
    found = figures(three, known["confidence"])  # the first row weighs as much as the other two
    assert found.ece == pytest.approx((0.05 + abs(0.5 - 0.95)) / 2)
    assert found.brier == pytest.approx((0.05**2 + (0.05**2 + 0.95**2) / 2) / 2)
    assert found.log_loss == pytest.approx((-np.log(0.95) + (-np.log(0.95) - np.log(0.05)) / 2) / 2)


def test_the_spread_is_multiplied_by_what_brings_nine_of_ten_rows_into_the_ellipse():
    one = sample(lambda known: 0.7)
    assert one.spread == pytest.approx(1.0, rel=0.03)  # distances are those of a normal
    wide = replace(one, far=one.far * 9.0)
    assert wide.spread == pytest.approx(3.0, rel=0.03)
    assert wide.within(ELLIPSE_90, wide.spread) == pytest.approx(0.9, abs=1e-3)
    # what is wrong or hidden says nothing
    off = replace(one, far=np.where(one.right, one.far, np.inf))
    assert off.spread == one.spread
    assert replace(one, far=np.full(len(one), np.inf)).spread == 20.0
    assert replace(one, right=np.zeros(len(one), np.bool_)).spread == 1.0


def part(name, x, y, **columns):
    """A part at (x, y) in each frame, the first of which was given."""
    n = len(x)
    known = {"confidence": np.full(n, 0.5), "std_x": np.ones(n), "std_y": np.ones(n), "ess": np.full(n, 50.0)}
    known |= {"particles": np.full(n, 100.0), "status": ["init", *["tracked"] * (n - 1)]} | columns
    return one_part("face", name, np.arange(n), x=np.asarray(x, float), y=np.full(n, float(y)), **known)


def face(off, **columns):
    """Two points 40 apart and a box of 60 by 60; all are off by so much in each frame."""
    off, n = np.asarray(off, float), len(off)
    points = [part("left", 30 + off, 50, **columns), part("right", 70 + off, 50, **columns)]
    box = part("box", 50 + off, 40, w=np.full(n, 60.0), h=np.full(n, 60.0), **columns)
    return joined([*points, box])


def true(n, status=None):
    return face(np.zeros(n), status=status or ["visible"] * n)


def test_right_is_less_than_a_quarter_of_the_size():
    found = fitting.collect([([face([0, 9.9, 10.1, 14.9, 15.1])], true(5))])
    assert found["points"].right.tolist() == [True, False, False, False] * 2  # of 40 pixels; the first frame was given
    assert found["box"].right.tolist() == [True, True, True, False]  # of 60


def test_hidden_rows_count_by_their_place_and_absent_ones_are_wrong():
    status = ["visible", "hidden", "hidden", "absent", "lost"]
    found = fitting.collect([([face([0, 0, 20, 0, 0])], true(5, status))])["box"]
    assert found.right.tolist() == [True, False, False] and found.visible.tolist() == [False] * 3
