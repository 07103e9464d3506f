"""A folder has one writer: on one machine, on several, with clocks that differ, and without locks or links."""

from __future__ import annotations

import errno
import json
import multiprocessing
import os
import subprocess
import sys
import time

import pytest

from facetrack_cli.core import claims
from facetrack_cli.core.claims import LOCK, BusyError, Claim, holder
from facetrack_cli.core.errors import OutputError
from facetrack_cli.core.sets import sweep

pytestmark = pytest.mark.skipif(os.name != "posix", reason="claims need the locks of POSIX")
ELSEWHERE = {"host": "node7", "boot": "b", "process": 1, "token": "ab12", "frame": 3}


@pytest.fixture
def no_locks(monkeypatch):
    monkeypatch.setattr(claims, "_flock", lambda file: None)


@pytest.fixture
def no_links(monkeypatch):
    def refuse(*_):
        raise OSError(errno.EPERM, os.strerror(errno.EPERM))

    monkeypatch.setattr(os, "link", refuse)


def leave(folder, note, *, silent=0.0):
    """What a process that is gone, or on another machine, left; so many seconds ago."""
    (folder / LOCK).write_text(note if isinstance(note, str) else json.dumps(note))
    then = time.time() - silent
    os.utime(folder / LOCK, (then, then))


def ours(process):
    host, boot = claims.here()
    return {**ELSEWHERE, "host": host, "boot": boot, "process": process}


def ended():
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait(60)
    return process.pid


def names(folder):
    return [path.name for path in folder.iterdir()]


def refused(folder):
    """Whether a second writer is refused, with its line; what it meets stays as it was."""
    before = (folder / LOCK).read_bytes()
    try:
        with Claim(folder):
            return False
    except BusyError as e:
        remedy = "wait until it ends, or name another folder with --out"
        assert str(e) == f"{folder}: another facetrack is writing its results here; {remedy}"
        assert (folder / LOCK).read_bytes() == before and names(folder) == [LOCK]
        return True


@pytest.mark.parametrize("without", [(), ("no_links",), ("no_locks",), ("no_links", "no_locks")])
def test_a_folder_has_one_writer(tmp_path, without, request):
    for one in without:
        request.getfixturevalue(one)
    for _ in range(2):
        with Claim(tmp_path) as claim:
            assert claim.left == {}
            note = json.loads((tmp_path / LOCK).read_text())
            assert (note["host"], note["boot"]) == claims.here() and note["process"] == os.getpid()
            assert holder(tmp_path) == note
            assert refused(tmp_path)
            claim.check()
        assert names(tmp_path) == [] and holder(tmp_path) is None


def test_signs_of_life(tmp_path, monkeypatch):
    monkeypatch.setattr(claims, "BEAT_S", 0.01)
    with Claim(tmp_path) as claim:
        size = (tmp_path / LOCK).stat().st_size
        for frame in (5, 123456):
            claim.frame, claim.frames = frame, 2 * frame
            os.utime(tmp_path / LOCK, (0, 0))
            deadline = time.monotonic() + 10
            while (tmp_path / LOCK).stat().st_mtime < 1 or holder(tmp_path)["frame"] != frame:
                assert time.monotonic() < deadline
            found = holder(tmp_path)
            assert found["frames"] == 2 * frame and found["seconds"] >= 0
        claim.note({"run": "x" * size})
        claim.note({"run": ""})
        assert (tmp_path / LOCK).stat().st_size > size, "a note never shrinks"
        assert holder(tmp_path)["run"] == ""


@pytest.mark.parametrize("without", [(), ("no_locks",)])
def test_another_machine_is_believed_for_a_minute(tmp_path, without, request):
    for one in without:
        request.getfixturevalue(one)
    leave(tmp_path, ELSEWHERE, silent=50)
    assert refused(tmp_path) and holder(tmp_path) == ELSEWHERE
    leave(tmp_path, ELSEWHERE, silent=70)
    assert holder(tmp_path) is None
    with Claim(tmp_path) as claim:
        assert claim.left == ELSEWHERE
        claim.check()
    assert names(tmp_path) == []


@pytest.mark.parametrize("hours", [-5, 5])
def test_the_clock_is_that_of_the_file_system(tmp_path, monkeypatch, hours):
    leave(tmp_path, ELSEWHERE)
    (tmp_path / "late").mkdir()
    leave(tmp_path / "late", ELSEWHERE, silent=70)
    clock = time.time
    monkeypatch.setattr(time, "time", lambda: clock() + 3600 * hours)
    with Claim(tmp_path / "late"):
        pass
    (tmp_path / "late").rmdir()
    assert refused(tmp_path)


def test_of_this_machine_a_process_that_ended_leaves_nothing(tmp_path, monkeypatch):
    leave(tmp_path, ours(os.getppid()))
    with Claim(tmp_path) as claim:  # it lives, but does not hold the lock: the number was given again
        assert claim.left["process"] == os.getppid()
    monkeypatch.setattr(claims, "_flock", lambda file: None)
    leave(tmp_path, ours(os.getppid()))
    assert refused(tmp_path)
    leave(tmp_path, ours(ended()))
    assert holder(tmp_path) is None
    with Claim(tmp_path):
        pass
    leave(tmp_path, ours(os.getppid()), silent=70)
    with Claim(tmp_path):
        pass


@pytest.mark.parametrize("text", ["", "x" * 50, "[1]", '{"process": 1}', '{"host": 1, "boot": [], "process": "x"}'])
def test_notes_that_say_nothing(tmp_path, text, monkeypatch):
    leave(tmp_path, text)
    with Claim(tmp_path):
        pass
    monkeypatch.setattr(claims, "_flock", lambda file: None)
    leave(tmp_path, text)
    assert refused(tmp_path), "it may be about to say who it is"
    leave(tmp_path, text, silent=70)
    with Claim(tmp_path):
        pass


def test_a_torn_note_is_read_again(tmp_path, monkeypatch):
    text = json.dumps(ELSEWHERE).ljust(5000)
    leave(tmp_path, text[:40] + "\0" * 4960)
    monkeypatch.setattr(claims.time, "sleep", lambda _: leave(tmp_path, text))
    assert holder(tmp_path) == ELSEWHERE


def test_one_that_is_taken_over_notices(tmp_path, monkeypatch):
    monkeypatch.setattr(claims, "_flock", lambda file: None)
    with Claim(tmp_path) as suspended:
        suspended.check()
        os.utime(tmp_path / LOCK, (0, 0))
        with Claim(tmp_path) as other:
            other.check()
            with pytest.raises(OutputError, match="another facetrack has taken this folder over"):
                suspended.check()
            suspended.note({"run": 1})
            assert "run" not in holder(tmp_path), "nor does it write into the other's note"
        with pytest.raises(OutputError, match="another facetrack has taken this folder over"):
            suspended.check()


def test_what_a_take_over_left_is_no_harm(tmp_path):
    leave(tmp_path, ELSEWHERE, silent=70)
    marker = tmp_path / f"{LOCK}.ab12"
    marker.touch()
    with pytest.raises(BusyError), Claim(tmp_path):
        pass
    os.utime(marker, (0, 0))
    with Claim(tmp_path):
        marker.touch()
        sweep(tmp_path)
        assert names(tmp_path) == [LOCK]


def _take(folders, barrier, mine):
    """Take over what is stale in each folder, at the same moment as another; write which it got."""
    claims._flock = lambda file: None
    claims.here = lambda: (f"node{mine}", "b")
    for folder in folders:
        barrier.wait(60)
        try:
            with Claim(folder):
                with (folder / "log").open("a") as log:
                    log.write(f"{mine}\n")
                barrier.wait(60)
        except BusyError:
            barrier.wait(60)


def test_of_two_that_take_over_at_once_one_wins(tmp_path):
    folders = [tmp_path / f"{i}" for i in range(60)]
    for folder in folders:
        folder.mkdir()
        leave(folder, ELSEWHERE, silent=70)
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


def test_a_folder_that_is_removed_meanwhile_is_made_again(tmp_path):
    with Claim(tmp_path / "a" / "b"):
        assert names(tmp_path / "a" / "b") == [LOCK]


def test_a_folder_that_cannot_be_written(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "pwrite", full)
    with pytest.raises(OutputError, match=r"\.facetrack\.lock: the disk is full"), Claim(tmp_path):
        pass
    assert names(tmp_path) == []
