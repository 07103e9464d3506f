"""From the settings of a target and its start to the target, and to the shape prior of its points (ours)."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from facetrack_cli.core.face_points import GROUPS, IRISES, POINTS
from facetrack_cli.core.geometry import centre, size_of_points
from facetrack_cli.core.models import model_path
from facetrack_cli.core.types import Array, Box, Start, TargetStart
from facetrack_cli.engine.protocols import Prior
from facetrack_cli.engine.spaces import Context
from facetrack_cli.engine.target import ParticleTarget, calibration_of, particle_target
from facetrack_cli.recipe.model import ConfidenceSettings, ParticleFilterSettings, Recipe, above
from facetrack_cli.recipe.sections import FactorizedSettings
from facetrack_cli.trackers.box.hidden_box import BoxTarget
from facetrack_cli.trackers.face.cascaded_regression import CORNER, load_regression
from facetrack_cli.trackers.face.detectors import detector
from facetrack_cli.trackers.face.landmark_sensors import LandmarkSensors
from facetrack_cli.trackers.face.mesh import NAMES, Iris, Mesh
from facetrack_cli.trackers.face.motion import measured
from facetrack_cli.trackers.face.settings import HeadSettings, StudentTSettings
from facetrack_cli.trackers.face.stabilized import FACE, Similarity, change_between, growth, slope
from facetrack_cli.trackers.face.target import FaceTarget
from facetrack_cli.trackers.points.settings import ParzenSettings
from facetrack_cli.trackers.points.shape_prior import MIN_SIGMA, BoundPrior, build


def face_target(
    recipe: Recipe, key: str, settings: ParticleFilterSettings, head: HeadSettings, start: Start, name: str
) -> FaceTarget:
    """The head by its own filter, and the points by the recipe's, in the stabilized image."""

    def network(kind: str, name: str) -> Path:
        if (path := model_path(name)) is None:
            remedy = "bring it by facetrack models get mesh, or write null"
            raise recipe.error(f"{above(key)}head.landmarks.{kind}", f"the network {name} is not here; {remedy}")
        return path

    placed = start.targets[name]
    box = placed.box or box_around(placed)
    side, searched = math.sqrt(box[2] * box[3]), start.placed_by != ""
    pose = pose_of(placed, box) if searched else np.zeros(4)
    middle = np.array(centre(box)) + side * pose[2:]
    similarity = Similarity(middle, side * math.exp(pose[1]) / FACE, float(pose[0]))
    at = {part: tuple(similarity.to_stabilized(np.array(place)).tolist()) for part, place in placed.points.items()}
    windows = {part: (w / similarity.scale, h / similarity.scale) for part, (w, h) in placed.windows.items()}
    still, boxed = (
        replace(start, targets={name: part}, corrections=())
        for part in (TargetStart(None, at, windows), TargetStart(box))
    )
    judged = ConfidenceSettings(lost_below=head.lost_below, patience=1)
    box_filter = ParticleFilterSettings.model_construct(
        target=head.target, motion=head.motion, likelihood=head.likelihood, filter=head.filter, confidence=judged
    )
    landmarks, by = head.landmarks, None if head.detections is None else head.detections.by
    mesh = None if landmarks.network is None else Mesh(network("network", landmarks.network))
    iris = None if mesh is None or landmarks.iris is None else Iris(network("iris", landmarks.iris))
    eyes, more = GROUPS["eyes"], POINTS if landmarks.points == "features" else tuple(NAMES)
    features = replace(particle_target(recipe, key, settings, still, name, ParticleTarget), calibration=None)
    if isinstance(settings.filter, FactorizedSettings) and isinstance(features.prior, StudentPrior):
        features = replace(features, step=partial(measured, settings.filter))
    sensors = LandmarkSensors(
        features.parts,
        None if by is None else detector(start.measured_by if by == "auto" else by),
        searched=searched,
        mesh=mesh,
        others=() if mesh is None else tuple(point for point in more if point not in (*settings.points, *eyes)),
        eyes=tuple(point for point in (*eyes, *(IRISES if iris else ())) if point not in settings.points),
        iris=iris,
    )
    box_target = particle_target(recipe, f"{key}.head" if key else "head", box_filter, boxed, name, BoxTarget)
    return FaceTarget(name, box_target, features, head, sensors, side, calibration_of(recipe, key, settings), pose)


def pose_of(start: TargetStart, box: Box) -> Array:
    """How a face lies in a box that a search has found, (4,) as in `FaceState`: by the box and by its points alike."""
    regression, side = load_regression(), math.sqrt(box[2] * box[3])
    parts = [part for part in regression.parts if part in start.points]
    if len(parts) < 3:
        return np.zeros(4)
    rest = (regression.mean + CORNER)[[regression.parts.index(part) for part in parts]]
    at = np.array([start.points[part] for part in parts])
    ends = [start.points.get(part) for part in ("mouth_left", "mouth_right")]
    roll, log_size = slope(np.array(ends)) if None not in ends else 0.0, change_between(at, rest)[1]
    shape = Similarity(np.zeros(2), math.exp(log_size), roll)
    off = (at.mean(axis=0) - shape.to_frame(rest.mean(axis=0)) - centre(box)) / side
    return np.array([roll, 0.5 * (log_size - math.log(side / FACE)), *(0.5 * off)])


def box_with(later: TargetStart, start: TargetStart) -> Box | None:
    """The box for points of a later frame, as it lay about them at the start; of a single point the start's box."""
    common = [part for part in later.points if part in start.points]
    if start.box is None or len(common) < 2:
        return start.box
    x, rest = (np.array([placed.points[part] for part in common]) for placed in (later, start))
    scale = growth(x, rest)
    left, top = (x.mean(axis=0) + scale * (np.array(start.box[:2]) - rest.mean(axis=0))).tolist()
    return left, top, scale * start.box[2], scale * start.box[3]


def box_around(start: TargetStart) -> Box:
    """A face's box, as frontal cascades draw it, from its points."""
    x = np.array(list(start.points.values()))
    side = 3.0 * size_of_points(x)  # of nose and mouth
    left, top = (x.mean(axis=0) - (0.5 * side, 0.72 * side)).tolist()
    return left, top, side, side


# --- the shape prior of its points ------------------------------------------------------------------------------------


def build_student(settings: StudentTSettings, context: Context) -> StudentPrior:
    """The Student t prior of a recipe, from the same files as `build`."""
    shapes = ParzenSettings(type="parzen", file=settings.file, sigma=MIN_SIGMA)
    return StudentPrior(build(shapes, context), settings.freedom)


class StudentPrior(Prior):
    """Student t density over the parts as seen from the stable one, with the shapes' second moments about rest (ours).

    With q (2 (K - 1),) the displacements of the other parts since the first frame, relative to the stable part, in
    units of L0, C = E[h h^T] + MIN_SIGMA^2 I over training shapes h, and n = `freedom`,

        log_density(s) = -(n + 2 (K - 1)) / 2 log(1 + q^T C^-1 q / n)

    without its constant. x is (N, K, 2) in pixels.
    """

    def __init__(self, bound: BoundPrior, freedom: float) -> None:
        self.first, self.length, self.freedom = bound.first, bound.length, float(freedom)
        h = bound.shapes[:, bound.moving].reshape(len(bound.shapes), -1)
        self.cov = h.T @ h / len(h) + MIN_SIGMA**2 * np.eye(h.shape[1])
        # q^T C^-1 q is the square of q L, where C^-1 = L L^T and q = (x - first) D
        relative = np.eye(len(self.first))[:, bound.moving] - np.eye(len(self.first))[:, [bound.stable]]
        self.to_unit = np.kron(relative, np.eye(2)) @ np.linalg.cholesky(np.linalg.inv(self.cov)) / self.length
        self.origin = self.first.ravel() @ self.to_unit

    def log_density(self, x: Array) -> Array:
        """(N,): the log density, at most 0."""
        unit = x.reshape(-1, len(self.to_unit)) @ self.to_unit - self.origin
        squared = np.einsum("ni,ni->n", unit, unit)
        return np.asarray(-0.5 * (self.freedom + unit.shape[1]) * np.log1p(squared / self.freedom))
