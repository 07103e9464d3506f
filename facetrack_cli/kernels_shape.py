"""The inner loops of the Parzen shape prior, compiled. Arrays in, arrays out; nothing of ours is imported here.

Each kernel has a slow plain twin in `tests/naive_shape.py`. A hypothesis is registered to q (P, 2), in kernel widths,
over the P parts that are listed in `parts`:

    q_i = ((x_i - first_i) - r) / width,   r = x_stable - first_stable,   or the mean over `parts` with `stable` = -1.

With h_j the training shapes in the same units, every answer needs the exponents -|q - h_j|^2 / 2 of all j. They are
taken as q.h_j - |h_j|^2 / 2, with -|q|^2 / 2 added at the end: two operations a coordinate.

No fastmath: the inner loops run over j without a reduction, so they vectorise as they stand and round alike everywhere.
"""

import math
from typing import Any

import numpy as np
from numba import njit

_compile: Any = njit(cache=True, nogil=True, error_model="numpy")

LANES = 8  # shapes are padded to a multiple of this, so that sums and maxima run in independent lanes

_LOG2E = 1.4426950408889634
_LN2_HI = 0.693147180369123816490
_LN2_LO = 1.90821492927058770002e-10
_ROUND = 6755399441055744.0  # 1.5 * 2**52: adding it leaves the nearest whole number in the low bits


@_compile
def _exp_below(v: Any, top: float, scratch: Any) -> None:
    """v[j] <- exp(max(v[j] - top, -700)) for v <= top, to 1e-14 relative.

    libm's exp, called one by one, would take most of the prior's time.
    """
    bits = scratch.view(np.int64)
    for j in range(v.shape[0]):
        a = v[j] - top
        a = a if a > -700.0 else -700.0
        t = a * _LOG2E + _ROUND
        n = t - _ROUND
        r = (a - n * _LN2_HI) - n * _LN2_LO
        p = 1.0 / 39916800.0
        p = p * r + 1.0 / 3628800.0
        p = p * r + 1.0 / 362880.0
        p = p * r + 1.0 / 40320.0
        p = p * r + 1.0 / 5040.0
        p = p * r + 1.0 / 720.0
        p = p * r + 1.0 / 120.0
        p = p * r + 1.0 / 24.0
        p = p * r + 1.0 / 6.0
        p = p * r + 0.5
        p = p * r + 1.0
        v[j] = p * r + 1.0
        scratch[j] = t
    for j in range(v.shape[0]):
        bits[j] = (bits[j] + 1023) << 52  # 2**n
    for j in range(v.shape[0]):
        v[j] *= scratch[j]


@_compile
def _weigh(
    x: Any, parts: Any, first: Any, stable: int, width: float, h: Any, bias: Any, w: Any, scratch: Any, lanes: Any
) -> float:
    """w[j] <- exp(-|q - h_j|^2 / 2) / exp(top); returns top, the largest exponent."""
    if stable >= 0:
        rx = x[stable, 0] - first[stable, 0]
        ry = x[stable, 1] - first[stable, 1]
    else:
        rx = 0.0
        ry = 0.0
        for i in range(parts.shape[0]):
            rx += x[parts[i], 0] - first[parts[i], 0]
            ry += x[parts[i], 1] - first[parts[i], 1]
        rx /= parts.shape[0]
        ry /= parts.shape[0]

    w[:] = bias
    norm = 0.0
    for i in range(parts.shape[0]):
        k = parts[i]
        qx = ((x[k, 0] - first[k, 0]) - rx) / width
        qy = ((x[k, 1] - first[k, 1]) - ry) / width
        norm += qx * qx + qy * qy
        hx = h[2 * i]
        hy = h[2 * i + 1]
        for j in range(w.shape[0]):
            w[j] += qx * hx[j] + qy * hy[j]

    lanes[:] = w[:LANES]
    for b in range(LANES, w.shape[0], LANES):
        for c in range(LANES):
            lanes[c] = w[b + c] if w[b + c] > lanes[c] else lanes[c]
    top = lanes[0]
    for c in range(1, LANES):
        top = max(top, lanes[c])

    _exp_below(w, top, scratch)
    return float(top - 0.5 * norm)


@_compile
def log_parzen(x: Any, parts: Any, first: Any, stable: int, width: float, h: Any, bias: Any) -> Any:
    """log sum_j exp(-|q_n - h_j|^2 / 2), (N,).

    x (N, K, 2) and first (K, 2) in pixels; parts (P,) int64; stable: a part, or -1 for the mean of `parts`; width: the
    kernel's standard deviation in pixels; h (2P, M) in kernel widths; bias (M,) = -|h_j|^2 / 2, and -1e300 for padding;
    M a multiple of LANES.
    """
    n, m = x.shape[0], bias.shape[0]
    out = np.empty(n)
    w = np.empty(m)
    scratch = np.empty(m)
    lanes = np.empty(LANES)
    for s in range(n):
        top = _weigh(x[s], parts, first, stable, width, h, bias, w, scratch, lanes)
        lanes[:] = w[:LANES]
        for b in range(LANES, m, LANES):
            for c in range(LANES):
                lanes[c] += w[b + c]
        total = 0.0
        for c in range(LANES):
            total += lanes[c]
        out[s] = top + math.log(total)
    return out


@_compile
def pick_shape(x: Any, parts: Any, first: Any, stable: int, width: float, h: Any, bias: Any, u: Any) -> Any:
    """The index j of a shape for each hypothesis, (N,) int64, drawn by the uniform u[n] in [0, 1).

    Its probability is proportional to exp(-|q_n - h_j|^2 / 2). The other arguments are those of `log_parzen`.
    """
    n, m = x.shape[0], bias.shape[0]
    out = np.empty(n, np.int64)
    w = np.empty(m)
    scratch = np.empty(m)
    lanes = np.empty(LANES)
    for s in range(n):
        _weigh(x[s], parts, first, stable, width, h, bias, w, scratch, lanes)
        for j in range(1, m):
            w[j] += w[j - 1]
        goal = u[s] * w[m - 1]
        j = 0
        while j < m - 1 and w[j] <= goal:
            j += 1
        while bias[j] <= -1e300:  # a goal rounded up to the total would end in the padding
            j -= 1
        out[s] = j
    return out
