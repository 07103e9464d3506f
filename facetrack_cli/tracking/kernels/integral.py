"""Reading integral images between their pixels."""

from __future__ import annotations

from typing import Any

from facetrack_cli.tracking.kernels.compiled import inline


@inline
def corner(integral: Any, x: float, y: float) -> Any:
    """The integral image (H + 1, W + 1) at (x, y), edges of pixels at whole numbers, clipped to it; bilinear.

    It is the sum of all above and to the left, parts of pixels by their area.
    """
    height, width = integral.shape[0] - 1, integral.shape[1] - 1
    x, y = min(max(x, 0.0), 1.0 * width), min(max(y, 0.0), 1.0 * height)
    x0, y0 = min(int(x), width - 1), min(int(y), height - 1)
    fx, fy = x - x0, y - y0
    return (1.0 - fy) * ((1.0 - fx) * integral[y0, x0] + fx * integral[y0, x0 + 1]) + fy * (
        (1.0 - fx) * integral[y0 + 1, x0] + fx * integral[y0 + 1, x0 + 1]
    )
