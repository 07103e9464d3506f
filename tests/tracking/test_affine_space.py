"""Affine states: what noise does to them, and what they are in the image."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.types import Particles
from facetrack_cli.engine.spaces import estimate, evenly
from facetrack_cli.trackers.appearance.space import AffineSpace, scale_of
from tests.support.parts import affine_walk
from tests.twins import guide as naive

SPACE = AffineSpace((41.0, 61.0))
STILL = np.zeros((1, 2))
WALK = affine_walk(2.0, 0.04, 0.01, turn=0.03)
NUMBER = st.floats(-3, 3)
STATES = st.tuples(st.floats(-500, 500), st.floats(-500, 500), NUMBER, NUMBER, NUMBER, NUMBER)


def shown(*state):
    estimated = evenly(np.array([state], np.float64), STILL)
    outline = SPACE.outline(estimated)
    return SPACE.windows(estimated)[0], outline.angle, outline.corners


# --- geometry ------------------------------------------------------------------------------------------------------


def test_a_box_at_the_start_is_itself():
    (x0,) = AffineSpace((41, 61)).at((100, 50, 41, 61))
    np.testing.assert_array_equal(x0, (120, 80, 1, 0, 0, 1))
    windows, angle, corners = shown(*x0)
    assert (tuple(windows), angle) == ((41, 61), 0)
    # its outermost pixels
    np.testing.assert_array_equal(corners, [(100, 50), (140, 50), (140, 110), (100, 110)])


@given(STATES)
def test_corners_equal_the_plain_twin_and_the_angle_is_the_nearest_rotation(state):
    windows, angle, corners = shown(*state)
    np.testing.assert_allclose(corners, naive.corners(state, SPACE.size), atol=1e-9)
    right, down = corners[1] - corners[0], corners[3] - corners[0]
    sides = np.linalg.norm(right) * 41 / 40, np.linalg.norm(down) * 61 / 60
    np.testing.assert_allclose(windows, sides, atol=1e-9)
    a = np.reshape(state[2:], (2, 2))

    def off(degrees):
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        return np.linalg.norm(a - [[c, -s], [s, c]])

    assert off(angle) <= min(off(angle + more) for more in (-90, -7, 0.5, 30, 180)) + 1e-9


def test_a_box_of_a_pixel_has_corners():
    outline = AffineSpace((1.0, 1.0)).outline(evenly(np.array([[5.0, 6, 1, 0, 0, 1]]), STILL))
    np.testing.assert_array_equal(outline.corners, [(4.5, 5.5), (5.5, 5.5), (5.5, 6.5), (4.5, 6.5)])


# --- motion --------------------------------------------------------------------------------------------------------


@given(
    st.integers(0, 10**6), STATES, st.floats(0, 4), st.sampled_from([None, 0.0, 0.5]), st.sampled_from([0.0, 0.3, 1.0]),
    st.tuples(st.floats(0.01, 0.9), st.floats(1.1, 4)),
)  # fmt: skip
def test_the_walk_equals_the_plain_twin(seed, state, noise, turn, shear, bounds):
    walk = affine_walk(3.0, 0.2, shear, bounds, turn)
    shift = np.random.default_rng(seed + 1).normal(size=(1, 6))
    x = np.tile(np.array(state), (5, 1, 1))
    u = np.random.default_rng(seed).standard_normal(x.shape)
    sigma = 3.0, 0.2, 0.2 if turn is None else turn, shear
    for given_, by, size in (((), np.zeros((1, 6)), 1.0), ((shift, noise), shift, noise)):
        expected = [naive.diffused(state, one[0], sigma, by[0], size, *bounds) for one in u]
        np.testing.assert_allclose(
            walk.propagate(np.random.default_rng(seed), x, *given_)[:, 0], expected, atol=1e-9, rtol=1e-9
        )


@pytest.mark.parametrize("walk", [WALK, affine_walk(2.0, 0.04)])
def test_the_transition_is_the_density_of_the_samples(walk):
    parent = np.array([[[10.0, 20, 1, 0.2, -0.1, 0.9]]])
    drawn = walk.propagate(np.random.default_rng(0), np.repeat(parent, 40_000, axis=0))
    off = (drawn - parent)[:, 0]
    cov = np.cov(off.T)
    log_p = walk.log_transition(drawn, parent)
    assert log_p.shape == (40_000, 1, 1)
    centre = -0.5 * np.linalg.slogdet(2 * np.pi * cov)[1]
    np.testing.assert_allclose(log_p.max(), centre, atol=0.3)
    expected = -0.5 * np.einsum("ni,ij,nj->n", off, np.linalg.inv(cov), off) + centre
    assert np.abs(log_p[:, 0, 0] - expected).mean() < 0.03
    # minus the entropy of a Gaussian
    assert log_p.mean() == pytest.approx(-0.5 * np.linalg.slogdet(2 * np.pi * np.e * cov)[1], abs=0.03)


def test_the_scale_stays_within_its_bounds_however_far_it_is_shifted():
    walk = affine_walk(2.0, 0.5, scale=(0.5, 2.0))
    rng = np.random.default_rng(0)
    x = np.repeat(np.array([[[0.0, 0, 1, 0, 0, 1]]]), 500, axis=0)
    for deform in ((9.0, 0, 0, 9), (-1.0, 0, 0, -1), (0.0, 3, -3, 0)):
        shift = np.array([[0.0, 0, *deform]])
        for _ in range(20):
            x = walk.propagate(rng, x, shift, 2.0)
            scale = scale_of(x)
            assert scale.min() >= 0.5 - 1e-9 and scale.max() <= 2.0 + 1e-9
    # it keeps its direction
    still = affine_walk(0.0, 0.0, scale=(0.5, 2.0))
    wild = np.array([[[0.0, 0, 6, 2, -2, 6]], [[0.0, 0, 0.1, 0, 0, 0.2]], [[0.0, 0, 0, 0, 0, 0]]])
    found = still.propagate(rng, wild)[:, 0, 2:]
    np.testing.assert_allclose(found[0], np.array([6, 2, -2, 6]) * 2 / math.sqrt(40), rtol=1e-12)
    np.testing.assert_allclose(found[1], np.array([0.1, 0, 0, 0.2]) * 0.5 / math.sqrt(0.025), rtol=1e-12)
    np.testing.assert_allclose(found[2], [0.5, 0, 0, 0.5], rtol=1e-12)


# --- estimate ------------------------------------------------------------------------------------------------------


def test_the_best_particle_or_the_mean():
    x = np.arange(18.0).reshape(3, 1, 6)
    particles = Particles(x, np.log([0.2, 0.5, 0.3]))
    many = np.full(1, np.inf)
    mean, best = estimate(particles, many), estimate(particles, many, best=True)
    np.testing.assert_allclose(mean.state, 0.2 * x[0] + 0.5 * x[1] + 0.3 * x[2])
    np.testing.assert_array_equal(best.state, x[1])
    # the spread is about the mean in both
    np.testing.assert_array_equal(best.cov, mean.cov)
    variance = 0.2 * 6.6**2 + 0.5 * 0.6**2 + 0.3 * 5.4**2  # 0, 6 and 12 about 6.6
    np.testing.assert_allclose(mean.cov[0], variance)
    of_equals = estimate(Particles(x, np.log([0.4, 0.4, 0.2])), many, best=True)
    np.testing.assert_array_equal(of_equals.state, x[0])
    alone = estimate(Particles(x, np.array([-np.inf, 0.0, -np.inf])), many)
    np.testing.assert_array_equal(alone.state, x[1])
