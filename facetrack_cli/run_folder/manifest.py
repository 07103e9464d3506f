"""`run.json`: of which clip a run's folder is, how it was made, how it ended, and the checksum of each of its files.

It is replaced last, together with those files: it alone says what is complete, and files of different runs are noticed
whenever they are read.
"""

from __future__ import annotations

import os
import shlex
import traceback
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Final, Literal

from pydantic import ConfigDict, TypeAdapter, ValidationError

from facetrack_cli import __version__
from facetrack_cli.core.errors import BusyError, ExitCode, FacetrackError, InputError, OutputError, from_system
from facetrack_cli.core.files import FULL, MAX_FILE_BYTES, check_readable, digest, discard, temporary_path
from facetrack_cli.core.log import LINES
from facetrack_cli.run_folder.lock import FolderLock, utc_now
from facetrack_cli.trajectory.writers import Ending

NAME: Final = "run.json"
VIDEO: Final = "annotated.mp4"
POSTERIOR: Final = "posterior.npz"
FILTERED: Final = "trajectory.filtered.csv"
TABLES: Final = tuple(f"trajectory.{form}" for form in ("csv", "json", "jsonl"))
OWNED: Final = (VIDEO, POSTERIOR, FILTERED, *TABLES, NAME)  # the files that a run writes, or replaces
REPORT: Final = "report.html"
PLOT: Final = "plot.png"


@dataclass(frozen=True)
class File:
    """A file's size in bytes and SHA-256."""

    bytes: int
    sha256: str


@dataclass(frozen=True)
class Clip(File):
    """The clip of a run, its size that of all its images; `changed_ns` is when it was last changed.

    `sha256` is "" if the run ended before all of it was read.
    """

    path: str
    changed_ns: int


@dataclass
class Manifest(Ending):
    """The contents of run.json. `asked`: a digest of all that was asked for.

    `networks` are those that placed points: `mesh`, or the file that the recipe names.
    `began` and `ended` are UTC; `seconds` is the time between them. In a batch a clip that failed has its `error`, and
    `log`, the last lines of a process that died.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")
    format: Literal["facetrack-run"] = "facetrack-run"
    version: Literal[1] = 1
    facetrack: str = __version__
    asked: str = ""
    networks: tuple[str, ...] = ()
    clip: Clip | None = None
    smoothed: bool = False
    host: str = ""
    began: str = ""
    ended: str = ""
    seconds: float | None = None
    error: str | None = None
    exit_code: int | None = None
    log: tuple[str, ...] = ()
    files: dict[str, File] = field(default_factory=dict)

    def record(self) -> dict[str, Any]:
        """The contents as JSON has them. What the tables say of the ending and the clip is not repeated."""
        left_out = {"variable_fps", "evidence", "source_sha256"}
        found: dict[str, Any] = _adapter().dump_python(self, mode="json", exclude=left_out)
        return found

    @property
    def is_failure(self) -> bool:
        """Whether the folder holds nothing but the line that its clip failed."""
        return self.error is not None and not self.files


@cache
def _adapter() -> TypeAdapter[Manifest]:
    return TypeAdapter(Manifest)


def from_record(record: object) -> Manifest:
    """The manifest of a `record`. Raises ValueError for anything else."""
    return _adapter().validate_python(record)


def read_manifest(folder: Path) -> Manifest | None:
    """The run.json of a folder; None if there is none. InputError for a file that is not as we write it."""
    path = folder / NAME
    try:
        check_readable(path, MAX_FILE_BYTES)
        return _adapter().validate_json(path.read_bytes())
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e.strerror or e}; make it readable") from e
    except ValidationError as e:
        raise InputError(f"{path}: is not as facetrack run writes it; remove it, or make the run again") from e


def check_belongs(path: Path) -> None:
    """InputError if a file of a run, as trajectory.csv, is not the one that run.json beside it says."""
    known = read_manifest(path.parent) if path.name in OWNED else None
    if known is None:
        return
    if path.name not in known.files:
        raise InputError(f"{path}: is not of the run in this folder, as {NAME} says; remove it, or copy it elsewhere")
    if known.files[path.name].sha256 != digest([path]):
        raise InputError(
            f"{path}: is not as its run wrote it, as {NAME} beside it says: it was edited, or is of another run; "
            "copy it elsewhere to read it as it is"
        )


def outdated(folder: Path) -> list[str]:
    """A line on the files that report, plot and export made of the track that is replaced now; none without any."""
    try:
        there = sorted(one.name for one in folder.iterdir() if one.name not in OWNED)
    except OSError:
        return []
    made = {name: made_by(name) for name in there if made_by(name)}
    if not made:
        return []
    again = [f"facetrack {by} {shlex.quote(str(folder))} --overwrite" for by in dict.fromkeys(made.values())]
    return [f"{folder}: older than the track: {', '.join(made)}; make anew: {', '.join(again)}"]


def made_by(name: str) -> str:
    """The command that writes a file of this name beside a trajectory; "" for any other file."""
    known = {REPORT: "report", PLOT: "plot"}
    return known.get(name, "export --to FORMAT" if name.startswith("trajectory.") else "")


def commit(
    lock: FolderLock, folder: Path, files: Sequence[Path], known: Manifest | None, gone: Sequence[Path] = ()
) -> None:
    """Let the temporary files of these paths replace them, and then run.json: `known`, and their checksums.

    Of the files that a run writes, those that `known` does not keep are removed. Without `known` (the run of an older
    version) there is no run.json, and only `gone` is removed. On a full disk the files are kept without a run.json.
    Raises OSError; OutputError if the lock was taken over, and nothing is replaced then.
    """
    files, gone, path = list(files), list(gone), folder / NAME
    try:
        if known is not None:
            new = {one.name: _file(temporary_path(one)) for one in files if one.name in OWNED}
            known = replace(known, files={**known.files, **new})
            gone += [folder / name for name in OWNED if name not in known.files and folder / name not in files]
            try:
                text = _adapter().dump_json(known, indent=1, exclude={"variable_fps", "evidence", "source_sha256"})
                temporary_path(path).write_bytes(text + b"\n")
                files.append(path)
                gone.remove(path)
            except OSError as e:
                if e.errno not in FULL:
                    raise
        lock.prepare(files, gone)
    except BaseException:
        discard(path)
        raise
    lock.commit()


def _file(path: Path) -> File:
    return File(bytes=path.stat().st_size, sha256=digest([path]))


def as_line(error: Exception) -> FacetrackError:
    """The error as its line alone: an exception need not survive the way between processes."""
    if os.environ.get("FACETRACK_DEBUG", "") not in ("", "0"):
        traceback.print_exception(error)
    if isinstance(error, FacetrackError):
        kinds = (BusyError, OutputError, InputError)
        return next((kind for kind in kinds if isinstance(error, kind)), FacetrackError)(str(error))
    if (of_system := from_system(error)) is not None:
        return of_system
    return FacetrackError(f"internal error, please report it: {type(error).__name__}: {error}")


def failed(known: Manifest, error: Exception, log: Sequence[str] = ()) -> Manifest:
    """The run with the error that ended it. `log`: the last lines of its process, if that died."""
    said = as_line(error)
    last = tuple(text.encode(errors="replace").decode() for text in log[-LINES:])
    return replace(
        known, complete=False, error=as_text(str(said)), exit_code=int(said.exit_code), log=last, ended=utc_now()
    )


def error_of(known: Manifest) -> FacetrackError | None:
    """The error that a run ended with."""
    kind = InputError if known.exit_code == ExitCode.INPUT else FacetrackError
    return None if known.error is None else kind(known.error)


def as_text(name: str) -> str:
    """A name as JSON holds it: bytes that are no text are escaped."""
    return name.encode(errors="backslashreplace").decode()
