"""A target followed by a particle filter: its state from frame to frame, and the model that the filter sees."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Final, NamedTuple, TypeAlias, TypeVar, cast

import numpy as np
from numpy.random import Generator

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import size_of_points
from facetrack_cli.core.types import BOX, Array, Frame, Info, Mask, Particles, Start, TargetStart
from facetrack_cli.engine import confidence
from facetrack_cli.engine.confidence import Calibration, Judgement, load_calibration
from facetrack_cli.engine.filters import Step
from facetrack_cli.engine.loop import Footprint
from facetrack_cli.engine.protocols import Belief, Likelihood, Linear, Motion, Names, Prediction, Prior
from facetrack_cli.engine.resampling import uniform
from facetrack_cli.engine.spaces import Context, Estimate, PointSpace, Space, evenly
from facetrack_cli.recipe.load import resolve_file
from facetrack_cli.recipe.model import ConfidenceSettings, ParticleFilterSettings, Recipe, above
from facetrack_cli.trajectory.diagnostics import ENTROPY, ERROR, EVIDENCE, NOISE, POSTERIOR, Diagnostic, Diagnostics
from facetrack_cli.trajectory.trajectory import PLACE, Status, TargetResult, of_frame

_ROUNDING: Final = 1e-9  # of a variance: what is less is rounding
Exclusion: TypeAlias = Callable[[Array, Sequence[Footprint]], Array]
"""What other targets, at their footprints, add to log p(y | x) of x (N, K, D): (N, K)."""


class ParticleState(NamedTuple):
    """What a particle filter carries on: particles, estimate, what was learned of the clip, how parts are judged.

    `reported` are the likelihood's diagnostics, `flow` is what a motion that predicts has learned, and `ahead` what it
    predicted of this frame. `entropy_fell`: whether the identity has become no less certain in this frame; None if
    nobody is recognised. `absent` (K,) are the parts that are not visible, None if all are.
    """

    particles: Particles
    estimated: Estimate
    learned: Any
    judgement: Judgement | None
    reported: Mapping[str, Any] = {}
    flow: Any = None
    ahead: Prediction | None = None
    entropy_fell: bool | None = None
    absent: Mask | None = None


@dataclass(frozen=True, eq=False)
class ParticleTarget:
    """A target followed by a particle filter. `x0` (K, D): the state in the first frame.

    `confidence` is None where the likelihood knows how the target moves and not what it looks like. With `scatter`
    (K, 2), particles begin evenly over so many pixels around x0, which are then the size of each part at the start.
    `best`: the estimate is the best particle, not the mean. `calibration` makes a probability of the confidence that is
    reported, and of nothing else.
    """

    name: str
    parts: tuple[str, ...]
    space: Space
    x0: Array
    particles: int
    motion: Motion
    likelihood: Likelihood
    prior: Prior | None
    step: Step
    confidence: ConfidenceSettings | None
    exclusion: Exclusion | None = None
    scatter: Array | None = None
    best: bool = False
    calibration: Calibration | None = None

    @property
    def windows(self) -> Mapping[str, tuple[float, float]]:
        sides = self.space.windows(evenly(self.x0, self.scatter))
        return {part: (float(w), float(h)) for part, (w, h) in zip(self.parts, sides, strict=True)}

    def _fresh(self, rng: Generator, x0: Array, scatter: Array | None) -> tuple[Particles, Estimate]:
        """Particles that stand together at x0 (K, D), or evenly over `scatter` (K, 2) pixels around it."""
        x = np.repeat(x0[None], self.particles, axis=0)
        if scatter is not None:
            x[..., :2] += scatter * (rng.random((*x.shape[:2], 2)) - 0.5)
        return Particles(x, uniform(self.particles)), evenly(x0, scatter)

    def begin(self, rng: Generator, frame: Frame) -> tuple[ParticleState, TargetResult]:
        try:
            learned = self.likelihood.init(frame, self.x0)
        except InputError as e:
            raise InputError(f"{self.name}, {e}") from None
        particles, still = self._fresh(rng, self.x0, self.scatter)
        judgement = None
        if self.confidence is not None:
            windows, metric = self.space.windows(still), partial(self.likelihood.distances, learned)
            judgement = confidence.begin(self.confidence, metric, frame, self.x0, windows)
        state, result = self._initial(rng, frame, ParticleState(particles, still, learned, judgement), "init")
        return state, result._replace(notes=getattr(learned, "notes", ()))

    def _initial(
        self, rng: Generator, frame: Frame, state: ParticleState, status: Status
    ) -> tuple[ParticleState, TargetResult]:
        """The state with its diagnostics and its flow, where particles begin."""
        flow, reported = self.motion.begin(rng, frame, state.estimated.state), self.likelihood.diagnose(state.learned)
        state = state._replace(reported=reported, flow=flow, entropy_fell=True if ENTROPY.name in reported else None)
        return state, self._result(state, frame, self.begun, status)

    def restart(
        self,
        rng: Generator,
        frame: Frame,
        first: ParticleState,
        start: TargetStart,
        absent: Names = (),
        relearned: Names = (),
    ) -> tuple[ParticleState, TargetResult]:
        """As `begin`, where `start` says that the target is in `frame`, with what the `first` frame taught.

        `start` has its box, or the points of all parts but those `absent`, which follow the others from then on, in
        the shape of the first frame, and have rows without a place. What the points `relearned` look like is learned.
        """
        hidden, fresh = np.isin(self.parts, absent), np.isin(self.parts, relearned)
        if isinstance(self.space, PointSpace):
            x0 = np.array([start.points.get(part, (0.0, 0.0)) for part in self.parts], dtype=float)
            x0, scatter = self.follow(x0[None], hidden)[0], None
        else:
            assert start.box is not None
            x0, scatter = self.space.at(start.box), None if self.scatter is None else np.array([start.box[2:]])
        particles, still = self._fresh(rng, x0, scatter)
        learned, judgement = first.learned, first.judgement
        if fresh.any():
            learned = self.likelihood.relearn(learned, frame, x0, fresh)
        if judgement is not None:
            assert self.confidence is not None
            if (presence := self.space.presence(particles, still)) is not None:
                judgement = confidence.decide(self.confidence, judgement, presence)
            else:
                windows, metric = self.space.windows(still), partial(self.likelihood.distances, learned)
                judgement = confidence.resume(self.confidence, judgement, fresh, metric, frame, x0, windows)
        learned = self.likelihood.learn(learned, frame, x0, particles)
        state = ParticleState(particles, still, learned, judgement, absent=hidden if hidden.any() else None)
        return self._initial(rng, frame, state, "tracked")

    def follow(self, x: Array, hidden: Mask) -> Array:
        """x (N, K, 2) with the `hidden` parts (K,) where they are from the others at the start."""
        x = x.copy()
        away = self.x0[hidden] - self.x0[~hidden].mean(axis=0)
        x[:, hidden] = x[:, ~hidden].mean(axis=1, keepdims=True) + away
        return x

    def advance(
        self, rng: Generator, state: ParticleState, frame: Frame, footprints: Sequence[Footprint] = ()
    ) -> tuple[ParticleState, TargetResult]:
        """As a `Target` does."""
        state, info = self.advanced(rng, state, frame, footprints)
        return state, self._result(state, frame, info, "tracked")

    def advanced(
        self,
        rng: Generator,
        state: ParticleState,
        frame: Frame,
        footprints: Sequence[Footprint] = (),
        motion: Callable[[Any], Motion] | None = None,
    ) -> tuple[ParticleState, Info]:
        """As `advance`; `motion` makes that of this one frame of what the likelihood has learned by a look at it."""
        expected = self.motion.expect(state.estimated.state[None])[0]
        state = state._replace(learned=self.likelihood.look(state.learned, frame, expected))
        moved: Any = self.motion if motion is None else motion(state.learned)
        ahead, scorer = None, cast(Any, self.likelihood)
        if state.flow is not None:
            asked = (partial(each, state.learned) for each in (scorer.error, scorer.expected))
            ahead = moved.predict(state.flow, frame, *asked)._replace(entropy_fell=state.entropy_fell)
            moved = replace(moved, ahead=ahead)
        bound = FrameModel(self, state, frame, footprints, moved)
        particles, info = self.step(rng, state.particles, bound)
        if state.absent is not None:
            particles = particles._replace(x=self.follow(particles.x, state.absent))
        estimated = self.space.estimate(particles, info.ess, best=self.best)
        learned = self.likelihood.learn(state.learned, frame, estimated.state, particles)
        if (judgement := state.judgement) is not None:
            assert self.confidence is not None
            seen = self.space.presence(particles, estimated)
            if seen is None:
                seen = self.likelihood.visible(learned)
            if seen is not None:
                judgement = confidence.decide(self.confidence, judgement, seen)
            else:
                distance = self.likelihood.distances(state.learned, frame, estimated.state[None])[0]
                judgement = confidence.judge(self.confidence, judgement, distance)
        reported, fell = self.likelihood.diagnose(learned), None
        if ENTROPY.name in reported:
            fell = reported[ENTROPY.name] <= state.reported[ENTROPY.name]
        flow = None if ahead is None else moved.learn(frame, estimated.state, particles.x)
        return ParticleState(particles, estimated, learned, judgement, reported, flow, ahead, fell, state.absent), info

    def footprint(self, state: ParticleState, *, ahead: bool) -> Footprint | None:
        if len(self.parts) > 1:
            return None  # points between which nobody knows what there is
        mean = state.estimated.state
        centre = self.motion.expect(mean[None])[0] if ahead else mean
        lost = state.judgement is not None and state.judgement.status[0] == "lost"
        return Footprint(centre[0, :2], self.space.windows(state.estimated)[0] / 2, lost=lost)

    @cached_property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """What is reported of the target beside its rows."""
        return (*self.likelihood.diagnostics, *self.space.diagnostics, *self.motion.diagnostics, EVIDENCE)

    @cached_property
    def begun(self) -> Info:
        """Of particles that have just begun."""
        return Info(np.full(len(self.parts), float(self.particles)))

    def _result(self, state: ParticleState, frame: Frame, info: Info, otherwise: Status) -> TargetResult:
        """`otherwise` is the status where nothing judges."""
        k, judged, estimated = len(self.parts), state.judgement, state.estimated
        windows, outline = self.space.windows(estimated), self.space.outline(estimated)
        std = np.sqrt(np.maximum(estimated.cov.reshape(k, 4)[:, ::3], 0.0))
        columns: dict[str, Any] = {
            "x": estimated.state[:, 0], "y": estimated.state[:, 1], "w": windows[:, 0], "h": windows[:, 1],
            "std_x": std[:, 0], "std_y": std[:, 1], "cov_xy": estimated.cov[:, 0, 1],
            "particles": np.full(k, float(len(state.particles.x))), "ess": info.ess,
        }  # fmt: skip
        if estimated.side_std is not None:
            columns |= {"std_w": estimated.side_std[:1], "std_h": estimated.side_std[1:]}
        if judged is None:
            columns["status"] = np.array([otherwise] * k)
        else:
            columns |= {"status": np.array(judged.status), "confidence": judged.confidence}
        if outline is not None:
            columns |= {"angle": [outline[0]], "corners": outline[1][None]}
        if posterior := state.reported.get(POSTERIOR.name):
            best = max(posterior.values())
            likeliest = [name for name, probability in posterior.items() if probability == best]
            if len(likeliest) == 1:  # of equals, as in the first frame, nobody is named
                columns |= {"identity": likeliest * k, "identity_prob": [best] * k}
        if state.absent is not None:
            columns |= {name: np.where(state.absent, np.nan, columns[name]) for name in PLACE if name in columns}
            columns["status"] = np.where(state.absent, "absent", columns["status"])
        names = tuple((self.name, part) for part in self.parts)
        rows = of_frame(names, frame, self._reported(state, frame, info), **columns)
        if self.calibration is not None:
            rows = self.calibration.applied(rows, self.size)
        return TargetResult(rows, state.particles.x[..., :2], beliefs=lambda: self.beliefs(state))

    def beliefs(self, state: ParticleState) -> tuple[Belief, ...]:
        """What is known after a frame, for the smoother; nothing of a cloud, whose particles are the target itself."""
        if not self.space.smooths:
            return ()
        estimated, judged = state.estimated, state.judgement
        motion = self.motion.linear(estimated.state)
        if (ahead := state.ahead) is not None:
            # its shift comes from this frame, and corrects the last estimate too: it is no motion of the target alone
            motion = motion._replace(cov=motion.cov * ahead.noise**2)
        doubt = np.zeros(len(self.parts), dtype=np.bool_) if judged is None else judged.below > 0
        counted = Particles(state.particles.x, self.space.counted(state.particles))
        filtered = belief(counted, motion, estimated.cov, doubt)
        return (filtered if self.calibration is None else self.calibration.believed(self.parts, filtered),)

    @cached_property
    def size(self) -> float:
        """The largest distance between two parts at the start, in pixels."""
        return size_of_points(self.x0[:, :2])

    def _reported(self, state: ParticleState, frame: Frame, info: Info) -> Mapping[str, Diagnostics]:
        values = {EVIDENCE.name: info.evidence, **state.reported, **self.space.diagnose(state.estimated)}
        if state.ahead is not None:
            values |= {NOISE.name: state.ahead.noise, ERROR.name: state.ahead.error}
        return {self.name: Diagnostics.of(self.diagnostics, [frame.index], [values])}


class FrameModel(NamedTuple):
    """What a filter may ask: a target with one frame, and the motion of it, bound in.

    Of N particles of K parts, with D coordinates a part; the parts of a particle move independently. `motion`, `prior`,
    `target` and `state` are for the filters of one tracker, which know them.
    """

    target: ParticleTarget
    state: ParticleState
    frame: Frame
    footprints: Sequence[Footprint]
    motion: Any  # a `Motion`, with what one that predicts has beside

    @property
    def prior(self) -> Any:
        return self.target.prior

    @property
    def ahead(self) -> Prediction:
        """Where the motion predicts the target, or where it was."""
        state = self.state.estimated.state
        ahead: Prediction | None = getattr(self.motion, "ahead", None)
        return Prediction(state, np.zeros_like(state)) if ahead is None else ahead

    def propagate(self, rng: Generator, x: Array) -> Array:
        """(N, K, D): a draw from p(x_t | x_{t-1} = x) for each x (N, K, D), around the place that is predicted."""
        moved: Array = self.motion.propagate(rng, x)
        return moved

    def log_transition(self, x: Array, parents: Array) -> Array:
        """(N, M, K): log p(x_n | parents_m) of each part; x (N, K, D), parents (M, K, D)."""
        return self._of_present(self.motion.log_transition(x, parents))

    def log_likelihood(self, x: Array, parents: Array) -> Array:
        """(N, K): log p(y | x) of each part; x and the particles that they come from are (N, K, D)."""
        score = partial(self.target.likelihood.score, self.state.learned, self.frame, x, parents)
        log_p = self._of_present(self.motion.weighed(x, parents, score))
        exclusion = self.target.exclusion
        return log_p if exclusion is None else log_p + exclusion(x, self.footprints)

    def log_prior(self, x: Array) -> Array:
        """(N,): log p(x) of the shape, up to a constant; zeros without a prior."""
        if self.target.prior is None:
            return np.zeros(len(x))
        absent = self.state.absent
        return self.target.prior.log_density(x if absent is None else self.target.follow(x, absent))

    def _of_present(self, log_p: Array) -> Array:
        """log_p (..., K), in which parts that are not to be seen say nothing."""
        return log_p if self.state.absent is None else np.where(self.state.absent, 0.0, log_p)


def belief(particles: Particles, motion: Linear, cov: Array, doubt: Mask) -> Belief:
    """Of particles x (N, K, D), with the estimate's covariance `cov` (K, 2, 2) of their places."""
    d = motion.matrix.shape[-1]
    w, x = np.exp(particles.log_w), particles.x[..., :d]
    mean = np.einsum("n,nkd->kd", w, x)
    spread = np.einsum("n,nkd,nke->kde", w, x - mean, x - mean)
    ours, theirs = (np.trace(matrix[:, :2, :2], axis1=1, axis2=2) for matrix in (spread, cov))
    # the estimate's counts how few particles it stands on; without particles that differ there is nothing to count
    more = np.divide(theirs, ours, out=np.ones(len(ours)), where=ours > _ROUNDING)
    return Belief(mean, spread * more[:, None, None], motion, doubt)


T = TypeVar("T", bound=ParticleTarget)


def particle_target(
    recipe: Recipe,
    key: str,
    settings: ParticleFilterSettings,
    start: Start,
    name: str,
    kind: type[T],
    exclusion: Exclusion | None = None,
) -> T:
    """The target `name` of a start, by the settings below `key` of the recipe."""
    placed = settings.target.place(start, name)
    context = Context(recipe, above(key), settings, start, name, placed)
    return kind(
        name=name,
        parts=settings.points or (BOX,),
        space=placed.space,
        x0=placed.x0,
        particles=settings.filter.particles,
        motion=settings.motion.build(context),
        likelihood=(settings.recognition or settings.likelihood).build(context),
        prior=None if settings.prior is None else settings.prior.build(context),
        step=settings.filter.build(context),
        confidence=settings.confidence if settings.likelihood.judges else None,
        exclusion=exclusion,
        scatter=placed.scatter,
        best=settings.target.best,
        calibration=calibration_of(recipe, key, settings),
    )


def calibration_of(recipe: Recipe, key: str, settings: ParticleFilterSettings) -> Calibration | None:
    """The calibration that settings name, if any."""
    name = settings.confidence.calibration
    if name is None:
        return None
    return load_calibration(resolve_file(recipe, name, f"{above(key)}confidence.calibration"))
