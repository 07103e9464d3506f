# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""Maps of skin probability, and their sums over boxes by integral images (Gonzalez & Collet, eq. 5-9)."""

import math

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.engine.kernels.compiled import box_sum, exact, part

# OpenCV's fixed-point BT.601 of 8 bits, full range: 14 bits after the point, and a half to round by
SHIFT, HALF, MIDDLE = np.int32(14), np.int32(1 << 13), np.int32((128 << 14) + (1 << 13))
R_TO_Y, G_TO_Y, B_TO_Y = np.int32(4899), np.int32(9617), np.int32(1868)
TO_CR, TO_CB = np.int32(11682), np.int32(9241)
EIGHT, MAX_LEVEL = np.int32(8), np.int32(255)
MAX_HALF_SIDE = 1e6  # half a side of a box, pixels


@part
def _code(b, g, r):
    """256 Cb + Cr of one pixel. No colour has either below 0; pure blue and pure red would have 256."""
    b, g, r = np.int32(b), np.int32(g), np.int32(r)
    y = (r * R_TO_Y + g * G_TO_Y + b * B_TO_Y + HALF) >> SHIFT
    cb = min(((b - y) * TO_CB + MIDDLE) >> SHIFT, MAX_LEVEL)
    cr = min(((r - y) * TO_CR + MIDDLE) >> SHIFT, MAX_LEVEL)
    return (cb << EIGHT) + cr


@exact
def _map(rows, table):
    height, width = rows.shape[0], rows.shape[1] // 3
    out, codes = np.empty((height, width), np.uint8), np.empty(width, np.int32)
    for i in range(height):
        row, made = rows[i], out[i]
        # in a loop of its own, which vectorises; looking up does not
        for x in range(width):
            codes[x] = _code(row[3 * x], row[3 * x + 1], row[3 * x + 2])
        for x in range(width):
            made[x] = table[np.uint32(codes[x])]
    return out


def skin_map(bgr: NDArray[np.uint8], table: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """table[Cb, Cr] of every pixel of bgr (H, W, 3) uint8 -> (H, W) uint8; table (256, 256) uint8."""
    rows = np.ascontiguousarray(bgr).reshape(bgr.shape[0], 3 * bgr.shape[1])
    return np.asarray(_map(rows, np.ascontiguousarray(table).reshape(-1)), np.uint8)


@part
def _within(edge, count):
    """An edge in pixels as a coordinate of the integral image, 0..count; nan is 0."""
    u = edge + 0.5
    return min(u, float(count)) if u > 0.0 else 0.0


@part
def _box_sum(integral, box):
    height, width = integral.shape[0] - 1, integral.shape[1] - 1
    x0, y0 = _within(box[0], width), _within(box[1], height)
    x1, y1 = max(_within(box[2], width), x0), max(_within(box[3], height), y0)
    return box_sum(integral, x0, y0, x1, y1)


@exact
def nested(x, width, height, factor, left, top):
    """Inner boxes, outer ones around them of twice the area, and inner areas (N,), at x (N, 1, D) = (cx, cy, s, ...).

    Inner boxes are width * s by height * s pixels of the whole image. Boxes (N, 4) are edges x0, y0, x1, y1 in pixels
    of the image reduced by `factor` that begins at (left, top) of the whole; what is thinner than a pixel is all 0.
    """
    n, longer = x.shape[0], math.sqrt(2.0)
    inner, outer, area = np.zeros((n, 4)), np.zeros((n, 4)), np.zeros(n)
    for p in range(n):
        s = x[p, 0, 2] / factor
        w, h = 0.5 * s * width, 0.5 * s * height
        cx = (x[p, 0, 0] - left - 0.5 * (factor - 1)) / factor
        cy = (x[p, 0, 1] - top - 0.5 * (factor - 1)) / factor
        # comparisons with nan are false
        if (
            min(w, h) >= 0.5
            and max(w, h) <= MAX_HALF_SIDE
            and abs(cx) <= 10.0 * MAX_HALF_SIDE
            and abs(cy) <= 10.0 * MAX_HALF_SIDE
        ):
            inner[p, 0], inner[p, 1], inner[p, 2], inner[p, 3] = cx - w, cy - h, cx + w, cy + h
            w, h, area[p] = longer * w, longer * h, 4.0 * w * h
            outer[p, 0], outer[p, 1], outer[p, 2], outer[p, 3] = cx - w, cy - h, cx + w, cy + h
    return inner, outer, area


@exact
def differences(integral, inner, outer):
    """Sums of a map over `inner` and over `outer` boxes, both (N, 4) = x0, y0, x1, y1 -> (N, 2) float64 (eq. 8).

    Edges are in pixels, pixel i covers [i - 0.5, i + 0.5], and parts of pixels count by their area. `integral`
    (H + 1, W + 1) is cv2.integral of the map, which is 0 beyond its border; a box turned inside out is empty.
    """
    out = np.empty((inner.shape[0], 2))
    for n in range(inner.shape[0]):
        out[n, 0], out[n, 1] = _box_sum(integral, inner[n]), _box_sum(integral, outer[n])
    return out


@exact
def at_points(bgr, table, xy):
    """table[Cb, Cr] / 255 of the pixel nearest to each point xy (N, 2) -> (N,) float64; 0 beyond the image."""
    height, width = bgr.shape[0], bgr.shape[1]
    out = np.zeros(xy.shape[0])
    for n in range(xy.shape[0]):
        u, v = xy[n, 0] + 0.5, xy[n, 1] + 0.5
        # nan is not within the image either
        if u >= 0.0 and u < width and v >= 0.0 and v < height:
            pixel = bgr[math.floor(v), math.floor(u)]
            code = _code(pixel[0], pixel[1], pixel[2])
            out[n] = table[code >> EIGHT, code & MAX_LEVEL] / 255.0
    return out
