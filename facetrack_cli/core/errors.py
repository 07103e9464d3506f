"""What can go wrong, and the exit code of each.

FacetrackError            1  an internal error
├── UsageError            2  the command line
│   ├── RecipeError       2  a recipe, with file, line and column where known
│   └── OutputError       2  the output cannot be written: permission, full disk, another file there
│       └── BusyError     2  another process writes there
└── InputError            3  a clip, an init file, a prior or a ground truth file

Every message is one line that names the file, the place and the remedy.

A message is a plain line on standard error, or with `--log-format json` an object a line.
"""

import contextlib
import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum
from typing import Final


class ExitCode(IntEnum):
    DONE = 0
    FAULT = 1
    USAGE = 2
    INPUT = 3
    LOST = 4
    BATCH = 5
    REGRESSION = 6
    INTERRUPTED = 130
    TERMINATED = 143


class FacetrackError(Exception):
    exit_code = ExitCode.FAULT


class UsageError(FacetrackError):
    exit_code = ExitCode.USAGE


class RecipeError(UsageError):
    pass


class OutputError(UsageError):
    pass


class BusyError(OutputError):
    pass


class InputError(FacetrackError):
    exit_code = ExitCode.INPUT


_NAME = (errno.ENAMETOOLONG, errno.ELOOP, errno.EACCES, errno.EPERM, errno.ENOTDIR)
_NO_MEMORY = ("Insufficient memory", "can't start new thread", "Cannot allocate memory")


def from_system(error: Exception) -> FacetrackError | None:
    """What the system refused, as our error: memory, or a name that nothing can have; None for any other error."""
    if isinstance(error, MemoryError) or any(words in str(error) for words in _NO_MEMORY):
        return FacetrackError(f"not enough memory ({reason(error)}); take fewer particles or smaller frames")
    if isinstance(error, OSError) and error.filename is not None and error.errno in _NAME:
        return InputError(f"{error.filename}: {error.strerror}; name another file or folder")
    return None


def visible(text: str) -> str:
    """The text with its control characters escaped, as \\x1b: names must not steer a terminal. Lines stay lines."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode() for c in text)


def flat(line: str) -> str:
    """The text on one line, as `visible`: a name may hold a line break, a message must not."""
    return visible(" ".join(line.splitlines()))


def reason(error: Exception) -> str:
    """The message of an exception on one line, at most 120 characters, without the path that the caller names."""
    text = " ".join(str(getattr(error, "strerror", None) or error).split())  # FFmpeg's errors have it, too
    return text if len(text) <= 120 else text[:117] + "..."


def check_opencv(version: str) -> None:
    """UsageError where `cv2` is neither OpenCV 4 nor 5, as where another package brought one, which took its place."""
    if version.startswith(("4.", "5.")):
        return
    remedy = "uninstall all packages opencv-*, then pip install 'opencv-python-headless>=4.13,<5'"
    raise UsageError(f"OpenCV 4 or 5 is needed, and cv2 is {version}: {remedy}")


@contextmanager
def reading(path: object, remedy: str = "make it readable", kind: type[FacetrackError] = InputError) -> Iterator[None]:
    """InputError, in its one line, where the system refuses to read a path."""
    try:
        yield
    except OSError as e:
        raise kind(f"{path}: cannot be read: {e.strerror or e}; {remedy}") from e


@contextmanager
def needed(what: str, package: str, extra: str = "plot") -> Iterator[None]:
    """Around imports of an extra's packages: UsageError in one line where one is missing or broken."""
    remedy = f"pip install 'facetrack[{extra}]'"
    try:
        yield
    except ModuleNotFoundError as e:
        module = (e.name or package).partition(".")[0]
        missing = "PyTables" if module == "tables" else module
        raise UsageError(f"{what} need {missing}, which is not installed: {remedy}") from None
    except (ImportError, ValueError, OSError) as e:
        said = " ".join(str(e).split())
        raise UsageError(f"{package} cannot be loaded: {said}; install it again: {remedy}") from e


LOG_FORMAT: Final = "FACETRACK_LOG_FORMAT"  # a variable, so that the processes of a batch know too
_LEVELS: Final = {"error: ": "error", "warning: ": "warning", "note: ": "info"}
_clip: str | None = None


@contextmanager
def about(clip: str) -> Iterator[None]:
    """Within this all lines of this process are about a clip of that name."""
    global _clip
    before, _clip = _clip, clip
    try:
        yield
    finally:
        _clip = before


def as_json() -> bool:
    return os.environ.get(LOG_FORMAT, "").lower() == "json"


def log_line(message: str, **more: object) -> str:
    """A message as one line, without its end; as JSON with time, level, message, and `more`, None left out."""
    if not as_json():
        return flat(message)
    import json
    from datetime import datetime, timezone

    level, said = "info", flat(message).removeprefix("facetrack: ")
    for prefix, name in _LEVELS.items():
        if said.startswith(prefix):
            level, said = name, said.removeprefix(prefix)
    time = datetime.now(timezone.utc).isoformat(timespec="milliseconds")
    members = {name: value for name, value in {**more, "clip": _clip or more.get("clip")}.items() if value is not None}
    # what is no text in UTF-8, as a name of a file may be, is escaped
    return json.dumps({"time": time, "level": level, "message": said, **members})


def write_line(message: str, **more: object) -> None:
    """Write it to standard error; a full disk under the log stops nothing."""
    with contextlib.suppress(OSError):
        sys.stderr.write(log_line(message, **more) + "\n")
        sys.stderr.flush()


def warn(message: str) -> None:
    write_line(f"facetrack: warning: {message}")
