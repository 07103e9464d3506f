"""Kernels of points, resampling, stabilized images and two hands against their slow plain twins."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.types import Frame, Particles
from facetrack_cli.engine.kernels.compiled import invert_cdf
from facetrack_cli.engine.spaces import estimate
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.trackers.face.stabilized import Similarity
from facetrack_cli.trackers.hands import hand_kernels as kernels
from facetrack_cli.trackers.points import point_kernels as windows
from tests.support.images import frame
from tests.support.parts import colour_ratio
from tests.twins import hands as naive_hands
from tests.twins import points as naive


def picture(seed, height=24, width=31):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


@given(
    x=st.floats(-12, 43),
    y=st.floats(-12, 36),
    w=st.sampled_from([3, 5, 9]),
    h=st.sampled_from([3, 7]),
)
def test_window_is_bilinear_and_replicates_the_border(x, y, w, h):
    image = picture(1)
    seen = windows.read_window(windows.flat(image), x, y, w, h)
    np.testing.assert_allclose(seen[:, :w], naive.window(image, x, y, w, h), atol=2e-3)
    np.testing.assert_array_equal(seen[:, w], 0.0)


def distances(image, templates, x, origin=(0, 0), factor=1):
    """The kernel on a list of templates (h, w, 3) for parts 1, 2, ... of x (N, K, 2)."""
    rows, sides = [], []
    for template in templates:
        h, w = template.shape[:2]
        row = np.zeros((h, w + 1, 3), np.float32)
        row[:, :w] = template / max(template.mean(), 1.0)
        rows.append(row.ravel())
        sides.append((w, h))
    out = np.full(x.shape[:2], np.nan)
    offsets = np.concatenate([[0], np.cumsum([len(row) for row in rows])])
    parts = np.arange(1, len(templates) + 1)
    windows.colour_ratio_distances(
        windows.flat(image), np.concatenate(rows), offsets, np.array(sides), parts, x, *origin, factor,
        1.0, out,
    )  # fmt: skip
    assert np.all(np.isnan(out[:, 0]))
    return out[:, 1:]


@given(
    x=st.floats(-6, 36),
    y=st.floats(-6, 30),
    seed=st.integers(0, 20),
)
def test_distances_agree_with_the_formula(x, y, seed):
    image = picture(seed)
    templates = [picture(seed + 100, 7, 5).astype(float), picture(seed + 200, 3, 9).astype(float)]
    centres = np.array([[[0, 0], [x, y], [12.25, 9.5]], [[0, 0], [3.0, y], [x, 2.5]]])
    expected = [
        [naive.colour_ratio_distance(image, template, *place)
         for template, place in zip(templates, line[1:], strict=True)]
        for line in centres
    ]  # fmt: skip
    np.testing.assert_allclose(distances(image, templates, centres), expected, rtol=2e-4, atol=2e-6)


X0, SIDES = np.array([[60.0, 51.0], [100.0, 70.0]]), np.array([[13.0, 13.0], [25.0, 21.0]])


def test_the_likelihood_of_colours_is_the_formula_and_its_floor_bounds_it():
    image = picture(5, 120, 160)
    plain, floored = (colour_ratio(SIDES, **more) for more in ({}, {"floor": -10.0}))
    learned, x = plain.init(frame(image), X0), X0 + 2.7
    score = plain.score(learned, frame(image), x[None])
    for i, (w, h) in enumerate(SIDES.astype(int)):
        template = naive.window(image, *X0[i], w, h)
        d = naive.colour_ratio_distance(image, template, *x[i])
        assert score[0, i] == pytest.approx(-d / (1.5 / template.mean()), rel=1e-4)
    bounded = floored.score(learned, frame(image), x[None])
    np.testing.assert_allclose(bounded, np.log(np.exp(score) + np.exp(-10.0)))


def naive_inverse(weights, points):
    """The first index whose cumulated share exceeds the point, by exact fractions."""
    from fractions import Fraction

    w = [Fraction(float(v)) for v in weights]
    out = []
    for point in points:
        total, i = Fraction(0), -1
        while total <= Fraction(float(point)) * sum(w):
            i += 1
            total += w[i]
        out.append(i)
    return out


@given(
    weights=st.lists(st.sampled_from([0.0, 0.1, 0.25, 1.0, 3.0]), min_size=1, max_size=12).filter(any),
    points=st.lists(st.sampled_from([0.0, 0.13, 0.37, 0.61, 0.93]), min_size=1, max_size=8),
)
def test_inverse_agrees_with_exact_fractions(weights, points):
    points = np.sort(points)
    seen = np.empty((len(points), 2), np.int64)
    invert_cdf(np.array(weights)[:, None].repeat(2, axis=1), points[:, None].repeat(2, axis=1), seen)
    assert seen[:, 0].tolist() == seen[:, 1].tolist() == naive_inverse(weights, points)


@pytest.mark.parametrize("ess", [np.inf, 5.0])
def test_mean_and_covariance_are_those_of_numpy(ess):
    rng = np.random.default_rng(4)
    x, w = rng.normal(size=(40, 3, 4)), rng.dirichlet(np.ones(40))
    found = estimate(Particles(x, np.log(w)), np.full(3, ess), sides=x[:, 0, 2:])
    np.testing.assert_allclose(found.state, np.average(x, axis=0, weights=w))
    more = (1 + 1 / ess) / (1 - 1 / ess)
    for k in range(3):
        cov = np.cov(x[:, k].T, aweights=w, ddof=0) * more
        np.testing.assert_allclose(found.cov[k], cov[:2, :2])
    np.testing.assert_allclose(found.side_std**2, np.diag(np.cov(x[:, 0, 2:].T, aweights=w, ddof=0)) * more)


@pytest.mark.parametrize("scale", [0.8, 1.5, 2.5, 5.0])
@pytest.mark.parametrize("side", [160, 201])
def test_a_stabilized_image_by_planes_is_nearly_that_of_the_converted_frame(scale, side):
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 256, (480, 640, 3)).astype(np.float32)
    smooth = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 8 * scale), None, 40, 215, cv2.NORM_MINMAX)
    planes = cv2.cvtColor(smooth.astype(np.uint8), cv2.COLOR_BGR2YUV_I420)
    whole = Frame(0, 0.0, cv2.cvtColor(planes, cv2.COLOR_YUV2BGR_I420))
    lies = Similarity(np.array([310.0, 250.0]), scale, 0.3)
    seen, expected = (lies.read(one, side).bgr.astype(float) for one in (Frame(0, 0.0, planes), whole))
    off = cv2.blur(seen, (2, 2)) - cv2.blur(expected, (2, 2))  # colours are read at every other pixel
    assert np.abs(off).mean() < 0.75 and abs(off.mean()) < 0.4


# --- two hands

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
    expected = naive_hands.move(x, seen, parted, *given, SCALE)
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
    np.testing.assert_allclose(out, 1 + naive_hands.weigh(*given), atol=1e-9)


@pytest.mark.parametrize(("least", "most"), [(-1.5, 8), (1.5, 3), (99.0, 2)])
def test_most_skin_is_where_its_plain_twin_says(least, most):
    share = maps(np.random.default_rng(most), 1)[0]
    share[5:30, 10:40] = np.random.default_rng(1).random((25, 30))
    given, fit = (share, 20.0, 0.18, FACE, SIZE, SCALE), np.empty_like(share)
    at, heights = np.empty((most, 2)), np.empty(most)
    count = kernels.fit_skin(*given, least, fit, at, heights)
    np.testing.assert_allclose(fit, naive_hands.fit_skin(*given), atol=1e-4)
    for ours, theirs in zip((at, heights), naive_hands.peaks(fit, least, most), strict=True):
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
    for ours, theirs in zip(found, naive_hands.gather(*given), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-6)


@pytest.mark.parametrize("hands", [[], [(2.0, 3.5), (20.0, 4.0)]])
def test_a_head_is_learned_as_its_plain_twin_says(hands):
    rng, hands = np.random.default_rng(5), np.array(hands).reshape(-1, 2)
    head = rng.uniform(0, 255, (12, 9, 3)).astype(np.float32)
    seen = (head + rng.normal(0, 9, head.shape)).astype(np.float32)
    expected = naive_hands.learn_head(seen, head, 5.0, hands, 3.0)
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
    now = np.clip(first * rng.uniform(0.985, 1.015) + rng.integers(-2, 3, first.shape) + 0.5, 0, 255).astype(np.uint8)
    assert kernels.same_light(first, now, thin) == naive_hands.same_light(first, now, thin)
    before, after = (np.ascontiguousarray(cv2.GaussianBlur(image, (0, 0), 1.5)[..., 1]) for image in (first, now))
    slope = cv2.morphologyEx(before, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    assert kernels.edges(before, after, slope) == naive_hands.edges(before, after, slope)
