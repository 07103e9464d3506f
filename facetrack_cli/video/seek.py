"""Any frame of a clip, quickly, and exactly the one that `open_source` gives under its number.

Near frames are reached by decoding onward. For far ones a video is read once without decoding (`stamps.py`), which
says when each frame is shown. A jump seeks to a keyframe before the wanted frame; the first picture that comes is
recognised by its time, and one decodes onward. Every picture's time is held to the stamps; if one differs, or if there
are none to trust, frames are counted from the start as `open_source` does, which is slow and right.
"""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from types import TracebackType

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Frame, Image
from facetrack_cli.video import images
from facetrack_cli.video.cursors import Approach
from facetrack_cli.video.recent import Recent, Turns
from facetrack_cli.video.source import open_source

CACHE_BYTES = 256 << 20  # of decoded frames, the neighbours of those that were asked for


class Frames:
    """Any frame of a video or an image folder; a context manager. Thread-safe: who asks last is served first.

    Attributes: `size` (width, height), rotation applied; `fps`; `decoded`, how many frames were decoded so far.
    Raises what `open_source` raises.
    """

    def __init__(self, path: Path, *, fps: Fraction | None = None):
        with open_source(path, fps=fps) as source:
            self.size, self.fps, self.path = source.size, source.fps, path
        self._recent: Recent[int, tuple[float, Image]] = Recent(CACHE_BYTES)
        self._turns = Turns()
        self._closed = False
        files = None if source.is_video else images.listing(path)
        self._reader = (
            _Folder(files, self.size, self.fps, self._recent)
            if files is not None
            else Approach(path, self.size, self.fps, self._recent, self._gives_way)
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
        """The frame with this number; its pixels may be shared with other calls and are not to be written to.

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
                # while waiting, another call may have come across it
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
    """The pictures of a folder. `approach` comes nearer to a frame and keeps it once it is there."""

    def __init__(
        self, files: list[Path], size: tuple[int, int], fps: Fraction, recent: Recent[int, tuple[float, Image]]
    ):
        self._files, self._size, self._fps, self._recent = files, size, fps, recent
        self.end: int | None = len(files)
        self.decoded = self.last = 0

    @property
    def count(self) -> int:
        return len(self._files)

    def approach(self, index: int, ticket: int) -> None:
        file, (width, height) = self._files[index], self._size
        try:
            image = images.read(file)
            if image.shape != (height, width, 3):
                raise ValueError(f"is not {width}x{height} pixels")
        except (OSError, ValueError) as error:  # a source ends here
            del self._files[index:]
            self.end = index
            raise InputError(f"{file}: {images.reason(error)}; {images.remedy(error)}") from error
        self.decoded += 1
        self._recent.put(index, (float(index / self._fps), image), image.nbytes)

    def stop(self) -> None: ...

    def release(self) -> None: ...
