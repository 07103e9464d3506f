"""facetrack run as its users meet it: files, exit codes, one line for what is wrong, and nothing lost on the way."""

import contextlib
import csv
import errno
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path, PureWindowsPath

import cv2
import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core import files
from facetrack_cli.core.errors import ExitCode
from facetrack_cli.core.files import FileSink, cannot_write
from facetrack_cli.core.models import shipped_folder
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.batch import folders, variant_name
from facetrack_cli.runs.clip import RunMonitor
from facetrack_cli.runs.clip import run as track_run
from facetrack_cli.runs.plan import Job
from facetrack_cli.runs.signals import Stop
from facetrack_cli.video.overlay import Overlay
from facetrack_cli.video.source import open_source
from facetrack_cli.video.writer import VideoWriter
from tests.support.samples import FOLDER
from tests.support.sway import FACETRACK, INIT, ROWS, SMALL, TABLES, count, make_clip, names, one_line, until
from tests.support.terminal import read_all

SAMPLE = FOLDER / "expressions.mp4"
ALL = ["annotated.mp4", "run.json", *TABLES]
posix = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    return make_clip(tmp_path_factory.mktemp("clip") / "sway.mp4").parent


@pytest.fixture
def clip(clips):
    return clips / "sway.mp4"


@pytest.fixture(scope="module")
def long_clip(tmp_path_factory):
    """Long enough to be interrupted at leisure."""
    return make_clip(tmp_path_factory.mktemp("long") / "long.mp4", 1500)


@pytest.fixture
def run(facetrack, monkeypatch):
    """Run `facetrack run` in this process and in an empty folder; exit code, stdout, stderr."""
    monkeypatch.setattr("facetrack_cli.runs.progress.EVERY_S", 1e9)  # on a busy machine compiling takes long
    return partial(facetrack, "run")


@pytest.fixture(scope="module")
def ran(clips):
    """A finished run of the clip, of 8 frames; nobody may change it."""
    words = ["run", clips / "sway.mp4", *SMALL, "--stop", 8, "-o", clips / "ran", "-q"]
    assert main([*map(str, words)]) == 0
    return clips / "ran"


def again(run, clip, *args):
    """Run into the folder o as `ran` was run."""
    return run(clip, *SMALL, "--stop", 8, "-o", "o", *args)


def footer(folder):
    return json.loads((Path(folder) / "trajectory.json").read_text())


def frames_in(text):
    return [int(line.split(",")[0]) for line in text.splitlines()[1:]]


def pictures(clip, first):
    """Write the frames of a clip as images, numbered from the `first` on, with their start."""
    Path("pictures").mkdir()
    Path("pictures.init.yaml").write_text(INIT)
    with open_source(clip) as source:
        for frame in source:
            assert cv2.imwrite(f"pictures/{frame.index + first}.png", frame.bgr)


def test_a_clip_gets_a_folder_with_three_files(run, clip):
    code, out, err = run(clip, *SMALL)
    assert (code, out) == (0, "") and names(Path("sway-face")) == ALL
    rows = list(csv.DictReader(Path("sway-face/trajectory.csv").read_text().splitlines()))
    assert [int(row["frame"]) for row in rows] == [i for i in range(30) for _ in range(ROWS)]
    assert {row["status"] for row in rows[:ROWS]} == {"init"}
    assert count(Path("sway-face/annotated.mp4")) == 30
    data = footer("sway-face")
    assert (data["complete"], data["frames_tracked"], data["variable_fps"]) == (True, 30, False)
    assert (data["recipe"]["name"], data["recipe"]["filter"]["particles"]) == ("face", 20)
    assert data["source"] == {"path": str(clip), "size": [128, 96], "fps": 25.0}
    assert data["init"]["targets"]["face"]["points"]["nose"] == [60, 40]
    assert data["frames"][0]["targets"][0]["particles"] == 20
    line, verdict, next_ = err.splitlines()
    assert "begins in frame 0 (0:00.00), by" in verdict
    assert next_ == "look: facetrack report sway-face; correct: facetrack fix sway-face"
    assert ", ".join(["annotated.mp4", *TABLES]) in line and "30 frames; " in line and " frames/s" in line


def test_what_is_streamed_and_the_frames_and_the_seed_that_are_asked_for(run, clip):
    stream = partial(run, clip, *SMALL, "--stop", 12, "-o", "-")
    first = stream()[1]
    assert names(Path()) == []
    assert run(clip, *SMALL, "--stop", 12, "--no-video", "-o", "deep/er", "--format", "csv,jsonl")[0] == 0
    assert names(Path("deep/er")) == ["run.json", "trajectory.csv", "trajectory.jsonl"]
    assert first == Path("deep/er/trajectory.csv").read_text()
    assert stream("--format", "jsonl")[1] == Path("deep/er/trajectory.jsonl").read_text()
    assert {*frames_in(stream("--init-frame", 7, "--start", 5)[1])} == {*range(7, 12)}
    assert stream("--seed", 5)[1] == stream("--set", "seed=5")[1] != first


def test_the_same_bytes_with_one_thread_and_two_and_from_pictures(run, clip):
    for threads in (1, 2):
        assert run(clip, *SMALL, "-o", f"files{threads}", "--threads", threads)[0] == 0
    one, other = (Path(f"files{n}/trajectory.csv").read_text() for n in (1, 2))
    assert one == other and footer("files1") == footer("files2")
    pictures(clip, 1)  # 2.png comes before 10.png
    images = run("pictures", *SMALL, "-o", "-", "--fps", 25)[1]
    assert run("pictures/*.png", *SMALL, "--init", "pictures.init.yaml", "-o", "-", "--fps", "25")[1] == images
    # grey is the decoder's luma; of images it is computed from rounded colours
    for ours, theirs in zip(*(csv.DictReader(text.splitlines()) for text in (one, images)), strict=True):
        assert [float(ours[key]) for key in "xy"] == pytest.approx([float(theirs[key]) for key in "xy"], abs=3.0)
    assert run("pictures", *SMALL, "--fps", 12.5)[0] == 0
    assert footer("pictures-face")["frames"][-1]["time_s"] == pytest.approx(29 / 12.5)
    assert count(Path("pictures-face/annotated.mp4")) == 30


def test_a_face_is_found_where_no_init_file_lies(run):
    Path("clip.mp4").symlink_to(SAMPLE)
    assert run("clip.mp4", *SMALL, "--stop", 4, "--no-video")[0] == 0
    init = footer("clip-face")["init"]
    assert init["from"] in ("haar", "yunet")  # what is installed
    rows = csv.DictReader(SAMPLE.with_suffix(".truth.csv").read_text().splitlines())
    truth = next((float(row["x"]), float(row["y"])) for row in rows if row["frame"] == "0" and row["part"] == "nose")
    assert np.hypot(*np.subtract(init["targets"]["face"]["points"]["nose"], truth)) < 15
    assert run(SAMPLE, *SMALL, "--start", 9, "--stop", 11, "--no-video", "--init", "haar", "-o", "x")[0] == 0
    assert (footer("x")["init"]["from"], footer("x")["init"]["frame"]) == ("haar", 9), "beside an init file, too"


def test_a_box_is_enough(run):
    within = ["--box", "110,93,99,99", "--init-frame", 3, "--stop", 6, "-o", "-"]
    assert frames_in(run(SAMPLE, *SMALL, "--config", "factorized", *within)[1])[::5] == [3, 4, 5]
    code, out, _ = run(SAMPLE, *within)
    rows = [line.split(",") for line in out.splitlines()[1:]]
    assert code == 0 and [(row[0], row[3]) for row in rows] == [("3", "box"), ("4", "box"), ("5", "box")]
    Path("box.yaml").write_text("frame: 2\nbox: [110, 93, 99, 99]\n")
    assert len(frames_in(run(SAMPLE, *SMALL, "--init", "box.yaml", "--stop", 4, "-o", "-")[1])) == 2 * ROWS


@pytest.mark.parametrize(
    ("args", "code", "message"),
    [
        (["--box", "1,2,3"], 2, "four numbers"),
        (["--box", "1,2,3,4", "--init", "x"], 2, "--init and --box"),
        (["--format", "xml"], 2, "choose among csv, json, jsonl"),
        (["--fps", "0"], 2, "frames per second"),
        (["--fps", "25"], 2, "--fps is for images"),
        (["--start", "9", "--stop", "9"], 2, "leaves no frame"),
        (["--start", "-1"], 2, "--start"),
        (["--config", ""], 2, "--config is empty"),
        (["--set", "target.windows=1000px"], 2, "larger than the frame of 128x96; make it smaller"),
        (["-o", "-", "--format", "csv,json"], 2, "one format"),
        (["other.mp4", "-o", "-"], 2, "streams one clip"),
        *((["--shard", shard], 2, "give I/N") for shard in ("0/5", "6/5", "a/b")),
        (["-o", ""], 2, "--out is empty"),
        (["--init", "none.yaml"], 3, "none.yaml: cannot be read: No such file"),
        (["--init", "haar", "--start", "99"], 3, "frame 99 is past the end"),
        (["--init", "haar", "--stop", "9"], 3, "no face found in frames 0 to 8"),
        (["--start", "3"], 3, "begins at frame 0, but frames from 3 on were asked for"),
        (["--init-frame", "4", "--stop", "4"], 3, "begins at frame 4, but frames 0 to 3 were asked for"),
        (["--init-frame", "30"], 3, "frame 30 is past the end, the clip has 30 frames"),
        (["--init-frame", "500"], 3, "(frame 500 is where --init-frame begins)"),
        (["--box", "500,500,10,10"], 3, "outside the frame of 128x96"),
        (["--box", "-400000,-400000,800000,800000"], 3, "larger than the frame of 128x96"),
    ],
)
def test_what_cannot_be_meant_is_one_line(run, clip, args, code, message):
    before = names(Path())
    got, out, err = run(clip, *args)
    assert (got, out) == (code, "")
    assert message in (err.splitlines()[0] if code == 2 else one_line(err))
    assert "internal error" not in err and "Traceback" not in err and names(Path()) == before


@pytest.mark.parametrize("what", ["missing.mp4", "text.mp4", "empty.mp4", "nothing"])
def test_an_input_that_is_no_clip_leaves_all_as_it_was(run, what):
    Path("text.mp4").write_text("not a video")
    Path("empty.mp4").touch()
    Path("nothing").mkdir()
    Path("old").mkdir()
    Path("old/trajectory.csv").write_text("mine")
    before = names(Path())
    code, _, err = run(what)
    assert code == 3 and what in one_line(err) and names(Path()) == before
    assert run(what, "-o", "old", "--overwrite")[0] == 3
    assert names(Path("old")) == ["trajectory.csv"] and Path("old/trajectory.csv").read_text() == "mine"


def test_results_that_are_there_are_not_touched(run, clip):
    folder = Path("sway-face")
    folder.mkdir()
    (folder / "trajectory.json").write_text("mine")
    code, _, err = run(clip, *SMALL)
    assert code == 2
    assert "sway-face/trajectory.json: exists already; replace it with --overwrite" in one_line(err)
    assert names(folder) == ["trajectory.json"] and (folder / "trajectory.json").read_text() == "mine"
    assert run(clip, *SMALL, "--format", "csv", "--no-video")[0] == 2, "they would stand beside what is no part of them"
    assert run(clip, *SMALL, "--overwrite")[0] == 0
    assert names(folder) == ALL and footer(folder)["complete"]
    # what was made from it, or corrected in it, stays and is named
    mine = {"report.html", "trajectory.wide.csv", "corrected.init.yaml", "unsaved.init.yaml", "notes.txt"}
    for name in mine:
        (folder / name).write_text(INIT)
    init = ["--init", folder / "corrected.init.yaml"]
    code, _, err = run(clip, *SMALL, "--overwrite", "--no-video", *init)
    assert code == 0 and {*names(folder)} == {*mine, "run.json", *TABLES}
    assert "older than the track: report.html, trajectory.wide.csv; make them anew" in err
    assert "unsaved.init.yaml: holds corrections that this track does not have" in err
    assert "corrected.init.yaml: holds" not in err, "the run begins with them"
    assert "older" not in run(clip, *SMALL, "--no-video", *init)[2], "nothing is replaced"


def test_what_is_read_is_never_the_output(run, clip):
    init, refused = clip.with_suffix(".init.yaml"), "is read here, and would be replaced"
    shutil.copy(clip, "annotated.mp4")
    Path("trajectory.json").write_text('{"frame": 0, "box": [30, 10, 60, 70]}')
    shutil.copy(shipped_folder() / "sir.yaml", "trajectory.csv")
    Path("pictures").mkdir()
    before = {path.name: path.read_bytes() for path in Path().glob("*.*")}
    for args, said in (
        (["annotated.mp4", "-o", ".", "--overwrite", "--init", init], refused),
        ([clip, "--init", "trajectory.json", "-o", ".", "--overwrite"], refused),
        ([clip, "--config", "trajectory.csv", "-o", ".", "--overwrite"], refused),
        (["pictures", "-o", "pictures"], "among the frames of the input"),
    ):
        code, _, err = run(*args)
        assert code == 2 and said in one_line(err)
    assert {path.name: path.read_bytes() for path in Path().glob("*.*")} == before


def test_what_is_in_the_way(run, clip):
    Path("taken").touch()
    Path("link").mkdir()
    Path("link/trajectory.csv").symlink_to("nowhere")
    for name in ("trajectory.csv", "annotated.mp4"):
        Path("o", name).mkdir(parents=True)
        assert f"{name}: is a folder, where a file is to be" in one_line(run(clip, "-o", "o", "--overwrite")[2])
        assert names(Path("o")) == [name]
        Path("o", name).rmdir()
    for out, said in (
        ("taken", "taken: is a file"),
        ("link", "exists already"),
    ):
        code, _, err = run(clip, "-o", out)
        assert code == 2 and said in one_line(err)


@pytest.mark.parametrize("name", ["annotated.mp4", "trajectory.csv", "run.json", ".checkpoint", ".facetrack.lock"])
def test_what_is_replaced_in_a_folder_is_no_link(run, clip, ran, name):
    """Whoever shares a folder may have left a link in it to a file of the user's."""
    Path("mine").mkdir()
    Path("mine/file").write_text("mine")
    shutil.copytree(ran, "o")
    Path("o", name).unlink(missing_ok=True)
    Path("o", name).symlink_to("../mine" if name == ".checkpoint" else "../mine/file")
    code, _, err = again(run, clip, "--seed", "5", "--overwrite")
    assert code in (ExitCode.USAGE, ExitCode.INPUT) and f"o/{name}: is " in one_line(err)
    assert names(Path("mine")) == ["file"] and Path("mine/file").read_text() == "mine"


def test_what_is_made_beside_a_run_is_no_link(facetrack, ran):
    shutil.copytree(ran, "o")
    Path("mine").write_text("mine")
    for name in ("report.html", "plot.png", "trajectory.mot.txt", "trajectory.mot"):
        Path("o", name).symlink_to("../mine")
    for words in (("report", "o"), ("plot", "o"), ("export", "o", "--to", "mot")):
        assert facetrack(*words, "--overwrite")[0] in (0, 2)
    assert Path("mine").read_text() == "mine"


def test_what_is_done_is_not_done_again_and_what_was_done_otherwise_is_refused(run, clips, tmp_path):
    clip = shutil.copy(clips / "sway.mp4", tmp_path / "sway.mp4")
    shutil.copy(clips / "sway.init.yaml", tmp_path)
    assert again(run, clip)[0] == 0
    before = Path("o/trajectory.csv").stat().st_mtime_ns
    assert "done before" in again(run, clip)[2] and Path("o/trajectory.csv").stat().st_mtime_ns == before
    Path(clip).touch()
    told = Path("o/run.json")
    told.write_text(json.dumps({**json.loads(told.read_text()), "log": ["a member of another version"]}))
    assert "done before" in again(run, clip)[2], "the same bytes, although its time is another"
    for change in (["--seed", "9"], ["--stop", "5"], ["--no-video"], ["--set", "confidence.patience=4"]):
        assert "exists already" in one_line(again(run, clip, *change)[2])
    make_clip(Path(clip), 11)
    assert "exists already" in one_line(again(run, clip)[2])
    assert again(run, clip, "--overwrite")[0] == 0 and "log" not in json.loads(told.read_text())


def zeros(name):
    """A file system may leave that after a power loss."""
    return lambda: Path("o", name).write_bytes(bytes(Path("o", name).stat().st_size))


def with_file(name):
    def change():
        told = json.loads(Path("o/run.json").read_text())
        told["files"][name] = {"bytes": 3, "sha256": "0" * 64}
        Path("o/run.json").write_text(json.dumps(told))

    return change


ELSEWHERE = ["../x", "/etc/hostname", "a/b", "a\0b", "people/1.jpg"]


@pytest.mark.parametrize("change", [*map(zeros, ("trajectory.csv", "annotated.mp4")), *map(with_file, ELSEWHERE)])
def test_what_is_not_as_run_json_says_is_not_done(run, clip, ran, change):
    shutil.copytree(ran, "o")
    change()
    code, _, err = again(run, clip)
    assert code == ExitCode.USAGE and "exists already" in one_line(err)


def test_a_full_disk_keeps_what_was_tracked(run, clip, monkeypatch):
    write = FileSink._write

    def full(self, data):
        room = 5000 - self._file.tell()
        write(self, data if self.path.suffix != ".csv" else data[: max(room, 0)])
        if self.path.suffix == ".csv" and len(data) > room:
            self._full = True
            raise cannot_write(self.path, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))

    monkeypatch.setattr(FileSink, "_write", full)
    code, _, err = run(clip, *SMALL)
    assert code == 2 and names(Path("sway-face")) == ALL
    assert "incomplete" in err.splitlines()[0] and "trajectory.csv: the disk is full" in err.splitlines()[1]
    kept = frames_in(Path("sway-face/trajectory.csv").read_text())
    assert kept == [i for i in range(len(kept) // ROWS) for _ in range(ROWS)] and 0 < len(kept) < 150


def test_a_cut_clip_gives_its_rows_a_warning_and_0(run, clip):
    pictures(clip, 0)
    whole = Path("pictures/20.png").read_bytes()
    Path("pictures/20.png").write_bytes(whole[: len(whole) // 2])
    code, _, err = run("pictures", *SMALL)
    warning, summary, _, _ = err.splitlines()
    assert code == 0 and warning.startswith("facetrack: warning: ") and "20.png" in warning
    assert "20 frames" in summary and "incomplete" in summary
    data = footer("pictures-face")
    assert (data["complete"], data["frames_tracked"]) == (False, 20) and "stopped" not in data
    assert "20.png" in data["warnings"][0] and count(Path("pictures-face/annotated.mp4")) == 20
    Path("pictures/0.png").write_bytes(b"")
    code, _, err = run("pictures", "-o", "again")
    assert code == 3 and "0.png" in one_line(err) and not Path("again").exists()


def test_strict_makes_damage_an_error(run, clip):
    data = bytearray(clip.read_bytes())
    for at in range(len(data) // 2, len(data) * 2 // 3, 97):
        data[at] ^= 0x5A
    Path("hurt.mp4").write_bytes(data)
    Path("hurt.init.yaml").write_text(INIT)
    code, _, err = run("hurt.mp4", *SMALL)
    warning, summary, *_ = err.splitlines()
    assert code == 0 and "hurt.mp4: damaged: the decoder reports errors at about frame" in warning
    assert "incomplete" in summary
    before = footer("hurt-face")
    assert before["complete"] is False and before["frames_tracked"] >= 28
    code, _, err = run("hurt.mp4", *SMALL, "--strict", "--overwrite")
    _, error = err.splitlines()
    assert code == ExitCode.INPUT and error.startswith("facetrack: error: ") and "damaged" in error
    assert not footer("hurt-face")["complete"] and footer("hurt-face")["frames"] == before["frames"]
    assert run(clip, *SMALL, "--strict", "-o", "whole")[0] == 0


def test_a_fault_of_ours_keeps_what_was_tracked(run, clip, monkeypatch):
    draw = Overlay.draw

    def failing(self, result):
        if result.frame.index == 10:
            raise ZeroDivisionError("a bug")
        return draw(self, result)

    monkeypatch.setattr(Overlay, "draw", failing)
    code, _, err = run(clip, *SMALL)
    assert code == 1 and "internal error" in err.splitlines()[-1] and "Traceback" not in err
    assert count(Path("sway-face/annotated.mp4")) == 10
    assert (footer("sway-face")["complete"], footer("sway-face")["stopped"]) == (False, "a bug")
    monkeypatch.setattr(RunMonitor, "write", lambda *_: 1 / 0)
    assert run(clip, *SMALL, "-o", "first")[0] == 1 and not Path("first").exists(), "of the first frame nothing is"


@pytest.mark.parametrize("threads", [1, 2])
def test_an_encoder_that_is_killed(run, clip, monkeypatch, threads):
    write = VideoWriter.write

    def killed(video, image, time_s):
        if time_s > 0.3:
            video._child.kill()
            video._child.wait()
        write(video, image, time_s)

    monkeypatch.setattr(VideoWriter, "write", killed)
    code, _, err = run(clip, *SMALL, "--threads", threads)
    summary, error = err.splitlines()
    assert code == ExitCode.USAGE and names(Path("sway-face")) == ["run.json", *TABLES]
    assert "(trajectory.csv, trajectory.json): 30 frames" in summary and "incomplete" not in summary
    assert "annotated.mp4: the video cannot be written (ffmpeg was killed by signal 9); run it again" in error
    data = footer("sway-face")
    assert data["complete"] is True and "stopped" not in data and len(data["frames"]) == 30
    assert ["annotated.mp4: the video cannot be written" in line for line in data["warnings"]] == [True]
    monkeypatch.setattr(VideoWriter, "write", write)
    code, _, err = run(clip, *SMALL, "--threads", threads)
    assert code == 0 and "frames/s" not in err and count(Path("sway-face/annotated.mp4")) == 30, "only drawn"
    assert footer("sway-face") == {**data, "warnings": []} and "killed" not in Path("sway-face/run.json").read_text()


def test_a_part_that_is_lost_at_the_end(run, tmp_path):
    path = make_clip(tmp_path / "covered.mp4", 20, cover=9)
    assert run(path, *SMALL, "--no-video")[0] == 0
    code, _, err = run(path, *SMALL, "--no-video", "--fail-on-lost", "--overwrite")
    assert code == 4 and footer("covered-face")["lost_frames"]
    assert "lost: " in err.splitlines()[0] and "; look at frames " in err.splitlines()[1]
    assert run(path, *SMALL, "--no-video", "--fail-on-lost", "-o", "early", "--stop", 8)[0] == 0


def test_folder_names_are_told_apart_by_where_the_clips_lie(tmp_path, monkeypatch):
    def named(*clips):
        return folders([tmp_path / clip for clip in clips], "r")

    assert named("a/clip.mp4", "a/other.mp4") == ["clip-r", "other-r"]
    assert named("a/clip.mp4", "b/clip.mp4", "b/x.mp4") == ["a-clip-r", "b-clip-r", "x-r"]
    assert named("a/s/clip.mp4", "b/s/clip.mp4") == ["a-s-clip-r", "b-s-clip-r"]
    assert named("a/clip.mp4", "a/clip.avi") == ["a-clip-mp4-r", "a-clip-avi-r"]
    assert named("a/Clip.mp4", "b/clip.mp4") == ["a-Clip-r", "b-clip-r"]
    both = named("A-clip.mp4", "a/clip.mp4", "b/clip.mp4")
    assert len({one.casefold() for one in both}) == 3 and both == named("A-clip.mp4", "a/clip.mp4", "b/clip.mp4")
    monkeypatch.setattr("facetrack_cli.runs.batch.title", lambda clip: clip.stem)
    monkeypatch.setattr("facetrack_cli.runs.batch.absolute", PureWindowsPath)
    assert folders([Path("C:/a/clip.mp4"), Path("D:/b/clip.mp4")], "r") == ["a-clip-r", "b-clip-r"]


def test_runs_of_other_settings_have_folders_of_their_own(run, clip):
    assert variant_name("face", ()) == "face"
    assert variant_name("face", ("filter.particles=500", "head=null")) == "face-filter.particles=500,head=null"
    assert variant_name("a", ("likelihood.windows={a: ../b}",)) == "a-likelihood.windows=-a--..-b-"
    assert run(clip, "--set", "filter.particles=21", "--no-video", "--stop", "3")[0] == 0
    assert footer("sway-face-filter.particles=21")["recipe"]["filter"]["particles"] == 21


@pytest.mark.parametrize("workers", [1, 2])
def test_a_batch_goes_on_past_a_bad_clip(run, clip, tmp_path, workers):
    other = make_clip(tmp_path / "one clip\n2.mp4", 6)
    Path("bad.mp4").write_text("no video")
    code, out, err = run(clip, "bad.mp4", other, other, *SMALL, "--stop", 9, "-j", workers, "-o", "all")
    assert (code, out) == (5, "")
    folders = [name for name in names(Path("all")) if not name.endswith(".json")]
    assert folders == ["bad-face", "one clip\n2-face", "sway-face"]
    assert names(Path("all/bad-face")) == ["run.json"]
    assert count(Path("all/sway-face/annotated.mp4")) == 9
    assert len(footer("all/one clip\n2-face")["frames"]) == 6
    lines = err.splitlines()
    assert sum("facetrack: error: bad.mp4: not a video" in line for line in lines) == 1
    assert lines[-1] == "1 of 3 inputs failed" and len(lines) == 4


def interrupted(args, ready, *signals, group=False):
    """Start the command, send the signals once it is `ready`; exit code and stderr."""
    words = [*FACETRACK, "run", *map(str, args)]
    process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, start_new_session=True)
    try:
        until(ready, process)
        for number in signals:
            with contextlib.suppress(ProcessLookupError):  # it has ended
                os.killpg(process.pid, number) if group else process.send_signal(number)
            time.sleep(0.1)  # of two that wait at once, Python handles the lower number first
        _, err = process.communicate(timeout=60)
        return process.returncode, err
    finally:
        process.kill()


def growing(folder):
    """Whether the encoder has written something already: then frames are being tracked."""
    return lambda: any(path.stat().st_size > 0 for path in folder.glob(".annotated*.mp4"))


def check_interrupted(folder, all_frames, reason):
    data = footer(folder)
    done = data["frames_tracked"]
    assert names(folder) == ALL and 0 < done < all_frames
    assert (data["complete"], data["stopped"], len(data["frames"])) == (False, reason, done)
    assert len(frames_in((folder / "trajectory.csv").read_text())) == ROWS * done
    assert count(folder / "annotated.mp4") == done


INT, TERM = signal.SIGINT, signal.SIGTERM


@posix
@pytest.mark.parametrize(
    ("signals", "code", "reason"), [([INT, INT, INT], 130, "interrupted"), ([TERM, INT], 143, "terminated")]
)
def test_a_signal_closes_the_files(long_clip, tmp_path, signals, code, reason):
    out = tmp_path / "out"
    got, err = interrupted([long_clip, *SMALL, "-o", out], growing(out), *signals, group=signals[0] == INT)
    assert got == code and reason in one_line(err)
    check_interrupted(out, 1500, reason)


@posix
def test_a_signal_ends_a_batch_cleanly(long_clip, tmp_path):
    clips, out = [tmp_path / f"{name}.mp4" for name in "abc"], tmp_path / "out"
    for path in clips:
        path.symlink_to(long_clip)
        path.with_suffix(".init.yaml").write_text(INIT)
    ready = [growing(out / f"{name}-face") for name in "ab"]
    words = [*clips, *SMALL, "-j", "2", "-o", out]
    got, err = interrupted(words, lambda: all(one() for one in ready), INT, group=True)
    assert got == 130 and "Traceback" not in err
    for name in "ab":
        check_interrupted(out / f"{name}-face", 1500, "interrupted")
    assert not (out / "c-face").exists()


@posix
def test_a_signal_while_looking_for_a_face(long_clip, tmp_path):
    out = tmp_path / "out"
    got, err = interrupted([long_clip, "--init", "haar", "-o", out], out.exists, INT, group=True)
    assert got == 130 and "nothing was written" in one_line(err) and not out.exists()


def test_the_checksum_of_a_clip_says_how_far_it_is_and_can_be_stopped(clip, tmp_path, monkeypatch):
    monkeypatch.setattr(files, "BLOCK", 1000)
    size, out, stop, said = clip.stat().st_size, tmp_path / "out", Stop(), []

    def looked(done, total, doing="", unit=""):
        if doing == "checksum of the clip":
            said.append((done, total, unit))
            stop.code = ExitCode.INTERRUPTED

    job = Job(clip, load_recipe(SMALL[1]), out, stop=8)
    assert track_run(job, stop, looked=looked).stopped == "interrupted"
    assert said == [(0, size // 10**6, "MB")] and not json.loads((out / "run.json").read_text())["complete"]
    assert track_run(job, Stop()).stopped is None
    run = json.loads((out / "run.json").read_text())
    assert run["complete"] and run["frames"] == 8
    assert run["clip"]["sha256"] == hashlib.sha256(clip.read_bytes()).hexdigest()


@posix
def test_signals_leave_a_note_and_are_given_back():
    before = signal.getsignal(TERM)
    with Stop().listening() as stop:
        assert not stop()
        signal.raise_signal(TERM)
        signal.raise_signal(INT)
        assert stop() and (stop.code, stop.reason) == (ExitCode.TERMINATED, "terminated")
    assert signal.getsignal(TERM) is before
    default = signal.signal(INT, signal.SIG_IGN)
    try:
        with Stop().listening() as stop:
            signal.raise_signal(INT)
            assert not stop(), "what is ignored stays so"
    finally:
        signal.signal(INT, default)


def test_plain_lines_now_and_then(clip, run, monkeypatch):
    monkeypatch.setattr("facetrack_cli.runs.progress.EVERY_S", 0.0)
    lines = run(clip, *SMALL, "--no-video")[2].splitlines()
    assert len(lines) == 33
    assert lines[9].startswith("sway.mp4: 10 of about 30 frames, ") and lines[9].endswith(" frames/s")


@pytest.mark.skipif(os.name != "posix", reason="needs a pseudo-terminal")
def test_a_bar_on_a_terminal(clip, tmp_path, monkeypatch):
    import pty

    ours, theirs = pty.openpty()
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    with ThreadPoolExecutor() as reader, os.fdopen(theirs, "w") as stderr, monkeypatch.context() as patch:
        said = reader.submit(read_all, ours)
        patch.setattr(sys, "stderr", stderr)
        assert main(["run", str(clip), *SMALL, "-o", str(tmp_path / "out")]) == 0
        stderr.close()
        text = said.result()
    assert "frames/s" in text and "━" in text and "30 frames; " in text.splitlines()[-3]


def test_a_reader_that_leaves_ends_the_run_quietly(long_clip):
    words = [*FACETRACK, "run", long_clip, *SMALL, "-o", "-"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout.readline().startswith(b"frame,time_s,")
        process.stdout.close()
        assert process.stderr.read() == b"" and process.wait(30) == 141


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full, or no such shell")
@pytest.mark.parametrize(
    ("streams", "args", "said"),
    [
        (">&-", "-o -", "standard output: cannot be written"),
        (">/dev/full", "-o -", "standard output: the disk is full"),
        *(pytest.param(closed, "", "", marks=pytest.mark.nightly) for closed in (">&-", "2>&-")),
        (">&- 2>&- <&-", "", ""),
        ("2>/dev/full", "", ""),
    ],
)
def test_streams_that_are_closed_or_full(clip, tmp_path, streams, args, said):
    few = " ".join([*SMALL, "--stop 3 --no-video"])
    command = f'"{sys.executable}" -m facetrack_cli run "{clip}" {few} {args} {streams}'
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    ended = subprocess.run(command, shell=True, cwd=tmp_path, capture_output=True, text=True, env=environment)
    assert ended.returncode == (2 if said else 0), ended.stderr
    assert "internal error" not in ended.stderr and "Traceback" not in ended.stderr
    assert said in one_line(ended.stderr) if said else names(tmp_path / "sway-face") == ["run.json", *TABLES]


# the interpreter's own start is not ours: 60 ms are left to it
BY_DAY = [(0.08, "SIGTERM"), (0.12, "SIGHUP"), (0.3, "SIGINT"), (0.6, "SIGTERM")]


HOOK = """
import signal, pathlib
set_ = signal.signal
def watched(number, handler):
    old = set_(number, handler)
    number == signal.SIGTERM and pathlib.Path({!r}).touch()
    return old
signal.signal = watched
"""


@pytest.fixture
def start(tmp_path):
    """Start a command that takes seconds, and wait until our first line of code has run."""
    (tmp_path / "sitecustomize.py").write_text(HOOK.format(str(tmp_path / "began")))

    def run(*arguments, hangup=signal.SIG_DFL, **more):
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(Path.cwd())])}
        # whoever runs the tests may ignore it, as nohup does
        more["preexec_fn"] = lambda: signal.signal(signal.SIGHUP, hangup)
        process = subprocess.Popen([*FACETRACK, *arguments], stderr=subprocess.PIPE, env=environment, **more)
        until((tmp_path / "began").exists, process)
        return process

    return run


def ended(process, name):
    process.send_signal(signal.Signals[name])
    said = process.communicate(timeout=20)[1].decode()
    return process.returncode, said


@posix
@pytest.mark.parametrize(("after", "name"), BY_DAY)
def test_a_signal_while_it_starts(start, tmp_path, after, name):
    process = start("run", "sample_videos/expressions.mp4", "-o", str(tmp_path / "out"), "--config", "adaptive")
    time.sleep(after - BY_DAY[0][0])
    code, said = ended(process, name)
    assert code == (130 if name == "SIGINT" else 143), said
    assert ("interrupted" if name == "SIGINT" else "terminated") in said and "Traceback" not in said


@posix
def test_what_is_ignored_stays_so(start, tmp_path):
    assert ended(start("recipes", hangup=signal.SIG_IGN, stdout=subprocess.DEVNULL), "SIGHUP")[0] == 0
