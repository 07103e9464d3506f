"""The loop over frames: bind, step, estimate, judge; a result a frame.

A tracker is a tuple of targets. A target is the parts of one recipe put together by `build.py`; what it learns of a
clip is a value that this loop carries from frame to frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np

from facetrack_cli.confidence import Confidence, Judgement, Measures
from facetrack_cli.filters import Step
from facetrack_cli.priors import BoundPrior
from facetrack_cli.resampling import uniform
from facetrack_cli.spaces import Estimate, estimate_points
from facetrack_cli.types import Array, Frame, Info, Particles, PartResult, Result, TargetResult


class Likelihood(Measures, Protocol):
    """An observation model; what it has learned of a clip so far is a value that it returns and is given back."""

    def init(self, frame: Frame, x0: Array) -> Any:
        """What is learned from the first frame with the parts at x0 (K, 2)."""

    def score(self, learned: Any, frame: Frame, x: Array, parents: Array) -> Array:
        """(N, K): log p(y | x) of each part, x and parents (N, K, D)."""


class Motion(Protocol):
    """How parts move from frame to frame; see `filters.FrameModel`."""

    def propagate(self, rng: np.random.Generator, x: Array) -> Array: ...

    def log_transition(self, x: Array, parents: Array) -> Array: ...


@dataclass(frozen=True)
class Target:
    """One target of a recipe, ready to track. `x0` (K, 2) pixels: its parts in the first frame."""

    name: str
    parts: tuple[str, ...]
    x0: Array
    particles: int
    motion: Motion
    likelihood: Likelihood
    prior: BoundPrior | None
    step: Step
    confidence: Confidence


Tracker: TypeAlias = tuple[Target, ...]


@dataclass(frozen=True)
class Bound:
    """A target with one frame bound in: the model that filters see (`filters.FrameModel`)."""

    target: Target
    learned: Any
    frame: Frame

    def propagate(self, rng: np.random.Generator, x: Array) -> Array:
        return self.target.motion.propagate(rng, x)

    def log_transition(self, x: Array, parents: Array) -> Array:
        return self.target.motion.log_transition(x, parents)

    def log_likelihood(self, x: Array, parents: Array) -> Array:
        return self.target.likelihood.score(self.learned, self.frame, x, parents)

    def log_prior(self, x: Array) -> Array:
        return np.zeros(len(x)) if self.target.prior is None else self.target.prior.log_density(x)

    def propose_part(self, rng: np.random.Generator, x: Array, part: int) -> Array:
        if self.target.prior is None:
            raise ValueError("there is no shape prior to propose from")
        return self.target.prior.propose(rng, x, part)


@dataclass
class _State:
    particles: Particles
    learned: Any
    judgement: Judgement


def track(tracker: Tracker, frames: Iterator[Frame], seed: int) -> Iterator[Result]:
    """Track over `frames`, the first of which is the one that the targets' `x0` belong to.

    The same tracker, frames and seed give the same results, bit for bit.
    """
    rng = np.random.default_rng(seed)
    first = next(frames, None)
    if first is None:
        return
    states = [_begin(target, first) for target in tracker]
    yield Result(first, tuple(_initial(t, s) for t, s in zip(tracker, states, strict=True)))
    for frame in frames:
        yield Result(frame, tuple(_advance(rng, t, s, frame) for t, s in zip(tracker, states, strict=True)))


def _begin(target: Target, frame: Frame) -> _State:
    learned = target.likelihood.init(frame, target.x0)
    x = np.repeat(target.x0[None], target.particles, axis=0)
    judgement = target.confidence.begin(target.likelihood, learned, frame, target.x0)
    return _State(Particles(x, uniform(target.particles)), learned, judgement)


def _initial(target: Target, state: _State) -> TargetResult:
    k = len(target.parts)
    still = Estimate(target.x0, np.zeros((k, 2, 2)))
    return _result(target, state, still, Info(np.full(k, float(target.particles))))


def _advance(rng: np.random.Generator, target: Target, state: _State, frame: Frame) -> TargetResult:
    state.particles, info = target.step(rng, state.particles, Bound(target, state.learned, frame))
    estimate = estimate_points(state.particles)
    distance = target.likelihood.distances(state.learned, frame, estimate.mean[None])[0]
    state.judgement = target.confidence.judge(state.judgement, distance)
    return _result(target, state, estimate, info)


def _result(target: Target, state: _State, estimate: Estimate, info: Info) -> TargetResult:
    parts = tuple(
        PartResult(
            name=name,
            x=float(estimate.mean[i, 0]),
            y=float(estimate.mean[i, 1]),
            w=float(target.likelihood.windows[i, 0]),
            h=float(target.likelihood.windows[i, 1]),
            status=state.judgement.status[i],
            confidence=float(state.judgement.confidence[i]),
            cov=(float(estimate.cov[i, 0, 0]), float(estimate.cov[i, 0, 1]), float(estimate.cov[i, 1, 1])),
            ess=float(info.ess[i]),
        )
        for i, name in enumerate(target.parts)
    )
    return TargetResult(target.name, parts, len(state.particles.x), state.particles.x)
