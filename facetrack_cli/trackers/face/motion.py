"""A walk with heavy tails, and its proposal given what sensors measured (ours)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array, Info, Particles
from facetrack_cli.engine.filters import Stepped, factorized
from facetrack_cli.engine.protocols import Linear, Motion
from facetrack_cli.engine.spaces import Context
from facetrack_cli.trackers.face.landmark_kernels import add_up, jump, step
from facetrack_cli.trackers.face.settings import JumpingWalkSettings

if TYPE_CHECKING:
    from facetrack_cli.engine.target import FrameModel
    from facetrack_cli.recipe.sections import FactorizedSettings

ANY: Final = 0.3  # share of draws that do not follow what a sensor and the last place make likely


class SensorReading(NamedTuple):
    """What S sensors say of K parts in one frame, in pixels of the stabilized image.

    With probability `sure` (S, K), z (S, K, 2) is the part's place plus N(0, var I); `var` (S, K) is in square pixels.
    Otherwise z is anywhere in an `area` of so many square pixels.
    """

    z: Array
    var: Array
    sure: Array
    area: float


class ScoredMaps(NamedTuple):
    """log p(y | x) of parts as log(v exp(s (r(x) - 1)) + (1 - v) exp(-floor s)), r read from maps, as by WindowNcc."""

    maps: NDArray[np.float32]
    corner: Array
    visible: Array
    sharpness: float
    floor: float


def modes(measured: SensorReading) -> tuple[Array, Array, Array]:
    """p(z | a) as sum_m exp(w_m - p_m |a - z_m|^2 / 2): z (M, K, 2), p and w (M, K).

    There is a mode for each set of sensors that are right, of those that say something. Sets with the last one come
    first.
    """
    shape = 2 ** int(measured.sure.any(axis=1).sum()), measured.sure.shape[1]
    found = np.empty((*shape, 2)), np.empty(shape), np.empty(shape)
    add_up(*measured, *found)
    return found


@dataclass(frozen=True, eq=False)
class JumpingWalk(Motion):
    """A random walk with heavy tails around `rest` (K, 2) (ours; see the recipe's section).

    p(a | a^-) = (1 - jumps) N(m, sigma^2 I) + jumps N(m, jump^2 I), m = rest + keep (a^- - rest); `sigma` (K,) and
    `jump` (K,) in pixels. Where sensors have measured the parts, p(a, z | a^-) is a mixture of normal densities, as
    each sensor may say nothing. Most particles are drawn from p(a | a^-, z), the proposal of least variance (Doucet,
    Godsill & Andrieu, Statistics and Computing 2000), and a share evenly from the components.
    """

    sigma: Array
    jump: Array
    jumps: float
    rest: Array
    keep: float

    def expect(self, x: Array) -> Array:
        """m of x (N, K, 2)."""
        return np.asarray(self.rest + self.keep * (x - self.rest))

    def propagate(self, rng: np.random.Generator, x: Array) -> Array:
        """x (N, K, 2) moved by one frame."""
        step = np.where(rng.random(x.shape[:2]) < self.jumps, self.jump, self.sigma)
        return np.asarray(self.expect(x) + step[..., None] * rng.standard_normal(x.shape))

    def log_measured(self, x: Array, parents: Array, measured: SensorReading) -> Array:
        """log of p(x, z | a^-) of each part over the density by which x was drawn; x, parents (N, K, 2) -> (N, K)."""
        return self._drawn(parents, np.empty((0, 0)), x.copy(), measured, None)

    def propose(
        self, rng: np.random.Generator, x: Array, measured: SensorReading, windows: ScoredMaps | None = None
    ) -> tuple[Array, Array]:
        """x (N, K, 2) moved by one frame, given what sensors measured; `log_measured` of it, with windows' score."""
        uniform, moved = rng.random(x.shape[:2]), rng.standard_normal(x.shape)
        return moved, self._drawn(x, uniform, moved, measured, windows)

    def _drawn(
        self, x: Array, uniform: Array, moved: Array, measured: SensorReading, windows: ScoredMaps | None
    ) -> Array:
        walk, log_p = (self.sigma, self.jump, self.jumps, self.rest, self.keep, ANY), np.empty(x.shape[:2])
        if windows is None:  # each place has a score of 0
            windows = ScoredMaps(np.zeros((x.shape[1], 1, 1), np.float32), 0 * self.rest, 0 * self.sigma, 1.0, 0.0)
        jump(x, uniform, *measured, *walk, *windows, moved, log_p)
        return log_p

    def log_transition(self, x: Array, parents: Array) -> Array:
        """log p(x_n | parents_m) of each part: x (N, K, 2), parents (M, K, 2) -> (N, M, K)."""
        squared = np.sum((x[:, None] - self.expect(parents)[None]) ** 2, axis=3)
        with np.errstate(divide="ignore"):
            each = [
                np.log(share) - 0.5 * squared / s**2 - np.log(2 * np.pi * s**2)
                for share, s in ((1 - self.jumps, self.sigma), (self.jumps, self.jump))
            ]
        return np.asarray(np.logaddexp(*each))

    def linear(self, state: Array) -> Linear:
        """The motion around a state (K, 2), its noise that of all steps together."""
        eye = np.broadcast_to(np.eye(2), (len(state), 2, 2))
        var = (1 - self.jumps) * self.sigma**2 + self.jumps * self.jump**2
        return Linear(self.keep * eye, (1 - self.keep) * self.rest, eye * var[:, None, None])


def jumping_walk(settings: JumpingWalkSettings, context: Context) -> JumpingWalk:
    placed = context.placed
    sigma, jump = (
        np.array([lengths.of(part).pixels(placed.unit) for part in context.settings.points])
        for lengths in (settings.sigma, settings.jump)
    )
    return JumpingWalk(sigma, jump, settings.jumps, placed.x0, settings.keep)


@dataclass(frozen=True, eq=False)
class MeasuredWalk(JumpingWalk):
    """A jumping walk in one frame, in which sensors have `measured` the parts.

    With `windows`, which score the parts, draws are weighed as they are drawn; `draws` keeps both by id.
    """

    measured: SensorReading
    windows: ScoredMaps | None
    draws: dict[int, tuple[Array, Array]] = field(default_factory=dict)

    def propagate(self, rng: np.random.Generator, x: Array) -> Array:
        drawn, log_p = self.propose(rng, x, self.measured, self.windows)
        if self.windows is not None:
            self.draws[id(drawn)] = drawn, log_p
        return drawn

    def weighed(self, x: Array, parents: Array, score: Callable[[], Array]) -> Array:
        return self.draws[id(x)][1] if id(x) in self.draws else score() + self.log_measured(x, parents, self.measured)


def measured(
    settings: FactorizedSettings, rng: np.random.Generator, particles: Particles, model: FrameModel
) -> Stepped:
    """`filters.factorized` of points that move by a MeasuredWalk with windows and have a StudentPrior.

    As the recipe has it, without a look ahead, and where no part is absent: in one kernel, from the same draws.
    """
    if settings.look_ahead != "none" or settings.reweight != "prior" or model.state.absent is not None:
        return factorized(settings, rng, particles, model)
    (n, k, _), walk, prior = particles.x.shape, model.motion, model.prior
    first, uniform, moved, second = rng.random(k), rng.random((n, k)), rng.standard_normal((n, k, 2)), rng.random(k)
    order = rng.permuted(np.repeat(np.arange(n)[:, None], k, axis=1), axis=0)
    how = (walk.sigma, walk.jump, walk.jumps, walk.rest, walk.keep, ANY, *walk.windows)
    after, log_w, ess = np.empty((n, k, 2)), np.empty(n), np.empty(k)
    draws, shape = (first, uniform, second, order), (prior.to_unit, prior.origin, prior.freedom)
    evidence = step(*particles, *draws, *walk.measured, *how, *shape, moved, after, log_w, ess)
    return Particles(after, log_w), Info(ess, evidence)
