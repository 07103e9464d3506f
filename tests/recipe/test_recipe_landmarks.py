"""head.landmarks: which network a recipe takes, and what is said where it is not there."""

import hashlib
import json

import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import InputError, RecipeError
from facetrack_cli.core.models import MODELS
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import to_dict
from facetrack_cli.start.assembly import build_tracker
from tests.support.samples import FOLDER, TrackClip

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
