"""The eyes of a face, placed by linear regressions (ours).

From where nose and mouth are, and by the same channels (`cascaded_regression.py`), a cascade places the corners of both
eyes in the stabilized image. Lids need more: an eye is 18 pixels wide there, and a blink moves its upper lid by 5. So a
patch around each eye is read from the frame itself, at twice the size, along the line of the eyes, the right eye
mirrored.
With phi the gradients of log(grey) in 8 directions and log(grey), on a grid in the patch, and a 1, one matrix gives
corners and lids, and the log odds of the eye's being visible:

    (x, odds) = R phi

All matrices are ridge regressions, trained on real faces by `tools/eye_descent.py`.
"""

from __future__ import annotations

import cmath
from functools import lru_cache
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.face_points import GROUPS
from facetrack_cli.core.models import shipped_folder
from facetrack_cli.core.npz import Kind, Stored
from facetrack_cli.core.types import Array, Frame, Image
from facetrack_cli.trackers.face import image_kernels
from facetrack_cli.trackers.face.cascaded_regression import AROUND, CORNER, GRID, PlacedPoints, turned
from facetrack_cli.trackers.face.image_kernels import DIRECTIONS
from facetrack_cli.trackers.face.stabilized import EYES, Similarity, read_grey, slope

KIND = Kind("facetrack-eyes", 1, "eye descent", "python tools/eye_descent.py")
DEFAULT = "eye_descent.npz"
POINTS: Final = GROUPS["eyes"]
"""The points that are placed, in this order."""
CORNERS: Final = [0, 1, 4, 5]
"""Which of them are corners: from left to right."""
SIDES: Final = ([0, 1, 2, 3], [5, 4, 6, 7])
"""Of the left and the right eye: outer and inner corner, upper and lower lid."""
_BOTH: Final = np.array(SIDES)
ZOOM: Final = 2.0  # of a patch
SIDE: Final = 48  # of a patch, pixels
MIDDLE: Final = (SIDE - 1) / 2
CELL: Final = 4  # pixels between the points of its grid
NARROW: Final = 0.25  # width of an eye in distances between the eyes, below which it is turned away
SMALL: Final = 16.0  # pixels of the frame between the eyes, below which lids are not seen
STEEP: Final = 40.0  # log odds of being visible that are lost by a width that is narrower by 1, or a face by its size
OFFSETS: Final = np.stack(np.meshgrid(*2 * [np.arange(CELL // 2, SIDE, CELL, dtype=np.float64)]), axis=2).reshape(-1, 2)
WIDTH: Final = (SIDE // CELL) ** 2 * (DIRECTIONS + 1) + 1  # of phi


class EyeRegression(NamedTuple):
    """The trained regressions of both eyes, in pixels of the part of the stabilized image that is read.

    Attributes
    ----------
    rest, mean : (5, 2) and (4, 2), mean places of nose and mouth, and of the corners of the eyes
    first : (11, 8), how the corners follow nose and mouth
    scales, stages : (S,) and (S, F + 1, 8), as in `CascadedRegression`
    std : (4,), of the errors of outer and inner corner, upper and lower lid, on people that were left out
    lids : (WIDTH, 9), the matrix R
    """

    rest: Array
    mean: Array
    first: Array
    scales: Array
    std: Array
    stages: NDArray[np.float32]
    lids: NDArray[np.float32]

    def fit(self, frame: Frame, head: Similarity, seen: NDArray[np.float32], parts: Array) -> PlacedPoints:
        """The eyes (8, 2) of a face with nose and mouth at `parts` (5, 2), by the channels `seen` and by the frame.

        Both are in the stabilized image.
        """
        corners = self.corners(seen, parts)
        middles = 0.5 * (corners[::2] + corners[1::2])
        at, odds, wide = np.empty((len(POINTS), 2)), np.empty(len(POINTS)), ZOOM * EYES
        narrow = ZOOM, NARROW * wide, STEEP / wide, min(STEEP * (head.scale * EYES / SMALL - 1), 0.0)
        image_kernels.place_eyes(
            patches(frame, head, middles), OFFSETS, turned(self.lids), middles, narrow, _BOTH, at, odds
        )
        return PlacedPoints(at, odds)

    def corners(self, seen: NDArray[np.float32], parts: Array) -> Array:
        """The corners (4, 2), as the cascade has them."""
        trained = self.rest, self.mean, self.first, AROUND, self.scales, turned(self.stages)
        return np.asarray(image_kernels.find_corners(seen, parts - CORNER, *trained) + CORNER)

    def save(self, path: Path) -> None:
        """Raises OutputError."""
        arrays = self._asdict().items()
        KIND.write(path, {name: np.asarray(a, "<f2" if a.dtype == np.float32 else "<f8") for name, a in arrays})


def openings(at: Array) -> Array:
    """(..., 2) how far eyes (..., 8, 2) are open: the distance of their lids over that of their corners."""
    each = at[..., _BOTH, :]
    apart = np.hypot(*np.moveaxis(each[..., [0, 2], :] - each[..., [1, 3], :], -1, 0))
    return np.asarray(apart[..., 1] / np.maximum(apart[..., 0], 1e-9))


def views(head: Similarity, middles: Array) -> Array:
    """(2, 4) views of the patches around both eyes, whose `middles` (2, 2) are in the stabilized image."""
    turn = cmath.rect(head.scale / ZOOM, head.angle + slope(middles))
    return np.array([(*at, turn.real, turn.imag) for at in head.to_frame(middles).tolist()])


def patches(frame: Frame, head: Similarity, middles: Array) -> Image:
    """(2, SIDE, SIDE) of both eyes in grey; `middles` as of `views`."""
    return read_grey(frame, views(head, middles), head.scale / ZOOM, SIDE)


@lru_cache(maxsize=8)
def load_eyes(path: Path | None = None) -> EyeRegression:
    """The regressions in a file that `save` wrote, by default the shipped one. Raises InputError for anything else."""
    return KIND.read(shipped_folder() / DEFAULT if path is None else path, _made)


def _made(stored: Stored) -> EyeRegression:
    wide, width = len(CORNERS) * GRID**2 * (DIRECTIONS + 3) + 1, 2 * len(CORNERS)
    scales, stages = stored.reals("scales", 1), stored.reals("stages", 3)
    rest, mean, first, lids = (stored.reals(name, 2) for name in ("rest", "mean", "first", "lids"))
    std = stored.reals("std", 1)
    eyes = EyeRegression(rest, mean, first, scales, std, turned(stages).swapaxes(1, 2), turned(lids).T)
    shapes = [array.shape for array in eyes]
    if shapes != [(5, 2), (4, 2), (11, width), (len(scales),), (4,), (len(scales), wide, width), (WIDTH, 9)]:
        raise ValueError(f"arrays of {shapes} are no regressions of eyes")
    if not all(np.isfinite(array).all() for array in eyes) or not len(scales) or min(*scales, *std) <= 0:
        raise ValueError("a number is not finite, or a scale or an error not above 0")
    return eyes
