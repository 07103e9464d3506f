"""The five points of a face, placed by a regression (`face/descent.py`) in the face as its eyes show it, upright."""

import math
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from threading import get_ident
from typing import Final

import cv2
import numpy as np

from facetrack_cli.core.types import Box, Frame, Image, Point
from facetrack_cli.tracking.face.descent import CORNER, load_descent
from facetrack_cli.tracking.face.still import EYE_LINE, FACE, MIDDLE, Similarity

# Fractions of a Haar box (x, y): the mean over 26 images, of 15 clips and two portraits; standard deviation 0.02.
EYES_IN_BOX: Final = ((0.309, 0.388), (0.672, 0.388))
MOUTH_Y: Final = 1.12  # how far the corners of the mouth are below the eyes, in distances between the eyes
EYE_WIDTH: Final = 100  # pixels to which a face is brought before its eyes are searched
# Each cascade with the offset of its window's centre from the eye's centre, in face widths.
_EYE_CASCADES: Final = (
    ("lefteye_2splits", 0.019, -0.030),
    ("righteye_2splits", 0.004, -0.034),
)


def cascade(name: str) -> cv2.CascadeClassifier:
    """OpenCV's own cascade of that name, loaded once for each thread, since it holds the image that it searches."""
    return _load(name, get_ident())


@lru_cache(maxsize=64)
def _load(name: str, thread: int) -> cv2.CascadeClassifier:
    return cv2.CascadeClassifier(str(Path(cv2.__file__).parent / "data" / f"haarcascade_{name}.xml"))


def place(
    image: Image, box: Box, eyes: tuple[Point, Point] | None = None, points: Mapping[str, Point] | None = None
) -> dict[str, Point]:
    """All five points of the face that fills `box` as the frontal cascade draws it, in pixels of `image` (BGR).

    Without `eyes`, the left one in the image first, cascades look for them. `points` are those that a detector has
    seen, near which the parts may be.
    """
    face, descent = upright(image, box, eyes), load_descent()
    rest = dict(zip(descent.parts, descent.mean + CORNER, strict=True))
    off = [face.to_still(np.array(at)) - rest[part] for part, at in (points or {}).items()]
    around = [np.mean(off, axis=0) + np.mean(list(rest.values()), axis=0)] if off else []
    at = face.to_frame(descent.fit(face.read(Frame(0, 0.0, image)).bgr, around).at)
    return {part: (x, y) for part, (x, y) in zip(descent.parts, at.tolist(), strict=True)}


def upright(image: Image, box: Box, eyes: tuple[Point, Point] | None = None) -> Similarity:
    """The face in `box` as a still face, by its eyes."""
    if eyes is None:
        # the part of the image around the box, so that the time does not depend on the size of the frame
        x0, y0 = max(int(box[0] - 0.5 * box[2]), 0), max(int(box[1] - 0.5 * box[3]), 0)
        near = image[y0 : int(box[1] + 1.5 * box[3]) + 1, x0 : int(box[0] + 1.5 * box[2]) + 1]
        left, right = np.add(_find_eyes(near, (box[0] - x0, box[1] - y0, box[2], box[3])), (x0, y0))
    else:
        left, right = np.array(eyes)
    across = right - left
    face = Similarity(np.zeros(2), math.sqrt(box[2] * box[3]) / FACE, math.atan2(across[1], across[0]))
    return face._replace(centre=(left + right) / 2 - face.to_frame(np.array([MIDDLE, EYE_LINE])))


def shows_features(image: Image, box: Box) -> bool:
    """Whether the face in `box` shows an eye to a cascade, or a mouth to the regression."""
    x0, y0 = max(int(box[0]), 0), max(int(box[1]), 0)
    near = image[y0 : int(box[1] + box[3]) + 1, x0 : int(box[0] + box[2]) + 1]
    if any(_detected_eyes(near, (box[0] - x0, box[1] - y0, box[2], box[3]))):
        return True
    still = upright(image, box, mean_eyes(box)).read(Frame(0, 0.0, image))
    return bool(load_descent().fit(still.bgr).odds.min() > 0)


def mean_eyes(box: Box) -> tuple[Point, Point]:
    """Where the eyes are in a face's box on average, in pixels."""
    x, y, w, h = box
    left, right = ((x + across * w - 0.5, y + down * h - 0.5) for across, down in EYES_IN_BOX)
    return left, right


def _find_eyes(image: Image, box: Box) -> tuple[Point, Point]:
    """The eyes of the face in `box`, in pixels: each the median of what two cascades say, else its mean place."""
    # of few detections the mean place is one more, so that a single wrong one cannot pull an eye all the way
    both = zip(mean_eyes(box), _detected_eyes(image, box), strict=True)
    left, right = (np.median([mean, *seen] if len(seen) < 3 else seen, axis=0).tolist() for mean, seen in both)
    return left, right


def _detected_eyes(image: Image, box: Box) -> tuple[list[Point], list[Point]]:
    """What the cascades see near the mean place of either eye."""
    x, y, w, h = box
    zoom, top, means = EYE_WIDTH / w, y + 0.1 * h, mean_eyes(box)
    matrix = np.array([[zoom, 0, -(x - 0.5) * zoom - 0.5], [0, zoom, -(top - 0.5) * zoom - 0.5]])
    size = (EYE_WIDTH, round(0.55 * h * zoom))
    patch = cv2.warpAffine(_smooth(image, 1 / zoom), matrix, size, borderMode=cv2.BORDER_REPLICATE)
    grey = cv2.equalizeHist(cv2.cvtColor(patch, cv2.COLOR_BGR2GRAY))
    found: tuple[list[Point], list[Point]] = ([], [])
    smallest, largest = (round(0.15 * EYE_WIDTH),) * 2, (round(0.45 * EYE_WIDTH),) * 2
    for name, dx, dy in _EYE_CASCADES:
        for ex, ey, ew, eh in cascade(name).detectMultiScale(grey, 1.1, 2, 0, smallest, largest):
            at = (x - 0.5 + (ex + ew / 2) / zoom - dx * w, top - 0.5 + (ey + eh / 2) / zoom - dy * w)
            for seen, mean in zip(found, means, strict=True):
                if abs(at[0] - mean[0]) < 0.08 * w and abs(at[1] - mean[1]) < 0.09 * h:
                    seen.append(at)
    return found


def _smooth(image: Image, shrink: float) -> Image:
    """The image, blurred against aliasing if it is to be reduced by `shrink`."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 0.5 * shrink), np.uint8) if shrink > 1 else image
