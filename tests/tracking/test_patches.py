"""Patches of affine faces."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.types import MAX_REMEMBERED, Frame
from facetrack_cli.trackers.appearance.space import Patches, scale_of
from tests.twins import appearance as naive

SIZE, SHAPE = (26.0, 30.0), (30, 26)


def frame(grey):
    return Frame(0, 0.0, np.repeat(np.asarray(grey, np.uint8)[..., None], 3, axis=2))


def smooth(seed, height=120, width=160, sigma=3.0):
    noise = np.random.default_rng(seed).normal(size=(height, width))
    values = cv2.GaussianBlur(noise, (0, 0), sigma)
    return np.clip(128 + 45 * values / values.std(), 0, 255).astype(np.uint8)


def state(cx, cy, a1=1.0, a2=0.0, a3=0.0, a4=1.0):
    return np.array([[cx, cy, a1, a2, a3, a4]], np.float64)


def states(*rows):
    return np.stack([state(*row) for row in rows])


@given(
    st.integers(0, 10**6), st.sampled_from([1, 2, 4, 8]), st.tuples(st.integers(1, 40), st.integers(1, 40)),
    st.tuples(st.integers(1, 9), st.integers(1, 9)), st.sampled_from([0.02, 0.3, 1.0, 4.0]),
)  # fmt: skip
def test_patches_equal_the_plain_twin(seed, factor, picture, shape, spread):
    rng = np.random.default_rng(seed)
    width, height = picture
    grey = rng.integers(0, 256, (height, width))
    x = np.concatenate([rng.uniform(-0.3, 1.3, (6, 2)) * picture, rng.normal(scale=spread, size=(6, 4))], axis=1)
    x[:3, 2:] += (1, 0, 0, 1)
    size = tuple(rng.uniform(1, 30, 2).tolist())
    found = Patches(size, shape).read(frame(grey), x[:, None], factor)
    reduced, left, top = frame(grey).grey(factor, (0.0, 0.0, width, height))
    assert (left, top) == (0, 0)
    for y, row in zip(found, x, strict=True):
        expected = naive.patch(reduced, (0, 0, width, height), factor, row, size, shape)
        np.testing.assert_allclose(y, expected, atol=2e-3)


def test_a_fast_and_a_careful_reading_agree():
    # what lies inside is read without bounds; one particle at the border makes no other one different
    grey, patches = smooth(3), Patches((40.0, 50.0))
    inside = states((70, 60, 1.1, 0.2, -0.1, 0.9))
    both = np.concatenate([inside, states((3, 60)), states((-500, 900))])
    for factor in (1, 2):
        alone, together = patches.read(frame(grey), inside, factor), patches.read(frame(grey), both, factor)
        np.testing.assert_allclose(together[0], alone[0], atol=1e-4)


def test_a_patch_of_which_less_than_half_is_seen_is_blank():
    patches = Patches((20.0, 20.0), (10, 10))
    f = frame(smooth(5))
    # columns at -9, -7, ..., 9 from the centre: five of ten lie right of x = -0.5 at 0, four at -1.6
    y = patches.read(f, states((0.0, 60), (-1.6, 60), (-300, 60)), 1)
    assert np.any(y, axis=1).tolist() == [True, False, False]
    assert [patches.inside(f, state(v, 60)) for v in (0.0, -1.6, -300, 60)] == [0.5, 0.4, 0.0, 1.0]


def test_flat_is_below_half_a_grey_level():
    grey = np.full((60, 60), 100)
    grey[:, ::2] = 101
    assert not Patches((10.0, 10.0), (5, 5)).read(frame(np.full((60, 60), 9)), states((30, 30)), 1).any()
    # half of the points at 100, half at 101: the variance is exactly 0.25
    assert Patches((10.0, 10.0), (10, 10)).read(frame(grey), states((30.5, 30.5)), 1).any()
    grey[:, ::4] = 100
    assert not Patches((8.0, 8.0), (8, 8)).read(frame(grey), states((31.5, 31.5)), 1).any()


@pytest.mark.parametrize("wild", [np.nan, np.inf, -np.inf, 1e300, -1e300, 1e12, 1e-300, 0.0])
@pytest.mark.parametrize("factor", [1, 4])
def test_wild_states_are_survived_and_harm_no_other(wild, factor):
    patches, good = Patches((40.0, 50.0)), state(70, 60)
    rows = [np.where(np.arange(6) == k, wild, good) for k in range(6)] + [np.full((1, 6), wild)]
    y = patches.read(frame(smooth(7)), np.stack([*rows, good]), factor)
    assert np.isfinite(y).all()
    np.testing.assert_allclose(y[-1], patches.read(frame(smooth(7)), good[None], factor)[0], atol=1e-4)
    for row in rows:
        assert patches.factor(row) in {2**k for k in range(9)}
        assert np.isfinite(patches.read(frame(smooth(7)), row[None], patches.factor(row))).all()


def test_factor_keeps_points_one_to_two_pixels_apart():
    patches = Patches((52.0, 60.0))
    for scale in np.geomspace(0.1, 60, 200):
        angle = 0.3
        a = scale * np.array([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)])
        step = 2.0 * scale / patches.factor(state(0, 0, *a))
        assert step <= 2.0 + 1e-9
        assert step > 1.0 or patches.factor(state(0, 0, *a)) == 1
    # the side where points are closer decides
    assert patches.factor(state(0, 0, 4, 0, 0, 1)) == 1
    assert patches.factor(state(0, 0, 4, 0, 0, 3)) == 4


def test_the_same_face_is_the_same_patch_at_every_scale():
    patches, coarse = Patches((30.0, 34.0)), smooth(8, 100, 120, 4)
    reference = patches.read(frame(coarse), states((59.5, 49.5)), patches.factor(state(0, 0)))[0]
    for scale in (2, 3, 4, 6, 8):
        large = cv2.resize(coarse, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        large = np.clip(large + np.random.default_rng(0).normal(scale=20, size=large.shape), 0, 255)
        there = state(*((v + 0.5) * scale - 0.5 for v in (59.5, 49.5)), scale, 0, 0, scale)
        y = patches.read(frame(large), there[None], patches.factor(there))[0]
        assert patches.factor(there) >= scale / 2
        assert float(np.mean(y * reference)) > 0.97


def test_the_frame_remembers_the_last_patches():
    f, patches, x = frame(smooth(9)), Patches(SIZE), states((70, 60), (71, 60))
    first = patches.read(f, x, 1)
    assert patches.read(f, x, 1) is first
    assert Patches((26.0, 30.0), (30, 26)).read(f, x, 1) is first
    assert patches.read(f, x.copy(), 1) is not first
    assert patches.read(f, x, 2) is not first
    assert patches.read(frame(smooth(9)), x, 1) is not first
    assert Patches((26.0, 31.0)).read(f, x, 1) is not first
    with pytest.raises(ValueError, match="read-only"):
        first[0, 0] = 1
    # a single state is asked for again and again, each time in another array
    single = patches.read(f, state(70, 60), 1)
    assert patches.read(f, states((70, 60)), 1) is single
    assert patches.read(f, states((71, 60)), 1) is not single
    # arrays that are gone give their id to others: each must be read again
    for k in range(3 * MAX_REMEMBERED):
        y = patches.read(f, states((70 + k, 60), (60, 50)), 1)
        np.testing.assert_array_equal(y, patches.read(frame(smooth(9)), states((70 + k, 60), (60, 50)), 1))
    assert len(f._patches) <= MAX_REMEMBERED


def test_scale_is_that_of_a_similarity_and_1_at_the_start():
    x = states((0, 0), (5, 5, 0, -3, 3, 0), (0, 0, 1, 0, 0, 0))
    assert scale_of(x)[:, 0] == pytest.approx([1, 3, np.sqrt(0.5)])
    assert scale_of(x).shape == (3, 1)


def test_the_factor_of_a_sheared_box_goes_by_where_its_sides_go():
    # a column is a step of 8 pixels by (a1, a3), a row one of 8 by (a2, a4)
    patches = Patches((8.0 * 26, 8.0 * 30))
    assert patches.factor(state(0, 0, 1, 0, 0, 1)) == 4
    assert patches.factor(state(0, 0, 0.2, 5, 0.2, 5)) == 2  # columns are close to each other
    assert patches.factor(state(0, 0, 5, 0.2, 5, 0.2)) == 2  # rows are
    assert patches.factor(state(0, 0, 5, 5, 0.2, 0.2)) == 32
