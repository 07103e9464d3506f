"""What is known of a sensor of points, and of a detector of faces: against chains written out, and where they must not
learn."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.trackers.face import sensors
from facetrack_cli.trackers.face.motion import SensorReading
from facetrack_cli.trackers.face.sensors import (
    AREA,
    ASTRAY,
    BLIND,
    DRIFT,
    ENDS,
    FADES,
    LIMITS,
    MAX_NOISE,
    MISLED,
    REGRESSION,
    SLIP,
    SURE,
    TOLD,
    Facing,
    Sensor,
    common_shift,
    joined,
    who_is_right,
)
from facetrack_cli.trackers.face.stabilized import EYES, SIDE

PLACES = np.array([[80.0, 100.0], [64.0, 120.0], [96.0, 120.0]])
VISIBLE = np.ones(3)
EXACT = np.broadcast_to(0.2 * np.eye(2), (3, 2, 2))  # covariance of the filter's state
AWAY = np.array([[3.0, -1.5], [-2.0, 2.5], [0.0, 4.0]])
FAR_AWAY, TOGETHER = np.array([20.0, 0.0]), np.array([6.0, -3.0])


def begun(z, x0, std, least=REGRESSION):
    return Sensor.begin(z, x0, std, least)


def fed(sensor, offset, frames, rng, noise=1.0, visible=VISIBLE, cov=EXACT, every=1):
    """After `frames` in which the sensor says where the parts are, plus an offset and noise."""
    for t in range(frames):
        z = PLACES + offset + noise * rng.standard_normal((3, 2))
        z = z if t % every == 0 else np.full((3, 2), np.nan)
        sensor = sensor.learned(z, PLACES + np.sqrt(0.2) * rng.standard_normal((3, 2)), cov, visible)
    return sensor


@pytest.mark.parametrize("keep", [1.0, FADES])
def test_the_bias_is_the_kalman_filter_of_an_offset_that_drifts_and_may_fade(keep):
    """In frames in which it is right, which is a chain of two states."""
    rng = np.random.default_rng(1)
    one = Sensor.begin(PLACES + AWAY, PLACES, 2.5, REGRESSION, keep)
    mean, var, r2 = AWAY.copy(), np.full(3, 2.5**2), np.full(3, 2.5**2)
    right, wrong = np.full(3, SURE), np.full(3, 1 - SURE)
    np.testing.assert_allclose(one.bias, mean)
    for _ in range(25):
        z = PLACES + AWAY + 1.5 * rng.standard_normal((3, 2))
        z[rng.random(3) < 0.2] += 14.0
        said = one.measured(z, VISIBLE)
        np.testing.assert_allclose(said.z, z - keep * mean)
        np.testing.assert_allclose(said.var, keep**2 * var + DRIFT**2 + r2)
        common = np.median(z - keep * mean - PLACES, axis=0)  # the head's, not the sensor's
        for k in range(3):
            predicted = keep**2 * var[k] + DRIFT**2
            mean[k] *= keep
            off = z[k] - mean[k] - PLACES[k]
            total = predicted + r2[k] + 0.2
            own = off - common
            here, far = (np.exp(-0.5 * own @ own / v) / (2 * np.pi * v) for v in (total, total + ASTRAY**2))
            ahead = right[k] * (1 - ENDS * wrong[k] / (1 - wrong[k])) + (1 - right[k]) * ENDS
            odds = ahead / (1 - ahead) * np.clip(here / far, np.exp(-TOLD), np.exp(TOLD))
            right[k] = odds / (1 + odds)
            wrong[k] = np.clip(wrong[k] + 0.01 * (1 - right[k] - wrong[k]), *LIMITS)
            if off @ off / 2 >= 9 * (predicted + r2[k] + 0.2):
                var[k] = predicted
                continue
            gain = right[k] * predicted / total
            mean[k] = mean[k] + gain * off
            var[k] = (1 - gain) * predicted
            r2[k] = np.clip(r2[k] + 0.02 * right[k] * (off @ off / 2 - r2[k]), REGRESSION**2, MAX_NOISE**2)
        one = one.learned(z, PLACES, EXACT, VISIBLE)
    np.testing.assert_allclose(one.bias, mean)
    np.testing.assert_allclose(one.var, var)
    np.testing.assert_allclose(one.noise, r2)
    np.testing.assert_allclose(one.right, right)
    np.testing.assert_allclose(one.wrong, wrong)


def test_a_bias_of_a_start_that_a_sensor_placed_fades_while_nothing_is_measured_and_that_of_a_hand_stays():
    hand, placed = (Sensor.begin(PLACES + AWAY, PLACES, 2.5, REGRESSION, keep) for keep in (1.0, FADES))
    for _ in range(60):
        hand, placed = (one.learned(np.full((3, 2), np.nan), PLACES, EXACT, VISIBLE) for one in (hand, placed))
    np.testing.assert_array_equal(hand.bias, AWAY)
    np.testing.assert_allclose(placed.bias, FADES**60 * AWAY)


@pytest.mark.parametrize(
    ("noise", "least", "most"),
    [(0.0, REGRESSION, REGRESSION), (1.2 * REGRESSION, REGRESSION, MAX_NOISE), (1.6 * MAX_NOISE, MAX_NOISE, MAX_NOISE)],
)
def test_the_noise_follows_how_far_measurements_are_off_within_its_bounds(noise, least, most):
    after = fed(begun(PLACES, PLACES, 0.07 * EYES), 0.0, 600, np.random.default_rng(2), noise)
    assert (np.sqrt(after.noise) >= 0.98 * least).all() and (np.sqrt(after.noise) <= most + 1e-9).all()
    if least < most:
        np.testing.assert_allclose(np.sqrt(after.noise), noise, rtol=0.35)


@pytest.mark.parametrize("how", ["all hidden", "another hidden", "far off", "not seen"])
def test_it_is_not_misled_by_what_says_nothing_of_the_part(how):
    """What covers a part moves what a sensor says of all of them; it is not how the sensor usually errs."""
    rng = np.random.default_rng(3)
    before = fed(begun(PLACES, PLACES, 2.0), 0.0, 50, rng)
    visible = {"all hidden": np.zeros(3), "another hidden": np.array([1.0, 0.0, 1.0])}.get(how, VISIBLE)
    offset = {"far off": 40.0, "not seen": np.nan}.get(how, 5.0)
    after = fed(before, offset, 80, rng, visible=visible)
    np.testing.assert_allclose(after.bias, before.bias, atol=1e-9)
    np.testing.assert_allclose(after.noise, before.noise, atol=1e-9)
    assert (after.var > before.var).all(), "meanwhile it is less known"


def test_what_it_says_of_a_part_depends_on_how_visible_that_is():
    one = begun(PLACES, PLACES, 2.0)
    seen, hidden = (one.measured(PLACES, np.array([1.0, 1.0, v])) for v in (1.0, 0.0))
    np.testing.assert_allclose(seen.sure, SURE)
    np.testing.assert_allclose(hidden.sure, [SURE, SURE, SURE * BLIND])
    np.testing.assert_allclose(seen.var, one.var + DRIFT**2 + one.noise)
    np.testing.assert_allclose(hidden.var, seen.var + MISLED**2, err_msg="all are placed together")


def test_a_part_that_the_sensor_does_not_know_has_no_bias_and_is_not_measured():
    z = PLACES.copy()
    z[1] = np.nan
    one = begun(z, PLACES - 1.0, 3.0)
    np.testing.assert_allclose(one.bias, [[1, 1], [0, 0], [1, 1]])
    assert one.var[1] == pytest.approx(MAX_NOISE**2) and one.var[0] == pytest.approx(9.0)
    said = one.measured(z, VISIBLE)
    assert said.sure[1] == 0 and np.isfinite(said.z).all()
    after = one.learned(z, PLACES, EXACT, VISIBLE)
    assert np.isfinite([*after.bias.ravel(), *after.var, *after.noise]).all() and after.noise[1] == one.noise[1]


def test_a_sensor_that_takes_something_else_for_a_part_is_believed_again_when_it_is_back():
    """Of the part alone; how often it does is learned."""
    rng, astray = np.random.default_rng(4), np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 10.0]])
    good = fed(begun(PLACES, PLACES, 2.0), 0.0, 100, rng)
    gone = fed(good, astray, 3, rng)
    assert (gone.right > 0.5).tolist() == [True, True, False] and gone.measured(PLACES, VISIBLE).sure[2] < 0.2
    back = fed(fed(good, astray, 30, rng), 0.0, 4, rng)
    assert (back.measured(PLACES, VISIBLE).sure > 0.9).all()
    np.testing.assert_allclose(back.bias, good.bias, atol=1.0)
    often = good
    for _ in range(10):
        often = fed(fed(often, astray, 20, rng), 0.0, 10, rng)
    assert often.wrong[2] > 0.5 > 0.02 > often.wrong[:2].max()


def test_windows_that_see_a_part_elsewhere_speak_against_a_sensor():
    sensor = begun(PLACES, PLACES, 2.0)
    told = [sensor.learned(PLACES, PLACES, EXACT, VISIBLE, np.full(3, said)).right[0] for said in (-9.0, -3.0, 0.0)]
    assert told[0] < 0.5 < told[1] < told[2]
    hidden = sensor.learned(PLACES, PLACES, EXACT, np.zeros(3), np.full(3, -9.0))
    assert (hidden.right > 0.9).all(), "of what is hidden they say nothing"


# --- two sensors ----------------------------------------------------------------------------------------------------


def said(z, var, sure):
    return SensorReading(np.asarray(z, float), np.full(3, var), np.full(3, sure), SIDE**2 / 4)


def test_two_sensors_that_agree_are_one_that_is_more_exact():
    """As the product of their normal densities, where both are sure."""
    both = joined(said(PLACES, 4.0, 1.0), said(PLACES + 1.0, 1.0, 1.0))
    np.testing.assert_allclose(both.z, PLACES + 0.8)
    np.testing.assert_allclose(both.var, 1 / (1 / 4 + 1))
    np.testing.assert_allclose(both.sure, 1.0)


def test_of_two_sensors_the_one_that_says_nothing_does_not_count():
    one, other = said(PLACES, 4.0, 0.9), said(PLACES + 1.0, 1.0, 0.0)
    np.testing.assert_allclose(joined(one, other).z, PLACES)
    np.testing.assert_allclose(joined(one, other).sure, 0.9)
    np.testing.assert_allclose(joined(other, one).z, PLACES)
    neither = joined(other, other)
    assert np.isfinite([*neither.z.ravel(), *neither.var]).all() and (neither.sure == 0).all()


def test_where_two_sensors_are_far_apart_the_second_is_believed():
    far = joined(said(PLACES, 4.0, 0.9), said(PLACES + FAR_AWAY, 1.0, 0.9))
    np.testing.assert_allclose(far.z, PLACES + FAR_AWAY)
    np.testing.assert_allclose(far.sure, 0.9)


def test_what_all_parts_move_together_is_the_head_s_and_what_one_moves_is_not():
    var = 4.0
    moved = common_shift(said(PLACES + TOGETHER, var, 0.9), PLACES)
    np.testing.assert_allclose(moved, TOGETHER * SLIP**2 / (SLIP**2 + var))
    opened = PLACES.copy()
    opened[2, 1] += 15.0
    np.testing.assert_allclose(common_shift(said(opened, var, 0.9), PLACES), 0, atol=1e-9)
    two = said(PLACES + 6.0, var, 0.9)._replace(sure=np.array([0.9, 0.9, 0.2]))
    np.testing.assert_array_equal(common_shift(two, PLACES), 0)


def test_who_is_right_is_the_sum_over_all_sets_of_readings_that_may_be():
    """Against integrals over the place of a part on a grid, for each set of those that are right."""
    rng, area, k = np.random.default_rng(5), 60.0**2, 3
    one, two, windows = (said(PLACES + 6 * rng.standard_normal((3, 2)), v, 0.9) for v in (9.0, 16.0, 4.0))
    readings = [each._replace(area=area) for each in (one, two, windows)]
    windows_see, regression_sees = rng.uniform(-3, 0, (8, k)), rng.uniform(-9, 5, (8, k))
    got = who_is_right(readings, windows_see, regression_sees)
    step = np.arange(-60, 60, 0.5)
    grid = np.stack(np.meshgrid(step, step), axis=2)
    for part in range(k):
        share = np.zeros(8)
        # the order of `modes`: the last reading says something in the first half
        for index, off in enumerate(product([False, True], repeat=3)):
            right, density, p = off[::-1], np.ones(grid.shape[:2]) / area, 1.0
            for is_off, each in zip(right, readings, strict=True):
                if is_off:
                    p *= 0.1 / area
                else:
                    squared = np.sum((PLACES[part] + grid - each.z[part]) ** 2, axis=2)
                    density = density * 0.9 * np.exp(-0.5 * squared / each.var[part]) / (2 * np.pi * each.var[part])
            p *= 1.0 if all(off) else density.sum() * 0.25
            for scores in (windows_see, regression_sees):
                p *= np.exp(np.clip(scores[index, part] - scores[:-1, part].max(), -TOLD, 0))
            share[index] = p
        for i in range(3):
            says = (np.arange(8) >> i) % 2 == 0
            odds = np.log(share[says].sum() / share[~says].sum()) - np.log(0.9 / 0.1)
            assert got[i, part] == pytest.approx(odds, rel=1e-3, abs=1e-3)


@pytest.mark.parametrize(("second", "windows_right"), [(FAR_AWAY, False), (0.0, True), (-FAR_AWAY, True)])
def test_what_two_sensors_say_alike_is_believed_though_windows_prefer_another_place(second, windows_right):
    one, two = said(PLACES + FAR_AWAY, 9.0, 0.97), said(PLACES + second, 9.0, 0.97)
    windows = said(PLACES, 1.0, 0.97)
    readings = [each._replace(area=AREA) for each in (one, two, windows)]
    there = np.array([-9.0 if (set_ >> 2) % 2 else 0.0 for set_ in range(8)])
    odds = who_is_right(readings, np.repeat(there[:, None], 3, axis=1)) + np.log(0.97 / 0.03)
    assert ((odds[2] > 0) == windows_right).all() and ((odds[0] < 0) == windows_right).all()


# --- is the face turned to the camera? -----------------------------------------------------------------------------


@given(st.lists(st.sampled_from([True, False, None]), min_size=1, max_size=40), st.booleans())
def test_facing_is_the_exact_chain_of_two_states(looks, unseen):
    """The forward pass over [shown, away], with the rate of finds as it was counted; None: a frame without a look."""
    one = Facing().unseen() if unseen else Facing()
    p, (yes, no) = np.array([1.0, 0.0]), one.found
    moves = np.array([[1 - sensors._HIDE, sensors._HIDE], [sensors._SHOW, 1 - sensors._SHOW]])
    for found in looks:
        one = one.predicted()
        p = p @ moves
        if found is not None:
            rate = yes / (yes + no)
            seen = np.array([rate, sensors._FALSE])
            p = p * (seen if found else 1 - seen)
            p /= p.sum()
            yes, no = ((1 - 1 / 50) * count + p[0] * hit for count, hit in ((yes, found), (no, not found)))
            one = one.looked(found=found)
        assert one.shown == pytest.approx(p[0])
        assert one.found == pytest.approx((yes, no))
