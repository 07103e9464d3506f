"""Corrections as a page or an init file gives them, completed by where the other parts were."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

from facetrack_cli.core.types import BOX, Box, Correction, Point, TargetStart
from facetrack_cli.tracking.corrected import is_complete


def completed(correction: Correction, target: Mapping[str, Any]) -> Correction:
    """With what it does not speak of kept where the `target`'s object of that frame has it; absent as it was there."""
    parts = tuple(part["part"] for part in target["parts"])
    if is_complete(correction, parts):
        return correction
    assert correction.absent is not True
    spoken = {*correction.given.points, *correction.kept, *correction.absent}
    kept, absent = dict(correction.kept), list(correction.absent)
    for part in target["parts"]:
        name = part["part"]
        if name in spoken:
            continue
        if part["status"] == "absent" or "x" not in part or "y" not in part:
            absent.append(name)
        else:
            kept[name] = float(part["x"]), float(part["y"])
    return replace(correction, kept=kept, absent=_all(absent, parts))


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
    return Correction(frame, target, TargetStart(points=by_hand), kept, _all(hidden, parts), old.learn)


def _all(absent: list[str], parts: tuple[str, ...]) -> tuple[str, ...] | Literal[True]:
    return True if set(absent) >= set(parts) else tuple(absent)
