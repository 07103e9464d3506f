"""State spaces: what the numbers of a particle mean, and how a posterior becomes image geometry.

============  =========================  ==============================================================================
space         a part's state             image geometry
============  =========================  ==============================================================================
PointSpace    x, y                       a window of fixed size around each point
BoxSpace      x, y, s, and their speeds  an upright box, s times as large as at the start (Odobez 2003, section 3.2)
CloudSpace    x, y of one pixel          an upright box about the whole cloud of particles (Gianni et al. 2007)
AffineSpace   x, y, a1, a2, a3, a4       the box of the start, turned, scaled and sheared (Zhou et al. 2003, section 4)
============  =========================  ==============================================================================
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from facetrack_cli.core.geometry import centre
from facetrack_cli.core.types import Array, Box, Particles
from facetrack_cli.tracking.models.patches import scale_of
from facetrack_cli.trajectory.diagnostics import AFFINE, SCALE, Diagnostic


class Estimate(NamedTuple):
    """Point estimate of the state (K, D), and covariance (K, 2, 2) of the parts' centres, in pixels."""

    state: Array
    cov: Array


class Outline(NamedTuple):
    """What a part is in the picture if no upright box: `angle` in degrees, `corners` (4, 2) clockwise from top left."""

    angle: float
    corners: Array


class Space(Protocol):
    """What a state is in the image. Its first two coordinates are the centre of the part, in pixels.

    `diagnostics` are declared by spaces that report more than image geometry, and `diagnose` gives their values.
    """

    diagnostics: ClassVar[tuple[Diagnostic, ...]] = ()

    def diagnose(self, estimated: Estimate) -> Mapping[str, Any]:
        """The value of each diagnostic by its name."""
        return {}

    def windows(self, estimated: Estimate) -> Array:
        """(K, 2): width and height in pixels of each part."""

    def outline(self, estimated: Estimate) -> Outline | None:
        """Of the one part that is no upright box; None where all are."""
        return None

    def at(self, box: Box) -> Array:
        """(1, D): the state, at rest, of a target that fills `box` at any time."""
        raise TypeError("points are not placed by a box")


@dataclass(frozen=True)
class PointSpace(Space):
    """Points: state (K, 2). `sides` (K, 2): the window of each, in pixels."""

    sides: Array

    def windows(self, estimated: Estimate) -> Array:
        return self.sides


@dataclass(frozen=True)
class BoxSpace(Space):
    """A box: state (1, 6) = (x, y, s, and the speed of each, per frame). `size`: width, height in pixels at s = 1."""

    size: tuple[float, float]

    def windows(self, estimated: Estimate) -> Array:
        return np.asarray(estimated.state[:, 2:3] * np.array(self.size))

    def at(self, box: Box) -> Array:
        """Its scale is that of the area: the shape stays the start's."""
        state = state_of_box(*box)
        state[0, 2] = math.sqrt(box[2] * box[3] / (self.size[0] * self.size[1]))
        return state


@dataclass(frozen=True)
class CloudSpace(Space):
    """A cloud in which each particle is a pixel: state (1, 2) = (x, y).

    Its box has four standard deviations a side, which is exact of an ellipse evenly filled.
    """

    def windows(self, estimated: Estimate) -> Array:
        return 4.0 * np.sqrt(np.maximum(np.diagonal(estimated.cov, axis1=1, axis2=2), 0.0))

    def at(self, box: Box) -> Array:
        return state_of_box(*box)


@dataclass(frozen=True)
class AffineSpace(Space):
    """A box under affine maps: state (1, 6) = (x, y, a1, a2, a3, a4), [[a1, a2], [a3, a4]] from the start to now.

    `size`: width, height in pixels at the start. Its sides are those of the parallelogram; its angle is the rotation
    that is nearest to the deformation.
    """

    size: tuple[float, float]
    diagnostics: ClassVar = (SCALE, AFFINE)

    def windows(self, estimated: Estimate) -> Array:
        _, _, a1, a2, a3, a4 = estimated.state[0].tolist()
        return np.array([[math.hypot(a1, a3) * self.size[0], math.hypot(a2, a4) * self.size[1]]])

    def at(self, box: Box) -> Array:
        """Upright, and as wide and as high as the box."""
        state = affine_state_of_box(*box)
        state[0, [2, 5]] = box[2] / self.size[0], box[3] / self.size[1]
        return state

    def diagnose(self, estimated: Estimate) -> Mapping[str, Any]:
        x, y, *deformation = estimated.state[0].tolist()
        return {"scale": float(scale_of(estimated.state[None])[0, 0]), "affine": (*deformation, x, y)}

    def outline(self, estimated: Estimate) -> Outline:
        cx, cy, a1, a2, a3, a4 = estimated.state[0].tolist()
        # the border runs through the middle of the outermost pixels, as that of an upright box
        x, y = (max(side - 1, 1) / 2 for side in self.size)
        right, down = (a1 * x, a3 * x), (a2 * y, a4 * y)
        corners = [
            (cx + i * right[0] + j * down[0], cy + i * right[1] + j * down[1])
            for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))
        ]
        return Outline(math.degrees(math.atan2(a3 - a2, a1 + a4)), np.array(corners))


def estimate(particles: Particles, *, best: bool = False) -> Estimate:
    """Weighted mean of x (N, K, D), or the `best` particle; and covariance of its first two coordinates about the mean.

    The best particle is the one of the greatest weight, the first of equals: the MAP estimate if all were drawn from
    one place.
    """
    w = np.exp(particles.log_w)
    mean = np.einsum("n,nkd->kd", w, particles.x)
    centred = particles.x[..., :2] - mean[:, :2]
    cov = np.einsum("n,nkd,nke->kde", w, centred, centred)
    return Estimate(particles.x[int(np.argmax(particles.log_w))] if best else mean, cov)


def evenly(x0: Array, windows: Array) -> Estimate:
    """The estimate of x0 (K, D) and `windows` (K, 2) at the start, with the covariance of evenly filled ellipses."""
    cov = np.zeros((len(x0), 2, 2))
    cov[:, [0, 1], [0, 1]] = (windows / 4.0) ** 2
    return Estimate(x0, cov)


def affine_state_of_box(left: float, top: float, w: float, h: float) -> Array:
    """(1, 6): the affine state of a box at the start; pixel centres are whole numbers."""
    return np.array([[*centre((left, top, w, h)), 1.0, 0.0, 0.0, 1.0]])


def state_of_box(left: float, top: float, w: float, h: float) -> Array:
    """(1, 6): the state of a box at the start, at rest and of scale 1; pixel centres are whole numbers."""
    return np.array([[*centre((left, top, w, h)), 1.0, 0.0, 0.0, 0.0]])
