# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""Windows read from an image, and their colours compared (Patras & Pantic 2004, eq. 8 and 9)."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.engine.kernels.compiled import exact, fast, inline

L1, HUBER, TUKEY, GEMAN_MCCLURE = 0, 1, 2, 3
ROBUST = {"l1": L1, "huber": HUBER, "tukey": TUKEY, "geman_mcclure": GEMAN_MCCLURE}


@inline
def _read_window(image, x, y, w, h, pixels, out):
    """Bilinear window of w x h pixels centred at (x, y) into `out`; returns the sum of its values.

    `image` (H, W * 3); outside it the nearest border pixel is read. Rows of `out` are (w + 1) * 3 long, the last pixel
    of each is zero; `pixels` is scratch, (h + 1) * (w + 1) * 3 + 3 long.
    """
    height, width = image.shape[0], image.shape[1] // 3
    left, top = x - (w - 1) / 2, y - (h - 1) / 2
    x0, y0 = math.floor(left), math.floor(top)
    fx, fy = np.float32(left - x0), np.float32(top - y0)
    one, stride = np.float32(1.0), 3 * (w + 1)
    w00, w01, w10, w11 = (one - fy) * (one - fx), (one - fy) * fx, fy * (one - fx), fy * fx
    # whole rows are copied side by side, so that all arithmetic runs over one long flat row and vectorises
    if x0 >= 0 and y0 >= 0 and x0 + w + 1 <= width and y0 + h + 1 <= height:
        for i in range(h + 1):
            source, row = image[y0 + i, 3 * x0 : 3 * x0 + stride], pixels[i * stride : (i + 1) * stride]
            for j in range(stride):
                row[j] = np.float32(source[j])
    else:
        for i in range(h + 1):
            yy = min(max(y0 + i, 0), height - 1)
            for j in range(w + 1):
                xx = min(max(x0 + j, 0), width - 1)
                for c in range(3):
                    pixels[i * stride + 3 * j + c] = np.float32(image[yy, 3 * xx + c])
    right, below, both = pixels[3:], pixels[stride:], pixels[stride + 3 :]
    for j in range(h * stride):
        out[j] = w00 * pixels[j] + w01 * right[j] + w10 * below[j] + w11 * both[j]
    for i in range(1, h + 1):
        out[i * stride - 3] = out[i * stride - 2] = out[i * stride - 1] = np.float32(0.0)
    total = np.float32(0.0)
    for j in range(h * stride):
        total += out[j]
    return total


def read_window(image: NDArray[Any], x: float, y: float, w: int, h: int) -> NDArray[np.float32]:
    """The window of w x h pixels of image (H, W * 3) at (x, y): (h, w + 1, 3) float32, its last column zero.

    By NumPy, since it is read a few times a frame: the arithmetic of `_read_window`, to the bit.
    """
    height, width = image.shape[0], image.shape[1] // 3
    left, top = x - (w - 1) / 2, y - (h - 1) / 2
    x0, y0, one = math.floor(left), math.floor(top), np.float32(1.0)
    fx, fy = np.float32(left - x0), np.float32(top - y0)
    rows = np.clip(np.arange(y0, y0 + h + 1), 0, height - 1)
    columns = np.clip(np.arange(x0, x0 + w + 1), 0, width - 1)
    pixels = image.reshape(height, width, 3)[rows[:, None], columns].astype(np.float32)
    out = np.zeros((h, w + 1, 3), np.float32)
    upper = (one - fy) * (one - fx) * pixels[:-1, :-1] + (one - fy) * fx * pixels[:-1, 1:]
    out[:, :w] = upper + fy * (one - fx) * pixels[1:, :-1] + fy * fx * pixels[1:, 1:]
    return out


@inline
def _mean_rho(template, window, gain, robust, scale, n):
    """Mean of a robust function of template - gain * window, two flat rows that hold n values and zeros."""
    one, two, d, inverse = np.float32(1.0), np.float32(2.0), np.float32(0.0), np.float32(1.0 / scale)
    if robust == L1:
        for j in range(len(template)):
            d += abs(template[j] - gain * window[j])
        return d / n
    if robust == HUBER:
        for j in range(len(template)):
            u = abs(template[j] - gain * window[j]) * inverse
            inner = min(u, one)
            d += inner * (two * u - inner)
        return 0.5 * scale * d / n
    if robust == TUKEY:
        for j in range(len(template)):
            u = (template[j] - gain * window[j]) * inverse
            rest = max(one - u * u, np.float32(0.0))
            d += one - rest * rest * rest
        return scale * d / n
    for j in range(len(template)):
        u = (template[j] - gain * window[j]) * inverse
        d += u * u / (one + u * u)
    return scale * d / n


@fast
def colour_ratio_distances(
    image, ratios, offsets, sides, parts, x, origin_x, origin_y, factor, least_mean, robust, scale, out
):
    """Mean robust difference of mean-normalised colours between templates and the windows at x (eq. 8 and 9).

    Template g of part `parts[g]` is `ratios[offsets[g] : offsets[g + 1]]`, divided by its own mean and laid out as
    `read_window` does, of `sides[g]` = (w, h) pixels. `x` (N, K, 2) are centres in the whole image; `image`
    (H, W * 3) shows it from (origin_x, origin_y) on, reduced by `factor`. The distance goes to `out[n, parts[g]]`. A
    window darker than `least_mean` is divided by that instead of its mean.
    """
    largest = 0
    for g in range(len(parts)):
        largest = max(largest, 3 * (sides[g, 0] + 1) * (sides[g, 1] + 1))
    pixels, buffer = np.zeros(largest + 3, np.float32), np.empty(largest, np.float32)
    # far outside, every window shows the same border; the bound keeps the integers small
    reach = 4.0 * (image.shape[0] + image.shape[1])
    for g in range(len(parts)):
        k, w, h = parts[g], sides[g, 0], sides[g, 1]
        template = ratios[offsets[g] : offsets[g + 1]]
        window, n = buffer[: len(template)], w * h * 3
        for p in range(x.shape[0]):
            cx = (x[p, k, 0] - origin_x - 0.5 * (factor - 1)) / factor
            cy = (x[p, k, 1] - origin_y - 0.5 * (factor - 1)) / factor
            cx, cy = min(max(cx, -reach), reach), min(max(cy, -reach), reach)
            total = _read_window(image, cx, cy, w, h, pixels, window)
            gain = np.float32(1.0 / max(total / n, least_mean))
            out[p, k] = _mean_rho(template, window, gain, robust, scale, n)


@exact
def extent(x, reach):
    """(x from, y from, x to, y to) of everything within `reach` of the places x (N, K, 2)."""
    x0, y0 = x1, y1 = x[0, 0, 0], x[0, 0, 1]
    for n in range(x.shape[0]):
        for k in range(x.shape[1]):
            u, v = x[n, k, 0], x[n, k, 1]
            x0, y0, x1, y1 = min(x0, u), min(y0, v), max(x1, u), max(y1, v)
    return x0 - reach, y0 - reach, x1 + reach, y1 + reach


def flat(image: NDArray[Any]) -> NDArray[Any]:
    """An image (H, W, 3) as the flat rows (H, W * 3) that the kernels read, without a copy if it is contiguous."""
    return np.ascontiguousarray(image).reshape(image.shape[0], -1)
