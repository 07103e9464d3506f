# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""The loops of skin and pattern (Gonzalez & Collet).

First sums over boxes by integral images (eq. 5-9). Then the sums of a normalised cross-correlation at fractional places
and scales (eq. 10): a template of (th, tw) points lies over the image with its first point at (u, v) and s pixels from
point to point. What is beyond the image is 0, and between the centres of its pixels the image is bilinear.
"""

import math

import numpy as np

from facetrack_cli.engine.kernels.compiled import exact, fast, inline, read_at


@exact("f8:2 f8:2")
def box_sums(sums, boxes):
    """Sums over boxes (4, N) = x0, y0, x1, y1 by an integral image (H + 1, W + 1) float64 -> (N,).

    Edges of pixels are whole numbers, parts of pixels count by their area, and beyond the image there is nothing.
    """
    out = np.empty(boxes.shape[1])
    for n in range(len(out)):
        x0, y0, x1, y1 = boxes[0, n], boxes[1, n], boxes[2, n], boxes[3, n]
        out[n] = read_at(sums, x1, y1) + read_at(sums, x0, y0) - read_at(sums, x1, y0) - read_at(sums, x0, y1)
    return out


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


@fast("u1:2 f4:2 f8:2")
def moments_direct(image, template, boxes):
    """Mean of template (th, tw) times image (H, W), and the image's variance, at the template's points.

    Boxes (3, N) = (u, v, s), finite, s > 0 -> (2, N) float64.
    """
    (height, width), (th, tw) = image.shape, template.shape
    left, right = np.zeros(tw, np.int64), np.zeros(tw, np.int64)
    upper, lower = np.zeros(th, np.int64), np.zeros(th, np.int64)
    a, b = np.zeros(tw, np.float32), np.zeros(tw, np.float32)
    c, d = np.zeros(th, np.float32), np.zeros(th, np.float32)
    line, out = np.zeros(width, np.float32), np.zeros((2, boxes.shape[1]))
    for p in range(boxes.shape[1]):
        u, v, s, level = boxes[0, p], boxes[1, p], boxes[2, p], np.float32(0.0)
        x0, x1 = _axis(u, s, width, left, right, a, b)
        y0, y1 = _axis(v, s, height, upper, lower, c, d)
        if x1 <= x0 or y1 <= y0:
            continue
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
        out[0, p], out[1, p] = cross / n, second / n - (first / n) ** 2
    return out


@exact("f4:2 f8:2 i8 i8")
def bilinear(values, places, left, top):
    """values (H, W), which begin at (left, top), read bilinearly at places (2+, N) = (u, v, ...) -> (N,) float64.

    At scale 1 and from the sums at whole places, this is what `moments_direct` sums: the sum is linear in the image.
    """
    out = np.empty(places.shape[1])
    for p in range(len(out)):
        out[p] = read_at(values, places[0, p] - left, places[1, p] - top)
    return out
