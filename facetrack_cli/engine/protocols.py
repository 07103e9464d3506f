"""Protocols of the parts of a particle filter: likelihood, motion and prior, with what each may offer further.

Derive from them: what a part does not say has the default written here.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Protocol, TypeAlias

from numpy.random import Generator

from facetrack_cli.core.types import Array, Frame, Mask, Particles
from facetrack_cli.trajectory.diagnostics import Diagnostic

Names: TypeAlias = Sequence[str]


class Linear(NamedTuple):
    """The motion of K parts as x_t = matrix x_{t-1} + offset + noise, noise ~ N(0, cov), for the smoother.

    `matrix` and `cov` are (K, D, D), `offset` (K, D), of the first D coordinates of the state, in its units.
    """

    matrix: Array
    offset: Array
    cov: Array


class Belief(NamedTuple):
    """What a filter knows of K parts after a frame: `mean` (K, D) and `cov` (K, D, D) of D coordinates of the state.

    `motion` is that from the frame before; `doubt` (K,) says which parts the frame may not show. Of a hand, `named`
    (2,) are the probability that both hands have their own names, and that these are others than in the frame before.
    """

    mean: Array
    cov: Array
    motion: Linear
    doubt: Mask
    named: Array | None = None


class Prediction(NamedTuple):
    """Where a target is expected in this frame, before any particle is drawn (Zhou et al. 2003, section 3.1.2).

    `state` (K, D) is the point estimate of the last frame and `shift` (K, D) what is added to it (nu_t, eq. 12);
    `noise` is eta, by which the noise is larger than usual (eq. 13), and `error` the eps_t that it follows from.
    `entropy_fell`: whether the identity had become more certain in the last frame; None if nobody is recognised.
    """

    state: Array
    shift: Array
    noise: float = 1.0
    error: float | None = None
    entropy_fell: bool | None = None


class Likelihood(Protocol):
    """An observation model, of N particles, K parts and D coordinates of a part; lengths are pixels of the frame.

    What it learns of a clip is a value, `learned`: `init`, `look`, `learn` and `relearn` return it, and each method
    gets that of the frame before. A likelihood with a predictive motion also has `error`, of patches (N, d) -> (N,),
    and `expected`, the mean patch (d,).
    """

    diagnostics: ClassVar[tuple[Diagnostic, ...]] = ()
    """What it reports beside log-likelihoods."""

    def init(self, frame: Frame, x0: Array) -> Any:
        """What is learned of the first frame.

        Parameters
        ----------
        frame : the first frame.
        x0 : (K, D), the parts there.

        Returns
        -------
        learned : any value. Its `notes`, if it has any, are lines for the user.
        """
        ...

    def score(self, learned: Any, frame: Frame, x: Array, parents: Array) -> Array:
        """The log-likelihood of each part of each particle.

        Parameters
        ----------
        learned, frame : what the frames before have taught, and this frame.
        x : (N, K, D), the particles.
        parents : (N, K, D), the particle of the frame before that each comes from.

        Returns
        -------
        (N, K) : log p(y | x), up to a constant that is the same for all particles of a part.
        """
        ...

    def learn(self, learned: Any, frame: Frame, state: Array, particles: Particles) -> Any:
        """What is known for the next frame, given the estimate `state` (K, D) and the particles of this one."""
        return learned

    def distances(self, learned: Any, frame: Frame, x: Array) -> Array:
        """(N, K): how badly parts x (N, K, D) match what the first frame showed; 0 is perfect."""
        ...

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


class Motion(Protocol):
    """How parts move from frame to frame: the transition density p(x_t | x_{t-1}) of N particles of K parts.

    Of a motion that predicts from the frame where the target went, before any particle is drawn, `begin` returns what
    it learns of a frame, a value, the flow. It also has `learn` and `predict`, and a field `ahead`, the prediction
    around which it moves in a frame: see `PredictedWalk` in `trackers/appearance/appearance.py`.
    """

    diagnostics: ClassVar[tuple[Diagnostic, ...]] = ()
    """What it reports of its predictions."""

    def begin(self, rng: Generator, frame: Frame, x0: Array) -> Any:
        """The flow of the first frame, whose parts are at x0 (K, D); None: it predicts nothing."""
        return None

    def propagate(self, rng: Generator, x: Array) -> Array:
        """(N, K, D): a draw from p(x_t | x_{t-1} = x) for each x (N, K, D)."""
        ...

    def log_transition(self, x: Array, parents: Array) -> Array:
        """(N, M, K): log p(x_n | parents_m) of each part; x (N, K, D), parents (M, K, D). Filters of points ask."""
        raise TypeError(f"{type(self).__name__} has no density")

    def expect(self, x: Array) -> Array:
        """(N, K, D): the mean of p(x_t | x_{t-1} = x)."""
        ...

    def linear(self, state: Array) -> Linear:
        """The motion around a state (K, D), for the smoother. Without it rows are never smoothed."""
        raise TypeError(f"{type(self).__name__} has no linear form, which --smooth and --lag take")

    def weighed(self, x: Array, parents: Array, score: Callable[[], Array]) -> Array:
        """(N, K): log p(y | x), which `score` gives, and of p(x | parents) over the density by which x was drawn."""
        return score()


class Prior(Protocol):
    """Which shapes, places of K parts together, are likely."""

    def log_density(self, x: Array) -> Array:
        """(N,): log p(x) of the shapes x (N, K, D), up to a constant."""
        ...

    def propose(self, rng: Generator, x: Array, part: int) -> Array:
        """(N, D): the place of a part, drawn given those of the others."""
        raise TypeError(f"{type(self).__name__} proposes no parts")
