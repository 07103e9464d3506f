"""What a run that was killed leaves in its folder: files half replaced, and tables without an end."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Mapping
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Final

from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.files import BytesSink, temporary_path
from facetrack_cli.run_folder.lock import LOCK, FolderLock, finish_replacing, left_in, sweep
from facetrack_cli.run_folder.manifest import Manifest, check_belongs, commit, from_record, read_manifest
from facetrack_cli.trajectory.reader import read_table, read_trajectory, table_in
from facetrack_cli.trajectory.trajectory import Trajectory
from facetrack_cli.trajectory.writers import FOOTER, FORMATS, WRITERS, Ending, Format, ending_of, tail

KILLED: Final = "killed"
_FRAME: Final[Mapping[Format, re.Pattern[bytes]]] = {
    "csv": re.compile(rb"(\d{1,15}),.*"),
    "json": re.compile(rb'\{"frame":(\d{1,15}),.*\},?'),
    "jsonl": re.compile(rb'\{"type":"frame","frame":(\d{1,15}),.*\}'),
}


def read_run(path: Path | str) -> Trajectory:
    """A trajectory as `read_trajectory` reads it; if it is in the folder of a run, what a kill left there is recovered
    first. InputError also for a file of another run than run.json beside it.
    """
    check_run(Path(path))
    return read_trajectory(path)


def check_run(path: Path) -> None:
    """Recover the folder of a run, or of one of its files. InputError for a file of another run than run.json there."""
    try:
        recover_interrupted(path if path.is_dir() else path.parent)
        check_belongs(table_in(path))
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e.strerror or e}; name a trajectory or ground-truth file") from e


def trajectory_of(run: Path) -> Path:
    """The trajectory of a run's folder that has a header. InputError if there is none."""
    remedy = "name the folder of a run, which facetrack run wrote"
    if run.is_file():
        raise InputError(f"{run}: is a file; {remedy}")
    if not run.is_dir():
        raise InputError(f"{run}: no such folder; {remedy}")
    recover_interrupted(run)
    for form in ("json", "jsonl"):
        if (path := run / f"trajectory.{form}").is_file():
            return path
    if (run / "trajectory.csv").is_file():
        missing = "has trajectory.csv alone, without recipe and clip"
        raise InputError(f"{run}: {missing}; run again with --format csv,json")
    raise InputError(f"{run}: has no trajectory.json; {remedy}")


def recover_interrupted(folder: Path) -> int:
    """End what a killed process left in a folder, if nobody writes there; the number of frames that it had tracked.

    Files half replaced are replaced; tables that were being written become the tables of a run that was stopped.
    """
    if not (folder / LOCK).exists():
        return 0
    finish_replacing(folder, left_in(folder))
    with contextlib.suppress(OutputError, OSError), FolderLock(folder) as lock:
        return recover(folder, lock)
    return 0


def recover(folder: Path, lock: FolderLock) -> int:
    """As `recover_interrupted`, of a folder that is locked."""
    note, frames = lock.stale_note, 0
    finish_replacing(folder, note)
    with contextlib.suppress(ValueError, InputError):  # a note need not be ours
        known, process = from_record(note.get("run")), note.get("process")
        if isinstance(process, int):
            frames = _end_tables(folder, lock, process, known)
    lock.note({"before": None})
    sweep(folder)
    return frames


def _end_tables(folder: Path, lock: FolderLock, process: int, known: Manifest) -> int:
    """Write the tables of a process anew with their whole frames, and run.json; the number of these frames."""
    parts = {form: temporary_path(folder / f"trajectory.{form}", process) for form in FORMATS}
    forms = [form for form in FORMATS if parts[form].is_file()]
    if not forms:
        return 0
    first = forms[-1]  # JSON also has the header, and its lines are the last of the three to be written
    text, frames = _whole_frames(first, parts[first].read_bytes())
    before = read_manifest(folder)
    if not frames or (before is not None and before.asked == known.asked and before.frames >= frames):
        return 0
    torn = temporary_path(folder / f"torn.{first}")
    try:
        torn.write_bytes(text)
        rows = read_table(torn)
        ending = ending_of(rows, complete=False, stopped=KILLED)
        head = {key: value for key, value in rows.header.items() if key not in (*FOOTER, "frames_tracked", "type")}
        files = [folder / f"trajectory.{form}" for form in forms]
        for form, path in zip(forms, files, strict=True):
            with temporary_path(path).open("wb") as file:
                writer = WRITERS[form](BytesSink(file.write), head)
                writer.write(rows)
                writer.close(ending)
        told = {name: getattr(ending, name) for name in ("frames", "complete", "stopped", "lost_frames", "lost_at_end")}
        commit(lock, folder, files, replace(known, **told, files={}))
    finally:
        torn.unlink(missing_ok=True)
    return frames


def _whole_frames(form: Format, text: bytes) -> tuple[bytes, int]:
    """A table up to its last whole frame, ended, and the number of its frames. A frame may be torn anywhere."""
    lines = text.split(b"\n")
    head = next((i for i, line in enumerate(lines) if _FRAME[form].fullmatch(line)), len(lines))
    body = [line for line in lines[head:-1] if _FRAME[form].fullmatch(line)]
    if form == "csv":
        groups = [list(those) for _, those in groupby(body, lambda line: line.partition(b",")[0])]
        if len(groups) < 2 or len(groups[-1]) < len(groups[0]):
            groups = groups[:-1]
        return b"\n".join([*lines[:head], *(line for those in groups for line in those), b""]), len(groups)
    with contextlib.suppress(ValueError):  # the last line has no end yet, and may be torn inside of an object
        if _FRAME[form].fullmatch(lines[-1]) and json.loads(lines[-1]):
            body.append(lines[-1])
    between = b",\n" if form == "json" else b"\n"
    whole = between.join([*(line.rstrip(b",") for line in body)])
    end = tail(form, Ending(), len(body)).encode()
    return b"\n".join([*lines[:head], whole]) + (b"\n" if form == "jsonl" else b"") + end, len(body)
