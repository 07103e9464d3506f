"""Faces by OpenCV's frontal cascades.

One cascade proposes faces in an image of bounded size, so that a 4K frame takes no longer than one of 640 pixels. Each
must be confirmed by one of two others, which leaves few false detections.
"""

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.geometry import overlap
from facetrack_cli.core.types import Box, Image
from facetrack_cli.tracking.start.points import cascade

PARTS: Final = ("nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower")
"""What can be placed; left and right as seen in the image."""
MAX_SEARCHED_PX, MIN_SEARCHED_PX = 640, 320  # bounds in pixels of the longer side of the image that is searched
MIN_FACE_SHARE: Final = 0.06  # of the image's shorter side: smaller faces have no features to track
MIN_CONTRAST: Final = 16.0  # standard deviation of grey in a face: 28 to 68 in usual clips, 12 if hardly visible


class NotHereError(InputError):
    """A frame lacks what a start needs; a later one may have it."""


def check_parts(parts: Sequence[str]) -> None:
    """UsageError for a part that is none of the five."""
    if unknown := ", ".join(part for part in parts if part not in PARTS):
        remedy = "say where the parts are in an init file, with --init FILE"
        raise UsageError(f"no cascade can place {unknown}, only {', '.join(PARTS)}; {remedy}")


def find_faces(image: Image) -> list[Box]:
    """Boxes of the frontal faces in an image (BGR), the largest first, in whole pixels."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    height, width = grey.shape
    zoom = float(np.clip(1.0, MIN_SEARCHED_PX / max(width, height), MAX_SEARCHED_PX / max(width, height)))
    if zoom != 1:
        size = max(round(width * zoom), 1), max(round(height * zoom), 1)
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA if zoom < 1 else cv2.INTER_LINEAR)
    seen = np.asarray(grey, np.uint8)
    smallest = max(20, round(MIN_FACE_SHARE * min(seen.shape)))
    faces = []
    for box in _detect("frontalface_alt2", seen, 3, smallest, max(seen.shape)):
        confirmed = sum(_confirmed(name, seen, box) for name in ("frontalface_default", "frontalface_alt"))
        if confirmed:
            # one that all three see is taken before a slightly larger one that two see
            faces.append((-box[2] * (2 + confirmed), box))
    return [(round(x / zoom), round(y / zoom), round(w / zoom), round(h / zoom)) for _, (x, y, w, h) in sorted(faces)]


def _detect(name: str, grey: Image, neighbours: int, smallest: int, largest: int) -> list[tuple[int, int, int, int]]:
    found = cascade(name).detectMultiScale(grey, 1.1, neighbours, 0, (smallest, smallest), (largest, largest))
    return [(int(x), int(y), int(w), int(h)) for x, y, w, h in found]


def _confirmed(name: str, grey: Image, box: tuple[int, int, int, int]) -> bool:
    """Whether the cascade of that name sees a face in the same place."""
    (x, y, w, h), margin = box, round(0.35 * box[2])
    left, top = max(x - margin, 0), max(y - margin, 0)
    patch = np.ascontiguousarray(grey[top : y + h + margin, left : x + w + margin])
    near = _detect(name, patch, 2, max(20, round(0.7 * w)), round(1.4 * w))
    return any(overlap((x, y, w, h), (bx + left, by + top, bw, bh)) > 0.5 for bx, by, bw, bh in near)


def nearest(image: Image, box: Box) -> Box | None:
    """The face that a cascade sees in a small image, about as large as `box` and about there; None if there is none."""
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
    faces = _detect("frontalface_alt2", grey, 2, round(0.7 * box[2]), round(1.4 * box[2]))
    best = max(faces, key=lambda face: overlap(face, box), default=None)
    return best if best is not None and overlap(best, box) >= 0.4 else None


def face_in(image: Image, box: Box) -> Box | None:
    """The face that fits a hand-drawn box best, if a cascade sees one."""
    x, y, w, h = box
    left, top = max(int(x - 0.4 * w), 0), max(int(y - 0.4 * h), 0)
    patch = image[top : int(y + 1.4 * h) + 1, left : int(x + 1.4 * w) + 1]
    zoom = min(1.0 if min(w, h) >= 40 else 80 / min(w, h), MAX_SEARCHED_PX / max(patch.shape[:2]), 200 / min(w, h))
    size = max(round(patch.shape[1] * zoom), 1), max(round(patch.shape[0] * zoom), 1)
    grey = cv2.cvtColor(cv2.resize(patch, size, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY)
    smallest = max(20, round(0.45 * min(w, h) * zoom))
    faces = [
        (fx / zoom + left, fy / zoom + top, fw / zoom, fh / zoom)
        for fx, fy, fw, fh in _detect("frontalface_alt2", np.asarray(grey, np.uint8), 2, smallest, max(grey.shape))
    ]
    best = max(faces, key=lambda face: (overlap(face, box), face), default=None)
    return best if best is not None and overlap(best, box) > 0.35 else None
