"""Slow, plain twins of trackers/appearance/appearance.py: shift, noise and walk, from the formulas alone."""

import math

import numpy as np


def shift_matrix(x, rows, components, rank=1e-3):
    """B (6, d) of eq. 12: X V_q S_q^-1 U_q^T, of Y = U S V^T; x (J, 6) are X's columns and rows (J, d) are Y's."""
    u, s, v_t = np.linalg.svd(rows.T.astype(np.float64), full_matrices=False)
    b = np.zeros((x.shape[1], rows.shape[1]))
    for i in range(min(components, len(s))):
        if s[i] > rank * s[0] and s[i] > 1e-6:
            b += np.outer(x.T @ v_t[i] / s[i], u[:, i])
    return b


def products(rows):
    return [[sum(float(a) * float(b) for a, b in zip(p, q, strict=True)) for q in rows] for p in rows]


def eta(error, a, b, c):
    """Eq. 13."""
    return a + (b - a) * (math.exp(error / c) - math.exp(-error / c)) / (math.exp(error / c) + math.exp(-error / c))


def diffused(x, u, sigma, shift, noise, least, most):
    """One state (6,) after x + shift + noise u, u (6,) standard, along place, scale, turn, stretch and shear."""
    position, deform, turn, shear = sigma
    grow, turned, stretch, skew = (
        s * v / math.sqrt(2) for s, v in zip((deform, turn, shear, shear), u[2:], strict=True)
    )
    off = [position * u[0], position * u[1], grow + stretch, skew - turned, turned + skew, grow - stretch]
    cx, cy, *a = (v + s + noise * o for v, s, o in zip(x, shift, off, strict=True))
    scale = math.sqrt(sum(v * v for v in a) / 2)
    by = max(min(scale, most), least) / max(scale, 1e-12)
    return [cx, cy, *(v * by for v in a)]


def corners(state, size):
    """(4, 2) of a box of `size`, from the top left clockwise, at the middle of its outermost pixels."""
    cx, cy, a1, a2, a3, a4 = state
    x, y = (max(side - 1, 1) / 2 for side in size)
    return [(cx + a1 * u + a2 * v, cy + a3 * u + a4 * v) for u, v in ((-x, -y), (x, -y), (x, y), (-x, y))]
