"""Any frame of a clip, quickly, and exactly the one that `open_source` gives under its number.

Near frames are reached by decoding onward. For distant ones the packets of a video are read once without decoding
(`stamps.py`), which gives the time of each frame. A jump (`cursors.py`) seeks to a keyframe before the wanted frame;
the first frame that comes is identified by its time, and decoding goes on from there. The time of every frame is
compared with the stamps; if one differs, or if there are no reliable ones, frames are counted from the start as
`open_source` does, which is slow and correct.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from types import TracebackType

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Frame, Image
from facetrack_cli.video.cache import Cache
from facetrack_cli.video.cursors import Approach
from facetrack_cli.video.images import UnreadableError
from facetrack_cli.video.source import FolderSource, open_source

CACHE_BYTES = 256 << 20  # of decoded frames, the neighbours of those that were asked for


class Turns:
    """A lock that the latest of those waiting gets first, since what was asked before is likely not wanted any more."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._tickets = 0
        self._waiting: list[int] = []
        self._taken = False

    def ticket(self) -> int:
        """A place in the queue, with which one may take several turns."""
        with self._condition:
            self._tickets += 1
            return self._tickets

    @contextmanager
    def turn(self, ticket: int) -> Iterator[None]:
        with self._condition:
            self._waiting.append(ticket)
            try:
                self._condition.wait_for(lambda: not self._taken and max(self._waiting) == ticket)
            finally:
                self._waiting.remove(ticket)
                self._condition.notify_all()
            self._taken = True
        try:
            yield
        finally:
            with self._condition:
                self._taken = False
                self._condition.notify_all()

    def overtaken(self, ticket: int) -> bool:
        """Whether a later ticket is waiting."""
        with self._condition:
            return max(self._waiting, default=0) > ticket


class Frames:
    """Any frame of a video or an image folder; a context manager. Thread-safe: the latest request is served first.

    Attributes: `size` (width, height), rotation applied; `fps`; `decoded`, how many frames were decoded so far.
    Raises what `open_source` raises.
    """

    def __init__(self, path: Path, *, fps: Fraction | None = None):
        self._recent: Cache[int, tuple[float, Image]] = Cache(CACHE_BYTES)
        self._turns = Turns()
        self._closed = False
        with open_source(path, fps=fps) as source:
            self.size, self.fps, self.path = source.size, source.fps, path
            self._reader = (
                _Folder(source, self._recent)
                if isinstance(source, FolderSource)
                else Approach(path, self.size, self._recent, self._gives_way)
            )

    @property
    def count(self) -> int:
        """How many frames can be read, as far as is known."""
        return self._reader.count

    @property
    def exact(self) -> bool:
        """Whether `count` is certain."""
        return self._reader.end is not None

    @property
    def decoded(self) -> int:
        return self._reader.decoded

    def read(self, index: int) -> Frame:
        """The frame with this number; its pixels may be shared with other calls and must not be written to.

        Raises InputError past the end, after which `count` is exact, and RuntimeError when closed, also meanwhile.
        """
        ticket = self._turns.ticket()
        while True:
            if self._closed:
                raise RuntimeError("these frames are closed; open them again")
            end = self._reader.end
            if index < 0 or (end is not None and index >= end):
                raise InputError(
                    f"{self.path}: there is no frame {index}, the clip has {self.count} frames "
                    f"(0 to {self.count - 1}); choose one of them"
                )
            found = self._recent.get(index)
            if found is not None:
                self._reader.last = index
                return Frame(index, *found)
            with self._turns.turn(ticket):
                # while waiting, another call may have decoded it
                if not self._closed and self._recent.get(index) is None:
                    self._reader.approach(index, ticket)

    def close(self) -> None:
        """End what is being read, also in other threads, and free the file; closing again does nothing."""
        self._closed = True
        self._reader.stop()
        with self._turns.turn(self._turns.ticket()):
            self._reader.release()
            self._recent.clear()

    def __enter__(self) -> Frames:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _gives_way(self, ticket: int) -> bool:
        return self._closed or self._turns.overtaken(ticket)


class _Folder:
    """The images of a folder, read into a cache; as `Approach` for videos."""

    def __init__(self, source: FolderSource, recent: Cache[int, tuple[float, Image]]):
        self._source, self._recent = source, recent
        self.end: int | None = len(source.files)
        self.decoded = self.last = 0

    @property
    def count(self) -> int:
        return self.end or 0

    def approach(self, index: int, ticket: int) -> None:
        try:
            frame = self._source.frame(index)
        except UnreadableError:  # a source ends here
            self.end = index
            raise
        self.decoded += 1
        self._recent.put(index, (frame.time_s, frame.bgr), frame.bgr.nbytes)

    def stop(self) -> None: ...

    def release(self) -> None: ...
