"""Nothing half done looks finished: kills, power loss, two writers, files of different runs."""

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
from pathlib import Path

import pytest

from facetrack_cli.__main__ import main
from facetrack_cli.core.files import temporary_path
from facetrack_cli.run_folder import lease as locks
from facetrack_cli.run_folder import manifest
from facetrack_cli.run_folder.lease import LOCK, NOTE, FolderLease
from facetrack_cli.run_folder.manifest import NAME, read_manifest, read_run, recover_interrupted
from tests.support.damage import raising
from tests.support.leases import abandon, leave_here
from tests.support.sway import FACETRACK, ROWS, SMALL, make_clip, names, until

posix = pytest.mark.skipif(os.name != "posix", reason="signals and locks of POSIX")
TABLES = ["--no-video", "--format", "csv,json,jsonl"]


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    return make_clip(tmp_path_factory.mktemp("killed") / "sway.mp4", 100)


@pytest.fixture(scope="module")
def whole(clip):
    """The tables of a run that nothing ended."""
    folder = clip.with_name("whole")
    assert run(clip, "-o", folder, *SMALL, *TABLES, "-q") == 0
    return folder


def run(*arguments):
    return main(["run", *map(str, arguments)])


def frames_of(part):
    return [int(line.split(",", 1)[0]) for line in part.read_text().splitlines()[1:]]


def records(folder, form):
    """The lines of a CSV, the frames of the others."""
    text = (folder / f"trajectory.{form}").read_text()
    if form == "json":
        return json.loads(text)["frames"]
    lines = text.splitlines()[1:]
    return lines if form == "csv" else [line for line in lines if '"type":"frame"' in line]


def killed(clip, out, *arguments, frames):
    """Run until so many frames are in the tables, then kill -9; the last frame that was in them."""
    process = subprocess.Popen([*FACETRACK, "run", clip, "-o", out, *map(str, arguments)], stderr=subprocess.DEVNULL)

    def written():
        parts = [frames_of(part) for part in out.glob(f".trajectory-{process.pid}-*.part.csv")]
        return parts and len(parts[0]) >= ROWS * frames and parts[0]

    last = until(written, process)[-1]
    process.kill()
    process.wait()
    return last


@pytest.fixture(scope="module")
def torn(clip):
    """The folder of a run that was killed, and the last frame in its tables."""
    folder = clip.with_name("torn")
    return folder, killed(clip, folder, *SMALL, *TABLES, frames=30)


@posix
def test_what_was_tracked_before_a_kill_is_kept_and_taken_up(clip, whole, torn, tmp_path):
    out, last = shutil.copytree(torn[0], tmp_path / "out"), torn[1]
    kept = read_run(out)
    assert names(out) == [NAME, "trajectory.csv", "trajectory.json", "trajectory.jsonl"], "no part is left"
    done = read_manifest(out)
    assert (done.complete, done.stopped) == (False, "killed")
    assert kept.frames[-1] >= last - 1 and len(kept.frames) == done.frames
    for form in ("csv", "json", "jsonl"):
        assert records(out, form) == records(whole, form)[: done.frames * (ROWS if form == "csv" else 1)]
    assert (kept.header["complete"], kept.header["stopped"]) == (False, "killed")
    assert kept.header["frames_tracked"] == done.frames
    killed(clip, out, *SMALL, *TABLES, frames=3)
    recover_interrupted(out)
    assert read_manifest(out).frames == len(read_run(out).frames) >= done.frames, "the longer track is kept"
    assert run(clip, "-o", out, *SMALL, *TABLES, "-q") == 0, "the same command tracks it again"
    assert (out / "trajectory.csv").read_bytes() == (whole / "trajectory.csv").read_bytes()
    assert read_manifest(out).stopped is None


@posix
@pytest.mark.parametrize("moment", ["WRITERS", "commit"])
def test_a_recovery_that_is_killed_is_made_again(torn, tmp_path, monkeypatch, moment):
    shutil.copytree(torn[0], tmp_path, dirs_exist_ok=True)
    monkeypatch.setattr(manifest, moment, raising(SystemExit))
    monkeypatch.setattr(FolderLease, "__exit__", lambda lease, *_: abandon(lease))
    with pytest.raises((SystemExit, TypeError)):
        recover_interrupted(tmp_path)
    monkeypatch.undo()
    recover_interrupted(tmp_path)
    assert len(read_run(tmp_path).frames) == read_manifest(tmp_path).frames >= 19


def leave_rows(out, form, text, run):
    """What a run whose run.json would be `run` leaves in its folder if it is killed while it writes a table."""
    (host, boot), mark = locks.here(), f"999999999-{'5' * 16}"
    note = {"host": host, "boot": boot, "token": "ab", "process": 999_999_999, "mark": mark, "run": run}
    leave_here(out, note, 999_999_999)
    (out / f".trajectory-{mark}.part.{form}").write_bytes(text)


@pytest.mark.parametrize("form", ["csv", "json", "jsonl"])
def test_a_table_torn_anywhere_ends_with_a_whole_frame(clip, tmp_path, form):
    whole = tmp_path / "whole"
    assert run(clip, "-o", whole, "--stop", 4, *SMALL, "--no-video", "--format", form, "-q") == 0
    text = (whole / f"trajectory.{form}").read_bytes()
    expected = records(whole, form)
    seen = set()
    # also where an object inside of a line ends, which looks like the end of a frame
    inside = [one.end() for one in re.finditer(rb'"ess":[0-9.]+\}', text)][-8:]
    for at in {*range(0, len(text), 503), *inside}:
        out = tmp_path / f"{at}"
        out.mkdir()
        leave_rows(out, form, text[:at], read_manifest(whole).record())
        recover_interrupted(out)
        done = read_manifest(out)
        seen.add(frames := 0 if done is None else done.frames)
        if frames:
            assert records(out, form) == expected[: frames * (ROWS if form == "csv" else 1)]
            assert len(read_run(out).frames) == frames
        else:
            assert names(out) == []
    assert seen >= {0, 2, 3}


def test_rows_that_a_kill_left_do_not_replace_as_many_or_more_of_the_same_job(clip, tmp_path):
    whole, part = tmp_path / "whole", tmp_path / "part"
    part.mkdir()
    assert run(clip, "-o", whole, "--stop", 5, *SMALL, "--no-video", "--format", "csv", "-q") == 0
    record, lines = read_manifest(whole).record(), (whole / "trajectory.csv").read_bytes().splitlines(keepends=True)

    def recovered(out, frames, **more):
        """How many frames are there after a kill with so many whole frames; "kept" if nothing was written."""
        before = {path.name: path.stat().st_ino for path in out.iterdir()}
        leave_rows(out, "csv", b"".join(lines[: frames * ROWS + 2]), record | more)
        recover_interrupted(out)
        if {path.name: path.stat().st_ino for path in out.iterdir()} == before:
            return "kept"
        assert names(out) == [NAME, "trajectory.csv"] and read_manifest(out).stopped == "killed"
        assert len(read_run(out).frames) == read_manifest(out).frames
        return read_manifest(out).frames

    assert recovered(whole, 3) == "kept" and read_manifest(whole).complete
    assert [recovered(part, frames) for frames in (3, 2, 3, 4)] == [3, "kept", "kept", 4]
    assert recovered(part, 2, asked="something else") == 2


@posix
@pytest.mark.parametrize("kills", [pytest.param(1, marks=pytest.mark.nightly), 2])
def test_a_worker_that_is_killed_is_replaced_once(clip, whole, tmp_path, kills):
    other, folder, killed = make_clip(tmp_path / "other.mp4", 5), tmp_path / "out" / "sway-face", set()
    words = [*FACETRACK, "run", clip, other, "-j", "2", "-o", tmp_path / "out", *SMALL, "--no-video"]
    process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)

    def killing():
        for part in folder.glob(".trajectory-*.part.csv"):
            number = int(part.name.split("-")[1].split(".")[0])
            with contextlib.suppress(FileNotFoundError):
                if number not in killed and len(frames_of(part)) >= (20 + 50 * len(killed)) * ROWS:
                    os.kill(number, signal.SIGKILL)
                    killed.add(number)
        return len(killed) == kills

    until(killing, process)
    said = process.communicate()[1]
    if kills == 1:
        assert process.returncode == 0, said
        assert records(folder, "csv") == records(whole, "csv")
        return
    assert process.returncode == 5
    assert "its process ended with code -9" in said and "frames that it had tracked are kept" in said
    known = read_manifest(folder)
    assert known.stopped == "killed" and len(read_run(folder).frames) >= 19
    assert "its process ended with code -9" in known.error and known.exit_code == 1


def test_a_run_owns_all_its_outputs(clip, tmp_path):
    assert run(clip, "-o", tmp_path, "--stop", 5, *SMALL, "--format", "csv,json,jsonl", "--smooth", "-q") == 0
    (tmp_path / "report.html").write_text("mine")
    assert run(clip, "-o", tmp_path, "--stop", 4, *SMALL, "--no-video", "--format", "csv", "--overwrite", "-q") == 0
    assert names(tmp_path) == ["report.html", NAME, "trajectory.csv"]


def test_files_of_different_runs_are_noticed(tmp_path, capsys):
    clip = make_clip(tmp_path / "sway.mp4", 5)
    for folder, seed in (("a", 1), ("b", 2)):
        assert run(clip, "-o", tmp_path / folder, *SMALL, "--seed", seed, "-q") == 0
    clip.unlink()
    for name in ("trajectory.csv", "trajectory.json"):
        shutil.copy(tmp_path / "a" / name, tmp_path / "b" / name)
        command = ["eval", tmp_path / "b" / name, "--truth", tmp_path / "a" / "trajectory.csv"]
        assert main([*map(str, command)]) == 3
        assert f"{name}: is not as its run wrote it" in capsys.readouterr().err


@posix
@pytest.mark.parametrize("renamed", [0, 1, 3])
def test_a_kill_between_two_renames_is_finished_by_whoever_reads(clip, tmp_path, monkeypatch, renamed):
    def torn(folder, note):
        if not note:
            return  # nothing was left before
        for name in note["replace"]["files"][:renamed]:
            temporary_path(folder / name).replace(folder / name)
        raise SystemExit

    assert run(clip, "-o", tmp_path, "--stop", 5, *SMALL, "--seed", 1, "-q") == 0
    monkeypatch.setattr(locks, "finish_replacing", torn)
    monkeypatch.setattr("facetrack_cli.runs.record.Recorder.__exit__", lambda into, *_: abandon(into.lease))
    with pytest.raises(SystemExit):
        run(clip, "-o", tmp_path, "--stop", 4, *SMALL, "--seed", 2, "--overwrite", "-q")
    monkeypatch.undo()
    assert [len(read_run(tmp_path / f"trajectory.{form}").frames) for form in ("csv", "json")] == [4, 4]
    assert read_manifest(tmp_path).frames == 4
    assert names(tmp_path) == ["annotated.mp4", NAME, "trajectory.csv", "trajectory.json"]


def test_a_swapped_clip_is_known(tmp_path, capsys, no_plot):
    clip, out = make_clip(tmp_path / "one.mp4", 6), str(tmp_path / "out")
    assert run(clip, "-o", out, *SMALL, "-q") == 0
    assert len(read_run(out).header["source_sha256"]) == 64
    make_clip(clip, 7)
    for command, code in (
        (["fix", out, "--init", str(clip.with_suffix(".init.yaml"))], 3),
        (["report", out], 0),
        (["eval", out, "--truth", f"{out}/trajectory.csv"], 0),
    ):
        assert main(command) == code
        assert "is not the clip that trajectory.json was made from" in "".join(capsys.readouterr())


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="asks Linux which file is brought to the disk")
def test_each_file_is_on_the_disk_before_its_name(clip, tmp_path, monkeypatch):
    said = []
    fsync, replace = os.fsync, Path.replace

    def synced(place):
        said.append(("sync", Path(f"/proc/self/fd/{place}").readlink().name))
        fsync(place)

    def renamed_(self, to):
        said.append((self.name, Path(to).name))
        return replace(self, to)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(Path, "replace", renamed_)
    assert run(clip, "-o", tmp_path / "out", "--stop", 3, *SMALL, "-q") == 0
    renamed = [one for one in said if one[0] != "sync" and one[1] != NOTE]
    assert [to for _, to in renamed] == ["annotated.mp4", "trajectory.csv", "trajectory.json", NAME]
    for one in renamed:
        assert said.index(("sync", one[0])) < said.index(("sync", NOTE)) < said.index(one)
    last = said.index(renamed[-1])
    assert ("sync", "out") in said[last:], "and the names are on the disk"


@pytest.mark.skipif(
    os.name != "posix" or os.getuid() != 0 or shutil.which("mkfs.ext4") is None,
    reason="mounting a file system takes root and mkfs.ext4",
)
def test_what_exits_with_0_survives_a_power_loss(clip, tmp_path):
    """Of a file system of its own on a file: whatever it holds at that moment, mounted again."""
    image, folder, after, left = (tmp_path / name for name in ("disk.img", "disk", "after.img", "after"))

    def mount(file, to):
        to.mkdir()
        done = subprocess.run(["mount", "-o", "loop", file, to], capture_output=True, text=True, check=False)
        if done.returncode:
            pytest.skip(f"no file system can be mounted here: {done.stderr.strip()}")
        mounted.callback(subprocess.run, ["umount", to], check=True)

    with image.open("wb") as file:
        file.truncate(64 << 20)
    subprocess.run(["mkfs.ext4", "-q", image], check=True)
    with contextlib.ExitStack() as mounted:
        mount(image, folder)
        code = run(clip, "--config", "sir", "--stop", 20, "-q", *SMALL, "-o", folder / "out")
        shutil.copy(image, after)
        mount(after, left)
        found = [name for name in names(left / "out") if name not in (LOCK, NOTE)]  # they may be there still
        assert code == 0 and found == ["annotated.mp4", NAME, "trajectory.csv", "trajectory.json"]
        for name in found:
            assert (left / "out" / name).read_bytes() == (folder / "out" / name).read_bytes() != b""
        assert len(read_run(left / "out").frames) == 20
