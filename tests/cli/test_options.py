"""Options: what shells complete, and the defaults that the user sets by variables."""

import shlex
import shutil
import subprocess

import click
import pytest
from click.shell_completion import ShellComplete

from facetrack_cli.__main__ import main
from facetrack_cli.cli import app
from facetrack_cli.core.models import shipped_recipes
from tests.cli.test_cli import HEAVY, facetrack
from tests.support.terminal import refusal

RECIPES = [path.stem for path in shipped_recipes()]


@pytest.mark.parametrize(
    ("line", "first", "words"),
    [
        ("run --config fac", "file,fac", [name for name in RECIPES if name.startswith("fac")]),
        ("recipes show sk", "file,sk", [name for name in RECIPES if name.startswith("sk")]),
        ("recipes sh", None, ["show"]),
        ("models g", None, ["get"]),
        ("models get m", None, ["mesh"]),
        ("run cl", "file,cl", []),
        ("run --out cl", "dir,cl", []),
        ("fix cl", "dir,cl", []),
    ],
)
def test_what_is_completed(line, first, words):
    *typed, last = [*shlex.split(line), *([""] if line.endswith(" ") else [])]
    found = ShellComplete(app.cli, {}, "facetrack", "_FACETRACK_COMPLETE").get_completions(typed, last)
    offered = [f"{item.type},{item.value}" for item in found]
    assert offered == [*([first] if first else []), *(f"plain,{word}" for word in words)]


def test_recipes_are_completed_without_loading_anything_heavy():
    words = {"_FACETRACK_COMPLETE": "bash_complete", "COMP_WORDS": "facetrack run --config f", "COMP_CWORD": "3"}
    done = facetrack(flags=["-X", "importtime"], **words)
    imported = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines()}
    assert "plain,face" in done.stdout.split() and "facetrack_cli.cli.options" in imported
    assert {name.partition(".")[0] for name in imported} & HEAVY == set()
    assert "facetrack_cli.recipe" not in imported


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_of_a_shell(shell):
    if shell == "bash" and not shutil.which("bash"):
        pytest.skip("Click asks Bash for its version")
    said = facetrack(_FACETRACK_COMPLETE=f"{shell}_source").stdout
    assert f"_FACETRACK_COMPLETE={shell}_complete" in said
    if shutil.which(shell):
        subprocess.run([shell, "-n"], input=said, text=True, check=True)


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
        ("run a.mp4", {"SET": "a=1 b=2", "FORMAT": "csv"}, {"overrides": ("a=1", "b=2"), "formats": ("csv",)}),
        ("run a.mp4", {"QUIET": "0", "JOBS": ""}, {"quiet": False, "jobs": 1}),
    ],
)
def test_the_order_is_command_line_environment_ours(given, words, variables, options):
    found = given(*words.split(), **{f"RUN_{name}": value for name, value in variables.items()}, DEBUG="yes, please")
    assert {name: found[name] for name in options} == options
    assert given("recipes", "check", "sir", RECIPES_CHECK_SET="filter.particles=0")[0] == 2, "commands below commands"


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("RUN_JOBS", "x", "'x' is not a valid integer range"),
        ("LOG_FORMAT", "xml", "'xml' is not one of 'text', 'json'"),
    ],
)
def test_a_wrong_variable_is_one_line(given, name, value, said):
    line = refusal(given("run", "a.mp4", **{name: value}), 2)
    assert line.startswith(f"facetrack: error: Invalid value for FACETRACK_{name}: {said}")
