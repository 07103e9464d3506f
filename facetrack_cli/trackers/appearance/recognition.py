"""Who the face is: joint weights over motion and identity (Zhou, Chellappa & Moghaddam 2003, eq. 5 and figure 1).

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
from typing import Any, ClassVar

import numpy as np

from facetrack_cli.core.types import Array, Frame, Image, Particles
from facetrack_cli.engine.protocols import Likelihood
from facetrack_cli.engine.resampling import logsumexp, normalise
from facetrack_cli.engine.spaces import Context
from facetrack_cli.recipe.load import resolve_file
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.trackers.appearance.appearance import Appearance, Mixture
from facetrack_cli.trackers.appearance.gallery import NONE, Gallery, load_gallery
from facetrack_cli.trackers.appearance.settings import RecognitionSettings
from facetrack_cli.trajectory.diagnostics import ENTROPY, POSTERIOR

# of a box's proportions against the gallery's: up to 1.2 all of 24 runs named the right one, at 1.25 22, at 1.5 16
MAX_STRETCH = 1.2
_MIN_WEIGHT = 1e-9  # of the largest weight: particles below it say nothing of the identity
_NEVER = -1e30  # in place of log 0, when a posterior has nothing left for an identity


@dataclass(frozen=True, eq=False)
class Recognised:
    """The appearance, log beta (N,) of the identities, with logsumexp 0, and notes on the start."""

    appearance: Mixture
    log_beta: Array
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Recognition(Likelihood):
    """An appearance that also says who it is."""

    settings: RecognitionSettings
    appearance: Appearance
    gallery: Gallery
    diagnostics: ClassVar = (POSTERIOR, ENTROPY)

    @classmethod
    def build(cls, settings: RecognitionSettings, context: Context) -> Recognition:
        appearance = context.settings.likelihood.build(context)
        shape = appearance.patches.shape
        return cls(settings, appearance, find_gallery(settings, shape, context.recipe, context.above))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The identities: the persons, and "none" if the settings ask for it."""
        return (*self.gallery.names, NONE) if self.settings.none else self.gallery.names

    def init(self, frame: Frame, x0: Array) -> Recognised:
        """Every identity is as likely. Raises InputError as the appearance does."""
        n, (w, h), wanted = len(self.names), self.appearance.patches.size, self.gallery.proportion
        notes: tuple[str, ...] = ()
        if wanted is not None and not 1 / MAX_STRETCH <= w / h / wanted <= MAX_STRETCH:
            box = f"the box of {w:.0f}x{h:.0f} pixels is {w / h:.2f} times as wide as high"
            remedy = "the name may be wrong; begin with a box of their proportions"
            notes = (f"{box}, and those of the gallery are {wanted:.2f} times: {remedy}",)
        return Recognised(self.appearance.init(frame, x0), np.full(n, -math.log(n)), notes)

    def score(self, learned: Recognised, frame: Frame, x: Array, parents: Array | None = None) -> Array:
        """log p_a + log sum_l beta_l {p_f p_n + (1 - p_f) / N} of x (N, 1, 6) -> (N, 1)."""
        joint = self._log_joint(learned, frame, x)
        return self.appearance.score(learned.appearance, frame, x, parents) + logsumexp(joint, axis=1)[:, None]

    def learn(self, learned: Recognised, frame: Frame, state: Array, particles: Particles) -> Recognised:
        """The appearance at the estimate `state` (1, 6), and the posterior by the weights of the particles."""
        joint = self._log_joint(learned, frame, particles.x)
        heavy = particles.log_w > particles.log_w.max() + math.log(_MIN_WEIGHT)
        joint, log_w = joint[heavy], particles.log_w[heavy]
        each = joint - logsumexp(joint, axis=1)[:, None]
        log_beta = normalise(np.maximum(logsumexp(log_w[:, None] + each, axis=0), _NEVER))
        appearance = self.appearance.learn(learned.appearance, frame, state, particles)
        return replace(learned, appearance=appearance, log_beta=log_beta)

    def error(self, learned: Recognised, patches: Any) -> Array:
        return self.appearance.error(learned.appearance, patches)

    def distances(self, learned: Recognised, frame: Frame, x: Array) -> Array:
        return self.appearance.distances(learned.appearance, frame, x)

    def expected(self, learned: Any) -> Any:
        return self.appearance.expected(learned.appearance)

    def insets(self, learned: Recognised) -> tuple[tuple[str, Image], ...]:
        return self.appearance.insets(learned.appearance)

    def diagnose(self, learned: Recognised) -> Mapping[str, Any]:
        """p(n_t | z_0:t) of each identity, and its entropy in nats: log N at the start, 0 when there is no doubt."""
        beta = np.exp(learned.log_beta)
        entropy = max(-float(beta @ learned.log_beta), 0.0)
        return {"posterior": dict(zip(self.names, beta.tolist(), strict=True)), "entropy": entropy}

    def _log_joint(self, learned: Recognised, frame: Frame, x: Array) -> Array:
        """(N, L): log beta_l {p_f p_n + (1 - p_f) / N} of x (N, 1, 6)."""
        settings, patches = self.settings, self.appearance.patches
        factor = patches.factor(learned.appearance.state)
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
        return np.asarray(np.maximum(joint.astype(np.float64) + log_beta, _NEVER))


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
