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
- `pixels`: neighbours in a patch are not independent. log p_a is multiplied by `pixels` / d.

Who the face is (`Recognition`): joint weights over motion and identity (eq. 5 and figure 1).

    alpha_l(j) = beta_l p_a(j) {p_f(j) p_n(j, l) + (1 - p_f(j)) / N}      weight of particle j and identity l
    w(j) = sum_l alpha_l(j),  beta_l = sum_j alpha_l(j)                   both normalised; beta is the posterior

for any likelihood p_a of affine patches, and the scores p_f and p_n of a gallery (`gallery.py`), in logs. `score` gives
log w(j), and `learn` finds beta from the weights of the filter: sum_j w(j) alpha_l(j) / w(j).

Before each frame the share `switch` of every beta_l goes to the others in equal parts; 0 as published. `none` is one
more identity, nobody of the gallery.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, cast

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Array, Frame, Particles
from facetrack_cli.engine.protocols import Likelihood
from facetrack_cli.engine.resampling import logsumexp, normalise
from facetrack_cli.engine.spaces import Context
from facetrack_cli.recipe.load import resolve_file
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.trackers.appearance import appearance_kernels as kernel
from facetrack_cli.trackers.appearance.affine import Patches
from facetrack_cli.trackers.appearance.appearance_kernels import Rows
from facetrack_cli.trackers.appearance.gallery import NONE, Gallery, load_gallery
from facetrack_cli.trackers.appearance.settings import AppearanceSettings, RecognitionSettings
from facetrack_cli.trajectory.diagnostics import ENTROPY, POSTERIOR

OUTLIER_RANGE = 6.0  # a normalised patch lies within 3 standard deviations of its mean, but for a few points
_NEVER = -1e30


@dataclass(frozen=True, eq=False)
class Mixture:
    """a_t: weights `m`, centres `mu`, standard deviations `sigma`, (3, d) float32 each, in the order w, s, f.

    `moments` (2, d) are M_1 and M_2 of S; `state` (1, 6) the estimate at which the model last learned. Of one that also
    says who it is, log beta (N,) of the identities, with logsumexp 0, and notes on the start.
    """

    m: Rows
    mu: Rows
    sigma: Rows
    moments: Array
    state: Array
    laplace: bool = False
    outlier: float = 0.0
    log_beta: Array | None = None
    notes: tuple[str, ...] = ()

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
            what = "the face's box is of one grey level, or more than half of the box lies outside the image"
            remedy = "choose another box, or begin elsewhere with --init-frame"
            raise InputError(f"frame {frame.index}: {what}: {remedy}")
        settings = self.settings
        mixing = np.array(settings.mixing.each) / sum(settings.mixing.each)
        # a component that is left out may come without a sigma
        sigmas = np.where(mixing > 0.0, settings.sigma.each, 1.0)
        m, sigma = (np.repeat(np.array(v, np.float32)[:, None], face.size, axis=1) for v in (mixing, sigmas))
        first = face.astype(np.float64)
        moments = m[1].astype(np.float64) * np.stack([first, sigmas[1] ** 2 + np.square(first)])
        centres = np.repeat(face[None], 3, axis=0)
        return Mixture(m, centres, sigma, moments, x0, settings.density == "laplace", settings.outlier or 0.0)

    def score(self, learned: Mixture, frame: Frame, x: Array, parents: Array | None = None) -> Array:
        """log p_a of x (N, 1, 6) -> (N, 1), eq. 6; parents do not matter."""
        y = self.patches.read(frame, x, self.patches.factor(learned.state))
        uniform = learned.outlier / OUTLIER_RANGE
        rate, log = learned.terms
        log_p = np.asarray(kernel.log_densities(y, learned.mu, rate, log, uniform, learned.laplace))[:, None]
        pixels = self.settings.pixels
        return log_p if pixels is None else log_p * (pixels / y.shape[1])

    def learn(self, learned: Mixture, frame: Frame, state: Array, particles: Particles | None = None) -> Mixture:
        """The model after the patch at the estimate `state` (1, 6), eq. 7-11; particles do not matter."""
        y = self.patches.read(frame, state, self.patches.factor(learned.state))[0]
        if not y.any():
            return learned
        (rate, log), settings = learned.terms, self.settings
        old, outside = (learned.m, learned.mu, learned.sigma, learned.moments), learned.outlier / OUTLIER_RANGE
        rates = settings.alpha, settings.least_sigma, settings.least_mixing
        m, mu, sigma, moments = kernel.update(y, *old, rate, log, outside, learned.laplace, *rates)
        return replace(learned, m=m, mu=mu, sigma=sigma, moments=moments, state=np.array(state))

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


# of a box's proportions against the gallery's: up to 1.2 all of 24 runs named the right one, at 1.25 22, at 1.5 16
MAX_STRETCH = 1.2
_MIN_WEIGHT = 1e-9  # of the largest weight: particles below it say nothing of the identity
_NOTHING_LEFT = -1e30  # in place of log 0, when a posterior has nothing left for an identity


@dataclass(frozen=True)
class Recognition(Appearance):
    """An appearance that also says who it is, of the persons in a gallery."""

    recognition: RecognitionSettings
    gallery: Gallery
    diagnostics: ClassVar = (POSTERIOR, ENTROPY)

    @classmethod
    def of(cls, settings: RecognitionSettings, context: Context) -> Recognition:
        patches, likelihood = Patches.of(context), cast(AppearanceSettings, context.settings.likelihood)
        gallery = find_gallery(settings, patches.shape, context.recipe, context.above)
        return cls(likelihood, patches, settings, gallery)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The identities: the persons, and "none" if the settings ask for it."""
        return (*self.gallery.names, NONE) if self.recognition.none else self.gallery.names

    def init(self, frame: Frame, x0: Array) -> Mixture:
        """Every identity is as likely. Raises InputError as the appearance does."""
        n, (w, h), wanted = len(self.names), self.patches.size, self.gallery.proportion
        notes: tuple[str, ...] = ()
        if wanted is not None and not 1 / MAX_STRETCH <= w / h / wanted <= MAX_STRETCH:
            box = f"the box of {w:.0f}x{h:.0f} pixels is {w / h:.2f} times as wide as high"
            remedy = "the name may be wrong; begin with a box of their proportions"
            notes = (f"{box}, and those of the gallery are {wanted:.2f} times: {remedy}",)
        return replace(super().init(frame, x0), log_beta=np.full(n, -math.log(n)), notes=notes)

    def score(self, learned: Any, frame: Frame, x: Array, parents: Array | None = None) -> Array:
        """log p_a + log sum_l beta_l {p_f p_n + (1 - p_f) / N} of x (N, 1, 6) -> (N, 1)."""
        joint = self._log_joint(learned, frame, x)
        return super().score(learned, frame, x, parents) + logsumexp(joint, axis=1)[:, None]

    def learn(self, learned: Any, frame: Frame, state: Array, particles: Particles | None = None) -> Any:
        """The appearance at the estimate `state` (1, 6), and the posterior by the weights of the particles."""
        assert particles is not None
        joint = self._log_joint(learned, frame, particles.x)
        heavy = particles.log_w > particles.log_w.max() + math.log(_MIN_WEIGHT)
        joint, log_w = joint[heavy], particles.log_w[heavy]
        each = joint - logsumexp(joint, axis=1)[:, None]
        log_beta = normalise(np.maximum(logsumexp(log_w[:, None] + each, axis=0), _NOTHING_LEFT))
        return replace(super().learn(learned, frame, state, particles), log_beta=log_beta)

    def diagnose(self, learned: Any) -> Mapping[str, Any]:
        """p(n_t | z_0:t) of each identity, and its entropy in nats: log N at the start, 0 when there is no doubt."""
        beta = np.exp(learned.log_beta)
        entropy = max(-float(beta @ learned.log_beta), 0.0)
        return {"posterior": dict(zip(self.names, beta.tolist(), strict=True)), "entropy": entropy}

    def _log_joint(self, learned: Any, frame: Frame, x: Array) -> Array:
        """(N, L): log beta_l {p_f p_n + (1 - p_f) / N} of x (N, 1, 6)."""
        settings, patches = self.recognition, self.patches
        factor = patches.factor(learned.state)
        # of the array x itself, since `score` and `learn` ask for the same one
        key = id(x), self.gallery, settings.none, settings.sharpness, factor, patches
        joint = frame.remembered(key)
        if joint is None:
            y = patches.read(frame, x, factor)
            frontal, log_n = self.gallery.log_scores(y, sharpness=settings.sharpness, none=settings.none)
            with np.errstate(divide="ignore"):
                named, nobody = np.log(frontal)[:, None] + log_n, np.log1p(-frontal)[:, None]
                joint = np.logaddexp(named, nobody - math.log(len(self.names))).astype(np.float32)
            frame.remember(key, x, joint)
        log_beta = learned.log_beta
        if switch := settings.switch:
            beta = np.exp(log_beta)
            with np.errstate(divide="ignore"):
                log_beta = np.log((1.0 - switch) * beta + switch * (1.0 - beta) / (len(beta) - 1))
        return np.asarray(np.maximum(joint.astype(np.float64) + log_beta, _NOTHING_LEFT))


def find_gallery(settings: RecognitionSettings, shape: tuple[int, int], recipe: Recipe, above: str) -> Gallery:
    """The gallery of a recipe for a template of that shape; RecipeError if there is none. `above`: as in `Context`."""
    key = f"{above}recognition.gallery"
    if settings.gallery is None:
        remedy = "give --gallery FILE, as facetrack gallery fit writes it, or name it here"
        raise recipe.error(key, f"nobody is known to recognise; {remedy}")
    path = resolve_file(recipe, settings.gallery, key)
    gallery = load_gallery(path)
    if gallery.shape != shape:
        its, mine = ("{} points high and {} wide".format(*size) for size in (gallery.shape, shape))
        remedy = "fit a gallery of that size, or change the template"
        raise recipe.error(key, f"{path}: the gallery's faces are {its}, and the recipe's template is {mine}; {remedy}")
    return gallery
