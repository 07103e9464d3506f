"""The box measures: against their plain twins, their own laws, a case worked out by hand, and got10k.

These were recorded to 1e-9, and are asked again if FACETRACK_PEERS says by whom.
"""

import os
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.geometry import iou
from facetrack_cli.evaluation.accuracy import (
    centre_errors,
    measure_boxes,
    within,
)
from tests.peers import cases
from tests.twins import boxes as naive_boxes

NAN = [np.nan] * 4
SHARES = ("success_auc", "precision_20", "normalised_auc", "ao", "sr50", "good_rate")
place = st.floats(-50, 150).map(lambda v: round(v, 2))
side = st.floats(0.1, 90).map(lambda v: round(v, 2))
box = st.tuples(place, place, side, side)
pairs = st.lists(st.tuples(box, box), min_size=1, max_size=8)


def arrays(rows):
    a, b = np.array(rows, dtype=float).transpose(1, 0, 2)
    return a, b


@given(pairs, place, place)
def test_iou_is_its_definition_and_does_not_depend_on_the_place(rows, dx, dy):
    a, b = arrays(rows)
    overlap = iou(a, b)
    np.testing.assert_allclose(overlap, [naive_boxes.iou(*row) for row in rows], atol=1e-12)
    clipped = [naive_boxes.iou(*(naive_boxes.clip(box, 100, 60) for box in row)) for row in rows]
    np.testing.assert_allclose(iou(a, b, (100, 60)), clipped, atol=1e-12)
    np.testing.assert_array_equal(overlap, iou(b, a))
    np.testing.assert_allclose(iou(a, a), 1.0, rtol=1e-12)
    moved = np.array([dx, dy, 0, 0])
    np.testing.assert_allclose(iou(a + moved, b + moved), overlap, atol=1e-9)


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


def test_measures_of_an_example_worked_out_by_hand():
    """Rows: given, exact, 25 px off to the right (IoU 3/13), missing, absent, hidden, half the width."""
    truth = np.tile([10.0, 20, 40, 20], (7, 1))
    ours = truth.copy()
    ours[0, 0] = 12
    ours[2, 0] += 25
    ours[3] = [10, np.nan, 40, 20]
    truth[4] = NAN
    ours[5] = [90, 90, 5, 5]
    ours[6, 2] = 20
    valid = np.array([True] * 5 + [False, True])
    found = measure_boxes(ours, truth, visible=valid)
    assert (found.rows, found.missing) == (5, 1)
    np.testing.assert_allclose(found.overlap, [1, 1, 3 / 13, 0, np.nan, np.nan, 0.5], rtol=1e-12)
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
    assert found.good_rate == 3 / 5
    found = measure_boxes(ours, truth, visible=valid, init=np.zeros(7, bool))  # the first counts as any
    assert found.overlap[0] == pytest.approx(38 / 42)
    assert found.ao == pytest.approx((38 / 42 + 1 + 3 / 13 + 0 + 0.5) / 5)


@pytest.mark.parametrize("rows", [0, 1, 4])
def test_nothing_to_measure_has_no_value(rows):
    found = measure_boxes(np.ones((rows, 4)), np.full((rows, 4), np.nan), size=(10, 10))
    assert (found.rows, found.missing, found.hidden_rows) == (0, 0, 0)
    for name in SHARES:
        assert getattr(found, name) is None, name
    assert found.success.shape == (21,)
    assert np.isnan(found.precision).all() and found.overlap.shape == (rows,)
    if rows:  # without a box of ours all is zero
        truth = np.tile([10.0, 20, 40, 20], (rows, 1))
        found = measure_boxes(np.full((rows, 4), np.nan), truth, init=np.zeros(rows, bool))
        assert (found.rows, found.missing) == (rows, rows) and {getattr(found, name) for name in SHARES} == {0.0}


CLOSE = 1e-9
RECORDED = cases.expected()


def ours(case):
    """The measures as measure.py has them."""
    known = ~np.isnan(case.truth).any(axis=1)
    found = measure_boxes(case.ours, case.truth, size=case.size)
    return {
        "iou": iou(case.ours, case.truth),
        "iou_clipped": iou(case.ours, case.truth, case.size),
        "centre_error": centre_errors(case.ours, case.truth),
        "otb": {
            "success_curve": found.success,
            "precision_curve": found.precision,
            "success_score": found.success_auc,
            "precision_score": found.precision_20,
            "success_rate": found.success[10],
        },
        "otb_success_of_all": found.success_auc * known.sum() / len(known),
        "normalised": {"curve": found.normalised_precision, "score": found.normalised_auc},
        "got10k": {"ao": found.ao, "sr": found.sr50, "sr75": found.sr75},
    }


def differences(mine, theirs, place=""):
    """Every value that differs by more than CLOSE, or is known to one of us alone."""
    if isinstance(theirs, dict):
        assert mine.keys() == theirs.keys()
        return [each for key in theirs for each in differences(mine[key], theirs[key], f"{place} {key}")]
    a, b = np.atleast_1d(np.array(mine, dtype=float)), np.atleast_1d(np.array(theirs, dtype=float))
    assert a.shape == b.shape, place
    with np.errstate(invalid="ignore"):
        apart = ~((np.abs(a - b) <= CLOSE) | (np.isnan(a) & np.isnan(b)))
    return [f"{place}[{at}]: ours {a[at]!r}, theirs {b[at]!r}" for at in np.flatnonzero(apart)]


def check(case, theirs):
    mine, theirs = ours(case), dict(theirs)
    # a single missing box makes their AO nan, and we count it as 0
    missing = np.isnan(case.ours).any(axis=1) & ~np.isnan(case.truth).any(axis=1)
    with_nan = theirs.pop("got10k_ao_with_nan")
    theirs["got10k"] = {name: theirs["got10k"][name] for name in mine["got10k"]}
    assert with_nan is None if missing[1:].any() else with_nan == theirs["got10k"]["ao"]
    assert not differences(mine, theirs)


@pytest.mark.parametrize("name", RECORDED)
def test_measures_are_those_recorded_from_the_toolkits(name):
    check(*RECORDED[name])


def test_records_reach_every_rule():
    """What would make the comparison empty: no miss, no absence, no value on a threshold."""
    edges, walk = RECORDED["edges"][0], RECORDED["walk"][0]
    for case in (edges, walk):
        assert np.isnan(case.ours).any() and np.isnan(case.truth).any()
    overlaps = iou(edges.ours, edges.truth)
    assert {0.0, 0.5, 0.75, 1.0} <= set(overlaps[~np.isnan(overlaps)])
    assert 20.0 in centre_errors(edges.ours, edges.truth)


@pytest.mark.nightly
def test_the_toolkits_say_now_what_they_said_and_what_we_say_of_new_cases():
    python = os.environ.get("FACETRACK_PEERS")
    if not python:
        pytest.skip("FACETRACK_PEERS names no Python that has the packages of tests/peers/requirements.txt")
    seed = int(time.time()) // 86400  # new ones each day; the names of the cases tell the seed
    given = {name: case for name, (case, _) in RECORDED.items()} | cases.random(seed)
    said = cases.run(python, given)["measures"]
    for name, case in given.items():
        check(case, said[name])
    for name, (_, held) in RECORDED.items():
        assert not differences(held, said[name], name)
