"""A box that may be hidden: its state, its walk, and what others than its own filter may do to it (ours).

A face's points carry their head, which is such a box.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from facetrack_cli.core.types import Array, Box, Frame, Info, Particles
from facetrack_cli.engine import confidence
from facetrack_cli.engine.protocols import Linear, Motion
from facetrack_cli.engine.resampling import effective_sample_size
from facetrack_cli.engine.spaces import BoxSpace, Context, Estimate
from facetrack_cli.engine.target import ParticleState, ParticleTarget
from facetrack_cli.trackers.box.box_kernels import arrive
from facetrack_cli.trackers.box.modes import TransitionDensity
from facetrack_cli.trackers.box.settings import VisibleWalkSettings

VISIBLE = 5  # the coordinate of a box that may be hidden that is P(visible)


@dataclass(frozen=True)
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
        log_w = self.counted(particles)
        found = super().estimate(Particles(particles.x, log_w), effective_sample_size(log_w)[None], best=best)
        found.state[0, VISIBLE] = np.exp(particles.log_w) @ particles.x[:, 0, VISIBLE]
        return found

    def presence(self, particles: Particles, estimated: Estimate) -> Array:
        """(1,): the probability that the target is visible and its centre within half a box of the estimate."""
        off = np.abs(particles.x[:, 0, :2] - estimated.state[0, :2])
        near = (off <= 0.5 * self.windows(estimated)[0]).all(axis=1)
        return np.array([min(float(np.sum(np.exp(particles.log_w) * particles.x[:, 0, VISIBLE] * near)), 1.0)])


@dataclass(frozen=True)
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
        moved[:, 0, VISIBLE] = self._visible(x)
        step = np.where(u < moved[:, 0, VISIBLE, None], *self.sigma) * x[:, 0, 2:3]
        moved[:, 0, 3:5] = one.velocity * x[:, 0, 3:5] + np.sqrt(one.acceleration) * step * e[:, :2]
        moved[:, 0, :2] += moved[:, 0, 3:5] + np.sqrt(1 - one.acceleration) * step * e[:, 2:4]
        moved[:, 0, 2] = np.clip(x[:, 0, 2] * np.exp(one.scale * e[:, 4]), *self.limits)
        return moved

    def carried(self, rng: np.random.Generator, x: Array, step: Array) -> Array:
        """x (N, 1, 6) a frame later, where all are known to have moved by `step` (2,): with the mean velocities."""
        moved, one = x.copy(), self.settings
        grown, scale = np.exp(one.scale * rng.standard_normal((len(x) + 1) // 2)), moved[:, 0, 2]
        scale[::2] *= grown
        scale[1::2] /= grown[: len(x) // 2]
        np.minimum(np.maximum(scale, self.limits[0], out=scale), self.limits[1], out=scale)
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

    def arrive(
        self, rng: np.random.Generator, z: Array, particles: Particles, *, found: bool = False
    ) -> TransitionDensity:
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
        return TransitionDensity(x, log_visible, log_hidden, returns, np.array([0.4 * size, 0.4 * size, 0.04]))

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


def visible_walk(settings: VisibleWalkSettings, context: Context) -> VisibleWalk:
    unit = context.placed.unit
    return VisibleWalk(
        settings, unit, (settings.sigma.pixels(unit), settings.hidden.pixels(unit)), context.placed.scale
    )


@dataclass(frozen=True)
class BoxTarget(ParticleTarget):
    """A target followed as a box that may be hidden, by a walk with velocity."""

    motion: VisibleWalk

    def carried(self, rng: Generator, state: ParticleState, shift: Array) -> tuple[ParticleState, Info]:
        """As `advanced`, where others see the box `shift` (2,) from where it is expected."""
        before = state.estimated.state
        step = self.motion.expect(before[None])[0, 0, :2] + shift - before[0, :2]
        particles = state.particles._replace(x=self.motion.carried(rng, state.particles.x, step))
        ess = np.full(1, effective_sample_size(particles.log_w))
        state = state._replace(particles=particles, estimated=self.space.estimate(particles, ess, best=self.best))
        return state, Info(ess)

    def unseen(
        self, rng: Generator, state: ParticleState, frame: Frame, *, anywhere: bool
    ) -> tuple[ParticleState, Info]:
        """As `advanced`, of a box that nobody sees: it stays, or may be `anywhere` in the frame."""
        assert self.confidence is not None and state.judgement is not None
        x = state.particles.x.copy()
        x[:, 0, VISIBLE] = 0.0
        if anywhere:
            x[:, 0, :2] = rng.random((len(x), 2)) * frame.size - 0.5
        particles = state.particles._replace(x=x)
        ess = np.full(1, effective_sample_size(particles.log_w))
        estimated = self.space.estimate(particles, ess, best=self.best)
        judgement = confidence.decide(self.confidence, state.judgement, np.zeros(1))
        return state._replace(particles=particles, estimated=estimated, judgement=judgement), Info(ess)
