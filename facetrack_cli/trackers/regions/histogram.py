"""Colour histograms in sub-regions of a box (Odobez, Ba & Gatica-Perez 2003, section 3.3, "Color model").

    b(c)     hue and saturation of the pixels in each of N_r sub-regions, N = N_h N_s N_r bins that sum to 1
    D^2      = 1 - sum_j sqrt( b_j(c) b_ref_j )            the reference is the box of the first frame
    p(z|c)   ~ exp(-lambda D^2)

A pixel belongs to the sub-region in which its centre lies. Beyond the frame there is no colour: a candidate is divided
by all pixels of its box, the reference by those inside. Hue and saturation are OpenCV's of 8 bits, hue in steps of 2
degrees; bins are equally wide and the first begins at red.

Pale and dark pixels, which have no hue, go to `value_bins` further bins of each sub-region, by their value (Perez et
al., ECCV 2002, with thresholds 0.1 and 0.2): one bin tells only that there is no colour, eight are a grey histogram.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Array, Frame, Image, Particles, Whole, factor_for
from facetrack_cli.engine.spaces import Context
from facetrack_cli.trackers.regions import region_kernels as kernel
from facetrack_cli.trackers.regions.settings import HistogramSettings

MIN_COLOURED = 0.05  # of a face half and more, of grey clips after lossy codecs less than 0.001
MAX_CELLS = 2**24  # of an integral histogram: 64 MB


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
class Histogram:
    """`size`: width and height of the box at scale 1, in pixels."""

    settings: HistogramSettings
    size: tuple[float, float]

    @classmethod
    def build(cls, settings: HistogramSettings, context: Context) -> Histogram:
        return cls(settings, context.placed.size)

    def init(self, frame: Frame, x0: Array) -> Reference:
        """The histogram of the box at x0 (1, 6). InputError without colours where `value_bins` knows no greys."""
        settings, factor = self.settings, factor_for(max(self.size), self.settings.max_size)
        region, ex, ey, _, pixels = self._read(frame, x0[None], factor)
        if region is None:
            wrong = "lies outside the image: choose another box"
            if factor > 1:
                remedy = "give a wider one, or raise likelihood.histogram.max_size"
                wrong = f"has no pixel of the image at 1/{factor} of its size: {remedy}"
            raise InputError(f"frame {frame.index}: the box {wrong}")
        hsv = _hsv(region)
        if settings.value_bins <= 1:
            self._need_colours(frame, hsv)
        hue = np.arange(180) * settings.hue_bins // 180 * settings.saturation_bins
        coloured = (hue[:, None] + np.arange(256) * settings.saturation_bins // 256).astype(np.uint16)
        bins = settings.hue_bins * settings.saturation_bins
        colourless = (bins + np.arange(256) * settings.value_bins // 256).astype(np.uint16)
        codes = kernel.code_colours(hsv, coloured, colourless, *self._least())
        counts = kernel.count_bins(codes, ex[0], ey[0], bins + settings.value_bins)
        used = np.flatnonzero(counts.any(axis=0))
        width = kernel.LANES * (len(used) // kernel.LANES + 1)
        new = np.full(bins + max(settings.value_bins, 1), len(used), np.uint16)
        new[used] = np.arange(len(used))
        root = np.zeros((len(counts), width), np.float32)
        root[:, : len(used)] = np.sqrt(counts[:, used] / pixels)
        return Reference(factor, new[coloured], new[colourless], root)

    def score(self, learned: Reference, frame: Frame, x: Array, parents: Array | None = None) -> Array:
        """-lambda D^2 of boxes x (N, 1, 6) -> (N, 1); parents do not matter."""
        return -self.settings.lambda_h * self._squared(learned, frame, x)

    def distances(self, learned: Reference, frame: Frame, x: Array) -> Array:
        """D of boxes x (N, 1, 6) -> (N, 1): 0 for a perfect match, 1 for no colour in common."""
        return np.sqrt(self._squared(learned, frame, x))

    def learn(self, learned: Reference, frame: Frame, state: Array, particles: Particles) -> Reference:
        return learned

    def _squared(self, learned: Reference, frame: Frame, x: Array) -> Array:
        region, ex, ey, area, pixels = self._read(frame, x, learned.factor)
        if region is None:
            return np.ones((len(x), 1))
        codes = kernel.code_colours(_hsv(region), learned.coloured, learned.colourless, *self._least())
        # what each way takes, in units of one pixel counted directly; both give the same to the last bit
        bins = learned.root.shape[1]
        integral = codes.size * bins <= MAX_CELLS and codes.size * (2 + bins // kernel.LANES) < pixels
        match = (kernel.match_integral if integral else kernel.match_direct)(codes, ex, ey, area, learned.root)
        return np.asarray(np.clip(1.0 - match, 0.0, 1.0)[:, None])

    def _read(self, frame: Frame, x: Array, factor: int) -> tuple[Image | None, Whole, Whole, Array, int]:
        """The part of the frame that boxes (N, 1, 6) cover, their edges in it, areas, and pixels of all together."""
        width, height = (max(side // factor, 1) for side in frame.size)
        boxes = np.ascontiguousarray(x[:, 0, :3])
        ex, ey, area = kernel.box_edges(boxes, *self.size, *self.settings.regions, factor, width, height)
        left, top, right, bottom, pixels = kernel.crop_boxes(ex, ey)
        if pixels == 0:
            return None, ex, ey, area, 0
        extent = (left * factor, top * factor, right * factor - 1, bottom * factor - 1)
        image, dx, dy = frame.reduced(factor, extent)
        dx, dy = dx // factor, dy // factor
        return image[top - dy : bottom - dy, left - dx : right - dx], ex, ey, area, pixels

    def _least(self) -> tuple[int, int]:
        """The least saturation and value, 0..255, of a pixel that has a hue."""
        if self.settings.value_bins == 0:
            return 0, 0
        return int(np.ceil(self.settings.least_saturation * 255)), int(np.ceil(self.settings.least_value * 255))

    def _need_colours(self, frame: Frame, hsv: Image) -> None:
        least = 255 * self.settings.least_saturation, 255 * self.settings.least_value
        saturated, light = hsv[..., 1] >= least[0], hsv[..., 2] >= least[1]
        share, dark = float(np.mean(saturated & light)), float(np.mean(~light))
        if share >= MIN_COLOURED:
            return
        grey = np.mean((_hsv(frame.bgr)[..., 1:] >= least).all(axis=2)) < MIN_COLOURED
        what = "this clip is grey, or too dark" if grey else "the box shows no colours"
        remedy = "use the recipe contour or contour_correlation, or --set likelihood.histogram.value_bins=8"
        if np.mean(saturated & ~light) >= MIN_COLOURED and dark > 0.5:
            remedy += ", or a lower likelihood.histogram.least_value"
        bounds = f"saturation at least {self.settings.least_saturation:g}, value at least {self.settings.least_value:g}"
        hues = f"{share:.1%} of the box's pixels have a hue ({bounds}), {dark:.0%} are too dark"
        raise InputError(f"frame {frame.index}: {what}, so a colour histogram cannot know it: {hues}: {remedy}")


def _hsv(bgr: Image) -> Image:
    """Hue 0..179 in steps of 2 degrees, saturation and value 0..255."""
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2HSV), np.uint8)
