"""Writing results: files that appear, or are replaced, when they are whole; streams; folders.

Every file is written under its temporary path, brought to the disk and then renamed. A symbolic link
stays one, and the file that it leads to is replaced; in the folder of a run, which may be a stranger's, it is refused,
by `check_plain`. On a full disk `FileSink` keeps the records that fit: the end of the
file is written over the last of them, in space that the file already has, so a finished file is always valid.
"""

import contextlib
import errno
import hashlib
import os
import secrets
import stat
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from facetrack_cli.core.errors import InputError, OutputError, reason

BLOCK = 1 << 20  # bytes of a file that are read at a time
_LAST_RECORDS = 2000  # at the end of a file, in which there is space for its end
MAX_TABLE_BYTES = 1 << 30  # of a table of rows: ten hours of a face and its points
MAX_FILE_BYTES = 1 << 26  # of any other file that is read whole
TABLES = ("trajectory.csv", "trajectory.json", "trajectory.jsonl")  # by one of which the folder of a run is known
MAX_DIRECTORY_BYTES = 1 << 25  # of the list of files in an .npz
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


_SECRET = secrets.token_hex(8)  # a file that lies there already under a name that was guessed is never written to


def cannot_write(path: Path, error: OSError, remedy: str = "choose another place") -> OutputError:
    """The one line for a file that cannot be written."""
    full = f"the disk is full ({reason(error)}); free some space or {remedy}"
    return OutputError(f"{path}: {full if error.errno in FULL else f'cannot be written: {reason(error)}; {remedy}'}")


@contextlib.contextmanager
def writing(path: Path, remedy: str = "choose another place") -> Iterator[None]:
    """OutputError, in its one line, where the system refuses to write a path."""
    try:
        yield
    except OSError as e:
        raise cannot_write(path, e, remedy) from e


def own_mark() -> str:
    """What the temporary names of this process have in common."""
    return f"{os.getpid()}-{_SECRET}"


def temporary_path(path: Path, mark: str | None = None) -> Path:
    """The temporary name under which this process, or the one of that mark, writes what will replace `path`."""
    whole = Path(os.path.realpath(path))
    return whole.with_name(f".{whole.stem}-{own_mark() if mark is None else mark}.part{whole.suffix}")


def sync(path: Path) -> None:
    """Bring a file, or the names in a folder, to the disk, where the system can. Raises OSError."""
    if os.name != "posix" and path.is_dir():
        return
    place = os.open(path, os.O_RDONLY if os.name == "posix" else os.O_RDWR)
    try:
        os.fsync(place)
    except OSError as e:
        if e.errno not in (errno.EINVAL, errno.ENOTSUP):  # of a file system that has none
            raise
    finally:
        os.close(place)


def publish(path: Path) -> None:
    """Rename the temporary file of a path to it, both on the disk. Raises OSError."""
    sync(temporary_path(path))
    temporary_path(path).replace(os.path.realpath(path))
    sync(Path(os.path.realpath(path)).parent)


def discard(path: Path) -> None:
    """Remove the temporary file of a path, if there is one."""
    with contextlib.suppress(OSError):
        temporary_path(path).unlink(missing_ok=True)


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """A file that replaces `path` when the block ends without an error. OSError."""
    try:
        with temporary_path(path).open("wb") as file:
            yield file
        publish(path)
    finally:
        discard(path)


def _bytes(text: str) -> bytes:
    # a file name that is not UTF-8 holds lone surrogates; escaped they are still valid JSON
    return text.encode(errors="backslashreplace")


def _pass_on(data: bytes, file: Any) -> None:
    """All of the bytes to an unbuffered file, which may take them in parts. OSError."""
    rest = memoryview(data)
    while rest:
        rest = rest[file.write(rest) :]


class Place(NamedTuple):
    """A place between two records of a file: the bytes and the records before it."""

    bytes: int
    records: int


class BytesSink:
    """Records encoded and handed to `write`, as that of an open file."""

    def __init__(self, write: Callable[[bytes], object]) -> None:
        self._write, self._records = write, 0

    def write(self, record: str) -> None:
        self._records += 1
        self._write(_bytes(record))

    def finish(self, tail: Callable[[int], str]) -> None:
        """End with `tail(number of records)`."""
        if end := tail(self._records):
            self._write(_bytes(end))

    def discard(self) -> None:
        pass


class StreamSink(BytesSink):
    """Records to an open binary stream, each passed on at once. BrokenPipeError when the reader has closed it."""

    def __init__(self, stream: BinaryIO) -> None:
        super().__init__(self._to_stream)
        # unbuffered: what a reader did not take must not be written again at exit
        self._stream = getattr(stream, "raw", stream)

    def _to_stream(self, data: bytes) -> None:
        try:
            _pass_on(data, self._stream)
        except BrokenPipeError:
            raise
        except OSError as e:
            raise cannot_write(Path("standard output"), e) from e


class FileSink(BytesSink):
    """Records into the temporary file of a path, each of them at once: a process that is killed loses none.

    Raises OutputError when the file cannot be written; `finish` may still be called then, and keeps what fits.
    """

    def __init__(self, path: Path) -> None:
        self.path, self._records, self._full = path, 0, False
        self._ends = deque([0], maxlen=_LAST_RECORDS)
        with writing(path):
            self._file: BinaryIO = self._open()

    def _open(self) -> BinaryIO:
        return temporary_path(self.path).open("wb", buffering=0)

    def write(self, record: str) -> None:
        data = _bytes(record)
        self._records += 1
        self._ends.append(self._ends[-1] + len(data))
        self._write(data)

    def place(self) -> Place:
        """Where the next record begins."""
        return Place(self._file.tell(), self._records)

    def go_on(self, file: Path, place: Place) -> None:
        """Begin with the contents of a file up to a place. Raises OSError."""
        left = place.bytes
        with file.open("rb") as before:
            while left and (block := before.read(min(left, BLOCK))):
                self._file.write(block)
                left -= len(block)
        if left:
            raise OSError(errno.EIO, f"{file} is too short")
        self._records = place.records
        self._ends.append(place.bytes)

    def sync(self) -> None:
        """Bring what is written to the disk. Raises OSError."""
        os.fsync(self._file.fileno())

    def finish(self, tail: Callable[[int], str]) -> None:
        """End the file with `tail(number of records)` and close it."""
        with contextlib.closing(self._file), writing(self.path):
            try:
                if self._full:
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                super().finish(tail)
            except (OSError, OutputError):
                self._cut(tail)
                raise

    def discard(self) -> None:
        """Close and remove the temporary file, if it is still there."""
        with contextlib.suppress(OSError):
            self._file.close()
        discard(self.path)

    def _write(self, data: bytes) -> None:
        try:
            _pass_on(data, self._file)
        except OSError as e:
            self._full = True
            raise cannot_write(self.path, e) from e

    def _cut(self, tail: Callable[[int], str]) -> None:
        """End the file within the bytes that reached it, after as many whole records as leave space for the tail."""
        reached = self._file.tell()
        for kept, place in zip(range(self._records, 0, -1), reversed(self._ends), strict=False):
            end = _bytes(tail(kept))
            if place + len(end) <= reached:
                self._file.seek(place)
                self._file.write(end)
                self._file.truncate(place + len(end))
                return
        self._file.truncate(0)


def check_new(path: Path, *, overwrite: bool, inputs: Iterable[Path | None] = ()) -> None:
    """Raises OutputError before the work for what `write_new` would refuse after it, and for a file of `inputs`."""
    check_file(path, overwrite=overwrite, inputs=inputs)
    if not path.parent.is_dir():
        raise OutputError(f"{path}: there is no folder {path.parent}; make it, or name another file")


def check_file(
    path: Path, *, overwrite: bool, inputs: Iterable[Path | None] = (), remedy: str = "name another file"
) -> None:
    """As `check_new`, for a file in a folder that is still to be made."""
    with writing(path, remedy):
        if path.is_dir():
            raise OutputError(f"{path}: is a folder, where a file is to be; {remedy}")
        if any(same_file(path, file) for file in inputs if file is not None):
            raise OutputError(f"{path}: is read here, and would be replaced; {remedy}")
        if os.path.lexists(path) and not overwrite and not _is_stream(path):
            raise OutputError(f"{path}: exists already; replace it with --overwrite, or {remedy}")
        if any((path.parent / name).exists() for name in TABLES):
            check_plain(path)


def check_plain(*paths: Path) -> None:
    """OutputError for links: what is written there would land elsewhere, where whoever made the folder wishes."""
    for path in paths:
        if path.is_symlink():
            raise OutputError(f"{path}: is a link, and what it leads to is not replaced; remove it, and run again")


def write_new(path: Path, data: bytes, *, overwrite: bool) -> None:
    """Write a small file whole or not at all; a device or a pipe is written to. Raises OutputError as `check_file`."""
    check_file(path, overwrite=overwrite)
    with writing(path, "write it elsewhere"):
        if _is_stream(path):
            path.write_bytes(data)
        else:
            with replacing(path) as file:
                file.write(data)


def digest(files: Iterable[Path], *, names: bool = False, heard: Callable[[int], None] = lambda _: None) -> str:
    """SHA-256 of the bytes of these files, with `names` of their names too. Raises OSError.

    `heard` hears how many bytes are read; what it raises ends it.
    """
    total, count = hashlib.sha256(), 0
    for path in files:
        if names:
            total.update(path.name.encode(errors="surrogateescape") + b"\0")
        with path.open("rb") as file:
            while block := file.read(BLOCK):
                total.update(block)
                heard(count := count + len(block))
    return total.hexdigest()


def check_readable(path: Path, most: int, what: str = "file") -> None:
    """InputError for a file of more than `most` bytes, and for a device or a pipe, which may never end. OSError."""
    status = path.stat()
    if stat.S_ISFIFO(status.st_mode):
        raise InputError(f"{path}: is a pipe, and can be read only once; save it in a file, and name that")
    if not stat.S_ISREG(status.st_mode) and not stat.S_ISDIR(status.st_mode):
        raise InputError(f"{path}: is a device, not a {what}; name a file")
    if status.st_size > most:
        size = f"{status.st_size / 1e6:.0f} MB, and at most {most / 1e6:.0f} MB are read"
        raise InputError(f"{path}: is too large for a {what}: {size}; name the right file, or split it")


def read_bounded(path: Path, most: int = MAX_FILE_BYTES, what: str = "file") -> bytes:
    """The bytes of a file. InputError as `check_readable`, before they take memory. OSError."""
    check_readable(path, most, what)
    with path.open("rb") as file:
        return file.read(most)


def absolute(path: Path) -> Path:
    """The whole path under the name that was given: a link keeps its own."""
    return Path(os.path.abspath(path))  # noqa: PTH100 -- Path.resolve follows links


def same_file(path: Path, other: Path) -> bool:
    """Whether both exist and are the same file or folder."""
    try:
        return path.samefile(other)
    except (OSError, ValueError):  # one of them does not exist, cannot be looked at, or is not a valid name
        return False


def _is_stream(path: Path) -> bool:
    """Whether `path` is a device or a pipe, which must not be replaced, as /dev/null."""
    return path.exists() and not path.is_file() and not path.is_dir()


def check_folder(path: Path, names: Sequence[str], *, overwrite: bool, inputs: Sequence[Path | None]) -> None:
    """OutputError if files of these names cannot go into the folder `path`, or would replace or mix with `inputs`."""
    with writing(path):
        if path.exists() and not path.is_dir():
            raise OutputError(f"{path}: is a file, where a folder for the results is to be; name another with --out")
        if any(same_file(path, file) for file in inputs if file is not None):
            raise OutputError(f"{path}: the results would go among the frames of the input; name another with --out")
    for name in names:
        check_file(path / name, overwrite=overwrite, inputs=inputs, remedy="name another folder with --out")
        check_plain(path / name)


def make_folder(path: Path, remedy: str = "choose another place") -> list[Path]:
    """Make a folder and return those that were made, the innermost first. OutputError if it cannot be written to."""
    with writing(path, remedy):
        made = [folder for folder in (path, *path.parents) if not folder.exists()]
        path.mkdir(parents=True, exist_ok=True)
        if not os.access(path, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    return made


def remove_folders(made: Sequence[Path]) -> None:
    """Remove folders that `make_folder` made, unless they hold something."""
    for folder in made:
        with contextlib.suppress(OSError):
            folder.rmdir()
