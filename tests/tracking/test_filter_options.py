"""What filters offer beyond the papers, against exact posteriors: a Kalman filter, a normal density, plain sums."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.types import Particles
from facetrack_cli.recipe.filters import Kld
from facetrack_cli.recipe.sections import Length
from facetrack_cli.tracking import filters
from facetrack_cli.tracking.filters import Prediction
from facetrack_cli.tracking.models.motion import RandomWalk
from facetrack_cli.tracking.models.spaces import estimate
from facetrack_cli.tracking.resampling import distinct, effective_sample_size, normalise, tempered, uniform
from tests.support.parts import adaptive, auxiliary, factorized, sir
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
        (factorized("none", look_ahead="none", resample_below=0.5), 0.035),
        (factorized("none", look_ahead="none", regularise=1.0), 0.05),
        (factorized("none", look_ahead="none", temper=0.5, moves=1), 0.05),
        (auxiliary(look_ahead="mean"), 0.2),
        (sir(resample_below=0.5), 0.09),
        (sir(regularise=0.5), 0.12),
        (sir(temper=0.3, moves=2), 0.09),
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


# --- tempering -----------------------------------------------------------------------------------------------------


@given(st.integers(0, 10_000), st.integers(2, 60), st.floats(0.01, 100), st.floats(0.05, 0.95))
def test_the_power_keeps_the_share_effective(seed, n, scale, share):
    log_l = scale * np.random.default_rng(seed).normal(size=(n, 2))
    power = tempered(np.zeros((n, 1)), log_l, share)
    ess = effective_sample_size(normalise(power * log_l))
    assert np.all((power > 0) & (power <= 1))
    assert np.all(ess >= share * n * (1 - 1e-9))
    below = power < 1
    # the largest such power
    more = effective_sample_size(normalise(np.minimum(power * 1.001, 1) * log_l))
    assert np.all(more[below] < share * n * (1 + 1e-6) + 1e-9)


def test_a_tempered_step_has_the_posterior_of_the_tempered_likelihood():
    """One step of a normal: prior variance Q^2, and the likelihood's precision times the power."""
    y = np.full((K, 1), 2.0)
    model = LinearGaussian(y)
    n = 200_000
    found, info = factorized("none", look_ahead="none", temper=0.93)(
        np.random.default_rng(0), Particles(np.zeros((n, K, 1)), uniform(n)), model
    )
    x = Q * np.random.default_rng(1).standard_normal((n, K, 1))
    power = tempered(np.zeros((n, 1)), model.log_likelihood(x, x), 0.93)
    assert np.all(power < 1)
    precision = 1 / Q**2 + power / R**2
    np.testing.assert_allclose(found.x.mean(axis=0)[:, 0], (power * 2.0 / R**2) / precision, atol=0.02)
    np.testing.assert_allclose(found.x.var(axis=0)[:, 0], 1 / precision, rtol=0.02)
    assert np.all(info.ess > 0.8 * n)


def test_stages_and_moves_reach_a_narrow_likelihood_that_no_particle_hits():
    """A likelihood a hundred times narrower than the motion: the plain step is left with a particle or two."""
    rng, n = np.random.default_rng(0), 300

    class Narrow(LinearGaussian):
        def log_likelihood(self, x, parents):
            return -0.5 * np.sum((x - self.y) ** 2, axis=2) / 0.01**2

    model, before = Narrow(np.full((K, 1), 1.5)), Particles(np.zeros((n, K, 1)), uniform(n))
    for step in (factorized("none", look_ahead="none", temper=0.5, moves=3), sir(temper=0.5, moves=5)):
        found, info = step(rng, before, model)
        at = estimate(Particles(np.repeat(found.x, 2, axis=2), found.log_w), info.ess)
        np.testing.assert_allclose(at.state[:, 0], 1.5, atol=0.01)
        assert np.all((at.cov[:, 0, 0] > 0.003**2) & (at.cov[:, 0, 0] < 0.02**2))
        assert info.ess.min() > 20
    _, info = factorized("none", look_ahead="none")(rng, before, model)
    assert info.ess.max() < 20


# --- one place, tempered -------------------------------------------------------------------------------------------


class Around(LinearGaussian):
    """The model of `adaptive`, whose particles all come from one place."""

    def __init__(self, y):
        super().__init__(y)
        self.ahead = Prediction(np.zeros((K, 1)), np.full((K, 1), 1.0))

    def propagate(self, rng, x):
        return x + 1.0 + Q * rng.standard_normal(x.shape)

    def expect(self, x):
        return x + 1.0


def test_the_adaptive_filter_with_moves_has_the_exact_posterior():
    y, n = np.full((K, 1), 2.0), 20_000
    settings = adaptive(n, adapt=False, temper=0.5, moves=2)
    found, _ = filters.adaptive(
        settings, np.random.default_rng(0), Particles(np.zeros((1, K, 1)), uniform(1)), Around(y)
    )
    precision = 1 / Q**2 + 1 / R**2
    w = np.exp(found.log_w)
    mean = (w[:, None] * found.x[:, :, 0]).sum(axis=0)
    np.testing.assert_allclose(mean, (1 / Q**2 + 2 / R**2) / precision, atol=0.04)
    np.testing.assert_allclose((w[:, None] * (found.x[:, :, 0] - mean) ** 2).sum(axis=0), 1 / precision, rtol=0.08)


# --- picking -------------------------------------------------------------------------------------------------------


def test_a_kernel_keeps_mean_and_covariance_and_makes_no_two_particles_equal():
    rng = np.random.default_rng(0)
    x = rng.normal(size=(50, 1, 2)) @ np.array([[2.0, 1.0], [0.0, 0.5]])
    chosen = np.sort(rng.integers(0, 50, 20_000))[:, None]
    settings = factorized("none", regularise=1.0).args[0]
    found = filters._regularised(settings, rng, x[chosen[:, 0]], chosen)
    before = x[chosen[:, 0], 0]
    np.testing.assert_allclose(found[:, 0].mean(axis=0), before.mean(axis=0), atol=0.05)
    np.testing.assert_allclose(np.cov(found[:, 0].T), np.cov(before.T), rtol=0.05, atol=0.05)
    assert len(np.unique(found[:, 0, 0])) == 20_000


def test_nothing_is_picked_while_enough_particles_are_effective():
    y, before = np.zeros((K, 1)), Particles(np.arange(40.0)[:, None, None] + np.zeros((40, K, 1)), uniform(40))

    class Still(LinearGaussian):
        def propagate(self, rng, x):
            return x

    found, _ = sir(resample_below=0.9)(np.random.default_rng(0), before, Still(y))
    np.testing.assert_array_equal(found.x, before.x)
    again, _ = sir(resample_below=0.9)(np.random.default_rng(0), found, Still(y))
    assert len(np.unique(again.x[:, 0])) < 40


def test_kld_takes_as_many_particles_as_a_plain_count_asks_for():
    rng, settings = np.random.default_rng(0), Kld(error=0.05, bin=Length(2.0, px=True), least=5)
    for spread in (0.1, 3.0, 8.0, 50.0):
        x = spread * rng.standard_normal((3000, 1, 6))
        bins, enough = set(), 1.0
        for n, (a, b) in enumerate(np.floor(x[:, 0, :2] / 2.0).tolist(), 1):
            bins.add((a, b))
            if (k := len(bins)) > 1:
                part = 2 / (9 * (k - 1))
                enough = (k - 1) / 0.1 * (1 - part + np.sqrt(part) * 2.3263479) ** 3
            if n >= max(enough, 5):
                break
        assert filters.kld_number(settings, x, 2.0) == n
    assert filters.kld_number(settings, np.zeros((50, 1, 2)), 2.0) == 5


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
        sir(), auxiliary(), auxiliary(look_ahead="mean"), sir(resample_below=0.5), sir(temper=0.3, moves=1),
        factorized("none"), factorized("none", look_ahead="mean"), factorized("none", look_ahead="none"),
        factorized("none", look_ahead="none", temper=0.5, moves=1),
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


def test_fewer_particles_serve_a_narrow_prediction():
    settings = sir(kld=Kld(bin=Length(0.5, px=True)))
    n = 5000
    rng = np.random.default_rng(0)
    one = RandomWalk(np.array([0.2]))

    class Walk(LinearGaussian):
        def propagate(self, rng, x):
            return one.propagate(rng, x)

        def log_likelihood(self, x, parents):
            return -0.5 * np.sum((x - 1.0) ** 2, axis=2)

    wide, _ = settings(rng, Particles(10 * rng.standard_normal((n, 1, 2)), uniform(n)), Walk(np.zeros((1, 2))))
    narrow, _ = settings(rng, Particles(np.zeros((n, 1, 2)), uniform(n)), Walk(np.zeros((1, 2))))
    assert len(narrow.x) < 500 < 2000 < len(wide.x) <= n
    assert narrow.log_w.shape == (len(narrow.x),)
