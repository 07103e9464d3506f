"""The box measures: against their plain twins, their own laws, and a case worked out by hand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.geometry import centre, iou, square
from facetrack_cli.evaluation.boxes import measure_boxes, share_above, share_up_to, vot_overlaps, within
from tests.twins import boxes as naive_boxes

NAN = [np.nan] * 4
SHARES = ("success_auc", "precision_20", "normalised_auc", "ao", "sr50", "vot_accuracy", "good_rate", "strict_rate")
place = st.floats(-50, 150).map(lambda v: round(v, 2))
side = st.floats(0.1, 90).map(lambda v: round(v, 2))
box = st.tuples(place, place, side, side)
pairs = st.lists(st.tuples(box, box), min_size=1, max_size=8)
whole_box = st.tuples(*[st.integers(-4, 12)] * 2, *[st.integers(0, 9)] * 2)
quad = st.lists(st.tuples(*[st.integers(-8, 24).map(lambda v: v / 2)] * 2), min_size=4, max_size=4)


def arrays(rows):
    a, b = np.array(rows, dtype=float).transpose(1, 0, 2)
    return a, b


@given(pairs)
def test_iou_is_its_definition(rows):
    a, b = arrays(rows)
    np.testing.assert_allclose(iou(a, b), [naive_boxes.iou(*row) for row in rows], atol=1e-12)


@given(pairs)
def test_iou_within_a_picture_is_that_of_clipped_boxes(rows):
    a, b = arrays(rows)
    expected = [naive_boxes.iou(*(naive_boxes.clip(one, 100, 60) for one in row)) for row in rows]
    np.testing.assert_allclose(iou(a, b, (100, 60)), expected, atol=1e-12)


@given(pairs, place, place)
def test_iou_is_symmetric_bounded_and_does_not_depend_on_the_place(rows, dx, dy):
    a, b = arrays(rows)
    found = iou(a, b)
    assert np.all((found >= 0) & (found <= 1))
    np.testing.assert_array_equal(found, iou(b, a))
    np.testing.assert_allclose(iou(a, a), 1.0, rtol=1e-12)
    moved = np.array([dx, dy, 0, 0])
    np.testing.assert_allclose(iou(a + moved, b + moved), found, atol=1e-9)


def test_iou_of_empty_turned_and_unknown_boxes():
    full = [0, 0, 10, 10]
    rows = [([3, 3, 0, 0], full), ([3, 3, 0, 5], [3, 3, 0, 5]), ([5, 5, -3, -3], full), ([8, 0, -3, 3], [8, 0, 3, 3])]
    np.testing.assert_array_equal(iou(*arrays(rows)), 0.0)
    assert np.isnan(iou(*arrays([(NAN, full), (full, NAN)]))).all()


def test_a_box_that_sticks_out_on_the_left_is_moved_when_clipped():
    """What GOT-10k does, strange as it is: not cut, as on the right."""
    assert iou(*arrays([([-5, 0, 20, 10], [0, 0, 20, 10])]), (100, 60)) == pytest.approx(1.0)
    assert iou(*arrays([([85, 0, 20, 10], [85, 0, 15, 10])]), (100, 60)) == pytest.approx(1.0)


def test_centre_lies_in_the_box_up_to_its_border():
    truth = np.tile([10.0, 20, 40, 20], (6, 1))
    ours = truth.copy()
    ours[:, 0] += [0, 10, 10.01, 20, 20.01, 0]  # a quarter of 40, and a half
    ours[5, 1] += 10.01
    assert within(ours, truth).tolist() == [True, True, True, True, False, False]
    assert within(ours, truth, 0.25).tolist() == [True, True, False, False, False, False]


@given(st.lists(st.sampled_from([0.0, 0.05, 0.3, 0.5, 1.0, math.inf]), min_size=1, max_size=30))
def test_curves_count_above_or_up_to_each_threshold(values):
    thresholds = np.linspace(0, 1, 21)
    above = [sum(v > t for v in values) / len(values) for t in thresholds]
    np.testing.assert_array_equal(share_above(np.array(values), thresholds), above)
    up_to = [sum(v <= t for v in values) / len(values) for t in thresholds]
    np.testing.assert_array_equal(share_up_to(np.array(values), thresholds), up_to)


def example():
    """Ours, truth, valid: given, exact, 25 px off to the right (IoU 3/13), missing, absent, hidden, half the width."""
    truth = np.tile([10.0, 20, 40, 20], (7, 1))
    ours = truth.copy()
    ours[0, 0] = 12
    ours[2, 0] += 25
    ours[3] = [10, np.nan, 40, 20]
    truth[4] = NAN
    ours[5] = [90, 90, 5, 5]
    ours[6, 2] = 20
    return ours, truth, np.array([True] * 5 + [False, True])


def test_measures_of_an_example_worked_out_by_hand():
    ours, truth, valid = example()
    found = measure_boxes(ours, truth, visible=valid)
    assert (found.rows, found.missing) == (5, 1)
    np.testing.assert_allclose(found.overlap, [1, 1, 3 / 13, 0, np.nan, np.nan, 0.5], rtol=1e-12)
    np.testing.assert_allclose(found.centre_error, [0, 0, 25, np.inf, np.nan, np.nan, 10])
    # strictly above: IoU 1 misses the last threshold, 0.5 the one at 0.5; 3/13 is above 0, .05, .1, .15, .2
    success = [4 / 5] * 5 + [3 / 5] * 5 + [2 / 5] * 10 + [0]
    np.testing.assert_allclose(found.success, success)
    assert found.success_auc == pytest.approx(np.mean(success))
    precision = [2 / 5] * 10 + [3 / 5] * 15 + [4 / 5] * 26
    np.testing.assert_allclose(found.precision, precision)
    assert found.precision_20 == 3 / 5
    # 25 of 40 px is beyond the curve, 10 of 40 is 0.25
    np.testing.assert_allclose(found.normalised_precision, [2 / 5] * 25 + [3 / 5] * 26)
    assert found.normalised_auc == pytest.approx((25 * 2 + 26 * 3) / 5 / 51)
    assert found.normalised_20 == 2 / 5
    assert found.ao == pytest.approx((1 + 3 / 13 + 0 + 0.5) / 4)
    assert (found.sr50, found.sr75) == (1 / 4, 1 / 4)
    assert found.got10k_success[50] == 1 / 4 and found.got10k_success[49] == 2 / 4 and found.got10k_success[-1] == 0
    assert found.vot_accuracy == pytest.approx(found.ao)  # whole pixels
    assert (found.good_rate, found.strict_rate) == (3 / 5, 3 / 5)


def test_without_an_initial_row_the_first_counts_as_any():
    ours, truth, valid = example()
    found = measure_boxes(ours, truth, visible=valid, init=np.zeros(7, bool))
    first = 38 / 42
    assert found.overlap[0] == pytest.approx(first)
    assert found.centre_error[0] == 2
    assert found.ao == found.vot_accuracy == pytest.approx((first + 1 + 3 / 13 + 0 + 0.5) / 5)


def test_hidden_rows_are_measured_apart():
    ours, truth, valid = example()
    found = measure_boxes(ours, truth, visible=valid, hidden=~valid)
    assert (found.hidden_rows, found.hidden_overlap) == (1, pytest.approx(iou(ours, truth)[5]))


@pytest.mark.parametrize("rows", [0, 1, 4])
def test_nothing_to_measure_has_no_value(rows):
    found = measure_boxes(np.ones((rows, 4)), np.full((rows, 4), np.nan), size=(10, 10))
    assert (found.rows, found.missing, found.hidden_rows) == (0, 0, 0)
    for name in SHARES:
        assert getattr(found, name) is None, name
    assert found.success.shape == (21,) and found.got10k_success.shape == (101,)
    assert np.isnan(found.precision).all() and found.overlap.shape == (rows,)


def test_a_tracker_without_any_box_has_zeros():
    truth = np.tile([10.0, 20, 40, 20], (5, 1))
    found = measure_boxes(np.full((5, 4), np.nan), truth, init=np.zeros(5, bool))
    assert (found.rows, found.missing) == (5, 5)
    for name in SHARES:
        assert getattr(found, name) == 0.0, name


sizes = st.none() | st.tuples(st.integers(1, 12), st.integers(1, 12))


@given(st.lists(st.tuples(whole_box, whole_box), min_size=1, max_size=6), sizes)
def test_vot_overlap_of_rectangles_is_that_of_painted_ones(rows, size):
    expected = [naive_boxes.vot_overlap(*row, size) for row in rows]
    np.testing.assert_allclose(vot_overlaps(*arrays(rows), size=size), expected, atol=1e-12)


@given(st.lists(st.tuples(quad, quad, whole_box, st.integers(0, 2)), min_size=1, max_size=5), sizes)
def test_vot_overlap_of_polygons_is_that_of_painted_ones(rows, size):
    regions = [((p, q), (p, b), (b, q))[kind] for p, q, b, kind in rows]
    expected = [naive_boxes.vot_overlap(*pair, size) for pair in regions]
    rectangles = np.array([b for _, _, b, _ in rows], dtype=float)
    corners = np.array([[p, q] for p, q, _, _ in rows], dtype=float)
    kinds = np.array([kind for *_, kind in rows])
    corners[kinds == 1, 1] = np.nan
    corners[kinds == 2, 0] = np.nan
    found = vot_overlaps(rectangles, rectangles, corners[:, 0], corners[:, 1], size)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_vot_overlap_is_on_whole_pixels():
    rows = [([0.5, 0, 4, 4], [0, 0, 4, 4]), ([0.6, 0, 4, 4], [0, 0, 4, 4]), (NAN, [0, 0, 4, 4]), ([0, 0, 4, 4], NAN)]
    np.testing.assert_allclose(vot_overlaps(*arrays(rows)), [1, 12 / 20, 0, np.nan])
    # a polygon covers its border as well: 5 by 5 pixels
    corners = np.array([[[0, 0], [4, 0], [4, 4], [0, 4.0]]])
    assert vot_overlaps(*arrays(rows[:1]), true_corners=corners) == pytest.approx(16 / 25)


def test_accuracy_takes_polygons_where_there_are_some():
    ours, truth, valid = example()
    corners = np.tile([[10, 20], [49, 20], [49, 39], [10, 39.0]], (7, 1, 1))
    same = measure_boxes(ours, truth, visible=valid, true_corners=corners)
    assert same.vot_accuracy == pytest.approx(measure_boxes(ours, truth, visible=valid).vot_accuracy)
    corners[1] += 100
    assert measure_boxes(ours, truth, visible=valid, true_corners=corners).vot_accuracy == same.vot_accuracy - 1 / 4


@pytest.mark.parametrize("side", [1.0, 30.0, 47.5])
def test_a_square_has_its_centre_where_it_is_asked_for(side):
    box = square(np.array([12.25, 7.5]), side)
    assert centre(box) == pytest.approx((12.25, 7.5)) and box[2:] == (side, side)
