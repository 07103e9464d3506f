"""Slow, plain twins of windows and shape priors, written from the formulas and from nothing of ours."""

import math

import numpy as np

from tests.twins.images import bilinear


def window(image, x, y, w, h):
    """(h, w, 3) pixels of image (H, W, 3) centred at (x, y); outside, the nearest border pixel."""
    left, top = x - (w - 1) / 2, y - (h - 1) / 2
    return np.array(
        [[[bilinear(image[..., c], left + j, top + i) for c in range(3)] for j in range(w)] for i in range(h)]
    )


def colour_ratio_distance(image, template, x, y, least_mean=1.0):
    """Eq. 8 and 9: `template` (h, w, 3) as seen, not divided by its mean."""
    h, w = template.shape[:2]
    q = window(image, x, y, w, h)
    c = template / max(template.mean(), least_mean) - q / max(q.mean(), least_mean)
    return float(np.abs(c).mean())


def registered(x, parts, first, stable, width):
    """q (P, 2) in kernel widths of one hypothesis x (K, 2)."""
    moved = [x[k] - first[k] for k in range(len(x))]
    reference = moved[stable] if stable >= 0 else sum(moved[k] for k in parts) / len(parts)
    return np.array([(moved[k] - reference) / width for k in parts])


def exponents(x, parts, first, stable, width, shapes):
    """-|q - h_j|^2 / 2 for each of shapes (M, P, 2), which are in kernel widths."""
    q = registered(x, parts, first, stable, width)
    return [-0.5 * sum((q[i, c] - h[i, c]) ** 2 for i in range(len(parts)) for c in (0, 1)) for h in shapes]


def log_parzen(x, parts, first, stable, width, shapes):
    out = []
    for one in x:
        e = exponents(one, parts, first, stable, width, shapes)
        top = max(e)
        out.append(top + math.log(sum(math.exp(v - top) for v in e)))
    return np.array(out)


def pick_shape(x, parts, first, stable, width, shapes, u):
    out = []
    for one, uniform in zip(x, u, strict=True):
        e = exponents(one, parts, first, stable, width, shapes)
        weights = [math.exp(v - max(e)) for v in e]
        reached = [sum(weights[: j + 1]) for j in range(len(weights))]
        out.append(min(j for j in range(len(weights)) if reached[j] > uniform * reached[-1]))
    return np.array(out)


def log_student(x, parts, first, stable, length, shapes, freedom, narrowest):
    """Of hypotheses x (N, K, 2); shapes (M, P, 2) are those of the moving parts, in units of `length`."""
    d = 2 * len(parts)
    c = [[narrowest**2 * (i == j) for j in range(d)] for i in range(d)]
    for h in shapes:
        flat = [h[k][axis] for k in range(len(parts)) for axis in (0, 1)]
        for i in range(d):
            for j in range(d):
                c[i][j] += flat[i] * flat[j] / len(shapes)
    out = []
    for one in x:
        q = registered(one, parts, first, stable, length).ravel()
        squared = float(q @ np.linalg.solve(np.array(c), q))
        out.append(-(freedom + d) / 2 * math.log(1 + squared / freedom))
    return np.array(out)
