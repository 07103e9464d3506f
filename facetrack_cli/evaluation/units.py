"""The length by which errors are normalised, from the truth.

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

    target: str
    frame: Whole
    length: Array
    text: str

    def at(self, frames: Whole) -> Array:
        """(R,) lengths for frames (R,); nan where there is none."""
        if not len(self.frame):
            return np.full(len(frames), np.nan)
        place = np.minimum(np.searchsorted(self.frame, frames), len(self.frame) - 1)
        return np.where(self.frame[place] == frames, self.length[place], np.nan)


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


def unit_of(how: str, target: str, truth: Sequence[Trajectory], *, box: bool, frames: Whole) -> Unit:
    """The length of one target, whose truth is `truth`, for increasing `frames` (F,).

    Raises UsageError where the truth has not the two parts that `how` names.
    """
    if (pair := _pair(how, truth)) is not None:
        one, other = pair
        rows = [np.searchsorted(s.frame, frames).clip(max=len(s) - 1) for s in pair]
        ends = [np.stack([s.x, s.y], axis=1)[r] for s, r in zip(pair, rows, strict=True)]
        there = [s.frame[r] == frames for s, r in zip(pair, rows, strict=True)]
        length = np.where(there[0] & there[1], np.hypot(*(ends[0] - ends[1]).T), np.nan)
        length[length == 0] = np.nan
        return Unit(target, frames, length, f"{one.part} to {other.part} in each frame, {_typical(length)}")
    if how != "size":
        return Unit(target, frames, np.full(len(frames), float(how)), f"{float(how):g} px")
    if box:
        row = np.searchsorted(truth[0].frame, frames).clip(max=len(truth[0]) - 1)
        area = np.where(truth[0].frame[row] == frames, truth[0].w[row] * truth[0].h[row], np.nan)
        length = np.sqrt(np.where(area > 0, area, np.nan))
        return Unit(target, frames, length, f"size, sqrt(width * height) in each frame, {_typical(length)}")
    size, text = _size(truth, frames)
    return Unit(target, frames, np.full(len(frames), size), text)


def _pair(how: str, truth: Sequence[Trajectory]) -> tuple[Trajectory, Trajectory] | None:
    """The two parts that `how` names, None if it names none."""
    wanted = NAMED.get(how) or (((how.split(":")[0], how.split(":")[1]),) if ":" in how else ())
    there = {s.part: s for s in truth}
    for one, other in wanted:
        if one in there and other in there:
            return there[one], there[other]
    if wanted:
        missing = " or ".join(" and ".join(part for part in names if part not in there) for names in wanted)
        names = ", ".join(list(there)[:8]) + (", ..." if len(there) > 8 else "")
        raise UsageError(f"--normalise {how}: the truth has no {missing}; it has {names}")
    return None


def _size(truth: Sequence[Trajectory], frames: Whole) -> tuple[float, str]:
    """The unit of recipes and what it is; nan if there is none."""
    if len(truth) < 2:
        return math.nan, "size: one point has none"
    known = [s.frame[np.isfinite(s.x) & np.isfinite(s.y) & (s.status != "absent")] for s in truth]
    together = frames
    for those in known:
        together = np.intersect1d(together, those, assume_unique=True)
    if not len(together):
        return math.nan, "size: no frame of the truth has all points"
    first = int(together[0])
    rows = [int(np.searchsorted(s.frame, first)) for s in truth]
    size = size_of_points(np.array([(s.x[r], s.y[r]) for s, r in zip(truth, rows, strict=True)]))
    if size == 0:
        return math.nan, "size: all points of the truth are at one place"
    return size, f"size, the largest distance between two points in frame {first}, {size:.1f} px"


def _typical(length: Array) -> str:
    known = length[np.isfinite(length)]
    return f"median {np.median(known):.1f} px" if len(known) else "not known in any"
