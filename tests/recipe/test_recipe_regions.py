"""Recipes of regions: the shipped ones, what does not go together, and what their numbers may be."""

import json

import pytest

from facetrack_cli.core.errors import RecipeError
from facetrack_cli.recipe.files import shipped_recipes
from facetrack_cli.recipe.load import check_recipe, load_recipe
from facetrack_cli.recipe.model import to_dict
from facetrack_cli.recipe.sections import LengthOrNone

NAMES = [path.stem for path in shipped_recipes() if hasattr(load_recipe(path.stem), "likelihood")]
NAMES = [name for name in NAMES if load_recipe(name).likelihood.type == "product"]
FACTORS = ("contour", "histogram", "correlation")


def refused(name, *overrides):
    with pytest.raises(RecipeError) as caught:
        load_recipe(name, overrides)
    return str(caught.value)


def test_there_is_a_recipe_for_each_combination_of_the_paper():
    objects = ("contour", "histogram", "contour_histogram")
    published = {one + end for one in objects for end in ("", "_correlation")}
    assert set(NAMES) == published | {"contour_histogram_correlation_robust"}


@pytest.mark.parametrize("name", NAMES)
def test_a_recipe_is_named_by_its_factors_and_reads_like_a_method_section(name):
    recipe = load_recipe(name)
    assert check_recipe(name) == []
    assert [f for f in FACTORS if getattr(recipe.likelihood, f) is not None] == name.removesuffix("_robust").split("_")
    assert recipe.points == () and recipe.filter.type == "sir" and recipe.filter.particles == 200
    lines = recipe.path.read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 40 and max(map(len, lines)) <= 120
    comment = " ".join(line.removeprefix("#").strip() for line in lines if line.startswith("#"))
    assert lines[0].startswith("# Odobez") and "section" in comment and "figure 2" in comment
    assert len(recipe.description) <= 100


def test_recipes_differ_in_their_factors_alone():
    recipes = [load_recipe(name) for name in NAMES]
    for section in ("target", "motion", "filter"):
        assert len({getattr(recipe, section).model_dump_json() for recipe in recipes}) == 1, section
    for factor in ("contour", "histogram"):
        given = [getattr(recipe.likelihood, factor) for recipe in recipes]
        different = {one.model_dump_json(exclude={"independent"}) for one in given if one is not None}
        assert len(different) == 1, factor


def test_the_robust_recipe_differs_by_its_correlation_and_by_what_is_independent_alone():
    robust, published = (to_dict(load_recipe("contour_histogram_correlation" + end)) for end in ("_robust", ""))
    assert robust.pop("description") != published.pop("description")
    assert robust["likelihood"].pop("correlation")["distance"] == "saturated_l1"
    assert published["likelihood"].pop("correlation")["distance"] == "l2"
    independent = [one["likelihood"]["contour"].pop("independent") for one in (robust, published)]
    assert independent == ["estimated", "all"]
    assert [one["confidence"].pop("calibration") is None for one in (robust, published)] == [False, True]
    assert robust == published


@pytest.mark.parametrize("name", NAMES)
def test_a_dump_is_the_same_recipe(name, tmp_path):
    recipe = load_recipe(name, ["motion.position.B=[[0.1, 2px], [0, 0.05]]"])
    assert to_dict(recipe)["motion"]["position"]["B"] == [[0.1, "2px"], [0.0, 0.05]]
    path = tmp_path / "again.json"
    path.write_text(json.dumps(to_dict(recipe)))
    assert to_dict(load_recipe(str(path))) == to_dict(recipe)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("target.scale=[1.5, 2]", "with 1, the size at the start, between them"),
        ("target.scale=[0, 2]", "target.scale[1] must be greater than 0"),
        ("motion={type: random_walk, sigma: {nose: 0.1, default: 0.2}}", '"nose" in motion.sigma is no part'),
        ("likelihood={type: colour_ratio}", "write product or skin_ncc"),
        ("filter={type: factorized, particles: 9}", "write sir or auxiliary"),
        ("prior={type: parzen, file: mouth_prior.npz, sigma: 0.1}", "write null"),
        ("motion.position.A=[[1, 1], [0, 1.1]]", "makes the state grow 1.1-fold each frame"),
        ("motion.scale.A=[[0, -2], [2, 0]]", "makes the state grow 2-fold each frame"),
        ("motion.scale.A=[[-3, 0], [0, 0.5]]", "makes the state grow 3-fold each frame"),
        ("motion.position.B=[[0.1, 0], [0.1]]", "need the same number of sources of noise"),
        ("motion.position.B=[[-1], [0]]", "must be 0 or a length"),
        ("motion.position.B=[[], []]", "at least 1 items"),
        ("motion.scale.B=[[-1], [0]]", "must be at least 0"),
        ("likelihood.histogram=null", "likelihood has no factor; add contour, histogram or correlation"),
        ("likelihood.correlation={sigma: 9, saturation: 5}", "saturation has no meaning for distance: l2"),
        ("likelihood.correlation={sigma: 9, distance: saturated_l1}", "saturated_l1 needs saturation"),
        ("likelihood.histogram.regions=[0, 3]", "must be at least 1"),
        ("likelihood.histogram.bins=3", 'unknown key "bins" in "likelihood.histogram"'),
        ("likelihood.contours={}", 'unknown key "contours" in "likelihood"; did you mean "contour"?'),
    ],
)
def test_what_cannot_be_is_refused(override, message):
    assert message in refused("histogram", override)


def test_points_do_not_take_what_regions_have():
    dynamics = "{A: [[1, 0], [0, 0]], B: [[0.1], [0]]}"
    said = refused("sir", f"motion={{type: first_order, position: {dynamics}, scale: {dynamics}}}")
    assert 'motion type "first_order" does not go with target type "points"; write random_walk' in said
    said = refused("sir", "likelihood={type: product, correlation: {sigma: 9}}")
    assert 'likelihood type "product" does not go with target type "points"; write colour_ratio' in said


def test_no_noise_is_a_length_of_dynamics_but_no_size_of_anything():
    none = LengthOrNone(0.0)
    recipe = load_recipe("contour", ["motion.position.B=[[0, 3px], [0.0, 0]]"])
    noise = recipe.motion.position.B
    assert noise == ((none, LengthOrNone(3.0, px=True)), (none, none))
    assert "must be a length above 0" in refused("contour", "likelihood.contour.sigma=0")
