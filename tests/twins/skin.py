"""Slow, plain twins of the skin kernels and of Kovac's rules, written from the formulas and from nothing of ours."""

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


def box_sum(values, box):
    """The sum of a map over (x0, y0, x1, y1): each pixel by the area of it that the box covers."""
    x0, y0, x1, y1 = box
    total = 0.0
    for i, row in enumerate(values):
        for j, value in enumerate(row):
            across = min(x1, j + 0.5) - max(x0, j - 0.5)
            down = min(y1, i + 0.5) - max(y0, i - 0.5)
            if across > 0 and down > 0:
                total += across * down * float(value)
    return total
