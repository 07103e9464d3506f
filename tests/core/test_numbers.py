"""Spans of masks and their unions, against slow twins."""

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.numbers import spans, union

MASKS = st.lists(st.tuples(st.booleans(), st.booleans()), max_size=12)


def naive_spans(mask, apart):
    found = []
    for row, holds in enumerate(mask):
        if holds and found and found[-1][1] == row and not apart[row]:
            found[-1] = (found[-1][0], row + 1)
        elif holds:
            found.append((row, row + 1))
    return found


@given(MASKS)
def test_spans_are_half_open_runs_of_true(rows):
    mask, apart = ([row[k] for row in rows] for k in (0, 1))
    array = np.array(mask, np.bool_)
    assert spans(array) == naive_spans(mask, [False] * len(mask))
    assert spans(array, np.array(apart[1:], np.bool_)) == naive_spans(mask, apart)


@given(st.lists(st.tuples(st.integers(0, 20), st.integers(1, 6)), max_size=8), st.integers(0, 3))
def test_a_union_covers_the_same_and_closes_gaps(found, gap):
    joined = union([(begin, begin + length) for begin, length in found], gap)
    covered = {place for begin, length in found for place in range(begin, begin + length)}
    assert covered <= {place for begin, end in joined for place in range(begin, end)}
    assert all(later[0] - earlier[1] > gap for earlier, later in itertools.pairwise(joined))
    assert gap or covered == {place for begin, end in joined for place in range(begin, end)}
