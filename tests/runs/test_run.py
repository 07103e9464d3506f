"""facetrack run as its users meet it: files, exit codes, one line for what is wrong, and nothing lost on the way."""

from __future__ import annotations

import contextlib
import csv
import errno
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.errors import ExitCode
from facetrack_cli.core.files import FileSink, cannot_write
from facetrack_cli.core.models import shipped_folder
from facetrack_cli.core.types import Image
from facetrack_cli.run_folder import manifest
from facetrack_cli.runs.batch import folders, variant_name
from facetrack_cli.runs.signals import Stop, TerminatedError, raising
from facetrack_cli.video.source import open_source
from facetrack_cli.video.writer import VideoWriter
from tests.support.results import file_rows
from tests.support.terminal import read_all

SAMPLE = Path(__file__).parents[2] / "sample_videos" / "expressions.mp4"
FACETRACK = [sys.executable, "-m", "facetrack_cli"]
INIT = """\
frame: 0
points: {nose: [60, 40], mouth_left: [48, 62], mouth_right: [72, 62], lip_upper: [60, 58], lip_lower: [60, 68]}
"""
SMALL = ["--config", str(Path(__file__).parents[1] / "support" / "face.yaml")]  # five points, fast
ROWS = 5  # of a frame

Runner = Callable[..., tuple[int, str, str]]


def texture(size: tuple[int, int] = (128, 96)) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    coarse = np.random.default_rng(3).integers(40, 220, (size[1] // 8, size[0] // 8, 3), dtype=np.uint8)
    return np.asarray(cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC), np.uint8)


def make_clip(path: Path, frames: int = 30, size: tuple[int, int] = (128, 96)) -> Path:
    """A texture that sways, with an init file beside it."""
    still = texture(size)
    with VideoWriter(path, size, Fraction(25)) as video:
        for i in range(frames):
            video.write(np.roll(still, round(3 * np.sin(i / 8)), axis=1), i / 25)
    path.with_suffix(".init.yaml").write_text(INIT)
    return path


def count(path: Path) -> int:
    """Frames of a video that can be decoded."""
    with open_source(path) as source:
        n = sum(1 for _ in source)
        assert source.complete
        return n


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_clip(tmp_path_factory.mktemp("clip") / "sway.mp4")


@pytest.fixture(scope="module")
def long_clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Long enough to be interrupted at leisure."""
    return make_clip(tmp_path_factory.mktemp("long") / "long.mp4", 1500)


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Iterator[Runner]:
    """Run `facetrack run` in this process and in an empty folder; exit code, stdout, stderr."""
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    threads = cv2.getNumThreads()

    def call(*args: object) -> tuple[int, str, str]:
        code = main(["run", *map(str, args)])
        return code, *capfd.readouterr()

    yield call
    cv2.setNumThreads(threads)


def one_line(text: str) -> str:
    lines = text.splitlines()
    assert len(lines) == 1, text
    assert "Traceback" not in text
    return lines[0]


# --- what is written ---


def test_a_clip_gets_a_folder_with_three_files(run: Runner, clip: Path) -> None:
    code, out, err = run(clip, *SMALL)
    assert (code, out) == (0, "")
    folder = Path("sway-face")
    assert names(folder) == ["annotated.mp4", "run.json", "trajectory.csv", "trajectory.json"]
    table = file_rows(folder / "trajectory.csv")
    assert [row.frame for row in table] == [i for i in range(30) for _ in range(ROWS)]
    assert {row.status for row in table[:ROWS]} == {"init"}
    assert count(folder / "annotated.mp4") == 30
    data = json.loads((folder / "trajectory.json").read_text())
    assert (data["complete"], data["frames_tracked"], data["variable_fps"]) == (True, 30, False)
    assert (data["recipe"]["name"], data["recipe"]["filter"]["particles"]) == ("face", 20)
    assert data["source"] == {"path": str(clip), "size": [128, 96], "fps": 25.0}
    assert data["init"]["targets"]["face"]["points"]["nose"] == [60, 40]
    assert data["frames"][0]["targets"][0]["particles"] == 20
    # on a busy machine compiling takes so long that progress is told
    line, verdict, next_ = [one for one in err.splitlines() if " of about " not in one]
    assert "begins in frame 0 (0:00.00), by" in verdict
    assert next_ == "look: facetrack report sway-face; correct: facetrack fix sway-face"
    assert "annotated.mp4, trajectory.csv, trajectory.json" in line
    assert "30 frames; " in line
    assert " frames/s" in line


def test_format_and_no_video(run: Runner, clip: Path) -> None:
    assert run(clip, *SMALL, "--no-video", "--format", "jsonl", "-o", "deep/er")[0] == 0
    assert names(Path("deep/er")) == ["run.json", "trajectory.jsonl"]


def test_the_stream_is_the_file(run: Runner, clip: Path) -> None:
    code, out, _ = run(clip, *SMALL, "-o", "-")
    assert code == 0
    assert names(Path()) == []
    run(clip, *SMALL, "-o", "dir", "--format", "csv,jsonl")
    assert out == Path("dir/trajectory.csv").read_text()
    code, out, _ = run(clip, *SMALL, "-o", "-", "--format", "jsonl")
    assert out == Path("dir/trajectory.jsonl").read_text()


def test_start_stop_and_init_frame(run: Runner, clip: Path) -> None:
    code, out, _ = run(clip, *SMALL, "-o", "-", "--init-frame", 7, "--start", 5, "--stop", 12)
    assert code == 0
    frames = [int(line.split(",")[0]) for line in out.splitlines()[1:]]
    assert sorted(set(frames)) == list(range(7, 12))


def test_seed_is_the_recipes_seed(run: Runner, clip: Path) -> None:
    first = run(clip, *SMALL, "-o", "-", "--seed", 5)[1]
    assert first == run(clip, *SMALL, "-o", "-", "--set", "seed=5")[1]
    assert first != run(clip, *SMALL, "-o", "-")[1]


def test_the_same_bytes_with_one_thread_and_two_and_from_pictures(run: Runner, clip: Path) -> None:
    code, one, _ = run(clip, *SMALL, "-o", "-", "--threads", 1)
    assert code == 0
    assert run(clip, *SMALL, "-o", "-", "--threads", 2)[1] == one
    run(clip, *SMALL, "-o", "files1", "--threads", 1)
    run(clip, *SMALL, "-o", "files2", "--threads", 2)
    assert Path("files1/trajectory.csv").read_text() == one
    assert Path("files1/trajectory.json").read_bytes() == Path("files2/trajectory.json").read_bytes()
    assert count(Path("files1/annotated.mp4")) == count(Path("files2/annotated.mp4")) == 30

    Path("pictures").mkdir()
    with open_source(clip) as source:
        for frame in source:
            assert cv2.imwrite(f"pictures/{frame.index + 1}.png", frame.bgr)  # 2.png comes before 10.png
    Path("pictures.init.yaml").write_text(INIT)
    images = run("pictures", *SMALL, "-o", "-", "--fps", 25)[1]
    assert run("pictures/*.png", *SMALL, "--init", "pictures.init.yaml", "-o", "-", "--fps", "25")[1] == images
    shutil.make_archive("pictures", "zip", "pictures")
    assert run("pictures.zip", *SMALL, "-o", "-", "--fps", "50/2")[1] == images
    # grey is the decoder's luma; of images it is computed from rounded colours
    rows = [list(csv.DictReader(text.splitlines())) for text in (one, images)]
    for ours, other in zip(*rows, strict=True):
        assert [float(ours[key]) for key in "xy"] == pytest.approx([float(other[key]) for key in "xy"], abs=3.0)
    assert run("pictures", *SMALL, "--fps", 12.5)[0] == 0
    assert file_rows(Path("pictures-face/trajectory.csv"))[-1].time_s == pytest.approx(29 / 12.5)
    assert count(Path("pictures-face/annotated.mp4")) == 30


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere names are text")
def test_a_name_that_is_no_text(clip: Path, tmp_path: Path) -> None:
    folder = os.fsdecode(b"caf\xe9\n")
    (tmp_path / folder).mkdir()
    with open_source(clip, stop=3) as source:
        for frame in source:
            cv2.imwrite(str(tmp_path / f"{frame.index}.png"), frame.bgr)
            (tmp_path / f"{frame.index}.png").rename(tmp_path / folder / f"{frame.index}.png")
    init = clip.with_suffix(".init.yaml")
    done = subprocess.run([*FACETRACK, "run", folder, *SMALL, "--init", init], cwd=tmp_path, capture_output=True)
    assert done.returncode == 0, done.stderr
    assert len(done.stderr.splitlines()) == 3  # summary, verdict, next step
    data = json.loads((tmp_path / f"{folder}-face" / "trajectory.json").read_bytes())
    assert data["source"]["path"] == folder
    (tmp_path / "a.mp4").symlink_to(tmp_path / f"{folder}-face" / "annotated.mp4")
    assert count(tmp_path / "a.mp4") == 3

    (tmp_path / f"{folder}.mp4").symlink_to(clip)
    done = subprocess.run(
        [*FACETRACK, "run", f"{folder}.mp4", "--init", init, "-o", "x"], cwd=tmp_path, capture_output=True
    )
    assert done.returncode == 3
    assert b"no UTF-8 text; rename the file" in done.stderr


# --- where the track starts ---


def test_a_face_is_found_where_no_init_file_lies(run: Runner) -> None:
    Path("clip.mp4").symlink_to(SAMPLE)
    code, _, _ = run("clip.mp4", *SMALL, "--stop", 4, "--no-video")
    assert code == 0
    data = json.loads(Path("clip-face/trajectory.json").read_text())
    assert data["init"]["from"] in ("haar", "yunet")  # what is installed
    nose = data["init"]["targets"]["face"]["points"]["nose"]
    truth = next(r for r in file_rows(SAMPLE.with_suffix(".truth.csv")) if r.frame == 0 and r.part == "nose")
    assert truth.x is not None
    assert truth.y is not None
    assert np.hypot(nose[0] - truth.x, nose[1] - truth.y) < 15


def test_haar_can_be_asked_for_beside_an_init_file(run: Runner) -> None:
    assert run(SAMPLE, *SMALL, "--stop", 2, "--no-video")[0] == 0
    data = json.loads(Path("expressions-face/trajectory.json").read_text())
    assert data["init"]["from"].endswith("expressions.init.yaml")
    assert run(SAMPLE, *SMALL, "--start", 9, "--stop", 12, "--no-video", "--init", "haar", "-o", "x")[0] == 0
    data = json.loads(Path("x/trajectory.json").read_text())
    assert (data["init"]["from"], data["init"]["frame"]) == ("haar", 9)


def test_a_box_is_enough(run: Runner) -> None:
    within = ["--box", "110,93,99,99", "--init-frame", 3, "--stop", 6, "-o", "-"]
    code, out, _ = run(SAMPLE, *SMALL, "--config", "factorized", *within)
    assert code == 0
    assert [line.split(",")[0] for line in out.splitlines()[1::5]] == ["3", "4", "5"]
    code, out, _ = run(SAMPLE, *within)
    rows = [line.split(",") for line in out.splitlines()[1:]]
    assert code == 0 and [(row[0], row[3]) for row in rows] == [("3", "box"), ("4", "box"), ("5", "box")]


def test_an_init_file_with_a_box_alone_is_enough(run: Runner) -> None:
    Path("box.yaml").write_text("frame: 2\nbox: [110, 93, 99, 99]\n")
    code, out, _ = run(SAMPLE, *SMALL, "--init", "box.yaml", "--stop", 4, "-o", "-")
    assert code == 0
    assert len(out.splitlines()) == 1 + 2 * ROWS


# --- what is refused ---


@pytest.mark.parametrize(
    ("args", "code", "message"),
    [
        (["--box", "1,2,3"], 2, "four numbers"),
        (["--box", "1,2,0,4"], 2, "width and height above 0"),
        (["--box", "1,2,nan,4"], 2, "width and height above 0"),
        (["--box", "1,2,3,4", "--init", "x"], 2, "--init and --box"),
        (["--format", "xml"], 2, "choose among csv, json, jsonl"),
        (["--format", ","], 2, "choose among"),
        (["--fps", "0"], 2, "frames per second"),
        (["--fps", "1/0"], 2, "frames per second"),
        (["--fps", "25"], 2, "for image folders"),
        (["--start", "9", "--stop", "9"], 2, "leaves no frame"),
        (["--start", "-1"], 2, "--start"),
        (["--seed", "-1"], 2, "seed -1 is no whole number from 0"),
        (["-j", "0"], 2, "--jobs"),
        (["--threads", "0"], 2, "--threads"),
        (["--config", "none"], 2, "neither a file nor a shipped recipe"),
        (["--set", "filter.particles=0"], 2, "particles"),
        (["-o", "-", "--format", "csv,json"], 2, "one format"),
        (["-o", ""], 2, "--out is empty"),
        (["--init", "none.yaml"], 3, "none.yaml: no such init file"),
        (["--start", "3"], 3, "begins at frame 0, but frames from 3 on were asked for"),
        (["--init-frame", "4", "--stop", "4"], 3, "begins at frame 4, but frames 0 to 3 were asked for"),
        (["--init-frame", "30"], 3, "frame 30 is past the end, the clip has 30 frames"),
        (["--init", "haar", "--start", "99"], 3, "frame 99 is past the end"),
        (["--init", "haar"], 3, "no face found in frames 0 to 29"),
        (["--box", "500,500,10,10"], 3, "outside the frame of 128x96"),
        (["--box", "500,500,10,10", "--config", "factorized"], 3, "not in the frame"),
        (["--config", "independent", "--init", "outside.yaml"], 3, "outside the frame of 128x96"),
    ],
)
def test_what_cannot_be_meant_is_one_line(run: Runner, clip: Path, args: list[str], code: int, message: str) -> None:
    Path("outside.yaml").write_text(INIT.replace("[60, 40]", "[600, 40]"))
    before = names(Path())
    got, out, err = run(clip, *args)
    assert (got, out) == (code, "")
    assert message in (err.splitlines()[0] if code == 2 else one_line(err))
    assert names(Path()) == before


@pytest.mark.parametrize("what", ["missing.mp4", "text.mp4", "empty.mp4", "nothing"])
def test_an_input_that_is_no_clip_leaves_nothing_behind(run: Runner, what: str) -> None:
    Path("text.mp4").write_text("not a video")
    Path("empty.mp4").touch()
    Path("nothing").mkdir()
    before = names(Path())
    code, _, err = run(what)
    assert code == 3
    assert what in one_line(err)
    assert names(Path()) == before


def test_results_that_are_there_are_not_touched(run: Runner, clip: Path) -> None:
    folder = Path("sway-face")
    folder.mkdir()
    (folder / "trajectory.json").write_text("mine")
    code, _, err = run(clip, *SMALL)
    assert code == 2
    assert "sway-face/trajectory.json: exists already; replace it with --overwrite" in one_line(err)
    assert names(folder) == ["trajectory.json"]
    assert (folder / "trajectory.json").read_text() == "mine"
    assert run(clip, *SMALL, "--format", "csv", "--no-video")[0] == 2, "they would stand beside what is no part of them"
    assert run(clip, *SMALL, "--overwrite")[0] == 0
    assert names(folder) == ["annotated.mp4", "run.json", "trajectory.csv", "trajectory.json"]
    assert json.loads((folder / "trajectory.json").read_text())["complete"]
    # what was made from it, or corrected in it, stays and is named
    mine = {"report.html", "trajectory.wide.csv", "corrected.init.yaml", "unsaved.init.yaml", "notes.txt"}
    for name in mine:
        (folder / name).write_text(INIT)
    begun = ["--init", folder / "corrected.init.yaml"]
    code, _, err = run(clip, *SMALL, "--overwrite", "--no-video", *begun)
    assert code == 0 and {*names(folder)} == {*mine, "run.json", "trajectory.csv", "trajectory.json"}
    assert "older than the track: report.html, trajectory.wide.csv; make anew: facetrack report sway-face --over" in err
    assert "unsaved.init.yaml: corrections of the track before, kept" in err
    assert "corrected.init.yaml: corrections" not in err, "the run begins with them"
    assert "older" not in run(clip, *SMALL, "--no-video", *begun)[2], "nothing is replaced"


def test_old_results_stay_until_the_new_ones_are_whole(run: Runner) -> None:
    folder = Path("bad-face")
    folder.mkdir()
    (folder / "trajectory.csv").write_text("mine")
    Path("bad.mp4").write_text("no video")
    assert run("bad.mp4", "--overwrite")[0] == 3
    assert names(folder) == ["trajectory.csv"]
    assert (folder / "trajectory.csv").read_text() == "mine"


def test_the_input_is_never_the_output(run: Runner, clip: Path) -> None:
    Path("annotated.mp4").write_bytes(clip.read_bytes())
    code, _, err = run("annotated.mp4", "-o", ".", "--overwrite", "--init", clip.with_suffix(".init.yaml"))
    assert code == 2
    assert "is read here, and would be replaced" in one_line(err)
    assert Path("annotated.mp4").read_bytes() == clip.read_bytes()
    Path("pictures").mkdir()
    code, _, err = run("pictures", "-o", "pictures")
    assert code == 2
    assert "among the frames of the input" in one_line(err)


def test_a_file_in_the_way_of_the_folder(run: Runner, clip: Path) -> None:
    Path("taken").touch()
    code, _, err = run(clip, "-o", "taken")
    assert code == 2
    assert "taken: is a file" in one_line(err)
    code, _, err = run(clip, "-o", "taken/below")
    assert code == 2
    assert "taken/below: cannot be written: Not a directory" in one_line(err)


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_must_not_be_written(run: Runner, clip: Path) -> None:
    Path("locked").mkdir(mode=0o500)
    code, _, err = run(clip, "-o", "locked")
    assert code == 2
    assert "Permission denied" in one_line(err)


def test_a_folder_that_is_marked_read_only(run: Runner, clip: Path) -> None:
    """Its bits say nothing to root, and on some network shares; where they hold, the test above."""
    Path("marked").mkdir(mode=0o555)
    code, _, err = run(clip, "-o", "marked")
    assert code == 0 if os.access("marked", os.W_OK) else (code == 2 and "Permission denied" in one_line(err))


# --- what goes wrong on the way ---


def test_a_full_disk_keeps_what_was_tracked(run: Runner, clip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = FileSink._write

    def full(self: FileSink, data: bytes) -> None:
        room = 5000 - self._written
        write(self, data if self.path.suffix != ".csv" else data[: max(room, 0)])
        if self.path.suffix == ".csv" and len(data) > room:
            self._full = True
            raise cannot_write(self.path, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))

    monkeypatch.setattr(FileSink, "_write", full)
    code, _, err = run(clip, *SMALL)
    assert code == 2
    lines = err.splitlines()
    assert "incomplete" in lines[0]
    assert "trajectory.csv: the disk is full" in lines[1]
    folder = Path("sway-face")
    assert names(folder) == ["annotated.mp4", "run.json", "trajectory.csv", "trajectory.json"]
    kept = file_rows(folder / "trajectory.csv")
    assert [row.frame for row in kept] == [i for i in range(len(kept) // ROWS) for _ in range(ROWS)]
    assert 0 < len(kept) < 150


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_standard_output_on_a_full_disk(clip: Path) -> None:
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run([*FACETRACK, "run", clip, *SMALL, "-o", "-"], stdout=full, stderr=subprocess.PIPE)
    assert done.returncode == 2
    assert "standard output: the disk is full" in one_line(done.stderr.decode())


def test_a_reader_that_leaves_ends_the_run_quietly(long_clip: Path) -> None:
    with subprocess.Popen(
        [*FACETRACK, "run", long_clip, *SMALL, "-o", "-"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline().startswith(b"frame,time_s,")
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(30) == 141


def test_a_cut_clip_gives_its_rows_a_warning_and_0(run: Runner, clip: Path) -> None:
    Path("pictures").mkdir()
    Path("pictures.init.yaml").write_text(INIT)
    with open_source(clip) as source:
        for frame in source:
            cv2.imwrite(f"pictures/{frame.index}.png", frame.bgr)
    whole = Path("pictures/20.png").read_bytes()
    Path("pictures/20.png").write_bytes(whole[: len(whole) // 2])
    code, _, err = run("pictures", *SMALL)
    assert code == 0
    warning, summary, _, _ = err.splitlines()
    assert warning.startswith("facetrack: warning: ")
    assert "20.png" in warning
    assert "20 frames" in summary
    assert "incomplete" in summary
    folder = Path("pictures-face")
    data = json.loads((folder / "trajectory.json").read_text())
    assert (data["complete"], data["frames_tracked"]) == (False, 20)
    assert "stopped" not in data
    assert "20.png" in data["warnings"][0]
    assert count(folder / "annotated.mp4") == 20
    Path("pictures/0.png").write_bytes(b"")
    code, _, err = run("pictures", "-o", "again")
    assert code == 3
    assert "0.png" in one_line(err)
    assert not Path("again").exists()


def test_a_fault_of_ours_keeps_what_was_tracked(run: Runner, clip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from facetrack_cli.video.overlay.overlay import Overlay

    draw = Overlay.draw

    def failing(self: Overlay, result: object) -> object:
        if result.frame.index == 10:  # type: ignore[attr-defined]
            raise ZeroDivisionError("a bug")
        return draw(self, result)  # type: ignore[arg-type]

    monkeypatch.setattr(Overlay, "draw", failing)
    code, _, err = run(clip, *SMALL)
    assert code == 1
    assert "internal error" in err.splitlines()[-1]
    assert "Traceback" not in err
    assert count(Path("sway-face/annotated.mp4")) == 10
    data = json.loads(Path("sway-face/trajectory.json").read_text())
    assert (data["complete"], data["stopped"]) == (False, "a bug")


def test_a_part_that_is_lost_at_the_end(run: Runner, tmp_path: Path) -> None:
    path = tmp_path / "covered.mp4"
    still = texture()
    with VideoWriter(path, (128, 96), Fraction(25)) as video:
        for i in range(20):
            frame = still.copy()
            if i > 8:
                frame[50:] = 255 - frame[50:]
            video.write(frame, i / 25)
    path.with_suffix(".init.yaml").write_text(INIT)
    assert run(path, "--no-video")[0] == 0
    code, _, err = run(path, "--no-video", "--fail-on-lost", "--overwrite")
    assert code == 4
    assert "lost: " in err.splitlines()[0] and "; look at frames " in err.splitlines()[1]
    assert json.loads(Path("covered-face/trajectory.json").read_text())["lost_frames"]
    assert run(path, "--no-video", "--fail-on-lost", "-o", "early", "--stop", 8)[0] == 0


# --- several clips ---


def test_folder_names_are_told_apart_by_where_the_clips_lie(tmp_path: Path) -> None:
    def named(*clips: str) -> list[str]:
        return folders([tmp_path / clip for clip in clips], "r")

    assert named("a/clip.mp4", "a/other.mp4") == ["clip-r", "other-r"]
    assert named("a/clip.mp4", "b/clip.mp4", "b/x.mp4") == ["a-clip-r", "b-clip-r", "x-r"]
    assert named("a/s/clip.mp4", "b/s/clip.mp4") == ["a-s-clip-r", "b-s-clip-r"]
    assert named("a/clip.mp4", "a/clip.avi") == ["a-clip-mp4-r", "a-clip-avi-r"]
    assert named("a/Clip.mp4", "b/clip.mp4") == ["a-Clip-r", "b-clip-r"]
    both = named("a-clip.mp4", "a/clip.mp4", "b/clip.mp4")
    assert len(set(both)) == 3
    assert both == named("a-clip.mp4", "a/clip.mp4", "b/clip.mp4")


def test_runs_of_other_settings_have_folders_of_their_own(run: Runner, clip: Path) -> None:
    assert variant_name("face", ()) == "face"
    assert variant_name("face", ("filter.particles=500", "head=null")) == "face-filter.particles=500,head=null"
    assert variant_name("a", ("likelihood.windows={a: ../b}",)) == "a-likelihood.windows=-a--..-b-"
    long = [variant_name("a", (f"likelihood.something={'x' * 60}{k}",)) for k in range(2)]
    assert long[0] != long[1] and all(re.fullmatch(r"a-set-[0-9a-f]{8}", name) for name in long)
    for n in (20, 21):
        assert run(clip, "--set", f"filter.particles={n}", "--no-video", "--stop", "3")[0] == 0
        data = json.loads(Path(f"sway-face-filter.particles={n}/trajectory.json").read_text())
        assert data["recipe"]["filter"]["particles"] == n


@pytest.mark.parametrize("workers", [1, 2])
def test_a_batch_goes_on_past_a_bad_clip(run: Runner, clip: Path, tmp_path: Path, workers: int) -> None:
    other = make_clip(tmp_path / "other.mp4", 10)
    Path("bad.mp4").write_text("no video")
    code, out, err = run(clip, "bad.mp4", other, other, *SMALL, "-j", workers, "-o", "all")
    assert (code, out) == (5, "")
    assert [name for name in names(Path("all")) if not name.endswith(".json")] == [
        "bad-face", "other-face", "sway-face"
    ]  # fmt: skip
    assert names(Path("all/bad-face")) == ["run.json"]
    assert count(Path("all/sway-face/annotated.mp4")) == 30
    assert len(file_rows(Path("all/other-face/trajectory.csv"))) == 10 * ROWS
    lines = err.splitlines()
    assert sum("facetrack: error: bad.mp4: not a video" in line for line in lines) == 1
    assert lines[-1] == "1 of 3 inputs failed"
    assert len(lines) == 4


def test_the_same_command_goes_on_with_what_is_missing(run: Runner, clip: Path, tmp_path: Path) -> None:
    other, old = make_clip(tmp_path / "other.mp4", 10), make_clip(tmp_path / "old.mp4", 10)
    Path("old-face").mkdir()
    Path("old-face/trajectory.csv").write_text("mine")
    assert run(clip, *SMALL)[0] == 0
    before = Path("sway-face/trajectory.csv").stat().st_mtime_ns
    code, _, err = run(clip, other, old, *SMALL, "-q")
    assert code == 5
    assert "old-face/trajectory.csv: exists already" in one_line(err)
    assert Path("sway-face/trajectory.csv").stat().st_mtime_ns == before
    assert Path("other-face/trajectory.csv").exists()
    code, _, err = run(clip, other, *SMALL)
    assert code == 0 and err.count("done before") == 2


def test_what_was_done_otherwise_is_refused(run: Runner, tmp_path: Path) -> None:
    clip = make_clip(tmp_path / "sway.mp4", 10)
    assert run(clip, *SMALL)[0] == 0
    clip.touch()
    assert "done before" in run(clip, *SMALL)[2], "the same bytes, although its time is another"
    for change in (
        ["--seed", "9"],
        ["--stop", "5"],
        ["--no-video"],
        ["--set", "confidence.patience=4", "-o", "sway-face"],
    ):
        assert "exists already" in one_line(run(clip, *SMALL, *change)[2])
    clip.write_bytes(make_clip(tmp_path / "another.mp4", 11).read_bytes())
    assert "exists already" in one_line(run(clip, *SMALL)[2])
    assert run(clip, *SMALL, "--overwrite")[0] == 0


def test_a_batch_does_not_stream(run: Runner, clip: Path) -> None:
    code, _, err = run(clip, "other.mp4", "-o", "-")
    assert code == 2
    assert "streams one clip" in one_line(err)


def test_processes_that_cannot_be_started(run: Runner, clip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> None:
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    monkeypatch.setattr("facetrack_cli.runs.workers.worker_context", refuse)
    code, _, err = run(clip, SAMPLE, "-j", "2")
    assert code == ExitCode.FAULT
    assert one_line(err).endswith("processes for -j cannot be started ([Errno 32] Broken pipe); run without -j")


@pytest.mark.skipif(os.name != "posix", reason="needs find and xargs")
def test_find_and_xargs(run: Runner, tmp_path: Path) -> None:
    tree = tmp_path / "a tree" / "it's"
    tree.mkdir(parents=True)
    make_clip(tree / "one clip.mp4", 5)
    make_clip(tree.parent / "two\nlines.mp4", 5)
    command = f"find '{tmp_path / 'a tree'}' -name '*.mp4' -print0 | xargs -0 \"$@\""
    words = [*FACETRACK, "run", *SMALL, "--no-video", "-j", "2"]
    done = subprocess.run(["sh", "-c", command, "sh", *words], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert names(Path()) == ["one clip-face", "two\nlines-face"]


# --- signals ---


def interrupted(args: list[object], ready: Callable[[], bool], *signals: int, group: bool = False) -> tuple[int, str]:
    """Start the command, send the signals once it is `ready`; exit code and stderr."""
    process = subprocess.Popen(
        [*FACETRACK, "run", *map(str, args)], stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        deadline = time.monotonic() + 60
        while not ready():
            assert process.poll() is None, process.stderr.read() if process.stderr else ""
            assert time.monotonic() < deadline
            time.sleep(0.02)
        for number in signals:
            with contextlib.suppress(ProcessLookupError):  # it has ended
                os.killpg(process.pid, number) if group else process.send_signal(number)
            time.sleep(0.1)  # of two that wait at once, Python handles the lower number first
        _, err = process.communicate(timeout=60)
        return process.returncode, err
    finally:
        process.kill()


def growing(folder: Path, pattern: str = ".annotated*.mp4") -> Callable[[], bool]:
    """Whether the encoder has written something already: then frames are being tracked."""
    return lambda: any(path.stat().st_size > 0 for path in folder.glob(pattern))


def check_interrupted(folder: Path, all_frames: int, reason: str) -> None:
    assert names(folder) == ["annotated.mp4", "run.json", "trajectory.csv", "trajectory.json"]
    data = json.loads((folder / "trajectory.json").read_text())
    done = data["frames_tracked"]
    assert 0 < done < all_frames
    assert (data["complete"], data["stopped"], len(data["frames"])) == (False, reason, done)
    assert len(file_rows(folder / "trajectory.csv")) == ROWS * done
    assert count(folder / "annotated.mp4") == done


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize(
    ("signals", "group", "code", "reason"),
    [
        pytest.param([signal.SIGINT], True, 130, "interrupted", marks=pytest.mark.nightly),
        ([signal.SIGINT, signal.SIGINT, signal.SIGINT], True, 130, "interrupted"),
        pytest.param([signal.SIGTERM], False, 143, "terminated", marks=pytest.mark.nightly),
        ([signal.SIGTERM, signal.SIGINT], False, 143, "terminated"),
    ],
    ids=["ctrl-c", "three times ctrl-c", "sigterm", "sigterm, then ctrl-c"],
)
def test_a_signal_closes_the_files(
    long_clip: Path, tmp_path: Path, signals: list[int], group: bool, code: int, reason: str
) -> None:
    out = tmp_path / "out"
    got, err = interrupted([long_clip, *SMALL, "-o", out], growing(out), *signals, group=group)
    assert got == code, err
    assert reason in one_line(err)
    check_interrupted(out, 1500, reason)


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.nightly)]
)
def test_a_signal_ends_a_batch_cleanly(long_clip: Path, tmp_path: Path, number: int, code: int) -> None:
    for name in ("a.mp4", "b.mp4", "c.mp4"):
        (tmp_path / name).symlink_to(long_clip)
        (tmp_path / name).with_suffix(".init.yaml").write_text(INIT)
    out = tmp_path / "out"
    clips = [tmp_path / name for name in ("a.mp4", "b.mp4", "c.mp4")]
    both = (growing(out / "a-face"), growing(out / "b-face"))
    group = number == signal.SIGINT
    got, err = interrupted(
        [*clips, *SMALL, "-j", "2", "-o", out], lambda: all(ready() for ready in both), number, group=group
    )
    assert got == code, err
    assert "Traceback" not in err
    for name in ("a-face", "b-face"):
        check_interrupted(out / name, 1500, "interrupted" if number == signal.SIGINT else "terminated")
    assert not (out / "c-face").exists()


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_signal_while_looking_for_a_face(long_clip: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    got, err = interrupted([long_clip, "--init", "haar", "-o", out], lambda: out.exists(), signal.SIGINT, group=True)
    assert got == 130
    assert "nothing was written" in one_line(err)
    assert not out.exists()


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_signals_leave_a_note_and_are_given_back() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with Stop().listening() as stop:
        assert not stop()
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)
        assert stop()
        assert (stop.code, stop.reason) == (ExitCode.TERMINATED, "terminated")
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_that_python_drops_before_anything_listens_is_not_lost(
    number: signal.Signals, code: int, capfd: pytest.CaptureFixture[str]
) -> None:
    class Struck:
        def __del__(self) -> None:
            signal.raise_signal(number)

    with raising():
        struck = Struck()
        del struck
        with Stop().listening() as stop:
            assert stop()
            assert stop.code == code
    assert capfd.readouterr() == ("", "")
    with raising(), pytest.raises((KeyboardInterrupt, TerminatedError)):
        signal.raise_signal(number)
    with raising(), Stop().listening() as stop:
        assert not stop()


def test_a_signal_that_is_ignored_stays_ignored() -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with Stop().listening() as stop:
            signal.raise_signal(signal.SIGINT)
            assert not stop()
    finally:
        signal.signal(signal.SIGINT, before)


# --- how far it is ---


def test_plain_lines_now_and_then(
    clip: Path, run: Runner, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("facetrack_cli.runs.progress.EVERY_S", 0.0)
    lines = run(clip, *SMALL, "--no-video")[2].splitlines()
    assert len(lines) == 33
    assert lines[9].startswith("sway.mp4: 10 of about 30 frames, ")
    assert lines[9].endswith(" frames/s")


@pytest.mark.skipif(os.name != "posix", reason="needs a pseudo-terminal")
def test_a_bar_on_a_terminal(clip: Path, tmp_path: Path) -> None:
    import pty

    ours, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "120"}
    process = subprocess.Popen(
        [*FACETRACK, "run", clip, *SMALL, "-o", tmp_path / "out"], stderr=theirs, env=environment
    )
    os.close(theirs)
    text = read_all(ours)
    assert process.wait(30) == 0
    assert "frames/s" in text
    assert "━" in text
    assert "30 frames; " in text.splitlines()[-3]


# --- found by hand, held here ---


@pytest.mark.parametrize(
    ("args", "code", "message"),
    [
        (["--set", "filter.particles=10000", "--config", "factorized_transition"], 2, "2,000 at most, not 10,000"),
        (["--set", "target.windows=1000px"], 2, "larger than the frame of 128x96; make it smaller"),
        (["--set", "target.windows=1e299px"], 2, "no more than a million"),
        (["--set", "motion.sigma=1e299px"], 2, "no more than a million"),
        (["--set", "prior.freedom=0"], 2, "prior.freedom must be greater than 0, not 0"),
        (
            ["--config", "sir", "--set", "prior={type: parzen, file: mouth_prior.npz, sigma: 0.001}"],
            2,
            "prior.sigma must be at least 0.005, not 0.001",
        ),
        (
            ["--set", "target.parts=[nose, mouth_left]", "--set", "likelihood.shift=[0, 0]"],
            2,
            "the recipe does not track mouth_right",
        ),
        (["--seed", str(2**63)], 2, "is no whole number from 0 to 9223372036854775807"),
        (["--start", "x"], 2, "'x' is not a valid whole number"),
        (["--init", ""], 2, "--init is empty"),
        (["--config", ""], 2, '"" is neither a file nor a shipped recipe'),
        (["-o", "o" * 300], 2, "cannot be written: File name too long"),
        (["--box", "60,-400000,2,800000"], 3, "smaller than 6x6 pixels"),
        (["--box", "-400000,-400000,800000,800000"], 3, "larger than the frame of 128x96"),
        (["--box", "60,-400000,2,800000", "--config", "sir"], 3, "far larger than the frame of 128x96 pixels"),
        (["--init-frame", "500"], 3, "(frame 500 is where --init-frame begins)"),
    ],
)
def test_what_cannot_work_is_refused_at_once(run: Runner, clip: Path, args: list[str], code: int, message: str) -> None:
    began = time.monotonic()
    got, out, err = run(clip, "--no-video", *args)
    assert (got, out) == (code, "")
    assert message in err.splitlines()[0]
    assert "internal error" not in err and "Traceback" not in err
    assert names(Path()) == []
    assert time.monotonic() - began < 20


def test_points_in_one_place_name_the_init_file(run: Runner, clip: Path) -> None:
    Path("one.yaml").write_text(INIT.replace("[48, 62]", "[60, 40]").replace("[72, 62]", "[60, 40]"))
    code, _, err = run(clip, "--init", "one.yaml")
    assert code == ExitCode.INPUT
    assert one_line(err).startswith("facetrack: error: one.yaml: mouth_left and mouth_right are at the same place")


@pytest.mark.parametrize("name", ["trajectory.csv", "annotated.mp4"])
def test_a_folder_in_the_way_of_a_file(run: Runner, clip: Path, name: str) -> None:
    Path("o", name).mkdir(parents=True)
    code, _, err = run(clip, "-o", "o", "--overwrite")
    assert code == ExitCode.USAGE
    assert f"{name}: is a folder, where a file is to be" in one_line(err)
    assert names(Path("o")) == [name]


def test_the_init_file_and_the_recipe_are_never_the_output(run: Runner, clip: Path) -> None:
    start = Path("trajectory.json")
    start.write_text('{"frame": 0, "box": [30, 10, 60, 70]}')
    code, _, err = run(clip, "--init", start, "-o", ".", "--overwrite")
    assert code == ExitCode.USAGE and "is read here, and would be replaced" in one_line(err)
    recipe = Path("trajectory.csv")
    recipe.write_text((shipped_folder() / "sir.yaml").read_text())
    code, _, err = run(clip, "--config", recipe, "-o", ".", "--overwrite")
    assert code == ExitCode.USAGE and "is read here, and would be replaced" in one_line(err)
    assert "sigma" in recipe.read_text() and "box" in start.read_text()


def test_a_link_to_nowhere_is_a_result_that_is_there(run: Runner, clip: Path) -> None:
    Path("o").mkdir()
    Path("o/trajectory.csv").symlink_to("nowhere")
    code, _, err = run(clip, "-o", "o")
    assert code == ExitCode.USAGE and "exists already" in one_line(err)


@pytest.mark.parametrize("name", ["annotated.mp4", "trajectory.csv", "run.json", ".checkpoint", ".facetrack.lock"])
def test_what_is_replaced_in_a_folder_is_no_link(run: Runner, clip: Path, name: str) -> None:
    """Whoever shares a folder may have left a link in it to a file of the user's."""
    Path("mine").mkdir()
    mine = Path("mine/file")
    mine.write_text("mine")
    assert run(clip, *SMALL, "-o", "o")[0] == 0
    Path("o", name).unlink(missing_ok=True)
    Path("o", name).symlink_to("../mine" if name == ".checkpoint" else "../mine/file")
    code, _, err = run(clip, *SMALL, "--seed", "5", "-o", "o", "--overwrite")
    assert code in (ExitCode.USAGE, ExitCode.INPUT) and f"o/{name}: is " in one_line(err)
    assert mine.read_text() == "mine" and [*Path("mine").iterdir()] == [mine]


@pytest.mark.parametrize("words", [("report",), ("plot",), ("export", "--to", "mot")])
def test_what_is_made_beside_a_run_is_no_link(run: Runner, clip: Path, words: tuple[str, ...]) -> None:
    assert run(clip, *SMALL, "-o", "o")[0] == 0
    Path("mine").write_text("mine")
    for name in ("report.html", "plot.png", "trajectory.mot.txt", "trajectory.mot"):
        Path("o", name).symlink_to("../mine")
    assert main([words[0], "o", *words[1:], "--overwrite"]) in (0, 2)
    assert Path("mine").read_text() == "mine"


@pytest.mark.parametrize("threads", [1, 2])
def test_an_encoder_that_is_killed(run: Runner, clip: Path, monkeypatch: pytest.MonkeyPatch, threads: int) -> None:
    write = VideoWriter.write

    def killed(video: VideoWriter, image: Image, time_s: float) -> None:
        if time_s > 0.3:
            video._encoder.program.child.kill()
            video._encoder.program.child.wait()
        write(video, image, time_s)

    monkeypatch.setattr(VideoWriter, "write", killed)
    code, _, err = run(clip, *SMALL, "--threads", threads)
    summary, error = err.splitlines()
    assert code == ExitCode.USAGE
    assert "(trajectory.csv, trajectory.json): 30 frames" in summary and "incomplete" not in summary
    assert "annotated.mp4: the video cannot be written (ffmpeg was killed by signal 9); run it again" in error
    assert names(Path("sway-face")) == ["run.json", "trajectory.csv", "trajectory.json"]
    assert len(file_rows(Path("sway-face/trajectory.csv"))) == 30 * ROWS
    data = json.loads(Path("sway-face/trajectory.json").read_text())
    assert data["complete"] is True and "stopped" not in data
    assert ["annotated.mp4: the video cannot be written" in line for line in data["warnings"]] == [True]


def test_strict_makes_damage_an_error(run: Runner, clip: Path) -> None:
    data = bytearray(clip.read_bytes())
    for at in range(len(data) // 3, len(data) * 2 // 3, 97):
        data[at] ^= 0x5A
    Path("hurt.mp4").write_bytes(data)
    Path("hurt.init.yaml").write_text(INIT)
    code, _, err = run("hurt.mp4", *SMALL)
    warning, summary, _, _ = err.splitlines()
    assert code == 0 and "hurt.mp4: damaged: the decoder reports errors at about frame" in warning
    assert "incomplete" in summary
    before = json.loads(Path("hurt-face/trajectory.json").read_text())
    assert before["complete"] is False and before["frames_tracked"] == 30
    code, _, err = run("hurt.mp4", *SMALL, "--strict", "--overwrite")
    summary, error = err.splitlines()
    assert code == ExitCode.INPUT and error.startswith("facetrack: error: ") and "damaged" in error
    after = json.loads(Path("hurt-face/trajectory.json").read_text())
    assert (after["complete"], after["frames"]) == (False, before["frames"])
    assert run(clip, *SMALL, "--strict", "-o", "whole")[0] == 0


def test_a_lag_of_more_frames_than_memory_holds(run: Runner, clip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("facetrack_cli.runs.clip.MAX_LAG_BYTES", 128 * 96 * 3 * 5)
    code, _, err = run(clip, *SMALL, "--lag", 6)
    assert code == ExitCode.USAGE and "at most --lag 5 at 128x96" in one_line(err)
    assert not Path("sway-face").exists()
    assert run(clip, *SMALL, "--lag", 5)[0] == 0


@pytest.mark.skipif(os.name != "posix", reason="closes streams as a shell does")
@pytest.mark.parametrize(
    ("closed", "args", "code"),
    [
        (">&-", "-o -", 2),
        *(pytest.param(closed, "", 0, marks=pytest.mark.nightly) for closed in (">&-", "2>&-")),
        (">&- 2>&- <&-", "", 0),
    ],
)
def test_streams_that_the_shell_closed(clip: Path, tmp_path: Path, closed: str, args: str, code: int) -> None:
    command = f'"{sys.executable}" -m facetrack_cli run "{clip}" --no-video {" ".join(SMALL)} {args} {closed}'
    ended = subprocess.run(command, shell=True, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ended.returncode == code, ended.stderr
    assert "internal error" not in ended.stderr and "Traceback" not in ended.stderr
    if code:
        assert "standard output: cannot be written" in one_line(ended.stderr)
    else:
        assert names(tmp_path / "sway-face") == ["run.json", "trajectory.csv", "trajectory.json"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
def test_a_log_on_a_full_disk_does_not_stop_a_run(clip: Path, tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with Path("/dev/full").open("w") as full:
        command = [*FACETRACK, "run", str(clip), "--no-video", *SMALL]
        ended = subprocess.run(command, cwd=tmp_path, stderr=full, env=environment, check=False)
    assert ended.returncode == 0
    assert names(tmp_path / "sway-face") == ["run.json", "trajectory.csv", "trajectory.json"]


@pytest.mark.nightly
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_while_a_batch_starts(long_clip: Path, tmp_path: Path) -> None:
    clips = [tmp_path / name for name in ("a.mp4", "b.mp4")]
    for one in clips:
        one.symlink_to(long_clip)
    for delay in (0.2, 0.6, 1.0):
        began = time.monotonic()
        code, err = interrupted(
            [*clips, "--box", "40,20,40,60", "-j", "2", "-o", tmp_path / "out", "--overwrite"],
            lambda: time.monotonic() - began > delay,  # noqa: B023 -- called within the turn
            signal.SIGINT,
            group=True,
        )
        assert code in (130, -signal.SIGINT), err  # the latter before Python itself has started
        assert "Traceback" not in err


@pytest.mark.parametrize("large", [False, True])
@pytest.mark.parametrize("name", ["trajectory.csv", "trajectory.json", "annotated.mp4"])
def test_what_is_zeros_of_the_same_length_is_not_done(run: Runner, clip: Path, monkeypatch, name: str, large) -> None:
    """A file system may leave that after a power loss."""
    monkeypatch.setattr(manifest, "LARGE_BYTES", 0 if large else 1 << 26)
    assert run(clip, *SMALL, "-o", "o")[0] == 0
    assert bool(json.loads(Path("o/run.json").read_text())["samples"]) == large
    assert "done before" in run(clip, *SMALL, "-o", "o")[2]
    path = Path("o", name)
    path.write_bytes(bytes(path.stat().st_size))
    code, _, err = run(clip, *SMALL, "-o", "o")
    assert code == ExitCode.USAGE and "done before" not in err and "exists already" in one_line(err)
    assert run(clip, *SMALL, "-o", "o", "--overwrite")[0] == 0 and any(path.read_bytes())


@pytest.mark.parametrize("name", ["../x", "/etc/hostname", "a/b", "a\0b", "people/1.jpg"])
def test_a_run_that_names_files_elsewhere_is_not_done(run: Runner, clip: Path, name: str) -> None:
    assert run(clip, *SMALL, "-o", "o")[0] == 0
    told = json.loads(Path("o/run.json").read_text())
    told["files"][name] = {"bytes": 3, "sha256": "0" * 64}
    Path("o/run.json").write_text(json.dumps(told))
    code, _, err = run(clip, *SMALL, "-o", "o")
    assert code == ExitCode.USAGE and "exists already" in one_line(err)
