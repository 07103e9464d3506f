"""A slow, plain twin of trackers/box/box_kernels.py, written from the formulas and from nothing of ours."""

import math


def normal(off, sigma):
    return math.exp(-0.5 * (off / sigma) ** 2) / (math.sqrt(2 * math.pi) * sigma)


def arrive(z, mean, step, scale, weights):
    """For each particle m, visible and hidden: w_m p(z | m) of one place and log scale z (3,), as (M, 2)."""
    return [
        [
            weights[m][k] * normal(z[0] - x, step[m][k]) * normal(z[1] - y, step[m][k]) * normal(z[2] - s, scale)
            for k in range(2)
        ]
        for m, (x, y, s) in enumerate(mean)
    ]
