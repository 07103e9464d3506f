"""The one-dimensional filter of scale (Danelljan et al. 2014, DSST; 2017, fDSST).

The target is read at S scales a^n, n from -(S - 1) / 2 to (S - 1) / 2, each window resampled to one size; its
gradients are a signal over the scales with many channels. A correlation filter of that signal, in closed form, has its
peak at the scale at which the target is as large as it was learned (DSST, eq. 3 to 6):

    A = conj(Y) X,  B = sum_d |X^d|^2,  R = F^-1 [ sum_d conj(A^d) Z^d / (B + lambda) ]

A and B are moved by the learning rate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array, Frame, factor_for
from facetrack_cli.trackers.box.cell_kernels import CHANNELS, gradients_of_scales
from facetrack_cli.trackers.box.features import CELL, Single

_LAMBDA = 0.01


class TrainedScale(NamedTuple):
    """A (S / 2 + 1, D) and B (S / 2 + 1,) of the D numbers that a window has at each scale."""

    numerator: NDArray[np.complex64]
    denominator: Single


@dataclass(frozen=True, eq=False)
class ScaleTrainer:
    """`size`: width and height of the target at scale 1, in pixels; `area`: pixels of a resampled window."""

    size: tuple[float, float]
    scales: int
    step: float
    area: float = 512.0

    @cached_property
    def log_scales(self) -> Array:
        return np.asarray((np.arange(self.scales) - (self.scales - 1) / 2) * math.log(self.step), np.float64)

    @cached_property
    def _y(self) -> Single:
        sigma = self.scales / 16
        y = np.exp(-0.5 * (np.fft.fftfreq(self.scales, 1 / self.scales) / sigma) ** 2)
        return np.fft.rfft(y).real.astype(np.float32)[:, None]

    @cached_property
    def _taper(self) -> Single:
        return np.hanning(self.scales + 2)[1:-1].astype(np.float32)[:, None]

    @cached_property
    def _shape(self) -> tuple[int, int]:
        k = math.sqrt(self.area / (self.size[0] * self.size[1]))
        w, h = (min(max(round(side * k / CELL), 2), 64) * CELL for side in self.size)
        return w, h

    def read(self, frame: Frame, centre: Array, scale: float) -> NDArray[np.complex64]:
        """The spectrum (S / 2 + 1, D) of the target around `centre` at `scale` times each of the scales."""
        w, h = self._shape
        sides = scale * np.exp(self.log_scales)[:, None] * np.array(self.size)
        factor = factor_for(max(scale * self.size[0] / w, 1e-6), 2.0) if scale * self.size[0] >= 2 * w else 1
        (x, y), (right, lower) = centre.tolist(), (sides[-1] / 2 + 2 * factor).tolist()
        grey, left, top = frame.grey(factor, (x - right, y - lower, x + right, y + lower))
        at = (np.array([x - left, y - top]) - 0.5 * (factor - 1)) / factor
        signal = np.empty((self.scales, CHANNELS, h // CELL, w // CELL), np.float32)
        gradients_of_scales(grey, at[0], at[1], sides / factor, CELL, signal)
        flat = signal.reshape(self.scales, -1) * self._taper
        return np.fft.rfft(np.fft.ifftshift(flat, axes=0), axis=0).astype(np.complex64, copy=False)

    def learn(self, known: TrainedScale | None, x: NDArray[np.complex64], rate: float) -> TrainedScale:
        a, b = self._y * x, np.sum(np.abs(x) ** 2, axis=1)
        if known is None:
            return TrainedScale(a, b)
        keep, new = np.float32(1 - rate), np.float32(rate)
        return TrainedScale(keep * known.numerator + new * a, keep * known.denominator + new * b)

    def respond(self, known: TrainedScale, z: NDArray[np.complex64]) -> Array:
        """The response (S,), from the least scale to the largest."""
        found = np.sum(known.numerator.conj() * z, axis=1) / (known.denominator + np.float32(_LAMBDA))
        return np.fft.fftshift(np.fft.irfft(found, n=self.scales)).astype(np.float64)
