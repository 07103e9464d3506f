"""Resampling at its edges, and arithmetic on log weights."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from facetrack_cli.engine.resampling import SCHEMES, effective_sample_size, logsumexp, normalise, uniform


class Extreme(np.random.Generator):
    """A generator whose every uniform is the largest below 1, or 0: where searches run off the end."""

    def __init__(self, u):
        super().__init__(np.random.PCG64(0))
        self.u = u

    def random(self, size=None):
        return self.u if size is None else np.full(size, self.u)


weights = hnp.arrays(float, st.integers(1, 40), elements=st.floats(-700, 50))


@pytest.mark.parametrize("name", SCHEMES)
@pytest.mark.parametrize("u", [0.0, np.nextafter(1.0, 0.0)])
@given(log_w=weights, m=st.integers(1, 60))
def test_indices_are_valid_at_both_ends(name, u, log_w, m):
    chosen = SCHEMES[name](Extreme(u), normalise(log_w), m)
    assert chosen.shape == (m,)
    assert chosen.dtype == np.int64
    assert chosen.min() >= 0
    assert chosen.max() < len(log_w)
    assert np.all(np.diff(chosen) >= 0)


@pytest.mark.parametrize("name", SCHEMES)
@pytest.mark.parametrize("u", [0.0, np.nextafter(1.0, 0.0), None])
def test_a_particle_of_weight_zero_is_never_drawn(name, u):
    rng = np.random.default_rng(3) if u is None else Extreme(u)
    with np.errstate(divide="ignore"):
        log_w = np.log(np.array([0.0, 0.0, 0.3, 0.0, 0.7, 0.0, 0.0]))
    assert set(SCHEMES[name](rng, log_w, 50)) <= {2, 4}


@pytest.mark.parametrize("name", SCHEMES)
def test_expected_counts_are_the_weights(name):
    rng = np.random.default_rng(1)
    w = np.array([0.05, 0.3, 0.02, 0.43, 0.2])
    counts = np.zeros(5)
    for _ in range(4000):
        counts += np.bincount(SCHEMES[name](rng, np.log(w), 7), minlength=5)
    np.testing.assert_allclose(counts / 4000, 7 * w, atol=0.08)


@given(log_w=weights, m=st.integers(1, 60), seed=st.integers(0, 99))
def test_systematic_counts_are_floor_or_ceil(log_w, m, seed):
    log_w = normalise(log_w)
    counts = np.bincount(SCHEMES["systematic"](np.random.default_rng(seed), log_w, m), minlength=len(log_w))
    assert np.all(np.abs(counts - m * np.exp(log_w)) < 1 + 1e-9)


@given(log_w=weights, m=st.integers(1, 60), seed=st.integers(0, 99))
def test_residual_keeps_the_whole_copies(log_w, m, seed):
    log_w = normalise(log_w)
    counts = np.bincount(SCHEMES["residual"](np.random.default_rng(seed), log_w, m), minlength=len(log_w))
    assert np.all(counts >= np.floor(m * np.exp(log_w) - 1e-9))


@given(weights)
def test_normalised_weights_sum_to_one_and_the_argument_is_untouched(log_w):
    before = log_w.copy()
    assert logsumexp(normalise(log_w)) == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_array_equal(log_w, before)


@pytest.mark.parametrize("bad", [-np.inf, np.nan, np.inf])
def test_weights_that_say_nothing_become_equal(bad):
    np.testing.assert_allclose(normalise(np.full(4, bad)), np.log(0.25))


def test_effective_sample_size_at_its_ends():
    assert effective_sample_size(uniform(37)) == pytest.approx(37)
    one = np.full(37, -np.inf)
    one[3] = 0.0
    assert effective_sample_size(one) == pytest.approx(1)


def test_logsumexp_along_an_axis():
    a = np.random.default_rng(0).normal(size=(4, 5)) * 300
    expected = [np.logaddexp.reduce(row) for row in a]
    np.testing.assert_allclose(logsumexp(a, axis=1), expected)
    with np.errstate(invalid="raise"):
        assert logsumexp(np.full(3, -np.inf)) == -np.inf


@pytest.mark.parametrize("name", SCHEMES)
def test_populations_side_by_side_are_each_resampled_by_their_own_weights(name):
    log_w = np.full((6, 3), -np.inf)
    log_w[[1, 4, 0], [0, 1, 2]] = 0.0
    chosen = SCHEMES[name](np.random.default_rng(0), log_w, 8)
    np.testing.assert_array_equal(chosen, [[1, 4, 0]] * 8)


def test_a_population_that_says_nothing_does_not_touch_its_neighbours():
    log_w = normalise(np.array([[0.0, np.nan], [np.log(3.0), 1.0]]))
    np.testing.assert_allclose(np.exp(log_w), [[0.25, 0.5], [0.75, 0.5]])
