"""Mutual exclusion of targets: what one explains, the others should not (Gianni, Collet & Dalle 2007).

Particles are penalised when the objects are close, so that two filters do not track the same skin (Gonzalez & Collet,
section 3). The papers print no formula. Chosen is, for a particle at x and the other targets j, each an ellipse:

    p(y | x) <- p(y | x) * prod_j (1 - strength * exp(-(d_j(x) / reach)^4 / 2))

with d_j the distance from the centre of j in half axes of its ellipse, 1 on its outline. By the fourth power the whole
ellipse is penalised and little outside of it. Where all particles of a target are penalised alike, none is.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from facetrack_cli.core.types import Array
from facetrack_cli.recipe.skin import Exclusion


class Cover(NamedTuple):
    """What a target explains: an upright ellipse of `centre` (2,) and `half` axes (2,), in pixels."""

    centre: Array
    half: Array


def log_weights(settings: Exclusion, x: Array, covers: Sequence[Cover]) -> Array:
    """(N, K): what is added to log p(y | x) of x (N, K, D)."""
    total = np.zeros(x.shape[:2])
    for cover in covers:
        half = np.maximum(cover.half, 1.0)  # of a cloud that has shrunk to a point, a pixel is left
        squared = np.sum(((x[..., :2] - cover.centre) / (half * settings.reach)) ** 2, axis=2)
        total += np.log1p(-min(settings.strength, 1 - 1e-12) * np.exp(-0.5 * np.minimum(squared, 1e6) ** 2))
    return total
