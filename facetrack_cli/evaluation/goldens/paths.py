"""The path that runs of a tracker took, a band around it, and the first frame at which others leave it.

It is there to be read: what decides is `bands.py`.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from facetrack_cli.core.types import Array, Whole
from facetrack_cli.trajectory.trajectory import Trajectory

HOLD: Final = 3  # frames in a row outside the band that make leaving more than noise
WIDE: Final = 2.5  # times the median distance of runs from their median: three standard deviations of a normal one
LEAST_PX: Final = 0.5
EVERY: Final = 5  # frames that share a reach


@dataclass(frozen=True, eq=False)
class Path:
    """One part's medians over runs, x and y (T,) in pixels, and how far the band reaches around them, a number
    for each EVERY frames. nan where no run has a position.
    """

    series: str
    x: Array
    y: Array
    reach: Array


@dataclass(frozen=True)
class Leave:
    """Where runs leave the path: the source frame, the part, its distance, and the band's reach there; pixels."""

    frame: int
    series: str
    distance: float
    reach: float

    def __str__(self) -> str:
        return (
            f"leaves its path at frame {self.frame}: {self.distance:.1f} px off, "
            f"{self.distance / self.reach:.1f} times the band of {self.reach:.1f} px"
        )


def paths(tables: Sequence[Trajectory]) -> tuple[Path, ...]:
    """The paths of runs over the same frames and parts, in tenths of pixels."""
    found = []
    for i, one in enumerate(tables[0].parts):
        x, y = _medians(tables, i)
        away = np.hypot([t.parts[i].x - x for t in tables], [t.parts[i].y - y for t in tables])
        reach = np.maximum(WIDE * _median(away), LEAST_PX)
        blocks = [reach[a : a + EVERY] for a in range(0, len(reach), EVERY)]
        widest = [float(block[np.isfinite(block)].max(initial=LEAST_PX)) for block in blocks]
        found.append(Path(one.name, np.round(x, 1), np.round(y, 1), np.round(widest, 1)))
    return tuple(found)


def first_leave(recorded: Sequence[Path], tables: Sequence[Trajectory]) -> Leave | None:
    """Where the median of these runs first leaves the band of a path, for HOLD frames in a row; None if it does not."""
    leaves = []
    for i, path in enumerate(recorded):
        x, y = _medians(tables, i)
        distance = np.hypot(x - path.x, y - path.y)
        reach = np.repeat(path.reach, EVERY)[: len(distance)]
        outside = distance > reach
        held = np.convolve(outside, np.ones(HOLD))[HOLD - 1 :] == HOLD
        if held.any():
            at = int(held.argmax())
            frames: Whole = tables[0].parts[i].frame
            leaves.append(Leave(int(frames[at]), path.series, float(distance[at]), float(reach[at])))
    return min(leaves, key=lambda leave: leave.frame, default=None)


def _medians(tables: Sequence[Trajectory], i: int) -> tuple[Array, Array]:
    return _median(np.array([t.parts[i].x for t in tables])), _median(np.array([t.parts[i].y for t in tables]))


def _median(values: Array) -> Array:
    """Over runs (S, T) -> (T,), nan where none has a value."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # no run has one
        return np.asarray(np.nanmedian(values, axis=0))
