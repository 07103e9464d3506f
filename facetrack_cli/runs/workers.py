"""Tasks in processes of their own, N at a time: with progress, a wish to stop, and none that takes another down."""

import contextlib
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.context import BaseContext
from multiprocessing.sharedctypes import Synchronized
from typing import Any, TypeAlias

import cv2

from facetrack_cli.core.errors import ExitCode, FacetrackError
from facetrack_cli.runs.signals import Stop

Work: TypeAlias = Callable[[Any, Stop, Callable[..., None]], Any]
"""A function of a module: from a task, the wish to stop, and whom to report the frames done, to a result."""
Ending: TypeAlias = "Synchronized[int]"  # the exit code of the wish to stop, 0 without one
REPORT_S = 0.2  # between a worker's reports
LOOK_S = 0.2  # between two looks at the signals


class DiedError(FacetrackError):
    """A process ended by itself, and its result is lost; the argument says how."""


def side_by_side(
    tasks: Sequence[Any],
    work: Work,
    workers: int,
    stop: Stop,
    report: Callable[[int], None] = lambda frames: None,
    *,
    threads: int = 1,
) -> Generator[tuple[int, Any], None, None]:
    """Do `tasks`, `workers` at a time: the index and the result of each as it ends, or the exception that ended it.

    `report` hears how many frames are done in all, now and then. Once `stop` says so, those at work are told, and the
    rest are not begun. Each process holds OpenCV to `threads` threads. One worker is this process.
    """
    if workers == 1:
        yield from _here(tasks, work, stop, report)
        return
    with _starting():
        context = worker_context()
        ending: Ending = context.Value("i", 0)
    waiting = list(reversed(list(enumerate(tasks))))
    working: list[_Worker] = []
    before = 0
    try:
        while waiting or working:
            if stop():
                waiting.clear()
                ending.value = stop.code or ExitCode.INTERRUPTED
            while waiting and len(working) < workers:
                index, task = waiting.pop()
                with _starting():
                    working.append(_Worker(context, index, work, task, ending, threads))
            wait([worker.pipe for worker in working], timeout=LOOK_S)
            for worker in list(working):
                if not worker.listen():
                    working.remove(worker)
                    before += worker.frames
                    yield worker.index, worker.result
            report(before + sum(worker.frames for worker in working))
    finally:
        ending.value = ending.value or ExitCode.INTERRUPTED
        for worker in working:
            worker.process.join()


def _here(tasks: Sequence[Any], work: Work, stop: Stop, report: Callable[[int], None]) -> Iterator[tuple[int, Any]]:
    done = [0] * len(tasks)
    for index, task in enumerate(tasks):
        if stop():
            return

        def add(frames: int, total: int | None = None, index: int = index) -> None:
            done[index] = frames
            report(sum(done))

        yield index, _result(work, task, stop, add)


def _result(work: Work, task: object, stop: Stop, report: Callable[..., None]) -> object:
    try:
        return work(task, stop, report)
    except Exception as e:  # it goes on where the tasks come from
        return e


class _Worker:
    """A process at work on one task, and the pipe that it reports through."""

    def __init__(self, context: BaseContext, index: int, *asked: object) -> None:
        self.index = index
        self.frames = 0
        self.result: object = None
        self._ended = False
        self.pipe, theirs = context.Pipe(duplex=False)
        self.process = context.Process(target=_serve, args=(theirs, *asked))  # type: ignore[attr-defined]
        self.process.start()
        theirs.close()

    def listen(self) -> bool:
        """Take in what the process says; False once it has said its last."""
        try:
            while self.pipe.poll():
                said = self.pipe.recv()
                if isinstance(said, int):
                    self.frames = said
                else:
                    self._ended, (self.result,) = True, said
        except EOFError:
            self.process.join()
            self.pipe.close()
            if not self._ended:
                self.result = DiedError(f"its process ended with code {self.process.exitcode}")
            return False
        return True


def _serve(pipe: Connection, work: Work, task: object, ending: Ending, threads: int) -> None:
    """What a process does: its task, and to stop when asked by a signal, by its parent, or by its parent's end."""
    # Ctrl-C reaches every process of a terminal; the parent alone acts on it
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = os.getppid()
    last = 0.0

    def send(said: object) -> None:
        # when nobody listens any more, what there is to close is closed all the same
        with contextlib.suppress(OSError):
            pipe.send(said)

    def report(done: int, total: int | None = None) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= REPORT_S:
            last = now
            send(done)

    def asked() -> ExitCode | None:
        if ending.value:
            return ExitCode(ending.value)
        return ExitCode.INTERRUPTED if os.getppid() != parent else None

    cv2.setNumThreads(threads)
    with Stop(asked).listening() as stop:
        send((_result(work, task, stop, report),))
    pipe.close()


@contextlib.contextmanager
def _starting() -> Iterator[None]:
    try:
        yield
    except (OSError, EOFError) as e:  # a broken pipe here is none of standard output
        raise FacetrackError(f"processes for -j cannot be started ({e}); run without -j") from e


def worker_context() -> BaseContext:
    """How processes are started: safely beside threads, and with the heavy imports done once."""
    # a server that has the heavy imports behind it forks a worker at once; plain fork is not safe beside threads
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    from multiprocessing import forkserver, resource_tracker

    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["facetrack_cli.runs.clip"])
    resource_tracker.ensure_running()  # first: it lifts the mask when it starts
    # out of reach of Ctrl-C, which would break into its imports with a traceback
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return context


def cores() -> int:
    """The processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
