"""A folder has one writer: on one machine, on several, and with clocks that differ."""

import errno
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from facetrack_cli.core.errors import BusyError, InputError, OutputError
from facetrack_cli.core.files import own_mark, temporary_path
from facetrack_cli.run_folder import lease as leases
from facetrack_cli.run_folder.lease import LOCK, NOTE, FolderLease, finish_replacing, holder, left_in, sweep
from facetrack_cli.run_folder.manifest import read_run, trajectory_of
from tests.support.damage import raising
from tests.support.leases import ELSEWHERE, abandon, ended_process, leave, leave_here, note_here
from tests.support.sway import names

LEASE_S = 0.6


@pytest.fixture
def soon(monkeypatch):
    """A lease of less than a second."""
    monkeypatch.setattr(leases, "LEASE_S", LEASE_S)
    monkeypatch.setattr(leases, "BEAT_S", 0.1)


def is_refused(folder):
    """Whether a second writer is refused, with its line; the lease stays as it was."""
    before = (folder / LOCK).read_bytes()
    try:
        with FolderLease(folder):
            return False
    except BusyError as e:
        remedy = "wait until it ends, or name another folder"
        assert str(e) == f"{folder}: another facetrack is writing its results here; {remedy}"
        assert (folder / LOCK).read_bytes() == before and names(folder) == [LOCK, NOTE]
        return True


def test_a_folder_has_one_writer(tmp_path):
    for _ in range(2):
        with FolderLease(tmp_path / "new" / "folder") as lease:
            folder = tmp_path / "new" / "folder"
            assert lease.stale_note == {}
            note = json.loads((folder / NOTE).read_text())
            assert (note["host"], note["boot"]) == leases.here() and note["process"] == os.getpid()
            assert holder(folder) == note
            assert is_refused(folder)
            lease.check()
            for reader in (read_run, trajectory_of):
                with pytest.raises(InputError, match="a run is being written here; wait until it ends"):
                    reader(folder)
        assert names(folder) == [] and holder(folder) is None
    with pytest.raises(InputError, match=r"has no trajectory\.json"):
        trajectory_of(folder)


def test_signs_of_life(tmp_path, soon, monkeypatch):
    with FolderLease(tmp_path) as lease:
        size = (tmp_path / NOTE).stat().st_size
        os.utime(tmp_path / LOCK, (0, 0))
        assert is_refused(tmp_path), "it is heard again meanwhile"
        assert (tmp_path / LOCK).stat().st_mtime > 1
        for frame in (5, 123456):
            time.sleep(0.1)
            lease.progress(frame, 2 * frame)
            found = holder(tmp_path)
            assert (found["frame"], found["frames"]) == (frame, 2 * frame) and found["seconds"] >= 0
        monkeypatch.setattr(leases, "BEAT_S", 10.0)
        lease.progress(7, None)
        assert holder(tmp_path)["frame"] == 123456, "progress is noted now and then"
        lease.note({"run": "x" * size})
        lease.note({"run": ""})
        assert (tmp_path / NOTE).stat().st_size > size, "a note never shrinks"
        assert holder(tmp_path)["run"] == ""


def test_another_machine_is_believed_for_a_minute(tmp_path, monkeypatch):
    clock = time.time
    for hours in (0, -5, 5):
        leave(tmp_path, ELSEWHERE, silent_s=50)
        with monkeypatch.context() as patched:
            patched.setattr(time, "time", lambda hours=hours: clock() + 3600 * hours)
            assert is_refused(tmp_path), "the clock is that of the file system"


def test_who_is_silent_is_taken_over(tmp_path, soon, capsys):
    leave(tmp_path, ELSEWHERE, silent_s=70)
    assert holder(tmp_path) is None
    began = time.monotonic()
    with FolderLease(tmp_path) as lease:
        assert lease.stale_note == ELSEWHERE and time.monotonic() - began > LEASE_S
        lease.check()
    assert names(tmp_path) == []
    assert f"{tmp_path}: whoever writes here is silent; waiting" in capsys.readouterr().err
    leave(tmp_path, ELSEWHERE, silent_s=70)
    with pytest.raises(BusyError), FolderLease(tmp_path, stopped=lambda: True):
        pass


def test_of_this_machine_a_process_that_ended_leaves_nothing(tmp_path):
    leave_here(tmp_path, note_here(os.getppid()), os.getppid())
    assert is_refused(tmp_path)
    number = ended_process()
    leave_here(tmp_path, note_here(number), number)
    assert holder(tmp_path) is None
    began = time.monotonic()
    with FolderLease(tmp_path) as lease:
        assert lease.stale_note["process"] == number and time.monotonic() - began < 1


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_process_that_is_suspended_and_comes_back(tmp_path, soon):
    code = f"""
import sys
from pathlib import Path
from facetrack_cli.run_folder import lease
lease.LEASE_S = {LEASE_S}
with lease.FolderLease(Path(sys.argv[1])) as held:
    print("held", flush=True)
    input()
    held.check()
"""
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    process = subprocess.Popen([sys.executable, "-c", code, tmp_path], **pipes)
    assert process.stdout.readline() == b"held\n" and is_refused(tmp_path)
    process.send_signal(signal.SIGSTOP)
    time.sleep(LEASE_S + 0.1)
    with FolderLease(tmp_path):
        process.send_signal(signal.SIGCONT)
        assert b"another facetrack has taken this folder over" in process.communicate(b"\n")[1]
        assert is_refused(tmp_path)
    assert names(tmp_path) == []


NO_NOTES = ["", "x" * 50, "[1]", '{"process": 1}', '{"host": 1, "boot": [], "process": "x"}']
NO_FILES = [1, [], {"files": ["/etc/x"]}, {"files": 3}, {"gone": [4]}]


def test_notes_that_say_nothing(tmp_path):
    for text in NO_NOTES:
        leave_here(tmp_path, text)
        with FolderLease(tmp_path):
            pass
        assert names(tmp_path) == []
    for replaced in NO_FILES:
        leave_here(tmp_path, {**note_here(ended_process()), "replace": replaced})
        finish_replacing(tmp_path, left_in(tmp_path))
        assert names(tmp_path) == [LOCK, NOTE]


@pytest.mark.parametrize("text", ["", "x" * 50, "filelock/2\npid=1\nho"])
def test_a_lease_that_says_nothing(tmp_path, soon, text):
    (tmp_path / LOCK).write_text(text)
    with pytest.raises(BusyError), FolderLease(tmp_path):  # its process may be about to write who it is
        pass
    os.utime(tmp_path / LOCK, (0, 0))
    with FolderLease(tmp_path):
        pass
    assert names(tmp_path) == []


def test_a_lease_of_another_length_and_a_note_that_is_being_written(tmp_path, monkeypatch):
    text = json.dumps(ELSEWHERE).ljust(5000)
    leave(tmp_path, text[:40] + "\0" * 4960, silent_s=50)
    with monkeypatch.context() as patched:
        patched.setattr(leases.time, "sleep", lambda _: leave(tmp_path, text, silent_s=70))
        assert holder(tmp_path) == ELSEWHERE, "it is read again"
    monkeypatch.setattr(leases, "LEASE_S", 30.0)
    with pytest.raises(OutputError, match="if nobody writes here, remove it"), FolderLease(tmp_path):
        pass


def test_a_process_that_is_taken_over_notices(tmp_path):
    with FolderLease(tmp_path) as suspended:
        suspended.check()
        leave_here(tmp_path, {**ELSEWHERE, "run": 1})
        with FolderLease(tmp_path) as other:
            other.check()
            assert other.stale_note["run"] == 1
            with pytest.raises(OutputError, match="another facetrack has taken this folder over"):
                suspended.prepare([], [tmp_path / LOCK])
            suspended.note({"run": 2})
            assert "run" not in holder(tmp_path), "nor does it write into the other's note"
        with pytest.raises(OutputError, match="another facetrack has taken this folder over"):
            suspended.check()


def test_what_was_not_recovered_stays_in_the_next_note(tmp_path):
    leave_here(tmp_path, {**note_here(ended_process()), "run": 1})
    for _ in range(2):
        lease = FolderLease(tmp_path).__enter__()
        assert lease.stale_note["run"] == 1
        abandon(lease)
    with FolderLease(tmp_path) as lease:
        lease.note({"before": None})
        assert "run" not in holder(tmp_path)


def _take(folders, barrier, mine):
    """Take over the stale lease of each folder, at the same moment as another process; write who got it."""
    leases.LEASE_S = LEASE_S
    for folder in folders:
        barrier.wait(60)
        try:
            with FolderLease(folder):
                with (folder / "log").open("a") as log:
                    log.write(f"{mine}\n")
                barrier.wait(60)
        except BusyError:
            barrier.wait(60)


def test_of_two_at_once_one_wins(tmp_path, soon):
    kinds = ["here"] * 4 + ["elsewhere"] + ["nothing"] * 4
    folders = [tmp_path / f"{i}" for i in range(len(kinds))]
    for folder, left in zip(folders, kinds, strict=True):
        folder.mkdir()
        if left == "here":
            leave_here(folder, note_here(ended_process()))
        elif left == "elsewhere":
            leave(folder, ELSEWHERE, silent_s=70)
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


@pytest.mark.parametrize("which", [LOCK, NOTE])
def test_a_folder_that_cannot_be_written(tmp_path, monkeypatch, which):
    patched = {LOCK: (leases.SoftFileLease, "_acquire"), NOTE: (Path, "write_bytes")}
    monkeypatch.setattr(*patched[which], raising(OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))))
    with pytest.raises(OutputError, match=r"\.facetrack\.lock: the disk is full"), FolderLease(tmp_path):
        pass
    assert names(tmp_path) == []
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"cannot be written: .*; work in a copy of the folder$"):
        FolderLease(tmp_path / "file" / "run").__enter__()


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


@pytest.mark.parametrize("name", [LOCK, NOTE])
def test_a_lease_that_is_a_link_or_a_pipe(tmp_path, name):
    (tmp_path / name).symlink_to(tmp_path / "mine")
    (tmp_path / "mine").write_text("kept")
    with pytest.raises(OutputError, match="is a link"), FolderLease(tmp_path):
        pass
    assert (tmp_path / "mine").read_text() == "kept"
    (tmp_path / name).unlink()
    os.mkfifo(tmp_path / name)
    assert left_in(tmp_path) == {}


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
