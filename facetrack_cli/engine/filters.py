"""The particle filters, side by side.

A filter is a function `(settings, rng, particles, model) -> (particles, info)`. It never sees a frame: `model` is the
target with one frame bound in, `FrameModel` in `target.py`. All arithmetic on weights is in logs.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.random import Generator

from facetrack_cli.core.types import Array, Info, Mask, Particles, Whole
from facetrack_cli.engine.protocols import Prediction
from facetrack_cli.engine.resampling import distinct, effective_sample_size, logsumexp, summed, systematic, uniform
from facetrack_cli.recipe.sections import AuxiliarySettings, FactorizedSettings, IndependentSettings, SirSettings

if TYPE_CHECKING:
    from facetrack_cli.engine.target import FrameModel


# in place of log 0, so that a ratio of two zeros is 1 and not a NaN: where nothing is likely, nothing is preferred
MIN_LOG = -1e30
Stepped: TypeAlias = tuple[Particles, Info]
Step: TypeAlias = "Callable[[Generator, Particles, FrameModel], Stepped]"


def sir(settings: SirSettings, rng: Generator, particles: Particles, model: FrameModel) -> Stepped:
    """Sampling/importance resampling over the joint state (section 2), p(y|s)p(s) as the observation."""
    parents = particles.x[systematic(rng, particles.log_w, len(particles.x))]
    return weighted(model, model.propagate(rng, parents), parents, 0.0)


def auxiliary(settings: AuxiliarySettings, rng: Generator, particles: Particles, model: FrameModel) -> Stepped:
    """Auxiliary filter over the joint state (section 4; Pitt & Shephard 1999); mu is drawn of p(s|s^-), not a mean."""
    mu = model.propagate(rng, particles.x)
    log_lambda = _log_observation(model, mu, particles.x)
    first, log_first = summed(particles.log_w + log_lambda)
    chosen = systematic(rng, first, len(mu))
    parents = particles.x[chosen]
    moved, info = weighted(model, model.propagate(rng, parents), parents, -log_lambda[chosen])
    return moved, info._replace(evidence=info.evidence + float(log_first))


def factorized(
    settings: FactorizedSettings | IndependentSettings, rng: Generator, particles: Particles, model: FrameModel
) -> Stepped:
    """Filter with factorized likelihoods (Patras & Pantic 2004, section 2.1).

    Each part runs an auxiliary step of its own (steps 1-5), which represents its marginal posterior p(a_i | Y);
    particles are put together from independent draws of those marginals, the proposal g(a) = prod_i p(a_i | Y); and
    they are reweighted by

    - `prior`: the shape prior in place of the ratio of eq. 5 (eq. 11);
    - `transition`: eq. 7, the ratio of predictive densities estimated from the particles themselves;
    - `none`, of `independent`: 1. That is N independent auxiliary filters, the paper's first baseline.

    As published the auxiliary step looks ahead by a draw mu of the transition; the weights then divide by a random
    lambda, and few of them are large. Beyond the paper, `look_ahead: none` makes it a bootstrap step, which evaluates
    the likelihood half as often.

    With `from_prior` (beyond the paper) the transition of a part is the mixture of both; the label of the component
    belongs to the auxiliary variable, and the weights of steps 3 and 5 hold as they are.
    """
    n, k, d = particles.x.shape
    columns = np.arange(k)
    jumps = rng.random((n, k)) < settings.from_prior if settings.from_prior > 0 else None
    if settings.look_ahead == "none":
        chosen = systematic(rng, np.repeat(particles.log_w[:, None], k, axis=1), n)
        base, evidence = np.zeros((n, k)), 0.0
    else:
        mu = _move(rng, particles.x, model, particles.x, jumps, np.broadcast_to(np.arange(n)[:, None], (n, k)))
        log_lambda = np.maximum(model.log_likelihood(mu, particles.x), MIN_LOG)
        first, log_first = summed(particles.log_w[:, None] + log_lambda)
        chosen = systematic(rng, first, n)
        base, evidence = -log_lambda.take(chosen * k + columns), float(log_first.sum())
    parents = particles.x.reshape(n * k, d).take(chosen * k + columns, axis=0)
    s = _move(rng, parents, model, particles.x, None if jumps is None else jumps[chosen, columns], chosen)
    marginal, each = summed(np.maximum(model.log_likelihood(s, parents), MIN_LOG) + base)
    # shuffled, because resampled indices come in order and would tie the parts together
    picked = rng.permuted(systematic(rng, marginal, n), axis=0)
    x = s.reshape(n * k, d).take(picked * k + columns, axis=0)
    log_ratio = np.zeros(n)
    if settings.reweight == "prior":
        log_ratio = model.log_prior(x)
    elif settings.reweight == "transition":  # eq. 7, of the joint predictive density to the product of the parts'
        step = model.log_transition(x, particles.x)  # (N, M, K)
        marginals = logsumexp(step + particles.log_w[:, None], axis=1)
        log_ratio = logsumexp(step.sum(axis=2) + particles.log_w, axis=1) - marginals.sum(axis=1)
    log_w, log_sum = summed(log_ratio)
    log_w = uniform(n) if settings.reweight == "none" else log_w
    evidence += float(each.sum()) - k * math.log(n) + float(log_sum) - math.log(n)
    return Particles(x, log_w), Info(distinct(picked, log_w), evidence)


def _move(rng: Generator, x: Array, model: FrameModel, whole: Array, jumps: Mask | None, chosen: Whole) -> Array:
    """x (N, K, D) moved by the transition, or by the prior where `jumps` (N, K); `whole` are the parents entire."""
    moved = model.propagate(rng, x)
    if jumps is None:
        return moved
    for i in range(x.shape[1]):
        rows = np.flatnonzero(jumps[:, i])
        if rows.size:
            moved[rows, i] = model.prior.propose(rng, whole[chosen[rows, i]], i)
    return moved


def adaptive(settings: Any, rng: Generator, particles: Particles, model: FrameModel) -> Stepped:
    """Around the one place that is predicted (Zhou et al. 2003, figure 1): theta_t = theta_{t-1} + nu_t + u_t."""
    ahead = model.ahead
    parents = np.repeat(ahead.state[None], number(settings, ahead), axis=0)
    x = model.propagate(rng, parents)
    if settings.centre:
        x[0] = ahead.state + ahead.shift
    return weighted(model, x, parents, 0.0)


def number(settings: Any, ahead: Prediction) -> int:
    """J_t, the number of particles (eq. 17). With J_0 = `particles` and d = `entropy` it is

        J_t = J_0 (eta + d)  if the entropy of the identity rose,  J_0 (eta - d)  if it did not,

    and J_0 eta where nobody is recognised; never below `least`. Eq. 17 prints (-1)^I[H_{t-1} < H_{t-2}], which adds d
    if the entropy stayed the same; taken is the text, "otherwise we deduct".
    """
    if not settings.adapt:
        return int(settings.particles)
    change = {None: 0.0, True: -settings.entropy, False: settings.entropy}[ahead.entropy_fell]
    return int(max(round(settings.particles * (ahead.noise + change)), settings.least))


def weighted(model: FrameModel, x: Array, parents: Array, base: Array | float) -> Stepped:
    """Whole particles, weighed by their observation: the last step of a filter over the joint state.

    Parameters
    ----------
    model : the tracker with this frame bound in.
    x, parents : (N, K, D), the particles, and those of the frame before that they come from.
    base : (N,) or one number, their log weights before the observation, unnormalised.

    Returns
    -------
    particles, info : x with normalised log weights (N,); their effective sample size (K,) and the log evidence.
    """
    log_w, log_sum = summed(_log_observation(model, x, parents) + base)
    # a joint weight says the same of every part
    ess = np.full(x.shape[1], float(effective_sample_size(log_w)))
    return Particles(x, log_w), Info(ess, float(log_sum) - math.log(len(x)))


def _log_observation(model: FrameModel, x: Array, parents: Array) -> Array:
    """(N,): log p(y|s)p(s) of whole particles, what the filters over the joint state take for the observation."""
    observed = model.log_likelihood(x, parents).sum(axis=1) + model.log_prior(x)
    return np.asarray(np.maximum(observed, MIN_LOG))
