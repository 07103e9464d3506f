"""How well boxes and points follow the ground truth.

Of boxes: the measures of OTB and GOT-10k, and the good tracking rate.

    measures = measure_boxes(ours, truth, visible=visible, size=(1280, 720))
    measures.success_auc, measures.ao

Boxes are (T, 4): left, top, width, height in pixels, one row for each frame; the centre is left + (width - 1) / 2. What
is not known is nan. Three rules hold for every measure:

- A row counts when its ground truth is known: `visible`, and no nan in its box. The others are left out.
- A row that counts and has no box of ours is a miss: overlap 0, infinite error of the centre.
- The toolkits' arithmetic is followed to the last bit, since comparisons with thresholds depend on it.

Where the toolkits differ from that: got10k 0.1.3 counts a row without ground truth as a failure in its OTB experiment
(its GOT-10k experiment, and the LaSOT experiment of later sources, leave such rows out), and its AO is nan as soon as
one prediction is nan.

Of points: errors, Euclidean distances in pixels. A *normalised* error is divided by a length of the ground truth
(rows.py). Failure rate and AUC are those of the literature on facial landmarks (300-W, COFW, WFLW), a row an image.
"""

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
    good_rate, strict_rate  share of rows `within` 0.5 and 0.25 of the box
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
    strict_rate: Annotated[Value, Measure("strict\n%", PERCENT, "more")]
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


def within(ours: Array, truth: Array, share: float = 0.5) -> Mask:
    """(T,) whether our centre is within `share` of the true width and height from the true centre, on both axes.

    0.5 is the true box itself, border included: these rows are what we take the good tracking rate of Gonzalez and
    Collet to count (table 1, which does not define it). 0.25 is our strict form. False where one of them has nan.
    """
    return np.asarray(np.all(np.abs(_centres(ours) - _centres(truth)) <= truth[:, 2:] * share, axis=1))


def share_above(values: Array, thresholds: Array) -> Array:
    """(K,) share of values (T,) strictly above each threshold (K,): a success curve. nan when there are no values."""
    below = np.searchsorted(np.sort(values), thresholds, side="right")
    return np.asarray((len(values) - below) / (len(values) or np.nan))


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
    success = share_above(overlap[counts], SUCCESS_THRESHOLDS)
    precision = share_up_to(distance[counts], PRECISION_THRESHOLDS)
    normalised_precision = share_up_to(normalised[counts], NORMALISED_THRESHOLDS)
    clipped = np.nan_to_num(iou(ours[later], truth[later], size))
    some = bool(counts.any())
    return BoxMeasures(
        rows=int(counts.sum()),
        missing=int((counts & np.isnan(otb[:, 0])).sum()),
        success_auc=float(np.mean(success)) if some else None,
        precision_20=float(precision[20]) if some else None,
        normalised_auc=float(np.mean(normalised_precision)) if some else None,
        normalised_20=float(normalised_precision[20]) if some else None,
        ao=mean(clipped),
        sr50=mean(clipped > 0.5),
        sr75=mean(clipped > 0.75),
        good_rate=mean(within(otb, truth)[counts]),
        strict_rate=mean(within(otb, truth, 0.25)[counts]),
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
    hidden_...     the same of hidden rows whose true position is known
    lost_for_good  parts whose median error over their last 25 visible rows exceeds 1/4 of the normalising length
    """

    rows: Annotated[int, Measure("visible\nrows", COUNT)]
    missing: Annotated[int, Measure("", COUNT, "less")]
    mean_px: Annotated[Value, Measure("mean\npx", PX, "less")]
    median_px: Annotated[Value, Measure("median\npx", PX, "less")]
    std_px: Annotated[Value, Measure("std\npx", PX, "less")]
    p95_px: Annotated[Value, Measure("95th\npx", PX, "less")]
    mean_normalised: Annotated[Value, Measure("mean\n% of length", PERCENT, "less")]
    median_normalised: Annotated[Value, Measure("", PERCENT, "less")]
    failure_rate: Annotated[Value, Measure("failed\n%", PERCENT, "less")]
    auc: Annotated[Value, Measure("AUC\n", UNIT, "more")]
    hidden_rows: Annotated[int, Measure("hidden\nrows", COUNT, rare=True)]
    hidden_mean_px: Annotated[Value, Measure("mean\npx", PX, "less", rare=True)]
    hidden_median_px: Annotated[Value, Measure("median\npx", PX, "less", rare=True)]
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
        median_normalised=median(finite),
        failure_rate=mean(normalised > failure),
        auc=auc(normalised, failure),
        hidden_rows=len(covered),
        hidden_mean_px=mean(covered),
        hidden_median_px=median(covered),
        lost_for_good=sum(for_good) if for_good else None,
    )


def auc(errors: Array, limit: float) -> Value:
    """Area under the cumulative distribution of `errors` (R,) from 0 to `limit`, over `limit`; None without rows."""
    return mean(np.clip(1 - errors / limit, 0.0, 1.0))


def lost_for_good(part: Rows) -> bool | None:
    """Whether a part ends lost; None where no visible row has a true position and a length."""
    seen = np.flatnonzero(part.visible & part.placed & np.isfinite(part.unit))[-LAST:]
    return bool(np.median(part.error[seen] / part.unit[seen]) > LOST) if len(seen) else None
