"""Protocols of the parts of a particle filter: likelihood, motion and prior, with what each may offer further.

Derive from them: what a part does not say has the default written here.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Protocol, TypeAlias, runtime_checkable

from numpy.random import Generator

from facetrack_cli.core.types import Array, Frame, Image, Mask, Particles
from facetrack_cli.engine.filters import Prediction
from facetrack_cli.trajectory.diagnostics import Diagnostic

Names: TypeAlias = Sequence[str]


class Linear(NamedTuple):
    """The motion of K parts as x_t = matrix x_{t-1} + offset + noise, noise ~ N(0, cov), for the smoother.

    `matrix` and `cov` are (K, D, D), `offset` (K, D), of the first D coordinates of the state, in its units.
    """

    matrix: Array
    offset: Array
    cov: Array


class Likelihood(Protocol):
    """An observation model. What it learns of a clip is a value: it returns the value and is given it back.

    `init`: from the first frame with the parts at x0 (K, D); its `notes`, if any, are lines for the user. `score`:
    (N, K), log p(y | x) of each part, x and parents (N, K, D). `learn`: after a frame with the estimate (K, D).
    `distances`: (N, K), how badly parts x match what the first frame showed; 0 is perfect. A likelihood with a
    predictive motion also has `error` of patches (N, d) -> (N,) and `expected`, the mean patch (d,).
    """

    diagnostics: ClassVar[tuple[Diagnostic, ...]] = ()
    """What it reports beside log-likelihoods."""

    def init(self, frame: Frame, x0: Array) -> Any: ...
    def score(self, learned: Any, frame: Frame, x: Array, parents: Array) -> Array: ...
    def learn(self, learned: Any, frame: Frame, state: Array, particles: Particles) -> Any: ...
    def distances(self, learned: Any, frame: Frame, x: Array) -> Array: ...

    def diagnose(self, learned: Any) -> Mapping[str, Any]:
        """In every frame the value of each diagnostic, by its name."""
        return {}

    def look(self, learned: Any, frame: Frame, expected: Array) -> Any:
        """A look at the frame around the expected state (K, D), before any particle is drawn."""
        return learned

    def visible(self, learned: Any) -> Array | None:
        """(K,): the probability that each part was visible in the frame learned last; None: distances judge."""
        return None

    def relearn(self, learned: Any, frame: Frame, x0: Array, parts: Mask) -> Any:
        """As `learned`, but of the `parts` (K,) as they look in a frame at x0 (K, D)."""
        raise TypeError(f"{type(self).__name__} does not learn single parts again")

    def insets(self, learned: Any) -> tuple[tuple[str, Image], ...]:
        """Small grey images to show beside a frame, each with its name."""
        return ()


class Motion(Protocol):
    """How parts move from frame to frame; see `filters.FrameModel`."""

    def propagate(self, rng: Generator, x: Array) -> Array: ...
    def log_transition(self, x: Array, parents: Array) -> Array: ...
    def expect(self, x: Array) -> Array: ...
    def linear(self, state: Array) -> Linear: ...

    def log_importance(self, x: Array, parents: Array) -> Array | None:
        """(N, K): log of p(x | parents) over the density by which x was drawn; None where these are equal."""
        return None

    def weighed(self, x: Array) -> Array | None:
        """(N, K): log p(y | x) plus `log_importance` of draws that were weighed as they were drawn; None of others."""
        return None


@runtime_checkable  # isinstance is slow: it is asked once per target
class PredictiveMotion(Protocol):
    """A motion that predicts from the frame where the target went, before any particle is drawn.

    What it learns of a frame is a value, the flow. `predict` is given by how much patches differ from the appearance,
    (N, d) -> (N,), and the patch (d,) that the appearance expects.
    """

    diagnostics: ClassVar[tuple[Diagnostic, ...]]

    def begin(self, rng: Generator, frame: Frame, x0: Array) -> Any: ...
    def learn(self, frame: Frame, state: Array, x: Array) -> Any: ...
    def predict(
        self, flow: Any, frame: Frame, error: Callable[[Any], Array], expected: Callable[[], Any]
    ) -> Prediction: ...
    def propagate(self, rng: Generator, x: Array, shift: Array | None = None, noise: float = 1.0) -> Array: ...


class Prior(Protocol):
    """Which shapes are likely; x is (N, K, D)."""

    def log_density(self, x: Array) -> Array: ...  # (N,)

    def propose(self, rng: Generator, x: Array, part: int) -> Array:
        """(N, D): the place of a part, drawn given those of the others."""
        raise TypeError(f"{type(self).__name__} proposes no parts")
