"""Several clips: where the results of each go, and N of them at a time."""

from __future__ import annotations

import os
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from facetrack_cli.core.errors import ExitCode, FacetrackError
from facetrack_cli.runs.clip import run
from facetrack_cli.runs.job import Job, Outcome, Report
from facetrack_cli.runs.outputs import check
from facetrack_cli.runs.progress import Progress
from facetrack_cli.runs.signals import Stop
from facetrack_cli.runs.workers import side_by_side


@dataclass(frozen=True)
class Ended:
    """A clip that ended one way or another: its outcome, if it began, and what it failed of."""

    clip: Path
    outcome: Outcome | None = None
    failure: str = ""
    code: ExitCode = ExitCode.DONE


def folders(clips: Sequence[Path], recipe: str) -> list[str]:
    """A folder name for the results of each clip, `<clip>-<recipe>`; no two are the same.

    Clips of one name are told apart by the folders they lie in, as many as it takes; those of one folder, by their
    suffix.
    """
    places = [absolute(clip) for clip in clips]
    names = [title(clip) for clip in clips]
    depth = 0
    while True:
        clashing = [i for i, name in enumerate(names) if _count(names, name) > 1]
        longest = max((len(clip.parts) for clip in places), default=0)
        if not clashing or depth > longest:
            break
        depth += 1
        for i in clashing:
            clip = places[i]
            same_place = [j for j in clashing if j != i and places[j].parent == clip.parent]
            last = clip.name.replace(".", "-") if same_place else title(clip)
            names[i] = "-".join([*clip.parent.parts[1:][-depth:], last])
    for i, name in enumerate(names):
        if _count(names[:i], name):
            names[i] = next(new for n in range(2, len(names) + 2) if not _count(names, new := f"{name}-{n}"))
    return [f"{name}-{recipe}" for name in names]


def absolute(clip: Path) -> Path:
    """The whole path under the name that was given: a link keeps its own."""
    return Path(os.path.abspath(clip))  # noqa: PTH100 -- Path.resolve follows links


def _count(names: Sequence[str], name: str) -> int:
    return sum(other.casefold() == name.casefold() for other in names)


def title(clip: Path) -> str:
    """What a clip is called: a file's name without its suffix; the name of a folder, also where `*.png` follows it."""
    full = absolute(clip)
    if full.is_dir():
        return full.name
    return full.parent.name if "*" in full.name and not full.exists() else full.stem


def run_batch(jobs: Sequence[Job], workers: int, stop: Stop, progress: Progress) -> Iterator[Ended]:
    """Run `jobs`, `workers` at a time; each is yielded as it ends. One that fails does not stop the others.

    Once `stop` says so, those at work close their files and the rest are not begun.
    """
    if workers == 1:
        for i, job in enumerate(jobs, 1):
            if stop():
                return
            progress.begin(f"[{i}/{len(jobs)}] {job.clip.name}", "frames", None)
            yield _attempt(job, stop, progress.update)
        return
    began, finished = time.monotonic(), 0
    progress.begin(f"{len(jobs)} clips", "clips", len(jobs))

    def report(frames: int) -> None:
        progress.update(finished, len(jobs), frames / (time.monotonic() - began))

    for i, ended in side_by_side(jobs, _attempt, workers, stop, report, threads=jobs[0].threads if jobs else 1):
        finished += 1
        if isinstance(ended, Exception):
            clip = jobs[i].clip
            ended = Ended(clip, None, f"{clip}: {ended}, nothing was kept", ExitCode.FAULT)
        yield ended


def check_all(jobs: Sequence[Job]) -> tuple[list[Ended], list[Job]]:
    """The jobs that cannot work, with what speaks against each, and the others."""
    refused: list[Ended] = []
    accepted: list[Job] = []
    for job in jobs:
        try:
            check(job)
        except FacetrackError as e:
            refused.append(Ended(job.clip, None, *_failure(e)))
        else:
            accepted.append(job)
    return refused, accepted


def _attempt(job: Job, stop: Stop, report: Report) -> Ended:
    try:
        outcome = run(job, stop, report)
    except Exception as e:
        return Ended(job.clip, None, *_failure(e))
    if outcome.error is not None:
        # an exception need not survive the way between processes; its line does
        return Ended(job.clip, replace(outcome, error=None), *_failure(outcome.error))
    return Ended(job.clip, outcome)


def _failure(error: Exception) -> tuple[str, ExitCode]:
    if os.environ.get("FACETRACK_DEBUG", "") not in ("", "0"):
        traceback.print_exception(error)
    if isinstance(error, FacetrackError):
        return str(error), error.exit_code
    return f"internal error, please report it: {type(error).__name__}: {error}", ExitCode.FAULT
