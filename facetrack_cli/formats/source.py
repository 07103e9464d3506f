"""What the header of a JSON trajectory says of its clip; a CSV says nothing, another hand may have written anything."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from facetrack_cli.formats.table import Table


def said(table: Table, group: str, key: str) -> Any:
    """The value below `group`, as of "recipe" and "name"; None where there is none."""
    found = table.header.get(group)
    return found.get(key) if isinstance(found, dict) else None


def clip_of(table: Table) -> Path | None:
    """The clip, looked for where the run was started and beside the trajectory; it need not be there."""
    named = said(table, "source", "path")
    if not isinstance(named, str) or not named:
        return None
    beside = table.path.absolute().parent
    return next((p for p in (Path(named), beside / named, beside.parent / named) if is_there(p)), Path(named))


def picture_of(table: Table) -> tuple[int, int] | None:
    """Width and height of its pictures in pixels."""
    size = said(table, "source", "size")
    if isinstance(size, list) and len(size) == 2 and all(type(side) is int and side > 0 for side in size):
        return size[0], size[1]
    return None


def is_there(path: Path) -> bool:
    """Whether there is such a file or folder, as far as the system lets us look."""
    try:
        return path.exists()
    except OSError:  # no permission, or a name that is too long
        return False
