"""Motion models: how a particle moves from one frame to the next, and the density of that move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from facetrack_cli.types import Array


@dataclass(frozen=True)
class RandomWalk:
    """Zero-order Gaussian motion, p(a_i | a_i^-) = N(a_i^-, sigma_i^2 I) (Patras & Pantic 2004, section 3.3).

    `sigma` (K,): the standard deviation of each part along each coordinate, in pixels.
    """

    sigma: Array

    def propagate(self, rng: np.random.Generator, x: Array) -> Array:
        """x (N, K, D) moved by one frame."""
        return x + self.sigma[:, None] * rng.standard_normal(x.shape)

    def log_transition(self, x: Array, parents: Array) -> Array:
        """log p(x_n | parents_m) of each part: x (N, K, D), parents (M, K, D) -> (N, M, K)."""
        d = x.shape[2]
        squared = np.sum((x[:, None] - parents[None]) ** 2, axis=3)
        constant = -0.5 * d * np.log(2 * np.pi) - d * np.log(self.sigma)
        return np.asarray(-0.5 * squared / self.sigma**2 + constant)
