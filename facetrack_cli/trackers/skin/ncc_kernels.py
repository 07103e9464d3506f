# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""The sums of a normalised cross-correlation at fractional places and scales (Gonzalez & Collet, eq. 10).

A template of (th, tw) points lies over the image with its first point at (u, v) and s pixels from point to point.
What is beyond the image is 0. The image is bilinear between the centres of its pixels.
"""

import math

import numpy as np

from facetrack_cli.engine.kernels.compiled import box_sum, exact, fast, inline, read_at

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
