"""The length in pixels by which errors are normalised, from the ground truth.

size     the largest distance between two points of the target, in the first frame with all of them: the unit of
         recipes. Of a box sqrt(width * height), in each frame. The default.
A:B      the distance between two parts, in each frame
mouth    mouth_left:mouth_right
eyes     eye_left:eye_right, or the outer corners of the eyes of a face of 68 points
NUMBER   so many pixels
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from facetrack_cli.core.errors import UsageError
from facetrack_cli.core.geometry import size_of_points
from facetrack_cli.core.types import Array, Whole
from facetrack_cli.trajectory.trajectory import Trajectory

# names of the two parts, tried in this order
NAMED = {"mouth": (("mouth_left", "mouth_right"),), "eyes": (("eye_left", "eye_right"), ("point_37", "point_46"))}


@dataclass(frozen=True, eq=False)
class Unit:
    """The length of one target: (F,) pixels, nan where unknown, for increasing frames (F,); `text` explains it."""

    frame: Whole
    length: Array
    text: str

    def at(self, frames: Whole) -> Array:
        """(R,) lengths for frames (R,); nan where there is none."""
        return _at(frames, self.frame, self.length)


def _at(frames: Whole, known: Whole, values: Array) -> Array:
    """(R,) values (F,) of the increasing frames `known` (F,) at `frames` (R,); nan for frames that are not there."""
    if not len(known):
        return np.full(len(frames), np.nan)
    place = np.searchsorted(known, frames).clip(max=len(known) - 1)
    return np.where(known[place] == frames, values[place], np.nan)


def check_normalise(how: str) -> str:
    """`how`, if it is one of the ways above. Raises UsageError."""
    parts = how.split(":")
    if how == "size" or how in NAMED or (len(parts) == 2 and all(parts) and parts[0] != parts[1]):
        return how
    try:
        pixels = float(how)
    except ValueError:
        pixels = math.nan
    if not 0 < pixels < math.inf:
        raise UsageError(
            f"--normalise {how!r}: give size, mouth, eyes, two parts as nose:mouth_left, or a number of pixels above 0"
        )
    return how


def unit_of(how: str, truth: Sequence[Trajectory], *, box: bool, frames: Whole) -> Unit:
    """The length of one target, whose ground truth is `truth`, for increasing `frames` (F,).

    Raises UsageError where the ground truth does not have the two parts that `how` names.
    """
    one = truth[0]
    if how in NAMED or ":" in how:
        one, other = _pair(how, truth)
        ends = [np.stack([_at(frames, s.frame, s.x), _at(frames, s.frame, s.y)]) for s in (one, other)]
        length, what = np.hypot(*(ends[0] - ends[1])), f"{one.part} to {other.part}"
    elif how == "size" and box:
        length, what = _at(frames, one.frame, np.sqrt(np.maximum(one.w * one.h, 0))), "size, sqrt(width * height)"
    else:
        size, text = _size(truth, frames) if how == "size" else (float(how), f"{float(how):g} px")
        return Unit(frames, np.full(len(frames), size), text)
    length = np.where(length > 0, length, np.nan)
    known = length[np.isfinite(length)]
    typical = f"median {np.median(known):.1f} px" if len(known) else "not known in any"
    return Unit(frames, length, f"{what} in each frame, {typical}")


def _pair(how: str, truth: Sequence[Trajectory]) -> tuple[Trajectory, Trajectory]:
    """The two parts that `how` names."""
    wanted = NAMED.get(how) or (tuple(how.split(":")),)
    there = {s.part: s for s in truth}
    for one, other in wanted:
        if one in there and other in there:
            return there[one], there[other]
    missing = " or ".join(" and ".join(part for part in names if part not in there) for names in wanted)
    names = ", ".join(list(there)[:8]) + (", ..." if len(there) > 8 else "")
    raise UsageError(f"--normalise {how}: the truth has no {missing}; it has {names}")


def _size(truth: Sequence[Trajectory], frames: Whole) -> tuple[float, str]:
    """The unit of recipes and what it is; nan if there is none."""
    if len(truth) < 2:
        return math.nan, "size: one point has none"
    absent = [_at(frames, s.frame, np.where(s.status == "absent", np.nan, 0.0)) for s in truth]
    axes = [[_at(frames, s.frame, axis) for axis in (s.x, s.y)] for s in truth]
    points = np.array(axes) + np.array(absent)[:, None]  # (K, 2, F)
    together = np.flatnonzero(np.isfinite(points).all(axis=(0, 1)))
    if not together.size:
        return math.nan, "size: no frame of the truth has all points"
    size = size_of_points(points[:, :, together[0]])
    if size == 0:
        return math.nan, "size: all points of the truth are at one place"
    first = frames[together[0]]
    return size, f"size, the largest distance between two points in frame {first}, {size:.1f} px"
