"""The guided filter against a Kalman filter, and against posteriors computed on a grid, with P(visible)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from facetrack_cli.core.types import Particles
from facetrack_cli.engine.resampling import logsumexp, normalise, uniform
from facetrack_cli.trackers.box.hidden_box import VISIBLE, ModeProposal
from tests.support.parts import guided, visible_walk

SIGMA, HIDDEN = 3.0, 1.5
WALK = visible_walk(SIGMA, HIDDEN, scale=0.01)
OPEN = 0.5  # standard deviation of a likelihood that says nothing of the log scale


@dataclass(frozen=True)
class Modes:
    """What a filter sees: a mixture of Gaussians of place and log scale as likelihood ratio, and guides at its modes.

    `tops` (J,) are the logarithms of the likelihood at the modes.
    """

    motion: Any
    mean: Any
    std: Any
    tops: Any
    redetected: Any = False
    flat: float | None = None

    def propagate(self, rng, x):
        return self.motion.propagate(rng, x)

    learned = None
    target = state = likelihood = property(lambda self: self)

    def guides(self, learned=None):
        mean = np.atleast_2d(np.asarray(self.mean, float))
        std = np.broadcast_to(np.asarray(self.std, float), mean.shape).copy()
        tops = np.broadcast_to(np.asarray(self.tops, float), len(mean)).copy()
        return ModeProposal(mean, std, tops, np.broadcast_to(self.redetected, len(mean)).copy())

    def log_likelihood(self, x, parents):
        z = np.column_stack([x[:, 0, :2], np.log(x[:, 0, 2])])
        return self.at(z)[:, None]

    def at(self, z):
        if self.flat is not None:
            return np.full(len(z), self.flat)
        of = self.guides()
        return logsumexp(of.log_w - 0.5 * np.sum(((z[:, None] - of.mean) / of.std) ** 2, axis=2), axis=1)


def visible(particles):
    return float(np.exp(particles.log_w) @ particles.x[:, 0, VISIBLE])


STILL = visible_walk(SIGMA, HIDDEN, scale=1e-3)
STD = (1.5, 2.0, OPEN)


def cloud(seed=5, n=40):
    """Particles of one scale, with speeds and shares of visibility of their own."""
    rng = np.random.default_rng(seed)
    x = np.empty((n, 1, 6))
    x[:, 0, :2], x[:, 0, 2] = rng.normal((50, 40), 2.5, (n, 2)), 1.0
    x[:, 0, 3:5], x[:, 0, VISIBLE] = rng.normal(0, 2, (n, 2)), rng.random(n)
    return Particles(x, normalise(rng.normal(0, 0.7, n)))


def exact(model, particles, spacing=0.25, returns=None):
    """Mean place given visible, mean place, E[|x|^2]'s trace given visible, and P(visible), on a grid of places.

    The sum over the parents is plain: a mixture of Gaussians around where each expects to be.
    """
    one = model.motion.settings
    x, y = np.meshgrid(np.arange(10, 95, spacing), np.arange(0, 85, spacing))
    z = np.column_stack([x.ravel(), y.ravel()])
    shown, hidden = np.zeros(len(z)), np.zeros(len(z))
    for w, parent in zip(np.exp(particles.log_w), particles.x[:, 0], strict=True):
        expected, before = parent[:2] + one.velocity * parent[3:5], parent[VISIBLE]
        near = before * (1 - one.hide) + (1 - before) * one.show * (1 - one.elsewhere)
        squared = np.sum((z - expected) ** 2, axis=1)
        leaves = 0.0 if returns is None else (1 - before) * one.show * one.elsewhere
        for total, share, sigma in ((shown, near, SIGMA), (hidden, 1 - near - leaves, HIDDEN)):
            total += w * share * np.exp(-0.5 * squared / sigma**2) / (2 * np.pi * sigma**2)
    if returns is not None:
        shown += returns(z)
    shown *= np.exp(model.at(np.column_stack([z, np.zeros(len(z))])))
    total = shown.sum() + hidden.sum()
    mean = shown @ z / shown.sum()
    spread = shown @ np.sum((z - mean) ** 2, axis=1) / shown.sum()
    return {
        "mean": mean, "all": (shown + hidden) @ z / total, "spread": spread, "visible": shown.sum() / total,
    }  # fmt: skip


def sampled(model, particles, n, share, seed):
    found, _ = guided(n, share)(np.random.default_rng(seed), particles, model)
    x, w, v = found.x[:, 0, :2], np.exp(found.log_w), found.x[:, 0, VISIBLE]
    mean = (w * v) @ x / (w @ v)
    spread = (w * v) @ np.sum((x - mean) ** 2, axis=1) / (w @ v)
    return {"mean": mean, "all": w @ x, "spread": spread, "visible": w @ v}


def assert_sampled(model, particles, truth, n, share, runs, off):
    """Steps of n particles have the exact values in the mean, but for a share `off`; the spread of each is returned."""
    found = [sampled(model, particles, n, share, seed) for seed in range(runs)]
    spread = {}
    for name, value in truth.items():
        of = np.array([run[name] for run in found])
        spread[name] = of.std(axis=0)
        assert np.all(np.abs(of.mean(axis=0) - value) < 4 * spread[name] / np.sqrt(runs) + off * np.abs(value)), name
    return spread


@pytest.mark.one_in(3)
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9])
@pytest.mark.parametrize("tops", [(0.5, 0.0), (3.0, 2.5), (-3.0, 1.0)])
def test_one_step_is_the_posterior_on_a_grid_whatever_the_share(tops, share):
    model = Modes(STILL, [(47.0, 38.0, 0.0), (55.0, 43.0, 0.0)], STD, tops)
    for name, std in assert_sampled(model, cloud(), exact(model, cloud()), 500, share, 20, 2e-3).items():
        assert np.all(std < {"visible": 0.06, "spread": 3.0}.get(name, 0.8)), name


def test_a_mode_found_anew_is_a_place_to_return_to():
    """log p(z, visible) has a third part then: `show` times `elsewhere`, around the mode."""
    model = Modes(STILL, [(47.0, 38.0, 0.0), (75.0, 70.0, 0.0)], STD, (-1.0, 5.0), (False, True))
    particles = cloud()
    one, before = STILL.settings, visible(particles)
    size = 0.4 * STILL.unit

    def returns(z):
        squared = np.sum((z - (75.0, 70.0)) ** 2, axis=1)
        share = (1 - before) * one.show * one.elsewhere
        return share * np.exp(-0.5 * squared / size**2) / (2 * np.pi * size**2)

    assert_sampled(model, particles, exact(model, particles, returns=returns), 1000, 0.7, 30, 0.01)


@pytest.mark.parametrize("share", [0.1, 0.7])
def test_p_visible_is_that_of_the_chain(share):
    """A likelihood that is the same everywhere, and steps that are the same hidden or not."""
    walk = visible_walk(SIGMA, SIGMA, scale=0.01)
    particles = Particles(np.tile([[[50.0, 40.0, 1.0, 0.0, 0.0, 1.0]]], (200, 1, 1)), uniform(200))
    rng, one, before, seen = np.random.default_rng(0), WALK.settings, 1.0, []
    for log_l in [2.0, -50.0, -50.0, -3.0, 0.0, 1.0, 5.0, 5.0, 0.0]:
        model = Modes(walk, (50.0, 40.0, 0.0), (SIGMA, SIGMA, 0.01), log_l, flat=log_l)
        particles, _ = guided(200, share)(rng, particles, model)
        near = before * (1 - one.hide) + (1 - before) * one.show * (1 - one.elsewhere)
        before = near * np.exp(log_l) / (near * np.exp(log_l) + 1 - near)
        seen.append(visible(particles))
        assert seen[-1] == pytest.approx(before, rel=1e-6)
    assert max(seen[1:3]) < 1e-18
    assert seen[6] > 0.9


def test_modes_after_a_prior_are_where_the_product_is_highest_and_those_found_anew_stay():
    rng = np.random.default_rng(0)
    mean, std, log_w = rng.normal(0, 3, (2, 3)), rng.uniform(0.5, 2, (2, 3)), np.array([1.5, 2.5])
    prior_mean, prior_std = rng.normal(0, 3, 3), rng.uniform(0.5, 2, 3)

    def height(z):
        return log_w[0] - 0.5 * np.sum(((z - mean[0]) / std[0]) ** 2 + ((z - prior_mean) / prior_std) ** 2)

    found = ModeProposal(mean, std, log_w, np.array([False, True])).after(prior_mean, prior_std)
    assert found.log_w[0] == pytest.approx(height(found.mean[0]))
    assert all(height(found.mean[0] + off) < found.log_w[0] for off in rng.normal(0, 0.1, (20, 3)))
    np.testing.assert_allclose(found.std[0], (1 / std[0] ** 2 + 1 / prior_std**2) ** -0.5)
    for one, given in zip(found[:3], (mean, std, log_w), strict=True):
        np.testing.assert_array_equal(one[1], given[1])
