# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""How likely places are, given all particles of the frame before (a marginal particle filter; Klaas et al. 2005)."""

import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.engine.kernels.compiled import exact

Array: TypeAlias = NDArray[np.float64]


def arrive(
    z: Array, mean: Array, step: Array, scale: float, log_shown: Array, log_hidden: Array, u: Array,
    shown: Array, hidden: Array, which: Any,
) -> None:  # fmt: skip
    """log sum_m w_m p(z_n | m) of places and log scales z (N, 3), where the target is visible, and where it is hidden.

    A particle m of the last frame is expected at `mean` (M, 3), with standard deviations `step` (M, 2), visible and
    hidden, along x and y, and `scale` of the log scale; `log_shown`, `log_hidden` (M,) are the logarithms of its weight
    times the probability of either. Sums go to `shown`, `hidden` (N,). `which` (N,) is the m from which z_n came, or
    M + m where it was hidden, drawn by u (N,), uniform in 0..1.
    """
    logs, factor, parts = np.empty((3, 2, len(mean)))
    _arrive(z, mean, step, scale, log_shown, log_hidden, u, shown, hidden, which, logs, factor, parts.reshape(-1))


@exact
def _arrive(z, mean, step, scale, log_shown, log_hidden, u, shown, hidden, which, logs, factor, parts):
    many = len(mean)
    for m in range(many):
        for k in range(2):
            factor[k, m] = -0.5 / step[m, k] ** 2
            logs[k, m] = -2.0 * math.log(step[m, k]) - math.log(scale) - 1.5 * math.log(2.0 * math.pi)
        logs[0, m] += log_shown[m]
        logs[1, m] += log_hidden[m]
    for n in range(len(z)):
        top = -math.inf
        for m in range(many):
            dx, dy, ds = z[n, 0] - mean[m, 0], z[n, 1] - mean[m, 1], (z[n, 2] - mean[m, 2]) / scale
            away = dx * dx + dy * dy
            for k in range(2):
                value = logs[k, m] + factor[k, m] * away - 0.5 * ds * ds
                parts[k * many + m] = value
                top = max(top, value)
        seen = unseen = 0.0
        for m in range(many):
            parts[m] = math.exp(parts[m] - top)
            seen += parts[m]
        for m in range(many, 2 * many):
            parts[m] = math.exp(parts[m] - top)
            unseen += parts[m]
        shown[n] = math.log(seen) + top if seen > 0.0 else -math.inf
        hidden[n] = math.log(unseen) + top if unseen > 0.0 else -math.inf
        left, chosen = u[n] * (seen + unseen), 2 * many - 1
        for i in range(2 * many):
            left -= parts[i]
            if left <= 0.0 and parts[i] > 0.0:
                chosen = i
                break
        which[n] = chosen
