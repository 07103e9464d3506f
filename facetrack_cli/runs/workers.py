"""Threads of a run, and processes of many.

Decoding, tracking and encoding go side by side:

    decode --(frames)--> track, write rows --(results)--> paint

Each arrow is a queue of a few frames, fewer if they are large: memory is bounded, and the slowest stage sets the pace.
Every stage sees the frames in their order, whatever the number of threads: the output is the same.

Tasks are done in processes of their own, N at a time. A process that dies is replaced, and takes no other task down.
"""

from __future__ import annotations

import contextlib
import faulthandler
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from itertools import takewhile
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import cv2

from facetrack_cli.core.errors import ExitCode, FacetrackError
from facetrack_cli.core.types import Frame
from facetrack_cli.runs.signals import Stop, never
from facetrack_cli.trajectory.trajectory import FrameResult

if TYPE_CHECKING:
    from multiprocessing.connection import Connection
    from multiprocessing.context import BaseContext
    from multiprocessing.process import BaseProcess

T = TypeVar("T")
MAX_QUEUE = 4  # frames in each queue
MAX_QUEUE_BYTES = 32 << 20  # of their pixels, unless one frame alone has more
POLL_S = 0.1  # how long a stage sleeps at most before it looks whether the run was cancelled
PATIENCE_S = 0.5  # a decoder that does not come back from a read is left behind after this long


def share_threads(threads: int) -> None:
    """Leave one thread to decoding. Idle threads of OpenCV spin: on two cores this takes a tenth of a run."""
    cv2.setNumThreads(max(threads - 1, 1))


def _room(frame: Frame) -> int:
    """How many frames of this size wait for a stage at most."""
    return max(1, min(MAX_QUEUE, MAX_QUEUE_BYTES // max(3 * frame.size[0] * frame.size[1], 1)))


@contextlib.contextmanager
def decoded_ahead(
    frames: Iterable[T], *, threaded: bool = True, most: int = MAX_QUEUE, stopped: Callable[[], bool] = never
) -> Iterator[Iterator[T]]:
    """Frames or images in a `with`, decoded in a thread of their own. `stopped` is asked before each; then they end.

    An exception of `frames` is raised behind the frames that came before it.
    """
    if not threaded:
        yield takewhile(lambda _: not stopped(), frames)
        return
    queue, room, cancelled = SimpleQueue[T | BaseException | None](), SimpleQueue[None](), threading.Event()
    seats = 0  # for frames that wait; `room` has those that are free

    def put(item: T) -> bool:
        nonlocal seats
        if not seats:
            seats = min(most, _room(item)) if isinstance(item, Frame) else most
            for _ in range(seats):
                room.put(None)
        while not cancelled.is_set():
            with contextlib.suppress(Empty):
                room.get(timeout=POLL_S)
                queue.put(item)
                return True
        return False

    def decode() -> None:
        try:
            if all(map(put, frames)):  # which holds no frame while the next one is decoded
                queue.put(None)
        except BaseException as e:
            queue.put(e)

    def decoded() -> Iterator[T]:
        free = 0
        while not stopped():
            try:
                item = queue.get(timeout=POLL_S)
            except Empty:
                continue
            if item is None:
                return
            if isinstance(item, BaseException):
                raise item
            free += 1
            if 2 * free >= seats or queue.empty():  # the decoder is woken for several frames at a time
                for _ in range(free):
                    room.put(None)
                free = 0
            yield item
            del item  # while the next one is waited for

    decoder = threading.Thread(target=decode, name="decode", daemon=True)
    decoder.start()
    try:
        yield decoded()
    finally:
        cancelled.set()
        decoder.join(PATIENCE_S)


class Painter:
    """Paints results, in their order, in a thread of its own. An exception of `paint` is raised by what comes after."""

    def __init__(self, paint: Callable[[FrameResult], None], *, threaded: bool = True) -> None:
        self._paint, self._waiting = paint, deque[Future[None]]()
        self._thread = ThreadPoolExecutor(1, "paint") if threaded else None
        self._failed = False

    def put(self, result: FrameResult) -> None:
        if self._thread is None:
            self._paint(result)
            return
        self._waiting.append(self._thread.submit(self._next, result))
        while len(self._waiting) > _room(result.frame):
            self._waiting.popleft().result()

    def _next(self, result: FrameResult) -> None:
        if not self._failed:
            self._failed = True  # unless it is painted: nothing follows a frame that is not
            self._paint(result)
            self._failed = False

    def end(self) -> None:
        """Wait until all is painted."""
        try:
            while self._waiting:
                self._waiting.popleft().result()
        finally:
            if self._thread is not None:
                self._thread.shutdown(cancel_futures=True)
                self._waiting.clear()


Work: TypeAlias = Callable[[Any, Stop, Callable[..., None]], Any]
"""A module's function of a task, the wish to stop, and a function to report the frames done; it gives the result."""
REPORT_S = 0.2  # between two reports of a process
LOOK_S = 0.2  # between two looks at the wish to stop
ORPHAN_S = 1.5  # for a task to close its files, once the process that gave it is gone


def side_by_side(
    tasks: Sequence[Any],
    work: Work,
    workers: int,
    stop: Stop,
    report: Callable[[int], None] = lambda frames: None,
    *,
    threads: int = 1,
) -> Generator[tuple[int, Any], None, None]:
    """Do `tasks`, `workers` at a time; yield the index and the result of each as it ends, or the exception.

    `report` hears how many frames are done in all. Once `stop` says so, the tasks at work are told, and the others are
    not begun. Each process does one task after another, and holds OpenCV to `threads` threads. If a signal ends a
    process, its task is tried again, once. With one worker the tasks are done in this process.
    """
    if workers == 1 or not tasks:
        done = [0] * len(tasks)

        def add(index: int, frames: int, total: int | None = None) -> None:
            done[index] = frames
            report(sum(done))

        for index, task in enumerate(tasks):
            if stop():
                return
            yield index, _result(work, task, stop, partial(add, index))
        return
    from multiprocessing.connection import wait

    waiting = deque((index, True) for index in range(len(tasks)))
    running: dict[Any, tuple[int, bool, BaseProcess]] = {}
    idle: list[tuple[Any, BaseProcess]] = []
    with _starting():
        context: Any = worker_context()
        # without locks: a process that is killed while it holds a lock would stop all others
        ending, frames = context.RawValue("i", 0), context.RawArray("q", len(tasks))
    try:
        while waiting or running:
            if stop():
                waiting.clear()
                ending.value = stop.code or ExitCode.INTERRUPTED
            while waiting and len(running) < workers:
                if idle:
                    pipe, process = idle.pop()
                else:
                    with _starting():
                        pipe, theirs = context.Pipe()
                        process = context.Process(target=_do, args=(theirs, work, ending, frames, threads), daemon=True)
                        process.start()
                        theirs.close()
                with contextlib.suppress(OSError):  # it has died while it had no task
                    pipe.send((waiting[0][0], tasks[waiting[0][0]]))
                    running[pipe] = *waiting.popleft(), process
            ready: list[Any] = wait([*running], LOOK_S)
            for pipe in ready:
                index, first, process = running.pop(pipe)
                try:
                    result = pipe.recv()
                    idle.append((pipe, process))
                except (EOFError, OSError):
                    process.join()
                    code = process.exitcode or 0
                    if code < 0 and first and not stop():
                        waiting.appendleft((index, False))
                        continue
                    memory = " (too little memory?)" * (code == -9)
                    result = FacetrackError(f"its process ended with code {code}{memory}")
                except Exception as e:  # a result that cannot be put together here, as an error of a plug-in may be
                    idle.append((pipe, process))
                    result = e
                yield index, result
            report(sum(frames))
    finally:
        ending.value = ending.value or ExitCode.INTERRUPTED
        for pipe, process in [*idle, *((pipe, process) for pipe, (*_, process) in running.items())]:
            pipe.close()
            process.join()


def _result(work: Work, task: object, stop: Stop, report: Callable[..., None]) -> object:
    try:
        return work(task, stop, report)
    except Exception as e:  # it goes on where the tasks come from
        return e


# --- in the processes ------------------------------------------------------------------------------------------------


def _do(pipe: Connection, work: Work, ending: Any, frames: Any, threads: int) -> None:
    """Do the tasks of a pipe. All share `ending`, the exit code of the wish to stop or 0, and the `frames` done."""
    threading.Thread(target=_end_with_parent, args=(ending,), name="parent", daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes of a terminal; the parent acts on it
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115, PTH123 -- for as long as the process lives
    faulthandler.enable()
    share_threads(threads)
    last = 0.0

    def report(done: int, total: int | None = None) -> None:
        nonlocal last
        if (now := time.monotonic()) - last >= REPORT_S:
            last, frames[index] = now, done

    with contextlib.suppress(EOFError, OSError):  # there are no more
        while True:
            index, task = pipe.recv()
            # the parent asked to stop, or has died
            with Stop(lambda: ExitCode(ending.value) if ending.value else None).listening() as stop:
                pipe.send(_result(work, task, stop, report))


def _end_with_parent(ending: Any) -> None:
    """End when the process that gives the tasks has ended: one that is killed tells nobody."""
    parent: Any = multiprocessing.parent_process()
    parent.join()  # by a pipe's end, whoever has forked us
    ending.value = ending.value or ExitCode.INTERRUPTED
    time.sleep(ORPHAN_S)
    os._exit(ExitCode.INTERRUPTED)


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
