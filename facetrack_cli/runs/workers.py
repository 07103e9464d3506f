"""Tasks in processes of their own, N at a time: with progress, a wish to stop, and none that takes another down."""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import multiprocessing
import os
import signal
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.context import BaseContext
from pathlib import Path
from typing import Any, TypeAlias

from facetrack_cli.core.errors import ExitCode, FacetrackError
from facetrack_cli.runs.pipeline import share_threads
from facetrack_cli.runs.signals import Stop

Work: TypeAlias = Callable[[Any, Stop, Callable[..., None]], Any]
"""A function of a module: from a task, the wish to stop, and whom to report the frames done, to a result."""
Ending: TypeAlias = ctypes.c_int  # the exit code of the wish to stop, 0 without one
REPORT_S = 0.2  # between a worker's reports
LOOK_S = 0.2  # between two looks at the signals


class DiedError(FacetrackError):
    """A process ended by itself, and its result is lost; the argument says how, `log` what it said last."""

    def __init__(self, how: str, log: Sequence[str] = ()) -> None:
        super().__init__(how)
        self.log = tuple(log)


def side_by_side(
    tasks: Sequence[Any],
    work: Work,
    workers: int,
    stop: Stop,
    report: Callable[[int], None] = lambda frames: None,
    *,
    threads: int = 1,
    tries: int = 1,
) -> Generator[tuple[int, Any], None, None]:
    """Do `tasks`, `workers` at a time: the index and the result of each as it ends, or the exception that ended it.

    `report` hears how many frames are done in all, now and then. Once `stop` says so, those at work are told, and the
    rest are not begun. Each process does one task after the other, and holds OpenCV to `threads` threads; one that
    dies is replaced, and if a signal ended it, its task is tried `tries` times. One worker is this process.
    """
    if workers == 1:
        yield from _here(tasks, work, stop, report)
        return
    waiting = deque((index, 1) for index in range(len(tasks)))
    with contextlib.ExitStack() as logs:
        pool = _Pool(work, threads, workers, Path(logs.enter_context(_log_folder())))
        try:
            while waiting or any(worker.busy for worker in pool.workers):
                if stop():
                    waiting.clear()
                    pool.ending.value = stop.code or ExitCode.INTERRUPTED
                while waiting and (worker := pool.idle()) is not None:
                    index, turn = waiting.popleft()
                    if not worker.give(index, turn, tasks[index]):  # it has died meanwhile
                        pool.workers.remove(worker)
                        waiting.appendleft((index, turn))
                wait([worker.pipe for worker in pool.workers], timeout=LOOK_S)
                for index, turn, result in pool.ended():
                    killed = isinstance(result, DiedError) and pool.killed
                    if killed and turn < tries and not stop():
                        waiting.appendleft((index, turn + 1))
                    else:
                        yield index, result
                report(pool.frames)
        finally:
            pool.end()


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


class _Pool:
    """The processes. `frames` are those done in all; `killed` is whether a signal ended the one that died last."""

    def __init__(self, work: Work, threads: int, size: int, logs: Path) -> None:
        with _starting():
            self._context = worker_context()
            # no lock: a worker that is killed while it holds one would stop all others
            self.ending: Ending = self._context.RawValue("i", 0)
        self._asked, self._size, self._logs = (work, self.ending, threads), size, logs
        self.workers: list[_Worker] = []
        self._done = self._made = 0
        self.killed = False

    @property
    def frames(self) -> int:
        return self._done + sum(worker.frames for worker in self.workers)

    def idle(self) -> _Worker | None:
        """A process without a task; None if all have one."""
        found = next((worker for worker in self.workers if not worker.busy), None)
        if found is None and len(self.workers) < self._size:
            self._made += 1
            with _starting():
                found = _Worker(self._context, self._logs / f"{self._made}", *self._asked)
            self.workers.append(found)
        return found

    def ended(self) -> Iterator[tuple[int, int, Any]]:
        """The tasks that are over: index, turn, result."""
        for worker in list(self.workers):
            over = worker.listen()
            if worker.died:
                self.workers.remove(worker)
                self.killed = (worker.process.exitcode or 0) < 0
            if over:
                self._done, worker.frames = self._done + worker.frames, 0
                yield worker.index, worker.turn, worker.result

    def end(self) -> None:
        """Let all end their tasks, and wait for them."""
        self.ending.value = self.ending.value or ExitCode.INTERRUPTED
        for worker in self.workers:
            worker.pipe.close()
        for worker in self.workers:
            worker.process.join()


class _Worker:
    """A process, the pipe to it, and the task it is `busy` with: its index, its turn, its frames, its result."""

    def __init__(self, context: BaseContext, log: Path, *asked: object) -> None:
        self.index = self.turn = self.frames = 0
        self.result: object = None
        self.busy = self.died = False
        self._log, self._shown = log, 0
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, log, *asked))  # type: ignore[attr-defined]
        self.process.start()
        theirs.close()

    def give(self, index: int, turn: int, task: object) -> bool:
        """Begin a task; False if the process has ended."""
        self.index, self.turn = index, turn
        try:
            self.pipe.send((task,))
        except OSError:
            self.listen()
            return False
        self.busy = True
        return True

    def listen(self) -> bool:
        """Take in what the process says; whether its task is over."""
        try:
            while self.pipe.poll():
                said = self.pipe.recv()
                if isinstance(said, int):
                    self.frames = said
                    continue
                self.busy, (self.result,) = False, said
                self._relay()
                return True
        except (EOFError, OSError):
            self.process.join()
            self.pipe.close()
            self.died, over, self.busy = True, self.busy, False
            self.result = DiedError(f"its process ended with code {self.process.exitcode}", self._relay(silent=over))
            return over
        return False

    def _relay(self, *, silent: bool = False) -> list[str]:
        """Pass on what the process wrote to standard error, unless `silent`; its lines."""
        with contextlib.suppress(OSError):
            with self._log.open("rb") as file:
                file.seek(self._shown)
                new = file.read()
            self._shown += len(new)
            if new and not silent:
                sys.stderr.write(new.decode(errors="replace"))
            return new.decode(errors="replace").splitlines()
        return []


def _serve(pipe: Connection, log: Path, work: Work, ending: Ending, threads: int) -> None:
    """What a process does: its tasks, and to stop when asked by a signal, by its parent, or by its parent's end."""
    # Ctrl-C reaches every process of a terminal; the parent alone acts on it
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(OSError), log.open("ab") as file:
        os.dup2(file.fileno(), 2)
        faulthandler.enable(2)
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

    share_threads(threads)
    with contextlib.suppress(EOFError, OSError):
        while True:
            (task,) = pipe.recv()
            with Stop(asked).listening() as stop:
                result = _result(work, task, stop, report)
            sys.stderr.flush()
            send((result,))


def _log_folder() -> contextlib.AbstractContextManager[str]:
    return tempfile.TemporaryDirectory(prefix="facetrack-", ignore_cleanup_errors=True)


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
