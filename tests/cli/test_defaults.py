"""Defaults that the user sets: the command line, then the environment, then pyproject.toml, then ours."""

import sys

import click
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.cli import app
from tests.support.terminal import refusal

toml = pytest.mark.skipif(sys.version_info < (3, 11), reason="this Python has no tomllib")


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


@toml
def test_the_order_is_command_line_environment_pyproject(given):
    text = "[tool.facetrack.run]\njobs = 4\nseed = 3\nno-video = true\nout = 'there'\nset = ['a=1', 'b=2']\n"
    got = given("run", "a.mp4", "-j", "2", text=text, RUN_SEED="5", RUN_SHARD="1/2")
    assert (got["jobs"], got["seed"], got["no_video"], got["out"]) == (2, 5, True, "there")
    assert (got["set"], got["shard"], got["quiet"]) == (("a=1", "b=2"), (1, 2), False)


@toml
def test_underscores_do_as_well_and_other_tables_are_left_alone(given):
    text = "[tool.facetrack.run]\nfail_on_lost = true\n[tool.facetrack.eval]\nwhatever = 1\n[tool.other]\nx = 1\n"
    assert given("run", "a.mp4", text=text)["fail_on_lost"] is True
    assert given("run", "a.mp4", text="[project]\nname = 'facetrack'\n")["jobs"] == 1


def test_variables(given):
    got = given("run", "a.mp4", RUN_SET="a=1 b=2", RUN_NO_VIDEO="1", RUN_QUIET="0", RUN_JOBS="")
    assert (got["set"], got["no_video"], got["quiet"], got["jobs"]) == (("a=1", "b=2"), True, False, 1)


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


@toml
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[tool.facetrack.run]\njbos = 4", 'tool.facetrack.run: unknown key "jbos"; did you mean "jobs"?'),
        ("[tool.facetrack]\nrnu = 4", 'tool.facetrack: unknown key "rnu"; did you mean "run"?'),
        ("[tool.facetrack.run]\njobs = 0", "tool.facetrack.run.jobs: 0 is not in the range 1<=x<=1000"),
        ("[tool.facetrack.run]\njobs = [1]", "tool.facetrack.run.jobs: give text or a number"),
        ("[tool.facetrack.run]\nquiet = 1", "tool.facetrack.run.quiet: give true or false"),
        ("[tool.facetrack.run]\nset = 'a=1'", "tool.facetrack.run.set: give a list of texts"),
        ("[tool.facetrack.run]\nout = true", "tool.facetrack.run.out: give text or a number"),
        ("[tool.facetrack]\nrun = 4", "tool.facetrack.run is no table; write [tool.facetrack.COMMAND]"),
        ("[tool]\nfacetrack = 4", "tool.facetrack is no table"),
        ("[tool.facetrack]\ndebug = true", 'tool.facetrack: unknown key "debug"'),
        ("[tool.facetrack.run\n", "no valid TOML"),
    ],
)
def test_a_wrong_pyproject_names_file_and_key(given, tmp_path, text, said):
    line = refusal(given("run", "a.mp4", text=text), 2)
    assert line.startswith(f"facetrack: error: {tmp_path / 'pyproject.toml'}: {said}")


@toml
def test_commands_below_commands_have_theirs(given, tmp_path, monkeypatch, capfd):
    text = "[tool.facetrack.recipes.check]\nset = ['filter.particles=0']\n"
    assert given("recipes", "check", "sir", text=text)[0] == 2
    assert given("recipes", "check", "sir", text=text, RECIPES_CHECK_SET="filter.particles=9") == {}


def test_the_variable_of_debug_keeps_its_meaning(given):
    assert given("run", "a.mp4", DEBUG="yes, please")["jobs"] == 1


def test_without_tomllib_a_line_says_so(given, monkeypatch, capfd):
    monkeypatch.setitem(sys.modules, "tomllib", None)
    assert given("run", "a.mp4", text="[tool.facetrack.run]\njobs = 4\n")["jobs"] == 1
    assert "its defaults are not read: that takes Python 3.11" in capfd.readouterr().err
    assert given("run", "a.mp4", text="[project]\nname = 'facetrack'\n")["jobs"] == 1
    assert capfd.readouterr().err == ""
