"""What a likelihood proposes, and what a motion says of it, for filters that draw particles around modes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from facetrack_cli.core.types import Array, Mask
from facetrack_cli.engine.resampling import logsumexp, normalise, systematic


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
        log_w = self.log_w - 0.5 * off
        return ModeProposal(
            np.where(kept, self.mean, both), np.where(kept, self.std, precision**-0.5), log_w, self.redetected
        )

    def draw(self, rng: Generator, n: int) -> Array:
        """(n, 3), n even: antithetic pairs, so that a symmetric density has no error of its mean."""
        if not n:
            return np.empty((0, 3))
        which = systematic(rng, normalise(self.log_w), n // 2)
        off = self.std[which] * rng.standard_normal((n // 2, 3))
        return np.vstack([self.mean[which] + off, self.mean[which] - off])

    def log_density(self, z: Array) -> Array:
        """(N,): of z (N, 3)."""
        off = (z[:, None] - self.mean) / self.std
        each = -0.5 * np.sum(off**2, axis=2) - np.log(self.std).sum(axis=1) - 1.5 * np.log(2 * np.pi)
        return logsumexp(each + normalise(self.log_w), axis=1)

    def elsewhere(self, spread: Array) -> ModeProposal | None:
        """The modes of re-detection, equally likely, with standard deviations `spread` (3,); None without any."""
        n = int(self.redetected.sum())
        if not n:
            return None
        return ModeProposal(self.mean[self.redetected], np.tile(spread, (n, 1)), np.zeros(n), np.ones(n, np.bool_))


class TransitionDensity(NamedTuple):
    """Places and log scales z (N, 3) as the motion sees them, given all particles of the last frame.

    `x` (N, 1, D): z with velocities drawn of p(velocity | z). `log_visible`, `log_hidden` (N,): log p(z, visible or
    hidden | Y_{t-1}), the sum over all parents, without `returns`, the probability of a return elsewhere, within
    `spread` (3,) of where it is found.
    """

    x: Array
    log_visible: Array
    log_hidden: Array
    returns: float
    spread: Array
