"""The path that runs of a tracker took, a band around it, and the first frame at which others leave it.

It is there to be read: what decides is `bands.py`.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from pydantic import BaseModel, ConfigDict

from facetrack_cli.core.types import Array
from facetrack_cli.trajectory.trajectory import Trajectory

HOLD: Final = 3  # frames in a row outside the band that make leaving more than noise
WIDE: Final = 2.5  # times the median distance of runs from their median: three standard deviations of a normal one
LEAST_PX: Final = 0.5
EVERY: Final = 5  # frames that share a reach


class PartPath(BaseModel):
    """The medians of one part over runs, x and y (T,) in pixels, None where no run has a position, and how far the
    band reaches around them, one number for each EVERY frames.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    x: list[float | None]
    y: list[float | None]
    reach: list[float]


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


def paths(tables: Sequence[Trajectory]) -> dict[str, PartPath]:
    """The paths of runs over the same frames and parts, by `target/part`, in tenths of pixels."""
    found = {}
    for i, one in enumerate(tables[0].parts):
        x, y = _medians(tables, i)
        away = np.hypot([t.parts[i].x - x for t in tables], [t.parts[i].y - y for t in tables])
        reach = np.nan_to_num(np.maximum(WIDE * _median(away), LEAST_PX), nan=LEAST_PX)
        widest = np.maximum.reduceat(reach, np.arange(0, len(reach), EVERY))
        mx, my = ([None if np.isnan(v) else v for v in np.round(axis, 1).tolist()] for axis in (x, y))
        found[one.name] = PartPath(x=mx, y=my, reach=np.round(widest, 1).tolist())
    return found


def first_leave(recorded: Mapping[str, PartPath], tables: Sequence[Trajectory]) -> Leave | None:
    """Where the median of these runs first leaves the band of a path, for HOLD frames in a row; None if it does not."""
    leaves = []
    for i, (name, path) in enumerate(recorded.items()):
        x, y = _medians(tables, i)
        distance = np.hypot(x - np.array(path.x, float), y - np.array(path.y, float))
        reach = np.repeat(path.reach, EVERY)[: len(distance)]
        held = np.convolve(distance > reach, np.ones(HOLD))[HOLD - 1 :] == HOLD
        if held.any():
            at = int(held.argmax())
            leaves.append(Leave(int(tables[0].parts[i].frame[at]), name, float(distance[at]), float(reach[at])))
    return min(leaves, key=lambda leave: leave.frame, default=None)


def _medians(tables: Sequence[Trajectory], i: int) -> tuple[Array, Array]:
    return _median(np.array([t.parts[i].x for t in tables])), _median(np.array([t.parts[i].y for t in tables]))


def _median(values: Array) -> Array:
    """Over runs (S, T) -> (T,), nan where none has a value."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # no run has one
        return np.asarray(np.nanmedian(values, axis=0))
