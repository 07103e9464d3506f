"""The colours, strokes and letters that windows, trails and the status bar are drawn with.

Status shows by form as well as by colour: a dot where tracked, a cross where lost, a hollow diamond at the start, a
filled one where a correction gave it, a dash for what is absent. Since `cv2.putText` smears text of 8 px, glyphs are
drawn four times too large at every quarter of a pixel and averaged down, and the crispest is kept.
"""

import math
import unicodedata
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array, Image, Point
from facetrack_cli.trajectory.trajectory import Status

Colour = tuple[int, int, int]  # blue, green, red
Ink = tuple[float, ...]
Points = NDArray[np.int32]
# one a target, or of a single target one a part: after Okabe and Ito, told apart by most colour-blind people,
# lightened to stand out from video
PALETTE: tuple[Colour, ...] = (
    (255, 205, 80),  # sky blue
    (70, 232, 250),  # yellow
    (160, 225, 40),  # bluish green
    (222, 150, 240),  # reddish purple
    (255, 140, 100),  # blue
    (240, 240, 240),  # white
)
LOST: Colour = (25, 110, 255)  # vermilion
WHITE: Colour = (255, 255, 255)
GREY: Colour = (175, 175, 175)  # of a face that is lost
_SHIFT = 4  # cv2's fixed point: sixteenths of a pixel
_CROSS = np.array([[(-1, -1), (1, 1)], [(-1, 1), (1, -1)]])
_DASH = np.array([[(-1, 0), (1, 0)]])
_DIAMOND = 1.2 * np.array([[(0, -1), (1, 0), (0, 1), (-1, 0), (0, -1)]])
_FINER = 4
_FACE = cv2.FONT_HERSHEY_SIMPLEX
_HERSHEY_CAP = 21  # units from baseline to the top of a capital
_OUTLINE_CAP = 20.5  # the same of OpenCV 5, whose letters are outlines: a stroke adds nothing to their height
_KEPT = 256


def fixed(points: Array) -> Points:
    """Pixels as cv2's fixed point numbers, any shape (..., 2)."""
    return np.rint(points * (1 << _SHIFT)).astype(np.int32)


def ink(colour: Colour, opacity: float) -> Ink:
    """`colour` for a layer of four channels: times its opacity 0..1, and the opacity as 0..255."""
    return colour[0] * opacity, colour[1] * opacity, colour[2] * opacity, 255 * opacity


def polylines(image: Image, lines: Sequence[Points], colour: Ink, thickness: int, *, closed: bool = False) -> None:
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


def mark(image: Image, at: Point, status: Status, colour: Ink, size: float, line: int, by_hand: bool) -> None:
    """The sign of `status` at (x, y), about `size` pixels to each side, with lines `line` wide, in place."""
    if status in ("tracked", "hidden"):
        x, y, radius = (round(value * (1 << _SHIFT)) for value in (*at, size))
        cv2.circle(image, (x, y), radius, colour, -1 if status == "tracked" else line, cv2.LINE_AA, _SHIFT)
    else:
        shape = {"lost": _CROSS, "absent": _DASH}.get(status, _DIAMOND)
        strokes = list(fixed(size * shape + at))
        if by_hand and status == "init":
            cv2.fillPoly(image, strokes, colour, cv2.LINE_AA, _SHIFT)
        polylines(image, strokes, colour, line)


class Sprite(NamedTuple):
    """An image to lay over another: its colours times opacity, and 255 minus opacity; (h, w, 3) uint8 each."""

    ink: Image
    keep: Image

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.ink.shape[1], self.ink.shape[0]


def stamp(image: Image, sprite: Sprite, left: int, top: int) -> None:
    """Lay `sprite` over `image` (h, w, 3) in place, its corner at (left, top); what falls outside is cut off."""
    x0, y0 = max(left, 0), max(top, 0)
    x1, y1 = min(left + sprite.ink.shape[1], image.shape[1]), min(top + sprite.ink.shape[0], image.shape[0])
    if x0 >= x1 or y0 >= y1:
        return
    under = image[y0:y1, x0:x1]
    part = np.s_[y0 - top : y1 - top, x0 - left : x1 - left]
    cv2.multiply(under, sprite.keep[part], under, 1 / 255)
    cv2.add(under, sprite.ink[part], under)


def plain(text: str) -> str:
    """`text` in the characters that the Hershey fonts have: accents dropped, the rest as question marks."""
    if text.isascii() and text.isprintable():
        return text
    bare = "".join(c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))
    return "".join(c if c.isascii() and c.isprintable() else "?" for c in bare)


def readable(name: str) -> str:
    """The name of a part or a target as people read it."""
    return name.replace("_", " ")


class Font:
    """One size of type: capitals `cap` pixels high, their tops at row `top` of `height`, and digits of equal width."""

    def __init__(self, cap: int) -> None:
        self.cap = cap
        self.top = math.ceil(0.2 * cap)
        self.height = self.top + cap + math.ceil(0.4 * cap)
        self.sprite = lru_cache(_KEPT)(self._render)
        self.width = lru_cache(_KEPT)(self._width)
        self._glyph = lru_cache(None)(self._draw_glyph)

    def _width(self, text: str) -> int:
        """The width of `text` in pixels."""
        return sum(self._glyph(c).shape[1] for c in plain(text))

    def mask(self, text: str) -> Image:
        """The opacity of `text`, (height, width) uint8."""
        glyphs = [self._glyph(c) for c in plain(text)]
        return np.concatenate(glyphs, axis=1) if glyphs else np.zeros((self.height, 1), np.uint8)

    def passing(self, text: str) -> Sprite:
        """White text that will be another in the next frame, and so is not kept."""
        ink = _grey(self.mask(text))
        return Sprite(ink, np.asarray(cv2.bitwise_not(ink), np.uint8))

    def _render(self, text: str, colour: Colour, halo: int = 0) -> Sprite:
        """Text in `colour` (blue, green, red), with a dark rim of `halo` pixels which widens it on all sides."""
        mask = np.pad(self.mask(text), halo)
        rim = mask
        if halo:
            disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * halo + 1, 2 * halo + 1))
            rim = np.maximum(mask, (0.85 * cv2.dilate(mask, disc)).astype(np.uint8))
        ink = np.round(mask[..., None] * (np.array(colour) / 255)).astype(np.uint8)
        return Sprite(ink, _grey(cv2.bitwise_not(rim)))

    def _draw_glyph(self, char: str) -> Image:
        stroke = max(1, round(_FINER * max(1.1, 0.12 * self.cap)))
        strokes = cv2.__version__.startswith("4.")
        scale = (self.cap * _FINER - stroke) / _HERSHEY_CAP if strokes else self.cap * _FINER / _OUTLINE_CAP
        (wide, _), _ = cv2.getTextSize(char, _FACE, scale, stroke)
        # Hershey sets widely; below 10 px each pixel between letters is needed
        advance = max(2, round(wide / _FINER - max(0.0, 0.08 * (self.cap - 9))))
        if char == " ":
            advance = max(3, round(0.45 * self.cap))
        baseline = (self.top + self.cap) * _FINER - (stroke + 1) // 2 * strokes
        margin = self.cap
        best, sharpest = np.zeros((self.height, advance), np.uint8), -1.0
        for shift in range(_FINER):
            canvas = np.zeros((self.height * _FINER, (advance + 2 * margin) * _FINER), np.uint8)
            at = (margin * _FINER + shift, baseline)
            cv2.putText(canvas, char, at, _FACE, scale, 255, stroke, cv2.LINE_AA)
            small = cv2.resize(canvas, (advance + 2 * margin, self.height), interpolation=cv2.INTER_AREA)
            glyph = small[:, margin : margin + advance].astype(np.float32) / 255
            sharpness = float(np.square(glyph).sum())
            if sharpness > sharpest:
                # light text on dark looks thinner than it is: lift the half tones
                best, sharpest = np.round(255 * glyph**0.8).astype(np.uint8), sharpness
        return best


def _grey(mask: Image | cv2.typing.MatLike) -> Image:
    return np.asarray(cv2.cvtColor(mask, cv2.COLOR_GRAY2BGR), np.uint8)
