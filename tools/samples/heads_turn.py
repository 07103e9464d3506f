"""A head that turns within its outline: the portrait's head laid round a body of revolution, with hair for its back.

What the portrait does not show, from some 55 degrees on either side of its middle, is drawn from what it shows next
to that: hair above, and below it the skin of the neck. The outline stays, but for the jaw, which goes a little along.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from heads_cutout import Cutout, spread
from portraits import Picture
from timeline import Array, smoothstep

_PER_DEGREE = 3  # columns of the unrolled head
_SEEN = 68.0  # degrees to either side that the portrait shows well enough


@dataclass(frozen=True)
class Turning:
    """The head unrolled: BGR by height (the portrait's rows) and longitude, and the alpha of its outline (H, W)."""

    unrolled: Picture
    alpha: Picture

    def at(self, yaw: float) -> Picture:
        """The head turned by `yaw` radians, positive to the right of the image: BGR times alpha, and alpha."""
        y, x = _grid(self.alpha.shape)
        middle, half = _body(y)
        shift = 19.0 * np.sin(yaw) * smoothstep((y - 112) / 42) * (1 - smoothstep((y - 170) / 18))
        longitude = np.arcsin(np.clip((x - shift - middle) / half, -1, 1)) - yaw
        longitude = np.degrees((longitude + np.pi) % (2 * np.pi))
        colour = cv2.remap(self.unrolled, (longitude * _PER_DEGREE).astype(np.float32), y.astype(np.float32),
                           cv2.INTER_CUBIC, borderMode=cv2.BORDER_WRAP)  # fmt: skip
        alpha = cv2.remap(self.alpha, (x - shift).astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
        out: Picture = np.dstack([colour * alpha[..., None], alpha]).astype(np.float32)
        return out


def _grid(shape: tuple[int, ...]) -> tuple[Array, Array]:
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    return y, x


def _body(y: Array) -> tuple[Array, Array]:
    """The middle and the half width, in the portrait's pixels, of the body that the head is laid round."""
    low = smoothstep((y - 106) / 46)
    dome = 76.0 * np.sqrt(np.clip(1.0 - ((95.0 - y) / 82.0) ** 2, 0.05, 1.0))
    return 227.0 - 4.0 * low, np.where(y < 95, dome, 76.0 - 29.0 * low)


def _wobble(shape: tuple[int, int], seed: int) -> Array:
    """Smooth noise in -1..1 that closes round the head."""
    thrice = np.tile(np.random.default_rng(seed).normal(0, 1, shape), (1, 3))
    smooth = cv2.GaussianBlur(thrice, (0, 0), 14.0)[:, shape[1] : 2 * shape[1]]
    return np.asarray(smooth / np.abs(smooth).max(), dtype=np.float64)


def _hair(shape: tuple[int, int]) -> Array:
    """Strands that fall a little askew, as a factor about 1, the finer ones on the coarser."""
    out = np.ones(shape)
    y, x = _grid(shape)
    for seed, wide, strength in ((33, 2.0, 0.11), (34, 5.0, 0.08), (35, 22.0, 0.05)):
        raw = np.tile(np.random.default_rng(seed).normal(0, 1, shape), (1, 3))
        fine = cv2.GaussianBlur(raw, (0, 0), sigmaX=wide, sigmaY=9.0 + wide)[:, shape[1] : 2 * shape[1]]
        askew = x + 26.0 * _wobble(shape, seed + 10) + 0.25 * (y - 60.0) * np.sin(np.radians(x / _PER_DEGREE))
        fell = cv2.remap(fine / fine.std(), (askew % shape[1]).astype(np.float32), y.astype(np.float32),
                         cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)  # fmt: skip
        out += strength * fell
    return np.clip(out, 0.4, 1.6)


def unroll(cutout: Cutout) -> Turning:
    """The head of the cutout, laid round."""
    alpha = cutout.head[..., 3]
    flat = (cutout.head[..., :3] / np.maximum(alpha, 1e-3)[..., None]).astype(np.float32)
    flat = spread(flat, (alpha > 0.98).astype(np.float32))
    shape = (alpha.shape[0], 360 * _PER_DEGREE)
    y, column = _grid(shape)
    longitude = column / _PER_DEGREE - 180.0
    away = np.abs(longitude)
    middle, half = _body(y)
    shown = np.radians(np.clip(longitude, -_SEEN, _SEEN))
    front = cv2.remap(flat, (middle + half * np.sin(shown)).astype(np.float32), y.astype(np.float32), cv2.INTER_CUBIC)
    sides = front[:, (away[0] > _SEEN - 20) & (away[0] < _SEEN - 4)].mean(axis=1, keepdims=True)
    rows = cv2.GaussianBlur(np.repeat(sides, 3, axis=1), (0, 0), 5.0)[:, 1]
    strands = _hair(shape)
    end = 121.0 + 3.5 * np.sin(np.radians(longitude)) + 3.0 * _wobble(shape, 36) + 9.0 * (strands - 1.0)
    below = smoothstep((y - end + 2.0) / 4.0)[..., None]
    hair = rows[np.minimum(np.arange(shape[0]), 108)][:, None] * strands[..., None]
    nape = rows[158] * (0.62 + 0.18 * smoothstep((y - 124.0) / 30.0))[..., None]
    back = hair * (1 - below) + nape * below
    share = smoothstep((away + 5.0 * _wobble(shape, 37) - _SEEN + 10.0) / 10.0)[..., None]
    shade = 1 - 0.3 * smoothstep((away - 42.0) / 30.0) * smoothstep((y - 122) / 10) * (1 - share[..., 0])
    unrolled: Picture = np.clip(front * (1 - share) * shade[..., None] + back * share, 0, 255).astype(np.float32)
    return Turning(unrolled, np.asarray(alpha, dtype=np.float32))
