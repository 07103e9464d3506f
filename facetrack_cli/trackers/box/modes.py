"""How high responses of a correlation filter are at its target, and at all else (ours; peaks as in LMCF, 2017).

And their modes, around which a filter draws particles, with what a motion says of places there.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.random import Generator

from facetrack_cli.core.types import Array, Image, Info, Mask, Particles
from facetrack_cli.engine.filters import MIN_LOG, Stepped
from facetrack_cli.engine.resampling import effective_sample_size, logsumexp, normalise, summed, systematic
from facetrack_cli.engine.target import FrameModel
from facetrack_cli.trackers.box.features import Single
from facetrack_cli.trackers.box.settings import GuidedSettings
from facetrack_cli.trackers.box.trained import UPSAMPLED

MIN_OTHER_STD: Final = 0.02  # standard deviation of what is not the target, in terms of the mean of its peaks
_MEMORY: Final = 50.0  # frames over which it is learned how high peaks are
_SIGMA: Final = (0.1, 0.2)  # the least and the largest standard deviation of peaks, in terms of their mean
_FREEDOM: Final = 3.0  # degrees of freedom of both densities


class Heights(NamedTuple):
    """Running mean and standard deviation of peaks, and how many frames they are learned from."""

    mean: float
    std: float
    frames: float

    def z(self, height: float) -> float:
        """How many standard deviations a height is below the mean; 0 above it."""
        return max(self.mean - height, 0.0) / self.spread

    @property
    def spread(self) -> float:
        """The standard deviation, within bounds."""
        least, most = (share * self.mean for share in _SIGMA)
        return max(min(max(self.std, least), most), 1e-9)

    def learn(self, height: float, share: float) -> Heights:
        frames = min(self.frames + share, _MEMORY)
        rate = share / frames
        off = min(max(height - self.mean, -2 * self.std), 2 * self.std)  # a mean that few bad frames do not move
        return Heights(self.mean + rate * off, math.sqrt((1 - rate) * (self.std**2 + rate * off**2)), frames)


class Peaks(NamedTuple):
    """How high responses are: of both filters at the target, and of both together where it is sought elsewhere."""

    now: float
    first: float
    elsewhere: float | None = None


class ResponseView(NamedTuple):
    """A window around `centre` (2,): R, the response of the filter of `now`, and that of the first frames.

    `spectrum` (2, C, F) is the window itself; `image`, too, as it is read for colours.
    """

    centre: Array
    spectrum: Single
    image: Image
    response: Single
    now: Single
    first: Single

    def heights(self, peak: Array) -> Peaks:
        """Those within a cell of a peak (column, row, height)."""
        column, row = round(float(peak[0])), round(float(peak[1]))
        rows, columns = (slice(max(k - UPSAMPLED, 0), k + UPSAMPLED + 1) for k in (row, column))
        return Peaks(float(self.now[rows, columns].max()), float(self.first[rows, columns].max()))


class Usual(NamedTuple):
    """How high peaks usually are: of the target, by both filters; in other windows of the first frame, and since."""

    now: Heights
    first: Heights
    others: Heights
    elsewhere: Heights

    @property
    def ratio(self) -> float:
        """How high peaks of the filter of now usually are, over peaks of the first frames' filter."""
        return self.now.mean / max(self.first.mean, 1e-9)

    def learn(self, peaks: Peaks, visible: float) -> Usual:
        """After a frame in which the target is visible with this probability."""
        elsewhere = self.elsewhere
        if peaks.elsewhere is not None:
            elsewhere = elsewhere.learn(peaks.elsewhere, 1 - visible)
        now, first = self.now.learn(peaks.now, visible), self.first.learn(peaks.first, visible)
        return Usual(now, first, self.others, elsewhere)


def evidence(seen: Heights, other: Heights, height: float, bound: float) -> float:
    """log p(height | the target) - log p(height | something else), of peaks of either, within a bound."""
    spread = max(other.std, MIN_OTHER_STD * seen.mean, 1e-9)
    ratio = log_student(seen.z(height)) - math.log(seen.spread)
    ratio -= log_student(max(height - other.mean, 0.0) / spread) - math.log(spread)
    return min(max(ratio, -bound), bound)


def log_student(z: float) -> float:
    """The logarithm of Student's density at z over that at 0."""
    return -0.5 * (_FREEDOM + 1) * math.log1p(z * z / _FREEDOM)


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


def guided(settings: GuidedSettings, rng: Generator, particles: Particles, model: FrameModel) -> Stepped:
    """Proposes from the modes of the likelihood too, with exact weights (after Zhang et al. 2017, 2018).

    Places and log scales z are drawn from q(z) = g * sum_j a_j N(z; mode_j) + (1 - g) * p(z | Y_{t-1}), g = `guided`,
    whatever their parents, so that a weight is over all parents (a marginal particle filter; Klaas et al. 2005):

        w(z, v) = L(z)^v p(z, v | Y_{t-1}) / q(z),  v = 1 where the target is visible, 0 where it is hidden

    Particles carry both, their sum as weight and the share of v = 1 as a coordinate (Rao-Blackwellised). A hidden
    target may return at a mode that re-detection found.
    """
    n, guides = settings.particles, model.likelihood.guides(model.learned).after(*model.motion.forecast(particles))
    pairs = round(settings.guided * n / 2)
    # some are drawn from either, or q would not cover what the other one covers
    drawn = 2 * min(max(pairs, 1), (n - 2) // 2) if settings.guided > 0 else 0
    parents = systematic(rng, particles.log_w, (n - drawn + 1) // 2)
    moved = model.propagate(rng, particles.x[np.repeat(parents, 2)[: n - drawn]])[:, 0, :3]
    z = np.vstack([guides.draw(rng, drawn), np.column_stack([moved[:, :2], np.log(moved[:, 2])])])
    x, log_visible, log_hidden, returns, spread = model.motion.arrive(
        rng, z, particles, found=bool(guides.redetected.any())
    )
    with np.errstate(divide="ignore"):
        log_g = np.log([drawn / n, 1 - drawn / n])
    log_q = np.logaddexp(log_g[0] + guides.log_density(z), log_g[1] + np.logaddexp(log_visible, log_hidden))
    if (found := guides.elsewhere(spread)) is not None and returns > 0:
        log_return = np.log(returns) + found.log_density(z)
        log_visible = np.logaddexp(log_visible, log_return)
        x[rng.random(n) < np.exp(log_return - log_visible), 0, 3:-1] = 0.0  # what returns has no velocity yet
    log_visible = log_visible + model.log_likelihood(x, x)[:, 0]
    total = np.logaddexp(log_visible, log_hidden)
    x[:, 0, -1] = np.exp(log_visible - total)
    log_ratio = np.maximum(total - log_q, MIN_LOG)
    log_w, log_sum = summed(log_ratio)
    evidence = float(log_sum) - math.log(n)
    return Particles(x, log_w), Info(np.full(1, float(effective_sample_size(log_w))), evidence)
