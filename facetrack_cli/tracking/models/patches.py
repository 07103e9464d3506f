"""How an affine face is read from a frame: template and patch (Zhou, Chellappa & Moghaddam 2003, eq. 3).

State x (N, 1, 6) = [cx, cy, a1, a2, a3, a4]: centre in pixels, deformation [[a1, a2], [a3, a4]] of the box at the
start, of which it is the identity. Point (i, j) of a template of rows x cols is read at

    (cx, cy) + [[a1, a2], [a3, a4]] (w ((j + .5) / cols - .5), h ((i + .5) / rows - .5))

A patch has mean 0 and variance 1. Points beyond the frame are left out of both and are 0. A patch that is flat, or with
less than half of it in the frame, is all 0.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array, Frame, factor_for
from facetrack_cli.recipe.affine import PatchLikelihood
from facetrack_cli.tracking.kernels import affine
from facetrack_cli.tracking.models.spaces import Context

MOST_FACTOR = 256  # a face of 13 times 256 pixels or more is read with gaps


@dataclass(frozen=True)
class Patches:
    """`size`: (w, h) in pixels of the box at the start; `shape`: (rows, cols) of the template, 30 x 26 in the paper."""

    size: tuple[float, float]
    shape: tuple[int, int] = (30, 26)

    @property
    def points(self) -> int:
        """d, the number of points of the template."""
        return self.shape[0] * self.shape[1]

    def factor(self, state: Array) -> int:
        """By what to reduce the frame for patches around `state` (1, 6), a power of two; 1 for no numbers.

        The template's points are then at most 2 pixels apart, along that side where they are closer.
        """
        _, _, a1, a2, a3, a4 = state[0].tolist()
        rows, cols = self.shape
        step = min(self.size[0] / cols * math.hypot(a1, a3), self.size[1] / rows * math.hypot(a2, a4))
        return factor_for(min(step, 2.0 * MOST_FACTOR), 2.0) if step > 2.0 else 1

    def read(self, frame: Frame, x: Array, factor: int) -> NDArray[np.float32]:
        """Patches (N, d) of x (N, 1, 6), flattened by rows, from the frame in grey reduced by `factor`; read-only.

        The frame remembers the last few: of one state by its values, of more by the array x, which must not change.
        """
        key = self, factor, x.tobytes() if x.size == 6 else id(x)
        if (known := frame.remembered(key)) is not None:
            return known
        states = np.ascontiguousarray(x.reshape(-1, 6))
        (w, h), (width, height) = self.size, frame.size
        extent = affine.boxes_extent(states, w, h, width, height)
        # a box is read from the block before its first one too; after a single state mostly come particles around it
        more = float(factor) if len(states) > 1 else factor + 0.15 * max(extent[2] - extent[0], extent[3] - extent[1])
        grey, left, top = frame.grey(factor, (extent[0] - more, extent[1] - more, extent[2] + more, extent[3] + more))
        patches: NDArray[np.float32] = affine.read_patches(
            grey, left, top, factor, width, height, extent, states, w, h, *self.shape
        )
        patches.flags.writeable = False
        frame.remember(key, x, patches)
        return patches

    def inside(self, frame: Frame, state: Array) -> float:
        """Which share of the template's points lies within the frame at `state` (1, 6)."""
        (w, h), (rows, cols), (width, height) = self.size, self.shape, frame.size
        cx, cy, a1, a2, a3, a4 = state[0].tolist()
        x, y = np.meshgrid(w * ((np.arange(cols) + 0.5) / cols - 0.5), h * ((np.arange(rows) + 0.5) / rows - 0.5))
        u, v = cx + a1 * x + a2 * y, cy + a3 * x + a4 * y
        return float(np.mean((u >= -0.5) & (v >= -0.5) & (u <= width - 0.5) & (v <= height - 0.5)))


def patches_of(context: Context) -> Patches:
    """How the likelihood of a target reads patches, which must be one that does."""
    likelihood = context.settings.likelihood
    if not isinstance(likelihood, PatchLikelihood):
        raise TypeError(f"the likelihood {likelihood.type} does not compare patches")
    columns, rows = likelihood.template
    return Patches(context.placed.size, (rows, columns))
