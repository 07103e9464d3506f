"""A face under affine maps: its state, its patches, its motion and the filter around a predicted place.

Zhou, Chellappa & Moghaddam, ICME 2003, section 4, eq. 1, 3, 12, 13 and 17.

Adaptive velocity (eq. 12). In the last frame, particles theta^(j) around the estimate theta and their patches y^(j)
around its patch y tell how a change of the patch and a change of the motion go together, to first order:

    X = [theta^(j) - theta],  Y = [y^(j) - y],  B = X V_q S_q^-1 U_q^T  with  Y = U S V^T,

the least squares solution with the q largest singular values. The printed nu = B (T{z_t; theta} - y) has the wrong
sign, since the new frame shows at the old place what the old one showed at theta - nu. Taken is -B (T{z_t; theta} - y),
repeated from theta + nu until eps = phi(T{z_t; theta + nu}, a_t) settles; the best step, or none, is kept.
V and S come from the eigenvectors of Y^T Y (J x J), and B is never written out: -B D = -X V_q S_q^-2 V_q^T Y^T D.

Adaptive noise (eq. 13). r_t / r_0 = eta(eps) = a + (b - a) tanh(eps / c): tight after a good prediction, wide after a
bad one. phi is that of the likelihood, the mean squared distance from the appearance in its standard deviations.

Beyond the paper, `search` first looks for the expected patch around and begins there if the error is less.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.random import Generator

from facetrack_cli.core.geometry import centre
from facetrack_cli.core.types import Array, Box, Frame, Particles, factor_for
from facetrack_cli.engine.filters import Prediction, Stepped, weighted
from facetrack_cli.engine.kernels.compiled import boxes_extent
from facetrack_cli.engine.protocols import Linear, Motion
from facetrack_cli.engine.spaces import Context, Estimate, SizedSpace, estimate
from facetrack_cli.engine.target import FrameModel
from facetrack_cli.trackers.appearance.appearance_kernels import Rows, differences, gain, mapped, read_patches
from facetrack_cli.trackers.appearance.settings import (
    AdaptiveSettings,
    AffineWalkSettings,
    AppearanceSettings,
    NoiseSettings,
)
from facetrack_cli.trajectory.diagnostics import AFFINE, ERROR, NOISE, SCALE

MAX_FACTOR = 256  # a face of 13 times 256 pixels or more is read with gaps
RANK = 1e-3  # of the largest singular value: directions in which the patches differ by less are rounding

# from noise of (x, y, scale, turn, stretch, shear) to that of (x, y, a1, a2, a3, a4); orthogonal
_AFFINE = np.eye(6)
_AFFINE[2:, 2:] = np.sqrt(0.5) * np.array([[1, 0, 1, 0], [0, -1, 0, 1], [0, 1, 0, 1], [1, 0, -1, 0]])


@dataclass(frozen=True)
class AffineSpace(SizedSpace):
    """A box under affine maps (section 4): state (1, 6) = (x, y, a1, a2, a3, a4).

    [[a1, a2], [a3, a4]] leads from the start to now. `size`: width, height in pixels at the start.
    """

    diagnostics: ClassVar = (SCALE, AFFINE)

    def windows(self, estimated: Estimate) -> Array:
        _, _, a1, a2, a3, a4 = estimated.state[0].tolist()
        return np.array([[math.hypot(a1, a3) * self.size[0], math.hypot(a2, a4) * self.size[1]]])

    def estimate(self, particles: Particles, ess: Array, *, best: bool) -> Estimate:
        squares = np.square(particles.x[:, 0, 2:])
        sides = np.sqrt(squares[:, :2] + squares[:, 2:]) * np.array(self.size)
        return estimate(particles, ess, best=best, sides=sides)

    def at(self, box: Box) -> Array:
        """Upright, and as wide and as high as the box."""
        return np.array([[*centre(box), box[2] / self.size[0], 0.0, 0.0, box[3] / self.size[1]]])

    def diagnose(self, estimated: Estimate) -> Mapping[str, Any]:
        x, y, *deformation = estimated.state[0].tolist()
        return {"scale": float(scale_of(estimated.state[None])[0, 0]), "affine": (*deformation, x, y)}

    def outline(self, estimated: Estimate) -> tuple[float, Array]:
        """The angle is that of the rotation which is nearest to the deformation."""
        cx, cy, a1, a2, a3, a4 = estimated.state[0].tolist()
        (w, h), ways = self.size, ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
        places = [(cx + i * w * a1 + j * h * a2, cy + i * w * a3 + j * h * a4) for i, j in ways]
        return math.degrees(math.atan2(a3 - a2, a1 + a4)), np.array(places)


def scale_of(x: Array) -> Array:
    """How large x (N, 1, 6) are, 1 at the start -> (N, 1): the RMS of the deformation's singular values."""
    return np.asarray(np.sqrt(0.5 * np.sum(np.square(x[..., 2:6]), axis=-1)))


@dataclass(frozen=True)
class Patches:
    """How an affine face is read from a frame: template and patch (eq. 3).

    Point (i, j) of a template of rows x cols is read, with the state of `AffineSpace`, at

        (cx, cy) + [[a1, a2], [a3, a4]] (w ((j + .5) / cols - .5), h ((i + .5) / rows - .5))

    with (w, h) the `size` in pixels of the box at the start; `shape`: (rows, cols), 30 x 26 in the paper. A patch has
    mean 0 and variance 1. Points beyond the frame are left out of both and are 0. A patch that is flat, or with less
    than half of it in the frame, is all 0.
    """

    size: tuple[float, float]
    shape: tuple[int, int] = (30, 26)

    @classmethod
    def of(cls, context: Context) -> Patches:
        """As the likelihood of a target reads them. Raises RecipeError for a likelihood that reads none."""
        likelihood = context.settings.likelihood
        if not isinstance(likelihood, AppearanceSettings):
            what = "does not compare patches; write velocity: null, noise: null, and no recognition"
            raise context.error("likelihood.type", f'likelihood type "{likelihood.type}" {what}')
        columns, rows = likelihood.template
        return cls(context.placed.size, (rows, columns))

    def factor(self, state: Array) -> int:
        """By what to reduce the frame for patches around `state` (1, 6), a power of two; 1 for no numbers.

        The template's points are then at most 2 pixels apart, along that side where they are closer.
        """
        _, _, a1, a2, a3, a4 = state[0].tolist()
        rows, cols = self.shape
        step = min(self.size[0] / cols * math.hypot(a1, a3), self.size[1] / rows * math.hypot(a2, a4))
        return factor_for(min(step, 2.0 * MAX_FACTOR), 2.0) if step > 2.0 else 1

    def read(self, frame: Frame, x: Array, factor: int) -> Rows:
        """Patches (N, d) of x (N, 1, 6), flattened by rows, from the frame in grey reduced by `factor`; read-only.

        The frame remembers the last few: of one state by its values, of more by the array x, which must not change.
        """
        key = self.size, self.shape, factor, x.tobytes() if x.size == 6 else id(x)
        patches: Rows | None = frame.remembered(key)
        if patches is None:
            states = np.ascontiguousarray(x.reshape(-1, 6))
            (w, h), (width, height) = self.size, frame.size
            x0, y0, x1, y1 = extent = boxes_extent(states, w, h, width, height)
            # a box is read from the block before its first one too; after one state mostly come particles around it
            more = float(factor) if len(states) > 1 else factor + 0.15 * max(x1 - x0, y1 - y0)
            grey, left, top = frame.grey(factor, (x0 - more, y0 - more, x1 + more, y1 + more))
            patches = read_patches(grey, left, top, factor, width, height, extent, states, w, h, *self.shape)
            patches.flags.writeable = False
            frame.remember(key, x, patches)
        return patches


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
    """Gaussian noise on the parameters of an affine map, theta_t = theta_{t-1} + u_t (eq. 1).

    The state is (x, y, a1, a2, a3, a4), `sigma` the standard deviation of x and y in pixels. The paper leaves u_0 open;
    here scale, turn, and stretch and shear have noise of their own: if they have the same, it is that of each of a1 to
    a4. `scale` bounds the scale, [least, most]; the linear form leaves the bounds out. The walk of a frame goes around
    the place `ahead`.
    """

    settings: AffineWalkSettings
    sigma: float
    scale: tuple[float, float]
    ahead: Prediction | None = field(default=None, kw_only=True)

    @cached_property
    def _sigma(self) -> Array:
        """(6,): standard deviations of x, y, scale, turn, stretch and shear."""
        deform, turn, shear = self.settings.deform, self.settings.turn, self.settings.shear
        turn, shear = (deform if sigma is None else sigma for sigma in (turn, shear))
        return np.array([self.sigma, self.sigma, deform, turn, shear, shear])

    def propagate(self, rng: Generator, x: Array) -> Array:
        """x (N, 1, 6) moved by one frame: by nu_t, and by the noise, r_t / r_0 times as large as at first."""
        u, spread = rng.standard_normal(x.shape), _AFFINE * self._sigma
        step = sum(u[..., j : j + 1] * spread[:, j] for j in range(6))  # in this order, on any processor
        x = x + step if self.ahead is None else x + self.ahead.shift + self.ahead.noise * step
        (least, most), scale = self.scale, scale_of(x)[..., None]
        wild = (scale < least) | (scale > most)
        if wild.any():
            by = np.clip(scale, least, most) / np.maximum(scale, 1e-12)
            x[..., 2:] = np.where(wild, x[..., 2:] * by, x[..., 2:])
        return x

    def expect(self, x: Array) -> Array:
        """The mean of p(x_t | x_{t-1} = x), (N, 1, 6)."""
        return x if self.ahead is None else x + self.ahead.shift

    def linear(self, state: Array) -> Linear:
        """The motion around a state (1, 6)."""
        return Linear(np.eye(6)[None], np.zeros((1, 6)), (_AFFINE * self._sigma**2 @ _AFFINE.T)[None])


@dataclass(frozen=True)
class PredictedWalk(AffineWalk):
    """A walk around the place that the frame predicts, with noise as large as the prediction is bad.

    So many `particles` are drawn around the start, where there is no last frame to learn B from.
    """

    patches: Patches
    particles: int
    diagnostics: ClassVar = (NOISE, ERROR)

    def begin(self, rng: Generator, frame: Frame, x0: Array) -> Flow:
        """The flow after the first frame, with the target at x0 (1, 6)."""
        x = x0[None]
        if self.settings.velocity is not None:
            x = self.propagate(rng, np.repeat(x, self.particles, axis=0))
        return self.learn(frame, x0, x)

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

        def look(shift: Array) -> tuple[Rows, float]:
            """The patch there, and its error."""
            patch = self.patches.read(frame, (flow.state + shift)[None], factor)
            return patch[0], float(error(patch)[0])

        shift = best = np.zeros_like(flow.state)
        patch, least = look(shift)
        if velocity := self.settings.velocity:
            model = expected() if velocity.towards == "appearance" or velocity.search > 0 else flow.patch
            wanted = model if velocity.towards == "appearance" else flow.patch
            if velocity.search > 0:
                place = self._search(flow.state, frame, factor, model, velocity.search)
                there, now = look(place)
                if now < least:
                    least, shift, best, patch = now, place, place, there
            for _ in range(velocity.iterations):
                shift = shift - mapped(flow.gain, flow.rows, patch - wanted)
                patch, now = look(shift)
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
    walk = settings, settings.sigma.pixels(context.placed.unit), context.placed.scale
    if settings.velocity is None and settings.noise is None:
        return AffineWalk(*walk)
    return PredictedWalk(*walk, Patches.of(context), context.settings.filter.particles)


def adaptive(settings: AdaptiveSettings, rng: Generator, particles: Particles, model: FrameModel) -> Stepped:
    """Around the one place that is predicted (figure 1): theta_t = theta_{t-1} + nu_t + u_t."""
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
