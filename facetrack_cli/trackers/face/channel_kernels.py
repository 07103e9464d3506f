# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""Gradients by direction and further channels of an image, smoothed."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.engine.kernels.compiled import fast

Single: TypeAlias = NDArray[np.float32]
_ZERO, _ONE, _TWO, _THREE, _FOUR, _FIVE = (np.float32(k) for k in range(6))
_ALL = np.float32(1 / 625)
_FLAT, _TINY = np.float32(0.02), np.float32(1e-6)


def smoothed_channels(across: Single, down: Single, size: Single, rms: Single, ways: Single, others: Single) -> Single:
    """(H, W, D + C): in D directions `ways` (D, 2), and the `others` (C, H, W), each twice the mean over 5x5 pixels.

    A gradient (`across`, `down`) (H, W) of length `size` counts in a direction with the square of its share along it,
    over `size` and over `rms`, the usual length around. H and W are 5 or more; the border reflects.
    """
    height, width = size.shape
    count = len(ways) + len(others)
    planes, row = np.empty((height, count, width), np.float32), np.empty((count, width), np.float32)
    out = np.empty((height, width, count), np.float32)
    _channels(across, down, size, rms, ways, others, planes, row, np.empty((2, width + 8), np.float32), out)
    return out


@fast
def _channels(across, down, size, rms, ways, others, planes, row, line, out):
    height, width = size.shape
    directions = len(ways)
    count = directions + len(others)
    for y in range(height):
        for k in range(directions):
            u, v, plane = ways[k, 0], ways[k, 1], planes[y, k]
            for x in range(width):
                along = max(u * across[y, x] + v * down[y, x], _ZERO)
                plane[x] = along * along / (size[y, x] * (rms[y, x] + _FLAT) + _TINY)
        for k in range(directions, count):
            for x in range(width):
                planes[y, k, x] = others[k - directions, y, x]
    # two means over 5 pixels are a sum with weights 1 2 3 4 5 4 3 2 1
    padded, values = line[0], line[1]
    flat = row.ravel()
    for y in range(height):
        middle = planes[y].ravel()
        for x in range(len(flat)):
            flat[x] = _FIVE * middle[x]
        for d in range(1, 5):
            weight, upper = np.float32(5 - d), planes[abs(y - d)].ravel()
            lower = planes[height - 1 - abs(height - 1 - y - d)].ravel()
            for x in range(len(flat)):
                flat[x] += weight * (upper[x] + lower[x])
        for k in range(count):
            for x in range(width):
                padded[x + 4] = row[k, x]
            for d in range(1, 5):
                padded[4 - d], padded[width + 3 + d] = row[k, d], row[k, width - 1 - d]
            for x in range(width):
                near = _FIVE * padded[x + 4] + _FOUR * (padded[x + 3] + padded[x + 5])
                near += _THREE * (padded[x + 2] + padded[x + 6]) + _TWO * (padded[x + 1] + padded[x + 7])
                values[x] = (near + padded[x] + padded[x + 8]) * _ALL
            for x in range(width):
                out[y, x, k] = values[x]
