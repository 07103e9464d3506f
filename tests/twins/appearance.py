"""Slow, plain twins of patches, mixture and gallery, written from the formulas and from nothing of ours."""

import math

from tests.twins.regions import pixel


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


def log_subspace(y, mean, vectors, values, rho):
    """Log of eq. 14 for one patch: a list of numbers each, `vectors` a list of directions."""
    d, s = len(mean), len(values)
    x = [y[i] - mean[i] for i in range(d)]
    q = [sum(e[i] * x[i] for i in range(d)) for e in vectors]
    total = 0.0
    for k in range(s):
        total -= 0.5 * q[k] ** 2 / values[k] + 0.5 * math.log(2 * math.pi * values[k])
    if s < d:
        error = sum(v * v for v in x) - sum(v * v for v in q)
        total -= error / (2 * rho) + 0.5 * (d - s) * math.log(2 * math.pi * rho)
    return total


def log_ratio(y, face, intra, extra):
    """Log of eq. 16 for one patch and one identity; the spaces are (mean, vectors, values, rho)."""
    difference = [a - b for a, b in zip(y, face, strict=True)]
    return log_subspace(difference, *intra) - log_subspace(difference, *extra)


def normalised(patch):
    mean = sum(patch) / len(patch)
    spread = math.sqrt(sum((v - mean) ** 2 for v in patch) / len(patch))
    return [(v - mean) / spread for v in patch]


def stand_in(pictures):
    if len(pictures) == 1:
        return list(pictures[0])
    return normalised([sum(values) / len(pictures) for values in zip(*pictures, strict=True)])


def minus(a, b):
    return [x - y for x, y in zip(a, b, strict=True)]


def to_own(people):
    """Differences of each image to what the other images of its person make up; people: lists of images."""
    return [
        minus(picture, stand_in(pictures[:k] + pictures[k + 1 :]))
        for pictures in people for k, picture in enumerate(pictures) if len(pictures) > 1
    ]  # fmt: skip


def figure_1(beta, p_a, p_f, p_n, switch=0.0):
    """Weights w (J,) and beta (L,) after a frame; p_a and p_f (J,), p_n (J, L), each in plain numbers."""
    n = len(beta)
    if switch:
        stays = [(1 - switch) * b for b in beta]
        comes = [switch / (n - 1) * sum(beta[:k] + beta[k + 1 :]) for k in range(n)]
        beta = [a + b for a, b in zip(stays, comes, strict=True)]
    alpha = [[beta[k] * p_a[j] * (p_f[j] * p_n[j][k] + (1 - p_f[j]) / n) for k in range(n)] for j in range(len(p_a))]
    total = sum(map(sum, alpha))
    return [sum(row) / total for row in alpha], [sum(row[k] for row in alpha) / total for k in range(n)]
