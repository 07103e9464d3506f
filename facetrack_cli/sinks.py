"""Where text results go: a file that appears when it is whole, or a stream.

A file is written under a temporary name beside its own. On a full disk it keeps the records that fit: its end is
written over the last of them, in room that the file already has, so a closed file is a valid one.
"""

from __future__ import annotations

import contextlib
import errno
import os
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from facetrack_cli.errors import OutputError

BLOCK = 1 << 16  # bytes held back before they are written


class ReaderGoneError(BrokenPipeError):
    """The program that reads our standard output has had enough."""


def refused(path: Path, error: OSError) -> OutputError:
    """The one line for a file that cannot be written."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return OutputError(
            f"{path}: the disk is full ({error.strerror}); free some space or write elsewhere with --out"
        )
    return OutputError(f"{path}: cannot be written: {error.strerror or error}; choose another place with --out")


def _bytes(text: str) -> bytes:
    # a file name that is no UTF-8 holds lone surrogates; escaped they are still valid JSON
    return text.encode(errors="backslashreplace")


class FileSink:
    """Records into `path`, which appears, or is replaced, at `finish`.

    Raises OutputError when the file cannot be written; `finish` may still be called then, and keeps what fits.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.temporary = path.with_name(f".{path.stem}-{os.getpid()}.part{path.suffix}")
        try:
            self._file: BinaryIO = self._open()
        except OSError as e:
            raise refused(path, e) from e
        self._buffer = bytearray()
        self._flushed = 0  # bytes in the file
        self._records = 0
        self._ends: deque[int] = deque()  # where the last records end
        self._full = False
        self.published = False  # whether the file stands at `path`

    def _open(self) -> BinaryIO:
        return self.temporary.open("wb", buffering=0)

    def write(self, record: str) -> None:
        data = _bytes(record)
        self._buffer += data
        self._records += 1
        self._ends.append((self._ends[-1] if self._ends else 0) + len(data))
        if len(self._buffer) >= BLOCK:
            self._flush()

    def finish(self, tail: Callable[[int], str]) -> None:
        """End the file with `tail(number of records)` and give it its name."""
        try:
            end = _bytes(tail(self._records))
            try:
                if self._full:
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                self._buffer += end
                self._flush()
            except (OSError, OutputError):
                self._cut(tail)
                self._rename()
                raise
            self._rename()
        except OSError as e:
            raise refused(self.path, e) from e
        finally:
            self.discard()

    def discard(self) -> None:
        """Close and remove the temporary file, if it is still there."""
        with contextlib.suppress(OSError):
            self._file.close()
        with contextlib.suppress(OSError):
            self.temporary.unlink(missing_ok=True)

    def _flush(self) -> None:
        view = memoryview(bytes(self._buffer))
        try:
            while view:
                n = self._file.write(view)
                self._flushed += n
                view = view[n:]
        except OSError as e:
            self._full = True
            raise refused(self.path, e) from e
        self._buffer.clear()
        # two blocks of record ends are enough to find room for the tail in
        while len(self._ends) > 1 and self._ends[0] < self._flushed - 2 * BLOCK:
            self._ends.popleft()

    def _cut(self, tail: Callable[[int], str]) -> None:
        """End the file within the bytes that reached it, after as many whole records as leave room."""
        kept = self._records
        while self._ends:
            end = _bytes(tail(kept))
            place = self._ends[-1]
            if place + len(end) <= self._flushed:
                self._file.seek(place)
                self._file.write(end)
                self._file.truncate(place + len(end))
                return
            self._ends.pop()
            kept -= 1
        self._file.truncate(0)

    def _rename(self) -> None:
        self._file.close()
        self.temporary.replace(self.path)
        self.published = True


class StreamSink:
    """Records to an open binary stream, each passed on at once. Raises ReaderGoneError when nobody reads any more."""

    def __init__(self, stream: BinaryIO, name: str = "standard output") -> None:
        self.path = None
        self.published = False
        # past the buffer: what a reader did not take must not be tried again at exit
        self._stream = getattr(stream, "raw", stream)
        self._name = name
        self._records = 0

    def write(self, record: str) -> None:
        self._records += 1
        self._pass_on(record)

    def finish(self, tail: Callable[[int], str]) -> None:
        self._pass_on(tail(self._records))

    def discard(self) -> None:
        pass

    def _pass_on(self, text: str) -> None:
        try:
            rest = memoryview(_bytes(text))
            while rest:
                rest = rest[self._stream.write(rest) :]
        except BrokenPipeError as e:
            raise ReaderGoneError from e
        except OSError as e:
            raise refused(Path(self._name), e) from e
