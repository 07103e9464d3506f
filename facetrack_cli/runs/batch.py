"""Several clips: where the results of each go, and N of them at a time.

What is done, and what failed, is what the folders say, before a clip is begun and again once its folder is claimed. So
several batches on the same folders, also of several machines, share the clips.
"""

import contextlib
import hashlib
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final

from facetrack_cli.core.errors import BusyError, FacetrackError
from facetrack_cli.core.files import absolute
from facetrack_cli.core.log import about
from facetrack_cli.recipe.model import to_dict
from facetrack_cli.run_folder.lease import FolderLease, holder, is_held
from facetrack_cli.run_folder.manifest import as_line, recover_interrupted
from facetrack_cli.runs.clip import run
from facetrack_cli.runs.job import Job, Outcome, Report, check, ended, note_failure, silent
from facetrack_cli.runs.pipeline import share_threads
from facetrack_cli.runs.progress import Progress
from facetrack_cli.runs.signals import Stop
from facetrack_cli.runs.workers import DiedError, cores, side_by_side
from facetrack_cli.tracking.kernels.precompile import Precompiler

TRIES: Final = 2  # of a clip whose process a signal ends
LOOK_S: Final = 0.5  # between two looks whether a clip of somebody else is free
SETTLE_S: Final = 10.0  # between two looks whether its claim is stale
_LONGEST: Final = 60  # characters of settings in the name of a folder


def variant_name(recipe: str, settings: Sequence[str]) -> str:
    """A recipe's name with the settings that are changed, as in `face-filter.particles=500`; a digest of long ones."""
    said = ",".join("".join(c if c.isalnum() or c in ".=_+" else "-" for c in one.strip()) for one in settings)
    if len(said) > _LONGEST:
        said = "set-" + hashlib.sha256(",".join(settings).encode("utf-8", "surrogateescape")).hexdigest()[:8]
    return f"{recipe}-{said}" if said else recipe


def folders(clips: Sequence[Path], recipe: str) -> list[str]:
    """A folder name for the results of each clip, `<clip>-<recipe>`; no two are the same.

    Clips of one name are told apart by the folders they lie in, as many as it takes; in one folder, by their suffix.
    """
    places = [absolute(clip) for clip in clips]
    names = [title(clip) for clip in clips]
    for depth in range(1, max((len(clip.parts) for clip in places), default=0) + 2):
        count = Counter(map(str.casefold, names))
        clashing = [i for i, name in enumerate(names) if count[name.casefold()] > 1]
        beside = Counter(places[i].parent for i in clashing)
        for i in clashing:
            clip = places[i]
            last = clip.name.replace(".", "-") if beside[clip.parent] > 1 else title(clip)
            names[i] = "-".join([*clip.parent.parts[1:][-depth:], last])
    taken: set[str] = set()
    count = Counter(map(str.casefold, names))
    for i, name in enumerate(names):
        if name.casefold() in taken:
            names[i] = next(new for n in range(2, len(names) + 2) if not count[(new := f"{name}-{n}").casefold()])
            count[names[i].casefold()] += 1
        taken.add(names[i].casefold())
    return [f"{name}-{recipe}" for name in names]


def title(clip: Path) -> str:
    """What a clip is called: a file's name without its suffix; the name of a folder, also where `*.png` follows it."""
    full = absolute(clip)
    if full.is_dir():
        return full.name
    return full.parent.name if "*" in full.name and not full.exists() else full.stem


def check_all(jobs: Sequence[Job]) -> tuple[list[Outcome], list[Job]]:
    """What became of the jobs that are done already, have failed before, or cannot work; and the others."""
    decided: list[Outcome] = []
    left: list[Job] = []
    for job in jobs:
        try:
            known = None if job.out is not None and is_held(job.out) else ended(job)
            if known is None:
                check(job)
        except FacetrackError as e:
            known = Outcome(clip=job.clip, error=as_line(e))
        if known is None:
            left.append(job)
        else:
            decided.append(known)
    return decided, left


def run_batch(jobs: Sequence[Job], workers: int, stop: Stop, progress: Progress) -> Iterator[Outcome]:
    """Run `jobs`, `workers` at a time in processes of this machine; as `share`."""

    def turn(jobs: Sequence[Job]) -> Iterator[tuple[Job, Outcome]]:
        return _turn(jobs, min(workers, len(jobs)), stop, progress)

    return share(jobs, turn, stop, progress)


def share(
    jobs: Sequence[Job],
    turn: Callable[[Sequence[Job]], Iterator[tuple[Job, Outcome]]],
    stop: Stop,
    progress: Progress,
) -> Iterator[Outcome]:
    """Run `jobs` by `turn`; each outcome is yielded as it ends. A job that fails does not stop the others.

    Clips that another facetrack is tracking come last: they are waited for, and tracked if nobody does any more. Once
    `stop` says so, the clips at work close their files and the others are not begun.
    """
    left, busy, told = list(jobs), list[Job](), False
    while (left or busy) and not stop():
        for job, outcome in turn(left):
            if isinstance(outcome.error, BusyError):
                busy.append(job)
            else:
                yield outcome
        if busy and not told and not stop():
            told = True
            progress.say(_waiting(busy))
        free, busy = _wait(busy, stop)
        decided, left = check_all(free)
        yield from decided


def _turn(jobs: Sequence[Job], workers: int, stop: Stop, progress: Progress) -> Iterator[tuple[Job, Outcome]]:
    if workers <= 1:
        for i, job in enumerate(jobs, 1):
            if stop():
                return
            share_threads(job.threads)
            progress.begin(f"[{i}/{len(jobs)}] {job.clip.name}", "frames", None)
            yield job, attempt(job, stop, progress.update, progress.looked)
        return
    progress.begin(f"{len(jobs)} clips", "clips", len(jobs))
    with Precompiler(to_dict(jobs[0].recipe), cores()) as compiler:  # or each of the workers would compile them
        compiler.finish(stop, progress.looked)
    began, finished = time.monotonic(), 0

    def report(frames: int) -> None:
        progress.update(finished, len(jobs), frames / (time.monotonic() - began))

    results = side_by_side(jobs, attempt, workers, stop, report, threads=jobs[0].threads, tries=TRIES)
    for i, result in results:
        finished += 1
        yield jobs[i], died(jobs[i], result) if isinstance(result, Exception) else result


def _waiting(busy: Sequence[Job]) -> str:
    notes = [holder(job.out) for job in busy if job.out is not None]
    hosts = sorted({str(note["host"]) for note in notes if note is not None and "host" in note})
    where = f" on {', '.join(hosts)}" if hosts else ""
    if len(busy) == 1:
        return f"1 clip is being tracked by another facetrack{where}; waiting for it"
    return f"{len(busy)} clips are being tracked by another facetrack{where}; waiting for them"


def _wait(busy: Sequence[Job], stop: Stop) -> tuple[list[Job], list[Job]]:
    """The clips of others, once one of them at least is not being tracked any more: those, and the rest."""
    settled = time.monotonic()
    while busy and not stop():
        those = [(job, job.out is not None and is_held(job.out)) for job in busy]
        if not all(held for _, held in those):
            return [job for job, held in those if not held], [job for job, held in those if held]
        time.sleep(LOOK_S)
        if time.monotonic() - settled > SETTLE_S:  # which removes a claim that is stale
            settled = time.monotonic()
            for job in busy:
                if job.out is not None:
                    recover_interrupted(job.out, stop)
    return [], []


def died(job: Job, error: Exception) -> Outcome:
    """What becomes of a clip whose process ended by itself."""
    frames = 0 if job.out is None else recover_interrupted(job.out)
    with contextlib.suppress(FacetrackError):  # an earlier turn may have come farther
        frames = max(frames, known.frames if (known := job.previous()) is not None else 0)
    kept = f"the {frames} frames that it had tracked are kept" if frames else "nothing was kept"
    said = FacetrackError(f"{job.clip}: {error}; {kept}")
    log = error.log if isinstance(error, DiedError) else ()
    if job.out is not None and job.batch:
        with contextlib.suppress(FacetrackError), FolderLease(job.out) as lock:
            note_failure(job, lock, said, log)
    return Outcome(clip=job.clip, error=said)


def attempt(job: Job, stop: Stop, report: Report = silent, looked: Report = silent) -> Outcome:
    """Run a job; its error is in the outcome, as one line."""
    with about(job.clip.name):
        try:
            outcome = run(job, stop, report, looked)
        except Exception as e:
            outcome = Outcome(clip=job.clip, error=e)
        outcome.error = outcome.error and as_line(outcome.error)
    return outcome
