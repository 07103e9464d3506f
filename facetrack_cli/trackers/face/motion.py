"""A walk with heavy tails, and its proposal given what sensors measured (ours)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array
from facetrack_cli.engine.protocols import Linear, Motion
from facetrack_cli.engine.spaces import Context
from facetrack_cli.trackers.face.settings import JumpingWalkSettings
from facetrack_cli.trackers.face.window_kernels import jump

ANY: Final = 0.3  # share of draws that do not follow what a sensor and the last place make likely


class SensorReading(NamedTuple):
    """What a sensor says of K parts in one frame, in pixels of the stabilized image.

    With probability `sure` (K,), z (K, 2) is the part's place plus N(0, var I); `var` (K,) is in square pixels.
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


def _proposed(log_p: Array) -> Array:
    """How often components (C, N, K) are drawn: the likely ones, and any, whose place windows may prefer."""
    p = np.exp(log_p - log_p.max(axis=0))
    return np.asarray((1 - ANY) * p / p.sum(axis=0) + ANY / len(p))


def _log_sum(values: Array) -> Array:
    highest = values.max(axis=0)
    return np.asarray(highest + np.log(np.exp(values - highest).sum(axis=0)))


def modes(measured: Sequence[SensorReading], parts: int) -> tuple[Array, Array, Array]:
    """p(z | a) as sum_m exp(w_m - p_m |a - z_m|^2 / 2), a mode for each set of sensors that say something."""
    z, p, w = np.zeros((1, parts, 2)), np.zeros((1, parts)), np.zeros((1, parts))
    for reading in (each for each in measured if each.sure.any()):
        sure, new = np.clip(reading.sure, 1e-6, 1 - 1e-6), 1 / reading.var
        total = p + new
        apart = np.sum((reading.z - z) ** 2, axis=2) * p * new / total
        z = np.concatenate([(p[..., None] * z + new[:, None] * reading.z) / total[..., None], z])
        p = np.concatenate([total, p])
        says = w + np.log(sure) - 0.5 * apart - np.log(2 * np.pi * reading.var)
        w = np.concatenate([says, w + np.log1p(-sure) - np.log(reading.area)])
    return z, p, w


@dataclass(frozen=True)
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

    def propagate_given(self, rng: np.random.Generator, x: Array, measured: Sequence[SensorReading]) -> Array:
        """x (N, K, 2) moved by one frame, given what sensors measured in it."""
        mean, var, log_p = self._components(x, measured)
        below = np.cumsum(_proposed(log_p), axis=0)
        chosen = (rng.random(x.shape[:2]) > below[:-1]).sum(axis=0), *np.indices(x.shape[:2])
        return np.asarray(
            mean[chosen] + np.sqrt(var[chosen[0], 0, chosen[2]])[..., None] * rng.standard_normal(x.shape)
        )

    def log_measured(self, x: Array, parents: Array, measured: Sequence[SensorReading]) -> Array:
        """log of p(x, z | a^-) of each part over the density by which x was drawn; x, parents (N, K, 2) -> (N, K)."""
        mean, var, log_p = self._components(parents, measured)
        log_n = -0.5 * np.sum((x - mean) ** 2, axis=3) / var - np.log(2 * np.pi * var)
        return np.asarray(_log_sum(log_p + log_n) - _log_sum(np.log(_proposed(log_p)) + log_n))

    def propose(
        self, rng: np.random.Generator, x: Array, measured: Sequence[SensorReading], windows: ScoredMaps
    ) -> tuple[Array, Array]:
        """`propagate_given`, and `log_measured` with the score by `windows` of what it gives, (N, K), in one kernel."""
        uniform, normal = rng.random(x.shape[:2]), rng.standard_normal(x.shape)
        steps = self.sigma, self.jump, self.jumps
        return jump(x, uniform, normal, modes(measured, x.shape[1]), steps, self.rest, self.keep, ANY, *windows)

    def _components(self, x: Array, measured: Sequence[SensorReading]) -> tuple[Array, Array, Array]:
        """Means (C, N, K, 2) and variances (C, 1, K) of a part, log p(z and this | a^-) (C, N, K).

        For each set of sensors that say something, with a step and with a jump.
        """
        rest = self.expect(x)
        z, precision, w = modes(measured, x.shape[1])
        z, precision, w = (np.repeat(mode, 2, axis=0)[:, None] for mode in (z, precision, w))
        var = np.tile(np.stack([self.sigma**2, self.jump**2]), (len(z) // 2, 1))[:, None]
        share = np.tile(np.log([max(1 - self.jumps, 1e-12), max(self.jumps, 1e-12)]), len(z) // 2)[:, None, None]
        wider, off = 1 + var * precision, z - rest
        log_p = w + share - 0.5 * np.sum(off**2, axis=3) * precision / wider - np.log(wider)
        return rest + (1 - 1 / wider)[..., None] * off, var / wider, log_p

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


@dataclass(frozen=True)
class MeasuredWalk(JumpingWalk):
    """A jumping walk in one frame, in which sensors have `measured` the parts.

    With `windows`, which score the parts, draws are weighed as they are drawn; `draws` keeps both by id.
    """

    measured: Sequence[SensorReading]
    windows: ScoredMaps | None
    draws: dict[int, tuple[Array, Array]] = field(default_factory=dict)

    def propagate(self, rng: np.random.Generator, x: Array) -> Array:
        if self.windows is None:
            return self.propagate_given(rng, x, self.measured)
        drawn, log_p = self.propose(rng, x, self.measured, self.windows)
        self.draws[id(drawn)] = drawn, log_p
        return drawn

    def weighed(self, x: Array) -> Array | None:
        return self.draws[id(x)][1] if id(x) in self.draws else None

    def log_importance(self, x: Array, parents: Array) -> Array:
        return self.log_measured(x, parents, self.measured)
