"""Likelihoods of a box: Odobez, Ba & Gatica-Perez, IDIAP-RR 03-15, 2003, sections 3.1 and 3.3.

Edges along the normals of an ellipse (`Contour`, section 3.3).

    p_o = product over l of max(K, exp(-|nu_m^l - nu_0^l|^2 / (2 sigma^2)))                                  (eq. 11)

nu_0^l is where normal l of L leaves the ellipse, and nu_m^l the nearest edge on it; without an edge the factor is K.
For the rest, the paper refers to Blake & Isard, *Active Contours*, 1998. Chosen here:

- The ellipse touches the borders of the box. Its normals stand at equal steps of arc.
- Edges are maxima of the contrast along a normal: the mean of two grey values less that of the two before them, so that
  a step of C grey levels has the contrast C. Their place between values is that of a parabola.
- `sigma` and `search` are the same at every scale, as printed: otherwise a larger ellipse would meet more edges.
- The frame is averaged over 3x3 pixels first. Beyond it there is no edge, and its border is none.

Colour histograms in sub-regions of the box (`Histogram`, section 3.3, "Color model").

    b(c)     hue and saturation of the pixels in each of N_r sub-regions, N = N_h N_s N_r bins that sum to 1
    D^2      = 1 - sum_j sqrt( b_j(c) b_ref_j )            the reference is the box of the first frame
    p(z|c)   ~ exp(-lambda D^2)

A pixel belongs to the sub-region in which its centre lies. Beyond the frame there is no colour: a candidate is divided
by all pixels of its box, the reference by those inside. Hue and saturation are OpenCV's of 8 bits, hue in steps of 2
degrees; bins are equally wide and the first begins at red.

Pale and dark pixels, which have no hue, go to `value_bins` further bins of each sub-region, by their value (Perez et
al., ECCV 2002, with thresholds 0.1 and 0.2): one bin tells only that there is no colour, eight are a grey histogram.

Correlation of the box with itself in the frame before (`Correlation`), and the product of likelihoods.

    z(r)  = z_k(T_c r), r in R                       the patch of a hypothesis on a fixed reference grid      (eq. 6)
    z now = z before + noise                         along the path of one object                             (eq. 7)
    p     = p_c(z_k | z_k-1, c_k, c_k-1) p_o(z_k|c_k)   this likelihood times one of the object               (eq. 10)
    p_c   = exp(-lambda_c d_c)                       c_k-1 is the particle's own parent                       (eq. 12)
    d_c   = sum over r of rho(z now(r) - z before(r))                                                         (eq. 13)

p_o may itself be the product of a contour and a histogram (section 4). The factors are taken to be independent; the
paper notes that this is not strictly so for colours and correlation, which look at the same pixels.

p_c scores how a particle moved, not where it lies: one that rests on a resting background has distance 0. R are the
centres of equal cells of the box, read bilinearly from the grey frame. The distances of figure 5:

    L2            rho(x) = x^2, lambda_c = 1 / (2 sigma^2)            as published
    saturated L1  rho(x) = min(|x|, saturation), lambda_c = 1 / sigma

d_c is a sum, so sigma belongs to one grid: with n points in place of 16x16, times sqrt(n / 256) for L2, and n / 256 for
saturated L1. Of 200 particles that are scattered by 5 % of the region's size, sigma = 100 (L2) or 400 (saturated L1
at 20) leaves some tens. The recipes take 60 (L2) and 120 (saturated L1), which leave two to five: a flatter
likelihood has a truer spread, but lets a region drift (`docs/decisions.md` has the figures).

Chosen here: the frame is reduced by the largest power of two that leaves a pixel for each step of the grid at the start
(area means). A point beyond the frame's border, now or before, differs by `OUTSIDE`, at most by `saturation`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import remap
from facetrack_cli.core.types import Array, Frame, Image, Particles, Whole, factor_for
from facetrack_cli.engine.kernels.compiled import boxes_extent, cropped
from facetrack_cli.engine.protocols import Likelihood
from facetrack_cli.engine.resampling import Share
from facetrack_cli.engine.spaces import Context
from facetrack_cli.trackers.regions import region_kernels as kernel
from facetrack_cli.trackers.regions.settings import (
    ContourSettings,
    CorrelationSettings,
    HistogramSettings,
    ProductSettings,
)

_MAX_PIXELS = 1e9  # pixels; no frame is as large


class Contour:
    """`size`: (w, h) of the box at scale 1; `sigma` and `search` as in the settings, all in pixels."""

    def __init__(self, settings: ContourSettings, size: tuple[float, float], sigma: float, search: float) -> None:
        self.settings, self.size, self.sigma, self.search = settings, size, sigma, search
        # by what frames are reduced; points of the ellipse at scale 1, and its normals
        self._outline = factor_for(max(size), settings.max_size), *ellipse(size, settings.normals)

    @classmethod
    def build(cls, settings: ContourSettings, context: Context) -> Contour:
        unit = context.placed.unit
        return cls(settings, context.placed.size, settings.sigma.pixels(unit), settings.search.pixels(unit))

    def init(self, frame: Frame, x0: Array) -> Share:
        """Of the first frame and x0 (1, 6) nothing is learned but how independent the normals are."""
        return self.learn(Share(), frame, x0)

    def score(self, learned: Share, frame: Frame, x: Array, parents: Array | None = None) -> Array:
        """log p_o of x (N, 1, 6) -> (N, 1), from L log K to 0; parents do not matter."""
        return np.asarray(self._terms(frame, x).sum(axis=1, keepdims=True) * learned.mean)

    def distances(self, learned: Share, frame: Frame, x: Array) -> Array:
        """1 - mean over l of exp(-d_l^2 / (2 sigma^2)) of x (N, 1, 6) -> (N, 1), 0 to 1 (no edges)."""
        d = self._nearest(frame, x, self.search)
        return np.asarray(1.0 - np.exp(-0.5 * (d / self.sigma) ** 2).mean(axis=1, keepdims=True))

    def learn(self, learned: Share, frame: Frame, state: Array, particles: Particles | None = None) -> Share:
        """How independent the normals are, if that is estimated."""
        if self.settings.independent == "all":
            return learned
        return learned.after(self._terms(frame, state[None])[0], ring=True)

    def _terms(self, frame: Frame, x: Array) -> Array:
        """(N, L): log of the factor of each normal in eq. 11."""
        least = math.log(self.settings.outlier)
        # what lies farther off counts K, found or not
        reach = min(self.search, self.sigma * math.sqrt(-2.0 * least))
        return np.maximum(-0.5 * (self._nearest(frame, x, reach) / self.sigma) ** 2, least)

    def _nearest(self, frame: Frame, x: Array, reach: float) -> Array:
        """How far the nearest edge lies on each normal, (N, L), in pixels; inf without one within `reach`."""
        factor = self._outline[0]
        boxes = np.clip(np.nan_to_num(x[:, 0, :3]), -_MAX_PIXELS, _MAX_PIXELS)
        # an edge at the very end of a normal is seen by two values beyond it, and each value by a pixel around it
        around = np.maximum(boxes[:, 2:], 0.0) * np.array(self.size) / 2 + (reach + 5.0 * factor)
        low, high = (boxes[:, :2] - around).min(axis=0).tolist(), (boxes[:, :2] + around).max(axis=0).tolist()
        grey, left, top = frame.grey(factor, (*low, *high))
        # sums, which are whole numbers: their ninths are the means
        nine = cv2.boxFilter(grey, cv2.CV_16U, (3, 3), normalize=False)
        threshold = 9.0 * self.settings.threshold
        return np.asarray(kernel.nearest_edges(nine, boxes, left, top, *self._outline, reach, threshold))


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


MIN_COLOURED = 0.05  # of a face half and more, of grey clips after lossy codecs less than 0.001
MAX_CELLS = 2**20  # pixels of an integral histogram: 64 MB


@dataclass(frozen=True)
class Reference:
    """The histogram of the first frame, with U bins that it uses in any sub-region (one more is for all others).

    `coloured` (180, 256) by hue and saturation and `colourless` (256,) by value give a pixel's bin, uint16; `root`
    (rows * cols, U) float32 holds the square roots of b_ref; `factor`: boxes are read at 1 / factor of the size.
    """

    factor: int
    coloured: NDArray[np.uint16]
    colourless: NDArray[np.uint16]
    root: NDArray[np.float32]


@dataclass(frozen=True)
class Histogram(Likelihood):
    """Colours in sub-regions of a box."""

    settings: HistogramSettings
    context: Context

    def init(self, frame: Frame, x0: Array) -> Reference:
        """The histogram of the box at x0 (1, 6). InputError without colours where `value_bins` knows no greys."""
        settings, factor = self.settings, factor_for(max(self.context.placed.size), self.settings.max_size)
        hsv, ex, ey, _ = self._read(frame, x0[None], factor)
        if hsv is None:
            wrong = f"the box has no pixel of the image at 1/{factor} of its size"
            remedy = "choose another, or raise likelihood.histogram.max_size"
            raise InputError(f"frame {frame.index}: {wrong}: {remedy}")
        least = 255 * settings.least_saturation, 255 * settings.least_value
        share = float(np.mean((hsv[..., 1:] >= least).all(axis=2)))
        if settings.value_bins <= 1 and share < MIN_COLOURED:
            what = f"{share:.1%} of the box's pixels have a hue, so a colour histogram cannot know it"
            remedy = "use the recipe contour or contour_correlation, or --set likelihood.histogram.value_bins=8"
            raise InputError(f"frame {frame.index}: {what}: {remedy}")
        hue = np.arange(180) * settings.hue_bins // 180 * settings.saturation_bins
        coloured = (hue[:, None] + np.arange(256) * settings.saturation_bins // 256).astype(np.uint16)
        bins = settings.hue_bins * settings.saturation_bins
        colourless = (bins + np.arange(256) * settings.value_bins // 256).astype(np.uint16)
        codes = self._codes(hsv, coloured, colourless)
        cells = [codes[y0:y1, x0:x1] for y0, y1 in pairwise(ey[0]) for x0, x1 in pairwise(ex[0])]
        counts = np.stack([np.bincount(cell.ravel(), minlength=bins + settings.value_bins) for cell in cells])
        used = np.flatnonzero(counts.any(axis=0))
        width = kernel.LANES * (len(used) // kernel.LANES + 1)
        new = np.full(bins + max(settings.value_bins, 1), len(used), np.uint16)
        new[used] = np.arange(len(used))
        root = np.zeros((len(counts), width), np.float32)
        root[:, : len(used)] = np.sqrt(counts[:, used] / counts.sum())
        return Reference(factor, new[coloured], new[colourless], root)

    def score(self, learned: Reference, frame: Frame, x: Array, parents: Array | None = None) -> Array:
        """-lambda D^2 of boxes x (N, 1, 6) -> (N, 1); parents do not matter."""
        return -self.settings.lambda_h * self._squared(learned, frame, x)

    def distances(self, learned: Reference, frame: Frame, x: Array) -> Array:
        """D of boxes x (N, 1, 6) -> (N, 1): 0 for a perfect match, 1 for no colour in common."""
        return np.sqrt(self._squared(learned, frame, x))

    def _squared(self, learned: Reference, frame: Frame, x: Array) -> Array:
        hsv, ex, ey, area = self._read(frame, x, learned.factor)
        if hsv is None:
            return np.ones((len(x), 1))
        codes = self._codes(hsv, learned.coloured, learned.colourless)

        def match(of: slice) -> Array:
            """The Bhattacharyya coefficients of some boxes with the reference."""
            left, top = int(ex[of].min()), int(ey[of].min())
            part = np.ascontiguousarray(codes[top : int(ey[of].max()), left : int(ex[of].max())])
            return np.asarray(kernel.match_boxes(part, ex[of] - left, ey[of] - top, area[of], learned.root))

        together = len(x) if codes.size <= MAX_CELLS else 1  # far apart: of each box what it covers alone
        each = [match(slice(n, n + together)) for n in range(0, len(x), together)]
        return np.asarray(np.clip(1.0 - np.concatenate(each), 0.0, 1.0)[:, None])

    def _read(self, frame: Frame, x: Array, factor: int) -> tuple[Image | None, Whole, Whole, Array]:
        """HSV of the part of the frame that boxes (N, 1, 6) cover, their edges in it, and areas.

        Column c of sub-regions holds the pixels ex[n, c] <= i < ex[n, c + 1] of that part, whose centres lie in it, and
        rows as well. Areas (N,) are those of whole boxes, also beyond the frame, and 0 of what is no box.
        """
        s, sizes, edges = x[:, 0, 2] / factor, [max(side // factor, 1) for side in frame.size], []
        sides = s * np.array(self.context.placed.size)[:, None]
        with np.errstate(invalid="ignore"):  # of boxes that lie nowhere
            low = (x[:, 0, :2].T - 0.5 * (factor - 1)) / factor - 0.5 * sides
        good = (s > 0.0) & ((np.abs(low) < 1e15) & (sides < 1e15)).all(axis=0)  # comparisons with nan are false
        low, sides = np.where(good, (low, sides), 0.0)
        for left, side, parts in zip(low, sides, self.settings.regions, strict=True):
            edges.append(np.ceil(left[:, None] + side[:, None] * np.arange(parts + 1) / parts))
        area = np.where(good, math.prod(each[:, -1] - each[:, 0] for each in edges), 0.0)
        ex, ey = (
            np.where(good[:, None], np.clip(each, 0, length), 0).astype(np.int64)
            for each, length in zip(edges, sizes, strict=True)
        )
        seen = (ex[:, -1] > ex[:, 0]) & (ey[:, -1] > ey[:, 0])
        if not seen.any():
            return None, ex, ey, area
        (left, right), (top, bottom) = ((int(each[seen, 0].min()), int(each[seen, -1].max())) for each in (ex, ey))
        hsv = cv2.cvtColor(cropped(frame.reduced, factor, left, top, right, bottom), cv2.COLOR_BGR2HSV)
        # boxes beyond the image are empty, and stay so wherever they are put
        return np.asarray(hsv, np.uint8), np.clip(ex, left, right) - left, np.clip(ey, top, bottom) - top, area

    def _codes(self, hsv: Image, coloured: NDArray[np.uint16], colourless: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """The bin of each pixel of hsv (H, W, 3); pale and dark ones have no hue where there are bins for them."""
        saturation, value = hsv[..., 1], hsv[..., 2]
        codes = coloured.ravel().take((hsv[..., 0].astype(np.intp) << 8) + saturation)
        if self.settings.value_bins == 0:
            return np.asarray(codes)
        # whole numbers, so that bytes are compared
        least_saturation, least_value = self.settings.least_saturation, self.settings.least_value
        pale = (saturation < math.ceil(255 * least_saturation)) | (value < math.ceil(255 * least_value))
        return np.where(pale, colourless.take(value), codes)


# grey levels: a region that is followed well has 6 to 20 (RMS); much more would push regions back into the frame
OUTSIDE = 32.0


class Previous(NamedTuple):
    """The frame that parents lie in, the estimate `state` (1, 6) there, and the share of independent points."""

    frame: Frame
    state: Array
    share: Share = Share()


class Correlation:
    """`size`: width and height of the compared region at scale 1, in pixels: `region` times the box."""

    def __init__(self, settings: CorrelationSettings, size: tuple[float, float]) -> None:
        self.settings, self.size = settings, size
        self._step = min(side / count for side, count in zip(size, settings.grid, strict=True))  # pixels at scale 1
        self.factor = int(2 ** math.floor(math.log2(max(self._step, 1.0))))  # by which frames are reduced

    @classmethod
    def build(cls, settings: CorrelationSettings, context: Context) -> Correlation:
        w, h = context.placed.size
        return cls(settings, (w * settings.region, h * settings.region))

    def init(self, frame: Frame, x0: Array) -> Previous:
        """What the first frame after this one is compared with."""
        # half a step off, as a region that is followed well may be
        return self.learn(Previous(frame, x0), frame, x0 + 0.5 * self._step * (np.eye(1, 6) + np.eye(1, 6, 1)))

    def score(self, learned: Previous, frame: Frame, x: Array, parents: Array) -> Array:
        """log p_c of x (N, 1, 6) in `frame` given its parents (N, 1, 6) in the frame before -> (N, 1), at most 0."""
        here, there = (np.ascontiguousarray(boxes[:, 0, :3]) for boxes in (x, parents))
        images = *self._image(frame, here), *self._image(learned.frame, there)
        sigma, most = self.settings.sigma, self.settings.saturation
        rate, outside = 1.0 / sigma, min(OUTSIDE, most or OUTSIDE)
        if most is None:
            rate, outside = 0.5 / sigma**2, OUTSIDE**2
        sums = np.empty((len(x), 1))  # d_c of eq. 13
        boxes = here, there, self.size, *self.settings.grid
        kernel.patch_distances(*images, self.factor, *boxes, most or 0.0, outside, sums[:, 0])
        return -rate * learned.share.mean * sums

    def learn(self, learned: Previous, frame: Frame, state: Array, particles: Particles | None = None) -> Previous:
        """`frame`, in which the parents of the next frame's particles lie, and how independent the points are."""
        if self.settings.independent == "all":
            return learned._replace(frame=frame)
        off = self._read(frame, state) - self._read(learned.frame, learned.state)
        terms = off**2 if self.settings.saturation is None else np.minimum(np.abs(off), self.settings.saturation)
        return Previous(frame, state, learned.share.after(terms))

    def _read(self, frame: Frame, state: Array) -> Array:
        """(rows, columns): grey values of the grid at a state (1, 6); those beyond the frame are its border's."""
        image, (left, top, _, _) = self._image(frame, np.ascontiguousarray(state[:, :3]))
        at = []
        for place, side, count, first in zip(state[0, :2], self.size, self.settings.grid, (left, top), strict=True):
            cells = place + state[0, 2] * side * ((np.arange(count) + 0.5) / count - 0.5)
            at.append(((cells - first - 0.5 * (self.factor - 1)) / self.factor).astype(np.float32))
        x, y = np.meshgrid(*at)
        return np.asarray(remap(image, x, y, cv2.BORDER_REPLICATE), np.float64)

    def _image(self, frame: Frame, boxes: Array) -> tuple[Image, tuple[int, int, int, int]]:
        """The grey image around the boxes (N, 3), reduced, and its view: (left, top, whole width, whole height)."""
        width, height = frame.size
        left, top, right, bottom = boxes_extent(boxes, *self.size, width, height)
        # between its border and the centre of its first block, a box is read from the block before too
        more = self.factor
        grey, left, top = frame.grey(more, (left - more, top - more, right + more, bottom + more))
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
