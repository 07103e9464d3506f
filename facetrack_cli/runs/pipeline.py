"""Decoding, tracking and encoding side by side.

    decode --(frames)--> track, record --(results)--> paint

Each arrow is a queue of a few frames, so memory stays flat and the slowest stage sets the pace. Every stage sees the
frames in their order, whatever the number of threads: what comes out is the same.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Generic, TypeAlias, TypeVar

from facetrack_cli.core.types import Frame
from facetrack_cli.trajectory.trajectory import FrameResult

DEPTH = 4  # frames in each queue
POLL_S = 0.1  # how long a stage sleeps at most before it looks whether the run was cancelled
PATIENCE_S = 1.0  # a decoder that does not come back from a read is left behind after this long

T = TypeVar("T")
Track: TypeAlias = Callable[[Iterator[Frame]], Iterator[FrameResult]]
Effect: TypeAlias = Callable[[FrameResult], None]


def run(
    frames: Iterable[Frame],
    track: Track,
    record: Effect,
    paint: Effect | None = None,
    *,
    threaded: bool = True,
    stopped: Callable[[], bool] = lambda: False,
) -> None:
    """Track `frames`; `record` every result in this thread, then `paint` it (in a thread of its own).

    `stopped` is asked before each frame; once it says yes, the results so far are painted and the call returns.
    The first exception of any stage ends the others and is raised here, after what came before it was painted.
    """
    if not threaded:
        for result in track(_until(frames, stopped)):
            record(result)
            if paint is not None:
                paint(result)
        return

    cancel = threading.Event()
    decoder = _Decoder(frames, cancel)
    painter = None if paint is None else _Painter(paint)
    decoder.start()
    if painter is not None:
        painter.start()
    try:
        for result in track(decoder.frames(stopped)):
            record(result)
            if painter is not None:
                painter.put(result)
    finally:
        cancel.set()
        if painter is not None:
            painter.finish()
        decoder.join(PATIENCE_S)
    if painter is not None and painter.error is not None:
        raise painter.error


def _until(frames: Iterable[Frame], stopped: Callable[[], bool]) -> Iterator[Frame]:
    if stopped():
        return
    for frame in frames:
        yield frame
        if stopped():
            return


class _End:
    pass


class _Channel(Generic[T]):
    """A bounded queue whose both ends give up when told to, so that no stage waits for one that has ended."""

    def __init__(self) -> None:
        self._queue: queue.Queue[T | _End | BaseException] = queue.Queue(DEPTH)

    def put(self, item: T | _End | BaseException, given_up: Callable[[], bool]) -> bool:
        while not given_up():
            try:
                self._queue.put(item, timeout=POLL_S)
                return True
            except queue.Full:
                continue
        return False

    def items(self, given_up: Callable[[], bool]) -> Iterator[T]:
        while not given_up():
            try:
                item = self._queue.get(timeout=POLL_S)
            except queue.Empty:
                continue
            if isinstance(item, _End):
                return
            if isinstance(item, BaseException):
                raise item
            yield item


class _Decoder(threading.Thread):
    """Reads ahead. An exception travels down the queue like a frame, behind the frames that came before it."""

    def __init__(self, frames: Iterable[Frame], cancel: threading.Event) -> None:
        super().__init__(name="decode", daemon=True)
        self._frames = frames
        self._cancelled = cancel.is_set
        self._channel = _Channel[Frame]()

    def run(self) -> None:
        try:
            for frame in self._frames:
                if not self._channel.put(frame, self._cancelled):
                    return
        except BaseException as e:  # it is raised again in the thread that tracks
            self._channel.put(e, self._cancelled)
        else:
            self._channel.put(_End(), self._cancelled)

    def frames(self, stopped: Callable[[], bool]) -> Iterator[Frame]:
        return self._channel.items(stopped)


class _Painter(threading.Thread):
    """Paints behind the tracker. After an exception it takes no more, and `put` raises it."""

    def __init__(self, paint: Effect) -> None:
        super().__init__(name="paint", daemon=True)
        self._paint = paint
        self._channel = _Channel[FrameResult]()
        self.error: BaseException | None = None

    def run(self) -> None:
        try:
            for result in self._channel.items(lambda: False):
                self._paint(result)
        except BaseException as e:  # it is raised again in the thread that tracks
            self.error = e

    def put(self, result: FrameResult) -> None:
        if not self._channel.put(result, self._failed):
            assert self.error is not None
            raise self.error

    def finish(self) -> None:
        """Wait until all that was put is painted."""
        self._channel.put(_End(), self._failed)
        self.join()

    def _failed(self) -> bool:
        return self.error is not None
