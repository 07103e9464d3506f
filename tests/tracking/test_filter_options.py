"""What filters offer beyond the papers, against exact posteriors: a Kalman filter, a normal density, plain sums."""

import numpy as np
import pytest

from facetrack_cli.core.types import Particles
from facetrack_cli.engine.resampling import distinct, effective_sample_size, uniform
from facetrack_cli.engine.spaces import estimate
from tests.support.parts import auxiliary, factorized, sir
from tests.tracking.test_filters import APART, FRAMES, K, LinearGaussian, Q, R, kalman, rmse, run, simulate


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    ("step", "most"),
    [
        (sir(), 0.1),
        (auxiliary(), 0.22),
        (factorized("none"), 0.075),
        (factorized("none", look_ahead="none"), 0.035),
        (factorized("none", look_ahead="mean"), 0.06),
        (auxiliary(look_ahead="mean"), 0.2),
    ],
)
def test_every_filter_agrees_with_kalman(step, most):
    assert rmse(step, 3000, covariance=APART, seeds=4) < most


def test_both_ratios_are_the_transition_times_the_prior():
    """Eq. 7 times eq. 11 is the posterior of a model in which the shape prior is a factor of the transition."""
    start = np.eye(K) + 0.7
    ys = simulate(3, start)[:1]
    exact, cov = kalman(ys, start, tied=True)
    runs = [run(factorized("both", look_ahead="none"), ys, start, 1000, seed, tied=True) for seed in range(4)]
    assert np.abs(np.mean([means for means, _ in runs], axis=0) - exact).max() < 0.08
    assert np.abs(np.mean([covs for _, covs in runs], axis=0) - cov).max() < 0.1


# --- spread --------------------------------------------------------------------------------------------------------


def test_particles_of_one_origin_are_one_sample():
    assert distinct(np.array([[0], [0], [1], [1]]), uniform(4)) == pytest.approx(2)
    assert distinct(np.arange(7)[:, None], uniform(7)) == pytest.approx(7)
    log_w = np.log([0.5, 0.25, 0.25])
    assert distinct(np.array([[0, 0], [1, 0], [2, 1]]), log_w) == pytest.approx([1 / 0.375, 1 / 0.625])


def spreads(step, n, noise, parts, seeds):
    """Variances (T,) after each step of a walk seen with this noise, mean squared errors, and the exact variance."""

    class Seen(LinearGaussian):
        def propagate(self, rng, x):
            return x + Q * rng.standard_normal(x.shape)

        def log_likelihood(self, x, parents):
            return -0.5 * np.sum((x - self.y) ** 2, axis=2) / noise**2

    found, plain, wrong = [], [], []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        x, particles = np.zeros((parts, 2)), Particles(np.zeros((n, parts, 2)), uniform(n))
        for t in range(FRAMES):
            x = x + Q * rng.standard_normal(x.shape)
            particles, info = step(rng, particles, Seen(x + noise * rng.standard_normal(x.shape)))
            if t < 5:
                continue  # until the exact variance stays the same
            state, cov, _ = estimate(particles, info.ess)
            found += cov[:, [0, 1], [0, 1]].ravel().tolist()
            plain += estimate(particles, np.full(parts, np.inf)).cov[:, [0, 1], [0, 1]].ravel().tolist()
            wrong += ((state - x) ** 2).ravel().tolist()
    return np.array(found), np.array(plain), np.array(wrong), 0.5 * (np.sqrt(Q**4 + 4 * Q**2 * noise**2) - Q**2)


MARGINALS = pytest.mark.parametrize(
    ("step", "parts"), [(factorized("none", look_ahead="none"), K), (sir(), 1)], ids=["parts", "one"]
)


@MARGINALS
def test_the_spread_is_the_variance_of_the_kalman_filter(step, parts):
    found, _, _, exact = spreads(step, 4000, 0.5, parts, 3)
    assert np.sqrt(np.mean((found / exact - 1) ** 2)) < 0.1


@MARGINALS
def test_the_spread_covers_the_error_however_few_particles_count(step, parts):
    """Four or five of a hundred particles count: uncorrected, the ellipses that should hold 90 % hold two thirds."""
    found, plain, wrong, exact = spreads(step, 100, 0.2, parts, 60 // parts)

    def within(variance):
        return np.mean(np.sum((wrong / np.maximum(variance, 1e-9)).reshape(-1, 2), axis=1) <= 2 * np.log(10))

    assert within(plain) < 0.75
    assert 0.82 < within(found) < 0.95
    assert np.mean(wrong) > 1.5 * exact  # what the particles themselves are off


def test_the_spread_is_that_of_two_samples_where_one_has_nearly_all_the_weight():
    x = np.array([[[0.0, 0.0]], [[2.0, 0.0]]])
    for small in (1e-3, 1e-9):
        log_w = np.log([1 - small, small])
        found = estimate(Particles(x, log_w), effective_sample_size(log_w)[None])
        assert found.cov[0, 0, 0] == pytest.approx(4.0, rel=5e-3)


# --- evidence ------------------------------------------------------------------------------------------------------


def exact_evidence(ys, covariance, *, tied=False):
    """log of the product of N(y_t; m, S) of the Kalman filter, without the likelihood's constant."""
    mean, cov, total = np.zeros((K, 1)), covariance, 0.0
    for y in ys:
        cov = cov + Q**2 * np.eye(K)
        s = cov + R**2 * np.eye(K)
        off = y - mean
        total -= 0.5 * (np.log(np.linalg.det(s / R**2)) + (off.T @ np.linalg.inv(s) @ off).item())
        gain = cov @ np.linalg.inv(s)
        mean, cov = mean + gain @ off, cov - gain @ cov
    return total


@pytest.mark.parametrize(
    "step",
    [
        sir(), auxiliary(), auxiliary(look_ahead="mean"),
        factorized("none"), factorized("none", look_ahead="mean"), factorized("none", look_ahead="none"),
    ],
)  # fmt: skip
def test_the_evidence_is_that_of_the_kalman_filter(step):
    ys = simulate(2, APART)[:8]
    exact, found = exact_evidence(ys, APART), []
    for seed in range(3):
        rng, n = np.random.default_rng(seed), 4000
        x = np.linalg.cholesky(APART) @ rng.standard_normal((n, K, 1))
        particles, total = Particles(x, uniform(n)), 0.0
        for y in ys:
            particles, info = step(rng, particles, LinearGaussian(y))
            total += info.evidence
        found.append(total)
    assert np.mean(found) == pytest.approx(exact, abs=0.35)


def test_the_evidence_counts_the_mean_of_the_prior_by_which_particles_are_reweighted():
    model, before = LinearGaussian(np.full((K, 1), 0.5), tied=True), Particles(np.zeros((300, K, 1)), uniform(300))
    none, prior = (
        factorized(reweight, look_ahead="none")(np.random.default_rng(0), before, model)
        for reweight in ("none", "prior")
    )
    np.testing.assert_array_equal(none[0].x, prior[0].x)
    expected = np.log(np.mean(np.exp(model.log_prior(none[0].x))))
    assert prior[1].evidence - none[1].evidence == pytest.approx(expected)
