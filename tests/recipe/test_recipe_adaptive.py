"""Recipes of affine targets: what does not go together, and what their numbers may be, each said where it stands."""

import pytest

from facetrack_cli.core.errors import RecipeError
from facetrack_cli.recipe.load import check_recipe, load_recipe
from facetrack_cli.recipe.model import to_dict
from tests.recipe.test_recipe import AFFINE, STEPS


def refused(*overrides, name="adaptive"):
    with pytest.raises(RecipeError) as caught:
        load_recipe(name, overrides)
    return str(caught.value)


@pytest.mark.parametrize("name", AFFINE)
def test_a_recipe_reads_like_a_method_section(name):
    recipe = load_recipe(name)
    assert check_recipe(name) == [] and recipe.points == () and recipe.target.type == "affine"
    lines = recipe.path.read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 40 and max(map(len, lines)) <= 120
    assert lines[0].startswith("# Zhou, Chellappa & Moghaddam") and len(recipe.description) <= 100


def test_each_step_of_the_ablation_adds_one_thing():
    def settings(name):
        given = to_dict(load_recipe(name))
        return {key: given[key] for key in ("target", "motion", "likelihood", "filter", "prior", "confidence")}

    steps = [settings(name) for name in STEPS[:5]]
    for before, after, section in zip(steps, steps[1:], ("likelihood", "motion", "motion", "filter"), strict=False):
        # the prediction comes with the filter that draws around it
        may = {section, "filter"} if after["filter"]["type"] != before["filter"]["type"] else {section}
        assert {key for key in before if before[key] != after[key]} == may
    assert {key for key in steps[2]["motion"] if steps[2]["motion"][key] != steps[3]["motion"][key]} == {"noise"}
    assert {key for key in steps[3]["filter"] if steps[3]["filter"][key] != steps[4]["filter"][key]} == {"adapt"}


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (
            ["motion.noise=null"],
            "filter.adapt follows motion.noise, which is null; add noise: {}, or write adapt: false",
        ),
        (["motion.noise.most=0.2"], "motion.noise.most is below least"),
        (["motion={type: random_walk, sigma: 0.1}"], 'does not go with target type "affine"; write affine_walk'),
        (["likelihood={type: skin}"], 'does not go with target type "affine"; write appearance'),
        (["filter.type=factorized"], 'does not go with target type "affine"; write sir or auxiliary or adaptive'),
        (["likelihood.mixing.w=0", "likelihood.mixing.s=0", "likelihood.mixing.f=0"], "mixing is all 0"),
        (["likelihood.sigma.s=0"], "likelihood.sigma.s must be at least 0.001"),
        (["likelihood.template=[5,30]"], "likelihood.template[1] must be at least 6, not 5"),
        (["target.scale=[1.5,2]"], "target.scale is [least, largest]"),
        (["filter.particles=500000"], "particles of 26x30 points each"),
        (["filter.particles=5000", "motion.velocity.samples=null"], "give velocity.samples, as in samples: 32"),
        (["filter.particles=3000", "motion.velocity.samples=2500"], "give velocity.samples, as in samples: 32"),
    ],
)
def test_what_does_not_go_together_is_refused(overrides, said):
    assert said in refused(*overrides)


def test_other_targets_have_nothing_of_it():
    message = 'recognition does not go with target type "region"; remove it, or follow an affine target'
    assert message in refused("recognition={}", name="histogram")
    adaptive = 'filter type "adaptive" does not go with target type'
    assert f'{adaptive} "points"' in refused("filter={type: adaptive, particles: 10}", name="sir")
    assert f'{adaptive} "region"' in refused("filter={type: adaptive, particles: 10}", name="histogram")


def test_many_particles_are_welcome_where_they_are_not_compared():
    some = ["filter.particles=20000", "motion.velocity.samples=32"]
    assert load_recipe("adaptive", some).filter.particles == 20000
    assert (
        load_recipe("adaptive", ["filter.particles=900", "motion.velocity.samples=null"]).motion.velocity.samples
        is None
    )
    assert load_recipe("fixed_template", ["filter.particles=100000"]).particles == 100000
