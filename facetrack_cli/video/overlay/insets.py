"""Small grey pictures of what a tracker knows, enlarged in a corner of the frame (Zhou et al. 2003, figure 3)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import cv2
import numpy as np

from facetrack_cli.core.types import Image
from facetrack_cli.video.overlay.marks import WHITE, Colour
from facetrack_cli.video.overlay.text import Font, stamp

Rect = tuple[float, float, float, float]  # x0, y0, x1, y1
_STAYS = 12  # frames at one place, at least
_LEAST = 12  # pixels high, or nothing could be seen
_MOST = 4  # targets with pictures, one a corner


class Shown(NamedTuple):
    """The images of one target, each with its name, and the colour of their frame."""

    target: str
    pictures: tuple[tuple[str, Image], ...]
    colour: Colour


class Insets:
    """Lays images into corners of frames of `size`; below `top` rows, which are the status bar's.

    Each target has a corner of its own, and keeps it until a window comes to lie there; then it goes where there is
    most room, and stays there for a while whatever comes. Where no corner is free it covers as little as it can.
    """

    def __init__(self, size: tuple[int, int], top: int, line: int, font: Font) -> None:
        self._size, self._top, self._line, self._font = size, top, line, font
        self._height = round(0.2 * min(size[1], 0.75 * size[0]))
        self._places: dict[str, tuple[int, int]] = {}  # the corner of a target, and since when
        self._count = 0

    def draw(self, image: Image, shown: Iterable[Shown], windows: Sequence[Rect]) -> list[Rect]:
        """Draw on `image` (H, W, 3) in place, away from `windows`; returns the places taken, one a target.

        What is no grey image, or has no room, is left out.
        """
        self._count += 1
        taken: list[Rect] = []
        places: dict[str, tuple[int, int]] = {}
        for one in shown:
            scaled = self._scaled(one) if len(taken) < _MOST else []
            if not scaled:
                continue
            size = sum(p.shape[1] + self._line for _, p in scaled) + self._line, scaled[0][1].shape[0] + 2 * self._line
            corner = self._corner(one.target, size, windows, {corner for corner, _ in places.values()})
            known = self._places.get(one.target)
            places[one.target] = known if known and known[0] == corner else (corner, self._count)
            box = self._box(corner, size)
            self._lay(image, scaled, one.colour, round(box[0]), round(box[1]))
            taken.append(box)
        self._places = places
        return taken

    def _scaled(self, one: Shown) -> list[tuple[str, Image]]:
        """The images with their names, all equally high, and together no wider than 0.4 of the frame."""
        fine = [(name, p) for name, p in one.pictures if p.ndim == 2 and min(p.shape) > 0 and p.dtype == np.uint8]
        wide = sum(p.shape[1] / p.shape[0] for _, p in fine)
        height = min(self._height, int(0.4 * self._size[0] / wide)) if fine else 0
        if height < _LEAST:
            return []
        found = []
        for name, picture in fine:
            size = max(1, round(height * picture.shape[1] / picture.shape[0])), height
            how = cv2.INTER_CUBIC if height > picture.shape[0] else cv2.INTER_AREA
            found.append((name, np.asarray(cv2.resize(picture, size, interpolation=how), np.uint8)))
        return found

    def _box(self, corner: int, size: tuple[int, int]) -> Rect:
        """Corners are numbered from the lower left, right, then the upper right, left."""
        (width, height), gap = size, 2 * self._line
        left = gap if corner in (0, 3) else self._size[0] - width - gap
        top = self._size[1] - height - gap if corner < 2 else self._top + gap
        return left, top, left + width, top + height

    def _corner(self, target: str, size: tuple[int, int], windows: Sequence[Rect], used: set[int]) -> int:
        free = [corner for corner in range(4) if corner not in used]
        covered = {corner: _covered(self._box(corner, size), windows) for corner in free}
        now, since = self._places.get(target, (-1, 0))
        if now not in free:
            return min(free, key=lambda corner: (covered[corner], corner))
        hardly_better = min(covered.values()) > 0.5 * covered[now]
        if not covered[now] or self._count - since < _STAYS or hardly_better:
            return now
        return min(free, key=lambda corner: (covered[corner], -_room(self._box(corner, size), windows)))

    def _lay(self, image: Image, scaled: Sequence[tuple[str, Image]], colour: Colour, left: int, top: int) -> None:
        line, font = self._line, self._font
        x = left + line
        for name, picture in scaled:
            height, width = picture.shape
            cv2.rectangle(image, (x - line, top), (x + width + line - 1, top + height + 2 * line - 1), colour, -1)
            under = image[max(top + line, 0) : top + line + height, max(x, 0) : x + width]
            under[:] = cv2.cvtColor(picture[: under.shape[0], : under.shape[1]], cv2.COLOR_GRAY2BGR)
            sprite = font.sprite(name[:12], WHITE, line)
            if name and sprite.size[0] <= width and sprite.size[1] <= 0.5 * height:
                stamp(image, sprite, x + width - sprite.size[0], top + line)
            x += width + line


def _covered(box: Rect, windows: Iterable[Rect]) -> float:
    """Pixels of the box that windows cover, each counted by itself."""
    return sum(
        max(0.0, min(box[2], w[2]) - max(box[0], w[0])) * max(0.0, min(box[3], w[3]) - max(box[1], w[1]))
        for w in windows
    )


def _room(box: Rect, windows: Iterable[Rect]) -> float:
    """How far the nearest window is, in pixels along the axis on which it is farther."""
    return min((max(w[0] - box[2], box[0] - w[2], w[1] - box[3], box[1] - w[3]) for w in windows), default=float("inf"))
