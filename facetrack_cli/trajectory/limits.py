"""Numbers that no file of truth or results may hold: they would be measured in silence, or overflow."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Array

MAX_PIXELS = 1e6  # no picture is larger; what is beyond is a slip, or no pixel
MAX_FRAME = 10**9
PIXELS = ("x", "y", "w", "h", "std_x", "std_y")
SIZES = ("w", "h", "std_x", "std_y")


def check_columns(path: Path, columns: Mapping[str, Array], place: Callable[[int], str]) -> None:
    """Raises InputError for a number of a column (R,) that cannot be; `place(row)` names its frame and part."""
    for name, values in columns.items():
        with np.errstate(invalid="ignore"):
            for wrong, why in (
                (np.isinf(values), "is no finite number"),
                ((np.abs(values) > MAX_PIXELS) & (name in PIXELS), "is farther out than any picture"),
                ((values < 0) & (name in SIZES), "is negative"),
            ):
                if wrong.any():
                    row = int(np.flatnonzero(wrong)[0])
                    raise InputError(
                        f"{path}: {place(row)}: {name} {values[row]:.15g} {why}; correct it, or leave it empty"
                    )


def refuse_pipe(path: Path) -> None:
    """Raises InputError for a named pipe or `<(...)`: files are looked at before they are read."""
    if path.is_fifo():
        raise InputError(f"{path}: is a pipe, and can be read only once; save it in a file, and name that")
