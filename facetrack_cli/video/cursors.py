"""Captures of a video that go to its frames, decoding onward or by jumps that stamps make sure of; see `seek.py`."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from facetrack_cli.core.types import Array, Image
from facetrack_cli.video import ffmpeg
from facetrack_cli.video.recent import Recent
from facetrack_cli.video.stamps import Reader, Stamps

CURSORS = 2  # captures that stay open; one of 4K may take 300 MB
SHORT = 16  # so many frames onward are decoded without a thought
CHECKED = 24  # so many frames from the start must agree with the stamps before they are trusted
LONG = 500  # of a clip with so many frames the stamps are read at once
BEHIND = 8, 250  # so many frames before a wanted one are kept, after a jump and when going backwards
_OTHER_KEYS = 0, 1, 4  # a jump that misses is tried again from so many keyframes before
_LANDS = 16  # OpenCV seeks so many frames earlier than it is told, and decodes onward from there


class _LostError(Exception):
    """A capture is not where it should be."""


class _Cursor:
    """A capture, the number and the time that follow, and whether it was decoded from the start.

    Otherwise frames before `key` may lack what they are predicted from. `wanted`: somebody will come back to it.
    """

    def __init__(self, path: Path):
        self.capture = cv2.VideoCapture(ffmpeg.source_argument(path), cv2.CAP_FFMPEG)
        self.next = self.key = self.used = 0
        self.time = self.origin = 0.0
        self.whole = True
        self.wanted = False


class Approach:
    """Comes nearer to a frame of a video file, and puts it into `recent`, with its time, once it is there.

    `end` is the number of frames once it is certain; `last` the frame that was asked for last; `decoded` counts frames
    and `jumps` seeks.
    `gives_way` says of a ticket whether somebody else should have the turn. Only `stop` may be called out of turn.
    """

    def __init__(
        self,
        path: Path,
        size: tuple[int, int],
        fps: Fraction,
        recent: Recent[int, tuple[float, Image]],
        gives_way: Callable[[int], bool],
    ):
        self._path, self._shape, self._recent, self._gives_way = path, (size[1], size[0], 3), recent, gives_way
        self.end: int | None = None
        self.decoded = self.jumps = self.last = self._reached = self._uses = 0
        self._period = float(1 / fps)
        self._back = max(recent.most_bytes * 3 // 4 // math.prod(self._shape), 1)
        self._careful = False  # frames differ in size, so each is looked at
        self._seeks = True
        self._heads: list[float] = []  # positions of the first frames
        self._stamps: Stamps | None = None
        self._times: Array = np.empty(0)
        self._arrived: Stamps | None = None
        self._packets = Reader(path)
        self._thread: threading.Thread | None = None
        self._cursors = [_Cursor(path)]
        count = self._cursors[0].capture.get(cv2.CAP_PROP_FRAME_COUNT)
        self._claimed = int(count) if math.isfinite(count) and 1 <= count < 1e9 else 0
        self._walk(self._cursors[0], 0, 0)
        if self._claimed >= LONG or not self._claimed:
            self._begin_stamps()

    @property
    def count(self) -> int:
        if self.end is not None:
            return self.end
        stamps = self._stamps or self._arrived
        return max(len(stamps.positions) if stamps is not None else self._claimed, self._reached)

    def approach(self, index: int, ticket: int) -> None:
        for further in (*_OTHER_KEYS, None):
            try:
                self._take_up()
                cursor = self._nearest(index, further is None)
                jump = None if further is None else self._jump_to(index, further)
                if jump is not None and (cursor is None or jump[0] > cursor.next):
                    self._check_heads()
                    cursor = self._jump(index, *jump)
                elif cursor is None:
                    cursor = self._restart()
                self._walk(cursor, index, ticket)
                return
            except _LostError:
                continue

    def stop(self) -> None:
        self._packets.stop()

    def release(self) -> None:
        if self._thread is not None:
            self._thread.join()
        for cursor in self._cursors:
            cursor.capture.release()
        self._cursors = []

    # --- stamps ------------------------------------------------------------------------------------------------------

    def _begin_stamps(self) -> None:
        if self._thread is None and not self._careful:
            self._thread = threading.Thread(target=self._read_stamps, name="stamps", daemon=True)
            self._thread.start()

    def _read_stamps(self) -> None:
        try:
            self._arrived = self._packets.read(self._heads[0])
        except (OSError, RuntimeError, ValueError):  # no ffmpeg program, or closed
            self._arrived = None

    def _take_up(self) -> None:
        """Make use of stamps that have arrived, if they agree with what was decoded so far."""
        stamps, self._arrived = self._arrived, None
        if stamps is None or self._careful:
            return
        # without a claimed number OpenCV does not seek, and forgets what it needs to decode onward
        if self._claimed < 2:
            self._claimed = len(stamps.positions)
            self._seeks = False
        known = [(place, position) for place, position in enumerate(self._heads)]
        known += [(c.next - 1, c.capture.get(cv2.CAP_PROP_POS_MSEC) / 1000) for c in self._cursors if c.next]
        total = len(stamps.positions)
        if stamps.counted and total > self._claimed:
            return
        if all(place < total and stamps.positions[place] == position for place, position in known):
            self._stamps, self._times = stamps, _times(stamps.positions, self._period)

    def _check_heads(self) -> None:
        """Decode the first frames, if they have not been, which holds them to the stamps."""
        assert self._stamps is not None
        cursor = next((c for c in self._cursors if c.whole and c.next == len(self._heads)), None)
        while len(self._heads) < min(CHECKED, len(self._stamps.positions)):
            cursor = cursor or self._restart()
            if not self._grab(cursor) or self._stamps is None:
                raise _LostError

    def _distrust(self) -> None:
        """Do without stamps, and forget what was found by them."""
        self._stamps = self._arrived = None
        self._recent.clear()
        for cursor in [c for c in self._cursors if not c.whole or self._careful]:
            self._drop(cursor)

    # --- captures ----------------------------------------------------------------------------------------------------

    def _nearest(self, index: int, whole: bool) -> _Cursor | None:
        return max(
            (c for c in self._cursors if max(c.next, c.key) <= index and (c.whole or not whole)),
            key=lambda c: c.next,
            default=None,
        )

    def _drop(self, cursor: _Cursor) -> None:
        cursor.capture.release()
        if cursor in self._cursors:
            self._cursors.remove(cursor)

    def _spare(self) -> _Cursor:
        """A capture that nobody is likely to miss."""
        if len(self._cursors) < CURSORS:
            self._cursors.append(_Cursor(self._path))
            return self._cursors[-1]
        return min(self._cursors, key=lambda c: (c.wanted, c.next if c.wanted else c.used))

    def _restart(self) -> _Cursor:
        """A capture that is at the start."""
        cursor = self._spare()
        if cursor.next:
            self._drop(cursor)
            cursor = _Cursor(self._path)
            self._cursors.append(cursor)
        return cursor

    def _jump_to(self, index: int, further: int) -> tuple[int, float] | None:
        """The keyframe from which to go to a frame, and the position to seek to; None to decode onward."""
        stamps = self._stamps
        if stamps is None or not self._seeks:
            return None
        lead = _LANDS + 2 + math.ceil(max(stamps.positions[0], 0) / self._period)
        last = min(index, len(stamps.positions) - 1)
        place = int(np.searchsorted(stamps.keys, last - lead, side="right")) - 1 - further
        if place < 0 or stamps.keys[place] <= SHORT:
            return None
        return int(stamps.keys[place]), float(stamps.entries[place])

    def _jump(self, index: int, key: int, entry: float) -> _Cursor:
        """A capture at or before a frame, and after a keyframe, if that can be had by seeking; else _LostError."""
        stamps = self._stamps
        if stamps is None:
            raise _LostError
        self.jumps += 1
        cursor = self._spare()
        rate = cursor.capture.get(cv2.CAP_PROP_FPS)
        ahead = math.ceil(entry * rate - 1e-6) if stamps.indexed else math.floor(entry * rate) - 1
        cursor.whole, cursor.wanted = False, False
        cursor.capture.set(cv2.CAP_PROP_POS_FRAMES, max(ahead, 0) + _LANDS)
        grabbed = cursor.capture.grab()
        position = cursor.capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
        at = int(np.searchsorted(stamps.positions, position))
        self.decoded += max(at - key, 0) + 1
        if not grabbed or at > index:
            self._drop(cursor)
            raise _LostError
        if at == len(stamps.positions) or stamps.positions[at] != position:
            self._distrust()
            raise _LostError
        cursor.next, cursor.key, cursor.origin, cursor.time = at + 1, key, stamps.positions[0], self._times[at]
        if at == index:
            self._look(cursor, at)
        return cursor

    # --- decoding onward ---------------------------------------------------------------------------------------------

    def _walk(self, cursor: _Cursor, index: int, ticket: int) -> None:
        """Decode onward until a frame is there, somebody else wants the turn, or stamps arrive for a jump."""
        self._uses += 1
        cursor.used, cursor.wanted = self._uses, False
        backwards = 0 < self.last - index <= BEHIND[1]
        before = min(BEHIND[1], self._back) if backwards else min(BEHIND[0], self._back // 8)
        if index - cursor.next > 3 * SHORT:
            self._begin_stamps()
        while cursor.next <= index:
            if cursor.next < index and self._gives_way(ticket):
                cursor.wanted = True
                return
            if self._arrived is not None:
                return
            if not self._grab(cursor):
                self._ended(cursor)
                return
            at = cursor.next - 1
            if self._careful or at >= max(index - before, cursor.key):
                self._look(cursor, at)

    def _grab(self, cursor: _Cursor) -> bool:
        """Go one frame on, and hold its time to the stamps; False at the end."""
        if not cursor.capture.grab():
            return False
        position = cursor.capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
        if cursor.next == 0:
            cursor.origin = position
        else:  # the rule of `VideoSource` for frames without a stamp, or thrown back
            step = position - cursor.origin - cursor.time
            cursor.time += step if step > 0 else self._period
        at = cursor.next
        cursor.next += 1
        self.decoded += 1
        self._reached = max(self._reached, cursor.next)
        if cursor.whole and at == len(self._heads) < CHECKED:
            self._heads.append(position)
        stamps = self._stamps
        if stamps is not None and (at >= len(stamps.positions) or stamps.positions[at] != position):
            self._distrust()
            if not cursor.whole:
                raise _LostError
        return True

    def _look(self, cursor: _Cursor, at: int) -> None:
        """Keep the frame that the cursor is at."""
        image: Any = cursor.capture.retrieve()[1]
        if image is not None and image.shape == self._shape:
            self._recent.put(at, (cursor.time, image), image.nbytes)
        elif self._careful:  # a source ends before the first frame of another size
            self.end = at
            self._drop(cursor)
        else:
            self._careful = True
            self._distrust()
            raise _LostError

    def _ended(self, cursor: _Cursor) -> None:
        whole, stamps = cursor.whole, self._stamps
        self._drop(cursor)
        if not whole and (stamps is None or cursor.next != len(stamps.positions)):
            raise _LostError
        self.end = cursor.next


def _times(positions: Array, period: float) -> Array:
    """The times that `VideoSource` makes of positions, to the last bit."""
    origin, time, times = float(positions[0]), 0.0, [0.0]
    for position in positions[1:].tolist():
        step = position - origin - time
        time += step if step > 0 else period
        times.append(time)
    return np.array(times)
