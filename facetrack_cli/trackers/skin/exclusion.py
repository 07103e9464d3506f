"""Mutual exclusion of targets (Gonzalez & Collet, section 3; Gianni, Collet & Dalle, GW 2007)."""

from collections.abc import Sequence

import numpy as np

from facetrack_cli.core.types import Array
from facetrack_cli.engine.loop import Footprint
from facetrack_cli.trackers.skin.settings import Exclusion


def log_weights(settings: Exclusion, x: Array, footprints: Sequence[Footprint]) -> Array:
    """(N, K): what mutual exclusion adds to log p(y | x) of x (N, K, D) (Gianni, Collet & Dalle 2007).

    Particles are penalised when the objects are close, so that two filters do not track the same skin (Gonzalez &
    Collet, section 3). The papers print no formula. Chosen is, with the other targets j, each an ellipse:

        p(y | x) <- p(y | x) * prod_j (1 - strength * exp(-(d_j(x) / reach)^4 / 2))

    with d_j the distance from the centre of j in half axes of its ellipse, 1 on its outline. By the fourth power the
    whole ellipse is penalised and little outside of it. Where all particles are penalised alike, none is.
    """
    total = np.zeros(x.shape[:2])
    for footprint in footprints:
        half = np.maximum(footprint.half, 1.0)  # of a cloud that has shrunk to a point, a pixel is left
        squared = np.sum(((x[..., :2] - footprint.centre) / (half * settings.reach)) ** 2, axis=2)
        total += np.log1p(-min(settings.strength, 1 - 1e-12) * np.exp(-0.5 * np.minimum(squared, 1e6) ** 2))
    return total
