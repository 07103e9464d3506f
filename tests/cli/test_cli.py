import os
import re
import subprocess
import sys
import types
from pathlib import Path

import click
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.cli import app as cli
from facetrack_cli.core import __version__
from facetrack_cli.core.errors import ExitCode, InputError, RecipeError
from facetrack_cli.core.models import shipped_recipes
from facetrack_cli.recipe.load import TAKE, TASKS, default_recipe
from facetrack_cli.start.init_file import read_init
from facetrack_cli.video.source import open_source
from tests.fuzz import guided
from tests.support.damage import raising
from tests.support.media import write_pictures
from tests.support.samples import FOLDER

HEAVY = {"numpy", "cv2", "numba", "pydantic", "rich", "imageio", "imageio_ffmpeg", "ruamel"}
PACKAGE = Path(cli.__file__).parents[1]


def facetrack(*arguments, flags=(), cwd=None, **environment):
    return subprocess.run(
        [sys.executable, *flags, "-m", "facetrack_cli", *arguments],
        capture_output=True,
        text=True,
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(PACKAGE.parent), **environment},
    )


@pytest.fixture
def boom(monkeypatch):
    """Put a command `boom` on the command line that does what it is given."""

    def boom(action):
        @click.command()
        def command():
            return action()

        module = types.ModuleType("facetrack_cli.cli.commands.boom")
        module.boom_command = command
        monkeypatch.setitem(sys.modules, module.__name__, module)
        monkeypatch.setitem(cli.COMMANDS, "boom", "Test.")
        monkeypatch.delenv("FACETRACK_DEBUG", raising=False)
        return main(["boom"])

    return boom


@pytest.mark.one_in(2)
@pytest.mark.parametrize("arguments", [["--help"], ["--version"], [], ["recipes", "--help"], ["rnu"]])
def test_nothing_heavy_is_imported_for_help(arguments):
    done = facetrack(*arguments, flags=["-X", "importtime"])
    imported = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines() if line.startswith("import time:")}
    assert "click" in imported and "facetrack_cli.cli.app" in imported
    assert {name.partition(".")[0] for name in imported} & HEAVY == set()
    commands = {name for name in imported if name.startswith("facetrack_cli.cli.commands.")}
    assert commands <= {f"facetrack_cli.cli.commands.{name}" for name in arguments}


def test_a_run_imports_nothing_that_it_does_not_use(tmp_path):
    run = "run", str(FOLDER / "occlusion.mp4"), "--stop", "3", "--no-video", "-o", str(tmp_path / "out"), "--overwrite"
    unused = (
        "runs.people runs.finished runs.live runs.api start.presence trackers.smoothed trackers.opencv video.overlay "
        "trackers.hands.target trackers.skin.likelihoods trackers.appearance.appearance trajectory.people video.writer "
        "trackers.regions.settings run_folder.status"
    )
    modules = {"PIL", "imageio", "scipy.linalg", "numpy.ma", "multiprocessing.connection"}
    others = {*modules, *(f"facetrack_cli.{name}" for name in unused.split())}
    for _ in range(2):  # the first one may compile kernels, which takes more
        lines = facetrack(*run, flags=["-X", "importtime"]).stderr.splitlines()
        imported = {line.rpartition("|")[2].strip() for line in lines if line.startswith("import time:")}
        if imported.isdisjoint(others):
            break
    assert "facetrack_cli.trackers.face.target" in imported
    assert imported & others == set()


def test_help_lists_the_commands_and_options_in_sections(capsys):
    def said(*words):
        assert main([*words]) == 0
        return capsys.readouterr().out

    listed = said("--help")
    for name, text in cli.COMMANDS.items():
        assert f"  {name} " in listed and text in listed
        command = cli.cli.get_command(click.Context(cli.cli), name)
        assert set(getattr(command, "sections", {})) <= {one.name for one in command.params}
    titles = [f"{title}:" for title in cli.SECTIONS]
    assert sorted(titles, key=listed.index) == titles
    assert said() == listed
    assert said("--version") == f"facetrack {__version__}\n"
    run = said("run", "--help-all")
    parts = ("Where the track begins:", "\n  --box X,Y", "Many clips and long", "\n  --shard")
    places = [run.index(part) for part in parts]
    assert places == sorted(places) and run.count("\n  --split") == 1 and "Options:\n  -h, --help" in run


def every_command():
    for name in cli.COMMANDS:
        command = cli.cli.get_command(click.Context(cli.cli), name)
        yield name, command
        for below, subcommand in getattr(command, "commands", {}).items():
            yield f"{name} {below}", subcommand


@pytest.mark.parametrize(("name", "command"), list(every_command()))
def test_a_command_has_an_example_and_help_of_80_columns_and_twelve_options(name, command, capsys):
    def shown(text):
        return {*re.findall(r"^  (?:-\w, )?(--[\w-]+)", text, re.MULTILINE)} - {"--help", "--help-all"}

    assert main([*name.split(), "--help"]) == 0
    text = capsys.readouterr().out
    options = {max(one.opts, key=len) for one in command.params if isinstance(one, click.Option)} - {"--help-all"}
    assert len(shown(text)) <= 12 and shown(text) <= options
    if len(options) > 12:
        assert main([*name.split(), "--help-all"]) == 0
    assert shown(capsys.readouterr().out if len(options) > 12 else text) == options
    example = text if isinstance(command, click.Group) else text.partition("Example")[2]
    assert f"facetrack {name}" in example.partition("Options:")[0]
    assert [line for line in text.splitlines() if len(line) > 80] == []
    assert not command.get_short_help_str(60).endswith("..."), "the first sentence of the help is too long for a list"
    for option in command.params:
        assert not isinstance(option, click.Option) or option.help, option.name


# errors end in one line and an exit code


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (InputError("clip.mp4: empty; record it again"), 3, "error: clip.mp4: empty; record it again"),
        (InputError("a\nb.mp4: empty"), 3, "error: a b.mp4: empty"),
        (click.UsageError("No such thing."), 2, "error: No such thing (see facetrack boom --help)"),
        (click.FileError("x.csv", "gone"), 2, "error: Could not open file 'x.csv': gone"),
        (KeyboardInterrupt(), 130, "interrupted"),
        (RecipeError("r.yaml:1:2: wrong"), 2, "error: r.yaml:1:2: wrong"),
    ],
)
def test_an_error_is_one_line(boom, capsys, error, code, said):
    assert boom(raising(error)) == code
    out, err = capsys.readouterr()
    assert out == "" and err.strip() == f"facetrack: {said}"


def test_a_crash_is_an_internal_error_in_one_line(boom, capsys, monkeypatch):
    assert boom(raising(ZeroDivisionError("two\nlines"))) == ExitCode.FAULT
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("facetrack: error: internal error: ZeroDivisionError: two lines; please report it")
    for debug, words, told in (("1", ["boom"], True), ("0", ["boom"], False)):
        monkeypatch.setenv("FACETRACK_DEBUG", debug)
        assert main(words) == ExitCode.FAULT
        assert ("Traceback" in capsys.readouterr().err) == told


@pytest.mark.parametrize("code", list(ExitCode))
def test_a_command_may_return_its_exit_code_or_leave_with_it(boom, code):
    assert boom(lambda: code) == code
    assert boom(raising(click.exceptions.Exit(code))) == code
    assert boom(lambda: None) == 0
    with pytest.raises(SystemExit) as left:
        boom(raising(SystemExit(code)))
    assert left.value.code == code


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["rnu"], "No such command 'rnu'"),
        (["recipes", "show"], "Missing argument 'RECIPE' (see facetrack recipes show --help)"),
        (["export", "run"], "Missing option '--to'. Choose from: csv-wide, pose,"),
        (["app", str(FOLDER / "map.mp4")], "map.mp4: is a file; name a folder for the project, and add clips"),
        (["recipes", "show", "factorised"], '"factorised" is neither a file nor a shipped recipe; did you mean'),
    ],
)
def test_usage_errors(arguments, said, capsys):
    assert main(arguments) == ExitCode.USAGE
    out, err = capsys.readouterr()
    assert out == "" and said in err and err.startswith("facetrack: error: ") and err.count("\n") == 1


@pytest.mark.skipif(os.name == "nt", reason="pipes break otherwise there")
@pytest.mark.parametrize("words", [["recipes", "schema"], ["--help"]])
def test_a_reader_that_goes_is_no_error(words):
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "facetrack_cli", *words]
    done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True)
    os.close(writing)
    assert (done.returncode, done.stderr) == (cli.READER_GONE, "")


# recipes


def test_recipes_are_found_from_anywhere_and_shown_as_they_are(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("r.yaml").write_text("# wrong, but shown: é\nseed: [", encoding="utf-8")
    assert main(["recipes", "show", "r.yaml"]) == 0
    assert capsys.readouterr().out == "# wrong, but shown: é\nseed: [\n"
    assert main(["recipes"]) == 0
    rows = [line.split("\t") for line in capsys.readouterr().out.splitlines()]
    particles = {name: count for name, count, _ in rows}
    assert (particles["factorized"], particles["independent"], particles["mil"]) == ("100", "1000", "-")
    assert len(rows) == len(shipped_recipes())
    assert all(len(text) > 20 for *_, text in rows)
    for name in ("factorized", "factorized.yaml"):
        assert main(["recipes", "show", name]) == 0
        out = capsys.readouterr().out
        assert out.startswith("# Patras & Pantic") and "\x1b" not in out


def test_check_lists_every_error_of_every_file(capsys, tmp_path):
    path = tmp_path / "r.yaml"
    path.write_text("description: x\nseed: -1\nsed: 2\n")
    assert main(["recipes", "check", "sir", str(path), "nowhere.yaml"]) == 2
    out = capsys.readouterr().out.splitlines()
    assert out[0] == "sir: good"
    assert f"{path}:2:7: seed: Input should be greater than or equal to 0, not -1" in out
    assert f'{path}:3:1: unknown key "sed"; did you mean "seed"?' in out
    assert sum("the recipe lacks" in line for line in out) == 4
    assert out[-1].startswith('"nowhere.yaml" is neither a file')
    assert main(["recipes", "check", "sir", "--set", "filter.particles=0"]) == 2
    assert main(["recipes", "check", "sir", "--set", "filter.particles=9"]) == 0


def test_every_shipped_recipe_has_one_task_by_which_a_terminal_lists_them(monkeypatch, capsys):
    in_tasks = [name for names in TASKS.values() for name in names]
    assert sorted(in_tasks) == sorted(path.stem for path in shipped_recipes())
    assert {default_recipe(box=False), default_recipe(box=True)} <= {*TAKE}
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    assert main(["recipes"]) == 0
    listed = capsys.readouterr().out
    assert all(f"{task}:" in listed for task in TASKS) and "\t" not in listed
    marked = re.findall(r"^  -> (\w+) ", listed, re.MULTILINE)
    assert marked == [*TAKE] == ["face", "correlation_filter", "signer", "adaptive_recognition"]


def test_init_finds_all_faces_of_a_frame(tmp_path, capsys):
    with open_source(FOLDER / "film.mp4", start=92, stop=96) as source:
        write_pictures(tmp_path / "two", [frame.bgr for frame in source])
    for faces, targets in (("one", ["face"]), ("all", ["face", "face_2"])):
        path = tmp_path / f"{faces}.init.yaml"
        assert main(["init", str(tmp_path / "two"), "--faces", faces, "-o", str(path)]) == 0
        assert list(read_init(path).targets) == targets
    capsys.readouterr()
    assert main(["init", str(tmp_path / "two"), "--faces", "all", "--box", "1,1,50,50"]) == ExitCode.USAGE
    assert "leave out --box" in capsys.readouterr().err
    small = ["--config", "head_hands", "--box", "155,60,4,4", "-o", str(tmp_path / "small.yaml")]
    assert main(["init", str(tmp_path / "two"), *small]) == ExitCode.INPUT and not (tmp_path / "small.yaml").exists()
    assert "the box of head is smaller than 6x6" in capsys.readouterr().err


def test_people_prints_its_table_unless_it_is_to_be_quiet_and_saves_over_no_file(tmp_path, capsys):
    film = tmp_path  # the folder of a run of everybody, by its rows and its list of people
    (film / "people.json").write_bytes(next(guided.seeds("people")))
    rows = "".join(f"{t},{t / 25},a,box,50,50,20,20,tracked\n" for t in range(9))
    (film / "trajectory.csv").write_text(f"frame,time_s,target,part,x,y,w,h,status\n{rows}")
    for words, said in (((), "1 people in 1 shots"), (("-q",), ""), (("-q", "--csv"), "person,first_frame")):
        assert main(["people", str(film), *words]) == 0
        out, err = capsys.readouterr()
        assert out.startswith(said) and bool(out) is bool(said) and err == ""
    known = film / "known.npz"
    known.write_text("precious")
    assert main(["people", str(film), "--rename", "a=Ann", "--save", str(known)]) == ExitCode.USAGE
    assert "known.npz: exists already; replace it with --overwrite" in capsys.readouterr().err
    assert known.read_text() == "precious" and '"Ann"' not in (film / "people.json").read_text()
