"""What of a table is exported: a choice of its targets, lost rows blanked, and one box around the parts of a target."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, TypeAlias, get_args

import numpy as np

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.types import Array
from facetrack_cli.trajectory.trajectory import Trajectory, joined, one_part

Around: TypeAlias = Literal["windows", "points"]
AROUND: tuple[Around, ...] = get_args(Around)


def choose(table: Trajectory, select: str | None) -> Trajectory:
    """The table with one target alone (`face`), or one part of it (`face/nose`); all of it for None.

    Raises UsageError, which lists what there is, when nothing has that name.
    """
    if select is None:
        return table
    found = [one for one in table.parts if select in (one.target, one.name)]
    if not found:
        names = [name for name in table.targets if name] + [one.name for one in table.parts]
        raise UsageError(f"{table.path}: has no {select!r}; choose among {', '.join(names)}")
    diagnostics = {name: one for name, one in table.diagnostics.items() if name == found[0].target}
    return joined(found, header=table.header, diagnostics=diagnostics, path=table.path)


def blank_lost(table: Trajectory) -> Trajectory:
    """The table with the place and size of lost rows not known."""
    lost = table.status == "lost"
    x, y, w, h = (np.where(lost, np.nan, values) for values in (table.x, table.y, table.w, table.h))
    return replace(table, x=x, y=y, w=w, h=h)


def enclose(parts: Sequence[Trajectory], around: Around = "windows") -> Trajectory:
    """One box for each row of a target, as the series of a part `box`: the smallest upright box around its parts.

    A target of one part has that part's own box. Of several, `windows` encloses the windows that the tracker compares,
    as in annotated videos; `points` their centres alone, each as one pixel. Parts whose place is not known in a row are
    left out of it; lost ones count, since their place is the estimate (see `blank_lost`). `confidence` is the mean over
    the parts, `status` lost when all parts are that are not absent. Raises InputError for windows of parts that have
    none.
    """
    if len(parts) == 1:
        return parts[0].renamed(parts[0].target, "box")
    frame = np.unique(np.concatenate([part.frame for part in parts]))
    shape = len(frame), len(parts)
    by_hand = np.zeros(len(frame), dtype=np.bool_)
    edges, confidence = np.full((*shape, 4), np.nan), np.full(shape, np.nan)
    time_s, status = np.full(len(frame), np.nan), np.full(shape, "", dtype="<U8")
    for k, part in enumerate(parts):
        rows = np.searchsorted(frame, part.frame)
        one = replace(part, w=np.ones(len(part)), h=np.ones(len(part))) if around == "points" else part
        sizeless = np.flatnonzero(np.isfinite(one.x) & ~(np.isfinite(one.w) & np.isfinite(one.h)))
        if sizeless.size:
            raise InputError(
                f"{one.name}: frame {one.frame[sizeless[0]]} has no w and h; enclose the points with --box points"
            )
        edges[rows, k, :2] = one.boxes[:, :2]
        edges[rows, k, 2:] = one.boxes[:, :2] + one.boxes[:, 2:]
        confidence[rows, k], status[rows, k] = part.confidence, part.status
        time_s[rows] = np.where(np.isfinite(part.time_s), part.time_s, time_s[rows])
        by_hand[rows] |= part.by_hand
    unknown = ~np.isfinite(edges).all(axis=2)
    low = np.where(unknown[..., None], np.inf, edges[..., :2]).min(axis=1)
    high = np.where(unknown[..., None], -np.inf, edges[..., 2:]).max(axis=1)
    w, h = np.where(unknown.all(axis=1)[:, None], np.nan, high - low).T
    left, top = np.where(np.isfinite(low), low, np.nan).T
    return one_part(
        parts[0].target,
        "box",
        frame,
        time_s=time_s,
        x=left + (w - 1) / 2,
        y=top + (h - 1) / 2,
        w=w,
        h=h,
        confidence=mean(confidence),
        status=_together(status),
        by_hand=by_hand,
    )


def mean(values: Array) -> Array:
    """The mean over the last axis of what is known; nan where nothing is."""
    known = np.isfinite(values)
    count = known.sum(axis=-1)
    return np.where(count > 0, np.where(known, values, 0.0).sum(axis=-1) / np.maximum(count, 1), np.nan)


def _together(status: np.ndarray[tuple[int, ...], np.dtype[np.str_]]) -> list[str]:
    """What the statuses of parts (T, K) say of their target: what all agree on, else that it is there.

    In a trajectory, parts that are absent have no say as long as others are there.
    """
    found = []
    for row in status.tolist():
        said = {one for one in row if one}
        if said & {"tracked", "init", "lost"}:
            said.discard("absent")
        found.append(said.pop() if len(said) == 1 else "tracked" if said & {"tracked", "init", "lost"} else "visible")
        if not any(row):
            found[-1] = ""
    return found
