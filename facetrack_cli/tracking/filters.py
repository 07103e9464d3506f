"""The particle filters, side by side: what they differ by is all that stands here.

A filter is a function `(rng, particles, model) -> (particles, info)`. It never sees a picture: `model` is the tracker
with one frame bound in. All arithmetic on weights is in logs.

============  ===========================================================  ================================
filter        proposal                                                     weight
============  ===========================================================  ================================
sir           transition of resampled particles                            p(y|s) [p(s)]
auxiliary     transition of particles that promise a high likelihood       p(y|s) [p(s)] / lambda
factorized    product of the marginal posteriors of the parts              eq. 11, eq. 7, or 1 (independent)
adaptive      noise around the place that the picture predicts             p(y|s)
============  ===========================================================  ================================
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol, TypeAlias

import numpy as np

from facetrack_cli.core.types import Array, Info, Particles
from facetrack_cli.tracking.resampling import (
    Resampling,
    effective_sample_size,
    logsumexp,
    normalise,
    systematic,
    uniform,
)

Reweight: TypeAlias = Literal["prior", "transition", "none"]


class Ahead(NamedTuple):
    """Where a target is expected in this frame, before any particle is drawn (Zhou et al. 2003, section 3.1.2).

    `state` (K, D) is the point estimate of the last frame and `shift` (K, D) what is added to it (nu_t, eq. 12);
    `noise` is eta, by which the noise is larger than usual (eq. 13), and `error` the eps_t that it follows from.
    `entropy_fell`: whether the identity became more certain from the last frame but one to the last; None if nobody is
    recognised.
    """

    state: Array
    shift: Array
    noise: float = 1.0
    error: float | None = None
    entropy_fell: bool | None = None


class FrameModel(Protocol):
    """What a filter may ask. N particles, K parts, D coordinates a part; the parts of a particle move independently."""

    def propagate(self, rng: np.random.Generator, x: Array) -> Array:
        """(N, K, D) drawn from p(x_t | x_{t-1} = x)."""

    def log_transition(self, x: Array, parents: Array) -> Array:
        """(N, M, K): log p(x_t | x_{t-1}) of each part."""

    def log_likelihood(self, x: Array, parents: Array) -> Array:
        """(N, K): log p(y | x) of each part."""

    def log_prior(self, x: Array) -> Array:
        """(N,): log p(x) of the shape, up to a constant; zeros without a prior."""

    @property
    def ahead(self) -> Ahead:
        """Where the target is expected; `propagate` takes its shift and noise into account."""

    def propose_part(self, rng: np.random.Generator, x: Array, part: int) -> Array:
        """(N, D): part `part` drawn from the shape prior given the other parts of each particle."""


# in place of log 0, so that a ratio of two zeros is 1 and not a NaN: where nothing is likely, nothing is preferred
LEAST = -1e30

Step: TypeAlias = Callable[[np.random.Generator, Particles, FrameModel], tuple[Particles, Info]]


@dataclass(frozen=True)
class Sir:
    """Sampling/importance resampling over the joint state (section 2): resample, propagate, weigh by the likelihood.

    With a shape prior in the model, p(y|s)p(s) is the observation, as in `Auxiliary`.
    """

    resample: Resampling = systematic

    def __call__(self, rng: np.random.Generator, particles: Particles, model: FrameModel) -> tuple[Particles, Info]:
        parents = particles.x[self.resample(rng, particles.log_w, len(particles.x))]
        x = model.propagate(rng, parents)
        log_w = normalise(_log_observation(model, x, parents))
        return Particles(x, log_w), _joint_info(x, log_w)


@dataclass(frozen=True)
class Auxiliary:
    """Auxiliary filter over the joint state, p(y|s)p(s) as the observation (section 4; Pitt & Shephard 1999).

    The first stage looks ahead with a *random* draw mu ~ p(s|s^-), as section 2.1 has it, not with the mean.
    """

    resample: Resampling = systematic

    def __call__(self, rng: np.random.Generator, particles: Particles, model: FrameModel) -> tuple[Particles, Info]:
        mu = model.propagate(rng, particles.x)
        log_lambda = _log_observation(model, mu, particles.x)
        chosen = self.resample(rng, normalise(particles.log_w + log_lambda), len(mu))
        parents = particles.x[chosen]
        x = model.propagate(rng, parents)
        log_w = normalise(_log_observation(model, x, parents) - log_lambda[chosen])
        return Particles(x, log_w), _joint_info(x, log_w)


@dataclass(frozen=True)
class Factorized:
    """Filter with factorized likelihoods (Patras & Pantic 2004, section 2.1).

    Each part runs an auxiliary step of its own (steps 1-5), which represents its marginal posterior p(a_i | Y);
    particles are put together from independent draws of those marginals, the proposal g(a) = prod_i p(a_i | Y); and
    they are reweighted by

    - `prior`: the shape prior in place of the ratio of eq. 5 (eq. 11);
    - `transition`: eq. 7, the ratio of predictive densities estimated from the particles themselves;
    - `none`: 1. That is N independent auxiliary filters, the paper's first baseline.

    `from_prior` (ours, 0 as published): this share of the sub-particles of each part is drawn from the shape prior
    given the other parts of the parent instead of from the transition, so that a part can come back from afar. The
    transition of a part is then the mixture of both, the label of the component belongs to the auxiliary variable, and
    the weights of steps 3 and 5 hold as they are.
    """

    reweight: Reweight = "prior"
    from_prior: float = 0.0
    resample: Resampling = systematic

    def __call__(self, rng: np.random.Generator, particles: Particles, model: FrameModel) -> tuple[Particles, Info]:
        n, k, _ = particles.x.shape
        columns = np.arange(k)
        jumps = rng.random((n, k)) < self.from_prior if self.from_prior > 0 else None
        mu = self._move(rng, particles.x, model, particles.x, jumps)
        log_lambda = np.maximum(model.log_likelihood(mu, particles.x), LEAST)
        chosen = self.resample(rng, normalise(particles.log_w[:, None] + log_lambda), n)
        parents = particles.x[chosen, columns]
        s = self._move(rng, parents, model, particles.x, None if jumps is None else jumps[chosen, columns], chosen)
        marginal = normalise(np.maximum(model.log_likelihood(s, parents), LEAST) - log_lambda[chosen, columns])
        # shuffled, because resampled indices come in order and would tie the parts together
        x = s[rng.permuted(self.resample(rng, marginal, n), axis=0), columns]
        log_w = self._log_weights(x, particles, model)
        return Particles(x, log_w), Info(np.minimum(effective_sample_size(marginal), effective_sample_size(log_w)))

    def _log_weights(self, x: Array, previous: Particles, model: FrameModel) -> Array:
        if self.reweight == "none":
            return uniform(len(x))
        if self.reweight == "prior":
            return normalise(model.log_prior(x))
        step = model.log_transition(x, previous.x)  # (N, M, K)
        joint = logsumexp(step.sum(axis=2) + previous.log_w, axis=1)
        marginals = logsumexp(step + previous.log_w[:, None], axis=1)
        return normalise(joint - marginals.sum(axis=1))

    @staticmethod
    def _move(
        rng: np.random.Generator,
        x: Array,
        model: FrameModel,
        whole: Array,
        jumps: np.ndarray[tuple[int, int], np.dtype[np.bool_]] | None,
        chosen: np.ndarray[tuple[int, int], np.dtype[np.int64]] | None = None,
    ) -> Array:
        """x (N, K, D) moved by the transition, or by the prior where `jumps` (N, K); `whole` are the parents entire."""
        moved = model.propagate(rng, x)
        if jumps is None:
            return moved
        for i in range(x.shape[1]):
            rows = np.flatnonzero(jumps[:, i])
            if rows.size:
                moved[rows, i] = model.propose_part(rng, whole[rows if chosen is None else chosen[rows, i]], i)
        return moved


@dataclass(frozen=True)
class Adaptive:
    """All particles around the one place that is predicted, as many as the prediction is worth (Zhou et al. 2003).

    Figure 1: only the point estimate of the last frame is propagated, theta_t = theta_{t-1} + nu_t + u_t. With J_0 =
    `particles` and d = `entropy`, their number is (eq. 17)

        J_t = J_0 (eta + d)  if the entropy of the identity rose,  J_0 (eta - d)  if it did not,

    and J_0 eta where nobody is recognised; never below `least`. Eq. 17 prints (-1)^I[H_{t-1} < H_{t-2}], which adds d
    if the entropy stayed the same; the text says "otherwise we deduct", which is what is taken: a posterior that has
    settled needs no more particles. `adapt` False keeps J_0.
    """

    particles: int
    adapt: bool = True
    entropy: float = 0.0
    least: int = 10
    centre: bool = False

    def number(self, ahead: Ahead) -> int:
        """J_t."""
        if not self.adapt:
            return self.particles
        change = 0.0 if ahead.entropy_fell is None else -self.entropy if ahead.entropy_fell else self.entropy
        return max(round(self.particles * (ahead.noise + change)), self.least)

    def __call__(self, rng: np.random.Generator, particles: Particles, model: FrameModel) -> tuple[Particles, Info]:
        ahead = model.ahead
        parents = np.repeat(ahead.state[None], self.number(ahead), axis=0)
        x = model.propagate(rng, parents)
        if self.centre:
            x[0] = ahead.state + ahead.shift
        log_w = normalise(_log_observation(model, x, parents))
        return Particles(x, log_w), _joint_info(x, log_w)


def _log_observation(model: FrameModel, x: Array, parents: Array) -> Array:
    """(N,): log p(y|s)p(s) of whole particles, what the filters over the joint state take for the observation."""
    observed = model.log_likelihood(x, parents).sum(axis=1) + model.log_prior(x)
    return np.asarray(np.maximum(observed, LEAST))


def _joint_info(x: Array, log_w: Array) -> Info:
    """A joint weight says the same of every part."""
    return Info(np.full(x.shape[1], float(effective_sample_size(log_w))))
