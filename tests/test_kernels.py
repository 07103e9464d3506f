"""Each kernel against its slow plain twin."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facetrack_cli import kernels
from tests import naive


def picture(seed, height=24, width=31):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


@settings(max_examples=60, deadline=None)
@given(
    x=st.floats(-12, 43),
    y=st.floats(-12, 36),
    w=st.sampled_from([3, 5, 9]),
    h=st.sampled_from([3, 7]),
    as_float=st.booleans(),
)
def test_window_is_bilinear_and_replicates_the_border(x, y, w, h, as_float):
    image = picture(1)
    seen = kernels.read_window(kernels.flat(image.astype(np.float32) if as_float else image), x, y, w, h)
    np.testing.assert_allclose(seen.reshape(h, w, 3), naive.window(image, x, y, w, h), atol=2e-3)


def test_window_at_whole_pixels_is_the_crop():
    image = picture(2)
    seen = kernels.read_window(kernels.flat(image), 10.0, 11.0, 5, 7).reshape(7, 5, 3)
    np.testing.assert_array_equal(seen, image[8:15, 8:13])


def test_window_that_touches_the_last_pixel_is_the_crop():
    image = picture(3)
    seen = kernels.read_window(kernels.flat(image), 28.0, 21.0, 5, 5).reshape(5, 5, 3)
    np.testing.assert_array_equal(seen, image[19:24, 26:31])


@settings(max_examples=60, deadline=None)
@given(
    robust=st.sampled_from(sorted(kernels.ROBUST)),
    scale=st.floats(0.02, 2.0),
    x=st.floats(-6, 36),
    y=st.floats(-6, 30),
    seed=st.integers(0, 20),
)
def test_distances_agree_with_the_formula(robust, scale, x, y, seed):
    image, w, h = picture(seed), 5, 7
    template = picture(seed + 100, h, w).astype(float)
    ratio = (template / template.mean()).astype(np.float32).ravel()
    out = np.empty(2)
    centres = np.array([[x, y], [12.25, 9.5]])
    kernels.colour_ratio_distances(
        kernels.flat(image), ratio, w, h, centres, 1.0, kernels.ROBUST[robust], scale, out
    )
    expected = [naive.colour_ratio_distance(image, template, *c, robust, scale) for c in centres]
    np.testing.assert_allclose(out, expected, rtol=2e-4, atol=2e-6)


def test_a_black_window_has_a_finite_distance():
    image = np.zeros((20, 20, 3), np.uint8)
    out = np.empty(1)
    template = np.ones(75, np.float32)
    kernels.colour_ratio_distances(kernels.flat(image), template, 5, 5, np.array([[9.0, 9.0]]), 1.0, 0, 0.2, out)
    assert out[0] == pytest.approx(1.0)
