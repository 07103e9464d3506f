"""Windows with several templates: r against its twin, its peak, new templates, and what is visible."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from facetrack_cli.core.types import Particles
from facetrack_cli.trackers.face.landmark_kernels import NEW_BELOW, YOUNG, judge
from facetrack_cli.trackers.face.settings import Length, ShiftPerPart, WindowNccSettings
from facetrack_cli.trackers.face.window_ncc import WindowNcc, WindowState
from tests.support.images import frame
from tests.support.parts import section
from tests.twins import window_ncc as naive

PARTS = ("nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower")


def built(windows, parts=PARTS, reach=9.0, shift=(0.0, 0.0), **settings):
    """Windows (K, 2) and reach in pixels."""
    one = section(WindowNccSettings, reach=Length(reach, px=True), shift=ShiftPerPart(shift), **settings)
    placed = SimpleNamespace(windows=np.array(windows, float), unit=40.0)
    return WindowNcc(one, SimpleNamespace(placed=placed, settings=SimpleNamespace(points=parts)))


def texture(seed=0, size=(90, 120)):
    noise = np.random.default_rng(seed).uniform(0, 255, (*size, 3))
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return np.clip(128 + (smooth - smooth.mean()) * 35 / smooth.std(), 0, 255).round().astype(np.uint8)


def around(x0, spread=0.3, n=50, seed=0):
    x = x0 + np.random.default_rng(seed).normal(0, spread, (n, *x0.shape))
    return Particles(x, np.full(n, -np.log(n)))


def step(model, learned, image, x, says=2.0):
    """After one more frame with the parts at x (K, 2), of which a sensor `says` so much."""
    learned = model.look(learned, frame(image), x)
    learned = learned._replace(sensor_odds=np.full(learned.good.shape, says))
    return model.learn(learned, frame(image), x, around(x))


def test_r_is_what_the_plain_twin_says_for_several_templates_and_beyond_the_reach():
    first, now, reach = texture(0), texture(1), 6
    mixed = (0.6 * first + 0.4 * now).astype(np.uint8)
    model = built([[11, 7], [8, 9]], PARTS[:2], reach)
    x0 = np.array([[40.0, 30.0], [3.0, 84.0]])  # the second at the border
    learned = model.init(frame(first), x0)
    more = model.relearn(learned, frame(now), x0, np.array([True, True]))
    learned.templates.windows[:, 1] = more.templates.windows[:, 0]
    learned.templates.number[:] = 2
    learned = model.look(learned, frame(mixed), x0 + 0.3)
    rng = np.random.default_rng(2)
    x = x0 + rng.uniform(-reach, reach, (12, 2, 2))
    sides = [(11, 7), (9, 9)]  # windows have an odd number of pixels
    plain = [
        [naive.channels(image, *x0[k].astype(int).tolist(), *sides[k]) for image in (first, now)] for k in range(2)
    ]
    wanted = [[naive.between(mixed, plain[k], *one[k].tolist()) for k in range(2)] for one in x]
    np.testing.assert_allclose(model.correlation(learned, x), wanted, atol=2e-4)
    beyond = x0 + np.array([500.0, -3.0])
    edge = np.clip(beyond, x0 - reach, x0 + reach)
    np.testing.assert_allclose(
        model.correlation(learned, beyond[None]), model.correlation(learned, edge[None]), atol=1e-4
    )


@pytest.mark.parametrize("gain", [0.6, 1.5])
def test_the_peak_is_at_the_truth_whatever_the_light(gain):
    image, shift = texture(), np.array([4.0, -3.0])
    model = built([[15, 15], [21, 11]], PARTS[:2])
    x0 = np.array([[50.0, 40.0], [70.0, 52.0]])
    learned = model.init(frame(image), x0)
    moved = cv2.warpAffine(image, np.array([[1, 0, shift[0]], [0, 1, shift[1]]]), image.shape[1::-1])
    moved = np.clip(moved * gain, 0, 255).round().astype(np.uint8)
    learned = model.look(learned, frame(moved), x0)
    offsets = np.stack(np.meshgrid(*2 * [np.arange(-9, 9.01, 0.5)]), axis=2).reshape(-1, 1, 2)
    score = model.score(learned, frame(moved), x0 + offsets, x0 + offsets)
    np.testing.assert_array_equal(offsets[score.argmax(axis=0), 0], [shift, shift])
    assert model.correlation(learned, (x0 + shift)[None]).min() > 0.97


def test_a_shifted_window_lies_beside_its_part():
    image, x0 = texture(), np.array([[50.0, 40.0], [50.0, 40.0]])
    model = built([[15, 15], [15, 15]], PARTS[:2], shift={"nose": (0.0, 0.4), "default": (0.0, 0.0)})
    np.testing.assert_array_equal(model.shift, [[0, 6], [0, 0]])
    there = built([[15, 15], [15, 15]], PARTS[:2]).init(frame(image), x0 + np.array([[0, 6], [0, 0]]))
    learned = model.init(frame(image), x0)
    np.testing.assert_array_equal(learned.templates.windows, there.templates.windows)
    assert model.correlation(model.look(learned, frame(image), x0), x0[None]).min() > 0.999


def test_flat_images_and_particles_far_outside_or_nowhere_are_survived():
    x0 = np.array([[50.0, 40.0], [1.0, 88.0]])
    model = built([[15, 15], [9, 9]], PARTS[:2])
    far = np.array([[[1e7, -1e7], [-5e5, 3.0]], [[np.nan, np.nan], [3.0, 3.0]]])
    for first, now in (
        (texture(), np.full((90, 120, 3), 128, np.uint8)),
        (np.zeros((90, 120, 3), np.uint8), texture()),
    ):
        learned = model.init(frame(first), x0)
        for where in (x0, x0 + 4e6):
            seen = model.look(learned, frame(now), where)
            assert np.isfinite(model.score(seen, frame(now), far, far)).all()
            assert np.isfinite(model.distances(seen, frame(now), far)).all()
            later = model.learn(seen, frame(now), where, around(where))
            assert np.isfinite([later.good, later.beside, later.visible, later.usual_odds]).all()


def test_a_window_that_matches_nothing_says_as_little_as_one_that_is_hidden():
    model, image, x0 = built([[15, 15]], PARTS[:1]), texture(), np.array([[50.0, 40.0]])
    learned = model.look(model.init(frame(image), x0), frame(image), x0)
    x = x0 + np.random.default_rng(0).uniform(-9, 9, (200, 1, 2))
    hidden = model.score(learned._replace(visible=np.zeros(1)), frame(image), x, x)
    seen = model.score(learned, frame(image), x, x)
    r = model.correlation(learned, x)
    assert np.ptp(hidden[r < 0.3]) < 0.02, "nothing, where it is not like the part"
    assert seen.max() - np.median(seen) > 8
    np.testing.assert_allclose(seen[r < 0], np.log1p(-0.98) - 0.5 * 30, atol=0.01)


def one_part(image, templates=4):
    x = np.array([[60.0, 45.0]])
    model = built([[15, 15]], PARTS[:1], templates=templates)
    return model, model.init(frame(image), x), x


def with_patch(image, other, half=10):
    """`image` with a piece of another around the part."""
    image = image.copy()
    image[45 - half : 46 + half, 60 - half : 61 + half] = other[45 - half : 46 + half, 60 - half : 61 + half]
    return image


def test_a_look_that_is_new_gives_a_template_and_is_known_from_then_on():
    closed, opened = texture(0), with_patch(texture(0), texture(1))
    model, learned, x = one_part(closed)
    learned = step(model, learned, closed, x)
    assert learned.templates.number[0] == 1
    before = model.correlation(model.look(learned, frame(opened), x), x[None])[0, 0]
    learned = step(model, learned, opened, x, says=4.0)
    assert before < NEW_BELOW
    assert learned.templates.number[0] == 2
    assert model.correlation(model.look(learned, frame(opened), x), x[None])[0, 0] > 0.99
    for _ in range(5):
        learned = step(model, learned, opened, x, says=4.0)
    assert learned.templates.number[0] == 2, "it is not learned again"
    assert model.correlation(model.look(learned, frame(closed), x), x[None])[0, 0] > 0.99, "nor is the first one lost"


@pytest.mark.parametrize("stays", [1, YOUNG + 2])
def test_what_was_learned_of_a_part_that_hides_soon_after_is_forgotten(stays):
    closed, opened, cover = texture(0), with_patch(texture(0), texture(1)), with_patch(texture(0), texture(2), 24)
    model, learned, x = one_part(closed)
    learned = step(model, learned, closed, x)
    for _ in range(stays):
        learned = step(model, learned, opened, x, says=4.0)
    assert learned.templates.number[0] == 2
    for _ in range(4):
        learned = step(model, learned, cover, x, says=-4.0)
    assert learned.visible[0] < 0.1
    assert learned.templates.number[0] == (1 if stays < YOUNG else 2)


def test_of_too_many_templates_the_one_that_matched_least_goes_and_never_the_first():
    looks = [texture(0), *(with_patch(texture(0), texture(i)) for i in range(1, 5))]
    model, learned, x = one_part(looks[0], templates=3)
    first = learned.templates.windows[0, 0].copy()
    for look, times in ((0, 1), (1, 30), (2, 80), (3, 2), (2, 5)):
        for _ in range(times):
            learned = step(model, learned, looks[look], x, says=4.0)
    assert learned.templates.number[0] == 3
    np.testing.assert_array_equal(learned.templates.windows[0, 0], first)
    like = [model.correlation(model.look(learned, frame(look), x), x[None])[0, 0] for look in looks]
    assert min(like[i] for i in (0, 2, 3)) > 0.99 and like[1] < NEW_BELOW


def test_where_a_track_begins_again_the_frame_is_looked_at_and_not_the_first_one():
    first, other = texture(0), texture(3)
    model, learned, x = one_part(first)
    assert learned.maps is None
    again = model.learn(learned, frame(other), x, around(x))
    seen = model.learn(model.look(learned, frame(other), x), frame(other), x, around(x))
    np.testing.assert_array_equal(again.good, seen.good)
    np.testing.assert_array_equal(again.beside, seen.beside)
    assert again.maps is None and again.good[0] < learned.good[0]


@pytest.mark.parametrize("seed", range(20))
def test_what_is_learned_of_all_parts_in_one_call_is_the_plain_twin(seed):
    rng = np.random.default_rng(seed)
    k, most, n = 12, int(rng.integers(1, 5)), 40
    like, number, age = rng.uniform(-1, 1, (k, most)), rng.integers(1, most + 1, k), rng.integers(0, 9, (k, most))
    age[:, 0], used = 3, rng.uniform(0, 1, (k, most))
    good, beside, visible = rng.uniform(0.3, 1, k), rng.uniform(0, 0.8, k), rng.uniform(0, 1, k)
    odds, usual, at = rng.normal(0, 4, k), rng.normal(0, 2, k), rng.uniform(20, 30, (k, 2))
    x, log_w = at + rng.choice([0.3, 3.0]) * rng.standard_normal((n, k, 2)), np.log(rng.dirichlet(np.ones(n)))
    maps, corner = rng.uniform(-1, 1, (k, 9, 9)).astype(np.float32), np.round(at) - 4
    old = good.copy(), visible.copy(), usual.copy(), used.copy()
    new, forgets = np.empty(k, bool), np.empty(k, bool)
    there = like, number, age, maps, corner, beside, odds, at
    changes = judge(*there, x, log_w, 1.0, good, visible, usual, used, new, forgets)
    state = WindowState(None, None, None, None, None, None, maps=maps, corner=corner)
    r = WindowNcc.correlation(None, state, at[None])[0]
    for i in range(k):
        before = like[i], number[i], age[i], beside[i], odds[i], at[i], x[:, i], np.exp(log_w)
        plain = naive.learned(*before, *(one[i] for one in old), r[i], 1.0)
        mine = good[i], visible[i], usual[i], used[i], new[i], forgets[i]
        for one, other in zip(mine, plain, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-6)
    assert changes == (new.any() or forgets.any())
