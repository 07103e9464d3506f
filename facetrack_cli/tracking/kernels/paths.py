"""The best path across a table, from its first column to its last, by dynamic programming."""

import numpy as np

from facetrack_cli.tracking.kernels.compiled import exact


@exact
def follow(gain, bend):
    """The path of the largest sum through gain (R, C): a row in each column, from one to the next at most a row away.

    A change of the row costs `bend`. Returns the largest sum of a path that ends in each row, (R,), and the rows of the
    best path of all, (C,) int64. Of equal paths it is the upper one, from the end backwards.
    """
    rows, columns = gain.shape
    # a row above the first and below the last, which no path comes from
    sums, path = np.empty((columns, rows + 2)), np.empty(columns, np.int64)
    for c in range(columns):
        sums[c, 0] = sums[c, rows + 1] = -np.inf
    for r in range(rows):
        sums[0, r + 1] = gain[r, 0]
    for c in range(1, columns):
        above, level, below = sums[c - 1, :-2], sums[c - 1, 1:-1], sums[c - 1, 2:]
        here, more = sums[c, 1:-1], gain[:, c]
        for r in range(rows):
            here[r] = max(level[r], max(above[r], below[r]) - bend) + more[r]
    ends, best = sums[columns - 1, 1:-1], 0
    for r in range(rows):
        best = r if ends[r] > ends[best] else best
    path[columns - 1] = best
    for c in range(columns - 1, 0, -1):
        last = sums[c - 1, path[c] : path[c] + 3]
        above, level, below = last[0] - bend, last[1], last[2] - bend
        step = -1 if above >= max(level, below) else 0 if level >= below else 1
        path[c - 1] = path[c] + step
    return ends, path
