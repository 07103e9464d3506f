"""Edges along the normals of an ellipse (Odobez, Ba & Gatica-Perez 2003, section 3.3, eq. 11).

    p_o = product over l of max(K, exp(-|nu_m^l - nu_0^l|^2 / (2 sigma^2)))                                  (eq. 11)

nu_0^l is where normal l of L leaves the ellipse, and nu_m^l the nearest edge on it; without one, the factor is K. The
paper leaves the rest to Blake & Isard, *Active Contours*, 1998. Ours:

- The ellipse touches the borders of the box: semi-axes s w / 2 and s h / 2. Its normals stand at equal steps of arc.
- Only grey values count. Edges are maxima of the contrast along a normal: the mean of two values less that of the two
  before them, so that a step of C grey levels has the contrast C. They lie between values, by a parabola.
- `sigma` and `search` are the same at every scale, as printed. If they grew with s, a larger ellipse would meet more
  edges on its normals, and on any textured ground it would be the better one.
- The picture is first averaged over 3x3 pixels: an outline is smooth across its normals, and much clutter is not.
- Beyond the picture there is no edge, and its border is none.
- A box larger than `max_size` at the start is read from a picture reduced by a power of two (area means), in steps of
  its pixels; so cost and contrasts do not depend on the size of the clip.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from facetrack_cli.core.types import Array, Extent, Frame, Particles, factor_for
from facetrack_cli.tracking.kernels import contour

_FAR = 1e9  # pixels; no picture is as large


@dataclass(frozen=True)
class Outline:
    """The ellipse at scale 1: `points` (L, 2) from its centre, in pixels, and its outward unit `normals` (L, 2).

    `factor`: what pictures are reduced by.
    """

    factor: int
    points: Array
    normals: Array


@dataclass(frozen=True)
class Contour:
    """`size`: (w, h) of the box at scale 1. Lengths in pixels, `threshold` in grey levels.

    `normals`: L; `search`: half the length of a normal; `outlier`: K, in (0, 1]. See the module for the rest.
    """

    size: tuple[float, float]
    normals: int
    sigma: float
    search: float
    threshold: float
    outlier: float
    max_size: int | None = None

    def init(self, frame: Frame, x0: Array) -> Outline:
        """The ellipse; nothing is learned from the first frame or from x0 (1, 6)."""
        return Outline(factor_for(max(self.size), self.max_size), *ellipse(self.size, self.normals))

    def score(self, learned: Outline, frame: Frame, x: Array, parents: Array | None = None) -> Array:
        """log p_o of x (N, 1, 6) -> (N, 1), from L log K to 0; parents do not matter."""
        least = math.log(self.outlier)
        # what lies farther off counts K, found or not
        reach = min(self.search, self.sigma * math.sqrt(-2.0 * least))
        d = self._nearest(learned, frame, x, reach)
        return np.asarray(np.maximum(-0.5 * (d / self.sigma) ** 2, least).sum(axis=1, keepdims=True))

    def distances(self, learned: Outline, frame: Frame, x: Array) -> Array:
        """1 - mean over l of exp(-d_l^2 / (2 sigma^2)) of x (N, 1, 6) -> (N, 1), 0 to 1 (no edges)."""
        d = self._nearest(learned, frame, x, self.search)
        return np.asarray(1.0 - np.exp(-0.5 * (d / self.sigma) ** 2).mean(axis=1, keepdims=True))

    def learn(self, learned: Outline, frame: Frame, state: Array, particles: Particles) -> Outline:
        """The ellipse stays as it is."""
        return learned

    def _nearest(self, learned: Outline, frame: Frame, x: Array, reach: float) -> Array:
        """How far the nearest edge lies on each normal, (N, L), in pixels; inf without one within `reach`."""
        boxes = np.clip(np.nan_to_num(x[:, 0, :3]), -_FAR, _FAR)
        # an edge at the very end of a normal is seen by two values beyond it, and each value by a pixel around it
        grey, left, top = frame.grey(learned.factor, self._extent(boxes, reach + 5.0 * learned.factor))
        # sums, which are whole numbers: their ninths are the means
        nine = cv2.boxFilter(grey, cv2.CV_16U, (3, 3), normalize=False)
        return np.asarray(
            contour.nearest_edges(
                nine, boxes, left, top, learned.factor, learned.points, learned.normals, reach, 9.0 * self.threshold
            )
        )

    def _extent(self, boxes: Array, margin: float) -> Extent:
        """All within the margin of the boxes (N, 3)."""
        around = np.maximum(boxes[:, 2:], 0.0) * np.array(self.size) / 2 + margin
        (left, top), (right, bottom) = (boxes[:, :2] - around).min(axis=0), (boxes[:, :2] + around).max(axis=0)
        return float(left), float(top), float(right), float(bottom)


def ellipse(size: tuple[float, float], count: int) -> tuple[Array, Array]:
    """`count` points of the ellipse with axes `size`, from its centre, and its unit normals there: (count, 2) each.

    They stand in the middle of `count` equal parts of its arc, of which the first begins at the right.
    """
    a, b = size[0] / 2, size[1] / 2
    fine = np.linspace(0.0, 2.0 * np.pi, 64 * count + 1)
    arc = np.append(0.0, np.cumsum(np.hypot(np.diff(a * np.cos(fine)), np.diff(b * np.sin(fine)))))
    angle = np.interp((np.arange(count) + 0.5) / count * arc[-1], arc, fine)
    points = np.stack([a * np.cos(angle), b * np.sin(angle)], axis=1)
    normals = np.stack([b * np.cos(angle), a * np.sin(angle)], axis=1)
    return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)
