"""A picture of a start on its frame: the box, each part with its name, and rulers in the frame's pixels."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import cv2
import numpy as np

from facetrack_cli.start.files import write_new
from facetrack_cli.types import Frame, Image, Point, Start

WISHED: Final = 900  # smaller frames are shown larger, by a whole factor, so that numbers are legible
BOX, PART, RULER = (255, 200, 0), (0, 255, 255), (255, 255, 255)


def draw_start(frame: Frame, start: Start) -> Image:
    """The frame with the start drawn on it, BGR; small frames are enlarged by a whole factor."""
    zoom = max(1, round(WISHED / max(frame.size)))
    image: Image = np.ascontiguousarray(frame.bgr)
    if zoom > 1:
        size = frame.size[0] * zoom, frame.size[1] * zoom
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_NEAREST), np.uint8)
    else:
        image = image.copy()
    unit = max(1.0, max(image.shape[:2]) / WISHED)
    _rulers(image, frame.size, zoom, unit)
    for name, target in start.targets.items():
        if target.box is not None:
            x, y, w, h = target.box
            corner, opposite = (x - 0.5, y - 0.5), (x + w - 0.5, y + h - 0.5)
            cv2.rectangle(image, _at(corner, zoom), _at(opposite, zoom), BOX, round(2 * unit), cv2.LINE_AA)
            _label(image, f"{name}, frame {start.frame}", _at(corner, zoom), BOX, unit)
        for part, point in target.points.items():
            at = _at(point, zoom)
            cv2.drawMarker(image, at, (0, 0, 0), cv2.MARKER_CROSS, round(15 * unit), round(3 * unit), cv2.LINE_AA)
            cv2.drawMarker(image, at, PART, cv2.MARKER_CROSS, round(13 * unit), round(unit), cv2.LINE_AA)
            text = f"{part} {point[0]:g}, {point[1]:g}"
            side = -1 if part.endswith("left") else 1
            beside = at[0] - round(10 * unit) - _width(text, unit) if side < 0 else at[0] + round(10 * unit)
            _label(image, text, (beside, at[1] + round(4 * unit)), PART, unit)
    return image


def write_preview(path: Path, frame: Frame, start: Start, *, overwrite: bool = False) -> None:
    """The same as a PNG file. OutputError if it exists and `overwrite` is not set, or cannot be written."""
    _, data = cv2.imencode(".png", draw_start(frame, start))
    write_new(path, data.tobytes(), overwrite=overwrite)


def _at(point: Point, zoom: int) -> tuple[int, int]:
    """A point of the frame on the enlarged picture, whose pixel centres lie at (p + 0.5) * zoom - 0.5."""
    return round((point[0] + 0.5) * zoom - 0.5), round((point[1] + 0.5) * zoom - 0.5)


def _rulers(image: Image, size: tuple[int, int], zoom: int, unit: float) -> None:
    """Ticks with numbers along the top and the left edge."""
    step = next(step for step in (10, 20, 50, 100, 200, 500, 1000, 10**9) if step * zoom >= 70 * unit)
    for value in range(step, size[0], step):
        x = _at((value, 0), zoom)[0]
        cv2.line(image, (x, 0), (x, round(8 * unit)), RULER, max(1, round(unit)))
        _label(image, str(value), (x + round(3 * unit), round(14 * unit)), RULER, unit)
    for value in range(step, size[1], step):
        y = _at((0, value), zoom)[1]
        cv2.line(image, (0, y), (round(8 * unit), y), RULER, max(1, round(unit)))
        _label(image, str(value), (round(10 * unit), y + round(4 * unit)), RULER, unit)


def _width(text: str, unit: float) -> int:
    return cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.45 * unit, 1)[0][0]


def _label(image: Image, text: str, at: tuple[int, int], colour: tuple[int, int, int], unit: float) -> None:
    """Text with a dark rim, moved inside the picture where it would stand out."""
    x = min(max(at[0], 2), max(image.shape[1] - _width(text, unit) - 2, 2))
    y = min(max(at[1], round(14 * unit)), image.shape[0] - 3)
    for ink, line in (((0, 0, 0), 3), (colour, 1)):
        place = (x, y)
        cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45 * unit, ink, round(line * unit), cv2.LINE_AA)
