"""The gallery: eq. 14 to 16 against plain twins and the normal density, made-up people, calibration, files."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facetrack_cli.core.errors import InputError
from facetrack_cli.trackers.appearance.gallery import NONE, Gallery, load_gallery, logistic
from facetrack_cli.trackers.appearance.gallery_fit import (
    Samples,
    equal_errors,
    fit_gallery,
    fit_logistic,
    off_the_mark,
)
from facetrack_cli.trackers.appearance.subspaces import (
    MIN_RHO,
    Moments,
    Subspace,
    common_basis,
    fit_subspace,
    folds_by,
)
from tests.twins import gallery as naive_gallery

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
    names = [f"person {p}" for p in range(number) for _ in range(pictures)]
    return normalised(x + rng.normal(0.0, 0.05, x.shape)), names


@pytest.fixture(scope="module")
def gallery():
    return fit_gallery(*people(), SHAPE, proportion=0.8)


def some_subspace(rng, d, s):
    vectors = np.linalg.qr(rng.normal(size=(d, d)))[0][:s]
    mean, values = rng.normal(size=d), rng.uniform(0.5, 3.0, s)
    return Subspace(mean.astype(np.float32), vectors.astype(np.float32), values, rng.uniform(0.1, 0.4))


def as_lists(space):
    return space.mean.tolist(), space.vectors.tolist(), space.values.tolist(), space.rho


# --- eq. 14 --------------------------------------------------------------------------------------------------------


@settings(max_examples=30)
@given(st.integers(1, 9), st.integers(0, 9), st.integers(0, 999))
def test_density_agrees_with_its_plain_twin_and_with_the_normal_density(d, s, seed):
    rng = np.random.default_rng(seed)
    space = some_subspace(rng, d, min(s, d))
    y = rng.normal(0.0, 2.0, (5, d))
    got = space.log_density(y)
    np.testing.assert_allclose(got, [naive_gallery.log_density(one, *as_lists(space)) for one in y.tolist()], rtol=1e-5)
    v = space.vectors.astype(np.float64)
    covariance = v.T * space.values @ v + space.rho * (np.eye(d) - v.T @ v)
    centred = y - space.mean
    squares = (centred * np.linalg.solve(covariance, centred.T).T).sum(axis=1)
    expected = -0.5 * (squares + np.linalg.slogdet(covariance)[1] + d * np.log(2 * np.pi))
    np.testing.assert_allclose(got, expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("s", [0, 3, 9])
def test_densities_of_differences_are_those_of_each(s):
    rng = np.random.default_rng(s)
    space, y, faces = some_subspace(rng, 9, s), rng.normal(size=(5, 9)), rng.normal(size=(3, 9))
    expected = np.stack([space.log_density(y - face) for face in faces], axis=1)
    np.testing.assert_allclose(space.log_densities(y, faces), expected, rtol=1e-6)


def test_components_of_a_known_model_are_found():
    rng = np.random.default_rng(0)
    true = np.array([9.0, 4.0])
    v = np.linalg.qr(rng.normal(size=(12, 12)))[0][:2]
    x = 3.0 + rng.normal(size=(20000, 2)) * np.sqrt(true) @ v + 0.5 * rng.normal(size=(20000, 12))
    space = fit_subspace(x, folds_by(np.arange(20000) % 7), energy=0.8).whole
    np.testing.assert_allclose(space.values, true + 0.25, rtol=0.05)
    assert space.rho == pytest.approx(0.25, rel=0.02)
    np.testing.assert_allclose(np.abs(space.vectors @ v.T), np.eye(2), atol=0.03)
    np.testing.assert_allclose(space.mean, 3.0, atol=0.1)


def test_rho_is_the_mean_of_d_less_s_eigenvalues_as_printed():
    x = np.random.default_rng(1).normal(size=(9, 5)) * [3.0, 1.0, 0.5, 0.4, 0.2]
    space = fit_subspace(x, energy=0.6).whole
    values = np.sort(np.linalg.eigvalsh(np.cov(x.T)))[::-1]
    s = len(space.values)
    assert 0 < s < 5
    assert space.rho == pytest.approx(values[s:].sum() / (5 - s))
    np.testing.assert_allclose(space.values, values[:s], rtol=1e-6)


def test_rho_of_few_pictures_is_what_new_ones_leave_over():
    rng = np.random.default_rng(2)
    clips = rng.normal(size=(6, 200))
    x = np.repeat(clips, 5, axis=0) + 0.1 * rng.normal(size=(30, 200))  # six clips, of five frames that are much alike
    new = rng.normal(size=(500, 200))
    folds = folds_by(np.arange(30) // 5)
    held, printed = (fit_subspace(x, those).whole for those in (folds, ()))
    assert held.rho == pytest.approx(1.0, rel=0.25)
    assert printed.rho < 0.2
    assert held.log_density(new).mean() > printed.log_density(new).mean() + 100


def test_a_basis_changes_nothing():
    rng = np.random.default_rng(3)
    x = rng.normal(size=(15, 40)) * np.linspace(3, 0.1, 40)
    basis = np.linalg.svd(x, full_matrices=False)[2]
    folds = folds_by(np.arange(15) // 3)
    plain, reduced = fit_subspace(x, folds), fit_subspace(x, folds, basis=basis)
    y = rng.normal(size=(4, 40))
    for a, b in zip((plain.whole, *plain.without), (reduced.whole, *reduced.without), strict=True):
        np.testing.assert_allclose(a.log_density(y), b.log_density(y), rtol=1e-4)


@pytest.mark.parametrize(
    ("n", "d", "most", "rank"), [(9, 30, 12, 9), (40, 12, 12, None), (30, 40, 7, 7), (40, 30, 7, 7)]
)
def test_a_basis_has_the_largest_directions(monkeypatch, n, d, most, rank):
    monkeypatch.setattr("facetrack_cli.trackers.appearance.subspaces.MAX_ROWS", 10_000)
    x = np.random.default_rng(n).normal(size=(n, d)) * np.linspace(3, 0.1, d)
    basis = common_basis(x, most)
    if rank is None:
        assert basis is None
        return
    largest = np.linalg.svd(x, full_matrices=False)[2][:rank]
    np.testing.assert_allclose(np.abs(basis @ largest.T).round(6), np.eye(rank)[:, : len(largest)], atol=1e-6)
    monkeypatch.setattr("facetrack_cli.trackers.appearance.subspaces.MAX_ROWS", 20)
    some = common_basis(x, most)  # of evenly spread rows
    assert some.shape == basis.shape
    np.testing.assert_allclose(some @ some.T, np.eye(len(some)), atol=1e-9)


def test_rows_that_are_all_alike_have_a_density():
    space = fit_subspace(np.ones((4, 6)), folds_by(np.arange(4))).whole
    assert space.rho == MIN_RHO
    assert np.isfinite(space.log_density(np.array([[1.0] * 6, [0.0] * 6, [1e3] * 6]))).all()
    with pytest.raises(ValueError, match="no rows"):
        fit_subspace(np.ones((0, 6)))


def test_what_was_held_out_was_not_seen():
    x = np.random.default_rng(4).normal(size=(12, 6))
    folds = folds_by(np.arange(12) % 3)
    fitted = fit_subspace(x, folds, energy=0.5)
    for fold, space in zip(folds, fitted.without, strict=True):
        alone = fit_subspace(x[~fold], energy=0.5).whole
        np.testing.assert_allclose(np.abs(space.vectors @ alone.vectors.T), np.eye(len(space.values)), atol=1e-5)
        np.testing.assert_allclose(space.mean, alone.mean)


# --- what spaces are learned from ----------------------------------------------------------------------------------


def test_differences_agree_with_their_plain_twins():
    x, _ = people(3, 4)
    who = np.array([0, 0, 0, 0, 1, 2, 2, 0, 1, 2, 1, 2])
    groups = [x[who == p].tolist() for p in range(3)]
    shown = Samples(x, who, np.arange(12))
    own, of = shown.to_own()
    order = np.argsort(who[of], kind="stable")
    np.testing.assert_allclose(own[order], naive_gallery.to_own(groups), atol=1e-12)
    np.testing.assert_allclose(shown.faces, [naive_gallery.stand_in(group) for group in groups], atol=1e-12)


@settings(max_examples=30)
@given(st.lists(st.integers(0, 3), min_size=2, max_size=9), st.booleans(), st.integers(0, 999))
def test_moments_of_differences_to_others_are_those_of_the_differences(labels, reduced, seed):
    rng = np.random.default_rng(seed)
    who = np.unique(labels, return_inverse=True)[1]
    x = normalised(smooth(rng, len(who)))
    patches, persons = rng.random(len(who)) < 0.7, rng.random(who.max() + 1) < 0.7
    basis = common_basis(x, 4) if reduced else None
    groups = [x[who == p].tolist() for p in range(who.max() + 1)]
    asked = [
        patches[np.flatnonzero(who == p)[k]] and persons[q]
        for p, group in enumerate(groups) for k in range(len(group)) for q in range(len(groups)) if q != p
    ]  # fmt: skip
    rows = np.array(naive_gallery.to_others(groups)).reshape(-1, D)[np.array(asked, bool)]
    got = Samples(x, who, np.arange(len(x)), basis).to_others(patches, persons)
    z = rows if basis is None else rows @ basis.T
    expected = Moments.of(z, (rows**2).sum(1))
    assert got.count == expected.count
    np.testing.assert_allclose(got.total, expected.total, atol=1e-9)
    np.testing.assert_allclose(got.products, expected.products, atol=1e-9)
    assert got.square == pytest.approx(expected.square, abs=1e-9)


def test_one_picture_stands_for_a_person_as_published():
    x, _ = people(2, 2)
    shown = Samples(x, np.array([0, 0, 1, 1]), np.arange(4))
    own, _ = shown.to_own()
    np.testing.assert_array_equal(own, [x[0] - x[1], x[1] - x[0], x[2] - x[3], x[3] - x[2]])
    alone = fit_gallery(x[:3], ["a", "a", "b"], SHAPE)
    np.testing.assert_array_equal(alone.faces[1], x[2].astype(np.float32))


def test_copies_are_compared_with_other_pictures_or_with_their_own():
    x, _ = people(2, 3)
    shown = Samples(x, np.array([0, 0, 0, 1, 1, 1]), np.array([0, 0, 1, 2, 2, 2]))
    own, of = shown.to_own()
    np.testing.assert_array_equal(own, [x[0] - x[2], x[1] - x[2], x[2] - x[0], x[4] - x[3], x[5] - x[3]])
    assert of.tolist() == [0, 1, 2, 4, 5]
    np.testing.assert_array_equal(shown.faces[1], x[3])


def test_patches_off_the_mark_are_normalised():
    wrong = off_the_mark(np.concatenate([people(2, 2)[0], np.zeros((1, D))]), SHAPE)
    assert len(wrong) == 35
    np.testing.assert_allclose(wrong[:28].std(1), 1.0)
    assert not wrong[28:].any()


# --- calibration ---------------------------------------------------------------------------------------------------


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e5), st.floats(-8.0, 8.0), st.integers(0, 99))
def test_calibration_grows_with_the_score(centre, unit, gap, seed):
    rng = np.random.default_rng(seed)
    slope, offset = fit_logistic(centre + unit * (gap + rng.normal(size=30)), centre + unit * rng.normal(size=50))
    at = centre + unit * np.linspace(-20, 20, 50)
    p = logistic(at, slope, offset)
    assert slope >= 0 and np.isfinite(offset)
    assert (np.diff(p) >= 0).all() and ((p >= 0) & (p <= 1)).all()
    if gap > 2:
        assert logistic(np.array(centre + unit * gap), slope, offset) > 0.75
        assert logistic(np.array(centre), slope, offset) < 0.25


def test_calibration_of_known_probabilities():
    # two normals of variance 1 at 0 and 2: the log odds are 2 x - 2
    rng = np.random.default_rng(5)
    slope, offset = fit_logistic(2.0 + rng.normal(size=40000), rng.normal(size=20000))
    assert (slope, offset) == (pytest.approx(2.0, rel=0.05), pytest.approx(-2.0, rel=0.05))
    assert fit_logistic(rng.normal(size=500), 3.0 + rng.normal(size=500)) == (0.0, 0.0)


def test_threshold_of_equal_errors():
    rng = np.random.default_rng(6)
    threshold, errors = equal_errors(2.0 + rng.normal(size=20000), rng.normal(size=30000))
    assert (threshold, errors) == (pytest.approx(1.0, abs=0.03), pytest.approx(0.1587, abs=0.01))
    assert equal_errors(np.array([5.0, 6.0]), np.array([1.0, 2.0, 3.0])) == (4.0, 0.0)


# --- the gallery ---------------------------------------------------------------------------------------------------


@settings(max_examples=15)
@given(st.integers(0, 999))
def test_scores_agree_with_their_plain_twin(gallery, seed):
    rng = np.random.default_rng(seed)
    y = normalised(FACE + smooth(rng, 3)).astype(np.float32)
    spaces = as_lists(gallery.intra), as_lists(gallery.extra)
    expected = np.array(
        [[naive_gallery.log_ratio(one, face, *spaces) for face in gallery.faces.tolist()] for one in y.tolist()]
    )
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
    log_q = np.array([naive_gallery.log_density(one, *as_lists(gallery.frontal)) for one in y.tolist()])
    np.testing.assert_allclose(p_f, gallery.most_frontal * logistic(log_q, *gallery.calibration), atol=1e-4)


@pytest.mark.parametrize("pictures", [2, 6])
def test_everybody_of_a_gallery_is_recognised(pictures):
    x, names = people(6, pictures + 10)
    known = np.arange(len(x)) % (pictures + 10) < pictures
    gallery = fit_gallery(x[known], [name for name, k in zip(names, known, strict=True) if k], SHAPE)
    assert gallery.names == tuple(f"person {p}" for p in range(6))
    assert gallery.counts == (pictures,) * 6
    p_f, log_n = gallery.log_scores(x[~known].astype(np.float32))
    assert ([gallery.names[k] for k in log_n.argmax(1)] == np.array(names)[~known]).mean() > 0.98
    assert np.median(p_f) > 0.6 * gallery.most_frontal


def test_strangers_are_nobody():
    x, names = people(24, 8, change=0.2)
    whose = np.array(names)
    known = np.arange(len(x)) < 18 * 8
    shown = np.arange(len(x)) % 8 < 5
    gallery = fit_gallery(x[known & shown], whose[known & shown].tolist(), SHAPE)
    y = x.astype(np.float32)
    _, log_n = gallery.log_scores(y, none=True)
    nobody = log_n.argmax(1) == 18
    assert nobody[~known].mean() > 0.9
    assert nobody[known & ~shown].mean() < 0.15
    assert 0.0 <= gallery.errors < 0.2


def test_a_frontal_face_is_told_from_patches_off_the_mark():
    x, names = people(8, 4)
    rng = np.random.default_rng(9)
    gallery = fit_gallery(x, names, SHAPE, negatives=normalised(smooth(rng, 60)))
    frontal, _ = gallery.log_scores(normalised(1.5 * FACE + smooth(rng, 50)).astype(np.float32))
    wrong, _ = gallery.log_scores(normalised(smooth(rng, 50)).astype(np.float32))
    assert np.median(frontal) > 2 * np.median(wrong)
    assert ((frontal >= 0) & (frontal <= gallery.most_frontal)).all()
    assert dataclasses.replace(gallery, most_frontal=0.2).log_scores(x.astype(np.float32))[0].max() <= 0.2


def test_a_gallery_of_single_pictures():
    x, names = people(4, 6)
    first = np.arange(len(x)) % 6 == 0
    with pytest.raises(InputError, match="light, expression and pose cannot be learned"):
        fit_gallery(x[first], np.array(names)[first].tolist(), SHAPE)
    copies = fit_gallery(x, names, SHAPE, images=np.arange(len(x)) // 6)
    assert copies.counts == (1, 1, 1, 1)
    np.testing.assert_array_equal(copies.faces, x[first].astype(np.float32))
    assert copies.notes == (
        "person 0, person 1, person 2, person 3: one image each: how their faces change with light, expression and "
        "pose cannot be learned from it; add further images",
    )
    one = fit_gallery(x[:7], names[:7], SHAPE)
    assert one.notes == (
        "person 1: one image: how this face changes with light, expression and pose cannot be learned from it; "
        "add further images",
    )
    assert not fit_gallery(x, names, SHAPE).notes


def test_people_who_are_hardly_told_apart_are_told():
    x, _ = people(1, 24)
    mixed = [f"person {k % 4}" for k in range(24)]  # one face under four names
    [note] = fit_gallery(x, mixed, SHAPE).notes
    assert "hardly told apart" in note and "equal error rate" in note


def test_one_person_is_no_gallery():
    x, _ = people(1, 3)
    with pytest.raises(InputError, match="of 1 person tells nobody apart"):
        fit_gallery(x, ["anna"] * 3, SHAPE)


@pytest.mark.parametrize("name", ["", "a\nb", "a\x7f", "\udc80", NONE, "None", " none "])
def test_names_that_are_none(name):
    x, _ = people(2, 2)
    with pytest.raises(InputError, match="no name of a person") as caught:
        fit_gallery(x, ["anna", "anna", name, name], SHAPE)
    assert "\n" not in str(caught.value)


# --- files ---------------------------------------------------------------------------------------------------------


def same(a, b):
    for field in dataclasses.fields(Gallery):
        one, other = getattr(a, field.name), getattr(b, field.name)
        if isinstance(one, Subspace):
            assert all(np.array_equal(getattr(one, f.name), getattr(other, f.name)) for f in dataclasses.fields(one))
        else:
            assert np.array_equal(one, other)


def test_a_gallery_is_what_was_saved(gallery, tmp_path):
    x, _ = people(2, 4)
    named = fit_gallery(x, ["Ł. 王", "Ł. 王", "O'Neil, Jr", "O'Neil, Jr"] * 2, SHAPE)
    for one in (gallery, named, dataclasses.replace(gallery, notes=("a", "longer"), proportion=None)):
        path = tmp_path / "faces.npz"
        one.save(path)
        read = load_gallery(path)
        same(one, read)
        read.save(tmp_path / "again.npz")
        assert path.read_bytes() == (tmp_path / "again.npz").read_bytes()
        y = x.astype(np.float32)
        np.testing.assert_array_equal(one.log_scores(y, none=True)[1], read.log_scores(y, none=True)[1])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["again.npz", "faces.npz"]


def refused(path):
    with pytest.raises(InputError) as caught:
        load_gallery(path)
    message = str(caught.value)
    assert message.startswith(str(path)) and "\n" not in message
    return message


def arrays_of(gallery, path):
    gallery.save(path)
    with np.load(path) as file:
        return dict(file)


DAMAGE = {
    "infinite": ("intra_mean", lambda a: a + np.inf, "not finite"),
    "negative": ("extra_values", lambda a: -a, "not above 0"),
    "no rho": ("frontal_rho", lambda a: a * 0, "not above 0"),
    "not orthonormal": ("frontal_vectors", lambda a: 2 * a, "orthonormal"),
    "directions": ("intra_vectors", lambda a: a[:, :-1], "directions"),
    "template": ("shape", lambda a: a + 1, "template"),
    "one number": ("shape", lambda a: a[:1], "not two numbers"),
    "three": ("shape", lambda a: np.append(a, 1), "not two numbers"),
    "flat": ("proportion", lambda a: a * 0, "no such proportion"),
    "no proportion": ("proportion", lambda a: a * np.nan, "no such proportion"),
    "bytes": ("names", lambda a: a.astype("S"), "names is of"),
    "twice": ("names", lambda a: np.repeat(a[:1], len(a)), "each named once"),
    "control": ("names", lambda a: np.char.add(a, "\n"), "no name"),
    "fewer": ("names", lambda a: a[:-1], "3 persons"),
    "counts": ("counts", lambda a: a * 0, "one image or more"),
    "falls": ("calibration", lambda a: -np.abs(a) - 1, "grows"),
    "long": ("calibration", lambda a: np.append(a, 1.0), "two numbers"),
    "above 1": ("most_frontal", lambda a: a * 0 + 1.5, "probability"),
    "threshold": ("threshold", lambda a: a * np.nan, "not finite"),
    "huge": ("faces", lambda a: a * 1e6, "unit variance"),
}


@pytest.mark.parametrize("case", DAMAGE)
def test_arrays_that_do_not_fit_are_refused(gallery, tmp_path, case):
    path = tmp_path / "faces.npz"
    key, change, said = DAMAGE[case]
    arrays = arrays_of(gallery, path)
    with np.errstate(invalid="ignore"):
        np.savez(path, **(arrays | {key: change(arrays[key])}))
    assert said in refused(path)
