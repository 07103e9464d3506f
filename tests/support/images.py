"""Frames of images made by hand, and particles as rows of (cx, cy, s)."""

import cv2
import numpy as np

from facetrack_cli.core.types import Frame


def frame(bgr, index=0):
    return Frame(index, 0.0, bgr)


def grey(values):
    """An image of grey levels (H, W), as three channels that turn into the same grey again."""
    return frame(np.repeat(np.clip(values, 0, 255).round().astype(np.uint8)[..., None], 3, axis=2))


def states(places):
    """(N, 1, 6) from rows of (cx, cy) or (cx, cy, s); the speeds do not matter, so they are wild."""
    places = np.atleast_2d(np.asarray(places, float))
    s = places[:, 2:] if places.shape[1] == 3 else np.ones((len(places), 1))
    return np.concatenate([places[:, :2], s, np.full((len(places), 3), 1e6)], axis=1)[:, None]


def smooth(seed, height=120, width=160, sigma=2.0):
    """(height, width) of random blobs around 128."""
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(0, 1, (height, width)), (0, 0), sigma)
    return 128 + noise * (45 / noise.std())
