"""The adaptive filter: its number of particles (eq. 17), and its posterior against the exact one."""

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.types import Particles
from facetrack_cli.engine.filters import Prediction
from facetrack_cli.engine.protocols import Likelihood
from facetrack_cli.engine.resampling import uniform
from facetrack_cli.engine.spaces import estimate
from facetrack_cli.engine.target import Bound, ParticleTarget
from facetrack_cli.trackers.appearance import velocity as filters
from facetrack_cli.trackers.appearance.settings import NoiseSettings, VelocitySettings
from facetrack_cli.trackers.appearance.space import AffineSpace, Patches
from facetrack_cli.trackers.appearance.velocity import eta
from facetrack_cli.trajectory.diagnostics import ENTROPY, POSTERIOR
from tests.support.parts import adaptive, affine_walk, appearance, predicted
from tests.support.results import parts_of
from tests.tracking.test_patches import frame, smooth, state

STATE, SHIFT = np.array([[10.0, 20.0, 1.0, 0.1, -0.1, 0.9]]), np.array([[3.0, -2.0, 0.05, 0.0, 0.0, 0.05]])
SPREAD = np.array([2.0, 2.0, 0.05, 0.05, 0.05, 0.05])


def ahead(noise=1.0, fell=None):
    return Prediction(STATE, SHIFT, noise, None, fell)


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
    there = ahead(noise, fell)
    assert filters.number(adaptive(100, entropy=0.2), there) == number
    assert filters.number(adaptive(300, entropy=0.2), there) == pytest.approx(3 * number, abs=2)
    assert filters.number(adaptive(100, entropy=0.0), there) == round(100 * noise)
    assert filters.number(adaptive(100, adapt=False, entropy=0.2), there) == 100


@given(st.floats(0, 3), st.sampled_from([None, True, False]), st.integers(1, 500), st.floats(0, 2), st.integers(1, 60))
def test_it_is_never_below_the_least(noise, fell, particles, entropy, least):
    number = filters.number(adaptive(particles, entropy=entropy, least=least), ahead(noise, fell))
    change = {None: 0, True: -entropy, False: entropy}[fell]
    assert number >= least
    assert number == least or abs(number - particles * (noise + change)) <= 0.5 + 1e-6


# --- the step ------------------------------------------------------------------------------------------------------


@dataclass
class Gaussian:
    """The state is seen at y with the standard deviations `sigma`; moves by SPREAD around the place ahead."""

    y: np.ndarray
    sigma: np.ndarray
    ahead: Prediction
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
    return filters.adaptive(adaptive(number, **settings), np.random.default_rng(seed), before, model)


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
        found = np.array([estimate(particles, info.ess).state for particles, info in runs])
        off.append(float(np.sqrt(np.mean(((found - mean) / spread) ** 2))))
    assert off[2] < 0.02, off
    # a sixteenth of the variance each time, so a quarter of the error
    assert off[0] > 2.5 * off[1] > 6 * off[2], off
    x, log_w = runs[0][0]
    cov = estimate(runs[0][0], runs[0][1].ess).cov[0]
    np.testing.assert_allclose(np.sqrt(np.diag(cov)), spread[:2], rtol=0.03)
    assert np.exp(log_w).sum() == pytest.approx(1)
    assert runs[0][1].ess == pytest.approx(1 / np.sum(np.exp(log_w) ** 2)) and len(x) == 128_000


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


# --- in the loop over frames ---------------------------------------------------------------------------------------

ENTROPIES = (1.0, 1.2, 0.7, 0.7, 0.9, 0.1)  # after each frame
POSTERIORS = ((0.5, 0.5), (0.5, 0.5), (0.2, 0.8), (0.9, 0.1), (0.5, 0.5), (1.0, 0.0))


@dataclass(frozen=True)
class Watching(Likelihood):
    """The appearance, which says that somebody is recognised with these entropies."""

    appearance: object
    diagnostics: ClassVar = (POSTERIOR, ENTROPY)

    def init(self, frame, x0):
        return self.appearance.init(frame, x0), 0

    def score(self, learned, frame, x, parents):
        return self.appearance.score(learned[0], frame, x, parents)

    def learn(self, learned, frame, state, particles):
        return self.appearance.learn(learned[0], frame, state, particles), learned[1] + 1

    def error(self, learned, patches):
        return self.appearance.error(learned[0], patches)

    def expected(self, learned):
        return self.appearance.expected(learned[0])

    def distances(self, learned, frame, x):
        return self.appearance.distances(learned[0], frame, x)

    def insets(self, learned):
        return self.appearance.insets(learned[0])

    def diagnose(self, learned):
        return {"posterior": dict(zip("ab", POSTERIORS[learned[1]], strict=True)), "entropy": ENTROPIES[learned[1]]}


BOX = (50.0, 56.0)
WALK = affine_walk(2.0, 0.02)
PICTURE, JUMP = smooth(5, 180, 240, 6.0), (3, -2)


def target(**settings):
    patches = Patches(BOX)
    made = ParticleTarget(
        name="face", parts=("box",), space=AffineSpace(BOX), x0=state(110, 95), particles=100,
        motion=predicted(WALK, patches, VelocitySettings()), likelihood=Watching(appearance(patches)), prior=None,
        step=partial(filters.adaptive, adaptive(100, entropy=0.2)), confidence=None,
    )  # fmt: skip
    return replace(made, **settings)


def followed(made, frames=6):
    """The states after each frame, and the results, of an image that moves by JUMP a frame."""
    rng, shown = np.random.default_rng(0), [
        frame(np.roll(PICTURE, (t * JUMP[1], t * JUMP[0]), axis=(0, 1))) for t in range(frames)
    ]  # fmt: skip
    states = [made.begin(rng, shown[0])]
    for one in shown[1:]:
        states.append(made.advance(rng, states[-1][0], one))
    return list(zip(*states, strict=True))


def reported(result):
    """The diagnostics of the one frame of a result."""
    ((name, found),) = result.rows.diagnostics.items()
    assert (name, found.frame.tolist()) == ("face", result.rows.frame.tolist())
    (record,) = found.records()
    return record


def test_the_number_follows_the_entropy_of_the_last_frame_and_the_one_before():
    states, results = followed(target())
    assert [one.ahead.entropy_fell for one in states[1:]] == [True, False, True, True, False]
    # at the start and where it stays the same it did not rise
    assert [parts_of(one)[0].particles for one in results] == [100, 80, 120, 80, 80, 120]
    unknown = followed(target(likelihood=target().likelihood.appearance))[0]
    assert {one.ahead.entropy_fell for one in unknown[1:]} == {None}


def test_who_it_is_is_said_where_one_is_likelier_than_all_others():
    results = followed(target())[1]
    assert [parts_of(one)[0].identity for one in results] == ["", "", "b", "a", "", "a"]
    assert [parts_of(one)[0].identity_prob for one in results] == [None, None, 0.8, 0.9, None, 1.0]
    assert [reported(one)["entropy"] for one in results] == list(ENTROPIES)
    assert [tuple(reported(one)["posterior"].values()) for one in results] == list(POSTERIORS)
    assert all([name for name, _ in one.insets] == ["stable", "recent"] for one in results)


@pytest.mark.parametrize("best", [False, True])
def test_what_is_predicted_is_where_the_picture_went(best):
    noise = NoiseSettings(rate=4.0)
    states, results = followed(target(best=best, motion=predicted(WALK, Patches(BOX), VelocitySettings(), noise)))
    for before, after, result in zip(states, states[1:], results[1:], strict=False):
        np.testing.assert_array_equal(after.ahead.state, before.estimated.state)
        np.testing.assert_array_equal(after.flow.state, after.estimated.state)
        x, log_w = after.particles
        expected = x[np.argmax(log_w)] if best else np.einsum("n,nkd->kd", np.exp(log_w), x)
        np.testing.assert_allclose(after.estimated.state, expected)
        np.testing.assert_allclose(after.ahead.shift[0, :2], JUMP, atol=0.5)
        # particles lie around the predicted place, with as much noise as is said
        off = after.particles.x[:, 0] - (after.ahead.state + after.ahead.shift)
        assert np.abs(off[:, :2].mean(axis=0)).max() < 4 * 2.0 * after.ahead.noise / math.sqrt(len(off))
        assert off[:, :2].std() == pytest.approx(2.0 * after.ahead.noise, rel=0.35)
        said = reported(result)
        assert (said["error"], said["noise"]) == (after.ahead.error, eta(noise, after.ahead.error))
        cx, cy, *a = after.estimated.state[0]
        assert said["affine"] == [*a, cx, cy] and said["scale"] == pytest.approx(math.sqrt(np.square(a).sum() / 2))
    middle = states[-1].estimated.state[0, :2]
    assert np.hypot(*(middle - (110, 95) - 5 * np.array(JUMP))) < 1.5
    assert not {"error", "noise"} & reported(results[0]).keys()


def test_without_a_motion_that_predicts_nothing_is_predicted():
    still = target(motion=WALK, step=partial(filters.adaptive, adaptive(100, entropy=0.0)))
    (first, second), results = followed(still, 2)
    ahead = Bound(still, first, frame(PICTURE), (), still.motion).ahead
    np.testing.assert_array_equal(ahead.state, first.estimated.state)
    assert not ahead.shift.any() and ahead.noise == 1.0 and second.flow is None
    assert parts_of(results[1])[0].particles == 100 and "error" not in reported(results[1])
