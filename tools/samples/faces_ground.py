"""What is behind the faces: a papered wall with an image on it, and a wall of painted bricks, in cool colours.

Drawn from fixed seeds, FINE times finer than the clips, (H * FINE, W * FINE, 3) BGR float32.
"""

from __future__ import annotations

import cv2
import numpy as np
from heads_grounds import FINE
from portraits import Picture
from timeline import Array


def _noise(rng: np.random.Generator, shape: tuple[int, int], sigma: float, strength: float) -> Array:
    raw = cv2.GaussianBlur(rng.normal(0.0, 1.0, shape), (0, 0), sigma)
    return np.asarray(raw / raw.std() * strength, dtype=np.float64)


def _hills(wide: int, high: int) -> Picture:
    """A framed image of green hills under a pale sky, in fine pixels."""
    out = np.empty((high, wide, 3), np.float32)
    out[:] = (66, 54, 46)
    rim = 4 * FINE
    v, u = np.mgrid[0 : 1 : (high - 2 * rim) * 1j, 0 : 1 : (wide - 2 * rim) * 1j]
    scene = np.array([206.0, 190.0, 172.0]) * (0.85 + 0.2 * v[..., None])
    for level, bend, bgr in ((0.48, 5.0, (150, 140, 104)), (0.62, 8.0, (112, 124, 78)), (0.78, 4.0, (70, 98, 58))):
        near = v > level + 0.08 * np.sin(bend * u + 9 * level) + 0.02 * np.sin(31 * u)
        scene = np.where(near[..., None], np.array(bgr, dtype=np.float64) * (1.25 - 0.4 * v[..., None]), scene)
    out[rim:-rim, rim:-rim] = scene
    return out


def papered_wall(width: int, height: int) -> Picture:
    """A wall papered in grey-blue, with fine stripes and small sprigs, and an image at the left; in clip pixels."""
    rng = np.random.default_rng(51)
    h, w = height * FINE, width * FINE
    y, x = np.mgrid[:h, :w].astype(np.float64) / FINE
    light = 1.05 - 0.22 * (y / height) - 0.12 * np.abs(x / width - 0.35)
    stripes = 0.028 * np.sign(np.sin(2 * np.pi * x / 17.0)) + 0.012 * np.sin(2 * np.pi * x / 2.3)
    u, v = np.mod(x, 17.0) - 4.25, np.mod(y + 11.0 * np.mod(np.floor(x / 17.0), 2), 22.0) - 11.0
    sprig = np.exp(-(((np.abs(u) + 0.6 * np.abs(v)) / 1.9) ** 4)) - 0.7 * np.exp(-(((u - 1) ** 2 + (v - 1) ** 2) / 0.8))
    tone = 1.0 + stripes - 0.12 * sprig + _noise(rng, (h, w), 0.8 * FINE, 0.018) + _noise(rng, (h, w), 12 * FINE, 0.02)
    out = np.array([176.0, 162.0, 142.0]) * (light * tone)[..., None]
    left, top, wide, high = 26 * FINE, 34 * FINE, 74 * FINE, 56 * FINE
    near = np.clip(np.minimum.reduce([x * FINE - left, left + wide - x * FINE, y * FINE - top, top + high - y * FINE])
                   + 8 * FINE, 0, 16 * FINE) / (16 * FINE)  # fmt: skip
    out *= (1 - 0.35 * cv2.GaussianBlur(near, (0, 0), 2 * FINE))[..., None]
    out[top : top + high, left : left + wide] = _hills(wide, high)
    return np.asarray(cv2.GaussianBlur(out.astype(np.float32), (0, 0), 0.5 * FINE), dtype=np.float32)


def brick_wall(width: int, height: int) -> Picture:
    """Bricks painted in grey-green, each a little different, with pale joints; in clip pixels."""
    rng = np.random.default_rng(52)
    h, w = height * FINE, width * FINE
    y, x = np.mgrid[:h, :w].astype(np.float64) / FINE
    x, y = x + _noise(rng, (h, w), 3 * FINE, 0.25), y + _noise(rng, (h, w), 3 * FINE, 0.25)
    long, high = 26.0, 11.0
    row = np.floor(y / high).astype(int)
    along = x + 0.5 * long * (row % 2) + 3 * long
    column = np.floor(along / long).astype(int)
    u, v = along - long * column, y - high * row
    deep = np.clip(np.minimum.reduce([u, long - u, v, high - v]) - 0.6, 0, 1.2) / 1.2  # 0 in the joints
    table = 1.0 + rng.normal(0, 0.055, (row.max() - row.min() + 1, column.max() + 1))
    own = table[row - row.min(), column]
    edge = 0.10 * np.exp(-(((v - 1.4) / 0.7) ** 2)) - 0.13 * np.exp(-(((v - high + 1.3) / 0.8) ** 2))
    grain = _noise(rng, (h, w), 0.7 * FINE, 0.035) + _noise(rng, (h, w), 9 * FINE, 0.03)
    brick = np.array([142.0, 150.0, 132.0]) * (own + edge + grain)[..., None]
    joint = np.array([122.0, 124.0, 116.0]) * (0.86 + grain)[..., None]
    out = joint * (1 - deep[..., None]) + brick * deep[..., None]
    out *= (1.08 - 0.2 * y / height - 0.1 * np.abs(x / width - 0.6))[..., None]
    return np.asarray(cv2.GaussianBlur(out.astype(np.float32), (0, 0), 0.45 * FINE), dtype=np.float32)
