"""Motions that several trackers share: how a particle moves in a frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from facetrack_cli.core.types import BOX, Array
from facetrack_cli.engine.protocols import Linear, Motion
from facetrack_cli.engine.spaces import Context
from facetrack_cli.recipe.sections import RandomWalkSettings


@dataclass(frozen=True)
class RandomWalk(Motion):
    """Zero-order Gaussian motion, p(a_i | a_i^-) = N(a_i^-, sigma_i^2 I) (Patras & Pantic 2004, section 3.3).

    `sigma` (K,): the standard deviation of each part along each coordinate, in pixels.
    """

    sigma: Array

    def propagate(self, rng: np.random.Generator, x: Array) -> Array:
        """x (N, K, D) moved by one frame."""
        return x + self.sigma[:, None] * rng.standard_normal(x.shape)

    def expect(self, x: Array) -> Array:
        """The mean of p(x_t | x_{t-1} = x), (N, K, D)."""
        return x

    def log_transition(self, x: Array, parents: Array) -> Array:
        """log p(x_n | parents_m) of each part: x (N, K, D), parents (M, K, D) -> (N, M, K)."""
        d = x.shape[2]
        squared = np.sum((x[:, None] - parents[None]) ** 2, axis=3)
        constant = -0.5 * d * np.log(2 * np.pi) - d * np.log(self.sigma)
        return np.asarray(-0.5 * squared / self.sigma**2 + constant)

    def linear(self, state: Array) -> Linear:
        """The motion around a state (K, D)."""
        eye = np.broadcast_to(np.eye(state.shape[1]), (len(state), state.shape[1], state.shape[1]))
        return Linear(eye, np.zeros_like(state), eye * self.sigma[:, None, None] ** 2)


@dataclass(frozen=True)
class FirstOrder(Motion):
    """Linear dynamics of values and speeds, c_k = A c_{k-1} + B w_k, w_k ~ N(0, I) (Odobez et al. 2003, section 3.2).

    The state (x, y, s, their speeds) falls into pairs c = (value, speed), which move independently: x and y by
    `position` (A, B), s by `scale`; A is (2, 2), B (2, M). At its bounds `least` and `most`, s stops, of speed 0.
    """

    position: tuple[Array, Array]
    scale: tuple[Array, Array]
    least: float
    most: float

    def propagate(self, rng: np.random.Generator, x: Array) -> Array:
        """x (N, K, 6) moved by one frame."""
        moved = np.empty_like(x)
        for i, (a, b) in enumerate((self.position, self.position, self.scale)):
            noise = rng.standard_normal((*x.shape[:2], b.shape[1]))
            # by columns: products of thousands of tiny matrices take three times as long
            for row in (0, 1):
                moved[..., i + 3 * row] = a[row, 0] * x[..., i] + a[row, 1] * x[..., i + 3]
                for source in range(b.shape[1]):
                    moved[..., i + 3 * row] += b[row, source] * noise[..., source]
        s = moved[..., 2]
        moved[..., 5] = np.where((s < self.least) | (s > self.most), 0.0, moved[..., 5])
        moved[..., 2] = np.clip(s, self.least, self.most)
        return moved

    def expect(self, x: Array) -> Array:
        """The mean of p(x_t | x_{t-1} = x), (N, K, 6); the bounds of s are left out."""
        moved = np.empty_like(x)
        for i, (a, _) in enumerate((self.position, self.position, self.scale)):
            moved[..., i::3] = x[..., i::3] @ a.T
        return moved

    def linear(self, state: Array) -> Linear:
        """The motion around a state (K, 6); the bounds of s are left out."""
        matrix, cov = np.zeros((2, len(state), 6, 6))
        for i, (a, b) in enumerate((self.position, self.position, self.scale)):
            matrix[:, i::3, i::3], cov[:, i::3, i::3] = a, b @ b.T
        return Linear(matrix, np.zeros((len(state), 6)), cov)


def random_walk(settings: RandomWalkSettings, context: Context) -> RandomWalk | FirstOrder:
    """Of points, or of the place and the scale of a box, whose speeds stay 0."""
    placed, target = context.placed, context.settings.target
    sigma = [settings.sigma.of(part).pixels(placed.unit) for part in target.points or (BOX,)]
    if target.points:
        return RandomWalk(np.array(sigma))
    stay = np.array([[1.0, 0.0], [0.0, 0.0]])
    position, scale = ((stay, np.array([[step], [0.0]])) for step in (*sigma, settings.scale))
    return FirstOrder(position, scale, *placed.scale)


def first_order(settings: Any, context: Context) -> FirstOrder:
    """Of the dynamics of a box, as a recipe writes them."""
    noise = [[length.pixels(context.placed.unit) for length in row] for row in settings.position.B]
    scale = np.array(settings.scale.A), np.array(settings.scale.B)
    return FirstOrder((np.array(settings.position.A), np.array(noise)), scale, *context.placed.scale)
