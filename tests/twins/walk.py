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
