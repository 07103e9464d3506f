"""Prediction from the frame of where a target went, before any particle is drawn (Zhou et al. 2003, section 3.1.2).

Adaptive velocity (eq. 12). In the last frame, particles theta^(j) around the estimate theta and their patches y^(j)
around its patch y tell how a change of the patch and a change of the motion go together, to first order:

    X = [theta^(j) - theta],  Y = [y^(j) - y],  B = X V_q S_q^-1 U_q^T  with  Y = U S V^T,

the least squares solution with the q largest singular values. The printed nu = B (T{z_t; theta} - y) has the wrong
sign, since the new frame shows at the old place what the old one showed at theta - nu. Taken is -B (T{z_t; theta} - y),
repeated from theta + nu until eps = phi(T{z_t; theta + nu}, a_t) settles; the best step, or none, is kept.

Adaptive noise (eq. 13). r_t / r_0 = eta(eps) = a + (b - a) tanh(eps / c): tight after a good prediction, wide after a
bad one. phi is that of the likelihood, the mean squared distance from the appearance in its standard deviations.

Beyond the paper, `search` first looks for the expected patch around and begins there if the error is less.
V and S come from the eigenvectors of Y^T Y (J x J), and B is never written out: -B D = -X V_q S_q^-2 V_q^T Y^T D.

The filter around that place, and its number of particles: figure 1 and eq. 17.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, TypeAlias

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from facetrack_cli.core.types import Array, Frame, Particles
from facetrack_cli.engine.filters import FrameModel, Prediction, Stepped, weighted
from facetrack_cli.engine.kernels.affine import diffuse
from facetrack_cli.engine.motion import log_normal
from facetrack_cli.engine.protocols import Linear, Motion
from facetrack_cli.engine.spaces import Context
from facetrack_cli.trackers.appearance.settings import AdaptiveSettings, AffineWalkSettings, NoiseSettings
from facetrack_cli.trackers.appearance.space import Patches, patches_of
from facetrack_cli.trackers.appearance.velocity_kernels import differences, gain, mapped
from facetrack_cli.trajectory.diagnostics import ERROR, NOISE

Rows: TypeAlias = NDArray[np.float32]
RANK = 1e-3  # of the largest singular value: directions in which the patches differ by less are rounding


# from noise of (x, y, scale, turn, stretch, shear) to that of (x, y, a1, a2, a3, a4); orthogonal
_AFFINE = np.eye(6)
_AFFINE[2:, 2:] = np.sqrt(0.5) * np.array([[1, 0, 1, 0], [0, -1, 0, 1], [0, 1, 0, 1], [1, 0, -1, 0]])


def eta(settings: NoiseSettings | None, error: float) -> float:
    """r_t / r_0 of eps_t = `error` (eq. 13); 1 without adaptive noise."""
    if settings is None:
        return 1.0
    return settings.least + (settings.most - settings.least) * float(np.tanh(error / settings.rate))


@dataclass(frozen=True, eq=False)
class Flow:
    """What the last frame tells: the estimate (1, 6), its patch (d,), and B as `gain` (6, J) times `rows` (J, d)."""

    state: Array
    patch: Rows
    gain: Array
    rows: Rows


@dataclass(frozen=True)
class AffineWalk(Motion):
    """Gaussian noise on the parameters of an affine map, theta_t = theta_{t-1} + u_t (Zhou et al. 2003, eq. 1).

    The state is (x, y, a1, a2, a3, a4), `sigma` the standard deviation of x and y in pixels. The paper leaves u_0 open;
    here scale, turn, and stretch and shear have noise of their own: if they have the same, it is that of each of a1 to
    a4. `scale` bounds the scale, [least, most].
    """

    settings: AffineWalkSettings
    sigma: float
    scale: tuple[float, float]

    @cached_property
    def _sigma(self) -> Array:
        """(6,): standard deviations of x, y, scale, turn, stretch and shear."""
        deform, turn, shear = self.settings.deform, self.settings.turn, self.settings.shear
        turn, shear = (deform if one is None else one for one in (turn, shear))
        return np.array([self.sigma, self.sigma, deform, turn, shear, shear])

    def propagate(self, rng: np.random.Generator, x: Array, shift: Array | None = None, noise: float = 1.0) -> Array:
        """x (N, 1, 6) moved by one frame: by the `shift` (1, 6), nu_t, and `noise`, r_t / r_0, times the noise."""
        moved = np.zeros((1, 6)) if shift is None else shift
        u = rng.standard_normal(x.shape)
        return np.asarray(diffuse(x[:, 0], u[:, 0], _AFFINE * self._sigma, moved[0], noise, *self.scale))[:, None]

    def expect(self, x: Array) -> Array:
        """The mean of p(x_t | x_{t-1} = x), (N, 1, 6); the bounds of the scale are left out."""
        return x

    def log_transition(self, x: Array, parents: Array) -> Array:
        """log p(x_n | parents_m): x (N, 1, 6), parents (M, 1, 6) -> (N, M, 1); the bounds are left out."""
        return log_normal((x[:, None] - parents[None]) @ _AFFINE, np.diag(self._sigma**2))

    def linear(self, state: Array) -> Linear:
        """The motion around a state (1, 6); the bounds of the scale are left out."""
        return Linear(np.eye(6)[None], np.zeros((1, 6)), (_AFFINE * self._sigma**2 @ _AFFINE.T)[None])


@dataclass(frozen=True)
class PredictedWalk(AffineWalk):
    """A walk around the place that the frame predicts, with noise as large as the prediction is bad.

    So many `particles` are drawn around the start, where there is no last frame to learn B from.
    """

    patches: Patches
    particles: int
    diagnostics: ClassVar = (NOISE, ERROR)

    def begin(self, rng: np.random.Generator, frame: Frame, x0: Array) -> Flow:
        """The flow after the first frame, with the target at x0 (1, 6)."""
        if self.settings.velocity is None:
            return self.learn(frame, x0, x0[None])
        return self.learn(frame, x0, self.propagate(rng, np.repeat(x0[None], self.particles, axis=0)))

    def learn(self, frame: Frame, state: Array, x: Array) -> Flow:
        """The flow after a frame with the estimate `state` (1, 6) and the particles x (J, 1, 6)."""
        factor = self.patches.factor(state)
        patch = self.patches.read(frame, state[None], factor)[0]
        if (velocity := self.settings.velocity) is None:
            return Flow(state, patch, np.zeros((6, 0)), np.zeros((0, len(patch)), np.float32))
        # evenly, since particles of a filter that resamples come in order
        most = min(velocity.samples or len(x), len(x))
        chosen = np.arange(most) * len(x) // most
        rows, products = differences(self.patches.read(frame, x, factor), chosen, patch)
        return Flow(state, patch, gain(x[chosen, 0] - state[0], products, velocity.components, RANK), rows)

    def predict(
        self, flow: Flow, frame: Frame, error: Callable[[Rows], Array], expected: Callable[[], Rows]
    ) -> Prediction:
        """Where the target is expected; `error` is phi of patches (N, d) -> (N,), `expected` the model's patch (d,)."""
        factor = self.patches.factor(flow.state)
        shift = best = np.zeros_like(flow.state)
        patch = self.patches.read(frame, flow.state[None], factor)
        least = float(error(patch)[0])
        if (velocity := self.settings.velocity) is None:
            return Prediction(flow.state, best, eta(self.settings.noise, least), least)
        model = expected() if velocity.towards == "appearance" or velocity.search > 0 else flow.patch
        wanted = model if velocity.towards == "appearance" else flow.patch
        if velocity.search > 0:
            found = self._search(flow.state, frame, factor, model, velocity.search)
            there = self.patches.read(frame, (flow.state + found)[None], factor)
            now = float(error(there)[0])
            if now < least:
                least, shift, best, patch = now, found, found, there
        for _ in range(velocity.iterations):
            shift = shift - mapped(flow.gain, flow.rows, patch[0], wanted)
            patch = self.patches.read(frame, (flow.state + shift)[None], factor)
            now = float(error(patch)[0])
            settled = now >= least * (1 - velocity.settle)
            if now < least:
                least, best = now, shift
            if settled:
                break
        return Prediction(flow.state, best, eta(self.settings.noise, least), least)

    def _search(self, state: Array, frame: Frame, factor: int, expected: Rows, reach: float) -> Array:
        """(1, 6): the shift to the place within `reach` boxes of `state` that is most like the expected patch (d,)."""
        rows, columns = self.patches.shape
        w, h = self.patches.size
        m, n = (max(round(reach * side), 1) for side in (rows, columns))
        around = Patches((w * (1 + 2 * n / columns), h * (1 + 2 * m / rows)), (rows + 2 * m, columns + 2 * n))
        field = around.read(frame, state[None], factor)[0].reshape(around.shape)
        match = cv2.matchTemplate(field, expected.reshape(self.patches.shape), cv2.TM_CCOEFF_NORMED)
        _, _, _, (x, y) = cv2.minMaxLoc(match)
        place = state[0, 2:].reshape(2, 2) @ ((x - n) * w / columns, (y - m) * h / rows)
        return np.array([[*place, 0.0, 0.0, 0.0, 0.0]])


def affine_walk(settings: AffineWalkSettings, context: Context) -> AffineWalk:
    """Around a place that is predicted from the frame, where the settings say so."""
    placed = context.placed
    walk = settings, settings.sigma.pixels(placed.unit), placed.scale
    if settings.velocity is None and settings.noise is None:
        return AffineWalk(*walk)
    return PredictedWalk(*walk, patches_of(context), context.settings.filter.particles)


def adaptive(settings: AdaptiveSettings, rng: Generator, particles: Particles, model: FrameModel) -> Stepped:
    """Around the one place that is predicted (Zhou et al. 2003, figure 1): theta_t = theta_{t-1} + nu_t + u_t."""
    ahead = model.ahead
    parents = np.repeat(ahead.state[None], number(settings, ahead), axis=0)
    x = model.propagate(rng, parents)
    if settings.centre:
        x[0] = ahead.state + ahead.shift
    return weighted(model, x, parents, 0.0)


def number(settings: AdaptiveSettings, ahead: Prediction) -> int:
    """J_t, the number of particles (eq. 17). With J_0 = `particles` and d = `entropy` it is

        J_t = J_0 (eta + d)  if the entropy of the identity rose,  J_0 (eta - d)  if it did not,

    and J_0 eta where nobody is recognised; never below `least`. Eq. 17 prints (-1)^I[H_{t-1} < H_{t-2}], which adds d
    if the entropy stayed the same; taken is the text, "otherwise we deduct".
    """
    if not settings.adapt:
        return settings.particles
    change = {None: 0.0, True: -settings.entropy, False: settings.entropy}[ahead.entropy_fell]
    return max(round(settings.particles * (ahead.noise + change)), settings.least)
