"""Defaults that the user sets: the command line, then the environment, then ours."""

import click
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.cli import app
from tests.support.terminal import refusal


@pytest.fixture
def given(monkeypatch, capfd):
    """Run a command line with these variables: the options that `run` gets, or what is said."""

    def given(*arguments, **variables):
        options = {}
        command = app.cli.get_command(click.Context(app.cli), "run")
        monkeypatch.setattr(command, "callback", lambda **values: options.update(values))
        for name, value in variables.items():
            monkeypatch.setenv(f"FACETRACK_{name}", value)
        code = main(list(arguments))
        return options if code == 0 else (code, *capfd.readouterr())

    return given


@pytest.mark.parametrize(
    ("words", "variables", "options"),
    [
        ("run a.mp4", {}, {"jobs": 1, "out": None, "overwrite": False, "cluster": None}),
        ("run a.mp4 -j 2", {"JOBS": "4", "SEED": "5", "SHARD": "1/2"}, {"jobs": 2, "seed": 5, "shard": (1, 2)}),
        ("run a.mp4", {"SET": "a=1 b=2", "NO_VIDEO": "1"}, {"overrides": ("a=1", "b=2"), "no_video": True}),
        ("run a.mp4", {"QUIET": "0", "JOBS": ""}, {"quiet": False, "jobs": 1}),
        ("track a.mp4", {"JOBS": "3"}, {"jobs": 3}),
    ],
)
def test_the_order_is_command_line_environment_ours(given, words, variables, options):
    found = given(*words.split(), **{f"RUN_{name}": value for name, value in variables.items()}, DEBUG="yes, please")
    assert {name: found[name] for name in options} == options


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
