"""Slow plain twins of the gallery: eq. 14 and 16 point by point, differences one by one, figure 1 in plain numbers."""

import math


def log_density(y, mean, vectors, values, rho):
    """Log of eq. 14 for one patch: a list of numbers each, `vectors` a list of directions."""
    d, s = len(mean), len(values)
    x = [y[i] - mean[i] for i in range(d)]
    q = [sum(e[i] * x[i] for i in range(d)) for e in vectors]
    total = 0.0
    for k in range(s):
        total -= 0.5 * q[k] ** 2 / values[k] + 0.5 * math.log(2 * math.pi * values[k])
    if s < d:
        error = sum(v * v for v in x) - sum(v * v for v in q)
        total -= error / (2 * rho) + 0.5 * (d - s) * math.log(2 * math.pi * rho)
    return total


def log_ratio(y, face, intra, extra):
    """Log of eq. 16 for one patch and one identity; the spaces are (mean, vectors, values, rho)."""
    difference = [a - b for a, b in zip(y, face, strict=True)]
    return log_density(difference, *intra) - log_density(difference, *extra)


def normalised(patch):
    mean = sum(patch) / len(patch)
    spread = math.sqrt(sum((v - mean) ** 2 for v in patch) / len(patch))
    return [(v - mean) / spread for v in patch]


def stand_in(pictures):
    if len(pictures) == 1:
        return list(pictures[0])
    return normalised([sum(values) / len(pictures) for values in zip(*pictures, strict=True)])


def minus(a, b):
    return [x - y for x, y in zip(a, b, strict=True)]


def to_own(people):
    """Differences of each image to what the other images of its person make up; people: lists of images."""
    return [
        minus(picture, stand_in(pictures[:k] + pictures[k + 1 :]))
        for pictures in people for k, picture in enumerate(pictures) if len(pictures) > 1
    ]  # fmt: skip


def to_others(people):
    return [
        minus(picture, stand_in(other))
        for p, pictures in enumerate(people) for picture in pictures for q, other in enumerate(people) if q != p
    ]  # fmt: skip


def figure_1(beta, p_a, p_f, p_n, switch=0.0):
    """Weights w (J,) and beta (L,) after a frame; p_a and p_f (J,), p_n (J, L), each in plain numbers."""
    n = len(beta)
    if switch:
        stays = [(1 - switch) * b for b in beta]
        comes = [switch / (n - 1) * sum(beta[:k] + beta[k + 1 :]) for k in range(n)]
        beta = [a + b for a, b in zip(stays, comes, strict=True)]
    alpha = [[beta[k] * p_a[j] * (p_f[j] * p_n[j][k] + (1 - p_f[j]) / n) for k in range(n)] for j in range(len(p_a))]
    total = sum(map(sum, alpha))
    return [sum(row) / total for row in alpha], [sum(row[k] for row in alpha) / total for k in range(n)]
