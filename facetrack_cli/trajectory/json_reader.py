"""The file around a trajectory in JSON or JSON lines: its header and the list of its frames, as they stand there."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from facetrack_cli.core.errors import InputError
from facetrack_cli.trajectory.row import SCHEMA, VERSION


def read_records(path: Path) -> tuple[dict[str, Any], list[Any]]:
    """(header, frames) of a JSON or JSON-lines trajectory; InputError, with the line, if it is none."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as e:
        raise InputError(f"{path}: byte {e.start} is not UTF-8 text; a trajectory is UTF-8") from e
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e.strerror or e}") from e
    try:
        whole = json.loads(text)
    except RecursionError as e:
        raise InputError(f"{path}: is nested too deep for a trajectory") from e
    except json.JSONDecodeError as whole_error:
        whole, frames = {}, []
        for number, line in enumerate(text.splitlines(), 1):
            if not line.strip():
                continue
            try:
                record = json.loads(line)
            except (json.JSONDecodeError, RecursionError):
                # the first line of a JSON object is no record: then the error of the whole says more
                place = f"{whole_error.lineno}" if number == 1 else str(number)
                why = f"{whole_error.msg}; " if number == 1 else "is no whole record; remove this line: "
                raise InputError(f"{path}:{place}: is not JSON: {why}was the run cut short?") from None
            kind = record.get("type") if isinstance(record, dict) else None
            if kind == "frame":
                frames.append(record)
            elif kind == "header":
                whole = record
        check_schema(path, whole)
        return whole, frames
    if isinstance(whole, dict) and whole.get("type") == "header":  # JSON lines that end after their header
        whole["frames"] = []
    check_schema(path, whole)
    frames = whole.pop("frames", None)
    if not isinstance(frames, list):
        raise InputError(f'{path}: has no list "frames"; it is no trajectory of facetrack')
    return whole, frames


def check_schema(path: Path, header: Any) -> None:
    """InputError if a header is not that of a trajectory, or of a version to come."""
    if not isinstance(header, dict) or header.get("schema") != SCHEMA:
        raise InputError(f'{path}: does not say "schema": "{SCHEMA}"; it is no trajectory of facetrack')
    version = header.get("version", VERSION)
    if type(version) is not int or version > VERSION:
        raise InputError(f"{path}: is of version {version!r}, and this facetrack reads {VERSION}; update facetrack")
