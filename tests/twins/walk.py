"""A slow, plain twin of trackers/box/box_kernels.py, written from the formulas and from nothing of ours."""

import math


def normal(off, sigma):
    return math.exp(-0.5 * (off / sigma) ** 2) / (math.sqrt(2 * math.pi) * sigma)


def arrive(z, parents, weights, sigma, walk):
    """For each particle m, visible and hidden: w_m p(z | m) of one place and log scale z (3,), as (M, 2)."""
    scale, velocity, _, hide, show, leave = walk[:6]
    found = []
    for w, (x, y, s, vx, vy, visible) in zip(weights, parents, strict=True):
        near = visible * (1 - hide) + (1 - visible) * show
        shares = near, 1 - near - (1 - visible) * leave
        off = z[0] - x - velocity * vx, z[1] - y - velocity * vy
        found.append(
            [
                w * share * normal(off[0], s * step) * normal(off[1], s * step) * normal(z[2] - math.log(s), scale)
                for share, step in zip(shares, sigma, strict=True)
            ]
        )
    return found


def velocity(z, parent, sigma, walk, noise):
    """(2,): a draw of p(velocity | z) of who comes from a parent by a step `sigma`, of standard normal `noise`."""
    _, a, b = walk[:3]
    kept = [a * v for v in parent[3:5]]
    spread = math.sqrt(b * (1 - b)) * sigma * parent[2]
    return [v + b * (z[i] - parent[i] - v) + spread * noise[i] for i, v in enumerate(kept)]


def log_mixture(z, mean, std, log_w):
    """For each z (N, 3) the logarithm of the sum of weighted normal densities, 1 at their means; far from all, too."""
    squares = [
        [sum(((a - b) / c) ** 2 for a, b, c in zip(p, m, s, strict=True)) for m, s in zip(mean, std, strict=True)]
        for p in z
    ]
    logs = [[w - each / 2 for w, each in zip(log_w, row, strict=True)] for row in squares]
    return [max(row) + math.log(math.fsum(math.exp(one - max(row)) for one in row)) for row in logs]


def carried(x, noise, step, scale, velocity, acceleration, least, most):
    """Particles x (N, 6), all moved by a step; of each two, one grows as the other shrinks."""
    found = []
    for n, (px, py, s, vx, vy, visible) in enumerate(x):
        grown = s * math.exp((-1) ** n * scale * noise[n // 2])
        # the mean of v_t = velocity v + acceleration (step - velocity v)
        v = [velocity * v + acceleration * (d - velocity * v) for v, d in zip((vx, vy), step, strict=True)]
        found.append([px + step[0], py + step[1], min(max(grown, least), most), *v, visible])
    return found


def summed(x, w, size):
    """State, covariance and spread of the sides of a box by particles x (N, 6) with weights, and how many count."""
    shown = math.fsum(one * p[5] for one, p in zip(w, x, strict=True))
    counts = [one * (p[5] if shown >= 0.5 else 1 - p[5]) for one, p in zip(w, x, strict=True)]
    counts = [one / math.fsum(counts) for one in counts]
    mean = [math.fsum(one * p[i] for one, p in zip(counts, x, strict=True)) for i in range(5)]
    n = 1 / math.fsum(one**2 for one in counts)
    more = (n + 1) / (n - 1)

    def spread(i, j):
        return more * math.fsum(one * (p[i] - mean[i]) * (p[j] - mean[j]) for one, p in zip(counts, x, strict=True))

    cov = [[spread(i, j) for j in range(2)] for i in range(2)]
    return [*mean, shown], cov, [side * math.sqrt(spread(2, 2)) for side in size], 1 / math.fsum(one**2 for one in w)
