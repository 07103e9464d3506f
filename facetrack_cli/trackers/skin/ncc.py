"""Normalised cross-correlation of boxes with a grey template (Gonzalez & Collet, section 4.2, eq. 10).

    NCC = sum T I / sqrt( sum T^2  sum I^2 )             `keep`, as published: no mean is subtracted
          the same of T - mean(T) and I - mean(I)        `remove`, beyond the paper (zero-mean NCC)

The published one is 0.9 and more for most patches of natural images. The template is the box of the first frame, on
whole pixels of the reduced frame; a particle's box is read at the same number of points, bilinearly, at its own scale.
Beyond the frame grey is 0, and a patch without a pattern has NCC 0.

If all scales are 1 and the particles lie close together, sum T I comes from one dense correlation (cv2.matchTemplate),
read bilinearly; otherwise each particle is read by itself. For `remove`, sum I and sum I^2 are those of the values that
are read, so that places between pixels are judged as whole ones are. For `keep` they are area sums by integral images:
between pixels that is a little more than the energy of the values, and the NCC up to 0.001 too small.

Beyond the paper (its future work): with `adapt` = a the template follows, T <- (1 - a) T + a I at the estimate.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Array, Frame, Image, Mask, factor_for
from facetrack_cli.trackers.skin import ncc_kernels as kernel
from facetrack_cli.trackers.skin.settings import PatternSettings

MIN_VARIANCE = 0.25  # grey levels squared: what varies less than by rounding is no pattern
DENSE = 10.0  # what one pixel of a dense correlation takes, in points read directly


@dataclass(frozen=True, eq=False)
class Template:
    """`first` and `now` (th, tw) float32, grey levels at the start and as adapted, read at 1 / factor of the size.

    `offset` (dx, dy): of its centre from the box's, in reduced pixels at scale 1; at most half a pixel.
    """

    factor: int
    first: NDArray[np.float32]
    now: NDArray[np.float32]
    offset: tuple[float, float]

    @cached_property
    def moments(self) -> tuple[NDArray[np.float32], float, float]:
        """`now` without its mean, that mean, and the variance."""
        mean = float(self.now.mean())
        centred = self.now - np.float32(mean)
        return centred, mean, float(np.mean(np.square(centred, dtype=np.float64)))


def learn_template(frame: Frame, size: tuple[float, float], x0: Array, max_size: float | None) -> Template:
    """The template of the box at x0 (1, 6). Raises InputError if nothing of it is in the frame."""
    cx, cy, s = x0[0, :3].tolist()
    width, height = frame.size
    if any(not (c + 0.5 * n * s > -0.5 and c - 0.5 * n * s < m - 0.5)
           for c, n, m in ((cx, size[0], width), (cy, size[1], height))):  # fmt: skip
        raise InputError(f"frame {frame.index}: the box lies outside the image: choose another box")
    factor = factor_for(max(size), max_size)
    tw, th = (max(round(side / factor), 2) for side in size)
    # at scale 1 on whole pixels, so that the frame is learned as it is, and read again where it was learned
    u, v = ((c - 0.5 * (factor - 1)) / factor - 0.5 * s * (n - 1) for c, n in ((cx, tw), (cy, th)))
    offset = ((round(u) - u) / s, (round(v) - v) / s)
    blank = np.zeros((th, tw), np.float32)
    template = Template(factor, blank, blank, offset)
    patch = _patch(template, frame, x0)
    return replace(template, first=patch, now=patch)


def correlate(template: Template, frame: Frame, x: Array) -> tuple[Array, Array]:
    """NCC of boxes x (N, 1, 6) with the template as it is now, with means kept and removed: (N,) each, -1..1."""
    view = _view(template, frame, x)
    centred, mean, variance = template.moments
    cross, spread = _moments(view, centred).T
    remove = _ratio(cross, variance * spread, view.seen)
    sums = cv2.integral2(view.image, sdepth=cv2.CV_64F, sqdepth=cv2.CV_64F)
    level, square = kernel.means(*sums, view.boxes, *centred.shape).T
    return _ratio(cross + mean * level, (variance + mean * mean) * square, view.seen), remove


def adapted(template: Template, settings: PatternSettings, frame: Frame, state: Array) -> Template:
    """The template after a frame whose estimate is `state` (1, 6)."""
    if settings.adapt == 0.0:
        return template
    first = replace(template, now=template.first)
    if float(correlate(first, frame, state[None])[1][0]) < settings.adapt_above:
        return template
    rate = np.float32(settings.adapt)
    return replace(template, now=(1 - rate) * template.now + rate * _patch(template, frame, state))


class _GreyView(NamedTuple):
    """The grey image around boxes (N, 3) = (u, v, s) in its pixels; which are `seen` at all; the range of (u, v)."""

    image: Image
    boxes: Array
    seen: Mask
    low: Array
    high: Array
    same_scale: bool


def _view(template: Template, frame: Frame, x: Array) -> _GreyView:
    factor, (th, tw) = template.factor, template.now.shape
    width, height = (max(side // factor, 1) for side in frame.size)
    boxes, seen, low, high, area, same = kernel.place(x, factor, template.offset, th, tw, width, height)
    x0, y0, x1, y1 = area.tolist()
    grey, left, top = frame.grey(factor, (x0 * factor, y0 * factor, x1 * factor - 1, y1 * factor - 1))
    dx, dy = left // factor, top // factor
    boxes -= (x0, y0, 0.0)
    image = np.ascontiguousarray(grey[y0 - dy : y1 - dy, x0 - dx : x1 - dx])  # one signature, one compilation
    return _GreyView(image, boxes, seen, low - (x0, y0), high - (x0, y0), same)


def _ratio(cross: Array, energy: Array, seen: Mask) -> Array:
    # of a template or a patch without a pattern the energy is next to nothing
    good = seen & (energy >= MIN_VARIANCE**2)
    return np.clip(np.where(good, cross, 0.0) / np.sqrt(np.where(good, energy, 1.0)), -1.0, 1.0)


def _moments(view: _GreyView, centred: NDArray[np.float32]) -> Array:
    """Mean of template times image, and the image's variance at the template's points, (N, 2), the cheaper way."""
    (x0, y0), (height, width) = np.floor(view.low).astype(int).tolist(), view.image.shape
    x1, y1 = (np.floor(view.high).astype(int) + 1 + centred.shape[::-1]).tolist()
    if not view.same_scale or (x1 - x0) * (y1 - y0) * DENSE > len(view.boxes) * centred.size:
        return np.asarray(kernel.moments_direct(view.image, centred, view.boxes))
    # one correlation at all whole places
    region = np.zeros((y1 - y0, x1 - x0), np.float32)
    left, right, top, bottom = max(x0, 0), min(x1, width), max(y0, 0), min(y1, height)
    if right > left and bottom > top:
        region[top - y0 : bottom - y0, left - x0 : right - x0] = view.image[top:bottom, left:right]
    cross = kernel.bilinear(cv2.matchTemplate(region, centred, cv2.TM_CCORR), view.boxes, x0, y0)
    across, down = np.diff(region, axis=1), np.diff(region, axis=0)
    images = region, region**2, across**2, down**2, np.diff(across, axis=0) ** 2
    sums = tuple(cv2.integral(image, sdepth=cv2.CV_64F) for image in images)
    return np.column_stack([cross / centred.size, kernel.variances(sums, view.boxes, x0, y0, *centred.shape)])


def _patch(template: Template, frame: Frame, x0: Array) -> NDArray[np.float32]:
    """The grey levels of the box at x0 (1, 6), at the template's points."""
    view = _view(template, frame, x0[None])
    if not view.seen[0]:
        return np.zeros_like(template.now)
    return np.asarray(kernel.read_patch(view.image, *view.boxes[0].tolist(), *template.now.shape))
