"""Several clips: where the results of each go, and N of them at a time."""

import os
import time
import traceback
from collections.abc import Iterator, Sequence
from pathlib import Path

from facetrack_cli.core.errors import FacetrackError, from_system
from facetrack_cli.runs.clip import run
from facetrack_cli.runs.job import Job, Outcome, Report, check
from facetrack_cli.runs.progress import Progress
from facetrack_cli.runs.signals import Stop
from facetrack_cli.runs.workers import side_by_side
from facetrack_cli.trajectory.killed import settle


def folders(clips: Sequence[Path], recipe: str) -> list[str]:
    """A folder name for the results of each clip, `<clip>-<recipe>`; no two are the same.

    Clips of one name are told apart by the folders they lie in, as many as it takes; those of one folder, by their
    suffix.
    """
    places = [absolute(clip) for clip in clips]
    names = [title(clip) for clip in clips]
    for depth in range(1, max((len(clip.parts) for clip in places), default=0) + 2):
        clashing = [i for i, name in enumerate(names) if _count(names, name) > 1]
        beside = [places[i].parent for i in clashing]
        for i in clashing:
            clip = places[i]
            last = clip.name.replace(".", "-") if beside.count(clip.parent) > 1 else title(clip)
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


def run_batch(jobs: Sequence[Job], workers: int, stop: Stop, progress: Progress) -> Iterator[Outcome]:
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
        yield _died(jobs[i], ended) if isinstance(ended, Exception) else ended


def _died(job: Job, ended: Exception) -> Outcome:
    """What becomes of a clip whose process ended by itself."""
    frames = 0 if job.out is None else settle(job.out)
    kept = f"the {frames} frames that it had tracked are kept" if frames else "nothing was kept"
    return Outcome(job.clip, error=FacetrackError(f"{job.clip}: {ended}; {kept}"))


def check_all(jobs: Sequence[Job]) -> tuple[list[Outcome], list[Job]]:
    """The jobs that cannot work, with what speaks against each, and the others."""
    refused: list[Outcome] = []
    accepted: list[Job] = []
    for job in jobs:
        try:
            check(job)
            accepted.append(job)
        except FacetrackError as e:
            refused.append(Outcome(job.clip, error=_line(e)))
    return refused, accepted


def _attempt(job: Job, stop: Stop, report: Report) -> Outcome:
    try:
        outcome = run(job, stop, report)
    except Exception as e:
        outcome = Outcome(job.clip, error=e)
    outcome.error = outcome.error and _line(outcome.error)
    return outcome


def _line(error: Exception) -> FacetrackError:
    """The error as its line alone: an exception need not survive the way between processes."""
    if os.environ.get("FACETRACK_DEBUG", "") not in ("", "0"):
        traceback.print_exception(error)
    if isinstance(error, FacetrackError):
        return FacetrackError(str(error))
    if (of_system := from_system(error)) is not None:
        return of_system
    return FacetrackError(f"internal error, please report it: {type(error).__name__}: {error}")
