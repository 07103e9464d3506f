"""The five points of a face, placed by a regression (`face/descent.py`) in the face as it is seen upright."""

from __future__ import annotations

import cmath
import math
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from threading import get_ident
from typing import Final

import cv2
import numpy as np

from facetrack_cli.core.errors import UsageError
from facetrack_cli.core.geometry import warp_affine
from facetrack_cli.core.types import Array, Box, Frame, Image, Point
from facetrack_cli.trackers.face.descent import CORNER, PlacedPoints, load_descent
from facetrack_cli.trackers.face.stabilized import EYE_LINE, FACE, MIDDLE, Similarity, change_between

# Fractions of a Haar box (x, y): the mean over 26 images, of 15 clips and two portraits; standard deviation 0.02.
EYES_IN_BOX: Final = ((0.309, 0.388), (0.672, 0.388))
MOUTH_Y: Final = 1.12  # how far the corners of the mouth are below the eyes, in distances between the eyes
EYES_AT: Final = np.array([MIDDLE, EYE_LINE])  # the middle between the eyes in the stabilized image
ZOOMS: Final = (0.95, 1.1, 1.3)  # sizes of a face in the box of a cascade
AGAIN: Final = 2  # times that a face is laid upright by its points, at most
EYE_WIDTH: Final = 100  # pixels to which a face is brought before its eyes are searched
# Each cascade with the offset of its window's centre from the eye's centre, in face widths.
_EYE_CASCADES: Final = (
    ("lefteye_2splits", 0.019, -0.030),
    ("righteye_2splits", 0.004, -0.034),
)


@lru_cache(maxsize=1)
def has_cascades() -> bool:
    """Whether this OpenCV has Haar cascades: 5 has the files no longer, and the class in contrib alone."""
    return hasattr(cv2, "CascadeClassifier") and _file("frontalface_alt2").is_file()


def check_cascades() -> None:
    """UsageError where this OpenCV has none."""
    if not has_cascades():
        remedy = "pip install 'opencv-python-headless<5', or take YuNet: pip install 'facetrack[detect]'"
        raise UsageError(f"the installed OpenCV {cv2.__version__} has no Haar cascades; {remedy}")


def cascade(name: str) -> cv2.CascadeClassifier:
    """OpenCV's own cascade of that name, loaded once for each thread, since it holds the image that it searches."""
    return _load(name, get_ident())


@lru_cache(maxsize=64)
def _load(name: str, thread: int) -> cv2.CascadeClassifier:
    check_cascades()
    return cv2.CascadeClassifier(str(_file(name)))


def _file(name: str) -> Path:
    return Path(cv2.__file__).parent / "data" / f"haarcascade_{name}.xml"


def place(
    image: Image, box: Box, eyes: tuple[Point, Point] | None = None, points: Mapping[str, Point] | None = None
) -> dict[str, Point]:
    """All five points of the upright face that fills `box` as the frontal cascade draws it, in pixels of `image` (BGR).

    `eyes`, the left one in the image first, and `points`: where a detector sees them.
    """
    return named(placed(Frame(0, 0.0, image), box, eyes, points or {}))


def named(points: PlacedPoints) -> dict[str, Point]:
    """The places by the names of the parts."""
    return {part: (x, y) for part, (x, y) in zip(load_descent().parts, points.at.tolist(), strict=True)}


def placed(
    frame: Frame, box: Box, eyes: tuple[Point, Point] | None, points: Mapping[str, Point], turn: int = 0
) -> PlacedPoints:
    """The face in `box` where the regression sees most of it; it is turned by eighths of a turn.

    Without `eyes` they are taken to be where they are on average, and the face of one of three sizes: the boxes of
    cascades say neither how a face is tilted, nor well how large it is. Then the face is laid upright by its points,
    as long as more is seen; its size stays, since a mouth may be wide.
    """
    descent, (left, right) = load_descent(), np.array(eyes or mean_eyes(box, turn))
    zooms = (1.0,) if eyes else ZOOMS
    size, (across, down) = math.sqrt(box[2] * box[3]) / FACE, (right - left).tolist()

    def seen(scale: float, angle: float, at: Array, still: Array) -> PlacedPoints:
        """What is seen of a face whose place `still` (2,) in the stabilized image is `at` (2,) in the frame."""
        face = Similarity(np.zeros(2), scale, angle)
        face = face._replace(centre=at - face.to_frame(still))
        found = descent.fit(face.read(frame).bgr)
        return PlacedPoints(face.to_frame(found.at), found.odds)

    rest, angle = descent.mean + CORNER, math.atan2(down, across)
    tries = [(zoom * size, seen(zoom * size, angle, (left + right) / 2, EYES_AT)) for zoom in zooms]
    if points:
        known = rest[[descent.parts.index(part) for part in points]]
        tries.append((size, seen(size, angle, np.mean(list(points.values()), axis=0), known.mean(axis=0))))
    scale, best = max(tries, key=lambda one: one[1].sure)
    for _ in range(AGAIN):
        again = seen(scale, change_between(best.at, rest)[0], best.at.mean(axis=0), rest.mean(axis=0))
        if again.sure <= best.sure:
            break
        best = again
    return best


def mean_eyes(box: Box, turn: int = 0) -> tuple[Point, Point]:
    """Where the eyes are in a face's box on average, in pixels; it is turned by eighths of a turn clockwise."""
    x, y, w, h = box
    left, right = ((x + across * w - 0.5, y + down * h - 0.5) for across, down in EYES_IN_BOX)
    if turn:
        middle, by = complex(x + w / 2 - 0.5, y + h / 2 - 0.5), cmath.exp(0.25j * math.pi * turn)
        left, right = ((z.real, z.imag) for z in (middle + by * (complex(*eye) - middle) for eye in (left, right)))
    return left, right


def shows_eye(image: Image, box: Box) -> bool:
    """Whether a cascade sees an eye of the upright face in `box` near the mean place of either."""
    x0, y0 = max(int(box[0]), 0), max(int(box[1]), 0)
    image = image[y0 : int(box[1] + box[3]) + 1, x0 : int(box[0] + box[2]) + 1]
    x, y, w, h = box[0] - x0, box[1] - y0, *box[2:]
    zoom, top = EYE_WIDTH / w, y + 0.1 * h
    matrix = np.array([[zoom, 0, -(x - 0.5) * zoom - 0.5], [0, zoom, -(top - 0.5) * zoom - 0.5]])
    size = (EYE_WIDTH, round(0.55 * h * zoom))
    patch = warp_affine(_smooth(image, 1 / zoom), matrix, size, cv2.BORDER_REPLICATE)
    grey = cv2.equalizeHist(cv2.cvtColor(patch, cv2.COLOR_BGR2GRAY))
    smallest, largest = (round(0.15 * EYE_WIDTH),) * 2, (round(0.45 * EYE_WIDTH),) * 2
    for name, dx, dy in _EYE_CASCADES:
        for ex, ey, ew, eh in cascade(name).detectMultiScale(grey, 1.1, 2, 0, smallest, largest):
            at = (x - 0.5 + (ex + ew / 2) / zoom - dx * w, top - 0.5 + (ey + eh / 2) / zoom - dy * w)
            if any(abs(at[0] - u) < 0.08 * w and abs(at[1] - v) < 0.09 * h for u, v in mean_eyes(box)):
                return True
    return False


def _smooth(image: Image, shrink: float) -> Image:
    """The image, blurred against aliasing if it is to be reduced by `shrink`."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 0.5 * shrink), np.uint8) if shrink > 1 else image
