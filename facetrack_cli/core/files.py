"""Writing results: files that appear, or are replaced, when they are whole; and streams.

Every file is written under a temporary name `beside` its own and then renamed. A symbolic link stays one: the file that
it leads to is replaced. On a full disk `FileSink` keeps the records that fit: the end of the file is written over the
last of them, in space that the file already has, so a closed file is always valid.
"""

from __future__ import annotations

import contextlib
import errno
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

from facetrack_cli.core.errors import OutputError, reason

BLOCK = 1 << 16  # bytes held back before they are written
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class ReaderGoneError(BrokenPipeError):
    """The program that reads our standard output has closed it."""


def cannot_write(path: Path, error: OSError, remedy: str = "choose another place with --out") -> OutputError:
    """The one line for a file that cannot be written."""
    if error.errno in FULL:
        return OutputError(f"{path}: the disk is full ({reason(error)}); free some space or {remedy}")
    return OutputError(f"{path}: cannot be written: {reason(error)}; {remedy}")


def beside(path: Path, process: int | None = None) -> Path:
    """The temporary name under which this process, or the one of that number, writes what will replace `path`."""
    whole = Path(os.path.realpath(path))
    return whole.with_name(f".{whole.stem}-{os.getpid() if process is None else process}.part{whole.suffix}")


def publish(path: Path) -> None:
    """Rename the file `beside` a path to it. Raises OSError."""
    beside(path).replace(os.path.realpath(path))


def discard(path: Path) -> None:
    """Remove the file `beside` a path, if there is one."""
    with contextlib.suppress(OSError):
        beside(path).unlink(missing_ok=True)


@contextlib.contextmanager
def replacing(path: Path, *, sync: bool = False) -> Iterator[BinaryIO]:
    """A file that replaces `path` at the end of the block; after an exception, Ctrl-C too, `path` is as it was.

    With `sync` its bytes are on the disk before it does. Raises OSError.
    """
    try:
        with beside(path).open("wb") as file:
            yield file
            if sync:
                file.flush()
                os.fsync(file.fileno())
        publish(path)
    finally:
        discard(path)


def _bytes(text: str) -> bytes:
    # a file name that is not UTF-8 holds lone surrogates; escaped they are still valid JSON
    return text.encode(errors="backslashreplace")


class FileSink:
    """Records into `path`, which appears, or is replaced, at `finish`.

    Raises OutputError when the file cannot be written; `finish` may still be called then, and keeps what fits.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._file: BinaryIO = self._open()
        except OSError as e:
            raise cannot_write(path, e) from e
        self._buffer = bytearray()
        self._flushed = 0  # bytes in the file
        self._records = 0
        self._ends: deque[int] = deque()  # where the last records end
        self._full = False
        self.published = False  # whether the file stands at `path`

    def _open(self) -> BinaryIO:
        return beside(self.path).open("wb", buffering=0)

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
            raise cannot_write(self.path, e) from e
        finally:
            self.discard()

    def discard(self) -> None:
        """Close and remove the temporary file, if it is still there."""
        with contextlib.suppress(OSError):
            self._file.close()
        if not self.published:
            discard(self.path)

    def _flush(self) -> None:
        view = memoryview(bytes(self._buffer))
        try:
            while view:
                n = self._file.write(view)
                self._flushed += n
                view = view[n:]
        except OSError as e:
            self._full = True
            raise cannot_write(self.path, e) from e
        self._buffer.clear()
        # two blocks of record ends are enough to find space for the tail
        while len(self._ends) > 1 and self._ends[0] < self._flushed - 2 * BLOCK:
            self._ends.popleft()

    def _cut(self, tail: Callable[[int], str]) -> None:
        """End the file within the bytes that reached it, after as many whole records as leave space for the tail."""
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
        publish(self.path)
        self.published = True


class StreamSink:
    """Records to an open binary stream, each passed on at once. ReaderGoneError when the reader has closed it."""

    def __init__(self, stream: BinaryIO, name: str = "standard output") -> None:
        self.path = None
        self.published = False
        # unbuffered: what a reader did not take must not be written again at exit
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
            raise cannot_write(Path(self._name), e) from e


def check_new(path: Path, *, overwrite: bool, inputs: Iterable[Path | None] = ()) -> None:
    """Refuse before the work what `write_new` would refuse after it, and a file that the work is made from.

    Raises OutputError. Of `inputs`, those that are None or do not exist are ignored.
    """
    check_file(path, overwrite=overwrite, inputs=inputs)
    if not path.parent.is_dir():
        raise OutputError(f"{path}: there is no folder {path.parent}; make it, or name another file")


def check_file(
    path: Path, *, overwrite: bool, inputs: Iterable[Path | None] = (), remedy: str = "name another file"
) -> None:
    """As `check_new`, for a file in a folder that is still to be made."""
    try:
        if path.is_dir():
            raise OutputError(f"{path}: is a folder, where a file is to be; {remedy}")
        if any(same_file(path, given) for given in inputs if given is not None):
            raise OutputError(f"{path}: is read here, and would be replaced; {remedy}")
        if os.path.lexists(path) and not overwrite and not _is_stream(path):
            raise OutputError(f"{path}: exists already; replace it with --overwrite, or {remedy}")
    except OSError as e:
        raise cannot_write(path, e, remedy) from None


def write_new(path: Path, data: bytes, *, overwrite: bool) -> None:
    """Write a small file whole or not at all. OutputError if it exists without `overwrite`, or cannot be written.

    A device or a pipe is written to, never replaced.
    """
    check_file(path, overwrite=overwrite)
    try:
        if _is_stream(path):
            path.write_bytes(data)
        else:
            with replacing(path) as file:
                file.write(data)
    except OSError as e:
        raise cannot_write(path, e, "write it elsewhere") from None


def same_file(path: Path, other: Path) -> bool:
    """Whether both exist and are the same file or folder."""
    try:
        return path.samefile(other)
    except (OSError, ValueError):  # one of them does not exist, cannot be looked at, or is not a valid name
        return False


def _is_stream(path: Path) -> bool:
    """Whether `path` is a device or a pipe: a file in the place of /dev/null would break the whole machine."""
    return path.exists() and not path.is_file() and not path.is_dir()
