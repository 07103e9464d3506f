"""Batches: what is done is not done again, what failed is told, and several at once share the clips."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from imageio_ffmpeg import get_ffmpeg_exe

from facetrack_cli.__main__ import main
from facetrack_cli.run_folder import lease as locks
from facetrack_cli.run_folder.lease import FolderLease
from facetrack_cli.run_folder.manifest import read_manifest
from facetrack_cli.run_folder.status import MAX_ROWS, ClipStatus, duration, worst
from facetrack_cli.runs import plan as jobs
from facetrack_cli.runs.plan import Outcome
from tests.runs.test_run import FACETRACK, SMALL, make_clip
from tests.support.leases import ELSEWHERE, leave
from tests.support.samples import FOLDER

posix = pytest.mark.skipif(os.name != "posix", reason="the lock needs POSIX")
OPTIONS = [*SMALL, "--no-video", "--format", "csv"]


@pytest.fixture
def clips(tmp_path, monkeypatch):
    """A folder of twelve clips; results go beside it."""
    monkeypatch.chdir(tmp_path)
    Path("clips").mkdir()
    one = make_clip(Path("clips/c0.mp4"), 6)
    for i in range(1, 12):
        shutil.copy(one, f"clips/c{i}.mp4")
        shutil.copy("clips/c0.init.yaml", f"clips/c{i}.init.yaml")
    return Path("clips")


def run(*arguments):
    return main(["run", *map(str, arguments), *OPTIONS])


def status(folder, capsys):
    assert main(["status", str(folder), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def tracked(folder):
    """When each folder of results was changed."""
    return {path.parent.name: path.stat().st_mtime_ns for path in folder.glob("*/trajectory.csv")}


# --- several at once ---


@posix
@pytest.mark.parametrize("workers", [pytest.param(1, marks=pytest.mark.nightly), 2])
def test_two_at_once_share_the_clips_and_do_none_twice(clips, workers):
    command = [*FACETRACK, "run", "clips", "-o", "out", "-j", str(workers), *OPTIONS]
    both = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    said = [process.communicate(timeout=120)[1] for process in both]
    assert [process.returncode for process in both] == [0, 0], said
    lines = [line for text in said for line in text.splitlines() if " -> " in line]
    assert sum("done before" not in line for line in lines) == 12, said
    assert all(sum(f"c{i}.mp4 -> " in line for line in text.splitlines()) == 1 for text in said for i in range(12))
    assert len(tracked(Path("out"))) == 12 and len(list(Path("out").glob("batch-*.json"))) == 1


def test_results_that_another_writes_between_two_looks_are_no_obstacle(clips, capfd, monkeypatch):
    check = jobs.check_folder

    def late(*given, **more):
        monkeypatch.setattr(jobs, "check_folder", check)
        assert run("clips/c0.mp4", "clips/c1.mp4", "-o", "out") == 0
        check(*given, **more)

    monkeypatch.setattr(jobs, "check_folder", late)
    assert run("clips/c0.mp4", "clips/c1.mp4", "-o", "out") == 0
    assert capfd.readouterr().err.count("done before") == 2


@posix
def test_clips_of_another_machine_are_waited_for(clips, capfd, monkeypatch):
    monkeypatch.setattr("facetrack_cli.runs.batch.SETTLE_S", 0.2)
    folder = Path("out/c0-face")
    folder.mkdir(parents=True)
    monkeypatch.setattr(locks, "LEASE_S", 3.0)
    leave(folder, ELSEWHERE)
    assert run("clips/c0.mp4", "clips/c1.mp4", "-o", "out") == 0
    lines = capfd.readouterr().err.splitlines()
    assert [line.partition(" -> ")[0] for line in lines] == [
        "clips/c1.mp4",
        "1 clip is being tracked by another facetrack on node7; waiting for it",
        "facetrack: out/c0-face: whoever writes here is silent; waiting 3 s for it",
        "clips/c0.mp4",
    ]


@pytest.mark.nightly
@posix
def test_ctrl_c_ends_the_waiting(clips):
    with FolderLease(Path("out/c0-face")):
        command = [*FACETRACK, "run", "clips/c0.mp4", "clips/c1.mp4", "-o", "out", *OPTIONS]
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        assert process.stderr is not None
        while "waiting for it" not in process.stderr.readline():
            assert process.poll() is None
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 130
        process.stderr.close()


@pytest.mark.nightly
@posix
def test_one_that_was_suspended_and_taken_over_replaces_nothing(tmp_path, monkeypatch):
    clip, out = make_clip(tmp_path / "sway.mp4", 300), tmp_path / "out"
    code = "from facetrack_cli.run_folder import lease; lease.LEASE_S = 0.6; "
    code += "import sys; from facetrack_cli.__main__ import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "run", clip, "-o", out, *OPTIONS]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not (parts := list(out.glob(".trajectory-*.part.csv"))) or parts[0].stat().st_size < 10_000:
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.002)
    process.send_signal(signal.SIGSTOP)
    time.sleep(0.8)
    monkeypatch.setattr(locks, "LEASE_S", 0.6)
    assert run(clip, "-o", out, "-q") == 0
    before = {path.name: path.read_bytes() for path in out.iterdir() if not path.name.startswith(".")}
    process.send_signal(signal.SIGCONT)
    said = process.communicate(timeout=60)[1]
    assert process.returncode == 2 and "another facetrack has taken this folder over" in said
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    assert (read_manifest(out).stopped, read_manifest(out).frames) == (None, 300)


# --- what failed ---


def test_what_failed_is_told_and_tried_again_only_if_asked(clips, capfd):
    Path("clips/c0.mp4").write_text("no video")
    inputs = ["clips/c0.mp4", "clips/c1.mp4", "-o", "out"]
    assert run(*inputs) == 5
    known = read_manifest(Path("out/c0-face"))
    assert known.error == "clips/c0.mp4: not a video; give a video file or a folder of images"
    assert (known.exit_code, known.files, known.frames) == (3, {}, 0)
    before = Path("out/c0-face/run.json").stat().st_mtime_ns
    capfd.readouterr()
    assert run(*inputs) == 5
    lines = capfd.readouterr().err.splitlines()
    assert f"facetrack: error: {known.error}" in lines
    assert lines[-1] == "1 of 2 inputs failed, 1 of them before; --retry-failed tries those again"
    assert Path("out/c0-face/run.json").stat().st_mtime_ns == before
    assert run(*inputs, "--retry-failed") == 5
    assert Path("out/c0-face/run.json").stat().st_mtime_ns > before
    shutil.copy("clips/c1.mp4", "clips/c0.mp4")
    assert run(*inputs) == 0, "the clip has changed"
    assert read_manifest(Path("out/c0-face")).error is None


def test_what_failed_does_not_keep_another_recipe_out(clips):
    Path("clips/c0.init.yaml").write_text("frame: 900\npoints: {nose: [1, 1]}")
    assert run("clips/c0.mp4", "clips/c1.mp4", "-o", "out") == 5
    shutil.copy("clips/c1.init.yaml", "clips/c0.init.yaml")
    assert run("clips/c0.mp4", "clips/c1.mp4", "-o", "out") == 0, "what is asked has changed"


def test_a_failure_leaves_other_results_alone(clips):
    assert run("clips/c0.mp4", "-o", "out/c0-face", "--seed", 5) == 0
    before = tracked(Path("out"))
    Path("clips/c0.mp4").write_text("no video")
    assert run("clips/c0.mp4", "clips/c1.mp4", "-o", "out") == 5
    assert run("clips/c0.mp4", "clips/c1.mp4", "-o", "out", "--overwrite") == 5
    assert read_manifest(Path("out/c0-face")).error is None
    assert tracked(Path("out"))["c0-face"] == before["c0-face"]


def test_an_error_in_the_middle_is_a_failure_with_frames(clips, monkeypatch):
    def count(outcome, result):
        original(outcome, result)
        if outcome.frames == 3:
            raise RuntimeError("three")

    original = Outcome.count
    monkeypatch.setattr(Outcome, "count", count)
    assert run("clips/c0.mp4", "clips/c1.mp4", "-o", "out") == 5
    known = read_manifest(Path("out/c0-face"))
    assert "RuntimeError: three" in known.error and known.frames == 3 and known.exit_code == 1 and known.files


# --- shards ---


def test_shards_are_disjoint_and_complete(clips, capfd):
    seen = set()
    for i in range(1, 6):
        assert run("@list", "--shard", f"{i}/5", "-o", "out") == 3, "the list is not there"
    Path("list").write_text("clips\n" + "clips/../clips/c3.mp4\n")
    for i in range(1, 6):
        assert run("@list", "--shard", f"{i}/5", "-o", "out") == 0
        found = set(tracked(Path("out"))) - seen
        assert len(found) == (3 if i <= 2 else 2)
        seen |= found
    assert seen == {f"c{i}-face" for i in range(12)} and len(list(Path("out").glob("batch-*"))) == 1
    assert run("clips/c0.mp4", "--shard", "2/2", "-o", "out") == 0, "there may be none"


@pytest.mark.parametrize(
    ("shard", "words"),
    [
        ("0/5", "counts from 1: the first of 5 jobs is 1/5"),
        ("6/5", "the last is 5/5"),
        ("3", "give I/N"),
        ("a/b", "I/N"),
    ],
)
def test_a_shard_that_is_none(clips, capfd, shard, words):
    assert run("clips", "--shard", shard) == 2
    assert words in capfd.readouterr().err


def test_a_folder_of_one_clip_is_a_batch(clips):
    for path in sorted(clips.glob("c[1-9]*")):
        path.unlink()
    assert run("clips", "-o", "out") == 0
    assert list(tracked(Path("out"))) == ["c0-face"]


# --- how far it is ---


def test_status_in_each_state(clips, capsys):
    Path("clips/c1.mp4").write_text("no video")
    three = ["clips/c0.mp4", "clips/c1.mp4", "clips/c2.mp4", "clips/c3.mp4", "clips/c4.mp4", "-o", "out"]
    shutil.copytree("clips", "moved")
    for i in (2, 3, 4):
        Path(f"clips/c{i}.mp4").unlink()
    assert run(*three) == 5
    for i in (2, 3, 4):
        shutil.rmtree(f"out/c{i}-face")
    capsys.readouterr()
    Path("out/c2-face").mkdir()
    leave(Path("out/c2-face"), ELSEWHERE, silent_s=1e6)
    before = {path: path.stat().st_mtime_ns for path in Path("out").rglob("*")}
    with FolderLease(Path("out/c3-face")) as claim:
        claim.note({"clip": "clips/c3.mp4", "frame": 3, "frames": 6})
        found = status("out", capsys)
        assert main(["status", "out"]) == 0
    text = capsys.readouterr().out
    assert found["schema"] == "facetrack-status" and found["version"] == 1
    assert found["counts"] == {"done": 1, "running": 1, "interrupted": 1, "failed": 1, "not begun": 1}
    by_clip = {one["clip"]: one for one in found["clips"]}
    assert [one["state"] for one in found["clips"]] == ["done", "failed", "interrupted", "running", "not begun"]
    running = by_clip["clips/c3.mp4"]
    assert (running["frames"], running["of"], running["host"]) == (3, 6, locks.here()[0])
    done = by_clip["clips/c0.mp4"]
    assert done["frames"] == 6 and done["seconds"] > 0 and done["ended"] >= done["since"] > "2"
    assert found["work_s"] == pytest.approx(2.5 * done["seconds"], abs=0.1)
    assert found["remaining_s"] == found["work_s"]
    assert "out: 5 clips" in text and "c1-face       0     –  failed: clips/c1.mp4: not a video" in text
    assert f"running: clips/c3.mp4: on {locks.here()[0]} since 2" in text and "3 of about 6 frames" in text
    assert "interrupted: clips/c2.mp4: what it had tracked is kept" in text
    assert "3 clips left: about" in text and ", 1 at a time" in text
    after = {path: path.stat().st_mtime_ns for path in Path("out").rglob("*") if "c3" not in str(path)}
    assert after.items() <= before.items() | {(Path("out"), Path("out").stat().st_mtime_ns)}, "nothing is written"
    assert main(["status", "out"]) == 0
    assert "of work; nothing is running: give the command again" in capsys.readouterr().out


def test_status_of_one_run_and_of_none(clips, capsys):
    assert run("clips/c0.mp4", "-o", "one", "-q") == 0
    found = status("one", capsys)
    assert [one["state"] for one in found["clips"]] == ["done"] and found["clips"][0]["folder"] == "."
    assert run("clips/c0.mp4", "clips/c1.mp4", "-q") == 0, "in the working directory there is no file of the batch"
    assert [one["folder"] for one in status(".", capsys)["clips"]] == ["c0-face", "c1-face", "one"]
    for what in ("clips", "gone", "clips/c0.mp4"):
        assert main(["status", what]) == 3
        assert len(capsys.readouterr().err.splitlines()) == 1
    Path("one/run.json").write_text("[]")
    assert [one["state"] for one in status("one", capsys)["clips"]] == ["failed"]
    Path("killed").mkdir()
    leave(Path("killed"), {**ELSEWHERE, "clip": "clips/c9.mp4"}, silent_s=1e6)
    assert [(one["clip"], one["state"]) for one in status("killed", capsys)["clips"]] == [
        ("clips/c9.mp4", "interrupted")
    ]


def test_the_table_has_the_clip_that_is_lost_most_first():
    often = ClipStatus("b.mp4", "b-face", "done", 10, lost=0.9, look="face nose is lost in 9")
    never, once = ClipStatus("a.mp4", "a-face", "done", 10, lost=0.0), replace(often, folder="c-face", lost=0.1)
    assert [*worst([never, once, often])] == [
        "clip    frames  lost  look at",
        "b-face      10   90%  face nose is lost in 9",
        "c-face      10   10%  face nose is lost in 9",
    ]
    assert [*worst([never])] == []
    doubtful = replace(once, folder="e-face", doubtful=True)
    assert next(line for line in [*worst([often, doubtful])][1:]).startswith("e-face")
    cut = replace(often, folder="d-face", lost=0.0, complete=False, look="cut short")
    assert next(line for line in [*worst([often, cut])][1:]).startswith("d-face")
    *_, more = worst([often] * (MAX_ROWS + 3))
    assert more.startswith("and 3 more")


def test_a_batch_ends_with_the_clips_to_look_at(clips, capsys):
    for name in ("c0", "c1"):
        folder = Path("out") / f"{name}-face"
        assert run(f"clips/{name}.mp4", "-o", folder, "-q") == 0
        known = read_manifest(folder)
        said = replace(known, lost_frames={"face/nose": 5, "face/box": 2}, lost_at_end=("face/nose",))
        said = replace(said, look=((1, 4), (5, 5)), resumed=2, seconds=2.0)
        if name == "c1":
            (folder / "run.json").write_text(json.dumps(said.record()))
    capsys.readouterr()
    found = {one["folder"]: one for one in status("out", capsys)["clips"]}
    assert found["c1-face"]["lost"] == round(5 / 6, 4) and found["c0-face"]["look"] == ""
    assert found["c1-face"]["still"] == 2 and found["c1-face"]["frames_per_s"] == 2.0, "of the frames since it went on"
    assert run("clips/c0.mp4", "clips/c1.mp4", "-o", "out") == 0
    last = capsys.readouterr().err.splitlines()[-1]
    assert last == "c1-face       6   83%  face nose is lost in 5 and at the end, frames 1 to 4, 5"


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.2, "0 s"), (99, "99 s"), (150, "2 min"), (7000, "1.9 h"), (80_000, "22 h"), (400_000, "4.6 days")],
)
def test_durations(seconds, words):
    assert duration(seconds) == words


@pytest.mark.skipif(os.name != "posix", reason="a kill needs POSIX")
@pytest.mark.parametrize("moment", [1.0, pytest.param(4.0, marks=pytest.mark.nightly), 8.0])
@pytest.mark.parametrize("how", ["-j", "--split"])
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
    deadline = time.monotonic() + 8  # five seconds, and what a busy machine takes
    while [one for one in children if one.is_running() and one.status() != psutil.STATUS_ZOMBIE]:
        assert time.monotonic() < deadline
        time.sleep(0.1)
