"""The sensors of a face's points in one frame: cascaded regressions, networks and a detector of faces."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.face_points import GROUPS, IRISES, MESH
from facetrack_cli.core.types import Array, Frame, Mask, Point, Whole
from facetrack_cli.trackers.face import landmark_filters as filters
from facetrack_cli.trackers.face.cascaded_regression import MAX_LOG_ODDS, PlacedPoints, face_channels, load_regression
from facetrack_cli.trackers.face.detectors import Detection, Detector, again
from facetrack_cli.trackers.face.eyes import CORNERS, SIDES, load_eyes, openings
from facetrack_cli.trackers.face.landmark_filters import BiasFilter, LandmarkFilter
from facetrack_cli.trackers.face.mesh import NAMES, Iris, Mesh
from facetrack_cli.trackers.face.stabilized import BOX, EYES, Similarity

OF_EYES: Final = (*GROUPS["eyes"], *IRISES)
TRUSTED: Final = 0.4  # weight of the network for eyes beside the regression
BLINKS: Final = 0.1 * EYES  # the least standard deviation of how lids and irises move, pixels
IRIS_BIAS: Final = 0.03 * EYES  # the network's lasting error of an iris, pixels; chosen, not measured
SHUT: Final = 0.15  # opening of an eye, below which its iris is covered; by as much more it is surely seen


class LandmarkReadings(NamedTuple):
    """What regressions and networks say of the points in a stabilized image; places are in its pixels."""

    channels: NDArray[np.float32]  # (C, H, W + 8), what the regressions read
    parts: PlacedPoints  # with windows, K, by the regression; nan, and log odds of 0, of those it does not know
    network: Array  # (K, 2), the same points by the network; nan where it sees no face
    others: PlacedPoints | None  # the network's further points; None where it sees no face
    eyes: PlacedPoints | None  # by regression and network together; None where they have no rows


@dataclass(frozen=True)
class LandmarkSensors:
    """The sensors of one face."""

    parts: tuple[str, ...]  # names of the points with windows
    detector: Detector | None
    searched: bool  # whether the start was placed by a search, and not by hand
    mesh: Mesh | None = None
    others: tuple[str, ...] = ()  # names of points without windows, as `eyes`
    eyes: tuple[str, ...] = ()
    iris: Iris | None = None

    def detected(self, image: Frame) -> Detection | None:
        """The face that the detector sees in the stabilized image."""
        return None if self.detector is None else self.detector.measure(image.bgr, BOX)

    def faces(self, frame: Frame, face: Similarity) -> list[Detection]:
        """The faces that the detector sees anywhere in a frame, turned about as `face`."""
        return [] if self.detector is None else again(self.detector, frame, face)

    def places(self, points: Mapping[str, Point]) -> Array:
        """(K, 2): the places of the parts; nan for a missing part."""
        return np.array([points.get(part, (math.nan, math.nan)) for part in self.parts])

    def begin(
        self, frame: Frame, similarity: Similarity, image: Frame, detection: Detection | None, x0: Array
    ) -> tuple[BiasFilter, LandmarkFilter | None, LandmarkFilter | None]:
        """Filters after the first frame, whose parts are at x0 (K, 2) in the stabilized image.

        Returns
        -------
        Bias filter of regression, detector and network; the filter of the network's further points, None where it
        sees no face; that of the eyes, None where they have no rows.
        """
        _, parts, network, others, eyes = self.read(frame, similarity, image)
        keep, std = filters.FADES if self.searched else 1.0, float(load_regression().std.mean())
        detected = self.places({} if detection is None else detection.points)
        z, least = (
            np.stack([parts.at, detected, network]),
            np.array([filters.REGRESSION, filters.DETECTOR, filters.NETWORK]),
        )
        biases = BiasFilter.begin(z, x0, np.array([std, filters.DETECTOR, std]), least, keep)
        mesh_filter = None if others is None else LandmarkFilter.begin(others.at)
        if eyes is None:
            return biases, mesh_filter, None
        bias, motion = np.full(len(OF_EYES), IRIS_BIAS), np.full(len(OF_EYES), BLINKS)
        bias[np.array(SIDES)], motion[CORNERS] = load_eyes().std, filters.MIN_MOTION
        index = [OF_EYES.index(part) for part in self.eyes]
        eye_filter = LandmarkFilter.begin(eyes.at, bias[index], motion[index])
        return biases, mesh_filter, eye_filter._replace(visible=0.5 * eye_filter.visible).after(*eyes)

    def read(
        self, frame: Frame, similarity: Similarity, image: Frame, around: Sequence[Array] = ()
    ) -> LandmarkReadings:
        """What the sensors say of a frame, of which `image` is the stabilized image.

        `around` are further middles (2,) of the parts from which the regression may start.
        """
        regression, channels = load_regression(), face_channels(image.bgr)
        crops = None if self.mesh is None else self.mesh.measure(frame, similarity)
        mesh = None if crops is None else crops.mean(axis=0)
        at, odds = regression.fit(image.bgr, around, channels)
        eyes = self._eyes(frame, similarity, channels, at, mesh)
        (index, trained), others = self._trained, None
        network = np.full((len(index), 2), np.nan)
        if mesh is not None:
            core = mesh[[NAMES[point] for point in regression.points]]
            core_odds = regression.visible(channels, core)
            network[trained] = core[index[trained]]
            # a part is visible if it is at either place, a further point as much as the nearest one that is known
            odds = np.logaddexp(odds, core_odds[: len(odds)]) - math.log(2)
            more = mesh[[NAMES[part] for part in self.others]]
            nearest = np.hypot(*(more[:, None] - core).transpose(2, 0, 1)).argmin(axis=1)
            others = PlacedPoints(more, core_odds[nearest])
        if self.parts != regression.parts:
            at, odds = np.where(trained[:, None], at[index], np.nan), np.where(trained, odds[index], 0.0)
        return LandmarkReadings(channels, PlacedPoints(at, odds), network, others, eyes)

    @cached_property
    def _trained(self) -> tuple[Whole, Mask]:
        """(K,) each: the indices of the parts in the regression, and whether it knows them."""
        known = load_regression().parts
        index = np.array([known.index(part) if part in known else -1 for part in self.parts])
        return index, index >= 0

    def log_odds_at(self, channels: NDArray[np.float32], places: Array) -> Array:
        """(M, K): log odds that the parts are visible at `places` (M, K, 2); 0 of parts that were not trained."""
        regression, odds = load_regression(), np.zeros(places.shape[:2])
        (index, trained), at = self._trained, np.zeros((len(regression.parts), 2))
        for row, place in zip(odds, places, strict=True):
            at[index[trained]] = place[trained]
            row[trained] = regression.visible(channels, at)[index[trained]]
        return odds

    def _eyes(
        self, frame: Frame, face: Similarity, channels: NDArray[np.float32], parts: Array, mesh: Array | None
    ) -> PlacedPoints | None:
        """The eyes by the regression; where the mesh (468, 2) is there, by the iris network as well."""
        if not self.eyes:
            return None
        at, odds = load_eyes().fit(frame, face, channels, parts)
        if self.iris is not None:
            irises, iris_odds = at[CORNERS].reshape(2, 2, 2).mean(axis=1), np.full(2, filters.NO_FACE)
            if mesh is not None:
                corners = mesh[[MESH[OF_EYES[i]] for i in CORNERS]]
                lids, irises = self.iris.measure(frame, face, corners)
                at = (1 - TRUSTED) * at + TRUSTED * lids
                iris_odds = odds[[0, 4]] + MAX_LOG_ODDS * (openings(at) / SHUT - 1)
            at, odds = np.concatenate([at, irises]), np.concatenate([odds, iris_odds])
        index = [OF_EYES.index(part) for part in self.eyes]
        return PlacedPoints(at[index], odds[index])
