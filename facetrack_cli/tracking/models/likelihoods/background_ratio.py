"""Windows of a face's parts against the windows beside them, which learn their own scale (ours).

The distance d of a window to the template is that of Patras & Pantic (2004, eq. 8 and 9), the lesser one of two
templates: that of the first frame, and one that follows the part while it is visible. How large d is where the part
is, and beside it, is not set but learned from the clip: with mean and standard deviation (g, s) of d at the part, and
(b, t) of windows around it, which all change slowly with the light,

    log L(d) = -max(d - g, 0)^2 / (2 s^2) - log s + max(b - d, 0)^2 / (2 t^2) + log t

is the logarithm of the likelihood ratio of a window that shows the part to one that shows the background. A part may be
covered, and then any window is as likely as another. With v, how visible it was in the frame before,

    p(y | a) ~ v L(d(a)) + 1 - v,    v = 1 / (1 + exp((q - .9) / .08)),  q = (d - g) / (b - g) at the estimate

so that a part which matches nothing says nothing, and the shape prior alone places it. What covers a part is, as a
rule, less like it than what is beside it, and a part that has changed is more like it: hence the .9.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from facetrack_cli.core.types import Array, Frame, Mask, Particles
from facetrack_cli.recipe import face, points
from facetrack_cli.tracking.models.likelihoods.colour_ratio import ColourRatio, Templates
from facetrack_cli.tracking.models.spaces import Context

_MEMORY = 50.0  # frames over which distances are learned
_NEAR = 1 / 13  # of a window's size: so far off, a window still shows the part
_STRICTEST = 1 / 8  # the least s, in terms of b - g: a part that has never changed would allow no change
_COVERED, _SOFT = 0.9, 0.08
_SURE = (0.02, 0.98)  # bounds of v
_ANGLES = np.arange(8) * (2 * np.pi / 8)
_RING = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)


class Distances(NamedTuple):
    """Mean and standard deviation (K,) of the distances of windows."""

    mean: Array
    std: Array


class Learned(NamedTuple):
    """Templates, distances at K parts and beside them; how visible each is (K,), and how like the first frame (K,)."""

    first: Templates
    recent: Templates
    good: Distances
    bad: Distances
    visible: Array
    anchored: Array


@dataclass(frozen=True)
class BackgroundRatio:
    """`colours` measures distances of windows to templates."""

    settings: face.BackgroundRatio
    colours: ColourRatio

    @classmethod
    def build(cls, settings: face.BackgroundRatio, context: Context) -> BackgroundRatio:
        colours = points.ColourRatio(type="colour_ratio", max_samples=settings.max_samples)
        return cls(settings, ColourRatio(colours, context.placed.windows))

    def init(self, frame: Frame, x0: Array) -> Learned:
        first = self.colours.init(frame, x0)
        near = np.median(self.colours.distances(first, frame, self._around(x0, _NEAR)), axis=0)
        beside = self.colours.distances(first, frame, self._around(x0, 1.0))
        b, ones = beside.mean(axis=0), np.ones(len(x0))
        good, bad = Distances(near, 0.25 * np.abs(b - near)), Distances(b, np.maximum(beside.std(axis=0), b / 8))
        return Learned(first, first, good, bad, ones, ones)

    def _around(self, x0: Array, far: float) -> Array:
        """Windows (8, K, 2) around x0 (K, 2), `far` window sizes away."""
        return np.asarray(x0 + far * self.colours.windows * _RING[:, None])

    def distances(self, learned: Learned, frame: Frame, x: Array) -> Array:
        """d of windows at x (N, K, 2) -> (N, K)."""
        return self._both(learned, frame, x)[0]

    def _both(self, learned: Learned, frame: Frame, x: Array) -> tuple[Array, Array]:
        """d, and that to the first frame's template alone."""
        d = self.colours.distances(learned.first, frame, x)
        if learned.recent is learned.first:
            return d, d
        return np.minimum(d, self.colours.distances(learned.recent, frame, x)), d

    def log_ratio(self, learned: Learned, d: Array) -> Array:
        """log L of distances (..., K)."""
        (g, s), (b, t) = learned.good, learned.bad
        s, t = np.maximum(s, _STRICTEST * np.maximum(b - g, 1e-3)), np.maximum(t, 1e-3)
        here, beside = -0.5 * (np.maximum(d - g, 0) / s) ** 2, 0.5 * (np.maximum(b - d, 0) / t) ** 2
        return np.asarray(here - np.log(s) + beside + np.log(t))

    def score(self, learned: Learned, frame: Frame, x: Array, parents: Array) -> Array:
        """log p(y | x) of each part but for a constant, x (N, K, 2) -> (N, K); parents do not matter."""
        v = np.clip(learned.visible, *_SURE)
        return np.logaddexp(np.log(v) + self.log_ratio(learned, self.distances(learned, frame, x)), np.log1p(-v))

    def presence(self, learned: Learned, frame: Frame, state: Array) -> Array:
        """v (K,) of parts at the estimate (K, 2)."""
        return _visible(learned, self.distances(learned, frame, state[None])[0])

    def learn(self, learned: Learned, frame: Frame, state: Array, particles: Particles) -> Learned:
        """Distances at the part in proportion to v, those beside it always, the second template while it is seen."""
        each, to_first = self._both(learned, frame, np.vstack([state[None], self._around(state, 1.0)]))
        d, beside = each[0], each[1:]
        visible, (g, s), (b, t) = _visible(learned, d), learned.good, learned.bad
        rate, off = visible / _MEMORY, np.minimum(np.maximum(d - g, -2 * s), 2 * s)
        good = Distances(g + rate * off, np.sqrt((1 - rate) * (s**2 + rate * off**2)))
        away, spread = beside.mean(axis=0) - b, ((beside - b) ** 2).mean(axis=0)
        bad = Distances(b + away / _MEMORY, np.sqrt(t**2 + (spread - t**2) / _MEMORY))
        rate = self.settings.adapt * np.where(visible > 0.5, visible, 0.0)
        recent = self.colours.blended(learned.recent, frame, state, rate) if rate.any() else learned.recent
        like = self.log_ratio(learned, to_first[0])
        anchored = visible / (1 + np.exp(-np.clip(like, -30, 30)))
        return Learned(learned.first, recent, good, bad, visible, anchored)

    def relearn(self, learned: Learned, frame: Frame, x0: Array, parts: Mask) -> Learned:
        """With all that is known of `parts` (K,) as they look in `frame` at x0 (K, 2)."""
        anew, rate = self.init(frame, x0), parts.astype(np.float64)
        first, recent = (self.colours.blended(old, frame, x0, rate) for old in (learned.first, learned.recent))
        good, bad = (
            Distances(*(np.where(parts, new, old) for new, old in zip(*both, strict=True)))
            for both in ((anew.good, learned.good), (anew.bad, learned.bad))
        )
        visible, anchored = (np.where(parts, 1.0, old) for old in (learned.visible, learned.anchored))
        return Learned(first, recent, good, bad, visible, anchored)


def _visible(learned: Learned, d: Array) -> Array:
    """v of distances (K,)."""
    q = (d - learned.good.mean) / np.maximum(learned.bad.mean - learned.good.mean, 1e-3)
    return np.asarray(1 / (1 + np.exp(np.clip((q - _COVERED) / _SOFT, -30, 30))))
