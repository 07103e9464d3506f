"""Several files of a folder replaced together, all of them or none, whatever ends the program.

Once all new files are written beside the old ones, and on the disk, a journal says so; whoever reads or writes the
folder next renames what is left.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

from facetrack_cli.core.claims import LOCK, process_runs
from facetrack_cli.core.errors import OutputError
from facetrack_cli.core.files import FULL, beside, publish, replacing, sync

JOURNAL: Final = ".saving.json"
_PART: Final = re.compile(r"\..+-(\d+)\.part\b")


def replace_all(folder: Path, files: Sequence[Path], gone: Sequence[Path] = (), *, anyway: bool = False) -> None:
    """Let what is `beside` these files of the folder replace them, and remove those that are `gone`. Raises OSError.

    A full disk without space for the journal leaves all as it was; with `anyway` each file is replaced by itself.
    """
    try:
        announce(folder, files, gone)
    except OSError as e:
        if e.errno not in FULL or not anyway:
            raise
        for path in files:
            publish(path)
        for path in gone:
            path.unlink(missing_ok=True)
    else:
        finish(folder)


def announce(folder: Path, files: Iterable[Path], gone: Sequence[Path] = ()) -> None:
    """Record that what is `beside` these files is whole, and those `gone` to be removed. `finish` follows."""
    names = {}
    for path in files:
        sync(beside(path))
        names[path.name] = _stamp(path)
    record = {"process": os.getpid(), "files": names, "gone": [path.name for path in gone]}
    with replacing(folder / JOURNAL) as file:
        file.write(json.dumps(record).encode())


def finish(folder: Path) -> None:
    """Replace what is announced and not replaced yet; it may be interrupted, and repeated. Raises OutputError. Files
    that were written since, as by another run, stay.
    """
    journal = folder / JOURNAL
    try:
        record = _read(journal)
        if record is None:
            return
        parts = {folder / name: beside(folder / name, record["process"]) for name in record["files"]}
        left = {path: part for path, part in parts.items() if part.exists()}
        ours = all(_stamp(path) == record["files"][path.name] for path in left)
        for path, part in left.items():
            with contextlib.suppress(FileNotFoundError):  # somebody else finishes, too
                if ours:
                    part.replace(os.path.realpath(path))
                else:
                    part.unlink()
        for name in record["gone"] if ours else ():
            (folder / name).unlink(missing_ok=True)
        for place in {folder, *(Path(os.path.realpath(path)).parent for path in parts)}:
            sync(place)
        journal.unlink(missing_ok=True)
    except OSError as e:
        remedy = "make it writable, and the next command that reads the folder does it"
        what = f"{e.filename or journal}: cannot be replaced by what was saved"
        raise OutputError(f"{what}: {e.strerror or e}; {remedy}") from e


def sweep(folder: Path) -> None:
    """Remove what processes that have ended wrote beside the files of a claimed folder, and did not announce."""
    if os.name != "posix" or (folder / JOURNAL).exists():
        return
    for path in list(folder.iterdir()):
        found = _PART.match(path.name)
        ended = found is not None and int(found[1]) != os.getpid() and not process_runs(int(found[1]))
        if ended or path.name.startswith(f"{LOCK}."):
            with contextlib.suppress(OSError):
                path.unlink()


def _read(journal: Path) -> dict[str, Any] | None:
    try:
        record: dict[str, Any] = json.loads(journal.read_bytes())
        names = [*record["files"], *record["gone"]]
        if any(Path(name).name != name for name in names) or not isinstance(record["process"], int):
            raise ValueError("names what is elsewhere")
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (ValueError, TypeError, KeyError) as e:
        raise OutputError(f"{journal}: is not as facetrack writes it; remove it") from e
    return record


def _stamp(path: Path) -> list[int] | None:
    with contextlib.suppress(FileNotFoundError):
        found = path.stat()
        return [found.st_size, found.st_mtime_ns]
    return None
