"""Layers of an image, premultiplied BGR and alpha: one over another, FINE times finer and reduced, seen in a box."""

from __future__ import annotations

import cv2
import numpy as np
from portraits import Picture
from render import SIZE
from timeline import Array


def over(under: Picture, layer: Picture) -> Picture:
    """An image (H, W, 3), or a layer (H, W, 4), with a layer (H, W, 4) before it."""
    out: Picture = under * (1 - layer[..., 3:]) + layer[..., : under.shape[2]]
    return out


def reduced(fine: Picture) -> Picture:
    """An image FINE times too large, by area means."""
    return np.asarray(cv2.resize(fine, SIZE, interpolation=cv2.INTER_AREA), dtype=np.float32)


def inside(box: tuple[float, float, float, float]) -> Picture:
    """How much of each pixel is in the box (middle, width, height), (H, W) 0..1."""

    def along(n: int, middle: float, length: float) -> Array:
        k = np.arange(n)
        both = np.minimum(k + 0.5, middle + length / 2) - np.maximum(k - 0.5, middle - length / 2)
        return np.asarray(np.clip(both, 0, 1), dtype=np.float64)

    x, y, w, h = box
    return np.asarray(np.outer(along(SIZE[1], y, h), along(SIZE[0], x, w)), dtype=np.float32)
