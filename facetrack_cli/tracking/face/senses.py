"""What sees the points of a face in the stabilized image: the regression or the network, and the detector of faces."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from facetrack_cli.core.types import Array, Frame, Point
from facetrack_cli.tracking.face import stabilized
from facetrack_cli.tracking.face.descent import PlacedPoints, load_descent, seen_in
from facetrack_cli.tracking.face.mesh import NAMES, Mesh
from facetrack_cli.tracking.face.mesh_points import MeshPoints
from facetrack_cli.tracking.face.sensors import DETECTOR, FADES, NETWORK, REGRESSION, Sensor
from facetrack_cli.tracking.face.stabilized import Similarity
from facetrack_cli.tracking.start.closer import again
from facetrack_cli.tracking.start.detectors import Detector, Found


class Sensed(NamedTuple):
    """What sensors say of the points in the stabilized image: those with windows, and the network's `others` (J, 2)."""

    parts: PlacedPoints
    others: PlacedPoints | None


class Begun(NamedTuple):
    """What is known of the sensor and, `second`, of the detector; the network's points, if it has seen the face."""

    sensor: Sensor
    second: Sensor
    others: MeshPoints | None


@dataclass(frozen=True)
class Senses:
    """The sensors of a face. Its `parts` have windows, its `others` have none.

    `detector` may be None. `searched`: whether it has placed the points itself.
    """

    parts: tuple[str, ...]
    detector: Detector | None
    searched: bool
    mesh: Mesh | None = None
    others: tuple[str, ...] = ()

    def detected(self, seen: Frame) -> Found | None:
        """The face that the detector sees in the stabilized image."""
        return None if self.detector is None else self.detector.measure(seen.bgr, stabilized.BOX)

    def faces(self, frame: Frame, face: Similarity) -> list[Found]:
        """The faces that the detector sees anywhere in a frame, which lie as the `face` did."""
        return [] if self.detector is None else again(self.detector, frame, face)

    def named(self, points: Mapping[str, Point]) -> Array:
        """The places (K, 2) of the parts; nan for a part that is missing."""
        return np.array([points.get(part, (math.nan, math.nan)) for part in self.parts])

    def begin(self, frame: Frame, similarity: Similarity, seen: Frame, found: Found | None, x0: Array) -> Begun:
        """What is known in a frame whose parts are at x0 (K, 2), where the detector has found the face, or not."""
        parts, others = self.sensed(frame, similarity, seen)
        least, keep = REGRESSION if self.mesh is None else NETWORK, FADES if self.searched else 1.0
        sensor = Sensor.begin(parts.at, x0, float(load_descent().std.mean()), least, keep)
        second = Sensor.begin(self.named({} if found is None else found.points), x0, DETECTOR, DETECTOR, keep)
        return Begun(sensor, second, None if others is None else MeshPoints.begin(others.at))

    def sensed(self, frame: Frame, similarity: Similarity, seen: Frame, around: Sequence[Array] = ()) -> Sensed:
        """What sensors say of the points in the stabilized image `seen`; nan, and 0, of parts that none of them knows.

        `around` (2,) are where the middle of the parts may be, beside the usual place.
        """
        descent = load_descent()
        crops = None if self.mesh is None else self.mesh.measure(frame, similarity)
        points = None if crops is None else crops.mean(axis=0)
        if points is None:
            at, odds = descent.fit(seen.bgr, around)
        else:
            at = points[[NAMES[point] for point in descent.points]]
            odds = descent.visible(seen_in(seen.bgr), at)
        index = [descent.parts.index(part) if part in descent.parts else -1 for part in self.parts]
        known = np.array(index) >= 0
        placed = known & (self.mesh is None or points is not None)
        parts = PlacedPoints(np.where(placed[:, None], at[index], np.nan), np.where(known, odds[index], 0.0))
        if points is None:
            return Sensed(parts, None)
        # a point is as visible as the nearest of which something is known
        others = points[[NAMES[part] for part in self.others]]
        nearest = np.hypot(*(others[:, None] - at).transpose(2, 0, 1)).argmin(axis=1)
        return Sensed(parts, PlacedPoints(others, odds[nearest]))
