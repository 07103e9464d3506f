# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""Patches of affine parallelograms, read bilinearly and normalised (Zhou, Chellappa & Moghaddam 2003, eq. 3)."""

import math

import numpy as np

from facetrack_cli.engine.kernels.compiled import between, exact, fast, inline, join, look_up

MIN_VARIANCE = 0.25  # of grey levels squared; below it a patch is flat
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_BITS, _MASK = np.uint32(8), np.uint32(0xFF)


@exact
def boxes_extent(x, w, h, width, height):
    """(x from, y from, x to, y to) of boxes (w, h), centred, at x, within the image.

    x (N, 3) = (cx, cy, s), or (N, 6) = (cx, cy, a1, a2, a3, a4), deformed by [[a1, a2], [a3, a4]].
    """
    x0, y0, x1, y1 = width - 1.0, height - 1.0, 0.0, 0.0
    for n in range(x.shape[0]):
        b1, b2, b3, b4 = x[n, 2], 0.0, 0.0, x[n, 2]
        if x.shape[1] == 6:
            b2, b3, b4 = x[n, 3], x[n, 4], x[n, 5]
        u, v = 0.5 * (w * abs(b1) + h * abs(b2)), 0.5 * (w * abs(b3) + h * abs(b4))
        left, top, right, bottom = x[n, 0] - u, x[n, 1] - v, x[n, 0] + u, x[n, 1] + v
        # comparisons leave out nan
        x0, y0 = left if left < x0 else x0, top if top < y0 else y0
        x1, y1 = right if right > x1 else x1, bottom if bottom > y1 else y1
    return max(x0, 0.0), max(y0, 0.0), min(x1, width - 1.0), min(y1, height - 1.0)


@inline
def _read_inside(joined, width, place, grid, at, part, four, row):
    """Grey levels of all points into `row`; `place` (u, v, b1, b2, b3, b4) in pixels of `joined`, all within."""
    gx, gy, fx, fy = grid[0], grid[1], part[0], part[1]
    u0, v0 = np.float32(place[0]), np.float32(place[1])
    b1, b2, b3, b4 = np.float32(place[2]), np.float32(place[3]), np.float32(place[4]), np.float32(place[5])
    stride = np.int32(width)
    for k in range(len(at)):
        u, v = u0 + b1 * gx[k] + b2 * gy[k], v0 + b3 * gx[k] + b4 * gy[k]
        i, j = np.int32(v), np.int32(u)
        fx[k], fy[k] = u - np.float32(j), v - np.float32(i)
        at[k] = i * stride + j
    look_up(joined, _BITS, _MASK, at, part, four, row)


@inline
def _read_anywhere(joined, width, height, place, whole, grid, seen, row):
    """As `_read_inside`, of points anywhere; how many of them are `seen`: those within `whole` (u, v from, u, v to)."""
    count = 0
    for k in range(len(row)):
        x, y = float(grid[0, k]), float(grid[1, k])
        u, v = place[0] + place[2] * x + place[3] * y, place[1] + place[4] * x + place[5] * y
        row[k], seen[k] = _ZERO, _ZERO
        # not a number fails this too
        if u >= whole[0] and v >= whole[1] and u <= whole[2] and v <= whole[3]:
            u, v = min(max(u, 0.0), width - 1.0), min(max(v, 0.0), height - 1.0)
            j, i = int(u), int(v)
            row[k] = between(joined[i * width + j], _BITS, _MASK, np.float32(u - j), np.float32(v - i))
            seen[k] = _ONE
            count += 1
    return count


@inline
def _normalise(row, seen, count, out):
    """`row` with mean 0 and variance 1 over the points `seen` into `out`; all 0 if they are too few or it is flat."""
    total, squares = _ZERO, _ZERO
    for k in range(len(row)):
        total += row[k]
    mean = total / np.float32(max(count, 1))
    for k in range(len(row)):
        row[k] = (row[k] - mean) * seen[k]
        squares += row[k] * row[k]
    variance = squares / np.float32(max(count, 1))
    shown = 2 * count >= len(row) and variance >= MIN_VARIANCE
    scale = _ONE / np.float32(math.sqrt(variance))
    for k in range(len(out)):
        out[k] = row[k] * scale if shown else _ZERO


@fast
def read_patches(grey, left, top, factor, width, height, extent, x, w, h, rows, cols):
    """Patches (N, rows * cols) float32 at x (N, 6) = (cx, cy, a1, a2, a3, a4), pixels of the whole image.

    Point (i, j) is read at (cx, cy) + [[a1, a2], [a3, a4]] (w ((j + .5) / cols - .5), h ((i + .5) / rows - .5)).
    `grey` (H, W) uint8 shows the whole image of width x height from (left, top) on, reduced by `factor`, at least
    within `extent`, where all the points within the image lie. Points beyond the whole image are 0 and count neither in
    mean nor in variance; a patch with more than half of them, or one that is flat, is 0 throughout.
    """
    d, shrink = rows * cols, 1.0 / factor
    # one block more on each side, between whose centre and the next the outermost points are read
    x0 = min(max(int((extent[0] - left) * shrink) - 1, 0), grey.shape[1] - 1)
    y0 = min(max(int((extent[1] - top) * shrink) - 1, 0), grey.shape[0] - 1)
    n_x = min(max(int((extent[2] - left) * shrink) + 2, x0 + 1), grey.shape[1]) - x0
    n_y = min(max(int((extent[3] - top) * shrink) + 2, y0 + 1), grey.shape[0]) - y0
    joined = join(grey[y0 : y0 + n_y, x0 : x0 + n_x], np.uint32, _BITS)
    # from the whole image's pixels to those of `joined`
    off_x, off_y = left + x0 * factor + 0.5 * (factor - 1), top + y0 * factor + 0.5 * (factor - 1)
    whole = ((-0.5 - off_x) * shrink, (-0.5 - off_y) * shrink,
             (width - 0.5 - off_x) * shrink, (height - 0.5 - off_y) * shrink)  # fmt: skip
    grid = np.empty((2, d), np.float32)
    for i in range(rows):
        for j in range(cols):
            grid[0, i * cols + j], grid[1, i * cols + j] = w * ((j + 0.5) / cols - 0.5), h * ((i + 0.5) / rows - 0.5)
    most_x, most_y = 0.5 * abs(w), 0.5 * abs(h)
    at, part, four = np.empty(d, np.int32), np.empty((2, d), np.float32), np.empty(d, np.uint32)
    row, some, every = np.empty(d, np.float32), np.empty(d, np.float32), np.ones(d, np.float32)
    out = np.empty((x.shape[0], d), np.float32)
    for n in range(x.shape[0]):
        u, v = (x[n, 0] - off_x) * shrink, (x[n, 1] - off_y) * shrink
        place = (u, v, x[n, 2] * shrink, x[n, 3] * shrink, x[n, 4] * shrink, x[n, 5] * shrink)
        half_u = abs(place[2]) * most_x + abs(place[3]) * most_y
        half_v = abs(place[4]) * most_x + abs(place[5]) * most_y
        if u - half_u >= 0.0 and v - half_v >= 0.0 and u + half_u <= n_x - 1.0 and v + half_v <= n_y - 1.0:
            _read_inside(joined, n_x, place, grid, at, part, four, row)
            seen, count = every, d
        else:
            seen, count = some, _read_anywhere(joined, n_x, n_y, place, whole, grid, some, row)
        _normalise(row, seen, count, out[n])
    return out


@exact
def diffuse(x, u, spread, shift, noise, least, most):
    """x + shift + noise * spread u of states x and standard noise u (N, 6), `spread` (6, 6), `shift` (6,) -> (N, 6).

    Deformations with a scale beyond `least` or `most` are brought back to it; one of 0 becomes upright.
    """
    out = np.empty_like(x)
    for n in range(len(x)):
        for i in range(6):
            total = 0.0
            for j in range(6):
                total += spread[i, j] * u[n, j]
            out[n, i] = x[n, i] + shift[i] + noise * total
        a1, a2, a3, a4 = out[n, 2], out[n, 3], out[n, 4], out[n, 5]
        scale = math.sqrt(0.5 * (a1 * a1 + a2 * a2 + a3 * a3 + a4 * a4))
        if scale < least or scale > most:
            if scale < 1e-12:
                out[n, 2], out[n, 3], out[n, 4], out[n, 5], scale = least, 0.0, 0.0, least, least
            by = min(max(scale, least), most) / scale
            for i in range(2, 6):
                out[n, i] *= by
    return out
