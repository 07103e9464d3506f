"""How far `lost`, `confidence` and the posterior's spread can be trusted, against the ground truth.

Counted are rows, one a frame and part, without those that the tracker was given. A row is *near* if its error is less
than a sixth of the normalising length (a box: if its IoU is more than 1/2), *covered* if the ground truth calls it
hidden or absent, *gone* if it is covered or not near.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from facetrack_cli.core.numbers import spans
from facetrack_cli.core.types import Array, Mask, Whole
from facetrack_cli.evaluation.measure import COUNT, HALVES, PERCENT, PX, UNIT, Measure, Value, mean, median, share
from facetrack_cli.evaluation.rows import Rows, column

BINS = 10
ELLIPSE_50 = 2 * math.log(2)
"""Squared Mahalanobis distance within which half of a two-dimensional normal distribution lies."""
ELLIPSE_90 = 2 * math.log(10)
"""The same for nine tenths of it."""


@dataclass(frozen=True)
class LostMeasures:
    """Status `lost` against the ground truth; shares are 0 to 1, delays frames.

    rows, covered, called  rows with a status; of these the covered, and those called lost
    precision        of the rows called lost, those covered; `precision_gone`: those gone
    recall           of the covered rows, those called lost; `recall_gone`: of the rows gone
    false_alarms     of the rows visible and near, those called lost
    tracked_near     of the rows called tracked, those near
    tracked_visible_near  of the rows called tracked and visible in the ground truth, those near
    spans            the stretches in which a part is covered; `spans_called`: those in which it is called lost at all
    delay_lost       from the first covered row until a part is called lost: median over the spans in which it is
    delay_back       from a part's return until it is tracked and near: median over the spans after which it is
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
    spans: Annotated[int, Measure("", COUNT)]
    spans_called: Annotated[int, Measure("", COUNT)]
    delay_lost: Annotated[Value, Measure("delay lost\nframes", HALVES, "less")]
    delay_back: Annotated[Value, Measure("delay back\nframes", HALVES, "less")]


@dataclass(frozen=True)
class CalibrationBin:
    """Rows with low <= confidence < high (last bin: <= high), their mean confidence, the shares near and visible."""

    low: float
    high: float
    rows: int
    mean_confidence: Value
    near: Value
    visible: Value


@dataclass(frozen=True)
class ConfidenceMeasures:
    """How far `confidence` behaves as a probability of being near, which it is not.

    rows           rows with a confidence of which is known whether they are near; absent rows are not
    near           share of them that are near, whatever their confidence
    auroc_near     chance that a near row has more confidence than one that is not near, ties counting half: 0.5 is
                   worthless, 1 tells them apart by some threshold (area under the ROC curve)
    auroc_visible  the same of visible rows against covered ones
    ece            expected calibration error: mean over rows of |share near - mean confidence| of their bin
    brier          mean of (confidence - 1 if near else 0) squared
    bins           `BINS` bins of equal width
    """

    rows: Annotated[int, Measure("rows\n", COUNT)]
    near: Annotated[Value, Measure("near\n%", PERCENT)]
    auroc_near: Annotated[Value, Measure("AUROC\nnear", UNIT, "more")]
    auroc_visible: Annotated[Value, Measure("AUROC\nvisible", UNIT, "more")]
    ece: Annotated[Value, Measure("calibration\nerror", UNIT, "less")]
    brier: Annotated[Value, Measure("Brier\n", UNIT, "less")]
    bins: tuple[CalibrationBin, ...]


@dataclass(frozen=True)
class CoverageMeasures:
    """Whether the posterior's spread covers the error: visible rows with a known true position, and with a std.

    within_50, within_90  share of rows whose true position lies within the 50 and the 90 % ellipse of a normal
                          distribution with std_x and std_y along x and y; 0.5 and 0.9 for a correct spread
    factor                by which the std would have to be multiplied for the 50 % ellipse to hold half of the rows
    zero_std              rows without spread along x or y, which are within only if they are exactly right there
    unknown_std           rows left out because they have no std
    """

    rows: Annotated[int, Measure("rows\n", COUNT)]
    within_50: Annotated[Value, Measure("in the 50 %\nellipse, %", PERCENT)]
    within_90: Annotated[Value, Measure("in the 90 %\nellipse, %", PERCENT)]
    factor: Annotated[Value, Measure("std would\nfit times", PX)]
    zero_std: Annotated[int, Measure("without\nspread", COUNT, rare=True)]
    unknown_std: Annotated[int, Measure("std not\nknown", COUNT, rare=True)]


def measure_lost(parts: Sequence[Rows]) -> LostMeasures | None:
    """`lost` against the ground truth; None if no row has a status. Delays: of spans in which no correction helped."""
    by_hand = [part.frame[part.by_hand] for part in parts]
    parts = [part.take(part.stated) for part in parts]
    lost, visible, covered, near, judged = (
        column(parts, name) for name in ("lost", "visible", "covered", "near", "judged")
    )
    if not len(lost):
        return None
    until_lost: list[int] = []
    until_back: list[int] = []
    count = 0
    for part, helped in zip(parts, by_hand, strict=True):
        for first, end in spans(part.covered):
            count += 1
            called = part.frame[first:end][part.lost[first:end]][:1]
            back = part.frame[end:][~part.lost[end:] & part.near[end:]][:1]
            if not _any_within(helped, part.frame[first], called):
                until_lost += (called - part.frame[first]).tolist()
            if not _any_within(helped, part.frame[first], back):
                until_back += (back - part.frame[end : end + 1]).tolist()
    known = covered | judged  # a hidden row is gone, wherever it is
    gone = covered | (judged & ~near)
    return LostMeasures(
        rows=len(lost),
        covered=int(np.sum(covered)),
        called=int(np.sum(lost)),
        precision=share(lost, covered),
        precision_gone=share(lost & known, gone),
        recall=share(covered, lost),
        recall_gone=share(gone, lost),
        false_alarms=share(visible & judged & near, lost),
        tracked_near=share(~lost & judged, near),
        tracked_visible_near=share(~lost & judged & visible, near),
        spans=count,
        spans_called=len(until_lost),
        delay_lost=median(np.array(until_lost)),
        delay_back=median(np.array(until_back)),
    )


def _any_within(frames: Whole, first: int, last: Whole) -> bool:
    """Whether any frame is from `first` to `last` (1,); False where there is no last."""
    return bool(len(last)) and bool(np.any((frames >= first) & (frames <= last[0])))


def measure_confidence(parts: Sequence[Rows]) -> ConfidenceMeasures | None:
    """None if no row has a confidence."""
    parts = [part.take(~part.init) for part in parts]
    confidence, near, judged, visible = (column(parts, name) for name in ("confidence", "near", "judged", "visible"))
    known = np.isfinite(confidence)
    if not known.any():
        return None
    seen = auroc(confidence[known], visible[known])
    rows = known & judged
    confidence, near, visible = confidence[rows], near[rows], visible[rows]
    # scores of other tools need not lie between 0 and 1; then they rank rows, and that is all
    scaled = bool(len(confidence)) and bool(np.all((confidence >= 0) & (confidence <= 1)))
    bins = calibration(confidence, near, visible) if scaled else ()
    return ConfidenceMeasures(
        rows=len(confidence),
        near=mean(near),
        auroc_near=auroc(confidence, near),
        auroc_visible=seen,
        ece=_calibration_error(bins) if scaled else None,
        brier=float(np.mean((confidence - near) ** 2)) if scaled else None,
        bins=bins,
    )


def measure_coverage(parts: Sequence[Rows]) -> CoverageMeasures | None:
    """None if no row has a std."""
    parts = [part.take(~part.init) for part in parts]
    offset, std, visible, placed = (column(parts, name) for name in ("offset", "std", "visible", "placed"))
    counted = visible & placed & np.isfinite(offset).all(axis=1)
    known = np.isfinite(std).all(axis=1)
    if not known.any():
        return None
    offset, spread = offset[counted & known], std[counted & known]
    squared = mahalanobis_squared(offset, spread)
    # the middle row's own distance where their number is odd, as the 50 % ellipse would have to reach it
    factor = (
        math.sqrt(float(np.quantile(squared, 0.5, method="inverted_cdf")) / ELLIPSE_50) if len(squared) else math.inf
    )
    return CoverageMeasures(
        rows=len(squared),
        within_50=mean(squared <= ELLIPSE_50),
        within_90=mean(squared <= ELLIPSE_90),
        factor=factor if math.isfinite(factor) else None,
        zero_std=int(np.sum((spread == 0).any(axis=1))),
        unknown_std=int(np.sum(counted & ~known)),
    )


def mahalanobis_squared(offset: Array, std: Array) -> Array:
    """(R,) squared Mahalanobis distance of offsets (R, 2) for deviations (R, 2) along the axes.

    Along an axis without spread it is 0 if the offset is, else infinite.
    """
    flat = std == 0
    with np.errstate(over="ignore"):  # of a tiny std: infinitely far is right
        terms = (offset / np.where(flat, 1.0, std)) ** 2
    terms = np.where(flat, np.where(offset == 0, 0.0, np.inf), terms)
    return np.asarray(terms.sum(axis=1))


def auroc(score: Array, positive: Mask) -> Value:
    """Area under the ROC curve, exact: the chance that a positive scores above a negative, ties counting half.

    score (R,) finite, positive (R,). None if all rows are positive, or none is.
    """
    positives = int(np.sum(positive))
    negatives = len(score) - positives
    if not positives or not negatives:
        return None
    _, which, counts = np.unique(score, return_inverse=True, return_counts=True)
    ranks = np.cumsum(counts) - (counts - 1) / 2  # the mean rank of each value, from 1
    above = float(np.sum(ranks[which.reshape(-1)[positive]])) - positives * (positives + 1) / 2
    return above / (positives * negatives)


def calibration(confidence: Array, near: Mask, visible: Mask) -> tuple[CalibrationBin, ...]:
    """`BINS` bins of equal width for confidence (R,) from 0 to 1, near (R,) and visible (R,)."""
    edges = np.arange(BINS + 1) / BINS
    which = np.clip(np.searchsorted(edges, confidence, side="right") - 1, 0, BINS - 1)
    rows = np.bincount(which, minlength=BINS)
    sums = np.bincount(which, weights=confidence, minlength=BINS)
    hits, seen = (np.bincount(which, weights=mask.astype(np.float64), minlength=BINS) for mask in (near, visible))
    return tuple(
        CalibrationBin(
            low=float(edges[i]),
            high=float(edges[i + 1]),
            rows=int(n),
            mean_confidence=float(sums[i] / n) if n else None,
            near=float(hits[i] / n) if n else None,
            visible=float(seen[i] / n) if n else None,
        )
        for i, n in enumerate(rows.tolist())
    )


def _calibration_error(bins: Sequence[CalibrationBin]) -> float:
    filled = [b for b in bins if b.near is not None and b.mean_confidence is not None]
    gaps = [b.rows * abs((b.near or 0.0) - (b.mean_confidence or 0.0)) for b in filled]
    return float(sum(gaps) / sum(b.rows for b in filled))
