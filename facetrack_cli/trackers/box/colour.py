"""Per-pixel colours of the target and of its surroundings (Bertinetto et al. 2016, Staple, section 3.4).

A pixel's colour u is the target's with probability P(O | u) / (P(O | u) + P(B | u)), by histograms of the target's box
and of the rest of the window (eq. 23 to 26 there); the score of a place is its mean over the box there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from facetrack_cli.core.types import Array, Image
from facetrack_cli.trackers.box.features import Single

_SIDE = 64  # pixels of a window that is read for colours
_BITS = 5  # of each channel: 32 levels
_RATE = 0.04
_TELLS = 0.2  # how much more likely the target's pixels must be than those around, on average


class Colours(NamedTuple):
    """Histograms (32768,) of the target and of its surroundings, and how far they tell the two apart, 0..1."""

    target: Single
    around: Single
    tells: float = 0.0


@dataclass(frozen=True)
class ColourModel:
    """`box`: width and height of the target as shares of the window's side."""

    box: tuple[float, float]

    def learn(self, known: Colours | None, window: Image, rate: float) -> Colours:
        """From a window (n, n, 3) in whose middle the target is; `rate` 1 as Staple learns, 0 not at all."""
        bins = _bins(window)
        half = np.abs(np.arange(_SIDE) - (_SIDE - 1) / 2) / _SIDE
        w, h = (max(side, 2.5 / _SIDE) for side in self.box)
        inside = np.outer(half <= 0.4 * h, half <= 0.4 * w)
        outside = ~np.outer(half <= 0.55 * h, half <= 0.55 * w)
        if not outside.any():
            outside = np.ones_like(inside)
        target, around = (_histogram(bins[of]) for of in (inside, outside))
        if known is not None:
            keep, new = np.float32(1 - _RATE * rate), np.float32(_RATE * rate)
            target, around = keep * known.target + new * target, keep * known.around + new * around
        found = Colours(target, around)
        p = _probability(found, bins)
        return found._replace(tells=max(float(p[inside].mean() - p[outside].mean()), 0.0))

    def respond(self, known: Colours, window: Image, samples: int) -> Single | None:
        """The score (samples, samples) of the box around each place of the window; None where colour tells nothing."""
        if known.tells < _TELLS:
            return None
        w, h = (max(round(0.8 * side * _SIDE), 1) | 1 for side in self.box)
        mean = cv2.blur(_probability(known, _bins(window)), (w, h), borderType=cv2.BORDER_REPLICATE)
        return np.asarray(cv2.resize(mean, (samples, samples), interpolation=cv2.INTER_LINEAR), np.float32)


def _bins(window: Image) -> Array:
    small = cv2.resize(window, (_SIDE, _SIDE), interpolation=cv2.INTER_AREA).astype(np.int64) >> (8 - _BITS)
    return np.asarray((small[..., 0] << 2 * _BITS) | (small[..., 1] << _BITS) | small[..., 2])


def _histogram(bins: Array) -> Single:
    return (np.bincount(bins, minlength=1 << 3 * _BITS) / max(len(bins), 1)).astype(np.float32)


def _probability(known: Colours, bins: Array) -> Single:
    target, around = known.target[bins], known.around[bins]
    return np.where(target + around > 0, target / np.maximum(target + around, np.float32(1e-12)), np.float32(0.5))
