"""The shape prior of a face: Student's t over the parts' places (ours)."""

from __future__ import annotations

import numpy as np

from facetrack_cli.core.types import Array
from facetrack_cli.engine.protocols import Prior
from facetrack_cli.engine.spaces import Context
from facetrack_cli.trackers.face.settings import StudentTSettings
from facetrack_cli.trackers.points.settings import ParzenSettings
from facetrack_cli.trackers.points.shape_prior import MIN_SIGMA, BoundPrior, build


def build_student(settings: StudentTSettings, context: Context) -> StudentPrior:
    """The Student t prior of a recipe, from the same files as `build`."""
    return StudentPrior(
        build(ParzenSettings(type="parzen", file=settings.file, sigma=MIN_SIGMA), context), settings.freedom
    )


class StudentPrior(Prior):
    """Student t density over the parts as seen from the stable one, with the shapes' second moments about rest (ours).

    With q (2 (K - 1),) the displacements of the other parts since the first frame, relative to the stable part, in
    units of L0, C = E[h h^T] + MIN_SIGMA^2 I over training shapes h, and n = `freedom`,

        log_density(s) = -(n + 2 (K - 1)) / 2 log(1 + q^T C^-1 q / n)

    without its constant. x is (N, K, 2) in pixels.
    """

    def __init__(self, bound: BoundPrior, freedom: float) -> None:
        self.first, self.length, self.freedom = bound.first, bound.length, freedom
        h = bound.shapes[:, bound.moving].reshape(len(bound.shapes), -1)
        self.cov = h.T @ h / len(h) + MIN_SIGMA**2 * np.eye(h.shape[1])
        # q^T C^-1 q is the square of q L, where C^-1 = L L^T and q = (x - first) D
        relative = np.eye(len(self.first))[:, bound.moving] - np.eye(len(self.first))[:, [bound.stable]]
        self._to_unit = np.kron(relative, np.eye(2)) @ np.linalg.cholesky(np.linalg.inv(self.cov)) / self.length
        self._first = self.first.ravel() @ self._to_unit

    def log_density(self, x: Array) -> Array:
        """(N,): the log density, at most 0."""
        unit = x.reshape(-1, len(self._to_unit)) @ self._to_unit - self._first
        squared = np.einsum("ni,ni->n", unit, unit)
        return np.asarray(-0.5 * (self.freedom + unit.shape[1]) * np.log1p(squared / self.freedom))
