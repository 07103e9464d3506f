"""Everything that was corrected into the run's folder: all files are written beside the old ones, then take over."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Callable
from pathlib import Path

from facetrack_cli.errors import OutputError
from facetrack_cli.fixing.fixer import Fixer
from facetrack_cli.fixing.repaint import repaint
from facetrack_cli.fixing.retrack import Report
from facetrack_cli.fixing.run_folder import CORRECTED, UNSAVED, Run
from facetrack_cli.start import write_init
from facetrack_cli.start.init_text import record_of


def save(
    fixer: Fixer,
    *,
    video: bool = True,
    report: Report = lambda done, total: None,
    stop: Callable[[], bool] = lambda: False,
) -> list[str]:
    """Write the rows as they are now, the corrections, and with `video` the video, if the run has one.

    What was written, a line each. Raises OutputError or InputError if something cannot be written, StoppedError once
    `stop` says so; the folder is then as it was.
    """
    run, rows = fixer.run, fixer.rows
    if not fixer.changed:
        forget(run)
        return [f"{run.folder}: nothing was corrected, all is as it was"]
    for book in rows.index.books:
        if not book.untouched:
            raise OutputError(f"{book.path}: was written by somebody else since it was opened; begin again")
    init = {key: value for key, value in run.init.items() if key != "corrections"}
    if fixer.corrections:
        init["corrections"] = [record_of(one) for one in fixer.corrections]
    done: list[tuple[Path, Path]] = []  # from where, to where
    said: list[str] = []
    at = run.folder
    try:
        if run.video is not None and video:
            done.append((_beside(run.video), run.video))
            said += repaint(run, rows, done[-1][0], report=report, stop=stop)
        for book in rows.index.books:
            at = book.path
            done.append((_beside(at), at))
            with done[-1][0].open("wb") as file:
                rows.write(book, file, init)
                file.flush()
                os.fsync(file.fileno())
        at = run.folder / CORRECTED
        done.append((_beside(at), at))
        write_init(done[-1][0], fixer.start, clip=run.clip.name, overwrite=True)
        for part, whole in done:
            at = whole
            part.replace(os.path.realpath(whole))
    except OSError as e:
        remedy = "free some space" if e.errno in (errno.ENOSPC, errno.EDQUOT) else "make it writable"
        raise OutputError(f"{at}: cannot be written: {e.strerror or e}; {remedy}, and save again") from e
    finally:
        for part, _ in done:
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)
    forget(run)
    said += [
        f"{run.folder / CORRECTED}: the correction of {one.target} at frame {one.frame} is past the end, frame "
        f"{rows.index.last}"
        for one in fixer.beyond
    ]
    if run.video is not None and not video:
        said.append(f"{run.video}: left as it was, it shows the track of before")
    return [*(f"{whole}: written" for _, whole in done), *said]


def keep(fixer: Fixer) -> Path | None:
    """Write the corrections that are not saved, for the next time; None if there are none. Raises OutputError."""
    path = fixer.run.folder / UNSAVED
    if not fixer.changed:
        forget(fixer.run)
        return None
    write_init(path, fixer.start, clip=fixer.run.clip.name, overwrite=True)
    return path


def forget(run: Run) -> None:
    """Remove what `keep` wrote."""
    with contextlib.suppress(OSError):
        (run.folder / UNSAVED).unlink(missing_ok=True)


def _beside(path: Path) -> Path:
    whole = Path(os.path.realpath(path))
    return whole.with_name(f".{whole.stem}-{os.getpid()}.fixed{whole.suffix}")
