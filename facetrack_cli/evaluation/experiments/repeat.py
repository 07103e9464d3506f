"""How far the runs of one recipe differ from seed to seed, and where they part ways.

    spread = spread_of("face", "nose", seeds, frames, positions, limit=12.0)
    spread.std[:, 0], spread.parting, spread.groups

Axes: S runs, T frames; positions (S, T, 2) are a part's centres in pixels, x before y.

*Parting.* At every frame the crowd is all runs, as long as each is within `limit` of their median. Otherwise it is the
largest set of runs within `limit` of one of them (of equal ones the one that shares most with the crowd of the frame
before), and a run is *away* when it is farther than `limit` from the crowd's median. So runs that fall into two halves
are told apart too, where the median of all would lie between them. A run *leaves* at the first of `HOLD` frames in a
row in which it is away, and is back at the first of as many in which it is not. The part's runs *part ways* at the
frame at which the first of them leaves. Medians are taken along x and along y.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.geometry import size_of_points
from facetrack_cli.core.types import Array, Mask, Whole
from facetrack_cli.evaluation.match import match
from facetrack_cli.trajectory.trajectory import Trajectory

HOLD = 5  # frames in a row that make leaving, or coming back, more than an excursion
FRACTION = 0.25  # of the target's size: the default limit


@dataclass(frozen=True)
class Leave:
    """A run that leaves the crowd: its seed, source frames, and how far it got from the crowd's median in pixels."""

    seed: int
    frame: int
    back: int | None  # None: it never came back
    farthest: float


@dataclass(frozen=True)
class Group:
    """Runs that end at one place: their seeds, the mean centre, and the mean error to the ground truth, if any."""

    seeds: tuple[int, ...]
    x: float
    y: float
    error: float | None = None


@dataclass(frozen=True, eq=False)
class Spread:
    """One part over all runs. `std` has n - 1 below the sum; `from_median` (T,) is the farthest run from the median.

    `away` (S, T) says which runs are outside the crowd, `to_crowd` (S, T) how far each is from its median; pixels.
    """

    target: str
    part: str
    seeds: tuple[int, ...]
    frame: Whole
    mean: Array  # (T, 2)
    std: Array  # (T, 2)
    from_median: Array
    to_crowd: Array
    away: Mask
    limit: float
    leaves: tuple[Leave, ...] = ()
    groups: tuple[Group, ...] = field(default=())

    @property
    def name(self) -> str:
        return f"{self.target}/{self.part}"

    @property
    def identical(self) -> bool:
        """Whether no run differs from another at any frame."""
        return not (self.from_median.any() or self.away.any())

    @property
    def parting(self) -> int | None:
        """The source frame at which the first run leaves."""
        return min((leave.frame for leave in self.leaves), default=None)

    @property
    def spread(self) -> Array:
        """(T,): the standard deviation of both axes together, sqrt(std_x^2 + std_y^2)."""
        return np.asarray(np.hypot(self.std[:, 0], self.std[:, 1]), dtype=np.float64)


def target_size(tables: Sequence[Trajectory], target: str) -> float:
    """The target's size in its first frame, in pixels, as recipes measure lengths.

    The largest distance between two parts; of a single part the root of its box's area. 1.0 where neither is known.
    """
    parts = [s for s in tables[0].parts if s.target == target and len(s)]
    first = np.array([(s.x[0], s.y[0]) for s in parts])
    if len(parts) > 1:
        size = size_of_points(first)
    else:
        size = float(np.sqrt(parts[0].w[0] * parts[0].h[0])) if parts else float("nan")
    return size if np.isfinite(size) and size > 0 else 1.0


def spreads(
    seeds: Sequence[int], tables: Sequence[Trajectory], fraction: float = FRACTION, truth: Sequence[Trajectory] = ()
) -> tuple[Spread, ...]:
    """The spread of every part over the runs `tables`, one a seed; `truth`: as `matched` returns it.

    Runs that were cut short count as far as all of them go.
    """
    known = {(one.target, one.part): one for one in truth}
    found = []
    for first in tables[0].parts:
        name = (first.target, first.part)
        runs = [one for table in tables if (one := table.find(*name)) is not None]
        frames = runs[0].frame
        for one in runs[1:]:
            frames = np.intersect1d(frames, one.frame, assume_unique=True)
        kept = [one.take(np.isin(one.frame, frames)) for one in runs]
        positions = np.stack([np.stack([one.x, one.y], axis=1) for one in kept])
        limit = fraction * target_size(tables, first.target)
        found.append(spread_of(*name, seeds, frames, positions, limit, _truth_at(known.get(name), frames)))
    return tuple(found)


def matched(table: Trajectory, truth: Trajectory | None) -> list[Trajectory]:
    """The parts of the ground truth under the names of a run's."""
    pairs = [] if truth is None else match(table, truth, partial=True, select=None, check_shift=False)
    return [pair.truth.renamed(pair.ours.target, pair.ours.part) for pair in pairs]


def _truth_at(truth: Trajectory | None, frames: Whole) -> Array | None:
    """(T, 2): the true centres in these frames, nan where they are not known."""
    if truth is None:
        return None
    out = np.full((len(frames), 2), np.nan)
    _, ours, theirs = np.intersect1d(frames, truth.frame, assume_unique=True, return_indices=True)
    out[ours] = np.stack([truth.x[theirs], truth.y[theirs]], axis=1)
    out[ours[truth.status[theirs] == "absent"]] = np.nan
    return out


def spread_of(
    target: str,
    part: str,
    seeds: Sequence[int],
    frame: Whole,
    positions: Array,
    limit: float,
    truth: Array | None = None,
) -> Spread:
    """The spread of one part: positions (S, T, 2), `limit` in pixels, `truth` (T, 2) where it is known."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a frame without any position is nan, and no news
        mean = np.nanmean(positions, axis=0)
        std = np.nanstd(positions, axis=0, ddof=1) if len(seeds) > 1 else np.zeros_like(mean)
        median = np.nanmedian(positions, axis=0)
        distance = np.hypot(*np.moveaxis(positions - median, 2, 0))  # (S, T)
        from_median = np.nanmax(distance, axis=0, initial=0.0)
    to_crowd, away = _crowds(positions, distance, limit)
    leaves = [
        Leave(
            seed,
            int(frame[first]),
            None if after is None else int(frame[after]),
            float(np.max(np.nan_to_num(to_crowd[s, first:after]), initial=0.0)),
        )
        for s, seed in enumerate(seeds)
        for first, after in stretches(away[s], HOLD)
    ]
    return Spread(
        target=target,
        part=part,
        seeds=tuple(seeds),
        frame=frame,
        mean=mean,
        std=std,
        from_median=from_median,
        to_crowd=to_crowd,
        away=away,
        limit=limit,
        leaves=tuple(sorted(leaves, key=lambda leave: (leave.frame, leave.seed))),
        groups=_groups(seeds, positions[:, -HOLD:], limit, None if truth is None else truth[-HOLD:]),
    )


def stretches(mask: Mask, hold: int) -> list[tuple[int, int | None]]:
    """(first, after) of each time that (T,) `mask` turns true for `hold` places or more, until false for as many.

    `after` is None where it is not false for so long again; what is shorter than `hold`, at the end too, is no stretch.
    """
    found: list[tuple[int, int | None]] = []
    edges = np.flatnonzero(np.diff(mask)) + 1
    bounds = [0, *edges.tolist(), len(mask)]
    inside = False
    for first, after in itertools.pairwise(bounds):
        if after - first < hold or bool(mask[first]) == inside:
            continue
        inside = not inside
        if inside:
            found.append((first, None))
        else:
            found[-1] = (found[-1][0], first)
    return found


def _crowds(positions: Array, distance: Array, limit: float) -> tuple[Array, Mask]:
    """(S, T) distances to the crowd's median and whether a run is away from it; `distance` is to the median of all."""
    to_crowd = distance.copy()
    away = np.zeros(distance.shape, dtype=np.bool_)
    everyone = np.ones(len(positions), dtype=np.bool_)
    before, last = everyone, -2
    # one crowd is the rule, so that only the other frames are looked at one by one; where no run has a position, as of
    # a part that a correction calls absent, none is away from others
    apart = ~(distance <= limit).all(axis=0) & ~np.isnan(distance).all(axis=0)
    for t in np.flatnonzero(apart).tolist():
        crowd = _crowd(positions[:, t], before if last == t - 1 else everyone, limit)
        middle = np.median(positions[crowd, t], axis=0) if crowd.any() else np.full(2, np.nan)
        to_crowd[:, t] = np.hypot(*(positions[:, t] - middle).T)
        away[:, t] = ~(to_crowd[:, t] <= limit)  # a run without a position is away too
        before, last = crowd, t
    return to_crowd, away


def _crowd(points: Array, before: Mask, limit: float) -> Mask:
    """(S,): the largest set of points (S, 2) within `limit` of one of them; of equal ones that most like `before`."""
    apart = np.hypot(*np.moveaxis(points[:, None] - points[None], 2, 0))
    near = apart <= limit
    tightness = -np.where(near, apart, 0.0).sum(axis=1)
    best = np.lexsort((tightness, (near & before).sum(axis=1), near.sum(axis=1)))[-1]
    chosen: NDArray[np.bool_] = near[best]
    return chosen


def _groups(seeds: Sequence[int], last: Array, limit: float, truth: Array | None) -> tuple[Group, ...]:
    """The crowd of the last frames (S, t, 2), then that of the rest, and so on; last come runs without a position."""
    points = np.median(last, axis=1)
    error = None if truth is None else np.hypot(*np.moveaxis(last - truth, 2, 0))  # (S, t)
    left = np.arange(len(seeds))
    found = []
    while left.size:
        crowd = _crowd(points[left], np.ones(left.size, dtype=np.bool_), limit)
        members = left[crowd] if crowd.any() else left
        centre = points[members].mean(axis=0)
        known = error is not None and bool(np.isfinite(error[members]).any())
        wrong = float(np.nanmean(error[members])) if error is not None and known else None
        found.append(Group(tuple(seeds[i] for i in members), float(centre[0]), float(centre[1]), wrong))
        left = np.setdiff1d(left, members)
    return tuple(found)
