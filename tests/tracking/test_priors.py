"""The shape prior: kernels against their twins, conditionals against the density, files, fitting, the shipped prior."""

import math

import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError, RecipeError, UsageError
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.trackers.face.assembly import StudentPrior
from facetrack_cli.trackers.points.point_kernels import LANES, PADDING, parzen
from facetrack_cli.trackers.points.shape_prior import (
    BoundPrior,
    ShapePrior,
    default_prior_path,
    fit_prior,
    load_prior,
)
from facetrack_cli.trajectory.trajectory import COLUMNS, joined, one_part
from facetrack_cli.trajectory.writers import csv_frames
from tests.support.samples import from_tools
from tests.twins import points as naive_shape

PARTS = ("nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower")
FACE = np.array([[141.0, 112.5], [120.0, 140.0], [160.0, 141.0], [140.0, 133.0], [139.0, 147.0]])
SCALE = ("mouth_left", "mouth_right")
NOSE = 0


def some_prior(shapes=6, seed=0, spread=0.15):
    moved = np.random.default_rng(seed).normal(0.0, spread, (shapes, 5, 2))
    moved[:, NOSE] = 0.0
    return ShapePrior(PARTS, moved, "nose", SCALE)


def some_particles(n, seed=1, spread=6.0):
    return FACE + np.random.default_rng(seed).normal(0.0, spread, (n, 5, 2))


# --- kernels -----------------------------------------------------------------------------------------------------


def kernel_arguments(rng, parts, stable, shapes):
    h = rng.normal(0.0, 2.0, (shapes, len(parts), 2))
    if stable < 0:
        h -= h.mean(1, keepdims=True)
    padding = -shapes % LANES
    flat = np.ascontiguousarray(np.pad(h.reshape(shapes, -1).T, ((0, 0), (0, padding))), np.float32)
    bias = np.concatenate([-0.5 * (h**2).sum((1, 2)), np.full(padding, PADDING)]).astype(np.float32)
    return h, flat, bias


@pytest.mark.parametrize("shapes", [1, 7, 8, 30])
@pytest.mark.parametrize(("parts", "stable"), [([1, 2, 3, 4], 0), ([0, 3], 2), ([1, 2, 3, 4], -1), ([3], -1)])
def test_kernels_agree_with_their_plain_twins(parts, stable, shapes):
    rng = np.random.default_rng(shapes)
    h, flat, bias = kernel_arguments(rng, parts, stable, shapes)
    x, u = some_particles(25), rng.random(25)
    sums, chosen = parzen(x, np.array(parts), FACE, stable, 5.5, flat, bias, u)
    plain = (parts, FACE, stable, 5.5, h)
    np.testing.assert_allclose(sums, naive_shape.log_parzen(x, *plain), rtol=1e-6, atol=1e-5)
    assert (chosen == naive_shape.pick_shape(x, *plain, u)).all()


@pytest.mark.parametrize("u", [0.0, np.nextafter(1.0, 0.0)])
def test_the_ends_of_the_uniform_pick_a_shape_that_exists(u):
    for shapes in (1, 7, 9, 401):
        _, flat, bias = kernel_arguments(np.random.default_rng(3), [1, 2, 3, 4], 0, shapes)
        for scale in (1.0, 1e3, 1e6):  # far away all weights but one are nothing
            x = FACE + scale * np.random.default_rng(4).normal(size=(50, 5, 2))
            chosen = parzen(x, np.array([1, 2, 3, 4]), FACE, 0, 5.5, flat, bias, np.full(50, u))[1]
            assert (chosen >= 0).all() and (chosen < shapes).all()


# --- density -----------------------------------------------------------------------------------------------------


def test_density_of_one_shape_is_a_gaussian_of_the_distance():
    moved = np.zeros((1, 5, 2))
    moved[0, 4] = 0.0, 0.5  # the lower lip half a mouth down
    bound = BoundPrior(ShapePrior(PARTS, moved, "nose", SCALE), PARTS, FACE, 0.1)
    length = np.hypot(40.0, 1.0)
    at = FACE.copy()
    at[4, 1] += 0.5 * length
    off = at.copy()
    off[3, 0] += 0.2 * length  # two standard deviations
    assert bound.log_density(np.stack([at, off])) == pytest.approx([0.0, -2.0], abs=1e-5)


def student(prior, parts, first, sigma=0.1, freedom=4.0):
    return StudentPrior(BoundPrior(prior, parts, first, sigma), freedom)


@pytest.mark.parametrize("bound", [BoundPrior, student])
def test_density_follows_the_face_and_its_size_and_not_the_order_of_parts(bound):
    prior, x = some_prior(), some_particles(50)
    expected = bound(prior, PARTS, FACE, 0.1).log_density(x)
    moved = bound(prior, PARTS, FACE, 0.1).log_density(x + np.array([37.0, -12.5]))
    np.testing.assert_allclose(moved, expected, rtol=1e-6)
    np.testing.assert_allclose(bound(prior, PARTS, 3 * FACE + 7.0, 0.1).log_density(3 * x), expected, rtol=1e-6)
    order = [3, 0, 4, 2, 1]
    shuffled = bound(prior, [PARTS[i] for i in order], FACE[order], 0.1)
    np.testing.assert_allclose(shuffled.log_density(x[:, order]), expected, rtol=1e-6)


# --- Student t ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("freedom", [1.0, 4.0, 300.0])
def test_the_student_density_is_the_formula(freedom):
    prior, x = some_prior(7), some_particles(25)
    others, length = [1, 2, 3, 4], np.hypot(40.0, 1.0)
    plain = naive_shape.log_student(x, others, FACE, NOSE, length, prior.shapes[:, others], freedom, 0.05)
    np.testing.assert_allclose(student(prior, PARTS, FACE, freedom=freedom).log_density(x), plain, rtol=1e-9)


def test_the_student_density_is_highest_at_rest_and_falls_slowly():
    prior = student(load_prior(default_prior_path()), PARTS, FACE)
    way = np.random.default_rng(5).normal(size=(5, 2))
    assert prior.log_density(FACE[None]) == pytest.approx([0.0], abs=1e-12)
    values = prior.log_density(np.stack([FACE + r * way for r in (1.0, 1e2, 1e4, 1e8, 1e50)]))
    assert np.isfinite(values).all() and (np.diff(values) < 0).all()
    # far out as a power of the distance, so that a window that is sure is believed
    assert values[3] - values[2] == pytest.approx(-(4 + 8) * np.log(1e4), rel=1e-3)
    assert prior.log_density(np.empty((0, 5, 2))).shape == (0,)


def test_a_recipe_that_draws_from_a_student_prior_is_refused():
    with pytest.raises(RecipeError, match="student_t proposes no parts; remove from_prior, or write parzen"):
        load_recipe("face", ["filter.from_prior=0.1"])


# --- conditionals ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("part", [0, 4])
def test_proposals_are_drawn_from_the_conditional(part):
    bound = BoundPrior(some_prior(), PARTS, FACE, 0.08)
    x = np.repeat(some_particles(1, seed=part, spread=3.0), 100_000, 0)
    drawn = bound.propose(np.random.default_rng(7), x, part)
    hidden = x.copy()
    hidden[:, part] = np.nan  # the part that it places is not read
    assert (bound.propose(np.random.default_rng(7), hidden, part) == drawn).all()
    # cells of 3 pixels, their probabilities by the density on a grid of 0.5
    low, high = drawn[:500].min(0) - 15, drawn[:500].max(0) + 15
    places = np.stack(np.meshgrid(*map(np.arange, low, high, (0.5, 0.5))), -1).reshape(-1, 2)
    # the density, per square pixel, with which the part is drawn there
    full = x[: len(places)].astype(np.float64)
    full[:, part] = places
    all_, others = (parzen(full, *table, np.empty(0))[0] for table in (bound._all, bound._without[part]))
    spread = bound._width / (math.sqrt(len(bound.moving)) if part == bound.stable else 1)
    mass = np.exp(all_ - others - math.log(2 * math.pi * spread**2)) * 0.25
    assert mass.sum() == pytest.approx(1.0, abs=1e-4)
    low = places.min(0) - 0.25
    size = np.ceil((places.max(0) + 0.25 - low) / 3.0).astype(int)
    cells = [(np.arange(n + 1) * 3.0 + start) for n, start in zip(size, low, strict=True)]
    expected = np.histogram2d(*places.T, bins=cells, weights=mass)[0].ravel() * len(drawn)
    found = np.histogram2d(*drawn.T, bins=cells)[0].ravel()
    assert found.sum() > 0.999 * len(drawn)
    common = expected > 20
    chi2 = ((found - expected)[common] ** 2 / expected[common]).sum() / common.sum()
    assert chi2 < 1.6, chi2  # 1 in expectation
    np.testing.assert_allclose(drawn.mean(0), (places * mass[:, None]).sum(0) / mass.sum(), atol=0.05)


# --- binding, files ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("parts", "first", "sigma", "error", "said"),
    [
        ((*PARTS, "brow"), np.vstack([FACE, FACE[:1]]), 0.1, RecipeError, "tracks nose, .*, brow; fit a prior"),
        (PARTS[:4], FACE[:4], 0.1, RecipeError, "lip_lower, and the recipe tracks .*, lip_upper;"),
        ((*PARTS[:4], "nose"), FACE, 0.1, RecipeError, "lip_lower"),
        (PARTS, FACE * 0.0, 0.1, InputError, "same place"),
    ],
)
def test_what_does_not_fit_together_is_refused(parts, first, sigma, error, said):
    with pytest.raises(error, match=said) as caught:
        BoundPrior(some_prior(), parts, first, sigma)
    assert "\n" not in str(caught.value)


# --- fitting -----------------------------------------------------------------------------------------------------


def write_truth(path, frames, status=None, parts=PARTS, target="face", first_frame=0):
    """frames (T, K, 2); status {(frame, part): word}."""
    t = np.arange(len(frames))
    found = []
    for name, (x, y) in zip(parts, np.moveaxis(np.asarray(frames), 0, 2), strict=True):
        words = [(status or {}).get((int(at), name), "visible") for at in t]
        found.append(one_part(target, name, t + first_frame, time_s=t / 25, x=x, y=y, status=words))
    text = "" if path.exists() else ",".join(COLUMNS) + "\n"
    with path.open("a") as file:
        file.write(text + "".join(csv_frames(joined(found))))
    return path


def talking(frames=40, drift=3.0):
    """The mouth opens and shuts while the head wanders; in the first frame it is shut."""
    t = np.arange(frames)[:, None]
    moved = np.repeat(FACE[None], frames, 0) + drift * np.stack([t, np.sin(t)], -1)
    moved[:, 4, 1] += 20.0 * np.sin(np.pi * t[:, 0] / frames) ** 2
    return moved


def test_fit_registers_as_published(tmp_path):
    frames = talking()
    prior, files = fit_prior([write_truth(tmp_path / "a.csv", frames)])
    assert prior.parts == PARTS
    assert files == ((tmp_path / "a.csv", 40, 40),)
    length = np.hypot(40.0, 1.0)
    opening = 20.0 * np.sin(np.pi * np.arange(40) / 40) ** 2 / length
    assert prior.shapes[:, 4, 1].max() == pytest.approx(opening.max(), abs=1e-3)
    assert np.abs(prior.shapes[:, :4]).max() < 1e-4  # the head's way is gone; the file rounds to 0.001 px
    bound = BoundPrior(prior, PARTS, frames[0], 0.05)
    closed_further = frames[:1].copy()
    closed_further[0, 4, 1] -= 20.0
    assert bound.log_density(frames).min() > bound.log_density(closed_further)[0] + 10.0


def test_fit_skips_frames_in_which_a_part_is_not_seen(tmp_path):
    frames = talking()
    frames[:3] += np.random.default_rng(0).normal(0.0, 30.0, (3, 5, 2))  # nonsense, but marked
    frames[20, 4] = 500.0, 0.0
    hidden = {(0, "nose"): "hidden", (1, "lip_lower"): "absent", (2, "mouth_left"): "lost"}
    hidden[20, "lip_lower"] = "hidden"
    prior, files = fit_prior([write_truth(tmp_path / "a.csv", frames, hidden)])
    assert files[0][1:] == (40, 36)
    assert np.abs(prior.shapes[0]).max() == 0.0  # frame 3 is the neutral one
    assert np.abs(prior.shapes[:, :4]).max() < 1e-4


def test_each_file_and_target_has_its_own_neutral_frame(tmp_path):
    path = write_truth(tmp_path / "a.csv", talking(10))
    write_truth(path, 2.0 * talking(10) + 100.0, target="other")
    twice = write_truth(tmp_path / "b.csv", talking(10) + 50.0, first_frame=7)
    one, _ = fit_prior([write_truth(tmp_path / "c.csv", talking(10))])
    prior, files = fit_prior([path, twice])
    assert [seen for _, _, seen in files] == [20, 10]
    # the same movements in another size and place add (next to) nothing
    np.testing.assert_allclose(prior.shapes, one.shapes, atol=1e-3)


def test_thinning_keeps_the_rare_and_is_repeatable(tmp_path):
    frames = np.concatenate([np.repeat(FACE[None], 300, 0), talking(30)])
    frames[:300] += np.random.default_rng(1).normal(0.0, 0.3, (300, 5, 2))
    frames[0] = FACE
    path = write_truth(tmp_path / "a.csv", frames)
    prior, _ = fit_prior([path], max_shapes=12)
    assert len(prior.shapes) == 12
    assert prior.shapes[:, 4, 1].max() == pytest.approx(0.5, abs=0.02)
    assert (fit_prior([path], max_shapes=12)[0].shapes == prior.shapes).all()
    still = write_truth(tmp_path / "still.csv", np.repeat(FACE[None], 50, 0))
    assert len(fit_prior([still])[0].shapes) == 1


def test_fit_says_what_is_wrong(tmp_path):
    good = write_truth(tmp_path / "good.csv", talking())
    four = write_truth(tmp_path / "four.csv", talking()[:, :4], parts=PARTS[:4])
    hidden = write_truth(tmp_path / "hidden.csv", talking(5), {(t, "nose"): "hidden" for t in range(5)})
    flat = write_truth(tmp_path / "flat.csv", np.ones((4, 5, 2)))
    wild = np.repeat(FACE[None], 3, 0)
    wild[1, 3] = 1e5
    wild = write_truth(tmp_path / "wild.csv", wild)
    for paths, given, error, said in [
        ([good, four], {}, InputError, "four.csv: there is no part lip_lower"),
        ([hidden], {}, InputError, "none of its 5 frames"),
        ([flat], {}, InputError, "frame 0: .* are 0.00 apart"),
        ([wild], {}, InputError, "wild.csv: frame 1: a part of face moves"),
        ([good], {"parts": ["nose", "lip_upper"]}, UsageError, "here are nose, lip_upper, with nose and mouth_left"),
        ([good], {"stable": "ear"}, UsageError, "with ear and .* --stable"),
        ([good], {"parts": [*PARTS, "nose"]}, UsageError, "named once"),
    ]:
        with pytest.raises(error, match=said) as caught:
            fit_prior(paths, **given)
        assert "\n" not in str(caught.value)


# --- the shipped prior, commands ---------------------------------------------------------------------------------


def test_the_shipped_prior_is_what_the_script_makes(tmp_path):
    script = from_tools("mouth_prior")
    script.make().save(tmp_path / "again.npz")
    script.make().save(tmp_path / "twice.npz")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "twice.npz").read_bytes()
    made, shipped = load_prior(tmp_path / "again.npz"), load_prior(default_prior_path())
    assert (made.parts, made.stable, made.scale) == (shipped.parts, shipped.stable, shipped.scale)
    # not by its bytes: another NumPy lays the file out differently
    np.testing.assert_allclose(made.shapes, shipped.shapes, rtol=0, atol=1e-12)


def test_the_shipped_prior_knows_the_mouth():
    prior = load_prior(default_prior_path())
    assert prior.parts == PARTS
    assert 300 <= len(prior.shapes) <= 500
    assert np.abs(prior.shapes[0]).max() == 0.0
    mirrored = prior.shapes[:, [0, 2, 1, 3, 4]] * [-1, 1]
    assert {s.tobytes() for s in np.round(mirrored, 4) + 0.0} == {s.tobytes() for s in np.round(prior.shapes, 4) + 0.0}
    still, none = np.zeros(2), {}
    opens = {"lip_lower": (0, 0.45), "lip_upper": (0, -0.12), "mouth_left": (0.03, 0.05), "mouth_right": (-0.03, 0.05)}
    smile = {"mouth_left": (-0.11, -0.1), "mouth_right": (0.11, -0.1), "lip_upper": (0, -0.05), "lip_lower": (0, -0.03)}
    wrong = {"mouth_left": (0.1, 0.8)}, {"lip_upper": (0.5, 0.1)}, {"mouth_left": (1, 0), "mouth_right": (-1, 0)}
    faces = [FACE + 40.0 * np.array([by.get(part, still) for part in PARTS]) for by in (none, opens, smile, *wrong)]
    known = BoundPrior(prior, PARTS, FACE, 0.1).log_density(np.stack(faces))
    assert known[:3].min() > known[3:].max() + 5.0


def test_commands(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_truth(tmp_path / "clip.truth.csv", talking(), {(5, "nose"): "hidden"})
    assert main(["prior", "fit", "clip.truth.csv", "-o", "own.npz"]) == 0
    out, err = capsys.readouterr()
    assert out == ""
    assert "clip.truth.csv: 39 of 40 frames used, 1 skipped" in err and "suggested sigma: 0.0" in err
    assert main(["prior", "fit", "clip.truth.csv", "-o", "own.npz"]) == 2  # it is there already
    assert "--overwrite" in capsys.readouterr().err
    assert main(["prior", "fit", "clip.truth.csv", "-o", "own.npz", "--overwrite", "-q"]) == 0
    assert capsys.readouterr().err == ""
    assert main(["prior", "show", "own.npz"]) == 0
    assert "lip_lower" in capsys.readouterr().out
    assert main(["prior", "show"]) == 0
    assert "401 shapes of 5 parts" in capsys.readouterr().out
    assert main(["prior", "show", "clip.truth.csv"]) == 3
    assert main(["prior", "fit", "clip.truth.csv", "-o", "y.npz", "--scale", "nose"]) == 2
    assert {path.name for path in tmp_path.iterdir()} == {"clip.truth.csv", "own.npz"}
