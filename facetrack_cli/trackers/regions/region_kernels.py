# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""The loops of the three likelihoods of a region (Odobez, Ba & Gatica-Perez 2003).

Contour: edges along the normals of an outline, and the nearest of each (eq. 11).

Histogram: many boxes at once, compared with one reference (section 3.3, "Color model"). An image is first coded: every
pixel holds the number of its bin, among the bins that matter and one for all others. Boxes are then counted from
integral histograms.

Correlation: patches on a fixed grid, of a particle now and of its parent in the image before (eq. 6), and how far they
differ (eq. 12 and 13).
"""

import math

import numpy as np

from facetrack_cli.engine.kernels.compiled import exact, fast, fast_part, inline, join, look_up

# --- contour

# all loops run over this many normals side by side: enough to vectorise, few enough to stay in the fastest cache
_MOST = 512
_HALF, _ZERO, _NAN, _INF = np.float32(0.5), np.float32(0.0), np.float32(np.nan), np.float32(np.inf)
_BITS, _MASK = np.uint64(16), np.uint64(0xFFFF)


@inline
def _read_along(joined, width, height, place, t, at, part, four, row):
    """Bilinear values `t` steps along the normals into `row`, nan outside; `place`: x, y and the steps along either."""
    px, py, dx, dy, fx, fy = place[0], place[1], place[2], place[3], part[0], part[1]
    stride, last_x, last_y = np.uint32(width), np.int32(width - 2), np.int32(height - 2)
    most_x, most_y = np.float32(width - 1), np.float32(height - 1)
    for k in range(len(at)):
        x, y = px[k] + t * dx[k], py[k] + t * dy[k]
        inside = (x >= _ZERO) & (y >= _ZERO) & (x <= most_x) & (y <= most_y)
        x, y = x if inside else _ZERO, y if inside else _ZERO
        x0, y0 = min(np.int32(x), last_x), min(np.int32(y), last_y)
        fx[k], fy[k] = x - np.float32(x0) if inside else _NAN, y - np.float32(y0)
        at[k] = np.uint32(y0) * stride + np.uint32(x0)
    look_up(joined, _BITS, _MASK, at, part, four, row)


@inline
def _contrast(g0, g1, g2, g3):
    """Of the middle two of four values."""
    return _HALF * abs(g3 + g2 - g1 - g0)


@inline
def _top(before, here, after):
    """Where the parabola through three contrasts, of which the middle one is a maximum, is highest: -0.5 to 0.5."""
    return _HALF * (before - after) / (before - here + (after - here))


@inline
def _edges(place, least, nearest, o, i, outer, inner):
    """`nearest`, where it has none yet, becomes an edge around `place`, outwards or inwards; how many still have none.

    Values are `o` outwards and `i` inwards; contrasts `outer` and `inner` before, at and, which is set here, after it.
    """
    (o0, o1, o2, o3), (i0, i1, i2, i3) = o, i
    (outer_before, outer_here, outer_after), (inner_before, inner_here, inner_after) = outer, inner
    none = np.int32(0)
    for k in range(len(nearest)):
        outer_after[k] = _contrast(o0[k], o1[k], o2[k], o3[k])
        inner_after[k] = _contrast(i0[k], i1[k], i2[k], i3[k])
        a0, a1, a2 = outer_before[k], outer_here[k], outer_after[k]
        b0, b1, b2 = inner_before[k], inner_here[k], inner_after[k]
        # nan fails all these comparisons
        a = place + _top(a0, a1, a2) if (a1 > least) & (a1 > a0) & (a1 >= a2) else _INF
        b = place + _top(b0, b1, b2) if (b1 > least) & (b1 >= b0) & (b1 > b2) else _INF
        nearest[k] = nearest[k] if nearest[k] < _INF else min(a, b)
        none += np.int32(0) if nearest[k] < _INF else np.int32(1)
    return none


@fast("u2:2 f8:2 i8 i8 i8 f8:2 f8:2 f8 f8")
def nearest_edges(image, x, origin_x, origin_y, factor, points, normals, reach, threshold):
    """How far the nearest edge lies from each point of an outline, along its normal: (N, L), inf where there is none.

    `x` (N, 3) are centres in the whole image and scales of the outline; `image` (H, W) uint16 shows it from
    (origin_x, origin_y) on, reduced by `factor`. `points` (L, 2) are relative to the centre, at scale 1; `normals`
    (L, 2) have length 1. `reach` and the answer are in pixels of the whole image, `threshold` in units of `image`.

    Values are read in steps of `factor` pixels. The contrast between the middle two of four of them, g_0 to g_3, is
    |g_3 + g_2 - g_1 - g_0| / 2. Its maxima above `threshold`, of two equal neighbours the one farther inwards, are the
    edges, placed by the parabola through their neighbours. What is nan is no edge, and next to it there is none.
    """
    height, width = image.shape
    count = len(points)
    out = np.full((len(x), count), np.inf)
    if height < 2 or width < 2 or reach <= 0.0:
        return out
    joined, n, least = join(image, np.uint64, _BITS), math.ceil(reach / factor), np.float32(threshold)
    together = max(_MOST // count, 1)
    room = together * count
    places, parts = np.empty((4, room), np.float32), np.empty((2, room), np.float32)
    ats, quads, distances = np.empty(room, np.uint32), np.empty(room, np.uint64), np.empty(room, np.float32)
    values, contrasts = np.empty((8, room), np.float32), np.empty((6, room), np.float32)
    for first in range(0, len(x), together):
        last = min(first + together, len(x))
        for p in range(first, last):
            # without a size there is no outline: all its points are nan
            scale = x[p, 2] / factor if x[p, 2] > 0.0 else np.nan
            cx = (x[p, 0] - origin_x - 0.5 * (factor - 1)) / factor
            cy = (x[p, 1] - origin_y - 0.5 * (factor - 1)) / factor
            for k in range(count):
                lane = (p - first) * count + k
                places[0, lane], places[1, lane] = cx + points[k, 0] * scale, cy + points[k, 1] * scale
                places[2, lane], places[3, lane] = normals[k, 0], normals[k, 1]
        lanes = (last - first) * count
        place, part, at, four = places[:, :lanes], parts[:, :lanes], ats[:lanes], quads[:lanes]
        g, c, nearest = values[:, :lanes], contrasts[:, :lanes], distances[:lanes]
        nearest[:] = _INF
        # rows of g: 0 to 3 the last values outwards, 4 to 7 inwards; of c: 0 to 2 the last contrasts, 3 to 5 inwards
        for k in range(6):
            t = np.float32(k if k < 3 else 3 - k)
            _read_along(joined, width, height, place, t, at, part, four, g[k if k < 3 else k + 1])
        for k in range(lanes):
            c[1, k] = c[3, k] = _contrast(g[5, k], g[0, k], g[1, k], g[2, k])  # half a step outwards
            c[0, k] = c[4, k] = _contrast(g[6, k], g[5, k], g[0, k], g[1, k])  # half a step inwards
        for step in range(n):  # outwards and inwards at once, until all have an edge
            a, b, e, f = step % 4, (step + 1) % 4, (step + 2) % 4, (step + 3) % 4
            u, v, w = step % 3, (step + 1) % 3, (step + 2) % 3
            for side in range(2):
                t = np.float32(-step - 3 if side else step + 3)
                _read_along(joined, width, height, place, t, at, part, four, g[4 * side + f])
            o, i = (g[a], g[b], g[e], g[f]), (g[4 + a], g[4 + b], g[4 + e], g[4 + f])
            outer, inner = (c[u], c[v], c[w]), (c[3 + u], c[3 + v], c[3 + w])
            if _edges(np.float32(step) + _HALF, least, nearest, o, i, outer, inner) == 0:
                break
        for k in range(lanes):
            distance = nearest[k] * factor
            if distance <= reach:
                out[first + k // count, k % count] = distance
    return out


# --- histogram

LANES = 16  # so many bins are counted at a time: enough to vectorise, few enough to fit into memory


@exact("u2:2 i8:2 i8:2 f8:1 f4:2")
def match_boxes(codes, ex, ey, area, root):
    """sum_j sqrt(b_j b_ref_j) of each box, (N,).

    codes (H, W) with values below U, a multiple of LANES; ex (N, cols + 1), ey (N, rows + 1) in its pixels; area (N,);
    root (rows * cols, U) float32: the square roots of the reference.
    """
    n, cols, rows, u = ex.shape[0], ex.shape[1] - 1, ey.shape[1] - 1, root.shape[1]
    height, width = codes.shape
    sums, out = np.zeros((n, u), np.float32), np.zeros(n)
    # integral[y, x, b] counts above and left, `below` in each column of pixels down to this row
    integral, counts = np.zeros((height + 1, width + 1, LANES), np.int32), np.empty(LANES, np.int32)
    for first in range(0, u, LANES):
        below = np.zeros((width, LANES), np.int32)
        for y in range(height):
            # in a pass of its own: to read a vector right after one of its numbers was written stalls the processor
            for x in range(width):
                b = codes[y, x] - first
                if b >= 0 and b < LANES:
                    below[x, b] += 1
            row = integral[y + 1]
            for x in range(width):
                now, before, column = row[x + 1], row[x], below[x]
                for b in range(LANES):
                    now[b] = before[b] + column[b]
        for p in range(n):
            total = sums[p, first : first + LANES]
            for r in range(rows):
                upper, lower = integral[ey[p, r]], integral[ey[p, r + 1]]
                for c in range(cols):
                    x0, x1 = ex[p, c], ex[p, c + 1]
                    ul, ur, ll, lr = upper[x0], upper[x1], lower[x0], lower[x1]
                    roots = root[r * cols + c, first : first + LANES]
                    for b in range(LANES):
                        counts[b] = lr[b] - ll[b] - ur[b] + ul[b]
                    for b in range(LANES):
                        total[b] += math.sqrt(np.float32(counts[b])) * roots[b]
    for p in range(n):
        if area[p] > 0.0:
            for b in range(u):
                out[p] += sums[p, b]
            out[p] /= math.sqrt(area[p])
    return out


# --- correlation


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
def _read_patch(image, view, factor, box, size, columns, across, lines, down, line, patch):
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


@fast("u1:2 i8x4 u1:2 i8x4 i8 f8:2 f8:2 f8x2 i8 i8 f8 f8 f8:1")
def patch_distances(now, now_view, before, before_view, factor, x, parents, size, cols, rows, saturation, outside, out):
    """Distances `out` (N,) of the patches of x (N, 3) in `now` from those of parents (N, 3) in `before` (eq. 13).

    x and parents are (cx, cy, s), boxes of `size` (w, h) times s; pixels of the whole image, centres at whole
    numbers. Both images are grey (H, W) uint8, reduced by `factor`; a view is (left, top, width, height): where in
    the whole image it begins, and how large that is. The patch is the grid of cols x rows cell centres of the box.
    A point adds rho, which is the least of |difference| and `saturation`, or the square of the difference where that
    is 0; one that lies beyond the whole image in either of the two adds `outside`.
    """
    # a border of zeros runs around a patch; what ends a row begins the next
    stride = cols + 1
    length = (rows + 2) * stride + 1
    a, b, alike = np.zeros(length, np.float32), np.zeros(length, np.float32), np.empty(length, np.float32)
    columns, across = np.zeros(cols, np.uint64), np.zeros(cols, np.float32)
    lines, down = np.zeros(rows, np.uint64), np.zeros(rows, np.float32)
    line = np.zeros(max(now.shape[1], before.shape[1]), np.float32)
    most, there = np.float32(saturation), (0, 0, 0, 0)
    for p in range(x.shape[0]):
        # resampling puts the children of a parent side by side: the parent is read once
        same = p > 0 and parents[p, 0] == parents[p - 1, 0] and parents[p, 1] == parents[p - 1, 1]
        if not (same and parents[p, 2] == parents[p - 1, 2]):
            there = _read_patch(before, before_view, factor, parents[p], size, columns, across, lines, down, line, b)
        here = _read_patch(now, now_view, factor, x[p], size, columns, across, lines, down, line, a)
        r0, r1 = max(here[0], there[0]), min(here[1], there[1])
        c0, c1 = max(here[2], there[2]), min(here[3], there[3])
        inside, v, total = max(r1 - r0, 0) * max(c1 - c0, 0), b, np.float32(0.0)
        if inside < cols * rows:
            # the same on both sides, so that what cannot be compared adds nothing
            alike[:] = a
            for first in range((r0 + 1) * stride + 1, (r1 + 1) * stride + 1, stride):
                for k in range(first + c0, first + c1):
                    alike[k] = b[k]
            v = alike
        if most > 0.0:
            for j in range(length):
                total += min(abs(a[j] - v[j]), most)
        else:
            for j in range(length):
                d = a[j] - v[j]
                total += d * d
        out[p] = total + (cols * rows - inside) * outside
