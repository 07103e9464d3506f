"""First-order dynamics: draws against A and B, the density against the draws, the filter against a Kalman filter."""

from types import SimpleNamespace

import numpy as np
import pytest

from facetrack_cli.core.types import Particles
from facetrack_cli.engine.motion import FirstOrder
from facetrack_cli.engine.resampling import uniform
from facetrack_cli.engine.spaces import BoxSpace, evenly
from facetrack_cli.trackers.regions.likelihoods import Product
from tests.support.parts import auxiliary, factorized, sir

A = np.array([[1.0, 0.9], [0.0, 0.8]])
B = np.array([[2.0, 0.5], [0.3, 1.0]])
SCALE_A = np.array([[0.95, 0.5], [0.0, 0.7]])
SCALE_B = np.array([[0.02, 0.0], [0.0, 0.01]])
MOTION = FirstOrder((A, B), (SCALE_A, SCALE_B), 0.01, 100.0)


def whole(block, scale):
    """(6, 6) of x, y, s and their speeds, from the blocks of place and of scale."""
    out = np.zeros((6, 6))
    for i, one in enumerate((block, block, scale)):
        out[np.ix_([i, i + 3], [i, i + 3])] = one
    return out


def test_scale_stops_at_its_bounds():
    wild = FirstOrder((A, B), (np.eye(2), np.array([[2.0], [1.0]])), 0.5, 2.0)
    x = np.tile(BoxSpace((10, 10)).at((0, 0, 10, 10)), (500, 1, 1))
    moved = wild.propagate(np.random.default_rng(3), x)
    s, speed = moved[..., 2], moved[..., 5]
    assert s.min() == 0.5 and s.max() == 2.0
    assert np.all(speed[(s == 0.5) | (s == 2.0)] == 0) and np.any(speed != 0)


def test_density_is_that_of_a_normal_distribution():
    rng = np.random.default_rng(4)
    parents = rng.normal(size=(3, 2, 6))
    x = rng.normal(size=(4, 2, 6))
    cov, a = whole(B @ B.T, SCALE_B @ SCALE_B.T), whole(A, SCALE_A)
    seen = MOTION.log_transition(x, parents)
    assert seen.shape == (4, 3, 2)
    for n, m, k in np.ndindex(4, 3, 2):
        off = x[n, k] - a @ parents[m, k]
        log_p = -0.5 * off @ np.linalg.solve(cov, off) - 0.5 * np.linalg.slogdet(2 * np.pi * cov)[1]
        assert seen[n, m, k] == pytest.approx(log_p)


def test_density_of_fewer_sources_than_numbers_is_that_on_their_line():
    motion = FirstOrder((A, np.array([[3.0], [4.0]])), (SCALE_A, SCALE_B), 0.01, 100.0)
    parent = np.array([[[5.0, 5.0, 1.0, 1.0, 1.0, 0.0]]])
    drawn = motion.propagate(np.random.default_rng(5), np.tile(parent, (6, 1, 1)))
    assert np.isfinite(motion.log_transition(drawn, parent)).all()
    beside = drawn.copy()
    beside[..., 3] += 0.5
    assert np.all(motion.log_transition(beside, parent) == -np.inf)
    mean = parent @ whole(A, SCALE_A).T
    two, three = mean.copy(), mean.copy()
    two[..., [0, 3]] += [0.6, 0.8]  # 0.2 standard deviations along (3, 4), whose length is 5
    three[..., [0, 3]] += [6.0, 8.0]
    ratio = motion.log_transition(two, parent) - motion.log_transition(three, parent)
    assert ratio[0, 0, 0] == pytest.approx((2.0**2 - 0.2**2) / 2)


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


class Moves(SimpleNamespace):
    """A likelihood that is given its answer, and knows only how the target moved."""

    def init(self, frame, x0):
        return frame, self

    def score(self, learned, frame, x, parents):
        assert learned[1] is self
        return self.answer * (parents[..., 0] - x[..., 0])

    def learn(self, learned, frame, state, particles):
        return frame, self


def test_a_product_is_the_sum_of_logarithms_and_judges_by_its_objects():
    one, other = (
        Moves(answer=a, distances=lambda _, __, x, d=d: np.full(x.shape[:2], d)) for a, d in ((2, 0.1), (3, 0.7))
    )
    product = Product((one, other, Moves(answer=5)))
    x, parents = np.zeros((4, 1, 6)), np.ones((4, 1, 6))
    learned = product.init("first", x[0])
    np.testing.assert_allclose(product.score(learned, "now", x, parents), np.full((4, 1), 10.0))
    np.testing.assert_allclose(product.distances(learned, "now", x), np.full((4, 1), 0.4))
    after = product.learn(learned, "now", x[0], None)
    assert [frame for frame, _ in learned] == ["first"] * 3
    assert [frame for frame, _ in after] == ["now"] * 3


def test_a_box_is_its_state():
    state = BoxSpace((31, 42)).at((10, 20, 31, 42))
    np.testing.assert_array_equal(state, [[25.0, 40.5, 1.0, 0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(BoxSpace((31, 42)).windows(evenly(2 * state, np.zeros((1, 2)))), [[62, 84]])
