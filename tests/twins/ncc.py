"""Slow, plain twins of kernels/ncc.py and of eq. 9 and 10, written from the formulas and from nothing of ours."""

import math


def pixel(picture, x, y):
    """Bilinear value at (x, y), 0 beyond the image (H, W)."""
    height, width = len(picture), len(picture[0])
    value = 0.0
    for j, wy in ((math.floor(y), 1 - y % 1), (math.floor(y) + 1, y % 1)):
        for i, wx in ((math.floor(x), 1 - x % 1), (math.floor(x) + 1, x % 1)):
            if 0 <= i < width and 0 <= j < height:
                value += wx * wy * float(picture[j][i])
    return value


def patch(picture, u, v, s, th, tw):
    """The values under a template whose first point lies at (u, v), s pixels from point to point."""
    return [[pixel(picture, u + j * s, v + i * s) for j in range(tw)] for i in range(th)]


def cross(picture, template, u, v, s):
    """sum T I."""
    seen = patch(picture, u, v, s, len(template), len(template[0]))
    return sum(float(t) * p for row, line in zip(template, seen, strict=True) for t, p in zip(row, line, strict=True))


def overlap(low, high, i):
    """How much of pixel i, which covers [i - 1/2, i + 1/2], lies between low and high."""
    return max(min(high, i + 0.5) - max(low, i - 0.5), 0.0)


def area_sum(picture, x0, y0, x1, y1, power=1):
    """Sum over a box of fractional edges, each pixel by its share."""
    return sum(
        overlap(y0, y1, j) * overlap(x0, x1, i) * float(value) ** power
        for j, row in enumerate(picture)
        if overlap(y0, y1, j) > 0
        for i, value in enumerate(row)
    )


def ncc(template, seen, remove=False):
    """Eq. 10 of two patches of the same shape; their means removed first, if they are to be."""
    t, p = [[float(value) for row in one for value in row] for one in (template, seen)]
    if remove:
        t, p = ([value - sum(one) / len(one) for value in one] for one in (t, p))
    product = sum(a * b for a, b in zip(t, p, strict=True))
    return product / math.sqrt(sum(a * a for a in t) * sum(b * b for b in p))


def regions(cx, cy, s, width, height):
    """The inner box and the one with twice its area about the same centre: edges x0, y0, x1, y1."""
    found = []
    for times in (1.0, math.sqrt(2.0)):
        w, h = width * s * times / 2, height * s * times / 2
        found.append((cx - w, cy - h, cx + w, cy + h))
    return found


def rho(skin, inner, outer):
    """Eq. 9 by the area of the inner box, of a map (H, W) in 0..1."""
    within = area_sum(skin, *inner)
    around = area_sum(skin, *outer) - within
    return (around - within) / ((inner[2] - inner[0]) * (inner[3] - inner[1]))
