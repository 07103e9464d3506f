"""`run.json`: what a run's folder holds. Of which clip, made how, with what end, and the checksum of each of its files.

It is replaced together with those files, so files of different runs are noticed whenever one of them is read.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from facetrack_cli import __version__
from facetrack_cli.core.claims import Claim
from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.files import FULL, MOST, beside, check_readable, digest, discard
from facetrack_cli.core.sets import replace_all

NAME: Final = "run.json"
TABLES: Final = tuple(f"trajectory.{form}" for form in ("csv", "json", "jsonl"))
FILTERED: Final = "trajectory.filtered.csv"
OWNED: Final = ("annotated.mp4", "posterior.npz", FILTERED, *TABLES, NAME)  # what a run writes, or replaces


REPORT: Final = "report.html"
PLOT: Final = "plot.png"


class _Stored(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class File(_Stored):
    """A file's size in bytes and SHA-256."""

    bytes: int
    sha256: str


class Clip(File):
    """The clip of a run, its size that of all its images; `changed_ns` is when it was last changed.

    `sha256` is "" if the run ended before all of it was read.
    """

    path: str
    changed_ns: int


class Manifest(_Stored):
    """The contents of run.json. `asked`: a digest of all that was asked for; `lost_at_end`: parts lost at the end.

    `networks` are those that placed points: `mesh`, or the file that the recipe names.

    `began` and `ended` are UTC; `seconds` is the time between them. In a batch a clip that failed has its `error`, and
    `log`, the last lines of a process that died.
    """

    format: Literal["facetrack-run"] = "facetrack-run"
    version: Literal[1] = 1
    facetrack: str = __version__
    asked: str = ""
    networks: tuple[str, ...] = ()
    clip: Clip | None = None
    complete: bool = True
    stopped: str | None = None
    frames: int = 0
    lost_frames: dict[str, int] = {}
    lost_at_end: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    smoothed: bool = False
    host: str = ""
    began: str = ""
    ended: str = ""
    seconds: float | None = None
    error: str | None = None
    exit_code: int | None = None
    log: tuple[str, ...] = ()
    files: dict[str, File] = {}


def read_manifest(folder: Path) -> Manifest | None:
    """What a folder says of its run; None if it says nothing. InputError for a file that is not as we write it."""
    path = folder / NAME
    try:
        check_readable(path, MOST)
        return Manifest.model_validate_json(path.read_bytes())
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
    """A line, where a track replaces another, on what was made from that one and stays; none if nothing was.

    That is what report, plot and export wrote by the names that they choose.
    """
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
    folder: Path,
    files: Sequence[Path],
    known: Manifest | None,
    gone: Sequence[Path] = (),
    *,
    claim: Claim | None = None,
    anyway: bool = False,
) -> None:
    """Let what is `beside` these files replace them, and run.json with them: `known`, and their checksums.

    Of what a run writes, files that `known` does not keep are removed. Without `known` (the run of an older version)
    there is no run.json, and only what is `gone` is removed. Raises OSError; OutputError if the `claim` was taken over,
    and nothing is replaced then. `anyway`: a full disk keeps what it can.
    """
    files, gone = list(files), list(gone)
    if known is not None:
        new = {one.name: _file(beside(one)) for one in files if one.name in OWNED}
        stored = {**known.files, **new}
        path = folder / NAME
        try:
            text = known.model_copy(update={"files": stored}).model_dump_json(indent=1)
            beside(path).write_text(text + "\n", encoding="utf-8")
            files.append(path)
        except OSError as e:
            discard(path)
            if e.errno not in FULL or not anyway:
                raise
        gone += [folder / name for name in OWNED if name not in stored and folder / name not in files]
    if claim is not None:
        try:
            claim.check()
        except OutputError:
            discard(folder / NAME)
            raise
    replace_all(folder, files, gone, anyway=anyway)


def _file(path: Path) -> File:
    return File(bytes=path.stat().st_size, sha256=digest([path]))
