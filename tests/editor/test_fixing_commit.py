"""A save that is torn off at any moment: the run is then as it was, or as it was to be, never something between."""

import json
import shutil
from pathlib import Path

import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import OutputError
from facetrack_cli.editor import save as saving
from facetrack_cli.editor.save import keep, save
from facetrack_cli.run_folder.finished import open_run
from facetrack_cli.run_folder.lock import FolderLock
from facetrack_cli.trajectory.header import CORRECTED, UNSAVED
from tests.editor.test_fixing_odd import fixing, nose, put
from tests.support.samples import FOLDER

CLIP = FOLDER / "expressions.mp4"


class Killed(BaseException):
    """Nothing is done after it."""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folder of a run, and its files once they are corrected."""
    folder = tmp_path_factory.mktemp("made")
    words = [
        "run",
        CLIP,
        "--config",
        "factorized",
        "-o",
        folder / "out",
        "--set",
        "filter.particles=20",
        "--stop",
        "8",
        "-q",
    ]
    assert main([str(word) for word in [*words, "--format", "csv,json,jsonl"]]) == 0
    shutil.copytree(folder / "out", folder / "after")
    put(folder / "after", nose(4, 158, 140))
    return folder / "out", files_of(folder / "after")


@pytest.fixture
def out(made, tmp_path):
    shutil.copytree(made[0], tmp_path / "out")
    return tmp_path / "out"


def files_of(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != "annotated.mp4"}


@pytest.mark.parametrize("moment", [0, 1, 3, 5])
def test_a_save_that_is_killed_is_finished_by_who_opens_the_run_next(made, out, monkeypatch, moment):
    """Before the files are listed in the note of the lock, and at files that take over."""
    before, after, done = files_of(out), made[1], []
    replace = Path.replace

    def kill(*_):
        raise Killed

    def torn(self, to):
        if len(done) == moment - 1:
            raise Killed
        done.append(self)
        return replace(self, to)

    with fixing(out) as fixer, monkeypatch.context() as patch:
        fixer.put([nose(4, 158, 140)])
        keep(fixer)
        patch.setattr(Path, "unlink", lambda self, missing_ok=False: None)
        patch.setattr(Path, "replace", torn)
        if moment == 0:
            patch.setattr(FolderLock, "prepare", kill)
        with pytest.raises(Killed):
            save(fixer)
    whole = moment > 0
    opened = open_run(out)
    assert [one.frame for one in opened.start.corrections] == ([4] if whole else [])
    assert (out / UNSAVED).exists() != whole
    if not whole:
        assert {name: files_of(out)[name] for name in before} == before
        put(out, nose(4, 158, 140))
    found = files_of(out)
    assert {name: found.pop(name) for name in after} == after
    assert not found


def test_links_stay_links(out, tmp_path):
    kept = tmp_path / "elsewhere.csv"
    shutil.move(out / "trajectory.csv", kept)
    (out / "trajectory.csv").symlink_to(kept)
    put(out, nose(4, 158, 140))
    assert (out / "trajectory.csv").is_symlink() and ",158.000,140.000," in kept.read_text()


def test_a_folder_in_the_place_of_the_init_file_is_refused_before_anything_is_replaced(out):
    before = files_of(out)
    (out / CORRECTED).mkdir()
    with pytest.raises(OutputError, match=r"corrected.init.yaml: is a folder, where a file is to be"):
        put(out, nose(4, 158, 140))
    (out / CORRECTED).rmdir()
    assert files_of(out) == before


def test_a_run_that_is_made_anew_while_it_is_saved_is_not_replaced(out, monkeypatch):
    def slow(start, clip, real=saving.as_yaml):
        (out / "trajectory.csv").write_text("another run")
        return real(start, clip)

    monkeypatch.setattr(saving, "as_yaml", slow)
    before = files_of(out)
    with pytest.raises(OutputError, match=r"trajectory.csv: was written by somebody else since it was opened"):
        put(out, nose(4, 158, 140))
    assert files_of(out) == {**before, "trajectory.csv": b"another run"}


def test_where_nothing_is_corrected_any_more_the_files_do_not_speak_of_corrections(made, out):
    before = files_of(out)
    put(out, nose(4, 158, 140))
    with fixing(out) as fixer:
        fixer.remove(4, "face")
        save(fixer)
    after = files_of(out)
    assert b"corrections" not in after.pop(CORRECTED)
    # the video is painted anew from the rows, which have three decimals
    runs = [json.loads(files.pop("run.json")) for files in (before, after)]
    videos = [run["files"].pop("annotated.mp4") for run in runs]
    assert after == before and runs[0] == runs[1] and all(videos)
