"""Regions in large images, which are read reduced: the same scene has the same likelihood there, and in its place."""

import numpy as np
import pytest

from facetrack_cli.core.types import Frame
from tests.support.parts import contour, correlation, histogram

SIZE = (30.0, 36.0)
TRUTH = (70.5, 52.5)  # of a box over whole pixels, or its own histogram would peak beside it
MOVED = (72.5, 51.5)  # in the next frame
WIDTH, HEIGHT = 144, 112


def scene(centre, zoom=1):
    """A light head of four colours, and a dark ground that moves with it, in an image `zoom` times as large."""
    y, x = (np.mgrid[: HEIGHT * zoom, : WIDTH * zoom] - 0.5 * (zoom - 1)) / zoom
    x, y = x - centre[0], y - centre[1]
    # all borders are two pixels wide
    cover = np.clip((1 - np.hypot(x / (SIZE[0] / 2), y / (SIZE[1] / 2))) * SIZE[0] / 4 + 0.5, 0, 1)[..., None]
    upper, left = np.clip(0.5 - y / 2, 0, 1)[..., None], np.clip(0.5 - x / 2, 0, 1)[..., None]
    head = upper * (left * (90, 150, 250) + (1 - left) * (90, 235, 235)) + (1 - upper) * (
        left * (250, 160, 110) + (1 - left) * (235, 130, 235)
    )
    ground = np.stack([50 + 20 * np.sin(x / 9), 60 + 20 * np.cos(y / 8), 40 + 20 * np.sin((x + y) / 11)], axis=2)
    return Frame(0, 0.0, np.clip(head * cover + ground * (1 - cover), 0, 255).round().astype(np.uint8))


def enlarged(frame, zoom):
    return Frame(frame.index, frame.time_s, frame.bgr.repeat(zoom, axis=0).repeat(zoom, axis=1))


def states(places, zoom=1):
    """(N, 1, 6) of rows (cx, cy, s) of the small image, in one `zoom` times as large."""
    x = np.zeros((len(places), 1, 6))
    x[:, 0, :3] = places
    x[..., :2] = zoom * x[..., :2] + 0.5 * (zoom - 1)
    return x


MODELS = {
    "contour": lambda z, reduce: contour(
        (SIZE[0] * z, SIZE[1] * z), 3.0 * z, 8.0 * z, normals=24, threshold=8.0, outlier=0.05, max_size=reduce
    ),
    "histogram": lambda z, reduce: histogram(
        (SIZE[0] * z, SIZE[1] * z), regions=(2, 2), lambda_h=60.0, max_size=reduce
    ),
    "correlation": lambda z, reduce: correlation((SIZE[0] * z, SIZE[1] * z), sigma=60.0),
}


def scores(name, zoom, places, reduce=36, picture=scene):
    """(N,) at places of the small image, of which one `zoom` times as large is read; parents at the ground truth."""
    model = MODELS[name](zoom, reduce)
    before, now = picture(TRUTH, zoom), picture(MOVED, zoom)
    parents = states([(*TRUTH, 1.0)] * len(places), zoom)
    learned = model.init(before, parents[0])
    assert learned.factor == (1 if reduce is None and name != "correlation" else zoom)
    return model.score(learned, now, states(places, zoom), parents)[:, 0]


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("zoom", [2, 8])
def test_a_picture_of_larger_pixels_has_the_same_likelihood(name, zoom):
    """Wherever a box is, over the border too. The same to rounding."""
    rng = np.random.default_rng(zoom)
    places = rng.normal((*MOVED, 1.0), (20.0, 20.0, 0.3), (400, 3))
    places[:, 2] = np.abs(places[:, 2])
    small = scores(name, 1, places)
    large = scores(name, zoom, places, picture=lambda centre, z: enlarged(scene(centre), z))
    assert np.ptp(small) > 10
    np.testing.assert_allclose(large, small, atol=2e-3, rtol=1e-5)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize(("zoom", "reduce"), [(1, 36), (8, 36), (4, None)])
def test_the_peak_is_at_the_truth_in_pictures_of_any_size(name, zoom, reduce):
    """To 0.3 pixels of the small image."""
    steps = np.linspace(-3.0, 3.0, 25)
    off = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    log_p = scores(name, zoom, np.column_stack([off + MOVED, np.ones(len(off))]), reduce)
    # the mean of the posterior, since a histogram is flat over a pixel
    weight = np.exp(log_p - log_p.max())
    mean = weight @ off / weight.sum()
    assert np.abs(mean).max() < 0.3
    assert weight[np.abs(off).max(axis=1) > 2.9].max() < 0.2
