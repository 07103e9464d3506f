"""The options of `facetrack run` for one long clip in pieces, and what is said of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Final

import click

from facetrack_cli.core.errors import ExitCode, InputError, UsageError
from facetrack_cli.core.log import about

if TYPE_CHECKING:
    from facetrack_cli.runs.job import Job, Outcome
    from facetrack_cli.runs.plan import Split, Starts
    from facetrack_cli.runs.progress import Progress
    from facetrack_cli.runs.signals import Stop

_UNITS: Final = {"s": 1.0, "m": 60.0, "h": 3600.0, "f": 1.0}


def length(value: str) -> tuple[float, bool]:
    """A length in s, or in frames, and whether it is the latter."""
    number, unit = value[:-1], value[-1:].lower()
    if unit not in _UNITS:
        raise click.BadParameter(f"{value!r}: give a unit, as in 10m, 90s, 1h, or 5000f for frames")
    try:
        found = float(number) * _UNITS[unit]
    except ValueError:
        found = 0.0
    if not 0 < found < 1e9:
        raise click.BadParameter(f"{value!r}: is no length of a piece; give one as 10m, 90s, 1h or 5000f")
    return found, unit == "f"


def check_split(split: tuple[float, bool] | None, starts: Starts | None, clips: int, unfit: str) -> Split | None:
    """How a clip is to be split; UsageError where it cannot be. `unfit`: an option that needs a whole clip."""
    from facetrack_cli.runs.plan import Split

    if split is None:
        if starts is not None:
            raise UsageError("--starts says where the pieces of --split begin; give that too")
        return None
    if starts is None:
        raise UsageError(
            "--split needs to know where its pieces begin: give --starts detect, which looks for the face, or "
            "--starts init, which takes the corrections in the init file"
        )
    if unfit:
        raise UsageError(f"{unfit} goes over the whole clip, --split cuts it in pieces; give one of them")
    if clips > 1:
        raise UsageError(f"--split cuts one clip, and {clips} are given; split one at a time")
    return Split(*split, starts)


def run_split(
    job: Job,
    workers: int,
    stop: Stop,
    shown: Progress,
    shard: tuple[int, int],
    say: Callable[[Outcome, Progress], None],
) -> ExitCode:
    """Track the pieces of a clip and join them; `say` says what became of the clip. A piece that fails does not stop
    the others.
    """
    from facetrack_cli.runs.split import run_pieces

    whole = None
    with about(job.clip.name):
        for piece, outcome in run_pieces(job, workers, stop, shown, shard):
            if not piece:
                whole = outcome
            elif outcome.error is not None:
                shown.say(f"facetrack: warning: {piece}: {outcome.error}")
            elif outcome.again is None and outcome.frames:
                shown.say(outcome.summary())
        shown.close()
        if whole is None:
            return stop.code or ExitCode.DONE
        if whole.error is not None and not whole.frames:
            raise whole.error
        say(whole, shown)
        if whole.error is not None:
            shown.error(f"facetrack: error: {whole.error}")
            return stop.code or (ExitCode.INPUT if isinstance(whole.error, InputError) else ExitCode.BATCH)
        return stop.code or (ExitCode.LOST if whole.lost_at_end else ExitCode.DONE)
