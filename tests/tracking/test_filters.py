"""The filters against a Kalman filter on a linear-Gaussian model of four parts on a line."""

from dataclasses import dataclass

import numpy as np
import pytest

from facetrack_cli.core.types import Particles
from facetrack_cli.engine.motion import RandomWalk
from facetrack_cli.engine.resampling import SCHEMES, logsumexp, uniform
from tests.support.parts import auxiliary, factorized, sir

K, D, FRAMES = 4, 1, 30
Q, R, TIE = 1.0, 1.5, 1.2  # standard deviations: of a step, of the observation, of the shape prior's ties


def tie_precision():
    """Neighbouring parts hold together: sum over i of |x_i - x_{i+1}|^2 / TIE^2, as a matrix over the K parts."""
    gaps = np.eye(K - 1, K) - np.eye(K - 1, K, 1)
    return gaps.T @ gaps / TIE**2


@dataclass
class LinearGaussian:
    """The model that a filter sees: random walk, each part observed with noise, ties as the shape prior if `tied`."""

    y: np.ndarray
    tied: bool = False
    blind: bool = False

    def propagate(self, rng, x):
        return RandomWalk(np.full(K, Q)).propagate(rng, x)

    def expect(self, x):
        return x

    def log_transition(self, x, parents):
        return RandomWalk(np.full(K, Q)).log_transition(x, parents)

    def log_likelihood(self, x, parents):
        assert x.shape == parents.shape
        if self.blind:
            return np.full(x.shape[:2], -np.inf)
        return -0.5 * np.sum((x - self.y) ** 2, axis=2) / R**2

    def log_prior(self, x):
        return -0.5 * np.einsum("nid,ij,njd->n", x, tie_precision(), x) if self.tied else np.zeros(len(x))

    @property
    def prior(self):
        return self

    def propose(self, rng, x, part):
        others = np.delete(np.arange(K), part)
        return x[:, others].mean(axis=1) + TIE * rng.standard_normal((len(x), D))


def simulate(seed, covariance):
    rng = np.random.default_rng(seed)
    x = np.linalg.cholesky(covariance) @ rng.standard_normal((K, D))
    ys = []
    for _ in range(FRAMES):
        x = x + Q * rng.standard_normal((K, D))
        ys.append(x + R * rng.standard_normal((K, D)))
    return ys


def kalman(ys, covariance, *, tied=False, forget_ties=False):
    """Exact means (FRAMES, K, D) and covariances over parts; `forget_ties` drops cross-covariances of the prediction.

    The latter is what eq. 11 does: product of the parts' own predictive densities, then the shape prior.
    """
    mean, cov, means, covs = np.zeros((K, D)), covariance, [], []
    for y in ys:
        cov = cov + Q**2 * np.eye(K)
        if forget_ties:
            cov = np.diag(np.diag(cov))
        information = np.linalg.inv(cov)
        total = information + np.eye(K) / R**2 + (tie_precision() if tied else 0)
        new = np.linalg.inv(total)
        mean, cov = new @ (information @ mean + y / R**2), new
        means.append(mean)
        covs.append(cov)
    return np.array(means), np.array(covs)


def run(step, ys, covariance, n, seed, *, tied=False):
    rng = np.random.default_rng(seed)
    x = np.einsum("ij,njd->nid", np.linalg.cholesky(covariance), rng.standard_normal((n, K, D)))
    particles, means, covs = Particles(x, uniform(n)), [], []
    for y in ys:
        particles, info = step(rng, particles, LinearGaussian(y, tied))
        assert logsumexp(particles.log_w) == pytest.approx(0, abs=1e-9)
        assert np.all((info.ess >= 1 - 1e-9) & (info.ess <= n * (1 + 1e-9)))
        w = np.exp(particles.log_w)
        mean = np.einsum("n,nkd->kd", w, particles.x)
        centred = particles.x - mean
        means.append(mean)
        covs.append(np.einsum("n,nid,njd->ij", w, centred, centred) / D)
    return np.array(means), np.array(covs)


def rmse(step, n, *, covariance, seeds=20, tied=False, forget_ties=False):
    errors = []
    for seed in range(seeds):
        ys = simulate(seed, covariance)
        exact, _ = kalman(ys, covariance, tied=tied, forget_ties=forget_ties)
        errors.append(np.mean((run(step, ys, covariance, n, seed + 1000, tied=tied)[0] - exact) ** 2))
    return float(np.sqrt(np.mean(errors)))


APART = np.eye(K)
TOGETHER = 0.3 * np.eye(K) + 4.0  # the parts begin strongly correlated


@pytest.mark.parametrize("name", SCHEMES)
def test_every_resampling_scheme_serves(name):
    assert rmse(factorized("none", resampling=name), 2000, covariance=APART, seeds=4) < 0.1


def test_transition_reweighting_keeps_correlations_that_independent_filters_lose():
    ys = simulate(5, TOGETHER)[:1]
    exact, exact_cov = kalman(ys, TOGETHER)
    means, covs = run(factorized("transition"), ys, TOGETHER, 1500, 1)
    assert np.abs(means - exact).max() < 0.25
    assert np.abs(covs - exact_cov).max() < 0.2
    _, alone = run(factorized("none"), ys, TOGETHER, 1500, 1)
    assert abs(alone[-1][0, 1]) < 0.1 < exact_cov[-1][0, 1]


def test_transition_reweighting_agrees_with_kalman():
    assert rmse(factorized("transition"), 400, covariance=TOGETHER, seeds=1) < 0.3


def test_filters_over_the_joint_state_take_the_prior_as_an_observation():
    assert rmse(sir(), 5000, covariance=APART, seeds=6, tied=True) < 0.06
    assert rmse(auxiliary(), 20000, covariance=APART, seeds=4, tied=True) < 0.2


def test_prior_reweighting_is_the_product_of_marginals_and_prior():
    """Eq. 11 against its exact value; and it is not the same as the joint posterior with that prior."""
    ys = simulate(3, APART)[:8]
    joint, _ = kalman(ys, APART, tied=True)
    exact, exact_cov = kalman(ys, APART, tied=True, forget_ties=True)
    means, covs = run(factorized("prior"), ys, APART, 200_000, 0, tied=True)
    assert np.sqrt(np.mean((means - exact) ** 2)) < 0.015
    assert np.sqrt(np.mean((means - joint) ** 2)) > 0.06
    np.testing.assert_allclose(covs, exact_cov, atol=0.03)


def test_sub_particles_from_the_prior_find_a_part_that_jumped():
    """A part far beyond the reach of its random walk: found when the prior proposes it, and not otherwise."""
    y = np.zeros((K, D))
    x = np.zeros((400, K, D))
    x[:, 0] = 60.0

    def after(step):
        particles, rng = Particles(x, uniform(400)), np.random.default_rng(0)
        for _ in range(4):
            particles, _ = step(rng, particles, LinearGaussian(y, tied=True))
        return np.einsum("n,nkd->kd", np.exp(particles.log_w), particles.x)

    assert np.abs(after(factorized("prior", from_prior=0.1))).max() < 2
    assert np.abs(after(factorized("prior"))).max() > 20


def test_mixture_transition_is_weighted_rightly():
    """With an observation that says nothing, sub-particles keep the mixture's mean: the weights must all be equal."""
    model = LinearGaussian(np.zeros((K, D)))
    model.log_likelihood = lambda x, parents: np.zeros(x.shape[:2])
    x = np.zeros((20000, K, D))
    x[:, 0] = 10.0
    particles, info = factorized("none", from_prior=0.25)(np.random.default_rng(0), Particles(x, uniform(20000)), model)
    # part 0: three quarters stay at 10, a quarter goes to the others' mean, 0
    assert particles.x[:, 0].mean() == pytest.approx(7.5, abs=0.1)
    np.testing.assert_allclose(info.ess, 20000)


EVERY = [
    sir(), auxiliary(), factorized("prior", from_prior=0.2),
    factorized("none"), factorized("transition"), factorized("none", look_ahead="none"),
]  # fmt: skip


@pytest.mark.parametrize("step", EVERY)
def test_zero_likelihood_everywhere_leaves_the_prediction(step):
    model = LinearGaussian(np.zeros((K, D)), blind=True)
    particles, _ = step(np.random.default_rng(0), Particles(np.full((300, K, D), 7.0), uniform(300)), model)
    assert np.all(np.isfinite(particles.x))
    assert np.all(np.isfinite(particles.log_w))
    assert particles.x.mean() == pytest.approx(7.0, abs=0.3)


@pytest.mark.parametrize("step", EVERY)
def test_one_particle_is_enough_and_parents_stay_as_they_are(step):
    particles = Particles(np.zeros((1, K, D)), uniform(1))
    for _ in range(3):
        particles, info = step(np.random.default_rng(0), particles, LinearGaussian(np.ones((K, D))))
    assert particles.x.shape == (1, K, D)
    np.testing.assert_allclose(info.ess, 1.0)
    before = Particles(np.random.default_rng(0).normal(size=(50, K, D)), uniform(50))
    for array in before:
        array.flags.writeable = False
    step(np.random.default_rng(1), before, LinearGaussian(np.zeros((K, D)), tied=True))
