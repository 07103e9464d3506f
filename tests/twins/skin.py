"""Slow, plain twins of skin and pattern, written from the formulas and from nothing of ours."""

import math


def rounded(b, g, r):
    """The same in 8 bits, as OpenCV rounds: 14 bits after the point, luma rounded before chroma is made of it."""

    def whole(value):
        return math.floor(value / 2**14 + 0.5)

    y = whole(4899 * r + 9617 * g + 1868 * b)
    return y, *(min(max(whole(k * d) + 128, 0), 255) for k, d in ((9241, b - y), (11682, r - y)))


def kovac(b, g, r):
    """Skin at daylight, or under flashlight, by Kovac, Peer & Solina 2003."""
    if r > 95 and g > 40 and b > 20 and max(r, g, b) - min(r, g, b) > 15 and abs(r - g) > 15 and r > g and r > b:
        return True
    return r > 220 and g > 210 and b > 170 and abs(r - g) <= 15 and r > b and g > b


def probability(colour, mean, cov):
    """exp(-d^2 / 2) with the Mahalanobis distance d of (Cb, Cr)."""
    (a, b), (_, c) = cov
    u, v = colour[0] - mean[0], colour[1] - mean[1]
    return math.exp(-(c * u * u - 2 * b * u * v + a * v * v) / (a * c - b * b) / 2)


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
