"""Where text results go: a file that appears when it is whole, or a stream.

A file is written under a temporary name beside its own. On a full disk it keeps the records that fit: its end is
written over the last of them, in room that the file already has, so a closed file is a valid one.
"""

from __future__ import annotations

import contextlib
import errno
import os
from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import BinaryIO

from facetrack_cli.core.errors import OutputError

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


def check_new(path: Path, *, overwrite: bool, inputs: Iterable[Path | None] = ()) -> None:
    """Refuse before the work what `write_new` would refuse after it, and a file that the work is made from.

    Raises OutputError. Of `inputs`, those that are None or not there are passed over.
    """
    try:
        if path.is_dir():
            raise OutputError(f"{path}: is a folder; name a file in it")
        if path.exists() and any(_is_same(path, given) for given in inputs if given is not None):
            raise OutputError(f"{path}: is read here, and would be replaced; name another file")
        if os.path.lexists(path) and not overwrite and not _is_stream(path):
            raise OutputError(f"{path}: exists already; replace it with --overwrite, or name another file")
        if not path.parent.is_dir():
            raise OutputError(f"{path}: there is no folder {path.parent}; make it, or name another file")
    except OSError as e:
        raise OutputError(f"{path}: cannot be written: {e.strerror or e}; name another file") from None


def write_new(path: Path, data: bytes, *, overwrite: bool) -> None:
    """All of a small file or nothing. OutputError if it exists and `overwrite` is not set, or cannot be written.

    A link stays one: the file that it leads to is replaced. A device or a pipe is written to, never replaced.
    """
    try:
        if _is_stream(path):
            path.write_bytes(data)
            return
        if not overwrite and os.path.lexists(path):
            raise OutputError(f"{path}: exists already; replace it with --overwrite, or name another file")
        whole = Path(os.path.realpath(path))
        part = whole.with_name(f".{whole.name}.{os.getpid()}.part")
        try:
            part.write_bytes(data)
            part.replace(whole)
        finally:  # also on Ctrl-C
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)
    except OSError as e:
        raise OutputError(f"{path}: cannot be written: {e.strerror or e}; write it elsewhere") from None


def _is_same(path: Path, other: Path) -> bool:
    try:
        return path.samefile(other)
    except (OSError, ValueError):  # it is not there, may not be looked at, or no name at all
        return False


def _is_stream(path: Path) -> bool:
    """Whether there is a device or a pipe: to put a file in the place of /dev/null would break the whole machine."""
    return path.exists() and not path.is_file() and not path.is_dir()
