"""Bias filters of sensors, the detector's chain and landmarks without windows: against filters that are written out."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

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
from facetrack_cli.trackers.face.landmark_kernels import MAX_LOG_ODDS
from facetrack_cli.trackers.face.motion import SensorReading
from facetrack_cli.trackers.face.stabilized import EYES, MIDDLE, Similarity
from tests.twins import landmark_filters as twin

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
