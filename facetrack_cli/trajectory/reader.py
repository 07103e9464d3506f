"""Reading trajectories and ground truth of facetrack: CSV, JSON and JSON lines, and what is wrong with a file."""

from __future__ import annotations

import csv
import itertools
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import InputError
from facetrack_cli.trajectory.diagnostics import KNOWN, Diagnostic, Diagnostics
from facetrack_cli.trajectory.trajectory import COLUMNS, FLOATS, TEXTS, Trajectory, build
from facetrack_cli.trajectory.writers import SCHEMA, VERSION

REQUIRED: Final = ("frame", "target", "part", "x", "y")
MAX_PIXELS: Final = 1e6  # no image is larger: what is beyond is a slip, or no pixel
MAX_FRAME: Final = 10**9
_DIGITS: Final = 18  # of a whole number: more do not fit into 64 bits
_BLOCK: Final = 1_000  # lines that become columns at a time: few enough to stay in the processor's cache


def read_trajectory(path: Path | str) -> Trajectory:
    """A trajectory or ground-truth file of facetrack, or the folder of a run; CSV and JSON are told apart by content.

    Columns of a CSV may stand in any order; frame, target, part, x and y are required, columns of other tools are
    passed over. Raises InputError, with the line where there is one, for a file that is none of them.
    """
    path, first = _begins(Path(path))
    return _read_json(path) if first == b"{" else _read_csv(path)


def refuse_pipe(path: Path) -> None:
    """Raises InputError for a named pipe or `<(...)`: files are looked at before they are read."""
    if path.is_fifo():
        raise InputError(f"{path}: is a pipe, and can be read only once; save it in a file, and name that")


def _begins(path: Path) -> tuple[Path, bytes]:
    """The file, inside of `path` if that is a folder, and its first character."""
    try:
        if path.is_dir():
            inside = (path / f"trajectory.{form}" for form in ("json", "csv", "jsonl"))
            path = next((file for file in inside if file.is_file()), path)
        refuse_pipe(path)
        with path.open("rb") as file:
            return path, file.read(64).removeprefix(b"\xef\xbb\xbf").lstrip()[:1]
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder without a trajectory.csv or .json; name the file") from None
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e.strerror or e}; name a trajectory or ground-truth file") from e


def _build(
    path: Path, targets: Sequence[str], parts: Sequence[str], columns: dict[str, Any], **others: Any
) -> Trajectory:
    """The trajectory of columns whose rows are of these targets and parts; InputError for numbers that cannot be."""
    if not targets:
        raise InputError(f"{path}: has a header and no rows; there is nothing in it to measure")
    numbers: dict[tuple[str, str], int] = {}
    which = [numbers.setdefault(pair, len(numbers)) for pair in zip(targets, parts, strict=True)]

    def check(name: str, wrong: NDArray[np.bool_], why: str) -> None:
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            place = f"frame {columns['frame'][row]}, {targets[row]}/{parts[row]}"
            raise InputError(f"{path}: {place}: {name} {columns[name][row]:.15g} {why}; correct it, or leave it empty")

    with np.errstate(invalid="ignore"):
        for name in FLOATS:
            values = columns[name]
            check(name, np.isinf(values), "is no finite number")
            if name in ("x", "y", "w", "h", "std_x", "std_y"):
                check(name, np.abs(values) > MAX_PIXELS, "is farther out than any image")
            if name in ("w", "h", "std_x", "std_y"):
                check(name, values < 0, "is negative")
            if name == "identity_prob":
                check(name, (values < 0) | (values > 1), "is no probability")
    return build(tuple(numbers), which, path=path, **columns, **others)


# --- CSV ---------------------------------------------------------------------------------------------------------


def _read_csv(path: Path) -> Trajectory:
    blocks: list[dict[str, Any]] = []
    targets: list[str] = []
    parts: list[str] = []
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            lines = csv.reader(file)
            try:
                header = _header(path, next(lines, []))
                for block, numbers in _blocks(path, lines, len(header)):
                    cells = dict(zip(header, zip(*block, strict=True), strict=True))
                    columns = {name: list(map(str.strip, cells.get(name, [""] * len(block)))) for name in COLUMNS}
                    for name, those in (("target", targets), ("part", parts)):
                        named = columns.pop(name)
                        if "" in named:
                            raise InputError(
                                f"{path}:{numbers[named.index('')]}: column {name} is empty; name the {name}"
                            )
                        those += named
                    blocks.append({name: _column(path, name, cells, numbers) for name, cells in columns.items()})
            except csv.Error as e:
                raise InputError(f"{path}:{lines.line_num}: is not CSV: {e}") from e
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e.strerror or e}; name a trajectory or ground-truth file") from e
    except UnicodeDecodeError as e:
        raise InputError(f"{path}: byte {e.start} is not UTF-8 text; a trajectory is CSV with a header line") from e
    whole = {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]} if blocks else {}
    return _build(path, targets, parts, whole)


def _header(path: Path, cells: Sequence[str]) -> list[str]:
    header = [name.strip() for name in cells]
    if not any(header):
        raise InputError(f"{path}: is empty; a trajectory begins with the header {','.join(COLUMNS)}")
    if missing := [name for name in REQUIRED if name not in header]:
        raise InputError(f"{path}:1: the header has no column {', '.join(missing)}; it should read {','.join(COLUMNS)}")
    if twice := sorted({name for name in header if name in COLUMNS and header.count(name) > 1}):
        raise InputError(f"{path}:1: column {twice[0]} is there twice; keep one of them")
    return header


def _blocks(path: Path, lines: Any, width: int) -> Iterator[tuple[list[list[str]], list[int]]]:
    """Rows of `width` cells, some at a time, with the number of each one's line."""

    def rows() -> Iterator[tuple[list[str], int]]:
        for cells in lines:
            if len(cells) == width:
                yield cells, lines.line_num
            elif cells:
                at = lines.line_num
                if len(cells) < width and not any(lines):
                    raise InputError(
                        f"{path}:{at}: is no whole line, and the last; was the run cut short? remove this line"
                    )
                raise InputError(
                    f"{path}:{at}: {len(cells)} values under {width} columns; "
                    "give every column a value, or leave it empty between its commas"
                )

    every = rows()
    while block := list(itertools.islice(every, _BLOCK)):
        yield [cells for cells, _ in block], [number for _, number in block]


def _column(path: Path, name: str, cells: Sequence[str], numbers: Sequence[int]) -> NDArray[Any]:
    """The values of a column's cells without blanks; InputError, with the line, for the first that is none."""
    if name in TEXTS:
        return np.array(cells, dtype=np.str_)
    convert = _frame if name == "frame" else _count if name == "particles" else _float
    try:
        return np.array([convert(cell) for cell in cells], dtype=np.int64 if name == "frame" else np.float64)
    except ValueError:
        at = next(i for i, cell in enumerate(cells) if _fails(convert, cell))
        if convert is _float:
            why = "is no finite number; correct it or leave it empty"
        else:
            why = "is no whole number from 0 up; correct it"
        raise InputError(f"{path}:{numbers[at]}: column {name}: {cells[at]!r} {why}") from None


def _frame(cell: str) -> int:
    if not (cell.isascii() and cell.isdigit()) or len(cell) > _DIGITS:
        raise ValueError
    return int(cell)


def _count(cell: str) -> float:
    return _frame(cell) if cell else math.nan


def _float(cell: str) -> float:
    if not cell:
        return math.nan
    number = float(cell)
    if number - number != 0 or "_" in cell:  # nan, inf, or 1_0, which float() takes for 10
        raise ValueError
    return number


def _fails(convert: Callable[[str], float], cell: str) -> bool:
    try:
        convert(cell)
    except ValueError:
        return True
    return False


# --- JSON --------------------------------------------------------------------------------------------------------

_SHARED: Final = ("frame", "time_s", "target", "particles", "identity", "identity_prob")
_OWN: Final = ("part", "status", "by_hand", *(name for name in FLOATS if name not in _SHARED))


def _read_json(path: Path) -> Trajectory:
    header, records = _records(path)
    columns: dict[str, list[Any]] = {name: [] for name in (*_SHARED, *_OWN)}
    reported: dict[str, dict[int, Mapping[str, Any]]] = {}
    declared = _declared(path, header)
    for at, record in enumerate(records):
        try:
            frame, time_s = _whole("frame", record["frame"]), _number("time_s", record.get("time_s"))
            for target in record["targets"]:
                name, parts = _text("target", target["target"]), target["parts"]
                particles, sure = (_number(key, target.get(key)) for key in ("particles", "identity_prob"))
                who = "" if target.get("identity") is None else _text("identity", target["identity"], empty=True)
                shared = (frame, time_s, name, particles, who, sure)
                for key, value in zip(_SHARED, shared, strict=True):
                    columns[key] += [value] * len(parts)
                for part in parts:
                    if not part.keys() <= _KEYS:
                        raise ValueError(f"unknown key {min(part.keys() - _KEYS)!r}")
                    columns["part"].append(_text("part", part["part"]))
                    columns["status"].append(_text("status", part.get("status", ""), empty=True))
                    columns["by_hand"].append(_flag("by_hand", part.get("by_hand", False)))
                    for key in _OWN[3:]:
                        columns[key].append(_number(key, part.get(key)))
                if not declared.keys().isdisjoint(target):
                    reported.setdefault(name, {}).setdefault(frame, target)
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as e:
            raise InputError(f"{path}: record {at} of frames is not as facetrack writes it: {e}") from None
    arrays: dict[str, Any] = {
        name: np.array(values) for name, values in columns.items() if name not in ("target", "part")
    }
    diagnostics = {name: _diagnostics(path, name, declared, found) for name, found in reported.items()}
    return _build(path, columns["target"], columns["part"], arrays, header=header, diagnostics=diagnostics)


_KEYS: Final = frozenset(_OWN)


def _whole(name: str, value: Any) -> int:
    if type(value) is not int or not 0 <= value < 10**_DIGITS:
        raise ValueError(f"{name} {value!r} is no whole number from 0 up")
    return value


def _number(name: str, value: Any) -> float:
    if value is None:
        return math.nan
    if type(value) not in (int, float):
        raise ValueError(f"{name} {value!r} is no number")
    return float(value)


def _text(name: str, value: Any, *, empty: bool = False) -> str:
    if not isinstance(value, str) or not (value or empty):
        raise ValueError(f"{name} {value!r} is no name")
    return value


def _flag(name: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{name} {value!r} is neither true nor false")
    return value


def _declared(path: Path, header: Mapping[str, Any]) -> dict[str, Diagnostic]:
    """The diagnostics that every version knows, then those that a header declares."""
    if "diagnostics" not in header:
        return dict(KNOWN)
    from pydantic import TypeAdapter, ValidationError

    try:
        listed = TypeAdapter(list[Diagnostic]).validate_python(header["diagnostics"])
    except ValidationError as e:
        first = e.errors()[0]
        key = ".".join(map(str, ("diagnostics", *first["loc"])))
        raise InputError(
            f"{path}: {key} is not as facetrack run writes it ({first['msg'].lower()}); make the run again"
        ) from None
    return {**KNOWN, **{one.name: one for one in listed if one.name not in KNOWN}}


def _diagnostics(
    path: Path, target: str, declared: Mapping[str, Diagnostic], found: Mapping[int, Mapping[str, Any]]
) -> Diagnostics:
    frames = sorted(found)
    present = {key for each in found.values() for key in each}
    chosen = tuple(one for name, one in declared.items() if name in present)
    try:
        return Diagnostics.of(chosen, frames, [found[frame] for frame in frames])
    except ValueError as e:
        at, why = e.args
        raise InputError(f"{path}: frame {frames[at]}, {target}: {why}; correct it, or leave it out") from None


def _records(path: Path) -> tuple[dict[str, Any], list[Any]]:
    """(header, frames) of a JSON or JSON-lines trajectory; InputError, with the line, if it is none."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as e:
        raise InputError(f"{path}: byte {e.start} is not UTF-8 text; a trajectory is UTF-8") from e
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e.strerror or e}") from e
    frames: Any = []
    try:
        header = json.loads(text)
        if isinstance(header, dict) and header.get("type") != "header":
            frames = header.pop("frames", None)
    except RecursionError as e:
        raise InputError(f"{path}: is nested too deep for a trajectory") from e
    except json.JSONDecodeError as whole_error:
        header = {}
        for number, line in enumerate(text.split("\n"), 1):
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
                header = record
            elif kind == "footer":
                header = {**record, **header}
    check_schema(path, header)
    if not isinstance(frames, list):
        raise InputError(f'{path}: has no list "frames"; it is no trajectory of facetrack')
    return header, frames


def check_schema(path: Path, header: Any) -> None:
    """InputError if a header is not that of a trajectory, or of a version to come."""
    if not isinstance(header, dict) or header.get("schema") != SCHEMA:
        raise InputError(f'{path}: does not say "schema": "{SCHEMA}"; it is no trajectory of facetrack')
    version = header.get("version", VERSION)
    if type(version) is not int or version > VERSION:
        raise InputError(f"{path}: is of version {version!r}, and this facetrack reads {VERSION}; update facetrack")
