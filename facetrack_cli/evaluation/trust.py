"""How far `lost`, `confidence` and the posterior's spread can be trusted, against the truth.

Counted are rows, one a frame and part, without those that the tracker was given. A row is *near* if it is off by less
than a sixth of the normalising length (a box: if it overlaps the truth by more than half), *gone* if the truth calls it
hidden or absent, or if it is not near. A figure that is not defined, as the precision of nothing, is None.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from facetrack_cli.core.spans import spans
from facetrack_cli.core.types import Array, Mask, Whole
from facetrack_cli.evaluation.rows import Figure, Rows, column, share

BINS = 10
ELLIPSE_50 = 2 * math.log(2)
"""Squared Mahalanobis distance within which half of a two-dimensional normal distribution lies."""
ELLIPSE_90 = 2 * math.log(10)
"""The same for nine tenths of it."""


@dataclass(frozen=True)
class LostMeasures:
    """Status `lost` against the truth; shares are 0 to 1, delays frames.

    precision        of the rows called lost, those hidden or absent
    precision_gone   of the rows called lost, those gone
    recall           of the hidden and absent rows, those called lost
    recall_gone      of the rows gone, those called lost
    false_alarms     of the rows visible and near, those called lost
    tracked_near     of the rows called tracked, those near
    tracked_visible_near  of the rows called tracked and visible in truth, those near
    delay_lost       from a part's being covered until it is called lost: median over the spans in which it is
    delay_back       from a part's return until it is tracked and near: median over the spans after which it is

    `rows` are those with a status, `covered` the hidden and absent of them, `called` those called lost; `spans` are the
    stretches in which a part is covered, `spans_called` those in which it is called lost at all.
    """

    rows: int
    covered: int
    called: int
    precision: Figure
    precision_gone: Figure
    recall: Figure
    recall_gone: Figure
    false_alarms: Figure
    tracked_near: Figure
    tracked_visible_near: Figure
    spans: int
    spans_called: int
    delay_lost: Figure
    delay_back: Figure


@dataclass(frozen=True)
class CalibrationBin:
    """Rows with low <= confidence < high (last bin: <= high), their mean confidence, the shares near and visible."""

    low: float
    high: float
    rows: int
    mean_confidence: Figure
    near: Figure
    visible: Figure


@dataclass(frozen=True)
class ConfidenceMeasures:
    """What `confidence` is worth. It is no probability of being near; these say how far it behaves as one.

    near           share of the rows that are near, whatever their confidence
    auroc_near     chance that a near row has more confidence than one that is not near, ties counting half: 0.5 is
                   worthless, 1 tells them apart by some threshold (area under the ROC curve)
    auroc_visible  the same of visible rows against hidden and absent ones
    ece            expected calibration error: mean over rows of |share near - mean confidence| of their bin
    brier          mean of (confidence - 1 if near else 0) squared
    bins           `BINS` bins of equal width

    `rows` are those with a confidence of which is known whether they are near; absent rows are not.
    """

    rows: int
    near: Figure
    auroc_near: Figure
    auroc_visible: Figure
    ece: Figure
    brier: Figure
    bins: tuple[CalibrationBin, ...]


@dataclass(frozen=True)
class CoverageMeasures:
    """Whether the posterior's spread covers the error: visible rows with known truth, without the first frame's.

    within_50, within_90  share of rows whose true position lies within the 50 and the 90 % ellipse of a normal
                          distribution with std_x and std_y along x and y: 0.5 and 0.9 were the spread right
    factor                by which the std would have to be multiplied for the 50 % ellipse to hold half of the rows
    rows                  rows counted; `zero_std` of them have no spread along x or y, and count as within only if
                          they are exactly right there
    unknown_std           rows left out because they have no std
    """

    rows: int
    within_50: Figure
    within_90: Figure
    factor: Figure
    zero_std: int
    unknown_std: int


@dataclass(frozen=True)
class Trust:
    """How far to trust what a tracker says of itself; None where it says nothing."""

    lost: LostMeasures | None
    confidence: ConfidenceMeasures | None
    coverage: CoverageMeasures | None


def measure_trust(parts: Sequence[Rows]) -> Trust:
    """All rows of one or more parts together."""
    later = [part.take(~part.init) for part in parts]
    return Trust(measure_lost(parts), measure_confidence(later), measure_coverage(later))


def measure_lost(parts: Sequence[Rows]) -> LostMeasures | None:
    """`lost` against the truth; None if no row has a status. Delays are of spans in which no correction helped."""
    by_hand = [part.frame[part.by_hand] for part in parts]
    parts = [part.take(part.told) for part in parts]
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
        delay_lost=float(np.median(until_lost)) if until_lost else None,
        delay_back=float(np.median(until_back)) if until_back else None,
    )


def _any_within(frames: Whole, first: int, last: Whole) -> bool:
    """Whether any frame is from `first` to `last` (1,); False where there is no last."""
    return bool(len(last)) and bool(np.any((frames >= first) & (frames <= last[0])))


def measure_confidence(parts: Sequence[Rows]) -> ConfidenceMeasures | None:
    """What confidence is worth; None if no row has any."""
    confidence, near, judged, visible = (column(parts, name) for name in ("confidence", "near", "judged", "visible"))
    told = np.isfinite(confidence)
    if not told.any():
        return None
    seen = auroc(confidence[told], visible[told])
    rows = told & judged
    confidence, near, visible = confidence[rows], near[rows], visible[rows]
    # scores of other tools need not lie between 0 and 1; then they rank rows, and that is all
    scaled = bool(len(confidence)) and bool(np.all((confidence >= 0) & (confidence <= 1)))
    bins = calibration(confidence, near, visible) if scaled else ()
    return ConfidenceMeasures(
        rows=len(confidence),
        near=float(np.mean(near)) if len(near) else None,
        auroc_near=auroc(confidence, near),
        auroc_visible=seen,
        ece=_calibration_error(bins) if scaled else None,
        brier=float(np.mean((confidence - near) ** 2)) if scaled else None,
        bins=bins,
    )


def measure_coverage(parts: Sequence[Rows]) -> CoverageMeasures | None:
    """Whether the spread covers the error, over visible rows; None if no row has a std."""
    offset, std, visible, placed = (column(parts, name) for name in ("offset", "std", "visible", "placed"))
    counted = visible & placed & np.isfinite(offset).all(axis=1)
    known = np.isfinite(std).all(axis=1)
    if not known.any():
        return None
    offset, spread = offset[counted & known], std[counted & known]
    squared = mahalanobis_squared(offset, spread)
    some = len(squared) > 0
    # the middle row's own distance where their number is odd, as the 50 % ellipse would have to reach it
    factor = math.sqrt(float(np.quantile(squared, 0.5, method="inverted_cdf")) / ELLIPSE_50) if some else math.inf
    return CoverageMeasures(
        rows=len(squared),
        within_50=float(np.mean(squared <= ELLIPSE_50)) if some else None,
        within_90=float(np.mean(squared <= ELLIPSE_90)) if some else None,
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


def auroc(score: Array, positive: Mask) -> Figure:
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
