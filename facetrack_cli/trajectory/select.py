"""What of a table is exported: a choice of its targets, lost rows blanked, and one box around the parts of a target."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, TypeAlias

import numpy as np

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.types import BOX, Array, Texts
from facetrack_cli.trajectory.trajectory import SEEN, UNSEEN, Trajectory, aligned, joined, one_part

Around: TypeAlias = Literal["windows", "points"]


def choose(table: Trajectory, select: str | None) -> Trajectory:
    """One target alone (`face`), or one part of it (`face/nose`); all for None. UsageError, with the names."""
    if select is None:
        return table
    parts = [part for part in table.parts if select in (part.target, part.name)]
    if not parts:
        names = [name for name in table.targets if name] + [part.name for part in table.parts]
        raise UsageError(f"{table.path}: has no {select!r}; choose among {', '.join(names)}")
    diagnostics = {name: part for name, part in table.diagnostics.items() if name == parts[0].target}
    return joined(parts, header=table.header, diagnostics=diagnostics, path=table.path)


def blank_lost(table: Trajectory) -> Trajectory:
    """The table with the place and size of lost rows not known."""
    lost = table.status == "lost"
    x, y, w, h = (np.where(lost, np.nan, values) for values in (table.x, table.y, table.w, table.h))
    return replace(table, x=x, y=y, w=w, h=h)


def hide_outside(table: Trajectory, size: tuple[int, int]) -> Trajectory:
    """The table in which places beyond the outermost pixels of pictures of `size` (width, height) are hidden."""
    beyond = [(x < 0) | (x > side - 1) for x, side in zip((table.x, table.y), size, strict=True)]
    return replace(
        table, status=np.where(np.isin(table.status, SEEN) & (beyond[0] | beyond[1]), "hidden", table.status)
    )


def enclose(parts: Sequence[Trajectory], around: Around = "windows") -> Trajectory:
    """One box for each row of a target, as the series of a part `box`: the smallest upright box around its parts.

    A target of one part has that part's own box. Of several, `windows` encloses the windows that the tracker compares,
    `points` their centres alone, each as one pixel. Parts whose place is not known in a row are left out of it, and so
    are parts without windows where others have some; lost ones count, since their place is the estimate.
    `confidence` is the mean over the parts, `status` lost when all parts
    are that are not absent. Raises InputError for windows of parts that have none.
    """
    target = parts[0].target
    if len(parts) == 1:
        return parts[0].renamed(target, BOX)
    if around == "points":
        parts = [part for part in parts if part.part != BOX]
        parts = [replace(part, w=np.ones(len(part)), h=np.ones(len(part))) for part in parts]
    parts = list(filter(has_windows, parts)) or parts
    for part in parts:
        if (sizeless := part.frame[np.isfinite(part.x) & ~np.isfinite(part.w + part.h)]).size:
            raise InputError(f"{part.name}: frame {sizeless[0]} has no w and h; enclose the points with --box points")
    frame, columns = aligned(parts, "x", "y", "w", "h", "confidence", "status", "by_hand")
    x, y, w, h, confidence, status, by_hand = columns.values()
    left, top = x - (w - 1) / 2, y - (h - 1) / 2
    finite = np.isfinite(left + top + w + h)
    low = [np.where(finite, edge, np.inf).min(axis=1) for edge in (left, top)]
    high = [np.where(finite, edge, -np.inf).max(axis=1) for edge in (left + w, top + h)]
    left, top, right, bottom = (np.where(finite.any(axis=1), edge, np.nan) for edge in (*low, *high))
    w, h = right - left, bottom - top
    place = {"x": left + (w - 1) / 2, "y": top + (h - 1) / 2, "w": w, "h": h, "confidence": mean(confidence)}
    about = {"status": _together(status), "by_hand": by_hand.any(axis=1), "time_s": joined(parts).times}
    return one_part(target, BOX, frame, **place, **about)


def has_windows(part: Trajectory) -> bool:
    """Whether it has a width and a height: no window follows the eyes of a face."""
    return bool(np.isfinite(part.w + part.h).any())


def mean(values: Array) -> Array:
    """The mean over the last axis of what is known; nan where nothing is."""
    finite = np.isfinite(values)
    count = finite.sum(axis=-1)
    return np.where(count > 0, np.where(finite, values, 0.0).sum(axis=-1) / np.maximum(count, 1), np.nan)


def _together(status: Texts) -> list[str]:
    """What the statuses (T, K) of parts that are not absent agree on, else that their target is there."""
    together = []
    for row in status.tolist():
        states = set(filter(None, row))
        of_tracker = bool(states & {"tracked", "init", "lost"})
        if of_tracker:
            states.discard("absent")
        if states == {*UNSEEN}:
            states.discard("lost")
        together.append(states.pop() if len(states) == 1 else "tracked" if of_tracker else "visible" if states else "")
    return together
