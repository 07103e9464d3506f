"""The best path across a table, from its first column to its last, by dynamic programming."""

import numpy as np
from numpy.typing import NDArray


def follow(gain: NDArray[np.float64], bend: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The path of the largest sum through gain (R, C): a row in each column, from one to the next at most a row away.

    A change of the row costs `bend`. Returns the largest sum of a path that ends in each row, (R,), and the rows of the
    best path of all, (C,) int64. Of equal paths it is the upper one, from the end backwards.
    """
    rows, columns = gain.shape
    # a row above the first and below the last, which no path comes from
    sums, path = np.full((columns, rows + 2), -np.inf), np.empty(columns, np.int64)
    sums[0, 1:-1] = gain[:, 0]
    for c in range(1, columns):
        above, level, below = sums[c - 1, :-2], sums[c - 1, 1:-1], sums[c - 1, 2:]
        sums[c, 1:-1] = np.maximum(level, np.maximum(above, below) - bend) + gain[:, c]
    ends = sums[-1, 1:-1]
    path[-1] = best = int(np.argmax(ends))
    for c in range(columns - 1, 0, -1):
        above, level, below = sums[c - 1, best : best + 3].tolist()
        best += -1 if above - bend >= max(level, below - bend) else 0 if level >= below - bend else 1
        path[c - 1] = best
    return ends, path
