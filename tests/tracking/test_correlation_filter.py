"""The correlation filter in the whole engine: a textured patch over a textured ground, whose ground truth is known."""

import cv2
import numpy as np
import pytest

from facetrack_cli.core.types import Frame, Start, TargetStart
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.assembly import build_tracker
from tests.support.results import parts_of

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
    w, h = size
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
