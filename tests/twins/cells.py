"""Slow, plain twins of trackers/box/box_kernels.py, written from the formulas and from nothing of ours."""

import math

import numpy as np

from tests.twins.images import bilinear


def window(image, x, y, across, down, shape):
    """`image`, 0..1, at the `shape` (H, W) pixels' centres of a window `across` x `down` around (x, y)."""
    rows, columns = shape
    return np.array(
        [
            [
                bilinear(image, x + (j - (columns - 1) / 2) * across / columns, y + (i - (rows - 1) / 2) * down / rows)
                / 255
                for j in range(columns)
            ]
            for i in range(rows)
        ]
    )


def orientation(dx, dy):
    """Which of 18 directions, 20 degrees apart, is nearest to (dx, dy); of two as near, the one of less degrees."""
    along = [math.cos(k * math.pi / 9) * dx + math.sin(k * math.pi / 9) * dy for k in range(9)]
    k = next(k for k in range(9) if abs(along[k]) >= max(map(abs, along)) * (1 - 1e-9))
    return k if along[k] > 0 else k + 9


def gradients(grey, cell):
    """(31, H / cell, W / cell): Felzenszwalb et al. 2010, section 6.1; cells beyond the border take votes as well."""
    height, width = grey.shape
    rows, columns = height // cell, width // cell
    votes = {(i, j): [0.0] * 18 for i in range(-1, rows + 1) for j in range(-1, columns + 1)}
    for y in range(height):
        for x in range(width):
            dx = grey[y, min(x + 1, width - 1)] - grey[y, max(x - 1, 0)]
            dy = grey[min(y + 1, height - 1), x] - grey[max(y - 1, 0), x]
            k, size = orientation(dx, dy), math.hypot(dx, dy)
            v, u = (y + 0.5) / cell - 0.5, (x + 0.5) / cell - 0.5
            for i in (math.floor(v), math.floor(v) + 1):
                for j in (math.floor(u), math.floor(u) + 1):
                    votes[i, j][k] += (1 - abs(v - i)) * (1 - abs(u - j)) * size
    energy = {at: sum((of[k] + of[k + 9]) ** 2 for k in range(9)) for at, of in votes.items()}
    out = np.zeros((31, rows, columns))
    for i in range(rows):
        for j in range(columns):
            of = votes[i, j]
            for corner, (down, right) in enumerate([(-1, -1), (-1, 1), (1, -1), (1, 1)]):
                four = sum(energy[a, b] for a in (i, i + down) for b in (j, j + right))
                norm = math.sqrt(four + 1e-4)
                signed = [min(value / norm, 0.2) for value in of]
                out[:18, i, j] += [0.5 * value for value in signed]
                out[18:27, i, j] += [0.5 * min((of[k] + of[k + 9]) / norm, 0.2) for k in range(9)]
                out[27 + corner, i, j] = 0.2357 * sum(signed)
    return out


def colours(image, target, around):
    """(H * W,) colours and (H * W,) probabilities of the target, from an image (H, W, 3)."""
    bins = [sum((int(v) // 8) * 32**k for k, v in enumerate(pixel[::-1])) for pixel in image.reshape(-1, 3)]
    both = [float(target[k]) + float(around[k]) for k in bins]
    return bins, [float(target[k]) / total if total else 0.5 for k, total in zip(bins, both, strict=True)]


def tally(histogram, bins, part, rate):
    """The histogram moved by `rate` towards that of the pixels `part`."""
    of = [bins[n] for n in part]
    return [(1 - rate) * before + rate * of.count(k) / len(part) for k, before in enumerate(histogram)]


def highest(response, least):
    """(row, column) of all that are at least `least` and no lower than their eight neighbours, the highest first."""
    inner = [(i, j) for i in range(1, len(response) - 1) for j in range(1, len(response[0]) - 1)]
    tops = [(i, j) for i, j in inner if response[i, j] >= max(least, response[i - 1 : i + 2, j - 1 : j + 2].max())]
    return sorted(tops, key=lambda at: -response[at])


def project(components, features, taper):
    """(C, M): each component's sum over the features (L, M), times the taper (M,)."""
    return np.array(
        [
            [taper[m] * sum(a * features[k, m] for k, a in enumerate(row)) for m in range(features.shape[1])]
            for row in components
        ]
    )


def complexes(x):
    """(C, F) complex numbers from (2, C, F)."""
    return x[0].astype(float) + 1j * x[1].astype(float)


def matrices(memory, channels):
    """(F, C, C): the Hermitian matrices whose upper triangles, by rows, are `memory` (P, 2, F)."""
    whole = np.zeros((memory.shape[2], channels, channels), complex)
    above = [(i, j) for i in range(channels) for j in range(i, channels)]
    for (i, j), entry in zip(above, memory, strict=True):
        whole[:, i, j] = entry[0] + 1j * entry[1]
        whole[:, j, i] = np.conj(whole[:, i, j])
    return whole


def multiply(whole, v):
    """(C, F): each frequency's matrix times v."""
    z = complexes(v)
    return np.stack([m @ z[:, f] for f, m in enumerate(whole)], axis=1)


def cubic(p, t):
    """Catmull and Rom's curve through p[1] and p[2] at t, 0..1."""
    a, b, c, d = p
    return 0.5 * (2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * b - a - 3 * c + d) * t**3)


def read_cubic(values, x, y):
    """`values` (H, W) at (x, y) by that curve, along rows and then down; indices beyond the border are those on it."""
    rows, columns = values.shape
    x, y = min(max(x, 0.0), columns - 1.0), min(max(y, 0.0), rows - 1.0)
    i, j = math.floor(y), math.floor(x)
    across = [
        cubic(
            [float(values[min(max(r, 0), rows - 1), min(max(c, 0), columns - 1)]) for c in range(j - 1, j + 3)], x - j
        )
        for r in range(i - 1, i + 3)
    ]
    return cubic(across, y - i)
