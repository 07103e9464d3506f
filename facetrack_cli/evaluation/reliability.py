"""How reliable `lost`, `confidence` and the posterior's spread are, against the ground truth.

Rows are counted, without the rows that the tracker was given: *near* and *right* as in rows.py, *covered* if hidden or
absent in the ground truth, *gone* if covered or not near.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from facetrack_cli.core.types import Array, Mask
from facetrack_cli.evaluation.rows import COUNT, PERCENT, PX, UNIT, Measure, Rows, Value, column, mean, median

BINS = 10
# squared Mahalanobis distances within which 50 and 90 % of a two-dimensional normal distribution lie
ELLIPSE_50, ELLIPSE_90 = 2 * math.log(2), 2 * math.log(10)


@dataclass(frozen=True)
class LostMeasures:
    """Status `lost` against the ground truth; shares are 0 to 1.

    rows, covered, called  rows with a status; of these the covered, and those called lost
    precision        of the rows called lost, those covered; `precision_gone`: those gone
    recall           of the covered rows, those called lost; `recall_gone`: of the rows gone
    false_alarms     of the rows visible and near, those called lost
    tracked_near     of the rows called tracked, those near; `tracked_visible_near`: of those visible too
    """

    rows: Annotated[int, Measure("rows\n", COUNT)]
    covered: Annotated[int, Measure("covered\nrows", COUNT)]
    called: Annotated[int, Measure("called\nlost", COUNT)]
    precision: Annotated[Value, Measure("precision\ncovered %", PERCENT, "more")]
    precision_gone: Annotated[Value, Measure("precision\ngone %", PERCENT, "more")]
    recall: Annotated[Value, Measure("recall\ncovered %", PERCENT, "more")]
    recall_gone: Annotated[Value, Measure("recall\ngone %", PERCENT, "more")]
    false_alarms: Annotated[Value, Measure("false\nalarms %", PERCENT, "less")]
    tracked_near: Annotated[Value, Measure("tracked:\nnear %", PERCENT, "more")]
    tracked_visible_near: Annotated[Value, Measure("& visible:\nnear %", PERCENT, "more")]


@dataclass(frozen=True)
class ConfidenceMeasures:
    """How well `confidence` tells rows apart, and how far it is the probability that a row is right.

    rows           rows with a confidence of which is known whether they are near; absent rows are not
    near, right    share of them that are near, and that are right, whatever their confidence
    auroc_near     area under the ROC curve: chance that a near row has more confidence than one that is not near, ties
                   counting half; 0.5 is no better than chance, 1 separates them by a threshold
    auroc_visible  the same of visible rows against covered ones
    ece            expected calibration error: mean over rows of |share right - mean confidence| of their tenth
    brier          mean of (confidence - 1 if right else 0) squared
    """

    rows: Annotated[int, Measure("rows\n", COUNT)]
    near: Annotated[Value, Measure("near\n%", PERCENT)]
    right: Annotated[Value, Measure("right\n%", PERCENT)]
    auroc_near: Annotated[Value, Measure("AUROC\nnear", UNIT, "more")]
    auroc_visible: Annotated[Value, Measure("AUROC\nvisible", UNIT, "more")]
    ece: Annotated[Value, Measure("calibration\nerror", UNIT, "less")]
    brier: Annotated[Value, Measure("Brier\n", UNIT, "less")]


@dataclass(frozen=True)
class CoverageMeasures:
    """Whether the posterior's spread covers the error: visible rows with a known true position, and with a std.

    within_..    share of rows whose true position lies within the 50 or 90 % ellipse of a normal distribution with
                 std_x, std_y and cov_xy; 0.5 and 0.9 for a correct spread
    factor       by which the std would have to be multiplied for the 50 % ellipse to hold half of the rows
    zero_std     rows without spread along x or y, which are within only if they are exactly right there
    unknown_std  rows left out because they have no std
    """

    rows: Annotated[int, Measure("rows\n", COUNT)]
    within_50: Annotated[Value, Measure("in the 50 %\nellipse, %", PERCENT)]
    within_90: Annotated[Value, Measure("in the 90 %\nellipse, %", PERCENT)]
    factor: Annotated[Value, Measure("std would\nfit times", PX)]
    zero_std: Annotated[int, Measure("without\nspread", COUNT, rare=True)]
    unknown_std: Annotated[int, Measure("std not\nknown", COUNT, rare=True)]


@dataclass(frozen=True)
class JitterMeasures:
    """How much a track trembles: the median over `rows` of |x_{t-1} - 2 x_t + x_{t+1}| / sqrt(6), in pixels.

    Of noise at rest, independent from frame to frame, it is 1.18 times the standard deviation along an axis; a motion
    adds its acceleration. `truth_px` is that of the ground truth. Counted are visible rows between two visible ones.
    """

    rows: Annotated[int, Measure("rows", COUNT)]
    median_px: Annotated[Value, Measure("median\npx", PX, "less")]
    truth_px: Annotated[Value, Measure("of the\ntruth", PX)]


def measure_jitter(parts: Sequence[Rows]) -> JitterMeasures | None:
    """None if no part has three visible rows in a row."""
    jitter: list[Array] = []
    for part in parts:
        usable = part.visible & part.placed & np.isfinite(part.at).all(axis=1) & ~part.by_hand
        three = usable[:-2] & usable[1:-1] & usable[2:] & (part.frame[2:] - part.frame[:-2] == 2)
        both = np.stack([part.at, part.at - part.offset])
        off = both[:, :-2] - 2 * both[:, 1:-1] + both[:, 2:]
        jitter.append(np.hypot(off[..., 0], off[..., 1])[:, three] / math.sqrt(6))
    ours, truth = np.concatenate(jitter, axis=1)
    return JitterMeasures(len(ours), median(ours), median(truth)) if len(ours) else None


def measure_lost(parts: Sequence[Rows]) -> LostMeasures | None:
    """None if no row has a status."""
    parts = [part.take(part.stated) for part in parts]
    names = ("lost", "visible", "covered", "near", "judged")
    lost, visible, covered, near, judged = (column(parts, name) for name in names)
    if not len(lost):
        return None
    judged_rows = covered | judged  # a hidden row is gone, wherever it is
    gone = covered | (judged & ~near)
    return LostMeasures(
        rows=len(lost),
        covered=int(np.sum(covered)),
        called=int(np.sum(lost)),
        precision=mean(covered[lost]),
        precision_gone=mean(gone[lost & judged_rows]),
        recall=mean(lost[covered]),
        recall_gone=mean(lost[gone]),
        false_alarms=mean(lost[visible & judged & near]),
        tracked_near=mean(near[~lost & judged]),
        tracked_visible_near=mean(near[~lost & judged & visible]),
    )


def measure_confidence(parts: Sequence[Rows]) -> ConfidenceMeasures | None:
    """None if no row has a confidence."""
    parts = [part.take(~part.init) for part in parts]
    names = ("confidence", "near", "right", "judged", "visible")
    confidence, near, right, judged, visible = (column(parts, name) for name in names)
    finite = np.isfinite(confidence)
    if not finite.any():
        return None
    seen = auroc(confidence[finite], visible[finite])
    rows = finite & judged
    confidence, near, right = confidence[rows], near[rows], right[rows]
    # scores of other tools need not lie between 0 and 1; then they rank rows, and that is all
    scaled = len(confidence) and np.all((confidence >= 0) & (confidence <= 1))
    return ConfidenceMeasures(
        rows=len(confidence),
        near=mean(near),
        right=mean(right),
        auroc_near=auroc(confidence, near),
        auroc_visible=seen,
        ece=calibration_error(confidence, right) if scaled else None,
        brier=float(np.mean((confidence - right) ** 2)) if scaled else None,
    )


def measure_coverage(parts: Sequence[Rows]) -> CoverageMeasures | None:
    """None if no row has a std."""
    parts = [part.take(~part.init) for part in parts]
    names = ("offset", "std", "cov_xy", "visible", "placed")
    offset, std, cov_xy, visible, placed = (column(parts, name) for name in names)
    counted = visible & placed & np.isfinite(offset).all(axis=1)
    finite = np.isfinite(std).all(axis=1)
    if not finite.any():
        return None
    offset, spread = offset[counted & finite], std[counted & finite]
    squared = mahalanobis_squared(offset, spread, cov_xy[counted & finite])
    # the median distance, which the 50 % ellipse would have to reach
    half = float(np.quantile(squared, 0.5, method="inverted_cdf")) if len(squared) else math.inf
    return CoverageMeasures(
        rows=len(squared),
        within_50=mean(squared <= ELLIPSE_50),
        within_90=mean(squared <= ELLIPSE_90),
        factor=math.sqrt(half / ELLIPSE_50) if math.isfinite(half) else None,
        zero_std=int(np.sum((spread == 0).any(axis=1))),
        unknown_std=int(np.sum(counted & ~finite)),
    )


def mahalanobis_squared(offset: Array, std: Array, cov_xy: Array | float = 0.0) -> Array:
    """(R,) squared Mahalanobis distance of offsets (R, 2) for deviations (R, 2) along the axes and a covariance (R,).

    Along an axis without spread it is 0 if the offset is, else infinite.
    """
    flat = std == 0
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # of a tiny std: infinitely far is right
        r = np.where(flat.any(axis=1), 0.0, np.clip(cov_xy / np.prod(std, axis=1), -0.999, 0.999))
        scaled = offset / np.where(flat, 1.0, std)
        # what y is off beyond what x says of it
        beyond = np.where(r == 0, scaled[:, 1], (scaled[:, 1] - r * scaled[:, 0]) / np.sqrt(1 - r * r))
        terms = np.stack([scaled[:, 0], beyond], axis=1) ** 2
    terms = np.where(flat, np.where(offset == 0, 0.0, np.inf), terms)
    return np.asarray(terms.sum(axis=1))


def auroc(score: Array, positive: Mask) -> Value:
    """Exact area under the ROC curve of score (R,): the chance that a positive (R,) scores above a negative, ties
    counting half. None if all rows are positive, or none is.
    """
    positives = int(np.sum(positive))
    negatives = len(score) - positives
    if not positives or not negatives:
        return None
    _, rank, counts = np.unique(score, return_inverse=True, return_counts=True)
    ranks = np.cumsum(counts) - (counts - 1) / 2  # the mean rank of each value, from 1
    above = float(np.sum(ranks[rank.reshape(-1)[positive]])) - positives * (positives + 1) / 2
    return above / (positives * negatives)


def calibration_error(confidence: Array, right: Mask, weight: Array | None = None) -> float:
    """The expected calibration error of confidence (R,) from 0 to 1, in `BINS` bins of equal width: the mean over rows,
    by their weights (R,), of |share right - mean confidence| of their bin.
    """
    bin_of = np.clip(np.searchsorted(np.arange(BINS + 1) / BINS, confidence, side="right") - 1, 0, BINS - 1)
    weight = np.ones(len(confidence)) if weight is None else weight
    return float(np.abs(np.bincount(bin_of, weight * (right - confidence))).sum() / weight.sum())
