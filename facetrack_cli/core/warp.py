"""Images under maps, read between pixels by OpenCV to the same last bit in 4 and 5.

OpenCV 4 reads at multiples of 1/32 pixel. OpenCV 5 reads where it is told to, so it is told those places: a hundredth
of all grey values would differ by 1 otherwise, and a filter that has drawn other particles goes its own way from there.
"""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np

from facetrack_cli.core.types import Array

_ROUNDS: Final = cv2.__version__.startswith("4.")


def warp_affine(
    image: Any, matrix: Any, size: tuple[int, int], border: int = cv2.BORDER_CONSTANT, *, inverse: bool = False
) -> Any:
    """`cv2.warpAffine`, linear, to an image of `size` (w, h). `inverse`: the matrix is from there to `image`."""
    if _ROUNDS:
        flags = cv2.INTER_LINEAR | (cv2.WARP_INVERSE_MAP if inverse else 0)
        return cv2.warpAffine(image, matrix, size, flags=flags, borderMode=border)
    return cv2.remap(
        image, *places(np.asarray(matrix, np.float64), size, inverse=inverse), cv2.INTER_LINEAR, None, border
    )


def places(matrix: Array, size: tuple[int, int], *, inverse: bool) -> tuple[Any, Any]:
    """Where `cv2.warpAffine` of OpenCV 4 reads: whole pixels (h, w, 2) and the number of 1/32 pixels beyond."""
    if not inverse:  # as there, term by term: another order has other last bits
        (a, b, x), (c, d, y) = matrix.tolist()
        by = a * d - b * c
        by = 1 / by if by else 0.0
        a, b, c, d = d * by, b * -by, c * -by, a * by
        matrix = np.array([[a, b, -a * x - b * y], [c, d, -c * x - d * y]])
    columns, rows = (np.arange(side, dtype=np.float64) for side in size)
    along = [np.rint(m[0] * columns * 1024) for m in matrix]
    down = [np.rint((m[1] * rows + m[2]) * 1024) + 16 for m in matrix]
    return _split(*((d[:, None] + a).astype(np.int64) >> 5 for a, d in zip(along, down, strict=True)))


def remap(image: Any, x: Any, y: Any, border: int) -> Any:
    """`cv2.remap`, linear, at x and y (h, w), float32."""
    at = (x, y) if _ROUNDS else _split(*(np.rint(one * 32).astype(np.int64) for one in (x, y)))
    return cv2.remap(image, *at, cv2.INTER_LINEAR, None, border)


def _split(x: Any, y: Any) -> tuple[Any, Any]:
    whole = np.clip(np.stack([x >> 5, y >> 5], axis=-1), -(2**15), 2**15 - 1).astype(np.int16)
    return whole, ((y & 31) * 32 + (x & 31)).astype(np.uint16)
