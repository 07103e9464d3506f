"""The kernels of two hands against their plain twins, on hands and skin drawn at random."""

import cv2
import numpy as np
import pytest

from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.trackers.hands import hand_kernels as kernels
from tests.twins import hands as naive

SETTINGS = load_recipe("signer").hands
STEPS, SHARES = np.array(SETTINGS.steps), np.array(SETTINGS.shares)
SCALE, FACE, SIZE = 8.0, np.array([4.0, 1.0]), 1.1


def maps(rng, count):
    """Of blobs, each from 0 to 1."""
    coarse = rng.random((count, 6, 8)).astype(np.float32) ** 2
    return np.ascontiguousarray(coarse.repeat(8, axis=1).repeat(8, axis=2))


def cloud(rng, n=300):
    x = np.concatenate([rng.uniform(-0.5, 8.5, (n, 2, 2)), 0.2 * rng.standard_normal((n, 2, 2))], axis=2)
    x[: n // 3, 1, :2] = x[: n // 3, 0, :2] + 0.3 * rng.standard_normal((n // 3, 2))  # near to each other
    return x, rng.random((n, 2)) < 0.7, rng.random(n) < 0.5


@pytest.mark.parametrize("count", [0, 1, 5])
def test_hands_move_as_their_plain_twin_says(count):
    rng = np.random.default_rng(count)
    x, seen, parted = cloud(rng)
    luck, noise = rng.random((2, 4, len(x))), rng.standard_normal((2, len(x), 2))
    peaks, often = rng.uniform(-3, 51, (count, 2)), rng.dirichlet(np.ones(count)) if count else np.empty(0)
    evidence, covered = maps(rng, 2)
    given = luck, noise, peaks, often, STEPS, SHARES, np.array([0.4, 0.2, 0.3]), 20.0, evidence, covered, FACE, SIZE
    expected = naive.move(x, seen, parted, *given, SCALE)
    weight = np.empty(len(x))
    kernels.move(x, seen, parted, *given, SCALE, weight)
    for ours, theirs in zip((x, seen, parted, weight), expected, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_hands_are_weighed_as_their_plain_twin_says(seed):
    rng = np.random.default_rng(seed)
    given = (*cloud(rng), *maps(rng, 3), FACE, SIZE, SCALE, 0.36, 20.0, 0.18)
    out = np.ones(len(given[0]))
    kernels.weigh(*given, out)
    np.testing.assert_allclose(out, 1 + naive.weigh(*given), atol=1e-9)


@pytest.mark.parametrize(("least", "most"), [(-1.5, 8), (1.5, 3), (99.0, 2)])
def test_most_skin_is_where_its_plain_twin_says(least, most):
    share = maps(np.random.default_rng(most), 1)[0]
    share[5:30, 10:40] = np.random.default_rng(1).random((25, 30))
    given, fit = (share, 20.0, 0.18, FACE, SIZE, SCALE), np.empty_like(share)
    at, heights = np.empty((most, 2)), np.empty(most)
    count = kernels.fit_skin(*given, least, fit, at, heights)
    np.testing.assert_allclose(fit, naive.fit_skin(*given), atol=1e-4)
    for ours, theirs in zip((at, heights), naive.peaks(fit, least, most), strict=True):
        np.testing.assert_array_equal(ours[:count], theirs)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_belief_is_what_its_plain_twin_says(share):
    rng = np.random.default_rng(4)
    x, _, _ = cloud(rng)
    seen, w = rng.random((len(x), 2)) < share, rng.dirichlet(np.full(len(x), 0.3))
    share, evidence = maps(rng, 2)
    given = x, seen, w, share, SCALE, evidence, 3.7
    found = [np.empty(shape) for shape in ((2,), (2, 2), (2, 2, 2), (2,), (2,), (2, 3))]
    kernels.gather(*given, *found)
    for ours, theirs in zip(found, naive.gather(*given), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-6)


@pytest.mark.parametrize("hands", [[], [(2.0, 3.5), (20.0, 4.0)]])
def test_a_head_is_learned_as_its_plain_twin_says(hands):
    rng, hands = np.random.default_rng(5), np.array(hands).reshape(-1, 2)
    head = rng.uniform(0, 255, (12, 9, 3)).astype(np.float32)
    seen = (head + rng.normal(0, 9, head.shape)).astype(np.float32)
    expected = naive.learn_head(seen, head, 5.0, hands, 3.0)
    change, new, apart = np.empty((3, *head.shape[:2]), np.float32)
    weights = np.ascontiguousarray(cv2.getGaussianKernel(9, 1.0, cv2.CV_32F)[:, 0])
    count = kernels.learn_head(seen, head, weights, 5.0, hands, 3.0, change, new, apart.ravel())
    for ours, theirs in zip((head, change, new, apart.ravel()[:count]), expected, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-3)


@pytest.mark.parametrize("seed", range(20))
def test_light_and_edges_change_as_their_plain_twins_say(seed):
    rng = np.random.default_rng(seed)
    (height, width), thin = rng.integers(1, 60, 2), 1 + seed % 3
    first = rng.integers(0 if seed % 2 else 30, 256 if seed % 2 else 230, (height, width, 3), np.uint8)
    now = np.clip(np.rint(first * rng.uniform(0.985, 1.015) + rng.integers(-2, 3, first.shape)), 0, 255)
    now = now.astype(np.uint8)
    assert kernels.same_light(first, now, thin) == naive.same_light(first, now, thin)
    before, after = (np.ascontiguousarray(cv2.GaussianBlur(image, (0, 0), 1.5)[..., 1]) for image in (first, now))
    slope = cv2.morphologyEx(before, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    assert kernels.edges(before, after, slope) == naive.edges(before, after, slope)
