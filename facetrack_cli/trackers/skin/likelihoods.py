"""Likelihoods of one person's skin: of a cloud of pixels, and of a face by colour and pattern.

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

A face is scored by skin colour and by a pattern (Gonzalez & Collet, section 4):

    rho = sum over R_ext of p(skin)  -  sum over R_int of p(skin)                      (eq. 5, 6, 9; by eq. 7 and 8)
    NCC = sum T I / sqrt( sum T^2  sum I^2 )                                          (eq. 10)
    p   ~ exp( -(k - rho / NCC)^2 / (2 sigma^2) )                                                           (eq. 11)

R_int is the box times `inner`, R_ext a frame around it of equal area: together a box with sides sqrt(2) as long. rho is
divided by the area of R_int, so that it lies in -1..1 at any scale. Beyond the frame nothing is skin.

rho is most negative where the face is, -1 at best, so that rho / NCC prefers the worse match. Hence `cost`:

    printed   v = rho / NCC              as in eq. 11, for k = v at the start: a target value, not an extreme
    shifted   v = (1 + rho) / NCC        positive and least at the face, so that k = 0 makes its least value the best
    product   v = rho max(NCC, 0)        beyond the paper: most negative where there is skin and the match is good

NCC^`exponent` stands for NCC. Of skin alone v = rho (shifted: 1 + rho), of NCC alone v = NCC^`exponent`.

NCC as published subtracts no mean (`keep`), and is 0.9 and more for most patches of natural images; beyond the paper,
`remove` takes T - mean(T) and I - mean(I) (zero-mean NCC). The template T is the box of the first frame, on whole
pixels of the reduced frame; a particle's box I is read at the same number of points, bilinearly, at its own scale.
Beyond the frame grey is 0, and a patch without a pattern has NCC 0. If all scales are 1 and the particles lie close
together, sum T I comes from one dense correlation (cv2.matchTemplate), read bilinearly; otherwise each particle is read
by itself. For `remove`, sum I and sum I^2 are those of the values that are read, so that places between pixels are
judged as whole ones are. For `keep` they are area sums by integral images: between pixels that is a little more than
the energy of the values, and the NCC up to 0.001 too small.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import centre, remap
from facetrack_cli.core.types import Array, Box, Frame, Image, Mask, Particles, factor_for
from facetrack_cli.engine.kernels.compiled import boxes_extent, cropped
from facetrack_cli.engine.loop import Footprint
from facetrack_cli.engine.protocols import Likelihood
from facetrack_cli.engine.spaces import BoxSpace, Context, Estimate, box_of, estimate
from facetrack_cli.recipe.model import ExclusionSettings
from facetrack_cli.trackers.points.point_kernels import extent
from facetrack_cli.trackers.skin import skin_kernels as kernel
from facetrack_cli.trackers.skin.settings import SkinCloudSettings, SkinNccSettings

# the rules pass 0.50 to 0.96 of faces that they know, 0.02 to 0.08 of very dark ones, 0.39 of one of a greyish pale
LEAST_SHARE = 0.4
# of (Cb, Cr) in any direction, in levels squared: less loses faces as the light changes, more lets in what is near
MIN_VARIANCE = 9.0
# grey clips have chroma of 1 or 2 after lossy codecs, faces of 5 to 40 nearly everywhere
MIN_CHROMA, MIN_COLOURED = 4.0, 0.05


@dataclass(frozen=True, eq=False)
class SkinModel:
    """A Gaussian on (Cb, Cr): mean (2,), cov (2, 2); full-range BT.601 of 8 bits, as OpenCV has it.

    `table` (256, 256) is 255 p, rounded, at [Cb, Cr]; `share` of the pixels of the ellipse in the box passed Kovac's
    rules; `fallback`: too few, so that all of the ellipse was the sample.
    """

    mean: Array
    cov: Array
    table: NDArray[np.uint8]
    share: float
    fallback: bool

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know of how the colour was learned."""
        little = f"Kovac's rules find skin in only {self.share:.0%} of the face"
        return (f"{little}, so its colour was learned from all that its box shows",) if self.fallback else ()


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
    return SkinModel(mean, cov, table, share, fallback)


def _inside(frame: Frame, box: Box) -> tuple[int, int, int, int]:
    """The half-open ranges of pixels whose centres the box covers, at least one: left, top, right, bottom."""
    width, height = frame.size
    (x, y, w, h), far = box, float(width + height)
    edges = (math.ceil(min(max(-1.0, edge - 0.5), far)) for edge in (x, y, x + w, y + h))
    left, top, right, bottom = edges
    left, right = max(left, 0), min(max(right, left + 1), width)
    top, bottom = max(top, 0), min(max(bottom, top + 1), height)
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


MIDDLE = 0.7  # of the box's sides: what is looked at to tell whether a place is skin
GRID = 9  # points along each side of it


@dataclass(frozen=True)
class CloudSpace(BoxSpace):
    """Each particle is a pixel (Gianni et al. 2007), (x, y) of its state; its box has four deviations a side."""

    smooths = False

    def estimate(self, particles: Particles, ess: Array, *, best: bool) -> Estimate:
        """The covariance of the pixels themselves: they are the target, not hypotheses of its place."""
        return estimate(particles, np.full_like(ess, np.inf), best=best)

    def windows(self, estimated: Estimate) -> Array:
        return 4.0 * np.sqrt(np.maximum(np.diagonal(estimated.cov, axis1=1, axis2=2), 0.0))


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
    """A cloud of pixels, whose colour is learned from a box at the start."""

    settings: SkinCloudSettings
    context: Context

    def init(self, frame: Frame, x0: Array) -> SkinModel:
        """The colour of skin in the teacher's box. Raises InputError if nothing of it is in the frame."""
        return learn_skin(frame, box_of(self.context.start, self.settings.learn_from or self.context.name))

    def score(self, learned: SkinModel, frame: Frame, x: Array, parents: Array) -> Array:
        """(N, 1): log p(y | x) of x (N, 1, D), x and y first."""
        return np.log(np.maximum(self._skin(learned, frame, x[:, 0, :2]), self.settings.floor))[:, None]

    def distances(self, learned: SkinModel, frame: Frame, x: Array) -> Array:
        """(N, 1): 1 less the mean probability of skin about each place."""
        steps = np.linspace(-0.5, 0.5, GRID) * MIDDLE
        w, h = self.context.placed.size
        grid = np.stack(np.meshgrid(steps * w, steps * h), axis=-1).reshape(-1, 2)
        skin = self._skin(learned, frame, (x[:, 0, None, :2] + grid).reshape(-1, 2))
        return np.asarray(1.0 - skin.reshape(len(x), -1).mean(axis=1)[:, None])

    def _skin(self, learned: SkinModel, frame: Frame, xy: Array) -> Array:
        """(N,): p of the pixel at each place xy (N, 2); 0 beyond the frame."""
        factor = factor_for(max(self.context.placed.size), self.settings.max_size)
        image, left, top = frame.reduced(factor, extent(np.ascontiguousarray(xy)[:, None], 0.0))
        there = np.floor((xy - (left, top) - (factor - 1) / 2) / factor + 0.5)
        p, within = np.zeros(len(xy)), ((there >= 0) & (there < image.shape[1::-1])).all(axis=1)
        if within.any():
            u, v = there[within].astype(np.intp).T
            p[within] = skin_map(image[v, u][None], learned.table)[0] / 255.0
        return p


MIN_NCC = 0.01  # what divides is at least this: a match of zero or below is as bad as can be, not of the other sign
MIN_RHO = 0.05  # a start with hardly more skin within than around cannot scale a distance
MAX_HALF_SIDE = 1e6  # half a side of a box, pixels
LARGEST = 1e6  # the largest scale, pixels from point to point
MIN_PATTERN = 0.25  # grey levels squared: what varies less than by rounding is no pattern
DENSE = 10.0  # what one pixel of a dense correlation takes, in points read directly


@dataclass(frozen=True, eq=False)
class SkinPattern:
    """`table` (256, 256) uint8, 255 p at [Cb, Cr]; `rho` of the start; `k`, what v is compared with; notes on it."""

    table: NDArray[np.uint8] | None
    template: Template | None
    rho: float
    k: float
    notes: tuple[str, ...]


@dataclass(frozen=True)
class SkinNcc(Likelihood):
    """A face by the skin in its box, by its pattern, or by both."""

    settings: SkinNccSettings
    context: Context

    def init(self, frame: Frame, x0: Array) -> SkinPattern:
        """The skin's colour and the template of the box at x0 (1, 6). InputError if nothing of it is in the frame."""
        table = template = None
        notes: tuple[str, ...] = ()
        skin, ncc = self.settings.skin, self.settings.ncc
        if skin is not None:
            cx, cy, s = x0[0, :3].tolist()
            w, h = (side * s for side in self.context.placed.size)
            model = learn_skin(frame, (cx - 0.5 * (w - 1), cy - 0.5 * (h - 1), w, h))
            table, notes = model.table, model.notes
        if ncc is not None:
            template = learn_template(frame, self.context.placed.size, x0, ncc.max_size)
            if template.variance < MIN_PATTERN:
                notes = (*notes, "the face's box is of one grey level throughout, so that no pattern can be matched")
        learned = SkinPattern(table, template, 0.0, 0.0, notes)
        rho = 0.0 if skin is None else float(self.rho(learned, frame, x0[None])[0])
        return replace(learned, rho=rho, k=float(self._values(learned, frame, x0[None])[0]))

    def score(self, learned: SkinPattern, frame: Frame, x: Array, parents: Array | None = None) -> Array:
        """-(k - v)^2 / (2 sigma^2) of boxes x (N, 1, 6) -> (N, 1) (eq. 11); parents do not matter."""
        off = learned.k - self._values(learned, frame, x)
        return np.asarray((off * off / (-2.0 * self.settings.sigma**2))[:, None])

    def distances(self, learned: SkinPattern, frame: Frame, x: Array) -> Array:
        """(N, 1), 0..1, of boxes x (N, 1, 6): the mean over the cues.

        Skin: 0 where rho is that of the start or less, 1 where it is 0 or more. Template: 1 less the zero-mean NCC.
        """
        cues = []
        if self.settings.skin is not None:
            cues.append(1.0 - np.clip(-self.rho(learned, frame, x) / max(-learned.rho, MIN_RHO), 0.0, 1.0))
        if learned.template is not None:
            cues.append(1.0 - np.maximum(correlate(learned.template, frame, x)[1], 0.0))
        return np.asarray(np.mean(cues, axis=0)[:, None])

    def rho(self, learned: SkinPattern, frame: Frame, x: Array) -> Array:
        """(R_ext - R_int) / area of R_int, eq. 9, of boxes x (N, 1, 6) -> (N,), -1..1; 0 of what is no box."""
        skin = self.settings.skin
        assert skin is not None and learned.table is not None
        factor = factor_for(max(self.context.placed.size), skin.max_size)
        w, h = (skin.inner * side for side in self.context.placed.size)
        reach = math.sqrt(2.0) * w, math.sqrt(2.0) * h
        within = boxes_extent(np.ascontiguousarray(x[:, 0, :3]), *reach, *frame.size)
        width, height = (max(side // factor, 1) for side in frame.size)
        x0, y0 = min(int(within[0]) // factor, width - 1), min(int(within[1]) // factor, height - 1)
        x1, y1 = min(int(within[2]) // factor + 2, width), min(int(within[3]) // factor + 2, height)
        image = cropped(frame.reduced, factor, x0, y0, x1, y1)
        integral = cv2.integral(skin_map(image, learned.table), sdepth=cv2.CV_64F)
        corner = np.array([[x0 * factor], [y0 * factor]])
        at = (x[:, 0, :2].T - corner - 0.5 * (factor - 1)) / factor
        half = 0.5 * (x[:, 0, 2] / factor) * np.array([[w], [h]])
        # comparisons with nan are false; what is thinner than a pixel is no box
        shown = ((half >= 0.5) & (half <= MAX_HALF_SIDE) & (np.abs(at) <= 10.0 * MAX_HALF_SIDE)).all(axis=0)
        at, half = np.where(shown, (at, half), 0.0)
        inner, outer = (
            kernel.box_sums(integral, np.vstack([at - side, at + side]) + 0.5) for side in (half, math.sqrt(2.0) * half)
        )
        rho = (outer - 2.0 * inner) / np.where(shown, 255.0 * 4.0 * half[0] * half[1], 1.0)
        return np.asarray(np.clip(rho, -1.0, 1.0))

    def _values(self, learned: SkinPattern, frame: Frame, x: Array) -> Array:
        """v of boxes x (N, 1, 6) -> (N,)."""
        ncc, cost = self.settings.ncc, self.settings.cost
        rho: Any = 1.0 if self.settings.skin is None else self.rho(learned, frame, x)
        shifted = 1.0 + rho if cost == "shifted" else rho
        if ncc is None or learned.template is None:
            return np.asarray(shifted)
        match = correlate(learned.template, frame, x)[0 if ncc.mean == "keep" else 1]
        if self.settings.skin is None or cost == "product":
            return np.asarray(rho * np.maximum(match, 0.0) ** ncc.exponent)
        return np.asarray(shifted / np.maximum(match, MIN_NCC) ** ncc.exponent)


@dataclass(frozen=True, eq=False)
class Template:
    """`centred` (th, tw) float32: grey levels at the start, read at 1 / factor of the size, without their `mean`.

    `variance` is theirs; `offset` (dx, dy): of its centre from the box's, in reduced pixels at scale 1; at most half a
    pixel.
    """

    factor: int
    centred: NDArray[np.float32]
    offset: tuple[float, float]
    mean: float = 0.0
    variance: float = 0.0


def learn_template(frame: Frame, size: tuple[float, float], x0: Array, max_size: float | None) -> Template:
    """The template of the box at x0 (1, 6). Raises InputError if nothing of it is in the frame."""
    cx, cy, s = x0[0, :3].tolist()
    for c, side, length in zip((cx, cy), size, frame.size, strict=True):
        if not (c + 0.5 * side * s > -0.5 and c - 0.5 * side * s < length - 0.5):
            raise InputError(f"frame {frame.index}: the box lies outside the image: choose another box")
    factor = factor_for(max(size), max_size)
    tw, th = (max(round(side / factor), 2) for side in size)
    # at scale 1 on whole pixels, so that the frame is learned as it is, and read again where it was learned
    u, v = ((c - 0.5 * (factor - 1)) / factor - 0.5 * s * (n - 1) for c, n in ((cx, tw), (cy, th)))
    template = Template(factor, np.zeros((th, tw), np.float32), ((round(u) - u) / s, (round(v) - v) / s))
    image, boxes, seen = _view(template, frame, x0[None])
    if not seen[0]:
        return template
    u, v, s = boxes[:, 0]
    x, y = (np.float32(at) for at in np.meshgrid(u + s * np.arange(tw), v + s * np.arange(th)))
    patch = remap(np.float32(image), x, y, cv2.BORDER_CONSTANT)
    centred = patch - np.float32(mean := float(patch.mean()))
    variance = float(np.mean(np.square(centred, dtype=np.float64)))
    return replace(template, centred=centred, mean=mean, variance=variance)


def correlate(template: Template, frame: Frame, x: Array) -> tuple[Array, Array]:
    """NCC of boxes x (N, 1, 6) with the template, with means kept and removed: (N,) each, -1..1."""
    image, boxes, seen = _view(template, frame, x)
    centred, mean, variance = template.centred, template.mean, template.variance
    cross, spread = _moments(image, boxes, seen, centred)
    remove = _ratio(cross, variance * spread, seen)
    # area means of the image and of its square: a point stands for s x s pixels around it
    (th, tw), s = centred.shape, boxes[2]
    low = boxes[:2] - 0.5 * s + 0.5
    edges, area = np.vstack([low, low + s * np.array([[tw], [th]])]), s * tw * s * th
    sums = cv2.integral2(image, sdepth=cv2.CV_64F, sqdepth=cv2.CV_64F)
    level, square = (kernel.box_sums(one, edges) / area for one in sums)
    return _ratio(cross + mean * level, (variance + mean * mean) * square, seen), remove


def _view(template: Template, frame: Frame, x: Array) -> tuple[Image, Array, Mask]:
    """The grey image around boxes x (N, 1, 6), boxes (3, N) = (u, v, s) in its pixels, and which are seen at all.

    (0, 0, 1) stands for those beyond the image, thinner than a pixel or no numbers.
    """
    factor, (th, tw) = template.factor, template.centred.shape
    size = np.array([max(side // factor, 1) for side in frame.size])
    s, points = x[:, 0, 2], np.array([[tw], [th]])
    at = (x[:, 0, :2].T - 0.5 * (factor - 1)) / factor + s * (np.array(template.offset)[:, None] - 0.5 * (points - 1))
    start, end = at - 0.5 * s, at + s * (points - 0.5)
    # comparisons with nan are false; beyond the bound the arithmetic of places would be rough
    seen = (s * min(th, tw) >= 1.0) & (s <= LARGEST) & ((end > -0.5) & (start < size[:, None] - 0.5)).all(axis=0)
    boxes = np.where(seen, np.vstack([at, s]), [[0.0], [0.0], [1.0]])
    corner, far = np.zeros(2, np.int64), np.ones(2, np.int64)
    if seen.any():
        corner = np.maximum(np.floor(start[:, seen].min(axis=1)), 0).astype(np.int64)
        far = np.minimum(np.ceil(end[:, seen].max(axis=1)) + 1, size).astype(np.int64)
    (x0, y0), (x1, y1) = corner.tolist(), far.tolist()
    boxes[:2] -= corner[:, None]
    image = np.ascontiguousarray(cropped(frame.grey, factor, x0, y0, x1, y1))  # one signature, one compilation
    return image, np.ascontiguousarray(boxes), seen


def _ratio(cross: Array, energy: Array, seen: Mask) -> Array:
    # of a template or a patch without a pattern the energy is next to nothing
    good = seen & (energy >= MIN_PATTERN**2)
    return np.clip(np.where(good, cross, 0.0) / np.sqrt(np.where(good, energy, 1.0)), -1.0, 1.0)


def _moments(image: Image, boxes: Array, seen: Mask, centred: NDArray[np.float32]) -> Array:
    """Mean of template times image, and the image's variance at the template's points, (2, N), the cheaper way."""
    places = boxes[:2, seen] if seen.any() else np.zeros((2, 1))
    (x0, y0), (height, width) = np.floor(places.min(axis=1)).astype(int).tolist(), image.shape
    x1, y1 = (np.floor(places.max(axis=1)).astype(int) + 1 + centred.shape[::-1]).tolist()
    same_scale = (boxes[2, seen] == 1.0).all()
    if not same_scale or (x1 - x0) * (y1 - y0) * DENSE > boxes.shape[1] * centred.size:
        return np.asarray(kernel.moments_direct(image, centred, boxes))
    # one correlation at all whole places
    region = np.zeros((y1 - y0, x1 - x0), np.float32)
    left, right, top, bottom = max(x0, 0), min(x1, width), max(y0, 0), min(y1, height)
    if right > left and bottom > top:
        region[top - y0 : bottom - y0, left - x0 : right - x0] = image[top:bottom, left:right]
    correlated = cv2.matchTemplate(region, centred, cv2.TM_CCORR)
    cross = kernel.bilinear(correlated, boxes, x0, y0) / centred.size
    return np.stack([cross, _variances(region, boxes[:2] - np.array([[x0], [y0]]), *centred.shape)])


def _variances(region: NDArray[np.float32], places: Array, th: int, tw: int) -> Array:
    """The variance (N,) of the bilinear image at th x tw points from `places` (2, N), a pixel apart.

    Between two values a and b, at the share f of the way, the square of the bilinear value is
    (1 - f) a^2 + f b^2 - f (1 - f) (b - a)^2: it is summed by integral images of squares and of squared differences.
    """
    across, down = np.diff(region, axis=1), np.diff(region, axis=0)

    def total(image: NDArray[np.float32], *corner: Array) -> Array:
        u, v = corner
        edges = np.stack([u, v, u + tw, v + th])
        return np.asarray(kernel.box_sums(cv2.integral(image, sdepth=cv2.CV_64F), edges))

    (x, y), (i, j) = places, np.floor(places)
    fx, fy = (x - i) * (1.0 - x + i), (y - j) * (1.0 - y + j)
    square = total(region**2, x, y) + fx * fy * total(np.diff(across, axis=0) ** 2, i, j)
    square -= fx * total(across**2, i, y) + fy * total(down**2, x, j)
    level = total(region, x, y) / (th * tw)
    return np.asarray(square / (th * tw) - level * level)
