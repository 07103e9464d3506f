"""How a quantity of the scene goes with time: key values joined smoothly, and trains of syllables."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Keys = Sequence[tuple[int, float]]


def smoothstep(u: Array) -> Array:
    """0 up to u = 0, 1 from u = 1 on, a cubic with level ends between."""
    u = np.clip(u, 0.0, 1.0)
    return u * u * (3.0 - 2.0 * u)


def track(keys: Keys, frames: int) -> Array:
    """(frames,) values that pass through the (frame, value) keys and rest for a moment at each."""
    out = np.full(frames, keys[0][1], dtype=np.float64)
    t = np.arange(frames, dtype=np.float64)
    for (t0, a), (t1, b) in pairwise(keys):
        inside = t >= t0
        out[inside] = a + (b - a) * smoothstep((t[inside] - t0) / (t1 - t0))
    return out


def unrest(rng: np.random.Generator, frames: int, strength: float, sigma: float) -> Array:
    """(frames, 2) how far what is held by hand strays from its smooth way, in pixels; smooth over `sigma` frames."""
    raw = cv2.GaussianBlur(rng.normal(0, 1, (frames + 40, 2)), (1, 0), sigmaX=0.1, sigmaY=sigma)[20:-20]
    return np.asarray(raw / raw.std() * strength, dtype=np.float64)


def syllables(rng: np.random.Generator, spans: Sequence[tuple[int, int]], frames: int) -> tuple[Array, Array]:
    """Talking in the frames of `spans`: (frames,) opening and (frames,) rounding of the mouth, each 0..1.

    Openings follow one another every 4 to 8 frames, 3 to 6 a second at 25 frames/s; the short ones are smaller,
    and about every third is rounded.
    """
    opening, rounding = np.zeros(frames), np.zeros(frames)
    t = np.arange(frames, dtype=np.float64)
    for first, last in spans:
        start = float(first)
        while True:
            length = rng.uniform(4.5, 8.3)
            if start + length > last:
                break
            u = np.clip((t - start) / length, 0.0, 1.0)
            bump = np.sin(np.pi * u) ** 2
            opening = np.maximum(opening, rng.uniform(0.5, 1.0) * min(1.0, length / 7.0) * bump)
            if rng.uniform() < 0.35:
                rounding = np.maximum(rounding, rng.uniform(0.5, 1.0) * bump)
            start += length * rng.uniform(0.75, 1.0)
    return opening, rounding
