# mypy: disallow_untyped_defs=False, disallow_untyped_calls=False
"""Pixels of polygons, row by row, compiled: `boxes.py` says whose rule it is. Twin: `tests/twins/boxes.py`."""

import numpy as np

from facetrack_cli.engine.kernels.compiled import exact


@exact
def count_pixels(a, a_poly, b, b_poly, within, out):
    """Shared pixels and pixels in all, into `out` (T, 2), of regions a and b (T, 4, 2) on whole pixels.

    `a_poly`, `b_poly` (T,) tell polygons from rectangles, whose corners are their outermost pixels; `within` (T, 4) is
    the first column and row and the last column and row that count.
    """
    ours, true, nodes = np.empty((2, 2)), np.empty((2, 2)), np.empty(4)
    for t in range(len(a)):
        left, top = within[t, 0], within[t, 1]
        width = within[t, 2] - left + 1
        shared = total = 0.0
        for row in range(int(within[t, 3] - top + 1)):
            n = _spans(a[t], a_poly[t], left, top, width, row, nodes, ours)
            m = _spans(b[t], b_poly[t], left, top, width, row, nodes, true)
            for i in range(n):
                total += ours[i, 1] - ours[i, 0] + 1
                for j in range(m):
                    shared += max(min(ours[i, 1], true[j, 1]) - max(ours[i, 0], true[j, 0]) + 1, 0.0)
            for j in range(m):
                total += true[j, 1] - true[j, 0] + 1
        out[t, 0], out[t, 1] = shared, total - shared


@exact
def _spans(region, is_polygon, left, top, width, row, nodes, out):
    """First and last columns of the runs of pixels that the region has in a row, into `out`; how many runs, 0 to 2.

    Columns and rows are counted from (left, top), which matters: where an edge meets a row is cut towards zero.
    """
    n, count = 0, 0
    if not is_polygon:
        out[0, 0], out[0, 1] = max(region[0, 0] - left, 0.0), min(region[2, 0] - left, width - 1)
        return int(region[0, 1] - top <= row <= region[2, 1] - top and out[0, 0] <= out[0, 1])
    for i in range(4):
        x, y = region[i, 0] - left, region[i, 1] - top
        x_before, y_before = region[i - 1, 0] - left, region[i - 1, 1] - top
        if min(y, y_before) <= row <= max(y, y_before):
            rise = y_before - y
            # both ends of an edge count, so that a corner is met twice; of a level edge each end comes by itself
            node = np.trunc(x + (row - y) / rise * (x_before - x)) if rise != 0 else x
            at = count
            while at > 0 and nodes[at - 1] > node:
                nodes[at] = nodes[at - 1]
                at -= 1
            nodes[at] = node
            count += 1
    i, covered = 0, -1.0
    while i < count - 1 and nodes[i] < width:
        if nodes[i] == nodes[i + 1] and i < count - 2:  # a corner met twice begins no run, unless it is the last
            i += 1
            continue
        first, last = max(nodes[i], covered + 1), min(nodes[i + 1], width - 1)
        if first <= last:
            out[n, 0], out[n, 1] = first, last
            n, covered = n + 1, last
        i += 2
    return n
