# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""Edges along the normals of an outline, and the nearest of each (Odobez, Ba & Gatica-Perez 2003, eq. 11)."""

import math

import numpy as np

from facetrack_cli.engine.kernels.compiled import fast, inline, join, look_up

# all loops run over this many normals side by side: enough to vectorise, few enough to stay in the fastest cache
_LANES = 512
_HALF, _ZERO, _NAN, _INF = np.float32(0.5), np.float32(0.0), np.float32(np.nan), np.float32(np.inf)
_BITS, _MASK = np.uint64(16), np.uint64(0xFFFF)


@inline
def _read(joined, width, height, place, t, at, part, four, row):
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


@fast
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
    together = max(_LANES // count, 1)
    room = together * count
    places, parts = np.empty((4, room), np.float32), np.empty((2, room), np.float32)
    ats, quads, found = np.empty(room, np.uint32), np.empty(room, np.uint64), np.empty(room, np.float32)
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
        g, c, nearest = values[:, :lanes], contrasts[:, :lanes], found[:lanes]
        nearest[:] = _INF
        # rows of g: 0 to 3 the last values outwards, 4 to 7 inwards; of c: 0 to 2 the last contrasts, 3 to 5 inwards
        for k in range(6):
            t = np.float32(k if k < 3 else 3 - k)
            _read(joined, width, height, place, t, at, part, four, g[k if k < 3 else k + 1])
        for k in range(lanes):
            c[1, k] = c[3, k] = _contrast(g[5, k], g[0, k], g[1, k], g[2, k])  # half a step outwards
            c[0, k] = c[4, k] = _contrast(g[6, k], g[5, k], g[0, k], g[1, k])  # half a step inwards
        for step in range(n):  # outwards and inwards at once, until all have an edge
            a, b, e, f = step % 4, (step + 1) % 4, (step + 2) % 4, (step + 3) % 4
            u, v, w = step % 3, (step + 1) % 3, (step + 2) % 3
            for side in range(2):
                t = np.float32(-step - 3 if side else step + 3)
                _read(joined, width, height, place, t, at, part, four, g[4 * side + f])
            o, i = (g[a], g[b], g[e], g[f]), (g[4 + a], g[4 + b], g[4 + e], g[4 + f])
            outer, inner = (c[u], c[v], c[w]), (c[3 + u], c[3 + v], c[3 + w])
            if _edges(np.float32(step) + _HALF, least, nearest, o, i, outer, inner) == 0:
                break
        for k in range(lanes):
            distance = nearest[k] * factor
            if distance <= reach:
                out[first + k // count, k % count] = distance
    return out
