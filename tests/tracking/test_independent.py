"""How many pixels, points and normals count as independent."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from facetrack_cli.core.types import Frame
from facetrack_cli.engine.resampling import MEMORY, averaged, effective_share
from facetrack_cli.trackers.appearance.space import Patches
from tests.support.parts import appearance, changed, contour, correlation


def field(rng, sigma):
    noise = rng.standard_normal((80, 80))
    return (cv2.GaussianBlur(noise, (0, 0), sigma) if sigma else noise)[20:60, 20:60]


@pytest.mark.parametrize("sigma", [0.0, 0.8, 1.5, 2.5])
def test_the_share_is_the_variance_of_a_sum(sigma):
    """n_e = n^2 var / var(sum), which many fields tell exactly, and one of them to a half or so."""
    rng = np.random.default_rng(0)
    fields = np.array([field(rng, sigma) for _ in range(300)])
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


def test_the_mean_forgets():
    share = 1.0
    for frame in range(3):
        share = averaged(share, frame, 0.2)
    assert share == pytest.approx(0.2)  # of the first frames the plain mean
    assert averaged(0.2, 1000, 0.7) == pytest.approx(0.2 + 0.5 / MEMORY)


# --- the likelihoods -----------------------------------------------------------------------------------------------


def frames():
    rng = np.random.default_rng(2)
    picture = cv2.GaussianBlur(rng.integers(0, 255, (120, 160, 3), np.uint8), (0, 0), 2.0)
    moved = np.roll(picture, 1, axis=1)
    return Frame(0, 0.0, picture), Frame(1, 0.04, moved)


AFFINE, BOX = np.array([[80.0, 60.0, 1, 0, 0, 1]]), np.array([[80.0, 60.0, 1, 0, 0, 0]])


def around(x0, n=40):
    x = np.repeat(x0[None], n, axis=0)
    x[..., :2] += np.random.default_rng(3).normal(0, 2, (n, 1, 2))
    return x


def test_the_terms_of_a_patch_are_those_of_the_sum():
    first, _ = frames()
    model = appearance(Patches((40.0, 48.0)), outlier=0.1)
    learned = model.init(first, AFFINE)
    y = model.patches.read(first, AFFINE[None] + 0.4, 1)
    log_p = model.score(learned, first, AFFINE[None] + 0.4)
    assert learned.log_terms(y[0]).sum() == pytest.approx(log_p[0, 0], rel=1e-5)


@pytest.mark.parametrize("kind", ["appearance", "contour", "correlation", "saturated"])
def test_estimated_the_likelihood_is_flatter_and_has_the_same_order(kind):
    first, second = frames()
    x0 = AFFINE if kind == "appearance" else BOX
    model = {
        "appearance": lambda: appearance(Patches((40.0, 48.0))),
        "contour": lambda: contour((40.0, 48.0), 2.0, 8.0, normals=32, threshold=2.0, outlier=0.05),
        "correlation": lambda: correlation((40.0, 48.0), grid=(16, 16)),
        "saturated": lambda: correlation((40.0, 48.0), "saturated_l1", grid=(16, 16)),
    }[kind]()
    estimated = changed(model, independent="estimated")
    x = around(x0)
    scores, shares = [], []
    for one in (model, estimated):
        learned = one.init(first, x0)
        learned = one.learn(learned, second, x0, None)
        scores.append(one.score(learned, second, x, x if kind != "appearance" else None))
        shares.append(learned.share)
        assert learned.frames == (one is estimated) * (2 if kind != "appearance" else 1)
    assert shares[0] == 1.0 and 0 < shares[1] < (1.001 if kind == "contour" else 0.6)
    if kind == "appearance":  # which learns the same of the frame
        np.testing.assert_allclose(scores[1], scores[0] * shares[1], rtol=1e-9)
    else:
        again = estimated.learn(estimated.init(first, x0), second, x0, None)
        plain = estimated.score(replace(again, share=1.0), second, x, x)
        np.testing.assert_allclose(scores[1], plain * shares[1], rtol=1e-9)
