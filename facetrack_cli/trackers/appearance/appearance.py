"""A face under affine maps that adapts: Zhou, Chellappa & Moghaddam, ICME 2003, eq. 1, 3, 5 to 13 and 17.

First its state, its patches, its motion around a predicted place (section 4).

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

Then the appearance model (section 3.1.1). Each pixel of a patch y has a mixture of its own: W, the frame before; S,
what is stable; F, the patch at the start.

    p_a = prod over pixels of sum_i m_i N(y; mu_i, sigma_i^2), i = w, s, f        eq. 6
    o_i = m_i N(y; mu_i, sigma_i^2) / p_a                                         eq. 7
    m_i <- alpha o_i + (1 - alpha) m_i                                            eq. 8
    M_p <- alpha y^p o_s + (1 - alpha) M_p, p = 1, 2                              eq. 9
    S = M_1 / m_s,  sigma_s^2 = M_2 / m_s - S^2                                   eq. 10
    W = y,  F, sigma_w and sigma_f stay                                           eq. 11

Corrected in print: eq. 6 lacks the product over the pixels; eq. 7 has sigma_w where the component's own is meant, and
eq. 10 has M_1 twice. The moments begin as M_1 = m_s F, M_2 = m_s (sigma_s^2 + F^2), which give F and sigma_s back; the
printed m_s sigma_s^2 + F^2 does not. Beyond the paper:

- sigma_s has the floor `least_sigma`; the weights have the floor `least_mixing` before they are made to sum to 1, or a
  component could vanish for ever. M_1 and M_2 follow m_s there, so that S stays. Weight 0 at the start stays 0.
- A point beyond the frame teaches nothing.
- `laplace` has exp(-|y - mu| / b) / (2 b), b = sigma / sqrt(2). With weights (0, 0, 1) it is the fixed template of the
  authors' earlier tracker.
- `outlier` is the weight of a fourth component, the L of Jepson et al. (the paper's [3]), uniform over `OUTLIER_RANGE`;
  the other three share the rest.
- `pixels`: neighbours in a patch are not independent. log p_a is multiplied by `pixels` / d.

Who the face is (`Recognition`): joint weights over motion and identity (eq. 5 and figure 1).

    alpha_l(j) = beta_l p_a(j) {p_f(j) p_n(j, l) + (1 - p_f(j)) / N}      weight of particle j and identity l
    w(j) = sum_l alpha_l(j),  beta_l = sum_j alpha_l(j)                   both normalised; beta is the posterior

for any likelihood p_a of affine patches, and the scores p_f and p_n of a gallery (`gallery.py`), in logs. `score` gives
log w(j), and `learn` finds beta from the weights of the filter: sum_j w(j) alpha_l(j) / w(j).

Before each frame the share `switch` of every beta_l goes to the others in equal parts; 0 as published. `none` is one
more identity, nobody of the gallery.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, cast

import cv2
import numpy as np
from numpy.random import Generator

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import centre
from facetrack_cli.core.types import Array, Box, Frame, Particles, factor_for
from facetrack_cli.engine.kernels.compiled import boxes_extent
from facetrack_cli.engine.protocols import Likelihood, Linear, Motion, Prediction
from facetrack_cli.engine.resampling import logsumexp, normalise
from facetrack_cli.engine.spaces import Context, Estimate, SizedSpace, estimate
from facetrack_cli.recipe.load import resolve_file
from facetrack_cli.recipe.model import Recipe, RecognitionSettings
from facetrack_cli.trackers.appearance import appearance_kernels as kernel
from facetrack_cli.trackers.appearance.appearance_kernels import Rows
from facetrack_cli.trackers.appearance.gallery import NONE, Gallery, load_gallery
from facetrack_cli.trackers.appearance.settings import AffineWalkSettings, AppearanceSettings, NoiseSettings
from facetrack_cli.trajectory.diagnostics import AFFINE, ENTROPY, ERROR, NOISE, POSTERIOR, SCALE

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
        """As the likelihood of a target reads them."""
        columns, rows = cast(AppearanceSettings, context.settings.likelihood).template
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
            patches = kernel.read_patches(grey, left, top, factor, width, height, extent, states, w, h, *self.shape)
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
        rows, products = kernel.differences(self.patches.read(frame, x, factor), chosen, patch)
        return Flow(state, patch, kernel.gain(x[chosen, 0] - state[0], products, velocity.components, RANK), rows)

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
                shift = shift - kernel.mapped(flow.gain, flow.rows, patch - wanted)
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


OUTLIER_RANGE = 6.0  # a normalised patch lies within 3 standard deviations of its mean, but for a few points
_NOTHING_LEFT = -1e30  # in place of log 0: of a component, or when a posterior has nothing left for an identity


@dataclass(frozen=True, eq=False)
class Mixture:
    """a_t: weights `m`, centres `mu`, standard deviations `sigma`, (3, d) float32 each, in the order w, s, f.

    `moments` (2, d) are M_1 and M_2 of S; `state` (1, 6) the estimate at which the model last learned. Of one that also
    says who it is, log beta (N,) of the identities, with logsumexp 0, and notes on the start.
    """

    m: Rows
    mu: Rows
    sigma: Rows
    moments: Array
    state: Array
    laplace: bool = False
    outlier: float = 0.0
    log_beta: Array | None = None
    notes: tuple[str, ...] = ()

    @cached_property
    def terms(self) -> tuple[Rows, Rows]:
        """(rate, log), (3, d) each: a component's density is 2^(log - rate |y - mu|^2), or |y - mu| of `laplace`."""
        if self.laplace:
            rate, area = np.float32(math.sqrt(2.0) / math.log(2.0)) / self.sigma, math.sqrt(2.0)
        else:
            rate, area = np.float32(0.5 / math.log(2.0)) / np.square(self.sigma), math.sqrt(2.0 * math.pi)
        with np.errstate(divide="ignore"):
            log = np.log2(np.float32((1.0 - self.outlier) / area) * self.m / self.sigma)
        return rate, np.maximum(log, np.float32(_NOTHING_LEFT))


@dataclass(frozen=True)
class Appearance(Likelihood):
    """`patches`: how faces are read."""

    settings: AppearanceSettings
    patches: Patches

    @classmethod
    def build(cls, settings: AppearanceSettings, context: Context) -> Appearance:
        return cls(settings, Patches.of(context))

    def init(self, frame: Frame, x0: Array) -> Mixture:
        """The model of the patch at x0 (1, 6). Raises InputError if there is nothing to see."""
        x0 = np.array(x0, np.float64)
        face = self.patches.read(frame, x0[None], self.patches.factor(x0))[0]
        if not face.any():
            what = "the face's box is of one grey level, or more than half of the box lies outside the image"
            remedy = "choose another box, or begin elsewhere with --init-frame"
            raise InputError(f"frame {frame.index}: {what}: {remedy}")
        settings = self.settings
        mixing = np.array(settings.mixing.each) / sum(settings.mixing.each)
        # a component that is left out may come without a sigma
        sigmas = np.where(mixing > 0.0, settings.sigma.each, 1.0)
        m, sigma = (np.repeat(np.array(v, np.float32)[:, None], face.size, axis=1) for v in (mixing, sigmas))
        first = face.astype(np.float64)
        moments = m[1].astype(np.float64) * np.stack([first, sigmas[1] ** 2 + np.square(first)])
        centres = np.repeat(face[None], 3, axis=0)
        return Mixture(m, centres, sigma, moments, x0, settings.density == "laplace", settings.outlier or 0.0)

    def score(self, learned: Mixture, frame: Frame, x: Array, parents: Array | None = None) -> Array:
        """log p_a of x (N, 1, 6) -> (N, 1), eq. 6; parents do not matter."""
        y = self.patches.read(frame, x, self.patches.factor(learned.state))
        uniform = learned.outlier / OUTLIER_RANGE
        rate, log = learned.terms
        log_p = np.asarray(kernel.log_densities(y, learned.mu, rate, log, uniform, learned.laplace))[:, None]
        pixels = self.settings.pixels
        return log_p if pixels is None else log_p * (pixels / y.shape[1])

    def learn(self, learned: Mixture, frame: Frame, state: Array, particles: Particles | None = None) -> Mixture:
        """The model after the patch at the estimate `state` (1, 6), eq. 7-11; particles do not matter."""
        y = self.patches.read(frame, state, self.patches.factor(learned.state))[0]
        if not y.any():
            return learned
        (rate, log), settings = learned.terms, self.settings
        old, outside = (learned.m, learned.mu, learned.sigma, learned.moments), learned.outlier / OUTLIER_RANGE
        rates = settings.alpha, settings.least_sigma, settings.least_mixing
        m, mu, sigma, moments = kernel.update(y, *old, rate, log, outside, learned.laplace, *rates)
        return replace(learned, m=m, mu=mu, sigma=sigma, moments=moments, state=np.array(state))

    def error(self, learned: Mixture, patches: Rows) -> Array:
        """eps_t of section 3.1.2 for patches (N, d) -> (N,): phi = 1/d sum_pixels sum_i m_i ((y - mu_i) / sigma_i)^2.

        The paper leaves phi open; this is that of the authors' later paper (IEEE Trans. Image Processing 13(11), 2004).
        """
        return np.asarray(kernel.errors(patches, learned.m, learned.mu, learned.sigma))

    def distances(self, learned: Mixture, frame: Frame, x: Array) -> Array:
        """1 less the NCC of x (N, 1, 6) with S or with F, whichever is larger -> (N, 1), 0..1; 0 is a perfect match."""
        y = self.patches.read(frame, x, self.patches.factor(learned.state))
        return np.clip(1.0 - np.asarray(kernel.best_matches(y, learned.mu[1:])), 0.0, 1.0)[:, None]

    def expected(self, learned: Mixture) -> Rows:
        """(d,): the mean of the mixture in each pixel."""
        return np.asarray((learned.m * learned.mu).sum(axis=0))


# of a box's proportions against the gallery's: up to 1.2 all of 24 runs named the right one, at 1.25 22, at 1.5 16
MAX_STRETCH = 1.2
_MIN_WEIGHT = 1e-9  # of the largest weight: particles below it say nothing of the identity


@dataclass(frozen=True)
class Recognition(Appearance):
    """An appearance that also says who it is, of the persons in a gallery."""

    recognition: RecognitionSettings
    gallery: Gallery
    diagnostics: ClassVar = (POSTERIOR, ENTROPY)

    @classmethod
    def of(cls, settings: RecognitionSettings, context: Context) -> Recognition:
        patches, likelihood = Patches.of(context), cast(AppearanceSettings, context.settings.likelihood)
        gallery = find_gallery(settings, patches.shape, context.recipe, context.above)
        return cls(likelihood, patches, settings, gallery)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The identities: the persons, and "none" if the settings ask for it."""
        return (*self.gallery.names, NONE) if self.recognition.none else self.gallery.names

    def init(self, frame: Frame, x0: Array) -> Mixture:
        """Every identity is as likely. Raises InputError as the appearance does."""
        n, (w, h), wanted = len(self.names), self.patches.size, self.gallery.proportion
        notes: tuple[str, ...] = ()
        if wanted is not None and not 1 / MAX_STRETCH <= w / h / wanted <= MAX_STRETCH:
            box = f"the box of {w:.0f}x{h:.0f} pixels is {w / h:.2f} times as wide as high"
            remedy = "the name may be wrong; begin with a box of their proportions"
            notes = (f"{box}, and those of the gallery are {wanted:.2f} times: {remedy}",)
        return replace(super().init(frame, x0), log_beta=np.full(n, -math.log(n)), notes=notes)

    def score(self, learned: Any, frame: Frame, x: Array, parents: Array | None = None) -> Array:
        """log p_a + log sum_l beta_l {p_f p_n + (1 - p_f) / N} of x (N, 1, 6) -> (N, 1)."""
        joint = self._log_joint(learned, frame, x)
        return super().score(learned, frame, x, parents) + logsumexp(joint, axis=1)[:, None]

    def learn(self, learned: Any, frame: Frame, state: Array, particles: Particles | None = None) -> Any:
        """The appearance at the estimate `state` (1, 6), and the posterior by the weights of the particles."""
        assert particles is not None
        joint = self._log_joint(learned, frame, particles.x)
        heavy = particles.log_w > particles.log_w.max() + math.log(_MIN_WEIGHT)
        joint, log_w = joint[heavy], particles.log_w[heavy]
        each = joint - logsumexp(joint, axis=1)[:, None]
        log_beta = normalise(np.maximum(logsumexp(log_w[:, None] + each, axis=0), _NOTHING_LEFT))
        return replace(super().learn(learned, frame, state, particles), log_beta=log_beta)

    def diagnose(self, learned: Any) -> Mapping[str, Any]:
        """p(n_t | z_0:t) of each identity, and its entropy in nats: log N at the start, 0 when there is no doubt."""
        beta = np.exp(learned.log_beta)
        entropy = max(-float(beta @ learned.log_beta), 0.0)
        return {"posterior": dict(zip(self.names, beta.tolist(), strict=True)), "entropy": entropy}

    def _log_joint(self, learned: Any, frame: Frame, x: Array) -> Array:
        """(N, L): log beta_l {p_f p_n + (1 - p_f) / N} of x (N, 1, 6)."""
        settings, patches = self.recognition, self.patches
        factor = patches.factor(learned.state)
        # of the array x itself, since `score` and `learn` ask for the same one
        key = id(x), self.gallery, settings.none, settings.sharpness, factor, patches
        joint = frame.remembered(key)
        if joint is None:
            y = patches.read(frame, x, factor)
            frontal, log_n = self.gallery.log_scores(y, sharpness=settings.sharpness, none=settings.none)
            with np.errstate(divide="ignore"):
                named, nobody = np.log(frontal)[:, None] + log_n, np.log1p(-frontal)[:, None]
                joint = np.logaddexp(named, nobody - math.log(len(self.names))).astype(np.float32)
            frame.remember(key, x, joint)
        log_beta = learned.log_beta
        if switch := settings.switch:
            beta = np.exp(log_beta)
            with np.errstate(divide="ignore"):
                log_beta = np.log((1.0 - switch) * beta + switch * (1.0 - beta) / (len(beta) - 1))
        return np.asarray(np.maximum(joint.astype(np.float64) + log_beta, _NOTHING_LEFT))


def find_gallery(settings: RecognitionSettings, shape: tuple[int, int], recipe: Recipe, above: str) -> Gallery:
    """The gallery of a recipe for a template of that shape; RecipeError if there is none. `above`: as in `Context`."""
    key = f"{above}recognition.gallery"
    if settings.gallery is None:
        remedy = "give --gallery FILE, as facetrack gallery fit writes it, or name it here"
        raise recipe.error(key, f"nobody is known to recognise; {remedy}")
    path = resolve_file(recipe, settings.gallery, key)
    gallery = load_gallery(path)
    if gallery.shape != shape:
        its, mine = ("{} points high and {} wide".format(*size) for size in (gallery.shape, shape))
        remedy = "fit a gallery of that size, or change the template"
        raise recipe.error(key, f"{path}: the gallery's faces are {its}, and the recipe's template is {mine}; {remedy}")
    return gallery
