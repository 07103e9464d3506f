"""The five points of a face, placed from its box by mean proportions and corrected by what the image shows.

Lengths are in the eye frame of `lowerface.py`. Where a step finds no evidence, or evidence too far from the mean, the
mean proportions stand. Nothing here is random.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from threading import get_ident
from typing import Final

import cv2
import numpy as np

from facetrack_cli.core.types import Box, Image, Point
from facetrack_cli.tracking.start.lowerface import HEIGHT, LEFT, TOP, UNIT, WIDTH, read_points

# Fractions of a Haar box (x, y): the mean over 26 images, of 15 clips and two portraits; standard deviation 0.02.
EYES_IN_BOX: Final = ((0.309, 0.388), (0.672, 0.388))
EYE_WIDTH: Final = 200  # pixels to which a face is brought before its eyes are searched
# Each cascade with the offset of its window's centre from the eye's centre, in face widths.
_EYE_CASCADES: Final = (
    ("eye", 0.0, 0.001),
    ("eye_tree_eyeglasses", 0.0, 0.003),
    ("lefteye_2splits", 0.019, -0.030),
    ("righteye_2splits", 0.004, -0.034),
)


def cascade(name: str) -> cv2.CascadeClassifier:
    """OpenCV's own cascade of that name, loaded once for each thread, since it holds the image that it searches."""
    return _load(name, get_ident())


@lru_cache(maxsize=64)
def _load(name: str, thread: int) -> cv2.CascadeClassifier:
    return cv2.CascadeClassifier(str(Path(cv2.__file__).parent / "data" / f"haarcascade_{name}.xml"))


def _blur(image: Image, spread: float) -> Image:
    """Gaussian blur, against aliasing before an image is reduced."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), spread), np.uint8)


@dataclass(frozen=True, slots=True)
class EyeFrame:
    """The eye frame in the image: its origin in pixels, the unit vector along x, the length of 1 in pixels."""

    origin: Point
    along: Point
    scale: float

    @classmethod
    def from_eyes(cls, left: Point, right: Point) -> EyeFrame:
        dx, dy = right[0] - left[0], right[1] - left[1]
        scale = float(np.hypot(dx, dy))
        return cls(((left[0] + right[0]) / 2, (left[1] + right[1]) / 2), (dx / scale, dy / scale), scale)

    def to_image(self, x: float, y: float) -> Point:
        (ox, oy), (ux, uy) = self.origin, self.along
        return float(ox + self.scale * (x * ux - y * uy)), float(oy + self.scale * (x * uy + y * ux))

    def rectify(self, image: Image) -> Image:
        """The lower face, upright and at UNIT pixels to a length of 1: rows TOP..BOTTOM, columns LEFT..RIGHT."""
        shrink = self.scale / UNIT
        (ux, uy), step = self.along, 1 / UNIT
        corner = self.to_image(LEFT + step / 2, TOP + step / 2)
        matrix = np.array([[ux * shrink, -uy * shrink, corner[0]], [uy * shrink, ux * shrink, corner[1]]])
        if shrink > 1:
            image = _blur(image, 0.5 * shrink)
        how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        lower = cv2.warpAffine(image, matrix, (WIDTH, HEIGHT), flags=how, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(lower, np.uint8)


def place(image: Image, box: Box) -> dict[str, Point]:
    """All five points of the face that fills `box` as the frontal cascade draws it, in pixels of `image` (BGR)."""
    # the part of the image around the box, so that the time does not depend on the size of the frame
    x0, y0 = max(int(box[0] - 0.5 * box[2]), 0), max(int(box[1] - 0.5 * box[3]), 0)
    image = image[y0 : int(box[1] + 1.6 * box[3]) + 1, x0 : int(box[0] + 1.5 * box[2]) + 1]
    eyes = find_eyes(image, (box[0] - x0, box[1] - y0, box[2], box[3]))
    points = {name: eyes.to_image(*at) for name, at in read_points(eyes.rectify(image)).items()}
    return {name: (x + x0, y + y0) for name, (x, y) in points.items()}


def mean_eyes(box: Box) -> tuple[Point, Point]:
    """Where the eyes are in a face's box on average, in pixels."""
    (lx, ly), (rx, ry) = EYES_IN_BOX
    x, y, w, h = box
    return (x + lx * w - 0.5, y + ly * h - 0.5), (x + rx * w - 0.5, y + ry * h - 0.5)


def find_eyes(image: Image, box: Box) -> EyeFrame:
    """The eye frame of the face in `box`: each eye the median of what four cascades say, else its mean place."""
    x, y, w, h = box
    zoom = EYE_WIDTH / w
    top = y + 0.1 * h
    matrix = np.array([[zoom, 0, -(x - 0.5) * zoom - 0.5], [0, zoom, -(top - 0.5) * zoom - 0.5]])
    if zoom < 1:
        image = _blur(image, 0.5 / zoom)
    size = (EYE_WIDTH, round(0.55 * h * zoom))
    patch = cv2.warpAffine(image, matrix, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    grey = cv2.equalizeHist(cv2.cvtColor(patch, cv2.COLOR_BGR2GRAY))
    found: tuple[list[Point], list[Point]] = ([], [])
    means = mean_eyes(box)
    smallest, largest = (round(0.15 * EYE_WIDTH),) * 2, (round(0.45 * EYE_WIDTH),) * 2
    for name, dx, dy in _EYE_CASCADES:
        for ex, ey, ew, eh in cascade(name).detectMultiScale(grey, 1.05, 2, 0, smallest, largest):
            at = (x - 0.5 + (ex + ew / 2) / zoom - dx * w, top - 0.5 + (ey + eh / 2) / zoom - dy * w)
            for side, mean in enumerate(means):
                if abs(at[0] - mean[0]) < 0.08 * w and abs(at[1] - mean[1]) < 0.09 * h:
                    found[side].append(at)
    # of few detections the mean place is one more, so that a single wrong one cannot pull an eye all the way
    (left, right) = (
        np.median([mean, *seen] if len(seen) < 3 else seen, axis=0).tolist()
        for mean, seen in zip(means, found, strict=True)
    )
    return EyeFrame.from_eyes(left, right)
