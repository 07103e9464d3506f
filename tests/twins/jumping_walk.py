"""A slow, plain twin of the kernel of trackers/face/motion.py, of one part. Imports nothing of ours."""

import math

import numpy as np


def components(parent, readings, area, walk, rest):
    """(log p(z and this | a^-), mean (2,), variance) for each set of sensors that are right, with a step and a jump.

    `readings` are (z (2,), variance, sureness) of the sensors that say something, `walk` (sigma, jump, jumps, keep).
    Those with the last sensor come first, a step before a jump.
    """
    (sigma, jump, jumps, keep), found = walk, []
    middle = rest + keep * (parent - rest)
    for wrong in range(2 ** len(readings)):
        for share, std in ((1 - jumps, sigma), (jumps, jump)):
            log_p, at, var = math.log(max(share, 1e-12)), middle, std**2
            for i, (z, noise, sure) in enumerate(readings):
                sure = min(max(sure, 1e-6), 1 - 1e-6)
                if wrong >> i & 1:
                    log_p += math.log((1 - sure) / area)
                    continue
                # the product of two normal densities
                total = var + noise
                log_p += math.log(sure / (2 * math.pi * total)) - ((z - at) ** 2).sum() / 2 / total
                at, var = (noise * at + var * z) / total, var * noise / total
            found.append((log_p, at, var))
    return found


def shares(found, anywhere):
    """How often components are drawn."""
    p = np.exp([log_p - max(each[0] for each in found) for log_p, *_ in found])
    return (1 - anywhere) * p / p.sum() + anywhere / len(p)


def drawn(uniform, normal, found, anywhere):
    """The place (2,) by a uniform draw and two normal ones."""
    below = np.cumsum(shares(found, anywhere))
    _, at, var = found[int((uniform > below[:-1]).sum())]
    return at + math.sqrt(var) * normal


def log_measured(x, found, anywhere):
    """log p(x, z | a^-) less the log of the density by which x (2,) was drawn."""
    off = [math.exp(-((x - at) ** 2).sum() / 2 / var) / (2 * math.pi * var) for _, at, var in found]
    target = sum(math.exp(log_p) * density for (log_p, *_), density in zip(found, off, strict=True))
    return math.log(target) - math.log(shares(found, anywhere) @ off)
