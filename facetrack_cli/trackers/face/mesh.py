"""MediaPipe's face mesh as a sensor: 468 points of a face by a small network, where its file is there.

`face_landmark.tflite` (Google, Apache-2.0; Kartynnik et al., "Real-time Facial Surface Geometry from Monocular Video on
Mobile GPUs", 2019) is run by OpenCV. It sees the upright face as it lies in the head, in two crops of different size;
the mean of both is more exact than either.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from threading import get_ident
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.face_points import MESH, POINTS
from facetrack_cli.core.types import Array, Frame, Image
from facetrack_cli.trackers.face.eyes import SIDES
from facetrack_cli.trackers.face.stabilized import EYE_LINE, EYES, MIDDLE, Similarity, slope

COUNT: Final = 468
NAMES: Final = {
    **{f"mesh_{i}": i for i in range(COUNT) if i not in MESH.values()},
    **{part: MESH[part] for part in POINTS},
}
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


# of a network: pixels of a side of its input, sizes of its outputs, what it is, and its file's name
_MESH: Final = (CROP, (1, 3 * COUNT), "MediaPipe's face mesh", "face_landmark.tflite")
_IRIS: Final = (EYE, (15, 213), "MediaPipe's iris network", "iris_landmark.tflite")


class Mesh:
    """The network in a file. Raises InputError for a file that is none."""

    def __init__(self, path: Path) -> None:
        self.path = path
        _net(path, get_ident(), *_MESH)

    def measure(self, frame: Frame, head: Similarity, crops: tuple[tuple[float, float], ...] = CROPS) -> Array | None:
        """The points (C, 468, 2) of a face by each crop, in pixels of the stabilized image; None without a face."""
        by_crop = []
        for side, below in crops:
            zoom = side * EYES / CROP
            middle = np.array([MIDDLE, EYE_LINE + below * EYES])
            crop = Similarity(head.to_frame(middle), head.scale * zoom, head.angle).read(frame, CROP)
            points, presence = _outputs(_net(self.path, get_ident(), *_MESH), crop.bgr)
            if 1 / (1 + math.exp(-float(presence.ravel()[0]))) < PRESENT:
                return None
            by_crop.append((points.reshape(COUNT, 3)[:, :2] - (CROP - 1) / 2) * zoom + middle)
        return np.asarray(by_crop, np.float64)


class Iris:
    """MediaPipe's iris network in a file (Ablavatski et al. 2020): lids, corners and iris of an eye.

    Raises InputError for a file that is none.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        _net(path, get_ident(), *_IRIS)

    def measure(self, frame: Frame, head: Similarity, corners: Array) -> tuple[Array, Array]:
        """The points (8, 2) of both eyes, as in GROUPS, and the middles (2, 2) of the irises, by `corners` (4, 2).

        All are in the stabilized image.
        """
        eyes, irises = np.empty((8, 2)), np.empty((2, 2))
        for k, (eye, ends, way) in enumerate(zip(SIDES, corners.reshape(2, 2, 2), (1, -1), strict=True)):
            zoom = EYE_CROP * math.hypot(*(ends[1] - ends[0]).tolist()) / EYE
            view = Similarity(head.to_frame(ends.mean(axis=0)), head.scale * zoom, head.angle + slope(ends))
            outputs = _outputs(_net(self.path, get_ident(), *_IRIS), view.read(frame, EYE).bgr[:, ::way])
            points = np.concatenate([output.reshape(-1, 3)[:, :2] for output in outputs])[[*LIDS, IRIS]]
            points = head.to_stabilized(view.to_frame((points - (EYE - 1) / 2) * (way, 1) + MIDDLE))
            eyes[eye], irises[k] = points[:-1], points[-1]
        return eyes, irises


def _outputs(net: cv2.dnn.Net, image: Image | NDArray[np.float32]) -> list[Any]:
    """The network's outputs for an image (H, W, 3), the largest first."""
    net.setInput(cv2.dnn.blobFromImage(image, 1 / 255, swapRB=True))
    return sorted(net.forward(net.getUnconnectedOutLayersNames()), key=np.size, reverse=True)


@lru_cache(maxsize=32)
def _net(path: Path, thread: int, side: int, sizes: tuple[int, ...], what: str, name: str) -> cv2.dnn.Net:
    """The network, loaded once for each thread, since it holds what it computes."""
    remedy = f"get it by facetrack models get mesh, or name {name}"
    try:
        net = cv2.dnn.readNetFromTFLite(str(path), **_ENGINE)
        actual = tuple(sorted(output.size for output in _outputs(net, np.zeros((side, side, 3), np.float32))))
    except cv2.error:
        raise InputError(f"{path}: is no network that OpenCV reads; {remedy}") from None
    if actual != sizes:
        raise InputError(f"{path}: is another network than {what}; {remedy}")
    return net
