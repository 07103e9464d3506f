"""The best path across a table: it is what its plain twin finds, straight over nothing and along a curved line."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.tracking.start.paths import follow
from tests.twins import paths as naive


@given(seed=st.integers(0, 10_000), rows=st.integers(1, 40), columns=st.integers(1, 5))
def test_the_kernel_is_what_its_plain_twin_says(seed, rows, columns):
    rng = np.random.default_rng(seed)
    gain, bend = rng.normal(0, 1, (rows, columns)), rng.uniform(0, 2)
    sums, path = follow(gain, bend)
    best, chosen = naive.follow(gain, bend)
    np.testing.assert_allclose(sums, best, rtol=0, atol=1e-12)
    assert path.tolist() == chosen


@given(seed=st.integers(0, 10_000), rows=st.integers(1, 9), columns=st.integers(1, 5), halves=st.integers(0, 2))
def test_of_equal_paths_it_takes_the_upper_from_the_end(seed, rows, columns, halves):
    # sums of halves are exact, so that many are equal
    gain, bend = np.random.default_rng(seed).integers(0, 3, (rows, columns)) / 2, halves / 2
    sums, path = follow(gain, bend)
    best, chosen = naive.follow(gain, bend)
    assert sums.tolist() == best.tolist() and path.tolist() == chosen


@pytest.mark.parametrize("rows", [1, 2, 96])
def test_a_table_that_says_nothing_is_crossed_straight(rows):
    sums, path = follow(np.zeros((rows, 96)), 0.05)
    assert not sums.any() and not path.any()


def test_a_line_is_followed_as_far_as_it_bends_by_a_row_a_column():
    line = np.round(48 + 20 * np.sin(np.arange(96) / 20)).astype(int)
    gain = np.zeros((96, 96))
    gain[line, np.arange(96)] = 1.0
    sums, path = follow(gain, 0.05)
    assert path.tolist() == line.tolist()
    assert sums.max() == pytest.approx(96 - 0.05 * np.count_nonzero(np.diff(line)))
