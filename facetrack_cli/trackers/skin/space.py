"""A target whose particles are its pixels (Gianni, Collet & Dalle, GW 2007)."""

from dataclasses import dataclass

import numpy as np

from facetrack_cli.core.geometry import centre
from facetrack_cli.core.types import Array, Box, Particles, Start
from facetrack_cli.engine.checks import box_of, check_size, size_of_box
from facetrack_cli.engine.spaces import Estimate, Placed, Space, estimate
from facetrack_cli.trackers.skin.settings import Cloud


@dataclass(frozen=True)
class CloudSpace(Space):
    """Each particle is a pixel (Gianni et al. 2007): state (1, 2) = (x, y); its box has four deviations a side."""

    smooths = False

    @classmethod
    def place(cls, settings: Cloud, start: Start, name: str) -> Placed:
        """All over the target's box, whose mean side is the unit of length."""
        box = check_size(start.origin, name, box_of(start, name))
        windows = np.array([box[2:]])
        return Placed(cls(), cls().at(box), windows, size_of_box(start, name), (0.25, 4.0), windows)

    def estimate(self, particles: Particles, ess: Array, *, best: bool) -> Estimate:
        """The covariance of the pixels themselves: they are the target, not hypotheses of its place."""
        return estimate(particles, np.full_like(ess, np.inf), best=best)

    def windows(self, estimated: Estimate) -> Array:
        return 4.0 * np.sqrt(np.maximum(np.diagonal(estimated.cov, axis1=1, axis2=2), 0.0))

    def at(self, box: Box) -> Array:
        return np.array([[*centre(box), 1.0, 0.0, 0.0, 0.0]])
