"""The colour of one person's skin, learned from the face's box (Gonzalez & Collet, section 3, eq. 4).

    pixels of the box that pass the rules of Kovac, Peer & Solina (EUROCON 2003)      a rough sample of skin
    mu_S, Sigma_S: mean and covariance of their (Cb, Cr)                                                (eq. 4)
    p(c | skin) = exp(-(c - mu_S)' Sigma_S^-1 (c - mu_S) / 2)        without the factor that makes it a density

so that p is 1 at the mean whatever the spread. Two things are ours. The spread of Sigma_S is kept above a floor in
every direction, or skin of one flat colour would be found nowhere else. And the rules know neither very dark nor very
pale skin: when too few pixels pass, the colour is learned from the box itself, and `note` says so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.errors import InputError
from facetrack_cli.types import Array, Box, Frame, Image

Mask: TypeAlias = NDArray[np.bool_]

LEAST_SHARE = 0.3
LEAST_VARIANCE = 4.0  # of Cb and Cr in any direction, in levels squared


@dataclass(frozen=True, eq=False)
class SkinModel:
    """A Gaussian on (Cb, Cr): mean (2,), cov (2, 2); full-range BT.601 of 8 bits, as OpenCV has it.

    `table` (256, 256) is 255 p, rounded, at [Cb, Cr]; `share` of the box's pixels passed Kovac's rules; `fallback`: too
    few, so that the box itself was the sample.
    """

    mean: Array
    cov: Array
    table: NDArray[np.uint8]
    share: float
    fallback: bool


def kovac(bgr: Image) -> Mask:
    """Which pixels of bgr (H, W, 3) are skin by the rules for daylight or those for flashlight -> (H, W)."""
    b, g, r = (bgr[..., c].astype(np.int16) for c in range(3))
    spread = bgr.max(axis=2).astype(np.int16) - bgr.min(axis=2)
    daylight = (r > 95) & (g > 40) & (b > 20) & (spread > 15) & (r - g > 15) & (r > b)
    flashlight = (r > 220) & (g > 210) & (b > 170) & (np.abs(r - g) <= 15) & (b < r) & (b < g)
    return np.asarray(daylight | flashlight, np.bool_)


def learn_skin(frame: Frame, box: Box, *, least_share: float = LEAST_SHARE) -> SkinModel:
    """The colour of the skin in a box (left, top, width, height; pixels), which may stick out of the picture.

    The box itself is the sample when less than `least_share` of its pixels pass Kovac's rules: 0 never, above 1 always.
    Raises InputError if nothing of the box is in the picture.
    """
    region = _inside(frame, box)
    passed = kovac(region)
    share = float(passed.mean())
    fallback = share < least_share or not passed.any()
    colours = cv2.cvtColor(region, cv2.COLOR_BGR2YCrCb)[..., [2, 1]].astype(np.float64)
    sample = colours.reshape(-1, 2) if fallback else colours[passed]
    mean = sample.mean(axis=0)
    off = sample - mean
    spread, axes = np.linalg.eigh(off.T @ off / len(sample))
    cov = (axes * np.maximum(spread, LEAST_VARIANCE)) @ axes.T
    return SkinModel(mean, cov, _table(mean, cov), share, fallback)


def note(model: SkinModel) -> str | None:
    """What the user should know of how the colour was learned, in one line; None if there is nothing."""
    if not model.fallback:
        return None
    return (
        f"only {model.share:.0%} of the face's box have the colour that skin has by Kovac's rules, "
        "so the colour of all of the box is taken for skin; what else has that colour may draw the track away"
    )


def _inside(frame: Frame, box: Box) -> Image:
    """The pixels whose centres the box covers, at least one."""
    width, height = frame.size
    left, right = _span(box[0], box[2], width)
    top, bottom = _span(box[1], box[3], height)
    if right <= left or bottom <= top:
        raise InputError(
            f"frame {frame.index}: the box {','.join(f'{v:g}' for v in box)} is not in the picture of "
            f"{width}x{height} pixels; give left, top, width and height in pixels of the frame"
        )
    return frame.bgr[top:bottom, left:right]


def _span(start: float, length: float, count: int) -> tuple[int, int]:
    first = math.ceil(min(max(start - 0.5, -1.0), count))
    last = math.ceil(min(max(start + length - 0.5, -1.0), count))
    return max(first, 0), min(max(last, first + 1), count)


def _table(mean: Array, cov: Array) -> NDArray[np.uint8]:
    levels = np.arange(256.0)
    d = np.stack(np.meshgrid(levels - mean[0], levels - mean[1], indexing="ij"), axis=-1)
    squared = np.einsum("...i,ij,...j", d, np.linalg.inv(cov), d)
    return np.asarray(np.rint(255 * np.exp(-squared / 2)), np.uint8)
