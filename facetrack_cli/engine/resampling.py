"""Resampling, arithmetic on log weights, and effective sample sizes: of particles, and of pixels (ours).

A likelihood that is a product over n pixels counts them as independent. Neighbours are not: what is wrong with one, a
shift or a shadow, is wrong with the next. A sum of n terms with the autocorrelation rho has the variance of that of

    n_e = n / sum over lags of rho(lag)

independent ones, so the logarithm of the product counts n_e / n. rho is that of the terms, the logarithms themselves,
at the estimate; lags count up to the distance at which its mean is what independent terms have by chance, n^(-1/2).
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from facetrack_cli.core.types import Array, Whole
from facetrack_cli.engine.kernels.compiled import invert_cdf

MEMORY: Final = 25  # frames over which shares are averaged: one alone is known to a quarter or so
_MIN_ENERGY: Final = 1e-9


def logsumexp(a: Array, axis: int = 0) -> Array:
    """log(sum(exp(a))) along `axis`, without overflow; -inf for an empty sum of weights."""
    top = a.max(axis=axis, keepdims=True)
    top = np.where(np.isfinite(top), top, 0.0)
    with np.errstate(divide="ignore"):
        return np.asarray((np.log(np.exp(a - top).sum(axis=axis, keepdims=True)) + top).squeeze(axis))


def normalise(log_w: Array) -> Array:
    """Log weights (N,) or (N, K) shifted so that the logsumexp along N is 0.

    Where all are zero, or one is no number, they become equal: a frame that no particle explains must not end a track.
    """
    return summed(log_w)[0]


def summed(log_w: Array) -> tuple[Array, Array]:
    """`normalise` and `logsumexp` of log weights (N,) or (N, K), for what neither of them needs to compute twice."""
    top = np.maximum.reduce(np.ascontiguousarray(log_w.T), axis=-1)  # along what is contiguous, in half the time
    if np.isfinite(top).all():
        shifted = log_w - top
        total = np.log(np.add.reduce(np.exp(shifted)))
        return shifted - total, total + top
    hopeless = ~np.isfinite(top)
    usable = np.where(hopeless, 0.0, log_w)
    shifted = usable - np.where(hopeless, 0.0, top)
    return np.asarray(shifted - np.log(np.exp(shifted).sum(axis=0))), logsumexp(log_w)


def effective_sample_size(log_w: Array) -> Array:
    """1 / sum(w^2) of normalised log weights along N: from 1 (one particle holds all) to N (all equal)."""
    return np.asarray(1.0 / np.exp(2.0 * log_w).sum(axis=0))


def distinct(chosen: Whole, log_w: Array) -> Array:
    """(K,): effective sample size of particles (N, K) that repeat: `chosen` (N, K) are their origins, log_w (N,).

    What comes from one origin is one sample; of all different origins it is that of the weights.
    """
    n, k = chosen.shape
    each = np.bincount((chosen + n * np.arange(k)).ravel(), np.repeat(np.exp(log_w), k), n * k).reshape(k, n)
    return np.asarray(1.0 / np.square(each).sum(axis=1))


def uniform(n: int) -> Array:
    """Normalised log weights of n equal particles, (n,)."""
    return np.full(n, -np.log(n))


def systematic(rng: np.random.Generator, log_w: Array, m: int) -> Whole:
    """M indices (M,) or (M, K), ascending, by normalised log weights (N,), or (N, K) of K populations side by side.

    They are where the cumulated weights first exceed M evenly spaced points with one uniform offset: the least noisy
    scheme, in which each count is floor or ceil of M * w. Never an index of weight zero, however the sums are rounded.
    """
    w, points = np.exp(log_w), np.add.outer(np.arange(m), rng.random(log_w.shape[1:])) / m
    invert_cdf(w.reshape(len(w), -1), points.reshape(m, -1), out := np.empty((m, w[:1].size), np.int64))
    return out.reshape(points.shape)


def effective_share(terms: Array, *, ring: bool = False) -> float:
    """The share of the terms of a sum that count as independent, n_e / n.

    Parameters
    ----------
    terms : (rows, columns) or (n,), log-likelihoods of pixels at the estimate.
    ring : whether the last term is a neighbour of the first.

    Returns
    -------
    1 / n to 1; 1 of fewer than four terms, and of terms that are all equal.
    """
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


class Share(NamedTuple):
    """The mean share of terms that count as independent, of all `frames` so far, later of the last `MEMORY` or so."""

    mean: float = 1.0
    frames: int = 0

    def after(self, terms: Array, *, ring: bool = False) -> Share:
        """With that of the `terms` of one more frame, as `effective_share` takes them."""
        more = effective_share(terms, ring=ring) - self.mean
        return Share(self.mean + more / min(self.frames + 1, MEMORY), self.frames + 1)
