"""What sees the points of a face in the stabilized image: the regression, the network and the detector of faces."""

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
    """What sensors say of the points in the stabilized image: those with windows, and the network's `others` (J, 2).

    `parts` are placed by the regression, and `network` (K, 2) by the network.
    """

    parts: PlacedPoints
    network: Array
    others: PlacedPoints | None


class Begun(NamedTuple):
    """What is known of regression, detector and network; the network's other points, if it has seen the face."""

    sensors: tuple[Sensor, ...]
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
        parts, network, others = self.sensed(frame, similarity, seen)
        keep, std = FADES if self.searched else 1.0, float(load_descent().std.mean())
        detected = self.named({} if found is None else found.points)
        each = (parts.at, std, REGRESSION), (detected, DETECTOR, DETECTOR), (network, std, NETWORK)
        sensors = tuple(Sensor.begin(at, x0, r, least, keep) for at, r, least in each)
        return Begun(sensors, None if others is None else MeshPoints.begin(others.at))

    def sensed(self, frame: Frame, similarity: Similarity, seen: Frame, around: Sequence[Array] = ()) -> Sensed:
        """What sensors say of the points in the stabilized image `seen`; nan, and 0, of parts that none of them knows.

        `around` (2,) are where the middle of the parts may be, beside the usual place.
        """
        descent = load_descent()
        crops = None if self.mesh is None else self.mesh.measure(frame, similarity)
        at, odds = descent.fit(seen.bgr, around)
        index = [descent.parts.index(part) if part in descent.parts else -1 for part in self.parts]
        known = np.array(index) >= 0
        at = np.where(known[:, None], at[index], np.nan)
        if crops is None:
            return Sensed(PlacedPoints(at, np.where(known, odds[index], 0.0)), np.full_like(at, np.nan), None)
        points = crops.mean(axis=0)
        network = points[[NAMES[point] for point in descent.points]]
        there = descent.visible(seen_in(seen.bgr), network)
        # a part is where either says
        odds = np.logaddexp(odds, there[: len(odds)]) - math.log(2)
        parts = PlacedPoints(at, np.where(known, odds[index], 0.0))
        # a point is as visible as the nearest of which something is known
        others = points[[NAMES[part] for part in self.others]]
        nearest = np.hypot(*(others[:, None] - network).transpose(2, 0, 1)).argmin(axis=1)
        placed = np.where(known[:, None], network[index], np.nan)
        return Sensed(parts, placed, PlacedPoints(others, there[nearest]))
