"""Sensors of points: bias filters written out, landmarks without windows, and windows with several templates."""

from itertools import product
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.types import Particles
from facetrack_cli.trackers.face import landmark_filters, landmark_kernels
from facetrack_cli.trackers.face.landmark_filters import (
    MOTION,
    NO_FACE,
    NOISE,
    BiasFilter,
    Facing,
    LandmarkFilter,
    who_is_right,
)
from facetrack_cli.trackers.face.landmark_kernels import MAX_LOG_ODDS, NEW_BELOW, YOUNG, judge
from facetrack_cli.trackers.face.motion import SensorReading
from facetrack_cli.trackers.face.settings import Length, ShiftPerPart, WindowNccSettings
from facetrack_cli.trackers.face.stabilized import EYES, MIDDLE, Similarity
from facetrack_cli.trackers.face.window_ncc import WindowNcc, WindowState
from tests.support.images import frame
from tests.support.parts import section
from tests.twins import landmark_filters as twin
from tests.twins import window_ncc as naive

PLACES = np.array([[80.0, 100.0], [64.0, 120.0], [96.0, 120.0]])


# --- two sensors ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shown", [1.0, 0.7])
def test_rows_of_a_face_are_those_of_the_plain_twin(shown):
    rng = np.random.default_rng(5)
    root = rng.normal(size=(9, 2, 2)) * np.array([1, 1, 1, 9, 1, 1, 9, 1, 1])[:, None, None]
    head, face = root[8] @ root[8].T, Similarity(np.array([20.0, 60.0]), 1.3, 0.4)
    at, below = rng.uniform(20, 140, (4, 2)), np.array([0, 3, 0, 2])
    windows = at, root[:4] @ root[:4].transpose(0, 2, 1), rng.random(4), below, rng.random(4), rng.random((4, 2))
    carried, var, visible = rng.uniform(60, 140, (8, 2)), rng.uniform(0, 9, 8), rng.random(8)
    carried[7], visible[:3] = np.nan, 0.9
    landmarks = carried, rng.normal(size=(8, 2)), var, np.full(8, 2.0), visible
    for box in (0.0, 2.0):
        known = [face.turn.real, face.turn.imag, *face.centre, MIDDLE, 1.3, 9.0, shown, 0.5, 3, 150, 99, 7.5, 30]
        known = np.array([*known, 0.8, 50, 40, 12, 23, np.cos(0.4), np.sin(0.4), 3, np.nan, box])
        rows, how, corners = np.empty((14, 13)), np.empty(13, np.int64), np.empty((13, 4, 2))
        landmark_kernels.show(*windows, *landmarks, head, known, rows, how, corners)
        expected, hows, outlines = twin.shown(*windows, *landmarks, head, known)
        np.testing.assert_allclose(rows, expected, atol=1e-12)
        np.testing.assert_allclose(corners, outlines, atol=1e-12)
        assert how.tolist() == hows and set(hows) == {0, 1, 2} and how[4] == box


def test_who_is_right_is_the_sum_over_all_sets_of_readings_that_may_be():
    """Against integrals over the place of a part on a grid, for each set of those that are right."""
    rng, area, k = np.random.default_rng(5), 60.0**2, 3
    # of each sensor the places (K, 2), their variance, and how sure it is
    each = [(PLACES + 6 * rng.standard_normal((3, 2)), np.full(3, v), np.full(3, 0.9)) for v in (9.0, 16.0, 4.0)]
    readings = SensorReading(*map(np.stack, zip(*each, strict=True)), area)
    windows_see, regression_sees = rng.uniform(-3, 0, (8, k)), rng.uniform(-9, 5, (8, k))
    got = who_is_right(readings, windows_see, regression_sees)
    step = np.arange(-60, 60, 0.5)
    grid = np.stack(np.meshgrid(step, step), axis=2)
    for part in range(k):
        share = np.zeros(8)
        # the order of `modes`: the last reading says something in the first half
        for index, off in enumerate(product([False, True], repeat=3)):
            right, density, p = off[::-1], np.ones(grid.shape[:2]) / area, 1.0
            for is_off, (z, var, _) in zip(right, each, strict=True):
                if is_off:
                    p *= 0.1 / area
                else:
                    squared = np.sum((PLACES[part] + grid - z[part]) ** 2, axis=2)
                    density = density * 0.9 * np.exp(-0.5 * squared / var[part]) / (2 * np.pi * var[part])
            p *= 1.0 if all(off) else density.sum() * 0.25
            for scores in (windows_see, regression_sees):
                p *= np.exp(np.clip(scores[index, part] - scores[:-1, part].max(), -MAX_LOG_ODDS, 0))
            share[index] = p
        for i in range(3):
            says = (np.arange(8) >> i) % 2 == 0
            odds = np.log(share[says].sum() / share[~says].sum()) - np.log(0.9 / 0.1)
            assert got[i, part] == pytest.approx(odds, rel=1e-3, abs=1e-3)


# --- is the face turned to the camera? -----------------------------------------------------------------------------


@given(st.lists(st.sampled_from([True, False, None]), min_size=1, max_size=40), st.booleans())
def test_facing_is_the_exact_chain_of_two_states(looks, unseen):
    """The forward pass over [shown, away], with the rate of finds as it was counted; None: a frame without a look."""
    one = Facing().undetected() if unseen else Facing()
    p, (yes, no) = np.array([1.0, 0.0]), one.counts
    hide, show = landmark_filters._HIDE, landmark_filters._SHOW
    moves = np.array([[1 - hide, hide], [show, 1 - show]])
    for found in looks:
        one = one.predicted()
        p = p @ moves
        if found is not None:
            rate = yes / (yes + no)
            seen = np.array([rate, landmark_filters._FALSE])
            p = p * (seen if found else 1 - seen)
            p /= p.sum()
            yes, no = ((1 - 1 / 50) * count + p[0] * hit for count, hit in ((yes, found), (no, not found)))
            one = one.updated(detected=found)
        assert one.shown == pytest.approx(p[0])
        assert one.counts == pytest.approx((yes, no))


# --- landmarks without windows ---------------------------------------------------------------------------------------

REST = MIDDLE + 30 * np.random.default_rng(7).standard_normal((30, 2))
SHOWN = np.full(30, 4.0)
TURN = Similarity(np.array([83.0, 71.0]), 1.0, 0.3)


def similarity(rest, z, weight):
    """Where least squares lead `rest` (J, 2) to z: the unknowns a, b, c, d of (a x - b y + c, b x + a y + d)."""
    rows, values, roots = [], [], np.repeat(np.sqrt(weight), 2)
    for (x, y), (u, v) in zip(rest, z, strict=True):
        rows += [[x, -y, 1, 0], [y, x, 0, 1]]
        values += [u, v]
    rows = np.array(rows)
    found = np.linalg.lstsq(rows * roots[:, None], np.array(values) * roots, rcond=None)[0]
    return (rows @ found).reshape(-1, 2)


def moving_face(frames, rng, turn=0.01, s=MOTION, r=NOISE):
    """(T, J, 2) true places and what is measured of them: points of their own, carried by a face that turns."""
    own, true = s * rng.standard_normal(REST.shape), []
    for t in range(frames):
        own = 0.5 * own + np.sqrt(0.75) * s * rng.standard_normal(REST.shape)
        true.append(Similarity(np.array([MIDDLE + 0.2 * t, MIDDLE]), 1 + 0.002 * t, turn * t).to_frame(REST) + own)
    true = np.stack(true)
    return true, true + r * rng.standard_normal(true.shape)


def test_each_point_is_the_kalman_filter_that_is_written():
    rng = np.random.default_rng(1)
    _, zs = moving_face(30, rng)
    odds, bias = rng.uniform(-7, 7, (30, 30)), rng.uniform(0, 3, 30)
    least = EYES * rng.choice([0.002, 0.02, 0.1], 30)  # of what a point moves by itself: lids move fast
    one = LandmarkFilter.begin(zs[0], bias, least)
    rest, moved, before = zs[0].copy(), zs[0].copy(), [zs[0], zs[0]]
    off, var, s2 = np.zeros((30, 2)), np.full(30, (0.015 * EYES) ** 2), np.maximum(0.05 * EYES, least) ** 2
    r2, seen = var.copy(), np.ones(30)
    for t in range(1, 30):
        z = None if t % 7 == 3 else zs[t]
        for j in range(30):
            ahead = 0.99 * seen[j] + 0.1 * (1 - seen[j])
            for_it = ahead * np.exp(np.clip(odds[t, j], -4, 4))
            seen[j] = for_it / (for_it + 1 - ahead)
            off[j], var[j] = off[j] / 2, var[j] / 4 + 0.75 * s2[j]
        if z is not None:
            moved = similarity(rest, z, np.clip(seen, 0.001, 0.98))
            for j in range(30):
                gain = seen[j] * var[j] / (var[j] + r2[j])
                off[j] = off[j] + gain * (z[j] - moved[j] - off[j])
                var[j] = (1 - gain) * var[j]
                bend = z[j] - 2 * before[1][j] + before[0][j]
                rate = seen[j] / 100
                r2[j] += rate * (min(bend @ bend / 12, 4 * r2[j]) - r2[j])
                r2[j] = min(max(r2[j], (0.005 * EYES) ** 2), (0.05 * EYES) ** 2)
                s2[j] = max(s2[j] + rate * (off[j] @ off[j] / 2 - s2[j]), least[j] ** 2)
                rest[j] = rest[j] + rate / 4 * off[j]
            before = [before[1], z]
        one = one.after(z, odds[t])
        np.testing.assert_allclose(one.visible, seen)
        np.testing.assert_allclose(one.at, moved + off)
        np.testing.assert_allclose(one.var, var)
    for mine, written in ((one.rest, rest), (one.motion_var, s2), (one.noise_var, r2), (one.last, np.stack(before))):
        np.testing.assert_allclose(mine, written)
    np.testing.assert_allclose(one.cov[:, 0, 0], var + bias**2)


def test_in_another_stabilized_image_all_is_as_it_would_have_been_there():
    _, zs = moving_face(24, np.random.default_rng(5))
    here, there = LandmarkFilter.begin(zs[0]), None
    for t in range(1, 24):
        here = here.after(zs[t], SHOWN)
        if there is not None:
            there = there.after(TURN.to_frame(zs[t]), SHOWN)
        if t == 12:
            there = here.mapped(TURN.turn, complex(*TURN.centre) - TURN.turn * complex(MIDDLE, MIDDLE))
            np.testing.assert_allclose(there.at, TURN.to_frame(here.at))
    np.testing.assert_allclose(there.at, TURN.to_frame(here.at))
    for name in ("var", "motion_var", "noise_var", "visible"):
        np.testing.assert_allclose(getattr(there, name), getattr(here, name))


def test_a_belief_has_the_motion_that_the_filter_predicts_by():
    _, zs = moving_face(10, np.random.default_rng(6))
    before = LandmarkFilter.begin(zs[0])
    for z in zs[1:]:
        before = before.after(z, SHOWN)
    after = before.after(None, NO_FACE)
    mean, cov, motion, doubt, _ = after.belief()
    np.testing.assert_array_equal(mean, after.at)
    np.testing.assert_array_equal(cov, after.var[:, None, None] * np.eye(2))
    np.testing.assert_allclose(np.einsum("jde,je->jd", motion.matrix, before.at) + motion.offset, after.at)
    own = before.var[:, None, None] * np.eye(2)
    np.testing.assert_allclose(motion.matrix @ own @ motion.matrix + motion.cov, after.var[:, None, None] * np.eye(2))
    assert not doubt.any()
    for _ in range(30):
        after = after.after(None, NO_FACE)
    # what is unseen for long is known as its motion says: more would let a smoother add up what is wrong
    cov, motion = after.belief()[1:3]
    np.testing.assert_allclose(motion.matrix @ cov @ motion.matrix + motion.cov, cov)


# --- kernels and their twins -----------------------------------------------------------------------------------------


def any_readings(rng, z, x0):
    """Places (S, K, 2) of which some are missing, in a face of which some parts are hidden, with a filter of them."""
    z = np.where(rng.random(z.shape[:2])[..., None] < 0.25, np.nan, z)
    z[rng.integers(3)] = np.nan if rng.random() < 0.3 else z[0] + 1
    biases = BiasFilter.begin(z + rng.normal(0, 3, z.shape), x0, np.array([2.0, 3, 2]), np.ones(3), 0.98)
    error_rate, reliability = rng.uniform(0.01, 0.9, z.shape[:2]), rng.uniform(0.01, 0.99, z.shape[:2])
    return z, biases._replace(reliability=reliability, error_rate=error_rate)


@pytest.mark.parametrize("parts", [1, 2, 3, 14])
@pytest.mark.parametrize("seed", range(4))
def test_all_sensors_in_one_call_are_the_plain_twin(seed, parts):
    rng = np.random.default_rng(seed)
    at = MIDDLE + 30 * rng.standard_normal((parts, 2))
    spread = rng.choice([1.0, 6.0, 15.0])
    z, biases = any_readings(rng, at + rng.normal(0, 5, 2) + spread * rng.standard_normal((3, parts, 2)), at)
    visible, root = rng.choice([0.0, 0.3, 1.0], parts, p=[0.2, 0.2, 0.6]), rng.standard_normal((parts, 2, 2))
    cov = root @ root.transpose(0, 2, 1)
    readings, together, shift, apart = biases.reading(z, visible, at)
    for mine, plain in zip(readings[:3], twin.readings(z, visible, *biases[:5], biases.keep), strict=True):
        np.testing.assert_allclose(mine, plain, rtol=1e-9)
    assert shift.all() or parts < 14, "a head is moved"
    for mine, plain in zip((together, shift, apart), twin.fused(*readings[:3], at), strict=True):
        np.testing.assert_allclose(mine, plain, rtol=1e-9, atol=1e-9)
    odds = np.where(rng.random((4, parts)) < 0.5, np.nan, rng.normal(0, 4, (4, parts)))
    *all_, differ, cross = twin.compared(*readings[:3], at, cov, visible)
    asked, before = [], [values.copy() for values in biases[:5]]

    def judge(said, differs):
        asked.append(True)
        for mine, plain in zip((*said[:3], differs), (*all_, differ), strict=True):
            np.testing.assert_allclose(mine, plain, rtol=1e-9, atol=1e-9)
        return odds

    after, own = biases.updated(z, readings, at, cov, visible, judge)
    assert bool(asked) == differ.any()
    np.testing.assert_array_equal(np.nan if own is None else own, odds[-1] if asked else np.nan)
    said = odds[:-1] if asked else np.full((3, parts), np.nan)
    plain = twin.updated(z, at, cov, visible, said, cross, biases.min_std, biases.keep, *before)
    for mine, written, old in zip(after[:5], plain, biases[:5], strict=True):
        np.testing.assert_allclose(mine, written, rtol=1e-9, atol=1e-9)
        assert mine is not old
    for mine, old in zip(biases[:5], before, strict=True):
        np.testing.assert_array_equal(mine, old, err_msg="a state is not changed")


def test_places_in_another_stabilized_image_are_those_of_its_map():
    rng = np.random.default_rng(2)
    x, at, bias = rng.normal(80, 30, (7, 4, 2)), rng.normal(80, 30, (4, 2)), rng.normal(0, 3, (3, 4, 2))
    shift = TURN.to_frame(np.zeros(2))
    new = [np.empty_like(values) for values in (x, at, bias)]
    landmark_kernels.relay((TURN.turn.real, TURN.turn.imag, *shift), x, at, bias, *new)
    for mine, plain in zip(new, (TURN.to_frame(x), TURN.to_frame(at), TURN.to_frame(bias) - shift), strict=True):
        np.testing.assert_allclose(mine, plain, rtol=1e-12, atol=1e-10)


PARTS = ("nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower")


# --- windows with several templates


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
