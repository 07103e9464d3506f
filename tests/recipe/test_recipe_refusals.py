"""What no recipe may say: values, and what does not go together, each refused once, with its key and a remedy."""

import hashlib
import json

import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError, RecipeError
from facetrack_cli.core.models import MODELS, shipped_folder
from facetrack_cli.recipe.load import check_recipe, load_recipe
from facetrack_cli.recipe.model import to_dict
from facetrack_cli.recipe.sections import LengthOrNone
from facetrack_cli.start.assembly import build_tracker
from tests.support.samples import FOLDER, TrackClip

REGION, HANDS = "contour_histogram_correlation", "head_hands"
DYNAMICS = "{A: [[1, 0], [0, 0]], B: [[0.1], [0]]}"
WRONG = [
    ("factorized", "prior=null", "prior needs a prior; add a prior section"),
    ("factorized", "filter.reweight=transition filter.from_prior=0.1", "from_prior above 0 goes with reweight: prior"),
    ("factorized", "filter.reweight=transition filter.particles=2001", "compares every two particles; give 2,000"),
    ("factorized", "target.points=[]", 'unknown key "points"; the keys there are: type, parts, windows'),
    ("auxiliary_prior", "filter.type=independent", "makes no use of a prior"),
    ("sir", f"motion={{type: first_order, position: {DYNAMICS}, scale: {DYNAMICS}}}",
     'motion type "first_order" does not go with target type "points"; write random_walk'),
    ("sir", "likelihood={type: product, correlation: {sigma: 9}}",
     'likelihood type "product" does not go with target type "points"; write colour_ratio'),
    ("sir", "filter={type: adaptive, particles: 10}", 'type "adaptive" does not go with target type "points"'),
    # regions
    (REGION, "target.scale=[1, 2]", "with 1, the size at the start, between them"),
    (REGION, "target.type=null", "target.type is one of 'points', 'region', 'cloud', 'affine', 'box', not null"),
    (REGION, "target={type: points, parts: [nose], windows: 9px}",
     'motion type "first_order" does not go with target type "points"'),
    (REGION, "motion={type: random_walk, sigma: {nose: 0.1, default: 0.2}}", '"nose" in motion.sigma is no part'),
    (REGION, "motion.position.A=[[1, 1e300], [0, 1]]", "A[1][2]: Input should be less than or equal to 1000000"),
    (REGION, "motion.position.B=[[0.1, 0], [0.1]]", "need the same number of sources of noise"),
    (REGION, "motion.position.B=[[-1], [0]]", "must be 0 or a length"),
    (REGION, "filter={type: factorized, particles: 9}", "write sir or auxiliary"),
    (REGION, "prior={type: parzen, file: mouth_prior.npz, sigma: 0.1}", "write null"),
    (REGION, "recognition={}", 'does not go with target type "region"; remove it, or follow an affine target'),
    (REGION, "likelihood.type={a: b}", "likelihood.type is one of 'colour_ratio', "),
    (REGION, "likelihood={type: product}", "likelihood has no factor; add contour, histogram or correlation"),
    (REGION, "likelihood.contour.sigma=0", "must be a length above 0"),
    # affine targets
    ("adaptive", "motion={type: random_walk, sigma: 0.1}", 'target type "affine"; write affine_walk'),
    ("adaptive", "likelihood.mixing.w=0 likelihood.mixing.s=0 likelihood.mixing.f=0", "mixing is all 0"),
    ("adaptive", "target.parts=[nose]", 'unknown key "parts"; the keys there are: type'),
    ("adaptive", "filter={type: factorized, particles: 9}", "write sir or auxiliary or adaptive"),
    # several targets
    (HANDS, "targets.Foot=null", "targets.Foot: a name has small letters"),
    (HANDS, "targets.head=null", 'there is no target "head" to learn from; there are left_hand, right_hand'),
    (HANDS, "exclusion.first=[foot]", 'there is no target "foot"; there are head, left_hand, right_hand'),
    (HANDS, "targets.left_hand.likelihood.learn_from=foot", 'there is no target "foot" to learn from'),
    (HANDS, "targets.left_hand.motion.scale=0.1", "a target of type cloud has none: remove it"),
    (HANDS, "hands={}", "left_hand is one of hands"),
    ("signer", "hands.shares=[0.5, 0.3, 0.1]", "the shares add up to"),
    (HANDS, "targets={}", "targets: Dictionary should have at least 1 item after validation, not 0"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "overrides", "said"), WRONG)
def test_what_cannot_be_is_refused(name, overrides, said):
    assigned = [overrides] if "{" in overrides or "[" in overrides else overrides.split()
    with pytest.raises(RecipeError) as caught:
        load_recipe(name, assigned)
    message = str(caught.value)
    assert said in message and "\n" not in message


@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        ("auxiliary_prior", ["filter.type=sir"]),
        ("adaptive", ["filter.particles=20000", "motion.velocity.samples=32"]),
        ("adaptive", ["filter.particles=900", "motion.velocity.samples=null"]),
        ("fixed_template", ["filter.particles=100000"]),
    ],
)
def test_what_is_close_to_it_is_taken(name, overrides):
    assert check_recipe(name, overrides) == []


def test_no_noise_is_a_length_of_dynamics():
    none = LengthOrNone(0.0)
    recipe = load_recipe("contour", ["motion.position.B=[[0, 3px], [0.0, 0]]"])
    assert ((none, LengthOrNone(3.0, px=True)), (none, none)) == recipe.motion.position.B
    assert to_dict(recipe)["motion"]["position"]["B"] == [[0.0, "3px"], [0.0, 0.0]]


@pytest.mark.parametrize(
    ("old", "new", "marked", "said"),
    [
        ("type: particle_filters\n", "", "d", 'the recipe lacks "type"; add it'),
        (
            "  left_hand:\n",
            "  left_hand:\n    colour: red\n",
            "colour",
            'unknown key "colour"; the keys there are: target, motion',
        ),
        ("inner: 1.0}", "iner: 1.0}", "iner", 'unknown key "iner"; did you mean "inner"?'),
        ("  right_hand:\n", "  left_hand:\n", "left_hand", 'the key "left_hand" is repeated'),
        ("  right_hand:\n", "  Right Hand:\n", "Right Hand", "targets.Right Hand: a name has"),
    ],
)
def test_a_wrong_recipe_of_several_targets_is_told_where_it_is_wrong(tmp_path, old, new, marked, said):
    recipe, file = (shipped_folder() / f"{HANDS}.yaml").read_text(), tmp_path / "mine.yaml"
    assert recipe.count(old) == 1
    file.write_text(recipe.replace(old, new))
    problem = check_recipe(str(file))[0]
    text = file.read_text().splitlines()[problem.span.line]
    assert text[problem.span.column :].startswith(marked)
    assert said in str(problem)


# --- head.landmarks: which network a recipe takes, and what is said where it is not there
NAME = MODELS["mesh"].member.split("/")[-1]
CLIP = FOLDER / "expressions.mp4"
KEY = "head.landmarks.network"


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A file in the place of the model `mesh`, which is taken for it."""
    data = b"a network"
    known = {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    monkeypatch.setitem(MODELS, "mesh", MODELS["mesh"]._replace(**known))
    monkeypatch.setenv("FACETRACK_MODELS", str(tmp_path / "models"))
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / NAME).write_bytes(data)
    return tmp_path / "models" / NAME


def network(*overrides, **options):
    return load_recipe("face", overrides, **options).head.landmarks.network


def test_auto_is_the_network_where_its_file_is_and_is_said_in_the_recipe(here):
    for given in ((), (f"{KEY}=auto",)):
        recipe = load_recipe("face", given)
        assert recipe.networks == ("mesh",) and to_dict(recipe)["head"]["landmarks"]["network"] == "mesh"
        assert network(*given, installed=False) is None
    assert network(f"{KEY}=null") is None and load_recipe("face", [f"{KEY}=null"]).networks == ()
    assert network(f"{KEY}=mesh", installed=False) == "mesh", "what is asked for is not left out"
    assert load_recipe("factorized").networks == ()
    here.unlink()
    assert network() is None and to_dict(load_recipe("face"))["head"]["landmarks"]["network"] is None
    here.write_bytes(b"damaged")
    with pytest.raises(InputError, match="is damaged, or another file than mesh; replace it: facetrack models get"):
        network()
    assert network(installed=False) is None


def run(capfd, *overrides):
    """The exit code and the lines on stderr."""
    sets = [word for each in overrides for word in ("--set", each)]
    code = main(["run", str(CLIP), "--config", "face", *sets, "--stop", "2", "--no-video", "-q"])
    return code, capfd.readouterr().err.splitlines()


def test_a_network_that_is_not_there_ends_in_one_line_that_says_what_to_do(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    code, lines = run(capfd, f"{KEY}=mesh")
    assert code == 2 and lines[0].startswith("facetrack: error: ") and sum("error" in line for line in lines) == 1
    assert lines[0].endswith("the network mesh is not here; bring it by facetrack models get mesh, or write null")
    assert not [*tmp_path.iterdir()], "nothing is written"


def test_a_run_is_built_and_recorded_with_the_network(mesh_model, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    assert run(capfd)[0] == 0
    monkeypatch.setenv("FACETRACK_MODELS", str(mesh_model.parent))
    [target] = build_tracker(load_recipe("face"), TrackClip("expressions", 1).start)
    assert target.sensors.mesh.path == mesh_model
    code, lines = run(capfd, "filter.particles=100")
    assert (code, lines) == (0, [])
    found = {one.parent.name: json.loads(one.read_text())["networks"] for one in tmp_path.glob("*/run.json")}
    networks = list(load_recipe("face").networks)  # iris where it lies beside mesh
    assert networks[0] == "mesh" and sorted(found.values()) == [[], networks]
    with pytest.raises(RecipeError, match="is not here"):
        monkeypatch.setenv("FACETRACK_MODELS", str(tmp_path))
        build_tracker(load_recipe("face", [f"{KEY}=mesh"]), TrackClip("expressions", 1).start)
