"""The overlap of two regions as VOT measures it: on whole pixels, rectangles and polygons alike.

vot-toolkit (`vot.region.raster.calculate_overlap`) makes float32 of all numbers, rounds them to whole pixels (halves to
the even one), paints both regions and counts. What follows from that, and is followed here:

- A rectangle [left, top, w, h] covers columns round(left) .. round(left) + round(w) - 1.
- A polygon covers the pixels of its border too: one over the corners of a rectangle has a row and a column more.
- With `size` only pixels of the picture count.
- Where the upright frame around both regions is not at least 2 by 2 pixels, the overlap is 1: of lines in one column,
  or of two empty boxes at one place. Where only its part within the picture is not, the overlap is 0.

Two oddities are not followed. Without `size` (its analyses always pass it) vot-toolkit counts wrongly where a
rectangle has negative coordinates, since it cuts the mask at the absolute coordinate. And a missing region stands there
as one at the picture's corner, so that its frame with truth there can be less than 2 by 2, its overlap 1; here it is 0.
"""

from __future__ import annotations

import numpy as np

from facetrack_cli.core.types import Array, Mask


def vot_overlaps(
    ours: Array,
    truth: Array,
    our_corners: Array | None = None,
    true_corners: Array | None = None,
    size: tuple[int, int] | None = None,
) -> Array:
    """(T,) overlap 0..1 of boxes (T, 4), or of polygons (T, 4, 2) where there are corners without nan.

    A row without a region of ours (nan) has 0; one without truth has nan.
    """
    a, a_poly = _regions(ours, our_corners)
    b, b_poly = _regions(truth, true_corners)
    missing, unknown = np.isnan(a).any(axis=(1, 2)), np.isnan(b).any(axis=(1, 2))
    found = np.where(unknown, np.nan, 0.0)
    known = ~missing & ~unknown
    upright = known & ~a_poly & ~b_poly
    found[upright] = _rectangles(a[upright], b[upright], size)
    if (other := known & (a_poly | b_poly)).any():
        # numba takes a quarter of a second to load, and most truth is of rectangles
        from facetrack_cli.tracking.kernels.polygons import count_pixels

        unlike, within = _frames(a[other], a_poly[other], b[other], b_poly[other], size)
        pixels = np.empty((int(other.sum()), 2))
        count_pixels(a[other], a_poly[other], b[other], b_poly[other], within, pixels)
        found[other] = _ratio(pixels[:, 0], pixels[:, 1], unlike, within)
    return found


def _regions(boxes: Array, corners: Array | None) -> tuple[Array, Mask]:
    """(T, 4, 2) corners on whole pixels, of rectangles their outermost pixels; and (T,) whether it is a polygon."""
    with np.errstate(over="ignore"):
        left, top, w, h = np.round(np.asarray(boxes, dtype=np.float64).astype(np.float32)).T
        # the sum is one of float32, which matters from 2 ** 24 on
        right, bottom = (left + w).astype(np.float64) - 1.0, (top + h).astype(np.float64) - 1.0
    sides = np.array([[left, top], [right, top], [right, bottom], [left, bottom]], dtype=np.float64)
    rectangles = np.ascontiguousarray(sides.transpose(2, 0, 1))
    if corners is None:
        return rectangles, np.zeros(len(boxes), dtype=np.bool_)
    polygons = np.round(np.asarray(corners, dtype=np.float64).astype(np.float32)).astype(np.float64)
    there: Mask = np.asarray(np.isfinite(polygons).all(axis=(1, 2)))
    return np.where(there[:, None, None], polygons, rectangles), there


def _frames(a: Array, a_poly: Mask, b: Array, b_poly: Mask, size: tuple[int, int] | None) -> tuple[Mask, Array]:
    """(T,) whether the frame around both regions is 2 by 2 or more; (T, 4) first column and row, last column and row
    of its part in the picture."""
    (a_low, a_high), (b_low, b_high) = _ends(a, a_poly), _ends(b, b_poly)
    low, high = np.minimum(a_low, b_low), np.maximum(a_high, b_high)
    unlike: Mask = np.asarray((low < high).all(axis=1))
    if size is not None:
        low, high = np.maximum(low, 0.0), np.minimum(high, np.array(size, dtype=np.float64) - 1.0)
    return unlike, np.concatenate([low, high], axis=1)


def _ends(region: Array, is_polygon: Mask) -> tuple[Array, Array]:
    """(T, 2) first column and row, and last ones; an empty rectangle ends before it begins, and is not turned round."""
    polygon = is_polygon[:, None]
    return (
        np.where(polygon, region.min(axis=1), region[:, 0]),
        np.where(polygon, region.max(axis=1), region[:, 2]),
    )


def _rectangles(a: Array, b: Array, size: tuple[int, int] | None) -> Array:
    neither = np.zeros(len(a), dtype=np.bool_)
    unlike, within = _frames(a, neither, b, neither, size)

    def count(low: Array, high: Array) -> Array:
        sides = np.minimum(high, within[:, 2:]) - np.maximum(low, within[:, :2]) + 1.0
        area: Array = np.prod(np.maximum(sides, 0.0), axis=1)
        return area

    shared = count(np.maximum(a[:, 0], b[:, 0]), np.minimum(a[:, 2], b[:, 2]))
    return _ratio(shared, count(a[:, 0], a[:, 2]) + count(b[:, 0], b[:, 2]) - shared, unlike, within)


def _ratio(shared: Array, union: Array, unlike: Mask, within: Array) -> Array:
    ratio = np.divide(shared, union, out=np.zeros_like(shared), where=union > 0.0)
    ratio[(within[:, :2] >= within[:, 2:]).any(axis=1)] = 0.0
    ratio[~unlike] = 1.0
    return ratio
