"""A face under affine maps: patches, box, walk, the filter around a predicted place, and the mixture W, S, F."""

import math
from dataclasses import replace
from functools import partial
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import corners
from facetrack_cli.core.types import MAX_REMEMBERED
from facetrack_cli.engine import filters
from facetrack_cli.engine.protocols import Prediction
from facetrack_cli.engine.spaces import evenly
from facetrack_cli.engine.target import ParticleTarget
from facetrack_cli.trackers.appearance import appearance_kernels as kernel
from facetrack_cli.trackers.appearance.appearance import OUTLIER_RANGE, AffineSpace, Appearance, Mixture, Patches, eta
from facetrack_cli.trackers.appearance.settings import NoiseSettings, VelocitySettings
from facetrack_cli.trajectory.diagnostics import ENTROPY, POSTERIOR
from tests.support.images import grey as frame
from tests.support.images import smooth
from tests.support.parts import adaptive, affine_walk, appearance, changed, components, predicted
from tests.support.results import parts_of
from tests.twins import appearance as twin
from tests.twins import guide as naive

SIZE, SHAPE = (26.0, 30.0), (30, 26)


def state(cx, cy, a1=1.0, a2=0.0, a3=0.0, a4=1.0):
    return np.array([[cx, cy, a1, a2, a3, a4]], np.float64)


def states(*rows):
    return np.stack([state(*row) for row in rows])


# --- patches -------------------------------------------------------------------------------------------------------


@given(
    st.integers(0, 10**6), st.sampled_from([1, 2, 4, 8]), st.tuples(st.integers(1, 40), st.integers(1, 40)),
    st.tuples(st.integers(1, 9), st.integers(1, 9)), st.sampled_from([0.02, 0.3, 1.0, 4.0]),
)  # fmt: skip
def test_patches_equal_the_plain_twin(seed, factor, picture, shape, spread):
    rng = np.random.default_rng(seed)
    width, height = picture
    grey = rng.integers(0, 256, (height, width))
    x = np.concatenate([rng.uniform(-0.3, 1.3, (6, 2)) * picture, rng.normal(scale=spread, size=(6, 4))], axis=1)
    x[:3, 2:] += (1, 0, 0, 1)
    size = tuple(rng.uniform(1, 30, 2).tolist())
    found = Patches(size, shape).read(frame(grey), x[:, None], factor)
    reduced, left, top = frame(grey).grey(factor, (0.0, 0.0, width, height))
    assert (left, top) == (0, 0)
    for y, row in zip(found, x, strict=True):
        expected = twin.patch(reduced, (0, 0, width, height), factor, row, size, shape)
        np.testing.assert_allclose(y, expected, atol=2e-3)


def test_factor_keeps_points_one_to_two_pixels_apart():
    patches = Patches((52.0, 60.0))
    for scale in np.geomspace(0.1, 60, 50):
        a = scale * np.array([np.cos(0.3), -np.sin(0.3), np.sin(0.3), np.cos(0.3)])
        step = 2.0 * scale / patches.factor(state(0, 0, *a))
        assert step <= 2.0 + 1e-9
        assert step > 1.0 or patches.factor(state(0, 0, *a)) == 1
    # the side where points are closer decides; a column is a step of 8 pixels by (a1, a3), a row one by (a2, a4)
    sheared = Patches((8.0 * 26, 8.0 * 30))
    for a, factor in ((1, 0, 0, 1), 4), ((0.2, 5, 0.2, 5), 2), ((5, 0.2, 5, 0.2), 2), ((5, 5, 0.2, 0.2), 32):
        assert sheared.factor(state(0, 0, *a)) == factor


def test_the_frame_remembers_the_last_patches():
    f, patches, x = frame(smooth(9)), Patches(SIZE), states((70, 60), (71, 60))
    first = patches.read(f, x, 1)
    assert patches.read(f, x, 1) is first is Patches(SIZE, SHAPE).read(f, x, 1)
    assert not any(one is first for one in (patches.read(f, x, 2), Patches((26.0, 31.0)).read(f, x, 1)))
    # a single state is asked for again and again, each time in another array
    assert patches.read(f, states((70, 60)), 1) is patches.read(f, state(70, 60), 1)
    # arrays that are gone give their id to others: each must be read again
    for k in range(3 * MAX_REMEMBERED):
        y = patches.read(f, states((70 + k, 60), (60, 50)), 1)
        np.testing.assert_array_equal(y, patches.read(frame(smooth(9)), states((70 + k, 60), (60, 50)), 1))
    assert len(f._patches) <= MAX_REMEMBERED


# --- in the image --------------------------------------------------------------------------------------------------

SPACE = AffineSpace((41.0, 61.0))
NUMBER = st.floats(-3, 3)
STATES = st.tuples(st.floats(-500, 500), st.floats(-500, 500), NUMBER, NUMBER, NUMBER, NUMBER)


@given(STATES)
def test_the_angle_is_the_nearest_rotation_and_corners_are_those_of_rows_in_a_file(state):
    estimated = evenly(np.array([state], np.float64), np.zeros((1, 2)))
    windows, (angle, places) = SPACE.windows(estimated)[0], SPACE.outline(estimated)
    a, affine = np.reshape(state[2:], (2, 2)), np.array([state[2:] + state[:2]])
    expected = corners(affine, np.array([state[:2]]), windows[None])[0]
    np.testing.assert_allclose(places, np.where(np.isnan(expected), places, expected), atol=1e-9)
    np.testing.assert_allclose(windows, np.linalg.norm(a, axis=0) * SPACE.size, atol=1e-9)

    def off(degrees):
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        return np.linalg.norm(a - [[c, -s], [s, c]])

    assert off(angle) <= min(off(angle + more) for more in (-90, -7, 0.5, 30, 180)) + 1e-9


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
    for ahead, by, size in ((None, np.zeros((1, 6)), 1.0), (Prediction(x[0], shift, noise), shift, noise)):
        expected = [naive.diffused(state, row[0], sigma, by[0], size, *bounds) for row in u]
        moved = replace(walk, ahead=ahead).propagate(np.random.default_rng(seed), x)[:, 0]
        np.testing.assert_allclose(moved, expected, atol=1e-9, rtol=1e-9)


# --- the filter: eq. 17, and one step ------------------------------------------------------------------------------

STATE, SHIFT = np.array([[10.0, 20.0, 1.0, 0.1, -0.1, 0.9]]), np.array([[3.0, -2.0, 0.05, 0.0, 0.0, 0.05]])


def ahead(noise=1.0, fell=None):
    return Prediction(STATE, SHIFT, noise, None, fell)


@pytest.mark.parametrize(
    ("noise", "fell", "number"),
    [
        (1.0, None, 100), (0.5, None, 50), (2.0, None, 200),  # nobody is recognised: J_0 eta
        (1.0, True, 80), (1.0, False, 120),  # d = 0.2: less while the entropy falls, more when it rose
        (0.5, True, 30), (2.0, False, 220), (0.774, True, 57), (0.776, False, 98), (0.1, True, 10),
    ],
)  # fmt: skip
def test_the_number_of_particles(noise, fell, number):
    there = ahead(noise, fell)
    assert filters.number(adaptive(100, entropy=0.2), there) == number
    assert filters.number(adaptive(100, entropy=0.2, least=60), there) == max(number, 60)
    assert filters.number(adaptive(100, entropy=0.0), there) == round(100 * noise)
    assert filters.number(adaptive(100, adapt=False, entropy=0.2), there) == 100


# --- in the loop over frames ---------------------------------------------------------------------------------------

ENTROPIES = (1.0, 1.2, 0.7, 0.7, 0.9, 0.1)  # after each frame
POSTERIORS = ((0.5, 0.5), (0.5, 0.5), (0.2, 0.8), (0.9, 0.1), (0.5, 0.5), (1.0, 0.0))


class Watching(Appearance):
    """The appearance, which says that somebody is recognised with these entropies; `outlier` counts frames here."""

    diagnostics: ClassVar = (POSTERIOR, ENTROPY)

    def learn(self, learned, frame, state, particles):
        return replace(super().learn(learned, frame, state, particles), outlier=learned.outlier + 1e-6)

    def diagnose(self, learned):
        frames = round(learned.outlier * 1e6)
        return {"posterior": dict(zip("ab", POSTERIORS[frames], strict=True)), "entropy": ENTROPIES[frames]}


BOX = (50.0, 56.0)
WALK = affine_walk(2.0, 0.02)
PICTURE, JUMP = smooth(5, 180, 240, 6.0), (3, -2)
PLAIN = appearance(Patches(BOX))


def target(**settings):
    made = ParticleTarget(
        name="face", parts=("box",), space=AffineSpace(BOX), x0=state(110, 95), particles=100,
        motion=predicted(WALK, PLAIN.patches, VelocitySettings()), likelihood=Watching(PLAIN.settings, PLAIN.patches),
        prior=None, step=partial(filters.adaptive, adaptive(100, entropy=0.2)), confidence=None,
    )  # fmt: skip
    return replace(made, **settings)


def followed(made, frames=6):
    """The states after each frame, and the results, of an image that moves by JUMP a frame."""
    rng = np.random.default_rng(0)
    images = [frame(np.roll(PICTURE, (t * JUMP[1], t * JUMP[0]), axis=(0, 1))) for t in range(frames)]
    steps = [made.begin(rng, images[0])]
    for image in images[1:]:
        steps.append(made.advance(rng, steps[-1][0], image))
    return list(zip(*steps, strict=True))


def reported(result):
    """The diagnostics of the one frame of a result."""
    ((name, found),) = result.rows.diagnostics.items()
    assert (name, found.frame.tolist()) == ("face", result.rows.frame.tolist())
    (record,) = found.records()
    return record


def test_the_number_and_the_name_follow_the_posterior():
    steps, results = followed(target())
    assert [after.ahead.entropy_fell for after in steps[1:]] == [True, False, True, True, False]
    # at the start and where it stays the same the entropy did not rise
    assert [parts_of(result)[0].particles for result in results] == [100, 80, 120, 80, 80, 120]
    # a name is said where one is likelier than all others
    assert [parts_of(result)[0].identity for result in results] == ["", "", "b", "a", "", "a"]
    assert [parts_of(result)[0].identity_prob for result in results] == [None, None, 0.8, 0.9, None, 1.0]
    assert [reported(result)["entropy"] for result in results] == list(ENTROPIES)
    assert [tuple(reported(result)["posterior"].values()) for result in results] == list(POSTERIORS)
    unknown = followed(target(likelihood=PLAIN))[0]
    assert {after.ahead.entropy_fell for after in unknown[1:]} == {None}


@pytest.mark.parametrize("best", [False, True])
def test_what_is_predicted_is_where_the_picture_went(best):
    noise = NoiseSettings(rate=4.0)
    walk = predicted(WALK, PLAIN.patches, VelocitySettings(), noise)
    step = partial(filters.adaptive, adaptive(100, centre=True))
    steps, results = followed(target(best=best, motion=walk, step=step))
    for before, after, result in zip(steps, steps[1:], results[1:], strict=False):
        np.testing.assert_array_equal(after.ahead.state, before.estimated.state)
        np.testing.assert_array_equal(after.flow.state, after.estimated.state)
        x, log_w = after.particles
        expected = x[np.argmax(log_w)] if best else np.einsum("n,nkd->kd", np.exp(log_w), x)
        np.testing.assert_allclose(after.estimated.state, expected)
        np.testing.assert_allclose(after.ahead.shift[0, :2], JUMP, atol=0.5)
        # particles lie around the predicted place, with as much noise as is said
        off = after.particles.x[:, 0] - (after.ahead.state + after.ahead.shift)
        assert not off[0].any() and off[1:].all(), "the first particle is the place itself"
        assert np.abs(off[:, :2].mean(axis=0)).max() < 4 * 2.0 * after.ahead.noise / math.sqrt(len(off))
        assert off[:, :2].std() == pytest.approx(2.0 * after.ahead.noise, rel=0.35)
        said = reported(result)
        assert (said["error"], said["noise"]) == (after.ahead.error, eta(noise, after.ahead.error))
        cx, cy, *a = after.estimated.state[0]
        assert said["affine"] == [*a, cx, cy] and said["scale"] == pytest.approx(math.sqrt(np.square(a).sum() / 2))
    middle = steps[-1].estimated.state[0, :2]
    assert np.hypot(*(middle - (110, 95) - 5 * np.array(JUMP))) < 1.5
    assert not {"error", "noise"} & reported(results[0]).keys()


# --- the mixture: densities, and what it learns ---------------------------------------------------------------------

PATCHES = Patches((40.0, 50.0))
MIXING, SIGMA = components(0.3, 0.3, 0.4), components(0.4, 0.5, 0.6)
MODEL = appearance(PATCHES, 0.1, mixing=MIXING, sigma=SIGMA, least_sigma=0.05)
TRUTH = state(80, 60)
W, S, F = 0, 1, 2


def read_only(values):
    """As patches are, so that no kernel is compiled for others."""
    values.flags.writeable = False
    return values


def mixture(rng, d, off=(), laplace=False, outlier=0.0):
    """Any mixture of d pixels, without the components `off`."""
    m = rng.uniform(0.05, 1, (3, d))
    m[list(off)] = 0
    m /= m.sum(axis=0)
    sigma, mu = rng.uniform(0.1, 1.5, (3, d)), rng.normal(size=(3, d))
    moments = m[1] * np.stack([mu[1], sigma[1] ** 2 + mu[1] ** 2])
    m, mu, sigma = (v.astype(np.float32) for v in (m, mu, sigma))
    return Mixture(m, mu, sigma, moments, TRUTH, laplace, outlier)


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
    y = read_only((learned.mu[F] + spread * rng.normal(size=(3, d)) * learned.sigma[F]).astype(np.float32))
    expected = [twin.log_density(v, learned.m, learned.mu, learned.sigma, laplace, outlier, OUTLIER_RANGE)
                for v in y.astype(np.float64)]  # fmt: skip
    found = kernel.log_densities(y, learned.mu, *learned.terms, outlier / OUTLIER_RANGE, laplace)
    assert found == pytest.approx(expected, rel=1e-5, abs=2e-3)
    assert MODEL.error(learned, y) == pytest.approx(
        [twin.error(v, learned.m, learned.mu, learned.sigma) for v in y.astype(np.float64)], rel=1e-4
    )
    centred = read_only(y - y.mean(axis=1, keepdims=True))
    matches = [max(twin.match(v, learned.mu[i].tolist()) for i in (S, F)) for v in centred.astype(np.float64)]
    assert kernel.best_matches(centred, learned.mu[1:]) == pytest.approx(matches, abs=1e-4)


@KINDS
@settings(max_examples=6)
@given(st.integers(0, 10**6), st.floats(0.01, 0.9), st.sampled_from([0.0, 0.01, 0.2]))
def test_learning_equals_the_plain_twin(off, laplace, outlier, seed, alpha, least_mixing):
    rng, d = np.random.default_rng(seed), 9
    learned = mixture(rng, d, off, laplace, outlier)
    slow = [(learned.m[:, k].astype(float), learned.mu[:, k].astype(float), learned.sigma[:, k].astype(float),
             learned.moments[:, k]) for k in range(d)]  # fmt: skip
    for _ in range(4):
        y = rng.normal(size=d).astype(np.float32)
        y[rng.random(d) < 0.2] = 0
        m, mu, sigma, moments = kernel.update(
            read_only(y), learned.m, learned.mu, learned.sigma, learned.moments, *learned.terms,
            outlier / OUTLIER_RANGE, laplace, alpha, 0.3, least_mixing,
        )  # fmt: skip
        learned = replace(learned, m=m, mu=mu, sigma=sigma, moments=moments)
        slow = [
            twin.update(float(v), *was, laplace, outlier, OUTLIER_RANGE, alpha, 0.3, least_mixing)
            for v, was in zip(y, slow, strict=True)
        ]
    found = learned.m, learned.mu, learned.sigma, learned.moments
    for mine, theirs in zip(found, zip(*slow, strict=True), strict=True):
        np.testing.assert_allclose(mine, np.array(theirs).T, rtol=1e-4, atol=1e-5)


def test_the_moments_at_the_start_give_back_what_they_were_made_of():
    learned = MODEL.init(frame(smooth(1)), TRUTH)
    m, first, second = learned.m[S].astype(float), *learned.moments
    np.testing.assert_allclose(first / m, learned.mu[F], rtol=1e-6)
    np.testing.assert_allclose(second / m - (first / m) ** 2, 0.5**2, rtol=1e-5)
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


@pytest.mark.parametrize(("density", "outlier"), [("gaussian", None), ("gaussian", 0.3), ("laplace", 0.3)])
def test_the_score_is_eq_6_of_the_patches_that_are_read(density, outlier):
    f, x = frame(smooth(1)), states((81, 60), (85, 57, 1.1, 0, 0.1, 0.9))
    model = changed(MODEL, density=density, outlier=outlier)
    learned = model.init(f, TRUTH)
    y = PATCHES.read(f, x, PATCHES.factor(TRUTH)).astype(np.float64)
    expected = [
        twin.log_density(v, learned.m, learned.mu, learned.sigma, density == "laplace", outlier or 0.0, OUTLIER_RANGE)
        for v in y
    ]
    assert model.score(learned, f, x)[:, 0] == pytest.approx(expected, rel=1e-4)
    few = changed(model, pixels=5).score(learned, f, x)[:, 0]
    assert few == pytest.approx(np.array(expected) * 5 / y.shape[1], rel=1e-4)
    mean = sum(learned.m[i].astype(float) * learned.mu[i] for i in (W, S, F))
    np.testing.assert_allclose(model.expected(learned), mean, atol=1e-5)
