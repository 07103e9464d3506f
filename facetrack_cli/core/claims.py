"""The one writer of a folder, among processes of this machine and of others that share its file system.

A claim is a file that appears together with its note: who, since when, how far. It is locked by flock, where the file
system can, and its time is set every `BEAT_S` seconds. It is stale if this machine's lock is free, if its process here
has ended, or if another machine's was silent for `STALE_S` by the file system's own clock; then it is taken over.
"""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import socket
import threading
import time
from collections.abc import Callable, Mapping
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Final

from facetrack_cli.core.errors import BusyError, OutputError
from facetrack_cli.core.files import cannot_write

with contextlib.suppress(ImportError):  # Windows: nothing keeps two apart
    import fcntl

LOCK: Final = ".facetrack.lock"
BEAT_S = 10.0  # between two signs of life
STALE_S = 60.0  # of silence, after which a claim of another machine is taken over
_SIZE: Final = 4096  # of a note, padded: rewritten it takes no space of a full disk


class Claim:
    """The one writer of a folder, in a `with`; BusyError for a second one, also on another machine that sees it.

    A process that is killed leaves the file: `left` is what it noted there, {} without a note. `frame` and `frames`
    (in all, None if not known) are noted with every sign of life.
    """

    def __init__(self, folder: Path) -> None:
        self.left: Mapping[str, Any] = {}
        self.frame, self.frames = 0, None  # type: int, int | None
        self._folder, self._path = folder, folder / LOCK
        self._token = secrets.token_hex(8)
        self._own = folder / f".claim-{self._token}-{os.getpid()}.part"  # as others that `sweep` removes
        self._file: int | None = None
        self._said: dict[str, Any] = {}
        self._began = time.monotonic()
        self._size = _SIZE
        self._writing, self._ended = threading.Lock(), threading.Event()

    def __enter__(self) -> Claim:
        if os.name != "posix":
            return self
        host, boot = here()
        self._said = {"host": host, "boot": boot, "process": os.getpid(), "token": self._token, "began": utc_now()}
        self._began = time.monotonic()
        try:
            while not self._gained():
                self._folder.mkdir(parents=True, exist_ok=True)  # whoever made it may have removed it
        except OSError as e:
            self.__exit__()
            raise cannot_write(self._path, e) from e
        threading.Thread(target=self._beat, name="claim", daemon=True).start()
        return self

    def note(self, record: Mapping[str, Any]) -> None:
        """Note what is being done, for whoever finds the folder meanwhile, or after a kill. Raises OutputError."""
        with self._writing:
            self._said |= record
            try:
                self._write()
            except OSError as e:
                raise cannot_write(self._path, e) from e

    def check(self) -> None:
        """OutputError if the claim was taken over while this process was suspended, or cut off."""
        if self._file is None:
            return
        with contextlib.suppress(OSError):
            if _note(self._path).get("token") == self._token:
                return
        raise OutputError(
            f"{self._folder}: another facetrack has taken this folder over, since this one gave no sign of life for "
            f"{STALE_S:.0f} s; what it writes there stays, nothing was replaced"
        )

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        with self._writing:
            file, self._file = self._file, None
        if file is not None:
            with contextlib.suppress(OSError):
                if _same(file, self._path):
                    self._path.unlink()
            os.close(file)

    # --- how it is gained ---

    def _gained(self) -> bool:
        with contextlib.suppress(FileNotFoundError):  # another process removes what it was, or sweeps the folder
            return self._appear() or self._take_over()
        return False

    def _appear(self) -> bool:
        """Whether there was no claim, and now there is ours."""
        if self._path.exists():
            return False
        file, kept = self._made(), False
        try:
            try:
                os.link(self._own, self._path)
            except FileExistsError:  # also of a call that a server was sent twice
                pass
            except OSError:  # of a file system without links
                return self._appear_empty()
            kept = _same(file, self._path)
            self._file = file if kept else None
            return kept
        finally:
            self._own.unlink(missing_ok=True)
            if not kept:
                os.close(file)

    def _appear_empty(self) -> bool:
        try:
            file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        except FileExistsError:
            return False
        if _flock(file) is not False:
            self._file = file
            self._write()
            if _same(file, self._path):
                return True
            self._file = None
        os.close(file)  # somebody has taken it for what a kill left
        return False

    def _take_over(self) -> bool:
        """Whether there was a stale claim, and now there is ours. Raises BusyError."""
        try:
            old = _opened(self._path)
        except FileNotFoundError:
            return False
        try:
            locked = _flock(old)
            note = {} if locked is False else _read(old)
            if locked is False or (_same(old, self._path) and _lives(note, locked, lambda: self._age(old))):
                raise self._busy()
            return _same(old, self._path) and self._replace(old, note)
        finally:
            os.close(old)

    def _replace(self, old: int, note: Mapping[str, Any]) -> bool:
        """Put ours in the place of a stale claim, unless another process does."""
        token = note.get("token")
        named = token if isinstance(token, str) and token.isalnum() else "none"
        marker = self._path.with_name(f"{LOCK}.{named[:32]}")
        try:
            os.close(os.open(marker, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        except FileExistsError:
            with contextlib.suppress(FileNotFoundError):
                file = os.open(marker, os.O_RDONLY)
                try:
                    if abs(self._age(file)) < STALE_S:
                        raise self._busy() from None
                finally:
                    os.close(file)
                marker.unlink()
            return False
        try:
            if not _same(old, self._path) or _note(self._path).get("token") != token:
                return False
            self._file = self._made()
            self._own.replace(self._path)
            self.left = note
            return True
        except FileNotFoundError:  # swept by another process
            if self._file is not None:
                os.close(self._file)
            self._file = None
            return False
        finally:
            marker.unlink(missing_ok=True)

    def _made(self) -> int:
        """A file of our own with the note, locked."""
        file = os.open(self._own, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o666)
        try:
            _flock(file)
            os.pwrite(file, self._text(), 0)
        except OSError:
            os.close(file)
            self._own.unlink(missing_ok=True)
            raise
        return file

    def _busy(self) -> BusyError:
        remedy = "wait until it ends, or name another folder with --out"
        return BusyError(f"{self._folder}: another facetrack is writing its results here; {remedy}")

    def _age(self, file: int) -> float:
        """The seconds since a file was changed, by the clock of its file system."""
        try:
            with self._own.open("wb") as now:
                now.write(b"\n")
                now.flush()
                os.utime(now.fileno())
            return self._own.stat().st_mtime - os.fstat(file).st_mtime
        finally:
            self._own.unlink(missing_ok=True)

    # --- what it says ---

    def _beat(self) -> None:
        while not self._ended.wait(BEAT_S):
            with self._writing, contextlib.suppress(OSError):
                if self._file is not None:
                    self._write()

    def _write(self) -> None:
        if self._file is not None:
            try:
                os.pwrite(self._file, self._text(), 0)
            finally:
                os.utime(self._file)

    def _text(self) -> bytes:
        """The note, never shorter than it was."""
        seconds = round(time.monotonic() - self._began, 1)
        text = json.dumps({**self._said, "frame": self.frame, "frames": self.frames, "seconds": seconds}).encode()
        self._size = max(self._size, len(text) + 1)
        return text.ljust(self._size - 1) + b"\n"


def holder(folder: Path) -> Mapping[str, Any] | None:
    """The note of who writes into a folder, {} if it cannot be read; None if nobody does.

    Nothing is written, so of another machine this one's clock must say how long it has been silent.
    """
    try:
        note, silent = _note(folder / LOCK), time.time() - (folder / LOCK).stat().st_mtime
    except OSError:
        return None
    return note if _lives(note, None, lambda: silent) else None


def utc_now() -> str:
    """The time as ISO 8601 in UTC, in whole seconds."""
    return datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")


def here() -> tuple[str, str]:
    """This machine's name, and what its processes have in common: since when it runs, and who counts them."""
    boot = ""
    with contextlib.suppress(OSError):
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        boot += f" {Path('/proc/self/ns/pid').readlink()}"  # two containers have processes of the same number
    return socket.gethostname(), boot


def process_runs(number: int) -> bool:
    """Whether this machine has a process of that number."""
    try:
        os.kill(number, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # it is somebody else's
        pass
    return True


def _lives(note: Mapping[str, Any], locked: bool | None, age: Callable[[], float]) -> bool:
    """Whether the one that noted this still works; `locked` is whether we could lock its file, None if nobody can."""
    ours = (note.get("host"), note.get("boot")) == here()
    if locked and (ours or not note.get("token")):
        return False
    process = note.get("process")
    if ours and isinstance(process, int) and process > 0 and not process_runs(process):
        return False
    return abs(age()) < STALE_S


def _flock(file: int) -> bool | None:
    """Lock a file; False if another process has, None if the file system cannot."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _opened(path: Path) -> int:
    try:
        return os.open(path, os.O_RDWR)  # some file systems lock no other
    except PermissionError:  # another user's
        return os.open(path, os.O_RDONLY)


def _same(file: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file), path.stat())
    except FileNotFoundError:
        return False


def _note(path: Path) -> dict[str, Any]:
    file = os.open(path, os.O_RDONLY)  # opened anew, so that a cache of the file system is
    try:
        return _read(file)
    finally:
        os.close(file)


def _read(file: int) -> dict[str, Any]:
    """What is noted in a claim; {} if that is nothing."""
    for _ in range(5):
        text = os.pread(file, 1 << 20, 0)
        with contextlib.suppress(ValueError):
            found = json.loads(text)
            return found if isinstance(found, dict) else {}
        if len(text) < _SIZE:  # of an older version, or none
            break
        time.sleep(0.01)  # torn: it is being written
    return {}
