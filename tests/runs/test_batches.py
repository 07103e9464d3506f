"""Batches: what is done is not done again, what failed is told, and several at once share the clips."""

import io
import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from imageio_ffmpeg import get_ffmpeg_exe
from PIL import Image

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.run_folder import lease as locks
from facetrack_cli.run_folder.lease import FolderLease
from facetrack_cli.run_folder.manifest import read_manifest
from facetrack_cli.run_folder.status import MAX_ROWS, ClipStatus, worst
from facetrack_cli.runs.batch import expand
from facetrack_cli.runs.plan import Outcome
from facetrack_cli.video.source import brings_rate
from tests.support.leases import ELSEWHERE, leave
from tests.support.samples import FOLDER
from tests.support.sway import FACETRACK, SMALL, make_clip, until
from tests.test_docs import ROOT, blocks

posix = pytest.mark.skipif(os.name != "posix", reason="the lock needs POSIX")
OPTIONS = [*SMALL, "--no-video", "--format", "csv"]
BOTH = ("clips/c0.mp4", "clips/c1.mp4", "-o", "out")


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    """A folder of twelve clips that show the same."""
    folder = tmp_path_factory.mktemp("clips")
    first = make_clip(folder / "c0.mp4", 6)
    for i in range(1, 12):
        for suffix in (".mp4", ".init.yaml"):
            shutil.copy(first.with_suffix(suffix), folder / f"c{i}{suffix}")
    return folder


@pytest.fixture
def run(facetrack, clips):
    """Track clips of the folder `clips`, a copy, beside which results go; exit code and the lines on stderr."""
    shutil.copytree(clips, "clips")

    def call(*words):
        code, _, err = facetrack("run", *words, *OPTIONS)
        return code, err.splitlines()

    return call


@pytest.fixture
def status(facetrack):
    def call(folder):
        code, out, _ = facetrack("status", folder, "--json")
        assert code == 0
        return json.loads(out)

    return call


def tracked(folder=Path("out")):
    """When each folder of results was changed."""
    return {path.parent.name: path.stat().st_mtime_ns for path in folder.glob("*/trajectory.csv")}


@posix
@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.nightly)])
def test_two_at_once_share_the_clips_and_do_none_twice(run, workers):
    command = [*FACETRACK, "run", "clips", "-o", "out", "-j", str(workers), *OPTIONS]
    both = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    said = [process.communicate(timeout=120)[1] for process in both]
    assert [process.returncode for process in both] == [0, 0], said
    lines = [line for text in said for line in text.splitlines() if " -> " in line]
    assert sum("done before" not in line for line in lines) == 12, said
    assert all(sum(f"c{i}.mp4 -> " in line for line in text.splitlines()) == 1 for text in said for i in range(12))
    assert len(tracked()) == 12 and len(list(Path("out").glob("batch-*.json"))) == 1


@posix
def test_clips_of_another_machine_are_waited_for(run, monkeypatch):
    monkeypatch.setattr("facetrack_cli.runs.batch.LOOK_S", 0.05)
    monkeypatch.setattr(locks, "LEASE_S", 1.0)
    folder = Path("out/c0-face")
    folder.mkdir(parents=True)
    leave(folder, ELSEWHERE)
    code, lines = run(*BOTH)
    assert code == 0 and [line.partition(" -> ")[0] for line in lines] == [
        "clips/c1.mp4",
        "1 clip is being tracked by another facetrack; waiting for it",
        "facetrack: out/c0-face: whoever writes here is silent; waiting 1 s for it",
        "clips/c0.mp4",
    ]


def test_what_failed_is_told_and_tried_again_only_if_asked(run):
    Path("clips/c0.mp4").write_text("no video")
    known = Path("out/c0-face/run.json")
    assert run(*BOTH)[0] == 5
    failed = read_manifest(known.parent)
    assert failed.error.startswith("clips/c0.mp4: not a video that can be read; give another file")
    assert (failed.exit_code, failed.files, failed.frames) == (3, {}, 0)
    before = known.stat().st_mtime_ns
    code, lines = run(*BOTH)
    assert code == 5 and f"facetrack: error: {failed.error}" in lines and known.stat().st_mtime_ns == before
    assert lines[-1] == "1 of 2 inputs failed, 1 of them before; --retry-failed tries those again"
    assert run(*BOTH, "--retry-failed")[0] == 5 and known.stat().st_mtime_ns > before
    shutil.copy("clips/c1.mp4", "clips/c0.mp4")
    assert run(*BOTH)[0] == 0 and read_manifest(known.parent).error is None, "the clip has changed"
    Path("clips/c0.init.yaml").write_text("frame: 900\npoints: {nose: [1, 1]}")
    assert run(*BOTH[:2], "-o", "other")[0] == 5
    shutil.copy("clips/c1.init.yaml", "clips/c0.init.yaml")
    assert run(*BOTH[:2], "-o", "other")[0] == 0, "what is asked has changed"


def test_a_failure_leaves_other_results_alone(run):
    assert run("clips/c0.mp4", "-o", "out/c0-face", "--seed", 5)[0] == 0
    before = tracked()
    code, lines = run(*BOTH)
    assert code == 5 and any("c0-face/trajectory.csv: exists already" in line for line in lines)
    Path("clips/c0.mp4").write_text("no video")
    assert run(*BOTH)[0] == run(*BOTH, "--overwrite")[0] == 5
    assert read_manifest(Path("out/c0-face")).error is None and tracked()["c0-face"] == before["c0-face"]


def test_an_error_in_the_middle_is_a_failure_with_frames(run, monkeypatch):
    def counted(outcome, result):
        count(outcome, result)
        if outcome.frames == 3:
            raise RuntimeError("three")

    count = Outcome.count
    monkeypatch.setattr(Outcome, "count", counted)
    assert run(*BOTH)[0] == 5
    known = read_manifest(Path("out/c0-face"))
    assert "RuntimeError: three" in known.error and known.frames == 3 and known.exit_code == 1 and known.files


def test_shards_are_disjoint_and_complete(run):
    seen = set()
    assert run("@list", "--shard", "1/5", "-o", "out")[0] == 3, "the list is not there"
    Path("list").write_text("clips\n" + "clips/../clips/c3.mp4\n")
    for i in range(1, 6):
        assert run("@list", "--shard", f"{i}/5", "-o", "out")[0] == 0
        found = {*tracked()} - seen
        assert len(found) == (3 if i <= 2 else 2)
        seen |= found
    assert seen == {f"c{i}-face" for i in range(12)} and len(list(Path("out").glob("batch-*"))) == 1
    assert run("clips/c0.mp4", "--shard", "2/2", "-o", "out")[0] == 0, "there may be none"
    for path in Path("clips").glob("c[1-9]*"):
        path.unlink()
    assert run("clips", "-o", "one")[0] == 0 and [*tracked(Path("one"))] == ["c0-face"], "a folder is a batch"


def test_status_in_each_state(run, status, facetrack):
    Path("clips/c1.mp4").write_text("no video")
    for i in (2, 3, 4):
        Path(f"clips/c{i}.mp4").unlink()
    assert run(*(f"clips/c{i}.mp4" for i in range(5)), "-o", "out")[0] == 5
    for i in (2, 3, 4):
        shutil.rmtree(f"out/c{i}-face")
    Path("out/c2-face").mkdir()
    leave(Path("out/c2-face"), ELSEWHERE, silent_s=1e6)
    before = {path: path.stat().st_mtime_ns for path in Path("out").rglob("*")}
    with FolderLease(Path("out/c3-face")) as claim:
        claim.note({"clip": "clips/c3.mp4", "frame": 3, "frames": 6})
        found, text = status("out"), facetrack("status", "out")[1]
    assert found["schema"] == "facetrack-status" and found["version"] == 1
    assert found["counts"] == {"done": 1, "running": 1, "interrupted": 1, "failed": 1, "not begun": 1}
    assert [one["state"] for one in found["clips"]] == ["done", "failed", "interrupted", "running", "not begun"]
    done, _, _, running, _ = found["clips"]
    assert (running["frames"], running["of"], running["host"]) == (3, 6, locks.here()[0])
    assert done["frames"] == 6 and done["seconds"] > 0 and done["ended"] >= done["since"] > "2"
    assert found["work_s"] == pytest.approx(2.5 * done["seconds"], abs=0.1)
    assert "out: 5 clips" in text and "c1-face       0     –  failed: clips/c1.mp4: not a video" in text
    assert f"running: clips/c3.mp4: on {locks.here()[0]} since 2" in text and "3 of about 6 frames" in text
    assert "3 clips left: about 0:00:0" in text and ", 1 at a time" in text
    after = {path: path.stat().st_mtime_ns for path in Path("out").rglob("*") if "c3" not in str(path)}
    assert after.items() <= before.items() | {(Path("out"), Path("out").stat().st_mtime_ns)}, "nothing is written"
    assert "; nothing is running: give the command again" in facetrack("status", "out")[1]


def test_status_of_one_run_and_of_none(run, status, facetrack):
    assert run("clips/c0.mp4", "-o", "one", "-q")[0] == 0
    [found] = status("one")["clips"]
    assert (found["state"], found["folder"]) == ("done", ".")
    assert run(*BOTH[:2], "-q")[0] == 0, "in the working directory there is no file of the batch"
    assert [one["folder"] for one in status(".")["clips"]] == ["c0-face", "c1-face", "one"]
    for what in ("clips", "gone", "clips/c0.mp4"):
        code, _, err = facetrack("status", what)
        assert code == 3 and len(err.splitlines()) == 1
    Path("one/run.json").write_text("[]")
    assert status("one")["clips"][0]["state"] == "failed"
    Path("killed").mkdir()
    leave(Path("killed"), {**ELSEWHERE, "clip": "clips/c9.mp4"}, silent_s=1e6)
    [found] = status("killed")["clips"]
    assert (found["clip"], found["state"]) == ("clips/c9.mp4", "interrupted")


def test_the_table_has_the_clip_that_is_lost_most_first():
    often = ClipStatus("b.mp4", "b-face", "done", 10, lost=0.9, look="face nose is lost in 9")
    never, once = ClipStatus("a.mp4", "a-face", "done", 10, lost=0.0), replace(often, folder="c-face", lost=0.1)
    assert [*worst([never, once, often])] == [
        "clip    frames  lost  look at",
        "b-face      10   90%  face nose is lost in 9",
        "c-face      10   10%  face nose is lost in 9",
    ]
    assert [*worst([never])] == []
    for first in (replace(once, doubtful=True), replace(once, complete=False)):
        assert [*worst([often, first])][1].startswith("c-face")
    assert [*worst([often] * (MAX_ROWS + 3))][-1].startswith("and 3 more")


def test_a_batch_ends_with_the_clips_to_look_at(run, status):
    assert run(*BOTH, "-q")[0] == 0
    known = read_manifest(Path("out/c1-face"))
    said = replace(known, lost_frames={"face/nose": 5, "face/box": 2}, lost_at_end=("face/nose",))
    said = replace(said, look=((1, 4), (5, 5)), resumed=2, seconds=2.0)
    Path("out/c1-face/run.json").write_text(json.dumps(said.record()))
    found = {one["folder"]: one for one in status("out")["clips"]}
    assert found["c1-face"]["lost"] == round(5 / 6, 4) and found["c0-face"]["look"] == ""
    assert found["c1-face"]["still"] == 2 and found["c1-face"]["frames_per_s"] == 2.0, "of the frames since it went on"
    code, lines = run(*BOTH)
    assert code == 0 and lines[-1] == "c1-face       6   83%  face nose is lost in 5 and at the end, frames 1 to 4, 5"


@pytest.mark.skipif(os.name != "posix", reason="a kill needs POSIX")
@pytest.mark.parametrize(
    ("how", "moment"),
    [("-j", 1.0), ("--split", 5.0), *(pytest.param("-j", at, marks=pytest.mark.nightly) for at in (2.0, 4.0, 8.0))],
)
def test_a_batch_that_is_killed_leaves_no_process(tmp_path, how, moment):
    """Workers, and the server that forks them, end by themselves, whatever they were doing."""
    psutil = pytest.importorskip("psutil")
    sample, clip = FOLDER / "expressions.mp4", tmp_path / "long.mp4"
    again = [get_ffmpeg_exe(), "-v", "error", "-stream_loop", "9", "-i", str(sample), "-c", "copy", str(clip)]
    subprocess.run(again, check=True)
    words = [clip, FOLDER / "film.mp4"] if how == "-j" else [clip, "--split", "10s"]
    command = [*FACETRACK, "run", *map(str, words), "-j", "2", "-q", "-o", str(tmp_path / "out")]
    process = subprocess.Popen(command, cwd=tmp_path)
    time.sleep(moment)
    children = psutil.Process(process.pid).children(recursive=True)
    process.kill()
    process.wait()

    def gone():
        return not [one for one in children if one.is_running() and one.status() != psutil.STATUS_ZOMBIE]

    until(gone, seconds=20)  # once the server has its imports, which a busy machine takes long for


FILES = """
day1/b10.mp4 day1/b2.MP4 day1/notes.txt day1/.hidden.mp4 day1/cover.jpg day2/c.mkv faces/0.png faces/1.png
tree/x/1.jpg tree/y/a.mp4 tree/y/deep/z.mp4 tree/r/run.json tree/r/annotated.mp4 tree/empty/no.txt empty/no.txt
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in (*FILES.split(), "sub/day3/d [1].mp4"):
        touch(name)


def touch(name):
    Path(name).parent.mkdir(parents=True, exist_ok=True)
    Path(name).touch()


def expanded(*inputs):
    clips, several = expand([Path(one) for one in inputs])
    return [clip.as_posix() for clip in clips], several


@pytest.mark.parametrize(
    ("inputs", "clips", "several"),
    [
        (["day2/c.mkv"], ["day2/c.mkv"], False),
        (["faces"], ["faces"], False),
        (["faces/*.png"], ["faces/*.png"], False),
        (["day2/c.mkv", "./day2/c.mkv"], ["day2/c.mkv"], False),
        (["day2"], ["day2/c.mkv"], True),
        (["tree"], ["tree/x", "tree/y/a.mp4"], True),
        (["sub/day3/d [1].mp4"], ["sub/day3/d [1].mp4"], False),
        (["day1/*.mp4"], ["day1/b10.mp4"], True),
        (["day?/*.m*"], ["day1/b10.mp4", "day2/c.mkv"], True),
        (["tree/*"], ["tree/x", "tree/y/a.mp4"], True),
    ],
)
def test_inputs(here, inputs, clips, several):
    assert expanded(*inputs) == (clips, several)


def test_a_rate_is_of_images_alone(run):
    code, err = run("clips", "--fps", "50", "-o", "out")
    assert code == 2 and not Path("out").exists()
    assert "--fps is for images; a video brings its own rate" in err[-1]


def test_images_beside_videos_are_left_out(here):
    assert expanded("day1") == (["day1/b2.MP4", "day1/b10.mp4"], True), "by their numbers"


def test_animations_are_clips(here):
    still, *others = [Image.new("L", (8, 8), level) for level in (10, 60, 110)]
    Path("mixed").mkdir()
    for name in ("mixed/b.gif", "mixed/c10.png"):
        still.save(name, save_all=True, append_images=others)
    still.save("mixed/c2.png")
    clips, several = expanded("mixed")
    assert (clips, several) == (["mixed/b.gif", "mixed/c10.png"], True)
    assert expanded("mixed/*.png")[0] == ["mixed/c10.png"]
    assert expanded("mixed/c10.png", "mixed/b.gif")[0] == ["mixed/c10.png", "mixed/b.gif"]
    rates = {name: brings_rate(Path("mixed") / name) for name in ("b.gif", "c10.png", "c2.png", "*.png", "")}
    assert [name for name, own in rates.items() if own] == ["b.gif", "c10.png"]


def test_lists(here, monkeypatch):
    Path("list.txt").write_bytes(b"\xef\xbb\xbfday2/c.mkv\r\n\n  \n# day1/b10.mp4\nfaces\nday1/*.mp4\nday2/c.mkv\n")
    clips = ["day2/c.mkv", "faces", "day1/b10.mp4"]
    assert expanded("@list.txt") == (clips, True)
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"day2/c.mkv")))
    assert expanded("@-") == (["day2/c.mkv"], True)
    touch("@odd.mp4")
    assert expanded("./@odd.mp4") == (["@odd.mp4"], False)


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        (["@gone.txt"], InputError, "gone.txt: cannot be read as a list of clips: No such file or directory"),
        (["@day1"], InputError, "day1: cannot be read as a list of clips: Is a directory"),
        (["@empty/no.txt"], InputError, "empty/no.txt: names no clip; a list has a path a line"),
        (["gone/*.mp4"], InputError, "gone/*.mp4: matches no file"),
        (["tree/r"], InputError, "tree/r: is the folder of a run; name the clip that was tracked"),
        (["faces/0.png", "faces/1.png", "day2/c.mkv"], UsageError, "faces/0.png and 1 more are single images; give "),
    ],
)
def test_what_cannot_be_meant(here, given, error, words):
    with pytest.raises(error) as raised:
        expanded(*given)
    assert str(raised.value).startswith(words) and "\n" not in str(raised.value)


def test_a_slurm_array(tmp_path, monkeypatch):
    """Without SLURM: the script with the variables that SLURM sets, and few frames and particles."""
    [script] = [text for text in blocks(ROOT / "docs" / "pipelines.md", "sh") if "SBATCH --array" in text]
    for at, name in enumerate("abc"):
        make_clip(tmp_path / f"{name}.mp4", 6 + at)
    (tmp_path / "list.txt").write_text(".\n")
    script = script.replace("/shared/results", "results").replace("--config adaptive_robust ", "--config factorized ")
    script = script.replace("export NUMBA_CACHE_DIR", "unused")  # or all kernels would be compiled again
    script = script.replace("facetrack run", " ".join([*FACETRACK, "run", "--set filter.particles=20"]))
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "SLURM_ARRAY_TASK_COUNT": "2"}
    for task in ("1", "2"):
        given = {**environment, "SLURM_ARRAY_TASK_ID": task}
        subprocess.run(["bash", "-ec", script], env=given, cwd=tmp_path, check=True)
    tables = sorted(tmp_path.glob("results/*/trajectory.csv"))
    assert [len(table.read_text().splitlines()) for table in tables] == [1 + 5 * (6 + at) for at in range(3)]
