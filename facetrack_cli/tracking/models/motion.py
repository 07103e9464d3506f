"""Motion models: how a particle moves from one frame to the next, and the density of that move."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from facetrack_cli.core.types import BOX, Array
from facetrack_cli.recipe import affine, points, regions
from facetrack_cli.tracking.kernels.affine import diffuse
from facetrack_cli.tracking.models.spaces import Context


@dataclass(frozen=True)
class RandomWalk:
    """Zero-order Gaussian motion, p(a_i | a_i^-) = N(a_i^-, sigma_i^2 I) (Patras & Pantic 2004, section 3.3).

    `sigma` (K,): the standard deviation of each part along each coordinate, in pixels.
    """

    sigma: Array

    def propagate(self, rng: np.random.Generator, x: Array) -> Array:
        """x (N, K, D) moved by one frame."""
        return x + self.sigma[:, None] * rng.standard_normal(x.shape)

    def expect(self, x: Array) -> Array:
        """The mean of p(x_t | x_{t-1} = x), (N, K, D)."""
        return x

    def log_transition(self, x: Array, parents: Array) -> Array:
        """log p(x_n | parents_m) of each part: x (N, K, D), parents (M, K, D) -> (N, M, K)."""
        d = x.shape[2]
        squared = np.sum((x[:, None] - parents[None]) ** 2, axis=3)
        constant = -0.5 * d * np.log(2 * np.pi) - d * np.log(self.sigma)
        return np.asarray(-0.5 * squared / self.sigma**2 + constant)


@dataclass(frozen=True)
class FirstOrder:
    """Linear dynamics of values and speeds, c_k = A c_{k-1} + B w_k, w_k ~ N(0, I) (Odobez et al. 2003, section 3.2).

    The state (x, y, s, their speeds) falls into pairs c = (value, speed), which move independently: x and y by
    `position` (A, B), s by `scale`; A is (2, 2), B (2, M). At its bounds `least` and `most`, s stops, of speed 0.
    """

    position: tuple[Array, Array]
    scale: tuple[Array, Array]
    least: float
    most: float

    def propagate(self, rng: np.random.Generator, x: Array) -> Array:
        """x (N, K, 6) moved by one frame."""
        moved = np.empty_like(x)
        for i, (a, b) in enumerate((self.position, self.position, self.scale)):
            noise = rng.standard_normal((*x.shape[:2], b.shape[1]))
            # by columns: products of thousands of tiny matrices take three times as long
            for row in (0, 1):
                moved[..., i + 3 * row] = a[row, 0] * x[..., i] + a[row, 1] * x[..., i + 3]
                for source in range(b.shape[1]):
                    moved[..., i + 3 * row] += b[row, source] * noise[..., source]
        s = moved[..., 2]
        moved[..., 5] = np.where((s < self.least) | (s > self.most), 0.0, moved[..., 5])
        moved[..., 2] = np.clip(s, self.least, self.most)
        return moved

    def expect(self, x: Array) -> Array:
        """The mean of p(x_t | x_{t-1} = x), (N, K, 6); the bounds of s are left out."""
        moved = np.empty_like(x)
        for i, (a, _) in enumerate((self.position, self.position, self.scale)):
            moved[..., i::3] = x[..., i::3] @ a.T
        return moved

    def log_transition(self, x: Array, parents: Array) -> Array:
        """log p(x_n | parents_m) of each part: x (N, K, 6), parents (M, K, 6) -> (N, M, K).

        The bounds of s are left out. Where B has one source of noise, the density is that on its line, -inf beside it.
        """
        total = np.zeros((len(x), len(parents), x.shape[1]))
        for i, (a, b) in enumerate((self.position, self.position, self.scale)):
            off = x[:, None, :, i::3] - parents[None, :, :, i::3] @ a.T
            total += _log_normal(off, b @ b.T)
        return total


@dataclass(frozen=True)
class AffineWalk:
    """Gaussian noise on the parameters of an affine map, theta_t = theta_{t-1} + u_t (Zhou et al. 2003, eq. 1).

    The state is (x, y, a1, a2, a3, a4), `sigma` the standard deviation of x and y in pixels. The paper leaves u_0 open;
    here scale, turn, and stretch and shear have noise of their own: if they have the same, it is that of each of a1 to
    a4. `scale` bounds the scale, [least, most].
    """

    settings: affine.AffineWalk
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
        return _log_normal((x[:, None] - parents[None]) @ _AFFINE, np.diag(self._sigma**2))


# from noise of (x, y, scale, turn, stretch, shear) to that of (x, y, a1, a2, a3, a4); orthogonal
_AFFINE = np.eye(6)
_AFFINE[2:, 2:] = np.sqrt(0.5) * np.array([[1, 0, 1, 0], [0, -1, 0, 1], [0, 1, 0, 1], [1, 0, -1, 0]])


def _log_normal(off: Array, cov: Array) -> Array:
    """log N(off; 0, cov) over the last axis; of a singular cov, the density on its support."""
    values, vectors = np.linalg.eigh(cov)
    along = off @ vectors
    spread = values > 1e-12 * max(float(values[-1]), 1e-300)
    z = along[..., spread] / np.sqrt(values[spread])
    inside = (np.abs(along[..., ~spread]) <= 1e-9 * (1.0 + np.abs(off).max(axis=-1, keepdims=True))).all(axis=-1)
    log_p = -0.5 * (z**2).sum(axis=-1) - 0.5 * float(np.sum(np.log(2 * np.pi * values[spread])))
    return np.where(inside, log_p, -np.inf)


def random_walk(settings: points.RandomWalk, context: Context) -> RandomWalk | FirstOrder:
    """Of points, or of the place and the scale of a box, whose speeds stay 0."""
    placed, target = context.placed, context.settings.target
    sigma = [settings.sigma.of(part).pixels(placed.unit) for part in target.points or (BOX,)]
    if target.points:
        return RandomWalk(np.array(sigma))
    stay = np.array([[1.0, 0.0], [0.0, 0.0]])
    position, scale = ((stay, np.array([[step], [0.0]])) for step in (*sigma, settings.scale))
    return FirstOrder(position, scale, *placed.scale)


def first_order(settings: regions.FirstOrder, context: Context) -> FirstOrder:
    noise = [[length.pixels(context.placed.unit) for length in row] for row in settings.position.B]
    scale = np.array(settings.scale.A), np.array(settings.scale.B)
    return FirstOrder((np.array(settings.position.A), np.array(noise)), scale, *context.placed.scale)
