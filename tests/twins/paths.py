"""A slow, plain twin of start/paths.py, which tries all paths. Imports nothing of ours."""

import itertools

import numpy as np


def paths(rows, columns):
    """Every path: a row for each column, where the next one differs by at most one."""
    for first in range(rows):
        for steps in itertools.product((-1, 0, 1), repeat=columns - 1):
            path = list(itertools.accumulate(steps, initial=first))
            if min(path) >= 0 and max(path) < rows:
                yield path


def worth(gain, bend, path):
    """The sum along a path, less `bend` for each change of the row."""
    return sum(gain[r, c] for c, r in enumerate(path)) - bend * sum(a != b for a, b in itertools.pairwise(path))


def follow(gain, bend):
    """The largest sum to each row of the last column (R,), and the best path, of equal ones the upper from its end."""
    best, chosen = np.full(len(gain), -np.inf), None
    for path in paths(*gain.shape):
        best[path[-1]] = max(best[path[-1]], worth(gain, bend, path))
        rank = (-worth(gain, bend, path), path[::-1])
        if chosen is None or rank < chosen:
            chosen = rank
    return best, chosen[1][::-1]
