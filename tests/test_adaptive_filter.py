"""The adaptive filter: its number of particles (eq. 17), and its posterior against the exact one."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.filters import Adaptive, Ahead
from facetrack_cli.guide import Noise
from facetrack_cli.motion import AffineWalk
from facetrack_cli.resampling import uniform
from facetrack_cli.spaces import estimate
from facetrack_cli.types import Particles

STATE, SHIFT = np.array([[10.0, 20.0, 1.0, 0.1, -0.1, 0.9]]), np.array([[3.0, -2.0, 0.05, 0.0, 0.0, 0.05]])
SPREAD = np.array([2.0, 2.0, 0.05, 0.05, 0.05, 0.05])


def ahead(noise=1.0, fell=None):
    return Ahead(STATE, SHIFT, noise, None, fell)


# --- eq. 17 --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("noise", "fell", "number"),
    [
        (1.0, None, 100), (0.5, None, 50), (2.0, None, 200),  # nobody is recognised: J_0 eta
        (1.0, True, 80), (1.0, False, 120),  # d = 0.2: less while the entropy falls, more when it rose
        (0.5, True, 30), (2.0, False, 220), (0.774, True, 57), (0.776, False, 98),
    ],
)  # fmt: skip
def test_the_number_of_particles(noise, fell, number):
    assert Adaptive(100, entropy=0.2).number(ahead(noise, fell)) == number
    assert Adaptive(300, entropy=0.2).number(ahead(noise, fell)) == pytest.approx(3 * number, abs=2)
    assert Adaptive(100).number(ahead(noise, fell)) == round(100 * noise), "d is 0 unless it is given"
    assert Adaptive(100, adapt=False, entropy=0.2).number(ahead(noise, fell)) == 100


@given(st.floats(0, 3), st.sampled_from([None, True, False]), st.integers(1, 500), st.floats(0, 2), st.integers(1, 60))
def test_it_is_never_below_the_least(noise, fell, particles, entropy, least):
    number = Adaptive(particles, entropy=entropy, least=least).number(ahead(noise, fell))
    change = {None: 0, True: -entropy, False: entropy}[fell]
    assert number >= least
    assert number == least or abs(number - particles * (noise + change)) <= 0.5 + 1e-6


def test_the_mean_error_of_a_good_track_takes_fewer_than_j_0():
    """Figure 2b: 77 of 100 with eta(eps; 0.5, 2, 1), at eps about 0.2."""
    assert Adaptive(100).number(ahead(Noise().eta(0.18))) == 77


# --- the step ------------------------------------------------------------------------------------------------------


@dataclass
class Gaussian:
    """The state is seen at y with the standard deviations `sigma`; moves by SPREAD around the place ahead."""

    y: np.ndarray
    sigma: np.ndarray
    ahead: Ahead
    blind: bool = False

    def propagate(self, rng, x):
        assert (x == self.ahead.state).all(), "only the point estimate is propagated"
        return x + self.ahead.shift + self.ahead.noise * SPREAD * rng.standard_normal(x.shape)

    def log_likelihood(self, x, parents):
        assert x.shape == parents.shape and (parents == self.ahead.state).all()
        if self.blind:
            return np.full(x.shape[:2], -np.inf)
        return -0.5 * np.sum(((x - self.y) / self.sigma) ** 2, axis=2)

    def log_prior(self, x):
        return np.zeros(len(x))


def stepped(model, number, seed=0, **settings):
    before = Particles(np.full((3, 1, 6), np.nan), uniform(3))  # what they were does not matter
    return Adaptive(number, **settings)(np.random.default_rng(seed), before, model)


@pytest.mark.parametrize("noise", [0.5, 1.0, 2.0])
def test_it_converges_to_the_exact_posterior(noise):
    """Proposal N(theta + nu, (eta u)^2) times likelihood N(y): Kalman's gain, for each coordinate."""
    sigma = np.array([1.5, 3.0, 0.03, 0.1, 0.05, 0.02])
    y = STATE + SHIFT + np.array([[1.0, -2.0, 0.02, -0.05, 0.0, 0.02]])
    model = Gaussian(y, sigma, ahead(noise))
    variance = (noise * SPREAD) ** 2
    k = variance / (variance + sigma**2)
    mean, spread = STATE + SHIFT + k * (y - STATE - SHIFT), np.sqrt((1 - k) * variance)
    off = []
    for number in (500, 8000, 128_000):
        runs = [stepped(model, number, seed, adapt=False) for seed in range(6)]
        found = np.array([estimate(particles).state for particles, _ in runs])
        off.append(float(np.sqrt(np.mean(((found - mean) / spread) ** 2))))
    assert off[2] < 0.02, off
    # a sixteenth of the variance each time, so a quarter of the error
    assert off[0] > 2.5 * off[1] > 6 * off[2], off
    x, log_w = runs[0][0]
    cov = estimate(runs[0][0]).cov[0]
    np.testing.assert_allclose(np.sqrt(np.diag(cov)), spread[:2], rtol=0.03)
    assert np.exp(log_w).sum() == pytest.approx(1)
    assert runs[0][1].ess == pytest.approx(1 / np.sum(np.exp(log_w) ** 2)) and len(x) == 128_000


def test_the_best_particle_is_the_one_at_the_peak():
    y = STATE + SHIFT
    particles, _ = stepped(Gaussian(y, 0.2 * SPREAD, ahead()), 20_000, adapt=False)
    best = estimate(particles, best=True).state
    nearest = np.argmin((((particles.x - y) / SPREAD) ** 2).sum(axis=(1, 2)))
    np.testing.assert_array_equal(best, particles.x[nearest])


def test_the_centre_is_a_particle_where_that_is_asked_for():
    model = Gaussian(STATE, SPREAD, ahead())
    with_it, without = (stepped(model, 50, centre=centre)[0].x for centre in (True, False))
    np.testing.assert_array_equal(with_it[0], STATE + SHIFT)
    np.testing.assert_array_equal(with_it[1:], without[1:])
    assert not (without == STATE + SHIFT).any()


def test_as_many_as_eq_17_says_and_equal_weights_where_nothing_is_likely():
    (x, log_w), info = stepped(Gaussian(STATE, SPREAD, ahead(0.7, False), blind=True), 100, entropy=0.1)
    assert len(x) == 80 and info.ess == pytest.approx(80)
    np.testing.assert_allclose(log_w, -math.log(80))


def test_the_noise_of_the_walk_is_as_large_as_eq_13_says():
    walk, parents = AffineWalk(2.0, 0.02, 0.01, 0.2, 5.0), np.repeat(STATE[None], 40_000, axis=0)
    one = walk.propagate(np.random.default_rng(0), parents) - STATE
    three = walk.propagate(np.random.default_rng(0), parents, SHIFT, 3.0) - STATE - SHIFT
    np.testing.assert_allclose(three, 3.0 * one, atol=1e-12)
