"""By how much one image is shifted against another: phase correlation (Kuglin & Hines, 1975), right for every size.

`cv2.phaseCorrelate` takes the middle of the correlation to be at half of the length to which it pads a side. Of an odd
length that is half a pixel beside it: two equal images are then 0.5 apart, at a response of 1. So sides are padded here
to an even length. This is the only place that calls it.

The window keeps to its place where the image moves, which draws the peak to zero. So a shift of a pixel or more is
measured again, on what both images show.
"""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array

PASSES: Final = 3


def shift_between(before: NDArray[np.float32], after: NDArray[np.float32]) -> tuple[Array, float]:
    """The shift (2,) in pixels, x before y, from `before` to `after` (H, W), and the height of its peak, 0..1."""
    height, width = before.shape
    x = y = 0
    for _ in range(PASSES):
        ours = before[max(-y, 0) : height - max(y, 0), max(-x, 0) : width - max(x, 0)]
        theirs = after[max(y, 0) : height + min(y, 0), max(x, 0) : width + min(x, 0)]
        rest, sure = _peak(ours, theirs)
        shift = np.array([x, y]) + rest
        before_that, (x, y) = (x, y), np.rint(shift).astype(int).tolist()
        if (x, y) == before_that or 2 * abs(x) > width or 2 * abs(y) > height:
            break
    return shift, sure


def _peak(before: NDArray[np.float32], after: NDArray[np.float32]) -> tuple[Array, float]:
    height, width = before.shape
    window = cv2.createHanningWindow((width, height), cv2.CV_32F)
    bottom, right = _even(height) - height, _even(width) - width
    padded = (cv2.copyMakeBorder(one * window, 0, bottom, 0, right, cv2.BORDER_CONSTANT) for one in (before, after))
    shift, sure = cv2.phaseCorrelate(*padded)
    return np.array(shift), sure


def _even(length: int) -> int:
    """The least even length from `length` on that a Fourier transform takes fast."""
    found = cv2.getOptimalDFTSize(length)
    while found % 2:
        found = cv2.getOptimalDFTSize(found + 1)
    return found
