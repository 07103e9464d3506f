"""What sees the points of a face in the stabilized image: the regression, the network and the detector of faces."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.face_points import GROUPS, IRISES, MESH
from facetrack_cli.core.types import Array, Frame, Point
from facetrack_cli.trackers.face import stabilized
from facetrack_cli.trackers.face.closer import again
from facetrack_cli.trackers.face.descent import SURE, PlacedPoints, load_descent, seen_in
from facetrack_cli.trackers.face.detectors import Detector, Found
from facetrack_cli.trackers.face.eyes import CORNERS, SIDES, load_eyes, openings
from facetrack_cli.trackers.face.mesh import NAMES, Iris, Mesh
from facetrack_cli.trackers.face.mesh_points import MIN_MOVES, NO_FACE, MeshPoints
from facetrack_cli.trackers.face.sensors import DETECTOR, FADES, NETWORK, REGRESSION, Sensor
from facetrack_cli.trackers.face.stabilized import EYES, Similarity

OF_EYES: Final = (*GROUPS["eyes"], *IRISES)
TRUSTED: Final = 0.4  # weight of the network for eyes beside the regression
BLINKS: Final = 0.1 * EYES  # the least standard deviation of how lids and irises move, pixels
IRIS_OFF: Final = 0.03 * EYES  # by how much the network is off for long with an iris, pixels; chosen, not measured
SHUT: Final = 0.15  # opening of an eye, below which its iris is covered; by as much more it is surely seen


class Sensed(NamedTuple):
    """What sensors say of the points in the stabilized image: those with windows, and the network's `others` (J, 2).

    `parts` are placed by the regression, in the `channels` of that image, `network` (K, 2) by the network, and `eyes`
    by both.
    """

    channels: NDArray[np.float32]
    parts: PlacedPoints
    network: Array
    others: PlacedPoints | None
    eyes: PlacedPoints | None


class Begun(NamedTuple):
    """What is known of regression, detector and network; the network's other points, if it has seen the face; eyes."""

    sensors: tuple[Sensor, ...]
    others: MeshPoints | None
    eyes: MeshPoints | None


@dataclass(frozen=True)
class Senses:
    """The sensors of a face. Its `parts` have windows, its `others` and those of its `eyes` have none.

    `detector`, `mesh` and `iris` may be None. `searched`: whether the detector has placed the points itself.
    """

    parts: tuple[str, ...]
    detector: Detector | None
    searched: bool
    mesh: Mesh | None = None
    others: tuple[str, ...] = ()
    eyes: tuple[str, ...] = ()
    iris: Iris | None = None

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
        _, parts, network, others, eyes = self.sensed(frame, similarity, seen)
        keep, std = FADES if self.searched else 1.0, float(load_descent().std.mean())
        detected = self.named({} if found is None else found.points)
        each = (parts.at, std, REGRESSION), (detected, DETECTOR, DETECTOR), (network, std, NETWORK)
        sensors = tuple(Sensor.begin(at, x0, r, least, keep) for at, r, least in each)
        begun = None if others is None else MeshPoints.begin(others.at)
        if eyes is None:
            return Begun(sensors, begun, None)
        wrong, least = np.full(len(OF_EYES), IRIS_OFF), np.full(len(OF_EYES), BLINKS)
        wrong[np.array(SIDES)], least[CORNERS] = load_eyes().std, MIN_MOVES
        index = [OF_EYES.index(part) for part in self.eyes]
        points = MeshPoints.begin(eyes.at, wrong[index], least[index])
        return Begun(sensors, begun, points._replace(visible=0.5 * points.visible).after(*eyes))

    def sensed(self, frame: Frame, similarity: Similarity, seen: Frame, around: Sequence[Array] = ()) -> Sensed:
        """What sensors say of the points in the stabilized image `seen`; nan, and 0, of parts that none of them knows.

        `around` (2,) are where the middle of the parts may be, beside the usual place.
        """
        descent, channels = load_descent(), seen_in(seen.bgr)
        crops = None if self.mesh is None else self.mesh.measure(frame, similarity)
        at, odds = descent.fit(seen.bgr, around, channels)
        index = [descent.parts.index(part) if part in descent.parts else -1 for part in self.parts]
        known = np.array(index) >= 0
        points = None if crops is None else crops.mean(axis=0)
        eyes = self._eyes(frame, similarity, channels, at, points)
        at = np.where(known[:, None], at[index], np.nan)
        if points is None:
            parts = PlacedPoints(at, np.where(known, odds[index], 0.0))
            return Sensed(channels, parts, np.full_like(at, np.nan), None, eyes)
        network = points[[NAMES[point] for point in descent.points]]
        there = descent.visible(channels, network)
        # a part is where either says
        odds = np.logaddexp(odds, there[: len(odds)]) - math.log(2)
        parts = PlacedPoints(at, np.where(known, odds[index], 0.0))
        # a point is as visible as the nearest of which something is known
        others = points[[NAMES[part] for part in self.others]]
        nearest = np.hypot(*(others[:, None] - network).transpose(2, 0, 1)).argmin(axis=1)
        placed = np.where(known[:, None], network[index], np.nan)
        return Sensed(channels, parts, placed, PlacedPoints(others, there[nearest]), eyes)

    def odds_at(self, channels: NDArray[np.float32], places: Array) -> Array:
        """The log odds (M, K) that parts are visible at `places` (M, K, 2), by the regression; 0 of others."""
        descent, odds = load_descent(), np.zeros(places.shape[:2])
        known = [k for k, part in enumerate(self.parts) if part in descent.parts]
        at = np.zeros((len(descent.parts), 2))
        index = [descent.parts.index(self.parts[k]) for k in known]
        for own, those in zip(odds, places, strict=True):
            at[index] = those[known]
            own[known] = descent.visible(channels, at)[index]
        return odds

    def _eyes(
        self, frame: Frame, face: Similarity, seen: NDArray[np.float32], parts: Array, mesh: Array | None
    ) -> PlacedPoints | None:
        """The eyes, by the regression and, where the mesh (468, 2) is known, by the network for irises."""
        if not self.eyes:
            return None
        at, odds = load_eyes().fit(frame, face, seen, parts)
        iris, sees = at[CORNERS].reshape(2, 2, 2).mean(axis=1), np.full(2, NO_FACE)
        if self.iris is not None and mesh is not None:
            corners = mesh[[MESH[OF_EYES[i]] for i in CORNERS]]
            lids, iris = self.iris.measure(frame, face, corners)
            at, sees = (1 - TRUSTED) * at + TRUSTED * lids, odds[[0, 4]] + SURE * (openings(at) / SHUT - 1)
        index = [OF_EYES.index(part) for part in self.eyes]
        return PlacedPoints(np.concatenate([at, iris])[index], np.concatenate([odds, sees])[index])
