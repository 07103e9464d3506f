"""Densities of patches under a mixture for each pixel, and how it learns (Zhou, Chellappa & Moghaddam 2003, eq. 6-11).

A pixel has three components, in the order w, s, f: weights m, centres mu, standard deviations sigma, all (3, d).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from facetrack_cli.kernels.compiled import exact, fast, inline

# pixels whose densities are multiplied before one logarithm: 4^48 is well within float32
_TOGETHER = 48
_LEAST = np.float32(-126.0)
_ONE, _ZERO = np.float32(1.0), np.float32(0.0)
_MAGIC, _BIAS, _BITS = np.float32(12582912.0), np.int32(0x4B400000 - 127), np.int32(23)
# the minimax polynomial of 2^f on [-0.5, 0.5]
_C1, _C2, _C3 = np.float32(0.6931472), np.float32(0.24022651), np.float32(0.05550327)
_C4, _C5, _C6 = np.float32(0.009618129), np.float32(0.0013333558), np.float32(0.00015403530)


@inline
def _exp2(x: Any) -> Any:
    """2^x of x up to 0, float32, to a relative error of 2e-7; at least 2^-126."""
    x = max(x, _LEAST)
    # adding 1.5 * 2^23 leaves the nearest whole number in the lowest bits
    shifted = np.float32(x + _MAGIC)
    f = x - (shifted - _MAGIC)
    power = np.float32(np.int32((shifted.view(np.int32) - _BIAS) << _BITS).view(np.float32))
    return power * (_ONE + f * (_C1 + f * (_C2 + f * (_C3 + f * (_C4 + f * (_C5 + f * _C6))))))


@inline
def _exponent(y: Any, mu: Any, rate: Any, log: Any, laplace: bool) -> Any:
    off = y - mu
    return log - rate * (abs(off) if laplace else off * off)


@exact
def powers(x: Any) -> Any:
    """2^x of x (n,) float32, as the kernels here take it: for the tests."""
    out = np.empty_like(x)
    for k in range(len(x)):
        out[k] = _exp2(x[k])
    return out


@fast
def log_densities(y: Any, mu: Any, rate: Any, log: Any, outlier: float, laplace: bool) -> Any:
    """log p (N,) of patches y (N, d): eq. 6, the sum over the pixels of the log of each one's mixture.

    A component's density is 2^(log - rate |y - mu|^2), with the first power if `laplace`; mu, rate, log are (3, d)
    float32. `outlier` is a density that is added in every pixel; 0 for none.
    """
    count, d = y.shape
    out = np.empty(count)
    low = np.float32(math.log2(outlier)) if outlier > 0.0 else np.float32(-1e30)
    for n in range(count):
        total = 0.0
        for start in range(0, d, _TOGETHER):
            end = min(start + _TOGETHER, d)
            row = y[n, start:end]
            mu_w, mu_s, mu_f = mu[0, start:end], mu[1, start:end], mu[2, start:end]
            rate_w, rate_s, rate_f = rate[0, start:end], rate[1, start:end], rate[2, start:end]
            log_w, log_s, log_f = log[0, start:end], log[1, start:end], log[2, start:end]
            product, highest = _ONE, _ZERO
            for k in range(len(row)):
                a = _exponent(row[k], mu_w[k], rate_w[k], log_w[k], laplace)
                b = _exponent(row[k], mu_s[k], rate_s[k], log_s[k], laplace)
                c = _exponent(row[k], mu_f[k], rate_f[k], log_f[k], laplace)
                top = max(max(a, b), max(c, low))
                highest += top
                product *= _exp2(a - top) + _exp2(b - top) + _exp2(c - top) + _exp2(low - top)
            total += float(highest) + math.log2(product)
        out[n] = total * math.log(2.0)
    return out


@fast
def errors(y: Any, m: Any, mu: Any, sigma: Any) -> Any:
    """phi (N,) of patches y (N, d): the mean over the pixels of sum_i m_i ((y - mu_i) / sigma_i)^2."""
    count, d = y.shape
    out = np.empty(count)
    rate = np.empty_like(m)
    for i in range(3):
        for k in range(d):
            rate[i, k] = m[i, k] / (sigma[i, k] * sigma[i, k])
    for n in range(count):
        total = _ZERO
        for k in range(d):
            w, s, f = y[n, k] - mu[0, k], y[n, k] - mu[1, k], y[n, k] - mu[2, k]
            total += w * w * rate[0, k] + s * s * rate[1, k] + f * f * rate[2, k]
        out[n] = total / d
    return out


@exact
def update(
    y: Any,
    m: Any,
    mu: Any,
    sigma: Any,
    moment_1: Any,
    moment_2: Any,
    rate: Any,
    log: Any,
    outlier: float,
    laplace: bool,
    alpha: float,
    least_sigma: float,
    least_mixing: float,
) -> Any:
    """m, mu, sigma (3, d) float32 and the moments (2, d) float64 after the patch y (d,): eq. 7-11.

    A pixel with y = 0 was not seen and keeps what it had. A component of weight 0 keeps it.
    """
    d = len(y)
    new_m, new_mu, new_sigma = m.copy(), mu.copy(), sigma.copy()
    moments = np.empty((2, d))
    low = np.float32(math.log2(outlier)) if outlier > 0.0 else np.float32(-1e30)
    for k in range(d):
        moments[0, k], moments[1, k] = moment_1[k], moment_2[k]
        if y[k] == _ZERO:
            continue
        a = _exponent(y[k], mu[0, k], rate[0, k], log[0, k], laplace)
        b = _exponent(y[k], mu[1, k], rate[1, k], log[1, k], laplace)
        c = _exponent(y[k], mu[2, k], rate[2, k], log[2, k], laplace)
        top = max(max(a, b), max(c, low))
        a, b, c = _exp2(a - top), _exp2(b - top), _exp2(c - top)
        p = float(a + b + c + _exp2(low - top))
        w = alpha * a / p + (1.0 - alpha) * m[0, k] if m[0, k] > 0.0 else 0.0
        s = alpha * b / p + (1.0 - alpha) * m[1, k] if m[1, k] > 0.0 else 0.0
        f = alpha * c / p + (1.0 - alpha) * m[2, k] if m[2, k] > 0.0 else 0.0
        new_mu[0, k] = y[k]
        if s > 0.0:
            own = alpha * b / p
            first = (own * y[k] + (1.0 - alpha) * moment_1[k]) / s
            second = (own * y[k] * y[k] + (1.0 - alpha) * moment_2[k]) / s
            new_mu[1, k] = first
            new_sigma[1, k] = max(math.sqrt(max(second - first * first, 0.0)), least_sigma)
            moments[0, k], moments[1, k] = first, second
        w = max(w, least_mixing) if m[0, k] > 0.0 else 0.0
        s = max(s, least_mixing) if m[1, k] > 0.0 else 0.0
        f = max(f, least_mixing) if m[2, k] > 0.0 else 0.0
        whole = w + s + f
        new_m[0, k], new_m[1, k], new_m[2, k] = w / whole, s / whole, f / whole
        # S is a ratio to m_s: what floors and rounding did to that is done to them
        if s > 0.0:
            moments[0, k] *= new_m[1, k]
            moments[1, k] *= new_m[1, k]
    return new_m, new_mu, new_sigma, moments
