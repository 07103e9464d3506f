"""The contour: it peaks at the ground truth, no normal costs more than K, borders and light are no edges."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facetrack_cli.trackers.regions import region_kernels as kernel
from facetrack_cli.trackers.regions.likelihoods import ellipse
from tests.support import parts
from tests.support.images import grey, states
from tests.twins import regions as naive_contour

SIZE = (40.0, 52.0)
TRUTH = (80.0, 60.0, 1.0)
WIDTH, HEIGHT = 160, 120


@settings(max_examples=10)
@given(
    seed=st.integers(0, 1000),
    cx=st.floats(-20, 80),
    cy=st.floats(-20, 60),
    s=st.one_of(st.floats(0.05, 3.0), st.sampled_from([-1.0, 0.0, 1e-7, 1e7])),
    factor=st.sampled_from([1, 2, 4]),
    reach=st.floats(0.5, 14.0),
    threshold=st.floats(9.0, 540.0),
)
def test_the_kernel_is_what_its_plain_twin_says(seed, cx, cy, s, factor, reach, threshold):
    noise = np.random.default_rng(seed).normal(0, 1, (37, 61)).astype(np.float32)
    image = np.clip(1150 + 1080 * cv2.GaussianBlur(noise, (0, 0), 1.0), 0, 2295).astype(np.uint16)
    points, normals = ellipse((23.0, 31.0), 10)
    x = np.array([[cx, cy, s]])
    ours = kernel.nearest_edges(image, x, 5.0, -3.0, factor, points, normals, reach, threshold)
    theirs = naive_contour.nearest_edges(image, x, (5.0, -3.0), factor, points, normals, reach, threshold)
    np.testing.assert_allclose(ours, theirs, atol=2e-3)  # float32, and a parabola may be nearly flat


@pytest.mark.parametrize(
    ("row", "at", "nearest"),
    [
        # the step from 0 to 100 has contrasts of 50, 100 and 50, which end on the centre of the last pixel
        ([0, 0, 0, 0, 0, 0, 0, 100, 100, 100], 4, 2.5),
        ([9, 9, 9, 0, 0, 0, 0, 0, 0, 0], 5, 2.5),
        # one nearer to the border may be half of a larger one
        ([0, 0, 0, 0, 0, 0, 0, 0, 100, 100], 4, math.inf),
        # two equal contrasts are one edge between them, on the outline too
        ([0, 0, 0, 0, 50, 100, 100, 100, 100, 100], 4, 0.0),
        ([0, 0, 0, 0, 50, 100, 100, 100, 100, 100], 6, 2.0),
        # contrasts of 60, 70 at 4.5, and 40: the parabola is highest 0.5 (60 - 40) / (60 - 140 + 40) from there
        ([0, 0, 0, 0, 40, 80, 100, 100, 100, 100], 7, 2.75),
        # of two edges the nearer, whichever way
        ([0, 0, 90, 90, 90, 90, 90, 0, 0, 0], 4, 2.5),
        ([0, 0, 90, 90, 90, 90, 90, 0, 0, 0], 5, 1.5),
    ],
)
@pytest.mark.parametrize("turned", [False, True])
def test_edges_by_hand(row, at, nearest, turned):
    image = np.repeat(np.array([row], np.uint16), 10, axis=0)
    image = np.ascontiguousarray(image.T) if turned else image
    normals = np.array([[0.0, 1.0], [0.0, -1.0]] if turned else [[1.0, 0.0], [-1.0, 0.0]])
    x = np.array([[3.0, at, 1.0] if turned else [at, 3.0, 1.0]])
    found = kernel.nearest_edges(image, x, 0.0, 0.0, 1, np.zeros((2, 2)), normals, 4.0, 5.0)
    np.testing.assert_allclose(found, [[nearest, nearest]], atol=1e-6)


@pytest.mark.parametrize(("size", "count"), [((40.0, 52.0), 9), ((90.0, 31.0), 32)])
def test_the_normals_stand_at_equal_steps_of_arc(size, count):
    points, normals = ellipse(size, count)
    other_points, other_normals = naive_contour.ellipse(*size, count)
    np.testing.assert_allclose(points, other_points, atol=0.03)
    np.testing.assert_allclose(normals, other_normals, atol=0.01)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)


@pytest.mark.parametrize(("max_size", "factor", "search"), [(None, 1, 4.0), (None, 1, 30.0), (30, 2, 30.0)])
def test_likelihood_and_distance_are_the_formulas(max_size, factor, search):
    """Eq. 11, on the means of 3x3 pixels: an edge that lies beyond `search` is none, wherever K takes over."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    within = np.hypot((x - TRUTH[0]) / (SIZE[0] / 2), (y - TRUTH[1]) / (SIZE[1] / 2)) < 1
    clutter = cv2.GaussianBlur(np.random.default_rng(0).normal(0, 1, within.shape), (0, 0), 2.0)
    picture = grey(cv2.GaussianBlur(np.where(within, 150.0, 90 + 25 * clutter / clutter.std()), (0, 0), 1.0))
    likelihood = parts.contour(SIZE, sigma=5.0, search=search, threshold=8.0, outlier=0.1, max_size=max_size)
    boxes = [TRUTH, (86.3, 57.2, 1.1), (70.1, 66.4, 0.8)]
    x, learned = states(boxes), likelihood.init(picture, states(TRUTH)[0])
    assert learned.factor == factor
    seen = picture.grey(factor, (0, 0, WIDTH, HEIGHT))[0].astype(float)
    means = np.lib.stride_tricks.sliding_window_view(np.pad(seen, 1, mode="reflect"), (3, 3)).mean(axis=(2, 3))
    points, normals = ellipse(SIZE, 32)
    nearest = naive_contour.nearest_edges(means, boxes, (0, 0), factor, points, normals, search, 8.0)
    likely = [[math.exp(-(d**2) / (2 * 5.0**2)) for d in row] for row in nearest]
    assert any(0.1 > p > 0 for row in likely for p in row) == (search > 5)
    logs = [sum(math.log(max(0.1, p)) for p in row) for row in likely]
    np.testing.assert_allclose(likelihood.score(learned, picture, x, x)[:, 0], logs, atol=5e-3)
    np.testing.assert_allclose(likelihood.distances(learned, picture, x)[:, 0], 1 - np.mean(likely, axis=1), atol=1e-3)
