# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""The loops of skin and pattern (Gonzalez & Collet).

First maps of skin probability, and their sums over boxes by integral images (eq. 5-9). Then the sums of a normalised
cross-correlation at fractional places and scales (eq. 10): a template of (th, tw) points lies over the image with its
first point at (u, v) and s pixels from point to point. What is beyond the image is 0, and between the centres of its
pixels the image is bilinear.
"""

import math

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.engine.kernels.compiled import box_sum, exact, fast, inline, part, read_at

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
    (H + 1, W + 1) is cv2.integral of the map, which is 0 beyond its border.
    """
    out = np.empty((inner.shape[0], 2))
    for n in range(inner.shape[0]):
        a, b = inner[n], outer[n]
        out[n, 0] = box_sum(integral, a[0] + 0.5, a[1] + 0.5, a[2] + 0.5, a[3] + 0.5)
        out[n, 1] = box_sum(integral, b[0] + 0.5, b[1] + 0.5, b[2] + 0.5, b[3] + 0.5)
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


# --- eq. 10

LARGEST = 1e6  # the largest scale, pixels from point to point


@exact
def place(x, factor, offset, th, tw, width, height):
    """Where the template lies for boxes x (N, 1, D) = (cx, cy, s, ...) in an image of width x height, reduced.

    cx and cy are pixels of the whole image; offset (dx, dy) from the box's centre to the template's, in reduced
    pixels at scale 1. Returns (N, 3) = (u, v, s), (0, 0, 1) of what is not seen; whether each is seen, (N,) bool: not
    beyond the image, thinner than a pixel or no number; low and high, the ranges of u and v, (2,); area (4,): x0, y0,
    x1, y1, half-open, the pixels that all cover together, at least one; and whether s is 1 throughout.
    """
    n, u0, v0, u1, v1, same = x.shape[0], np.inf, np.inf, -np.inf, -np.inf, True
    boxes, seen = np.empty((n, 3)), np.zeros(n, np.bool_)
    x0, y0, x1, y1 = width, height, 0, 0
    for p in range(n):
        s = x[p, 0, 2]
        u = (x[p, 0, 0] - 0.5 * (factor - 1)) / factor + s * (offset[0] - 0.5 * (tw - 1))
        v = (x[p, 0, 1] - 0.5 * (factor - 1)) / factor + s * (offset[1] - 0.5 * (th - 1))
        right, bottom = u + s * (tw - 0.5), v + s * (th - 0.5)
        # comparisons with nan are false; beyond the bound the arithmetic of places would be rough
        if not (
            s * min(tw, th) >= 1.0 and s <= LARGEST
            and right > -0.5 and u - 0.5 * s < width - 0.5 and bottom > -0.5 and v - 0.5 * s < height - 0.5
        ):  # fmt: skip
            boxes[p, 0], boxes[p, 1], boxes[p, 2] = 0.0, 0.0, 1.0
            continue
        boxes[p, 0], boxes[p, 1], boxes[p, 2], seen[p] = u, v, s, True
        u0, v0, u1, v1, same = min(u0, u), min(v0, v), max(u1, u), max(v1, v), same and s == 1.0
        x0, x1 = min(x0, max(math.floor(u - 0.5 * s), 0)), max(x1, min(math.ceil(right) + 1, width))
        y0, y1 = min(y0, max(math.floor(v - 0.5 * s), 0)), max(y1, min(math.ceil(bottom) + 1, height))
    if x1 == 0:
        u0, v0, u1, v1, x0, y0, x1, y1 = 0.0, 0.0, 0.0, 0.0, 0, 0, 1, 1
    return boxes, seen, np.array([u0, v0]), np.array([u1, v1]), np.array([x0, y0, x1, y1]), same


@inline
def _axis(start, step, length, near, far, share_near, share_far):
    """The two pixels that each point of one axis is read from, and their shares; returns the range [first, last) read.

    A pixel beyond the image of `length` pixels has the share 0, and the nearest one stands in for it.
    """
    first, last = length, 0
    for i in range(len(near)):
        # far outside nothing is read; the bound keeps the integers small
        place = min(max(start + i * step, -2.0), length + 1.0)
        below = math.floor(place)
        part = place - below
        near[i], far[i] = min(max(below, 0), length - 1), min(max(below + 1, 0), length - 1)
        share_near[i] = 1.0 - part if below >= 0 and below < length else 0.0
        share_far[i] = part if below >= -1 and below < length - 1 else 0.0
        if share_near[i] + share_far[i] > 0.0:
            first, last = min(first, near[i]), max(last, far[i] + 1)
    return first, last


@fast
def moments_direct(image, template, boxes):
    """Mean of template (th, tw) times image (H, W), and the image's variance, at the template's points.

    Boxes (N, 3) = (u, v, s), finite, s > 0 -> (N, 2) float64.
    """
    (height, width), (th, tw) = image.shape, template.shape
    left, right = np.zeros(tw, np.int64), np.zeros(tw, np.int64)
    upper, lower = np.zeros(th, np.int64), np.zeros(th, np.int64)
    a, b = np.zeros(tw, np.float32), np.zeros(tw, np.float32)
    c, d = np.zeros(th, np.float32), np.zeros(th, np.float32)
    line, out = np.zeros(width, np.float32), np.zeros((boxes.shape[0], 2))
    for p in range(boxes.shape[0]):
        x0, x1 = _axis(boxes[p, 0], boxes[p, 2], width, left, right, a, b)
        y0, y1 = _axis(boxes[p, 1], boxes[p, 2], height, upper, lower, c, d)
        if x1 <= x0 or y1 <= y0:
            continue
        (u, v, s), level = boxes[p], np.float32(0.0)
        if u >= 0.0 and v >= 0.0 and u + s * (tw - 1) <= width - 1 and v + s * (th - 1) <= height - 1:
            # squares about 0 would lose a faint pattern to rounding
            level = np.float32(image[(y0 + y1) // 2, (x0 + x1) // 2])
        cross, first, second = 0.0, 0.0, 0.0
        for i in range(th):
            if c[i] + d[i] == 0.0:
                continue
            above, below, blend = image[upper[i], x0:x1], image[lower[i], x0:x1], line[x0:x1]
            for j in range(len(blend)):
                blend[j] = c[i] * np.float32(above[j]) + d[i] * np.float32(below[j])
            # summed row by row, so that float32 loses nothing
            total, off, square, row = np.float32(0.0), np.float32(0.0), np.float32(0.0), template[i]
            for j in range(tw):
                value = a[j] * line[left[j]] + b[j] * line[right[j]]
                total += row[j] * value
                value -= level
                off += value
                square += value * value
            cross += float(total)
            first += float(off)
            second += float(square)
        n = th * tw
        out[p, 0], out[p, 1] = cross / n, second / n - (first / n) ** 2
    return out


@exact
def read_patch(image, u, v, s, th, tw):
    """The image (H, W) uint8 at the points of a template of (th, tw) at (u, v, s) -> (th, tw) float32."""
    height, width = image.shape
    left, right, a, b = np.zeros(tw, np.int64), np.zeros(tw, np.int64), np.zeros(tw), np.zeros(tw)
    upper, lower, c, d = np.zeros(th, np.int64), np.zeros(th, np.int64), np.zeros(th), np.zeros(th)
    _axis(u, s, width, left, right, a, b)
    _axis(v, s, height, upper, lower, c, d)
    out = np.empty((th, tw), np.float32)
    for i in range(th):
        for j in range(tw):
            out[i, j] = c[i] * (a[j] * image[upper[i], left[j]] + b[j] * image[upper[i], right[j]]) + d[i] * (
                a[j] * image[lower[i], left[j]] + b[j] * image[lower[i], right[j]]
            )
    return out


@exact
def bilinear(values, places, left, top):
    """values (H, W), which begin at (left, top), read bilinearly at places (N, 2+) = (u, v, ...) -> (N,) float64.

    At scale 1 and from the sums at whole places, this is what `moments_direct` sums: the sum is linear in the image.
    """
    out = np.empty(places.shape[0])
    for p in range(places.shape[0]):
        out[p] = read_at(values, places[p, 0] - left, places[p, 1] - top)
    return out


@exact
def variances(sums, boxes, left, top, th, tw):
    """Variance of the bilinear image at the points of boxes (N, 3) = (u, v, 1) -> (N,) float64.

    sums: integral images of an image that begins at (left, top) and covers what the points are read from; of it, its
    square, and the squares of its differences to the right, downwards, and both. Between two values a and b, at the
    share f of the way, the square of the bilinear value is (1 - f) a^2 + f b^2 - f (1 - f) (b - a)^2.
    """
    plain, squares, across, down, both = sums
    out, n = np.empty(boxes.shape[0]), th * tw
    for p in range(boxes.shape[0]):
        x, y = boxes[p, 0] - left, boxes[p, 1] - top
        i, j = math.floor(x), math.floor(y)
        fx, fy = (x - i) * (1.0 - x + i), (y - j) * (1.0 - y + j)
        square = box_sum(squares, x, y, x + tw, y + th) + fx * fy * box_sum(both, i, j, i + tw, j + th)
        square -= fx * box_sum(across, i, y, i + tw, y + th) + fy * box_sum(down, x, j, x + tw, j + th)
        level = box_sum(plain, x, y, x + tw, y + th) / n
        out[p] = square / n - level * level
    return out


@exact
def means(integral, squares, boxes, th, tw):
    """Area means of the image and of its square over boxes (N, 3) = (u, v, s) -> (N, 2) float64.

    integral and squares (H + 1, W + 1) float64, as cv2.integral2 gives them. A point stands for s x s pixels around
    it. At scale 1 these are the means of the points, bilinear in the image and in its square.
    """
    out = np.empty((boxes.shape[0], 2))
    for p in range(boxes.shape[0]):
        s = boxes[p, 2]
        x0, y0 = boxes[p, 0] - 0.5 * s + 0.5, boxes[p, 1] - 0.5 * s + 0.5
        x1, y1 = x0 + s * tw, y0 + s * th
        area = s * tw * s * th
        out[p, 0] = box_sum(integral, x0, y0, x1, y1) / area
        out[p, 1] = box_sum(squares, x0, y0, x1, y1) / area
    return out
