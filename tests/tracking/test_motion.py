"""The contract of every motion, and the walk of a face's points: draws have the density that they state."""

from types import SimpleNamespace

import numpy as np
import pytest

from facetrack_cli.engine.spaces import FirstOrder, RandomWalk
from facetrack_cli.trackers.appearance.appearance import AffineWalk
from facetrack_cli.trackers.appearance.settings import AffineWalkSettings
from facetrack_cli.trackers.box.hidden_box import VisibleWalk
from facetrack_cli.trackers.box.settings import VisibleWalkSettings
from facetrack_cli.trackers.face.motion import ANY, JumpingWalk, SensorReading
from facetrack_cli.trackers.face.window_ncc import WindowNcc, WindowState
from tests.twins import jumping_walk as twin

HIDES = VisibleWalkSettings(type="visible_walk", sigma="2px", scale=0.02, hide=1e-6)
DEFORMS = AffineWalkSettings(type="affine_walk", sigma="3px", deform=0.02, turn=0.03, shear=0.01)
PLACE = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[2.0], [1.0]])  # one source of noise for place and speed
TWO_SOURCES = np.array([[1.0, 0.9], [0.0, 0.8]]), np.array([[2.0, 0.5], [0.3, 1.0]])
SIZE = np.array([[1.0, 0.0], [0.0, 0.0]]), np.array([[0.02], [0.0]])
POINTS, BOX = np.array([[10.0, 20.0], [30.0, 5.0]]), np.array([[10.0, 20.0, 1.0, 1.0, -1.0, 0.0]])
MOTIONS = {  # each with a state
    "random_walk": (RandomWalk(np.array([3.0, 1.0])), POINTS),
    "jumping_walk": (
        JumpingWalk(np.array([1.0, 0.5]), np.array([6.0, 2.0]), 0.2, np.array([[12.0, 18.0], [31.0, 6.0]]), 0.9),
        POINTS,
    ),
    "first_order": (FirstOrder(PLACE, SIZE, 0.1, 10.0), BOX),
    "visible_walk": (VisibleWalk(HIDES, 40.0, (2.0, 4.0), (0.2, 5.0)), np.array([[10.0, 20.0, 1.0, 1.0, -1.0, 1.0]])),
}
MORE = {
    "two sources": (FirstOrder(TWO_SOURCES, SIZE, 0.01, 100.0), BOX),
    "affine_walk": (AffineWalk(DEFORMS, 3.0, (0.01, 100.0)), np.array([[10.0, 20.0, 1.0, 0.1, -0.1, 1.0]])),
}


@pytest.mark.parametrize(("motion", "state"), [*MOTIONS.values(), *MORE.values()], ids=[*MOTIONS, *MORE])
def test_draws_of_every_motion_are_those_of_its_linear_form_and_each_pair_is_scored(motion, state):
    rng, pairs = np.random.default_rng(1), np.repeat(state[None], 7, axis=0)
    x, parents = motion.propagate(rng, pairs[:4]), motion.propagate(rng, pairs)
    parents.flags.writeable = False
    assert motion.propagate(rng, parents).shape == parents.shape
    assert motion.propagate(rng, parents[:0]).shape == (0, *state.shape)
    if not isinstance(motion, FirstOrder | AffineWalk | VisibleWalk):
        table = motion.log_transition(x, parents)
        assert table.shape == (4, 7, len(state))
        np.testing.assert_allclose(table[2, 5], motion.log_transition(x[2:3], parents[5:6])[0, 0])
    linear = motion.linear(state)
    d = linear.matrix.shape[-1]
    drawn = motion.propagate(np.random.default_rng(6), np.repeat(state[None], 60_000, axis=0))[..., :d]
    expected = np.einsum("kde,ke->kd", linear.matrix, state[:, :d]) + linear.offset
    for k in range(len(state)):
        std = np.sqrt(np.diagonal(linear.cov[k])) + 1e-12
        assert np.abs((drawn[:, k].mean(axis=0) - expected[k]) / std).max() < 0.03
        scatter = np.cov(drawn[:, k].T)
        assert np.abs((scatter - linear.cov[k]) / np.outer(std, std)).max() < 0.05
        if isinstance(motion, RandomWalk):  # the density is the normal one
            child = motion.propagate(rng, parents[:1])
            z = (child[0, k] - parents[0, k]) / std
            expected_log = -0.5 * z @ z - np.log(2 * np.pi * linear.cov[k, 0, 0])
            assert motion.log_transition(child, parents[:1])[0, 0, k] == pytest.approx(expected_log)


def test_scale_stops_at_its_bounds():
    wild = FirstOrder(TWO_SOURCES, (np.eye(2), np.array([[2.0], [1.0]])), 0.5, 2.0)
    moved = wild.propagate(np.random.default_rng(3), np.tile(BOX, (500, 1, 1)))
    s, speed = moved[..., 2], moved[..., 5]
    assert s.min() == 0.5 and s.max() == 2.0
    assert np.all(speed[(s == 0.5) | (s == 2.0)] == 0) and np.any(speed != 0)


REST = np.array([[2.0, -1.0], [0.0, 0.0], [1.0, 1.0]])
JUMPS = JumpingWalk(np.array([0.5, 1.0, 2.0]), np.array([3.0, 4.0, 6.0]), 0.3, REST, 0.9)
PARENT = np.array([[3.0, -2.0], [1.0, 0.5], [-2.0, 2.0]])
STEP = 0.2
AXIS = np.arange(-40, 40, STEP)
GRID = np.stack(np.meshgrid(AXIS, AXIS), axis=2).reshape(-1, 1, 2)


def normal(off, var):
    return np.exp(-0.5 * (off**2).sum(axis=-1) / var) / (2 * np.pi * var)


def jump_density(x, parent, part):
    """p(x | parent) by its formula; x (..., 2)."""
    mean = REST[part] + 0.9 * (parent - REST[part])
    return 0.7 * normal(x - mean, JUMPS.sigma[part] ** 2) + 0.3 * normal(x - mean, JUMPS.jump[part] ** 2)


MEASURED = SensorReading(
    np.array([[5.0, -1.0], [-9.0, 4.0], [30.0, 30.0]]),  # near, a jump away, and where nobody gets
    np.array([1.0, 2.0, 1.5]),
    np.array([0.95, 0.9, 0.8]),
    1600.0,
)
OTHER = MEASURED._replace(
    z=MEASURED.z + np.array([3.0, 1.0]), var=np.array([0.5, 9.0, 1.0]), sure=np.array([0.7, 0.95, 0.5])
)


def stacked(measured):
    if not measured:
        return SensorReading(np.empty((0, 3, 2)), np.empty((0, 3)), np.empty((0, 3)), MEASURED.area)
    return SensorReading(*map(np.stack, zip(*(each[:3] for each in measured), strict=True)), MEASURED.area)


def test_the_density_of_a_jump_is_the_formula_and_integrates_to_one():
    log_p = JUMPS.log_transition(GRID.repeat(3, axis=1), PARENT[None])
    assert log_p.shape == (len(GRID), 1, 3)
    np.testing.assert_allclose(np.exp(log_p[:, 0]).sum(axis=0) * STEP**2, 1.0, atol=1e-3)
    for part in range(3):
        np.testing.assert_allclose(np.exp(log_p[::977, 0, part]), jump_density(GRID[::977, 0], PARENT[part], part))


@pytest.mark.parametrize("measured", [[], [MEASURED, OTHER], [OTHER, MEASURED, MEASURED]])
def test_draws_given_sensors_are_of_the_posterior_by_their_weights(measured):
    """The mean of the weights is what sensors say of a parent."""
    parents = (PARENT + 3)[None].repeat(60_000, axis=0)
    x, weights = JUMPS.propose(np.random.default_rng(1), parents, stacked(measured))
    np.testing.assert_allclose(JUMPS.log_measured(x, parents, stacked(measured)), weights, atol=1e-9)
    for part, (draws, log_w) in enumerate(zip(np.moveaxis(x, 1, 0), weights.T, strict=True)):
        p = jump_density(GRID[:, 0], parents[0, part], part)
        for one in measured:  # p(z | x) by its formula
            sure = one.sure[part]
            p *= sure * normal(one.z[part] - GRID[:, 0], one.var[part]) + (1 - sure) / one.area
        assert np.log(np.exp(log_w).mean()) == pytest.approx(np.log(p.sum() * STEP**2), abs=0.02)
        w, p = np.exp(log_w) / np.exp(log_w).sum(), p / p.sum()
        assert 1 / (w**2).sum() > 0.5 * len(w), "few draws are wasted"
        mean = p @ GRID[:, 0]
        cov = (GRID[:, 0] - mean).T @ ((GRID[:, 0] - mean) * p[:, None])
        np.testing.assert_allclose(w @ draws, mean, atol=0.08)
        np.testing.assert_allclose(np.cov(draws.T, aweights=w), cov, atol=0.04 * np.trace(cov))
        for axis in (0, 1):
            below, order = p.reshape(len(AXIS), -1).sum(axis=axis).cumsum(), draws[:, axis].argsort()  # 0 is y
            at = np.searchsorted(draws[order, axis], AXIS + STEP / 2)
            assert np.abs(below - np.append(0, w[order].cumsum())[at]).max() < 0.015


@pytest.mark.parametrize(
    "measured", [[], [MEASURED], [MEASURED, OTHER], [MEASURED, MEASURED._replace(sure=0 * REST[:, 0]), OTHER]]
)
def test_one_kernel_draws_and_weighs_as_the_plain_twin_and_windows_do(measured):
    rng = np.random.default_rng(4)
    maps, corner = rng.uniform(-1, 1, (3, 9, 9)).astype(np.float32), np.round(REST) - 4
    windows = WindowNcc.__new__(WindowNcc)
    windows.settings = SimpleNamespace(sharpness=30.0)
    learned = WindowState(None, None, None, np.array([1.0, 0.5, 0.0]), None, None, maps=maps, corner=corner)
    x = REST + rng.normal(0, 3, (40, 3, 2))
    x = np.repeat(np.sort(x[:20], axis=0), 2, axis=0)  # parents that repeat
    drawn, log_p = JUMPS.propose(np.random.default_rng(5), x, stacked(measured), windows.scored(learned))
    again = np.random.default_rng(5)
    uniform, normal = again.random(x.shape[:2]), again.standard_normal(x.shape)
    score = windows.score(learned, None, drawn, x)
    for n, k in np.ndindex(x.shape[:2]):
        readings = [(one.z[k], one.var[k], one.sure[k]) for one in measured if one.sure.any()]
        walk = JUMPS.sigma[k], JUMPS.jump[k], JUMPS.jumps, JUMPS.keep
        found = twin.components(x[n, k], readings, MEASURED.area, walk, REST[k])
        np.testing.assert_allclose(drawn[n, k], twin.drawn(uniform[n, k], normal[n, k], found, ANY), rtol=1e-9)
        assert log_p[n, k] == pytest.approx(score[n, k] + twin.log_measured(drawn[n, k], found, ANY), abs=2e-3)
