"""The filters, resampling and effective sizes, against a Kalman filter, exact posteriors, and laws at their edges."""

from dataclasses import dataclass

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from facetrack_cli.core.types import Particles
from facetrack_cli.engine.resampling import (
    distinct,
    effective_share,
    logsumexp,
    normalise,
    systematic,
    uniform,
)
from facetrack_cli.engine.spaces import RandomWalk
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
    """Exact means (FRAMES, K, D) and covariances over parts, and the log evidence but for the likelihood's constant.

    `forget_ties` drops cross-covariances of the prediction. That is what eq. 11 does: product of the parts' own
    predictive densities, then the shape prior.
    """
    mean, cov, means, covs, evidence = np.zeros((K, D)), covariance, [], [], 0.0
    for y in ys:
        cov = cov + Q**2 * np.eye(K)
        if forget_ties:
            cov = np.diag(np.diag(cov))
        s, off = cov + R**2 * np.eye(K), y - mean
        evidence -= 0.5 * (np.log(np.linalg.det(s / R**2)) + (off.T @ np.linalg.inv(s) @ off).item())
        information = np.linalg.inv(cov)
        new = np.linalg.inv(information + np.eye(K) / R**2 + (tie_precision() if tied else 0))
        mean, cov = new @ (information @ mean + y / R**2), new
        means.append(mean)
        covs.append(cov)
    return np.array(means), np.array(covs), evidence


def run(step, ys, covariance, n, seed, *, tied=False):
    """As `kalman`, by a filter of n particles."""
    rng, evidence = np.random.default_rng(seed), 0.0
    x = np.einsum("ij,njd->nid", np.linalg.cholesky(covariance), rng.standard_normal((n, K, D)))
    particles, means, covs = Particles(x, uniform(n)), [], []
    for y in ys:
        particles, info = step(rng, particles, LinearGaussian(y, tied))
        assert logsumexp(particles.log_w) == pytest.approx(0, abs=1e-9)
        assert np.all((info.ess >= 1 - 1e-9) & (info.ess <= n * (1 + 1e-9)))
        w = np.exp(particles.log_w)
        means.append(np.einsum("n,nkd->kd", w, particles.x))
        off = particles.x - means[-1]
        covs.append(np.einsum("n,nid,njd->ij", w, off, off) / D)
        evidence += info.evidence
    return np.array(means), np.array(covs), evidence


APART = np.eye(K)
TOGETHER = 0.3 * np.eye(K) + 4.0  # the parts begin strongly correlated
NEAR = [  # step, particles, bound of the root mean squared distance from the Kalman filter's means
    (factorized("none"), 2000, 0.1),
    (auxiliary(), 3000, 0.22),
    (factorized("none", look_ahead="none"), 3000, 0.035),
]


def rmse(step, n, *, covariance=APART, seeds=2, tied=False):
    errors = []
    for seed in range(seeds):
        ys = simulate(seed, covariance)
        exact, _, _ = kalman(ys, covariance, tied=tied)
        errors.append(np.mean((run(step, ys, covariance, n, seed + 1000, tied=tied)[0] - exact) ** 2))
    return float(np.sqrt(np.mean(errors)))


@pytest.mark.parametrize(("step", "n", "most"), NEAR)
def test_every_filter_and_scheme_agrees_with_kalman(step, n, most):
    assert rmse(step, n) < most


def test_filters_over_the_joint_state_take_the_prior_as_an_observation():
    assert rmse(sir(), 5000, tied=True) < 0.06


def test_transition_reweighting_keeps_correlations_that_independent_filters_lose():
    assert rmse(factorized("transition"), 400, covariance=TOGETHER, seeds=1) < 0.3
    ys = simulate(5, TOGETHER)[:1]
    exact, exact_cov, _ = kalman(ys, TOGETHER)
    means, covs, _ = run(factorized("transition"), ys, TOGETHER, 1000, 1)
    assert np.abs(means - exact).max() < 0.25
    assert np.abs(covs - exact_cov).max() < 0.2
    _, alone, _ = run(factorized("none"), ys, TOGETHER, 1500, 1)
    assert abs(alone[-1][0, 1]) < 0.1 < exact_cov[-1][0, 1]


def test_prior_reweighting_is_the_product_of_marginals_and_prior():
    """Eq. 11 against its exact value; and it is not the same as the joint posterior with that prior."""
    ys = simulate(3, APART)[:8]
    joint, _, _ = kalman(ys, APART, tied=True)
    exact, exact_cov, _ = kalman(ys, APART, tied=True, forget_ties=True)
    means, covs, _ = run(factorized("prior"), ys, APART, 60_000, 0, tied=True)
    assert np.sqrt(np.mean((means - exact) ** 2)) < 0.025
    assert np.sqrt(np.mean((means - joint) ** 2)) > 0.06
    np.testing.assert_allclose(covs, exact_cov, atol=0.04)


@pytest.mark.parametrize(
    "step",
    [
        sir(), auxiliary(), factorized("none"), factorized("none", look_ahead="none"),
    ],
)  # fmt: skip
def test_the_evidence_is_that_of_the_kalman_filter(step):
    ys = simulate(2, APART)[:8]
    found = [run(step, ys, APART, 3000, seed)[2] for seed in range(2)]
    assert np.mean(found) == pytest.approx(kalman(ys, APART)[2], abs=0.35)


def test_the_evidence_counts_the_mean_of_the_prior_by_which_particles_are_reweighted():
    model, before = LinearGaussian(np.full((K, 1), 0.5), tied=True), Particles(np.zeros((300, K, 1)), uniform(300))
    none, prior = (
        factorized(reweight, look_ahead="none")(np.random.default_rng(0), before, model)
        for reweight in ("none", "prior")
    )
    np.testing.assert_array_equal(none[0].x, prior[0].x)
    expected = np.log(np.mean(np.exp(model.log_prior(none[0].x))))
    assert prior[1].evidence - none[1].evidence == pytest.approx(expected)


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
def test_zero_likelihood_leaves_the_prediction_one_particle_is_enough_and_parents_stay_as_they_are(step):
    model = LinearGaussian(np.zeros((K, D)), blind=True)
    particles, _ = step(np.random.default_rng(0), Particles(np.full((300, K, D), 7.0), uniform(300)), model)
    assert np.isfinite(particles.log_w).all() and particles.x.mean() == pytest.approx(7.0, abs=0.3)
    particles = Particles(np.zeros((1, K, D)), uniform(1))
    for _ in range(3):
        particles, info = step(np.random.default_rng(0), particles, LinearGaussian(np.ones((K, D))))
    assert particles.x.shape == (1, K, D)
    np.testing.assert_allclose(info.ess, 1.0)
    before = Particles(np.random.default_rng(0).normal(size=(50, K, D)), uniform(50))
    for array in before:
        array.flags.writeable = False
    step(np.random.default_rng(1), before, LinearGaussian(np.zeros((K, D)), tied=True))


class Family:
    """Every state is (its own number, that of the state it was moved from); only true parents are taken."""

    def __init__(self):
        self.born, self.asked = 0, 0

    def propagate(self, rng, x):
        own = self.born + np.arange(1, x[..., 0].size + 1, dtype=float).reshape(x.shape[:2])
        self.born += own.size
        return np.stack([own, x[..., 0]], axis=2)

    def log_likelihood(self, x, parents):
        np.testing.assert_array_equal(x[..., 1], parents[..., 0])
        self.asked += 1
        return -0.1 * (x[..., 0] % 7)

    def log_prior(self, x):
        return np.zeros(len(x))


@pytest.mark.parametrize(("step", "looks"), [(sir(), 1), (auxiliary(), 2), (factorized("none"), 2)])
def test_filters_score_each_state_beside_the_one_it_was_moved_from(step, looks):
    """Its likelihood may depend on both (Odobez et al. 2003, eq. 9), in the first stage of a filter too."""
    family, rng = Family(), np.random.default_rng(7)
    for parts in (1, 2):
        particles = Particles(family.propagate(rng, np.zeros((40, parts, 2))), uniform(40))
        for _ in range(3):
            family.asked = 0
            particles, _ = step(rng, particles, family)
            assert family.asked == looks


# --- spread --------------------------------------------------------------------------------------------------------


def test_particles_of_one_origin_are_one_sample():
    assert distinct(np.array([[0], [0], [1], [1]]), uniform(4)) == pytest.approx(2)
    assert distinct(np.arange(7)[:, None], uniform(7)) == pytest.approx(7)
    log_w = np.log([0.5, 0.25, 0.25])
    assert distinct(np.array([[0, 0], [1, 0], [2, 1]]), log_w) == pytest.approx([1 / 0.375, 1 / 0.625])


# --- resampling ----------------------------------------------------------------------------------------------------


class Extreme(np.random.Generator):
    """A generator whose every uniform is the largest below 1, or 0: where searches run off the end."""

    def __init__(self, u):
        super().__init__(np.random.PCG64(0))
        self.u = u

    def random(self, size=None):
        return self.u if size is None else np.full(size, self.u)


@pytest.mark.parametrize("u", [0.0, np.nextafter(1.0, 0.0), None])
@given(log_w=hnp.arrays(float, st.integers(1, 40), elements=st.floats(-700, 50)), m=st.integers(1, 60))
def test_indices_ascend_and_are_of_particles_that_have_weight(u, log_w, m):
    log_w = normalise(np.where(np.arange(len(log_w)) % 3 == 1, -np.inf, log_w))
    chosen = systematic(np.random.default_rng(m) if u is None else Extreme(u), log_w, m)
    assert chosen.shape == (m,) and chosen.dtype == np.int64
    assert chosen.min() >= 0 and chosen.max() < len(log_w) and np.all(np.diff(chosen) >= 0)
    assert np.isfinite(log_w[chosen]).all()
    assert np.all(np.abs(np.bincount(chosen, minlength=len(log_w)) - m * np.exp(log_w)) < 1 + 1e-9)


def test_logsumexp_along_an_axis():
    a = np.random.default_rng(0).normal(size=(4, 5)) * 300
    expected = [np.logaddexp.reduce(row) for row in a]
    np.testing.assert_allclose(logsumexp(a, axis=1), expected)
    with np.errstate(invalid="raise"):
        assert logsumexp(np.full(3, -np.inf)) == -np.inf


def test_populations_side_by_side_are_each_resampled_by_their_own_weights():
    log_w = np.full((6, 3), -np.inf)
    log_w[[1, 4, 0], [0, 1, 2]] = 0.0
    np.testing.assert_array_equal(systematic(np.random.default_rng(0), log_w, 8), [[1, 4, 0]] * 8)


@pytest.mark.parametrize("bad", [[-np.inf] * 2, [np.nan, 1.0], [np.inf, 0.0]])
def test_weights_that_say_nothing_become_equal_and_do_not_touch_their_neighbours(bad):
    log_w = normalise(np.array([[0.0, bad[0]], [np.log(3.0), bad[1]]]))
    np.testing.assert_allclose(np.exp(log_w), [[0.25, 0.5], [0.75, 0.5]])


# --- how many terms of a sum are independent


@pytest.mark.parametrize("sigma", [0.0, 0.8, 2.5])
def test_the_share_is_the_variance_of_a_sum(sigma):
    """n_e = n^2 var / var(sum), which many fields tell exactly, and one of them to a half or so."""
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((150, 80, 80))
    fields = np.array([cv2.GaussianBlur(one, (0, 0), sigma) if sigma else one for one in noise])[:, 20:60, 20:60]
    n = fields[0].size
    exact = n * fields.var() / fields.sum(axis=(1, 2)).var()
    found = np.median([effective_share(one) for one in fields])
    assert found == pytest.approx(exact, rel=0.5)


def test_the_share_of_a_ring_goes_round():
    angle = np.arange(64) * (2 * np.pi / 64)
    rng = np.random.default_rng(1)
    slow = sum(rng.normal() * np.cos(k * angle) + rng.normal() * np.sin(k * angle) for k in range(1, 4))
    assert effective_share(slow, ring=True) == effective_share(np.roll(slow, 17), ring=True)
    assert 1 / 64 <= effective_share(slow, ring=True) < 0.3 < effective_share(rng.normal(size=64), ring=True) <= 1


@pytest.mark.parametrize("terms", [np.zeros((5, 5)), np.full(9, 3.5), np.ones((1, 2)), np.array([1.0])])
def test_what_says_nothing_counts_in_full(terms):
    assert effective_share(terms) == 1.0
