# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""Patches on a fixed grid, of a particle now and of its parent in the image before, and how far they differ.

Odobez, Ba & Gatica-Perez 2003, eq. 6 (the patch) and eq. 12 and 13 (its distance from the parent's).
"""

import numpy as np

from facetrack_cli.engine.kernels.compiled import fast, fast_part

L2, SATURATED_L1, HAUSDORFF = 0, 1, 2
DISTANCES = {"l2": L2, "saturated_l1": SATURATED_L1, "hausdorff": HAUSDORFF}
NOTHING = np.float32(1e9)  # grey level of what is not there: so far from all others that it is nobody's nearest


@fast_part
def _axis(centre, step, low, whole, count, factor, at, part):
    """Where the points of one axis, `step` apart around `centre`, are read; the range [first, last) of those within.

    The whole image is `whole` pixels long; the reduced one shows it from `low` on, by `count` pixels. Point i is read
    between pixels at[i] and at[i] + 1, by the share part[i] of the latter.
    """
    n, shrink = len(at), 1.0 / factor
    least, most = (-0.5 * factor - low) * shrink, (whole - low - 0.5 * factor) * shrink
    place, step = (centre - 0.5 * step * (n - 1) - low - 0.5 * (factor - 1)) * shrink, step * shrink
    first, last = n, 0
    for i in range(n):
        reduced = place + i * step
        # not a number fails this too
        if reduced >= least and reduced <= most:
            first, last = min(first, i), i + 1
            reduced = min(max(reduced, 0.0), count - 1.0)
            below = max(min(int(reduced), count - 2), 0)
            at[i], part[i] = below, reduced - below
    return min(first, last), last


@fast_part
def _read(image, view, factor, box, size, columns, across, lines, down, line, patch):
    """The `patch` of the `box` (cx, cy, s), read bilinearly; `view` as in `patch_distances`, the others are scratch.

    Returns (first row, last row, first column, last column), half-open: the points within the image, which are set.
    """
    height, width = image.shape
    one, stride = np.float32(1.0), len(columns) + 1
    r0, r1 = _axis(box[1], box[2] * size[1] / len(lines), view[1], view[3], height, factor, lines, down)
    c0, c1 = _axis(box[0], box[2] * size[0] / len(columns), view[0], view[2], width, factor, columns, across)
    if r1 > r0 and c1 > c0:
        # an image of one pixel has no neighbour to the right or below
        right, below = np.uint64(min(1, width - 1)), np.uint64(min(1, height - 1))
        start = min(columns[c0], columns[c1 - 1])
        end = max(columns[c0], columns[c1 - 1]) + right + np.uint64(1)
        # slices, since an index that could be negative keeps a loop from vectorising
        at, share = columns[c0:c1], across[c0:c1]
        for j in range(len(at)):
            at[j] -= start
        for i in range(r0, r1):
            y, fy = lines[i], down[i]
            upper, lower = image[y, start:end], image[y + below, start:end]
            for j in range(len(upper)):
                line[j] = (one - fy) * np.float32(upper[j]) + fy * np.float32(lower[j])
            row = patch[(i + 1) * stride + 1 + c0 : (i + 1) * stride + 1 + c1]
            for j in range(len(row)):
                row[j] = (one - share[j]) * line[at[j]] + share[j] * line[at[j] + right]
    return r0, r1, c0, c1


@fast_part
def _nearest(a, b, stride, n):
    """Sum over the points of patch `a` of the least difference from the 3x3 points of patch `b` around each."""
    first = stride + 1
    row = a[first : first + n]
    b00, b01, b02 = b[:n], b[1 : n + 1], b[2 : n + 2]
    b10, b11, b12 = b[stride : stride + n], b[first : first + n], b[first + 1 : first + 1 + n]
    b20, b21, b22 = b[2 * stride : 2 * stride + n], b[2 * stride + 1 : 2 * stride + 1 + n], b[2 * stride + 2 :]
    total = np.float32(0.0)
    for j in range(n):
        v = row[j]
        above = min(min(abs(v - b00[j]), abs(v - b01[j])), abs(v - b02[j]))
        level = min(min(abs(v - b10[j]), abs(v - b11[j])), abs(v - b12[j]))
        below = min(min(abs(v - b20[j]), abs(v - b21[j])), abs(v - b22[j]))
        total += min(min(above, level), below)
    return total


@fast_part
def _cut(patch, r0, r1, c0, c1, stride, out):
    """`patch` with NOTHING outside rows r0..r1 and columns c0..c1, into `out`."""
    out[:] = NOTHING
    for first in range((r0 + 1) * stride + 1, (r1 + 1) * stride + 1, stride):
        for k in range(first + c0, first + c1):
            out[k] = patch[k]


@fast
def patch_distances(
    now, now_view, before, before_view, factor, x, parents, size, cols, rows, distance, saturation, outside, out
):
    """Distances `out` (N,) of the patches of x (N, 3) in `now` from those of parents (N, 3) in `before` (eq. 13).

    x and parents are (cx, cy, s), boxes of `size` (w, h) times s; pixels of the whole image, centres at whole
    numbers. Both images are grey (H, W) uint8, reduced by `factor`; a view is (left, top, width, height): where in
    the whole image it begins, and how large that is. The patch is the grid of cols x rows cell centres of the box.
    A point that lies beyond the whole image in either of the two adds `outside` in place of rho.
    """
    # a border of NOTHING runs around a patch; what ends a row begins the next
    stride = cols + 1
    length, n = (rows + 2) * stride + 1, rows * stride - 1
    a, b = np.full(length, NOTHING), np.full(length, NOTHING)
    cut_a, cut_b = np.empty(length, np.float32), np.empty(length, np.float32)
    columns, across = np.zeros(cols, np.uint64), np.zeros(cols, np.float32)
    lines, down = np.zeros(rows, np.uint64), np.zeros(rows, np.float32)
    line = np.zeros(max(now.shape[1], before.shape[1]), np.float32)
    most, there = np.float32(saturation), (0, 0, 0, 0)
    for p in range(x.shape[0]):
        # resampling puts the children of a parent side by side: the parent is read once
        same = p > 0 and parents[p, 0] == parents[p - 1, 0] and parents[p, 1] == parents[p - 1, 1]
        if not (same and parents[p, 2] == parents[p - 1, 2]):
            there = _read(before, before_view, factor, parents[p], size, columns, across, lines, down, line, b)
        here = _read(now, now_view, factor, x[p], size, columns, across, lines, down, line, a)
        r0, r1 = max(here[0], there[0]), min(here[1], there[1])
        c0, c1 = max(here[2], there[2]), min(here[3], there[3])
        inside, u, v, total = max(r1 - r0, 0) * max(c1 - c0, 0), a, b, np.float32(0.0)
        if inside < cols * rows:
            # the same on both sides, so that what cannot be compared adds nothing
            _cut(a, r0, r1, c0, c1, stride, cut_a)
            _cut(b, r0, r1, c0, c1, stride, cut_b)
            u, v = cut_a, cut_b
        if distance == HAUSDORFF:
            total = max(_nearest(u, v, stride, n), _nearest(v, u, stride, n))
        elif distance == L2:
            for j in range(length):
                d = u[j] - v[j]
                total += d * d
        else:
            for j in range(length):
                total += min(abs(u[j] - v[j]), most)
        out[p] = total + (cols * rows - inside) * outside
