"""Colour template that ignores the strength of the light (Patras & Pantic 2004, section 3.2, eq. 8-10).

    c(o, q) = o / E{o} - q / E{q}          each window divided by its own mean, over pixels and channels    (eq. 8)
    d(o, q) = E_j{ rho(c_j) }              mean over the window of a robust function, L1 as published       (eq. 9)
    p(y|a)  = exp(-d / sigma_i)            sigma_i = sigma / E{o_i}, sigma = 1.5 for intensities in 0..255  (eq. 10)

Templates are learned in the first frame and then stay. Beyond the paper, as options: other robust functions; a floor,
p + exp(floor) in place of p, so that a part which matches nothing costs the same wherever it is; and `max_samples`,
which reads windows larger than that from a picture reduced by a whole factor (area means), so that a clip in 4K
costs no more than one in 240p.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli import kernels
from facetrack_cli.types import Array, Frame, Image

# a window darker than one grey level says nothing; dividing by less would only blow up its noise
LEAST_MEAN = 1.0


@dataclass(frozen=True)
class Template:
    """One part's window in the first frame, read at 1 / `factor` of the picture's size.

    `ratio` (h * w * 3,) float32 is o / E{o}; `w`, `h` are odd, in reduced pixels; `sigma` is sigma_i.
    """

    ratio: NDArray[np.float32]
    w: int
    h: int
    factor: int
    sigma: float


@dataclass(frozen=True)
class ColourRatio:
    """`windows` (K, 2): width and height of each part's window in pixels. See the module for the rest."""

    windows: Array
    sigma: float = 1.5
    robust: str = "l1"
    scale: float = 0.2
    floor: float | None = None
    max_samples: int | None = None

    def init(self, frame: Frame, x0: Array) -> tuple[Template, ...]:
        """The templates of K parts at x0 (K, 2)."""
        return tuple(self._template(frame, x0[i], self.windows[i]) for i in range(len(x0)))

    def score(self, learned: tuple[Template, ...], frame: Frame, x: Array, parents: Array | None = None) -> Array:
        """log p(y | x) of each part, x (N, K, 2) -> (N, K), with the floor if there is one; parents do not matter."""
        log_p = -self.distances(learned, frame, x) / np.array([t.sigma for t in learned])
        return log_p if self.floor is None else np.asarray(np.logaddexp(log_p, self.floor))

    def distances(self, learned: tuple[Template, ...], frame: Frame, x: Array) -> Array:
        """d(o_i, q_i) of eq. 9 for windows at x (N, K, 2) -> (N, K)."""
        out = np.empty((x.shape[1], x.shape[0]))
        # far outside the picture every window shows the same border; the bound keeps the kernel's integers small
        reach = 2.0 * max(frame.size)
        for factor in sorted({t.factor for t in learned}):
            parts = [i for i, t in enumerate(learned) if t.factor == factor]
            centres = np.clip(np.ascontiguousarray(x[:, parts].swapaxes(0, 1)), -reach, reach)
            picture, centres = _reduced(frame, centres, factor, max(max(learned[i].w, learned[i].h) for i in parts))
            for i, c in zip(parts, centres, strict=True):
                t = learned[i]
                robust = kernels.ROBUST[self.robust]
                kernels.colour_ratio_distances(picture, t.ratio, t.w, t.h, c, LEAST_MEAN, robust, self.scale, out[i])
        return out.T

    def _template(self, frame: Frame, x0: Array, window: Array) -> Template:
        largest = float(window.max())
        factor = 1 if self.max_samples is None else max(1, int(np.ceil(largest / self.max_samples)))
        w, h = (_odd(float(side) / factor) for side in window)
        picture, centre = _reduced(frame, x0[None, None], factor, max(w, h))
        o = kernels.read_window(picture, float(centre[0, 0, 0]), float(centre[0, 0, 1]), w, h)
        mean = max(float(o.mean()), LEAST_MEAN)
        return Template(o / np.float32(mean), w, h, factor, self.sigma / mean)


def _odd(side: float) -> int:
    """The odd number nearest to a length in pixels, at least 3, so that a window has a pixel at its centre."""
    return max(3, 2 * round((side - 1) / 2) + 1)


def _reduced(frame: Frame, centres: Array, factor: int, side: int) -> tuple[Image, Array]:
    """The picture as flat rows, reduced by `factor` where windows of `side` can reach; and `centres` in its pixels."""
    if factor == 1:
        return kernels.flat(frame.bgr), centres
    # whole blocks counted from the picture's corner, so that the grid of area means is the same in every frame
    blocks = np.maximum(np.array(frame.size) // factor, 1)
    margin = side // 2 + 2
    low = np.clip(np.floor(centres.min(axis=(0, 1)) / factor - margin), 0, blocks - 1).astype(int)
    high = np.clip(np.ceil(centres.max(axis=(0, 1)) / factor + margin), low + 1, blocks).astype(int)
    (left, top), (right, bottom) = low * factor, high * factor
    region = frame.bgr[top:bottom, left:right]
    small = cv2.resize(region, tuple((high - low).tolist()), interpolation=cv2.INTER_AREA)
    return kernels.flat(small), (centres - (left, top) - (factor - 1) / 2) / factor
