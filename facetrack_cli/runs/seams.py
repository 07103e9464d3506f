"""Where two pieces of a clip meet: whether they agree over the frames that both have, and whose rows are taken.

Two tracks of a target agree in a frame if its boxes overlap by half (intersection over union), and its points are, in
the mean, apart by at most half the distance between the eyes; of faces whose eyes are not followed half the largest
distance between two points, of a single point half the width of its window. Pieces agree if every target does, in
`SHARE` of the frames that both have. None of this is in the papers.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from itertools import count
from typing import Any, Final, NamedTuple

import numpy as np

from facetrack_cli.core.geometry import iou
from facetrack_cli.core.types import BOX, Array, Mask
from facetrack_cli.trajectory.select import choose
from facetrack_cli.trajectory.trajectory import Trajectory

OVERLAP: Final = 0.5  # of boxes, intersection over union
APART: Final = 0.5  # mean distance of points, in sizes of their shape
SHARE: Final = 0.8  # of the frames that both have, in which they must agree
_SAME: Final = 0.5  # of those frames, in which tracks of several faces agree if they are of one face
_EYES: Final = ("eye_left", "eye_right")


class Seam(NamedTuple):
    """Where the rows of a later piece begin; `agreement`: the share of frames in which both agree, None without any."""

    frame: int
    agreement: float | None
    agrees: bool

    def record(self) -> dict[str, Any]:
        return self._asdict() | {"agreement": None if self.agreement is None else round(self.agreement, 4)}


class Meeting(NamedTuple):
    """A seam; `names` are those that targets of the later piece take, `begun` those of them that begin there."""

    seam: Seam
    names: dict[str, str]
    begun: frozenset[str]


def meet(earlier: Trajectory, later: Trajectory, taken: Collection[str], *, matched: bool) -> Meeting:
    """How the rows of two pieces meet, in the middle of the frames that both have.

    `matched`: targets have the names of those that they agree with, others a name that is not `taken`; else names stay.
    """
    both = np.intersect1d(earlier.frames, later.frames)
    if not len(both):
        names = _named(later, {}, taken) if matched else {name: name for name in later.targets}
        return Meeting(Seam(int(later.frames[0]), None, False), names, frozenset(names.values()))
    first, stop = int(both[0]), int(both[-1]) + 1
    a, b = earlier.between(first, stop), later.between(first, stop)
    shares: dict[tuple[str, str], float] = {}
    for ours in a.targets:
        for theirs in b.targets:
            if matched or ours == theirs:
                fine = agreeing(choose(a, ours), choose(b, theirs))
                shares[ours, theirs] = float(fine.mean()) if len(fine) else 0.0
    pairs: dict[str, str] = {}
    for (ours, theirs), share in sorted(shares.items(), key=lambda one: -one[1]):
        if ours not in pairs.values() and theirs not in pairs and (share >= _SAME or not matched):
            pairs[theirs] = ours
    found = {ours: shares[ours, theirs] for theirs, ours in pairs.items()}
    # of several faces one that is lost all the while may have left
    there = [name for name in a.targets if not matched or (choose(a, name).status != "lost").any()]
    agreement = min((found.get(name, 0.0) for name in there), default=0.0)
    names = _named(later, pairs, taken)
    seam = Seam(int(both[len(both) // 2]), agreement, agreement >= SHARE)
    return Meeting(seam, names, frozenset(names[name] for name in later.targets if name not in pairs))


def renamed(rows: Trajectory, names: Mapping[str, str]) -> Trajectory:
    """The rows, each target under its name in `names`."""
    diagnostics = {names[target]: one for target, one in rows.diagnostics.items()}
    return replace(rows, names=tuple((names[target], part) for target, part in rows.names), diagnostics=diagnostics)


def agreeing(ours: Trajectory, theirs: Trajectory) -> Mask:
    """(T,) whether two tracks of one target agree, of the T frames of both in which either shows a part that both have.

    A part that one of them alone shows is in another place.
    """
    frames = np.intersect1d(ours.frames, theirs.frames)
    fine, known = np.ones(len(frames), bool), np.zeros(len(frames), bool)
    points: list[tuple[str, Trajectory]] = []
    apart: list[Array] = []
    for one in ours.parts:
        if (other := next((part for part in theirs.parts if part.part == one.part), None)) is None:
            continue
        a, b = one.take(np.isin(one.frame, frames)), other.take(np.isin(other.frame, frames))
        shown = np.isfinite(a.x), np.isfinite(b.x)
        known |= shown[0] | shown[1]
        fine &= shown[0] == shown[1]
        if one.part == BOX:
            fine &= ~(iou(a.boxes, b.boxes) < OVERLAP)
        else:
            points.append((one.part, a))
            apart.append(np.hypot(a.x - b.x, a.y - b.y))
    if points:
        distance = np.stack(apart)
        many = np.isfinite(distance).sum(axis=0)
        mean = np.nansum(distance, axis=0) / np.maximum(many, 1)
        fine &= ~(mean > APART * _size(points))
    found: Mask = fine[known]
    return found


def _size(points: list[tuple[str, Trajectory]]) -> Array:
    """(T,) the size of a shape in pixels; nan where it is not known."""
    places = {part: np.stack([rows.x, rows.y], axis=1) for part, rows in points}
    if all(eye in places for eye in _EYES):
        return np.asarray(np.hypot(*(places[_EYES[0]] - places[_EYES[1]]).T))
    if len(points) == 1:
        return points[0][1].w
    each = np.stack([*places.values()])
    between = np.hypot(*np.moveaxis(each[:, None] - each[None], -1, 0))
    return np.asarray(np.fmax.reduce(between, axis=(0, 1)))


def _named(later: Trajectory, pairs: Mapping[str, str], taken: Collection[str]) -> dict[str, str]:
    """What the targets of a later piece are called: as those they are, else by a name that nobody has."""
    names, given = dict(pairs), {*taken, *pairs.values()}
    for target in later.targets:
        if target not in names:
            stem = target.rstrip("0123456789").rstrip("_")
            free = (name for i in count(1) if (name := f"{stem}_{i}" if i > 1 else stem) not in given)
            names[target] = next(free)
            given.add(names[target])
    return names
