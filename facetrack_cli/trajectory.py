"""The table of results: one row a frame, target and part. CSV, JSON and JSON lines, and the reader of the CSV.

The CSV holds what was measured and nothing of when or where, so the same numbers give the same bytes. JSON holds the
same rows, grouped by frame, with what a tracker that adapts tells of a target (told.py), between a header (source,
recipe, seed, init) and a footer (how the run ended). JSON lines are the header, a line a frame, and the footer, each
with its `type`. Truth files are CSV with the same columns, whose `status` is visible, hidden or absent.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol, TypeAlias

from facetrack_cli.digits import dumps, fixed
from facetrack_cli.errors import InputError
from facetrack_cli.told import members

if TYPE_CHECKING:
    from facetrack_cli.types import Result

SCHEMA = "facetrack-trajectory"
VERSION = 1
Format: TypeAlias = Literal["csv", "json", "jsonl"]
FORMATS: tuple[Format, ...] = ("csv", "json", "jsonl")


class Row(NamedTuple):
    """One line of a trajectory or of a truth file.

    `frame` is the 0-based source frame; (x, y) the centre and (w, h) the window in pixels; `angle` in degrees;
    `confidence` 0..1; `std_x`, `std_y` the posterior's spread in pixels. What is not known is None, or "" for text.
    `by_hand`, which the CSV does not have, is whether a correction said so at this very frame.
    """

    frame: int
    time_s: float | None
    target: str
    part: str
    x: float | None
    y: float | None
    w: float | None = None
    h: float | None = None
    angle: float | None = None
    confidence: float | None = None
    status: str = ""
    std_x: float | None = None
    std_y: float | None = None
    particles: int | None = None
    ess: float | None = None
    identity: str = ""
    identity_prob: float | None = None
    by_hand: bool = False


COLUMNS = Row._fields[:-1]  # of the CSV
REQUIRED = ("frame", "target", "part", "x", "y")
# the bytes of a file are a function of the values: every column has its number of decimals
DECIMALS = {
    "time_s": 4,
    "x": 3,
    "y": 3,
    "w": 3,
    "h": 3,
    "angle": 2,
    "confidence": 4,
    "std_x": 3,
    "std_y": 3,
    "ess": 1,
    "identity_prob": 4,
}
WHOLE = ("frame", "particles")


def rows(result: Result) -> Iterator[Row]:
    """The rows of one frame: targets in the tracker's order, parts in the recipe's."""
    for target in result.targets:
        for part in target.parts:
            yield Row(
                frame=result.frame.index,
                time_s=result.frame.time_s,
                target=target.name,
                part=part.name,
                x=_place(part.x),
                y=_place(part.y),
                w=_place(part.w),
                h=_place(part.h),
                angle=part.angle,
                confidence=part.confidence,
                status=part.status,
                std_x=None if part.cov is None else math.sqrt(max(part.cov[0], 0.0)),
                std_y=None if part.cov is None else math.sqrt(max(part.cov[2], 0.0)),
                particles=target.particles,
                ess=part.ess,
                identity=target.identity or "",
                identity_prob=target.identity_prob,
                by_hand=part.by_hand,
            )


def _place(value: float) -> float | None:
    """nan, which an absent part has, is not known."""
    return value if value == value else None


# --- writing -----------------------------------------------------------------------------------------------------


class Sink(Protocol):
    """Where records go. `write` takes a whole record: a sink that runs full keeps whole records only."""

    def write(self, record: str) -> None: ...
    def finish(self, tail: Callable[[int], str]) -> None: ...


class Writer(Protocol):
    """A trajectory being written, a frame at a time. `close` ends it properly, whatever ended the run."""

    def write(self, result: Result) -> None: ...
    def close(self, footer: Footer) -> None: ...


Header: TypeAlias = Mapping[str, Any]  # JSON-ready: source, recipe, seed, init


class Footer(NamedTuple):
    """How a run ended. `complete` is False when frames that were asked for are missing; `stopped` says why.

    `lost_frames` counts, for each "target/part", the frames in which it was lost. Only at its end is it known whether
    a clip keeps a constant rate.
    """

    complete: bool = True
    stopped: str | None = None
    warnings: tuple[str, ...] = ()
    lost_frames: Mapping[str, int] = {}
    variable_fps: bool | None = None


def csv_lines(items: Iterable[Row]) -> str:
    """Rows as lines of CSV, without the header."""
    return "".join(",".join([form(value) for form, value in zip(_CSV, row, strict=False)]) + "\n" for row in items)


class CsvWriter:
    """Header line, then a row a frame, target and part."""

    def __init__(self, sink: Sink, header: Header) -> None:
        self._sink = sink
        sink.write(",".join(COLUMNS) + "\n")

    def write(self, result: Result) -> None:
        self._sink.write(csv_lines(rows(result)))

    def close(self, footer: Footer) -> None:
        self._sink.finish(lambda _: "")


class JsonWriter:
    """One object; the frames stand in a list, one to a line, so that neither writing nor `grep` holds them all."""

    def __init__(self, sink: Sink, header: Header) -> None:
        self._sink = sink
        self._between = ""
        head = "".join(f"{dumps(key)}: {dumps(value)},\n" for key, value in _head(header).items())
        sink.write("{\n" + head + '"frames": [\n')

    def write(self, result: Result) -> None:
        # the comma goes with the record that follows it: a file cut back to whole records still closes
        self._sink.write(self._between + "{" + _frame(result) + "}")
        self._between = ",\n"

    def close(self, footer: Footer) -> None:
        def tail(records: int) -> str:
            pairs = _foot(footer, records - 1)
            return "\n],\n" + ",\n".join(f"{dumps(key)}: {dumps(value)}" for key, value in pairs.items()) + "\n}\n"

        self._sink.finish(tail)


class JsonLinesWriter:
    """A line a frame, for programs that read while the tracker runs."""

    def __init__(self, sink: Sink, header: Header) -> None:
        self._sink = sink
        sink.write(dumps({"type": "header", **_head(header)}) + "\n")

    def write(self, result: Result) -> None:
        self._sink.write('{"type":"frame",' + _frame(result) + "}\n")

    def close(self, footer: Footer) -> None:
        self._sink.finish(lambda records: dumps({"type": "footer", **_foot(footer, records - 1)}) + "\n")


WRITERS: Mapping[Format, Callable[[Sink, Header], Writer]] = {
    "csv": CsvWriter,
    "json": JsonWriter,
    "jsonl": JsonLinesWriter,
}


def _head(header: Header) -> dict[str, Any]:
    from facetrack_cli import __version__

    return {"schema": SCHEMA, "version": VERSION, "facetrack": __version__, **header}


def _foot(footer: Footer, frames: int) -> dict[str, Any]:
    ended = {"stopped": footer.stopped} if footer.stopped else {}
    return {
        "complete": footer.complete,
        **ended,
        "frames_tracked": frames,
        "variable_fps": footer.variable_fps,
        "lost_frames": dict(footer.lost_frames),
        "warnings": list(footer.warnings),
    }


def _frame(result: Result) -> str:
    """The members of one frame's object; numbers have the digits of the CSV."""
    targets: list[str] = []
    told = {target.name: members(target.told) for target in result.targets if target.told is not None}
    for name, group in groupby(rows(result), key=attrgetter("target")):
        parts: list[str] = []
        head: list[str] = []
        for row in group:
            known = {key: text for key, form, value in zip(_KEYS, _JSON, row, strict=True) if (text := form(value))}
            head = head or _members(known, _OF_TARGET)
            parts.append("{" + ",".join(_members(known, _OF_PART)) + "}")
        head += told.get(name, ())
        targets.append("{" + ",".join(head) + ',"parts":[' + ",".join(parts) + "]}")
    time_s = _JSON[COLUMNS.index("time_s")](result.frame.time_s) or "null"
    return f'"frame":{result.frame.index},"time_s":{time_s},"targets":[{",".join(targets)}]'


_OF_TARGET = ("target", "particles", "identity", "identity_prob")
_OF_PART = ("part", "x", "y", "w", "h", "angle", "confidence", "status", "by_hand", "std_x", "std_y", "ess")


def _members(known: Mapping[str, str], names: Iterable[str]) -> list[str]:
    return [f'"{name}":{known[name]}' for name in names if name in known]


def _whole(value: Any) -> str:
    return "" if value is None else str(value)


def _quoted(value: Any) -> str:
    text = str(value)
    return '"' + text.replace('"', '""') + '"' if any(c in text for c in ',"\r\n') else text


def _string(value: Any) -> str:
    return dumps(value) if value else ""


def _only_true(value: Any) -> str:
    return "true" if value else ""


# how the values of each column are written; "" is not known
_CSV = tuple(fixed(DECIMALS[name]) if name in DECIMALS else _whole if name in WHOLE else _quoted for name in COLUMNS)
_JSON = (*(_string if form is _quoted else form for form in _CSV), _only_true)
_KEYS = Row._fields


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
