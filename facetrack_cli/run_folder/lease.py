"""The one writer of a folder, among processes of this machine and of others that share its file system.

`filelock`'s lease says who that is: a file whose time its process sets every few seconds. The lease of a process
of this machine that has ended is taken over at once; that of one that is suspended, or on another machine, once nobody
has touched it for `LEASE_S` seconds while the next writer looked on.

Beside it lies a note: what is being written, how far it is, and what is to be done after a kill. Several files are
replaced together, all or none: once the new files are on the disk, the note lists them, and then each is renamed.
Whoever finds such a note finishes the renames.
"""

import contextlib
import json
import os
import re
import secrets
import socket
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, BinaryIO, Final

from filelock import LeaseSettingsMismatch, SoftFileLease, Timeout

from facetrack_cli.core.errors import BusyError, InputError, OutputError, write_line
from facetrack_cli.core.files import check_plain, discard, own_mark, read_bounded, sync, temporary_path, writing
from facetrack_cli.trajectory.reader import STILLS

LOCK: Final = ".facetrack.lock"
NOTE: Final = ".facetrack.note"
IN_A_COPY: Final = "work in a copy of the folder"  # also what commands without --out can do
BEAT_S = 10.0  # between two notes of how far it is
LEASE_S = 60.0  # of silence, after which a lease is taken over
_AT_ONCE_S: Final = 0.2  # in which the lease of a process that has ended is taken over
_NOTE_BYTES: Final = 4096  # a note is padded to this, so that a full disk has space for the next one
_MAX_NOTE_BYTES: Final = 1 << 20
_MARK: Final = re.compile(r"\d+-[0-9a-f]{16}")
_PART: Final = re.compile(r"\..+-(\d+)(-[0-9a-f]{16})?\.part\b")


class FolderLease:
    """The one writer of a folder, in a `with`; BusyError for a second one, also on another machine that sees it.

    Where the writer is silent, it waits for `LEASE_S` seconds, or until `stopped`, whether it is gone.

    Attributes
    ----------
    stale_note : Mapping
        The note that a killed process left; empty without one.
    """

    def __init__(self, folder: Path, stopped: Callable[[], bool] = lambda: False) -> None:
        self.stale_note: Mapping[str, Any] = {}
        self._folder, self._path, self._stopped = folder, folder / NOTE, stopped
        self._token = secrets.token_hex(8)
        self._note: dict[str, Any] = {}
        self._began = self._noted = time.monotonic()
        self._bytes = _NOTE_BYTES

    def __enter__(self) -> "FolderLease":
        check_plain(self._folder / LOCK, self._path)
        with writing(self._folder / LOCK, IN_A_COPY):
            self._lease = self._acquired()
            try:
                left = left_in(self._folder)
                self.stale_note = left.get("before") or left
                host, boot = here()
                self._note = {"host": host, "boot": boot, "process": os.getpid(), "token": self._token}
                self._note |= {"began": utc_now(), "mark": own_mark(), "before": self.stale_note or None}
                # in place of the one that is there: a process that is suspended goes on to write into its own
                temporary_path(self._path).write_bytes(self._text())
                temporary_path(self._path).replace(self._path)
                self._file: BinaryIO = self._path.open("r+b", buffering=0)
            except BaseException:
                discard(self._path)
                self._lease.release()
                raise
        return self

    def note(self, record: Mapping[str, Any], *, on_disk: bool = False) -> None:
        """Note what is being done, for others and for after a kill; `on_disk`: or a power loss. Raises OutputError."""
        with writing(self._path, IN_A_COPY):
            self._note |= record
            self._file.seek(0)
            self._file.write(self._text())
            if on_disk:
                os.fsync(self._file.fileno())
                sync(self._folder)

    def progress(self, frame: int, frames: int | None) -> None:
        """Note how many frames are done, and how many there are, if that is known; every `BEAT_S` seconds."""
        self._note |= {"frame": frame, "frames": frames}
        if time.monotonic() - self._noted >= BEAT_S:
            self._noted = time.monotonic()
            with contextlib.suppress(OutputError):
                self.note({})

    def check(self) -> None:
        """OutputError if the lease was taken over while this process was suspended, or cut off."""
        if not self._is_ours():
            why = f"this one gave no sign of life for {LEASE_S:.0f} s; what it writes there stays, nothing was replaced"
            raise OutputError(f"{self._folder}: another facetrack has taken this folder over, since {why}")

    def prepare(self, files: Sequence[Path], gone: Sequence[Path] = ()) -> None:
        """Note, on the disk, that the temporary files of these paths replace them, and that those `gone` are removed.

        From here on all of it is done, whatever ends the program: by `commit`, or by whoever finds the note. Raises
        OSError; OutputError if the lease was taken over, and nothing is replaced then.
        """
        for path in files:
            sync(temporary_path(path))
        self.check()
        lists = {"files": files, "gone": gone}
        listed = {key: [str(path.relative_to(self._folder)) for path in paths] for key, paths in lists.items()}
        self.note({"replace": listed}, on_disk=True)

    def commit(self) -> None:
        """Replace and remove what is prepared. Raises OutputError."""
        finish_replacing(self._folder, self._note)
        self.note({"replace": None})

    def __exit__(self, *_: object) -> None:
        self._file.close()
        if self._is_ours() and not self._note.get("replace"):  # with files left to be replaced the note stays
            self._path.unlink(missing_ok=True)
        self._lease.release()

    def _acquired(self) -> SoftFileLease:
        """The lease of the folder, which is made. Raises BusyError, OutputError, OSError."""
        path = self._folder / LOCK
        remedy = "wait until it ends, or name another folder"
        busy = BusyError(f"{self._folder}: another facetrack is writing its results here; {remedy}")
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            lease = SoftFileLease(
                path,
                lease_duration=LEASE_S,
                heartbeat_interval=LEASE_S / 6,
                mode=0o600 | self._folder.stat().st_mode & 0o666,  # who may write here may take it over
                thread_local=False,
            )
            with contextlib.suppress(Timeout):
                lease.acquire(_AT_ONCE_S)
                return lease
            with tempfile.TemporaryFile(dir=self._folder) as now:  # by the clock of the file system
                silent_s = os.fstat(now.fileno()).st_mtime - path.stat().st_mtime
            if silent_s < LEASE_S:
                raise busy
            if lease.owner is None:  # cut short, as by a power loss
                lease.force_break()
            write_line(f"facetrack: {self._folder}: whoever writes here is silent; waiting {LEASE_S:.0f} s for it")
            lease.acquire(1.5 * LEASE_S, cancel_check=self._stopped)
            return lease
        except Timeout:
            raise busy from None
        except LeaseSettingsMismatch as e:
            raise OutputError(f"{path}: is of another facetrack; if nobody writes here, remove it") from e
        except FileNotFoundError:  # its process has ended meanwhile, and removed the file, or the folder
            return self._acquired()

    def _is_ours(self) -> bool:
        return left_in(self._folder).get("token") == self._token

    def _text(self) -> bytes:
        """The note, never shorter than it was."""
        text = json.dumps({**self._note, "seconds": round(time.monotonic() - self._began, 1)}).encode()
        self._bytes = max(self._bytes, len(text) + 1)
        return text.ljust(self._bytes - 1) + b"\n"


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
    """Remove the temporary files of processes that have ended from a folder that is ours."""
    for path in list(folder.iterdir()):
        match = _PART.match(path.name)
        if match is not None and int(match[1]) != os.getpid() and not process_runs(int(match[1])):
            with contextlib.suppress(OSError):
                path.unlink()


def is_held(folder: Path) -> bool:
    """Whether a process writes into a folder, or has left something to be ended there."""
    return any(os.path.lexists(folder / name) for name in (LOCK, NOTE))


def holder(folder: Path) -> Mapping[str, Any] | None:
    """The note of the process that writes into a folder, {} if it cannot be read; None if there is none.

    Nothing is written, so this machine's clock must say how long the process has been silent.
    """
    try:
        silent_s = time.time() - (folder / LOCK).stat().st_mtime
    except OSError:
        return None
    note = left_in(folder)
    process, is_here = note.get("process"), (note.get("host"), note.get("boot")) == here()
    ended = is_here and isinstance(process, int) and process > 0 and not process_runs(process)
    return None if ended or abs(silent_s) >= LEASE_S else note


def left_in(folder: Path) -> dict[str, Any]:
    """The note in a folder, whether its process is alive or not; {} without one."""
    for _ in range(5):
        try:
            text = read_bounded(folder / NOTE, _MAX_NOTE_BYTES)
            note = json.loads(text)
            return note if isinstance(note, dict) else {}
        except ValueError:
            if len(text) < _NOTE_BYTES:
                break
            time.sleep(0.01)  # it is being written
        except (OSError, InputError):
            break
    return {}


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
    """Whether this machine has a process of that number; True where that cannot be asked."""
    try:
        if os.name == "posix":  # elsewhere this ends it
            os.kill(number, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # the process of another user
        pass
    return True
