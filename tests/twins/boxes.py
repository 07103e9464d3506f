"""Slow, plain twins of the box measures, written from the definitions and from nothing of ours."""

import math

import numpy as np


def iou(a, b):
    """Intersection over union of two boxes [left, top, w, h]."""
    across = min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0])
    down = min(a[1] + a[3], b[1] + b[3]) - max(a[1], b[1])
    if across <= 0 or down <= 0:
        return 0.0
    return across * down / (a[2] * a[3] + b[2] * b[3] - across * down)


def clip(box, width, height):
    """GOT-10k's: the corner is moved into the image, then the size is cut at its border."""
    left, top = min(max(box[0], 0), width), min(max(box[1], 0), height)
    return [left, top, min(max(box[2], 0), width - left), min(max(box[3], 0), height - top)]


def whole(value):
    """A number as float32, rounded, halves to even."""
    return int(np.rint(np.float32(value)))


def paint_rectangle(box):
    """The pixels of [left, top, w, h], and the corners of their frame."""
    left, top, w, h = (whole(v) for v in box)
    pixels = {(x, y) for x in range(left, left + w) for y in range(top, top + h)}
    return pixels, (left, top, left + w - 1, top + h - 1)


def frame_of_polygon(corners):
    points = [(whole(x), whole(y)) for x, y in corners]
    xs, ys = [p[0] for p in points], [p[1] for p in points]
    return min(xs), min(ys), max(xs), max(ys)


def paint_polygon(corners, left, top, right, bottom):
    """The pixels of a polygon by VOT's scan line, within a mask; columns are cut towards the mask's left side."""
    points = [(whole(x) - left, whole(y) - top) for x, y in corners]
    pixels = set()
    for y in range(bottom - top + 1):
        met = []
        for i in range(len(points)):
            (x1, y1), (x0, y0) = points[i], points[i - 1]
            if y1 == y0 == y:
                met.append(x1)
            elif y1 != y0 and (y0 <= y <= y1 or y1 <= y <= y0):
                met.append(math.trunc(x1 + (y - y1) / (y0 - y1) * (x0 - x1)))
        met.sort()
        while len(met) > 1:
            if met[0] == met[1] and len(met) > 2:
                met = met[1:]
                continue
            pixels |= {(x + left, y + top) for x in range(max(met[0], 0), min(met[1], right - left) + 1)}
            met = met[2:]
    return pixels


def vot_overlap(a, b, size=None):
    """VOT's overlap of two regions, each a box of four numbers or corners (4, 2)."""
    frames = [paint_rectangle(r)[1] if np.ndim(r) == 1 else frame_of_polygon(r) for r in (a, b)]
    left, top = min(f[0] for f in frames), min(f[1] for f in frames)
    right, bottom = max(f[2] for f in frames), max(f[3] for f in frames)
    if left >= right or top >= bottom:
        return 1.0
    if size is not None:
        left, top, right, bottom = max(left, 0), max(top, 0), min(right, size[0] - 1), min(bottom, size[1] - 1)
        if left >= right or top >= bottom:
            return 0.0
    inside = {(x, y) for x in range(left, right + 1) for y in range(top, bottom + 1)}
    p, q = (
        (paint_rectangle(r)[0] if np.ndim(r) == 1 else paint_polygon(r, left, top, right, bottom)) & inside
        for r in (a, b)
    )
    return len(p & q) / len(p | q) if p | q else 0.0
