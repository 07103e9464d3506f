"""The loop over frames: bind, step, estimate, judge; a result a frame.

A tracker is a tuple of targets, put together by `build.py`: particle filters, or what is wrapped to stand beside them
(`opencv.py`). What a target knows of a clip is a value that this loop carries from frame to frame.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np

from facetrack_cli.confidence import Confidence, Judgement, Measures
from facetrack_cli.errors import InputError
from facetrack_cli.filters import Step
from facetrack_cli.priors import BoundPrior
from facetrack_cli.resampling import uniform
from facetrack_cli.spaces import Estimate, Space, estimate
from facetrack_cli.types import Array, Frame, Info, Particles, PartResult, Result, Status, TargetResult


class Likelihood(Measures, Protocol):
    """An observation model; what it has learned of a clip so far is a value that it returns and is given back."""

    def init(self, frame: Frame, x0: Array) -> Any:
        """What is learned from the first frame with the parts at x0 (K, D)."""

    def score(self, learned: Any, frame: Frame, x: Array, parents: Array) -> Array:
        """(N, K): log p(y | x) of each part, x and parents (N, K, D)."""

    def learn(self, learned: Any, frame: Frame, state: Array, particles: Particles) -> Any:
        """What is known after a frame with the estimate `state` (K, D), for the next one."""


class Motion(Protocol):
    """How parts move from frame to frame; see `filters.FrameModel`."""

    def propagate(self, rng: np.random.Generator, x: Array) -> Array: ...

    def log_transition(self, x: Array, parents: Array) -> Array: ...


class Target(Protocol):
    """One target of a recipe, ready to track. `state` is a value that the loop keeps for it from frame to frame."""

    @property
    def name(self) -> str: ...

    @property
    def parts(self) -> tuple[str, ...]:
        """What its results have a row of."""

    @property
    def windows(self) -> Mapping[str, tuple[float, float]]:
        """Width and height in pixels of the picture that each part is compared by, of those that have one."""

    def begin(self, rng: np.random.Generator, frame: Frame) -> tuple[Any, TargetResult]:
        """The state after the first frame, and what there is to say of it."""

    def advance(self, rng: np.random.Generator, state: Any, frame: Frame) -> tuple[Any, TargetResult]:
        """The state after one more frame, and what there is to say of it."""


Tracker: TypeAlias = tuple[Target, ...]


def track(tracker: Tracker, frames: Iterator[Frame], seed: int, *, clip: str = "") -> Iterator[Result]:
    """Track over `frames`, the first of which is the one that the tracker's start belongs to.

    The same tracker, frames and seed give the same results, bit for bit. Raises InputError, which names the `clip`, if
    the first frame does not show what a target needs.
    """
    rng = np.random.default_rng(seed)
    states: list[Any] = []
    for frame in frames:
        if states:
            ended = [target.advance(rng, state, frame) for target, state in zip(tracker, states, strict=True)]
        else:
            try:
                ended = [target.begin(rng, frame) for target in tracker]
            except InputError as e:
                raise InputError(f"{clip}: {e}" if clip else str(e)) from None
        states = [state for state, _ in ended]
        yield Result(frame, tuple(result for _, result in ended))


@dataclass(frozen=True)
class State:
    """What a particle filter carries on: its particles, what was learned of the clip, and how each part is judged."""

    particles: Particles
    learned: Any
    judgement: Judgement | None


@dataclass(frozen=True)
class ParticleTarget:
    """A target followed by a particle filter. `x0` (K, D): the state in the first frame.

    `confidence` is None where the likelihood knows how the target moves and not what it looks like.
    """

    name: str
    parts: tuple[str, ...]
    space: Space
    x0: Array
    particles: int
    motion: Motion
    likelihood: Likelihood
    prior: BoundPrior | None
    step: Step
    confidence: Confidence | None

    @property
    def windows(self) -> Mapping[str, tuple[float, float]]:
        return {
            part: (float(w), float(h)) for part, (w, h) in zip(self.parts, self.space.windows(self.x0), strict=True)
        }

    def begin(self, rng: np.random.Generator, frame: Frame) -> tuple[State, TargetResult]:
        try:
            learned = self.likelihood.init(frame, self.x0)
        except InputError as e:
            raise InputError(f"{self.name}, {e}") from None
        particles = Particles(np.repeat(self.x0[None], self.particles, axis=0), uniform(self.particles))
        judgement = None
        if self.confidence is not None:
            windows = self.space.windows(self.x0)
            judgement = self.confidence.begin(self.likelihood, learned, frame, self.x0, windows)
        state = State(particles, learned, judgement)
        k = len(self.parts)
        still = Estimate(self.x0, np.zeros((k, 2, 2)))
        return state, self._result(state, still, Info(np.full(k, float(self.particles))), "init")

    def advance(self, rng: np.random.Generator, state: State, frame: Frame) -> tuple[State, TargetResult]:
        particles, info = self.step(rng, state.particles, Bound(self, state.learned, frame))
        estimated = estimate(particles)
        judgement = state.judgement
        if self.confidence is not None and judgement is not None:
            distance = self.likelihood.distances(state.learned, frame, estimated.mean[None])[0]
            judgement = self.confidence.judge(judgement, distance)
        learned = self.likelihood.learn(state.learned, frame, estimated.mean, particles)
        state = State(particles, learned, judgement)
        return state, self._result(state, estimated, info, "tracked")

    def _result(self, state: State, estimated: Estimate, info: Info, otherwise: Status) -> TargetResult:
        """`otherwise` is the status where nothing judges."""
        judged = state.judgement
        windows = self.space.windows(estimated.mean)
        parts = tuple(
            PartResult(
                name=name,
                x=float(estimated.mean[i, 0]),
                y=float(estimated.mean[i, 1]),
                w=float(windows[i, 0]),
                h=float(windows[i, 1]),
                status=otherwise if judged is None else judged.status[i],
                confidence=None if judged is None else float(judged.confidence[i]),
                cov=(float(estimated.cov[i, 0, 0]), float(estimated.cov[i, 0, 1]), float(estimated.cov[i, 1, 1])),
                ess=float(info.ess[i]),
            )
            for i, name in enumerate(self.parts)
        )
        return TargetResult(self.name, parts, len(state.particles.x), state.particles.x[..., :2])


@dataclass(frozen=True)
class Bound:
    """A target with one frame bound in: the model that filters see (`filters.FrameModel`)."""

    target: ParticleTarget
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
