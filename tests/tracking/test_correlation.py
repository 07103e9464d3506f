"""The correlation of frames: it peaks at the true motion, follows whatever moves, and is not fooled by the border."""

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from facetrack_cli.core.types import Frame
from facetrack_cli.trackers.regions import region_kernels as kernel
from facetrack_cli.trackers.regions.likelihoods import OUTSIDE
from tests.support.images import grey, states
from tests.support.parts import correlation
from tests.twins import regions as naive

DISTANCES = ["l2", "saturated_l1", "hausdorff"]
SIZE = (40.0, 48.0)
WIDTH, HEIGHT = 160, 120


def texture(seed=0, width=WIDTH, height=HEIGHT, blur=2.5):
    noise = np.random.default_rng(seed).normal(0, 1, (height, width)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), blur)
    return 128 + smooth * (40 / smooth.std())


def moved(grey, dx, dy):
    size = grey.shape[1], grey.shape[0]
    return cv2.warpAffine(
        grey, np.array([[1, 0, dx], [0, 1.0, dy]]), size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
    )


def scored(likelihood, before, now, x, parents):
    parents = np.repeat(states(parents), len(np.atleast_2d(x)), axis=0)
    return likelihood.score(likelihood.init(before, states([0, 0, 1.0])[0]), now, states(x), parents)[:, 0]


place = st.floats(-60, 220, width=32)
scale = st.one_of(st.floats(0.0, 3.0, width=32), st.sampled_from([1e-6, 1e3, -0.7]))


@settings(max_examples=30)
@given(
    kind=st.sampled_from(DISTANCES),
    boxes=st.lists(st.tuples(place, place, scale), min_size=1, max_size=4),
    parent=st.tuples(place, place, scale),
    other=st.tuples(st.integers(0, 2), scale),
    split=st.integers(0, 4),
    size=st.tuples(st.floats(2, 200), st.floats(2, 200)),
    grid=st.tuples(st.integers(1, 9), st.integers(1, 9)),
    factor=st.sampled_from([1, 2, 8]),
    picture=st.sampled_from([(1, 1), (1, 9), (7, 2), (37, 50), (96, 120)]),
)
def test_kernel_does_what_its_twin_does(kind, boxes, parent, other, split, size, grid, factor, picture):
    rng = np.random.default_rng(picture[0] + factor)
    whole = picture[1] * factor + 5 % factor, picture[0] * factor + 3 % factor
    # in another place of the whole image than the one before, as a crop is
    now, before = (rng.integers(0, 256, picture, dtype=np.uint8) for _ in range(2))
    now_view, before_view = (0, 0, *whole), (2 * factor, 3 * factor, whole[0] + 2 * factor, whole[1] + 3 * factor)
    x = np.array(boxes)
    # rounding decides whether a point on the border lies within
    for axis in (0, 1):
        cells = size[axis] * ((np.arange(grid[axis]) + 0.5) / grid[axis] - 0.5)
        rows = np.vstack([x, parent, np.add(parent, other[1] * (np.arange(3) == other[0]))])
        borders = [-0.5, now_view[2 + axis] - 0.5, before_view[2 + axis] - 0.5]
        points = rows[:, axis, None] + np.outer(rows[:, 2], cells)
        assume(np.abs(points[..., None] - borders).min() > 1e-6)
    # two parents that differ in one coordinate, with several children each
    of = np.tile(parent, (len(x), 1))
    of[split:, other[0]] += other[1]
    out = np.full(len(x), np.nan)
    how = (0.0 if kind == "l2" else 25.0), kind == "hausdorff", 1000.0
    kernel.patch_distances(now, now_view, before, before_view, factor, x, of, size, *grid, *how, out)
    for n in range(len(x)):
        a = naive.patch(now, now_view, factor, x[n], size, *grid)
        b = naive.patch(before, before_view, factor, of[n], size, *grid)
        # float32 places a point to within 1e-5 pixels, over which grey levels differ by up to 255
        assert out[n] == pytest.approx(naive.distance(a, b, kind, 25.0, 1000.0), rel=1e-3, abs=0.05)


@pytest.mark.parametrize("kind", DISTANCES)
def test_likelihood_is_the_formula_of_the_paper(kind):
    before, now = grey(texture(0)), grey(texture(0) * 0.9 + 20)
    likelihood = correlation(SIZE, kind, grid=(5, 4), sigma=60.0, saturation=15.0 if kind == "saturated_l1" else None)
    x, parent = [[70.3, 50.2, 1.1], [20.0, 30.0, 0.5], [150.0, 60.0, 1.0]], [71.0, 49.0, 1.05]
    factor = 8
    assert likelihood.init(before, states(parent)[0]).factor == factor, "40 / 5 pixels a step"
    greys = [f.grey(factor, (0, 0, WIDTH, HEIGHT)) for f in (now, before)]
    (a, b), view = [grey[0] for grey in greys], (0, 0, WIDTH, HEIGHT)
    assert all(grey[1:] == (0, 0) for grey in greys)
    for row, log_p in zip(x, scored(likelihood, before, now, x, parent), strict=True):
        here = naive.patch(a, view, factor, row, SIZE, 5, 4)
        there = naive.patch(b, view, factor, parent, SIZE, 5, 4)
        outside = {"l2": OUTSIDE**2, "saturated_l1": 15.0, "hausdorff": OUTSIDE}[kind]
        d = naive.distance(here, there, kind, 15.0, outside)
        assert log_p == pytest.approx(-d / (2 * 60.0**2 if kind == "l2" else 60.0), rel=1e-3)


def test_each_frame_takes_the_place_of_the_one_before():
    frames = [grey(texture(0)), grey(texture(1)), grey(moved(texture(1), 2, 0))]
    likelihood = correlation(SIZE)
    x, x2 = states([[80.3, 60.1, 1.0], [75.2, 61.7, 0.83]]), states([[82.3, 60.1, 1.0], [77.2, 61.7, 0.83]])
    learned = likelihood.init(frames[0], x[0])
    np.testing.assert_array_equal(likelihood.score(learned, Frame(1, 0.0, frames[0].bgr), x, x), 0.0)
    after = likelihood.learn(learned, frames[1], x[0])
    assert after.frame is frames[1]
    assert learned.frame is frames[0], "what was learned is a value"
    assert likelihood.score(after, frames[2], x2, x).min() > likelihood.score(learned, frames[2], x2, x).max()


@pytest.mark.parametrize("grid", [(16, 16), (60, 60)])
def test_a_parent_is_looked_up_wherever_it_was(grid):
    """Each frame is cut around the boxes that lie in it."""
    still = texture(0, 500, 400)
    before, now = grey(still), grey(moved(still, 2, 1))
    likelihood = correlation((64.0, 64.0), grid=grid)
    x, parent = [[420.0, 330.0, 1.0]], [60.0, 50.0, 1.4]
    cut = scored(likelihood, before, now, x, parent)
    whole = Frame(0, 0.0, before.bgr), Frame(1, 0.0, now.bgr)
    for f in whole:
        f.grey(likelihood.init(f, states([0, 0, 1.0])[0]).factor, (0, 0, 500, 400))
    np.testing.assert_array_equal(cut, scored(likelihood, *whole, x, parent))
