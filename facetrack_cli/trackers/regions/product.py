"""The product of several likelihoods of the same part (Odobez, Ba & Gatica-Perez, IDIAP-RR 03-15, 2003, eq. 10).

    p(z_k | z_{k-1}, c_k, c_{k-1}) = p_c(z_k | z_{k-1}, c_k, c_{k-1}) x p_o(z_k | c_k)

p_o may itself be the product of a contour and a histogram (section 4). The factors are taken to be independent; the
paper notes that this is not strictly so for colours and correlation, which look at the same pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from facetrack_cli.core.types import Array, Frame, Particles
from facetrack_cli.engine.protocols import Likelihood
from facetrack_cli.engine.spaces import Context
from facetrack_cli.trackers.regions.settings import ProductSettings


@dataclass(frozen=True)
class Product(Likelihood):
    """`factors` that have `distances` say what the target looks like, p_o, the others how it moved, p_c."""

    factors: tuple[Any, ...]

    @classmethod
    def build(cls, settings: ProductSettings, context: Context) -> Product:
        return cls(tuple(one.build(context) for one in settings.factors))

    def init(self, frame: Frame, x0: Array) -> tuple[Any, ...]:
        """What each factor learns from the first frame with the parts at x0 (K, D)."""
        return tuple(factor.init(frame, x0) for factor in self.factors)

    def score(self, learned: tuple[Any, ...], frame: Frame, x: Array, parents: Array) -> Array:
        """(N, K): the sum of the factors' log-likelihoods."""
        total = np.zeros(x.shape[:2])
        for factor, known in zip(self.factors, learned, strict=True):
            total += factor.score(known, frame, x, parents)
        return total

    def learn(self, learned: tuple[Any, ...], frame: Frame, state: Array, particles: Particles) -> tuple[Any, ...]:
        """What each factor knows after a frame."""
        return tuple(f.learn(known, frame, state, particles) for f, known in zip(self.factors, learned, strict=True))

    def distances(self, learned: tuple[Any, ...], frame: Frame, x: Array) -> Array:
        """(N, K): the mean over the factors of p_o, from 0, a perfect match, to about 1. ValueError without p_o."""
        both = zip(self.factors, learned, strict=True)
        found = [factor.distances(known, frame, x) for factor, known in both if hasattr(factor, "distances")]
        if not found:
            raise ValueError("only what the object looks like can be compared with the first frame")
        return np.asarray(np.mean(found, axis=0))
