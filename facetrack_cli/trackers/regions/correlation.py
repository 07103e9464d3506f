"""Correlation of a region with itself in the frame before, and the product of likelihoods.

Odobez, Ba & Gatica-Perez, IDIAP-RR 03-15, 2003, sections 3.1 and 3.3:

    z(r)  = z_k(T_c r), r in R                       the patch of a hypothesis on a fixed reference grid      (eq. 6)
    z now = z before + noise                         along the path of one object                             (eq. 7)
    p     = p_c(z_k | z_k-1, c_k, c_k-1) p_o(z_k|c_k)   this likelihood times one of the object               (eq. 10)
    p_c   = exp(-lambda_c d_c)                       c_k-1 is the particle's own parent                       (eq. 12)
    d_c   = sum over r of rho(z now(r) - z before(r))                                                         (eq. 13)

p_o may itself be the product of a contour and a histogram (section 4). The factors are taken to be independent; the
paper notes that this is not strictly so for colours and correlation, which look at the same pixels.

p_c scores how a particle moved, not where it lies: one that rests on a resting background has distance 0. R are the
centres of equal cells of the box, read bilinearly from the grey frame. The distances of figure 5:

    l2            rho(x) = x^2, lambda_c = 1 / (2 sigma^2)            as published
    saturated_l1  rho(x) = min(|x|, saturation), lambda_c = 1 / sigma
    hausdorff     lambda_c = 1 / sigma; no formula in the paper. The modified distance (Dubuisson & Jain 1994): for each
                  point the least |difference| from the 3x3 points of the other patch around it, summed over the grid,
                  and of both directions the larger sum.

d_c is a sum, so sigma belongs to one grid: with n points in place of 16x16, times sqrt(n / 256) for l2, and n / 256 for
the others. Of 200 particles that are scattered by 5 % of the region's size, sigma = 100 (l2), 400 (saturated_l1 at 20)
or 100 (hausdorff) leaves some tens. The recipes take 60 (l2) and 120 (saturated_l1), which leave two to five: a flatter
likelihood has a truer spread, but lets a region drift (`docs/decisions.md` has the figures).

Chosen here: the frame is reduced by the largest power of two that leaves a pixel for each step of the grid at the start
(area means). A point beyond the frame's border, now or before, differs by `OUTSIDE`, at most by `saturation`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from facetrack_cli.core.geometry import remap
from facetrack_cli.core.types import Array, Frame, Image, Particles
from facetrack_cli.engine.kernels.affine import boxes_extent
from facetrack_cli.engine.protocols import Likelihood
from facetrack_cli.engine.resampling import averaged, effective_share
from facetrack_cli.engine.spaces import Context
from facetrack_cli.trackers.regions import region_kernels as kernel
from facetrack_cli.trackers.regions.settings import CorrelationSettings, ProductSettings

# grey levels: a region that is followed well has 6 to 20 (RMS); much more would push regions back into the frame
OUTSIDE = 32.0


@dataclass(frozen=True)
class Previous:
    """The frame that parents lie in; `factor`: by what frames are reduced.

    `state` (1, 6) is the estimate there, `share` how much of the points counts as independent, averaged over `frames`.
    """

    frame: Frame
    factor: int
    state: Array
    share: float = 1.0
    frames: int = 0


@dataclass(frozen=True)
class Correlation:
    """`size`: width and height of the compared region at scale 1, in pixels: `region` times the box."""

    settings: CorrelationSettings
    size: tuple[float, float]

    @classmethod
    def build(cls, settings: CorrelationSettings, context: Context) -> Correlation:
        w, h = context.placed.size
        return cls(settings, (w * settings.region, h * settings.region))

    def init(self, frame: Frame, x0: Array) -> Previous:
        """What the first frame after this one is compared with."""
        columns, rows = self.settings.grid
        step = min(self.size[0] / columns, self.size[1] / rows)
        first = Previous(frame, 2 ** math.floor(math.log2(max(step, 1.0))), x0)
        # half a step off, as a region that is followed well may be
        return self.learn(first, frame, x0 + 0.5 * step * (np.eye(1, 6) + np.eye(1, 6, 1)))

    def score(self, learned: Previous, frame: Frame, x: Array, parents: Array) -> Array:
        """log p_c of x (N, 1, 6) in `frame` given its parents (N, 1, 6) in the frame before -> (N, 1), at most 0."""
        here, there = (np.ascontiguousarray(boxes[:, 0, :3]) for boxes in (x, parents))
        images = *self._image(frame, learned.factor, here), *self._image(learned.frame, learned.factor, there)
        distance, sigma, saturation = self.settings.distance, self.settings.sigma, self.settings.saturation or 0.0
        rate, outside = (0.5 / sigma**2, OUTSIDE**2) if distance == "l2" else (1.0 / sigma, OUTSIDE)
        if distance == "saturated_l1":
            outside = min(outside, saturation)
        sums = np.empty((len(x), 1))  # d_c of eq. 13
        boxes, kind = (here, there, self.size), (kernel.DISTANCES[distance], saturation, outside)
        kernel.patch_distances(*images, learned.factor, *boxes, *self.settings.grid, *kind, sums[:, 0])
        return -rate * learned.share * sums

    def learn(self, learned: Previous, frame: Frame, state: Array, particles: Particles | None = None) -> Previous:
        """`frame`, in which the parents of the next frame's particles lie, and how independent the points are."""
        if self.settings.independent == "all":
            return replace(learned, frame=frame)
        off = self._read(frame, learned.factor, state) - self._read(learned.frame, learned.factor, learned.state)
        terms = off**2 if self.settings.saturation is None else np.minimum(np.abs(off), self.settings.saturation)
        share = averaged(learned.share, learned.frames, effective_share(terms))
        return replace(learned, frame=frame, state=state, share=share, frames=learned.frames + 1)

    def _read(self, frame: Frame, factor: int, state: Array) -> Array:
        """(rows, columns): grey values of the grid at a state (1, 6); those beyond the frame are its border's."""
        image, (left, top, _, _) = self._image(frame, factor, np.ascontiguousarray(state[:, :3]))
        at = []
        for place, side, count, first in zip(state[0, :2], self.size, self.settings.grid, (left, top), strict=True):
            cells = place + state[0, 2] * side * ((np.arange(count) + 0.5) / count - 0.5)
            at.append(((cells - first - 0.5 * (factor - 1)) / factor).astype(np.float32))
        x, y = np.meshgrid(*at)
        return np.asarray(remap(image, x, y, cv2.BORDER_REPLICATE), np.float64)

    def _image(self, frame: Frame, factor: int, boxes: Array) -> tuple[Image, tuple[int, int, int, int]]:
        """The grey image around the boxes (N, 3), reduced, and its view: (left, top, whole width, whole height)."""
        width, height = frame.size
        left, top, right, bottom = boxes_extent(boxes, *self.size, width, height)
        # between its border and the centre of its first block, a box is read from the block before too
        grey, left, top = frame.grey(factor, (left - factor, top - factor, right + factor, bottom + factor))
        return grey, (left, top, width, height)


@dataclass(frozen=True)
class Product(Likelihood):
    """Eq. 10. `factors` that have `distances` say what the target looks like, p_o, the others how it moved, p_c."""

    factors: tuple[Any, ...]

    @classmethod
    def build(cls, settings: ProductSettings, context: Context) -> Product:
        return cls(tuple(factor.build(context) for factor in settings.factors))

    def init(self, frame: Frame, x0: Array) -> tuple[Any, ...]:
        """What each factor learns from the first frame with the parts at x0 (K, D)."""
        return tuple(factor.init(frame, x0) for factor in self.factors)

    def score(self, learned: tuple[Any, ...], frame: Frame, x: Array, parents: Array) -> Array:
        """(N, K): the sum of the factors' log-likelihoods."""
        total = np.zeros(x.shape[:2])
        for factor, part in zip(self.factors, learned, strict=True):
            total += factor.score(part, frame, x, parents)
        return total

    def learn(self, learned: tuple[Any, ...], frame: Frame, state: Array, particles: Particles) -> tuple[Any, ...]:
        """What each factor knows after a frame."""
        both = zip(self.factors, learned, strict=True)
        return tuple(factor.learn(part, frame, state, particles) for factor, part in both)

    def distances(self, learned: tuple[Any, ...], frame: Frame, x: Array) -> Array:
        """(N, K): the mean over the factors of p_o, from 0, a perfect match, to about 1."""
        looks = [pair for pair in zip(self.factors, learned, strict=True) if hasattr(pair[0], "distances")]
        return np.asarray(np.mean([factor.distances(part, frame, x) for factor, part in looks], axis=0))
