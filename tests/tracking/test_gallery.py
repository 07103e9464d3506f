"""Who it is: eq. 14 to 16 and figure 1 against plain twins, made-up people, calibration, files."""

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
from facetrack_cli.trackers.appearance.appearance import Appearance, Patches
from facetrack_cli.trackers.appearance.gallery import (
    MIN_RHO,
    NONE,
    Subspace,
    common_basis,
    coordinates,
    equal_errors,
    fit_gallery,
    fit_logistic,
    fit_subspace,
    folds_by,
    logistic,
    name_problem,
    stand_in,
    to_others,
    to_own,
)
from tests.support import parts
from tests.twins import appearance as naive

SHAPE = (10, 8)
D = SHAPE[0] * SHAPE[1]


def normalised(x):
    x = x - x.mean(-1, keepdims=True)
    return x / x.std(-1, keepdims=True)


def smooth(rng, n, strength=1.0):
    """(n, D): random fields that vary slowly over the patch, as faces do."""
    rows, cols = np.meshgrid(np.linspace(0, np.pi, SHAPE[0]), np.linspace(0, np.pi, SHAPE[1]), indexing="ij")
    waves = [np.cos(i * rows) * np.cos(j * cols) for i in range(4) for j in range(4) if i + j]
    return strength * rng.normal(size=(n, len(waves))) @ np.stack(waves).reshape(len(waves), -1)


FACE = smooth(np.random.default_rng(77), 1)[0]  # what all faces have in common


def people(number=4, pictures=6, seed=0, change=0.35):
    """Patches (number * images, D) and whose they are: a face of each, that changes from image to image."""
    rng = np.random.default_rng(seed)
    faces = 1.5 * FACE + smooth(rng, number)
    x = np.repeat(faces, pictures, axis=0) + smooth(rng, number * pictures, change)
    names = np.repeat([f"person {p}" for p in range(number)], pictures)
    return normalised(x + rng.normal(0.0, 0.05, x.shape)), names


def fitted(x, names, **more):
    return fit_gallery(x, list(names), SHAPE, negatives=normalised(smooth(np.random.default_rng(9), 60)), **more)


@pytest.fixture(scope="module")
def gallery():
    return fitted(*people(), proportion=0.8)


def subspaces(x, folds, basis):
    return fit_subspace(*coordinates(x, basis), folds, basis)


def as_lists(space):
    return space.mean.tolist(), space.vectors.tolist(), space.values.tolist(), space.rho


# --- eq. 14 --------------------------------------------------------------------------------------------------------


@settings(max_examples=30)
@given(st.integers(1, 9), st.integers(0, 9), st.integers(0, 999))
def test_density_agrees_with_its_plain_twin_and_with_the_normal_density(d, s, seed):
    rng = np.random.default_rng(seed)
    v = np.linalg.qr(rng.normal(size=(d, d)))[0][:s]
    mean, values = rng.normal(size=d).astype(np.float32), rng.uniform(0.5, 3.0, len(v))
    space = Subspace(mean, v.astype(np.float32), values, rng.uniform(0.1, 0.4))
    y, faces = rng.normal(0.0, 2.0, (5, d)), rng.normal(size=(3, d))
    got = space.log_density(y)
    np.testing.assert_allclose(got, [naive.log_subspace(row, *as_lists(space)) for row in y.tolist()], rtol=1e-5)
    covariance = v.T * values @ v + space.rho * (np.eye(d) - v.T @ v)
    centred = y - mean
    squares = (centred * np.linalg.solve(covariance, centred.T).T).sum(axis=1)
    expected = -0.5 * (squares + np.linalg.slogdet(covariance)[1] + d * np.log(2 * np.pi))
    np.testing.assert_allclose(got, expected, rtol=1e-4, atol=1e-4)
    differences = np.stack([space.log_density(y - face) for face in faces], axis=1)
    np.testing.assert_allclose(space.log_densities(y, faces), differences, rtol=1e-6)


def test_rho_is_the_mean_of_d_less_s_eigenvalues_as_printed():
    x = np.random.default_rng(1).normal(size=(9, 5)) * [3.0, 1.0, 0.5, 0.4, 0.2]
    space = subspaces(x, (), np.eye(5))[0]
    values = np.sort(np.linalg.eigvalsh(np.cov(x.T)))[::-1]
    s = len(space.values)
    assert 0 < s < 5
    assert space.rho == pytest.approx(values[s:].sum() / (5 - s))
    np.testing.assert_allclose(space.values, values[:s], rtol=1e-6)
    alike = subspaces(np.ones((4, 6)), folds_by(np.arange(4)), np.eye(6))[0]
    assert alike.rho == MIN_RHO


def test_a_basis_changes_nothing_and_what_was_held_out_was_not_seen():
    rng = np.random.default_rng(3)
    x, y = rng.normal(size=(15, 40)) * np.linspace(3, 0.1, 40), rng.normal(size=(4, 40))
    folds = folds_by(np.arange(15) // 3)
    plain, reduced = (subspaces(x, folds, basis) for basis in (np.eye(40), common_basis(x, 20)))
    for a, b in zip((plain[0], *plain[1]), (reduced[0], *reduced[1]), strict=True):
        np.testing.assert_allclose(a.log_density(y), b.log_density(y), rtol=1e-4)
    for fold, space in zip(folds, plain[1], strict=True):
        alone = subspaces(x[~fold], (), np.eye(40))[0]
        np.testing.assert_allclose(np.abs(space.vectors @ alone.vectors.T), np.eye(len(space.values)), atol=1e-5)
        np.testing.assert_allclose(space.mean, alone.mean)


# --- what spaces are learned from ----------------------------------------------------------------------------------


def test_differences_agree_with_their_plain_twins():
    x, _ = people(3, 4)
    who = np.array([0, 0, 0, 0, 1, 2, 2, 0, 1, 2, 1, 2])
    groups = [x[who == p].tolist() for p in range(3)]
    own, of = to_own(x, who, np.arange(12))
    order = np.argsort(who[of], kind="stable")
    np.testing.assert_allclose(own[order], naive.to_own(groups), atol=1e-12)
    np.testing.assert_allclose([stand_in(np.array(g)) for g in groups], [*map(naive.stand_in, groups)], atol=1e-12)


def test_copies_are_compared_with_other_pictures_or_with_their_own():
    x, _ = people(2, 3)
    own, of = to_own(x, np.array([0, 0, 0, 1, 1, 1]), np.array([0, 0, 1, 2, 2, 2]))
    np.testing.assert_array_equal(own, [x[0] - x[2], x[1] - x[2], x[2] - x[0], x[4] - x[3], x[5] - x[3]])
    assert of.tolist() == [0, 1, 2, 4, 5]


# --- calibration ---------------------------------------------------------------------------------------------------


def test_calibration_and_threshold_of_known_distributions():
    # two normals of variance 1 at 0 and 2: the log odds are 2 x - 2
    rng = np.random.default_rng(5)
    slope, offset = fit_logistic(2.0 + rng.normal(size=40000), rng.normal(size=20000))
    assert (slope, offset) == (pytest.approx(2.0, rel=0.05), pytest.approx(-2.0, rel=0.05))
    assert fit_logistic(rng.normal(size=500), 3.0 + rng.normal(size=500)) == (0.0, 0.0)
    threshold, errors = equal_errors(2.0 + rng.normal(size=20000), rng.normal(size=30000))
    assert (threshold, errors) == (pytest.approx(1.0, abs=0.03), pytest.approx(0.1587, abs=0.01))
    assert equal_errors(np.array([5.0, 6.0]), np.array([1.0, 2.0, 3.0])) == (4.0, 0.0)


# --- the gallery ---------------------------------------------------------------------------------------------------


@settings(max_examples=10)
@given(st.integers(0, 999))
def test_scores_agree_with_their_plain_twin(gallery, seed):
    y = normalised(FACE + smooth(np.random.default_rng(seed), 3)).astype(np.float32)
    spaces = as_lists(gallery.intra), as_lists(gallery.extra)
    expected = [[naive.log_ratio(row, face, *spaces) for face in gallery.faces.tolist()] for row in y.tolist()]
    faces = gallery.faces.astype(np.float64)
    ratios = gallery.intra.log_densities(y, faces) - gallery.extra.log_densities(y, faces)
    np.testing.assert_allclose(ratios, expected, rtol=1e-4, atol=1e-2)
    expected = np.concatenate([expected, np.full((3, 1), gallery.threshold)], axis=1)
    for sharpness in (1.0, 0.05):
        for n in (4, 5):
            p_f, log_n = gallery.log_scores(y, none=n == 5, sharpness=sharpness)
            told = expected[:, :n] - expected[:, :1]
            np.testing.assert_allclose((log_n - log_n[:, :1]) / sharpness, told, rtol=1e-3, atol=0.05)
            np.testing.assert_allclose(np.exp(log_n).sum(1), 1.0)
    log_q = np.array([naive.log_subspace(row, *as_lists(gallery.frontal)) for row in y.tolist()])
    np.testing.assert_allclose(p_f, gallery.most_frontal * logistic(log_q, *gallery.calibration), atol=1e-4)


def test_what_cannot_be_learned_is_noted_or_refused():
    x, names = people(4, 6)
    first = np.arange(len(x)) % 6 == 0
    with pytest.raises(InputError, match="light, expression and pose cannot be learned"):
        fitted(x[first], names[first])
    copies = fitted(x, names, images=np.arange(len(x)) // 6)
    assert copies.counts == (1, 1, 1, 1)
    np.testing.assert_array_equal(copies.faces, x[first].astype(np.float32))
    more = "with light, expression and pose cannot be learned from it; add further images"
    everybody = "person 0, person 1, person 2, person 3"
    assert copies.notes == (f"{everybody}: one image each: how their faces change {more}",)
    assert fitted(x[:7], names[:7]).notes == (f"person 1: one image: how this face changes {more}",)
    assert not fitted(x, names).notes
    # one face under four names
    [note] = fitted(people(1, 24)[0], [f"person {k % 4}" for k in range(24)]).notes
    assert "hardly told apart" in note and "equal error rate" in note


@pytest.mark.parametrize("name", ["", "a\nb", "a\x7f", "\udc80", NONE, "None", " none "])
def test_names_that_are_none(name):
    assert "no name of a person" in name_problem(name) and "\n" not in name_problem(name)


# --- recognition: the posterior over frames, switch, nobody, what cannot be seen -----------------------------------

X0 = np.array([[40.0, 50.0, 1.0, 0.0, 0.0, 1.0]])
SIZE = (16.0, 20.0)
SHOWN, SHOWN_NAMES = people(6, 10, change=0.2)  # patches of six people, each of ten images


@pytest.fixture(scope="module")
def half():
    """A gallery of the first five images of each."""
    known = np.arange(60) % 10 < 5
    return fitted(SHOWN[known], SHOWN_NAMES[known])


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


def watch(model, patches):
    """What is learned of the last patch, and after each the posterior and its entropy."""
    rng, learned = np.random.default_rng(0), model.init(picture(patches[0]), X0)
    said = [model.diagnose(learned)]
    for t, patch in enumerate(patches[1:], start=1):
        learned = step(model, learned, picture(patch, t), rng)[0]
        said.append(model.diagnose(learned))
    return learned, [tuple(one.values()) for one in said]


@settings(max_examples=7)
@given(st.integers(0, 999), st.booleans(), st.sampled_from([0.0, 0.1]), st.sampled_from([1.0, 0.02]))
def test_weights_and_posterior_agree_with_figure_1(half, seed, none, switch, sharpness):
    rng = np.random.default_rng(seed)
    model = recognition(half, none=none, switch=switch, sharpness=sharpness)
    first, frame = picture(SHOWN[rng.integers(60)]), picture(SHOWN[rng.integers(60)], 1)
    beta = rng.dirichlet(np.ones(len(model.names)))
    learned = dataclasses.replace(model.init(first, X0), log_beta=np.log(beta))
    after, particles = step(model, learned, frame, rng, spread=2.0)

    y = model.patches.read(frame, particles.x, 1)
    log_a = Appearance.score(model, learned, frame, particles.x)[:, 0]
    p_f, log_n = half.log_scores(y, none=none, sharpness=sharpness)
    weights, posterior = naive.figure_1(
        beta.tolist(), np.exp(log_a - log_a.max()).tolist(), p_f.tolist(), np.exp(log_n).tolist(), switch
    )
    np.testing.assert_allclose(np.exp(particles.log_w), weights, rtol=1e-4, atol=1e-12)
    said, entropy = model.diagnose(after).values()
    np.testing.assert_allclose(list(said.values()), posterior, rtol=1e-4, atol=1e-8)
    assert entropy == pytest.approx(-sum(p * math.log(p) for p in posterior if p > 0), abs=1e-4)


def test_a_stranger_is_nobody_only_where_that_is_asked_for():
    x, names = people(12, 8, change=0.12)
    known = (np.arange(96) < 80) & (np.arange(96) % 8 < 5)
    gallery = fitted(x[known], names[known])
    stranger = x[88:96]
    for patches, least, most in ((stranger, 0.9, 1.0), (x[[5, 6, 7] * 3], 0.0, 0.1)):
        assert least <= watch(recognition(gallery, none=True), patches)[1][-1][0][NONE] <= most
    assert NONE not in watch(recognition(gallery), stranger)[1][-1][0]


@pytest.mark.parametrize("none", [False, True])
@pytest.mark.parametrize("switch", [0.0, 0.5])
def test_what_cannot_be_seen_or_has_no_weight_says_nothing_of_who_it_is(half, none, switch):
    model = recognition(half, none=none, switch=switch)
    learned, _ = watch(model, [SHOWN[5]] * 3)
    deformed = [[0, 0, 0, 0], [1e6, 0, 0, 1e6], [1, 1, 1, 1]]
    wild = np.array([[1e7, -1e7, 1, 0, 0, 1], *([40, 50, *a] for a in deformed), [-9, 50, 1, 0, 0, 1]])[:, None]
    frame = picture(np.zeros(D), 3)
    scores = model.score(learned, frame, wild, wild)
    assert scores.shape == (5, 1) and np.isfinite(scores).all()
    after = model.learn(learned, frame, wild[0], Particles(wild, normalise(scores[:, 0])))
    assert np.exp(after.log_beta).sum() == pytest.approx(1.0)
    if not switch:
        # the flat ones have p_f = 0; those on an edge of the box may have a little
        only = Particles(wild[:2].copy(), np.log([0.5, 0.5]))
        after = model.learn(learned, frame, wild[0], only)
        assert np.exp(after.log_beta) == pytest.approx(np.exp(learned.log_beta))
    frame, near, far = picture(SHOWN[6], 3), X0[None], X0[None] + [[[4.0, 4.0, 0, 0, 0, 0]]]
    alone = model.learn(learned, frame, X0, Particles(near, np.zeros(1)))
    both = model.learn(learned, frame, X0, Particles(np.concatenate([near, far]), np.array([0.0, -np.inf])))
    assert np.exp(both.log_beta) == pytest.approx(np.exp(alone.log_beta))


def test_a_gallery_of_another_template_is_refused(half, tmp_path):
    half.save(tmp_path / "small.npz")
    recipe = load_recipe("adaptive_recognition", [f"recognition.gallery={tmp_path / 'small.npz'}"])
    with pytest.raises(RecipeError, match="faces are 10 points high and 8 wide, and the recipe's template is 30 poi"):
        check_gallery(recipe)


@pytest.mark.parametrize(
    ("proportion", "told"), [(None, 0), (0.8, 0), (0.95, 0), (1.0, 1), (0.68, 0), (0.64, 1), (3.0, 1)]
)
def test_a_box_of_other_proportions_than_the_gallerys_is_told(half, proportion, told):
    model = recognition(dataclasses.replace(half, proportion=proportion))  # the box is 16 by 20
    notes = model.init(picture(SHOWN[0]), X0).notes
    assert len(notes) == told
    assert all("16x20 pixels" in note and f"{proportion:.2f} times" in note and "begin with" in note for note in notes)


def test_of_many_pairs_everybody_meets_everybody_else():
    who = np.repeat(np.arange(20), 50)
    patch, other = to_others(who, 9_000)  # of 19,000
    met = np.zeros((20, 20), int)
    np.add.at(met, (who[patch], other), 1)
    assert met.sum() == 9_000 and not met.diagonal().any()
    assert met[~np.eye(20, dtype=bool)].min() > 10  # 24 on average
    assert len(to_others(who[::50])[0]) == 20 * 19
