"""The smoother against exact posteriors, and rows from smoothed beliefs: points, boxes, a face, and a fixed lag."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.types import Correction, Particles
from facetrack_cli.engine.loop import track
from facetrack_cli.engine.protocols import Belief
from facetrack_cli.engine.spaces import RandomWalk
from facetrack_cli.engine.target import belief
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.assembly import tracker_for
from facetrack_cli.trackers.smoothed import chained, lagged, smoothed, smoothed_names, smoothed_rows, steadied
from facetrack_cli.trajectory.trajectory import UNSEEN, successive
from facetrack_cli.trajectory.writers import csv_frames
from tests.support.samples import TrackClip
from tests.tracking.test_motion import MOTIONS


def kalman(motion, x0, rng, t, hidden=(), noise=1.5):
    """Beliefs of a Kalman filter of `t` frames whose places are seen but in the `hidden` ones; x of all, and z."""
    linear = motion.linear(x0)
    d, places = linear.matrix.shape[-1], 2
    x0 = x0[:, :d]
    h = np.eye(d)[:places]
    x, seen, found = x0, [], []
    mean, cov = x0.copy(), np.zeros((len(x0), d, d))
    found.append(Belief(mean, cov, linear, np.zeros(len(x0), bool)))
    for i in range(1, t):
        x = np.einsum("kde,ke->kd", linear.matrix, x) + linear.offset
        x = x + np.array([rng.multivariate_normal(np.zeros(d), one, method="eigh") for one in linear.cov])
        z = x @ h.T + noise * rng.standard_normal((len(x), places))
        mean = np.einsum("kde,ke->kd", linear.matrix, mean) + linear.offset
        cov = linear.matrix @ cov @ linear.matrix.transpose(0, 2, 1) + linear.cov
        if i not in hidden:
            gain = cov @ h.T @ np.linalg.inv(h @ cov @ h.T + noise**2 * np.eye(places))
            mean, cov = mean + np.einsum("kde,ke->kd", gain, z - mean @ h.T), cov - gain @ h @ cov
        seen.append(z)
        found.append(Belief(mean, cov, linear, np.zeros(len(x0), bool)))
    return found, np.array(seen)


def none_of(lost):
    """Nothing is gone, and nothing placed by hand."""
    return np.zeros_like(lost), np.zeros(len(lost), bool)


def batch(linear, x0, seen, hidden, noise, k):
    """Mean and covariance of x_1 ... x_T-1 of part k given all that was seen, from their joint normal distribution."""
    a, o, q, x = linear.matrix[k], linear.offset[k], linear.cov[k], x0[k, : linear.matrix.shape[-1]]
    t, d = len(seen), len(a)
    drift, spread, power = np.zeros((t, d)), np.zeros((t * d, t * d)), [np.eye(d)]
    for i in range(t):
        x = a @ x + o
        drift[i] = x
        power.append(a @ power[-1])
    carry = np.zeros((t * d, t * d))
    for i in range(t):
        for j in range(i + 1):
            carry[i * d : i * d + d, j * d : j * d + d] = power[i - j]
    spread = carry @ np.kron(np.eye(t), q) @ carry.T
    rows = [i * d + c for i in range(t) if i + 1 not in hidden for c in (0, 1)]
    gain = spread[:, rows] @ np.linalg.inv(spread[np.ix_(rows, rows)] + noise**2 * np.eye(len(rows)))
    z = np.concatenate([seen[i, k] for i in range(t) if i + 1 not in hidden])
    mean = drift.ravel() + gain @ (z - drift.ravel()[rows])
    cov = spread - gain @ spread[rows]
    return mean.reshape(t, d), np.stack([cov[i * d : i * d + d, i * d : i * d + d] for i in range(t)])


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("hidden", [(), range(8, 15)])
def test_the_smoothed_belief_is_the_posterior_given_all_frames(name, hidden):
    """Also where the filter, in frames that did not show the part, believed something else."""
    motion, x0 = MOTIONS[name]
    found, seen = kalman(motion, x0, np.random.default_rng(1), 25, hidden)
    lost = np.zeros((25, len(x0)), bool)
    lost[[i for i in hidden if i > 9]] = True  # the first two were in doubt before
    for i in hidden:
        found[i] = found[i]._replace(mean=found[i].mean + 50, cov=np.eye(found[i].cov.shape[-1]) * found[i].cov * 3)
        found[i] = found[i]._replace(doubt=np.ones(len(x0), bool))
    mean, cov = smoothed(chained(found, lost, *none_of(lost)))
    for k in range(len(x0)):
        exact, spread = batch(motion.linear(x0), x0, seen, hidden, 1.5, k)
        np.testing.assert_allclose(mean[1:, k], exact, atol=1e-6)
        np.testing.assert_allclose(cov[1:, k], spread, atol=1e-6)


def test_a_part_that_is_not_seen_again_says_nothing_of_before():
    motion, x0 = MOTIONS["random_walk"]
    found, _ = kalman(motion, x0, np.random.default_rng(2), 12)
    lost = np.zeros((12, 2), bool)
    lost[8:, 0] = True
    gone = np.zeros_like(lost)
    mean, cov = smoothed(chained(found, lost, gone, gone[:, 0]))
    before, spread = smoothed(chained(found[:8], lost[:8], gone[:8], gone[:8, 0]))
    np.testing.assert_allclose(mean[:8, 0], before[:, 0])
    np.testing.assert_allclose(cov[:8, 0], spread[:, 0])


def test_a_hidden_part_moves_with_those_that_are_seen():
    walk = RandomWalk(np.array([2.0, 2.0]))
    x = np.stack([np.array([[3.0 * i**2, 0.0], [3.0 * i**2, 40.0]]) for i in range(9)])
    doubt, exact = np.zeros(2, bool), np.broadcast_to(0.01 * np.eye(2), (2, 2, 2))
    found = [Belief(one, exact, walk.linear(one), doubt) for one in x]
    lost = np.zeros((9, 2), bool)
    lost[3:6, 1] = True
    mean, _ = smoothed(chained(found, lost, *none_of(lost)))
    np.testing.assert_allclose(mean[3:6, 1], x[3:6, 1], atol=0.1)


def test_the_belief_of_particles_is_their_mean_and_their_covariance_widened_as_the_estimates():
    rng = np.random.default_rng(5)
    motion, x0 = MOTIONS["first_order"]
    x, w = x0 + rng.standard_normal((50, 1, 6)), rng.dirichlet(np.ones(50))
    plain = np.cov(x[:, 0].T, aweights=w, ddof=0)
    found = belief(Particles(x, np.log(w)), motion.linear(x0), 1.5 * plain[None, :2, :2], np.zeros(1, bool))
    np.testing.assert_allclose(found.mean, np.average(x, axis=0, weights=w))
    np.testing.assert_allclose(found.cov[0], 1.5 * plain)
    one = belief(Particles(x0[None], np.zeros(1)), motion.linear(x0), np.zeros((1, 2, 2)), np.zeros(1, bool))
    assert not one.cov.any() and (one.mean == x0).all()


def test_points_at_rest_lose_their_jitter_and_what_jumps_stays_where_it_is():
    rng = np.random.default_rng(5)
    true = np.full((80, 2, 2), 50.0)
    true[40:, 1, 1] += 12.0  # a lip that drops in a frame
    at = true + 0.4 * rng.standard_normal(true.shape)
    found = steadied(at, np.ones((80, 2), bool))
    off, before = np.abs(found - true), np.abs(at - true)
    assert off[:, 0].mean() < 0.5 * before[:, 0].mean()
    assert off[:, 1].mean() < 0.7 * before[:, 1].mean()
    np.testing.assert_allclose(found[38:42, 1], at[38:42, 1], atol=0.8)
    moving = np.cumsum(3 * rng.standard_normal((80, 1, 2)), axis=0)
    np.testing.assert_allclose(steadied(moving, np.ones((80, 1), bool)), moving, atol=4.0)
    still = np.full((5, 1, 2), 7.0)
    np.testing.assert_array_equal(steadied(still, np.ones((5, 1), bool)), still)


def test_what_is_hidden_or_absent_stays_as_it_is_and_parts_before_from_after():
    rng = np.random.default_rng(6)
    at = 50 + 0.4 * rng.standard_normal((60, 3, 2))
    shown = np.ones((60, 3), bool)
    shown[20:30, 1:], at[20:30, 2] = False, np.nan
    at[20:30, 1] += 30.0
    found = steadied(at, shown)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(at))
    np.testing.assert_array_equal(found[20:30, 1], at[20:30, 1])
    assert np.abs(found[30:, 1] - 50).max() < 1.5 and np.abs(found[:20, 1] - 50).max() < 1.5
    # of either side nothing comes to the other
    other = at.copy()
    other[30:, 2] += 9.0
    np.testing.assert_allclose(steadied(other, shown)[:20, 2], found[:20, 2])
    for few in (1, 2):
        np.testing.assert_allclose(steadied(at[:few], shown[:few]), at[:few])


@given(st.integers(1, 6).flatmap(lambda n: st.lists(st.tuples(*[st.floats(0.05, 0.95)] * 2), min_size=n, max_size=n)))
def test_names_are_smoothed_to_the_sum_over_all_sequences(frames):
    likelihood, change = (
        np.array(each) for each in zip(*frames, strict=True)
    )  # p(y | first) of p(y | first or second)
    change[0] = 0.5
    p, now = np.empty(len(frames)), 0.5
    for t in range(len(frames)):
        ahead = now * (1 - change[t]) + (1 - now) * change[t]
        now = p[t] = ahead * likelihood[t] / (ahead * likelihood[t] + (1 - ahead) * (1 - likelihood[t]))
    total = np.zeros((len(frames), 2))
    for sequence in itertools.product((0, 1), repeat=len(frames)):
        weight = 1.0
        for t, state in enumerate(sequence):
            weight *= (1 - likelihood[t]) if state else likelihood[t]
            weight *= 0.5 if t == 0 else change[t] if state != sequence[t - 1] else 1 - change[t]
        for t, state in enumerate(sequence):
            total[t, state] += weight
    assert smoothed_names(p, change) == pytest.approx(total[:, 0] / total.sum(axis=1), abs=1e-9)


CLIP = TrackClip("occlusion", 112)  # a hand covers a corner of the mouth and the lower lip in frames 51 to 101
MOVED = Correction(60, "face", points={"nose": (175.0, 120.0)})


def results_of(name, stop=112, corrections=(), overrides=None, seed=0):
    recipe = load_recipe(name, overrides or {})
    start = replace(CLIP.start, corrections=tuple(corrections))
    tracker = tracker_for(recipe, start, CLIP.frames[0].size)
    return list(track(tracker, iter(CLIP.frames[:stop]), seed))


def rows_of(results):
    return successive([one.rows for one in results])


def beliefs_of(results):
    return [() if (found := one.targets[0].beliefs) is None else found() for one in results]


@pytest.fixture(scope="module")
def points():
    # hidden parts wander more, and visible ones tremble more, with the look-ahead of the published filter
    return results_of("factorized_robust", overrides={"filter.look_ahead": "draw", "filter.particles": 100})


def off_in(rows, words=("visible", "hidden")):
    """The mean distance from the truth of nose, mouth and lips where that says one of these words."""
    off = []
    for part in rows.parts[:5]:  # box and eyes have no truth
        for t, x, y in zip(part.frame.tolist(), part.x, part.y, strict=True):
            true = CLIP.truth[t, part.part]
            off += [np.hypot(x - true.x, y - true.y)] if true.status in words else []
    return np.mean(off)


def test_points_are_as_near_and_quieter_and_an_occlusion_is_bridged(points):
    before = rows_of(points)
    after = smoothed_rows(before, beliefs_of(points))
    for word, most in (("visible", 1.02), ("hidden", 1.15)):  # over ten seeds there is no difference
        assert off_in(after, (word,)) < most * off_in(before, (word,))
    assert jitter(after) < 0.95 * jitter(before)
    for name in ("status", "confidence", "w", "h", "ess", "particles"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    lost = np.isin(before.status, UNSEEN)
    assert lost.sum() > 50
    assert after.std_x[lost].mean() > 3 * after.std_x[~lost].mean()  # the bridge's


def jitter(rows):
    off = np.stack([one.x[:-2] - 2 * one.x[1:-1] + one.x[2:] for one in rows.parts])
    return float(np.median(np.abs(off)))


@pytest.mark.parametrize("name", ["factorized_robust", "correlation_filter"])
def test_a_lag_is_the_smoother_of_the_frames_up_to_then(name, points):
    results = points if name == "factorized_robust" else results_of(name, 40)
    after = list(lagged(iter(results), 15))
    assert [one.frame.index for one in after] == [one.frame.index for one in results]
    for t in (0, 1, 30, 39, 55, 100, 111):
        if t < len(results):
            some = results[: t + 16]
            exact = smoothed_rows(rows_of(some), beliefs_of(some)).at(results[t].frame.index)
            for column in ("x", "y", "w", "std_x", "std_y", "cov_xy"):
                np.testing.assert_allclose(getattr(after[t].rows, column), getattr(exact, column), atol=1e-6)


def test_rows_that_were_given_stay_byte_for_byte():
    results = results_of("factorized_robust", 80, [MOVED])
    before = rows_of(results)
    after = smoothed_rows(before, beliefs_of(results))
    for frame in (0, 60):
        assert [*csv_frames(after.at(frame))] == [*csv_frames(before.at(frame))]
    assert not np.array_equal(after.at(59).x, before.at(59).x)
    alone = results[60:]
    np.testing.assert_allclose(smoothed_rows(rows_of(alone), beliefs_of(alone)).x, after.between(60, 80).x, atol=1e-9)


def test_what_is_absent_has_no_place_and_parts_what_is_around():
    gone = Correction(30, "face", absent=True)
    back = Correction(40, "face", points=CLIP.start.targets["face"].points)
    results = results_of("factorized_robust", 60, [gone, back])
    after = smoothed_rows(rows_of(results), beliefs_of(results))
    np.testing.assert_array_equal(after.frame[np.isnan(after.x)] // 10, 3)
    alone = results[:30]
    np.testing.assert_allclose(smoothed_rows(rows_of(alone), beliefs_of(alone)).x, after.between(0, 30).x, atol=1e-9)
    assert len(list(lagged(iter(results), 7))) == 60


def test_an_affine_box_stays_what_its_diagnostics_say():
    results = results_of("adaptive", 12)
    before = rows_of(results)
    after = smoothed_rows(before, beliefs_of(results))
    affine, was = (one.diagnostics["face"].values["affine"] for one in (after, before))
    assert not np.array_equal(affine, was)
    np.testing.assert_allclose(affine[:, 4], after.x)
    ratio = np.hypot(affine[:, 0], affine[:, 2]) / np.hypot(was[:, 0], was[:, 2])
    np.testing.assert_allclose(after.w, before.w * ratio)
    assert after.corners is not None
    np.testing.assert_allclose(np.linalg.norm(after.corners[:, 1] - after.corners[:, 0], axis=1), after.w)
    np.testing.assert_allclose(after.angle, before.angle, atol=1.0)


def test_a_face_moves_as_one(points):
    trembles, further = [], []
    for seed in range(3):
        results = results_of("face", 40, seed=seed)
        before = rows_of(results)
        after = smoothed_rows(before, beliefs_of(results))
        box, now = before.parts[5], after.parts[5]
        assert (box.part, now.part) == ("box", "box")
        np.testing.assert_allclose(now.w / box.w, now.h / box.h)
        assert np.abs(after.x - before.x).max() < 8
        assert after.between(1, 40).std_x.min() > 0
        np.testing.assert_array_equal(now.angle, box.angle)
        trembles.append([[np.median(np.abs(np.diff(one.y, 2))) for one in rows.parts[:5]] for rows in (after, before)])
        further.append(off_in(after) - off_in(before))
    # the box has no truth; points tremble less, and are as near to the truth as before
    smooth, rough = np.mean(trembles, axis=(0, 2))
    assert smooth < 0.97 * rough
    assert np.mean(further) < 0.04, "pixels"


@pytest.mark.parametrize("absent", [True, ("nose",)])
def test_a_face_may_be_absent_for_a_while(absent):
    given = CLIP.start.targets["face"].points
    gone, back = Correction(8, "face", absent=absent), Correction(12, "face", points=given)
    results = results_of("face", 16, [gone, back])
    before = rows_of(results)
    for after in (smoothed_rows(before, beliefs_of(results)), rows_of(lagged(iter(results), 5))):
        np.testing.assert_array_equal(np.isnan(after.x), np.isnan(before.x))
        np.testing.assert_array_equal(np.isnan(after.std_x), np.isnan(before.std_x))
        assert np.nanmax(np.abs(after.x - before.x)) < 8


def test_what_has_no_beliefs_stays():
    results = results_of("mil", 3)
    before = rows_of(results)
    assert beliefs_of(results) == [()] * 3
    assert smoothed_rows(before, beliefs_of(results)) is before
    assert [one.rows.x.tolist() for one in lagged(iter(results), 2)] == [one.rows.x.tolist() for one in results]
