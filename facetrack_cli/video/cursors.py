"""Captures of a video that go to any of its frames, by decoding onward or by jumps; see `seek.py`."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np

from facetrack_cli.core.types import Image
from facetrack_cli.video.cache import Cache
from facetrack_cli.video.source import Capture
from facetrack_cli.video.stamps import Stamps, StoppedError, read_stamps

CURSORS = 2  # captures that stay open; one of 4K may take 300 MB
SHORT = 16  # so many frames onward are always decoded
LONG = 500  # of a clip with so many frames the stamps are read at once
BEHIND = 8, 250  # so many frames before a wanted one are kept, after a jump and when going backwards
_OTHER_KEYS = 0, 1, 4  # a jump that misses is tried again from so many keyframes before
_LANDS = 16  # OpenCV seeks so many frames earlier than it is told, and decodes onward from there


class _LostError(Exception):
    """A capture is not where it should be."""


class Approach:
    """Comes nearer to a frame of a video file, and puts it into `recent`, with its time, once it is there.

    `end` is the number of frames once it is certain; `last` the frame that was asked for last; `decoded` counts frames
    and `jumps` seeks. `gives_way` says of a ticket whether another one should have the turn. Only `stop` may be called
    out of turn.
    """

    def __init__(
        self,
        path: Path,
        size: tuple[int, int],
        recent: Cache[int, tuple[float, Image]],
        gives_way: Callable[[int], bool],
    ):
        self._path, self._shape, self._recent, self._gives_way = path, (size[1], size[0], 3), recent, gives_way
        self.end: int | None = None
        self.decoded = self.jumps = self.last = self._reached = 0
        self._back = max(recent.most_bytes * 3 // 4 // math.prod(self._shape), 1)
        self._careful = False  # frames differ in size, so each is looked at
        self._stamps: Stamps | None = None
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._cursors = [Capture(path)]  # the least recently used comes first
        self._claimed, self._period = self._cursors[0].claimed or 0, self._cursors[0].period
        self._walk(self._cursors[0], 0, 0)
        if self._claimed >= LONG or not self._claimed:
            self._begin_stamps()

    @property
    def count(self) -> int:
        if self.end is not None:
            return self.end
        stamps = self._stamps
        return max(len(stamps.positions) if stamps is not None else self._claimed, self._reached)

    def approach(self, index: int, ticket: int) -> None:
        for further in (*_OTHER_KEYS, None):
            try:
                cursor = self._nearest(index, further is None)
                jump = None if further is None else self._jump_to(index, further)
                if jump is not None and (cursor is None or jump[0] > cursor.next):
                    cursor = self._jump(index, *jump)
                self._walk(cursor or self._restart(), index, ticket)
                return
            except _LostError:
                continue

    def stop(self) -> None:
        self._stop.set()

    def release(self) -> None:
        if self._thread is not None:
            self._thread.join()
        for cursor in self._cursors:
            cursor.release()
        self._cursors = []

    # --- stamps ------------------------------------------------------------------------------------------------------

    def _begin_stamps(self) -> None:
        if self._thread is None and not self._careful:
            self._thread = threading.Thread(target=self._read_stamps, name="stamps", daemon=True)
            self._thread.start()

    def _read_stamps(self) -> None:
        try:
            stamps = read_stamps(self._path, self._period, self._stop)
        except (OSError, RuntimeError, ValueError, StoppedError):  # no ffmpeg program, or closed
            return
        if not self._careful:
            self._stamps = stamps

    def _distrust(self) -> None:
        """Do without stamps, and forget what was found by them."""
        self._stamps = None
        self._recent.clear()
        for cursor in [c for c in self._cursors if c.key or self._careful]:
            self._drop(cursor)

    # --- captures ----------------------------------------------------------------------------------------------------

    def _nearest(self, index: int, from_start: bool) -> Capture | None:
        """The capture that is the shortest way before a frame; with `from_start` of those that never jumped."""
        those = (c for c in self._cursors if max(c.next, c.key) <= index and not (c.key and from_start))
        return max(those, key=lambda c: c.next, default=None)

    def _drop(self, cursor: Capture) -> None:
        cursor.release()
        if cursor in self._cursors:
            self._cursors.remove(cursor)

    def _spare(self) -> Capture:
        """Another capture, or the least recently used one."""
        if len(self._cursors) < CURSORS:
            self._cursors.append(Capture(self._path))
            return self._cursors[-1]
        return self._cursors[0]

    def _restart(self) -> Capture:
        """A capture that is at the start."""
        cursor = self._spare()
        if cursor.next:
            self._drop(cursor)
            cursor = self._spare()
        return cursor

    def _jump_to(self, index: int, further: int) -> tuple[int, float] | None:
        """The keyframe from which to go to a frame, and the position to seek to; None to decode onward."""
        stamps = self._stamps
        # without a claimed number OpenCV does not seek, and loses what it needs to decode onward
        if stamps is None or self._claimed < 2:
            return None
        lead = _LANDS + 2 + math.ceil(max(stamps.positions[0], 0) / self._period)
        last = min(index, len(stamps.positions) - 1)
        place = int(np.searchsorted(stamps.keys, last - lead, side="right")) - 1 - further
        if place < 0 or stamps.keys[place] <= SHORT:
            return None
        return int(stamps.keys[place]), float(stamps.entries[place])

    def _jump(self, index: int, key: int, entry: float) -> Capture:
        """A capture at or before a frame, and after a keyframe, if that can be had by seeking; else _LostError."""
        stamps = self._stamps
        if stamps is None:
            raise _LostError
        self.jumps += 1
        cursor = self._spare()
        ahead = math.ceil(entry * cursor.rate - 1e-6) if stamps.indexed else math.floor(entry * cursor.rate) - 1
        grabbed = cursor.seek(max(ahead, 0) + _LANDS)
        at = int(np.searchsorted(stamps.positions, cursor.position))
        self.decoded += max(at - key, 0) + 1
        if not grabbed or at > index:
            self._drop(cursor)
            raise _LostError
        cursor.key = key
        if at == len(stamps.positions) or stamps.positions[at] != cursor.position:
            self._distrust()
            raise _LostError
        cursor.next, cursor.origin, cursor.time = at + 1, float(stamps.positions[0]), float(stamps.times[at])
        if at == index:
            self._look(cursor, at)
        return cursor

    # --- decoding onward ---------------------------------------------------------------------------------------------

    def _walk(self, cursor: Capture, index: int, ticket: int) -> None:
        """Decode onward until a frame is there, another ticket should have the turn, or stamps allow a jump."""
        self._cursors.sort(key=lambda c: c is cursor)
        backwards = 0 < self.last - index <= BEHIND[1]
        before = min(BEHIND[1], self._back) if backwards else min(BEHIND[0], self._back // 8)
        if index - cursor.next > 3 * SHORT:
            self._begin_stamps()
        stamps = self._stamps
        while cursor.next <= index:
            if self._stamps is not stamps or (cursor.next < index and self._gives_way(ticket)):
                return
            if not self._grab(cursor):
                self._ended(cursor)
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
        if stamps is not None and (at >= len(stamps.positions) or stamps.positions[at] != cursor.position):
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
            self.end = at
            self._drop(cursor)
        else:
            self._careful = True
            self._distrust()
            raise _LostError

    def _ended(self, cursor: Capture) -> None:
        self._drop(cursor)
        if cursor.key and (self._stamps is None or cursor.next != len(self._stamps.positions)):
            raise _LostError
        self.end = cursor.next
