"""Decoding, tracking and encoding side by side.

    decode --(frames)--> track, record --(results)--> paint

Each arrow is a queue of a few frames, fewer if they are large: memory is bounded, and the slowest stage sets the pace.
Every stage sees the frames in their order, whatever the number of threads: what comes out is the same.
"""

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Generic, TypeAlias, TypeVar

import cv2

from facetrack_cli.core.types import Frame
from facetrack_cli.trajectory.trajectory import FrameResult

DEPTH = 4  # frames in each queue
MOST_BYTES = 32 << 20  # of their pixels, unless one alone has more
POLL_S = 0.1  # how long a stage sleeps at most before it looks whether the run was cancelled
PATIENCE_S = 1.0  # a decoder that does not come back from a read is left behind after this long
T = TypeVar("T")
Track: TypeAlias = Callable[[Iterator[Frame]], Iterator[FrameResult]]
Effect: TypeAlias = Callable[[FrameResult], None]


def share_threads(threads: int) -> None:
    """Leave one of so many to decoding. OpenCV's wait for work by spinning: on two cores that is a tenth of a run."""
    cv2.setNumThreads(max(threads - 1, 1))


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

    cancelled = threading.Event()
    decoded, results = _Channel[Frame](cancelled.is_set), _Channel[FrameResult](lambda: bool(failed))
    failed: list[BaseException] = []

    def decode() -> None:
        try:
            if all(map(decoded.put, frames)):  # which holds no frame while the next one is decoded
                decoded.put(None)
        except BaseException as e:  # it travels like a frame, behind the frames that came before it
            decoded.put(e)

    def paint_all() -> None:
        try:
            for result in results.items(lambda: False):
                assert paint is not None
                paint(result)
        except BaseException as e:
            failed.append(e)

    decoder = threading.Thread(target=decode, name="decode", daemon=True)
    painter = threading.Thread(target=paint_all, name="paint", daemon=True)
    decoder.start()
    painter.start()
    try:
        for result in track(decoded.items(stopped)):
            record(result)
            if paint is not None and not results.put(result):
                break
            del result  # while the next one is tracked
    finally:
        cancelled.set()
        results.put(None)
        painter.join()
        decoder.join(PATIENCE_S)
    if failed:
        raise failed[0]


def _until(frames: Iterable[Frame], stopped: Callable[[], bool]) -> Iterator[Frame]:
    if stopped():
        return
    for frame in frames:
        yield frame
        if stopped():
            return


class _Channel(Generic[T]):
    """A bounded queue whose both ends give up when told to, so that no stage waits for one that has ended."""

    def __init__(self, given_up: Callable[[], bool]) -> None:
        self._waiting = deque[tuple[T | BaseException | None, int]]()
        self._bytes = 0
        self._changed = threading.Condition()
        self._given_up = given_up

    def put(self, item: T | BaseException | None) -> bool:
        """False if nobody takes it any more. None is the end; an exception is raised at the other side."""
        size = _size(item)
        while not self._given_up():
            with self._changed:
                if self._changed.wait_for(lambda: self._fits(size), POLL_S):
                    self._waiting.append((item, size))
                    self._bytes += size
                    self._changed.notify_all()
                    return True
        return False

    def _fits(self, size: int) -> bool:
        return len(self._waiting) < DEPTH and (not self._waiting or self._bytes + size <= MOST_BYTES)

    def items(self, stopped: Callable[[], bool]) -> Iterator[T]:
        while not stopped():
            with self._changed:
                if not self._changed.wait_for(lambda: self._waiting, POLL_S):
                    continue
                item, size = self._waiting.popleft()
                self._bytes -= size
                self._changed.notify_all()
            if item is None:
                return
            if isinstance(item, BaseException):
                raise item
            yield item
            del item  # while the next one is waited for


def _size(item: object) -> int:
    """The bytes of a frame's pixels."""
    frame = item.frame if isinstance(item, FrameResult) else item
    return frame.bgr.nbytes if isinstance(frame, Frame) else 0
