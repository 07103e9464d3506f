"""Series made ready for drawing: gaps, envelopes of long ones, spans, limits. Arrays alone, nothing of matplotlib."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from facetrack_cli.core.spans import spans, union
from facetrack_cli.core.types import Array, Mask, Whole

Span = tuple[float, float]


def frames_of(series: Sequence[Whole]) -> Whole:
    """All frames of any series, increasing; quick where all have the same, as they nearly always do."""
    first = series[0]
    if all(frame is first or np.array_equal(frame, first) for frame in series):
        return first
    return np.unique(np.concatenate(series))


def usual_step(frame: Whole) -> int:
    """The step between the rows of a series: 1, or that of a series with every n-th frame."""
    return int(np.median(np.diff(frame))) if len(frame) > 1 else 1


class Drawn(NamedTuple):
    """A line to draw: (x, y) with nan wherever it is broken, and if it was thinned its means (x, y) beside."""

    x: Array
    y: Array
    mean_x: Array | None = None
    mean_y: Array | None = None


def envelope(frame: Whole, value: Array, bins: int) -> Drawn:
    """A line through (T,) values, broken where a value is not known and where frames are missing.

    A series with more rows than two to a bin is thinned: drawn by the least and the greatest value in each of `bins`
    equal spans of frames, so that no peak is lost, and by their means.
    """
    known = np.flatnonzero(np.isfinite(value))
    if not known.size:
        return Drawn(np.full(1, np.nan), np.full(1, np.nan))
    reach = 1.5 * usual_step(frame)
    f, v = frame[known].astype(np.float64), value[known].astype(np.float64)
    if len(frame) <= 2 * bins:
        return Drawn(*_broken(f, v, np.flatnonzero(np.diff(f) > reach) + 1))
    span = (frame[-1] - frame[0] + 1) / bins
    place = ((f - frame[0]) / span).astype(np.int64)
    first = np.flatnonzero(np.diff(place, prepend=-1))
    last = np.append(first[1:], len(f)) - 1
    low, high = np.minimum.reduceat(v, first), np.maximum.reduceat(v, first)
    rising = v[last] >= v[first]
    y = np.stack([np.where(rising, low, high), np.where(rising, high, low)], axis=1).ravel()
    x = np.stack([f[first], f[last]], axis=1).ravel()
    gaps = np.flatnonzero(f[first[1:]] - f[last[:-1]] > reach) + 1
    means = _broken((f[first] + f[last]) / 2, np.add.reduceat(v, first) / (last - first + 1), gaps)
    return Drawn(*_broken(x, y, 2 * gaps), *means)


def _broken(x: Array, y: Array, before: Whole) -> tuple[Array, Array]:
    return np.insert(x, before, np.nan), np.insert(y, before, np.nan)


def alone(y: Array) -> Mask:
    """Points of a line that have no neighbour: nothing of them would show without a mark."""
    known = np.isfinite(y)
    beside = np.zeros(len(y), dtype=np.bool_)
    beside[1:] |= known[:-1]
    beside[:-1] |= known[1:]
    lonely: Mask = known & ~beside
    return lonely


def frame_spans(frame: Whole, mask: Mask, least: float = 0.0) -> list[Span]:
    """(start, end) of each span of rows where `mask` holds, each row half a step wide to either side.

    Spans less than `least` frames apart become one, and each is at least `least` frames wide, so that a single frame of
    a long clip is still seen.
    """
    if not mask.any():
        return []
    half = usual_step(frame) / 2
    begins, ends = np.array(spans(mask, np.diff(frame) > 3 * half)).T  # missing frames end a span, too
    starts, stops = frame[begins] - half, frame[ends - 1] + half
    wide = np.maximum(least - (stops - starts), 0) / 2
    return union(zip((starts - wide).tolist(), (stops + wide).tolist(), strict=True), least * (1 - 1e-9))


def quantiles(values: Array, shares: Iterable[float]) -> list[Array]:
    """Quantiles of (K, T) along K, of those that are known: (T,) for each share; nan where none is.

    As numpy.nanquantile, which takes minutes where this takes a second.
    """
    ordered = np.sort(values, axis=0)  # nan goes to the end
    count = np.isfinite(ordered).sum(axis=0)
    columns = np.arange(values.shape[1])
    found = []
    for share in shares:
        at = share * np.maximum(count - 1, 0)
        low = np.floor(at).astype(np.int64)
        high = np.minimum(low + 1, np.maximum(count - 1, 0))
        below, above = ordered[low, columns], ordered[high, columns]
        found.append(np.asarray(below + (at - low) * (above - below), dtype=np.float64))
    return found


def limits(values: Iterable[Array], *, floor: float | None = None, least: float = 1.0) -> tuple[float, float] | None:
    """Limits of an axis that holds `values`, a little wider; at least `least` apart. None where nothing is known.

    A few rows far outside, such as those of a part that ran away for a moment, do not press all others flat: where the
    whole is more than eight times as tall as the middle 98 % of the rows, the limits follow the middle.
    """
    every = np.concatenate([v[np.isfinite(v)] for v in values] or [np.empty(0)])
    if not every.size:
        return None
    low, high = float(every.min()), float(every.max())
    middle = np.quantile(every[:: max(1, len(every) // 500_000)], (0.01, 0.99))
    tall = max(float(middle[1] - middle[0]), least)
    if high - low > 8 * tall:
        low, high = max(low, float(middle[0]) - tall), min(high, float(middle[1]) + tall)
    if floor is not None:
        low = floor
    short = max(least - (high - low), 0) / 2
    low, high = (low - short, high + short) if floor is None else (low, high + 2 * short)
    margin = 0.06 * (high - low)
    return (low - margin if floor is None else low), high + margin


def beyond(y: Array, low: float, high: float) -> tuple[Mask, Mask]:
    """Points of a line (below `low`, above `high`): where the axis ends before them."""
    with np.errstate(invalid="ignore"):
        return y < low, y > high
