"""Edges along the normals of an ellipse (Odobez, Ba & Gatica-Perez 2003, section 3.3, eq. 11).

    p_o = product over l of max(K, exp(-|nu_m^l - nu_0^l|^2 / (2 sigma^2)))                                  (eq. 11)

nu_0^l is where normal l of L leaves the ellipse, and nu_m^l the nearest edge on it; without an edge the factor is K.
For the rest, the paper refers to Blake & Isard, *Active Contours*, 1998. Chosen here:

- The ellipse touches the borders of the box. Its normals stand at equal steps of arc.
- Edges are maxima of the contrast along a normal: the mean of two grey values less that of the two before them, so that
  a step of C grey levels has the contrast C. Their place between values is that of a parabola.
- `sigma` and `search` are the same at every scale, as printed: otherwise a larger ellipse would meet more edges.
- The frame is averaged over 3x3 pixels first. Beyond it there is no edge, and its border is none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from facetrack_cli.core.types import Array, Frame, Particles, factor_for
from facetrack_cli.engine.resampling import averaged, effective_share
from facetrack_cli.engine.spaces import Context
from facetrack_cli.trackers.regions import region_kernels as kernel
from facetrack_cli.trackers.regions.settings import ContourSettings

_MAX_PIXELS = 1e9  # pixels; no frame is as large


@dataclass(frozen=True)
class Ellipse:
    """The ellipse at scale 1: `points` (L, 2) from its centre, in pixels, and its outward unit `normals` (L, 2).

    `share`: how much of the normals counts as independent, averaged over `frames`.
    """

    factor: int
    points: Array
    normals: Array
    share: float = 1.0
    frames: int = 0


@dataclass(frozen=True)
class Contour:
    """`size`: (w, h) of the box at scale 1; `sigma` and `search` as in the settings, all in pixels."""

    settings: ContourSettings
    size: tuple[float, float]
    sigma: float
    search: float

    @classmethod
    def build(cls, settings: ContourSettings, context: Context) -> Contour:
        unit = context.placed.unit
        return cls(settings, context.placed.size, settings.sigma.pixels(unit), settings.search.pixels(unit))

    def init(self, frame: Frame, x0: Array) -> Ellipse:
        """The ellipse; of the first frame and x0 (1, 6) nothing is learned but how independent the normals are."""
        factor = factor_for(max(self.size), self.settings.max_size)
        return self.learn(Ellipse(factor, *ellipse(self.size, self.settings.normals)), frame, x0)

    def score(self, learned: Ellipse, frame: Frame, x: Array, parents: Array | None = None) -> Array:
        """log p_o of x (N, 1, 6) -> (N, 1), from L log K to 0; parents do not matter."""
        return np.asarray(self._terms(learned, frame, x).sum(axis=1, keepdims=True) * learned.share)

    def distances(self, learned: Ellipse, frame: Frame, x: Array) -> Array:
        """1 - mean over l of exp(-d_l^2 / (2 sigma^2)) of x (N, 1, 6) -> (N, 1), 0 to 1 (no edges)."""
        d = self._nearest(learned, frame, x, self.search)
        return np.asarray(1.0 - np.exp(-0.5 * (d / self.sigma) ** 2).mean(axis=1, keepdims=True))

    def learn(self, learned: Ellipse, frame: Frame, state: Array, particles: Particles | None = None) -> Ellipse:
        """How independent the normals are, if that is estimated."""
        if self.settings.independent == "all":
            return learned
        share = effective_share(self._terms(learned, frame, state[None])[0], ring=True)
        return replace(learned, share=averaged(learned.share, learned.frames, share), frames=learned.frames + 1)

    def _terms(self, learned: Ellipse, frame: Frame, x: Array) -> Array:
        """(N, L): log of the factor of each normal in eq. 11."""
        least = math.log(self.settings.outlier)
        # what lies farther off counts K, found or not
        reach = min(self.search, self.sigma * math.sqrt(-2.0 * least))
        return np.maximum(-0.5 * (self._nearest(learned, frame, x, reach) / self.sigma) ** 2, least)

    def _nearest(self, learned: Ellipse, frame: Frame, x: Array, reach: float) -> Array:
        """How far the nearest edge lies on each normal, (N, L), in pixels; inf without one within `reach`."""
        boxes = np.clip(np.nan_to_num(x[:, 0, :3]), -_MAX_PIXELS, _MAX_PIXELS)
        # an edge at the very end of a normal is seen by two values beyond it, and each value by a pixel around it
        around = np.maximum(boxes[:, 2:], 0.0) * np.array(self.size) / 2 + (reach + 5.0 * learned.factor)
        low, high = (boxes[:, :2] - around).min(axis=0).tolist(), (boxes[:, :2] + around).max(axis=0).tolist()
        grey, left, top = frame.grey(learned.factor, (*low, *high))
        # sums, which are whole numbers: their ninths are the means
        nine = cv2.boxFilter(grey, cv2.CV_16U, (3, 3), normalize=False)
        outline = learned.factor, learned.points, learned.normals
        return np.asarray(kernel.nearest_edges(nine, boxes, left, top, *outline, reach, 9.0 * self.settings.threshold))


def ellipse(size: tuple[float, float], count: int) -> tuple[Array, Array]:
    """Points of the ellipse with axes `size`, from its centre, and its unit normals there: (count, 2) each.

    They are in the middle of `count` equal parts of its arc, of which the first begins at the right.
    """
    a, b = size[0] / 2, size[1] / 2
    fine = np.linspace(0.0, 2.0 * np.pi, 64 * count + 1)
    arc = np.append(0.0, np.cumsum(np.hypot(np.diff(a * np.cos(fine)), np.diff(b * np.sin(fine)))))
    angle = np.interp((np.arange(count) + 0.5) / count * arc[-1], arc, fine)
    points = np.stack([a * np.cos(angle), b * np.sin(angle)], axis=1)
    normals = np.stack([b * np.cos(angle), a * np.sin(angle)], axis=1)
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)
