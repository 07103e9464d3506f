"""A slow, plain twin of what many kernels do: they read an image between its pixels."""

import math


def bilinear(image, x, y):
    """Grey value of `image` (H, W) at (x, y), beyond its border that of the nearest place within."""
    rows, columns = image.shape
    x, y = min(max(x, 0.0), columns - 1.0), min(max(y, 0.0), rows - 1.0)
    value = 0.0
    for i, wy in ((math.floor(y), 1 - y % 1), (math.floor(y) + 1, y % 1)):
        for j, wx in ((math.floor(x), 1 - x % 1), (math.floor(x) + 1, x % 1)):
            value += wx * wy * float(image[min(i, rows - 1), min(j, columns - 1)])
    return value
