"""The correlation filter on clips whose ground truth is known, and the walk of a box that may be hidden."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.types import Frame, Particles, Start, TargetStart
from facetrack_cli.engine.loop import track
from facetrack_cli.engine.resampling import normalise, uniform
from facetrack_cli.engine.spaces import Estimate
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.trackers.box import box_kernels as kernels
from facetrack_cli.trackers.box.hidden_box import VISIBLE, VisibleBoxSpace
from tests.support.parts import visible_walk
from tests.support.results import parts_of
from tests.twins import walk as naive

WIDTH, HEIGHT = 160, 120
SEEDS = [0, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (1, 2))]


def texture(height, width, seed, blur=2.0, colour=True):
    """(height, width, 3) of random blobs, whose mean colour is random too."""
    rng = np.random.default_rng(seed)
    noise = cv2.GaussianBlur(rng.normal(0, 1, (height, width, 3)).astype(np.float32), (0, 0), blur)
    picture = rng.uniform(80, 170, 3) + 45 * noise / noise.std()
    return picture if colour else np.repeat(picture.mean(axis=2, keepdims=True), 3, axis=2)


def paste(ground, patch, x, y, k=1.0):
    """`ground` with the patch, k times as large, around (x, y), parts of pixels by their share."""
    h, w = patch.shape[:2]
    to = np.array([[k, 0, x - k * (w - 1) / 2], [0, k, y - k * (h - 1) / 2]])
    size = ground.shape[1::-1]
    share = cv2.warpAffine(np.ones((h, w), np.float32), to, size)[..., None]
    # beyond its border the patch goes on, so that it is not mixed with black
    return ground * (1 - share) + cv2.warpAffine(patch, to, size, borderMode=cv2.BORDER_REPLICATE) * share


def clip(places, size=(24, 28), colour=True, frame_size=(WIDTH, HEIGHT), cover=(), seed=1, blur=2.0):
    """A patch at `places` (x, y) or (x, y, scale), None where it is gone; in frames `cover` something is before it."""
    ground = texture(frame_size[1], frame_size[0], seed + 100, 1.5 * blur, colour)
    patch, other = texture(size[1], size[0], seed, blur, colour), texture(size[1] + 16, size[0] + 16, seed + 50, blur)
    frames = []
    for n, place in enumerate(places):
        picture = ground if place is None else paste(ground, patch, *place)
        if n in cover:
            picture = paste(picture, other, *place[:2])
        frames.append(Frame(n, n / 25, np.clip(picture, 0, 255).round().astype(np.uint8)))
    return frames


def path(count=30, x=60.0, y=55.0):
    return [(x + 25 * np.sin(n / 8), y + 12 * (1 - np.cos(n / 6)), 1 + 0.12 * np.sin(n / 10)) for n in range(count)]


def start(place, size=(24, 28), name="thing"):
    w, h = map(float, size)
    return Start(0, {name: TargetStart(box=(place[0] - (w - 1) / 2, place[1] - (h - 1) / 2, w, h))}, "clip.init.yaml")


def run(frames, begin, seed=0, **overrides):
    return list(track(build_tracker(load_recipe("correlation_filter", overrides), begin), iter(frames), seed))


def boxes(results, target=0):
    return [parts_of(one.targets[target])[0] for one in results]


def off(results, places):
    """How far the centre is off, in shares of the box (frames, 2)."""
    return np.array([((b.x - p[0]) / b.w, (b.y - p[1]) / b.h) for b, p in zip(boxes(results), places, strict=True)])


def statuses(results):
    return [one.status for one in boxes(results)]


def assert_finite(results):
    for one in boxes(results):
        assert np.isfinite([one.x, one.y, one.w, one.h, one.confidence, one.ess]).all()
        assert -1e-9 <= one.confidence <= 1 + 1e-9


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("colour", [True, False])
def test_a_moving_target_is_followed(colour, seed):
    places = path()
    results = run(clip(places, colour=colour, seed=3 * seed + 1), start(places[0]), seed)
    assert_finite(results)
    assert np.abs(off(results, places)).max() < 0.25
    assert set(statuses(results)) == {"init", "tracked"}
    scale = np.array([one.w / 24 for one in boxes(results)])
    assert np.abs(np.log(scale / [p[2] for p in places])).max() < 0.15


@pytest.mark.one_in(4)
@pytest.mark.parametrize(("key", "values"), [
    ("likelihood.window", (2, 10)), ("likelihood.sharpness", (0.01, 100)), ("likelihood.peak", (0.01, 1)),
    ("likelihood.evidence", (0, 20)), ("likelihood.hidden_rate", (0, 1)), ("likelihood.components", (2, 34)),
    ("likelihood.scales.count", (3, 65)), ("likelihood.scales.sharpness", (0.1, 100)), ("motion.scale", (1e-6, 1)),
    ("motion.sigma", (1e-6, 5)), ("motion.hidden", (1e-6, 5)), ("motion.elsewhere", (0, 1)),
    ("motion.show", (1e-300, 0.999)), ("motion.hide", (1e-300, 0.999)),
])  # fmt: skip
def test_settings_at_their_bounds_are_survived(key, values):
    places = path(14)
    for value in values:
        assert_finite(run(clip(places, cover=range(6, 10)), start(places[0]), **{key: value}))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("colour", [True, False])
def test_covered_it_is_lost_and_tracked_again_after(colour, seed):
    places = [(60 + 0.5 * n, 55 + 0.2 * n) for n in range(40)]
    results = run(clip(places, cover=range(15, 25), colour=colour, seed=3 * seed + 1), start(places[0]), seed)
    assert_finite(results)
    status = statuses(results)
    assert set(status[:15]) == {"init", "tracked"}
    assert set(status[17:25]) == {"lost"}
    assert set(status[30:]) == {"tracked"}
    assert np.abs(off(results, places))[30:].max() < 0.25


@pytest.mark.parametrize("targets", [2, pytest.param(8, marks=pytest.mark.nightly)])
def test_it_is_found_where_it_returns(targets):
    """Beyond the window, which is 5 times as large as the box; at most one target is missed, none is mistaken."""
    places, times = [(40.0, 40.0)] * 15 + [None] * 10 + [(250.0, 190.0)] * 55, []
    for seed in range(targets):
        frames = clip(places, (20, 20), frame_size=(320, 240), seed=3 * seed + 1)
        results = run(frames, start(places[0], (20, 20)), seed)
        assert_finite(results)
        status = statuses(results)
        assert set(status[18:25]) == {"lost"}
        found = [n for n in range(25, 80) if status[n] == "tracked"]
        times.append(len(found))
        assert not found or np.abs(off([results[n] for n in found], [places[n] for n in found])).max() < 0.25
    assert sum(n >= 10 for n in times) >= targets - 1


def test_the_mean_of_l_over_a_box_and_a_tenth_of_log_scale_is_its_evidence():
    frames, [target] = clip(path()), build_tracker(load_recipe("correlation_filter"), start(path()[0]))
    likelihood = target.likelihood
    learned = likelihood.look(likelihood.init(frames[0], target.x0), frames[2], target.x0)
    guides = likelihood.guides(learned)
    sides = [np.arange(WIDTH), np.arange(HEIGHT), np.arange(-0.3, 0.3, 0.01)]
    x = np.zeros((np.prod([len(side) for side in sides]), 1, 6))
    x[:, 0, :3] = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    x[:, 0, 2] = np.exp(x[:, 0, 2])
    whole = np.exp(likelihood.score(learned, frames[2], x, x)).sum() * 0.01
    areas = 24 * 28 * np.exp(2 * guides.mean[:, 2])
    assert whole == pytest.approx(np.sum(np.exp(guides.log_w) * areas * 0.1), rel=0.02)


# --- the walk: its density, its samples, and what it says of places that are proposed

SIGMA, HIDDEN = 3.0, 1.0
WALK = visible_walk(SIGMA, HIDDEN, scale=0.05)
N = 100_000

PARENTS = [(50.0, 40.0, 1.0, 0.0, 0.0, 1.0), (50.0, 40.0, 0.5, 4.0, -2.0, 0.0), (50.0, 40.0, 1.6, -3.0, 1.0, 0.4)]


def state(parent, n=1):
    return np.tile(np.array(parent), (n, 1, 1))


@pytest.mark.parametrize(("limits", "drawn"), [((0.9, 1.02), True), ((0.1, 10.0), False)])
def test_the_scale_stays_within_its_limits(limits, drawn):
    one = visible_walk(SIGMA, HIDDEN, limits=limits, scale=0.2)
    s = one.propagate(np.random.default_rng(0), state(PARENTS[0], 1000))[:, 0, 2]
    assert limits[0] <= s.min() and s.max() <= limits[1]
    assert (np.isin(s, limits).sum() > 0) == drawn


def test_presence_is_the_weight_of_what_is_visible_within_half_a_box():
    # of a box of 12x8 pixels at scale 1.5: at its corner, beyond a side of it, and within
    table = [((59, 46), 0.8, 0.4), ((59.1, 40), 1.0, 0.2), ((50, 33.9), 1.0, 0.1), ((41, 34), 0.5, 0.3)]
    x = np.array([[(*place, 1.0, 0.0, 0.0, visible)] for place, visible, _ in table])
    estimated = Estimate(np.array([[50.0, 40.0, 1.5, 0.0, 0.0, 0.9]]), np.zeros((1, 2, 2)))
    presence = VisibleBoxSpace((12.0, 8.0)).presence(Particles(x, np.log([w for *_, w in table])), estimated)
    assert presence == pytest.approx([0.8 * 0.4 + 0.5 * 0.3])


def crowd(seed=3, n=30):
    rng = np.random.default_rng(seed)
    x = np.array([PARENTS[k % 3] for k in range(n)])[:, None]
    x[:, 0, :2] += rng.normal(0, 2, (n, 2))
    return Particles(x, normalise(rng.normal(0, 1, n)))


@given(seed=st.integers(0, 10_000), many=st.integers(1, 6), n=st.integers(1, 5))
def test_the_kernel_is_what_its_plain_twin_says(seed, many, n):
    rng = np.random.default_rng(seed)
    z, parents, w = rng.normal(0, 1, (n, 3)), rng.normal(0, 1, (many, 6)), rng.dirichlet(np.ones(many))
    parents[:, 2], parents[:, 5] = rng.uniform(0.5, 2, many), rng.random(many)
    walk, u, e = (0.7, 0.5, 0.3, 0.02, 0.18, 0.02, 0.9, 1.1), rng.random(n), rng.normal(0, 1, (n, 2))
    shown, hidden, x = np.empty(n), np.empty(n), np.empty((n, 6))
    returns, size = kernels.arrive(z, parents, np.log(w), (SIGMA, HIDDEN), walk, u, e, shown, hidden, x)
    assert returns == pytest.approx(w @ (1 - parents[:, 5]) * 0.02) and size == pytest.approx(w @ parents[:, 2])
    for k in range(n):
        parts = np.array(naive.arrive(z[k], parents, w, (SIGMA, HIDDEN), walk))
        np.testing.assert_allclose(np.exp([shown[k], hidden[k]]), parts.sum(axis=0), rtol=1e-9)
        which = np.searchsorted(np.cumsum(parts.T.ravel()) / parts.sum(), u[k])
        np.testing.assert_allclose(x[k, :2], z[k, :2])
        assert x[k, 2] == pytest.approx(min(max(np.exp(z[k, 2]), 0.9), 1.1)) and x[k, 5] == 0
        sigma = (SIGMA, HIDDEN)[which // many]
        np.testing.assert_allclose(x[k, 3:5], naive.velocity(z[k], parents[which % many], sigma, walk, e[k]))


@given(seed=st.integers(0, 10_000), n=st.integers(2, 9), hidden=st.booleans())
def test_particles_that_are_carried_and_what_they_come_to_are_those_of_the_plain_twins(seed, n, hidden):
    rng = np.random.default_rng(seed)
    x, log_w, step = rng.normal(0, 3, (n, 6)), normalise(rng.normal(0, 1, n)), rng.normal(0, 2, 2)
    x[:, 2], x[:, 5] = rng.uniform(0.5, 2, n), rng.uniform(0, 0.4, n) if hidden else rng.random(n)
    noise, walk = rng.normal(0, 1, (n + 1) // 2), (0.3, 0.5, 0.7, 0.9, 1.1)
    kernels.carry(x, noise, step, walk, moved := np.empty((n, 1, 6)))
    np.testing.assert_allclose(moved[:, 0], naive.carried(x, noise, step, *walk), rtol=1e-12)
    particles = Particles(x[:, None], log_w)
    found, ess = VisibleBoxSpace((12.0, 8.0)).summed(particles)
    *expected, samples = naive.summed(x, np.exp(log_w), (12.0, 8.0))
    for mine, plain in zip(found, expected, strict=True):
        np.testing.assert_allclose(mine[0] if mine.ndim > 1 else mine, plain, rtol=1e-6)
    assert ess == pytest.approx(samples)


@given(seed=st.integers(0, 10_000), far=st.sampled_from([1.0, 100.0]))
def test_a_mixture_is_that_of_its_normal_densities(seed, far):
    rng = np.random.default_rng(seed)
    z, mean, std, log_w = (
        rng.normal(0, far, (4, 3)),
        rng.normal(0, 1, (3, 3)),
        rng.uniform(0.5, 2, (3, 3)),
        rng.normal(0, 1, 3),
    )
    kernels.log_mixture(z, mean, std, log_w, out := np.empty(4))
    np.testing.assert_allclose(out, naive.log_mixture(z, mean, std, log_w), rtol=1e-9)


def test_who_arrives_is_weighed_over_all_parents():
    particles, rng = crowd(), np.random.default_rng(4)
    z = np.column_stack([rng.normal(50, 4, 50), rng.normal(40, 4, 50), rng.normal(0, 0.3, 50)])
    x, log_visible, log_hidden, returns, _ = WALK.arrive(np.random.default_rng(0), z, particles)
    np.testing.assert_allclose(x[:, 0, :2], z[:, :2])
    np.testing.assert_allclose(x[:, 0, 2], np.exp(z[:, 2]))
    one = WALK.settings
    hidden = float(np.exp(particles.log_w) @ (1 - particles.x[:, 0, VISIBLE]))
    assert returns == 0.0
    _, same, less, returns, _ = WALK.arrive(np.random.default_rng(0), z, particles, found=True)
    assert returns == pytest.approx(hidden * one.show * one.elsewhere)
    np.testing.assert_array_equal(same, log_visible)
    assert np.all(less <= log_hidden) and np.any(less < log_hidden)


@pytest.mark.parametrize("parent", PARENTS[:2])
def test_its_velocity_is_that_of_who_was_propagated_to_the_same_place(parent):
    """p(v | z) is a regression of the velocities on the places of samples; of one parent that is surely (in)visible."""
    one = visible_walk(SIGMA, HIDDEN, scale=0.05, hide=1e-9, show=1e-9)
    moved = one.propagate(np.random.default_rng(0), state(parent, N))[:, 0]
    off = moved[:, 0] - moved[:, 0].mean()
    slope = off @ moved[:, 3] / (off @ off)
    residual = np.std(moved[:, 3] - moved[:, 3].mean() - slope * off)
    z = np.tile([55.0, 38.0, np.log(parent[2])], (20_000, 1))
    v = one.arrive(np.random.default_rng(1), z, Particles(state(parent), np.zeros(1)))[0][:, 0, 3]
    assert v.mean() == pytest.approx(moved[:, 3].mean() + slope * (55 - moved[:, 0].mean()), abs=0.05)
    assert v.std() == pytest.approx(residual, rel=0.03)


def test_its_forecast_is_that_of_samples_of_a_visible_target():
    one = visible_walk(SIGMA, HIDDEN, scale=0.05, hide=1e-9)
    particles = crowd()
    particles.x[:, 0, VISIBLE], particles.x[:, 0, 2] = 1.0, 1.3
    mean, std = one.forecast(particles)
    rng = np.random.default_rng(0)
    which = rng.choice(len(particles.x), N, p=np.exp(particles.log_w))
    moved = one.propagate(rng, particles.x[which])[:, 0]
    z = np.column_stack([moved[:, :2], np.log(moved[:, 2])])
    np.testing.assert_allclose(mean, z.mean(axis=0), atol=0.05)
    np.testing.assert_allclose(std, z.std(axis=0), rtol=0.02)


def test_far_from_all_parents_it_is_finite():
    particles = Particles(state(PARENTS[0], 10), uniform(10))
    z = np.array([[1e6, -1e6, 0.0], [50.0, 40.0, 5.0], [50.0, 40.0, -5.0]])
    x, log_visible, log_hidden, _, _ = WALK.arrive(np.random.default_rng(0), z, particles)
    assert np.isfinite(x).all() and np.isfinite(np.logaddexp(log_visible, log_hidden)).all()
    assert x[1, 0, 2] == 10.0 and x[2, 0, 2] == 0.1


@pytest.mark.parametrize("n", [1, 7, 400])
def test_what_others_see_moving_is_carried_with_its_mean_velocities(n):
    one, before = WALK.settings, np.repeat(np.array(PARENTS), [n] * 3, axis=0)[:, None]
    step = np.array([5.0, -2.0])
    after = WALK.carried(np.random.default_rng(0), before, step)
    np.testing.assert_array_equal(after[:, 0, :2], before[:, 0, :2] + step)
    np.testing.assert_array_equal(after[:, 0, VISIBLE], before[:, 0, VISIBLE])
    # the mean of the velocity of `propagate`, given where the place has come to
    a, b = one.velocity, one.acceleration
    np.testing.assert_allclose(after[:, 0, 3:5], a * before[:, 0, 3:5] + b * (step - a * before[:, 0, 3:5]))
    grown = np.log(after[:, 0, 2] / before[:, 0, 2])
    assert grown.std() == pytest.approx(0.05, rel=0.15) if n == 400 else np.isfinite(grown).all()
