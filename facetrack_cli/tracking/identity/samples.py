"""What the spaces of a gallery are learned from: images, differences between them, and patches off the mark."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array, Mask
from facetrack_cli.tracking.identity.subspaces import Moments

Indices = NDArray[np.intp]
# of a patch: right, down (shares of its sides), degrees, size
_OFF = ((0.3, 0, 0, 1), (-0.3, 0, 0, 1), (0, 0.3, 0, 1), (0, -0.3, 0, 1), (0, 0, 40, 1), (0, 0, -40, 1), (0, 0, 0, 0.6))


@dataclass(frozen=True, eq=False)
class Samples:
    """Patches `x` (n, d), the person `who` (n,) and the image `of` (n,) of each, counted from 0.

    The first patch of an image is the image itself, further ones are copies that were cut a little off. Moments are in
    the coordinates of `basis` (r, d), None for all directions.
    """

    x: Array
    who: Indices
    of: Indices
    basis: Array | None = None

    @property
    def first(self) -> Mask:
        """(n,): the images themselves."""
        mask = np.zeros(len(self.x), bool)
        mask[np.unique(self.of, return_index=True)[1]] = True
        return mask

    @cached_property
    def faces(self) -> Array:
        """(P, d): what stands for each person."""
        first = self.first
        return np.stack([stand_in(self.x[first & (self.who == p)]) for p in range(self.who.max() + 1)])

    def to_own(self) -> tuple[Array, Indices]:
        """Differences of patches to the mean face of the other images of their person, and which patch each is of.

        Where there is no other image they are those of its copies to the image.
        """
        rows, index, first = [], [], self.first
        for k in range(self.of.max() + 1):
            mine = np.flatnonzero(self.of == k)
            others = first & (self.who == self.who[mine[0]]) & (self.of != k)
            stands = stand_in(self.x[others]) if others.any() else self.x[mine[0]]
            mine = mine if others.any() else mine[1:]
            rows.append(self.x[mine] - stands)
            index.append(mine)
        return np.concatenate(rows), np.concatenate(index)

    def to_others(self, patches: Mask, persons: Mask) -> Moments:
        """Moments of the differences of these patches (n,) to what stands for those of these persons (P,) who are
        others. The differences, up to n (P - 1) of them, are not written out: their moments come from sums.
        """
        coordinates, squares, face_coordinates, face_squares, products_of_both = self._sums
        z, who, faces = coordinates[patches], self.who[patches], face_coordinates[persons]
        known = persons[who][:, None]
        apart = np.where(known, face_coordinates[who], 0.0)  # a patch is not compared with its own person
        number = persons.sum() - known[:, 0]
        asked = len(z) - np.bincount(who, minlength=len(persons))[persons]
        cross = z.T @ (faces.sum(0) - apart)
        products = (z.T * number) @ z - cross - cross.T + (faces.T * asked) @ faces
        along = products_of_both[patches]
        between = (along @ persons).sum() - along[np.arange(len(z)), who][known[:, 0]].sum()
        square = number @ squares[patches] - 2.0 * between + asked @ face_squares[persons]
        return Moments(int(number.sum()), number @ z - asked @ faces, products, max(float(square), 0.0))

    @cached_property
    def _sums(self) -> tuple[Array, ...]:
        """Coordinates (n, r) and squared lengths (n,) of patches, the same of faces, and their products (n, P)."""
        of_each = []
        for rows in (self.x, self.faces):
            of_each += [rows if self.basis is None else rows @ self.basis.T, np.einsum("nd,nd->n", rows, rows)]
        return (*of_each, self.x @ self.faces.T)


def stand_in(images: Array) -> Array:
    """(d,): what stands for a person, the mean of the images (k, d), of unit variance again."""
    mean = images.mean(0)
    spread = float(mean.std())
    if len(images) == 1 or spread < 1e-6:
        return np.asarray(images[0])
    return np.asarray((mean - mean.mean()) / spread)


def off_the_mark(x: Array, shape: tuple[int, int]) -> Array:
    """Patches (m, d): each of x (n, d) displaced, turned and made smaller, where the border is repeated."""
    rows, cols = shape
    out = []
    for patch in x.astype(np.float32).reshape(-1, rows, cols):
        for dx, dy, angle, size in _OFF:
            m = cv2.getRotationMatrix2D(((cols - 1) / 2, (rows - 1) / 2), angle, size)
            m[:, 2] += np.array([dx * cols, dy * rows])
            moved = cv2.warpAffine(patch, m, (cols, rows), borderMode=cv2.BORDER_REPLICATE).astype(np.float64)
            spread = float(moved.std())
            out.append(((moved - moved.mean()) / spread if spread > 1e-6 else 0.0 * moved).ravel())
    return np.array(out)
