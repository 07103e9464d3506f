"""Lines on standard error: plain ones, or with `--log-format json` an object a line."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Final

from facetrack_cli.core.errors import flat

VARIABLE: Final = "FACETRACK_LOG_FORMAT"  # a variable, so that the processes of a batch know too
LINES: Final = 20  # of what a process wrote to standard error that are kept, the last ones
_LEVELS: Final = {"error: ": "error", "warning: ": "warning", "note: ": "info"}


_clip: str | None = None


@contextlib.contextmanager
def about(clip: str) -> Iterator[None]:
    """Within this all lines of this process are about a clip of that name."""
    global _clip
    before, _clip = _clip, clip
    try:
        yield
    finally:
        _clip = before


def as_json() -> bool:
    return os.environ.get(VARIABLE, "").lower() == "json"


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
    known = {name: value for name, value in {**more, "clip": _clip or more.get("clip")}.items() if value is not None}
    # what is no text in UTF-8, as a name of a file may be, is escaped
    return json.dumps({"time": time, "level": level, "message": said, **known})


def write_line(message: str, **more: object) -> None:
    """Write it to standard error; a full disk under the log stops nothing."""
    with contextlib.suppress(OSError):
        sys.stderr.write(log_line(message, **more) + "\n")
        sys.stderr.flush()


def warn(message: str) -> None:
    write_line(f"facetrack: warning: {message}")
