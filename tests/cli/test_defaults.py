"""Defaults that the user sets: the command line, then the environment, then ours. Files of a folder set none."""

import click
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.cli import app
from tests.support.terminal import refusal


@pytest.fixture
def given(tmp_path, monkeypatch, capfd):
    """Run a command line below a folder with this pyproject.toml: the options that `run` gets, or what is said."""
    (tmp_path / "deep" / "er").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "deep" / "er")

    def given(*arguments, text="", **variables):
        (tmp_path / "pyproject.toml").write_text(text)
        got = {}
        command = app.cli.get_command(click.Context(app.cli), "run")

        def take(**values):
            got.update(values)

        monkeypatch.setattr(command, "callback", take)
        for name, value in variables.items():
            monkeypatch.setenv(f"FACETRACK_{name}", value)
        code = main(list(arguments))
        return got if code == 0 else (code, *capfd.readouterr())

    return given


def test_the_order_is_command_line_environment_ours(given):
    got = given("run", "a.mp4", "-j", "2", RUN_JOBS="4", RUN_SEED="5", RUN_SHARD="1/2")
    assert (got["jobs"], got["seed"], got["shard"], got["quiet"]) == (2, 5, (1, 2), False)


@pytest.mark.parametrize("text", ["[tool.facetrack.run]\njobs = 4\nout = 'there'\noverwrite = true\n", "[\n", "\0"])
def test_a_folder_sets_nothing(given, text, capfd):
    got = given("run", "a.mp4", text=text)
    assert (got["jobs"], got["out"], got["overwrite"], got["cluster"]) == (1, None, False, None)
    assert capfd.readouterr().err == ""


def test_variables(given):
    got = given("run", "a.mp4", RUN_SET="a=1 b=2", RUN_NO_VIDEO="1", RUN_QUIET="0", RUN_JOBS="")
    assert (got["overrides"], got["no_video"], got["quiet"], got["jobs"]) == (("a=1", "b=2"), True, False, 1)


def test_the_other_name_of_a_command_has_the_same_variables(given):
    assert given("track", "a.mp4", RUN_JOBS="3")["jobs"] == 3


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("RUN_JOBS", "x", "FACETRACK_RUN_JOBS: 'x' is not a valid whole number"),
        ("RUN_JOBS", "0", "FACETRACK_RUN_JOBS: 0 is not in the range 1<=x<=1000"),
        ("RUN_QUIET", "maybe", "FACETRACK_RUN_QUIET: 'maybe' is not a valid boolean"),
        ("RUN_BOX", "1,2", "FACETRACK_RUN_BOX: '1,2': give four numbers with commas: left,top,width,height"),
        ("LOG_FORMAT", "xml", "FACETRACK_LOG_FORMAT: 'xml' is not one of 'text', 'json'"),
    ],
)
def test_a_wrong_variable_is_one_line(given, name, value, said):
    assert refusal(given("run", "a.mp4", **{name: value}), 2).startswith(f"facetrack: error: {said}")


def test_commands_below_commands_have_theirs(given):
    assert given("recipes", "check", "sir", RECIPES_CHECK_SET="filter.particles=0")[0] == 2
    assert given("recipes", "check", "sir", RECIPES_CHECK_SET="filter.particles=9") == {}


def test_help_shows_the_variables_that_are_set(given, capfd):
    given("run", "--help", RUN_JOBS="4")
    said = capfd.readouterr().out
    assert "FACETRACK_RUN_JOBS=4" in said and said.count("FACETRACK_RUN_") == 1


def test_the_variable_of_debug_keeps_its_meaning(given):
    assert given("run", "a.mp4", DEBUG="yes, please")["jobs"] == 1
