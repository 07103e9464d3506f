"""What the spaces of a gallery are learned from: pictures, differences between them, and patches off the mark."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array
from facetrack_cli.tracking.identity.subspaces import Moments

Indices = NDArray[np.intp]
# of a patch: right, down (shares of its sides), degrees, size
_OFF = ((0.3, 0, 0, 1), (-0.3, 0, 0, 1), (0, 0.3, 0, 1), (0, -0.3, 0, 1), (0, 0, 40, 1), (0, 0, -40, 1), (0, 0, 0, 0.6))


@dataclass(frozen=True, eq=False)
class Pictures:
    """Patches `x` (n, d), the person `who` (n,) and the picture `of` (n,) of each, counted from 0.

    The first patch of a picture is the picture itself, further ones are copies that were cut a little off.
    """

    x: Array
    who: Indices
    of: Indices

    @property
    def first(self) -> NDArray[np.bool_]:
        """(n,): the pictures themselves."""
        mask = np.zeros(len(self.x), bool)
        mask[np.unique(self.of, return_index=True)[1]] = True
        return mask

    @property
    def faces(self) -> Array:
        """(P, d): what stands for each person."""
        first = self.first
        return np.stack([stand_in(self.x[first & (self.who == p)]) for p in range(self.who.max() + 1)])

    def to_own(self) -> tuple[Array, Indices]:
        """Differences of patches to what the other pictures of their person make up, and which patch each is of.

        Where there is no other picture they are those of its copies to the picture.
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

    def to_others(self, basis: Array | None) -> Others:
        """Differences of each patch to what stands for each other person, in the coordinates of a basis (r, d)."""
        faces = self.faces
        z, z_faces = (rows if basis is None else rows @ basis.T for rows in (self.x, faces))
        return Others(self.who, z, z_faces, _squares(self.x), _squares(faces), self.x @ faces.T)


@dataclass(frozen=True, eq=False)
class Others:
    """The n (P - 1) differences of patches to other persons, not written out: their moments come from sums.

    Coordinates `z` (n, r) of patches and `faces` (P, r) of what stands for each person, the squared lengths of both,
    and `along` (n, P), their products.
    """

    who: Indices
    z: Array
    faces: Array
    square: Array
    face_square: Array
    along: Array

    def moments(self, patches: NDArray[np.bool_], persons: NDArray[np.bool_]) -> Moments:
        """Of the differences of these patches (n,) to those of these persons (P,) who are others."""
        z, who, faces = self.z[patches], self.who[patches], self.faces[persons]
        known = persons[who][:, None]
        apart = np.where(known, self.faces[who], 0.0)  # a patch is not compared with its own person
        number = persons.sum() - known[:, 0]
        asked = len(z) - np.bincount(who, minlength=len(persons))[persons]
        cross = z.T @ (faces.sum(0) - apart)
        products = (z.T * number) @ z - cross - cross.T + (faces.T * asked) @ faces
        along = self.along[patches]
        between = (along @ persons).sum() - along[np.arange(len(z)), who][known[:, 0]].sum()
        square = number @ self.square[patches] - 2.0 * between + asked @ self.face_square[persons]
        return Moments(int(number.sum()), number @ z - asked @ faces, products, max(float(square), 0.0))


def _squares(x: Array) -> Array:
    return np.asarray(np.einsum("nd,nd->n", x, x))


def stand_in(pictures: Array) -> Array:
    """(d,): what stands for a person, the mean of the pictures (k, d), of unit variance again."""
    mean = pictures.mean(0)
    spread = float(mean.std())
    if len(pictures) == 1 or spread < 1e-6:
        return np.asarray(pictures[0])
    return np.asarray((mean - mean.mean()) / spread)


def off_the_mark(x: Array, shape: tuple[int, int]) -> Array:
    """Patches (m, d): each of x (n, d) displaced, turned and made smaller, where the border is repeated."""
    rows, cols = shape
    out = []
    for picture in x.astype(np.float32).reshape(-1, rows, cols):
        for dx, dy, angle, size in _OFF:
            m = cv2.getRotationMatrix2D(((cols - 1) / 2, (rows - 1) / 2), angle, size)
            m[:, 2] += np.array([dx * cols, dy * rows])
            moved = cv2.warpAffine(picture, m, (cols, rows), borderMode=cv2.BORDER_REPLICATE).astype(np.float64)
            spread = float(moved.std())
            out.append(((moved - moved.mean()) / spread if spread > 1e-6 else 0.0 * moved).ravel())
    return np.array(out)
