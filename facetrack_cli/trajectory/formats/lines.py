"""Text files of numbers without quotes, as the tracking benchmarks keep them: their lines, and what is wrong with them.

Every reader of this folder builds on these: one message a fault, with the file, the line and the remedy.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Array, Whole
from facetrack_cli.trajectory.reader import MAX_FRAME, MAX_PIXELS, refuse_pipe
from facetrack_cli.trajectory.trajectory import Trajectory, one_part

FROM_ONE = np.array([1.0, 1.0, 0.0, 0.0])  # what boxes (..., 4) that are counted from 1 have too much


class Line(NamedTuple):
    """A line and its number in the file, counted from 1."""

    number: int
    text: str


def read_text(path: Path) -> str:
    """The text of a file, without a byte order mark and with `\\n` at the ends of its lines.

    Raises InputError for a file that is missing, a folder, a pipe, empty, or no text.
    """
    try:
        refuse_pipe(path)
        raw = path.read_bytes()
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; name the truth file in it") from None
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; name a truth file") from None
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e.strerror or e}; make it readable, or name another") from e
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(f"{path}: is UTF-16 text; save it as UTF-8")
    if b"\0" in raw[:8192]:
        raise InputError(f"{path}: is binary; name a truth file in UTF-8 text")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as e:
        line = raw.count(b"\n", 0, e.start) + 1
        raise InputError(f"{path}:{line}: is not UTF-8 text; save the file as UTF-8, or name a truth file") from e
    if not text.strip():
        raise InputError(f"{path}: is empty; a truth file has a line a frame")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def lines_by_frame(path: Path, text: str) -> list[Line]:
    """The lines of a file in which line i is frame i: a blank one in the middle is an error, at the end it is not."""
    lines = [line.strip() for line in text.rstrip().split("\n")]
    for number, line in enumerate(lines, 1):
        if not line:
            raise InputError(
                f"{path}:{number}: is blank, and every line is a frame here; write nan,nan,nan,nan for a frame without"
            )
    return [Line(number, line) for number, line in enumerate(lines, 1)]


def lines_with_frame(text: str) -> list[Line]:
    """The lines of a file whose lines name their frame: blank ones are passed over."""
    return [Line(number, line.strip()) for number, line in enumerate(text.split("\n"), 1) if line.strip()]


def delimiter(line: str) -> str | None:
    """What stands between the numbers: a comma where there is one, else tabs or blanks (None, as for str.split)."""
    return "," if "," in line else None


def numbers(path: Path, lines: Iterable[Line], columns: int, wanted: str, use: list[int] | None = None) -> Array:
    """(T, columns), or (T, len(use)): the numbers of lines that have all `columns` of them; an empty cell is nan.

    `wanted` says what a line should hold. Raises InputError with the line for anything else.
    """
    found: list[list[float]] = []
    between: str | None = None
    for at, (number, text) in enumerate(lines):
        if at == 0:
            between = delimiter(text)
        cells = text.split(between)
        try:
            if len(cells) != columns or "_" in text:  # float() would take 1_0 for 10
                raise ValueError
            found.append([float(cell) for cell in (cells if use is None else [cells[i] for i in use])])
        except ValueError:
            found.append(_carefully(f"{path}:{number}", cells, columns, wanted, use))
    values = np.array(found, dtype=np.float64).reshape(len(found), -1)
    if np.isinf(values).any():
        row = np.flatnonzero(np.isinf(values).any(axis=1))[0]
        raise InputError(f"{path}:{list(lines)[row].number}: inf is no number to measure with; write nan if not known")
    return values


def _carefully(place: str, cells: list[str], columns: int, wanted: str, use: list[int] | None) -> list[float]:
    """The numbers of a line of which float() refused one: empty cells are nan, anything else is an error."""
    for cell in (cell.strip() for cell in cells):
        if len(cell.split()) > 1 or ";" in cell:
            raise InputError(
                f"{place}: {cell!r} is no number; write numbers with a point and one kind of comma, tab or blank "
                f"between them, as in {wanted}"
            )
    if len(cells) != columns:
        there = f"{len(cells)} value{'s' if len(cells) > 1 else ''}"
        raise InputError(f"{place}: {there} instead of {columns}; a line holds {wanted}")
    values = []
    for cell in (cells[i].strip() for i in (use or range(columns))):
        try:
            if "_" in cell:
                raise ValueError
            values.append(float(cell) if cell else np.nan)
        except ValueError:
            raise InputError(f"{place}: {cell!r} is no number; a line holds {wanted}") from None
    return values


def whole(path: Path, lines: list[Line], values: Array, name: str, least: int, most: int = MAX_FRAME) -> Whole:
    """A column as whole numbers from `least` on. Raises InputError with the line of the first that is none."""
    with np.errstate(invalid="ignore"):
        wrong = np.flatnonzero(~((values >= least) & (values <= most) & (values == np.floor(values))))
    if wrong.size:
        row = wrong[0]
        raise InputError(
            f"{path}:{lines[row].number}: {name} {values[row]:.15g} is no whole number from {least} up; correct it"
        )
    return values.astype(np.int64)


def no_frame_twice(path: Path, lines: list[Line], keys: Whole, what: str) -> None:
    """Raises InputError if two rows of `keys` (T, C) are the same; `what` names the columns."""
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    wrong = np.flatnonzero(first[inverse.reshape(-1)] != np.arange(len(keys)))
    if wrong.size:
        row = wrong[0]
        earlier = lines[first[inverse.reshape(-1)[row]]].number
        raise InputError(f"{path}:{lines[row].number}: the same {what} as in line {earlier}; keep one of them")


def boxes(
    path: Path,
    lines: list[Line],
    frame: Whole,
    ltwh: Array,
    *,
    target: str = "",
    status: np.ndarray[tuple[int], np.dtype[np.str_]] | None = None,
    no_area_is_absent: bool = False,
    **columns: Array | None,
) -> Trajectory:
    """One series of boxes (T, 4) left, top, width, height from 0. A row of nan, or without width and height, is absent.

    `status` (T,) may say hidden or absent already; rows that it calls absent may hold any box, which is not kept.
    Raises InputError with the line for a box that is half nan, of a negative size, without area, or beyond any picture.
    """
    said = np.full(len(frame), "visible", dtype="<U8") if status is None else status.astype("<U8")
    unknown = np.isnan(ltwh)
    absent = (said == "absent") | unknown.all(axis=1) | (ltwh[:, 2:] == 0).all(axis=1)
    if no_area_is_absent:
        absent |= (ltwh[:, 2:] == 0).any(axis=1) | (ltwh == [-2, -2, -1, -1]).all(axis=1)
    with np.errstate(invalid="ignore"):
        for wrong, why in (
            (unknown.any(axis=1), "nan in a box that is known by half; give all four numbers, or four times nan"),
            ((ltwh[:, 2:] < 0).any(axis=1), "the box has a negative size; a box is left, top, width, height"),
            ((ltwh[:, 2:] == 0).any(axis=1), "the box has no area; four zeros say that there is none"),
            ((np.abs(ltwh) > MAX_PIXELS).any(axis=1), "the box is farther out than any picture; correct it"),
        ):
            rows = np.flatnonzero(wrong & ~absent)
            if rows.size:
                raise InputError(f"{path}:{lines[rows[0]].number}: {why}")
    known = np.where(absent[:, None], np.nan, ltwh)
    return one_part(
        target,
        "box",
        frame,
        x=known[:, 0] + (known[:, 2] - 1) / 2,
        y=known[:, 1] + (known[:, 3] - 1) / 2,
        w=known[:, 2],
        h=known[:, 3],
        status=np.where(absent, "absent", said),
        **columns,
    )


def decimal(value: float) -> str:
    """A number as the writers of this folder give it: at most 4 decimals, as many as the centres of a CSV need.

    The CSV has 3; half a width makes a fourth. What is not known is nan.
    """
    text = f"{value:.4f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
