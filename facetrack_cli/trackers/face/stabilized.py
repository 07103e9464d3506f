"""The stabilized image: the frame seen from the head, in which the face is upright and has a fixed size."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import cv2
import numpy as np

from facetrack_cli.core.face_points import EYE_DISTANCE
from facetrack_cli.core.geometry import warp_affine
from facetrack_cli.core.types import Array, Extent, Frame, Image, Planes
from facetrack_cli.trackers.face.image_kernels import warp

SIDE: Final = 160  # sides of the stabilized image, in pixels
FACE: Final = 112.0  # sides of the face's box in it
MIDDLE: Final = (SIDE - 1) / 2
BOX: Final = (MIDDLE - (FACE - 1) / 2, MIDDLE - (FACE - 1) / 2, FACE, FACE)
EYES: Final = EYE_DISTANCE * FACE
EYE_LINE: Final = MIDDLE - 0.112 * FACE  # the row of the eyes


class Similarity(NamedTuple):
    """The map from a stabilized image to the frame."""

    centre: Array  # (2,), where the middle of the stabilized image lies in the frame, in pixels
    scale: float  # pixels of the frame to a pixel of the stabilized image
    angle: float = 0.0  # by which the image is turned in the frame, clockwise, in radians

    @property
    def turn(self) -> complex:
        """What places, as complex numbers about the middle, are multiplied by."""
        return complex(self.scale * math.cos(self.angle), self.scale * math.sin(self.angle))

    @property
    def matrix(self) -> Array:
        """(2, 2): [[a, -b], [b, a]] of the map."""
        turn = self.turn
        return np.array([[turn.real, -turn.imag], [turn.imag, turn.real]])

    def to_frame(self, x: Array) -> Array:
        """Places (..., 2) of the stabilized image in the frame."""
        return mapped(x, self.turn, complex(*self.centre) - self.turn * complex(MIDDLE, MIDDLE))

    def to_stabilized(self, x: Array) -> Array:
        """Places (..., 2) of the frame in the stabilized image."""
        return mapped(x, 1 / self.turn, complex(MIDDLE, MIDDLE) - complex(*self.centre) / self.turn)

    def within(self, other: Similarity) -> Similarity:
        """The map to the frame, where this one is to the stabilized image of another map."""
        return Similarity(other.to_frame(self.centre), other.scale * self.scale, other.angle + self.angle)

    def into(self, other: Similarity) -> tuple[complex, complex]:
        """What takes places x of this map's stabilized image to that of another map, as `mapped` does."""
        turn = other.turn
        turned, apart = self.turn / turn, complex(*self.centre.tolist()) - complex(*other.centre.tolist())
        return turned, apart / turn + (1 - turned) * complex(MIDDLE, MIDDLE)

    def is_near(self, other: Similarity, pixels: float) -> bool:
        """Whether the face's box lies within so many pixels of the stabilized image of where another map has it."""
        far = math.hypot(*(self.centre - other.centre)) + abs(self.scale - other.scale) * FACE / 2
        return far < pixels * self.scale and math.cos(self.angle - other.angle) > math.cos(2 * pixels / FACE)

    def read(self, frame: Frame, side: int = SIDE) -> Frame:
        """The stabilized image, (side, side, 3), of a frame; beyond the frame's border, the border's pixels.

        Of planes U and V are read at every other pixel, as they are stored.
        """
        if (planes := self._planes(frame, side)) is not None:
            still = planes.bgr[:side, :side]
        else:
            factor, extent = self.extent(side)
            still = self._warped(*frame.reduced(factor, extent), factor, side, (side - 1) / 2)
        return Frame(frame.index, frame.time_s, still)

    def read_grey(self, frame: Frame, side: int) -> Image:
        """As `read`, in grey (side, side)."""
        if frame.yuv is not None and frame.yuv.ours is not None and (planes := self._planes(frame, side)):
            return planes.grey[:side, :side]  # of so few pixels alone
        factor, extent = self.extent(side)
        return self._warped(*frame.grey(factor, extent), factor, side, (side - 1) / 2)

    def _planes(self, frame: Frame, side: int) -> Planes | None:
        """As `read`, of planes as they are stored, with an even number of pixels along each side."""
        factor, extent = self.extent(side)
        if frame.yuv is None or (planes := frame.planes(factor, extent)) is None:
            return None
        even, middle = side + side % 2, (side - 1) / 2
        y, *tints = (in_one_piece(*plane, extent) for plane in planes)
        u, v = (self._warped(*tint, even // 2, middle / 2 - 0.25, 2) for tint in tints)
        return Planes(self._warped(*y, even, middle), u, v, frame.yuv.ours)

    def extent(self, side: int) -> tuple[int, Extent]:
        """By which factor the frame is reduced that is read, and where."""
        factor = 1
        while 2 * factor <= self.scale and factor < 256:
            factor *= 2
        far = 0.5 * side * self.scale * (abs(math.cos(self.angle)) + abs(math.sin(self.angle))) + 4 * factor
        x, y = self.centre.tolist()
        return factor, (x - far, y - far, x + far, y + far)

    def _warped(self, image: Image, left: int, top: int, factor: int, side: int, half: float, step: int = 1) -> Image:
        """What `map_of` maps, (side, side)."""
        a, b, u, v = self.map_of(left, top, factor, half, step)
        if image.ndim == 2:  # OpenCV takes longer
            out = np.empty((side, side), np.uint8)
            warp(image, np.array([[a, b, u, v]]), out[None])
            return out
        matrix = np.array([[a, -b, u], [b, a, v]])
        return np.asarray(warp_affine(image, matrix, (side, side), cv2.BORDER_REPLICATE, inverse=True), np.uint8)

    def map_of(self, left: int, top: int, factor: int, half: float, step: int = 1) -> tuple[float, float, float, float]:
        """The map (a x - b y + u, b x + a y + v) to an image of the frame.

        That image is reduced by `factor` and begins at (left, top). It is read at every `step` pixels, of which `half`
        lie on either side of the middle.
        """
        (x, y), off, scale = self.centre.tolist(), (factor - 1) / 2, step * self.scale / factor
        a, b = scale * math.cos(self.angle), scale * math.sin(self.angle)
        return a, b, (x - left - off) / factor - (a - b) * half, (y - top - off) / factor - (b + a) * half


def mapped(x: Array, turned: complex, shift: complex) -> Array:
    """Places x (..., 2) as complex numbers, times `turned` plus `shift`: NumPy is slow on axes of two."""
    return (np.ascontiguousarray(x, np.float64).view(np.complex128) * turned + shift).view(np.float64)


def in_one_piece(image: Image, left: int, top: int, factor: int, extent: Extent) -> tuple[Image, int, int, int]:
    """An image of the frame as `map_of` has it, as one piece of memory: all of it, or what lies in the extent."""
    if image.flags.c_contiguous:
        return image, left, top, factor
    x0, y0, x1, y1 = (int(at - begin) // factor for at, begin in zip(extent, (left, top, left, top), strict=True))
    x0, y0 = min(max(x0, 0), image.shape[1] - 1), min(max(y0, 0), image.shape[0] - 1)
    part = image[y0 : max(y1, y0) + 2, x0 : max(x1, x0) + 2]
    return np.ascontiguousarray(part), left + x0 * factor, top + y0 * factor, factor


def change_between(x: Array, rest: Array) -> tuple[float, float]:
    """By which angle `rest` (K, 2) is turned to come nearest to x (K, 2), in radians, and the log of its size.

    By Procrustes.
    """
    a, b = x - x.mean(axis=0), rest - rest.mean(axis=0)
    along, across = float(np.sum(a * b)), float(np.sum(b[:, 0] * a[:, 1] - b[:, 1] * a[:, 0]))
    size = math.hypot(along, across) / max(float(np.sum(b * b)), 1e-9)
    return math.atan2(across, along), math.log(max(size, 1e-9))


def growth(x: Array, rest: Array) -> float:
    """By how much places x (K, 2) are wider spread than others."""
    wide, before = (np.sum((places - places.mean(axis=0)) ** 2) for places in (x, rest))
    return math.sqrt(wide / max(before, 1e-9))


def slope(pair: Array | tuple[Any, ...]) -> float:
    """The angle of the line from one place to another, in radians."""
    (x, y), (u, v) = pair.tolist() if isinstance(pair, np.ndarray) else pair
    return math.atan2(v - y, u - x)
