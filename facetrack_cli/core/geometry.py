"""Boxes, points and outlines in an image, and images under maps. Pixel centres are whole numbers."""

from typing import Any, Final

import cv2
import numpy as np

from facetrack_cli.core.types import Array, Box, Point


def iou(a: Array, b: Array, size: tuple[int, int] | None = None) -> Array:
    """(T,) intersection over union of boxes a and b (T, 4), 0..1; nan where one of them has nan.

    As in got10k (`rect_iou`), 2.2e-16 is added to the union, so that two empty boxes have 0. A box of negative width or
    height is empty. With `size` (width, height) of the image, boxes are first clipped to it as GOT-10k does: the corner
    is moved inside, then the width is cut at the border. So a box beyond the left border is moved, and keeps its width.
    """
    if size is not None:
        low = [np.clip(boxes[:, :2], 0.0, size) for boxes in (a, b)]
        a, b = (np.hstack([at, np.clip(box[:, 2:], 0.0, size - at)]) for at, box in zip(low, (a, b), strict=True))
    left, top = np.maximum(a[:, 0], b[:, 0]), np.maximum(a[:, 1], b[:, 1])
    right, bottom = np.minimum(a[:, 0] + a[:, 2], b[:, 0] + b[:, 2]), np.minimum(a[:, 1] + a[:, 3], b[:, 1] + b[:, 3])
    shared = np.maximum(right - left, 0.0) * np.maximum(bottom - top, 0.0)
    union = a[:, 2] * a[:, 3] + b[:, 2] * b[:, 3] - shared
    # negative sizes share nothing, but their areas may cancel to no union at all
    ratio = np.divide(shared, union + np.finfo(np.float64).eps, out=shared.copy(), where=shared != 0.0)
    clipped: Array = np.clip(ratio, 0.0, 1.0)
    return clipped


def overlap(a: Box, b: Box) -> float:
    """Intersection over union of two boxes, 0..1."""
    return float(iou(np.array([a], np.float64), np.array([b], np.float64))[0])


def common_area(a: Box, b: Box) -> float:
    """Area of the intersection of two boxes, in pixels squared."""
    across = min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0])
    down = min(a[1] + a[3], b[1] + b[3]) - max(a[1], b[1])
    return max(across, 0) * max(down, 0)


def share_inside(box: Box, size: tuple[int, int]) -> float:
    """The share of a box's area that is in a picture of this size; the border runs around the outermost pixels."""
    return common_area(box, (-0.5, -0.5, float(size[0]), float(size[1]))) / (box[2] * box[3])


def centre(box: Box) -> Point:
    """The centre of a box over whole pixels, between its first and its last pixel."""
    return box[0] + (box[2] - 1) / 2, box[1] + (box[3] - 1) / 2


def square(middle: Array, side: float) -> Box:
    """The square box whose `centre` is at `middle` (2,)."""
    return float(middle[0]) - (side - 1) / 2, float(middle[1]) - (side - 1) / 2, side, side


def corners(affine: Array, centre: Array, size: Array) -> Array:
    """(T, 4, 2) corners, clockwise from the top left, of boxes whose sides became parallel to the columns of `affine`.

    `affine` (T, 6) begins with a1 to a4 of [[a1, a2], [a3, a4]]; `centre` and `size` (T, 2) are in pixels, `size` the
    lengths of the sides. nan where a side has no direction.
    """
    sides = affine[:, [[0, 2], [1, 3]]]  # (T, side, xy)
    lengths = np.hypot(sides[..., 0], sides[..., 1])
    with np.errstate(invalid="ignore", divide="ignore"):
        half = sides * (size / 2 / np.where(lengths > 1e-9, lengths, np.nan))[..., None]
    u, v = half[:, 0], half[:, 1]
    places: Array = centre[:, None] + np.stack([-u - v, u - v, u + v, v - u], axis=1)
    return np.where(np.isfinite(places).all(axis=(1, 2), keepdims=True), places, np.nan)


def size_of_points(x0: Array) -> float:
    """The unit of length of a recipe for points x0 (K, 2): the largest distance between two of them, in pixels."""
    return float(np.sqrt(np.sum((x0[:, None] - x0[None]) ** 2, axis=2)).max())


def shown_angle(degrees: Array, aspect: float) -> Array:
    """Angles in the pixels of a file, as a picture shows them whose pixels are `aspect` times as wide as high."""
    if aspect == 1:
        return degrees
    radians = np.radians(degrees)
    return np.asarray(np.degrees(np.arctan2(np.sin(radians), aspect * np.cos(radians))))


def inside(point: Point, size: tuple[int, int]) -> bool:
    """Whether a point is on a pixel of an image of that (width, height)."""
    return -0.5 <= point[0] <= size[0] - 0.5 and -0.5 <= point[1] <= size[1] - 0.5


# --- images under maps, read between pixels to the same last bit in OpenCV 4 and 5 ------------------------------------

# OpenCV 4 reads at multiples of 1/32 pixel. OpenCV 5 reads where it is told to, so it is told those places. A hundredth
# of all grey values would differ by 1 otherwise, and a filter that has drawn other particles goes its own way then.
_ROUNDS: Final = cv2.__version__.startswith("4.")


def warp_affine(
    image: Any, matrix: Any, size: tuple[int, int], border: int = cv2.BORDER_CONSTANT, *, inverse: bool = False
) -> Any:
    """`cv2.warpAffine`, linear, to an image of `size` (w, h). `inverse`: the matrix is from there to `image`."""
    if _ROUNDS:
        flags = cv2.INTER_LINEAR | (cv2.WARP_INVERSE_MAP if inverse else 0)
        return cv2.warpAffine(image, matrix, size, flags=flags, borderMode=border)
    return cv2.remap(
        image, *places(np.asarray(matrix, np.float64), size, inverse=inverse), cv2.INTER_LINEAR, None, border
    )


def places(matrix: Array, size: tuple[int, int], *, inverse: bool) -> tuple[Any, Any]:
    """Where `cv2.warpAffine` of OpenCV 4 reads: whole pixels (h, w, 2) and the number of 1/32 pixels beyond."""
    if not inverse:  # as there, term by term: another order has other last bits
        (a, b, x), (c, d, y) = matrix.tolist()
        by = a * d - b * c
        by = 1 / by if by else 0.0
        a, b, c, d = d * by, b * -by, c * -by, a * by
        matrix = np.array([[a, b, -a * x - b * y], [c, d, -c * x - d * y]])
    columns, rows = (np.arange(side, dtype=np.float64) for side in size)
    along = [np.rint(m[0] * columns * 1024) for m in matrix]
    down = [np.rint((m[1] * rows + m[2]) * 1024) + 16 for m in matrix]
    return _split(*((d[:, None] + a).astype(np.int64) >> 5 for a, d in zip(along, down, strict=True)))


def remap(image: Any, x: Any, y: Any, border: int) -> Any:
    """`cv2.remap`, linear, at x and y (h, w), float32."""
    at = (x, y) if _ROUNDS else _split(*(np.rint(coordinates * 32).astype(np.int64) for coordinates in (x, y)))
    return cv2.remap(image, *at, cv2.INTER_LINEAR, None, border)


def _split(x: Any, y: Any) -> tuple[Any, Any]:
    whole = np.clip(np.stack([x >> 5, y >> 5], axis=-1), -(2**15), 2**15 - 1).astype(np.int16)
    return whole, ((y & 31) * 32 + (x & 31)).astype(np.uint16)
