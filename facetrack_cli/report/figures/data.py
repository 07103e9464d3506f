"""Columns made ready for drawing: gaps, envelopes of long ones, spans, quantiles. Arrays alone, without matplotlib."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from facetrack_cli.core.types import Array, Mask, Whole

Span = tuple[float, float]


def stacked(series: Sequence[tuple[Whole, Array | Mask]]) -> tuple[Whole, Array]:
    """All (T,) frames of K series, increasing, and their values (K, T), nan where a series does not have the frame."""
    frame = series[0][0]
    if not all(f is frame or np.array_equal(f, frame) for f, _ in series):  # nearly always they are all the same
        frame = np.unique(np.concatenate([f for f, _ in series]))
    values = np.full((len(series), len(frame)), np.nan)
    for row, (f, value) in zip(values, series, strict=True):
        row[slice(None) if len(f) == len(frame) else np.searchsorted(frame, f)] = value
    return frame, values


class Drawn(NamedTuple):
    """A line to draw: (x, y) with nan wherever it is broken; if it was thinned, the (x, y) of its means too."""

    x: Array
    y: Array
    means: tuple[Array, Array] | None = None


def envelope(frame: Whole, value: Array, bins: int) -> Drawn:
    """A line through (T,) values, broken where a value is not known and where frames are missing.

    A series with more than two rows to a bin is thinned: drawn by the least and the greatest value in each of `bins`
    equal spans of frames, so that no peak is lost, and by their means.
    """
    known = np.flatnonzero(np.isfinite(value))
    if not known.size:
        return Drawn(np.full(1, np.nan), np.full(1, np.nan))
    reach = 1.5 * _step(frame)
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
    return Drawn(*_broken(x, y, 2 * gaps), means)


def _broken(x: Array, y: Array, before: Whole) -> tuple[Array, Array]:
    return np.insert(x, before, np.nan), np.insert(y, before, np.nan)


def _step(frame: Whole) -> int:
    """The usual step between rows: 1, or n of a series with every n-th frame."""
    return int(np.median(np.diff(frame))) if len(frame) > 1 else 1


def alone(y: Array) -> Mask:
    """(T,) the points of a line that have no neighbour: they need a mark to be seen."""
    known = np.isfinite(np.concatenate([[np.nan], y, [np.nan]]))
    lonely: Mask = known[1:-1] & ~known[:-2] & ~known[2:]
    return lonely


def spans(frame: Whole, mask: Mask, least: float = 0.0) -> list[Span]:
    """(start, end) of each stretch of rows where `mask` holds, each row half a step wide to either side.

    Stretches less than `least` frames apart become one, and each is at least `least` frames wide, so that a single
    frame of a long clip is still seen.
    """
    if not mask.any():
        return []
    step, f = _step(frame), frame[mask].astype(np.float64)
    # a stretch ends where the mask does, and where frames are missing
    ends = np.flatnonzero((np.diff(np.flatnonzero(mask)) > 1) | (np.diff(f) > 1.5 * step))
    starts, stops = f[np.append(0, ends + 1)] - step / 2, f[np.append(ends, len(f) - 1)] + step / 2
    wide = np.maximum(least - (stops - starts), 0) / 2
    found: list[Span] = []
    for start, end in zip((starts - wide).tolist(), (stops + wide).tolist(), strict=True):
        if found and start - found[-1][1] <= least * (1 - 1e-9):
            found[-1] = (found[-1][0], end)
        else:
            found.append((start, end))
    return found


def quantiles(values: Array, shares: Iterable[float]) -> list[Array]:
    """Quantiles of (K, T) along K, of the values that are known: (T,) for each share; nan where none is.

    As numpy.nanquantile, which is a hundred times slower.
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
