"""Any frame of a clip, quickly, and exactly the one that `open_source` gives under its number.

Near frames are reached by decoding onward, distant ones by a jump to the keyframe before them. If the packets do not
tell which frame is which (`decode.read_index`), frames are counted from the start, which is slow and correct.
"""

import contextlib
import math
import threading
from collections import OrderedDict
from fractions import Fraction
from pathlib import Path

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Frame, Image
from facetrack_cli.video.decode import MIN_JUMP_FRAMES, Decoder, Index, LostError, read_index
from facetrack_cli.video.images import UnreadableError
from facetrack_cli.video.source import FolderSource, open_source

CACHE_BYTES = 256 << 20  # of decoded frames, the neighbours of those that were asked for
BEHIND = 8, 250  # so many frames before a wanted one are kept, after a jump and when going backwards


class Frames(contextlib.AbstractContextManager["Frames"]):
    """Any frame of a video or an image folder; a context manager. Thread-safe.

    `size` is (width, height), upright; `decoded` and `jumps` count frames and seeks. Raises what `open_source` raises.
    """

    def __init__(self, path: Path, *, fps: Fraction | None = None, stream: int | None = None):
        self.path, self._stream = path, stream
        self.decoded = self.jumps = self._last = self._reached = self._claimed = 0
        self._end: int | None = None  # the number of frames, once it is certain
        self._recent = OrderedDict[int, tuple[float, Image]]()  # times and pixels, the least recently used first
        self._lock = threading.Lock()
        self._closed = threading.Event()
        self._index: Index | None = None  # read for the first jump, or where the file does not say how long it is
        self._indexed = False
        with open_source(path, fps=fps, stream=stream) as source:
            self.size, self.fps, self.aspect = source.size, source.fps, float(source.aspect)
        self._most = max(CACHE_BYTES // math.prod((*self.size, 3)), 1)
        self._folder = source if isinstance(source, FolderSource) else None
        if self._folder is not None:
            self._end = len(self._folder.files)
        else:
            self._decoder = Decoder(path, stream)
            self._claimed = self._decoder.claimed or 0
            if not self._claimed:
                self._read_index()
            self._approach(0)

    @property
    def count(self) -> int:
        """How many frames can be read, as far as is known."""
        if self._end is not None:
            return self._end
        index = self._index  # once: another thread may set it
        return max(self._claimed if index is None else len(index.pts), self._reached)

    @property
    def exact(self) -> bool:
        """Whether `count` is certain."""
        return self._end is not None

    def read(self, index: int) -> Frame:
        """The frame with this number; its pixels may be shared with other calls and must not be written to.

        Raises InputError past the end, after which `count` is exact, and RuntimeError when closed, also meanwhile.
        """
        with self._lock:
            ahead = index >= 0 and (self._end is None or index < self._end)
            if ahead and index not in self._recent and not self._closed.is_set():
                self._approach(index)
            if self._closed.is_set():
                raise RuntimeError("these frames are closed; open them again")
            if index not in self._recent:
                there = f"the clip has {self.count} frames (0 to {self.count - 1}); choose one of them"
                raise InputError(f"{self.path}: there is no frame {index}, {there}")
            self._recent.move_to_end(index)
            self._last = index
            return Frame(index, *self._recent[index], aspect=self.aspect)

    def close(self) -> None:
        """End what is being read, also in other threads, and free the file; closing again does nothing."""
        self._closed.set()
        with self._lock:
            (self._folder or self._decoder).close()
            self._recent.clear()

    def __exit__(self, *_: object) -> None:
        self.close()

    # what follows is called with the lock

    def _approach(self, index: int) -> None:
        """Put a frame into `_recent`, if the clip has it."""
        if self._folder is not None:
            try:
                frame = self._folder.frame(index)
            except UnreadableError:
                self._end = index  # a source ends before an image that cannot be read
                raise
            self.decoded += 1
            self._keep(frame)
            return
        backwards = 0 < self._last - index <= BEHIND[1]
        before = min(BEHIND[backwards], self._most * 3 // 4)
        if not 0 <= index - self._decoder.next <= MIN_JUMP_FRAMES:
            self._jump(index)
        while self._decoder.next <= index and not self._closed.is_set():
            try:
                if not self._decode(index - before):
                    return
            except LostError:
                self._index = None
                self._recent.clear()
                self._restart()

    def _read_index(self) -> None:
        self._indexed = True
        with contextlib.suppress(OSError, ValueError):
            self._index = read_index(self.path, self._closed.is_set, self._stream)

    def _jump(self, index: int) -> None:
        """Go to the keyframe before a frame, if decoding onward does not lead there sooner."""
        if not self._indexed:
            self._read_index()
        packets, onward = self._index, self._decoder.next <= index
        if packets is not None:
            key = packets.keys[max(int(np.searchsorted(packets.keys, index, side="right")) - 1, 0)]
            if onward and key <= self._decoder.next + MIN_JUMP_FRAMES:
                return
            self.jumps += 1
            if self._decoder.seek(index, packets):
                return
            self._index = None
        if packets is not None or not onward:
            self._restart()

    def _decode(self, wanted: int) -> bool:
        """Decode the next frame, and keep it if its number is `wanted` or greater; False at the end.

        Raises LostError.
        """
        at, raw = self._decoder.next, self._decoder.read()
        self.decoded += 1
        self._reached = max(self._reached, self._decoder.next)
        if raw is None:
            if self._decoder.index is not None and self._index is not None and at != len(self._index.pts):
                raise LostError(f"{self.path}: ends at frame {at}")
            self._end = at
        elif at >= wanted:
            self._keep(self._decoder.picture(raw))
        return raw is not None

    def _keep(self, frame: Frame) -> None:
        self._recent[frame.index] = frame.time_s, frame.pixels
        if len(self._recent) > self._most:
            self._recent.popitem(last=False)

    def _restart(self) -> None:
        self._decoder.close()
        self._decoder = Decoder(self.path, self._stream)
