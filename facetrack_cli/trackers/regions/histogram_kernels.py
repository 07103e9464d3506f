# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""Histograms of many boxes at once, compared with one reference (Odobez et al. 2003, section 3.3, "Color model").

An image is first coded: every pixel holds the number of its bin, among the bins that matter and one for all others.
Boxes are then counted either pixel by pixel (`match_direct`) or from integral histograms (`match_integral`). Counts are
whole numbers and both end in the same sums in the same order, so both give the same result to the last bit.
"""

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.engine.kernels.compiled import exact, part

LANES = 16  # the number of bins is padded to a multiple of this, so that loops over bins vectorise


@exact
def edges(x, size_w, size_h, cols, rows, factor, width, height):
    """Where boxes (N, 3) = (cx, cy, s) and their sub-regions lie in an image of width x height, reduced by `factor`.

    Returns ex (N, cols + 1) and ey (N, rows + 1) int64, cut off at the image: column c of sub-regions holds the
    pixels ex[c] <= i < ex[c + 1], those whose centres lie in it; area (N,) float64: the pixels of the whole box, also
    beyond the image, and 0 for a box that is none (no positive size, or out of all measure).
    """
    n = x.shape[0]
    ex, ey, area = np.zeros((n, cols + 1), np.int64), np.zeros((n, rows + 1), np.int64), np.zeros(n)
    for p in range(n):
        s = x[p, 2] / factor
        w, h = s * size_w, s * size_h
        left = (x[p, 0] - 0.5 * (factor - 1)) / factor - 0.5 * w
        top = (x[p, 1] - 0.5 * (factor - 1)) / factor - 0.5 * h
        # comparisons with nan are false
        if not (s > 0.0 and abs(left) < 1e15 and abs(top) < 1e15 and w < 1e15 and h < 1e15):
            continue
        for c in range(cols + 1):
            ex[p, c] = int(min(max(math.ceil(left + w * c / cols), 0), width))
        for r in range(rows + 1):
            ey[p, r] = int(min(max(math.ceil(top + h * r / rows), 0), height))
        # as the last edges are rounded, w * cols / cols may not be w
        across = math.ceil(left + w * cols / cols) - math.ceil(left)
        area[p] = float(across) * float(math.ceil(top + h * rows / rows) - math.ceil(top))
    return ex, ey, area


@exact
def crop(ex, ey):
    """What boxes cover of the image; makes ex and ey, in place, count from its corner and stay within it.

    Returns (left, top, right, bottom) around all of them, half open, and the pixels of all boxes together: all 0 if no
    box holds a pixel.
    """
    left, top, right, bottom, total = 0, 0, 0, 0, 0
    for p in range(ex.shape[0]):
        x0, x1, y0, y1 = ex[p, 0], ex[p, -1], ey[p, 0], ey[p, -1]
        if x1 <= x0 or y1 <= y0:
            continue
        if total == 0:
            left, top, right, bottom = x0, y0, x1, y1
        left, top, right, bottom = min(left, x0), min(top, y0), max(right, x1), max(bottom, y1)
        total += (x1 - x0) * (y1 - y0)
    # boxes beyond the image are empty, and stay so wherever they are put
    for p in range(ex.shape[0]):
        for c in range(ex.shape[1]):
            ex[p, c] = min(max(ex[p, c], left), right) - left
        for r in range(ey.shape[1]):
            ey[p, r] = min(max(ey[p, r], top), bottom) - top
    return left, top, right, bottom, total


@exact
def code(hsv, coloured, colourless, least_saturation, least_value):
    """The bins of hsv (H, W, 3) uint8 -> (H, W) uint16: coloured[h, s], or colourless[v] of low saturation or value."""
    out = np.empty(hsv.shape[:2], np.uint16)
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            s, v = hsv[y, x, 1], hsv[y, x, 2]
            out[y, x] = colourless[v] if s < least_saturation or v < least_value else coloured[hsv[y, x, 0], s]
    return out


@part
def _add_match(counts, root, sums):
    for b in range(len(sums)):
        sums[b] += math.sqrt(np.float32(counts[b])) * root[b]


@part
def _coefficient(sums, area):
    total = 0.0
    for b in range(len(sums)):
        total += sums[b]
    return total / math.sqrt(area) if area > 0.0 else 0.0


def count(codes: NDArray[np.uint16], ex: NDArray[np.int64], ey: NDArray[np.int64], bins: int) -> NDArray[np.int64]:
    """The histograms of one box, ex (cols + 1), ey (rows + 1) -> (rows * cols, bins) int64."""
    cells = [codes[y0:y1, x0:x1] for y0, y1 in pairwise(ey) for x0, x1 in pairwise(ex)]
    return np.stack([np.bincount(cell.ravel(), minlength=bins) for cell in cells])


@exact
def match_direct(codes, ex, ey, area, root):
    """sum_j sqrt(b_j b_ref_j) of each box, (N,), counted pixel by pixel.

    codes (H, W) with values below U; ex (N, cols + 1), ey (N, rows + 1) in its pixels; area (N,); root (rows * cols, U)
    float32: the square roots of the reference.
    """
    n, cols, rows = ex.shape[0], ex.shape[1] - 1, ey.shape[1] - 1
    counts, sums, out = np.empty(root.shape[1], np.int32), np.empty(root.shape[1], np.float32), np.empty(n)
    for p in range(n):
        sums[:] = np.float32(0.0)
        for r in range(rows):
            for c in range(cols):
                counts[:] = 0
                for y in range(ey[p, r], ey[p, r + 1]):
                    for x in range(ex[p, c], ex[p, c + 1]):
                        counts[codes[y, x]] += 1
                _add_match(counts, root[r * cols + c], sums)
        out[p] = _coefficient(sums, area[p])
    return out


@exact
def match_integral(codes, ex, ey, area, root):
    """What `match_direct` returns, from the integral histogram of `codes`: integral[y, x, b] counts above and left."""
    n, cols, rows, u = ex.shape[0], ex.shape[1] - 1, ey.shape[1] - 1, root.shape[1]
    height, width = codes.shape
    below = np.zeros((width, u), np.int32)  # of each column of pixels down to this row
    integral = np.empty((height + 1, width + 1, u), np.int32)
    integral[0] = 0
    for y in range(height):
        # in a pass of its own: reading a vector back right after one of its numbers was written stalls the processor
        for x in range(width):
            below[x, codes[y, x]] += 1
        row = integral[y + 1]
        row[0] = 0
        for x in range(width):
            now, before, column = row[x + 1], row[x], below[x]
            for b in range(u):
                now[b] = before[b] + column[b]
    counts, sums, out = np.empty(u, np.int32), np.empty(u, np.float32), np.empty(n)
    for p in range(n):
        sums[:] = np.float32(0.0)
        for r in range(rows):
            upper, lower = integral[ey[p, r]], integral[ey[p, r + 1]]
            for c in range(cols):
                x0, x1 = ex[p, c], ex[p, c + 1]
                ul, ur, ll, lr = upper[x0], upper[x1], lower[x0], lower[x1]
                for b in range(u):
                    counts[b] = lr[b] - ll[b] - ur[b] + ul[b]
                _add_match(counts, root[r * cols + c], sums)
        out[p] = _coefficient(sums, area[p])
    return out
