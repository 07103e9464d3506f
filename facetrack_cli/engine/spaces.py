"""State spaces: what the numbers of a particle mean, where a target begins, and how a posterior becomes geometry."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final, NamedTuple, Protocol

import numpy as np

from facetrack_cli.core.errors import InputError, RecipeError
from facetrack_cli.core.geometry import centre
from facetrack_cli.core.types import Array, Box, Particles, Start
from facetrack_cli.engine.kernels.compiled import moments
from facetrack_cli.recipe.model import ParticleFilterSettings, Recipe
from facetrack_cli.recipe.sections import ScaledSettings
from facetrack_cli.trajectory.diagnostics import Diagnostic

MIN_BOX_PX: Final = 6  # pixels of a side; in less there is nothing to see


def box_of(start: Start, name: str) -> Box:
    """The target's box; InputError if it has none."""
    box = start.targets[name].box
    if box is None:
        points = ", or follow its points, by a recipe such as factorized" if start.targets[name].points else ""
        need = f"{name} has no box, which the recipe follows; add one, as in box: [x, y, w, h]"
        raise InputError(f"{start.origin}: {need}{points}")
    return box


def check_size(origin: str, name: str, box: Box) -> Box:
    """A target's box, which `origin` gave; InputError if it is too small to see anything in it."""
    if min(box[2:]) < MIN_BOX_PX:
        least = f"{MIN_BOX_PX}x{MIN_BOX_PX} pixels"
        raise InputError(f"{origin}: the box of {name} is smaller than {least}; give a larger one")
    return box


def size_of_box(start: Start, name: str) -> float:
    """The unit of length of a region or a single point: the mean side of its box, in pixels."""
    box = start.targets[name].box
    if box is None:
        raise InputError(f"{start.origin}: {name} has a single point and no box to measure lengths by; add a box")
    return float(np.sqrt(box[2] * box[3]))


class Estimate(NamedTuple):
    """Point estimate of the state (K, D), and covariance (K, 2, 2) of the parts' centres, in pixels.

    `side_std` (2,): standard deviations in pixels of the width and height of a box; None of what has no size to follow.
    """

    state: Array
    cov: Array
    side_std: Array | None = None


class Space(Protocol):
    """What a state (K, D) is in the image. Its first two coordinates are the centre of the part, in pixels."""

    diagnostics: ClassVar[tuple[Diagnostic, ...]] = ()
    smooths: ClassVar[bool] = True
    """Whether particles are hypotheses of the target's place, which a smoother may weigh."""

    def diagnose(self, estimated: Estimate) -> Mapping[str, Any]:
        """In every frame the value of each of `diagnostics`, by its name."""
        return {}

    def windows(self, estimated: Estimate) -> Array:
        """(K, 2): width and height of each part, in pixels."""
        ...

    def counted(self, particles: Particles) -> Array:
        """(N,) log weights by which particles count in the estimate."""
        return particles.log_w

    def estimate(self, particles: Particles, ess: Array, *, best: bool) -> Estimate:
        """Of particles whose effective sample sizes are `ess` (K,)."""
        return estimate(particles, ess, best=best)

    def outline(self, estimated: Estimate) -> tuple[float, Array] | None:
        """Angle in degrees and corners (4, 2), clockwise from top left, of the one part; None of an upright one."""
        return None

    def at(self, box: Box) -> Array:
        """(1, D): the state, at rest, of a target that fills a box."""
        raise TypeError("points are not placed by a box")

    def presence(self, particles: Particles, estimated: Estimate) -> Array | None:
        """(1,): the probability that the target is visible where it is estimated; None of what is always visible."""
        return None


@dataclass(frozen=True)
class PointSpace(Space):
    """Points: state (K, 2). `sides` (K, 2): the window of each, in pixels."""

    sides: Array

    def windows(self, estimated: Estimate) -> Array:
        return self.sides


@dataclass(frozen=True)
class SizedSpace(Space):
    """A target that fills its box at the start, of `size` (width, height) in pixels."""

    size: tuple[float, float]

    @classmethod
    def place(cls, settings: ScaledSettings, start: Start, name: str) -> Placed:
        """Where the target begins; the unit of length is the mean side of its box."""
        box = check_size(start.origin, name, box_of(start, name))
        space = cls(box[2:])
        return Placed(space, space.at(box), np.array([box[2:]]), size_of_box(start, name), settings.scale)


@dataclass(frozen=True)
class BoxSpace(SizedSpace):
    """An upright box (Odobez et al. 2003, section 3.2): state (1, 6) = (x, y, s, their speeds); `size` at s = 1."""

    def windows(self, estimated: Estimate) -> Array:
        return np.asarray(estimated.state[:, 2:3] * np.array(self.size))

    def estimate(self, particles: Particles, ess: Array, *, best: bool) -> Estimate:
        scale = particles.x[:, 0, 2:3]
        return estimate(particles, ess, best=best, sides=scale * np.array(self.size))

    def at(self, box: Box) -> Array:
        """Its scale is that of the area: the shape stays the start's."""
        scale = math.sqrt(box[2] * box[3] / (self.size[0] * self.size[1]))
        return np.array([[*centre(box), scale, 0.0, 0.0, 0.0]])


def estimate(particles: Particles, ess: Array, *, best: bool = False, sides: Array | None = None) -> Estimate:
    """Weighted mean of x (N, K, D), or the first `best` particle; covariance of the true x and y about the mean.

    Weighted squares about the mean of n equal samples fall short of the variance by a factor 1 - 1 / n, and the mean is
    off by the variance over n. So they are multiplied by (n + 1) / (n - 1), n the effective sample size `ess` (K,),
    which is nothing where many particles count. `sides` (N, 2): width and height of each particle's box.
    """
    x, w = np.ascontiguousarray(particles.x), np.exp(particles.log_w)
    more = (1 + 1 / ess) / np.maximum(1 - 1 / ess, 1e-12)
    moments(x, w, more, mean := np.empty(x.shape[1:]), cov := np.empty((x.shape[1], 2, 2)))
    side_std = None if sides is None else np.sqrt(w @ np.square(sides - w @ sides) * more[0])
    return Estimate(x[int(np.argmax(particles.log_w))] if best else mean, cov, side_std)


def evenly(x0: Array, windows: Array | None) -> Estimate:
    """The estimate of x0 (K, D), with the covariance of evenly filled ellipses in `windows` (K, 2), or none."""
    cov = np.zeros((len(x0), 2, 2))
    cov[:, [0, 1], [0, 1]] = 0.0 if windows is None else (windows / 4.0) ** 2
    return Estimate(x0, cov)


@dataclass(frozen=True)
class Placed:
    """Where a target begins: its state `x0` (K, D), and `windows` (K, 2), each part's width and height, in pixels.

    `unit` is the recipe's unit of length, in pixels; `scale` the least and the largest scale of a box. With `scatter`
    (K, 2), particles begin evenly over so many pixels around x0, and not together.
    """

    space: Space
    x0: Array
    windows: Array
    unit: float
    scale: tuple[float, float] = (1.0, 1.0)
    scatter: Array | None = None

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the first part, in pixels."""
        w, h = self.windows[0].tolist()
        return w, h


@dataclass(frozen=True)
class Context:
    """What the parts of one target of a recipe are built from, beside their own settings.

    `settings` are all of the target's; `above` stands before their keys: nothing, or as in `targets.face.`.
    """

    recipe: Recipe
    above: str
    settings: ParticleFilterSettings
    start: Start
    name: str
    placed: Placed

    def error(self, key: str, message: str) -> RecipeError:
        """An error that points at a key of the target's settings, as in `prior.file`."""
        return self.recipe.error(f"{self.above}{key}", message)
