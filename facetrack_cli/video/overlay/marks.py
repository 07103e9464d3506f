"""The colours and strokes that windows, trails and the status bar are drawn with.

Status shows by form as well as by colour: a dot where tracked, a cross where lost, a hollow diamond at the start, a
filled one where a correction gave it, a dash for what is absent.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array, Image
from facetrack_cli.trajectory.trajectory import Status

Colour = tuple[int, int, int]  # blue, green, red
Points = NDArray[np.int32]

# one a target: after Okabe and Ito, told apart by most colour-blind people, lightened to stand out from video
PALETTE: tuple[Colour, ...] = (
    (255, 205, 80),  # sky blue
    (70, 232, 250),  # yellow
    (160, 225, 40),  # bluish green
    (222, 150, 240),  # reddish purple
    (240, 240, 240),  # white
    (255, 140, 100),  # blue
)
LOST: Colour = (25, 110, 255)  # vermilion
WHITE: Colour = (255, 255, 255)

_SHIFT = 4  # cv2's fixed point: sixteenths of a pixel
_CROSS = np.array([[(-1, -1), (1, 1)], [(-1, 1), (1, -1)]])
_DASH = np.array([[(-1, 0), (1, 0)]])
_DIAMOND = 1.2 * np.array([[(0, -1), (1, 0), (0, 1), (-1, 0), (0, -1)]])


def fixed(points: Array) -> Points:
    """Pixels as cv2's fixed point numbers, any shape (..., 2)."""
    return np.rint(points * (1 << _SHIFT)).astype(np.int32)


def ink(colour: Colour, opacity: float) -> tuple[float, float, float, float]:
    """`colour` for a layer of four channels: times its opacity 0..1, and the opacity as 0..255."""
    return colour[0] * opacity, colour[1] * opacity, colour[2] * opacity, 255 * opacity


def polylines(
    image: Image, lines: Sequence[Points], colour: tuple[float, ...], thickness: int, *, closed: bool = False
) -> None:
    """Smooth lines through `lines`, each (n, 2) from `fixed`, drawn on `image` (H, W, 3 or 4) in place."""
    if len(lines):
        cv2.polylines(image, lines, closed, colour, thickness, cv2.LINE_AA, _SHIFT)


def dashes(corners: Array, pitch: float) -> Array:
    """A polygon's outline (n, 2) as dashes (m, 2, 2) about `pitch` pixels apart, one at either end of every side."""
    sides = np.roll(corners, -1, axis=0) - corners
    longest = float(np.hypot(sides[:, 0], sides[:, 1]).max())
    n = min(max(2, round(longest / pitch) + 1), 40)
    ends = np.arange(2 * n).reshape(n, 2) / (2 * n - 1)
    dashed: Array = corners[:, None, None] + ends[..., None] * sides[:, None, None]
    return dashed.reshape(-1, 2, 2)


def mark(
    image: Image,
    at: tuple[float, float],
    status: Status,
    colour: tuple[float, ...],
    size: float,
    line: int,
    by_hand: bool,
) -> None:
    """The sign of `status` at (x, y), about `size` pixels to each side, with lines `line` wide, in place."""
    if status == "tracked":
        x, y, radius = (round(value * (1 << _SHIFT)) for value in (*at, size))
        cv2.circle(image, (x, y), radius, colour, -1, cv2.LINE_AA, _SHIFT)
    else:
        shape = {"lost": _CROSS, "absent": _DASH}.get(status, _DIAMOND)
        strokes = list(fixed(size * shape + at))
        if by_hand and status == "init":
            cv2.fillPoly(image, strokes, colour, cv2.LINE_AA, _SHIFT)
        polylines(image, strokes, colour, line)
