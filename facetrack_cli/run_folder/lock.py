"""The one writer of a folder, among processes of this machine and of others that share its file system.

The lock is a file with a note: who writes, since when, how far, and what is to be done after a kill. It is held by
flock, where the file system has it, and its time is set every `BEAT_S` seconds. It is stale if its flock is free on
this machine, if its process here has ended, or if another machine was silent for `STALE_S` by the file system's own
clock. The next writer then takes it over, in place.

Several files are replaced together, all or none: once the new files are on the disk, the note lists them, and then each
is renamed. Whoever finds such a note finishes the renames.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import secrets
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Final

from facetrack_cli.core.errors import BusyError, OutputError
from facetrack_cli.core.files import check_plain, own_mark, sync, temporary_path, writing
from facetrack_cli.trajectory.people import STILLS

with contextlib.suppress(ImportError):  # Windows: nothing keeps two writers apart
    import fcntl

LOCK: Final = ".facetrack.lock"
BEAT_S = 10.0  # between two signs of life
STALE_S = 60.0  # of silence, after which the lock of another machine is taken over
SETTLE_S = 0.5  # in which a process without a common flock sees that another one takes over as well
_NOTE_BYTES: Final = 4096  # a note is padded to this, so that a full disk has space for the next one
_MARK: Final = re.compile(r"\d+-[0-9a-f]{16}")
_PART: Final = re.compile(r"\..+-(\d+)(-[0-9a-f]{16})?\.part\b")


class FolderLock:
    """The one writer of a folder, in a `with`; BusyError for a second one, also on another machine that sees it.

    A process that is killed leaves the file: `stale_note` is its note, {} without one. `frame` and `frames` (in all,
    None if not known) are noted with every sign of life.
    """

    def __init__(self, folder: Path) -> None:
        self.stale_note: Mapping[str, Any] = {}
        self.frame, self.frames = 0, None  # type: int, int | None
        self._folder, self._path = folder, folder / LOCK
        self._token = secrets.token_hex(8)
        self._file: int | None = None
        self._note: dict[str, Any] = {}
        self._began, self._bytes = time.monotonic(), _NOTE_BYTES
        self._writing, self._ended = threading.Lock(), threading.Event()

    def __enter__(self) -> FolderLock:
        if os.name != "posix":
            return self
        check_plain(self._path)
        host, boot = here()
        self._note = {"host": host, "boot": boot, "process": os.getpid(), "token": self._token, "began": utc_now()}
        self._note["mark"] = own_mark()
        with writing(self._path):
            while not self._acquire():
                self._folder.mkdir(parents=True, exist_ok=True)  # the process that made it may have removed it
        threading.Thread(target=self._beat, name="lock", daemon=True).start()
        return self

    def note(self, record: Mapping[str, Any], *, on_disk: bool = False) -> None:
        """Note what is being done, for others and for after a kill; `on_disk`: or a power loss. Raises OutputError."""
        with self._writing, writing(self._path):
            self._note |= record
            self._write()
            if on_disk and self._file is not None:
                os.fsync(self._file)
                sync(self._folder)

    def check(self) -> None:
        """OutputError if the lock was taken over while this process was suspended, or cut off."""
        if self._note and not self._is_ours():
            raise OutputError(
                f"{self._folder}: another facetrack has taken this folder over, since this one gave no sign of life "
                f"for {STALE_S:.0f} s; what it writes there stays, nothing was replaced"
            )

    def prepare(self, files: Sequence[Path], gone: Sequence[Path] = ()) -> None:
        """Note, on the disk, that the temporary files of these paths replace them, and that those `gone` are removed.

        From here on all of it is done, whatever ends the program: by `commit`, or by whoever finds the note. Raises
        OSError; OutputError if the lock was taken over, and nothing is replaced then.
        """
        for path in files:
            sync(temporary_path(path))
        self.check()
        listed = {
            key: [str(one.relative_to(self._folder)) for one in those]
            for key, those in (("files", files), ("gone", gone))
        }
        self.note({"process": os.getpid(), "mark": own_mark(), "replace": listed}, on_disk=True)

    def commit(self) -> None:
        """Replace and remove what is prepared. Raises OutputError."""
        finish_replacing(self._folder, self._note)
        self.note({"replace": None})

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        with self._writing:
            file, self._file = self._file, None
        if file is not None:
            # with files left to be replaced the note stays
            if self._is_ours() and not self._note.get("replace"):
                self._path.unlink(missing_ok=True)
            os.close(file)

    def _acquire(self) -> bool:
        """Whether the lock is ours now; if not, try again. Raises BusyError, OSError."""
        try:
            file, is_new = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666), True
        except FileNotFoundError:
            return False
        except FileExistsError:
            file, is_new = -1, False
        try:
            if is_new:
                os.fchmod(file, self._folder.stat().st_mode & 0o666)  # who may write here may take it over
            else:
                file = os.open(self._path, os.O_RDWR)
            can_lock = _flock(file)
            if not _is_at(file, self._path):
                return False
            left = {} if is_new else self._stale(file, can_lock)
            if can_lock is False:
                raise self._busy()
            self._file, self._note["before"] = file, left.get("before") or left or None
            self._write(new=True)
            if not is_new and (can_lock is None or left.get("host") != here()[0]):
                time.sleep(SETTLE_S)  # of two processes that take over at once, the last one that writes has the lock
                if not self._is_ours():
                    raise self._busy()
            self.stale_note = self._note["before"] or {}
            return True
        except FileNotFoundError:  # its process has removed it
            return False
        except BaseException as e:
            self._file = None
            if is_new and isinstance(e, OSError):
                self._path.unlink(missing_ok=True)
            raise
        finally:
            if self._file is None and file >= 0:
                os.close(file)

    def _stale(self, file: int, can_lock: bool | None) -> dict[str, Any]:
        """The note of a lock whose process has ended. Raises BusyError for any other."""
        left = {} if can_lock is False else _read(file)
        if can_lock is not False and not left.get("token"):
            time.sleep(SETTLE_S)  # its process may be about to write who it is
            left = _read(file)
        if can_lock is False or is_alive(left, can_lock, lambda: self._age(file)):
            raise self._busy()
        return left

    def _busy(self) -> BusyError:
        remedy = "wait until it ends, or name another folder with --out"
        return BusyError(f"{self._folder}: another facetrack is writing its results here; {remedy}")

    def _age(self, file: int) -> float:
        """The seconds since a file was changed, by the clock of its file system."""
        with tempfile.TemporaryFile(dir=self._folder) as now:
            os.utime(now.fileno())
            return os.fstat(now.fileno()).st_mtime - os.fstat(file).st_mtime

    def _is_ours(self) -> bool:
        with contextlib.suppress(OSError):
            return _read_path(self._path).get("token") == self._token
        return False

    def _beat(self) -> None:
        while not self._ended.wait(BEAT_S):
            with self._writing, contextlib.suppress(OSError):
                self._write()

    def _write(self, *, new: bool = False) -> None:
        """Write the note, never shorter than it was; not into the note of a process that has taken over."""
        if self._file is None or not (new or self._is_ours()):
            return
        seconds = round(time.monotonic() - self._began, 1)
        text = json.dumps({**self._note, "frame": self.frame, "frames": self.frames, "seconds": seconds}).encode()
        self._bytes = max(self._bytes, len(text) + 1)
        try:
            os.pwrite(self._file, text.ljust(self._bytes - 1) + b"\n", 0)
        finally:
            os.utime(self._file)  # which also makes NFS pass the note on


def finish_replacing(folder: Path, note: Mapping[str, Any]) -> None:
    """Replace and remove the files that a note lists, as far as that is not done; may be repeated. OutputError."""
    listed, mark = note.get("replace"), mark_of(note)
    if not isinstance(listed, dict) or mark is None:
        return
    try:
        files, gone = ([_inside(folder, name) for name in listed.get(key, ())] for key in ("files", "gone"))
    except TypeError:  # a note that is not ours
        return
    check_plain(*files, folder / STILLS)
    try:
        for path in files:
            with contextlib.suppress(FileNotFoundError):  # it is replaced already
                temporary_path(path, mark).replace(path)
        for path in gone:
            path.unlink(missing_ok=True)
        for place in {folder, *(path.parent for path in files if path.exists())}:
            sync(place)
    except OSError as e:
        remedy = "make it writable, and the next command that reads the folder does it"
        what = f"{e.filename or folder}: cannot be replaced by what was saved"
        raise OutputError(f"{what}: {e.strerror or e}; {remedy}") from e


def _inside(folder: Path, name: str) -> Path:
    """A file of a run's folder, or of its pictures, whatever a note says."""
    return folder.joinpath(*(STILLS,) * (Path(name).parent.name == STILLS), Path(name).name)


def mark_of(note: Mapping[str, Any]) -> str | None:
    """The mark of the temporary files of the process that wrote a note; None in a note that is not ours."""
    mark = note.get("mark")
    return mark if isinstance(mark, str) and _MARK.fullmatch(mark) else None


def sweep(folder: Path) -> None:
    """Remove the temporary files of processes that have ended from a folder that is locked."""
    for path in list(folder.iterdir()) if os.name == "posix" else ():
        found = _PART.match(path.name)
        if found is not None and int(found[1]) != os.getpid() and not process_runs(int(found[1])):
            with contextlib.suppress(OSError):
                path.unlink()


def holder(folder: Path) -> Mapping[str, Any] | None:
    """The note of the process that writes into a folder, {} if it cannot be read; None if there is none.

    Nothing is written, so of another machine this one's clock must say how long it has been silent.
    """
    try:
        note, silent_s = _read_path(folder / LOCK), time.time() - (folder / LOCK).stat().st_mtime
    except OSError:
        return None
    return note if is_alive(note, None, lambda: silent_s) else None


def left_in(folder: Path) -> Mapping[str, Any]:
    """The note in a folder, whether its process is alive or not; {} without one."""
    with contextlib.suppress(OSError):
        return _read_path(folder / LOCK)
    return {}


def is_alive(note: Mapping[str, Any], can_lock: bool | None, age_s: Callable[[], float]) -> bool:
    """Whether the process of a note still works; `can_lock`: whether we got its flock, None without flock."""
    is_here = (note.get("host"), note.get("boot")) == here()
    if can_lock and (is_here or not note.get("token")):
        return False
    process = note.get("process")
    if is_here and isinstance(process, int) and process > 0 and not process_runs(process):
        return False
    return abs(age_s()) < STALE_S


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
    except OSError:  # the process of another user
        pass
    return True


def _flock(file: int) -> bool | None:
    """Lock a file; False if another process has, None if the file system cannot."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _is_at(file: int, path: Path) -> bool:
    with contextlib.suppress(FileNotFoundError):
        return os.path.samestat(os.fstat(file), path.stat())
    return False


def _read_path(path: Path) -> dict[str, Any]:
    # opened anew, so that NFS reads it anew; a pipe in its place is not waited for
    file = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    try:
        return _read(file)
    finally:
        os.close(file)


def _read(file: int) -> dict[str, Any]:
    """The note in a file; {} if there is none."""
    for _ in range(5):
        text = os.pread(file, 1 << 20, 0)
        with contextlib.suppress(ValueError):
            found = json.loads(text)
            return found if isinstance(found, dict) else {}
        if len(text) < _NOTE_BYTES:
            break
        time.sleep(0.01)  # it is being written
    return {}
