"""What a run that was killed leaves in its folder: files half replaced, and tables without an end."""

from __future__ import annotations

import contextlib
import json
import re
import shutil
from collections import deque
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from facetrack_cli.core.claims import LOCK, Claim
from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.files import beside
from facetrack_cli.core.sets import finish, sweep
from facetrack_cli.trajectory.manifest import Manifest, commit, read_manifest
from facetrack_cli.trajectory.reader import read_table
from facetrack_cli.trajectory.writers import FORMATS, Footer, Format, footer_of, tail

KILLED: Final = "killed"
_FRAME: Final[Mapping[Format, re.Pattern[bytes]]] = {
    "csv": re.compile(rb"(\d{1,15}),.*\n", re.DOTALL),
    "json": re.compile(rb'\{"frame":(\d{1,15}),.*\}(?:,?\n|$)'),
    "jsonl": re.compile(rb'\{"type":"frame","frame":(\d{1,15}),.*\}\n'),
}


def settle(folder: Path) -> int:
    """End what a process that was killed left in a folder, if nobody writes there; the frames that it had tracked.

    A set of files half replaced is replaced; tables that were being written become those of a run that was stopped.
    """
    if not folder.is_dir():
        return 0
    finish(folder)
    if not (folder / LOCK).exists():
        return 0
    with contextlib.suppress(OutputError, OSError), Claim(folder) as lock:
        return recover(folder, lock)
    return 0


def recover(folder: Path, lock: Claim) -> int:
    """As `settle`, of a folder that is locked."""
    finish(folder)
    process, frames = lock.left.get("left") or lock.left.get("process"), 0
    with contextlib.suppress(ValueError, InputError):  # what is left need not be ours
        known = Manifest.model_validate(lock.left.get("run"))
        if isinstance(process, int):
            lock.note({"run": lock.left["run"], "left": process})  # in case that this one is killed, too
            frames = _end(folder, process, known)
            lock.note({"left": None})
    sweep(folder)
    return frames


def _end(folder: Path, process: int, known: Manifest) -> int:
    """End the tables of a process in the folder; the number of frames they hold."""
    parts = {form: beside(folder / f"trajectory.{form}", process) for form in FORMATS}
    ends = {form: _ends(form, part) for form, part in parts.items() if part.is_file()}
    last = min((those[-1].frame if those else -1 for those in ends.values()), default=-1)
    cuts = {form: next((one for one in reversed(those) if one.frame == last), None) for form, those in ends.items()}
    if last < 0 or None in cuts.values():
        return 0
    frames, before = max(cut.frames for cut in cuts.values() if cut), read_manifest(folder)
    if before is not None and before.asked == known.asked and before.frames >= frames:
        return 0
    files = []
    for form, cut in cuts.items():
        assert cut is not None
        files.append(folder / f"trajectory.{form}")
        ours = beside(files[-1])
        if ours != parts[form]:  # a copy: the process may be suspended alone, and write on
            shutil.copyfile(parts[form], ours)
        _close(form, ours, cut.end, Footer(), frames)
        footer = footer_of(read_table(ours), complete=False, stopped=KILLED)
        _close(form, ours, cut.end, footer, frames)
    ended = {"complete": False, "stopped": KILLED, "frames": frames, "lost_frames": footer.lost_frames, "files": {}}
    commit(folder, files, known.model_copy(update=ended))
    return frames


def _close(form: Format, part: Path, end: int, footer: Footer, frames: int) -> None:
    with part.open("r+b") as file:
        file.truncate(end)
        file.seek(end)
        file.write(tail(form, footer, frames).encode())


class _Ending(NamedTuple):
    """A frame in a table: where its text ends in the file, the frames up to it, and its lines."""

    frame: int
    end: int
    frames: int
    lines: int


def _ended(line: bytes) -> bool:
    """Whether a line is whole: without its end it may be torn where an object inside of it ends."""
    if line.endswith(b"\n"):
        return True
    try:
        json.loads(line)
    except ValueError:
        return False
    return True


def _ends(form: Format, path: Path) -> Sequence[_Ending]:
    """The last whole frames of a table that was being written."""
    found: deque[_Ending] = deque(maxlen=8)
    frames, place = 0, 0
    with path.open("rb") as file:
        for text in file:
            place += len(text)
            if (one := _FRAME[form].fullmatch(text)) is None or not _ended(text):
                continue
            frame, lines = int(one[1]), 1
            if found and found[-1].frame == frame:
                lines += found.pop().lines
            else:
                frames += 1
            end = place - (len(text) - len(text.rstrip(b",\n"))) if form == "json" else place
            found.append(_Ending(frame, end, frames, lines))
    if form == "csv" and found and (len(found) < 2 or found[-1].lines < found[0].lines):
        found.pop()  # torn, as far as its number of lines tells
    return found
