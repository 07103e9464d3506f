"""Whether a trajectory and its truth are rows of different frames under the same numbers.

A file that was cut at its head and renumbered fits the truth at another lag than 0. For each lag the errors of all
visible rows are pooled. A lag is believed if the median error there is far lower than at 0, with the median offset and
without, and if nothing ordinary explains it: a tracker that trails behind, an offset along a straight path, a target at
rest, a motion that repeats itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from facetrack_cli.core.types import Array, Whole
from facetrack_cli.trajectory.trajectory import Trajectory

FARTHEST = 30  # frames that are searched to either side
# chosen on 451 aligned tracks, real and simulated: no false alarm; of those that follow, cut by 12 frames, 4 of 5 found
LOWER = 0.7  # the median error, of that at lag 0
SPREAD_LOWER = 0.5  # the same without the median offset, which a straight path cannot tell from a lag
ROWS_CLOSER = 0.7  # share of the rows that must be closer at the lag
TWIN = 0.5  # the median error, of that at the lag of the other sign
TRAILING, LEADING = 3, 1  # frames that a tracker may be behind or ahead: what differs so little is left to it
LEAST_ROWS = 20
MOST_ROWS = 2_000  # of a part; of more, evenly spaced ones are looked at: they find nearly as many cuts as all do
ROUNDING = 0.05  # pixels: what is smaller is not told apart


class Shift(NamedTuple):
    """Rows fit the truth `lag` frames later: what the trajectory calls t is t + lag in the truth. Medians in pixels."""

    lag: int
    error: float
    error_at_lag: float


def find_shift(pairs: Sequence[tuple[Trajectory, Trajectory]]) -> Shift | None:
    """The lag at which (ours, truth) clearly belong together, or None where 0 is as good, or nothing can be said."""
    tracks = [track for track in (_track(*pair) for pair in pairs) if track is not None]
    rows = sum(len(track.truth) for track in tracks)
    compared = {lag: _compare(tracks, lag) for lag in range(-FARTHEST, FARTHEST + 1) if lag and tracks}
    usable = {lag: one for lag, one in compared.items() if one is not None and 2 * one.rows >= rows}
    if not usable:
        return None
    lag = min(usable, key=lambda one: (usable[one].error, abs(one)))
    best, twin = usable[lag], usable.get(-lag)
    # the first rows of a tracker that trails lie on the truth at lag 0, where it began
    first = np.concatenate([track.first for track in tracks])
    if (
        best.ratio < LOWER
        and best.spread_ratio < SPREAD_LOWER
        and best.closer > ROWS_CLOSER
        and (twin is None or best.error < TWIN * twin.error)
        and not -TRAILING <= lag <= LEADING
        and not (len(first) and np.nanmedian(first) < 0.25 * best.error_at_zero)
    ):
        return Shift(lag, best.error_at_zero, best.error)
    return None


class _Compared(NamedTuple):
    rows: int
    error: float  # median at the lag
    error_at_zero: float  # the lower of the medians at lag 0 over the same truth rows and over the same rows of ours
    ratio: float
    spread_ratio: float
    closer: float  # share of rows


def _compare(tracks: Sequence[_Track], lag: int) -> _Compared | None:
    columns: list[list[Array]] = []
    for track in tracks:
        at_lag, still, at_ours = track.errors(lag)
        known = np.isfinite(at_lag).all(axis=1) & np.isfinite(still).all(axis=1)
        if known.sum() >= 2:
            at_lag, still, at_ours = at_lag[known], still[known], at_ours[known]
            spreads = [offset - np.median(offset, axis=0) for offset in (at_lag, still)]
            columns.append([np.hypot(*offset.T) for offset in (at_lag, still, at_ours, *spreads)])
    if sum(len(distances[0]) for distances in columns) < LEAST_ROWS:
        return None
    there, same_truth, same_ours, spread, spread_at_zero = map(np.concatenate, zip(*columns, strict=True))
    error, at_zero = float(np.median(there)), float(min(np.median(same_truth), np.nanmedian(same_ours)))
    return _Compared(
        len(there),
        error,
        at_zero,
        (error + ROUNDING) / (at_zero + ROUNDING),
        (float(np.median(spread)) + ROUNDING) / (float(np.median(spread_at_zero)) + ROUNDING),
        float(np.mean(there < same_truth)),
    )


class _Track(NamedTuple):
    """One pair: rows of ours with their frames, visible rows of truth with theirs, and the error of the first row."""

    frame: Whole
    ours: Array
    truth_frame: Whole
    truth: Array
    first: Array

    def errors(self, lag: int) -> tuple[Array, Array, Array]:
        """(rows, 2) each: ours less truth at the lag; at 0, the same rows of truth; at 0, the same rows of ours."""
        wanted = self.truth_frame - lag
        moved, still = self._ours_at(wanted), self._ours_at(self.truth_frame)
        between = np.stack([np.interp(wanted, self.truth_frame, axis, np.nan, np.nan) for axis in self.truth.T], axis=1)
        return moved - self.truth, still - self.truth, moved - between

    def _ours_at(self, frames: Whole) -> Array:
        place = np.minimum(np.searchsorted(self.frame, frames), len(self.frame) - 1)
        return np.where((self.frame[place] == frames)[:, None], self.ours[place], np.nan)


def _track(ours: Trajectory, truth: Trajectory) -> _Track | None:
    """None where too little is known."""
    mine, true = (np.stack([one.x, one.y], axis=1) for one in (ours, truth))
    tracked = np.isfinite(mine).all(axis=1) & (ours.status != "lost")
    seen = np.isfinite(true).all(axis=1) & ~np.isin(truth.status, ("hidden", "absent"))
    rows = np.flatnonzero(seen)[:: 1 + int(seen.sum()) // MOST_ROWS]
    if rows.size < 2 or not tracked.any():
        return None
    frame, mine, truth_frame, true = ours.frame[tracked], mine[tracked], truth.frame[rows], true[rows]
    began = np.flatnonzero(truth_frame == frame[0])
    return _Track(frame, mine, truth_frame, true, np.hypot(*(mine[:1] - true[began]).T))
