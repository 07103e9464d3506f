"""Several clips: where each one's results go, and N of them at a time in processes of their own."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.context import BaseContext
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import TypeAlias

from facetrack_cli.core.errors import ExitCode, FacetrackError
from facetrack_cli.runs.clip import run
from facetrack_cli.runs.job import Job, Outcome, Report
from facetrack_cli.runs.outputs import check
from facetrack_cli.runs.progress import Progress
from facetrack_cli.runs.signals import Stop

Ending: TypeAlias = "Synchronized[int]"  # the exit code of the wish to stop, 0 without one

TELL_S = 0.2  # between a worker's reports
LOOK_S = 0.2  # between two looks at the signals


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
        yield from _one_by_one(jobs, stop, progress)
    else:
        yield from _side_by_side(jobs, workers, stop, progress)


def _one_by_one(jobs: Sequence[Job], stop: Stop, progress: Progress) -> Iterator[Ended]:
    for i, job in enumerate(jobs, 1):
        if stop():
            return
        progress.begin(f"[{i}/{len(jobs)}] {job.clip.name}", "frames", None)
        yield _attempt(job, stop, progress.update)


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


# --- processes ---------------------------------------------------------------------------------------------------


class _Worker:
    """A process at work on one job, and the pipe that it tells of it through."""

    def __init__(self, context: BaseContext, job: Job, ending: Ending) -> None:
        self.job = job
        self.frames = 0
        self.ended: Ended | None = None
        self.pipe, theirs = context.Pipe(duplex=False)
        self.process = context.Process(target=_work, args=(job, theirs, ending))  # type: ignore[attr-defined]
        self.process.start()
        theirs.close()

    def listen(self) -> bool:
        """Take in what the process says; False once it has said its last."""
        try:
            while self.pipe.poll():
                said = self.pipe.recv()
                if isinstance(said, Ended):
                    self.ended = said
                    self.frames = said.outcome.frames if said.outcome else self.frames
                else:
                    self.frames = said
        except EOFError:
            self.process.join()
            self.pipe.close()
            if self.ended is None:
                how = f"its process ended with code {self.process.exitcode}"
                self.ended = Ended(self.job.clip, None, f"{self.job.clip}: {how}, nothing was kept", ExitCode.FAULT)
            return False
        return True


def _side_by_side(jobs: Sequence[Job], workers: int, stop: Stop, progress: Progress) -> Iterator[Ended]:
    with _told_of_processes():
        context = worker_context()
        ending: Ending = context.Value("i", 0)
    waiting = list(reversed(jobs))
    working: list[_Worker] = []
    finished = frames_before = 0
    began = time.monotonic()
    progress.begin(f"{len(jobs)} clips", "clips", len(jobs))
    try:
        while waiting or working:
            if stop():
                waiting.clear()
                ending.value = stop.code or ExitCode.INTERRUPTED
            while waiting and len(working) < workers:
                with _told_of_processes():
                    working.append(_Worker(context, waiting.pop(), ending))
            wait([worker.pipe for worker in working], timeout=LOOK_S)
            for worker in list(working):
                if worker.listen():
                    continue
                working.remove(worker)
                finished += 1
                frames_before += worker.frames
                assert worker.ended is not None
                yield worker.ended
            frames = frames_before + sum(worker.frames for worker in working)
            progress.update(finished, len(jobs), frames / (time.monotonic() - began))
    finally:
        ending.value = ending.value or ExitCode.INTERRUPTED
        for worker in working:
            worker.process.join()


@contextlib.contextmanager
def _told_of_processes() -> Iterator[None]:
    try:
        yield
    except (OSError, EOFError) as e:  # a broken pipe here is none of standard output
        raise FacetrackError(f"processes for -j cannot be started ({e}); run without -j") from e


def worker_context() -> BaseContext:
    """How processes are started: safely beside threads, and with the heavy imports done once."""
    # a server that has the heavy imports behind it forks a worker at once; plain fork is not safe beside threads
    if "forkserver" in multiprocessing.get_all_start_methods():
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(
            ["facetrack_cli.runs.batch", "facetrack_cli.tracking.build.build", "facetrack_cli.video.source"]
        )
        _start_server()
        return context
    return multiprocessing.get_context("spawn")


def _start_server() -> None:
    """Start the server out of reach of Ctrl-C, which would break into its imports with a traceback."""
    from multiprocessing import forkserver, resource_tracker

    resource_tracker.ensure_running()  # first: it lifts the mask when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _work(job: Job, pipe: Connection, ending: Ending) -> None:
    """What a worker does: its job, and to stop when asked by a signal, by its parent, or by its parent's end."""
    # Ctrl-C reaches every process of a terminal; the parent alone acts on it
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = os.getppid()
    last = 0.0

    def report(done: int, total: int | None) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= TELL_S:
            last = now
            tell(done)

    def tell(said: object) -> None:
        # when nobody listens any more, what there is to close is closed all the same
        with contextlib.suppress(OSError):
            pipe.send(said)

    def asked() -> ExitCode | None:
        if ending.value:
            return ExitCode(ending.value)
        return ExitCode.INTERRUPTED if os.getppid() != parent else None

    use_threads(job.threads)
    with Stop(asked).listening() as stop:
        tell(_attempt(job, stop, report))
    pipe.close()


def cores() -> int:
    """The processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def use_threads(threads: int) -> None:
    """Hold OpenCV to `threads` threads, in this process."""
    import cv2

    cv2.setNumThreads(threads)
