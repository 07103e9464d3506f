"""A target followed by a particle filter: its state from frame to frame, and the model that the filter sees."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.random import Generator

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import size_of_points
from facetrack_cli.core.types import Array, Frame, Info, Mask, Particles, TargetStart
from facetrack_cli.engine import confidence
from facetrack_cli.engine.calibration import Calibration
from facetrack_cli.engine.confidence import Judgement
from facetrack_cli.engine.filters import Prediction, Step
from facetrack_cli.engine.loop import Footprint
from facetrack_cli.engine.protocols import (
    EstimatesVisibility,
    LearnsParts,
    Likelihood,
    Motion,
    Names,
    PreparesFrame,
    ProposesModes,
    Reports,
    ScoresByMaps,
    ScoresPatches,
)
from facetrack_cli.engine.resampling import effective_sample_size, uniform
from facetrack_cli.engine.smoothing import Belief, belief
from facetrack_cli.engine.spaces import Estimate, PointSpace, Space, evenly
from facetrack_cli.recipe.model import Confidence
from facetrack_cli.trackers.appearance.velocity import Flow, PredictedWalk
from facetrack_cli.trackers.box.filters import Arrived, Guides
from facetrack_cli.trackers.box.hidden_box import VISIBLE, VisibleBoxSpace, VisibleWalk
from facetrack_cli.trackers.face.motion import JumpingWalk, SensorReading
from facetrack_cli.trackers.face.shape_prior import StudentPrior
from facetrack_cli.trackers.points.shape_prior import BoundPrior
from facetrack_cli.trackers.skin.cloud import CloudSpace, log_weights
from facetrack_cli.trackers.skin.settings import Exclusion
from facetrack_cli.trajectory.diagnostics import ENTROPY, ERROR, EVIDENCE, NOISE, POSTERIOR, Diagnostic, Diagnostics
from facetrack_cli.trajectory.trajectory import PLACE, Status, TargetResult, of_frame


@dataclass(frozen=True)
class ParticleState:
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
    ahead: Prediction | None = None
    entropy_before: float | None = None
    absent: Mask | None = None


class Rows(NamedTuple):
    """The rows of a target in a frame before they are a trajectory: columns (K,) each, log evidence, notes."""

    columns: Mapping[str, Any]
    frame: int
    evidence: float = math.nan
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
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
    prior: BoundPrior | StudentPrior | None
    step: Step
    confidence: Confidence | None
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
            windows = self.space.windows(still)
            judgement = confidence.begin(self.confidence, self.likelihood, learned, frame, self.x0, windows)
        state, result = self._begun(rng, frame, ParticleState(particles, still, learned, judgement), "init")
        return state, result._replace(notes=getattr(learned, "notes", ()))

    def _begun(
        self, rng: Generator, frame: Frame, state: ParticleState, status: Status
    ) -> tuple[ParticleState, TargetResult]:
        """The state with its diagnostics and its flow, where particles begin."""
        flow = None if self._predicts is None else self._predicts.begin(rng, frame, state.estimated.state)
        state = replace(state, reported=self._diagnose(state.learned), flow=flow)
        return state, self._result(state, frame, Info(np.full(len(self.parts), float(self.particles))), status)

    def restart(
        self,
        rng: Generator,
        frame: Frame,
        first: ParticleState,
        given: TargetStart,
        absent: Names = (),
        anew: Names = (),
    ) -> tuple[ParticleState, TargetResult]:
        """As `begin`, where `given` says that the target is in `frame`, with what the `first` frame taught.

        `given` has the target's box, or the points of all parts but those `absent`, which follow the others from then
        on, in the shape of the start, and have rows without a place. What the points `anew` look like is learned.
        """
        hidden, fresh = np.isin(self.parts, absent), np.isin(self.parts, anew)
        if isinstance(self.space, PointSpace):
            x0 = np.array([given.points.get(part, (0.0, 0.0)) for part in self.parts], dtype=float)
            x0, scatter = self.follow(x0[None], hidden)[0], None
        else:
            assert given.box is not None
            x0, scatter = self.space.at(given.box), None if self.scatter is None else np.array([given.box[2:]])
        particles, still = self._fresh(rng, x0, scatter)
        learned, judgement = first.learned, first.judgement
        if fresh.any():
            assert isinstance(self.likelihood, LearnsParts)
            learned = self.likelihood.relearn(learned, frame, x0, fresh)
        if judgement is not None:
            assert self.confidence is not None
            if isinstance(self.space, VisibleBoxSpace):
                judgement = confidence.decide(self.confidence, judgement, self.space.presence(particles, still))
            else:
                windows, measure = self.space.windows(still), self.likelihood
                judgement = confidence.resume(self.confidence, judgement, fresh, measure, learned, frame, x0, windows)
        learned = self.likelihood.learn(learned, frame, x0, particles)
        state = ParticleState(particles, still, learned, judgement, absent=hidden if hidden.any() else None)
        return self._begun(rng, frame, state, "tracked")

    def follow(self, x: Array, hidden: Mask) -> Array:
        """x (N, K, 2) with the `hidden` parts (K,) where they are from the others at the start."""
        x = x.copy()
        away = self.x0[hidden] - self.x0[~hidden].mean(axis=0)
        x[:, hidden] = x[:, ~hidden].mean(axis=1, keepdims=True) + away
        return x

    def advance(
        self,
        rng: Generator,
        state: ParticleState,
        frame: Frame,
        footprints: Sequence[Footprint] = (),
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
        measured: Sequence[SensorReading] | None = None,
    ) -> tuple[ParticleState, Info]:
        """As `advance`; `measured` is what sensors say of the parts of a target that moves by a JumpingWalk."""
        if self._prepares is not None:
            expected = self.motion.expect(state.estimated.state[None])[0]
            state = replace(state, learned=self._prepares.look(state.learned, frame, expected))
        bound = Bound(self, state, frame, footprints, measured)
        particles, info = self.step(rng, state.particles, bound)
        if state.absent is not None:
            particles = particles._replace(x=self.follow(particles.x, state.absent))
        estimated = self.space.estimate(particles, info.ess, best=self.best)
        learned = self.likelihood.learn(state.learned, frame, estimated.state, particles)
        if (judgement := state.judgement) is not None:
            assert self.confidence is not None
            if self._hides is not None:
                presence = self._hides.presence(particles, estimated)
                judgement = confidence.decide(self.confidence, judgement, presence)
            elif self._estimates_visibility is not None:
                judgement = confidence.decide(self.confidence, judgement, self._estimates_visibility.visible(learned))
            else:
                distance = self.likelihood.distances(state.learned, frame, estimated.state[None])[0]
                judgement = confidence.judge(self.confidence, judgement, distance)
        predicted: dict[str, Any] = {}
        if self._predicts is not None:
            flow = self._predicts.learn(frame, estimated.state, particles.x)
            predicted = {"flow": flow, "ahead": bound.ahead, "entropy_before": state.reported.get(ENTROPY.name)}
        state = ParticleState(
            particles, estimated, learned, judgement, self._diagnose(learned), absent=state.absent, **predicted
        )
        return state, info

    def carried(self, rng: Generator, state: ParticleState, shift: Array) -> tuple[ParticleState, Info]:
        """As `advanced`, of a box that others see `shift` (2,) from where it is expected."""
        assert isinstance(self.motion, VisibleWalk)
        before = state.estimated.state
        step = self.motion.expect(before[None])[0, 0, :2] + shift - before[0, :2]
        particles = state.particles._replace(x=self.motion.carried(rng, state.particles.x, step))
        ess = np.full(1, effective_sample_size(particles.log_w))
        state = replace(state, particles=particles, estimated=self.space.estimate(particles, ess, best=self.best))
        return state, Info(ess)

    def unseen(
        self, rng: Generator, state: ParticleState, frame: Frame, *, anywhere: bool
    ) -> tuple[ParticleState, Info]:
        """As `advanced`, of a box that nobody sees: it stays, or may be `anywhere` in the frame."""
        assert isinstance(self.space, VisibleBoxSpace) and self.confidence is not None and state.judgement is not None
        x = state.particles.x.copy()
        x[:, 0, VISIBLE] = 0.0
        if anywhere:
            x[:, 0, :2] = rng.random((len(x), 2)) * frame.size - 0.5
        particles = state.particles._replace(x=x)
        ess = np.full(1, effective_sample_size(particles.log_w))
        estimated = self.space.estimate(particles, ess, best=self.best)
        judgement = confidence.decide(self.confidence, state.judgement, np.zeros(1))
        return replace(state, particles=particles, estimated=estimated, judgement=judgement), Info(ess)

    @cached_property
    def _predicts(self) -> PredictedWalk | None:
        return self.motion if isinstance(self.motion, PredictedWalk) else None

    @cached_property
    def _scores_patches(self) -> ScoresPatches | None:
        return self.likelihood if isinstance(self.likelihood, ScoresPatches) else None

    @cached_property
    def _prepares(self) -> PreparesFrame | None:
        return self.likelihood if isinstance(self.likelihood, PreparesFrame) else None

    @cached_property
    def _scores_by_maps(self) -> ScoresByMaps | None:
        return self.likelihood if isinstance(self.likelihood, ScoresByMaps) else None

    @cached_property
    def _estimates_visibility(self) -> EstimatesVisibility | None:
        return self.likelihood if isinstance(self.likelihood, EstimatesVisibility) else None

    @cached_property
    def _hides(self) -> VisibleBoxSpace | None:
        return self.space if isinstance(self.space, VisibleBoxSpace) else None

    @cached_property
    def _reports(self) -> Reports | None:
        return self.likelihood if isinstance(self.likelihood, Reports) else None

    def _diagnose(self, learned: Any) -> Mapping[str, Any]:
        return {} if self._reports is None else self._reports.diagnose(learned)

    def footprint(self, state: ParticleState, *, ahead: bool) -> Footprint | None:
        if len(self.parts) > 1:
            return None  # points between which nobody knows what there is
        mean = state.estimated.state
        centre = self.motion.expect(mean[None])[0] if ahead else mean
        lost = state.judgement is not None and state.judgement.status[0] == "lost"
        return Footprint(centre[0, :2], self.space.windows(state.estimated)[0] / 2, lost=lost)

    @cached_property
    def _names(self) -> tuple[tuple[str, str], ...]:
        return tuple((self.name, part) for part in self.parts)

    @cached_property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """What is reported of the target beside its rows."""
        parts = (self._reports, self.space, self._predicts)
        return (*(one for part in parts if part is not None for one in part.diagnostics), EVIDENCE)

    def rows(self, state: ParticleState, frame: Frame, info: Info | None = None, otherwise: Status = "tracked") -> Rows:
        """`otherwise` is the status where nothing judges. Without `info` particles have just begun."""
        info = Info(np.full(len(self.parts), float(self.particles))) if info is None else info
        k, judged, estimated = len(self.parts), state.judgement, state.estimated
        windows, outline = self.space.windows(estimated), self.space.outline(estimated)
        std = np.sqrt(np.maximum(estimated.cov.reshape(k, 4)[:, ::3], 0.0))
        known: dict[str, Any] = {
            "x": estimated.state[:, 0], "y": estimated.state[:, 1], "w": windows[:, 0], "h": windows[:, 1],
            "std_x": std[:, 0], "std_y": std[:, 1], "cov_xy": estimated.cov[:, 0, 1],
            "particles": np.full(k, float(len(state.particles.x))), "ess": info.ess,
        }  # fmt: skip
        if estimated.side_std is not None:
            known |= {"std_w": estimated.side_std[:1], "std_h": estimated.side_std[1:]}
        if judged is None:
            known["status"] = np.array([otherwise] * k)
        else:
            known |= {"status": np.array(judged.status), "confidence": judged.confidence}
        if outline is not None:
            known |= {"angle": [outline.angle], "corners": outline.corners[None]}
        if posterior := state.reported.get(POSTERIOR.name):
            best = max(posterior.values())
            likeliest = [name for name, probability in posterior.items() if probability == best]
            if len(likeliest) == 1:  # of equals, as in the first frame, nobody is named
                known |= {"identity": likeliest * k, "identity_prob": [best] * k}
        if state.absent is not None:
            known |= {name: np.where(state.absent, np.nan, known[name]) for name in PLACE if name in known}
            known["status"] = np.where(state.absent, "absent", known["status"])
        return Rows(known, frame.index, info.evidence)

    def _result(self, state: ParticleState, frame: Frame, info: Info, otherwise: Status) -> TargetResult:
        found = self.rows(state, frame, info, otherwise)
        rows = of_frame(self._names, frame, self._reported(state, frame, info), **found.columns)
        if self.calibration is not None:
            rows = self.calibration.applied(rows, self.size)
        insets = () if self._scores_patches is None else self._scores_patches.insets(state.learned)
        return TargetResult(rows, state.particles.x[..., :2], insets, beliefs=lambda: self.beliefs(state))

    def beliefs(self, state: ParticleState) -> tuple[Belief, ...]:
        """What is known after a frame, for the smoother; nothing of a cloud, whose particles are the target itself."""
        if isinstance(self.space, CloudSpace):
            return ()
        estimated, judged = state.estimated, state.judgement
        motion = self.motion.linear(estimated.state)
        if (ahead := state.ahead) is not None:
            # its shift comes from this frame, and corrects the last estimate too: it is no motion of the target alone
            motion = motion._replace(cov=motion.cov * ahead.noise**2)
        doubt = np.zeros(len(self.parts), dtype=np.bool_) if judged is None else judged.below > 0
        counted = Particles(state.particles.x, self.space.counted(state.particles))
        one = belief(counted, motion, estimated.cov, doubt)
        return (one if self.calibration is None else self.calibration.believed(self.parts, one),)

    @cached_property
    def size(self) -> float:
        """The largest distance between two parts at the start, in pixels."""
        return size_of_points(self.x0[:, :2])

    def _reported(self, state: ParticleState, frame: Frame, info: Info) -> Mapping[str, Diagnostics]:
        values = {EVIDENCE.name: info.evidence, **state.reported, **self.space.diagnose(state.estimated)}
        if state.ahead is not None:
            values |= {NOISE.name: state.ahead.noise, ERROR.name: state.ahead.error}
        return {self.name: Diagnostics.of(self.diagnostics, [frame.index], [values])}


@dataclass(frozen=True)
class Bound:
    """A target with one frame bound in: the model that filters see (`filters.FrameModel`).

    `known` are draws whose log likelihoods were computed with them, by the draws' ids.
    """

    target: ParticleTarget
    state: ParticleState
    frame: Frame
    footprints: Sequence[Footprint] = ()
    measured: Sequence[SensorReading] | None = None
    known: dict[int, tuple[Array, Array]] = field(default_factory=dict)

    @cached_property
    def ahead(self) -> Prediction:
        """Where the motion predicts the target, or where it was."""
        estimated, learned, target = self.state.estimated.state, self.state.learned, self.target
        if target._predicts is None:
            return Prediction(estimated, np.zeros_like(estimated))
        scorer, before, entropy = (
            target._scores_patches,
            self.state.entropy_before,
            self.state.reported.get(ENTROPY.name),
        )
        assert self.state.flow is not None and scorer is not None
        ahead = target._predicts.predict(
            self.state.flow, self.frame, partial(scorer.error, learned), partial(scorer.expected, learned)
        )
        return ahead if entropy is None else ahead._replace(entropy_fell=before is None or entropy <= before)

    def propagate(self, rng: Generator, x: Array) -> Array:
        predicts, motion = self.target._predicts, self.target.motion
        if self.measured is not None:
            assert isinstance(motion, JumpingWalk)
            if self.target._scores_by_maps is None or self.target.exclusion is not None:
                return motion.propagate_given(rng, x, self.measured)
            windows = self.target._scores_by_maps.scored(self.state.learned)
            drawn, log_p = motion.propose(rng, x, self.measured, windows)
            self.known[id(drawn)] = drawn, log_p
            return drawn
        if predicts is None:
            return motion.propagate(rng, x)
        return predicts.propagate(rng, x, self.ahead.shift, self.ahead.noise)

    def expect(self, x: Array) -> Array:
        return self.target.motion.expect(x) + (0.0 if self.target._predicts is None else self.ahead.shift)

    def log_transition(self, x: Array, parents: Array) -> Array:
        return self._of_present(self.target.motion.log_transition(x, parents))

    def log_likelihood(self, x: Array, parents: Array) -> Array:
        if (known := self.known.get(id(x))) is not None:
            return self._of_present(known[1])
        log_p = self.target.likelihood.score(self.state.learned, self.frame, x, parents)
        if self.measured is not None:
            assert isinstance(self.target.motion, JumpingWalk)
            log_p = log_p + self.target.motion.log_measured(x, parents, self.measured)
        log_p = self._of_present(log_p)
        exclusion = self.target.exclusion
        return log_p if exclusion is None else log_p + log_weights(exclusion, x, self.footprints)

    def log_prior(self, x: Array) -> Array:
        if self.target.prior is None:
            return np.zeros(len(x))
        absent = self.state.absent
        return self.target.prior.log_density(x if absent is None else self.target.follow(x, absent))

    def _of_present(self, log_p: Array) -> Array:
        """log_p (..., K), in which parts that are not to be seen say nothing."""
        return log_p if self.state.absent is None else np.where(self.state.absent, 0.0, log_p)

    @property
    def guides(self) -> Guides:
        assert isinstance(self.target.likelihood, ProposesModes)
        return self.target.likelihood.guides(self.state.learned)

    def forecast(self, particles: Particles) -> tuple[Array, Array]:
        assert isinstance(self.target.motion, VisibleWalk)
        return self.target.motion.forecast(particles)

    def arrive(self, rng: Generator, z: Array, particles: Particles, *, found: bool = False) -> Arrived:
        assert isinstance(self.target.motion, VisibleWalk)
        return self.target.motion.arrive(rng, z, particles, found=found)

    def propose_part(self, rng: Generator, x: Array, part: int) -> Array:
        assert isinstance(self.target.prior, BoundPrior)
        return self.target.prior.propose(rng, x, part)
