"""Where a frame shows skin of the person that is neither background nor face (ours).

p(skin | c) of a colour c = (Cb, Cr) is that of two densities: skin is normal about the median colour of the face, wider
along the saturation than across it, since cameras and light make faces paler than hands; all else is the histogram of
the first frame within the reach of an arm. From it is taken away:

- what was skin in all frames so far: the least p of each pixel, which rises slowly. A still camera's shelves and lamps
  never move, and a hand does. Where hands hang or lie in the first frame, skin counts at once;
- the face and neck, where they look as before and no arm leads to: a hand in front of them changes what is seen, by
  more than a head that turns, its expressions and the light do while no hand is near. What changed is learned slowly.

A camera that sets its exposure or white balance anew colours all things anew. So each frame is brought back to the
light of the first one.

All of it is on a frame reduced so that the face's box is 10 to 20 pixels large.

The camera's motion is found by phase correlation (Kuglin & Hines, 1975). `cv2.phaseCorrelate` takes the middle of the
correlation to be at half of the length to which it pads a side. Of an odd length that is half a pixel beside it: two
equal images are then 0.5 apart, at a response of 1. So sides are padded here to an even length. The window keeps to its
place where the image moves, which draws the peak to zero. So a shift of a pixel or more is measured again, on what both
images show.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import warp_affine
from facetrack_cli.core.types import Array, Box, Frame, Image, Planes, factor_for
from facetrack_cli.engine.loop import Footprint
from facetrack_cli.trackers.hands.hand_kernels import BRIGHT, DARK, LEARNS, edges, learn_head, same_light

Map = NDArray[np.float32]
MAX_FACE_PX: Final = 20  # of the face's box in the reduced frame
LEAST_COLOUR: Final = 3.0  # of Cb and Cr from grey, of the face's median colour
PALE: Final = 1.25  # saturation of skin over that of the face
ALONG, ACROSS, NOISE = 0.4, 0.12, 1.5  # standard deviations of skin: in saturations of the face, and in levels
SKIN_SHARE: Final = 0.03  # of what is not the face
PASSES: Final = 3  # of the phase correlation
SHIFT: Final = 0.25  # of a pixel: a camera that moves by less stands still
MOST: Final = 0.4  # of steep edges, of which so many change if the camera moves
MOVES: Final = 0.6  # of the peak of the phase correlation, from which on it tells a motion of the camera
RISES: Final = 0.002  # of the background's p in a frame
CHANGED: Final = 4.0  # grey levels by which the face differs from before, where as much speaks for a hand as against it
UNREST, UNREST_AT_FIRST = 2.5, 1.5  # by so many times as much as without a hand, if that is more; grey levels
REACHES: Final = 0.45  # sizes of the face, by which skin beside it speaks for a hand before it
TELL: Final = 2400  # so many values tell the light, on a lattice
AGREES: Final = 0.15  # of a channel, between the quartiles of all pixels at most
HEAD: Final = (-0.8, -1.3, 0.8, 1.1)  # head and neck about the face's middle, in sizes of the box
_NOBODY: Final = np.empty((0, 2))
_BESIDE: Final = np.ones((3, 3), np.uint8)
_SMOOTHED: Final = np.asarray(cv2.getGaussianKernel(9, 1.0, cv2.CV_32F)[:, 0], np.float32)


class Scene(NamedTuple):
    """What is known of the clip."""

    chances: Map  # (256, 256), p(skin | c) by [Cb, Cr]
    still: Map  # (H, W), the p of the background
    grey: Image  # (H, W), the last frame
    face: Map  # (h, w, 3), the template of the head
    first: Image  # (H, W, 3), the frame in whose light all are seen
    factor: int  # of reduced frames
    side: float  # of the face's box in their pixels in the first frame
    unrest: float = UNREST_AT_FIRST  # grey levels by which the head differs from its template where no hand is near


def reduced(frame: Frame, factor: int) -> Image:
    """The whole frame, reduced; its planes become colours where Y is twice as large."""
    width, height = frame.size
    whole = (0.0, 0.0, width - 1.0, height - 1.0)
    if factor == 1 or frame.yuv is None or (planes := frame.planes(factor // 2, whole)) is None:
        return frame.reduced(factor, whole)[0]
    y, u, v = (plane[0] for plane in planes)
    image = Planes(y[: 2 * u.shape[0], : 2 * u.shape[1]], u, v, frame.yuv.ours).bgr
    return np.asarray(cv2.resize(image, u.shape[::-1], interpolation=cv2.INTER_AREA), np.uint8)


def side_of(head: Footprint) -> float:
    """The mean side of the head's box in pixels: the unit of lengths, in the first frame."""
    return 2 * math.sqrt(float(head.half[0] * head.half[1]))


def to_map(at: Array, factor: int) -> Array:
    """Places (..., 2) of the frame in pixels of the reduced one."""
    return (at + 0.5) / factor - 0.5


class Seen(NamedTuple):
    """Of a frame, (H, W): `evidence`, p that there is skin of a hand or arm, and `face`, 1 at the face and near it."""

    evidence: Map
    face: Map


def begin(frame: Frame, head: Footprint, hands: tuple[Box, ...] = ()) -> tuple[Scene, Seen]:
    """The scene and the evidence of the first frame; `hands` are boxes of hands that are known.

    Raises InputError for a grey clip.
    """
    side = side_of(head)
    factor = factor_for(side, MAX_FACE_PX)
    small, s = reduced(frame, factor), side / factor
    (x, y), colours = to_map(head.centre, factor), cv2.cvtColor(small, cv2.COLOR_BGR2YCrCb)[..., :0:-1]  # Cb and Cr
    # of each pixel, how far it is from the middle of the face, in sizes
    u, v = np.meshgrid((np.arange(small.shape[1]) - x) / s, (np.arange(small.shape[0]) - y) / s)
    face = (u / 0.33) ** 2 + (v / 0.42) ** 2 < 1
    middle = np.median(colours[face].astype(float), axis=0) - 128 if face.any() else np.zeros(2)
    if math.hypot(*middle) < LEAST_COLOUR:
        remedy = "hands are found by the colour of skin; follow the face alone, with --config face"
        raise InputError(f"frame {frame.index}: the face has no colour, as in a grey clip: {remedy}")
    around = (np.hypot(u, v - 2) < 6) & ~((np.abs(u) < 0.75) & (np.abs(v) < 0.9))
    chances = _chances(middle, colours[around])
    skin, grey = _skin(chances, small)
    # hanging at the sides, or before the chest and in the lap
    hang = np.exp(-0.5 * ((np.abs(u) - 1.5) / 0.7) ** 2) / (1 + np.exp((3.0 - v) / 0.3))
    still = skin * (1 - hang)
    for left, top, w, h in hands:
        (x0, y0), (x1, y1) = (np.rint(to_map(np.array(at), factor)) for at in ((left, top), (left + w, top + h)))
        still[max(int(y0), 0) : max(int(y1) + 1, 0), max(int(x0), 0) : max(int(x1) + 1, 0)] = 0
    template = _head(small, np.array([x, y]), s, s)
    scene = Scene(chances, still.astype(np.float32), grey, template, small, factor, s)
    return look(scene, frame, head)


def look(
    scene: Scene, frame: Frame, head: Footprint, hands: Array = _NOBODY, radius: float = 0.0
) -> tuple[Scene, Seen]:
    """The scene after a frame with the head there, and what is seen; `hands` (n, 2) were there in the reduced frame."""
    small = _as_lit(scene.first, reduced(frame, scene.factor))
    skin, grey = _skin(scene.chances, small)
    followed = _followed(scene, grey, skin)
    first = scene.first if followed is scene.still else small  # a camera that moves shows other things
    still = np.minimum(skin, followed + RISES)
    at, s = to_map(head.centre, scene.factor), side_of(head) / scene.factor
    # a head that turns a little is no hand: each pixel may come from beside its own
    seen, face, unrest = _head(small, at, s, scene.side), scene.face.copy(), scene.unrest
    change, new, apart = np.empty((3, *seen.shape[:2]), np.float32)
    before = scene.side * ((hands - at) / s - np.array(HEAD[:2]))
    limit = max(CHANGED, UNREST * unrest)
    if count := learn_head(seen, face, _SMOOTHED, limit, before, radius, change, new, apart.reshape(-1)):
        unrest += LEARNS * (_median(apart.reshape(-1)[:count]) - unrest)
    evidence, near = skin - still, np.zeros_like(skin)
    # the head, with a margin that the disc and what is blurred do not reach beyond
    reach = 2 * round(REACHES * s) + 1
    across, down = at.tolist()
    x, y = max(int(across + s * HEAD[0]) - reach, 0), max(int(down + s * HEAD[1]) - reach, 0)
    right, lower = int(across + s * HEAD[2]) + reach + 1, int(down + s * HEAD[3]) + reach + 1
    part = slice(y, max(lower, y)), slice(x, max(right, x))
    beside, by = evidence[part], s / scene.side
    if beside.size:
        size = beside.shape[::-1]
        margin, heads = _heads(*new.shape, scene.side)
        heads = heads.copy()
        heads[margin:-margin, margin:-margin, 2] = new
        to_part = _map((across - margin * by - x, down - margin * by - y), s, scene.side)
        covered, near[part], changed = cv2.split(warp_affine(heads, to_part, size))
        beside *= 1 - covered
        half = cv2.resize(beside, ((size[0] + 1) // 2, (size[1] + 1) // 2), interpolation=cv2.INTER_AREA)
        arm = cv2.resize(cv2.dilate(half, _disc(round(REACHES * s / 2))), size)
        beside += covered * np.maximum(changed, np.minimum(arm, 1)) * skin[part]
    scene = scene._replace(still=still, grey=grey, face=face, first=first, unrest=unrest)
    return scene, Seen(evidence, near)


def _as_lit(first: Image, now: Image) -> Image:
    """A frame in the light of the first one: new exposure or white balance changes each channel by a factor, which is
    the median over pixels if they agree.
    """
    thin = max(round(math.sqrt(first.size / TELL)), 1)
    if same_light(first, now, thin):
        return now
    both = [np.ascontiguousarray(one[::thin, ::thin]) for one in (first, now)]
    usable = np.flatnonzero(np.logical_and(*(cv2.inRange(one, (DARK,) * 3, (BRIGHT,) * 3) for one in both)))
    before, after = (one.reshape(-1, 3).take(usable, axis=0).T for one in both)
    low, middle, high = (share * len(usable) // 4 for share in (1, 2, 3))
    ratio = np.partition(after / before.astype(np.float32), [low, middle, high], axis=1)
    if (ratio[:, high] - ratio[:, low]).max() > AGREES:
        return now
    return np.asarray(np.clip(np.rint(now / ratio[:, middle]), 0, 255), np.uint8)


def _followed(scene: Scene, grey: Image, skin: Map) -> Map:
    """The background where the camera has moved it, by phase correlation; what comes into the picture is background."""
    # a shift changes edges by as much of their slopes
    slope = np.asarray(cv2.morphologyEx(scene.grey, cv2.MORPH_GRADIENT, _BESIDE), np.uint8)
    steep, moved = edges(scene.grey, grey, slope)
    if moved <= MOST * steep:
        return scene.still
    (x, y), sure = shift_between(scene.grey, grey)
    if sure < MOVES or max(abs(x), abs(y)) < SHIFT or max(abs(x), abs(y)) > scene.side:
        return scene.still
    shift = np.array([[1, 0, x], [0, 1, y]], np.float32)
    size = grey.shape[::-1]
    # what moves before a still camera draws the peak, too: the motion is the camera's if edges fit better by it
    before = scene.grey.astype(np.float32)
    around, off, rest = (one[::2, ::2] for one in (slope, grey - warp_affine(before, shift, size), grey - before))
    steepest = -(-3 * (around.size - 1) // 4)
    there = around >= np.partition(around.ravel(), steepest)[steepest]
    if _median(np.abs(off[there])) >= _median(np.abs(rest[there])):
        return scene.still
    there = warp_affine(np.ones_like(before), shift, size)
    return np.asarray(warp_affine(scene.still, shift, size) + (1 - there) * skin, np.float32)


def _median(values: Map) -> float:
    """Of values (n,), in a fifth of NumPy's time."""
    middle = [(len(values) - 1) // 2, len(values) // 2]
    return float(np.partition(values, middle)[middle].sum(dtype=np.float64)) / 2


def _chances(middle: Array, others: Image) -> Map:
    """Of each colour, where `middle` (2,) is that of the face, from grey, and `others` (n, 2) are the other colours."""
    length = math.hypot(*middle)
    way = middle / length
    along = np.outer(way, way)
    cov = along * (ALONG * length) ** 2 + (np.eye(2) - along) * (ACROSS * length) ** 2 + np.eye(2) * NOISE**2
    levels = np.arange(256.0) - 128
    off = np.stack(np.meshgrid(levels - PALE * middle[0], levels - PALE * middle[1], indexing="ij"), axis=-1)
    squared = np.einsum("...i,ij,...j", off, np.linalg.inv(cov), off)
    skin = np.exp(-squared / 2) / (2 * math.pi * math.sqrt(np.linalg.det(cov)))
    counts = np.zeros((256, 256))
    np.add.at(counts, tuple(others.T), 1.0)
    rest = cv2.GaussianBlur(counts, (0, 0), 1.5) / max(len(others), 1)
    rest = (1 - SKIN_SHARE) * rest + SKIN_SHARE * skin
    odds = np.clip(np.log((skin + 1e-6) / (rest + 1e-6)), -3, 3).astype(np.float32)
    return np.asarray(1 / (1 + np.exp(-odds)), np.float32)


def _skin(chances: Map, image: Image) -> tuple[Map, Image]:
    """p(skin | c) of each pixel, and its grey level."""
    levels = cv2.cvtColor(image, cv2.COLOR_BGR2YCrCb)
    both = np.empty((*levels.shape[:2], 2), np.uint8)
    cv2.mixChannels([levels], [both], [1, 0, 2, 1])
    p = chances.ravel().take(both.view("<u2")[..., 0])  # 256 Cb + Cr
    return np.asarray(cv2.GaussianBlur(p, (0, 0), 0.7), np.float32), np.ascontiguousarray(levels[..., 0])


def _map(at: Iterable[float], side: float, first: float) -> Map:
    """The map from the head's template, of a box that was `first` pixels large, to the reduced frame."""
    (x, y), by = at, side / first
    return np.array([[by, 0, x + side * HEAD[0]], [0, by, y + side * HEAD[1]]], np.float32)


def _head(small: Image, at: Array, side: float, first: float) -> Map:
    """The template of the head: face and neck, as large as in the first frame."""
    size = max(round(first * (HEAD[2] - HEAD[0])), 9), max(round(first * (HEAD[3] - HEAD[1])), 9)
    patch = warp_affine(small, _map(at, side, first), size, cv2.BORDER_REPLICATE, inverse=True)
    return np.asarray(patch, np.float32)


@lru_cache(4)
def _heads(height: int, width: int, side: float) -> tuple[int, Map]:
    """A margin, and images larger than the template by it: 1 within, less at the border; at its disc; for p there."""
    reach = round(REACHES * side)
    margin, inner = reach + 2, np.ones((height - 2, width - 2), np.float32)
    soft = cv2.GaussianBlur(np.pad(inner, 1), (0, 0), 1.0, borderType=cv2.BORDER_CONSTANT)
    covered = np.pad(soft, margin)
    images = [covered, cv2.dilate(covered, _disc(reach)), np.zeros_like(covered)]
    return margin, np.asarray(cv2.merge(images), np.float32)


def _disc(radius: int) -> Image:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)), np.uint8)


def shift_between(before: Map | Image, after: Map | Image) -> tuple[Array, float]:
    """The shift (2,) in pixels, x before y, from `before` to `after` (H, W), and the height of its peak, 0..1."""
    (height, width), x, y = before.shape, 0, 0
    for _ in range(PASSES):
        ours = before[max(-y, 0) : height - max(y, 0), max(-x, 0) : width - max(x, 0)]
        theirs = after[max(y, 0) : height + min(y, 0), max(x, 0) : width + min(x, 0)]
        # the least even lengths that a Fourier transform takes fast
        fast = ((cv2.getOptimalDFTSize(longer) for longer in range(side, 2 * side + 2)) for side in ours.shape)
        down, across = (next(size for size in sizes if size % 2 == 0) for sizes in fast)
        border, window = (0, down - len(ours), 0, across - len(ours[0]), cv2.BORDER_CONSTANT), _hanning(*ours.shape)
        rest, sure = cv2.phaseCorrelate(*(cv2.copyMakeBorder(one * window, *border) for one in (ours, theirs)))
        shift = np.array([x, y]) + rest
        before_that, (x, y) = (x, y), np.rint(shift).astype(int).tolist()
        if (x, y) == before_that or 2 * abs(x) > width or 2 * abs(y) > height:
            break
    return shift, sure


@lru_cache(4)
def _hanning(height: int, width: int) -> Map:
    return np.asarray(cv2.createHanningWindow((width, height), cv2.CV_32F), np.float32)
