"""The colour of one person's skin, and a cloud of pixels that have it.

The colour is learned from the face's box (Gonzalez & Collet, section 3, eq. 4):

    pixels of the box that pass the rules of Kovac, Peer & Solina (EUROCON 2003)      a rough sample of skin
    mu_S, Sigma_S: mean and covariance of their (Cb, Cr)                                                (eq. 4)
    p(c | skin) = exp(-(c - mu_S)' Sigma_S^-1 (c - mu_S) / 2)        without the factor that makes it a density

so that p is 1 at the mean. Beyond the paper, the spread of Sigma_S has a floor in every direction, or skin of one flat
colour would be found nowhere else. And the rules know neither very dark nor very pale skin: when they pass too little
of the ellipse in the box, all of it is the sample, and `notes` says so. Corners do not count: there may be a warm wall.

Of a cloud each particle is a pixel, weighed by the probability that it is skin (Gianni, Collet & Dalle, GW 2007). As
Gonzalez & Collet describe that tracker (section 3), a head or a hand is a cloud of pixels:

    p(y | x) = max(p(c(x) | skin), floor)

with the skin colour of eq. 4, learned from one box in the first frame, such as the face's for head and hands alike.
Beyond the paper: with the floor, a cloud without any skin spreads out and finds some; `max_size` reduces the frame.

Targets of one recipe may exclude each other (`log_weights`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import centre
from facetrack_cli.core.types import Array, Box, Frame, Image, Mask, Particles, Start, factor_for
from facetrack_cli.engine.loop import Footprint
from facetrack_cli.engine.protocols import Likelihood
from facetrack_cli.engine.spaces import Context, Estimate, Placed, Space, box_of, check_size, estimate, size_of_box
from facetrack_cli.trackers.points.point_kernels import extent
from facetrack_cli.trackers.skin.settings import CloudSettings, ExclusionSettings, SkinCloudSettings

# the rules pass 0.50 to 0.96 of faces that they know, 0.02 to 0.08 of very dark ones, 0.39 of one of a greyish pale
LEAST_SHARE = 0.4
# of (Cb, Cr) in any direction, in levels squared: less loses faces as the light changes, more lets in what is near
MIN_VARIANCE = 9.0
# grey clips have chroma of 1 or 2 after lossy codecs, faces of 5 to 40 nearly everywhere
MIN_CHROMA, MIN_COLOURED = 4.0, 0.05
MIN_CONTRAST = 0.1  # where less, boxes at some distance score better than the face itself


@dataclass(frozen=True, eq=False)
class SkinModel:
    """A Gaussian on (Cb, Cr): mean (2,), cov (2, 2); full-range BT.601 of 8 bits, as OpenCV has it.

    `table` (256, 256) is 255 p, rounded, at [Cb, Cr]; `share` of the pixels of the ellipse in the box passed Kovac's
    rules; `fallback`: too few, so that all of the ellipse was the sample; `contrast`: mean p in the box less that in
    the ring of equal area around it, -1..1.
    """

    mean: Array
    cov: Array
    table: NDArray[np.uint8]
    share: float
    fallback: bool
    contrast: float

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know of how the colour was learned, one line at most."""
        notes = []
        if self.fallback:
            little = f"Kovac's rules find skin in only {self.share:.0%} of the face"
            notes.append(f"{little}, so its colour was learned from all that its box shows")
        if self.contrast < MIN_CONTRAST:
            same = "what surrounds the face has nearly the same colour"
            notes.append(f"{same}, so skin colour will hardly tell them apart")
        return ("; ".join(notes),) if notes else ()


def kovac(bgr: Image) -> Mask:
    """Which pixels of bgr (H, W, 3) are skin by the rules for daylight or those for flashlight -> (H, W)."""
    b, g, r = (bgr[..., c].astype(np.int16) for c in range(3))
    spread = bgr.max(axis=2).astype(np.int16) - bgr.min(axis=2)
    daylight = (r > 95) & (g > 40) & (b > 20) & (spread > 15) & (r - g > 15) & (r > b)
    flashlight = (r > 220) & (g > 210) & (b > 170) & (np.abs(r - g) <= 15) & (b < r) & (b < g)
    return np.asarray(daylight | flashlight, np.bool_)


def skin_map(bgr: Image, table: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """table[Cb, Cr] (H, W) of every pixel of bgr (H, W, 3)."""
    codes = cv2.cvtColor(bgr, cv2.COLOR_BGR2YCrCb).astype(np.intp)
    return np.asarray(table.ravel()[(codes[..., 2] << 8) + codes[..., 1]], np.uint8)


def learn_skin(frame: Frame, box: Box) -> SkinModel:
    """The colour of the skin in a box (pixels), which may stick out of the frame.

    All of the ellipse in the box is the sample when less than `LEAST_SHARE` of it passes Kovac's rules. Raises
    InputError if nothing of the box is in the frame, or hardly anything in it has a colour.
    """
    x0, y0, x1, y1 = _inside(frame, box)
    region = frame.bgr[y0:y1, x0:x1]
    passed, ellipse = kovac(region), _ellipse(box, x0, y0, region)
    share = float(passed[ellipse].mean())
    fallback = share < LEAST_SHARE or not passed.any()
    colours = cv2.cvtColor(region, cv2.COLOR_BGR2YCrCb)[..., [2, 1]].astype(np.float64)
    sample = colours[ellipse if fallback else passed]
    coloured = float((np.abs(sample - 128).max(axis=1) >= MIN_CHROMA).mean())
    if coloured < MIN_COLOURED:
        share_of_box = f"only {coloured:.0%} of the face's box have a colour, so skin cannot be known by it"
        remedy = "take a recipe that does without, as ncc or contour_correlation"
        raise InputError(f"frame {frame.index}: {share_of_box}; {remedy}")
    mean = sample.mean(axis=0)
    off = sample - mean
    spread, axes = np.linalg.eigh(off.T @ off / len(sample))
    cov = (axes * np.maximum(spread, MIN_VARIANCE)) @ axes.T
    d = np.stack(np.meshgrid(np.arange(256.0) - mean[0], np.arange(256.0) - mean[1], indexing="ij"), axis=-1)
    squared = np.einsum("...i,ij,...j", d, np.linalg.inv(cov), d)
    table = np.asarray(np.rint(255 * np.exp(-squared / 2)), np.uint8)
    return SkinModel(mean, cov, table, share, fallback, _contrast(frame, box, table))


def _inside(frame: Frame, box: Box) -> tuple[int, int, int, int]:
    """The half-open ranges of pixels whose centres the box covers, at least one: left, top, right, bottom."""
    width, height = frame.size
    ranges = []
    for start, length, count in zip(box[:2], box[2:], (width, height), strict=True):
        first, last = (math.ceil(min(max(-1.0, edge - 0.5), count)) for edge in (start, start + length))
        ranges.append((max(first, 0), min(max(last, first + 1), count)))
    (left, right), (top, bottom) = ranges
    if right <= left or bottom <= top:
        where = f"the box {','.join(f'{v:g}' for v in box)} is not in the image of {width}x{height} pixels"
        raise InputError(f"frame {frame.index}: {where}; give left, top, width and height in pixels of the frame")
    return left, top, right, bottom


def _ellipse(box: Box, x0: int, y0: int, region: Image) -> Mask:
    """Which pixels of the region at (x0, y0) the box's ellipse covers; all of them if it covers none."""
    height, width = region.shape[:2]
    x, y = centre(box)
    u = (np.arange(x0, x0 + width) - x) / max(box[2] / 2, 0.5)
    v = (np.arange(y0, y0 + height) - y) / max(box[3] / 2, 0.5)
    covered = u**2 + v[:, None] ** 2 <= 1
    return np.asarray(covered if covered.any() else np.ones_like(covered), np.bool_)


def _contrast(frame: Frame, box: Box, table: NDArray[np.uint8]) -> float:
    """Mean p in the box less that around it, of pixels in the frame; 1 where there is nothing around it."""
    margin_x, margin_y = ((math.sqrt(2) - 1) / 2 * side for side in box[2:])
    x0, y0, x1, y1 = _inside(frame, box)
    wide = (box[0] - margin_x, box[1] - margin_y, box[2] + 2 * margin_x, box[3] + 2 * margin_y)
    left, top, right, bottom = _inside(frame, wide)
    # of a box of less than a pixel, the pixel that it gets all the same
    left, top, right, bottom = min(left, x0), min(top, y0), max(right, x1), max(bottom, y1)
    p = skin_map(frame.bgr[top:bottom, left:right], table).astype(np.float64) / 255
    face = p[y0 - top : y1 - top, x0 - left : x1 - left]
    around = p.size - face.size
    return float(face.mean() - (p.sum() - face.sum()) / around) if around else 1.0


MIDDLE = 0.7  # of the box's sides: what is looked at to tell whether a place is skin
GRID = 9  # points along each side of it


@dataclass(frozen=True)
class CloudSpace(Space):
    """Each particle is a pixel (Gianni et al. 2007): state (1, 2) = (x, y); its box has four deviations a side."""

    smooths = False

    @classmethod
    def place(cls, settings: CloudSettings, start: Start, name: str) -> Placed:
        """All over the target's box, whose mean side is the unit of length."""
        box = check_size(start.origin, name, box_of(start, name))
        windows = np.array([box[2:]])
        return Placed(cls(), cls().at(box), windows, size_of_box(start, name), (0.25, 4.0), windows)

    def estimate(self, particles: Particles, ess: Array, *, best: bool) -> Estimate:
        """The covariance of the pixels themselves: they are the target, not hypotheses of its place."""
        return estimate(particles, np.full_like(ess, np.inf), best=best)

    def windows(self, estimated: Estimate) -> Array:
        return 4.0 * np.sqrt(np.maximum(np.diagonal(estimated.cov, axis1=1, axis2=2), 0.0))

    def at(self, box: Box) -> Array:
        return np.array([[*centre(box), 1.0, 0.0, 0.0, 0.0]])


def log_weights(settings: ExclusionSettings, x: Array, footprints: Sequence[Footprint]) -> Array:
    """(N, K): what mutual exclusion adds to log p(y | x) of x (N, K, D) (Gianni, Collet & Dalle 2007).

    Particles are penalised when the objects are close, so that two filters do not track the same skin (Gonzalez &
    Collet, section 3). The papers print no formula. Chosen is, with the other targets j, each an ellipse:

        p(y | x) <- p(y | x) * prod_j (1 - strength * exp(-(d_j(x) / reach)^4 / 2))

    with d_j the distance from the centre of j in half axes of its ellipse, 1 on its outline. By the fourth power the
    whole ellipse is penalised and little outside of it. Where all particles are penalised alike, none is.
    """
    total = np.zeros(x.shape[:2])
    for footprint in footprints:
        half = np.maximum(footprint.half, 1.0)  # of a cloud that has shrunk to a point, a pixel is left
        squared = np.sum(((x[..., :2] - footprint.centre) / (half * settings.reach)) ** 2, axis=2)
        total += np.log1p(-min(settings.strength, 1 - 1e-12) * np.exp(-0.5 * np.minimum(squared, 1e6) ** 2))
    return total


@dataclass(frozen=True)
class SkinCloud(Likelihood):
    """`size`: width and height in pixels at the start; `teacher`: the box that teaches the colour, in pixels."""

    settings: SkinCloudSettings
    size: tuple[float, float]
    teacher: Box

    @classmethod
    def build(cls, settings: SkinCloudSettings, context: Context) -> SkinCloud:
        start, teacher = context.start, settings.learn_from or context.name
        if teacher not in start.targets:
            raise InputError(f"{start.origin}: has no {teacher}, whose colours {context.name} learns from; add its box")
        return cls(settings, context.placed.size, box_of(start, teacher))

    def init(self, frame: Frame, x0: Array) -> SkinModel:
        """The colour of skin in the teacher's box. Raises InputError if nothing of it is in the frame."""
        return learn_skin(frame, self.teacher)

    def score(self, learned: SkinModel, frame: Frame, x: Array, parents: Array) -> Array:
        """(N, 1): log p(y | x) of x (N, 1, D), x and y first."""
        return np.log(np.maximum(self._skin(learned, frame, x[:, 0, :2]), self.settings.floor))[:, None]

    def distances(self, learned: SkinModel, frame: Frame, x: Array) -> Array:
        """(N, 1): 1 less the mean probability of skin about each place."""
        steps = np.linspace(-0.5, 0.5, GRID) * MIDDLE
        grid = np.stack(np.meshgrid(steps * self.size[0], steps * self.size[1]), axis=-1).reshape(-1, 2)
        skin = self._skin(learned, frame, (x[:, 0, None, :2] + grid).reshape(-1, 2))
        return np.asarray(1.0 - skin.reshape(len(x), -1).mean(axis=1)[:, None])

    def _skin(self, learned: SkinModel, frame: Frame, xy: Array) -> Array:
        """(N,): p of the pixel at each place xy (N, 2); 0 beyond the frame."""
        factor = factor_for(max(self.size), self.settings.max_size)
        image, left, top = frame.reduced(factor, extent(np.ascontiguousarray(xy)[:, None], 0.0))
        there = np.floor((xy - (left, top) - (factor - 1) / 2) / factor + 0.5)
        p, within = np.zeros(len(xy)), ((there >= 0) & (there < image.shape[1::-1])).all(axis=1)
        if within.any():
            u, v = there[within].astype(np.intp).T
            p[within] = skin_map(image[v, u][None], learned.table)[0] / 255.0
        return p
