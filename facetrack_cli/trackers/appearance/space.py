"""The affine maps of a face, and how its patches are read (Zhou, Chellappa & Moghaddam 2003, section 4 and eq. 3)."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.geometry import centre
from facetrack_cli.core.types import Array, Box, Frame, Particles, factor_for
from facetrack_cli.engine.kernels.affine import boxes_extent, read_patches
from facetrack_cli.engine.spaces import Context, Estimate, Outline, SizedSpace, estimate
from facetrack_cli.trackers.appearance.settings import PatchLikelihoodSettings
from facetrack_cli.trajectory.diagnostics import AFFINE, SCALE

MAX_FACTOR = 256  # a face of 13 times 256 pixels or more is read with gaps


@dataclass(frozen=True)
class AffineSpace(SizedSpace):
    """A box under affine maps (Zhou et al. 2003, section 4): state (1, 6) = (x, y, a1, a2, a3, a4).

    [[a1, a2], [a3, a4]] leads from the start to now. `size`: width, height in pixels at the start. Its angle is
    the rotation that is nearest to the deformation.
    """

    diagnostics: ClassVar = (SCALE, AFFINE)

    def windows(self, estimated: Estimate) -> Array:
        _, _, a1, a2, a3, a4 = estimated.state[0].tolist()
        return np.array([[math.hypot(a1, a3) * self.size[0], math.hypot(a2, a4) * self.size[1]]])

    def estimate(self, particles: Particles, ess: Array, *, best: bool) -> Estimate:
        squares = np.square(particles.x[:, 0, 2:])
        sides = np.sqrt(squares[:, :2] + squares[:, 2:]) * np.array(self.size)
        return estimate(particles, ess, best=best, sides=sides)

    def at(self, box: Box) -> Array:
        """Upright, and as wide and as high as the box."""
        return np.array([[*centre(box), box[2] / self.size[0], 0.0, 0.0, box[3] / self.size[1]]])

    def diagnose(self, estimated: Estimate) -> Mapping[str, Any]:
        x, y, *deformation = estimated.state[0].tolist()
        return {"scale": float(scale_of(estimated.state[None])[0, 0]), "affine": (*deformation, x, y)}

    def outline(self, estimated: Estimate) -> Outline:
        cx, cy, a1, a2, a3, a4 = estimated.state[0].tolist()
        # the border runs through the middle of the outermost pixels, as that of an upright box
        x, y = (max(side - 1, 1) / 2 for side in self.size)
        a1, a2, a3, a4, angle = a1 * x, a2 * y, a3 * x, a4 * y, math.degrees(math.atan2(a3 - a2, a1 + a4))
        ways = ((-1, -1), (1, -1), (1, 1), (-1, 1))
        return Outline(angle, np.array([(cx + i * a1 + j * a2, cy + i * a3 + j * a4) for i, j in ways]))


def scale_of(x: Array) -> Array:
    """How large x (N, 1, 6) are, 1 at the start -> (N, 1): the RMS of the deformation's singular values."""
    return np.asarray(np.sqrt(0.5 * np.sum(np.square(x[..., 2:6]), axis=-1)))


@dataclass(frozen=True)
class Patches:
    """How an affine face is read from a frame: template and patch (Zhou, Chellappa & Moghaddam 2003, eq. 3).

    Point (i, j) of a template of rows x cols is read, with the state of `AffineSpace`, at

        (cx, cy) + [[a1, a2], [a3, a4]] (w ((j + .5) / cols - .5), h ((i + .5) / rows - .5))

    with (w, h) the `size` in pixels of the box at the start; `shape`: (rows, cols), 30 x 26 in the paper. A patch has
    mean 0 and variance 1. Points beyond the frame are left out of both and are 0. A patch that is flat, or with less
    than half of it in the frame, is all 0.
    """

    size: tuple[float, float]
    shape: tuple[int, int] = (30, 26)

    def factor(self, state: Array) -> int:
        """By what to reduce the frame for patches around `state` (1, 6), a power of two; 1 for no numbers.

        The template's points are then at most 2 pixels apart, along that side where they are closer.
        """
        _, _, a1, a2, a3, a4 = state[0].tolist()
        rows, cols = self.shape
        step = min(self.size[0] / cols * math.hypot(a1, a3), self.size[1] / rows * math.hypot(a2, a4))
        return factor_for(min(step, 2.0 * MAX_FACTOR), 2.0) if step > 2.0 else 1

    def read(self, frame: Frame, x: Array, factor: int) -> NDArray[np.float32]:
        """Patches (N, d) of x (N, 1, 6), flattened by rows, from the frame in grey reduced by `factor`; read-only.

        The frame remembers the last few: of one state by its values, of more by the array x, which must not change.
        """
        key = self.size, self.shape, factor, x.tobytes() if x.size == 6 else id(x)
        if (known := frame.remembered(key)) is not None:
            return known
        states = np.ascontiguousarray(x.reshape(-1, 6))
        (w, h), (width, height) = self.size, frame.size
        extent = boxes_extent(states, w, h, width, height)
        # a box is read from the block before its first one too; after a single state mostly come particles around it
        more = float(factor) if len(states) > 1 else factor + 0.15 * max(extent[2] - extent[0], extent[3] - extent[1])
        grey, left, top = frame.grey(factor, (extent[0] - more, extent[1] - more, extent[2] + more, extent[3] + more))
        patches: NDArray[np.float32] = read_patches(
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
    """How the likelihood of a target reads patches. Raises TypeError for a likelihood that reads none."""
    likelihood = context.settings.likelihood
    if not isinstance(likelihood, PatchLikelihoodSettings):
        raise TypeError(f"the likelihood {likelihood.type} does not compare patches")
    columns, rows = likelihood.template
    return Patches(context.placed.size, (rows, columns))
