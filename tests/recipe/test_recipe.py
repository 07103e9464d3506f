"""Recipes: shipped ones, how they are found, values, what is refused and where, and the schema."""

import json
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from facetrack_cli.core.errors import ExitCode, RecipeError
from facetrack_cli.core.models import shipped_recipes
from facetrack_cli.core.yaml_tree import MAX_BYTES, Source, YamlProblems, parse
from facetrack_cli.recipe.load import check_recipe, find_recipe, load_recipe, read_recipe, resolve_file
from facetrack_cli.recipe.model import OpenCvRecipe, json_schema, to_dict
from facetrack_cli.recipe.sections import FactorizedSettings, IndependentSettings, Length, SirSettings
from facetrack_cli.trackers.points.settings import ColourRatioSettings, PointsSettings

GOOD = """\
description: A recipe for tests
target:
  type: points
  parts: [nose, chin]
  windows: {nose: 0.5, default: 12px}
motion:
  type: random_walk
  sigma: 0.05
likelihood:
  type: colour_ratio
filter:
  type: sir
  particles: 10
"""


@pytest.fixture
def write(tmp_path):
    def write(text, name="mine.yaml"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return str(path)

    return write


def refused(path, *overrides):
    """The error of a recipe: (line, column, message), or (None, None, message) where the place is the option's."""
    with pytest.raises(RecipeError) as caught:
        load_recipe(path, overrides)
    assert caught.value.exit_code == ExitCode.USAGE
    said = str(caught.value)
    assert "\n" not in said
    if found := re.match(re.escape(path) + r":(\d+):(\d+): (.*)", said):
        return int(found[1]), int(found[2]), found[3]
    return None, None, said


# the shipped recipes


@pytest.mark.parametrize("name", [path.stem for path in shipped_recipes()])
def test_a_shipped_recipe_is_good_and_reads_like_a_method_section(name, write):
    assert check_recipe(name) == []
    recipe = load_recipe(name, ["seed=4"])
    assert recipe.name == name and len(recipe.description) <= 120
    lines = recipe.path.read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 40 and max(map(len, lines)) <= 120
    assert lines[0].startswith("# "), "the paper, its sections and equations"
    if isinstance(recipe, OpenCvRecipe):
        assert (recipe.tracker, recipe.points, recipe.particles, recipe.random) == (name, (), None, name == "mil")
    again = load_recipe(write(json.dumps(to_dict(recipe)), "again.json"))
    assert to_dict(again) == to_dict(recipe)


def test_a_dump_has_lengths_as_they_were_written():
    settings = to_dict(load_recipe("sir", ["motion.sigma={nose: 2.5px, default: 0.1}", "target.windows=[12px, 0.3]"]))
    assert settings["motion"]["sigma"] == {"nose": "2.5px", "default": 0.1}
    assert settings["target"]["windows"] == ["12px", 0.3]


def test_a_gallery_is_sought_like_any_file_of_a_recipe(write, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = read_recipe(find_recipe("adaptive_recognition")).text
    path = write(text.replace("recognition: {}", "recognition: {gallery: people.npz}"), "mine.yaml")
    (problem,) = check_recipe(path)
    assert 'there is no file "people.npz"' in str(problem)
    (tmp_path / "people.npz").touch()
    assert check_recipe(path) == []
    assert "recognition does not go with target type" in refused("histogram", "recognition={}")[2]


def test_the_type_of_a_recipe_says_which_keys_it_has(write):
    whole = load_recipe(write("type: particle_filter\n" + GOOD))
    assert to_dict(whole) == to_dict(load_recipe(write(GOOD))) and whole.points == ("nose", "chin")
    for text, said in (
        ("type: open_cv\ntracker: mil", r':1:7: unknown type of recipe "open_cv"; did you mean "opencv"\?'),
        ("type: [opencv]\ntracker: mil", r":1:7: unknown type of recipe"),
        ("type: opencv\ntracker: mil\nfilter: {type: sir}", r':3:1: unknown key "filter"'),
        (
            "type: opencv\ntracker: goturn",
            r""":2:10: tracker: Input should be 'mil', 'csrt', 'kcf' or 'mosse', not "goturn\"""",
        ),
    ):
        with pytest.raises(RecipeError, match=said):
            load_recipe(write(f"{text}\ndescription: d\n"))


# finding


def test_a_recipe_is_found_by_name_and_by_path(write, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert load_recipe("sir") == load_recipe("sir.yaml")
    write(GOOD, "sir")
    write(GOOD, "sir.yaml")
    assert load_recipe("sir").description == "A recipe for tests"  # a path that exists wins
    assert load_recipe("./sir.yaml").description == "A recipe for tests"
    (tmp_path / "factorized").mkdir()
    assert isinstance(load_recipe("factorized").filter, FactorizedSettings)  # a folder is no recipe


def test_a_miss_names_the_nearest_and_all(tmp_path):
    every = "neither a file nor a shipped recipe; the shipped recipes are: adaptive, "
    for name, said in (
        ("factorised.yaml", r'did you mean "factorized"\?$'), ("zzzz", every), ("recipes/mine.yaml", every),
        (str(tmp_path), "neither a file"), ("x" * 300, "neither a file"),
    ):  # fmt: skip
        with pytest.raises(RecipeError, match=said):
            load_recipe(name)


def test_files_are_sought_beside_the_recipe_then_among_the_shipped(write, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "recipes").mkdir()
    text = read_recipe(find_recipe("factorized")).text
    path = write(text, "recipes/mine.yaml")
    recipe = load_recipe(path)
    assert resolve_file(recipe, "mouth_prior.npz", "prior.file").parent == shipped_recipes()[0].parent
    (tmp_path / "recipes" / "mouth_prior.npz").touch()
    assert resolve_file(recipe, "mouth_prior.npz", "prior.file") == tmp_path / "recipes" / "mouth_prior.npz"
    # a name given on the command line is meant from where the user stands
    (tmp_path / "own.npz").touch()
    with pytest.raises(RecipeError):
        resolve_file(recipe, "own.npz", "prior.file")
    mine = load_recipe(path, ["prior.file=own.npz"])
    assert resolve_file(mine, "own.npz", "prior.file").resolve() == tmp_path / "own.npz"
    bad = load_recipe(write(text.replace("mouth_prior.npz", "mouse_prior.npz"), "recipes/mine.yaml"))
    with pytest.raises(RecipeError, match=r'mine.yaml:\d+:9: there is no file "mouse_prior.npz"'):
        resolve_file(bad, "mouse_prior.npz", "prior.file")
    assert len(check_recipe(str(bad.path))) == 1


def test_an_error_of_building_points_into_the_recipe(write):
    path = write(GOOD)
    error = load_recipe(path).error("filter.particles", "too few; add some")
    assert str(error) == f"{path}:13:14: too few; add some"
    error = load_recipe(path, ["filter.particles=11"]).error("filter.particles", "too few")
    assert str(error) == "--set filter.particles=11: too few"


# values


def test_values_and_lengths(write):
    recipe = load_recipe(write(GOOD))
    assert isinstance(recipe.target, PointsSettings) and isinstance(recipe.filter, SirSettings)
    assert recipe.target.parts == ("nose", "chin")
    assert recipe.target.window("nose") == (Length(0.5), Length(0.5))
    assert recipe.target.window("chin") == (Length(12, px=True), Length(12, px=True))
    assert recipe.motion.sigma.of("chin").pixels(200) == 10
    assert Length(12, px=True).pixels(200) == 12
    assert recipe.prior is None and recipe.seed == 0 and recipe.confidence.lost_below == 0.3
    assert isinstance(recipe.likelihood, ColourRatioSettings) and recipe.likelihood.sigma == 1.5
    with pytest.raises(ValidationError):
        recipe.seed = 3
    recipe = load_recipe(write(GOOD), ["target.windows={nose: [0.5, 8 px], chin: [1, .25]}"])
    assert recipe.target.window("nose") == (Length(0.5), Length(8, px=True))
    assert recipe.target.window("chin") == (Length(1), Length(0.25))


def test_yaml_1_2(write):
    for text, seed in (("010", 10), ("0x10", 16), ("0o10", 8)):
        assert load_recipe(write(GOOD + f"seed: {text}\n")).seed == seed
    assert load_recipe(write(GOOD.replace("0.05", "1e-3"))).motion.sigma.of("nose") == Length(1e-3)
    assert load_recipe(write(GOOD.replace("A recipe for tests", "no"))).description == "no"
    assert load_recipe(write(b"\xef\xbb\xbf" + GOOD.replace("\n", "\r\n").encode())).filter.particles == 10
    assert load_recipe(write(json.dumps(to_dict(load_recipe(write(GOOD)))), "r.json")).filter.particles == 10


# overrides


def test_overrides_in_order_and_of_every_kind():
    recipe = load_recipe("factorized", ["filter.particles=200", "filter.particles=300", "seed = 7", "prior.sigma=1e-1"])
    assert (recipe.filter.particles, recipe.seed) == (300, 7)
    recipe = load_recipe("factorized", ["filter={type: independent, particles: 5}", "prior=null"])
    assert recipe.filter == IndependentSettings(type="independent", particles=5) and recipe.prior is None
    recipe = load_recipe("sir", ["filter.type=auxiliary", "confidence.patience=9"])
    assert recipe.filter.type == "auxiliary" and recipe.filter.particles == 1000
    assert recipe.confidence.patience == 9 and recipe.confidence.lost_below == 0.3
    recipe = load_recipe("sir", ["prior.type=parzen", "prior.file=mouth_prior.npz", "prior.sigma=0.1"])
    assert recipe.prior is not None and recipe.prior.sigma == 0.1


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("filter.particels=200", 'unknown key "particels"; did you mean "particles"?'),
        ("filter.particles='200'", 'filter.particles: Input should be a valid integer, not "200"'),
        ("target.type=sphere", "target.type is one of 'points', 'region', 'cloud', 'affine'"),
        ("seed.x=1", '"seed" holds no keys'),
        ("seed", "write --set KEY=VALUE"),
        ("=1", "no value, or no name, is given"),
        ("a..b=1", "no value, or no name, is given"),
        ("filter=[a", "not valid YAML"),
        ("seed=!!python/object:x 1", 'the tag "'),
        ("seed=é{", "seed: Input should be a valid integer"),
    ],
)
def test_a_wrong_override_is_named(override, message):
    line, _, said = refused("sir", override)
    assert line is None and said.startswith(f"--set {override}: ")
    assert message in said


# what is refused, and where

WRONG = {
    "unknown key": (GOOD + "sed: 3\n", 14, 1, 'unknown key "sed"; did you mean "seed"?'),
    "missing key": (GOOD.replace("  particles: 10\n", ""), 11, 1, 'filter lacks "particles"; add it'),
    "missing type": (GOOD.replace("  type: sir\n", ""), 11, 1, 'filter lacks "type"; add it'),
    "unknown type": (GOOD.replace("sir", "siri"), 12, 9, "filter.type is one of 'sir', 'auxiliary'"),
    "text for number": (GOOD.replace("10", '"10"'), 13, 14, 'should be a valid integer, not "10"'),
    "bool for int": (GOOD.replace("10", "true"), 13, 14, "should be a valid integer, not true"),
    "zero particles": (GOOD.replace("10", "0"), 13, 14, "should be greater than or equal to 1, not 0"),
    "zero length": (GOOD.replace("0.05", "0"), 8, 10, "must be a length above 0"),
    "NaN": (GOOD.replace("0.05", ".nan"), 8, 10, ".nan is not a finite number"),
    "digits": (GOOD.replace("10", "1" * 40), 13, 14, "Input should be a valid integer"),
    "scalar section": (GOOD + "confidence: 3\n", 14, 13, "must be a mapping of keys, not 3"),
    "part of no target": (GOOD.replace("0.05", "{nos: 1, default: 1}"), 8, 11,
                          '"nos" in motion.sigma is no part of the target; did you mean "nose"?'),
    "part without value": (GOOD.replace("0.05", "{nose: 1}"), 8, 3, "motion.sigma has no value for chin"),
    "part twice": (GOOD.replace("[nose, chin]", "[nose, nose]"), 4, 10, 'part "nose" is named twice'),
    "part's name": (GOOD.replace("chin", "Chin"), 4, 17, "target.parts[2]: String should match pattern"),
    "no parts": (GOOD.replace("[nose, chin]", "[]"), 4, 10, "should have at least 1 item after validation, not 0"),
    "enum": (GOOD.replace("sir", "independent\n  look_ahead: far"), 13, 15, "should be 'draw'"),
    "repeated key": (GOOD + "motion: 3\n", 14, 1, 'the key "motion" is repeated (first on line 6)'),
    "anchor": (GOOD.replace("10", "&n 10"), 13, 14, '"&n" is an anchor'),
    "tag": (GOOD.replace("10", "!!python/object:os.system x"), 13, 14, "is not allowed; remove it"),
    "half a character": (GOOD + 'seed: "\\ud800"', 14, 7, "half of a surrogate pair"),
    "complex key": (GOOD + "? [a]\n: b\n", 14, 3, "a key must be a name"),
    "open bracket": (GOOD.replace("chin]", "chin"), 5, 10, "not valid YAML: while parsing a flow sequence"),
    "list": ("- a\n- b\n", 1, 1, "a recipe is a mapping of keys"),
    "empty": ("", 1, 1, "the recipe is empty; start from a shipped"),
    "deep": (GOOD + "seed: " + "[" * 5000, 14, 27, "nested more than 20 deep"),
    "not UTF-8": (b"seed: \xff\xfe", 1, 1, "byte 7 is not UTF-8"),
    "two documents": (GOOD + "---\n" + GOOD, 14, 1, "expected a single document"),
    "escape": (GOOD + 'seed: "\\UFFFFFFFF"', 1, 1, "not valid YAML"),
    "too large": ("#" * (MAX_BYTES + 1), 1, 1, "larger than 100 kB"),
    "long line": (GOOD.replace("[nose, chin]", "[nose, " + "a, " * 60 + "Chin]"), 4, 197, "should match pattern"),
    "wide characters": (GOOD + "confidence: {脸脸: 1}\n", 14, 14, 'unknown key "脸脸"; the keys there are: lost_below'),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_wrong_recipe(case, write):
    text, line, column, message = WRONG[case]
    path = write(text)
    assert load_recipe(write(GOOD, "good.yaml"))  # what is refused is the change
    found_line, found_column, said = refused(path)
    assert (found_line, found_column) == (line, column)
    assert message in said


def test_all_errors_are_listed_in_the_order_of_the_text(write):
    text = GOOD.replace("0.05", "0").replace("10", "0").replace("  type: colour_ratio", "  type: colour_ratio\n  a: 1")
    path = write(text + "seed: x\nsed: 1\n")  # an unknown key hides none of the others
    found = check_recipe(path)
    assert [problem.span.line + 1 for problem in found] == [8, 11, 14, 15, 16]
    assert refused(path)[2].endswith("(and 4 more: facetrack recipes check lists all)")
    assert len(check_recipe(write(GOOD + "seed: 1\nseed: 2\nmotion: !x 3\nseed: 3\n"))) == 4


# whatever is written, it is a recipe or a RecipeError


@given(st.text(st.sampled_from("ab:{}[]-?&*!|>'\"%@`#,~ \n\t\\01.e") | st.characters(codec="utf-8"), max_size=40))
def test_any_text_is_a_tree_or_is_refused(text):
    try:
        tree = parse(Source("any", text, Path()))
    except YamlProblems as refused:
        for problem in refused.problems:
            assert str(problem).startswith("any:")
    else:
        json.dumps(None if tree is None else tree.plain(), allow_nan=False)


# the schema


def test_schema_describes_every_field():
    schema = json_schema()
    json.dumps(schema, allow_nan=False)
    assert schema["$schema"].endswith("2020-12/schema")
    models = schema["$defs"]
    for name, model in models.items():
        assert model.get("title") and (model.get("description") or name == "Length"), name
        for field, what in model.get("properties", {}).items():
            assert what.get("description"), f"{name}.{field} has no description"
        if "properties" in model:
            assert model["additionalProperties"] is False
    for reference in re.findall(r'"\$ref": "([^"]*)"', json.dumps(schema)):
        assert reference.removeprefix("#/$defs/") in schema["$defs"]
    assert len(models["ParticleRecipe"]["properties"]["filter"]["oneOf"]) == 6
    length = json.dumps(schema["$defs"]["LengthPerPart"])
    assert '"maximum": 1000000.0' in length and "px" in length
    assert models["VisibleWalkSettings"]["properties"]["hidden"]["default"] == 0.1, "as a recipe writes it"
