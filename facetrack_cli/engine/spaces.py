"""State spaces: what the numbers of a particle mean, where a target begins, and how a posterior becomes geometry.

Then motions that several trackers share: how a particle moves in a frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final, NamedTuple, Protocol

import numpy as np

from facetrack_cli.core.errors import InputError, RecipeError
from facetrack_cli.core.geometry import centre
from facetrack_cli.core.types import BOX, Array, Box, Particles, Start
from facetrack_cli.engine.kernels.compiled import moments
from facetrack_cli.engine.protocols import Linear, Motion
from facetrack_cli.recipe.model import ParticleFilterSettings, Recipe
from facetrack_cli.recipe.sections import RandomWalkSettings
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


@dataclass(frozen=True, eq=False)
class PointSpace(Space):
    """Points: state (K, 2). `sides` (K, 2): the window of each, in pixels."""

    sides: Array

    def windows(self, estimated: Estimate) -> Array:
        return self.sides


@dataclass(frozen=True, eq=False)
class SizedSpace(Space):
    """A target that fills its box at the start, of `size` (width, height) in pixels."""

    size: tuple[float, float]

    @classmethod
    def place(cls, settings: Any, start: Start, name: str) -> Placed:
        """Where the target begins, a cloud all over its box; the unit of length is the mean side of that."""
        box = check_size(start.origin, name, box_of(start, name))
        space, windows = cls(box[2:]), np.array([box[2:]])
        scatter = None if cls.smooths else windows
        return Placed(space, space.at(box), windows, size_of_box(start, name), settings.scale, scatter)


@dataclass(frozen=True, eq=False)
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


class Placed(NamedTuple):
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


class Context(NamedTuple):
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


# --- motions


@dataclass(frozen=True, eq=False)
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


@dataclass(frozen=True, eq=False)
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
    position, scale = (
        (np.array(own.A), np.array([[length.pixels(unit) for length in row] for row in own.B]))
        for own, unit in ((settings.position, context.placed.unit), (settings.scale, 1.0))
    )
    return FirstOrder(position, scale, *context.placed.scale)
