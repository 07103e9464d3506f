"""Run the case of a hostile input, apart from everything else, and say what is wrong with how it was answered."""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import sys
import time
import traceback
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

MOST_S, MOST_BYTES, MOST_LETTERS = 30, 1 << 30, 1000
DOCUMENTED = (0, 2, 3, 4, 5, 6)
NOISE = re.compile(
    r"Traceback|internal error|please report|not enough memory|^\S*\.py:\d+: |Exception ignored", re.MULTILINE
)
CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")


@dataclass
class Case:
    """A command line in a folder of its own; an error must name one of `named`, unless there is none."""

    name: str
    folder: Path
    argv: list[str] = field(default_factory=list)
    named: tuple[str, ...] = ()
    files: dict[Path, bytes] = field(default_factory=dict)  # those that must stay as they are

    def put(self, name: str, content: bytes) -> str:
        """Write a hostile file; its name."""
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        self.files[path] = content
        self.named = (*self.named, name)
        return name


class Answer(NamedTuple):
    code: int
    stdout: str
    stderr: str
    seconds: float
    rose: int  # bytes of memory above what the driver itself has
    faults: list[str]


def answer(case: Case) -> Answer:
    """Run a case in a process that is forked from this one, and judge it."""
    before = set(case.folder.rglob("*"))
    streams = [case.folder.parent / "stdout", case.folder.parent / "stderr"]
    began = time.monotonic()
    child = os.fork()
    if child == 0:
        _child(case, streams)
    code, rose, late = _wait(child, began)
    seconds = time.monotonic() - began
    stdout, stderr = (path.read_text(encoding="utf-8", errors="backslashreplace") for path in streams)
    found = Answer(code, stdout, stderr, seconds, rose, [])
    found.faults.extend(_faults(case, before, found, late))
    return found


def _child(case: Case, streams: list[Path]) -> None:
    code = 99
    try:
        os.setsid()
        os.chdir(case.folder)
        for number, path in enumerate(streams, start=1):
            os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        limit = _size_now() + (3 * MOST_BYTES)
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (MOST_S, MOST_S))
        from facetrack_cli.__main__ import main

        code = int(main(case.argv))
        sys.stdout.flush()
        sys.stderr.flush()
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
    finally:
        os._exit(code)


def _size_now() -> int:
    """Bytes of address space, where the system says."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    except OSError:
        return 4 << 30


def _wait(child: int, began: float) -> tuple[int, int, bool]:
    pause = 0.002
    while True:
        gone, status, usage = os.wait4(child, os.WNOHANG)
        if gone:
            own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            unit = 1 if sys.platform == "darwin" else 1024
            code = os.waitstatus_to_exitcode(status)
            return code, (usage.ru_maxrss - own) * unit, code in (-signal.SIGXCPU, -signal.SIGKILL)
        if time.monotonic() - began > 4 * MOST_S:  # the machine may have other work, but a wait for nothing has an end
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return -signal.SIGKILL, 0, True
        time.sleep(pause)
        pause = min(0.05, pause * 1.2)


def _faults(case: Case, before: set[Path], found: Answer, late: bool) -> list[str]:
    folder, faults = case.folder, []
    if late:
        return [f"takes more than {MOST_S} s"]
    if found.code not in DOCUMENTED:
        faults.append(f"exit code {found.code}")
    if found.rose > MOST_BYTES:
        faults.append(f"takes {found.rose / 1e9:.1f} GB")
    if noise := NOISE.search(found.stderr):
        faults.append(f"says {noise[0]!r}")
    if CONTROL.search(found.stderr.replace("\r\n", "\n")):
        faults.append("control characters on standard error")
    lines = [line for line in found.stderr.splitlines() if line.startswith("facetrack: error: ")]
    checks = case.argv[:2] == ["recipes", "check"]
    if found.code in (2, 3) and not checks:
        if len(lines) != 1:
            faults.append(f"{len(lines)} error lines")
        if case.named and not any(name in line for line in lines for name in case.named):
            faults.append(f"the error does not name {' or '.join(case.named)}")
    if found.code in (5, 6) and not (lines or found.stdout):
        faults.append("says nothing")
    said = lines + (found.stdout.splitlines() if checks else [])
    typed = sum(map(len, case.argv))  # may be quoted
    if any(len(line) > MOST_LETTERS + 2 * typed for line in said):
        faults.append(f"a line of {max(map(len, said))} characters")
    if (folder / "pwned").exists():
        faults.append("runs code of the input")
    made = [path for path in folder.rglob("*") if path not in before and path.is_file()]
    faults += [f"leaves {path.relative_to(folder)}" for path in made if ".part" in path.name]
    if found.code in (2, 3) and not _says_incomplete(folder):
        faults += [f"fails, and leaves {path.relative_to(folder)}" for path in made if ".part" not in path.name]
    for path, content in case.files.items():
        if not path.is_file() or path.read_bytes() != content:
            faults.append(f"changes {path.relative_to(folder)}")
    return faults


def _says_incomplete(folder: Path) -> bool:
    for path in folder.glob("out/**/trajectory.json"):
        try:
            return json.loads(path.read_text(encoding="utf-8"))["complete"] is False
        except (ValueError, KeyError):
            return False
    return False
