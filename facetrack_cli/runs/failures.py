"""A clip of a batch that failed: its one line, and the run.json that says so to the same command the next time."""

from __future__ import annotations

import contextlib
import os
import traceback
from collections.abc import Sequence
from typing import TYPE_CHECKING

from facetrack_cli.core.claims import here, utc_now
from facetrack_cli.core.errors import BusyError, ExitCode, FacetrackError, InputError, OutputError, from_system
from facetrack_cli.core.log import LINES
from facetrack_cli.runs.again import asked, looked_at, previous
from facetrack_cli.trajectory.batch_file import as_text
from facetrack_cli.trajectory.manifest import OWNED, Manifest, commit, read_manifest

if TYPE_CHECKING:
    from facetrack_cli.runs.job import Job


def line(error: Exception) -> FacetrackError:
    """The error as its line alone: an exception need not survive the way between processes."""
    if os.environ.get("FACETRACK_DEBUG", "") not in ("", "0"):
        traceback.print_exception(error)
    if isinstance(error, FacetrackError):
        kinds = (BusyError, OutputError, InputError)
        return next((kind for kind in kinds if isinstance(error, kind)), FacetrackError)(str(error))
    if (of_system := from_system(error)) is not None:
        return of_system
    return FacetrackError(f"internal error, please report it: {type(error).__name__}: {error}")


def failure(error: Exception, log: Sequence[str] = ()) -> dict[str, object]:
    """What run.json says of an error. `log`: what the process said last, if it died."""
    said = line(error)
    last = tuple(text.encode(errors="replace").decode() for text in log[-LINES:])
    text = as_text(str(said))
    return {"complete": False, "error": text, "exit_code": int(said.exit_code), "log": last, "ended": utc_now()}


def note_failure(job: Job, error: Exception, log: Sequence[str] = (), begun: Manifest | None = None) -> None:
    """Say in run.json of a folder, which is claimed, that its clip failed; what was tracked of it stays.

    Nothing is said where the error is one of writing, and over results that are whole or of something else. `begun` is
    what is known of the run.
    """
    if job.out is None or isinstance(error, OutputError):
        return
    with contextlib.suppress(FacetrackError, OSError):  # the error itself is worth more
        known = previous(job)
        if known is not None and known.files and known.stopped is None:
            return
        there = [name for name in OWNED if (job.out / name).exists()]
        if known is None and there and not is_failure(read_manifest(job.out)):
            return
        begun = begun or Manifest(asked=asked(job), host=here()[0])
        known = known if known is not None and known.files else begun.model_copy(update={"clip": looked_at(job.clip)})
        commit(job.out, [], known.model_copy(update=failure(error, log)))


def is_failure(known: Manifest | None) -> bool:
    """Whether a folder holds nothing but the word that its clip failed."""
    return known is not None and known.error is not None and not known.files


def code_of(known: Manifest) -> type[FacetrackError]:
    """The kind of error that a failed run ended with."""
    return InputError if known.exit_code == ExitCode.INPUT else FacetrackError
