"""State spaces: what the numbers of a particle mean, and how a posterior becomes image geometry.

============  =========================  ==============================================================================
space         a part's state             image geometry
============  =========================  ==============================================================================
PointSpace    x, y                       a window of fixed size around each point
BoxSpace      x, y, s, and their speeds  an upright box, s times as large as at the start (Odobez 2003, section 3.2)
CloudSpace    x, y of one pixel          an upright box about the whole cloud of particles (Gianni et al. 2007)
============  =========================  ==============================================================================
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from facetrack_cli.types import Array, Particles


class Estimate(NamedTuple):
    """Posterior mean of the state (K, D), and covariance (K, 2, 2) of the parts' centres, in pixels."""

    mean: Array
    cov: Array


class Space(Protocol):
    """What a state is in the picture. Its first two coordinates are the centre of the part, in pixels."""

    def windows(self, estimated: Estimate) -> Array:
        """(K, 2): width and height in pixels of each part."""


@dataclass(frozen=True)
class PointSpace:
    """Points: state (K, 2). `sides` (K, 2): the window of each, in pixels."""

    sides: Array

    def windows(self, estimated: Estimate) -> Array:
        return self.sides


@dataclass(frozen=True)
class BoxSpace:
    """A box: state (1, 6) = (x, y, s, and the speed of each, per frame). `size`: width, height in pixels at s = 1."""

    size: tuple[float, float]

    def windows(self, estimated: Estimate) -> Array:
        return np.asarray(estimated.mean[:, 2:3] * np.array(self.size))


@dataclass(frozen=True)
class CloudSpace:
    """A cloud in which each particle is a pixel: state (1, 2) = (x, y).

    Its box has four standard deviations a side, which is exact of an ellipse evenly filled.
    """

    def windows(self, estimated: Estimate) -> Array:
        return 4.0 * np.sqrt(np.maximum(np.diagonal(estimated.cov, axis1=1, axis2=2), 0.0))


def estimate(particles: Particles) -> Estimate:
    """Weighted mean of x (N, K, D), and covariance of its first two coordinates."""
    w = np.exp(particles.log_w)
    mean = np.einsum("n,nkd->kd", w, particles.x)
    centred = particles.x[..., :2] - mean[:, :2]
    return Estimate(mean, np.einsum("n,nkd,nke->kde", w, centred, centred))


def evenly(x0: Array, windows: Array) -> Estimate:
    """The estimate of x0 (K, D) and `windows` (K, 2) at the start, with the covariance of evenly filled ellipses."""
    cov = np.zeros((len(x0), 2, 2))
    cov[:, [0, 1], [0, 1]] = (windows / 4.0) ** 2
    return Estimate(x0, cov)


def size_of_points(x0: Array) -> float:
    """The unit of length of a recipe for points x0 (K, 2): the largest distance between two of them, in pixels."""
    return float(np.sqrt(np.sum((x0[:, None] - x0[None]) ** 2, axis=2)).max())


def state_of_box(left: float, top: float, w: float, h: float) -> Array:
    """(1, 6): the state of a box at the start, at rest and of scale 1; pixel centres are whole numbers."""
    return np.array([[left + (w - 1) / 2, top + (h - 1) / 2, 1.0, 0.0, 0.0, 0.0]])
