"""Resampling schemes, the effective sample size, and arithmetic on log weights.

Every scheme takes the generator, normalised log weights (N,) and a number of draws M, and returns M indices (M,) int64
in ascending order, each below N and never of a particle whose weight is zero. Expected counts are M * w for them all.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.types import Array

Indices: TypeAlias = NDArray[np.int64]
Resampling: TypeAlias = Callable[[np.random.Generator, Array, int], Indices]


def logsumexp(a: Array, axis: int | None = None) -> Array:
    """log(sum(exp(a))) along `axis` (over all of it by default), without overflow; -inf for an empty sum of weights."""
    top = np.max(a, axis=axis, keepdims=True)
    top = np.where(np.isfinite(top), top, 0.0)
    with np.errstate(divide="ignore"):
        total = np.log(np.sum(np.exp(a - top), axis=axis, keepdims=True)) + top
    return np.asarray(np.squeeze(total, axis=axis) if axis is not None else total.reshape(()))


def normalise(log_w: Array) -> Array:
    """Log weights shifted so that their logsumexp is 0. Where all are zero, or one is no number, they become equal.

    A frame that no particle explains must not end a track: equal weights leave the predictive density as it was.
    """
    top = log_w.max()
    if not np.isfinite(top):
        return np.full(log_w.shape, -np.log(log_w.size))
    shifted = log_w - top
    return np.asarray(shifted - np.log(np.exp(shifted).sum()))


def effective_sample_size(log_w: Array, axis: int = 0) -> Array:
    """1 / sum(w^2) of normalised log weights along `axis`: from 1 (one particle holds all) to N (all equal)."""
    return np.asarray(np.exp(-logsumexp(2.0 * log_w, axis=axis)))


def uniform(n: int) -> Array:
    """Normalised log weights of n equal particles, (n,)."""
    return np.full(n, -np.log(n))


def _invert(weights: Array, points: Array) -> Indices:
    """Indices where the cumulated weights first exceed each of the ascending `points` in [0, 1)."""
    cumulated = np.cumsum(weights)
    # scaled to the sum reached, so that rounding can neither pass the last particle nor pick one of weight zero
    chosen = np.searchsorted(cumulated, points * cumulated[-1], side="right")
    return np.asarray(np.minimum(chosen, np.flatnonzero(weights)[-1]), np.int64)


def systematic(rng: np.random.Generator, log_w: Array, m: int) -> Indices:
    """One uniform offset, M evenly spaced points: the least noisy, each count is floor or ceil of M * w."""
    return _invert(np.exp(log_w), (np.arange(m) + rng.random()) / m)


def stratified(rng: np.random.Generator, log_w: Array, m: int) -> Indices:
    """One uniform point in each of M equal strata."""
    return _invert(np.exp(log_w), (np.arange(m) + rng.random(m)) / m)


def multinomial(rng: np.random.Generator, log_w: Array, m: int) -> Indices:
    """M independent draws, as the papers' algorithms are written."""
    return _invert(np.exp(log_w), np.sort(rng.random(m)))


def residual(rng: np.random.Generator, log_w: Array, m: int) -> Indices:
    """floor(M * w) copies of each, and the remainder drawn systematically from what is left over."""
    w = np.exp(log_w)
    expected = m * w / w.sum()
    copies = np.floor(expected).astype(np.int64)
    rest = m - int(copies.sum())
    fixed = np.repeat(np.arange(w.size), copies)
    if rest <= 0:  # rounding can make the floors add up to all of M
        return fixed[:m]
    fraction = expected - copies
    drawn = _invert(fraction, (np.arange(rest) + rng.random()) / rest)
    return np.sort(np.concatenate([fixed, drawn]))


SCHEMES: dict[str, Resampling] = {
    "systematic": systematic,
    "stratified": stratified,
    "multinomial": multinomial,
    "residual": residual,
}
