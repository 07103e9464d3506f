"""What a process that writes into a folder leaves there when it is killed, or is silent on another machine."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from functools import cache
from pathlib import Path

from filelock import SoftFileLease

from facetrack_cli.run_folder import lease as leases

ELSEWHERE = {"host": "node7", "boot": "b", "process": 1, "token": "ab12", "frame": 3}


def leave(folder, note, *, host="node7", process=1, silent_s=0.0):
    """The lease and the note of a process of a machine, of so many seconds ago."""
    lease, then = folder / leases.LOCK, time.time() - silent_s
    with contextlib.suppress(FileNotFoundError):
        os.unlink(lease)  # noqa: PTH108 -- tests make Path.unlink do nothing
    owner = f"filelock/2\npid={process}\nhost={host}\nmode=lease\ntoken={'a' * 32}\nduration={leases.LEASE_S!r}\n"
    lease.write_text(owner)
    (folder / leases.NOTE).write_text(note if isinstance(note, str) else json.dumps(note))
    os.utime(lease, (then, then))


def leave_here(folder, note, process=None):
    """Those of a process of this machine, by default of one that has ended."""
    leave(folder, note, host=host_here(), process=process or ended_process())


def abandon(held):
    """Leave a lease as a kill leaves it; for `FolderLease.__exit__`."""
    note, number = leases.left_in(held._folder), ended_process()
    with contextlib.suppress(ValueError):
        held._file.close()
    leave_here(held._folder, {**note, "process": number} if note else "", number)


def note_here(process):
    host, boot = leases.here()
    return {**ELSEWHERE, "host": host, "boot": boot, "process": process}


@cache
def host_here():
    """What filelock calls this machine."""
    with tempfile.TemporaryDirectory() as folder, SoftFileLease(Path(folder) / "x") as lease:
        return lease.owner.hostname


def ended_process():
    process = subprocess.Popen([sys.executable, "-S", "-c", ""])
    process.wait(60)
    return process.pid
