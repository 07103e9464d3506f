"""The walk of a box that may be hidden: its density, its samples, and what it says of places that are proposed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.types import Particles
from facetrack_cli.engine.resampling import normalise, uniform
from facetrack_cli.engine.spaces import Estimate
from facetrack_cli.trackers.box import box_kernels as kernels
from facetrack_cli.trackers.box.hidden_box import VISIBLE, VisibleBoxSpace
from tests.support.parts import visible_walk
from tests.twins import walk as naive

SIGMA, HIDDEN = 3.0, 1.0
WALK = visible_walk(SIGMA, HIDDEN, scale=0.05)
N = 100_000

PARENTS = [(50.0, 40.0, 1.0, 0.0, 0.0, 1.0), (50.0, 40.0, 0.5, 4.0, -2.0, 0.0), (50.0, 40.0, 1.6, -3.0, 1.0, 0.4)]


def state(parent, n=1):
    return np.tile(np.array(parent), (n, 1, 1))


@pytest.mark.parametrize(("limits", "drawn"), [((0.9, 1.02), True), ((0.1, 10.0), False)])
def test_the_scale_stays_within_its_limits(limits, drawn):
    one = visible_walk(SIGMA, HIDDEN, limits=limits, scale=0.2)
    s = one.propagate(np.random.default_rng(0), state(PARENTS[0], 1000))[:, 0, 2]
    assert limits[0] <= s.min() and s.max() <= limits[1]
    assert (np.isin(s, limits).sum() > 0) == drawn


def test_presence_is_the_weight_of_what_is_visible_within_half_a_box():
    # of a box of 12x8 pixels at scale 1.5: at its corner, beyond a side of it, and within
    table = [((59, 46), 0.8, 0.4), ((59.1, 40), 1.0, 0.2), ((50, 33.9), 1.0, 0.1), ((41, 34), 0.5, 0.3)]
    x = np.array([[(*place, 1.0, 0.0, 0.0, visible)] for place, visible, _ in table])
    estimated = Estimate(np.array([[50.0, 40.0, 1.5, 0.0, 0.0, 0.9]]), np.zeros((1, 2, 2)))
    presence = VisibleBoxSpace((12.0, 8.0)).presence(Particles(x, np.log([w for *_, w in table])), estimated)
    assert presence == pytest.approx([0.8 * 0.4 + 0.5 * 0.3])


def crowd(seed=3, n=30):
    rng = np.random.default_rng(seed)
    x = np.array([PARENTS[k % 3] for k in range(n)])[:, None]
    x[:, 0, :2] += rng.normal(0, 2, (n, 2))
    return Particles(x, normalise(rng.normal(0, 1, n)))


@given(seed=st.integers(0, 10_000), many=st.integers(1, 6), n=st.integers(1, 5))
def test_the_kernel_is_what_its_plain_twin_says(seed, many, n):
    rng = np.random.default_rng(seed)
    z, parents, w = rng.normal(0, 1, (n, 3)), rng.normal(0, 1, (many, 6)), rng.dirichlet(np.ones(many))
    parents[:, 2], parents[:, 5] = rng.uniform(0.5, 2, many), rng.random(many)
    walk, u, e = (0.7, 0.5, 0.3, 0.02, 0.18, 0.02, 0.9, 1.1), rng.random(n), rng.normal(0, 1, (n, 2))
    shown, hidden, x = np.empty(n), np.empty(n), np.empty((n, 6))
    returns, size = kernels.arrive(z, parents, np.log(w), (SIGMA, HIDDEN), walk, u, e, shown, hidden, x)
    assert returns == pytest.approx(w @ (1 - parents[:, 5]) * 0.02) and size == pytest.approx(w @ parents[:, 2])
    for k in range(n):
        parts = np.array(naive.arrive(z[k], parents, w, (SIGMA, HIDDEN), walk))
        np.testing.assert_allclose(np.exp([shown[k], hidden[k]]), parts.sum(axis=0), rtol=1e-9)
        which = np.searchsorted(np.cumsum(parts.T.ravel()) / parts.sum(), u[k])
        np.testing.assert_allclose(x[k, :2], z[k, :2])
        assert x[k, 2] == pytest.approx(min(max(np.exp(z[k, 2]), 0.9), 1.1)) and x[k, 5] == 0
        sigma = (SIGMA, HIDDEN)[which // many]
        np.testing.assert_allclose(x[k, 3:5], naive.velocity(z[k], parents[which % many], sigma, walk, e[k]))


@given(seed=st.integers(0, 10_000), n=st.integers(2, 9), hidden=st.booleans())
def test_particles_that_are_carried_and_what_they_come_to_are_those_of_the_plain_twins(seed, n, hidden):
    rng = np.random.default_rng(seed)
    x, log_w, step = rng.normal(0, 3, (n, 6)), normalise(rng.normal(0, 1, n)), rng.normal(0, 2, 2)
    x[:, 2], x[:, 5] = rng.uniform(0.5, 2, n), rng.uniform(0, 0.4, n) if hidden else rng.random(n)
    noise, walk = rng.normal(0, 1, (n + 1) // 2), (0.3, 0.5, 0.7, 0.9, 1.1)
    kernels.carry(x, noise, step, walk, moved := np.empty((n, 1, 6)))
    np.testing.assert_allclose(moved[:, 0], naive.carried(x, noise, step, *walk), rtol=1e-12)
    particles = Particles(x[:, None], log_w)
    found, ess = VisibleBoxSpace((12.0, 8.0)).summed(particles)
    *expected, samples = naive.summed(x, np.exp(log_w), (12.0, 8.0))
    for mine, plain in zip(found, expected, strict=True):
        np.testing.assert_allclose(mine[0] if mine.ndim > 1 else mine, plain, rtol=1e-6)
    assert ess == pytest.approx(samples)


@given(seed=st.integers(0, 10_000), far=st.sampled_from([1.0, 100.0]))
def test_a_mixture_is_that_of_its_normal_densities(seed, far):
    rng = np.random.default_rng(seed)
    z, mean, std, log_w = (
        rng.normal(0, far, (4, 3)),
        rng.normal(0, 1, (3, 3)),
        rng.uniform(0.5, 2, (3, 3)),
        rng.normal(0, 1, 3),
    )
    kernels.log_mixture(z, mean, std, log_w, out := np.empty(4))
    np.testing.assert_allclose(out, naive.log_mixture(z, mean, std, log_w), rtol=1e-9)


def test_who_arrives_is_weighed_over_all_parents():
    particles, rng = crowd(), np.random.default_rng(4)
    z = np.column_stack([rng.normal(50, 4, 50), rng.normal(40, 4, 50), rng.normal(0, 0.3, 50)])
    x, log_visible, log_hidden, returns, _ = WALK.arrive(np.random.default_rng(0), z, particles)
    np.testing.assert_allclose(x[:, 0, :2], z[:, :2])
    np.testing.assert_allclose(x[:, 0, 2], np.exp(z[:, 2]))
    one = WALK.settings
    hidden = float(np.exp(particles.log_w) @ (1 - particles.x[:, 0, VISIBLE]))
    assert returns == 0.0
    _, same, less, returns, _ = WALK.arrive(np.random.default_rng(0), z, particles, found=True)
    assert returns == pytest.approx(hidden * one.show * one.elsewhere)
    np.testing.assert_array_equal(same, log_visible)
    assert np.all(less <= log_hidden) and np.any(less < log_hidden)


@pytest.mark.parametrize("parent", PARENTS[:2])
def test_its_velocity_is_that_of_who_was_propagated_to_the_same_place(parent):
    """p(v | z) is a regression of the velocities on the places of samples; of one parent that is surely (in)visible."""
    one = visible_walk(SIGMA, HIDDEN, scale=0.05, hide=1e-9, show=1e-9)
    moved = one.propagate(np.random.default_rng(0), state(parent, N))[:, 0]
    off = moved[:, 0] - moved[:, 0].mean()
    slope = off @ moved[:, 3] / (off @ off)
    residual = np.std(moved[:, 3] - moved[:, 3].mean() - slope * off)
    z = np.tile([55.0, 38.0, np.log(parent[2])], (20_000, 1))
    v = one.arrive(np.random.default_rng(1), z, Particles(state(parent), np.zeros(1)))[0][:, 0, 3]
    assert v.mean() == pytest.approx(moved[:, 3].mean() + slope * (55 - moved[:, 0].mean()), abs=0.05)
    assert v.std() == pytest.approx(residual, rel=0.03)


def test_its_forecast_is_that_of_samples_of_a_visible_target():
    one = visible_walk(SIGMA, HIDDEN, scale=0.05, hide=1e-9)
    particles = crowd()
    particles.x[:, 0, VISIBLE], particles.x[:, 0, 2] = 1.0, 1.3
    mean, std = one.forecast(particles)
    rng = np.random.default_rng(0)
    which = rng.choice(len(particles.x), N, p=np.exp(particles.log_w))
    moved = one.propagate(rng, particles.x[which])[:, 0]
    z = np.column_stack([moved[:, :2], np.log(moved[:, 2])])
    np.testing.assert_allclose(mean, z.mean(axis=0), atol=0.05)
    np.testing.assert_allclose(std, z.std(axis=0), rtol=0.02)


def test_far_from_all_parents_it_is_finite():
    particles = Particles(state(PARENTS[0], 10), uniform(10))
    z = np.array([[1e6, -1e6, 0.0], [50.0, 40.0, 5.0], [50.0, 40.0, -5.0]])
    x, log_visible, log_hidden, _, _ = WALK.arrive(np.random.default_rng(0), z, particles)
    assert np.isfinite(x).all() and np.isfinite(np.logaddexp(log_visible, log_hidden)).all()
    assert x[1, 0, 2] == 10.0 and x[2, 0, 2] == 0.1


@pytest.mark.parametrize("n", [1, 7, 400])
def test_what_others_see_moving_is_carried_with_its_mean_velocities(n):
    one, before = WALK.settings, np.repeat(np.array(PARENTS), [n] * 3, axis=0)[:, None]
    step = np.array([5.0, -2.0])
    after = WALK.carried(np.random.default_rng(0), before, step)
    np.testing.assert_array_equal(after[:, 0, :2], before[:, 0, :2] + step)
    np.testing.assert_array_equal(after[:, 0, VISIBLE], before[:, 0, VISIBLE])
    # the mean of the velocity of `propagate`, given where the place has come to
    a, b = one.velocity, one.acceleration
    np.testing.assert_allclose(after[:, 0, 3:5], a * before[:, 0, 3:5] + b * (step - a * before[:, 0, 3:5]))
    grown = np.log(after[:, 0, 2] / before[:, 0, 2])
    assert grown.std() == pytest.approx(0.05, rel=0.15) if n == 400 else np.isfinite(grown).all()
