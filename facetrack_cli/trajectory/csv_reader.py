"""Reading the CSV of a trajectory or ground-truth file, with a message for everything that is wrong in it."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from facetrack_cli.core.errors import InputError
from facetrack_cli.trajectory.row import COLUMNS, DECIMALS, REQUIRED, WHOLE, Row

# --- reading -----------------------------------------------------------------------------------------------------


def read_csv(path: Path) -> list[Row]:
    """The rows of a trajectory or truth file, in the file's order.

    Columns may stand in any order; frame, target, part, x and y must be there, columns of other tools are passed over.
    Raises InputError with file, line and column for anything that is no number where one belongs.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            return list(_read(path, csv.reader(file)))
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e.strerror or e}; name a trajectory or truth file in CSV") from e
    except UnicodeDecodeError as e:
        raise InputError(f"{path}: byte {e.start} is not UTF-8 text; a trajectory is CSV with a header line") from e


def _read(path: Path, lines: Any) -> Iterator[Row]:
    try:
        header = [name.strip() for name in next(lines, [])]
        if not any(header):
            raise InputError(f"{path}: is empty; a trajectory begins with the header {','.join(COLUMNS)}")
        missing = [name for name in REQUIRED if name not in header]
        if missing:
            raise InputError(
                f"{path}:1: the header has no column {', '.join(missing)}; it should read {','.join(COLUMNS)}"
            )
        twice = sorted({name for name in header if name in COLUMNS and header.count(name) > 1})
        if twice:
            raise InputError(f"{path}:1: column {twice[0]} is there twice; keep one of them")
        # the last cell is one of our own, empty, for columns that the file has not
        places = [header.index(name) if name in header else len(header) for name in COLUMNS]
        readers = [(_READERS[name], at) for name, at in zip(COLUMNS, places, strict=True)]
        for cells in lines:
            if not cells:
                continue
            if len(cells) != len(header):
                at = lines.line_num
                if len(cells) < len(header) and not any(lines):
                    raise InputError(
                        f"{path}:{at}: is no whole line, and the last; was the run cut short? remove this line"
                    )
                raise InputError(
                    f"{path}:{at}: {len(cells)} values under {len(header)} columns; "
                    "give every column a value, or leave it empty between its commas"
                )
            cells.append("")
            try:
                yield Row(*[read(cells[at]) for read, at in readers])
            except ValueError:
                line = f"{path}:{lines.line_num}"
                yield Row(*[_value(line, name, cells[at].strip()) for name, at in zip(COLUMNS, places, strict=True)])
    except csv.Error as e:
        raise InputError(f"{path}:{lines.line_num}: is not CSV: {e}") from e


def _float(cell: str) -> float | None:
    if not cell:
        return None
    number = float(cell)
    if number - number != 0 or "_" in cell:  # nan, inf, or 1_0, which float() takes for 10
        raise ValueError
    return number


def _frame_number(cell: str) -> int:
    if not (cell.isascii() and cell.isdigit()) or len(cell) > 18:
        raise ValueError
    return int(cell)


def _int(cell: str) -> int | None:
    return _frame_number(cell) if cell else None


def _name(cell: str) -> str:
    name = cell.strip()
    if not name:
        raise ValueError
    return name


# how the cells of a column are read; what they refuse _value reads once more, to allow blanks or to say what is wrong
_READERS: Mapping[str, Callable[[str], Any]] = {
    **dict.fromkeys(("status", "identity"), str.strip),
    **dict.fromkeys(("target", "part"), _name),
    **dict.fromkeys(WHOLE, _int),
    **dict.fromkeys(DECIMALS, _float),
    "frame": _frame_number,
}


def _value(place: str, column: str, cell: str) -> Any:
    if column in DECIMALS:
        if not cell:
            return None
        try:
            number = math.nan if "_" in cell else float(cell)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise InputError(f"{place}: column {column}: {cell!r} is no finite number; correct it or leave it empty")
        return number
    if column in WHOLE:
        if not cell and column != "frame":
            return None
        if not (cell.isascii() and cell.isdigit()) or len(cell) > 18:
            raise InputError(f"{place}: column {column}: {cell!r} is no whole number from 0 up; correct it")
        return int(cell)
    if not cell and column in ("target", "part"):
        raise InputError(f"{place}: column {column} is empty; name the {column}")
    return cell
