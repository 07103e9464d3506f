"""Protocols of the parts of a particle filter: likelihood and motion, and what a likelihood may offer further."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, TypeAlias, runtime_checkable

from numpy.random import Generator

from facetrack_cli.core.types import Array, Frame, Image, Mask, Particles, TargetStart
from facetrack_cli.engine.confidence import ComparesParts
from facetrack_cli.engine.protocols import Linear
from facetrack_cli.trackers.box.proposals import Guides
from facetrack_cli.trackers.face.motion import ScoredMaps
from facetrack_cli.trajectory.diagnostics import Diagnostic
from facetrack_cli.trajectory.trajectory import TargetResult

Names: TypeAlias = Sequence[str]


class Likelihood(ComparesParts, Protocol):
    """An observation model. What it learns of a clip is a value: it returns the value and is given it back.

    `init`: from the first frame with the parts at x0 (K, D); its `notes`, if any, are lines for the user. `score`:
    (N, K), log p(y | x) of each part, x and parents (N, K, D). `learn`: after a frame with the estimate (K, D).
    """

    def init(self, frame: Frame, x0: Array) -> Any: ...
    def score(self, learned: Any, frame: Frame, x: Array, parents: Array) -> Array: ...
    def learn(self, learned: Any, frame: Frame, state: Array, particles: Particles) -> Any: ...


@runtime_checkable
class Reports(Protocol):
    """A likelihood that reports more than log-likelihoods: in every frame the value of each diagnostic by its name."""

    diagnostics: tuple[Diagnostic, ...]

    def diagnose(self, learned: Any) -> Mapping[str, Any]: ...


@runtime_checkable  # isinstance is slow: it is asked once per target
class ScoresPatches(Protocol):
    """A likelihood that scores patches by their distance from the appearance, for the velocity prediction."""

    def error(self, learned: Any, patches: Any) -> Array: ...  # (N,): phi(y, a_t) of patches y (N, d)
    def expected(self, learned: Any) -> Any: ...  # (d,): the mean patch
    def insets(self, learned: Any) -> tuple[tuple[str, Image], ...]: ...  # small grey images, each with its name


@runtime_checkable
class PreparesFrame(Protocol):
    """A likelihood that looks at a frame once, before any particle is drawn."""

    def look(self, learned: Any, frame: Frame, expected: Array) -> Any: ...  # around the expected state (K, D)


@runtime_checkable
class ScoresByMaps(Protocol):
    """A likelihood that reads what it says of a frame from maps."""

    def scored(self, learned: Any) -> ScoredMaps: ...


@runtime_checkable
class ProposesModes(Protocol):
    """A likelihood that proposes where particles should be."""

    def guides(self, learned: Any) -> Guides: ...


@runtime_checkable
class EstimatesVisibility(Protocol):
    """A likelihood that says with which probability each part was visible, (K,), in the frame that it learned last."""

    def visible(self, learned: Any) -> Array: ...


@runtime_checkable
class LearnsParts(Protocol):
    """A likelihood that can learn some of its parts (K,) again, as they look in a frame at x0 (K, D)."""

    def relearn(self, learned: Any, frame: Frame, x0: Array, parts: Mask) -> Any: ...


@runtime_checkable
class Restarts(Protocol):
    """A target that can begin again with what it knows; see `ParticleTarget.restart`."""

    def restart(
        self, rng: Generator, frame: Frame, first: Any, given: TargetStart, absent: Names = (), anew: Names = ()
    ) -> tuple[Any, TargetResult]: ...


class Motion(Protocol):
    """How parts move from frame to frame; see `filters.FrameModel`."""

    def propagate(self, rng: Generator, x: Array) -> Array: ...
    def log_transition(self, x: Array, parents: Array) -> Array: ...
    def expect(self, x: Array) -> Array: ...
    def linear(self, state: Array) -> Linear: ...
