"""The pose of a head from its points, by a slow twin and Monte Carlo; spans of motion on tracks of known motion."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.trajectory.head import SHAPE, SPREAD, euler, fit_pose, head_motion, head_pose, rotation_of
from facetrack_cli.trajectory.trajectory import one_part
from tests.twins import head_pose as twin

FIVE = ("eye_left", "eye_right", "nose", "mouth_left", "mouth_right")
MOUTH = ("nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower")  # what the shipped recipes follow
ANGLE = st.floats(-40, 40)


def table(names, of):
    return np.array([of[name] for name in names])


def seen_from(angles, names=FIVE, scale=1.5, place=(300.0, 200.0), shape=None):
    """(T, K, 2) points of the face at angles (T, 3) in degrees."""
    shape = table(names, SHAPE) if shape is None else shape
    turned = np.einsum("tij,...kj->tki", rotation_of(np.radians(angles))[:, :2], shape)
    return scale * turned + np.array(place)


def fit(xy, names=FIVE, std=0.5, seen=None, spread=None):
    cov = np.broadcast_to(std**2 * np.eye(2), (*xy.shape, 2))
    seen = np.ones(xy.shape[:2], bool) if seen is None else seen
    return fit_pose(xy, cov, seen, table(names, SHAPE), table(names, SPREAD if spread is None else spread))


@given(ANGLE, ANGLE, st.floats(-170, 170), st.floats(0.2, 20))
def test_a_turned_shape_gives_its_pose_back(pitch, yaw, roll, scale):
    angles = np.array([[pitch, yaw, roll]])
    np.testing.assert_allclose(np.degrees(euler(rotation_of(np.radians(angles)))), angles, atol=1e-9)
    for names in (FIVE, MOUTH, tuple(SHAPE)):
        found, _, size, origin, ambiguous, _ = fit(seen_from(angles, names, scale), names, std=0.01 * scale)
        np.testing.assert_allclose(found, angles, atol=0.01)
        np.testing.assert_allclose(size, scale, rtol=1e-4)
        np.testing.assert_allclose(origin[0], (300, 200), atol=0.01 * scale)
        assert not ambiguous.any()


def test_signs_are_those_of_the_camera_s_axes():
    nose, eyes = table(["nose"], SHAPE), table(["eye_left", "eye_right"], SHAPE)
    straight, down, left, tilted = (rotation_of(np.radians(a)) for a in ([0, 0, 0], [20, 0, 0], [0, 20, 0], [0, 0, 20]))
    assert (down @ nose[0] - straight @ nose[0])[1] > 0  # y points down
    assert (left @ nose[0])[0] < 0
    assert (tilted @ eyes[1])[1] > (tilted @ eyes[0])[1]  # clockwise: the eye on the right sinks


@pytest.mark.parametrize("names", [FIVE, MOUTH])
def test_a_slow_plain_twin_agrees(names):
    rng = np.random.default_rng(3)
    angles = rng.uniform(-30, 30, (1, 3))
    xy = seen_from(angles, names) + rng.normal(0, 1, (1, 5, 2))
    cov = np.broadcast_to(np.array([[1.0, 0.2], [0.2, 0.8]]), (*xy.shape, 2))
    shape, spread = table(names, SHAPE), table(names, SPREAD)
    found, covariance, scale, origin, *_ = fit_pose(xy, cov, np.ones(xy.shape[:2], bool), shape, spread)
    pose, wide = twin.fit(xy[0], cov[0], shape, spread)
    np.testing.assert_allclose(np.degrees(pose[:3]), found[0], atol=1e-3)
    np.testing.assert_allclose([np.exp(pose[3]), *pose[4:]], [scale[0], *origin[0]], rtol=1e-4)
    np.testing.assert_allclose(np.degrees(np.degrees(wide[:3, :3])), covariance[0], rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize(("names", "angles"), [(FIVE, (12, -20, 8)), (MOUTH, (-15, 25, -30))])
def test_the_spread_is_what_noise_of_points_and_people_makes(names, angles):
    rng, count, scale = np.random.default_rng(7), 1000, 1.5
    shapes = table(names, SHAPE) + rng.normal(0, 1, (count, 5, 3)) * table(names, SPREAD)
    turned = np.einsum("ij,nkj->nki", rotation_of(np.radians(np.array(angles)))[:2], shapes)
    points = scale * turned + 200 + rng.normal(0, 1.0, (count, 5, 2))
    found, covariance, *_ = fit(points, names, std=1.0)
    same = seen_from(np.array([angles]), names) + rng.normal(0, 1.0, (count, 5, 2))
    poses, *_, of_points = fit(same, names, std=1.0)
    alone = np.sqrt(np.median(np.diagonal(of_points, axis1=1, axis2=2), axis=0))
    np.testing.assert_allclose(np.std(poses, axis=0), alone, rtol=0.1)
    claimed = np.sqrt(np.median(np.diagonal(covariance, axis1=1, axis2=2), axis=0))
    np.testing.assert_allclose(np.std(found, axis=0), claimed, rtol=0.15)
    z = np.abs(found - angles) / np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    assert ((z < 1).mean(axis=0) > 0.62).all() and ((z < 2).mean(axis=0) > 0.9).all()
    assert np.abs(found.mean(axis=0) - angles).max() < 1.5


def test_small_faces_in_noise_are_ambiguous_and_say_so():
    rng = np.random.default_rng(5)
    angles = np.tile([0.0, 25.0, 0.0], (400, 1))

    def share(scale):
        xy = seen_from(angles, MOUTH, scale) + rng.normal(0, 1.0, (400, 5, 2))
        found, covariance, _, _, ambiguous, _ = fit(xy, MOUTH, std=1.0)
        return ambiguous.mean(), (np.abs(found[:, 1] - 25) < 2 * np.sqrt(covariance[:, 1, 1])).mean()

    (none, fine), (some, fair) = share(1.5), share(0.12)  # 95 and 8 pixels between the eyes
    assert none == 0 and fine > 0.93 and some > 0.01 and fair > 0.85


def rows(names, frames, lost=(), std=1.0):
    xy = seen_from(np.zeros((len(frames), 3)), names)
    for k, name in enumerate(names):
        status = ["lost" if (name, frame) in lost else "tracked" for frame in frames]
        known = dict.fromkeys(("std_x", "std_y"), np.full(len(frames), std))
        yield one_part("face", name, frames, x=xy[:, k, 0], y=xy[:, k, 1], status=status, **known)


def test_rows_without_enough_points_have_no_pose_and_noise_makes_spread():
    frames = np.arange(10, 15)
    lost = {("lip_lower", 11), ("nose", 12), ("lip_upper", 13), ("lip_lower", 13)}
    pose = head_pose(list(rows(MOUTH, frames, lost)))
    assert pose.frame.tolist() == frames.tolist()
    # without the nose four points are nearly in a plane only if the lips are, and they are not; three are too few
    assert np.isfinite(pose.angles).all(axis=1).tolist() == [True, True, True, False, True]
    assert (pose.std[1] > pose.std[0]).all()
    assert head_pose(list(rows(("eye_left", "eye_right", "mouth_left", "mouth_right"), frames))) is None  # in a plane
    assert head_pose(list(rows(("nose", "mouth_left", "mouth_right"), frames))) is None
    assert head_pose([one_part("face", "box", frames)]) is None
    some = list(rows(MOUTH, frames))
    other = [one_part("face", "chin", frames, x=np.zeros(5), y=np.zeros(5)), *some]
    np.testing.assert_array_equal(head_pose(other).angles, head_pose(some).angles)
    angles, covariance, *_ = fit(np.full((2, 5, 2), 100.0))
    assert np.isnan(angles).all() and np.isnan(covariance).all()
    stds = (0.5, 8.0, 0.1, np.nan, 60.0)
    exact, vague, less, none, most = (head_pose(list(rows(FIVE, np.arange(3), std=std))).std for std in stds)
    assert (vague > 1.3 * exact).all()
    assert np.array_equal(exact, less) and np.array_equal(exact, none), "half a pixel is the least"
    assert np.isnan(most).all(), "77 degrees say nothing"


POINTS = {"nose": (0, -30), "mouth_left": (-25, 8), "mouth_right": (25, 8), "lip_upper": (0, 0), "lip_lower": (0, 15)}
SIZE = 100.0  # twice the largest distance, that of the corners of the mouth


def points(time_s, x=0.0, y=0.0, degrees=0.0, scale=1.0, noise=0.0, seed=0, lost=None):
    """Five parts around (200 + x, 150 + y), turned and scaled; x and y in units of the target's size."""
    t = len(time_s)
    rng = np.random.default_rng(seed)
    turn, scale = np.radians(np.broadcast_to(degrees, t)), np.broadcast_to(scale, t)
    x, y = 200 + SIZE * np.broadcast_to(x, t), 150 + SIZE * np.broadcast_to(y, t)
    found = []
    for name, (px, py) in POINTS.items():
        there = np.stack([px * np.cos(turn) - py * np.sin(turn), px * np.sin(turn) + py * np.cos(turn)])
        px_t, py_t = scale * there + [x, y] + noise * rng.normal(size=(2, t))
        status = np.full(t, "tracked", dtype="<U8")
        if lost and name in lost:
            status[lost[name]] = "lost"
        found.append(one_part("face", name, np.arange(t), time_s=time_s, x=px_t, y=py_t, status=status))
    return found


def box(time_s, x=0.0, y=0.0, side=100.0, noise=0.0, seed=0, **columns):
    t = len(time_s)
    nx, ny = noise * np.random.default_rng(seed).normal(size=(2, t))
    side = np.broadcast_to(side, t)
    x, y = 200 + 100 * np.broadcast_to(x, t) + nx, 150 + 100 * np.broadcast_to(y, t) + ny
    return [one_part("face", "box", np.arange(t), time_s=time_s, x=x, y=y, w=side, h=side, **columns)]


def clock(seconds, fps=25.0):
    return np.arange(round(seconds * fps)) / fps


def lasting_noise():
    """Particle noise is not white: half of each frame's error stays for the next one."""
    rng = np.random.default_rng(3)
    x, y = np.zeros((2, 1500))
    for t in range(1, 1500):
        x[t], y[t] = 0.5 * np.array([x[t - 1], y[t - 1]]) + 0.012 * rng.normal(size=2)
    return box(clock(60), x=x, y=y)


def talking():
    still = points(T, noise=0.3)
    return [*still[:4], replace(still[4], y=still[4].y + 12 * (np.sin(2 * np.pi * 2.5 * T) > 0))]


T, MINUTE = clock(8), clock(60)
PAN, TURN, GROWN = np.clip(T - 3, 0, 2), np.clip(T - 2, 0, 0.8), np.exp(0.3 * np.clip(T - 3, 0, 1.5))
AWAY = {"nose": slice(50, 90), "lip_lower": slice(80, 140), "mouth_left": slice(120, 200)}
PANS = [(0.3, 0, "right"), (-0.3, 0, "left"), (0, 0.3, "down"), (0, -0.3, "up")]
NOISES = [(0.0, 0), (0.5, 0), (1.5, 1), (4.0, 2)]
MADE = (points, box)


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        *((make(MINUTE, noise=noise, seed=seed), []) for make in MADE for noise, seed in NOISES),
        (lasting_noise(), []),
        (talking(), []),  # an open mouth alone
        (points(clock(10), degrees=8, noise=0.5, lost=AWAY), []),  # parts that get lost and return
        *((make(T, x=x * PAN, y=y * PAN, noise=0.7), [label]) for make in MADE for x, y, label in PANS),
        (points(T, degrees=25 * TURN, noise=0.5), ["clockwise"]),  # as seen in the picture
        (points(T, degrees=-25 * TURN, noise=0.5), ["counterclockwise"]),
        (box(T, angle=(170 + 30 * TURN + 180) % 360 - 180), ["clockwise"]),  # past 180 degrees
        (points(T, noise=0.3, scale=GROWN), ["approach"]),
        (points(T, noise=0.3, scale=1 / GROWN), ["recede"]),
        (box(T, noise=0.3, side=100 * GROWN), ["approach"]),
        (box(T, noise=0.3, side=100 / GROWN), ["recede"]),
    ],
)
def test_motion_has_its_label_and_noise_none(parts, expected):
    spans = sorted(span for kind, found in head_motion(parts).items() if kind != "still" for span in found)
    assert [label for *_, label in spans] == expected


@pytest.mark.parametrize("make", MADE)
@pytest.mark.parametrize(
    "t", [T, np.concatenate([np.arange(0, 3, 0.04), np.arange(3, 5, 0.08), np.arange(5, 8, 0.04)])]
)
def test_times_count_not_frames(make, t):
    """Also of a clip of half the frames while it pans: the same span in seconds."""
    [(first, last, _)] = head_motion(make(t, x=0.3 * np.clip(t - 3, 0, 2), noise=0.7))["horizontal"]
    assert t[first] == pytest.approx(3, abs=0.25) and t[last] == pytest.approx(5, abs=0.25)
    stays = head_motion(make(t, noise=1.0))
    assert stays.pop("still") == [(0, len(t) - 1, "still")] and not any(stays.values())


def test_nothing_is_said_of_what_is_lost():
    t = clock(10)
    rush, gone = 2.0 * np.clip(t - 4.4, 0, 1), dict.fromkeys(POINTS, slice(100, 150))
    moved = head_motion(points(t, x=rush, lost=gone))
    assert moved.pop("still") == [(0, 99, "still"), (150, 249, "still")] and not any(moved.values())


def test_a_single_point_has_neither_tilt_nor_size_nor_speed():
    point = [one_part("face", "nose", np.arange(len(T)), time_s=T, x=200 + 40 * np.clip(T - 2, 0, 1), y=T * 0)]
    # without a size, nobody knows how fast it is
    assert head_motion(point) == {"horizontal": [], "vertical": [], "still": []}
    assert "tilt" not in head_motion(box(T))
    for rows in (1, 2, 3):
        for parts in (points(T[:rows]), box(T[:rows]), [part.take(slice(0, 0)) for part in points(T[:rows])]):
            assert not any(head_motion(parts).values())
