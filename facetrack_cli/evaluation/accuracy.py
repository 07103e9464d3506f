"""How well boxes and points follow the ground truth, and how reliable lost, confidence and spread are.

Of boxes: the measures of OTB and GOT-10k, and the good tracking rate.

    measures = measure_boxes(ours, truth, visible=visible, size=(1280, 720))
    measures.success_auc, measures.ao

Boxes are (T, 4): left, top, width, height in pixels, one row for each frame; the centre is left + (width - 1) / 2. What
is not known is nan. Three rules hold for every measure:

- A row counts when its ground truth is known: `visible`, and no nan in its box. The others are left out.
- A row that counts and has no box of ours is a miss: overlap 0, infinite error of the centre.
- The toolkits' arithmetic is followed to the last bit, since comparisons with thresholds depend on it.

Where the toolkits differ from that: docs/measure.md.

Of points: errors, Euclidean distances in pixels. A *normalised* error is divided by a length of the ground truth
(rows.py). Failure rate and AUC are those of the literature on facial landmarks (300-W, COFW, WFLW), a row an image.

Of lost, confidence and spread: how reliable they are. Rows are counted, without the rows that the tracker was given:
*near* and *right* as in rows.py, *covered* if hidden or absent in the ground truth, *gone* if covered or not near.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from facetrack_cli.core.geometry import iou
from facetrack_cli.core.types import Array, Mask
from facetrack_cli.evaluation.rows import COUNT, PERCENT, PX, UNIT, Measure, Rows, Value, column, mean, median

SUCCESS_THRESHOLDS: Array = np.linspace(0.0, 1.0, 21)  # overlap; OTB
PRECISION_THRESHOLDS: Array = np.arange(51.0)  # pixels
NORMALISED_THRESHOLDS: Array = np.linspace(0.0, 0.5, 51)  # error of the centre in sizes of the true box


@dataclass(frozen=True, eq=False)
class BoxMeasures:
    """All measures of the boxes of one target, or of several together. Shares and overlaps are 0..1.

    rows            rows that count, as OTB, precision and the good tracking rate count them
    missing         of these, rows without a box of ours
    success_auc     mean of `success`, the shares of rows with an IoU strictly above each of SUCCESS_THRESHOLDS
                    (Wu, Lim and Yang 2013; got10k's ExperimentOTB)
    precision_20    of `precision`, the shares with centres at most PRECISION_THRESHOLDS apart, that at 20 px
    normalised_auc  mean of `normalised_precision`, the shares with `normalised_errors` at most NORMALISED_THRESHOLDS
                    (Müller et al. 2018; Fan et al. 2019), as LaSOT's table and got10k report; `normalised_20` is at 0.2
    ao, sr50, sr75  mean IoU, and the shares strictly above 0.5 and 0.75 (Huang, Zhao and Huang 2019; got10k's
                    ExperimentGOT10k)
    good_rate       share of rows whose centre is `within` the true box
    hidden_rows     hidden rows with a true box, which no other measure counts; `hidden_overlap` is their mean IoU

    `overlap` (T,) is the IoU as in OTB, nan where no row counts.
    """

    rows: Annotated[int, Measure("visible\nrows", COUNT)]
    missing: Annotated[int, Measure("", COUNT, "less")]
    success_auc: Annotated[Value, Measure("success\nAUC", UNIT, "more")]
    precision_20: Annotated[Value, Measure("precision\n20 px, %", PERCENT, "more")]
    normalised_auc: Annotated[Value, Measure("normalised\nAUC", UNIT, "more")]
    normalised_20: Annotated[Value, Measure("", PERCENT, "more")]
    ao: Annotated[Value, Measure("GOT-10k\nAO", UNIT, "more")]
    sr50: Annotated[Value, Measure("SR 0.5\n%", PERCENT, "more")]
    sr75: Annotated[Value, Measure("SR 0.75\n%", PERCENT, "more")]
    good_rate: Annotated[Value, Measure("good\n%", PERCENT, "more")]
    hidden_rows: Annotated[int, Measure("hidden\nrows", COUNT, rare=True)]
    hidden_overlap: Annotated[Value, Measure("mean\nIoU", UNIT, "more", rare=True)]
    overlap: Array
    success: Array
    precision: Array
    normalised_precision: Array


def centre_errors(ours: Array, truth: Array) -> Array:
    """(T,) distance of the centres in pixels (OTB; got10k's `center_error`)."""
    return _length(_centres(ours) - _centres(truth))


def normalised_errors(ours: Array, truth: Array) -> Array:
    """(T,) distance of the centres, each axis in widths and heights of the true box: the normalised precision of
    TrackingNet (Müller et al. 2018) and LaSOT (Fan et al. 2019). Sides below one pixel count as one, as in
    `normalized_center_error` of got10k's later sources; 0.1.3 on PyPI does not have it.
    """
    return _length((_centres(ours) - _centres(truth)) / np.maximum(1.0, truth[:, 2:]))


def within(ours: Array, truth: Array) -> Mask:
    """(T,) whether our centre is in the true box, border included: these rows are what we take the good tracking rate
    of Gonzalez and Collet to count (table 1, which does not define it). False where one of them has nan.
    """
    return np.asarray(np.all(np.abs(_centres(ours) - _centres(truth)) <= truth[:, 2:] / 2, axis=1))


def share_up_to(values: Array, thresholds: Array) -> Array:
    """(K,) share of values (T,) at or below each threshold (K,): a precision curve. nan when there are no values."""
    return np.asarray(np.searchsorted(np.sort(values), thresholds, side="right") / (len(values) or np.nan))


def measure_boxes(
    ours: Array,
    truth: Array,
    *,
    visible: Mask | None = None,
    hidden: Mask | None = None,
    init: Mask | None = None,
    size: tuple[int, int] | None = None,
) -> BoxMeasures:
    """All measures of boxes `ours` against `truth`, (T, 4) each, row by row of the same frames.

    visible, hidden: (T,) what the ground truth says of each row; by default all rows are visible.
    init: (T,) rows that the tracker was given; by default the first. OTB's experiment puts the ground truth there
    (overlap 1, error 0), and so does the good tracking rate here; GOT-10k leaves them out.
    size: (width, height) of the frames, to which GOT-10k clips; without it nothing is clipped.
    """
    ours, truth = np.asarray(ours, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    finite = np.isfinite(truth).all(axis=1)
    counts = finite if visible is None else finite & visible
    start: Mask = np.asarray(np.arange(len(ours)) == 0 if init is None else init)
    covered = np.zeros_like(finite) if hidden is None else finite & hidden
    later = counts & ~start
    # nan all over, so that no half of a box is compared with anything
    ours = np.where(np.isfinite(ours).all(axis=1, keepdims=True), ours, np.nan)
    otb = np.where(start[:, None], truth, ours)
    overlap = np.where(counts, np.nan_to_num(iou(otb, truth)), np.nan)
    errors = centre_errors(otb, truth), normalised_errors(otb, truth)
    distance, normalised = (np.where(np.isnan(error), np.inf, error) for error in errors)
    rows = int(counts.sum())
    success = (rows - np.searchsorted(np.sort(overlap[counts]), SUCCESS_THRESHOLDS, side="right")) / (rows or np.nan)
    precision = share_up_to(distance[counts], PRECISION_THRESHOLDS)
    normalised_precision = share_up_to(normalised[counts], NORMALISED_THRESHOLDS)
    clipped = np.nan_to_num(iou(ours[later], truth[later], size))
    return BoxMeasures(
        rows=rows,
        missing=int((counts & np.isnan(otb[:, 0])).sum()),
        success_auc=float(np.mean(success)) if rows else None,
        precision_20=float(precision[20]) if rows else None,
        normalised_auc=float(np.mean(normalised_precision)) if rows else None,
        normalised_20=float(normalised_precision[20]) if rows else None,
        ao=mean(clipped),
        sr50=mean(clipped > 0.5),
        sr75=mean(clipped > 0.75),
        good_rate=mean(within(otb, truth)[counts]),
        hidden_rows=int(covered.sum()),
        hidden_overlap=mean(np.nan_to_num(iou(ours, truth)[covered])),
        overlap=overlap,
        success=success,
        precision=precision,
        normalised_precision=normalised_precision,
    )


def _centres(boxes: Array) -> Array:
    return np.asarray(boxes[:, :2] + (boxes[:, 2:] - 1.0) / 2.0)


def _length(offsets: Array) -> Array:
    return np.asarray(np.sqrt(offsets[:, 0] ** 2 + offsets[:, 1] ** 2))


FAILURE = 0.1  # normalised error above which a row has failed, as in COFW and WFLW; 300-W takes 0.08
LAST = 25  # visible rows at the end whose median error tells whether a part is lost for good
LOST = 1 / 4  # of the normalising length: a part whose last rows are further off is lost for good


@dataclass(frozen=True)
class PointMeasures:
    """Errors of one part, or of several together.

    rows           visible rows with a known true position and a position of ours; the figures below are of these
    missing        visible rows for which we have no position; they count as failures, and in nothing else
    ..._px         error in pixels: mean, median, standard deviation, 95th percentile
    failure_rate   share of the visible rows whose normalised error is above the failure threshold, or missing
    auc            area under the cumulative distribution of their normalised error up to that threshold, divided by it
    hidden_...     of hidden rows whose true position is known
    lost_for_good  parts whose median error over their last 25 visible rows exceeds 1/4 of the normalising length
    """

    rows: Annotated[int, Measure("visible\nrows", COUNT)]
    missing: Annotated[int, Measure("", COUNT, "less")]
    mean_px: Annotated[Value, Measure("mean\npx", PX, "less")]
    median_px: Annotated[Value, Measure("median\npx", PX, "less")]
    std_px: Annotated[Value, Measure("std\npx", PX, "less")]
    p95_px: Annotated[Value, Measure("95th\npx", PX, "less")]
    mean_normalised: Annotated[Value, Measure("mean\n% of length", PERCENT, "less")]
    failure_rate: Annotated[Value, Measure("failed\n%", PERCENT, "less")]
    auc: Annotated[Value, Measure("AUC\n", UNIT, "more")]
    hidden_rows: Annotated[int, Measure("hidden\nrows", COUNT, rare=True)]
    hidden_mean_px: Annotated[Value, Measure("mean\npx", PX, "less", rare=True)]
    lost_for_good: Annotated[int | None, Measure("lost for\ngood", COUNT, "less")]


def measure_points(parts: Sequence[Rows], failure: float = FAILURE) -> PointMeasures:
    """Errors over all rows of the parts but those that a correction gave; `failure` is a normalised error."""
    parts = [part.take(~part.later) for part in parts]
    error, unit, visible, hidden = (column(parts, name) for name in ("error", "unit", "visible", "hidden"))
    seen, missing = visible & np.isfinite(error), visible & np.isinf(error)
    px, covered = error[seen], error[hidden & np.isfinite(error)]
    # rows without a length have no normalised error; those without a position fail by any length
    scaled = (seen | missing) & np.isfinite(unit)
    normalised = error[scaled] / unit[scaled]
    finite = normalised[np.isfinite(normalised)]
    for_good = [lost for part in parts if (lost := lost_for_good(part)) is not None]
    return PointMeasures(
        rows=len(px),
        missing=int(np.sum(missing)),
        mean_px=mean(px),
        median_px=median(px),
        std_px=float(np.std(px)) if len(px) else None,
        p95_px=float(np.percentile(px, 95)) if len(px) else None,
        mean_normalised=mean(finite),
        failure_rate=mean(normalised > failure),
        auc=auc(normalised, failure),
        hidden_rows=len(covered),
        hidden_mean_px=mean(covered),
        lost_for_good=sum(for_good) if for_good else None,
    )


def auc(errors: Array, limit: float) -> Value:
    """Area under the cumulative distribution of `errors` (R,) from 0 to `limit`, over `limit`; None without rows."""
    return mean(np.clip(1 - errors / limit, 0.0, 1.0))


def lost_for_good(part: Rows) -> bool | None:
    """Whether a part ends lost; None where no visible row has a true position and a length."""
    seen = np.flatnonzero(part.visible & part.placed & np.isfinite(part.unit))[-LAST:]
    return bool(np.median(part.error[seen] / part.unit[seen]) > LOST) if len(seen) else None


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
    tracked_near     of the rows called tracked, those near
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
    """

    rows: Annotated[int, Measure("rows\n", COUNT)]
    within_50: Annotated[Value, Measure("in the 50 %\nellipse, %", PERCENT)]
    within_90: Annotated[Value, Measure("in the 90 %\nellipse, %", PERCENT)]
    factor: Annotated[Value, Measure("std would\nfit times", PX)]


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
        usable = part.visible & part.placed & np.isfinite(part.at).all(axis=1) & ~(part.later | part.left_out)
        three = usable[:-2] & usable[1:-1] & usable[2:] & (part.frame[2:] - part.frame[:-2] == 2)
        both = np.stack([part.at, part.at - part.offset])
        off = both[:, :-2] - 2 * both[:, 1:-1] + both[:, 2:]
        jitter.append(np.hypot(off[..., 0], off[..., 1])[:, three] / math.sqrt(6))
    ours, truth = np.concatenate(jitter, axis=1)
    return JitterMeasures(len(ours), median(ours), median(truth)) if len(ours) else None


def measure_lost(parts: Sequence[Rows]) -> LostMeasures | None:
    """None if no row has a status."""
    parts = [part.take(part.stated) for part in parts]
    lost, visible, near, judged = (column(parts, name) for name in ("lost", "visible", "near", "judged"))
    if not len(lost):
        return None
    covered = ~visible
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
