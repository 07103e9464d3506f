"""A box that may be hidden (ours)."""

from dataclasses import dataclass

import numpy as np

from facetrack_cli.core.types import Array, Box, Particles
from facetrack_cli.engine.resampling import effective_sample_size, normalise
from facetrack_cli.engine.spaces import BoxSpace, Estimate

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
