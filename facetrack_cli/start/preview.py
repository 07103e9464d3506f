"""The preview of a start: the frame around the targets, their boxes and parts, and rulers in pixels of the frame."""

from pathlib import Path
from typing import Final

import cv2
import numpy as np

from facetrack_cli.core.files import write_new
from facetrack_cli.core.types import Array, Frame, Image, Point, Start

SHOWN_PX: Final = 900  # pixels, about: what is shown is enlarged by a whole factor to come near it
BOX, PART, RULER = (255, 200, 0), (0, 255, 255), (255, 255, 255)


def write_preview(path: Path, frame: Frame, start: Start, *, overwrite: bool = False) -> None:
    """`draw_start` as a PNG file. OutputError if it exists and `overwrite` is not set, or cannot be written."""
    write_new(path, cv2.imencode(".png", draw_start(frame, start))[1].tobytes(), overwrite=overwrite)


def draw_start(frame: Frame, start: Start) -> Image:
    """The frame around the start's targets with the start drawn on it, enlarged by a whole factor; BGR."""
    view = _View(frame, start)
    image, unit = view.image, view.unit
    view.draw_rulers()
    for name, target in start.targets.items():
        if target.box is not None:
            x, y, w, h = target.box
            corner = view.at((x - 0.5, y - 0.5))
            cv2.rectangle(image, corner, view.at((x + w - 0.5, y + h - 0.5)), BOX, round(unit), cv2.LINE_AA)
            view.label(f"{name}, frame {start.frame}", (corner[0], corner[1] - round(4 * unit)), BOX)
        centre = np.mean(list(target.points.values()), axis=0) if target.points else np.zeros(2)
        for part, point in target.points.items():
            at, text = view.at(point), f"{part} {point[0]:g}, {point[1]:g}"
            for ink, size, line in (((0, 0, 0), 15, 3), (PART, 13, 1)):
                cv2.drawMarker(image, at, ink, cv2.MARKER_CROSS, round(size * unit), round(line * unit), cv2.LINE_AA)
            view.label(text, view.beside(at, np.asarray(point) - centre, text), PART)
    return image


class _View:
    """What is shown of the frame, all targets and 0.7 of their size around; `unit` is the size of letters and lines."""

    def __init__(self, frame: Frame, start: Start) -> None:
        places: list[Point] = []
        for target in start.targets.values():
            places += target.points.values()
            if target.box is not None:
                x, y, w, h = target.box
                places += [(x, y), (x + w, y + h)]
        low, high = np.min(places, axis=0), np.max(places, axis=0)
        around = max(20.0, 0.7 * float((high - low).max()))
        self.x0, self.y0 = np.clip((low - around).astype(int), 0, np.array(frame.size) - 1).tolist()
        self.x1, self.y1 = np.clip((high + around).astype(int) + 1, (self.x0 + 1, self.y0 + 1), frame.size).tolist()
        shown = frame.bgr[self.y0 : self.y1, self.x0 : self.x1]
        self.zoom = max(1, round(SHOWN_PX / max(shown.shape[:2])))
        self.unit = max(1.0, max(shown.shape[:2]) * self.zoom / SHOWN_PX)
        # a pixel covers zoom x zoom pixels
        self.image: Image = np.repeat(np.repeat(shown, self.zoom, axis=0), self.zoom, axis=1)

    def at(self, point: Point) -> tuple[int, int]:
        """A point of the frame in the preview."""
        x, y = ((value - first + 0.5) * self.zoom - 0.5 for value, first in zip(point, (self.x0, self.y0), strict=True))
        return round(x), round(y)

    def beside(self, at: tuple[int, int], away: Array, text: str) -> tuple[int, int]:
        """Where the label of a point begins: on the side that is away from the other points."""
        unit, width = self.unit, self.width(text)
        if abs(away[0]) > abs(away[1]):
            x = at[0] + 10 * unit if away[0] > 0 else at[0] - 10 * unit - width
            return round(x), round(at[1] + 4 * unit)
        return round(at[0] - width / 2), round(at[1] + (20 if away[1] > 0 else -11) * unit)

    def draw_rulers(self) -> None:
        """Ticks with numbers along the top and the left edge."""
        unit, line, tick = self.unit, round(self.unit), round(8 * self.unit)
        step = next(step for step in (5, 10, 20, 50, 100, 200, 500, 1000, 10**9) if step * self.zoom >= 70 * unit)
        for x in range(-(-self.x0 // step) * step, self.x1, step):
            column, _ = self.at((x, self.y0))
            cv2.line(self.image, (column, 0), (column, tick), RULER, line)
            self.label(str(x), (column + round(3 * unit), round(14 * unit)), RULER)
        for y in range(-(-self.y0 // step) * step, self.y1, step):
            _, row = self.at((self.x0, y))
            cv2.line(self.image, (0, row), (tick, row), RULER, line)
            self.label(str(y), (round(10 * unit), row + round(4 * unit)), RULER)

    def width(self, text: str) -> int:
        return cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.45 * self.unit, 1)[0][0]

    def label(self, text: str, at: tuple[int, int], colour: tuple[int, int, int]) -> None:
        """Text with a dark rim, moved inside the image where it would be cut off."""
        (height, width), size = self.image.shape[:2], 0.45 * self.unit
        x = min(max(at[0], 2), max(width - self.width(text) - 2, 2))
        y = min(max(at[1], round(14 * self.unit)), height - 3)
        for ink, line in (((0, 0, 0), round(3 * self.unit)), (colour, round(self.unit))):
            cv2.putText(self.image, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, size, ink, line, cv2.LINE_AA)
