"""A trajectory beside its ground truth: the (R,) rows that are measured, and the lengths that normalise errors."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from facetrack_cli.core.errors import UsageError
from facetrack_cli.core.geometry import iou, size_of_points
from facetrack_cli.core.types import Array, Mask, Whole
from facetrack_cli.trajectory.trajectory import Trajectory

NEAR = 1 / 6  # of the normalising length: a point is near if its error is less
RIGHT = 1 / 4  # of the size: a row is right, as calibration has it, if the error of its centre is less
NEAR_IOU = 0.5  # a box is near if its overlap with the ground truth (intersection over union) is more


@dataclass(frozen=True, eq=False)
class Rows:
    """One part against its ground truth; every array is (R,) but `at`, `offset` and `std`, (R, 2), x before y.

    `cov_xy` is the covariance of the posterior in x and y, 0 where it is not known.

    `at` is our position, `offset` ours minus the ground truth in pixels, nan where either has no position; `unit` the
    length in pixels by which errors are normalised, nan where it is unknown. Each row is one of visible, hidden,
    absent; `placed` are the visible and hidden ones whose true position is known. `near` and `right` are defined where
    `judged`; an absent row is judged, and neither. A box is right by its centre, in sizes of the true one, sqrt(width *
    height). `lost` is defined where `stated`: the status is tracked or lost. `init` are the rows that the tracker was
    given, `later` those of them after the first, by corrections; `left_out` rows that a correction calls absent.
    """

    target: str
    part: str
    frame: Whole
    at: Array
    offset: Array
    unit: Array
    visible: Mask
    hidden: Mask
    absent: Mask
    placed: Mask
    near: Mask
    right: Mask
    judged: Mask
    stated: Mask
    lost: Mask
    init: Mask
    later: Mask
    left_out: Mask
    confidence: Array
    std: Array
    cov_xy: Array

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def covered(self) -> Mask:
        return self.hidden | self.absent

    @property
    def by_hand(self) -> Mask:
        """(R,) given by a correction: a position, or that the part is absent."""
        return self.later | self.left_out

    @property
    def error(self) -> Array:
        """(R,) pixels; nan where the true position is not known, infinite where ours alone is missing."""
        error = np.hypot(self.offset[:, 0], self.offset[:, 1])
        return np.where(self.placed, np.where(np.isnan(error), np.inf, error), np.nan)

    def take(self, rows: Mask) -> Rows:
        """These rows alone."""
        arrays: dict[str, Any] = {key: one[rows] for key, one in vars(self).items() if isinstance(one, np.ndarray)}
        return replace(self, **arrays)


def rows_of(pair: Pair, unit: Array) -> Rows:
    """The rows of a pair, with `unit` (R,) in pixels. A row of ground truth without a status is visible."""
    ours, truth = pair.ours, pair.truth
    hidden, absent = truth.status == "hidden", truth.status == "absent"
    offset = np.stack([ours.x - truth.x, ours.y - truth.y], axis=1)
    error = np.hypot(offset[:, 0], offset[:, 1])
    placed = ~absent & np.isfinite(truth.x) & np.isfinite(truth.y)
    if pair.is_box:  # which is near without a unit too
        near, known = iou(ours.boxes, truth.boxes) > NEAR_IOU, np.isfinite(truth.boxes).all(axis=1)
        size = np.sqrt(np.maximum(truth.w * truth.h, 0))
    else:
        near, known, size = error < NEAR * unit, np.isfinite(unit), unit
    first = np.arange(len(ours)) == 0
    init = ours.status == "init" if np.any(ours.status != "") else first
    return Rows(
        target=ours.target,
        part=ours.part,
        frame=ours.frame,
        at=np.stack([ours.x, ours.y], axis=1),
        offset=offset,
        unit=unit,
        visible=~hidden & ~absent,
        hidden=hidden,
        absent=absent,
        placed=placed,
        near=near & placed & known,
        right=(error < RIGHT * size) & placed & known,
        judged=(placed & known) | absent,
        stated=(ours.status == "tracked") | ours.unseen,
        lost=ours.unseen,
        init=init,
        later=init & ~first,
        left_out=(ours.status == "absent") & ~ours.vanished,
        confidence=ours.confidence,
        std=np.stack([ours.std_x, ours.std_y], axis=1),
        cov_xy=np.nan_to_num(ours.cov_xy),
    )


def column(parts: Iterable[Rows], name: str) -> Any:
    """One column of all parts, end to end."""
    return np.concatenate([getattr(part, name) for part in parts])


class Pair(NamedTuple):
    """One part and its ground truth, row by row: `ours.frame` and `truth.frame` are equal."""

    ours: Trajectory
    truth: Trajectory

    @property
    def declared_box(self) -> bool:
        """Whether ours or the truth is declared a box; a window of a point has a size too and is no box."""
        return "box" in (self.ours.part, self.truth.part) or self.truth.corners is not None

    @property
    def is_box(self) -> bool:
        """Whether the pair is measured as boxes: ours or the truth is declared a box, and both have a size in a row."""
        return self.declared_box and all(bool(np.any(np.isfinite(s.w) & np.isfinite(s.h))) for s in self)


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
        return at(frames, self.frame, self.length)


def at(frames: Whole, known: Whole, values: Array) -> Array:
    """(R, ...) values (F, ...) of the increasing frames `known` (F,) at `frames` (R,); nan for frames not there."""
    found = np.full((len(frames), *values.shape[1:]), np.nan)
    there = np.isin(frames, known)
    found[there] = values[np.searchsorted(known, frames[there])]
    return found


def places(truth: Trajectory, frames: Whole) -> Array:
    """(R, 2) true centres in these frames; nan where they are not known, or the part is absent."""
    centres = np.stack([truth.x, truth.y], axis=1)
    return at(frames, truth.frame, np.where(truth.status[:, None] == "absent", np.nan, centres))


def check_normalise(how: str) -> str:
    """`how`, if it is one of these ways to give the length in pixels by which errors are normalised. Raises UsageError.

    size     the largest distance between two points of the target, in the first frame with all of them: the unit of
             recipes. Of a box sqrt(width * height), in each frame. The default.
    A:B      the distance between two parts, in each frame
    mouth    mouth_left:mouth_right
    eyes     eye_left:eye_right, or the outer corners of the eyes of a face of 68 points
    NUMBER   so many pixels
    """
    parts = how.split(":")
    if how == "size" or how in NAMED or (len(parts) == 2 and all(parts) and parts[0] != parts[1]):
        return how
    try:
        pixels = float(how)
    except ValueError:
        pixels = math.nan
    if not 0 < pixels < math.inf:
        wanted = "size, mouth, eyes, two parts as nose:mouth_left, or a number of pixels above 0"
        raise UsageError(f"--normalise {how!r}: give {wanted}")
    return how


def unit_of(how: str, truth: Sequence[Trajectory], *, box: bool, frames: Whole) -> Unit:
    """The length of a target with ground truth `truth`, for increasing `frames` (F,); UsageError for another `how`."""
    one = truth[0]
    if how in NAMED or ":" in how:
        one, other = _pair(how, truth)
        ends = [np.stack([at(frames, s.frame, s.x), at(frames, s.frame, s.y)]) for s in (one, other)]
        length, what = np.hypot(*(ends[0] - ends[1])), f"{one.part} to {other.part}"
    elif how == "size" and box:
        length, what = at(frames, one.frame, np.sqrt(np.maximum(one.w * one.h, 0))), "size, sqrt(width * height)"
    else:
        size, text = _size(truth, frames) if how == "size" else (float(how), f"{float(how):g} px")
        return Unit(frames, np.full(len(frames), size), text)
    length = np.where(length > 0, length, np.nan)
    known = length[np.isfinite(length)]
    typical = f"median {np.median(known):.1f} px" if len(known) else "not known in any"
    return Unit(frames, length, f"{what} in each frame, {typical}")


def _pair(how: str, truth: Sequence[Trajectory]) -> tuple[Trajectory, Trajectory]:
    wanted = NAMED.get(how) or (tuple(how.split(":")),)
    there = {s.part: s for s in truth}
    for one, other in wanted:
        if one in there and other in there:
            return there[one], there[other]
    missing = " or ".join(" and ".join(part for part in names if part not in there) for names in wanted)
    names = ", ".join(list(there)[:8]) + (", ..." if len(there) > 8 else "")
    raise UsageError(f"--normalise {how}: the ground truth has no {missing}; it has {names}")


def _size(truth: Sequence[Trajectory], frames: Whole) -> tuple[float, str]:
    """The unit of recipes and what it is; nan if there is none."""
    if len(truth) < 2:
        return math.nan, "size: one point has none"
    points = np.stack([places(one, frames) for one in truth])  # (K, F, 2)
    together = np.flatnonzero(np.isfinite(points).all(axis=(0, 2)))
    if not together.size:
        return math.nan, "size: no frame of the ground truth has all points"
    size = size_of_points(points[:, together[0]])
    if size == 0:
        return math.nan, "size: all points of the ground truth are at one place"
    first = frames[together[0]]
    return size, f"size, the largest distance between two points in frame {first}, {size:.1f} px"
