"""A box that may be hidden: its state, its walk, its filter, and what others than that may do to it (ours).

A face's points carry their head, which is such a box. The filter draws particles around the modes of a likelihood.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

from facetrack_cli.core.types import Array, Box, Frame, Info, Mask, Particles
from facetrack_cli.engine import confidence
from facetrack_cli.engine.filters import MIN_LOG, Stepped
from facetrack_cli.engine.protocols import Linear, Motion
from facetrack_cli.engine.resampling import effective_sample_size, normalise, summed, systematic
from facetrack_cli.engine.spaces import BoxSpace, Context, Estimate
from facetrack_cli.engine.target import FrameModel, ParticleState, ParticleTarget
from facetrack_cli.trackers.box.box_kernels import arrive, carry, log_mixture, sum_up
from facetrack_cli.trackers.box.settings import GuidedSettings, VisibleWalkSettings

VISIBLE = 5  # the coordinate of a box that may be hidden that is P(visible)


@dataclass(frozen=True, eq=False)
class VisibleBoxSpace(BoxSpace):
    """A box that may be hidden (ours): state (1, 6) = (x, y, s, speeds of x and y, P(visible))."""

    def at(self, box: Box) -> Array:
        state = super().at(box)
        state[0, VISIBLE] = 1.0
        return state

    def counted(self, particles: Particles) -> Array:
        """Given that the target is visible, or, if it rather is hidden, given that."""
        w, shown = np.exp(particles.log_w), particles.x[:, 0, VISIBLE]
        counts = w * (shown if float(w @ shown) >= 0.5 else 1 - shown)
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(counts / np.add.reduce(counts)))

    def estimate(self, particles: Particles, ess: Array, *, best: bool) -> Estimate:
        """The mean of the particles that count, and P(visible)."""
        return self.summed(particles)[0]

    def summed(self, particles: Particles) -> tuple[Estimate, float]:
        """As `estimate`, and the effective sample size of all particles."""
        mean = Estimate(np.empty((1, 6)), np.empty((1, 2, 2)), np.empty(2))
        return mean, sum_up(np.ascontiguousarray(particles.x), particles.log_w, self.size, *mean)

    def presence(self, particles: Particles, estimated: Estimate) -> Array:
        """(1,): the probability that the target is visible and its centre within half a box of the estimate."""
        off = np.abs(particles.x[:, 0, :2] - estimated.state[0, :2])
        near = (off <= 0.5 * self.windows(estimated)[0]).all(axis=1)
        return np.array([min(float(np.sum(np.exp(particles.log_w) * particles.x[:, 0, VISIBLE] * near)), 1.0)])


@dataclass(frozen=True, eq=False)
class VisibleWalk(Motion):
    """A walk with velocity of a box that may be hidden; with a = `velocity` and b = `acceleration` of the settings

        v_t = a v_{t-1} + sqrt(b) e_1,  x_t = x_{t-1} + v_t + sqrt(1 - b) e_2,  log s_t = log s_{t-1} + e_3

    where e_1, e_2 have the standard deviation `sigma` (pixels at scale 1) times s_{t-1}. So p(x_t | x_{t-1}, v_{t-1})
    is N(x_{t-1} + a v_{t-1}, sigma^2), and p(v_t | x_t, ...) is N(a v_{t-1} + b (x_t - x_{t-1} - a v_{t-1}), b (1 - b)
    sigma^2). Whether it is visible is a chain of two states, independent of the rest. `limits` are those of s.
    """

    settings: VisibleWalkSettings
    unit: float
    sigma: tuple[float, float]
    limits: tuple[float, float]

    def propagate(self, rng: np.random.Generator, x: Array) -> Array:
        """x (N, 1, 6) moved by one frame. Every second noise is the opposite of the one before."""
        one, n = self.settings, (len(x) + 1) // 2
        e, u = (np.repeat(noise, 2, axis=0)[: len(x)] for noise in (rng.standard_normal((n, 5)), rng.random((n, 1))))
        e[1::2] *= -1
        moved = x.copy()
        moved[:, 0, VISIBLE] = self.expect(x)[:, 0, VISIBLE]
        step = np.where(u < moved[:, 0, VISIBLE, None], *self.sigma) * x[:, 0, 2:3]
        moved[:, 0, 3:5] = one.velocity * x[:, 0, 3:5] + np.sqrt(one.acceleration) * step * e[:, :2]
        moved[:, 0, :2] += moved[:, 0, 3:5] + np.sqrt(1 - one.acceleration) * step * e[:, 2:4]
        grown = x[:, 0, 2] * np.exp(one.scale * e[:, 4])
        moved[:, 0, 2] = np.minimum(np.maximum(grown, self.limits[0]), self.limits[1])  # np.clip takes longer
        return moved

    def carried(self, rng: np.random.Generator, x: Array, step: Array) -> Array:
        """x (N, 1, 6) a frame later, where all are known to have moved by `step` (2,): with the mean velocities."""
        one, noise = self.settings, rng.standard_normal((len(x) + 1) // 2)
        walk = one.scale, one.velocity, one.acceleration, *self.limits
        carry(x[:, 0], noise, step, walk, moved := np.empty_like(x))
        return moved

    def expect(self, x: Array) -> Array:
        """The mean of p(x_t | x_{t-1} = x), (N, 1, 6)."""
        matrix, offset = self._ahead
        return np.asarray(x @ matrix + offset)

    @cached_property
    def _ahead(self) -> tuple[Array, Array]:
        """What `expect` multiplies by, (6, 6), and adds: one of six small steps takes as long."""
        one, matrix, show = self.settings, np.eye(6), self.settings.show * (1 - self.settings.elsewhere)
        matrix[3:5, :2] = matrix[3:5, 3:5] = one.velocity * np.eye(2)
        matrix[VISIBLE, VISIBLE] = 1 - one.hide - show
        return matrix, show * (np.arange(6) == VISIBLE)

    def forecast(self, particles: Particles) -> tuple[Array, Array]:
        """Mean and standard deviation (3,) of place and log scale a frame later, where the target is visible."""
        one, x, w = self.settings, particles.x[:, 0], np.exp(particles.log_w)
        z = np.column_stack([x[:, :2] + one.velocity * x[:, 3:5], np.log(x[:, 2])])
        mean, step = w @ z, self.sigma[0] * float(w @ x[:, 2])
        return mean, np.sqrt(w @ (z - mean) ** 2 + np.array([step, step, one.scale]) ** 2)

    def arrive(
        self, rng: np.random.Generator, z: Array, particles: Particles, *, found: bool = False
    ) -> tuple[Array, Array, Array, float, Array]:
        """How a particle of the last frame may come to z (N, 3), place and log scale, and with which velocity.

        Parameters
        ----------
        found : whether re-detection found anything; what returns elsewhere unseen counts as hidden.

        Returns
        -------
        x : (N, 1, D), z with velocities drawn of p(velocity | z).
        log_visible, log_hidden : (N,), log p(z, visible or hidden | Y_{t-1}), the sum over all parents, without
        returns, spread : the probability of a return elsewhere, within `spread` (3,) of where it is found.
        """
        n, one = len(z), self.settings
        x, log_visible, log_hidden = np.empty((n, 1, 6)), np.empty(n), np.empty(n)
        show = one.show * (1 - one.elsewhere), one.show * one.elsewhere * found
        walk = one.scale, one.velocity, one.acceleration, one.hide, *show, *self.limits
        of, noise = np.ascontiguousarray(particles.x[:, 0]), (rng.random(n), rng.standard_normal((n, 2)))
        returns, scale = arrive(z, of, particles.log_w, self.sigma, walk, *noise, log_visible, log_hidden, x[:, 0])
        spread = np.array([0.4 * scale * self.unit, 0.4 * scale * self.unit, 0.04])
        return x, log_visible, log_hidden, returns, spread

    def linear(self, state: Array) -> Linear:
        """The motion around a state (1, 6), without its last coordinate, by whether the target is visible there."""
        one, s, shown = self.settings, float(state[0, 2]), float(state[0, VISIBLE])
        var = s**2 * (shown * self.sigma[0] ** 2 + (1 - shown) * self.sigma[1] ** 2)
        matrix, cov = np.eye(5), np.diag([var, var, (one.scale * s) ** 2, *[one.acceleration * var] * 2])
        for place, speed in ((0, 3), (1, 4)):
            matrix[place, speed] = matrix[speed, speed] = one.velocity
            cov[place, speed] = cov[speed, place] = one.acceleration * var
        return Linear(matrix[None], np.zeros((1, 5)), cov[None])


def visible_walk(settings: VisibleWalkSettings, context: Context) -> VisibleWalk:
    unit = context.placed.unit
    sigma = settings.sigma.pixels(unit), settings.hidden.pixels(unit)
    return VisibleWalk(settings, unit, sigma, context.placed.scale)


class ModeProposal(NamedTuple):
    """Where the likelihood proposes to look: J Gaussians of place and log scale, in pixels and nats.

    `mean`, `std` (J, 3), `log_w` (J,); `redetected` (J,): whether re-detection found the mode, far from the last place.
    """

    mean: Array
    std: Array
    log_w: Array
    redetected: Mask

    def after(self, mean: Array, std: Array) -> ModeProposal:
        """These modes times a Gaussian prior (3,); modes of re-detection stay as they are."""
        precision = 1 / self.std**2 + 1 / std**2
        both = (self.mean / self.std**2 + mean / std**2) / precision
        kept = self.redetected[:, None]
        off = np.where(self.redetected, 0.0, np.sum((self.mean - mean) ** 2 / (self.std**2 + std**2), axis=1))
        std = np.where(kept, self.std, precision**-0.5)
        return ModeProposal(np.where(kept, self.mean, both), std, self.log_w - 0.5 * off, self.redetected)

    def draw(self, rng: Generator, n: int) -> Array:
        """(n, 3), n even: antithetic pairs, so that a symmetric density has no error of its mean."""
        if not n:
            return np.empty((0, 3))
        which = systematic(rng, normalise(self.log_w), n // 2)
        off = self.std[which] * rng.standard_normal((n // 2, 3))
        return np.vstack([self.mean[which] + off, self.mean[which] - off])

    def log_density(self, z: Array) -> Array:
        """(N,): of z (N, 3)."""
        log_w = normalise(self.log_w) - np.log(self.std).sum(axis=1) - 1.5 * math.log(2 * math.pi)
        log_mixture(z, self.mean, self.std, log_w, out := np.empty(len(z)))
        return out

    def elsewhere(self, spread: Array) -> ModeProposal | None:
        """The modes of re-detection, equally likely, with standard deviations `spread` (3,); None without any."""
        if not (n := int(self.redetected.sum())):
            return None
        return ModeProposal(self.mean[self.redetected], np.tile(spread, (n, 1)), np.zeros(n), np.ones(n, np.bool_))


def guided(settings: GuidedSettings, rng: Generator, particles: Particles, model: FrameModel) -> Stepped:
    """Proposes from the modes of the likelihood too, with exact weights (after Zhang et al. 2017, 2018).

    Places and log scales z are drawn from q(z) = g * sum_j a_j N(z; mode_j) + (1 - g) * p(z | Y_{t-1}), g = `guided`,
    whatever their parents, so that a weight is over all parents (a marginal particle filter; Klaas et al. 2005):

        w(z, v) = L(z)^v p(z, v | Y_{t-1}) / q(z),  v = 1 where the target is visible, 0 where it is hidden

    Particles carry both, their sum as weight and the share of v = 1 as a coordinate (Rao-Blackwellised). A hidden
    target may return at a mode that re-detection found.
    """
    likelihood: Any = model.target.likelihood
    n, guides = settings.particles, likelihood.guides(model.state.learned).after(*model.motion.forecast(particles))
    pairs = round(settings.guided * n / 2)
    # some are drawn from either, or q would not cover what the other one covers
    drawn = 2 * min(max(pairs, 1), (n - 2) // 2) if settings.guided > 0 else 0
    parents = systematic(rng, particles.log_w, (n - drawn + 1) // 2)
    moved = model.propagate(rng, particles.x[np.repeat(parents, 2)[: n - drawn]])[:, 0, :3]
    z = np.vstack([guides.draw(rng, drawn), np.column_stack([moved[:, :2], np.log(moved[:, 2])])])
    x, log_visible, log_hidden, returns, spread = model.motion.arrive(
        rng, z, particles, found=bool(guides.redetected.any())
    )
    log_q = np.logaddexp(log_visible, log_hidden) + math.log(1 - drawn / n)
    if drawn:
        log_q = np.logaddexp(math.log(drawn / n) + guides.log_density(z), log_q)
    if (found := guides.elsewhere(spread)) is not None and returns > 0:
        log_return = np.log(returns) + found.log_density(z)
        log_visible = np.logaddexp(log_visible, log_return)
        x[rng.random(n) < np.exp(log_return - log_visible), 0, 3:-1] = 0.0  # what returns has no velocity yet
    log_visible = log_visible + model.log_likelihood(x, x)[:, 0]
    total = np.logaddexp(log_visible, log_hidden)
    x[:, 0, -1] = np.exp(log_visible - total)
    log_w, log_sum = summed(np.maximum(total - log_q, MIN_LOG))
    ess = np.full(1, float(effective_sample_size(log_w)))
    return Particles(x, log_w), Info(ess, float(log_sum) - math.log(n))


@dataclass(frozen=True, eq=False)
class BoxTarget(ParticleTarget):
    """A target followed as a box that may be hidden, by a walk with velocity."""

    space: VisibleBoxSpace
    motion: VisibleWalk

    def carried(self, rng: Generator, state: ParticleState, shift: Array) -> tuple[ParticleState, Info]:
        """As `advanced`, where others see the box `shift` (2,) from where it is expected."""
        before = state.estimated.state
        step = self.motion.settings.velocity * before[0, 3:5] + shift
        return self._moved(state, self.motion.carried(rng, state.particles.x, step))

    def unseen(
        self, rng: Generator, state: ParticleState, frame: Frame, *, anywhere: bool
    ) -> tuple[ParticleState, Info]:
        """As `advanced`, of a box that nobody sees: it stays, or may be `anywhere` in the frame."""
        assert self.confidence is not None and state.judgement is not None
        x = state.particles.x.copy()
        x[:, 0, VISIBLE] = 0.0
        if anywhere:
            x[:, 0, :2] = rng.random((len(x), 2)) * frame.size - 0.5
        judgement = confidence.decide(self.confidence, state.judgement, np.zeros(1))
        return self._moved(state._replace(judgement=judgement), x)

    def _moved(self, state: ParticleState, x: Array) -> tuple[ParticleState, Info]:
        """With the particles at x, of the same weights."""
        particles = state.particles._replace(x=x)
        estimated, ess = self.space.summed(particles)
        return state._replace(particles=particles, estimated=estimated), Info(np.full(1, ess))
