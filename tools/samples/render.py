"""One frame of a clip: the portrait warped, lit, and seen by a sensor; and the ground truth that goes with it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from portraits import MARGIN, PARTS, Picture, Portrait
from timeline import Array, smoothstep
from warp import Moment, to_picture, to_skin, to_skull

SIZE = (320, 240)


def truth(portrait: Portrait, m: Moment) -> dict[str, tuple[float, float]]:
    """Where the five parts are in the image, in pixels."""
    out = {}
    for part in PARTS:
        p = np.array([portrait.anatomy.points[part]])
        x, y = to_picture(p, part == "lip_lower", portrait.anatomy, m, portrait.origin)[0]
        out[part] = (float(x), float(y))
    return out


def _sample(picture: Picture, p: Array) -> Picture:
    grid = (p + MARGIN).reshape(SIZE[1], SIZE[0], 2).astype(np.float32)
    out = cv2.remap(picture, grid[..., 0], grid[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(out, dtype=np.float32)


def _coverage(depth: Array) -> Array:
    """(n,) 0..1 how far each pixel is covered by what has its edge at depth 0, and half a pixel more."""
    grid = depth.reshape(SIZE[1], SIZE[0])
    slope = np.hypot(*np.gradient(grid)).ravel()
    return np.clip(1.0 + depth / np.maximum(slope, 0.2), 0.0, 1.0)


def face(portrait: Portrait, m: Moment) -> tuple[Picture, Array, Array]:
    """The warped portrait (H, W, 3), and each pixel's point of the portrait, (H, W, 2), above and below the lips."""
    a = portrait.anatomy
    y, x = np.mgrid[: SIZE[1], : SIZE[0]].astype(np.float64)
    skull = to_skull(np.stack([x.ravel(), y.ravel()], axis=1), a, m, portrait.origin)
    above, below = to_skin(skull, False, a, m), to_skin(skull, True, a, m)
    covered = _coverage(a.edges(above[:, 0])[0] - above[:, 1])
    filled = _coverage(below[:, 1] - a.edges(below[:, 0])[1])
    # beyond the corners both branches are one skin, and nothing may shine through
    filled = np.maximum(filled, smoothstep((np.abs(a.across(below[:, 0])) - 0.96) / 0.05))
    over = covered.reshape(SIZE[1], SIZE[0], 1)
    under = filled.reshape(SIZE[1], SIZE[0], 1)
    out = _sample(portrait.mouth, skull) * (1 - under) + _sample(portrait.skin, below) * under
    out = out * (1 - over) + _sample(portrait.skin, above) * over
    shape = (SIZE[1], SIZE[0], 2)
    return out.astype(np.float32), above.reshape(shape), below.reshape(shape)


def expose(scene: Picture, strength: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    """The scene under light of the given strength, with the noise of a sensor, as 8-bit BGR."""
    seen = scene * strength
    noise = rng.normal(0.0, 1.0, seen.shape) * np.sqrt(0.5 + 0.008 * np.clip(seen, 0, 255))
    out: NDArray[np.uint8] = np.clip(np.rint(seen + noise), 0, 255).astype(np.uint8)
    return out
