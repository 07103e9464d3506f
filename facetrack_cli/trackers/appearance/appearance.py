"""The adaptive appearance model W, S, F (Zhou, Chellappa & Moghaddam 2003, section 3.1.1).

Each pixel of a patch y has a mixture of its own: W, the frame before; S, what is stable; F, the patch at the start.

    p_a = prod over pixels of sum_i m_i N(y; mu_i, sigma_i^2), i = w, s, f        eq. 6
    o_i = m_i N(y; mu_i, sigma_i^2) / p_a                                         eq. 7
    m_i <- alpha o_i + (1 - alpha) m_i                                            eq. 8
    M_p <- alpha y^p o_s + (1 - alpha) M_p, p = 1, 2                              eq. 9
    S = M_1 / m_s,  sigma_s^2 = M_2 / m_s - S^2                                   eq. 10
    W = y,  F, sigma_w and sigma_f stay                                           eq. 11

Corrected in print: eq. 6 lacks the product over the pixels; eq. 7 has sigma_w where the component's own is meant, and
eq. 10 has M_1 twice. The moments begin as M_1 = m_s F, M_2 = m_s (sigma_s^2 + F^2), which give F and sigma_s back; the
printed m_s sigma_s^2 + F^2 does not. Beyond the paper:

- sigma_s has the floor `least_sigma`; the weights have the floor `least_mixing` before they are made to sum to 1, or a
  component could vanish for ever. M_1 and M_2 follow m_s there, so that S stays. Weight 0 at the start stays 0.
- A point beyond the frame teaches nothing.
- `laplace` has exp(-|y - mu| / b) / (2 b), b = sigma / sqrt(2). With weights (0, 0, 1) it is the fixed template of the
  authors' earlier tracker.
- `outlier` is the weight of a fourth component, the L of Jepson et al. (the paper's [3]), uniform over `OUTLIER_RANGE`;
  the other three share the rest.
- `pixels`: neighbours in a patch are not independent. log p_a is multiplied by `pixels` / d; with `independent:
  estimated` by the share that is estimated from frame to frame (`effective_share` in engine/resampling.py).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Array, Frame, Image, Particles
from facetrack_cli.engine.protocols import Likelihood
from facetrack_cli.engine.resampling import averaged, effective_share
from facetrack_cli.engine.spaces import Context
from facetrack_cli.trackers.appearance import appearance_kernels as kernel
from facetrack_cli.trackers.appearance.affine import Patches
from facetrack_cli.trackers.appearance.appearance_kernels import Rows
from facetrack_cli.trackers.appearance.settings import AppearanceSettings

OUTLIER_RANGE = 6.0  # a normalised patch lies within 3 standard deviations of its mean, but for a few points
_NEVER = -1e30


@dataclass(frozen=True, eq=False)
class Mixture:
    """a_t: weights `m`, centres `mu`, standard deviations `sigma`, (3, d) float32 each, in the order w, s, f.

    `moments` (2, d) are M_1 and M_2 of S; `state` (1, 6) the estimate at which the model last learned. `share`: how
    much of the pixels counts as independent, averaged over `frames`.
    """

    m: Rows
    mu: Rows
    sigma: Rows
    moments: Array
    state: Array
    laplace: bool = False
    outlier: float = 0.0
    share: float = 1.0
    frames: int = 0

    def log_terms(self, y: Rows) -> Array:
        """(d,): log of the mixture in each pixel of one patch y (d,), the terms of the sum in eq. 6."""
        rate, log = self.terms
        off = np.abs(y - self.mu)
        each = np.logaddexp2.reduce(log - rate * (off if self.laplace else off * off), axis=0).astype(np.float64)
        return np.asarray(np.logaddexp(each * math.log(2.0), math.log(max(self.outlier / OUTLIER_RANGE, 1e-300))))

    @cached_property
    def terms(self) -> tuple[Rows, Rows]:
        """(rate, log), (3, d) each: a component's density is 2^(log - rate |y - mu|^2), or |y - mu| of `laplace`."""
        if self.laplace:
            rate, area = np.float32(math.sqrt(2.0) / math.log(2.0)) / self.sigma, math.sqrt(2.0)
        else:
            rate, area = np.float32(0.5 / math.log(2.0)) / np.square(self.sigma), math.sqrt(2.0 * math.pi)
        with np.errstate(divide="ignore"):
            log = np.log2(np.float32((1.0 - self.outlier) / area) * self.m / self.sigma)
        return rate, np.maximum(log, np.float32(_NEVER))


@dataclass(frozen=True)
class Appearance(Likelihood):
    """`patches`: how faces are read."""

    settings: AppearanceSettings
    patches: Patches

    @classmethod
    def build(cls, settings: AppearanceSettings, context: Context) -> Appearance:
        return cls(settings, Patches.of(context))

    def init(self, frame: Frame, x0: Array) -> Mixture:
        """The model of the patch at x0 (1, 6). Raises InputError if there is nothing to see."""
        x0 = np.array(x0, np.float64)
        face = self.patches.read(frame, x0[None], self.patches.factor(x0))[0]
        if not face.any():
            what = "the face's box is of one grey level throughout"
            if self.patches.inside(frame, x0) < 0.5:
                what = "more than half of the box lies outside the image"
            remedy = "choose another box, or begin elsewhere with --init-frame"
            raise InputError(f"frame {frame.index}: {what}, so that there is no face to follow: {remedy}")
        settings = self.settings
        mixing = np.array(settings.mixing.each) / sum(settings.mixing.each)
        # a component that is left out may come without a sigma
        sigmas = np.where(mixing > 0.0, settings.sigma.each, 1.0)
        m, sigma = (np.repeat(np.array(v, np.float32)[:, None], face.size, axis=1) for v in (mixing, sigmas))
        first = face.astype(np.float64)
        moments = m[1].astype(np.float64) * np.stack([first, sigmas[1] ** 2 + np.square(first)])
        centres = np.repeat(face[None], 3, axis=0)
        mixture = Mixture(m, centres, sigma, moments, x0, settings.density == "laplace", settings.outlier or 0.0)
        if settings.independent == "all":
            return mixture
        # a pixel off, which is what a tracker is at best
        shifted = self.patches.read(frame, (x0 + np.eye(1, 6) + np.eye(1, 6, 1))[None], self.patches.factor(x0))[0]
        return replace(mixture, share=effective_share(mixture.log_terms(shifted).reshape(self.patches.shape)))

    def score(self, learned: Mixture, frame: Frame, x: Array, parents: Array | None = None) -> Array:
        """log p_a of x (N, 1, 6) -> (N, 1), eq. 6; parents do not matter."""
        y = self.patches.read(frame, x, self.patches.factor(learned.state))
        uniform = learned.outlier / OUTLIER_RANGE
        rate, log = learned.terms
        log_p = np.asarray(kernel.log_densities(y, learned.mu, rate, log, uniform, learned.laplace))[:, None]
        pixels = self.settings.pixels
        return log_p * learned.share if pixels is None else log_p * (pixels / y.shape[1])

    def learn(self, learned: Mixture, frame: Frame, state: Array, particles: Particles | None = None) -> Mixture:
        """The model after the patch at the estimate `state` (1, 6), eq. 7-11; particles do not matter."""
        y = self.patches.read(frame, state, self.patches.factor(learned.state))[0]
        if not y.any():
            return learned
        (rate, log), settings = learned.terms, self.settings
        old, outside = (learned.m, learned.mu, learned.sigma, learned.moments), learned.outlier / OUTLIER_RANGE
        rates = settings.alpha, settings.least_sigma, settings.least_mixing
        m, mu, sigma, moments = kernel.update(y, *old, rate, log, outside, learned.laplace, *rates)
        after = replace(learned, m=m, mu=mu, sigma=sigma, moments=moments, state=np.array(state))
        if settings.independent == "all":
            return after
        share = effective_share(learned.log_terms(y).reshape(self.patches.shape))
        return replace(after, share=averaged(learned.share, learned.frames + 1, share), frames=learned.frames + 1)

    def error(self, learned: Mixture, patches: Rows) -> Array:
        """eps_t of section 3.1.2 for patches (N, d) -> (N,): phi = 1/d sum_pixels sum_i m_i ((y - mu_i) / sigma_i)^2.

        The paper leaves phi open; this is that of the authors' later paper (IEEE Trans. Image Processing 13(11), 2004).
        """
        return np.asarray(kernel.errors(patches, learned.m, learned.mu, learned.sigma))

    def distances(self, learned: Mixture, frame: Frame, x: Array) -> Array:
        """1 less the NCC of x (N, 1, 6) with S or with F, whichever is larger -> (N, 1), 0..1; 0 is a perfect match."""
        y = self.patches.read(frame, x, self.patches.factor(learned.state))
        match = np.asarray(kernel.best_matches(y, learned.mu[1:]))
        return np.clip(1.0 - match, 0.0, 1.0)[:, None]

    def expected(self, learned: Mixture) -> Rows:
        """(d,): the mean of the mixture in each pixel."""
        return np.asarray((learned.m * learned.mu).sum(axis=0))

    def insets(self, learned: Mixture) -> tuple[tuple[str, Image], ...]:
        """S and W as grey images, as in the paper's figure 3; a component of weight 0 is left out."""
        shown = [(name, i) for name, i in (("stable", 1), ("recent", 0)) if self.settings.mixing.each[i] > 0]
        each = [(name, kernel.greys(learned.mu[i])) for name, i in shown or [("first", 2)]]
        return tuple((name, np.asarray(grey).reshape(self.patches.shape)) for name, grey in each)
