"""Any frame of a clip, quickly, and exactly the one that `open_source` gives under its number.

Near frames are reached by decoding onward. For distant ones the packets are read once without decoding (`stamps.py`),
which gives the time of each frame. A jump seeks to a keyframe before the wanted frame; the first frame that comes is
identified by its time, and decoding goes on from there. If the time of any frame differs from the stamps, or if there
are no reliable ones, frames are counted from the start as `open_source` does, which is slow and correct.
"""

import contextlib
import itertools
import math
import threading
from collections import OrderedDict
from collections.abc import Hashable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Frame, Image
from facetrack_cli.video.images import UnreadableError
from facetrack_cli.video.source import Capture, FolderSource, Source, VideoSource, open_source
from facetrack_cli.video.stamps import Stamps, read_stamps

CACHE_BYTES = 256 << 20  # of decoded frames, the neighbours of those that were asked for
CURSORS = 2  # captures that stay open; one of 4K may take 300 MB
SHORT = 16  # so many frames onward are always decoded
LONG = 500  # of a clip with so many frames the stamps are read at once
BEHIND = 8, 250  # so many frames before a wanted one are kept, after a jump and when going backwards
_OTHER_KEYS = 0, 1, 4  # a jump that misses is tried again from so many keyframes before
_LANDS = 16  # OpenCV seeks so many frames earlier than it is told, and decodes onward from there
_Key = TypeVar("_Key", bound=Hashable)
_Value = TypeVar("_Value")


class Cache(Generic[_Key, _Value]):
    """A byte-bounded LRU cache: the least recently used is forgotten when all take over `most_bytes`. Thread-safe."""

    def __init__(self, most_bytes: int):
        self.most_bytes = most_bytes
        self.bytes = 0
        self._known: OrderedDict[_Key, tuple[_Value, int]] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, key: _Key) -> _Value | None:
        with self._lock:
            if found := self._known.get(key):
                self._known.move_to_end(key)
            return found[0] if found else None

    def put(self, key: _Key, value: _Value, size: int) -> None:
        """Keep a value of so many bytes; the last one is kept however large it is."""
        with self._lock:
            self.bytes += size - self._known.pop(key, (None, 0))[1]
            self._known[key] = value, size
            while self.bytes > self.most_bytes and len(self._known) > 1:
                self.bytes -= self._known.popitem(last=False)[1][1]

    def clear(self) -> None:
        with self._lock:
            self._known.clear()
            self.bytes = 0


class Turns:
    """A lock that the latest of those waiting gets first, since what was asked before is likely not wanted any more."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._tickets = itertools.count(1)
        self._waiting: list[int] = []
        self._taken = False

    def ticket(self) -> int:
        """A place in the queue, with which one may take several turns."""
        return next(self._tickets)

    @contextlib.contextmanager
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


class _LostError(Exception):
    """A capture is not where it should be."""


class Frames(contextlib.AbstractContextManager["Frames"]):
    """Any frame of a video or an image folder; a context manager. Thread-safe: the latest request is served first.

    `size` is (width, height), rotation applied; `decoded` and `jumps` count the frames that were decoded and the seeks.
    Raises what `open_source` raises.
    """

    def __init__(self, path: Path, *, fps: Fraction | None = None):
        self.path = path
        self.decoded = self.jumps = self._last = self._reached = self._claimed = 0
        self._end: int | None = None  # the number of frames, once it is certain
        self._recent: Cache[int, tuple[float, Image]] = Cache(CACHE_BYTES)
        self._turns = Turns()
        self._closed = threading.Event()
        self._careful = False  # frames differ in size, so each is looked at
        self._stamps: Stamps | None = None
        self._thread: threading.Thread | None = None
        self._cursors: list[Capture] = []  # the least recently used comes first
        with open_source(path, fps=fps) as source:
            self.size, self.fps = source.size, source.fps
        self._shape = (self.size[1], self.size[0], 3)
        self._back = max(CACHE_BYTES * 3 // 4 // math.prod(self._shape), 1)
        self._folder = source if isinstance(source, FolderSource) else None
        if self._folder is not None:
            self._end = len(self._folder.files)
        else:
            cursor = self._spare(fresh=True)
            self._claimed = cursor.claimed or 0
            self._walk(cursor, 0, 0)
            if self._claimed >= LONG or not self._claimed:
                self._begin_stamps()

    @property
    def count(self) -> int:
        """How many frames can be read, as far as is known."""
        if self._end is not None:
            return self._end
        stamps = self._stamps
        return max(len(stamps.times) if stamps is not None else self._claimed, self._reached)

    @property
    def exact(self) -> bool:
        """Whether `count` is certain."""
        return self._end is not None

    def read(self, index: int) -> Frame:
        """The frame with this number; its pixels may be shared with other calls and must not be written to.

        Raises InputError past the end, after which `count` is exact, and RuntimeError when closed, also meanwhile.
        """
        ticket = self._turns.ticket()
        while True:
            if self._closed.is_set():
                raise RuntimeError("these frames are closed; open them again")
            if index < 0 or (self._end is not None and index >= self._end):
                there = f"the clip has {self.count} frames (0 to {self.count - 1}); choose one of them"
                raise InputError(f"{self.path}: there is no frame {index}, {there}")
            found = self._recent.get(index)
            if found is not None:
                self._last = index
                return Frame(index, *found)
            with self._turns.turn(ticket):
                # while waiting, another call may have decoded it
                if not self._closed.is_set() and self._recent.get(index) is None:
                    self._approach(index, ticket)

    def close(self) -> None:
        """End what is being read, also in other threads, and free the file; closing again does nothing."""
        self._closed.set()
        with self._turns.turn(self._turns.ticket()):
            if self._thread is not None:
                self._thread.join()
            for cursor in list(self._cursors):
                self._drop(cursor)
            self._recent.clear()

    def __exit__(self, *_: object) -> None:
        self.close()

    # what follows is called with the turn

    def _approach(self, index: int, ticket: int) -> None:
        """Come nearer to a frame, which is put into `_recent` once it is there."""
        if self._folder is not None:
            try:
                frame = self._folder.frame(index)
            except UnreadableError:  # a source ends here
                self._end = index
                raise
            self.decoded += 1
            self._recent.put(index, (frame.time_s, frame.bgr), frame.bgr.nbytes)
            return
        for further in (*_OTHER_KEYS, None):
            with contextlib.suppress(_LostError):
                cursor = self._nearest(index, further is None)
                if further is not None:
                    cursor = self._jump(index, further, 0 if cursor is None else cursor.next) or cursor
                self._walk(cursor or self._spare(fresh=True), index, ticket)
                return

    def _nearest(self, index: int, from_start: bool) -> Capture | None:
        """The capture that is the shortest way before a frame; with `from_start` of those that never jumped."""
        those = (c for c in self._cursors if max(c.next, c.key) <= index and not (c.key and from_start))
        return max(those, key=lambda c: c.next, default=None)

    def _spare(self, *, fresh: bool) -> Capture:
        """Another capture while there are few, else the least recently used; `fresh`: one that is at the start."""
        if fresh and len(self._cursors) == CURSORS:
            self._drop(self._cursors[0])
        if len(self._cursors) < CURSORS:
            self._cursors.append(Capture(self.path))
            return self._cursors[-1]
        return self._cursors[0]

    def _drop(self, cursor: Capture) -> None:
        cursor.release()
        if cursor in self._cursors:
            self._cursors.remove(cursor)

    def _jump(self, index: int, further: int, beyond: int) -> Capture | None:
        """A capture after the keyframe before a frame, or one so many keyframes `further` before, and not past it.

        None without stamps, or if that is not `beyond` a frame. Raises _LostError if the seek does not arrive.
        """
        stamps = self._stamps
        # without a claimed number OpenCV does not seek, and loses what it needs to decode onward
        if stamps is None or self._claimed < 2:
            return None
        place = _key_before(stamps, index, further, float(self.fps))
        if place < 0 or stamps.keys[place] <= max(SHORT, beyond):
            return None
        self.jumps += 1
        cursor = self._spare(fresh=False)
        at = _land(cursor, stamps, place)
        self.decoded += max(at - cursor.key, 0) + 1
        if at < 0 or at > index:
            self._drop(cursor)
            raise _LostError
        if at == len(stamps.times) or stamps.positions[at] != cursor.position:
            self._distrust()
            raise _LostError
        cursor.next, cursor.origin, cursor.time = at + 1, float(stamps.positions[0]), float(stamps.times[at])
        if at == index:
            self._look(cursor, at)
        return cursor

    def _walk(self, cursor: Capture, index: int, ticket: int) -> None:
        """Decode onward until a frame is there, another ticket should have the turn, or stamps allow a jump."""
        self._cursors.sort(key=lambda c: c is cursor)
        backwards = 0 < self._last - index <= BEHIND[1]
        before = min(BEHIND[1], self._back) if backwards else min(BEHIND[0], self._back // 8)
        if index - cursor.next > 3 * SHORT:
            self._begin_stamps()
        stamps = self._stamps
        while cursor.next <= index:
            overtaken = cursor.next < index and (self._closed.is_set() or self._turns.overtaken(ticket))
            if overtaken or self._stamps is not stamps:
                return
            if not self._grab(cursor):
                self._drop(cursor)
                if cursor.key and (self._stamps is None or cursor.next != len(self._stamps.times)):
                    raise _LostError
                self._end = cursor.next
                return
            at = cursor.next - 1
            if self._careful or at >= max(index - before, cursor.key):
                self._look(cursor, at)

    def _grab(self, cursor: Capture) -> bool:
        """Go one frame on, and compare its time with the stamps; False at the end."""
        if not cursor.grab():
            return False
        at = cursor.next - 1
        self.decoded += 1
        self._reached = max(self._reached, cursor.next)
        stamps = self._stamps
        if stamps is not None and (at >= len(stamps.times) or stamps.positions[at] != cursor.position):
            self._distrust()
            if cursor.key:
                raise _LostError
        return True

    def _look(self, cursor: Capture, at: int) -> None:
        """Keep the frame that the cursor is at."""
        image = cursor.image()
        if image is not None and image.shape == self._shape:
            self._recent.put(at, (cursor.time, image), image.nbytes)
        elif self._careful:  # a source ends before the first frame of another size
            self._end = at
            self._drop(cursor)
        else:
            self._careful = True
            self._distrust()
            raise _LostError

    def _begin_stamps(self) -> None:
        if self._thread is None and not self._careful:
            self._thread = threading.Thread(target=self._read_stamps, name="stamps", daemon=True)
            self._thread.start()

    def _read_stamps(self) -> None:
        with contextlib.suppress(OSError, RuntimeError, ValueError):  # no ffmpeg program, or closed
            stamps = read_stamps(self.path, self._closed)
            if not self._careful:
                self._stamps = stamps

    def _distrust(self) -> None:
        """Do without stamps, and forget what was found by them."""
        self._stamps = None
        self._recent.clear()
        for cursor in [c for c in self._cursors if c.key or self._careful]:
            self._drop(cursor)


def _key_before(stamps: Stamps, index: int, further: int, fps: float) -> int:
    """Which key to seek to for a frame, so many keys `further` before; negative where there is none."""
    lead = _LANDS + 2 + math.ceil(max(stamps.positions[0], 0) * fps)
    last = min(index, len(stamps.times) - 1)
    return int(np.searchsorted(stamps.keys, last - lead, side="right")) - 1 - further


def _land(cursor: Capture, stamps: Stamps, place: int) -> int:
    """Seek to a key; the number of the frame that is arrived at, by its time. Negative if none is."""
    entry = float(stamps.entries[place])
    ahead = math.ceil(entry * cursor.rate - 1e-6) if stamps.indexed else math.floor(entry * cursor.rate) - 1
    grabbed = cursor.seek(max(ahead, 0) + _LANDS)
    cursor.key = int(stamps.keys[place])
    return int(np.searchsorted(stamps.positions, cursor.position)) if grabbed else -1


def open_sought(
    path: Path, stamps: Stamps | None, *, fps: Fraction | None = None, start: int = 0, stop: int | None = None
) -> Source:
    """As `open_source`, but what comes before `start` is not decoded where the stamps allow to seek it.

    Frames and times are the same. Iterating raises InputError at a frame whose time is not that of its stamp.
    """
    source = open_source(path, fps=fps, start=start, stop=stop)
    if stamps is not None and isinstance(source, VideoSource):

        def approach(capture: Capture, index: int) -> Capture | None:
            if any(_approached(capture, stamps, index, further) for further in _OTHER_KEYS):
                capture.damage.clear()  # what is said of frames that lack those before them
                return capture
            capture.release()
            return None

        source.sought = approach, stamps.positions
    return source


def _approached(capture: Capture, stamps: Stamps, index: int, further: int) -> bool:
    """Bring a capture to a frame by a jump, if each frame after that has the time of its stamp."""
    place = _key_before(stamps, index, further, capture.rate)
    if capture.claimed is None or capture.claimed < 2 or place < 0 or stamps.keys[place] <= SHORT:
        return False
    at = _land(capture, stamps, place)
    if not 0 <= at <= index < len(stamps.times) or stamps.positions[at] != capture.position:
        return False
    capture.next, capture.origin, capture.time = at + 1, float(stamps.positions[0]), float(stamps.times[at])
    while capture.next <= index:
        if not capture.grab() or stamps.positions[capture.next - 1] != capture.position:
            return False
    return True
