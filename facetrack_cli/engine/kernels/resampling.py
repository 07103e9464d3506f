# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""Drawing indices by weights."""

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.engine.kernels.compiled import exact


def invert_cdf(weights: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.int64]:
    """For each column, the indices at which the cumulated weights first exceed each ascending point of [0, 1).

    `weights` (N, K), not all zero in a column, need not sum to one; `points` (M, K) -> (M, K) int64. Never an index of
    weight zero, and never N, however the sums are rounded.
    """
    out = np.empty((len(points), weights.shape[1]), np.int64)
    _invert_cdf(weights, points, out)
    return out


@exact
def _invert_cdf(weights, points, out):
    (n, columns), m = weights.shape, points.shape[0]
    for k in range(columns):
        total, last = 0.0, 0
        for i in range(n):
            total += weights[i, k]
            if weights[i, k] > 0.0:
                last = i
        i, cumulated = 0, weights[0, k]
        for j in range(m):
            while i < last and cumulated <= points[j, k] * total:
                i += 1
                cumulated += weights[i, k]
            out[j, k] = i
