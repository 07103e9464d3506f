"""A picture of a start: the frame around the targets, their boxes and parts, and rulers in the frame's pixels."""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np

from facetrack_cli.core.files import write_new
from facetrack_cli.core.types import Array, Frame, Image, Point, Start

LONGER_SIDE: Final = 900  # of the picture, about: what is shown is enlarged by a whole factor to come near it
BOX, PART, RULER = (255, 200, 0), (0, 255, 255), (255, 255, 255)


class _View(NamedTuple):
    """The part of the frame that is shown, from pixel (left, top), and how often it is enlarged."""

    left: int
    top: int
    width: int
    height: int
    zoom: int

    def at(self, point: Point) -> tuple[int, int]:
        """A point of the frame in the picture; pixel p of the view covers zoom pixels from p * zoom on."""
        x = (point[0] - self.left + 0.5) * self.zoom - 0.5
        y = (point[1] - self.top + 0.5) * self.zoom - 0.5
        return round(x), round(y)

    @property
    def unit(self) -> float:
        """The size of letters and lines, 1 in a picture of LONGER_SIDE."""
        return max(1.0, max(self.width, self.height) * self.zoom / LONGER_SIDE)


def draw_start(frame: Frame, start: Start) -> Image:
    """The frame around the start's targets with the start drawn on it, enlarged by a whole factor; BGR."""
    view = _view(frame.size, start)
    shown = frame.bgr[view.top : view.top + view.height, view.left : view.left + view.width]
    size = view.width * view.zoom, view.height * view.zoom
    image = np.array(cv2.resize(shown, size, interpolation=cv2.INTER_NEAREST), np.uint8)
    unit = view.unit
    _rulers(image, view)
    for name, target in start.targets.items():
        if target.box is not None:
            x, y, w, h = target.box
            corner = view.at((x - 0.5, y - 0.5))
            cv2.rectangle(image, corner, view.at((x + w - 0.5, y + h - 0.5)), BOX, round(unit), cv2.LINE_AA)
            _label(image, f"{name}, frame {start.frame}", (corner[0], corner[1] - round(4 * unit)), BOX, unit)
        centre = np.mean(list(target.points.values()), axis=0) if target.points else np.zeros(2)
        for part, point in target.points.items():
            at = view.at(point)
            cv2.drawMarker(image, at, (0, 0, 0), cv2.MARKER_CROSS, round(15 * unit), round(3 * unit), cv2.LINE_AA)
            cv2.drawMarker(image, at, PART, cv2.MARKER_CROSS, round(13 * unit), round(unit), cv2.LINE_AA)
            text = f"{part} {point[0]:g}, {point[1]:g}"
            _label(image, text, _beside(at, np.asarray(point) - centre, _width(text, unit), unit), PART, unit)
    return image


def write_preview(path: Path, frame: Frame, start: Start, *, overwrite: bool = False) -> None:
    """The same as a PNG file. OutputError if it exists and `overwrite` is not set, or cannot be written."""
    _, data = cv2.imencode(".png", draw_start(frame, start))
    write_new(path, data.tobytes(), overwrite=overwrite)


def _view(size: tuple[int, int], start: Start) -> _View:
    """All targets and as far around them as 0.7 of their size, but no more than the frame."""
    corners: list[Point] = []
    for target in start.targets.values():
        corners += target.points.values()
        if target.box is not None:
            x, y, w, h = target.box
            corners += [(x, y), (x + w, y + h)]
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    around = max(20.0, 0.7 * float((high - low).max()))
    x0, y0 = np.clip((low - around).astype(int), 0, np.array(size) - 1)
    x1, y1 = np.clip((high + around).astype(int) + 1, (x0 + 1, y0 + 1), size)
    width, height = int(x1 - x0), int(y1 - y0)
    return _View(int(x0), int(y0), width, height, max(1, round(LONGER_SIDE / max(width, height))))


def _beside(at: tuple[int, int], away: Array, width: int, unit: float) -> tuple[int, int]:
    """Where the label of a point begins: on the side that looks away from the other points."""
    if abs(away[0]) > abs(away[1]):
        x = at[0] + 10 * unit if away[0] > 0 else at[0] - 10 * unit - width
        return round(x), round(at[1] + 4 * unit)
    return round(at[0] - width / 2), round(at[1] + (20 if away[1] > 0 else -11) * unit)


def _rulers(image: Image, view: _View) -> None:
    """Ticks with numbers along the top and the left edge."""
    unit = view.unit
    step = next(step for step in (5, 10, 20, 50, 100, 200, 500, 1000, 10**9) if step * view.zoom >= 70 * unit)
    tick, line = round(8 * unit), round(unit)
    for x in range(-(-view.left // step) * step, view.left + view.width, step):
        column, _ = view.at((x, view.top))
        cv2.line(image, (column, 0), (column, tick), RULER, line)
        _label(image, str(x), (column + round(3 * unit), round(14 * unit)), RULER, unit)
    for y in range(-(-view.top // step) * step, view.top + view.height, step):
        _, row = view.at((view.left, y))
        cv2.line(image, (0, row), (tick, row), RULER, line)
        _label(image, str(y), (round(10 * unit), row + round(4 * unit)), RULER, unit)


def _width(text: str, unit: float) -> int:
    return cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.45 * unit, 1)[0][0]


def _label(image: Image, text: str, at: tuple[int, int], colour: tuple[int, int, int], unit: float) -> None:
    """Text with a dark rim, moved inside the picture where it would stand out."""
    x = min(max(at[0], 2), max(image.shape[1] - _width(text, unit) - 2, 2))
    y = min(max(at[1], round(14 * unit)), image.shape[0] - 3)
    for ink, line in (((0, 0, 0), 3), (colour, 1)):
        cv2.putText(image, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.45 * unit, ink, round(line * unit), cv2.LINE_AA)
