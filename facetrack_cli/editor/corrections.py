"""Corrections as the page gives them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from facetrack_cli.core.types import BOX, Box, Correction, Point, TargetStart
from facetrack_cli.tracking.corrected import all_or


def merged(
    frame: int,
    target: str,
    box: Box | None,
    points: Mapping[str, Point],
    absent: tuple[str, ...] | Literal[True],
    before: Correction | None,
    parts: tuple[str, ...],
) -> Correction:
    """What was just put right, over the correction that the same frame has already, if any."""
    if absent is True or (parts == (BOX,) and absent):
        return Correction(frame, target, absent=True)
    gone = set(absent)
    if box is not None and (parts == (BOX,) or not points):
        return Correction(frame, target, TargetStart(box=box), absent=absent)
    old = Correction(frame, target) if before is None else before
    by_hand = {part: at for part, at in {**old.given.points, **points}.items() if part not in gone or part in points}
    kept = {part: at for part, at in old.kept.items() if part not in by_hand and part not in gone}
    hidden = [part for part in parts if part in {*gone, *old.hidden(parts)}]
    hidden = [part for part in hidden if part not in by_hand]
    return Correction(frame, target, TargetStart(points=by_hand), kept, all_or(hidden, parts), old.learn)
