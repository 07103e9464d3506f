# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""Colours of an image that is given by its planes."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.engine.kernels.compiled import exact

Plane: TypeAlias = NDArray[np.uint8]


def coloured(y: Plane, u: Plane, v: Plane) -> Plane:
    """Blue, green and red, (3, H, W), of planes Y, U and V (H, W) of limited range by BT.601, as OpenCV computes it."""
    out = np.empty((3, *y.shape), np.uint8)
    _coloured(y.ravel(), u.ravel(), v.ravel(), *out.reshape(3, -1))
    return out


@exact
def _coloured(y, u, v, blue, green, red):
    half, shift, low, high = np.int32(1 << 19), np.int32(20), np.int32(0), np.int32(255)
    for i in range(len(y)):
        grey = max(np.int32(y[i]) - np.int32(16), low) * np.int32(1220542) + half
        b, r = np.int32(u[i]) - np.int32(128), np.int32(v[i]) - np.int32(128)
        blue[i] = min(max((grey + np.int32(2116026) * b) >> shift, low), high)
        green[i] = min(max((grey - np.int32(409993) * b - np.int32(852492) * r) >> shift, low), high)
        red[i] = min(max((grey + np.int32(1673527) * r) >> shift, low), high)
