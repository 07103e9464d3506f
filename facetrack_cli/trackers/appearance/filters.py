"""The filter around a predicted place, and its number of particles (Zhou, Chellappa & Moghaddam 2003, figure 1)."""

import numpy as np
from numpy.random import Generator

from facetrack_cli.core.types import Particles
from facetrack_cli.engine.filters import FrameModel, Prediction, Stepped, weighted
from facetrack_cli.trackers.appearance.settings import Adaptive


def adaptive(settings: Adaptive, rng: Generator, particles: Particles, model: FrameModel) -> Stepped:
    """Around the one place that is predicted (Zhou et al. 2003, figure 1): theta_t = theta_{t-1} + nu_t + u_t."""
    ahead = model.ahead
    parents = np.repeat(ahead.state[None], number(settings, ahead), axis=0)
    x = model.propagate(rng, parents)
    if settings.centre:
        x[0] = ahead.state + ahead.shift
    return weighted(model, x, parents, 0.0)


def number(settings: Adaptive, ahead: Prediction) -> int:
    """J_t, the number of particles (eq. 17). With J_0 = `particles` and d = `entropy` it is

        J_t = J_0 (eta + d)  if the entropy of the identity rose,  J_0 (eta - d)  if it did not,

    and J_0 eta where nobody is recognised; never below `least`. Eq. 17 prints (-1)^I[H_{t-1} < H_{t-2}], which adds d
    if the entropy stayed the same; taken is the text, "otherwise we deduct".
    """
    if not settings.adapt:
        return settings.particles
    change = {None: 0.0, True: -settings.entropy, False: settings.entropy}[ahead.entropy_fell]
    return max(round(settings.particles * (ahead.noise + change)), settings.least)
