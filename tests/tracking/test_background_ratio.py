"""The likelihood that learns its scale from the windows beside a part, and the walk that is drawn back to rest."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core.types import Frame, Particles
from facetrack_cli.recipe import face, points
from facetrack_cli.tracking.models.likelihoods.background_ratio import BackgroundRatio, Distances
from facetrack_cli.tracking.models.likelihoods.colour_ratio import ColourRatio
from facetrack_cli.tracking.models.motion import RestingWalk
from tests.tracking.test_correlation_filter import texture

X0 = np.array([[40.0, 40.0], [90.0, 50.0]])
PARTICLES = Particles(X0[None], np.zeros(1))


def likelihood(adapt=0.05):
    settings = face.BackgroundRatio(type="background_ratio", adapt=adapt)
    return BackgroundRatio(settings, ColourRatio(points.ColourRatio(type="colour_ratio"), np.full((2, 2), 15.0)))


def frame(picture):
    return Frame(0, 0.0, np.clip(picture, 0, 255).astype(np.uint8))


SHOWN = frame(texture(100, 130, 3, blur=3.0))


def covered(part):
    x, y = X0[part].astype(int)
    picture = SHOWN.bgr.copy()
    picture[y - 12 : y + 13, x - 12 : x + 13] = np.random.default_rng(5).integers(0, 256, (25, 25, 3))
    return frame(picture)


def test_the_peak_is_at_the_truth_and_a_window_beside_it_is_background():
    model = likelihood()
    learned = model.init(SHOWN, X0)
    offsets = np.array([(dx, dy) for dx in range(-12, 13, 2) for dy in range(-12, 13, 2)], float)
    log_p = model.score(learned, SHOWN, X0 + offsets[:, None], X0[None])
    assert np.array_equal(offsets[log_p.argmax(axis=0)], np.zeros((2, 2)))
    ratio = model.log_ratio(learned, model.distances(learned, SHOWN, X0 + np.array([[[15.0, 0.0]], [[0.0, 0.0]]])))
    assert (ratio[0] < 0).all() and (ratio[1] > 2).all()


@given(st.floats(0, 2), st.floats(0.01, 0.3), st.floats(0.3, 0.9), st.floats(0.1, 0.3))
def test_the_ratio_is_that_of_two_half_gaussians(d, s, b, t):
    model, g = likelihood(), 0.1
    learned = model.init(SHOWN, X0)._replace(
        good=Distances(np.full(2, g), np.full(2, s)), bad=Distances(np.full(2, b), np.full(2, t))
    )
    wide = max(s, (b - g) / 8)
    here = np.exp(-0.5 * (max(d - g, 0) / wide) ** 2) / wide
    beside = np.exp(-0.5 * (max(b - d, 0) / t) ** 2) / t
    expected = np.log(here) - np.log(beside) if here > 0 else None
    found = model.log_ratio(learned, np.full(2, d))
    assert np.isfinite(found).all()
    assert expected is None or found == pytest.approx(expected, abs=1e-6)


def test_a_covered_part_says_nothing_of_its_place():
    model = likelihood()
    learned = model.init(SHOWN, X0)
    for _ in range(3):
        learned = model.learn(learned, covered(1), X0, PARTICLES)
    assert model.presence(learned, covered(1), X0)[0] > 0.9
    assert learned.visible[1] < 0.1 < 0.9 < learned.visible[0]
    around = X0 + np.array([[[0.0, 0.0]], [[9.0, 0.0]], [[0.0, 9.0]]])
    spread = np.ptp(model.score(learned, covered(1), around, X0[None]), axis=0)
    assert spread[0] > 3 > 1 > spread[1]
    # and it is not learned
    assert model.presence(learned, SHOWN, X0)[1] > 0.9


def test_light_and_slow_change_are_learned_and_the_first_frame_is_kept():
    model = likelihood(adapt=0.3)
    learned = model.init(SHOWN, X0)
    for i in range(20):
        mixed = frame((1 - i / 25) * SHOWN.bgr + i / 25 * texture(100, 130, 9, blur=3.0))
        learned = model.learn(learned, mixed, X0, PARTICLES)
    assert (model.presence(learned, mixed, X0) > 0.8).all()
    assert (model.presence(learned, SHOWN, X0) > 0.9).all()
    assert (learned.anchored < 0.9).all(), "it looks less like the first frame"
    dark = frame(0.5 * SHOWN.bgr)
    assert (model.presence(model.init(SHOWN, X0), dark, X0) > 0.9).all()


def test_flat_frames_and_places_outside_are_survived():
    model, flat = likelihood(), frame(np.full((100, 130, 3), 128))
    learned = model.init(flat, X0)
    for _ in range(3):
        learned = model.learn(learned, flat, X0 + 1e4, PARTICLES)
    assert np.isfinite(model.score(learned, flat, X0[None] - 1e5, X0[None])).all()
    assert np.isfinite(model.presence(learned, SHOWN, X0)).all()


def test_a_part_that_is_placed_anew_is_learned_and_the_other_is_not():
    model = likelihood()
    learned = model.learn(model.init(SHOWN, X0), covered(1), X0, PARTICLES)
    there = X0 + np.array([[0.0, 0.0], [14.0, 8.0]])
    again = model.relearn(learned, SHOWN, there, np.array([False, True]))
    assert (model.presence(again, SHOWN, there) > 0.9).all()
    assert again.visible[1] == 1 and again.good.mean[0] == learned.good.mean[0]


def test_the_resting_walk_is_drawn_back():
    walk = RestingWalk(np.array([2.0, 1.0]), X0, 0.9)
    x = np.repeat(X0[None] + 20.0, 20_000, axis=0)
    moved = walk.propagate(np.random.default_rng(0), x)
    assert moved.mean(axis=0) == pytest.approx(X0 + 18.0, abs=0.06)
    assert moved.std(axis=0) == pytest.approx(np.array([[2.0] * 2, [1.0] * 2]), rel=0.03)
    log_p = walk.log_transition(X0[None] + 18.0, x[:1])
    assert log_p[0, 0] == pytest.approx(-2 * np.log(np.array([2.0, 1.0])) - np.log(2 * np.pi))
    still = RestingWalk(np.array([2.0, 1.0]), X0, 1.0)
    assert np.array_equal(still.expect(x), x), "that of Patras & Pantic"
