"""Recognition: figure 1 against its plain twin, the posterior over frames, switch, nobody, what cannot be seen."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError, RecipeError
from facetrack_cli.core.types import Frame, Particles
from facetrack_cli.engine.resampling import normalise
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.assembly import check_gallery
from facetrack_cli.trackers.appearance.gallery import NONE
from facetrack_cli.trackers.appearance.gallery_fit import fit_gallery
from facetrack_cli.trackers.appearance.space import Patches
from tests.support import parts
from tests.tracking.test_gallery import SHAPE, D, people
from tests.twins import gallery as naive_gallery

X0 = np.array([[40.0, 50.0, 1.0, 0.0, 0.0, 1.0]])
SIZE = (16.0, 20.0)


@pytest.fixture(scope="module")
def shown():
    """Patches of six people, each of ten images, and the names of the people."""
    return people(6, 10, change=0.2)


@pytest.fixture(scope="module")
def gallery(shown):
    x, names = shown
    known = np.arange(60) % 10 < 5
    return fit_gallery(x[known], np.array(names)[known].tolist(), SHAPE)


def picture(patch, index=0):
    """A frame that shows a patch (D,) twice as large, at X0."""
    grey = np.full((100, 80), 90.0)
    small = np.clip(120.0 + 40.0 * patch, 0, 255).reshape(SHAPE)
    grey[40:60, 32:48] = np.kron(small, np.ones((2, 2)))
    return Frame(index, index / 25, np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2))


def recognition(gallery, **options):
    return parts.recognition(gallery, parts.appearance(Patches(SIZE, SHAPE), 0.05), **options)


def step(model, learned, frame, rng, n=12, spread=0.3):
    """One step as the filter makes it: what was learned, the particles with their weights."""
    x = X0 + np.array([spread, spread, 0.01, 0.01, 0.01, 0.01]) * rng.normal(size=(n, 1, 6))
    particles = Particles(x, normalise(model.score(learned, frame, x, x)[:, 0]))
    return model.learn(learned, frame, x[particles.log_w.argmax()], particles), particles


def watch(model, patches, seed=0):
    rng = np.random.default_rng(seed)
    learned = model.init(picture(patches[0]), X0)
    path = [learned]
    for t, patch in enumerate(patches[1:], start=1):
        learned, _ = step(model, learned, picture(patch, t), rng)
        path.append(learned)
    return path


@settings(max_examples=settings().max_examples // 3)
@given(st.integers(0, 999), st.booleans(), st.sampled_from([0.0, 0.1]), st.sampled_from([1.0, 0.02]))
def test_weights_and_posterior_agree_with_figure_1(shown, gallery, seed, none, switch, sharpness):
    rng = np.random.default_rng(seed)
    x, _ = shown
    model = recognition(gallery, none=none, switch=switch, sharpness=sharpness)
    first, frame = picture(x[rng.integers(60)]), picture(x[rng.integers(60)], 1)
    learned = model.init(first, X0)
    beta = rng.dirichlet(np.ones(len(model.names)))
    learned = dataclasses.replace(learned, log_beta=np.log(beta))
    after, particles = step(model, learned, frame, rng, spread=2.0)

    y = model.appearance.patches.read(frame, particles.x, 1)
    log_a = model.appearance.score(learned.appearance, frame, particles.x)[:, 0]
    p_f, log_n = gallery.log_scores(y, none=none, sharpness=sharpness)
    weights, posterior = naive_gallery.figure_1(
        beta.tolist(), np.exp(log_a - log_a.max()).tolist(), p_f.tolist(), np.exp(log_n).tolist(), switch
    )
    np.testing.assert_allclose(np.exp(particles.log_w), weights, rtol=1e-4, atol=1e-12)
    np.testing.assert_allclose(list(after.posterior.values()), posterior, rtol=1e-4, atol=1e-8)
    assert after.entropy == pytest.approx(-sum(p * math.log(p) for p in posterior if p > 0), abs=1e-4)


def test_the_start_knows_nothing(shown, gallery):
    x, _ = shown
    for none, n in ((False, 6), (True, 7)):
        learned = recognition(gallery, none=none).init(picture(x[0]), X0)
        assert learned.entropy == pytest.approx(math.log(n))
        assert list(learned.posterior) == [*gallery.names, NONE][:n]
        assert list(learned.posterior.values()) == pytest.approx([1 / n] * n)
        assert learned.names == tuple(learned.posterior)


@pytest.mark.parametrize("person", range(6))
@pytest.mark.parametrize("none", [False, True])
def test_everybody_is_named_within_ten_frames(shown, gallery, person, none):
    x, names = shown
    path = watch(recognition(gallery, none=none), x[10 * person + np.array([5, 6, 7, 8, 9, 5, 6, 7, 8, 9])])
    last = path[-1]
    assert max(last.posterior, key=last.posterior.get) == names[10 * person]
    # of so few made-up people the threshold is a rough one: some frames speak for nobody
    assert last.posterior[names[10 * person]] > (0.75 if none else 0.9)
    assert last.entropy < (0.6 if none else 0.3) < 0.5 * path[0].entropy
    assert path[1].posterior[names[10 * person]] < 0.7, "no frame decides alone"


def test_a_stranger_is_nobody_only_where_that_is_asked_for(shown):
    x, names = people(12, 8, change=0.12)
    known = (np.arange(96) < 80) & (np.arange(96) % 8 < 5)
    gallery = fit_gallery(x[known], np.array(names)[known].tolist(), SHAPE)
    stranger = x[88:96]
    assert watch(recognition(gallery, none=True), stranger)[-1].posterior[NONE] > 0.9
    assert NONE not in watch(recognition(gallery), stranger)[-1].posterior
    assert watch(recognition(gallery, none=True), x[[5, 6, 7] * 3])[-1].posterior[NONE] < 0.1


def test_a_posterior_that_is_0_comes_back_by_a_switch_alone(shown, gallery):
    x, names = shown
    rng = np.random.default_rng(0)
    for switch in (0.0, 0.05):
        model = recognition(gallery, switch=switch)
        learned = model.init(picture(x[55]), X0)
        learned = dataclasses.replace(learned, log_beta=np.array([0.0] + [-np.inf] * 5))
        for t in range(1, 9):
            learned, particles = step(model, learned, picture(x[55 + t % 5], t), rng)
            assert np.isfinite(particles.log_w).all()
            assert not np.isnan(learned.log_beta).any() and np.isfinite(learned.entropy)
        assert (learned.posterior[names[55]] > 0.9) == (switch > 0)


@pytest.mark.parametrize("none", [False, True])
@pytest.mark.parametrize("switch", [0.0, 0.5])
def test_what_cannot_be_seen_says_nothing_of_who_it_is(shown, gallery, none, switch):
    x, _ = shown
    model = recognition(gallery, none=none, switch=switch)
    learned = watch(model, [x[5]] * 3)[-1]
    deformed = [[0, 0, 0, 0], [1e6, 0, 0, 1e6], [1, 1, 1, 1]]
    wild = np.array([[1e7, -1e7, 1, 0, 0, 1], *([40, 50, *a] for a in deformed), [-9, 50, 1, 0, 0, 1]])[:, None]
    frame = picture(np.zeros(D), 3)
    scores = model.score(learned, frame, wild, wild)
    assert scores.shape == (5, 1) and np.isfinite(scores).all()
    after = model.learn(learned, frame, wild[0], Particles(wild, normalise(scores[:, 0])))
    assert sum(after.posterior.values()) == pytest.approx(1.0)
    if not switch:
        # the flat ones have p_f = 0; those on an edge of the box may have a little
        only = Particles(wild[:2].copy(), np.log([0.5, 0.5]))
        after = model.learn(learned, frame, wild[0], only)
        assert list(after.posterior.values()) == pytest.approx(list(learned.posterior.values()))


def test_particles_without_weight_say_nothing(shown, gallery):
    x, _ = shown
    model = recognition(gallery)
    frame = picture(x[5], 1)
    learned = model.init(picture(x[5]), X0)
    near, far = X0[None], X0[None] + [[[4.0, 4.0, 0, 0, 0, 0]]]
    alone = model.learn(learned, frame, X0, Particles(near, np.zeros(1)))
    both = model.learn(learned, frame, X0, Particles(np.concatenate([near, far]), np.array([0.0, -np.inf])))
    assert list(both.posterior.values()) == pytest.approx(list(alone.posterior.values()))


def test_it_reports_what_the_appearance_shows_and_who_it_is(shown, gallery):
    x, _ = shown
    model = recognition(gallery)
    learned = watch(model, x[5:10])[-1]
    assert model.diagnose(learned) == {"posterior": learned.posterior, "entropy": learned.entropy}
    assert [one.name for one in model.diagnostics] == ["posterior", "entropy"]
    for (name, inset), (other, expected) in zip(
        model.insets(learned), model.appearance.insets(learned.appearance), strict=True
    ):
        assert name == other
        np.testing.assert_array_equal(inset, expected)
    frame = picture(x[6], 9)
    at = X0[None]
    patches = model.appearance.patches.read(frame, at, 1)
    assert model.error(learned, patches) == model.appearance.error(learned.appearance, patches)
    assert model.distances(learned, frame, at) == model.appearance.distances(learned.appearance, frame, at)


def test_a_gallery_of_another_template_is_refused(gallery, tmp_path):
    gallery.save(tmp_path / "small.npz")
    recipe = load_recipe("adaptive_recognition", [f"recognition.gallery={tmp_path / 'small.npz'}"])
    with pytest.raises(RecipeError, match="faces are 10 points high and 8 wide, and the recipe's template is 30 poi"):
        check_gallery(recipe)


def test_a_start_without_a_face_is_refused(gallery):
    with pytest.raises(InputError, match="frame 0"):
        recognition(gallery).init(picture(np.zeros(D)), np.array([[40.0, 50.0, 0.5, 0, 0, 0.5]]))


@pytest.mark.parametrize(
    ("proportion", "told"), [(None, 0), (0.8, 0), (0.95, 0), (1.0, 1), (0.68, 0), (0.64, 1), (3.0, 1)]
)
def test_a_box_of_other_proportions_than_the_gallerys_is_told(gallery, shown, proportion, told):
    model = recognition(dataclasses.replace(gallery, proportion=proportion))  # the box is 16 by 20
    notes = model.init(picture(shown[0][0]), X0).notes
    assert len(notes) == told
    assert all("16x20 pixels" in note and f"{proportion:.2f} times" in note and "begin with" in note for note in notes)
