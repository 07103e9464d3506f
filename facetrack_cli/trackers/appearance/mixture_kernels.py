# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""Densities of patches under a mixture for each pixel, and how it learns (Zhou, Chellappa & Moghaddam 2003, eq. 6-11).

A pixel has three components, in the order w, s, f: weights m, centres mu, standard deviations sigma, all (3, d).
"""

import math

import numpy as np

from facetrack_cli.engine.kernels.compiled import fast, inline

# pixels whose sums are multiplied before one logarithm: 32 lanes in float64, of 15 factors up to 4 each
_LANES, _TOGETHER = 32, 15 * 32
_MIN_EXPONENT = np.float32(-126.0)
_ONE, _ZERO, _NEVER = np.float32(1.0), np.float32(0.0), np.float32(-1e30)
_MIN_WEIGHT = 1e-30  # below it a weight counts as 0
_HALF, _BIAS, _BITS = np.float32(0.5), np.int32(127), np.int32(23)
# of 2^f on [-0.5, 0.5], by least relative error: 1e-7
_C1, _C2, _C3 = np.float32(0.693147004), np.float32(0.240222424), np.float32(0.0555073395)
_C4, _C5 = np.float32(0.00967151392), np.float32(0.00132647157)


@inline
def _exp2(x):
    """2^x of x up to 0, float32, to a relative error of 4e-7; at least 2^-126."""
    x = x if x > _MIN_EXPONENT else _MIN_EXPONENT
    # towards 0 after half is taken off: the nearest whole number
    whole = np.int32(x - _HALF)
    f = x - np.float32(whole)
    power = np.float32(np.int32((whole + _BIAS) << _BITS).view(np.float32))
    return power * (_ONE + f * (_C1 + f * (_C2 + f * (_C3 + f * (_C4 + f * _C5)))))


@inline
def _components(mu, rate, log, start, end):
    """(mu, rate, log) of w, s and f for the pixels from `start` to `end`."""
    return (
        (mu[0, start:end], rate[0, start:end], log[0, start:end]),
        (mu[1, start:end], rate[1, start:end], log[1, start:end]),
        (mu[2, start:end], rate[2, start:end], log[2, start:end]),
    )


@inline
def _exponent(y, component, k, laplace):
    """log2 of a component's density of the value y in pixel k."""
    mu, rate, log = component
    off = y - mu[k]
    return log[k] - rate[k] * (abs(off) if laplace else off * off)


@inline
def _sum(a, b, c):
    """(top, share): 2^a + 2^b + 2^c is share 2^top, and top the largest of the three."""
    # `max` would check for nan, in twice the time
    high, low = a if a > b else b, b if a > b else a
    top, middle = high if high > c else c, c if high > c else high
    return top, _ONE + _exp2(middle - top) + _exp2(low - top)


@inline
def _sum_with(a, b, c, more):
    """As `_sum`, of four."""
    top, share = _sum(a, b, c)
    both = top if top > more else more
    return both, share * _exp2(top - both) + _exp2(more - both)


@inline
def _log2_product(values, lanes):
    """log2 of the product of `values`, float32 within 1..4, _TOGETHER of them at most."""
    lanes[:] = _ONE
    for start in range(0, len(values), _LANES):
        some = values[start : start + _LANES]
        for k in range(len(some)):
            lanes[k] *= some[k]
    product = 1.0
    for k in range(_LANES):
        product *= float(lanes[k])
    return math.log2(product)


@fast
def log_densities(y, mu, rate, log, outlier, laplace):
    """log p (N,) of patches y (N, d): eq. 6, the sum over the pixels of the log of each one's mixture.

    A component's density is 2^(log - rate |y - mu|^2), with the first power if `laplace`; mu, rate, log are (3, d)
    float32. `outlier` is a density that is added in every pixel; 0 for none.
    """
    count, d = y.shape
    out = np.zeros(count)
    shares, lanes = np.empty(_TOGETHER, np.float32), np.empty(_LANES, np.float32)
    uniform = np.float32(math.log2(outlier)) if outlier > 0.0 else _ZERO
    for start in range(0, d, _TOGETHER):
        end = min(start + _TOGETHER, d)
        w, s, f = _components(mu, rate, log, start, end)
        for n in range(count):
            row, share, total = y[n, start:end], shares[: end - start], _ZERO
            for k in range(len(row)):
                a, b, c = (
                    _exponent(row[k], w, k, laplace), _exponent(row[k], s, k, laplace), _exponent(row[k], f, k, laplace)
                )  # fmt: skip
                top, share[k] = _sum_with(a, b, c, uniform) if outlier > 0.0 else _sum(a, b, c)
                total += top
            out[n] += (float(total) + _log2_product(share, lanes)) * math.log(2.0)
    return out


@fast
def errors(y, m, mu, sigma):
    """phi (N,) of patches y (N, d): the mean over the pixels of sum_i m_i ((y - mu_i) / sigma_i)^2."""
    count, d = y.shape
    out, rate = np.empty(count), m / (sigma * sigma)
    for n in range(count):
        total = _ZERO
        for k in range(d):
            w, s, f = y[n, k] - mu[0, k], y[n, k] - mu[1, k], y[n, k] - mu[2, k]
            total += w * w * rate[0, k] + s * s * rate[1, k] + f * f * rate[2, k]
        out[n] = total / d
    return out


@fast
def update(y, m, mu, sigma, moments, rate, log, outlier, laplace, alpha, least_sigma, least_mixing):
    """m, mu, sigma (3, d) float32 and the moments (2, d) float64 after the patch y (d,): eq. 7-11.

    A pixel with y = 0 was not seen and keeps what it had. A component of weight 0 keeps that.
    """
    d, keep = len(y), 1.0 - alpha
    own_w, own_s, own_f = np.empty(d, np.float32), np.empty(d, np.float32), np.empty(d, np.float32)
    w_part, s_part, f_part = _components(mu, rate, log, 0, d)
    uniform = np.float32(math.log2(outlier)) if outlier > 0.0 else _NEVER
    for k in range(d):  # o_i of eq. 7
        a, b = _exponent(y[k], w_part, k, laplace), _exponent(y[k], s_part, k, laplace)
        c = _exponent(y[k], f_part, k, laplace)
        top = a if a > b else b
        top = top if top > c else c
        top = top if top > uniform else uniform
        a, b, c = _exp2(a - top), _exp2(b - top), _exp2(c - top)
        share = _ONE / (a + b + c + _exp2(uniform - top))
        own_w[k], own_s[k], own_f[k] = a * share, b * share, c * share
    new_m, new_mu, new_sigma, new_moments = np.empty_like(m), mu.copy(), sigma.copy(), np.empty_like(moments)
    old_w, old_s, old_f = m[0], m[1], m[2]
    new_w, new_s, new_f = new_m[0], new_m[1], new_m[2]
    w_centre, centre, spread = new_mu[0], new_mu[1], new_sigma[1]
    first, second, new_first, new_second = moments[0], moments[1], new_moments[0], new_moments[1]
    for k in range(d):
        value, seen = float(y[k]), y[k] != _ZERO
        w, s, f = float(old_w[k]), float(old_s[k]), float(old_f[k])
        w_on, s_on, f_on = w > 0.0, s > 0.0, f > 0.0
        gain = alpha * own_s[k]
        w, s, f = alpha * own_w[k] + keep * w, gain + keep * s, alpha * own_f[k] + keep * f
        known, some = seen & s_on, s > _MIN_WEIGHT
        # with alpha = 1 and nothing owned no moment is left: S stays
        whole = s if some else (old_s[k] if s_on else 1.0)
        mean = (gain * value + keep * first[k] if some else first[k]) / whole
        square = (gain * value * value + keep * second[k] if some else second[k]) / whole
        variance = square - mean * mean
        variance = variance if variance > least_sigma * least_sigma else least_sigma * least_sigma
        centre[k] = np.float32(mean) if known else centre[k]
        spread[k] = np.float32(math.sqrt(variance)) if known else spread[k]
        w_centre[k] = y[k] if seen else w_centre[k]
        w, s, f = (
            (w if w > least_mixing else least_mixing) if w_on else 0.0,
            (s if s > least_mixing else least_mixing) if s_on else 0.0,
            (f if f > least_mixing else least_mixing) if f_on else 0.0,
        )
        total, learns = w + s + f, seen & (w + s + f > _MIN_WEIGHT)
        new_w[k] = np.float32(w / total) if learns else old_w[k]
        new_s[k] = np.float32(s / total) if learns else old_s[k]
        new_f[k] = np.float32(f / total) if learns else old_f[k]
        # what floors and rounding did to m_s is done to its moments, or S would move with it
        new_first[k] = mean * new_s[k] if known else first[k]
        new_second[k] = square * new_s[k] if known else second[k]
    return new_m, new_mu, new_sigma, new_moments


@fast
def best_matches(y, templates):
    """The largest NCC of patches y (N, d) of mean 0 with any of the templates (n, d) -> (N,); 0 of a flat one."""
    count, d = y.shape
    out, means, squares = np.full(count, -1.0), np.zeros(len(templates)), np.zeros(len(templates))
    for i in range(len(templates)):
        row, total, square = templates[i], _ZERO, _ZERO
        for k in range(d):
            total += row[k]
        mean = np.float32(total / d)
        for k in range(d):
            square += (row[k] - mean) * (row[k] - mean)
        means[i], squares[i] = mean, square
    for n in range(count):
        row, square = y[n], _ZERO
        for k in range(d):
            square += row[k] * row[k]
        for i in range(len(templates)):
            other, mean, cross = templates[i], np.float32(means[i]), _ZERO
            for k in range(d):
                cross += row[k] * (other[k] - mean)
            lengths = math.sqrt(float(square) * squares[i])
            out[n] = max(out[n], cross / lengths if lengths > 1e-6 else 0.0)
    return out


@fast
def greys(values):
    """Values (d,) float32 as grey levels uint8: 0 is 128, one is 51 levels, and beyond 0..255 it ends."""
    out = np.empty(len(values), np.uint8)
    for k in range(len(values)):
        out[k] = np.uint8(min(max(values[k] * np.float32(51.0) + np.float32(128.0), 0.0), 255.0))
    return out
