"""A face on grounds of no skin colour."""

from functools import cache

import cv2
import numpy as np

from tests.support.images import frame, smooth, states
from tests.support.parts import skin_ncc

SIZE = (40.0, 48.0)
TRUTH = (101.5, 83.5)


@cache
def scene(centre=TRUTH, second=None, darker=1.0, noise=0.0, height=170, width=260):
    """A face of SIZE on grounds of no skin colour, with hair above and a neck below; perhaps another skin patch."""
    rng = np.random.default_rng(3)
    ground = smooth(1, height, width, 6)[..., None] * np.array([0.9, 0.8, 0.55])
    h, w = SIZE[1], SIZE[0]
    shades = np.random.default_rng(4).normal(0, 1, (height, width))
    shades = 6 * cv2.GaussianBlur(shades, (0, 0), 3) / 0.1

    def ellipse(place, half, colour, soft=0.0):
        mask = np.zeros((height, width), np.float32)
        at = (round(place[0] * 16), round(place[1] * 16))
        cv2.ellipse(mask, at, (round(half[0] * 16), round(half[1] * 16)), 0, 0, 360, 1.0, -1, cv2.LINE_AA, 4)
        mask = cv2.GaussianBlur(mask, (0, 0), 0.8 + soft)[..., None]
        ground[:] = ground * (1 - mask) + mask * (np.array(colour) + 0.4 * shades[..., None])

    skin = np.array([120.0, 150.0, 205.0])
    cx, cy = centre
    ellipse((cx, cy - 0.1 * h), (0.62 * w, 0.66 * h), (30, 35, 45))
    ellipse((cx, cy + 0.6 * h), (0.2 * w, 0.25 * h), 0.8 * skin)
    ellipse((cx, cy), (0.5 * w, 0.55 * h), skin)
    for side in (-1, 1):
        ellipse((cx + side * 0.22 * w, cy - 0.12 * h), (0.1 * w, 0.05 * h), (50, 45, 50))
        ellipse((cx + side * 0.22 * w, cy - 0.26 * h), (0.13 * w, 0.03 * h), (40, 50, 70))
    ellipse((cx, cy + 0.1 * h), (0.06 * w, 0.08 * h), 0.8 * skin)
    ellipse((cx, cy + 0.3 * h), (0.17 * w, 0.05 * h), (80, 70, 150))
    if second is not None:
        ellipse(second, (0.5 * w, 0.5 * h), skin)
    return np.clip(ground * darker + rng.normal(0, noise, ground.shape), 0, 255).round().astype(np.uint8)


def learned(bgr, centre=TRUTH, size=SIZE, **options):
    likelihood = skin_ncc(size, **options)
    return likelihood, likelihood.init(frame(bgr), states(centre)[0])
