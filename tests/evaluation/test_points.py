"""Errors of points, the lengths that normalise them, and the way back after occlusions."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.errors import UsageError
from facetrack_cli.evaluation.points import auc, lost_for_good, measure_points, measure_recovery, occlusions
from facetrack_cli.evaluation.rows import Pair, check_normalise, rows_of, unit_of
from facetrack_cli.trajectory.trajectory import one_part

UNIT = 12.0  # a sixth of it, within which a point is near, is 2; a quarter, beyond which it is lost for good, is 3


def rows(errors, status="", *, frame=None, target="face", part="nose", unit=UNIT, ours="tracked", **columns):
    """Rows of a part that is off by `errors` along x; nan has no position; `status` is the truth's."""
    errors = np.asarray(errors, dtype=float)
    count = len(errors)
    frame = np.arange(count) if frame is None else frame
    words = {"v": "visible", "h": "hidden", "a": "absent"}
    truth_status = [words[letter] for letter in status] if status else [""] * count
    ours_status = [ours] * count if isinstance(ours, str) else ours
    truth = one_part(target, part, frame, x=np.full(count, 50.0), y=np.full(count, 20.0), status=truth_status)
    mine = one_part(target, part, frame, x=50.0 + errors, y=np.full(count, 20.0), status=ours_status, **columns)
    return rows_of(Pair(mine, truth), np.full(count, float(unit)))


def test_errors_in_pixels_and_normalised():
    found = measure_points([rows([0, 3, 1, 2, 9], "vvvvh", unit=20)], failure=0.1)
    assert (found.rows, found.missing, found.hidden_rows) == (4, 0, 1)
    assert found.mean_px == 1.5 and found.median_px == 1.5
    assert found.std_px == pytest.approx(math.sqrt(1.25))
    assert found.p95_px == pytest.approx(2.85)  # between 2 and 3, at 0.95 * 3 = 2.85 of the places 0 to 3
    assert found.mean_normalised == pytest.approx(0.075) and found.median_normalised == pytest.approx(0.075)
    assert found.failure_rate == 0.25  # 3 / 20 is above 0.1, 2 / 20 is not
    assert found.auc == pytest.approx((1 + 0 + 0.5 + 0) / 4)
    assert found.hidden_mean_px == found.hidden_median_px == 9


def test_all_parts_together_count_every_row_once():
    found = measure_points([rows([1, 1, 1], part="a"), rows([5], part="b")])
    assert found.rows == 4 and found.mean_px == 2


def test_a_row_without_a_position_fails_and_does_not_blur_the_mean():
    found = measure_points([rows([0, math.nan, 0, math.nan], "vvvh")])
    assert (found.rows, found.missing, found.hidden_rows) == (2, 1, 0)
    assert found.mean_px == 0 and found.mean_normalised == 0
    assert found.failure_rate == pytest.approx(1 / 3) and found.auc == pytest.approx(2 / 3)


def test_absent_rows_and_unknown_lengths_have_no_error():
    found = measure_points([rows([1, 2], "aa")])
    assert found.rows == found.hidden_rows == 0
    assert found.mean_px is found.std_px is found.p95_px is found.auc is found.failure_rate is None
    assert found.hidden_mean_px is found.lost_for_good is None
    found = measure_points([rows([1, 3], unit=math.nan)])
    assert found.mean_px == 2 and found.failure_rate is found.auc is found.mean_normalised is None


@given(
    st.lists(st.floats(0, 1) | st.just(math.inf), min_size=1, max_size=30),
    st.floats(0.01, 0.5),
)
def test_auc_is_the_integral_of_the_step_function(errors, limit):
    # piece by piece between the steps: the share of errors at or below the left end, times the width
    edges = [0.0, *sorted(e for e in errors if 0 < e < limit), limit]
    area = sum((right - left) * np.mean([e <= left for e in errors]) for left, right in itertools.pairwise(edges))
    assert auc(np.array(errors), limit) == pytest.approx(area / limit, abs=1e-12)


def test_lost_for_good_looks_at_the_last_visible_rows():
    assert lost_for_good(rows([9] * 30 + [1] * 25)) is False
    assert lost_for_good(rows([1] * 30 + [9] * 13 + [1] * 12)) is True  # the median of the last 25
    assert lost_for_good(rows([1] * 30 + [9] * 12 + [1] * 13)) is False
    assert lost_for_good(rows([9] * 30 + [1] * 25 + [9] * 30, "v" * 55 + "h" * 30)) is False
    assert lost_for_good(rows([3.0] * 5)) is False and lost_for_good(rows([3.01] * 5)) is True
    assert lost_for_good(rows([math.nan] * 5)) is True
    assert lost_for_good(rows([1] * 5, "hhhhh")) is None
    both = measure_points([rows([9] * 5), rows([1] * 5), rows([9] * 5)])
    assert both.lost_for_good == 2


def test_recovery_is_the_first_of_five_near_rows_of_all_that_was_covered():
    status = "vv" + "hh" + "v" * 10
    left = rows([0, 0, 9, 9, 9, 0, 0, 0, 0, 9, 0, 0, 0, 0], status, part="left")
    right = rows([0, 0, 9, 9] + [1.99] * 10, status, part="right")
    nose = rows([9] * 14, part="nose")  # in sight all the time: it does not matter
    assert [one.frames_to_return for one in occlusions([nose, right])] == [0]
    (one,) = occlusions([left, right, nose])
    # 5-8 are only four in a row, and 10-13 too
    assert one.frames_to_return is None and one.decided
    assert (one.target, one.parts, one.first, one.last) == ("face", ("left", "right"), 2, 3)
    left = rows([0, 0, 9, 9, 9, 2.0, 0, 0, 0, 0, 0, 0, 0, 0], status, part="left")  # 2.0 is not less than a sixth
    (one,) = occlusions([left, right, nose])
    assert one.frames_to_return == 2


def test_recovery_ends_at_the_next_occlusion_and_knows_when_it_cannot_tell():
    found = occlusions([rows([0] * 20, "vhhvvvvhhvvvvvvahhvv", frame=np.arange(100, 120))])
    assert [(one.first, one.last) for one in found] == [(101, 102), (107, 108), (115, 117)]
    # four rows before the next, six before the next, two before the end
    assert [one.decided for one in found] == [False, True, False]
    assert [one.frames_to_return for one in found] == [None, 0, None]
    over = measure_recovery(found)
    assert (over.occlusions, over.decided, over.returned, over.recovered) == (3, 1, 1, 1.0)
    assert (over.frames_median, over.frames_worst) == (0.0, 0.0)
    assert occlusions([rows([0, 0])]) == ()
    assert measure_recovery(()) is None
    assert measure_recovery(occlusions([rows([9] * 12, "vhh" + "v" * 9)])).recovered == 0.0
    assert measure_recovery(occlusions([rows([9] * 3, "vhh")])).recovered is None


def test_recovery_is_not_known_where_the_truth_is_not():
    unknown = rows([0, 9, *[0] * 8], "vhvvvvvvvv", unit=math.nan)
    (one,) = occlusions([unknown])
    assert (one.frames_to_return, one.decided) == (None, False)
    assert measure_recovery([one]).recovered is None


def test_targets_recover_apart_and_frames_are_counted_not_rows():
    anna = rows([0] * 9, "vh" + "v" * 7, target="anna", frame=np.arange(9) * 10)
    ben = rows([0, 9, 9, 0, 0, 0, 0, 0, 0], "vh" + "v" * 7, target="ben", frame=np.arange(9) * 10)
    assert [(one.target, one.frames_to_return) for one in occlusions([anna, ben])] == [("anna", 0), ("ben", 10)]


def points(part, xy, frame=(0, 1), status=None, **columns):
    x, y = zip(*xy, strict=True)
    return one_part("face", part, frame, x=x, y=y, status=status or ["visible"] * len(xy), **columns)


TRUTH = [
    points("nose", [(math.nan, math.nan), (0, 0)]),
    points("mouth_left", [(0, 0), (0, 3)]),
    points("mouth_right", [(6, 8), (4, 0)]),
]
FRAMES = np.array([0, 1])


@pytest.mark.parametrize(
    ("how", "lengths"),
    [
        ("size", [5, 5]),  # frame 1 is the first with all points
        ("mouth", [10, 5]),
        ("nose:mouth_right", [math.nan, 4]),
        ("7.5", [7.5, 7.5]),
    ],
)
def test_lengths(how, lengths):
    unit = unit_of(check_normalise(how), TRUTH, box=False, frames=FRAMES)
    np.testing.assert_allclose(unit.at(FRAMES), lengths)
    assert math.isnan(unit.at(np.array([5]))[0]) and " px" in unit.text


def test_lengths_of_eyes_and_boxes():
    eyes = [points("point_37", [(0, 0)], [3]), points("point_46", [(3, 4)], [3])]
    assert unit_of("eyes", eyes, box=False, frames=np.array([3])).at(np.array([3]))[0] == 5
    box = points("box", [(0, 0), (1, 1), (2, 2)], (0, 1, 2), w=[4, 9, 0], h=[9, 16, 2])
    found = unit_of("size", [box], box=True, frames=np.array([0, 1, 2])).at(np.array([1, 0, 2]))
    np.testing.assert_allclose(found, [12, 6, math.nan])


def test_lengths_that_are_not_there():
    shut = [points("a", [(1, 1)], [0]), points("b", [(1, 1)], [0])]
    for how in ("a:b", "size"):
        assert math.isnan(unit_of(how, shut, box=False, frames=np.array([0])).length[0]), "0 divides nothing"
    assert math.isnan(unit_of("size", TRUTH[:1], box=False, frames=FRAMES).length[0])
    assert "no frame" in unit_of("size", TRUTH, box=False, frames=np.array([0])).text
    for how in ("eyes", "mouth_left:chin"):
        with pytest.raises(UsageError, match=r"the ground truth has no .*; it has nose, mouth_left, mouth_right"):
            unit_of(how, TRUTH, box=False, frames=FRAMES)


@pytest.mark.parametrize("how", ["", "width", "a:", ":b", "a:b:c", "a:a", "0", "-3", "nan", "inf", "3px"])
def test_ways_to_normalise_that_are_none(how):
    with pytest.raises(UsageError, match="--normalise"):
        check_normalise(how)


def test_what_is_measured_as_a_box():
    size = {"w": [5.0], "h": [5.0]}
    box, window = one_part("a", "box", [0], **size), one_part("a", "nose", [0], **size)
    assert Pair(box, one_part("", "box", [0], **size)).is_box
    assert not Pair(window, window).is_box, "the window of a point is no box to be measured"
    assert not Pair(box, one_part("a", "box", [0], x=[1.0])).is_box
    assert not Pair(one_part("a", "box", [0]), box).is_box
