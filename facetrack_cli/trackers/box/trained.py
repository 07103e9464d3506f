"""Spatially regularised correlation filters, kept from forgetting by a memory.

The response of filters f^d to a window with channels x^d is R = sum_d f^d * x^d (circular correlation). It should be
y(c) = exp(-|c|^2 / (2 sigma_y^2)), a peak where the target is. Sought are the filters of

    sum_k pi_k |sum_d f^d * x_k^d - y|^2 + sum_d |w f^d|^2       (Danelljan et al. 2015, SRDCF, eq. 4; 2017, ECO, eq. 7)

with w small inside of the target's box and large outside, and pi_k the weights of the windows seen so far. ECO keeps
some 30 to 50 of them and merges the most alike. Here all are kept, by their sufficient statistics: after PCA there are
so few channels C that for each frequency sum_k pi_k x_k x_k^H, a matrix (C, C), is small, and a new window moves it by
the learning rate. So nothing is merged, and memory is the same after any number of frames. The normal equations

    (sum_k pi_k x_k x_k^H) f + F[w^2 F^-1 f] = sum_k pi_k x_k conj(y)

are solved by conjugate gradients from the filters of the last frame on, a few steps each time. What is left of them is
carried on: a window x of weight a makes the residual r = (1 - a) r - a g + a x (conj(y) - x^H f), g = F[w^2 F^-1 f].
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import numpy as np

from facetrack_cli.core.types import Array
from facetrack_cli.trackers.box.box_kernels import multiply, remember, respond
from facetrack_cli.trackers.box.features import Single, inverse, joined, spectrum

UPSAMPLED = 2  # samples of a response for a cell
_FIRST_STEPS = 50
_INSIDE, _OUTSIDE = 0.1, 100.0  # w^2 inside of the target's box, and a whole box around it


class Trained(NamedTuple):
    """`filters` f (2, C, F), the memory, matrices (P, 2, F), the `residual` (2, C, F), and g, the `walled` filters."""

    filters: Single
    matrices: Single
    residual: Single
    walled: Single


@dataclass(frozen=True, eq=False)
class Trainer:
    """`box`: the target's width and height in cells; `sigma`: sigma_y in cells; `steps` of conjugate gradients."""

    cells: int
    box: tuple[float, float]
    sigma: float
    steps: int = 2
    y: Single = field(init=False)
    wall: Single = field(init=False)  # w^2 of each cell
    _middle: Single = field(init=False)

    def __post_init__(self) -> None:
        g = self.cells
        d = np.fft.fftfreq(g, 1 / g)
        y = np.exp(-0.5 * (d[:, None] ** 2 + d[None] ** 2) / self.sigma**2)
        half = np.abs(np.arange(g) - (g - 1) / 2)
        # 1 on the border of the box
        out = np.maximum((half / (self.box[1] / 2))[:, None], (half / (self.box[0] / 2))[None])
        rise = np.clip(out - 1, 0, 1) ** 2
        # what moves place 0 into the middle
        signs = (-1.0) ** (np.arange(g)[:, None] + np.arange(g // 2 + 1))
        object.__setattr__(self, "_middle", (UPSAMPLED**2 * signs).astype(np.float32))
        object.__setattr__(self, "y", np.fft.rfft2(y).real.ravel().astype(np.float32))  # y is even
        object.__setattr__(self, "wall", (_INSIDE + (_OUTSIDE - _INSIDE) * rise).astype(np.float32))

    def begin(self, x: Single) -> Trained:
        """From the first window's spectrum x (2, C, F)."""
        channels, frequencies = x.shape[1:]
        matrices = np.zeros((channels * (channels + 1) // 2, 2, frequencies), np.float32)
        remember(matrices, x, np.float32(1.0))
        nothing = np.zeros_like(x)
        return self._solve(Trained(nothing, matrices, self.y * x, nothing), _FIRST_STEPS)

    def learn(self, known: Trained, x: Single, rate: float) -> Trained:
        """With a window more, of weight `rate` in the memory."""
        matrices, share = known.matrices.copy(), np.float32(rate)
        remember(matrices, x, share)
        off = np.empty((2, x.shape[2]), np.float32)
        respond(x, known.filters, off)
        off *= -share
        off[0] += share * self.y
        residual = (1 - share) * known.residual - share * known.walled
        residual[0] += off[0] * x[0] - off[1] * x[1]
        residual[1] += off[0] * x[1] + off[1] * x[0]
        return self._solve(Trained(known.filters, matrices, residual, known.walled), self.steps)

    def respond(self, x: Single, *filters: Single) -> Single:
        """The responses (n, 2 G, 2 G) of n filters, with place 0 in the middle, [G, G]: between the cells by its
        Fourier series.
        """
        g, half = self.cells, self.cells // 2
        found = np.empty((len(filters), 2, x.shape[2]), np.float32)
        for one, out in zip(filters, found, strict=True):
            respond(one, x, out)
        few = joined(found.swapaxes(0, 1)).reshape(-1, g, half + 1) * self._middle
        many = np.zeros((len(few), UPSAMPLED * g, half), few.dtype)
        many[:, :half], many[:, 1 - half :] = few[:, :half, :half], few[:, half + 1 :, :half]
        return np.fft.irfft(np.fft.ifft(many, axis=1, out=many), UPSAMPLED * g).astype(np.float32, copy=False)

    def _solve(self, known: Trained, steps: int) -> Trained:
        """Conjugate gradients, preconditioned by the diagonal."""
        v, matrices, r, walled = known
        channels = v.shape[1]
        diagonal = matrices[np.cumsum([0, *range(channels, 1, -1)]), 0]
        scale = np.float32(1.0) / (diagonal + np.float32(0.5 * float(diagonal.mean()) + _INSIDE))
        p, last, ap = np.zeros_like(v), 1.0, np.empty_like(v)
        for _ in range(steps):
            z = scale * r
            rz = self._dot(r, z)
            p = z + np.float32(rz / max(last, 1e-20)) * p
            cells = inverse(p, self.cells)
            cells *= self.wall
            beyond = spectrum(cells)
            multiply(matrices, p, ap)
            ap += beyond
            alpha, last = np.float32(rz / max(self._dot(p, ap), 1e-20)), rz
            v, r, walled = v + alpha * p, r - alpha * ap, walled + alpha * beyond
        return Trained(v, matrices, r, walled)

    def _dot(self, a: Single, b: Single) -> float:
        """The inner product of two real functions by half of their frequencies."""
        product = np.add.reduce(a * b, axis=(0, 1)).astype(np.float64).reshape(self.cells, -1)
        return float(2 * product.sum() - product[:, 0].sum() - product[:, -1].sum())


def peaks(response: Single, least: float, most: int) -> Array:
    """At most `most` local maxima of at least `least` times the highest: rows of (column, row, height), highest first.

    A parabola through the neighbours gives the place between samples (LMCF looks at several too; Wang et al. 2017).
    """
    top = float(response.max())
    inner, near = response[1:-1, 1:-1], cv2.dilate(response, np.ones((3, 3)))[1:-1, 1:-1]
    rows, columns = np.nonzero((inner >= max(least * top, 1e-6)) & (inner == near))
    if not len(rows):  # the highest is on the border
        row, column = np.unravel_index(int(response.argmax()), response.shape)
        return np.array([[float(column), float(row), top]])
    order = np.argsort(-inner[rows, columns], kind="stable")[:most]
    return np.array([_vertex(response, int(rows[k]) + 1, int(columns[k]) + 1) for k in order])


def _vertex(response: Single, row: int, column: int) -> tuple[float, float, float]:
    middle, height = float(response[row, column]), float(response[row, column])
    found = []
    for a, b in (
        (response[row, column - 1], response[row, column + 1]),
        (response[row - 1, column], response[row + 1, column]),
    ):
        bend = float(a) + float(b) - 2 * middle
        off = 0.5 * (float(a) - float(b)) / bend if bend < -1e-12 else 0.0
        height -= 0.25 * (float(a) - float(b)) * off
        found.append(off)
    return column + found[0], row + found[1], height
