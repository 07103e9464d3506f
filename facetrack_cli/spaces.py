"""State spaces: what the numbers of a particle mean, and how a posterior becomes image geometry."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from facetrack_cli.types import Array, Particles


class Estimate(NamedTuple):
    """Posterior mean (K, 2) and covariance (K, 2, 2) of the parts' centres, in pixels."""

    mean: Array
    cov: Array


def estimate_points(particles: Particles) -> Estimate:
    """Weighted mean and covariance of x (N, K, 2)."""
    w = np.exp(particles.log_w)
    mean = np.einsum("n,nkd->kd", w, particles.x)
    centred = particles.x - mean
    return Estimate(mean, np.einsum("n,nkd,nke->kde", w, centred, centred))


def size_of_points(x0: Array) -> float:
    """The unit of length of a recipe for points x0 (K, 2): the largest distance between two of them, in pixels."""
    return float(np.sqrt(np.sum((x0[:, None] - x0[None]) ** 2, axis=2)).max())
