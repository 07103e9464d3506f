"""What `lost`, `confidence` and the spread are worth, counted by hand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from facetrack_cli.evaluation.reliability import (
    ELLIPSE_50,
    ELLIPSE_90,
    auroc,
    mahalanobis_squared,
    measure_confidence,
    measure_coverage,
    measure_jitter,
    measure_lost,
    reliability_bins,
)
from tests.evaluation.test_points import rows


def statuses(letters):
    return [{"i": "init", "t": "tracked", "l": "lost", "-": ""}[letter] for letter in letters]


def test_lost_against_the_truth():
    # a unit of 12: near is less than 2 off
    part = rows(
        errors=[0, 0, 0, 9, 9, 9, 9, 0, 9, 0],
        status="vvvhhhvvvv",
        ours=statuses("tltttllltl"),
    )
    found = measure_lost([part])
    assert (found.rows, found.covered, found.called) == (10, 3, 5)
    # lost are rows 1, 5, 6, 7, 9; hidden 3, 4, 5; gone 3, 4, 5, 6, 8
    assert found.precision == 1 / 5 and found.recall == 1 / 3
    assert found.precision_gone == 2 / 5 and found.recall_gone == 2 / 5
    assert found.false_alarms == 3 / 5  # of 0, 1, 2, 7, 9: rows 1, 7, 9
    assert found.tracked_near == 2 / 5  # of 0, 2, 3, 4, 8: rows 0, 2
    assert found.tracked_visible_near == 2 / 3  # of 0, 2, 8
    assert (found.spans, found.spans_called) == (1, 1)
    assert found.delay_lost == 2  # hidden from 3, called in 5
    assert found.delay_back is None  # from 6 on: lost and off, lost and near, tracked and off, lost and near


def test_delays_are_medians_over_the_spans_of_all_parts_in_frames():
    one = rows([0] * 10, "vhhvvvhhvv", ours=statuses("ttltltttll"), frame=np.arange(10) * 2, part="one")
    other = rows([0] * 4, "hvva", ours=statuses("lttl"), part="other")
    found = measure_lost([one, other])
    assert (found.spans, found.spans_called) == (4, 3)
    assert found.delay_lost == 0  # of 2 frames (one row), 0 and 0
    assert found.delay_back == 0  # of 0 and 0; after the second nothing came back


def test_nothing_to_count_is_not_zero():
    found = measure_lost([rows([0, 0], ours=statuses("tt"))])
    assert found.precision is found.precision_gone is found.recall is found.recall_gone is None
    assert found.delay_lost is found.delay_back is None
    assert found.false_alarms == 0.0 and found.tracked_near == 1.0
    assert measure_lost([rows([0, 0], ours="")]) is None
    far = measure_lost([rows([9, 9], ours=statuses("tt"))])
    assert far.false_alarms is None and far.recall_gone == 0.0


def test_a_row_of_unknown_place_counts_by_its_visibility_alone():
    found = measure_lost([rows([0, 0, 9], "vhv", ours=statuses("lll"), unit=math.nan)])
    assert found.precision == 1 / 3 and found.precision_gone == 1.0  # of the one row of which it is known
    assert found.false_alarms is None


def test_the_given_row_is_left_out():
    given_row = {"ours": statuses("itl"), "confidence": [1.0, 0.5, 0.5], "std_x": [0.0, 1, 1], "std_y": [0.0, 1, 1]}
    part, measures = rows([0, 0, 0], **given_row), (measure_lost, measure_confidence, measure_coverage)
    assert [measure([part]).rows for measure in measures] == [2, 2, 2] and measure_coverage([part]).zero_std == 0
    silent = [rows([0, 0, 0], ours="", confidence=[1.0, 0.5, 0.5])]  # without any status
    assert measure_lost(silent) is measure_coverage(silent) is None and measure_confidence(silent).rows == 2


def test_confidence_in_bins():
    errors = [0, 0, 9, 0, 9, 9, 0]
    found = measure_confidence([rows(errors, "vvvhvva", confidence=[1.0, 0.9, 0.95, 0.2, 0.1, 0.0, 0.05])])
    # the absent row is not near, whatever its offset
    assert found.rows == 7 and found.near == 3 / 7
    filled = [(b.low, b.high, b.rows, b.right) for b in found.bins if b.rows]
    assert filled == [(0.0, 0.1, 2, 0.0), (0.1, 0.2, 1, 0.0), (0.2, 0.3, 1, 1.0), (0.9, 1.0, 3, 2 / 3)]
    assert len(found.bins) == 10 and found.bins[5].right is found.bins[5].mean_confidence is None
    gaps = 2 * 0.025 + 1 * 0.1 + 1 * 0.8 + 3 * (0.95 - 2 / 3)
    assert found.ece == pytest.approx(gaps / 7)
    assert found.brier == pytest.approx((0 + 0.1**2 + 0.95**2 + 0.8**2 + 0.1**2 + 0 + 0.05**2) / 7)
    # near: 1.0, 0.9, 0.2; not near: 0.95, 0.1, 0.0, 0.05; two of the twelve pairs are the wrong way
    assert found.auroc_near == pytest.approx((4 + 3 + 3) / 12)
    assert found.auroc_visible == pytest.approx((2 + 2 + 2 + 1 + 0) / 10)


def test_scores_that_are_no_confidence_rank_rows_and_no_more():
    found = measure_confidence([rows([0, 9], confidence=[7.5, -2.0])])
    assert found.auroc_near == 1.0 and found.ece is found.brier is None and found.bins == ()
    assert measure_confidence([rows([0, 9])]) is None
    alike = measure_confidence([rows([0, 0], confidence=[1.0, 0.0])])
    assert alike.auroc_near is alike.auroc_visible is None and alike.near == 1.0


@given(st.lists(st.tuples(st.integers(0, 4), st.booleans()), max_size=25))
def test_auroc_counts_pairs(pairs):
    score, positive = np.array([p[0] for p in pairs], dtype=float), np.array([p[1] for p in pairs], dtype=bool)
    above = [(a > b) + 0.5 * (a == b) for a in score[positive] for b in score[~positive]]
    assert auroc(score, positive) == (pytest.approx(np.mean(above)) if above else None)


@given(arrays.arrays(float, st.integers(1, 40), elements=st.floats(0, 1)))
def test_every_confidence_is_in_the_bin_that_says_so(confidence):
    bins = reliability_bins(confidence, confidence > 0.5, confidence < 0.3)
    for i, one in enumerate(bins):
        inside = (confidence >= one.low) & ((confidence < one.high) | (i == 9))
        assert one.rows == inside.sum()
        assert not one.rows or one.mean_confidence == pytest.approx(confidence[inside].mean())
        assert not one.rows or one.right == pytest.approx((confidence[inside] > 0.5).mean())
        assert not one.rows or one.visible == pytest.approx((confidence[inside] < 0.3).mean())


def test_coverage_of_ellipses():
    # along x alone, in std: the 50 % ellipse reaches 1.1774 and the 90 % one 2.1460
    part = rows([1.17, 1.18, 2.14, 2.15, 0, 5], "vvvvvh", std_x=[1.0] * 6, std_y=[2.0] * 6)
    found = measure_coverage([part])
    assert (found.rows, found.zero_std, found.unknown_std) == (5, 0, 0)
    assert found.within_50 == 2 / 5 and found.within_90 == 4 / 5
    assert found.factor == pytest.approx(1.18 / math.sqrt(ELLIPSE_50))


def test_rows_without_a_spread():
    std = {"std_x": [0.0, 0.0, 1.0, math.nan, 1.0], "std_y": [0.0, 1.0, 0.0, 1.0, 1.0]}
    found = measure_coverage([rows([0, 1, 1, 1, math.nan], **std)])
    # exactly right; no spread where it is off; none where it is not; unknown; no position
    assert (found.rows, found.zero_std, found.unknown_std) == (3, 3, 1)
    assert found.within_50 == found.within_90 == 2 / 3
    assert measure_coverage([rows([0, 1])]) is None
    nowhere = measure_coverage([rows([1], "h", std_x=[1.0], std_y=[1.0])])
    assert nowhere.rows == 0 and nowhere.within_50 is nowhere.factor is None
    assert measure_coverage([rows([1], std_x=[0.0], std_y=[1.0])]).factor is None


def test_the_ellipses_hold_what_they_are_named_for():
    std = np.array([0.5, 3.0])
    offset = np.random.default_rng(0).normal(size=(40_000, 2)) * std
    squared = mahalanobis_squared(offset, np.broadcast_to(std, offset.shape))
    assert np.mean(squared <= ELLIPSE_50) == pytest.approx(0.5, abs=0.01)
    assert np.mean(squared <= ELLIPSE_90) == pytest.approx(0.9, abs=0.006)


def test_the_ellipses_lie_along_the_covariance():
    rng = np.random.default_rng(0)
    cov = np.array([[4.0, 2.5], [2.5, 2.0]])
    offset = rng.multivariate_normal(np.zeros(2), cov, 40_000)
    std = np.broadcast_to(np.sqrt(np.diag(cov)), offset.shape)
    squared = mahalanobis_squared(offset, std, np.full(len(offset), 2.5))
    np.testing.assert_allclose(squared, np.einsum("ni,ij,nj->n", offset, np.linalg.inv(cov), offset), rtol=1e-9)
    assert np.mean(squared <= ELLIPSE_90) == pytest.approx(0.9, abs=0.006)


def test_a_tiny_spread_is_infinitely_far_and_no_warning():
    assert mahalanobis_squared(np.array([[1.0, 0.0]]), np.array([[1e-320, 1.0]])).tolist() == [math.inf]


def test_jitter_is_the_deviation_of_noise_and_nothing_of_an_even_motion():
    rng = np.random.default_rng(0)
    noise = measure_jitter([rows(rng.normal(0, 2, 20_000))])  # along x alone
    assert noise.rows == 19_998 and noise.truth_px == 0
    assert noise.median_px == pytest.approx(2 * 0.6745, rel=0.03)  # the median of a normal deviate
    assert measure_jitter([rows(np.arange(9.0))]).median_px == pytest.approx(0)


def test_jitter_needs_three_visible_rows_in_a_row():
    found = measure_jitter([rows([0, 6, 0, 1, 9, 9], "vvvhvv"), rows([0, 0, 6, 0], part="b", frame=[0, 1, 3, 4])])
    assert found.rows == 1
    assert found.median_px == pytest.approx(12 / math.sqrt(6))
    assert measure_jitter([rows([0, 1])]) is None
