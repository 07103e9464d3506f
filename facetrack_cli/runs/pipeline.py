"""Decoding, tracking and encoding side by side.

    decode --(frames)--> track, write rows --(results)--> paint

Each arrow is a queue of a few frames, fewer if they are large: memory is bounded, and the slowest stage sets the pace.
Every stage sees the frames in their order, whatever the number of threads: the output is the same.
"""

import contextlib
import threading
from collections.abc import Callable, Iterable, Iterator
from queue import Empty, Full, Queue
from typing import Generic, TypeVar

import cv2

from facetrack_cli.core.types import Frame
from facetrack_cli.runs.signals import never
from facetrack_cli.trajectory.trajectory import FrameResult

MAX_QUEUE = 4  # frames in each queue
MAX_QUEUE_BYTES = 32 << 20  # of their pixels, unless one frame alone has more
POLL_S = 0.1  # how long a stage sleeps at most before it looks whether the run was cancelled
PATIENCE_S = 1.0  # a decoder that does not come back from a read is left behind after this long
T = TypeVar("T")


def share_threads(threads: int) -> None:
    """Leave one thread to decoding. Idle threads of OpenCV spin: on two cores this takes a tenth of a run."""
    cv2.setNumThreads(max(threads - 1, 1))


@contextlib.contextmanager
def decoded_ahead(
    frames: Iterable[Frame], *, threaded: bool = True, stopped: Callable[[], bool] = never
) -> Iterator[Iterator[Frame]]:
    """The frames in a `with`, decoded in a thread of their own. `stopped` is asked before each; then they end.

    An exception of `frames` is raised behind the frames that came before it.
    """
    if not threaded:
        yield _until(frames, stopped)
        return
    cancelled = threading.Event()
    decoded = _Channel[Frame](cancelled.is_set)

    def decode() -> None:
        try:
            if all(map(decoded.put, frames)):  # which holds no frame while the next one is decoded
                decoded.put(None)
        except BaseException as e:
            decoded.put(e)

    decoder = threading.Thread(target=decode, name="decode", daemon=True)
    decoder.start()
    try:
        yield decoded.items(stopped)
    finally:
        cancelled.set()
        decoder.join(PATIENCE_S)


class Painter:
    """Paints results, in their order, in a thread of its own. An exception of `paint` is raised by `put` or `end`."""

    def __init__(self, paint: Callable[[FrameResult], None], *, threaded: bool = True) -> None:
        self._paint, self._error = paint, list[BaseException]()
        self._results = _Channel[FrameResult](lambda: bool(self._error))
        self._thread = threading.Thread(target=self._run, name="paint", daemon=True) if threaded else None
        if self._thread is not None:
            self._thread.start()

    def put(self, result: FrameResult) -> None:
        if self._thread is None:
            self._paint(result)
        elif not self._results.put(result):
            self.end()

    def end(self) -> None:
        """Wait until all is painted."""
        if self._thread is not None:
            self._results.put(None)
            self._thread.join()
            self._thread = None
            if self._error:
                raise self._error[0]

    def _run(self) -> None:
        try:
            for result in self._results.items(never):
                self._paint(result)
        except BaseException as e:
            self._error.append(e)


def _until(frames: Iterable[Frame], stopped: Callable[[], bool]) -> Iterator[Frame]:
    if not stopped():
        for frame in frames:
            yield frame
            if stopped():
                return


class _Channel(Generic[T]):
    """A bounded queue. Either end gives up on request, so that no stage waits for one that has ended."""

    def __init__(self, given_up: Callable[[], bool]) -> None:
        self._queue, self._given_up = Queue[T | BaseException | None](MAX_QUEUE), given_up

    def put(self, item: T | BaseException | None) -> bool:
        """Append an item; False if the reader is gone. None ends the items; an exception is raised in the reader."""
        frame = item.frame if isinstance(item, FrameResult) else item
        if isinstance(frame, Frame):
            in_colours = max(3 * frame.size[0] * frame.size[1], 1)
            self._queue.maxsize = max(1, min(MAX_QUEUE, MAX_QUEUE_BYTES // in_colours))
        while not self._given_up():
            with contextlib.suppress(Full):
                self._queue.put(item, timeout=POLL_S)
                return True
        return False

    def items(self, stopped: Callable[[], bool]) -> Iterator[T]:
        while not stopped():
            try:
                item = self._queue.get(timeout=POLL_S)
            except Empty:
                continue
            if item is None:
                return
            if isinstance(item, BaseException):
                raise item
            yield item
            del item  # while the next one is waited for
