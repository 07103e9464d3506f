"""A target followed by a particle filter: its state from frame to frame, and the model that the filter sees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Array, Frame, Image, Info, Particles, TargetStart
from facetrack_cli.recipe.particle_filter import Confidence
from facetrack_cli.recipe.skin import Exclusion
from facetrack_cli.tracking import confidence
from facetrack_cli.tracking.confidence import Judgement, Measures
from facetrack_cli.tracking.exclusion import Cover, log_weights
from facetrack_cli.tracking.filters import Ahead, Step
from facetrack_cli.tracking.models.shape_prior import BoundPrior
from facetrack_cli.tracking.models.spaces import Estimate, PointSpace, Space, estimate, evenly
from facetrack_cli.tracking.models.velocity import Flow, PredictedWalk
from facetrack_cli.tracking.resampling import uniform
from facetrack_cli.trajectory.diagnostics import ENTROPY, ERROR, NOISE, POSTERIOR, Diagnostic, Diagnostics
from facetrack_cli.trajectory.trajectory import PLACE, Status, TargetResult, Trajectory, build


class Likelihood(Measures, Protocol):
    """An observation model; what it has learned of a clip so far is a value that it returns and is given back."""

    def init(self, frame: Frame, x0: Array) -> Any:
        """What is learned from the first frame with the parts at x0 (K, D).

        If there is anything that the user should know of it, it has `notes`, a line each.
        """

    def score(self, learned: Any, frame: Frame, x: Array, parents: Array) -> Array:
        """(N, K): log p(y | x) of each part, x and parents (N, K, D)."""

    def learn(self, learned: Any, frame: Frame, state: Array, particles: Particles) -> Any:
        """What is known after a frame with the estimate `state` (K, D), for the next one."""


@runtime_checkable
class Reports(Protocol):
    """A likelihood that reports more than log-likelihoods, in every frame."""

    diagnostics: tuple[Diagnostic, ...]

    def diagnose(self, learned: Any) -> Mapping[str, Any]:
        """The value of each of `diagnostics` by its name."""


@runtime_checkable  # is asked once a target: it is slow
class Adapts(Protocol):
    """A likelihood that says how far patches are from what is known, for the velocity prediction."""

    def error(self, learned: Any, patches: Any) -> Array:
        """(N,): phi(y, a_t) of patches y (N, d)."""

    def expected(self, learned: Any) -> Any:
        """(d,): the patch that the model expects, its mean."""

    def insets(self, learned: Any) -> tuple[tuple[str, Image], ...]:
        """Small grey images of what is known, each with its name."""


@runtime_checkable
class LearnsParts(Protocol):
    """A likelihood of several parts, of which some can be learned anew."""

    def relearn(self, learned: Any, frame: Frame, x0: Array, parts: NDArray[np.bool_]) -> Any:
        """What is known once `parts` (K,) look as they do in `frame` at x0 (K, D)."""


class Motion(Protocol):
    """How parts move from frame to frame; see `filters.FrameModel`."""

    def propagate(self, rng: np.random.Generator, x: Array) -> Array: ...

    def log_transition(self, x: Array, parents: Array) -> Array: ...

    def expect(self, x: Array) -> Array: ...


@dataclass(frozen=True)
class State:
    """What a particle filter carries on: particles, estimate, what was learned of the clip, how parts are judged.

    `reported` are the likelihood's diagnostics, `flow` is what a motion that predicts has learned, `ahead` what it
    predicted of this frame, and `entropy_before` the entropy of the identity in the frame before this one. `absent`
    (K,) are the parts that are not visible, None if all are.
    """

    particles: Particles
    estimated: Estimate
    learned: Any
    judgement: Judgement | None
    reported: Mapping[str, Any] = field(default_factory=dict)
    flow: Flow | None = None
    ahead: Ahead | None = None
    entropy_before: float | None = None
    absent: NDArray[np.bool_] | None = None


@dataclass(frozen=True)
class ParticleTarget:
    """A target followed by a particle filter. `x0` (K, D): the state in the first frame.

    `confidence` is None where the likelihood knows how the target moves and not what it looks like. `exclusion` is how
    it keeps off what other targets explain. With `scatter` (K, 2), particles begin evenly over so many pixels around
    x0, which are then the size of each part at the start. `best` takes the best particle for the estimate, and not the
    mean.
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
    exclusion: Exclusion | None = None
    scatter: Array | None = None
    best: bool = False

    @property
    def windows(self) -> Mapping[str, tuple[float, float]]:
        sides = self.space.windows(self._start())
        return {part: (float(w), float(h)) for part, (w, h) in zip(self.parts, sides, strict=True)}

    def _start(self) -> Estimate:
        return self._still(self.x0, self.scatter)

    @staticmethod
    def _still(x0: Array, scatter: Array | None) -> Estimate:
        return evenly(x0, np.zeros((len(x0), 2)) if scatter is None else scatter)

    def _fresh(self, rng: np.random.Generator, x0: Array, scatter: Array | None) -> Particles:
        """Particles that stand together at x0 (K, D), or evenly over `scatter` (K, 2) pixels around it."""
        x = np.repeat(x0[None], self.particles, axis=0)
        if scatter is not None:
            x[..., :2] += scatter * (rng.random((*x.shape[:2], 2)) - 0.5)
        return Particles(x, uniform(self.particles))

    def begin(self, rng: np.random.Generator, frame: Frame) -> tuple[State, TargetResult]:
        try:
            learned = self.likelihood.init(frame, self.x0)
        except InputError as e:
            raise InputError(f"{self.name}, {e}") from None
        still = self._start()
        particles = self._fresh(rng, self.x0, self.scatter)
        judgement = None
        if self.confidence is not None:
            windows = self.space.windows(still)
            judgement = confidence.begin(self.confidence, self.likelihood, learned, frame, self.x0, windows)
        flow = None if self._predicts is None else self._predicts.begin(rng, frame, self.x0)
        state = State(particles, still, learned, judgement, self._diagnose(learned), flow)
        result = self._result(state, frame, self._even, "init")
        return state, result._replace(notes=getattr(learned, "notes", ()))

    @property
    def _even(self) -> Info:
        return Info(np.full(len(self.parts), float(self.particles)))

    def restart(
        self,
        rng: np.random.Generator,
        frame: Frame,
        first: State,
        given: TargetStart,
        absent: Sequence[str] = (),
        anew: Sequence[str] = (),
    ) -> tuple[State, TargetResult]:
        """As `begin`, where `given` says that the target is in `frame`, with what the `first` frame taught.

        `given` has the target's box, or the points of all parts but those `absent`, which follow the others from then
        on, in the shape that they have at the start, and have rows without a place. What the points `anew` look like is
        learned in `frame`.
        """
        hidden = np.array([part in absent for part in self.parts])
        fresh = np.array([part in anew for part in self.parts])
        x0, scatter = self._placed(given, hidden)
        particles, still = self._fresh(rng, x0, scatter), self._still(x0, scatter)
        learned = first.learned
        if fresh.any():
            assert isinstance(self.likelihood, LearnsParts)
            learned = self.likelihood.relearn(learned, frame, x0, fresh)
        judgement = first.judgement
        if judgement is not None:
            assert self.confidence is not None
            windows = self.space.windows(still)
            judgement = confidence.resume(
                self.confidence, judgement, fresh, self.likelihood, learned, frame, x0, windows
            )
        learned = self.likelihood.learn(learned, frame, x0, particles)
        flow = None if self._predicts is None else self._predicts.begin(rng, frame, x0)
        state = State(
            particles,
            still,
            learned,
            judgement,
            self._diagnose(learned),
            flow,
            absent=hidden if hidden.any() else None,
        )
        return state, self._result(state, frame, self._even, "tracked")

    def _placed(self, given: TargetStart, hidden: NDArray[np.bool_]) -> tuple[Array, Array | None]:
        """The state (K, D) of what is given, and how far its particles are scattered."""
        if not isinstance(self.space, PointSpace):
            assert given.box is not None
            return self.space.at(given.box), None if self.scatter is None else np.array([given.box[2:]])
        nowhere = (0.0, 0.0)
        x0 = np.array([given.points.get(part, nowhere) for part in self.parts], dtype=float)
        return self.follow(x0[None], hidden)[0], None

    def follow(self, x: Array, hidden: NDArray[np.bool_]) -> Array:
        """x (N, K, 2) with the `hidden` parts (K,) where they are from the others at the start."""
        x = x.copy()
        away = self.x0[hidden] - self.x0[~hidden].mean(axis=0)
        x[:, hidden] = x[:, ~hidden].mean(axis=1, keepdims=True) + away
        return x

    def advance(
        self, rng: np.random.Generator, state: State, frame: Frame, covers: Sequence[Cover] = ()
    ) -> tuple[State, TargetResult]:
        bound = Bound(self, state, frame, covers)
        particles, info = self.step(rng, state.particles, bound)
        if state.absent is not None:
            particles = particles._replace(x=self.follow(particles.x, state.absent))
        estimated = estimate(particles, best=self.best)
        judgement = state.judgement
        if judgement is not None:
            assert self.confidence is not None
            distance = self.likelihood.distances(state.learned, frame, estimated.state[None])[0]
            judgement = confidence.judge(self.confidence, judgement, distance)
        learned = self.likelihood.learn(state.learned, frame, estimated.state, particles)
        reported = self._diagnose(learned)
        if self._predicts is None:
            state = State(particles, estimated, learned, judgement, reported, absent=state.absent)
        else:
            flow = self._predicts.learn(frame, estimated.state, particles.x)
            before = state.reported.get(ENTROPY.name)
            state = State(particles, estimated, learned, judgement, reported, flow, bound.ahead, before)
        return state, self._result(state, frame, info, "tracked")

    @cached_property
    def _predicts(self) -> PredictedWalk | None:
        return self.motion if isinstance(self.motion, PredictedWalk) else None

    @cached_property
    def _adapts(self) -> Adapts | None:
        return self.likelihood if isinstance(self.likelihood, Adapts) else None

    @cached_property
    def _reports(self) -> Reports | None:
        return self.likelihood if isinstance(self.likelihood, Reports) else None

    def _diagnose(self, learned: Any) -> Mapping[str, Any]:
        return {} if self._reports is None else self._reports.diagnose(learned)

    def predict(self, state: State, frame: Frame) -> Ahead:
        """Where the target is expected in `frame`: where its motion predicts it, or where it was."""
        estimated = state.estimated.state
        if self._predicts is None:
            return Ahead(estimated, np.zeros_like(estimated))
        adapts, learned = self._adapts, state.learned
        assert state.flow is not None and adapts is not None
        ahead = self._predicts.predict(
            state.flow, frame, lambda patches: adapts.error(learned, patches), lambda: adapts.expected(learned)
        )
        entropy = state.reported.get(ENTROPY.name)
        if entropy is None:
            return ahead
        return ahead._replace(entropy_fell=state.entropy_before is None or entropy <= state.entropy_before)

    def cover(self, state: State, *, ahead: bool) -> Cover | None:
        if len(self.parts) > 1:
            return None  # points between which nobody knows what there is
        mean = state.estimated.state
        centre = self.motion.expect(mean[None])[0] if ahead else mean
        return Cover(centre[0, :2], self.space.windows(state.estimated)[0] / 2)

    @cached_property
    def _names(self) -> tuple[tuple[str, str], ...]:
        return tuple((self.name, part) for part in self.parts)

    @cached_property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """What is reported of the target beside its rows."""
        return tuple(
            one for part in (self._reports, self.space, self._predicts) if part is not None for one in part.diagnostics
        )

    def _result(self, state: State, frame: Frame, info: Info, otherwise: Status) -> TargetResult:
        """`otherwise` is the status where nothing judges."""
        k, judged, estimated = len(self.parts), state.judgement, state.estimated
        windows, outline = self.space.windows(estimated), self.space.outline(estimated)
        identity, probability = _likeliest(state.reported.get(POSTERIOR.name))
        rows = build(
            self._names,
            np.arange(k),
            np.full(k, frame.index),
            time_s=np.full(k, frame.time_s),
            x=estimated.state[:, 0],
            y=estimated.state[:, 1],
            w=windows[:, 0],
            h=windows[:, 1],
            angle=None if outline is None else [outline.angle],
            confidence=None if judged is None else judged.confidence,
            status=[otherwise] * k if judged is None else judged.status,
            std_x=np.sqrt(np.maximum(estimated.cov[:, 0, 0], 0.0)),
            std_y=np.sqrt(np.maximum(estimated.cov[:, 1, 1], 0.0)),
            cov_xy=estimated.cov[:, 0, 1],
            particles=np.full(k, float(len(state.particles.x))),
            ess=info.ess,
            identity=[identity] * k if identity else None,
            identity_prob=[probability] * k if identity else None,
            corners=None if outline is None else outline.corners[None],
            diagnostics=self._reported(state, frame),
        )
        if state.absent is not None:
            rows = without_place(rows, state.absent)
        insets = () if self._adapts is None else self._adapts.insets(state.learned)
        return TargetResult(rows, state.particles.x[..., :2], insets)

    def _reported(self, state: State, frame: Frame) -> Mapping[str, Diagnostics]:
        if not self.diagnostics:
            return {}
        values = {**state.reported, **self.space.diagnose(state.estimated)}
        if state.ahead is not None:
            values |= {NOISE.name: state.ahead.noise, ERROR.name: state.ahead.error}
        return {self.name: Diagnostics.of(self.diagnostics, [frame.index], [values])}


def without_place(rows: Trajectory, absent: NDArray[np.bool_]) -> Trajectory:
    """The rows, those of `absent` parts (K,) without anything that is known of a place."""
    known: dict[str, Any] = {name: np.where(absent, np.nan, getattr(rows, name)) for name in (*PLACE, "cov_xy")}
    corners = None if rows.corners is None else np.where(absent[:, None, None], np.nan, rows.corners)
    return replace(rows, **known, corners=corners, status=np.where(absent, "absent", rows.status))


def _likeliest(posterior: Mapping[str, float] | None) -> tuple[str | None, float | None]:
    """Who it is, and its probability; of equals, as in the first frame, nobody is named."""
    if not posterior:
        return None, None
    best = max(posterior.values())
    likeliest = [name for name, probability in posterior.items() if probability == best]
    return (likeliest[0], best) if len(likeliest) == 1 else (None, None)


@dataclass(frozen=True)
class Bound:
    """A target with one frame bound in: the model that filters see (`filters.FrameModel`)."""

    target: ParticleTarget
    state: State
    frame: Frame
    covers: Sequence[Cover] = ()

    @cached_property
    def ahead(self) -> Ahead:
        return self.target.predict(self.state, self.frame)

    def propagate(self, rng: np.random.Generator, x: Array) -> Array:
        predicts = self.target._predicts
        if predicts is None:
            return self.target.motion.propagate(rng, x)
        return predicts.propagate(rng, x, self.ahead.shift, self.ahead.noise)

    def log_transition(self, x: Array, parents: Array) -> Array:
        return self._of_present(self.target.motion.log_transition(x, parents))

    def log_likelihood(self, x: Array, parents: Array) -> Array:
        log_p = self._of_present(self.target.likelihood.score(self.state.learned, self.frame, x, parents))
        exclusion = self.target.exclusion
        return log_p if exclusion is None else log_p + log_weights(exclusion, x, self.covers)

    def log_prior(self, x: Array) -> Array:
        if self.target.prior is None:
            return np.zeros(len(x))
        absent = self.state.absent
        return self.target.prior.log_density(x if absent is None else self.target.follow(x, absent))

    def _of_present(self, log_p: Array) -> Array:
        """log_p (..., K), in which parts that are not to be seen say nothing."""
        return log_p if self.state.absent is None else np.where(self.state.absent, 0.0, log_p)

    def propose_part(self, rng: np.random.Generator, x: Array, part: int) -> Array:
        if self.target.prior is None:
            raise ValueError("there is no shape prior to propose from")
        return self.target.prior.propose(rng, x, part)
