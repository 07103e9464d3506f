"""The stabilized image: the frame seen from the head, in which the face is upright and has a fixed size."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import cv2
import numpy as np

from facetrack_cli.core.face_points import EYE_DISTANCE
from facetrack_cli.core.geometry import warp_affine
from facetrack_cli.core.types import Array, Extent, Frame, Image, Planes
from facetrack_cli.trackers.face.image_kernels import see, shrink
from facetrack_cli.video import shots

SIDE: Final = 160  # sides of the stabilized image, in pixels
FACE: Final = 112.0  # sides of the face's box in it
MIDDLE: Final = (SIDE - 1) / 2
BOX: Final = (MIDDLE - (FACE - 1) / 2, MIDDLE - (FACE - 1) / 2, FACE, FACE)
EYES: Final = EYE_DISTANCE * FACE
EYE_LINE: Final = MIDDLE - 0.112 * FACE  # the row of the eyes
_NO_MATRIX: Final = np.empty((0, 3))


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
        views = np.array([self.view])
        if frame.yuv is None:
            factor, extent = extent_of(views, self.scale, side)
            still = self._warped(*frame.reduced(factor, extent), factor, side)
        else:
            joined = read_planes(frame, views, self.scale, side, tinted=True)[0]
            still = np.asarray(cv2.cvtColor(joined, cv2.COLOR_YUV2BGR_I420), np.uint8)[:side, :side]
        return Frame(frame.index, frame.time_s, still)

    def read_grey(self, frame: Frame, side: int) -> Image:
        """As `read`, in grey (side, side)."""
        return read_grey(frame, np.array([self.view]), self.scale, side).reshape(side, side)

    @property
    def view(self) -> tuple[float, float, float, float]:
        """The middle, and a and b of [[a, -b], [b, a]]."""
        (x, y), turn = self.centre.tolist(), self.turn
        return x, y, turn.real, turn.imag

    def _warped(self, image: Image, left: int, top: int, factor: int, side: int) -> Image:
        """As `read`, of an image of the frame that is reduced by `factor` and begins at (left, top)."""
        (x, y, a, b), off, half = self.view, (factor - 1) / 2, (side - 1) / 2
        a, b = a / factor, b / factor
        u, v = (x - left - off) / factor - (a - b) * half, (y - top - off) / factor - (b + a) * half
        matrix = np.array([[a, -b, u], [b, a, v]])
        return np.asarray(warp_affine(image, matrix, (side, side), cv2.BORDER_REPLICATE, inverse=True), np.uint8)


def extent_of(views: Array, scale: float, side: int) -> tuple[int, Extent]:
    """By which factor the frame is reduced that views (M, 4) of one scale and turn read, and where."""
    factor = 1
    while 2 * factor <= scale and factor < 256:
        factor *= 2
    (x, y, a, b), (u, v, _, _) = views[0].tolist(), views[-1].tolist()
    far = 0.5 * side * (abs(a) + abs(b)) + 4 * factor
    return factor, (min(x, u) - far, min(y, v) - far, max(x, u) + far, max(y, v) + far)


def read_planes(frame: Frame, views: Array, scale: float, side: int, *, tinted: bool) -> Image:
    """Y of a frame with planes, (M, side, side), as the views (M, 4) show it; `tinted`: below it, both tints.

    An odd `side` is by 1 larger.
    """
    factor, extent = extent_of(views, scale, side)
    planes, even, ours = frame.planes(factor, extent) or [], side + side % 2, frame.yuv and frame.yuv.ours
    read = planes if tinted or ours is not None else planes[:1]  # of a strided plane what is read is copied
    (y, *at), *tints = (in_one_piece(*plane, extent) for plane in read)
    (u, *tint_at), (v, *_) = tints or 2 * [(y, *at)]
    out = np.empty((len(views), even + even // 2 * tinted, even), np.uint8)
    see(y, u, v, tuple(at), tuple(tint_at), views, (side - 1) / 2, _NO_MATRIX if ours is None else ours, out)
    return out


def read_grey(frame: Frame, views: Array, scale: float, side: int) -> Image:
    """Views (M, 4) of any frame in grey, (M, side, side)."""
    if frame.yuv is not None:
        lit = read_planes(frame, views, scale, side, tinted=False)
        return Planes(flat := lit.reshape(-1, lit.shape[2]), flat, flat).grey.reshape(lit.shape)[:, :side, :side]
    factor, extent = extent_of(views, scale, side)
    (grey, *at), out = frame.grey(factor, extent), np.empty((len(views), side, side), np.uint8)
    see(grey, grey, grey, (*at, factor), (*at, factor), views, (side - 1) / 2, _NO_MATRIX, out)
    return out


def mapped(x: Array, turned: complex, shift: complex) -> Array:
    """Places x (..., 2) as complex numbers, times `turned` plus `shift`: NumPy is slow on axes of two."""
    return (np.ascontiguousarray(x, np.float64).view(np.complex128) * turned + shift).view(np.float64)


def in_one_piece(image: Image, left: int, top: int, factor: int, extent: Extent) -> tuple[Image, int, int, int]:
    """An image of the frame as `Frame.planes` has it, as one piece of memory: all of it, or what lies in the extent."""
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


def shrunk(frame: Frame) -> Image:
    """`video.shots.small` of a frame; of planes in one call."""
    if (
        frame.yuv is None
        or frame.size[0] // 2 <= shots.SIDE[0] * shots.READ
        or frame.size[1] <= shots.SIDE[1] * shots.READ
    ):
        return shots.small(frame)
    (lit, wide), (u, half), (v, _) = map(_rows_of, frame.yuv[:3])
    shrink(lit, u, v, wide, half, frame.size, shots.READ, out := np.empty((shots.SIDE[1], shots.SIDE[0], 3), np.uint8))
    return out


def _rows_of(plane: Image) -> tuple[Image, int]:
    """All bytes of a plane, and how many a row has, with those beside the picture."""
    kept, wide = plane.base, plane.strides[0]
    if kept is None or plane.flags.c_contiguous or kept.shape != (len(plane) * wide,):
        return plane.ravel(), plane.shape[1]
    return kept, wide
