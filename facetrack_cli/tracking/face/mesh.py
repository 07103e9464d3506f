"""MediaPipe's face mesh as a sensor: 468 points of a face by a small network, where its file is there.

`face_landmark.tflite` (Google, Apache-2.0; Kartynnik et al., "Real-time Facial Surface Geometry from Monocular Video on
Mobile GPUs", 2019) is run by OpenCV. It sees the upright face as it lies in the head, in two crops of different size;
the mean of both is more exact than either.
"""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path
from threading import get_ident
from typing import Final

import cv2
import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.face_points import MESH, POINTS
from facetrack_cli.core.types import Array, Frame
from facetrack_cli.tracking.face.stabilized import EYE_LINE, EYES, MIDDLE, Similarity

COUNT: Final = 468
NAMES: Final = {
    **{f"mesh_{i}": i for i in range(COUNT) if i not in MESH.values()},
    **{part: MESH[part] for part in POINTS},
}
"""Every point of the mesh by its name."""
CROP: Final = 192  # pixels of a side of what the network sees
# crops: side, and distance of the middle below the eyes, in distances between the eyes
CROPS: Final = ((4.2, 0.75), (3.4, 0.75))
PRESENT: Final = 0.5  # probability of a face below which nothing is said


class Mesh:
    """The network in a file. Raises InputError for a file that is none."""

    def __init__(self, path: Path) -> None:
        self.path = path
        _net(path, get_ident())

    def measure(self, frame: Frame, head: Similarity, crops: tuple[tuple[float, float], ...] = CROPS) -> Array | None:
        """The points (C, 468, 2) of a face by each crop, in pixels of the stabilized image; None without a face."""
        net, found = _net(self.path, get_ident()), []
        for side, below in crops:
            zoom = side * EYES / CROP
            middle = np.array([MIDDLE, EYE_LINE + below * EYES])
            crop = Similarity(head.to_frame(middle), head.scale * zoom, head.angle).read(frame, CROP)
            net.setInput(cv2.dnn.blobFromImage(crop.bgr, 1 / 255, swapRB=True))
            points, presence = sorted(net.forward(net.getUnconnectedOutLayersNames()), key=np.size, reverse=True)
            if 1 / (1 + math.exp(-float(presence.ravel()[0]))) < PRESENT:
                return None
            found.append((points.reshape(COUNT, 3)[:, :2] - (CROP - 1) / 2) * zoom + middle)
        return np.asarray(found, np.float64)


@lru_cache(maxsize=16)
def _net(path: Path, thread: int) -> cv2.dnn.Net:
    """The network, loaded once for each thread, since it holds what it computes."""
    remedy = "get it by facetrack models get mesh, or name face_landmark.tflite"
    try:
        net = cv2.dnn.readNetFromTFLite(str(path))
        net.setInput(np.zeros((1, 3, CROP, CROP), np.float32))
        sizes = sorted(one.size for one in net.forward(net.getUnconnectedOutLayersNames()))
    except cv2.error:
        raise InputError(f"{path}: is no network that OpenCV reads; {remedy}") from None
    if sizes != [1, 3 * COUNT]:
        raise InputError(f"{path}: is another network than MediaPipe's face mesh; {remedy}")
    return net
