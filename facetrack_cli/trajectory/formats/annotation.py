"""The tracks of annotation tools: one for each part, over all frames, with a box, and whether the part is visible.

Labels are `target/part`, or the target alone for its box. Boxes are measured from the corner of the image, as here; a
pixel's centre is at .5 there, and a whole number here, so that points move by half a pixel.
"""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import shown_angle
from facetrack_cli.core.types import BOX, Array, Texts, Whole
from facetrack_cli.trajectory.reader import MAX_PIXELS
from facetrack_cli.trajectory.trajectory import SEEN, Trajectory, joined, one_part

HALF_PIXEL = 0.5  # the centre of the first pixel is 0 here and 0.5 in the tools


class Track(NamedTuple):
    """One part over consecutive frames: centre `xy` (T, 2), `ltwh` (T, 4) and `state` (T,): `seen`, `lost` or `gone`.

    A part that is gone keeps its last place. `ltwh` of a point may be nan.
    """

    label: str
    part: str
    frame: Whole
    xy: Array
    ltwh: Array
    angle: Array
    state: Texts


def tracks(table: Trajectory) -> Iterator[Track]:
    """Each part from its first place to the last frame of the table; where there is no row, it is gone."""
    last = int(table.frames[-1])
    for one in table.parts:
        known = np.isfinite(one.x) & np.isfinite(one.y)
        if not known.any():
            continue
        rows = np.flatnonzero(known)
        frame = np.arange(one.frame[rows[0]], last + 1)
        at = rows[np.searchsorted(one.frame[rows], frame, side="right") - 1]  # the last row that has a place
        here = one.frame[at] == frame
        state = np.where(here, np.where(np.isin(one.status[at], SEEN), "seen", "lost"), "gone")
        name = one.target or "target"
        label = name if one.part == BOX else f"{name}/{one.part}"
        xy = np.stack([one.x[at], one.y[at]], axis=1)
        angle = shown_angle(one.angle[at], 1 / one.pixel_aspect)  # tools show the pixels of the file as squares
        yield Track(label, one.part, frame, xy, one.boxes[at], angle, state)


def counted(frames: Whole, times: Array, rate: float) -> tuple[Whole, Whole]:
    """Frames (N,), from 1, of a tool whose frame is the player's time x `rate`, and the pictures (N,) that come up.

    `times` (T,) are the seconds of `frames` (T,), nan where pictures have none. Of several pictures in a frame of the
    tool the first counts.
    """
    there = np.where(np.isfinite(times), np.rint(np.round(times * rate, 3)), frames).astype(np.int64) + 1
    numbers, first = np.unique(there, return_index=True)
    return numbers, frames[first]


def named(label: str) -> tuple[str, str]:
    """The target and the part of a label."""
    target, _, part = label.partition("/")
    return target, part or BOX


class Mark(NamedTuple):
    """What a tool says of one part in one frame, in our pixels; `by_hand` marks a keyframe."""

    x: float
    y: float
    w: float = math.nan
    h: float = math.nan
    status: str = "visible"
    by_hand: bool = True
    angle: float = math.nan


def box_mark(place: str, left: Any, top: Any, w: Any, h: Any, **about: Any) -> Mark:
    """The mark of a box. InputError, with its `place` in a file, if it is no box."""
    left, top, w, h = numbers(place, left, top, w, h)
    if w <= 0 or h <= 0:
        raise InputError(f"{place}: the box has no area; remove it, or mark it as not visible")
    return Mark(left + (w - 1) / 2, top + (h - 1) / 2, w, h, **about)


def point_mark(place: str, x: Any, y: Any, **about: Any) -> Mark:
    """The mark of a point in the tool's pixels. InputError, with its `place` in a file, if it is no point."""
    x, y = numbers(place, x, y)
    return Mark(x - HALF_PIXEL, y - HALF_PIXEL, **about)


def numbers(place: str, *given: Any) -> list[float]:
    """Pixels or degrees as numbers. InputError, with their `place` in a file, if they are no numbers."""
    try:
        values = [float(one) for one in given]
    except (TypeError, ValueError, OverflowError):
        values = []
    if not all(abs(value) <= MAX_PIXELS for value in values) or not values:
        raise InputError(f"{place}: {', '.join(map(str, given))} are no pixels; export the file from its tool again")
    return values


def collected(path: Path, found: Mapping[tuple[str, str], Mapping[int, Mark]], read_as: str, shift: int) -> Trajectory:
    """The marks by (target, part) and frame as a trajectory, without places where something is absent."""
    parts = []
    for (target, part), marks in found.items():
        frames = sorted(marks)
        status = np.array([marks[frame].status for frame in frames])
        values = np.array([(*marks[frame][:4], marks[frame].angle) for frame in frames], dtype=np.float64)
        values[status == "absent"] = np.nan
        columns = dict(zip(("x", "y", "w", "h", "angle"), values.T, strict=True))
        by_hand = [marks[frame].by_hand for frame in frames]
        parts.append(one_part(target, part, np.array(frames) + shift, **columns, status=status, by_hand=by_hand))
    if not parts:
        raise InputError(f"{path}: has no track of a box or a point; there is nothing in it to read")
    return joined(parts, header={"read_as": read_as}, path=path)
