"""Edges along the normals of an outline, and the nearest of each (Odobez, Ba & Gatica-Perez 2003, eq. 11)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from facetrack_cli.kernels.compiled import fast, inline

_ONE, _HALF, _NONE = np.uint32(1), np.float32(0.5), np.float32(np.inf)


@inline
def _grey(image: Any, x: Any, y: Any, inside: bool) -> Any:
    """Bilinear grey value; nan beyond the centres of the border pixels. `inside`: it is known to lie well within."""
    if not inside:
        height, width = image.shape
        if not (x >= 0.0 and y >= 0.0 and x <= width - 1 and y <= height - 1):
            return np.float32(np.nan)
    # unsigned, or each index would be tested for counting from the end
    x0, y0 = np.uint32(np.int32(x)), np.uint32(np.int32(y))
    if not inside:
        x0, y0 = np.uint32(min(x0, width - 2)), np.uint32(min(y0, height - 2))
    fx, fy = x - np.float32(x0), y - np.float32(y0)
    above, below = image[y0, x0], image[y0 + _ONE, x0]
    above += fx * (image[y0, x0 + _ONE] - above)
    below += fx * (image[y0 + _ONE, x0 + _ONE] - below)
    return above + fy * (below - above)


@inline
def _top(before: Any, here: Any, after: Any) -> Any:
    """Where the parabola through three contrasts, of which the middle one is a maximum, is highest: -0.5 to 0.5."""
    return _HALF * (before - after) / (before - here + (after - here))


@fast
def nearest_edges(
    image: Any,
    x: Any,
    origin_x: float,
    origin_y: float,
    factor: int,
    points: Any,
    normals: Any,
    reach: float,
    threshold: float,
) -> Any:
    """How far the nearest edge lies from each point of an outline, along its normal: (N, L), inf where there is none.

    `x` (N, 3) are centres in the whole picture and scales of the outline; `image` (H, W) float32 shows it from
    (origin_x, origin_y) on, reduced by `factor`. `points` (L, 2) are relative to the centre, at scale 1; `normals`
    (L, 2) have length 1. `reach` and the answer are in pixels of the whole picture.

    Grey values are read in steps of `factor` pixels. The contrast between the middle two of four of them, g_0 to g_3,
    is |g_3 + g_2 - g_1 - g_0| / 2. Its maxima above `threshold`, of two equal neighbours the one farther inwards, are
    the edges, placed by the parabola through their neighbours. What is nan is no edge, and next to it there is none.
    """
    out = np.full((len(x), len(points)), np.inf)
    height, width = image.shape
    if height < 2 or width < 2 or reach <= 0.0:
        return out
    n = math.ceil(reach / factor)
    least = np.float32(threshold)
    for p in range(len(x)):
        scale = x[p, 2] / factor
        cx = (x[p, 0] - origin_x - 0.5 * (factor - 1)) / factor
        cy = (x[p, 1] - origin_y - 0.5 * (factor - 1)) / factor
        # no outline, or one that is nowhere near the picture
        if not (scale > 0.0 and scale < 1e9 and abs(cx) < 1e12 and abs(cy) < 1e12):
            continue
        for k in range(len(points)):
            dx, dy = np.float32(normals[k, 0]), np.float32(normals[k, 1])
            px, py = np.float32(cx + points[k, 0] * scale), np.float32(cy + points[k, 1] * scale)
            ex, ey = (n + 2) * abs(dx), (n + 2) * abs(dy)
            inside = px - ex >= 1.0 and py - ey >= 1.0 and px + ex < width - 2 and py + ey < height - 2
            # the last three values on the outer side, o, and on the inner side, i, and the last two contrasts of each
            o0 = i0 = _grey(image, px, py, inside)
            o1, i1 = _grey(image, px + dx, py + dy, inside), _grey(image, px - dx, py - dy, inside)
            two = np.float32(2.0)
            o2 = _grey(image, px + two * dx, py + two * dy, inside)
            i2 = _grey(image, px - two * dx, py - two * dy, inside)
            outer = inner_before = _HALF * abs(o2 + o1 - o0 - i1)  # half a step outwards
            inner = outer_before = _HALF * abs(o1 + o0 - i1 - i2)  # half a step inwards
            for step in range(n):  # outwards and inwards at once, until there is an edge
                t = np.float32(step + 3)
                o3 = _grey(image, px + t * dx, py + t * dy, inside)
                i3 = _grey(image, px - t * dx, py - t * dy, inside)
                outer_after, inner_after = _HALF * abs(o3 + o2 - o1 - o0), _HALF * abs(i0 + i1 - i2 - i3)
                nearest = _NONE
                if outer > least and outer > outer_before and outer >= outer_after:
                    nearest = np.float32(step) + _HALF + _top(outer_before, outer, outer_after)
                if inner > least and inner >= inner_before and inner > inner_after:
                    nearest = min(nearest, np.float32(step) + _HALF + _top(inner_before, inner, inner_after))
                if nearest < _NONE:
                    if nearest * factor <= reach:
                        out[p, k] = nearest * factor
                    break
                o0, o1, o2, i0, i1, i2 = o1, o2, o3, i1, i2, i3
                outer_before, outer, inner_before, inner = outer, outer_after, inner, inner_after
    return out
