# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""Windows read from an image, and their colours compared; the loops of the Parzen shape prior.

Patras & Pantic 2004, eq. 8, 9 and 11. Each kernel has a slow plain twin in `tests/twins/points.py`. For the prior, a
hypothesis is registered to q (P, 2), in kernel widths, over the P parts that are listed in `parts`:

    q_i = ((x_i - first_i) - r) / width,   r = x_stable - first_stable,   or the mean over `parts` with `stable` = -1.

With h_j the training shapes in the same units, every answer needs the exponents -|q - h_j|^2 / 2 of all j. They are
taken as q.h_j - |h_j|^2 / 2, in float32, and -|q|^2 / 2, in float64: what differs between shapes is small, so their
weights are right to about 1e-6 of the exponent however far q is, in half the time and half the cache of float64.
No fastmath: the inner loops run over j without a reduction, so they vectorise as they stand and round alike everywhere.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.engine.kernels.compiled import exact, fast, inline


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


@exact("u1:2 f8 f8 i8 i8")
def read_window(image, x, y, w, h):
    """The window of w x h pixels of image (H, W * 3) at (x, y): (h, w + 1, 3) float32, its last column zero."""
    length = 3 * h * (w + 1)
    pixels, out = np.zeros(length + 3 * (w + 2), np.float32), np.empty(length, np.float32)
    _read_window(image, x, y, w, h, pixels, out)
    return out.reshape(h, w + 1, 3)


@fast("u1:2 f4:1 i8:1 i8:2 i8:1 f8:3 i8 i8 i8 f8 f8:2")
def colour_ratio_distances(image, ratios, offsets, sides, parts, x, origin_x, origin_y, factor, least_mean, out):
    """Mean absolute difference of mean-normalised colours between templates and the windows at x (eq. 8 and 9).

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
            gain, d = np.float32(1.0 / max(total / n, least_mean)), np.float32(0.0)
            for j in range(len(template)):
                d += abs(template[j] - gain * window[j])
            out[p, k] = d / n


def extent(x: NDArray[np.float64], reach: float) -> tuple[float, float, float, float]:
    """(x from, y from, x to, y to) of everything within `reach` of the places x (N, K, 2)."""
    (x0, y0), (x1, y1) = x.min(axis=(0, 1)).tolist(), x.max(axis=(0, 1)).tolist()
    return x0 - reach, y0 - reach, x1 + reach, y1 + reach


def flat(image: NDArray[Any]) -> NDArray[Any]:
    """An image (H, W, 3) as the flat rows (H, W * 3) that the kernels read, without a copy if it is contiguous."""
    return np.ascontiguousarray(image).reshape(image.shape[0], -1)


LANES = 16  # shapes are padded to a multiple of this, so that sums and maxima run in independent lanes
PADDING = np.float32(-1e38)  # the bias of a shape that is none
_FARTHEST = 1e30  # float32 holds 3e38
_MIN_EXPONENT = np.float32(-80.0)  # exp of it is nothing beside the largest weight, 1
_LOG2E, _LN2_HI, _LN2_LO = np.float32(1.4426950408889634), np.float32(0.693359375), np.float32(-2.12194440e-4)
_ROUND = np.float32(12582912.0)  # 1.5 * 2**23: adding it leaves the nearest whole number in the low bits
_ONE, _HALF = np.float32(1.0), np.float32(0.5)
_C3, _C4, _C5 = np.float32(1.6666665459e-1), np.float32(4.1665795894e-2), np.float32(8.3334519073e-3)
_C6, _C7 = np.float32(1.3981999507e-3), np.float32(1.9875691500e-4)


@exact
def _exp_below(v, top, bits, scale):
    """v[j] <- exp(max(v[j] - top, -80)) for v <= top, to 2e-7 relative; `bits` and `scale` are one scratch array.

    libm's exp, called one by one, would take most of the prior's time. The polynomial is that of Cephes' expf.
    """
    for j in range(v.shape[0]):
        a = v[j] - top if v[j] - top > _MIN_EXPONENT else _MIN_EXPONENT
        t = a * _LOG2E + _ROUND
        n = t - _ROUND
        r = (a - n * _LN2_HI) - n * _LN2_LO
        p = ((((_C7 * r + _C6) * r + _C5) * r + _C4) * r + _C3) * r + _HALF
        v[j] = (p * r) * r + r + _ONE
        scale[j] = t
    for j in range(v.shape[0]):
        bits[j] = (bits[j] + 127) << 23  # 2**n
    for j in range(v.shape[0]):
        v[j] *= scale[j]


@exact
def _weigh(x, parts, first, stable, width, h, bias, w, bits, scale):
    """w[j] <- exp(-|q - h_j|^2 / 2) / exp(top); returns top, the largest exponent, and the sum of w."""
    if stable >= 0:
        rx, ry = x[stable, 0] - first[stable, 0], x[stable, 1] - first[stable, 1]
    else:
        rx, ry = 0.0, 0.0
        for k in parts:
            rx += x[k, 0] - first[k, 0]
            ry += x[k, 1] - first[k, 1]
        rx, ry = rx / parts.shape[0], ry / parts.shape[0]
    for j in range(w.shape[0]):
        w[j] = bias[j]
    norm = 0.0
    for i in range(parts.shape[0]):
        k, hx, hy = parts[i], h[2 * i], h[2 * i + 1]
        qx, qy = ((x[k, 0] - first[k, 0]) - rx) / width, ((x[k, 1] - first[k, 1]) - ry) / width
        norm += qx * qx + qy * qy
        fx = np.float32(min(max(qx, -_FARTHEST), _FARTHEST))
        fy = np.float32(min(max(qy, -_FARTHEST), _FARTHEST))
        for j in range(w.shape[0]):
            w[j] += fx * hx[j] + fy * hy[j]
    for c in range(LANES):
        scale[c] = w[c]
    for b in range(LANES, w.shape[0], LANES):
        for c in range(LANES):
            scale[c] = w[b + c] if w[b + c] > scale[c] else scale[c]
    top = scale[0]
    for c in range(1, LANES):
        top = max(top, scale[c])
    _exp_below(w, top, bits, scale)
    for c in range(LANES):
        scale[c] = w[c]
    for b in range(LANES, w.shape[0], LANES):
        for c in range(LANES):
            scale[c] += w[b + c]
    total = 0.0
    for c in range(LANES):
        total += scale[c]
    return float(top) - 0.5 * norm, total


@exact("f8:3 i8:1 f8:2 i8 f8 f4:2 f4:1 f8:1")
def parzen(x, parts, first, stable, width, h, bias, u):
    """log sum_j exp(-|q_n - h_j|^2 / 2), (N,), and the index j of a shape for each hypothesis if `u` is not empty.

    The index is drawn by the uniform u[n] in [0, 1) with a probability proportional to exp(-|q_n - h_j|^2 / 2).
    x (N, K, 2) in pixels; parts (P,) int64; first (K, 2) in pixels; stable: a part, or -1 for the mean of `parts`;
    width: the kernel's standard deviation in pixels; h (2P, M) float32 in kernel widths; bias (M,) float32 =
    -|h_j|^2 / 2, and PADDING behind the last; M a multiple of LANES.
    """
    m = bias.shape[0]
    sums, chosen = np.empty(x.shape[0]), np.empty(u.shape[0], np.int64)
    w, bits = np.empty(m, np.float32), np.empty(m, np.int32)
    scale = bits.view(np.float32)
    for s in range(x.shape[0]):
        top, total = _weigh(x[s], parts, first, stable, width, h, bias, w, bits, scale)
        sums[s] = top + math.log(total)
        if u.shape[0] == 0:
            continue
        goal, j, reached = u[s] * total, 0, float(w[0])
        while j < m - 1 and reached <= goal:
            j += 1
            reached += w[j]
        while bias[j] <= PADDING:  # a goal rounded up to the total would end in the padding
            j -= 1
        chosen[s] = j
    return sums, chosen
