"""The prediction of eq. 12 and 13: in pixels, against its twin, and where there is nothing to predict from."""

import math
from functools import partial

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.trackers.appearance.appearance import RANK, Patches, eta
from facetrack_cli.trackers.appearance.appearance_kernels import differences, gain, mapped
from facetrack_cli.trackers.appearance.settings import NoiseSettings, VelocitySettings
from tests.support.images import smooth
from tests.support.parts import affine_walk, appearance, changed, predicted
from tests.tracking.test_affine import frame, read_only, state
from tests.twins import guide as naive

SIZE = (50.0, 56.0)
PATCHES = Patches(SIZE)
MODEL = appearance(PATCHES)
WALK = affine_walk(2.0, 0.025)
GUIDE = predicted(WALK, PATCHES, VelocitySettings(), NoiseSettings())
HERE = state(120, 90)
PICTURE = smooth(5, 180, 240, 6.0)


def apart(one, other, size=SIZE):
    """Mean distance in pixels of the corners of two states (1, 6)."""
    return float(np.linalg.norm(np.subtract(naive.corners(one[0], size), naive.corners(other[0], size)), axis=1).mean())


def moved(x=0.0, y=0.0, scale=1.0, turn=0.0, stretch=0.0):
    """The image after the target HERE moved, and where that is."""
    c, s = scale * math.cos(math.radians(turn)), scale * math.sin(math.radians(turn))
    a = np.array([[c * (1 + stretch), -s], [s, c * (1 - stretch)]])
    middle, to = HERE[0, :2], HERE[0, :2] + (x, y)
    picture = cv2.warpAffine(
        PICTURE, np.column_stack([a, to - a @ middle]), PICTURE.shape[::-1], borderMode=cv2.BORDER_REFLECT
    )
    return frame(picture), np.concatenate([to, a.ravel()])[None]


def flow_of(guide=GUIDE, picture=None, here=HERE, seed=0):
    return guide.begin(np.random.default_rng(seed), frame(PICTURE) if picture is None else picture, here)


def ahead_of(guide, flow, now, learned=None):
    learned = MODEL.init(frame(PICTURE), HERE) if learned is None else learned
    return guide.predict(flow, now, partial(MODEL.error, learned), partial(MODEL.expected, learned))


MOTIONS = [
    *({"x": 4 * math.cos(a), "y": 4 * math.sin(a)} for a in np.arange(8) * math.pi / 4),
    {"scale": 1.07}, {"scale": 0.93}, {"turn": 5}, {"turn": -5}, {"stretch": 0.05},
    {"x": -3, "y": 2, "scale": 1.04, "turn": -3}, {"x": 9},
]  # fmt: skip


@pytest.mark.parametrize("towards", ["last", "appearance"])
@pytest.mark.parametrize("motion", MOTIONS)
def test_the_shift_points_to_the_truth(motion, towards):
    now, there = moved(**motion)
    guide = changed(GUIDE, velocity=VelocitySettings(samples=32 if towards == "last" else None, towards=towards))
    ahead = ahead_of(guide, flow_of(guide), now)
    assert ahead.state is HERE or (ahead.state == HERE).all()
    before, after = apart(HERE, there), apart(ahead.state + ahead.shift, there)
    assert before > 1.2 and after < 0.06, (before, after)  # at most 0.023


@given(
    st.integers(0, 10**6), st.integers(0, 40), st.sampled_from([1, 3, 30, 90]), st.integers(1, 45),
    st.sampled_from([0.0, 0.5, 3.0]),
)  # fmt: skip
def test_b_equals_the_plain_twin(seed, count, d, components, decay):
    rng = np.random.default_rng(seed)
    y = (rng.normal(size=(count + 3, d)) * 10 ** (-decay * np.arange(d) / d)).astype(np.float32)
    x, patch, wanted = rng.normal(size=(count, 6)), *rng.normal(size=(2, d)).astype(np.float32)
    chosen = rng.permutation(count + 3)[:count]
    rows, squares = differences(read_only(y), chosen, read_only(patch))
    np.testing.assert_array_equal(rows, y[chosen] - patch)
    np.testing.assert_allclose(squares, np.reshape(naive.products(rows), (count, count)), rtol=1e-4, atol=1e-4)
    np.testing.assert_array_equal(squares, squares.T)
    # where a singular value is cut off, or is not, by a hair, both are right
    values = np.linalg.svd(rows, compute_uv=False) if count else np.ones(1)
    near = np.append(values, 0)[min(components, len(values)) - 1 : components + 1]
    exact = rows.astype(np.float64) @ rows.astype(np.float64).T
    if (values < 3e-3 * values[0]).any() or (len(near) == 2 and near[0] - near[1] < 1e-3 * values[0]):
        assert np.isfinite(gain(x, exact, components, RANK)).all()
        return
    found = gain(x, exact, components, RANK) @ rows
    expected = naive.shift_matrix(x, rows, components) if count else np.zeros((6, d))
    np.testing.assert_allclose(found, expected, atol=1e-6 * max(np.abs(expected).max(), 1e-9))
    step = mapped(gain(x, exact, components, RANK), rows, patch - wanted)
    np.testing.assert_allclose(step, expected @ (patch - wanted), atol=1e-3 * (1 + np.abs(expected).max() * d))


FLAT = np.full_like(PICTURE, 90)


@pytest.mark.parametrize("last", [PICTURE, FLAT, PICTURE[:12, :16]])
@pytest.mark.parametrize("now", [PICTURE, FLAT, np.zeros_like(PICTURE)])
@pytest.mark.parametrize(
    "x",
    [
        np.repeat(HERE[None], 40, axis=0),
        HERE[None],
        np.repeat(state(-900, 4000)[None], 9, axis=0),
        np.concatenate([HERE[None], state(1e7, -1e7)[None], state(120, 90, 0, 0, 0, 0)[None], state(0, 0, 1e9)[None]]),
    ],
    ids=["all equal", "one", "outside", "wild"],
)
@pytest.mark.parametrize("velocity", [VelocitySettings(), VelocitySettings(towards="appearance", search=1.0), None])
def test_where_nothing_can_be_learned_nothing_is_wild(last, now, x, velocity):
    guide = changed(GUIDE, velocity=velocity)
    for here in (HERE, x[-1]):
        flow = guide.learn(frame(last), here, x)
        assert np.isfinite(flow.gain).all()
        ahead = ahead_of(guide, flow, frame(now))
        assert np.isfinite(ahead.shift).all() and np.isfinite(ahead.noise)
        assert ahead.error is not None and np.isfinite(ahead.error)
        if velocity is None or (velocity.search == 0 and len(np.unique(x, axis=0)) == 1 and (here == x[0]).all()):
            assert not ahead.shift.any()


@given(st.floats(0, 300), st.floats(0.1, 2), st.floats(0, 5), st.floats(0.5, 20))
def test_eta_equals_the_plain_twin_and_keeps_its_bounds(error, least, more, rate):
    found = eta(NoiseSettings(least=least, most=least + more, rate=rate), error)
    assert least <= found <= least + more + 1e-12
    assert found == pytest.approx(naive.eta(min(error, 300 * rate), least, least + more, rate))


@pytest.mark.parametrize(
    ("errors", "kept", "asked"),
    [
        ([5.0, 6.0], 0, 2),  # worse at once: none at all
        ([5.0, 4.0, 4.5], 1, 3),
        ([5.0, 4.0, 3.999], 2, 3),  # a hair better: it has settled, and it is the best
        ([5.0, 4.89, 4.78, 4.67, 4.56], 4, 5),  # falls by just above 2 % each
        ([0.0, 0.0], 0, 2),
    ],
)
def test_it_ends_when_the_error_settles_and_keeps_the_best(errors, kept, asked):
    now, _ = moved(x=4)
    flow, said = flow_of(), list(errors)
    guide = changed(GUIDE, velocity=VelocitySettings(iterations=asked - 1 if kept == 4 else 10))
    shifts, shift = [np.zeros((1, 6))], np.zeros((1, 6))
    for _ in range(asked - 1):
        difference = PATCHES.read(now, (HERE + shift)[None], 1)[0] - flow.patch
        shift = shift - (flow.gain @ (flow.rows @ difference))[None]
        shifts.append(shift)
    ahead = guide.predict(flow, now, lambda patches: np.array([said.pop(0)]), lambda: flow.patch)
    assert not said, "asked for as often as it should be"
    assert ahead.error == errors[kept]
    np.testing.assert_allclose(ahead.shift, shifts[kept], atol=1e-4)


def test_a_search_finds_what_jumped_and_no_worse_place():
    now, there = moved(x=30, y=-25)
    guide, searching = (changed(GUIDE, velocity=VelocitySettings(search=s)) for s in (0.0, 1.0))
    near, far = (ahead_of(one, flow_of(), now) for one in (guide, searching))
    assert apart(near.state + near.shift, there) > 20
    assert apart(far.state + far.shift, there) < 0.25
    still = ahead_of(changed(GUIDE, velocity=VelocitySettings(search=1.0, iterations=1)), flow_of(), frame(PICTURE))
    assert apart(still.state + still.shift, HERE) < 0.1
    # nor does it believe a match that the appearance does not
    flow, said = flow_of(), iter([1.0, 3.0, 4.0])
    ahead = searching.predict(flow, now, lambda patches: np.array([next(said)]), lambda: flow.patch)
    assert ahead.error == 1.0 and not ahead.shift.any()


def test_towards_the_appearance_corrects_what_the_last_frame_was_wrong_by():
    # the estimate of the last frame was 3 pixels off, and nothing moved
    wrong, picture = state(123, 90), frame(PICTURE)
    learned = MODEL.init(picture, HERE)
    for towards, off in (("last", 3.0), ("appearance", 0.0)):
        guide = changed(GUIDE, velocity=VelocitySettings(towards=towards))
        ahead = ahead_of(guide, flow_of(guide, here=wrong), picture, learned)
        assert apart(ahead.state + ahead.shift, HERE) == pytest.approx(off, abs=0.2)
