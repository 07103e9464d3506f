"""The adaptive appearance model W, S, F: its densities, what it learns, and where its peak lies."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.trackers.appearance import appearance_kernels as kernel
from facetrack_cli.trackers.appearance.affine import Patches
from facetrack_cli.trackers.appearance.appearance import OUTLIER_RANGE, Mixture
from tests.support.parts import appearance, changed, components
from tests.tracking.test_affine import frame, smooth, state, states
from tests.twins import appearance as naive

PATCHES = Patches((40.0, 50.0))
MIXING, SIGMA = components(0.3, 0.3, 0.4), components(0.4, 0.5, 0.6)
MODEL = appearance(PATCHES, 0.1, mixing=MIXING, sigma=SIGMA, least_sigma=0.05)
FIXED = changed(MODEL, mixing=components(0, 0, 1))
TRUTH = state(80, 60)
W, S, F = 0, 1, 2


def mixture(rng, d, off=(), laplace=False, outlier=0.0):
    """Any mixture of d pixels, without the components `off`."""
    m = rng.uniform(0.05, 1, (3, d))
    m[list(off)] = 0
    m /= m.sum(axis=0)
    sigma, mu = rng.uniform(0.1, 1.5, (3, d)), rng.normal(size=(3, d))
    moments = m[1] * np.stack([mu[1], sigma[1] ** 2 + mu[1] ** 2])
    m, mu, sigma = (v.astype(np.float32) for v in (m, mu, sigma))
    return Mixture(m, mu, sigma, moments, TRUTH, laplace, outlier)


def log_densities(learned, y):
    return kernel.log_densities(y, learned.mu, *learned.terms, learned.outlier / OUTLIER_RANGE, learned.laplace)


def taught(learned, y, alpha=0.1, least_sigma=0.05, least_mixing=0.01):
    """The mixture after a patch that is given as it is."""
    m, mu, sigma, moments = kernel.update(
        np.asarray(y, np.float32), learned.m, learned.mu, learned.sigma, learned.moments, *learned.terms,
        learned.outlier / OUTLIER_RANGE, learned.laplace, alpha, least_sigma, least_mixing,
    )  # fmt: skip
    return replace(learned, m=m, mu=mu, sigma=sigma, moments=moments)


KINDS = pytest.mark.parametrize(
    ("off", "laplace", "outlier"),
    [((), False, 0.0), ((), True, 0.0), ((), False, 0.2), ((), True, 0.1), ((W, S), True, 0.0), ((S,), False, 0.3)],
)


@KINDS
@settings(max_examples=6)
@given(st.integers(0, 10**6), st.sampled_from([1, 33, 500]), st.floats(0.5, 3))
def test_densities_equal_the_plain_twin(off, laplace, outlier, seed, d, spread):
    rng = np.random.default_rng(seed)
    learned = mixture(rng, d, off, laplace, outlier)
    # around one of the components: far from all of them the twin's densities would be 0
    y = (learned.mu[F] + spread * rng.normal(size=(3, d)) * learned.sigma[F]).astype(np.float32)
    expected = [naive.log_density(v, learned.m, learned.mu, learned.sigma, laplace, outlier, OUTLIER_RANGE)
                for v in y.astype(np.float64)]  # fmt: skip
    assert log_densities(learned, y) == pytest.approx(expected, rel=1e-5, abs=2e-3)
    assert MODEL.error(learned, y) == pytest.approx(
        [naive.error(v, learned.m, learned.mu, learned.sigma) for v in y.astype(np.float64)], rel=1e-4
    )
    centred = y - y.mean(axis=1, keepdims=True)
    matches = [max(naive.match(v, learned.mu[i].tolist()) for i in (S, F)) for v in centred.astype(np.float64)]
    assert kernel.best_matches(centred, learned.mu[1:]) == pytest.approx(matches, abs=1e-4)


def test_far_from_all_components_the_nearest_one_counts():
    learned = replace(mixture(np.random.default_rng(1), 780), sigma=np.full((3, 780), 0.05, np.float32))
    off = (27 - learned.mu.astype(float)) / 0.05
    logs = np.log(learned.m.astype(float)) - off**2 / 2 - np.log(0.05 * np.sqrt(2 * np.pi))
    log_p = log_densities(learned, np.full((1, 780), 27, np.float32))[0]
    assert log_p == pytest.approx(np.logaddexp.reduce(logs, axis=0).sum(), rel=1e-5)


@KINDS
@settings(max_examples=6)
@given(st.integers(0, 10**6), st.floats(0.01, 0.9), st.sampled_from([0.0, 0.01, 0.2]))
def test_learning_equals_the_plain_twin(off, laplace, outlier, seed, alpha, least_mixing):
    rng, d = np.random.default_rng(seed), 9
    learned = mixture(rng, d, off, laplace, outlier)
    twin = [(learned.m[:, k].astype(float), learned.mu[:, k].astype(float), learned.sigma[:, k].astype(float),
             learned.moments[:, k]) for k in range(d)]  # fmt: skip
    for _ in range(4):
        y = rng.normal(size=d).astype(np.float32)
        y[rng.random(d) < 0.2] = 0
        learned = taught(learned, y, alpha, 0.3, least_mixing)
        twin = [
            naive.update(float(v), *was, laplace, outlier, OUTLIER_RANGE, alpha, 0.3, least_mixing)
            for v, was in zip(y, twin, strict=True)
        ]
    found = learned.m, learned.mu, learned.sigma, learned.moments
    for mine, theirs in zip(found, zip(*twin, strict=True), strict=True):
        np.testing.assert_allclose(mine, np.array(theirs).T, rtol=1e-4, atol=1e-5)


def test_the_moments_at_the_start_give_back_what_they_were_made_of():
    learned = MODEL.init(frame(smooth(1)), TRUTH)
    m, first, second = learned.m[S].astype(float), *learned.moments
    np.testing.assert_allclose(first / m, learned.mu[F], rtol=1e-6)
    np.testing.assert_allclose(second / m - (first / m) ** 2, 0.5**2, rtol=1e-5)
    # as printed, m_s sigma_s^2 + F^2, the variance would be off by F^2 (1 / m_s - 1)
    printed = (m * 0.5**2 + learned.mu[F] ** 2) / m - learned.mu[F] ** 2
    assert np.median(printed / 0.5**2) > 2
    # and after one look at the same face it has hardly moved
    after = MODEL.learn(learned, frame(smooth(1)), TRUTH)
    np.testing.assert_allclose(after.mu[S], learned.mu[F], atol=1e-5)
    assert (after.sigma[S] < 0.5).all()
    assert (after.sigma[S] > 0.4).all()


def test_learning_is_blind_to_what_is_not_seen():
    f = frame(smooth(1))
    learned = MODEL.init(f, state(25, 60))
    # a third of the box leaves the image
    after, seen = MODEL.learn(learned, f, state(8, 60)), PATCHES.read(f, state(8, 60), 1)[0] != 0
    for now, before in ((after.m, learned.m), (after.mu, learned.mu), (after.sigma, learned.sigma)):
        np.testing.assert_array_equal(now[:, ~seen], before[:, ~seen])
    assert (after.mu[W, seen] != learned.mu[W, seen]).mean() > 0.99
    assert MODEL.learn(learned, f, state(-300, 60)) is learned
    assert MODEL.learn(learned, frame(np.full((120, 160), 40)), state(60, 60)) is learned


@pytest.mark.parametrize(
    ("place", "picture"),
    [
        ((-15, 60), smooth(1)), ((900, 60), smooth(1)), ((80, 60), np.full((120, 160), 99)),
    ],
)  # fmt: skip
def test_nothing_to_see_at_the_start_is_one_clear_line(place, picture):
    with pytest.raises(
        InputError, match=r"^frame 0: the face's box is of one grey level, or more than half .* outside"
    ):
        MODEL.init(frame(picture), state(*place))


def test_the_pictures_of_s_and_w_are_grey_levels_around_the_middle():
    learned = MODEL.init(frame(smooth(1)), TRUTH)
    mu = learned.mu.copy()
    mu[S, :6], mu[W, :6] = (0, 1, -1, 2.49, 2.6, -40), (-2.5, -2.6, 40, 0.5, -0.5, 0)
    shown = dict(MODEL.insets(replace(learned, mu=mu)))
    assert shown["stable"].shape == shown["recent"].shape == PATCHES.shape and shown["stable"].dtype == np.uint8
    assert shown["stable"].ravel()[:6].tolist() == [128, 179, 77, 254, 255, 0]
    assert shown["recent"].ravel()[:6].tolist() == [0, 0, 255, 153, 102, 128]
    assert [name for name, _ in FIXED.insets(learned)] == ["first"]
    assert [name for name, _ in changed(MODEL, mixing=components(0.5, 0, 0.5)).insets(learned)] == ["recent"]


@pytest.mark.parametrize(("density", "outlier"), [("gaussian", None), ("gaussian", 0.3), ("laplace", 0.3)])
def test_the_score_is_eq_6_of_the_patches_that_are_read(density, outlier):
    f, x = frame(smooth(1)), states((81, 60), (85, 57, 1.1, 0, 0.1, 0.9))
    model = changed(MODEL, density=density, outlier=outlier)
    learned = model.init(f, TRUTH)
    y = PATCHES.read(f, x, PATCHES.factor(TRUTH)).astype(np.float64)
    expected = [
        naive.log_density(v, learned.m, learned.mu, learned.sigma, density == "laplace", outlier or 0.0, OUTLIER_RANGE)
        for v in y
    ]
    assert model.score(learned, f, x)[:, 0] == pytest.approx(expected, rel=1e-4)
    few = changed(model, pixels=5).score(learned, f, x)[:, 0]
    assert few == pytest.approx(np.array(expected) * 5 / y.shape[1], rel=1e-4)
    mean = sum(learned.m[i].astype(float) * learned.mu[i] for i in (W, S, F))
    np.testing.assert_allclose(model.expected(learned), mean, atol=1e-5)
