"""The colour histogram: its peak is at the ground truth, it tells left from right, and says if there are no colours."""

from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.trackers.regions import likelihoods
from tests.support.images import frame, states
from tests.support.parts import histogram
from tests.twins import regions as naive

SIZE = (48.0, 60.0)
TRUTH = (101.3, 83.6)


def colours(hues, saturation=180, value=180):
    hsv = np.zeros((*np.shape(hues), 3), np.uint8)
    hsv[..., 0], hsv[..., 1], hsv[..., 2] = hues, saturation, value
    return cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR)


@cache
def scene(centre=TRUTH, scale=1.0, height=200, width=260):
    """A box whose nine sub-regions have hues of their own, on a ground of another hue."""
    rng = np.random.default_rng(0)
    hues = np.full((height, width), 128) + rng.integers(-3, 4, (height, width))
    w, h = SIZE[0] * scale, SIZE[1] * scale
    left, top = centre[0] - w / 2, centre[1] - h / 2
    patch = np.array([[11, 56, 78], [101, 11, 33], [56, 146, 168]])
    for i in range(int(top), int(top + h) + 2):
        for j in range(int(left), int(left + w) + 2):
            r, c = naive.cell(i, top, h, 3), naive.cell(j, left, w, 3)
            if r is not None and c is not None:
                hues[i, j] = patch[r, c] + rng.integers(-5, 6)
    return colours(hues)


def learned_at_truth(picture, **options):
    likelihood = histogram(SIZE, **options)
    return likelihood, likelihood.init(frame(picture), states([TRUTH])[0])


def noisy(seed, height=30, width=37):
    """Any colours, greys and darkness in patches of a few pixels."""
    small = np.random.default_rng(seed).integers(0, 256, (9, 9, 3), dtype=np.uint8)
    small[:2] = small[:2, :, :1]
    return cv2.resize(small, (width, height), interpolation=cv2.INTER_NEAREST)


places = st.lists(st.tuples(st.floats(-15, 50), st.floats(-15, 45), st.floats(0.02, 3)), min_size=1, max_size=4)


@settings(max_examples=12)
@given(
    seed=st.integers(0, 30),
    x=places,
    regions=st.sampled_from([(1, 1), (3, 3), (2, 4)]),
    bins=st.sampled_from([(8, 4, 1), (5, 3, 4), (7, 1, 0)]),
    factor=st.sampled_from([1, 2]),
)
def test_distance_agrees_with_the_formula(seed, x, regions, bins, factor):
    picture, size, x0 = noisy(seed), (11.0, 14.5), (17.2, 14.9, 1.0)
    likelihood = histogram(
        size, hue_bins=bins[0], saturation_bins=bins[1], regions=regions, value_bins=bins[2], max_size=16 // factor
    )
    learned = likelihood.init(frame(picture), states([x0])[0])
    assert learned.factor == factor

    small = frame(picture).reduced(factor, (0, 0, 99, 99))[0]
    codes = [
        [naive.bin_of(*map(int, pixel), *bins, 0.1, 0.2) for pixel in row]
        for row in cv2.cvtColor(small, cv2.COLOR_BGR2HSV)
    ]

    def there(box):
        box = ((box[0] - (factor - 1) / 2) / factor, (box[1] - (factor - 1) / 2) / factor, box[2] / factor)
        return naive.counts(codes, box, size, *regions)

    first, _ = there(x0)
    reference = {key: n / sum(first.values()) for key, n in first.items()}
    expected = [naive.squared_distance(*there(box), reference) for box in x]
    seen = likelihood.score(learned, frame(picture), states(x), states(x))
    np.testing.assert_allclose(seen[:, 0], -20 * np.array(expected), atol=2e-5)
    d = likelihood.distances(learned, frame(picture), states(x))[:, 0]
    np.testing.assert_allclose(d**2, expected, atol=2e-6)


@pytest.mark.parametrize("bins", [(8, 4, 1), (5, 3, 4), (7, 1, 0)])
def test_every_colour_goes_to_its_bin(bins):
    """Two colours share a bin if they do by the formula, at every threshold and every border of two bins."""
    numbers = {"hue_bins": bins[0], "saturation_bins": bins[1], "value_bins": bins[2]}
    likelihood = histogram((64.0, 64.0), regions=(1, 1), least_saturation=0.3, **numbers)
    learned = likelihood.init(frame(np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)),
                              states([(31.5, 31.5)])[0])  # fmt: skip
    hues, rest = np.arange(0, 180, 3), np.array([0, 1, 50, 51, 52, 76, 77, 84, 85, 86, 127, 128, 200, 254, 255])
    hsv = np.stack(np.meshgrid(hues, rest, rest, indexing="ij"), axis=-1).astype(np.uint8)
    ours = likelihood._codes(hsv.reshape(len(hues), -1, 3), learned.coloured, learned.colourless)
    theirs = [naive.bin_of(*map(int, pixel), *bins, 0.3, 0.2) for pixel in hsv.reshape(-1, 3)]
    pairs = set(zip(ours.ravel().tolist(), theirs, strict=True))
    assert len(pairs) == len(set(theirs)) == len(set(ours.ravel().tolist()))


@given(x=places, regions=st.sampled_from([(1, 1), (3, 3), (2, 4)]))
def test_areas_and_edges_are_those_of_the_twin(x, regions):
    hsv, ex, ey, area = histogram((12.0, 9.5), regions=regions)._read(frame(noisy(1, 25, 31)), states(x), 1)
    counts = [naive.counts(np.zeros((25, 31), int), box, (12.0, 9.5), *regions) for box in x]
    assert area.tolist() == [whole for _, whole in counts]
    seen = [sum(found.values()) for found, _ in counts]
    if hsv is None:
        assert not any(seen)
    else:
        assert ((ex[:, -1] - ex[:, 0]) * (ey[:, -1] - ey[:, 0])).tolist() == seen


def test_boxes_far_apart_are_counted_as_alone(monkeypatch):
    likelihood, learned = learned_at_truth(scene())
    x = states([(*TRUTH, 1), (20, 30, 1), (-90, 20, 1), (240.2, 180.7, 0.4)])
    together = likelihood.distances(learned, frame(scene()), x)
    monkeypatch.setattr(likelihoods, "MAX_CELLS", 0)
    np.testing.assert_array_equal(likelihood.distances(learned, frame(scene()), x), together)


def grey_scene(noise=0):
    value = cv2.cvtColor(scene(), cv2.COLOR_BGR2GRAY)
    value = np.clip((value.astype(float) - 90) * 3, 60, 250)[..., None].repeat(3, axis=2)
    value += np.random.default_rng(1).integers(-noise, noise + 1, value.shape)
    return value.round().astype(np.uint8)


@pytest.mark.parametrize("value_bins", [0, 1])
@pytest.mark.parametrize("noise", [0, 2])
def test_a_grey_clip_is_refused(value_bins, noise):
    with pytest.raises(InputError) as raised:
        histogram(SIZE, value_bins=value_bins).init(frame(grey_scene(noise), 7), states([TRUTH])[0])
    message = str(raised.value)
    assert message.startswith("frame 7: 0.")
    assert "% of the box's pixels have a hue, so a colour histogram cannot know it: use the recipe" in message
    assert message.endswith("recipe contour or contour_correlation, or --set likelihood.histogram.value_bins=8")
    assert "\n" not in message


def test_a_grey_box_in_a_clip_with_colours_and_a_dark_box():
    picture = scene().copy()
    picture[40:130, 60:140] = 128
    with pytest.raises(InputError, match=r"frame 0: 0\.0% of the box's pixels have a hue"):
        learned_at_truth(picture)
    likelihood, learned = learned_at_truth(scene() // 5, least_value=0.05)
    assert likelihood.distances(learned, frame(scene() // 5), states([TRUTH]))[0, 0] < 1e-3


def test_a_box_outside_the_picture_cannot_be_learned():
    with pytest.raises(InputError, match="frame 0: the box has no pixel of the image at 1/1 of its size"):
        histogram(SIZE).init(frame(scene()), states([(-100.0, 20.0)])[0])
