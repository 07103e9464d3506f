"""State spaces: what the numbers of a particle mean, and how a posterior becomes image geometry."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import InputError, RecipeError
from facetrack_cli.core.geometry import centre, size_of_points
from facetrack_cli.core.types import Array, Box, Frame, Particles, Start, factor_for
from facetrack_cli.recipe import affine, correlation_filter, points, regions, skin
from facetrack_cli.recipe.model import ParticleFilter, Recipe
from facetrack_cli.tracking.kernels.affine import boxes_extent, read_patches
from facetrack_cli.tracking.resampling import effective_sample_size, normalise
from facetrack_cli.tracking.start.checks import box_of, check_size, size_of_box
from facetrack_cli.trajectory.diagnostics import AFFINE, SCALE, Diagnostic

VISIBLE = 5  # the coordinate of a box that may be hidden that is P(visible)
MAX_FACTOR = 256  # a face of 13 times 256 pixels or more is read with gaps


class Estimate(NamedTuple):
    """Point estimate of the state (K, D), and covariance (K, 2, 2) of the parts' centres, in pixels.

    `side_std` (2,): standard deviations in pixels of the width and height of a box; None of what has no size to follow.
    """

    state: Array
    cov: Array
    side_std: Array | None = None


class Outline(NamedTuple):
    """What a part is in the frame if no upright box: `angle` in degrees, `corners` (4, 2) clockwise from top left."""

    angle: float
    corners: Array


class Space(Protocol):
    """What a state is in the image. Its first two coordinates are the centre of the part, in pixels.

    `windows` (K, 2): width and height in pixels of each part. `at` (1, D): the state, at rest, of a target that fills a
    box at any time. `outline`: of the one part that is no upright box.
    """

    diagnostics: ClassVar[tuple[Diagnostic, ...]] = ()

    def diagnose(self, estimated: Estimate) -> Mapping[str, Any]:
        return {}

    def windows(self, estimated: Estimate) -> Array: ...

    def counted(self, particles: Particles) -> Array:
        """(N,) log weights by which particles count in the estimate."""
        return particles.log_w

    def estimate(self, particles: Particles, ess: Array, *, best: bool) -> Estimate:
        """Of particles whose effective sample sizes are `ess` (K,)."""
        return estimate(particles, ess, best=best)

    def outline(self, estimated: Estimate) -> Outline | None:
        return None

    def at(self, box: Box) -> Array:
        raise TypeError("points are not placed by a box")


@dataclass(frozen=True)
class PointSpace(Space):
    """Points: state (K, 2). `sides` (K, 2): the window of each, in pixels."""

    sides: Array

    def windows(self, estimated: Estimate) -> Array:
        return self.sides


@dataclass(frozen=True)
class BoxSpace(Space):
    """An upright box (Odobez et al. 2003, section 3.2): state (1, 6) = (x, y, s, their speeds); `size` at s = 1."""

    size: tuple[float, float]

    def windows(self, estimated: Estimate) -> Array:
        return np.asarray(estimated.state[:, 2:3] * np.array(self.size))

    def estimate(self, particles: Particles, ess: Array, *, best: bool) -> Estimate:
        scale = particles.x[:, 0, 2:3]
        return estimate(particles, ess, best=best, sides=scale * np.array(self.size))

    def at(self, box: Box) -> Array:
        """Its scale is that of the area: the shape stays the start's."""
        scale = math.sqrt(box[2] * box[3] / (self.size[0] * self.size[1]))
        return np.array([[*centre(box), scale, 0.0, 0.0, 0.0]])


@dataclass(frozen=True)
class VisibleBoxSpace(BoxSpace):
    """A box that may be hidden (ours): state (1, 6) = (x, y, s, speeds of x and y, P(visible))."""

    def at(self, box: Box) -> Array:
        state = super().at(box)
        state[0, VISIBLE] = 1.0
        return state

    def counted(self, particles: Particles) -> Array:
        """Given that the target is visible, or, if it rather is hidden, given that."""
        shown = particles.x[:, 0, VISIBLE]
        visible = float(np.sum(np.exp(particles.log_w) * shown))
        with np.errstate(divide="ignore"):
            return normalise(particles.log_w + np.log(shown if visible >= 0.5 else 1 - shown))

    def estimate(self, particles: Particles, ess: Array, *, best: bool) -> Estimate:
        """The mean of the particles that count, and P(visible)."""
        log_w = self.counted(particles)
        found = super().estimate(Particles(particles.x, log_w), effective_sample_size(log_w)[None], best=best)
        found.state[0, VISIBLE] = float(np.sum(np.exp(particles.log_w) * particles.x[:, 0, VISIBLE]))
        return found

    def presence(self, particles: Particles, estimated: Estimate) -> Array:
        """(1,): the probability that the target is visible and its centre within half a box of the estimate."""
        off = np.abs(particles.x[:, 0, :2] - estimated.state[0, :2])
        near = (off <= 0.5 * self.windows(estimated)[0]).all(axis=1)
        return np.array([min(float(np.sum(np.exp(particles.log_w) * particles.x[:, 0, VISIBLE] * near)), 1.0)])


@dataclass(frozen=True)
class CloudSpace(Space):
    """Each particle is a pixel (Gianni et al. 2007): state (1, 2) = (x, y); its box has four deviations a side."""

    def estimate(self, particles: Particles, ess: Array, *, best: bool) -> Estimate:
        """The covariance of the pixels themselves: they are the target, not hypotheses of its place."""
        return estimate(particles, np.full_like(ess, np.inf), best=best)

    def windows(self, estimated: Estimate) -> Array:
        return 4.0 * np.sqrt(np.maximum(np.diagonal(estimated.cov, axis1=1, axis2=2), 0.0))

    def at(self, box: Box) -> Array:
        return np.array([[*centre(box), 1.0, 0.0, 0.0, 0.0]])


@dataclass(frozen=True)
class AffineSpace(Space):
    """A box under affine maps (Zhou et al. 2003, section 4): state (1, 6) = (x, y, a1, a2, a3, a4).

    [[a1, a2], [a3, a4]] leads from the start to now. `size`: width, height in pixels at the start. Its angle is
    the rotation that is nearest to the deformation.
    """

    size: tuple[float, float]
    diagnostics: ClassVar = (SCALE, AFFINE)

    def windows(self, estimated: Estimate) -> Array:
        _, _, a1, a2, a3, a4 = estimated.state[0].tolist()
        return np.array([[math.hypot(a1, a3) * self.size[0], math.hypot(a2, a4) * self.size[1]]])

    def estimate(self, particles: Particles, ess: Array, *, best: bool) -> Estimate:
        squares = np.square(particles.x[:, 0, 2:])
        sides = np.sqrt(squares[:, :2] + squares[:, 2:]) * np.array(self.size)
        return estimate(particles, ess, best=best, sides=sides)

    def at(self, box: Box) -> Array:
        """Upright, and as wide and as high as the box."""
        return np.array([[*centre(box), box[2] / self.size[0], 0.0, 0.0, box[3] / self.size[1]]])

    def diagnose(self, estimated: Estimate) -> Mapping[str, Any]:
        x, y, *deformation = estimated.state[0].tolist()
        return {"scale": float(scale_of(estimated.state[None])[0, 0]), "affine": (*deformation, x, y)}

    def outline(self, estimated: Estimate) -> Outline:
        cx, cy, a1, a2, a3, a4 = estimated.state[0].tolist()
        # the border runs through the middle of the outermost pixels, as that of an upright box
        x, y = (max(side - 1, 1) / 2 for side in self.size)
        a1, a2, a3, a4, angle = a1 * x, a2 * y, a3 * x, a4 * y, math.degrees(math.atan2(a3 - a2, a1 + a4))
        ways = ((-1, -1), (1, -1), (1, 1), (-1, 1))
        return Outline(angle, np.array([(cx + i * a1 + j * a2, cy + i * a3 + j * a4) for i, j in ways]))


def estimate(particles: Particles, ess: Array, *, best: bool = False, sides: Array | None = None) -> Estimate:
    """Weighted mean of x (N, K, D), or the first `best` particle; covariance of the true x and y about the mean.

    Weighted squares about the mean of n equal samples fall short of the variance by a factor 1 - 1 / n, and the mean is
    off by the variance over n. So they are multiplied by (n + 1) / (n - 1), n the effective sample size `ess` (K,),
    which is nothing where many particles count. `sides` (N, 2): width and height of each particle's box.
    """
    w = np.exp(particles.log_w)
    more = (1 + 1 / ess) / np.maximum(1 - 1 / ess, 1e-12)
    mean = np.einsum("n,nkd->kd", w, particles.x)
    cov = spread(w, particles.x[..., :2] - mean[:, :2]) * more[:, None, None]
    side_std = None if sides is None else np.sqrt(w @ np.square(sides - w @ sides) * more[0])
    return Estimate(particles.x[int(np.argmax(particles.log_w))] if best else mean, cov, side_std)


def spread(w: Array, off: Array) -> Array:
    """(K, 2, 2): the mean of the outer products of `off` (N, K, 2), with weights w (N,)."""
    # by two sums of products of two, a quarter of the time of one of products of three
    weighted, cov = w[:, None, None] * off, np.empty((off.shape[1], 4))
    cov[:, ::3] = np.einsum("nkd,nkd->kd", weighted, off)
    cov[:, 1:3] = np.einsum("nkd,nkd->kd", weighted, off[..., ::-1])
    return cov.reshape(-1, 2, 2)


def evenly(x0: Array, windows: Array | None) -> Estimate:
    """The estimate of x0 (K, D), with the covariance of evenly filled ellipses in `windows` (K, 2), or none."""
    cov = np.zeros((len(x0), 2, 2))
    cov[:, [0, 1], [0, 1]] = 0.0 if windows is None else (windows / 4.0) ** 2
    return Estimate(x0, cov)


def scale_of(x: Array) -> Array:
    """How large x (N, 1, 6) are, 1 at the start -> (N, 1): the RMS of the deformation's singular values."""
    return np.asarray(np.sqrt(0.5 * np.sum(np.square(x[..., 2:6]), axis=-1)))


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
    settings: ParticleFilter
    start: Start
    name: str
    placed: Placed

    def error(self, key: str, message: str) -> RecipeError:
        """An error that points at a key of the target's settings, as in `prior.file`."""
        return self.recipe.error(f"{self.above}{key}", message)


def place_points(settings: points.Points, start: Start, name: str) -> Placed:
    """Points where the start has them; the unit is the largest distance of two, or the box's size around one."""
    placed, parts = start.targets[name], settings.parts
    if missing := ", ".join(part for part in parts if part not in placed.points):
        raise InputError(f"{start.origin}: {name} has no point for {missing}; the recipe wants them")
    x0 = np.array([placed.points[part] for part in parts], dtype=float)
    unit = size_of_points(x0) if len(parts) > 1 else size_of_box(start, name)
    if not unit:
        raise InputError(f"{start.origin}: all points of {name} are in one place; move them apart")
    windows = np.array([[side.pixels(unit) for side in settings.window(part)] for part in parts])
    for part, side in placed.windows.items():
        if part in parts:
            windows[parts.index(part)] = side
    return Placed(PointSpace(windows), x0, windows, unit)


def place_box(
    settings: regions.Region | correlation_filter.Box | affine.Affine | skin.Cloud, start: Start, name: str
) -> Placed:
    """A target that fills its box, whose mean side is the unit; particles of a cloud begin all over it."""
    box = check_size(start.origin, name, box_of(start, name))
    windows, unit = np.array([box[2:]]), size_of_box(start, name)
    if isinstance(settings, skin.Cloud):
        return Placed(CloudSpace(), CloudSpace().at(box), windows, unit, (0.25, 4.0), windows)
    kinds: dict[type, type[AffineSpace | BoxSpace]] = {
        affine.Affine: AffineSpace,
        correlation_filter.Box: VisibleBoxSpace,
    }
    space = kinds.get(type(settings), BoxSpace)(box[2:])
    return Placed(space, space.at(box), windows, unit, settings.scale)


@dataclass(frozen=True)
class Patches:
    """How an affine face is read from a frame: template and patch (Zhou, Chellappa & Moghaddam 2003, eq. 3).

    Point (i, j) of a template of rows x cols is read, with the state of `AffineSpace`, at

        (cx, cy) + [[a1, a2], [a3, a4]] (w ((j + .5) / cols - .5), h ((i + .5) / rows - .5))

    with (w, h) the `size` in pixels of the box at the start; `shape`: (rows, cols), 30 x 26 in the paper. A patch has
    mean 0 and variance 1. Points beyond the frame are left out of both and are 0. A patch that is flat, or with less
    than half of it in the frame, is all 0.
    """

    size: tuple[float, float]
    shape: tuple[int, int] = (30, 26)

    def factor(self, state: Array) -> int:
        """By what to reduce the frame for patches around `state` (1, 6), a power of two; 1 for no numbers.

        The template's points are then at most 2 pixels apart, along that side where they are closer.
        """
        _, _, a1, a2, a3, a4 = state[0].tolist()
        rows, cols = self.shape
        step = min(self.size[0] / cols * math.hypot(a1, a3), self.size[1] / rows * math.hypot(a2, a4))
        return factor_for(min(step, 2.0 * MAX_FACTOR), 2.0) if step > 2.0 else 1

    def read(self, frame: Frame, x: Array, factor: int) -> NDArray[np.float32]:
        """Patches (N, d) of x (N, 1, 6), flattened by rows, from the frame in grey reduced by `factor`; read-only.

        The frame remembers the last few: of one state by its values, of more by the array x, which must not change.
        """
        key = self.size, self.shape, factor, x.tobytes() if x.size == 6 else id(x)
        if (known := frame.remembered(key)) is not None:
            return known
        states = np.ascontiguousarray(x.reshape(-1, 6))
        (w, h), (width, height) = self.size, frame.size
        extent = boxes_extent(states, w, h, width, height)
        # a box is read from the block before its first one too; after a single state mostly come particles around it
        more = float(factor) if len(states) > 1 else factor + 0.15 * max(extent[2] - extent[0], extent[3] - extent[1])
        grey, left, top = frame.grey(factor, (extent[0] - more, extent[1] - more, extent[2] + more, extent[3] + more))
        patches: NDArray[np.float32] = read_patches(
            grey, left, top, factor, width, height, extent, states, w, h, *self.shape
        )
        patches.flags.writeable = False
        frame.remember(key, x, patches)
        return patches

    def inside(self, frame: Frame, state: Array) -> float:
        """Which share of the template's points lies within the frame at `state` (1, 6)."""
        (w, h), (rows, cols), (width, height) = self.size, self.shape, frame.size
        cx, cy, a1, a2, a3, a4 = state[0].tolist()
        x, y = np.meshgrid(w * ((np.arange(cols) + 0.5) / cols - 0.5), h * ((np.arange(rows) + 0.5) / rows - 0.5))
        u, v = cx + a1 * x + a2 * y, cy + a3 * x + a4 * y
        return float(np.mean((u >= -0.5) & (v >= -0.5) & (u <= width - 0.5) & (v <= height - 0.5)))


def patches_of(context: Context) -> Patches:
    """How the likelihood of a target reads patches. Raises TypeError for a likelihood that reads none."""
    likelihood = context.settings.likelihood
    if not isinstance(likelihood, affine.PatchLikelihood):
        raise TypeError(f"the likelihood {likelihood.type} does not compare patches")
    columns, rows = likelihood.template
    return Patches(context.placed.size, (rows, columns))
