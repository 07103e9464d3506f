"""The recipe that a report shows is the one that ran, and its command makes the run again."""

from __future__ import annotations

import shlex
from pathlib import Path
from types import SimpleNamespace

import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.models import shipped_recipes
from facetrack_cli.recipe.load import _shipped, calibrated, load_recipe
from facetrack_cli.recipe.model import to_dict
from facetrack_cli.report.command_line import command, recipe_yaml
from facetrack_cli.report.text import _trust, doubts
from facetrack_cli.trajectory.header import read_header
from facetrack_cli.trajectory.reader import read_trajectory
from facetrack_cli.trajectory.trajectory import joined

SAMPLE = Path(__file__).parents[2] / "sample_videos" / "occlusion.mp4"


@pytest.mark.parametrize("path", shipped_recipes(), ids=lambda path: path.stem)
def test_the_recipe_shown_is_the_recipe(path, tmp_path):
    recipe = load_recipe(str(path))
    copy = tmp_path / f"{path.stem}.yaml"
    copy.write_text(recipe_yaml({"name": recipe.name, **to_dict(recipe)}), encoding="utf-8")
    assert to_dict(load_recipe(str(copy))) == to_dict(recipe)


@pytest.mark.parametrize(
    "options",
    [
        ["--config", "factorized", "--set", "filter.particles=15", "--set", "target.windows={default: 0.4}"],
        ["--config", "sir", "--set", "filter.particles=15", "--box", "115,58,113,113", "--init-frame", "4"],
        ["--config", "mine.yaml", "--init", "haar", "--start", "3"],
    ],
    ids=["overrides", "box", "own recipe"],
)
def test_the_command_repeats_the_run(options, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    own = to_dict(load_recipe("independent")) | {"description": "mine"}
    Path("mine.yaml").write_text(recipe_yaml(own))
    assert main(["run", str(SAMPLE), *options, "--seed", "7", "--stop", "12", "-o", "run", "--no-video", "-q"]) == 0
    table = read_trajectory(Path("run"))
    words = shlex.split(command(read_header(table), int(table.frames[-1])))
    assert words[:3] == ["facetrack", "run", str(SAMPLE)]
    Path("mine.yaml").write_text(recipe_yaml(table.header["recipe"]))  # as the page has it
    assert main([*words[1:], "--no-video", "-q"]) == 0
    assert Path("again/trajectory.csv").read_bytes() == Path("run/trajectory.csv").read_bytes()


@pytest.mark.parametrize("exists", [True, False])
def test_folders_are_repeated_at_their_rate_and_init_files_from_their_frame(exists, tmp_path):
    clip = tmp_path / "pictures"
    if exists:
        clip.mkdir()
    header = {
        "source": {"path": str(clip), "size": [64, 48], "fps": 29.97003},
        "recipe": {"name": "my own", "description": "x"},
        "seed": 1,
        "init": {"from": str(tmp_path / "x.init.yaml"), "frame": 4, "targets": {}},
    }
    (tmp_path / "x.init.yaml").write_text("frame: 2\nbox: [1, 2, 3, 4]\n")
    table = joined([], path=tmp_path / "trajectory.json", header=header)
    words = shlex.split(command(read_header(table), 30))
    assert words[words.index("--fps") + 1] == "30000/1001"
    assert words[words.index("--init-frame") + 1] == "4"
    assert words[words.index("--config") + 1] == "my own.yaml"
    (tmp_path / "x.init.yaml").write_text("frame: 4\nbox: [1, 2, 3, 4]\n")
    assert "--init-frame" not in shlex.split(command(read_header(table), 30))


def test_a_confidence_is_called_a_probability_only_where_it_is_one():
    known, unknown = {"confidence": {"calibration": "a.json"}}, {"confidence": {"calibration": None}}
    assert calibrated(known) and not calibrated(unknown) and not calibrated({})
    assert calibrated({"targets": {"a": known, "b": None}})
    assert not calibrated({"targets": {"a": known, "b": unknown}})
    said = _trust(True, 0.98)
    assert "expects 98.0\u00a0% of the rows to be right" in said
    assert "not how often the place is right" in _trust(False, 0.87)
    assert doubts(SimpleNamespace(recipe=known), 0.49) and not doubts(SimpleNamespace(recipe=known), 0.5)
    assert not doubts(SimpleNamespace(recipe=unknown), 0.1) and not doubts(SimpleNamespace(recipe=known), None)


def test_a_shipped_calibration_holds_for_the_recipe_as_it_is_shipped():
    assert calibrated(to_dict(load_recipe("skin_ncc_robust", ["seed=7"])))
    changed = to_dict(load_recipe("skin_ncc_robust", ["likelihood.skin=null"]))
    assert not calibrated(changed) and doubts(SimpleNamespace(recipe=changed), 0.4)  # low, it still says something
    assert not calibrated(to_dict(load_recipe("skin_ncc")))


def test_a_calibration_is_of_the_shipped_recipe_without_a_network_on_machines_that_have_it_too(monkeypatch, tmp_path):
    monkeypatch.setattr("facetrack_cli.recipe.load.model_path", lambda name: tmp_path)
    _shipped.cache_clear()
    assert calibrated(to_dict(load_recipe("face", installed=False)))
    assert not calibrated(to_dict(load_recipe("face")))
