"""Slow, plain twins of the compiled kernels, written from the formulas and from nothing of ours."""

import math

import numpy as np


def pixel(image, x, y, c):
    """Bilinear value of image (H, W, 3) at (x, y); outside, the nearest border pixel."""
    height, width = image.shape[:2]
    x0, y0 = math.floor(x), math.floor(y)
    value = 0.0
    for yy, wy in ((y0, y0 + 1 - y), (y0 + 1, y - y0)):
        for xx, wx in ((x0, x0 + 1 - x), (x0 + 1, x - x0)):
            value += wx * wy * float(image[min(max(yy, 0), height - 1), min(max(xx, 0), width - 1), c])
    return value


def window(image, x, y, w, h):
    """(h, w, 3) pixels centred at (x, y)."""
    return np.array(
        [
            [[pixel(image, x - (w - 1) / 2 + j, y - (h - 1) / 2 + i, c) for c in range(3)] for j in range(w)]
            for i in range(h)
        ]
    )


def rho(u, robust, scale):
    """The robust functions: |u| near zero or far out in all of them, with `scale` where they bend."""
    a = abs(u)
    if robust == "l1":
        return a
    if robust == "huber":
        return u * u / (2 * scale) if a <= scale else a - scale / 2
    if robust == "tukey":
        return scale * (1 - (1 - (u / scale) ** 2) ** 3) if a <= scale else scale
    if robust == "geman_mcclure":
        return scale * u * u / (scale * scale + u * u)
    raise ValueError(robust)


def colour_ratio_distance(image, template, x, y, robust="l1", scale=0.2, least_mean=1.0, norm="channel"):
    """Eq. 8 and 9: `template` (h, w, 3) as seen, not divided by its mean; `norm` as in the recipe."""
    h, w = template.shape[:2]
    q = window(image, x, y, w, h)
    c = template / max(template.mean(), least_mean) - q / max(q.mean(), least_mean)
    pixels = [[rho(v, robust, scale) for v in colour] for colour in c.reshape(-1, 3)]
    return float(np.mean([sum(each) / (3 if norm == "channel" else 1) for each in pixels]))
