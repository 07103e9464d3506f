"""The colour template: its peak is at the ground truth, light does not move it, its options do what they say."""

import numpy as np
import pytest

from tests.support.images import frame
from tests.support.parts import colour_ratio
from tests.twins import points as naive


def texture(height=120, width=160, seed=0, blur=2.0, scale=1):
    import cv2

    noise = np.random.default_rng(seed).uniform(0, 255, (height, width, 3))
    smooth = cv2.GaussianBlur(noise, (0, 0), blur)
    smooth = 128 + (smooth - smooth.mean()) * 30 / smooth.std()
    picture = np.clip(smooth, 20, 180)
    if scale > 1:
        picture = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    return np.clip(picture, 0, 255).round().astype(np.uint8)


X0 = np.array([[60.3, 50.8], [100.0, 70.0]])
WINDOWS = np.array([[13.0, 13.0], [25.0, 21.0]])


def grid(reach=6, step=0.5):
    offsets = np.arange(-reach, reach + step / 2, step)
    dx, dy = np.meshgrid(offsets, offsets)
    return np.stack([dx.ravel(), dy.ravel()], axis=1)


@pytest.mark.parametrize("norm", ["channel", "pixel"])
@pytest.mark.parametrize(("robust", "scale"), [("l1", None), ("tukey", 0.3)])
def test_agrees_with_the_formula(norm, robust, scale):
    picture = texture()
    likelihood = colour_ratio(WINDOWS, norm=norm, robust=robust, scale=scale)
    learned = likelihood.init(frame(picture), np.round(X0))
    x = X0 + 2.7
    for i, (w, h) in enumerate(WINDOWS.astype(int)):
        template = naive.window(picture, *np.round(X0[i]), w, h)
        d = naive.colour_ratio_distance(picture, template, *x[i], robust, scale, norm=norm)
        sigma = 1.5 / template.mean()
        assert likelihood.score(learned, frame(picture), x[None])[0, i] == pytest.approx(-d / sigma, rel=1e-4)


def test_the_floor_bounds_from_below_and_leaves_good_matches_alone():
    picture = texture()
    plain, floored = colour_ratio(WINDOWS), colour_ratio(WINDOWS, floor=-10.0)
    learned = plain.init(frame(picture), X0)
    x = X0 + grid(reach=40, step=8)[:, None]
    a, b = plain.score(learned, frame(picture), x), floored.score(learned, frame(picture), x)
    assert a.min() < -12
    assert b.min() >= -10
    np.testing.assert_allclose(b, np.log(np.exp(a) + np.exp(-10.0)))
