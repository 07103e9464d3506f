"""The inner loops, compiled. Arrays in, arrays out; nothing of ours is imported here, and nothing random happens here.

Each kernel has a slow plain twin in `tests/naive.py` that the tests hold it to.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

L1, HUBER, TUKEY, GEMAN_MCCLURE = 0, 1, 2, 3
ROBUST = {"l1": L1, "huber": HUBER, "tukey": TUKEY, "geman_mcclure": GEMAN_MCCLURE}

_compile: Any = njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "nsz"}, error_model="numpy")


@_compile
def _read_window(image: Any, left: float, top: float, rows: int, row_values: int, out: Any) -> Any:
    """Bilinear window of `rows` x `row_values // 3` pixels at a subpixel place, flat into `out`; returns its sum.

    Outside the picture the nearest border pixel is read.
    """
    height, width = image.shape[0], image.shape[1] // 3
    x0, y0 = math.floor(left), math.floor(top)
    fx, fy = np.float32(left - x0), np.float32(top - y0)
    one = np.float32(1.0)
    w00, w01 = (one - fy) * (one - fx), (one - fy) * fx
    w10, w11 = fy * (one - fx), fy * fx
    total = np.float32(0.0)
    if x0 >= 0 and y0 >= 0 and 3 * x0 + row_values + 3 <= 3 * width and y0 + rows + 1 <= height:
        for i in range(rows):
            # the inner loop runs over flat rows: this is what lets it vectorise
            r0 = image[y0 + i, 3 * x0 : 3 * x0 + row_values + 3]
            r1 = image[y0 + i + 1, 3 * x0 : 3 * x0 + row_values + 3]
            v = out[i * row_values : (i + 1) * row_values]
            for j in range(row_values):
                v[j] = (
                    w00 * np.float32(r0[j])
                    + w01 * np.float32(r0[j + 3])
                    + w10 * np.float32(r1[j])
                    + w11 * np.float32(r1[j + 3])
                )
            for j in range(row_values):
                total += v[j]
        return total
    for i in range(rows):
        ya = min(max(y0 + i, 0), height - 1)
        yb = min(max(y0 + i + 1, 0), height - 1)
        for j in range(row_values // 3):
            xa = min(max(x0 + j, 0), width - 1)
            xb = min(max(x0 + j + 1, 0), width - 1)
            for c in range(3):
                value = (
                    w00 * np.float32(image[ya, 3 * xa + c])
                    + w01 * np.float32(image[ya, 3 * xb + c])
                    + w10 * np.float32(image[yb, 3 * xa + c])
                    + w11 * np.float32(image[yb, 3 * xb + c])
                )
                out[i * row_values + 3 * j + c] = value
                total += value
    return total


@_compile
def read_window(image: Any, x: float, y: float, w: int, h: int) -> Any:
    """The window of w x h pixels centred at (x, y), read bilinearly: (h * w * 3,) float32. `image` is (H, W * 3)."""
    out = np.empty(h * w * 3, np.float32)
    _read_window(image, x - (w - 1) / 2, y - (h - 1) / 2, h, w * 3, out)
    return out


@_compile
def colour_ratio_distances(
    image: Any, template: Any, w: int, h: int, centres: Any, least_mean: float, robust: int, scale: float, out: Any
) -> None:
    """Mean robust difference of mean-normalised colours between a template and the windows at `centres` (eq. 8, 9).

    `image` (H, W * 3) uint8 or float32; `template` (h * w * 3,) float32, already divided by its own mean; `centres`
    (N, 2) float64, x before y; `out` (N,) float64. A window darker than `least_mean` is divided by that instead.
    """
    n = w * h * 3
    window = np.empty(n, np.float32)
    inverse_scale = np.float32(1.0 / scale)
    one = np.float32(1.0)
    for p in range(centres.shape[0]):
        total = _read_window(image, centres[p, 0] - (w - 1) / 2, centres[p, 1] - (h - 1) / 2, h, w * 3, window)
        gain = np.float32(1.0 / max(total / n, least_mean))
        d = np.float32(0.0)
        if robust == L1:
            for j in range(n):
                d += abs(template[j] - gain * window[j])
            out[p] = d / n
        elif robust == HUBER:
            for j in range(n):
                u = abs(template[j] - gain * window[j]) * inverse_scale
                q = min(u, one)
                d += q * (np.float32(2.0) * u - q)
            out[p] = 0.5 * scale * d / n
        elif robust == TUKEY:
            for j in range(n):
                u = (template[j] - gain * window[j]) * inverse_scale
                r = max(one - u * u, np.float32(0.0))
                d += one - r * r * r
            out[p] = scale * d / n
        else:
            for j in range(n):
                u = (template[j] - gain * window[j]) * inverse_scale
                d += u * u / (one + u * u)
            out[p] = scale * d / n


def flat(image: NDArray[Any]) -> NDArray[Any]:
    """A picture (H, W, 3) as the flat rows (H, W * 3) that the kernels read, without a copy if it is contiguous."""
    return np.ascontiguousarray(image).reshape(image.shape[0], -1)
