"""Nose and mouth of a face, placed by a cascade of linear regressions on gradients and redness (ours).

The supervised descent method of Xiong & De la Torre, "Supervised Descent Method and its Applications to Face
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
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.models import shipped_folder
from facetrack_cli.core.npz import Kind, Stored
from facetrack_cli.core.types import Array, Image
from facetrack_cli.trackers.face import channel_kernels as orientations
from facetrack_cli.trackers.face.channel_kernels import DIRECTIONS, smoothed_channels

KIND = Kind("facetrack-descent", 1, "mouth descent", "python tools/mouth_descent.py")
DEFAULT = "mouth_descent.npz"
LEFT, TOP, SIDE = 24, 46, 112  # of the stabilized image, pixels: the part that is read
CORNER: Final = np.array([LEFT, TOP], np.float64)
GRID: Final = 5
ODDS_SCALE: Final = 1.6
NEAR: Final = 3.0  # pixels
SEEN: Final = 14.0  # log odds of all parts, above which nothing else is tried
SURE: Final = 4.0  # bound of what one part says of how well a face lies, in log odds
STEP: Final = 5.0  # pixels between the points of the grid, times the stage's scale
AROUND: Final = (np.stack(np.meshgrid(*2 * [np.arange(GRID) - (GRID - 1) / 2]), axis=2) * STEP).reshape(-1, 2)


class PlacedPoints(NamedTuple):
    """Points `at` (K, 2), in pixels; `odds` (K,): log p(image | visible) - log p(image | covered)."""

    at: Array
    odds: Array

    @property
    def sure(self) -> float:
        """The log odds of all parts together, each of them bounded."""
        return float(np.clip(self.odds, -SURE, SURE).sum())


class Descent(NamedTuple):
    """`mean` (K, 2): the mean shape in the part of the stabilized image that is read; `stages` (S, F + 1, 2 K): R_k.

    `scales` (S,): of the grid in each stage; `std` (K,): of the errors on people that were left out, pixels; `odds`
    (F / K + 1, J): of J points, the K `parts` first.
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
        """The parts in a stabilized image, of which `seen` are the channels, if they are known.

        If they are hardly seen from the usual place of a face, they are sought around other middles (2,); the likeliest
        is taken, by the odds of being visible.
        """
        usual = self.mean.mean(axis=0) + CORNER
        best = self._from(still, np.zeros(2), seen)
        for middle in around:
            shift = np.round(middle - usual)
            if best.sure < SEEN and np.abs(shift).max() >= NEAR:  # from nearer the regression finds its way
                best = max(best, self._from(still, shift), key=lambda one: one.sure)
        return best

    def _from(self, still: Image, shift: Array, seen: NDArray[np.float32] | None = None) -> PlacedPoints:
        """The parts, sought `shift` (2,) beside the usual place."""
        seen = seen_in(still, shift) if seen is None else seen
        at = self.descended(seen) + CORNER
        return PlacedPoints(at + shift, self.visible(seen, at))

    def descended(self, seen: NDArray[np.float32]) -> Array:
        """x after the last stage (K, 2), in the channels of the part of the stabilized image that is read."""
        return orientations.descended(seen, self.mean, AROUND, self.scales, self.stages)

    def visible(self, seen: NDArray[np.float32], at: Array) -> Array:
        """The log odds (J,) that the first J points are visible at (J, 2), by the channels `seen`."""
        phi, odds = orientations.read(seen, at - CORNER, ODDS_SCALE * AROUND), self.odds[:, : len(at)]
        return np.asarray(np.einsum("jf,fj->j", phi.reshape(len(at), -1), odds[:-1]) + odds[-1])

    def save(self, path: Path) -> None:
        """Raises OutputError."""
        numbers: dict[str, Array] = {name: np.asarray(getattr(self, name), "<f8") for name in ("mean", "scales", "std")}
        numbers |= {name: getattr(self, name).astype("<f2") for name in ("stages", "odds")}
        KIND.write(path, {"points": np.array(self.points), **numbers})


@lru_cache(maxsize=8)
def load_descent(path: Path | None = None) -> Descent:
    """The descent in a file that `save` wrote, by default the shipped one. Raises InputError for anything else."""
    return KIND.read(shipped_folder() / DEFAULT if path is None else path, _made)


def _made(stored: Stored) -> Descent:
    points, stages = stored.texts("points"), stored.reals("stages", 3).astype(np.float32)
    mean, scales, std = stored.reals("mean", 2), stored.reals("scales", 1), stored.reals("std", 1)
    odds, k, width = stored.reals("odds", 2).astype(np.float32), len(mean), GRID**2 * (DIRECTIONS + 3)
    if not k or len(set(points)) < len(points) or not len(scales):
        raise ValueError("a descent has a stage or more, and a part or more, each named once")
    if not all(np.isfinite(one).all() for one in (stages, mean, scales, std, odds)) or min(*scales, *std) <= 0:
        raise ValueError("a number is not finite, or a scale or an error not above 0")
    shapes = [one.shape for one in (stages, mean, std, odds)]
    if shapes != [(len(scales), k * width + 1, 2 * k), (k, 2), (k,), (width + 1, len(points))] or k > len(points):
        raise ValueError(f"arrays of {shapes} do not fit {len(points)} points")
    return Descent(points, mean, stages, scales, std, odds)


def seen_in(still: Image, shift: Array | None = None) -> NDArray[np.float32]:
    """The channels of the part of a stabilized image that is read, or of the part (2,) whole pixels beside it."""
    if shift is None or not shift.any():
        return channels(still[TOP : TOP + SIDE, LEFT : LEFT + SIDE])
    x, y = (CORNER + shift + (SIDE - 1) / 2).tolist()
    size = still.shape[0]
    part = cv2.getRectSubPix(still, (SIDE, SIDE), (float(np.clip(x, 0, size)), float(np.clip(y, 0, size))))
    return channels(np.asarray(part, np.uint8))


def read(seen: NDArray[np.float32], x: Array, scale: float) -> NDArray[np.float32]:
    """phi of parts x (K, 2): the channels at the nearest pixels of the grids, and a 1; (K GRID^2 C + 1,)."""
    return np.append(orientations.read(seen, x, scale * AROUND).ravel(), np.float32(1))


def channels(image: Image) -> NDArray[np.float32]:
    """The channels of an image (H, W, 3), as `smoothed_channels` has them."""
    return smoothed_channels(np.asarray(cv2.blur(image, (3, 3)), np.uint8))
