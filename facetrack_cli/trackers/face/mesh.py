"""MediaPipe's face mesh as a sensor: 468 points of a face by a small network, where its file is there.

`face_landmark.tflite` (Google, Apache-2.0; Kartynnik et al., "Real-time Facial Surface Geometry from Monocular Video on
Mobile GPUs", 2019) is run by OpenCV. It sees the upright face as it lies in the head, in two crops of different size;
the mean of both is more exact than either.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from threading import get_ident
from typing import Any, Final

import cv2
import numpy as np

from facetrack_cli.core.face_points import MESH, POINTS
from facetrack_cli.core.types import Array, Frame, Image
from facetrack_cli.trackers.face.eyes import SIDES
from facetrack_cli.trackers.face.stabilized import EYE_LINE, EYES, MIDDLE, Similarity, slope

COUNT: Final = 468
NAMES: Final = {f"mesh_{i}": i for i in range(COUNT) if i not in MESH.values()} | {part: MESH[part] for part in POINTS}
"""Every point of the mesh by its name."""
CROP: Final = 192  # pixels of a side of what the network sees
# crops: side, and distance of the middle below the eyes, in distances between the eyes
CROPS: Final = ((4.2, 0.75), (3.4, 0.75))
EYE: Final = 64  # pixels of a side of what the network of an eye sees
EYE_CROP: Final = 2.3  # that side, in distances between the corners of the eye
LIDS: Final = (0, 8, 12, 4)  # its outer and inner corner, upper and lower lid
IRIS: Final = 71  # the middle of the iris
PRESENT: Final = 0.5  # probability of a face below which nothing is said
# the new engine of OpenCV 5 knows one of a network's outputs alone
_ENGINE: Final[Mapping[str, Any]] = {"engine": getattr(cv2.dnn, "ENGINE_CLASSIC", 0)} if cv2.__version__ >= "5" else {}


@dataclass
class Mesh:
    """The network in a file."""

    path: Path

    def measure(self, frame: Frame, head: Similarity, crops: tuple[tuple[float, float], ...] = CROPS) -> Array | None:
        """The points (C, 468, 2) of a face by each crop, in pixels of the stabilized image; None without a face."""
        by_crop = []
        for side, below in crops:
            zoom = side * EYES / CROP
            middle = np.array([MIDDLE, EYE_LINE + below * EYES])
            crop = Similarity(head.to_frame(middle), head.scale * zoom, head.angle).read(frame, CROP)
            points, presence = _outputs(self.path, crop.bgr)
            if 1 / (1 + math.exp(-float(presence.ravel()[0]))) < PRESENT:
                return None
            by_crop.append((points.reshape(COUNT, 3)[:, :2] - (CROP - 1) / 2) * zoom + middle)
        return np.asarray(by_crop, np.float64)


@dataclass
class Iris:
    """MediaPipe's iris network in a file (Ablavatski et al. 2020): lids, corners and iris of an eye."""

    path: Path

    def measure(self, frame: Frame, head: Similarity, corners: Array) -> tuple[Array, Array]:
        """The points (8, 2) of both eyes, as in GROUPS, and the middles (2, 2) of the irises, by `corners` (4, 2).

        All are in the stabilized image.
        """
        eyes, irises = np.empty((8, 2)), np.empty((2, 2))
        for k, (eye, ends, way) in enumerate(zip(SIDES, corners.reshape(2, 2, 2), (1, -1), strict=True)):
            zoom = EYE_CROP * math.hypot(*(ends[1] - ends[0]).tolist()) / EYE
            view = Similarity(head.to_frame(ends.mean(axis=0)), head.scale * zoom, head.angle + slope(ends))
            outputs = _outputs(self.path, view.read(frame, EYE).bgr[:, ::way])
            points = np.concatenate([output.reshape(-1, 3)[:, :2] for output in outputs])[[*LIDS, IRIS]]
            points = head.to_stabilized(view.to_frame((points - (EYE - 1) / 2) * (way, 1) + MIDDLE))
            eyes[eye], irises[k] = points[:-1], points[-1]
        return eyes, irises


def _outputs(path: Path, image: Image) -> list[Any]:
    """What the network in a file says of an image (H, W, 3), the largest output first."""
    net = _net(path, get_ident())
    net.setInput(cv2.dnn.blobFromImage(image, 1 / 255, swapRB=True))
    return sorted(net.forward(net.getUnconnectedOutLayersNames()), key=np.size, reverse=True)


@lru_cache(maxsize=32)
def _net(path: Path, thread: int) -> cv2.dnn.Net:
    """The network, loaded once for each thread, since it holds what it computes."""
    return cv2.dnn.readNetFromTFLite(str(path), **_ENGINE)
