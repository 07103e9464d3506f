"""Smoothing: the posterior of each frame given the frames after it too, p(x_t | Y_T) with t < T.

A filter leaves a belief a frame, mean and covariance of its particles, and the motion by which it came there. Backward
from the last frame, with m, P the belief of frame t, m', P' what the motion makes of it in frame t + 1, and m_s, P_s
the smoothed belief of that frame (Rauch, Tung & Striebel, AIAA Journal 1965; Särkkä, Bayesian Filtering and Smoothing,
2013, section 8.2):

    m' = A m + o,  P' = A P A^T + Q,  G = P A^T P'^-1
    m <- m + G (m_s - m'),  P <- P + G (P_s - P') G^T

The parts are smoothed apart. A frame that did not show a part says nothing of it: its belief becomes the prediction
from the last frame that did, so that between that frame and the next that does, the result is the bridge of the motion,
along with the parts that are seen meanwhile (ours).
Where a correction placed a target, its belief has no covariance, and nothing comes over it.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from facetrack_cli.core.types import Array, Mask, Particles
from facetrack_cli.engine.protocols import Linear

# of expectation and maximisation; more make errors larger again, which last from frame to frame
ROUNDS = 5
TAIL: Final = 1.0  # degrees of freedom of steps in `steadied`
_MIN_VARIANCE: Final = 1e-9  # of a variance: what is less is rounding
_TINY: Final = 1e-12


class Belief(NamedTuple):
    """What a filter knows of K parts after a frame: `mean` (K, D) and `cov` (K, D, D) of D coordinates of the state.

    `motion` is that from the frame before; `doubt` (K,) says which parts the frame may not show. Of a hand, `named`
    (2,) are the probability that both hands have their own names, and that these are others than in the frame before.
    """

    mean: Array
    cov: Array
    motion: Linear
    doubt: Mask
    named: Array | None = None


class Chain(NamedTuple):
    """Beliefs of T frames: `mean` (T, K, D), `cov` (T, K, D, D), the motions into each frame, of one axis more.

    Of (T, K) are `unseen`, whether the frame did not show the part; `joined`, whether there is a belief of it in this
    frame and in the one before; `linked`, whether it also says something of the frame before.
    """

    mean: Array
    cov: Array
    motion: Linear
    unseen: Mask
    joined: Mask
    linked: Mask


def belief(particles: Particles, motion: Linear, cov: Array, doubt: Mask) -> Belief:
    """Of particles x (N, K, D), with the estimate's covariance `cov` (K, 2, 2) of their places."""
    d = motion.matrix.shape[-1]
    w, x = np.exp(particles.log_w), particles.x[..., :d]
    mean = np.einsum("n,nkd->kd", w, x)
    spread = np.einsum("n,nkd,nke->kde", w, x - mean, x - mean)
    ours, theirs = (np.trace(matrix[:, :2, :2], axis1=1, axis2=2) for matrix in (spread, cov))
    # the estimate's counts how few particles it stands on; without particles that differ there is nothing to count
    more = np.divide(theirs, ours, out=np.ones(len(ours)), where=ours > _MIN_VARIANCE)
    return Belief(mean, spread * more[:, None, None], motion, doubt)


def names(p: Array, exchanged: Array) -> Array:
    """(T,): the probability, given all T frames, of the one of two states that was filtered to `p` (T,); `exchanged`
    (T,) is the probability that the state of a frame is not that of the frame before.
    """
    posterior = p.copy()
    for t in range(len(p) - 1, 0, -1):
        stay, change = p[t - 1] * (1 - exchanged[t]), p[t - 1] * exchanged[t]
        ahead = stay + (1 - p[t - 1]) * exchanged[t]
        posterior[t - 1] = stay * posterior[t] / max(ahead, _TINY) + change * (1 - posterior[t]) / max(1 - ahead, _TINY)
    return posterior


def chain(beliefs: Sequence[Belief], lost: Mask, gone: Mask, by_hand: Mask | None = None) -> Chain:
    """Of beliefs of T frames; `lost` (T, K) as the tracker judged, `gone` where there is no part to know of.

    In the frames `by_hand` (T,) corrections placed the parts. A part is `lost` only after some frames in doubt,
    which did not show it either. Those of the last stretch, after which it is never seen again, say nothing of what
    was before.
    """
    by_hand = np.zeros(len(lost), dtype=np.bool_) if by_hand is None else by_hand
    unseen = lost & ~gone & ~by_hand[:, None]
    seen_later = np.zeros_like(unseen)
    for t in range(len(unseen) - 2, -1, -1):
        unseen[t] |= unseen[t + 1] & beliefs[t].doubt & ~gone[t] & ~by_hand[t]
        seen_later[t] = ~gone[t + 1] & (~unseen[t + 1] | seen_later[t + 1])
    joined = np.zeros_like(unseen)
    joined[1:] = ~gone[1:] & ~gone[:-1]
    mean, cov = (np.stack([getattr(belief, name) for belief in beliefs]) for name in ("mean", "cov"))
    motion = Linear(*(np.stack(each) for each in zip(*(belief.motion for belief in beliefs), strict=True)))
    # what a frame does not show moves with the parts that it shows
    shown, offset = joined & ~unseen, motion.offset.copy()
    shown[1:] &= ~unseen[:-1] & ~by_hand[1:, None]
    for t in np.flatnonzero(shown.any(axis=1) & (joined & ~shown).any(axis=1)).tolist():
        offset[t, joined[t] & ~shown[t]] += (mean[t] - mean[t - 1])[shown[t]].mean(axis=0)
    return Chain(mean, cov, motion._replace(offset=offset), unseen, joined, joined & (~unseen | seen_later))


def bridged(beliefs: Chain) -> Chain:
    """With predictions in place of the beliefs of frames that did not show a part."""
    mean, cov = beliefs.mean.copy(), beliefs.cov.copy()
    for t in np.flatnonzero((beliefs.unseen & beliefs.joined).any(axis=1)).tolist():
        hidden = beliefs.unseen[t] & beliefs.joined[t]
        ahead, spread = _predicted(beliefs, t, mean[t - 1], cov[t - 1])
        mean[t, hidden], cov[t, hidden] = ahead[hidden], spread[hidden]
    return beliefs._replace(mean=mean, cov=cov)


def smoothed(beliefs: Chain) -> tuple[Array, Array]:
    """(T, K, D) means and (T, K, D, D) covariances given all T frames."""
    beliefs = bridged(beliefs)
    mean, cov = beliefs.mean, beliefs.cov
    for t in range(len(mean) - 1, 0, -1):
        if not beliefs.linked[t].any():
            continue
        ahead, spread = _predicted(beliefs, t, mean[t - 1], cov[t - 1])
        gain = cov[t - 1] @ beliefs.motion.matrix[t].mT @ _inverse(spread)
        gain[~beliefs.linked[t]] = 0.0
        mean[t - 1] += np.einsum("kde,ke->kd", gain, mean[t] - ahead)
        new = cov[t - 1] + gain @ (cov[t] - spread) @ gain.mT
        cov[t - 1] = (new + new.mT) / 2
    return mean, cov


def _predicted(beliefs: Chain, t: int, mean: Array, cov: Array) -> tuple[Array, Array]:
    """What the motion into frame t makes of mean (K, D) and covariance (K, D, D)."""
    matrix = beliefs.motion.matrix[t]
    ahead = np.einsum("kde,ke->kd", matrix, mean) + beliefs.motion.offset[t]
    return ahead, matrix @ cov @ matrix.mT + beliefs.motion.cov[t]


def steadied(at: Array, shown: Mask) -> Array:
    """Places (T, K, 2) without their jitter, where two successive frames have `shown` (T, K) a part.

    The places are a random walk with steps of Student's t, seen with normal noise: what rests is smoothed, and what
    moves stays as it is. Noise and steps are those of each part in the clip. The t is a normal density whose variance
    differs from frame to frame, and that is a hidden variable, too (Lange, Little & Taylor, Journal of the American
    Statistical Association 1989): expectation and maximisation find it, with a smoother of known variances within.
    """
    joined = shown[1:] & shown[:-1]
    bends = np.where(joined[1:] & joined[:-1], np.sum((at[2:] - 2 * at[1:-1] + at[:-2]) ** 2, axis=2), np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of parts that are never seen thrice
        noise = np.nan_to_num(np.nanmedian(bends, axis=0)) / (6 * 2 * math.log(2)) + _MIN_VARIANCE
    step, wide, smooth = noise.copy(), np.ones(joined.shape), at
    for _ in range(ROUNDS):
        var, smooth = np.empty(shown.shape), at.copy()
        var[0] = noise
        for t in range(1, len(at)):
            ahead = np.where(joined[t - 1], var[t - 1] + step * wide[t - 1], np.inf)
            gain = 1 / (1 + noise / ahead)
            var[t] = gain * noise
            before = np.where(joined[t - 1][:, None], smooth[t - 1], at[t])  # there may be none
            smooth[t] = before + gain[:, None] * (at[t] - before)
        moved = np.zeros(joined.shape)
        for t in range(len(at) - 2, -1, -1):
            ahead = var[t] + step * wide[t]
            gain = np.where(joined[t], var[t] / ahead, 0.0)
            moved[t] = var[t + 1] * (1 - gain) ** 2 + gain * step * wide[t]
            smooth[t] += gain[:, None] * np.where(joined[t][:, None], smooth[t + 1] - smooth[t], 0.0)
            var[t] += gain**2 * (var[t + 1] - ahead)
        moved += 0.5 * np.sum((smooth[1:] - smooth[:-1]) ** 2, axis=2)
        wide = np.where(joined, (TAIL + 2 * moved / step) / (TAIL + 2), 1.0)
        step = np.sum(moved / wide, axis=0, where=joined) / np.maximum(joined.sum(axis=0), 1) + _MIN_VARIANCE
    return smooth


def _inverse(cov: Array) -> Array:
    """The inverse of covariances (..., D, D), on their support."""
    scale = np.sqrt(np.maximum(np.diagonal(cov, axis1=-2, axis2=-1), 0.0))
    scale = np.where(scale > 1e-12, scale, 1.0)
    both = scale[..., None] * scale[..., None, :]
    return np.asarray(np.linalg.pinv(cov / both, rcond=_MIN_VARIANCE, hermitian=True) / both)
