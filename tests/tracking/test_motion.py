"""The random walk: its draws have the density that it states."""

import numpy as np
import pytest

from facetrack_cli.core.geometry import size_of_points
from facetrack_cli.core.types import Particles
from facetrack_cli.tracking.models.motion import RandomWalk
from facetrack_cli.tracking.models.spaces import estimate

SIGMA = np.array([0.5, 2.0, 4.0])


def test_draws_have_the_stated_spread_and_no_drift():
    x = np.arange(6.0).reshape(1, 3, 2).repeat(40000, axis=0)
    moved = RandomWalk(SIGMA).propagate(np.random.default_rng(0), x) - x
    np.testing.assert_allclose(moved.std(axis=0), SIGMA[:, None].repeat(2, axis=1), rtol=0.03)
    np.testing.assert_allclose(moved.mean(axis=0), 0.0, atol=0.07)
    corner = np.corrcoef(moved.reshape(-1, 6).T) - np.eye(6)
    assert np.abs(corner).max() < 0.02


def test_density_integrates_to_one_and_is_the_gaussian():
    walk = RandomWalk(SIGMA)
    step = 0.25
    axis = np.arange(-25, 25, step)
    gx, gy = np.meshgrid(axis, axis)
    x = np.stack([gx.ravel(), gy.ravel()], axis=1)[:, None].repeat(3, axis=1)
    log_p = walk.log_transition(x, np.array([[[1.0, -2.0]] * 3]))
    assert log_p.shape == (len(x), 1, 3)
    np.testing.assert_allclose(np.exp(log_p).sum(axis=(0, 1)) * step**2, 1.0, atol=1e-3)
    one = walk.log_transition(np.array([[[3.0, 1.0]] * 3]), np.zeros((1, 3, 2)))[0, 0]
    np.testing.assert_allclose(one, -10 / (2 * SIGMA**2) - np.log(2 * np.pi * SIGMA**2))


def test_every_pair_of_particle_and_parent_is_scored():
    rng = np.random.default_rng(1)
    x, parents = rng.normal(size=(4, 3, 2)), rng.normal(size=(7, 3, 2))
    table = RandomWalk(SIGMA).log_transition(x, parents)
    assert table.shape == (4, 7, 3)
    single = RandomWalk(SIGMA).log_transition(x[2:3], parents[5:6])
    np.testing.assert_allclose(table[2, 5], single[0, 0])


def test_estimate_is_the_weighted_mean_and_covariance():
    x = np.array([[[0.0, 0.0]], [[4.0, 2.0]]])
    found = estimate(Particles(x, np.log([0.25, 0.75])), np.full(1, np.inf))
    np.testing.assert_allclose(found.state, [[3.0, 1.5]])
    np.testing.assert_allclose(found.cov, [[[3.0, 1.5], [1.5, 0.75]]])


def test_size_of_points_is_the_largest_distance():
    assert size_of_points(np.array([[0.0, 0.0], [3.0, 4.0], [1.0, 1.0]])) == pytest.approx(5.0)
    assert size_of_points(np.array([[2.0, 2.0]])) == 0.0
