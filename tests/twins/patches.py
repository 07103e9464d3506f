"""Slow, plain twins of kernels/patches.py, written from the formulas and from nothing of ours."""

import math


def pixel(picture, view, factor, x, y):
    """Bilinear grey value at (x, y) of the whole image, which `picture` (H, W) shows from (left, top) on, reduced.

    None beyond the whole image; between its border and the centres of the outermost blocks, the nearest of these.
    """
    left, top, width, height = view
    if not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):
        return None
    rows, cols = picture.shape
    u = min(max((x - left - (factor - 1) / 2) / factor, 0), cols - 1)
    v = min(max((y - top - (factor - 1) / 2) / factor, 0), rows - 1)
    value = 0.0
    for i, wy in ((math.floor(v), 1 - v % 1), (math.floor(v) + 1, v % 1)):
        for j, wx in ((math.floor(u), 1 - u % 1), (math.floor(u) + 1, u % 1)):
            value += wx * wy * float(picture[min(i, rows - 1), min(j, cols - 1)])
    return value


def patch(picture, view, factor, box, size, cols, rows):
    """{(row, column): grey value or None} at the centres of the cells of the box (cx, cy, s)."""
    cx, cy, s = box
    w, h = size[0] * s, size[1] * s
    return {
        (i, j): pixel(picture, view, factor, cx - w / 2 + (j + 0.5) * w / cols, cy - h / 2 + (i + 0.5) * h / rows)
        for i in range(rows)
        for j in range(cols)
    }


def directed(a, b, both):
    """Sum of the least differences of the points of `a` from the 3x3 of `b`, among points that lie in both."""
    return sum(
        min(
            abs(a[i, j] - b[k, m]) for k in range(i - 1, i + 2) for m in range(j - 1, j + 2) if (k, m) in both
        )
        for i, j in both
    )  # fmt: skip


def distance(a, b, kind, saturation, outside):
    """d_c of eq. 13 of two patches; `outside` is rho of a point that one of them lacks."""
    both = {place for place in a if a[place] is not None and b[place] is not None}
    missing = (len(a) - len(both)) * outside
    if kind == "hausdorff":
        return max(directed(a, b, both), directed(b, a, both)) + missing
    differences = [abs(a[place] - b[place]) for place in both]
    if kind == "l2":
        return sum(d * d for d in differences) + missing
    return sum(min(d, saturation) for d in differences) + missing


def extent(boxes, size, width, height):
    """(x from, y from, x to, y to) of all boxes (cx, cy, s), cut to the pixels of the image."""
    corners = [
        (cx - size[0] * abs(s) / 2, cy - size[1] * abs(s) / 2, cx + size[0] * abs(s) / 2, cy + size[1] * abs(s) / 2)
        for cx, cy, s in boxes
    ]
    whole = [f(c[axis] for c in corners) for axis, f in enumerate((min, min, max, max))]
    return [min(max(v, 0), most - 1) for v, most in zip(whole, (width, height) * 2, strict=True)]
