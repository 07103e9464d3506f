"""A folder has one writer: on one machine, on several, with clocks that differ, and without flock."""

from __future__ import annotations

import errno
import json
import multiprocessing
import os
import subprocess
import sys
import time

import pytest

from facetrack_cli.core.errors import BusyError, OutputError
from facetrack_cli.core.files import own_mark, temporary_path
from facetrack_cli.run_folder import lock as locks
from facetrack_cli.run_folder.lock import LOCK, FolderLock, finish_replacing, holder, left_in, sweep

pytestmark = pytest.mark.skipif(os.name != "posix", reason="the lock needs POSIX")
ELSEWHERE = {"host": "node7", "boot": "b", "process": 1, "token": "ab12", "frame": 3}


@pytest.fixture(autouse=True)
def _soon(monkeypatch):
    monkeypatch.setattr(locks, "SETTLE_S", 0.02)


@pytest.fixture
def no_flock(monkeypatch):
    monkeypatch.setattr(locks, "_flock", lambda file: None)


def leave(folder, note, *, silent_s=0.0):
    """The lock file of a process that is gone, or on another machine, of so many seconds ago."""
    (folder / LOCK).write_text(note if isinstance(note, str) else json.dumps(note))
    then = time.time() - silent_s
    os.utime(folder / LOCK, (then, then))


def note_here(process):
    host, boot = locks.here()
    return {**ELSEWHERE, "host": host, "boot": boot, "process": process}


def ended_process():
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait(60)
    return process.pid


def names(folder):
    return [path.name for path in folder.iterdir()]


def is_refused(folder):
    """Whether a second writer is refused, with its line; the lock stays as it was."""
    before = (folder / LOCK).read_bytes()
    try:
        with FolderLock(folder):
            return False
    except BusyError as e:
        remedy = "wait until it ends, or name another folder with --out"
        assert str(e) == f"{folder}: another facetrack is writing its results here; {remedy}"
        assert (folder / LOCK).read_bytes() == before and names(folder) == [LOCK]
        return True


@pytest.mark.parametrize("without", [(), ("no_flock",)])
def test_a_folder_has_one_writer(tmp_path, without, request):
    for one in without:
        request.getfixturevalue(one)
    for _ in range(2):
        with FolderLock(tmp_path / "new" / "folder") as lock:
            folder = tmp_path / "new" / "folder"
            assert lock.stale_note == {}
            note = json.loads((folder / LOCK).read_text())
            assert (note["host"], note["boot"]) == locks.here() and note["process"] == os.getpid()
            assert holder(folder) == note
            assert is_refused(folder)
            lock.check()
        assert names(folder) == [] and holder(folder) is None


def test_signs_of_life(tmp_path, monkeypatch):
    monkeypatch.setattr(locks, "BEAT_S", 0.01)
    with FolderLock(tmp_path) as lock:
        size = (tmp_path / LOCK).stat().st_size
        for frame in (5, 123456):
            lock.frame, lock.frames = frame, 2 * frame
            os.utime(tmp_path / LOCK, (0, 0))
            deadline = time.monotonic() + 10
            while (tmp_path / LOCK).stat().st_mtime < 1 or holder(tmp_path)["frame"] != frame:
                assert time.monotonic() < deadline
            found = holder(tmp_path)
            assert found["frames"] == 2 * frame and found["seconds"] >= 0
        lock.note({"run": "x" * size})
        lock.note({"run": ""})
        assert (tmp_path / LOCK).stat().st_size > size, "a note never shrinks"
        assert holder(tmp_path)["run"] == ""


@pytest.mark.one_in(3)
@pytest.mark.parametrize("without", [(), ("no_flock",)])
@pytest.mark.parametrize("hours", [0, -5, 5])
def test_another_machine_is_believed_for_a_minute(tmp_path, without, hours, request, monkeypatch):
    for one in without:
        request.getfixturevalue(one)
    clock = time.time
    leave(tmp_path, ELSEWHERE, silent_s=50)
    monkeypatch.setattr(time, "time", lambda: clock() + 3600 * hours)  # the clock is that of the file system
    assert is_refused(tmp_path)
    monkeypatch.undo()
    leave(tmp_path, ELSEWHERE, silent_s=70)
    assert holder(tmp_path) is None
    with FolderLock(tmp_path) as lock:
        assert lock.stale_note == ELSEWHERE
        lock.check()
    assert names(tmp_path) == []


def test_of_this_machine_a_process_that_ended_leaves_nothing(tmp_path, request):
    leave(tmp_path, note_here(os.getppid()))
    with FolderLock(tmp_path) as lock:  # the process is there, but does not hold the lock: its number was given again
        assert lock.stale_note["process"] == os.getppid()
    request.getfixturevalue("no_flock")
    leave(tmp_path, note_here(os.getppid()))
    assert is_refused(tmp_path)
    for process, silent_s in ((ended_process(), 0), (os.getppid(), 70)):
        leave(tmp_path, note_here(process), silent_s=silent_s)
        assert holder(tmp_path) is None
        with FolderLock(tmp_path):
            pass


@pytest.mark.parametrize("text", ["", "x" * 50, "[1]", '{"process": 1}', '{"host": 1, "boot": [], "process": "x"}'])
def test_notes_that_say_nothing(tmp_path, text, request):
    leave(tmp_path, text)
    with FolderLock(tmp_path):
        pass
    request.getfixturevalue("no_flock")
    leave(tmp_path, text)
    assert is_refused(tmp_path), "its process may be about to write who it is"
    leave(tmp_path, text, silent_s=70)
    with FolderLock(tmp_path):
        pass


def test_a_note_that_is_being_written_is_read_again(tmp_path, monkeypatch):
    text = json.dumps(ELSEWHERE).ljust(5000)
    leave(tmp_path, text[:40] + "\0" * 4960)
    monkeypatch.setattr(locks.time, "sleep", lambda _: leave(tmp_path, text))
    assert holder(tmp_path) == ELSEWHERE


def test_a_process_that_is_taken_over_notices(tmp_path, no_flock):
    with FolderLock(tmp_path) as suspended:
        suspended.check()
        leave(tmp_path, {**ELSEWHERE, "run": 1}, silent_s=70)
        with FolderLock(tmp_path) as other:
            other.check()
            assert other.stale_note["run"] == 1
            with pytest.raises(OutputError, match="another facetrack has taken this folder over"):
                suspended.prepare([], [tmp_path / LOCK])
            suspended.note({"run": 2})
            assert "run" not in holder(tmp_path), "nor does it write into the other's note"
        with pytest.raises(OutputError, match="another facetrack has taken this folder over"):
            suspended.check()


def test_what_was_not_recovered_stays_in_the_next_note(tmp_path):
    leave(tmp_path, {**note_here(ended_process()), "run": 1})
    for _ in range(2):
        lock = FolderLock(tmp_path).__enter__()
        assert lock.stale_note["run"] == 1
        lock._ended.set()
        os.close(lock._file)  # as a kill leaves it
    with FolderLock(tmp_path) as lock:
        lock.note({"before": None})
        assert "run" not in holder(tmp_path)


def _take(folders, barrier, mine):
    """Take over the stale lock of each folder, at the same moment as another process; write who got it."""
    locks._flock = lambda file: None
    locks.SETTLE_S = 0.1
    locks.here = lambda: (f"node{mine}", "b")
    for folder in folders:
        barrier.wait(60)
        try:
            with FolderLock(folder):
                with (folder / "log").open("a") as log:
                    log.write(f"{mine}\n")
                barrier.wait(60)
        except BusyError:
            barrier.wait(60)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("silent_s", [70, None])
def test_of_two_at_once_one_wins(tmp_path, silent_s):
    folders = [tmp_path / f"{i}" for i in range(15)]
    for folder in folders:
        folder.mkdir()
        if silent_s is not None:
            leave(folder, ELSEWHERE, silent_s=silent_s)
    context = multiprocessing.get_context("spawn")
    barrier = context.Barrier(2)
    both = [context.Process(target=_take, args=(folders, barrier, i)) for i in range(2)]
    for process in both:
        process.start()
    for process in both:
        process.join(60)
        assert process.exitcode == 0
    won = [(folder / "log").read_text().split() for folder in folders]
    assert all(len(one) == 1 for one in won), won


def test_a_folder_that_cannot_be_written(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "pwrite", full)
    with pytest.raises(OutputError, match=r"\.facetrack\.lock: the disk is full"), FolderLock(tmp_path):
        pass
    assert names(tmp_path) == []


# --- files that are replaced together ---


def test_two_may_finish_at_once(tmp_path, monkeypatch):
    """A file that another process has renamed in the meantime is not missed; one that it replaces again stays."""
    table, replace = tmp_path / "a.csv", type(tmp_path).replace
    temporary_path(table).write_text("saved")
    note = {"mark": own_mark(), "replace": {"files": ["a.csv", "b.csv"], "gone": ["../c", "d"]}}
    (tmp_path / "d").touch()

    def first(self, to):
        replace(self, to)
        return replace(self, to)

    monkeypatch.setattr(type(tmp_path), "replace", first)
    finish_replacing(tmp_path, note)
    table.write_text("another run")
    finish_replacing(tmp_path, note)
    assert table.read_text() == "another run" and names(tmp_path) == ["a.csv"]


def test_a_note_replaces_nothing_outside_of_the_folder(tmp_path):
    """Whoever shares a folder writes its note: names lead to files of the folder, and links lead nowhere."""
    out, other = tmp_path / "out", tmp_path / "other"
    for folder in (out, other, out / "people"):
        folder.mkdir()
    for path in (other / "a.csv", other / "1.jpg"):
        path.write_text("mine")
    mark = f"{ended_process()}-{'0' * 16}"
    (out / f".a-{mark}.part.csv").write_text("theirs")
    note = {"mark": mark, "replace": {"files": ["../other/a.csv", "x/people/1.jpg"], "gone": ["../other/1.jpg"]}}
    finish_replacing(out, note)
    assert (out / "a.csv").read_text() == "theirs" and {*names(other)} == {"1.jpg", "a.csv"}
    (out / f".a-{mark}.part.csv").write_text("theirs")
    (out / "a.csv").unlink()
    (out / "a.csv").symlink_to(other / "a.csv")
    with pytest.raises(OutputError, match=r"out/a.csv: is a link, and what it leads to is not replaced"):
        finish_replacing(out, note)
    (out / "a.csv").unlink()
    (out / "people").rmdir()
    (out / "people").symlink_to(other)
    with pytest.raises(OutputError, match=r"out/people: is a link"):
        finish_replacing(out, {"mark": mark, "replace": {"gone": ["people/1.jpg"]}})
    for mark in (1, "1", f"../{'0' * 16}", f"/-{'0' * 16}"):
        finish_replacing(out, {"mark": mark, "replace": {"files": ["b.csv"], "gone": ["people/1.jpg"]}})
    assert {*names(other)} == {"1.jpg", "a.csv"} and (other / "a.csv").read_text() == "mine"


def test_a_lock_that_is_a_link_or_a_pipe(tmp_path):
    (tmp_path / LOCK).symlink_to(tmp_path / "mine")
    (tmp_path / "mine").write_text("kept")
    with pytest.raises(OutputError, match="is a link"), FolderLock(tmp_path):
        pass
    assert (tmp_path / "mine").read_text() == "kept"
    (tmp_path / LOCK).unlink()
    os.mkfifo(tmp_path / LOCK)
    assert left_in(tmp_path) == {}


def test_temporary_names_cannot_be_guessed(tmp_path):
    code = "from pathlib import Path; from facetrack_cli.core.files import temporary_path as t; print(t(Path('a.csv')))"
    said = [subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout for _ in range(2)]
    secrets = {one.split("-")[-1] for one in said}
    assert len(secrets) == 2 and all(len(one) == len(f"{'0' * 16}.part.csv\n") for one in secrets)


@pytest.mark.parametrize("replace", [1, [], {"files": ["/etc/x"]}, {"files": 3}, {"gone": [4]}])
def test_a_note_of_files_that_is_not_ours_does_no_harm(tmp_path, replace):
    leave(tmp_path, {**note_here(ended_process()), "replace": replace})
    finish_replacing(tmp_path, left_in(tmp_path))
    assert names(tmp_path) == [LOCK]


def test_what_ended_processes_left_is_swept_away(tmp_path):
    patterns = [
        f".trajectory-{{}}-{'a' * 16}.part.csv",
        ".plot-{}.part.png",
        ".annotated-{}.part.audio.mp4",
        ".mine-{}.csv",
    ]
    gone = ended_process()
    for number in (gone, os.getpid(), os.getppid(), 10**30):
        for name in patterns:
            (tmp_path / name.format(number)).write_text("x")
    sweep(tmp_path)
    kept = {name.format(number) for name in patterns for number in (os.getpid(), os.getppid())}
    assert {*names(tmp_path)} == kept | {f".mine-{gone}.csv", f".mine-{10**30}.csv"}
