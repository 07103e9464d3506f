"""A box that may be hidden, and what others than its own filter may do to it (ours): a face's points carry its head."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from facetrack_cli.core.types import Array, Frame, Info
from facetrack_cli.engine import confidence
from facetrack_cli.engine.resampling import effective_sample_size
from facetrack_cli.engine.target import ParticleState, ParticleTarget
from facetrack_cli.trackers.box.motion import VisibleWalk
from facetrack_cli.trackers.box.space import VISIBLE
from facetrack_cli.trajectory.trajectory import TargetResult


@dataclass(frozen=True)
class BoxTarget(ParticleTarget):
    """A target followed as a box that may be hidden, by a walk with velocity."""

    motion: VisibleWalk

    def carried(
        self, rng: Generator, state: ParticleState, frame: Frame, shift: Array
    ) -> tuple[ParticleState, TargetResult]:
        """As `advance`, where others see the box `shift` (2,) from where it is expected."""
        before = state.estimated.state
        step = self.motion.expect(before[None])[0, 0, :2] + shift - before[0, :2]
        particles = state.particles._replace(x=self.motion.carried(rng, state.particles.x, step))
        ess = np.full(1, effective_sample_size(particles.log_w))
        state = replace(state, particles=particles, estimated=self.space.estimate(particles, ess, best=self.best))
        return state, self._result(state, frame, Info(ess), "tracked")

    def unseen(
        self, rng: Generator, state: ParticleState, frame: Frame, *, anywhere: bool
    ) -> tuple[ParticleState, TargetResult]:
        """As `advance`, of a box that nobody sees: it stays, or may be `anywhere` in the frame."""
        assert self.confidence is not None and state.judgement is not None
        x = state.particles.x.copy()
        x[:, 0, VISIBLE] = 0.0
        if anywhere:
            x[:, 0, :2] = rng.random((len(x), 2)) * frame.size - 0.5
        particles = state.particles._replace(x=x)
        ess = np.full(1, effective_sample_size(particles.log_w))
        estimated = self.space.estimate(particles, ess, best=self.best)
        judgement = confidence.decide(self.confidence, state.judgement, np.zeros(1))
        state = replace(state, particles=particles, estimated=estimated, judgement=judgement)
        return state, self._result(state, frame, Info(ess), "lost")
