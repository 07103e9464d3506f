"""Several files of a run replaced together: all of them or none, whatever ends the program meanwhile. Once all new
files are written beside the old ones, a journal says so; whoever opens the run next renames what is left.
"""

import contextlib
import json
import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

from facetrack_cli.core.errors import OutputError
from facetrack_cli.core.files import beside, replacing

JOURNAL: Final = ".saving.json"
_PART: Final = re.compile(r"\..+-(\d+)\.part\b")


def announce(folder: Path, files: Iterable[Path], instead: Sequence[Path] = ()) -> None:
    """Record that what is `beside` these files is whole, and those `instead` to be removed. `finish` follows."""
    names = {}
    for path in files:
        with beside(path).open("rb") as whole:
            os.fsync(whole.fileno())
        names[path.name] = _stamp(path)
    record = {"process": os.getpid(), "files": names, "gone": [path.name for path in instead]}
    with replacing(folder / JOURNAL, sync=True) as file:
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
        journal.unlink(missing_ok=True)
    except OSError as e:
        remedy = f"make it writable, and facetrack fix {folder} does it"
        what = f"{e.filename or journal}: cannot be replaced by what was saved"
        raise OutputError(f"{what}: {e.strerror or e}; {remedy}") from e


def sweep(folder: Path) -> None:
    """Remove what processes that have ended wrote beside the run's files, and did not announce."""
    if os.name != "posix" or (folder / JOURNAL).exists():
        return
    for path in list(folder.iterdir()):
        found = _PART.match(path.name)
        if found is not None and int(found[1]) != os.getpid() and not _runs(int(found[1])):
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
        raise OutputError(f"{journal}: is not as facetrack fix writes it; remove it") from e
    return record


def _stamp(path: Path) -> list[int] | None:
    with contextlib.suppress(FileNotFoundError):
        found = path.stat()
        return [found.st_size, found.st_mtime_ns]
    return None


def _runs(number: int) -> bool:
    try:
        os.kill(number, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # it is somebody else's
        pass
    return True
