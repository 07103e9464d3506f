"""Nose and mouth of a face, placed by a cascade of linear regressions on gradients and redness (ours).

The supervised descent method of Xiong & De la Torre, "Supervised CascadedRegression Method and its Applications to Face
Alignment", CVPR 2013. From the mean shape x_0, stage k moves all parts at once,

    x_{k+1} = x_k + R_k phi_k(x_k),

where phi_k are image channels read on a grid around each part, and a 1. The channels are the gradient of log(grey) in
8 directions, log(grey), redness log((red + 8) / (green + 8)) and its slope down the face, each relative to its
surroundings. The matrices R_k are ridge regressions, trained on real faces by `tools/mouth_descent.py`. Further
regressions give, from the channels around a point, the logarithm of the likelihood ratio of its being visible or
covered; they are trained on faces that boards, discs and fingers cover. They also know points that a network places.

Unlike windows it has no memory: its errors do not grow, and a mouth may open in a frame. It is less exact, and off by
about the same vector for a person.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.models import shipped_folder
from facetrack_cli.core.npz import Kind, Stored
from facetrack_cli.core.types import Array, Image
from facetrack_cli.trackers.face import image_kernels
from facetrack_cli.trackers.face.image_kernels import DIRECTIONS, smoothed_channels

KIND = Kind("facetrack-descent", 1, "mouth descent", "python tools/mouth_descent.py")
DEFAULT = "mouth_descent.npz"
LEFT, TOP, SIDE = 24, 46, 112  # of the stabilized image, pixels: the part that is read
CORNER: Final = np.array([LEFT, TOP], np.float64)
GRID: Final = 5
ODDS_SCALE: Final = 1.6
NEAR: Final = 2.5  # pixels
SEEN: Final = 14.0  # log odds of all parts, above which nothing else is tried
MAX_LOG_ODDS: Final = 4.0  # bound of what one part says of how well a face lies
STEP: Final = 5.0  # pixels between the points of the grid, times the stage's scale
AROUND: Final = (np.stack(np.meshgrid(*2 * [np.arange(GRID) - (GRID - 1) / 2]), axis=2) * STEP).reshape(-1, 2)


class PlacedPoints(NamedTuple):
    """Points that a regression or a network has placed.

    Attributes
    ----------
    at : (K, 2), in pixels
    odds : (K,), log p(image | visible) - log p(image | covered)
    """

    at: Array
    odds: Array

    @property
    def log_odds(self) -> float:
        """Log odds that the face is there: those of all points together, each of them bounded."""
        return float(sum(min(max(odds, -MAX_LOG_ODDS), MAX_LOG_ODDS) for odds in self.odds.tolist()))


class CascadedRegression(NamedTuple):
    """A trained cascade, in pixels of the part of the stabilized image that is read.

    Attributes
    ----------
    points : names of J points, of which the cascade places the first K, the `parts`
    mean : (K, 2), the mean shape
    stages : (S, F + 1, 2 K), the matrices R_k
    scales : (S,), by which the grid of each stage is wider
    std : (K,), of the errors on people that were left out
    odds : (F / K + 1, J), the regressions of whether a point is visible
    """

    points: tuple[str, ...]
    mean: Array
    stages: NDArray[np.float32]
    scales: Array
    std: Array
    odds: NDArray[np.float32]

    @property
    def parts(self) -> tuple[str, ...]:
        return self.points[: len(self.mean)]

    def fit(self, still: Image, around: Sequence[Array] = (), seen: NDArray[np.float32] | None = None) -> PlacedPoints:
        """The parts in a stabilized image.

        Parameters
        ----------
        still : (H, W, 3), the stabilized image
        around : middles (2,) of further starts, which are tried where the parts are hardly seen from the mean shape;
            the fit of the greatest log odds is taken
        seen : the image's `face_channels`, if they are computed already
        """
        seen = face_channels(still) if seen is None else seen
        best = self.placed_from(seen, self.mean)
        for middle in around:
            if best.log_odds >= SEEN:
                break
            shift = middle - CORNER - np.add.reduce(self.mean) / len(self.mean)
            if max(map(abs, shift.tolist())) >= NEAR:  # from nearer the regression finds its way
                best = max(best, self.placed_from(seen, self.mean + shift), key=lambda fit: fit.log_odds)
        return best

    def placed_from(self, seen: NDArray[np.float32], x: Array) -> PlacedPoints:
        """The parts, sought from x (K, 2) on."""
        return self._placed(seen, x, len(self.stages))

    def visible(self, seen: NDArray[np.float32], at: Array) -> Array:
        """The log odds (J,) that the first J points are visible at (J, 2), by the channels `seen`."""
        return self._placed(seen, at - CORNER, 0).odds

    def _placed(self, seen: NDArray[np.float32], x: Array, stages: int) -> PlacedPoints:
        odds: Any = np.empty(len(x), np.float32)
        cascade = AROUND, self.scales[:stages], turned(self.stages)[:stages]
        return PlacedPoints(image_kernels.place(seen, x, *cascade, ODDS_SCALE, self.odds, odds) + CORNER, odds)

    def save(self, path: Path) -> None:
        """Raises OutputError."""
        numbers: dict[str, Array] = {name: np.asarray(getattr(self, name), "<f8") for name in ("mean", "scales", "std")}
        numbers |= {name: getattr(self, name).astype("<f2") for name in ("stages", "odds")}
        KIND.write(path, {"points": np.array(self.points), **numbers})


@lru_cache(maxsize=8)
def load_regression(path: Path | None = None) -> CascadedRegression:
    """The cascade in a file that `save` wrote, by default the shipped one. Raises InputError for anything else."""
    return KIND.read(shipped_folder() / DEFAULT if path is None else path, _made)


def _made(stored: Stored) -> CascadedRegression:
    points, stages = stored.texts("points"), turned(stored.reals("stages", 3)).swapaxes(1, 2)
    mean, scales, std = stored.reals("mean", 2), stored.reals("scales", 1), stored.reals("std", 1)
    odds, k, width = stored.reals("odds", 2).astype(np.float32), len(mean), GRID**2 * (DIRECTIONS + 3)
    if not k or len(set(points)) < len(points) or not len(scales):
        raise ValueError("a cascade has a stage or more, and a part or more, each named once")
    arrays = stages, mean, std, odds
    if not all(np.isfinite(array).all() for array in (*arrays, scales)) or min(*scales, *std) <= 0:
        raise ValueError("a number is not finite, or a scale or an error not above 0")
    shapes = [array.shape for array in arrays]
    if shapes != [(len(scales), k * width + 1, 2 * k), (k, 2), (k,), (width + 1, len(points))] or k > len(points):
        raise ValueError(f"arrays of {shapes} do not fit {len(points)} points")
    return CascadedRegression(points, mean, stages, scales, std, odds)


def turned(matrices: NDArray[Any]) -> NDArray[np.float32]:
    """Matrices (..., F, J) as (..., J, F) in one piece, for sums along F; those of a file are kept so."""
    return np.ascontiguousarray(matrices.swapaxes(-1, -2), np.float32)


def face_channels(still: Image) -> NDArray[np.float32]:
    """The channels of the part of a stabilized image that is read."""
    return channels(still[TOP : TOP + SIDE, LEFT : LEFT + SIDE])


def read(seen: NDArray[np.float32], x: Array, scale: float) -> NDArray[np.float32]:
    """phi of parts x (K, 2): the channels at the nearest pixels of the grids, and a 1; (K GRID^2 C + 1,)."""
    return np.append(image_kernels.read(seen, x, scale * AROUND).ravel(), np.float32(1))


def channels(image: Image) -> NDArray[np.float32]:
    """The channels of an image (H, W, 3), as `smoothed_channels` has them."""
    return smoothed_channels(np.asarray(cv2.blur(image, (3, 3)), np.uint8))
