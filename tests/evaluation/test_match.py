"""A trajectory and its ground truth: how they are paired, and measures of their rows, counted by hand."""

import itertools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.evaluation.accuracy import (
    ELLIPSE_50,
    ELLIPSE_90,
    auc,
    auroc,
    lost_for_good,
    mahalanobis_squared,
    measure_confidence,
    measure_coverage,
    measure_jitter,
    measure_lost,
    measure_points,
)
from facetrack_cli.evaluation.rows import Pair, lengths_of, match, rows_of
from facetrack_cli.trajectory.trajectory import joined, one_part


def box(frames, target="head", part="box", **columns):
    """On a smooth path, a pixel or two a frame."""
    t, size = np.asarray(frames), np.full(len(frames), 30.0)
    path = {"x": 160 + 40 * np.sin(t / 23), "y": 120 + 30 * np.sin(t / 17), "w": size, "h": size}
    return one_part(target, part, frames, **{**path, **columns})


def table(*parts, name="run.csv", **header):
    return joined(parts, path=Path(name), header=header)


def truth(frames, target="", **columns):
    return table(box(frames, target, **columns), name="gt.txt")


def pairs(ours, theirs, **options):
    return match(ours, theirs, **{"partial": False, "select": None, **options})


T = np.arange(50)
HEAD, FACE = table(box(range(50))), table(*(box(range(9), "face", part) for part in ("nose", "chin")))
TWO = table(box(range(50)), box(range(50), "hand"))
TRACK, TRUE = (box(range(50), status=np.where(T % 9, *words)) for words in (("tracked", "lost"), ("visible", "hidden")))
CUT = table(box(range(100)).take(np.delete(np.arange(100), [40, 41])))
SIZED = table(box(range(50)), source={"size": [320, 240]})
FAR = truth(range(50), x=T + 640, y=np.full(50, 20.0))
ODD = truth(range(50), "head", status=np.where(T == 7, "Hidden", "visible"))
OTHERS = table(box(range(50), "1"), box(range(50), "2"), name="gt.txt")
SHIFTED = replace(truth(range(3, 103)), header={"shift": 4})


@pytest.mark.parametrize(
    ("ours", "theirs", "message"),
    [
        (HEAD, ODD, "gt.txt: frame 7, head/box: status 'Hidden' is none of visible, hidden, absent; correct it"),
        (TWO, truth(range(50)), "gt.txt: .*head/box, hand/box; choose .* --target NAME/PART"),
        (FACE, truth(range(9)), "gt.txt: .* has face/nose, face/chin; .* or give ground truth of its points"),
        (HEAD, OTHERS, "no part in common .* has 1/box, 2/box, the trajectory head/box"),
        (table(box(range(50), "a", "nose")), truth(range(50), "b"), "no part in common.*not measured by boxes"),
        (CUT, truth(range(100)), "run.csv: no row of head/box in frame 40 and 1 more"),
        (SIZED, FAR, "50 of its 50 places are outside of the image of 320x240"),
        (table(box(range(100))), SHIFTED, r"shifted by 3\? --shift 1;"),  # the remedy counts from the file
    ],
)
def test_tables_that_do_not_belong_together(ours, theirs, message):
    with pytest.raises(InputError, match=message):
        pairs(ours, theirs)


def test_what_looks_as_if_it_did_not_belong_together():
    assert pairs(table(TRACK), table(TRUE, name="gt.txt")) and pairs(table(TRACK), table(TRACK, name="gt.txt"))
    assert pairs(HEAD, FAR)  # a CSV does not say how large its image was
    assert pairs(SIZED, replace(truth(range(50)), status=np.where(T < 40, "absent", "visible")))
    (pair,) = pairs(CUT, truth(range(100)), partial=True)
    assert len(pair.ours) == 98


def test_truth_without_names_goes_to_the_only_boxes_or_to_those_that_are_chosen():
    point = one_part("head", "nose", range(50), x=T, y=T)
    (pair,) = pairs(table(point, box(range(50))), truth(range(50)))
    assert (pair.ours.name, pair.is_box, len(pair.truth)) == ("head/box", True, 50)
    assert np.array_equal(pair.ours.frame, pair.truth.frame)
    for select in ("hand", "hand/box"):
        (pair,) = pairs(TWO, truth(range(50)), select=select)
        assert pair.ours.name == "hand/box"
    with pytest.raises(UsageError, match="choose among"):
        pairs(TWO, truth(range(50)), select="foot")


def test_names_are_paired_and_the_rest_is_noted():
    nose, lip, eye = (box(range(50), "face", part) for part in ("nose", "lip", "eye"))
    notes = []
    found = pairs(table(nose, lip), table(eye, nose, name="gt.csv"), note=notes.append)
    assert [(pair.ours.name, pair.is_box) for pair in found] == [("face/nose", False)]
    assert notes == ["gt.csv: face/eye is not in the trajectory, and left out", "gt.csv: says nothing of face/lip"]
    notes.clear()
    (pair,) = pairs(HEAD, truth(range(50), "1"), note=notes.append)
    assert (pair.ours.target, pair.truth.target) == ("head", "head")
    assert notes == ["1 of the ground truth is taken for head: both have one target"]


@pytest.mark.parametrize(
    ("frames", "message"),
    [
        (range(1, 101), r"frames 1\.\.100, the trajectory 0\.\.99: shifted by 1\? --shift -1; .*the 99 that both"),
        (range(200, 300), r"frames 200\.\.299, the .*: shifted by 200\? --shift -200; if not, name its own"),
        (range(200, 250), r"if it is moved, --shift N; if not, name its own"),
        (range(61), r"frames 0\.\.60, the trajectory 0\.\.99: .*; if not, --partial measures the 61 that both have"),
        (range(1), r"frames 0 alone"),
        (range(0, 90, 10), r"frames 0\.\.80"),
        (range(10, 100, 10), r"frames 10\.\.90"),
    ],
)
def test_frames_that_do_not_agree(frames, message):
    with pytest.raises(InputError, match=message) as refused:
        pairs(table(box(range(100))), truth(frames))
    assert str(refused.value).startswith("gt.txt: ") and "\n" not in str(refused.value)


@pytest.mark.parametrize("frames", [range(0, 100, 10), range(5, 100, 10), range(9, 100, 10), range(3, 96, 7)])
def test_sparse_truth_need_not_touch_both_ends(frames):
    (pair,) = pairs(table(box(range(100))), truth(frames))
    assert pair.truth.frame.tolist() == list(frames) == pair.ours.frame.tolist()


@given(st.sets(st.integers(0, 60), min_size=1), st.sets(st.integers(0, 60), min_size=1))
def test_partial_is_the_intersection(mine, others):
    ours, theirs = table(box(sorted(mine))), truth(sorted(others))
    if not mine & others:
        with pytest.raises(InputError, match="if not, name its own"):
            pairs(ours, theirs, partial=True)
        return
    (pair,) = pairs(ours, theirs, partial=True)
    assert pair.ours.frame.tolist() == pair.truth.frame.tolist() == sorted(mine & others)
    assert np.array_equal(pair.ours.x, pair.truth.x)


# --- measures: errors, lengths, what `lost`, `confidence` and spread are worth

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


def statuses(letters):
    return [{"i": "init", "t": "tracked", "l": "lost", "-": ""}[letter] for letter in letters]


def test_errors_in_pixels_and_normalised():
    found = measure_points([rows([0, 3, 1, 2, 9], "vvvvh", unit=20)], failure=0.1)
    assert (found.rows, found.missing, found.hidden_rows) == (4, 0, 1)
    assert found.mean_px == 1.5 and found.median_px == 1.5
    assert found.std_px == pytest.approx(math.sqrt(1.25))
    assert found.p95_px == pytest.approx(2.85)  # between 2 and 3, at 0.95 * 3 = 2.85 of the places 0 to 3
    assert found.mean_normalised == pytest.approx(0.075)
    assert found.failure_rate == 0.25  # 3 / 20 is above 0.1, 2 / 20 is not
    assert found.auc == pytest.approx((1 + 0 + 0.5 + 0) / 4)
    assert found.hidden_mean_px == 9
    found = measure_points([rows([1, 1, 1], part="a"), rows([5], part="b")])  # every row counts once
    assert found.rows == 4 and found.mean_px == 2


def test_rows_without_a_position_fail_and_those_without_truth_or_length_have_no_error():
    found = measure_points([rows([0, math.nan, 0, math.nan], "vvvh")])
    assert (found.rows, found.missing, found.hidden_rows) == (2, 1, 0)
    assert found.mean_px == 0 and found.mean_normalised == 0
    assert found.failure_rate == pytest.approx(1 / 3) and found.auc == pytest.approx(2 / 3)
    found = measure_points([rows([1, 2], "aa")])
    assert found.rows == found.hidden_rows == 0
    assert found.mean_px is found.std_px is found.p95_px is found.auc is found.failure_rate is None
    assert found.hidden_mean_px is found.lost_for_good is None
    found = measure_points([rows([1, 3], unit=math.nan)])
    assert found.mean_px == 2 and found.failure_rate is found.auc is found.mean_normalised is None


@given(st.lists(st.floats(0, 1) | st.just(math.inf), min_size=1, max_size=30), st.floats(0.01, 0.5))
def test_auc_is_the_integral_of_the_step_function(errors, limit):
    # piece by piece between the steps: the share of errors at or below the left end, times the width
    edges = [0.0, *sorted(e for e in errors if 0 < e < limit), limit]
    area = sum((right - left) * np.mean([e <= left for e in errors]) for left, right in itertools.pairwise(edges))
    assert auc(np.array(errors), limit) == pytest.approx(area / limit, abs=1e-12)


@pytest.mark.parametrize(
    ("errors", "status", "lost"),
    [
        ([9] * 30 + [1] * 25, "", False),
        ([1] * 30 + [9] * 13 + [1] * 12, "", True),  # the median of the last 25
        ([1] * 30 + [9] * 12 + [1] * 13, "", False),
        ([9] * 30 + [1] * 25 + [9] * 30, "v" * 55 + "h" * 30, False),
        ([3.0] * 5, "", False),
        ([3.01] * 5, "", True),
        ([math.nan] * 5, "", True),
        ([1] * 5, "hhhhh", None),
    ],
)
def test_lost_for_good_looks_at_the_last_visible_rows(errors, status, lost):
    part = rows(errors, status)
    assert lost_for_good(part) is lost
    assert measure_points([part, part]).lost_for_good == (None if lost is None else 2 * lost)


def points(part, xy, frame=(0, 1), **columns):
    x, y = zip(*xy, strict=True)
    return one_part("face", part, frame, x=x, y=y, status=["visible"] * len(xy), **columns)


TRUTH = [
    points("nose", [(math.nan, math.nan), (0, 0)]),
    points("mouth_left", [(0, 0), (0, 3)]),
    points("mouth_right", [(6, 8), (4, 0)]),
]
BOX = [points("box", [(0, 0), (1, 1), (2, 2)], (0, 1, 2), w=[4, 9, 0], h=[9, 16, 2])]
SHUT = [points("a", [(1, 1)], [0]), points("b", [(1, 1)], [0])]


def lengths(how, truth, frames, reference=()):
    own = [Pair(*(part.take(np.isin(part.frame, frames)),) * 2) for part in truth]
    return lengths_of(how, own, reference)


@pytest.mark.parametrize(
    ("how", "truth", "frames", "expected"),
    [
        ("size", TRUTH, [0, 1], [5, 5]),  # frame 1 is the first with all points
        ("mouth_left:mouth_right", TRUTH, [0, 1], [10, 5]),
        ("nose:mouth_right", TRUTH, [0, 1], [math.nan, 4]),
        ("7.5", TRUTH, [0, 1], [7.5, 7.5]),
        ("size", BOX, [0, 1, 2], [6, 12, math.nan]),
        ("a:b", SHUT, [0], [math.nan]),  # 0 divides nothing
        ("size", SHUT, [0], [math.nan]),
        ("size", TRUTH[:1], [0, 1], [math.nan] * 2),
        ("size", TRUTH, [0], [math.nan]),
    ],
)
def test_lengths(how, truth, frames, expected):
    found, text = lengths(how, truth, frames)
    for each in found:
        np.testing.assert_allclose(each, expected)
    assert len(found) == len(truth) and text


def test_lengths_that_are_of_other_parts_or_not_there():
    assert "no frame" in lengths("size", TRUTH, [0])[1]
    assert lengths("mouth_left:mouth_right", TRUTH[:1], [0, 1], TRUTH)[0][0].tolist() == [10, 5]
    with pytest.raises(UsageError, match=r"the ground truth has no chin; it has nose, mouth_left, mouth_right"):
        lengths("mouth_left:chin", TRUTH, [0, 1])


def test_what_is_measured_as_a_box():
    size = {"w": [5.0], "h": [5.0]}
    box, window, bare = one_part("a", "box", [0], **size), one_part("a", "nose", [0], **size), one_part("a", "box", [0])
    assert Pair(box, box).is_box
    assert not any(pair.is_box for pair in (Pair(window, window), Pair(box, bare), Pair(bare, box)))


def test_lost_against_the_truth():
    # a unit of 12: near is less than 2 off
    part = rows([1.99, 0, 0, 9, 9, 9, 9, 0, 2, 0], "vvvhhhvvvv", ours=statuses("tltttllltl"))
    found = measure_lost([part])
    assert (found.rows, found.covered, found.called) == (10, 3, 5)
    # lost are rows 1, 5, 6, 7, 9; hidden 3, 4, 5; gone 3, 4, 5, 6, 8
    assert found.precision == 1 / 5 and found.recall == 1 / 3
    assert found.precision_gone == 2 / 5 and found.recall_gone == 2 / 5
    assert found.false_alarms == 3 / 5  # of 0, 1, 2, 7, 9: rows 1, 7, 9
    assert found.tracked_near == 2 / 5  # of 0, 2, 3, 4, 8: rows 0, 2


def test_nothing_to_count_is_not_zero_and_a_row_of_unknown_place_counts_by_its_visibility():
    found = measure_lost([rows([0, 0], ours=statuses("tt"))])
    assert found.precision is found.precision_gone is found.recall is found.recall_gone is None
    assert found.false_alarms == 0.0 and found.tracked_near == 1.0
    assert measure_lost([rows([0, 0], ours="")]) is None
    far = measure_lost([rows([9, 9], ours=statuses("tt"))])
    assert far.false_alarms is None and far.recall_gone == 0.0
    found = measure_lost([rows([0, 0, 9], "vhv", ours=statuses("lll"), unit=math.nan)])
    assert found.precision == 1 / 3 and found.precision_gone == 1.0  # of the one row of which it is known
    assert found.false_alarms is None


def test_the_given_row_is_left_out():
    given_row = {"ours": statuses("itl"), "confidence": [1.0, 0.5, 0.5], "std_x": [0.0, 1, 1], "std_y": [0.0, 1, 1]}
    part, measures = rows([0, 0, 0], **given_row), (measure_lost, measure_confidence, measure_coverage)
    assert [measure([part]).rows for measure in measures] == [2, 2, 2]
    silent = [rows([0, 0, 0], ours="", confidence=[1.0, 0.5, 0.5])]  # without any status
    assert measure_lost(silent) is measure_coverage(silent) is None and measure_confidence(silent).rows == 2


def test_confidence_in_bins():
    errors = [0, 0, 9, 0, 9, 9, 0]
    found = measure_confidence([rows(errors, "vvvhvva", confidence=[1.0, 0.9, 0.95, 0.2, 0.1, 0.0, 0.05])])
    # the absent row is not near, whatever its offset
    assert found.rows == 7 and found.near == 3 / 7
    gaps = 2 * 0.025 + 1 * 0.1 + 1 * 0.8 + 3 * (0.95 - 2 / 3)
    assert found.ece == pytest.approx(gaps / 7)
    assert found.brier == pytest.approx((0 + 0.1**2 + 0.95**2 + 0.8**2 + 0.1**2 + 0 + 0.05**2) / 7)
    # near: 1.0, 0.9, 0.2; not near: 0.95, 0.1, 0.0, 0.05; two of the twelve pairs are the wrong way
    assert found.auroc_near == pytest.approx((4 + 3 + 3) / 12)
    assert found.auroc_visible == pytest.approx((2 + 2 + 2 + 1 + 0) / 10)
    found = measure_confidence([rows([0, 9], confidence=[7.5, -2.0])])  # which is no confidence, and ranks rows
    assert found.auroc_near == 1.0 and found.ece is found.brier is None
    assert measure_confidence([rows([0, 9])]) is None
    alike = measure_confidence([rows([0, 0], confidence=[1.0, 0.0])])
    assert alike.auroc_near is alike.auroc_visible is None and alike.near == 1.0


@given(st.lists(st.tuples(st.integers(0, 4), st.booleans()), max_size=25))
def test_auroc_counts_pairs(pairs):
    score, positive = np.array([p[0] for p in pairs], dtype=float), np.array([p[1] for p in pairs], dtype=bool)
    above = [(a > b) + 0.5 * (a == b) for a in score[positive] for b in score[~positive]]
    assert auroc(score, positive) == (pytest.approx(np.mean(above)) if above else None)


def test_coverage_of_ellipses_and_rows_without_a_spread():
    # along x alone, in std: the 50 % ellipse reaches 1.1774 and the 90 % one 2.1460
    found = measure_coverage([rows([1.17, 1.18, 2.14, 2.15, 0, 5], "vvvvvh", std_x=[1.0] * 6, std_y=[2.0] * 6)])
    assert found.rows == 5
    assert found.within_50 == 2 / 5 and found.within_90 == 4 / 5
    assert found.factor == pytest.approx(1.18 / math.sqrt(ELLIPSE_50))
    std = {"std_x": [0.0, 0.0, 1.0, math.nan, 1.0], "std_y": [0.0, 1.0, 0.0, 1.0, 1.0]}
    found = measure_coverage([rows([0, 1, 1, 1, math.nan], **std)])
    # exactly right; no spread where it is off; none where it is not; unknown; no position
    assert found.rows == 3
    assert found.within_50 == found.within_90 == 2 / 3
    assert measure_coverage([rows([0, 1])]) is None
    nowhere = measure_coverage([rows([1], "h", std_x=[1.0], std_y=[1.0])])
    assert nowhere.rows == 0 and nowhere.within_50 is nowhere.factor is None
    assert measure_coverage([rows([1], std_x=[0.0], std_y=[1.0])]).factor is None


def test_the_ellipses_hold_what_they_are_named_for_and_lie_along_the_covariance():
    rng = np.random.default_rng(0)
    cov = np.array([[4.0, 2.5], [2.5, 2.0]])
    offset = rng.multivariate_normal(np.zeros(2), cov, 40_000)
    std = np.broadcast_to(np.sqrt(np.diag(cov)), offset.shape)
    squared = mahalanobis_squared(offset, std, np.full(len(offset), 2.5))
    np.testing.assert_allclose(squared, np.einsum("ni,ij,nj->n", offset, np.linalg.inv(cov), offset), rtol=1e-9)
    assert np.mean(squared <= ELLIPSE_50) == pytest.approx(0.5, abs=0.01)
    assert np.mean(squared <= ELLIPSE_90) == pytest.approx(0.9, abs=0.006)
    # a tiny spread is infinitely far, and no warning
    assert mahalanobis_squared(np.array([[1.0, 0.0]]), np.array([[1e-320, 1.0]])).tolist() == [math.inf]


def test_jitter_is_the_deviation_of_noise_and_nothing_of_an_even_motion():
    noise = measure_jitter([rows(np.random.default_rng(0).normal(0, 2, 20_000))])  # along x alone
    assert noise.rows == 19_998 and noise.truth_px == 0
    assert noise.median_px == pytest.approx(2 * 0.6745, rel=0.03)  # the median of a normal deviate
    assert measure_jitter([rows(np.arange(9.0))]).median_px == pytest.approx(0)
    # it needs three visible rows in a row
    found = measure_jitter([rows([0, 6, 0, 1, 9, 9], "vvvhvv"), rows([0, 0, 6, 0], part="b", frame=[0, 1, 3, 4])])
    assert found.rows == 1 and found.median_px == pytest.approx(12 / math.sqrt(6))
    assert measure_jitter([rows([0, 1])]) is None
