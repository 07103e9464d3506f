"""A trajectory beside its ground truth, row by row: the arrays that every measure is computed from.

Axes: R rows of one part, one a frame, in the order of their frames.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from facetrack_cli.core.geometry import iou
from facetrack_cli.core.types import Array, Mask, Whole
from facetrack_cli.trajectory.trajectory import Trajectory

NEAR = 1 / 6  # of the normalising length: a point is near if its error is less
NEAR_IOU = 0.5  # a box is near if its overlap with the ground truth (intersection over union) is more


@dataclass(frozen=True, eq=False)
class Rows:
    """One part against its ground truth; every array is (R,) but `offset` and `std`, which are (R, 2), x before y.

    `offset` is ours minus the ground truth in pixels, nan where either has no position; `unit` the length in pixels by
    which errors are normalised, nan where it is unknown. Each row is one of visible, hidden, absent; `placed` are the
    visible and hidden ones whose true position is known. `near` is defined where `judged`; an absent row is judged, and
    not near. `lost` is defined where `stated`: the status is tracked or lost. `init` are the rows that the tracker was
    given, `later` those of them after the first, by corrections; `left_out` rows that a correction calls absent.
    """

    target: str
    part: str
    frame: Whole
    offset: Array
    unit: Array
    visible: Mask
    hidden: Mask
    absent: Mask
    placed: Mask
    near: Mask
    judged: Mask
    stated: Mask
    lost: Mask
    init: Mask
    later: Mask
    left_out: Mask
    confidence: Array
    std: Array

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
    placed = ~absent & np.isfinite(truth.x) & np.isfinite(truth.y)
    if pair.is_box:  # which is near without a unit too
        near, known = iou(ours.boxes, truth.boxes) > NEAR_IOU, np.isfinite(truth.boxes).all(axis=1)
    else:
        near, known = np.hypot(offset[:, 0], offset[:, 1]) < NEAR * unit, np.isfinite(unit)
    first = np.arange(len(ours)) == 0
    init = ours.status == "init" if np.any(ours.status != "") else first
    return Rows(
        target=ours.target,
        part=ours.part,
        frame=ours.frame,
        offset=offset,
        unit=unit,
        visible=~hidden & ~absent,
        hidden=hidden,
        absent=absent,
        placed=placed,
        near=near & placed & known,
        judged=(placed & known) | absent,
        stated=(ours.status == "tracked") | (ours.status == "lost"),
        lost=ours.status == "lost",
        init=init,
        later=init & ~first,
        left_out=ours.status == "absent",
        confidence=ours.confidence,
        std=np.stack([ours.std_x, ours.std_y], axis=1),
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
        """Whether one of the two is declared a box; the windows of points have sizes too, and are none."""
        return "box" in (self.ours.part, self.truth.part) or self.truth.corners is not None

    @property
    def is_box(self) -> bool:
        """Whether the pair is measured as boxes: one is declared a box, and both have a size in some row."""
        return self.declared_box and all(bool(np.any(np.isfinite(s.w) & np.isfinite(s.h))) for s in self)
