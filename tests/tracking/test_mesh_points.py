"""The filter of points that a network places: against one written out, of hidden points, and in a turned face."""

import numpy as np

from facetrack_cli.trackers.face.mesh_points import MOVES, NO_FACE, OFF, TREMBLES, MeshPoints
from facetrack_cli.trackers.face.stabilized import EYES, MIDDLE, Similarity

REST = MIDDLE + 30 * np.random.default_rng(7).standard_normal((30, 2))
VISIBLE = np.full(30, 4.0)
HIDDEN = np.where(np.arange(30) < 6, -4.0, 4.0)
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


def moving(frames, rng, turn=0.01, s=MOVES, r=TREMBLES):
    """(T, J, 2) true places and what is measured of them: points of their own, carried by a face that turns."""
    own, true = s * rng.standard_normal(REST.shape), []
    for t in range(frames):
        own = 0.5 * own + np.sqrt(0.75) * s * rng.standard_normal(REST.shape)
        true.append(Similarity(np.array([MIDDLE + 0.2 * t, MIDDLE]), 1 + 0.002 * t, turn * t).to_frame(REST) + own)
    true = np.stack(true)
    return true, true + r * rng.standard_normal(true.shape)


def test_each_point_is_the_kalman_filter_that_is_written():
    rng = np.random.default_rng(1)
    _, zs = moving(30, rng)
    odds = rng.uniform(-7, 7, (30, 30))
    one = MeshPoints.begin(zs[0])
    rest, moved, before = zs[0].copy(), zs[0].copy(), [zs[0], zs[0]]
    off, var, s2 = np.zeros((30, 2)), np.full(30, (0.015 * EYES) ** 2), np.full(30, (0.05 * EYES) ** 2)
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
                s2[j] = max(s2[j] + rate * (off[j] @ off[j] / 2 - s2[j]), (0.02 * EYES) ** 2)
                rest[j] = rest[j] + rate / 4 * off[j]
            before = [before[1], z]
        one = one.after(z, odds[t])
        np.testing.assert_allclose(one.visible, seen)
        np.testing.assert_allclose(one.at, moved + off)
        np.testing.assert_allclose(one.var, var)
    for mine, written in ((one.rest, rest), (one.moves, s2), (one.trembles, r2), (one.before, np.stack(before))):
        np.testing.assert_allclose(mine, written)
    np.testing.assert_allclose(one.cov[:, 0, 0], var + OFF**2)


def test_hidden_points_are_led_by_the_visible_ones_and_known_less_and_less():
    rng = np.random.default_rng(3)
    one = MeshPoints.begin(REST)
    for _ in range(8):
        one = one.after(REST, HIDDEN)
    for t in range(12):
        true = Similarity(np.array([MIDDLE + t, MIDDLE - t]), 1 + 0.01 * t, 0.02 * t).to_frame(REST)
        z = np.where(HIDDEN[:, None] < 0, true + rng.uniform(20, 40, REST.shape), true)
        one = one.after(z, HIDDEN)
        np.testing.assert_allclose(one.at, true, atol=0.03 * EYES)
    np.testing.assert_allclose(one.var[:6], one.moves[:6], rtol=0.01)
    assert one.var[6:].max() < 0.3 * one.var[:6].min()
    np.testing.assert_array_equal(one.belief().doubt, HIDDEN < 0)
    # where they are seen again, they are where they are measured
    for _ in range(4):
        one = one.after(z, VISIBLE)
    np.testing.assert_allclose(one.at[:6], z[:6], atol=0.1 * EYES)
    assert not one.belief().doubt.any()


def test_in_another_stabilized_image_all_is_as_it_would_have_been_there():
    _, zs = moving(24, np.random.default_rng(5))
    here, there = MeshPoints.begin(zs[0]), None
    for t in range(1, 24):
        here = here.after(zs[t], VISIBLE)
        if there is not None:
            there = there.after(TURN.to_frame(zs[t]), VISIBLE)
        if t == 12:
            there = here.mapped(TURN.to_frame)
            np.testing.assert_allclose(there.at, TURN.to_frame(here.at))
    np.testing.assert_allclose(there.at, TURN.to_frame(here.at))
    for name in ("var", "moves", "trembles", "visible"):
        np.testing.assert_allclose(getattr(there, name), getattr(here, name))


def test_a_belief_has_the_motion_that_the_filter_predicts_by():
    _, zs = moving(10, np.random.default_rng(6))
    before = MeshPoints.begin(zs[0])
    for z in zs[1:]:
        before = before.after(z, VISIBLE)
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


def test_what_was_still_for_long_is_followed_at_once_where_its_least_motion_says_so():
    """A blink: some lids of a face go down for three frames, after a minute."""
    still, lids = REST + 0, np.arange(30) < 3
    shut = still + np.where(lids[:, None], (0, 0.12 * EYES), 0)
    followed = []
    for least in (0.1 * EYES, 0.002 * EYES):
        one = MeshPoints.begin(still, 0.02 * EYES, np.where(lids, least, 0.02 * EYES))
        rng = np.random.default_rng(4)
        for _ in range(600):
            one = one.after(still + 0.02 * EYES * rng.standard_normal(still.shape), VISIBLE)
        for _ in range(2):
            one = one.after(shut, VISIBLE)
        followed.append((one.at - still)[lids, 1].mean() / (0.12 * EYES))
        np.testing.assert_allclose(one.cov[:, 0, 0], one.var + (0.02 * EYES) ** 2)
    assert followed[0] > 0.85 and followed[1] < 0.6
