"""Filters that draw particles around the modes of a correlation filter's response."""

from __future__ import annotations

import math

import numpy as np
from numpy.random import Generator

from facetrack_cli.core.types import Info, Particles
from facetrack_cli.engine.filters import MIN_LOG, Stepped
from facetrack_cli.engine.resampling import SCHEMES, effective_sample_size, summed
from facetrack_cli.engine.target import FrameModel
from facetrack_cli.trackers.box.settings import GuidedSettings


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
    parents = SCHEMES["systematic"](rng, particles.log_w, (n - drawn + 1) // 2)
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
