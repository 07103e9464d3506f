# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""Steps of a walk that jumps, given what sensors measured, with the likelihood of where they lead, in one pass."""

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.engine.kernels.compiled import exact, read_at

Array: TypeAlias = NDArray[np.float64]


def jump(
    x: Array, uniform: Array, normal: Array, modes: tuple[Array, Array, Array], steps: tuple[Array, Array, float],
    rest: Array, keep: float, anywhere: float, maps: NDArray[np.float32], corner: Array, visible: Array,
    sharpness: float, floor: float,
) -> tuple[Array, Array]:  # fmt: skip
    """Particles x (N, K, 2) moved by a JumpingWalk given sensors, and their log likelihoods (N, K) with those of maps.

    `uniform` (N, K) and `normal` (N, K, 2) are the draws. `modes` are z (M, K, 2), p and w (M, K) of what is measured,
    `steps` the walk's `sigma`, `jump` and `jumps`, `anywhere` the share of draws that is even. `maps`, `corner`,
    `visible`, `sharpness` and `floor` are those of WindowNcc.
    """
    moved, log_p, parts = np.empty_like(x), np.empty(x.shape[:2]), np.empty((6, 2 * len(modes[0])))
    walk, windows = (rest, keep, anywhere), (maps, corner, visible, sharpness, floor)
    _jump(x, uniform, normal, *modes, *steps, *walk, *windows, parts, moved, log_p)
    return moved, log_p


@exact
def _jump(
    x, uniform, normal, z, p, w, sigma, jump, jumps, rest, keep, anywhere, maps, corner, visible, sharpness, floor,
    parts, moved, log_p,
):  # fmt: skip
    many = 2 * len(z)
    gain, var, share, drawn, width, above = parts
    for k in range(x.shape[1]):
        hidden = (1.0 - visible[k]) * math.exp(-floor * sharpness)
        for n in range(len(x)):
            mx, my = rest[k, 0] + keep * (x[n, k, 0] - rest[k, 0]), rest[k, 1] + keep * (x[n, k, 1] - rest[k, 1])
            if n == 0 or x[n, k, 0] != x[n - 1, k, 0] or x[n, k, 1] != x[n - 1, k, 1]:  # parents come in order
                top = -math.inf
                for c in range(many):
                    m, square = c // 2, sigma[k] ** 2 if c % 2 == 0 else jump[k] ** 2
                    wider = 1.0 + square * p[m, k]
                    gain[c], var[c] = 1.0 - 1.0 / wider, square / wider
                    off = (z[m, k, 0] - mx) ** 2 + (z[m, k, 1] - my) ** 2
                    often = max(1.0 - jumps if c % 2 == 0 else jumps, 1e-12)
                    above[c] = w[m, k] + math.log(often) - 0.5 * off * p[m, k] / wider - math.log(wider)
                    top = max(top, above[c])
                total = 0.0
                for c in range(many):
                    share[c] = math.exp(above[c] - top)
                    total += share[c]
                for c in range(many):
                    drawn[c] = (1.0 - anywhere) * share[c] / total + anywhere / many
                    width[c] = math.sqrt(var[c])
            left, c = uniform[n, k] - drawn[0], 0
            while left > 0.0 and c < many - 1:
                c += 1
                left -= drawn[c]
            u = mx + gain[c] * (z[c // 2, k, 0] - mx) + width[c] * normal[n, k, 0]
            v = my + gain[c] * (z[c // 2, k, 1] - my) + width[c] * normal[n, k, 1]
            moved[n, k, 0], moved[n, k, 1] = u, v
            target = proposal = 0.0
            for c in range(many):
                off = (u - mx - gain[c] * (z[c // 2, k, 0] - mx)) ** 2 + (
                    v - my - gain[c] * (z[c // 2, k, 1] - my)
                ) ** 2
                density = math.exp(-0.5 * off / var[c]) / var[c]
                target += share[c] * density
                proposal += drawn[c] * density
            r = read_at(maps[k], u - corner[k, 0], v - corner[k, 1])
            seen = math.log(visible[k] * math.exp(sharpness * (r - 1.0)) + hidden)
            log_p[n, k] = seen + top + math.log(target / proposal) if target > 0.0 else -math.inf
