"""How many of the pixels of a patch, or of the normals of a contour, tell something of their own (ours).

A likelihood that is a product over n pixels counts them as independent. Neighbours are not: what is wrong with one, a
shift or a shadow, is wrong with the next. A sum of n terms with the autocorrelation rho has the variance of that of

    n_e = n / sum over lags of rho(lag)

independent ones, so the logarithm of the product counts n_e / n. rho is that of the terms, the logarithms themselves,
at the estimate; lags count up to the distance at which its mean is what independent terms have by chance, n^(-1/2).
"""

from typing import Final

import numpy as np

from facetrack_cli.core.types import Array

MEMORY: Final = 25  # frames over which shares are averaged: one alone is known to a quarter or so
_MIN_ENERGY: Final = 1e-9


def effective_share(terms: Array, *, ring: bool = False) -> float:
    """n_e / n of terms (rows, columns) or (n,), 1 / n to 1; on a `ring` the last is the first one's neighbour."""
    field = np.atleast_2d(np.asarray(terms, np.float64))
    off = field - field.mean()
    n, energy = off.size, float(np.sum(off * off))
    if n < 4 or energy < _MIN_ENERGY * n:
        return 1.0
    shape = off.shape if ring else tuple(2 * side if side > 1 else 1 for side in off.shape)
    power = np.abs(np.fft.rfft2(off, shape)) ** 2
    # the biased estimate: lags weigh as many pairs as there are
    rho = np.fft.irfft2(power, shape) / energy
    lags = [np.minimum(np.arange(side), side - np.arange(side)) for side in shape]
    far = np.maximum.outer(*lags).ravel()
    sums, counts = np.bincount(far, rho.ravel()), np.bincount(far)
    chance = np.flatnonzero(sums <= counts / np.sqrt(n))
    total = float(np.sum(sums[: chance[0]] if chance.size else sums))
    return float(np.clip(1 / max(total, _MIN_ENERGY), 1 / n, 1.0))


def averaged(share: float, frames: int, new: float) -> float:
    """The mean share after one more frame, of all so far, later of the last `MEMORY` or so."""
    return share + (new - share) / min(frames + 1, MEMORY)
