"""Motion models: how a particle moves from one frame to the next, and the density of that move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import BOX, Array, Particles
from facetrack_cli.engine.kernels.affine import diffuse
from facetrack_cli.engine.spaces import Context
from facetrack_cli.trackers.appearance import settings as affine
from facetrack_cli.trackers.box import settings as correlation_filter
from facetrack_cli.trackers.box.hidden_box import VISIBLE
from facetrack_cli.trackers.box.proposals import Arrived
from facetrack_cli.trackers.box.walk_kernels import arrive, jump
from facetrack_cli.trackers.face import settings as face
from facetrack_cli.trackers.points import settings as points
from facetrack_cli.trackers.regions import settings as regions

ANY: Final = 0.3  # share of draws that do not follow what a sensor and the last place make likely


class Linear(NamedTuple):
    """The motion of K parts as x_t = matrix x_{t-1} + offset + noise, noise ~ N(0, cov), for the smoother.

    `matrix` and `cov` are (K, D, D), `offset` (K, D), of the first D coordinates of the state, in its units.
    """

    matrix: Array
    offset: Array
    cov: Array


@dataclass(frozen=True)
class RandomWalk:
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


class SensorReading(NamedTuple):
    """What a sensor says of K parts in one frame: z (K, 2) = part + N(0, var I) with probability `sure` (K,).

    Otherwise it says nothing: z is then anywhere in `area` square pixels. `var` (K,) in square pixels.
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
    for one in (each for each in measured if each.sure.any()):
        sure, new = np.clip(one.sure, 1e-6, 1 - 1e-6), 1 / one.var
        total = p + new
        apart = np.sum((one.z - z) ** 2, axis=2) * p * new / total
        z = np.concatenate([(p[..., None] * z + new[:, None] * one.z) / total[..., None], z])
        p = np.concatenate([total, p])
        says = w + np.log(sure) - 0.5 * apart - np.log(2 * np.pi * one.var)
        w = np.concatenate([says, w + np.log1p(-sure) - np.log(one.area)])
    return z, p, w


@dataclass(frozen=True)
class JumpingWalk:
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
        z, precision, w = (np.repeat(one, 2, axis=0)[:, None] for one in (z, precision, w))
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


@dataclass(frozen=True)
class FirstOrder:
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

    def log_transition(self, x: Array, parents: Array) -> Array:
        """log p(x_n | parents_m) of each part: x (N, K, 6), parents (M, K, 6) -> (N, M, K).

        The bounds of s are left out. Where B has one source of noise, the density is that on its line, -inf beside it.
        """
        total = np.zeros((len(x), len(parents), x.shape[1]))
        for i, (a, b) in enumerate((self.position, self.position, self.scale)):
            off = x[:, None, :, i::3] - parents[None, :, :, i::3] @ a.T
            total += _log_normal(off, b @ b.T)
        return total

    def linear(self, state: Array) -> Linear:
        """The motion around a state (K, 6); the bounds of s are left out."""
        matrix, cov = np.zeros((2, len(state), 6, 6))
        for i, (a, b) in enumerate((self.position, self.position, self.scale)):
            matrix[:, i::3, i::3], cov[:, i::3, i::3] = a, b @ b.T
        return Linear(matrix, np.zeros((len(state), 6)), cov)


@dataclass(frozen=True)
class VisibleWalk:
    """A walk with velocity of a box that may be hidden; with a = `velocity` and b = `acceleration` of the settings

        v_t = a v_{t-1} + sqrt(b) e_1,  x_t = x_{t-1} + v_t + sqrt(1 - b) e_2,  log s_t = log s_{t-1} + e_3

    where e_1, e_2 have the standard deviation `sigma` (pixels at scale 1) times s_{t-1}. So p(x_t | x_{t-1}, v_{t-1})
    is N(x_{t-1} + a v_{t-1}, sigma^2), and p(v_t | x_t, ...) is N(a v_{t-1} + b (x_t - x_{t-1} - a v_{t-1}), b (1 - b)
    sigma^2). Whether it is visible is a chain of two states, independent of the rest. `limits` are those of s.
    """

    settings: correlation_filter.VisibleWalk
    unit: float
    sigma: tuple[float, float]
    limits: tuple[float, float]

    def propagate(self, rng: np.random.Generator, x: Array) -> Array:
        """x (N, 1, 6) moved by one frame. Every second noise is the opposite of the one before."""
        one, n = self.settings, (len(x) + 1) // 2
        e, u = (np.repeat(noise, 2, axis=0)[: len(x)] for noise in (rng.standard_normal((n, 5)), rng.random((n, 1))))
        e[1::2] *= -1
        moved = x.copy()
        moved[:, 0, VISIBLE] = self._visible(x)
        step = np.where(u < moved[:, 0, VISIBLE, None], *self.sigma) * x[:, 0, 2:3]
        moved[:, 0, 3:5] = one.velocity * x[:, 0, 3:5] + np.sqrt(one.acceleration) * step * e[:, :2]
        moved[:, 0, :2] += moved[:, 0, 3:5] + np.sqrt(1 - one.acceleration) * step * e[:, 2:4]
        moved[:, 0, 2] = np.clip(x[:, 0, 2] * np.exp(one.scale * e[:, 4]), *self.limits)
        return moved

    def carried(self, rng: np.random.Generator, x: Array, step: Array) -> Array:
        """x (N, 1, 6) a frame later, where all are known to have moved by `step` (2,): with the mean velocities."""
        moved, one = x.copy(), self.settings
        noise = rng.standard_normal((len(x) + 1) // 2)
        e = np.stack([noise, -noise], axis=1).ravel()[: len(x)]
        moved[:, 0, 2] = np.clip(x[:, 0, 2] * np.exp(one.scale * e), *self.limits)
        moved[:, 0, :2] += step
        moved[:, 0, 3:5] = one.velocity * (1 - one.acceleration) * x[:, 0, 3:5] + one.acceleration * step
        return moved

    def expect(self, x: Array) -> Array:
        """The mean of p(x_t | x_{t-1} = x), (N, 1, 6)."""
        moved = x.copy()
        moved[:, 0, 3:5] *= self.settings.velocity
        moved[:, 0, :2] += moved[:, 0, 3:5]
        moved[:, 0, VISIBLE] = self._visible(x)
        return moved

    def log_transition(self, x: Array, parents: Array) -> Array:
        """log p of place and log scale of x (N, 1, 6) given parents (M, 1, 6) -> (N, M, 1)."""
        z, visible = np.column_stack([x[:, 0, :2], np.log(x[:, 0, 2])]), self._visible(parents)
        shown, hidden = (self._log_density(z, parents, sigma) for sigma in self.sigma)
        return np.asarray(np.logaddexp(shown + np.log(visible), hidden + np.log1p(-visible)))[..., None]

    def forecast(self, particles: Particles) -> tuple[Array, Array]:
        """Mean and standard deviation (3,) of place and log scale a frame later, where the target is visible."""
        one, x, w = self.settings, particles.x[:, 0], np.exp(particles.log_w)
        z = np.column_stack([x[:, :2] + one.velocity * x[:, 3:5], np.log(x[:, 2])])
        mean, step = w @ z, self.sigma[0] * float(w @ x[:, 2])
        return mean, np.sqrt(w @ (z - mean) ** 2 + np.array([step, step, one.scale]) ** 2)

    def arrive(self, rng: np.random.Generator, z: Array, particles: Particles, *, found: bool = False) -> Arrived:
        """How a particle of the last frame may come to z (N, 3), place and log scale, and with which velocity.

        `found`: whether re-detection found anything; what returns elsewhere unseen counts as hidden.
        """
        one, parents, visible = self.settings, particles.x, self._visible(particles.x)
        mean = np.column_stack([self.expect(parents)[:, 0, :2], np.log(parents[:, 0, 2])])
        step = parents[:, 0, 2:3] * np.array(self.sigma)
        log_visible, log_hidden, which = np.empty(len(z)), np.empty(len(z)), np.empty(len(z), np.int64)
        with np.errstate(divide="ignore"):
            leaves = (1 - parents[:, 0, VISIBLE]) * one.show * one.elsewhere * found
            each = particles.log_w + np.log(visible), particles.log_w + np.log(np.maximum(1 - visible - leaves, 0.0))
        arrive(z, mean, step, one.scale, *each, rng.random(len(z)), log_visible, log_hidden, which)
        # the parent, and whether the target was visible on its way, by which its step is chosen
        chosen, sigma = parents[which % len(parents), 0], np.where(which < len(parents), *self.sigma)
        x = np.empty((len(z), 1, parents.shape[2]))
        x[:, 0, :2], x[:, 0, 2] = z[:, :2], np.clip(np.exp(z[:, 2]), *self.limits)
        v, b = one.velocity * chosen[:, 3:5], one.acceleration
        noise = np.sqrt(b * (1 - b)) * (sigma * chosen[:, 2])[:, None] * rng.standard_normal((len(z), 2))
        x[:, 0, 3:5] = v + b * (z[:, :2] - chosen[:, :2] - v) + noise
        x[:, 0, VISIBLE] = 0.0
        w = np.exp(particles.log_w)
        returns = float(w @ leaves)
        size = float(w @ parents[:, 0, 2]) * self.unit
        return Arrived(x, log_visible, log_hidden, returns, np.array([0.4 * size, 0.4 * size, 0.04]))

    def linear(self, state: Array) -> Linear:
        """The motion around a state (1, 6), without its last coordinate, by whether the target is visible there."""
        one, s, shown = self.settings, float(state[0, 2]), float(state[0, VISIBLE])
        var = s**2 * (shown * self.sigma[0] ** 2 + (1 - shown) * self.sigma[1] ** 2)
        matrix, cov = np.eye(5), np.diag([var, var, (one.scale * s) ** 2, *[one.acceleration * var] * 2])
        for place, speed in ((0, 3), (1, 4)):
            matrix[place, speed] = matrix[speed, speed] = one.velocity
            cov[place, speed] = cov[speed, place] = one.acceleration * var
        return Linear(matrix[None], np.zeros((1, 5)), cov[None])

    def _visible(self, x: Array) -> Array:
        """(N,): P(visible) a frame later. What returns elsewhere is not counted."""
        one, before = self.settings, x[:, 0, VISIBLE]
        return np.asarray(before * (1 - one.hide) + (1 - before) * one.show * (1 - one.elsewhere))

    def _log_density(self, z: Array, parents: Array, sigma: float) -> Array:
        """(N, M): log p(z | parents) with steps of `sigma`."""
        one, parents = self.settings, parents[:, 0]
        mean, step = parents[:, :2] + one.velocity * parents[:, 3:5], sigma * parents[:, 2]
        off = ((z[:, 0, None] - mean[:, 0]) ** 2 + (z[:, 1, None] - mean[:, 1]) ** 2) / step**2
        off += ((z[:, 2, None] - np.log(parents[:, 2])) / one.scale) ** 2
        return np.asarray(-0.5 * off - 2 * np.log(step) - np.log(one.scale) - 1.5 * np.log(2 * np.pi))


@dataclass(frozen=True)
class AffineWalk:
    """Gaussian noise on the parameters of an affine map, theta_t = theta_{t-1} + u_t (Zhou et al. 2003, eq. 1).

    The state is (x, y, a1, a2, a3, a4), `sigma` the standard deviation of x and y in pixels. The paper leaves u_0 open;
    here scale, turn, and stretch and shear have noise of their own: if they have the same, it is that of each of a1 to
    a4. `scale` bounds the scale, [least, most].
    """

    settings: affine.AffineWalk
    sigma: float
    scale: tuple[float, float]

    @cached_property
    def _sigma(self) -> Array:
        """(6,): standard deviations of x, y, scale, turn, stretch and shear."""
        deform, turn, shear = self.settings.deform, self.settings.turn, self.settings.shear
        turn, shear = (deform if one is None else one for one in (turn, shear))
        return np.array([self.sigma, self.sigma, deform, turn, shear, shear])

    def propagate(self, rng: np.random.Generator, x: Array, shift: Array | None = None, noise: float = 1.0) -> Array:
        """x (N, 1, 6) moved by one frame: by the `shift` (1, 6), nu_t, and `noise`, r_t / r_0, times the noise."""
        moved = np.zeros((1, 6)) if shift is None else shift
        u = rng.standard_normal(x.shape)
        return np.asarray(diffuse(x[:, 0], u[:, 0], _AFFINE * self._sigma, moved[0], noise, *self.scale))[:, None]

    def expect(self, x: Array) -> Array:
        """The mean of p(x_t | x_{t-1} = x), (N, 1, 6); the bounds of the scale are left out."""
        return x

    def log_transition(self, x: Array, parents: Array) -> Array:
        """log p(x_n | parents_m): x (N, 1, 6), parents (M, 1, 6) -> (N, M, 1); the bounds are left out."""
        return _log_normal((x[:, None] - parents[None]) @ _AFFINE, np.diag(self._sigma**2))

    def linear(self, state: Array) -> Linear:
        """The motion around a state (1, 6); the bounds of the scale are left out."""
        return Linear(np.eye(6)[None], np.zeros((1, 6)), (_AFFINE * self._sigma**2 @ _AFFINE.T)[None])


# from noise of (x, y, scale, turn, stretch, shear) to that of (x, y, a1, a2, a3, a4); orthogonal
_AFFINE = np.eye(6)
_AFFINE[2:, 2:] = np.sqrt(0.5) * np.array([[1, 0, 1, 0], [0, -1, 0, 1], [0, 1, 0, 1], [1, 0, -1, 0]])


def _log_normal(off: Array, cov: Array) -> Array:
    """log N(off; 0, cov) over the last axis; of a singular cov, the density on its support."""
    values, vectors = np.linalg.eigh(cov)
    along = off @ vectors
    spread = values > 1e-12 * max(float(values[-1]), 1e-300)
    z = along[..., spread] / np.sqrt(values[spread])
    inside = (np.abs(along[..., ~spread]) <= 1e-9 * (1.0 + np.abs(off).max(axis=-1, keepdims=True))).all(axis=-1)
    log_p = -0.5 * (z**2).sum(axis=-1) - 0.5 * float(np.sum(np.log(2 * np.pi * values[spread])))
    return np.where(inside, log_p, -np.inf)


def random_walk(settings: points.RandomWalk, context: Context) -> RandomWalk | FirstOrder:
    """Of points, or of the place and the scale of a box, whose speeds stay 0."""
    placed, target = context.placed, context.settings.target
    sigma = [settings.sigma.of(part).pixels(placed.unit) for part in target.points or (BOX,)]
    if target.points:
        return RandomWalk(np.array(sigma))
    stay = np.array([[1.0, 0.0], [0.0, 0.0]])
    position, scale = ((stay, np.array([[step], [0.0]])) for step in (*sigma, settings.scale))
    return FirstOrder(position, scale, *placed.scale)


def jumping_walk(settings: face.JumpingWalk, context: Context) -> JumpingWalk:
    placed = context.placed
    sigma, jump = (
        np.array([lengths.of(part).pixels(placed.unit) for part in context.settings.points])
        for lengths in (settings.sigma, settings.jump)
    )
    return JumpingWalk(sigma, jump, settings.jumps, placed.x0, settings.keep)


def first_order(settings: regions.FirstOrder, context: Context) -> FirstOrder:
    noise = [[length.pixels(context.placed.unit) for length in row] for row in settings.position.B]
    scale = np.array(settings.scale.A), np.array(settings.scale.B)
    return FirstOrder((np.array(settings.position.A), np.array(noise)), scale, *context.placed.scale)


def visible_walk(settings: correlation_filter.VisibleWalk, context: Context) -> VisibleWalk:
    unit = context.placed.unit
    return VisibleWalk(
        settings, unit, (settings.sigma.pixels(unit), settings.hidden.pixels(unit)), context.placed.scale
    )
