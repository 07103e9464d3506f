"""Slow, plain twins of kernels/affine.py and kernels/mixture.py, written from the formulas and from nothing of ours."""

import math

from tests.twins.patches import pixel


def patch(picture, view, factor, state, size, shape):
    """Normalised grey levels at `state` (cx, cy, a1, a2, a3, a4), by rows; `view` as in naive_patches.pixel."""
    cx, cy, a1, a2, a3, a4 = state
    (w, h), (rows, cols) = size, shape
    values = []
    for i in range(rows):
        for j in range(cols):
            x, y = w * ((j + 0.5) / cols - 0.5), h * ((i + 0.5) / rows - 0.5)
            values.append(pixel(picture, view, factor, cx + a1 * x + a2 * y, cy + a3 * x + a4 * y))
    seen = [v for v in values if v is not None]
    if 2 * len(seen) < len(values):
        return [0.0] * len(values)
    mean = sum(seen) / len(seen)
    variance = sum((v - mean) ** 2 for v in seen) / len(seen)
    if variance < 0.25:
        return [0.0] * len(values)
    return [0.0 if v is None else (v - mean) / math.sqrt(variance) for v in values]


def density(y, mu, sigma, laplace):
    if laplace:
        b = sigma / math.sqrt(2)
        return math.exp(-abs(y - mu) / b) / (2 * b)
    return math.exp(-((y - mu) ** 2) / (2 * sigma**2)) / math.sqrt(2 * math.pi) / sigma


def parts(y, m, mu, sigma, laplace, outlier, width):
    """Each component's share in the density of one pixel, and that of the outliers."""
    three = [(1 - outlier) * m[i] * density(y, mu[i], sigma[i], laplace) for i in range(3)]
    return [*three, outlier / width]


def log_density(y, m, mu, sigma, laplace, outlier, width):
    """Eq. 6 of a patch y (d,); m, mu, sigma are (3, d)."""
    return sum(
        math.log(sum(parts(y[k], m[:, k], mu[:, k], sigma[:, k], laplace, outlier, width))) for k in range(len(y))
    )


def error(y, m, mu, sigma):
    """The mean of the squared distances from the components in their standard deviations."""
    return sum(m[i, k] * ((y[k] - mu[i, k]) / sigma[i, k]) ** 2 for i in range(3) for k in range(len(y))) / len(y)


def update(y, m, mu, sigma, moments, laplace, outlier, width, alpha, least_sigma, least_mixing):
    """Eq. 7-11 of one pixel: m, mu, sigma (3,) and moments (2,), as they are after y."""
    if y == 0:
        return m, mu, sigma, moments
    shares = parts(y, m, mu, sigma, laplace, outlier, width)
    own = [share / sum(shares) for share in shares]
    m = [alpha * own[i] + (1 - alpha) * m[i] for i in range(3)]
    moments = [alpha * y**p * own[1] + (1 - alpha) * moments[p - 1] for p in (1, 2)]
    stable, spread = mu[1], sigma[1]
    if m[1] > 0:
        stable = moments[0] / m[1]
        spread = math.sqrt(max(moments[1] / m[1] - stable**2, least_sigma**2))
    floored = [max(v, least_mixing) if v > 0 else 0 for v in m]
    whole = [v / sum(floored) for v in floored]
    if m[1] > 0:
        moments = [v * whole[1] / m[1] for v in moments]
    return whole, [y, stable, mu[2]], [sigma[0], spread, sigma[2]], moments


def match(y, template):
    """The correlation coefficient of y, of mean 0, with a template; 0 if either is flat."""
    mean = sum(template) / len(template)
    off = [v - mean for v in template]
    lengths = math.sqrt(sum(v * v for v in y) * sum(v * v for v in off))
    return sum(a * b for a, b in zip(y, off, strict=True)) / lengths if lengths > 1e-6 else 0.0
