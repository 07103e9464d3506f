"""The table of results: one row a frame, target and part. CSV, JSON and JSON lines, and the reader of the CSV.

The CSV holds what was measured and nothing of when or where, so the same numbers give the same bytes. JSON holds the
same rows, grouped by frame, with what a tracker that adapts tells of a target (told.py), between a header (source,
recipe, seed, init) and a footer (how the run ended). JSON lines are the header, a line a frame, and the footer, each
with its `type`. Truth files are CSV with the same columns, whose `status` is visible, hidden or absent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from itertools import groupby
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Protocol

from facetrack_cli.core.numbers import dumps, fixed
from facetrack_cli.trajectory.row import COLUMNS, DECIMALS, SCHEMA, VERSION, WHOLE, Footer, Format, Header, Row, rows

if TYPE_CHECKING:
    from facetrack_cli.core.types import Result, Told


# --- writing -----------------------------------------------------------------------------------------------------


class Sink(Protocol):
    """Where records go. `write` takes a whole record: a sink that runs full keeps whole records only."""

    def write(self, record: str) -> None: ...
    def finish(self, tail: Callable[[int], str]) -> None: ...


class Writer(Protocol):
    """A trajectory being written, a frame at a time. `close` ends it properly, whatever ended the run."""

    def write(self, result: Result) -> None: ...
    def close(self, footer: Footer) -> None: ...


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


# a1 to a4 to 5 decimals: of a box of 1,000 pixels that is a hundredth of one
_FIVE, _FOUR, _THREE = fixed(5), fixed(4), fixed(3)


_AFFINE: tuple[Callable[[Any], str], ...] = (_FIVE, _FIVE, _FIVE, _FIVE, _THREE, _THREE)


NUMBERS = ("entropy", "scale", "noise", "error")


KEYS = frozenset(("posterior", "affine", *NUMBERS))


_key = lru_cache(4096)(dumps)  # the names of a gallery come again in every frame


def members(told: Told) -> list[str]:
    """`"key":value` of what is known: posterior, entropy, scale, noise, error, affine, in this order.

    What is not finite is left out: of the posterior a name, of the affine map all of it.
    """
    found = []
    if told.posterior is not None:
        found.append(f'"posterior":{_object(told.posterior)}')
    found += [f'"{name}":{text}' for name in NUMBERS if (text := _FOUR(getattr(told, name)))]
    if told.affine is not None:
        numbers = [form(value) for form, value in zip(_AFFINE, told.affine, strict=True)]
        if all(numbers):
            found.append(f'"affine":[{",".join(numbers)}]')
    return found


def _object(posterior: Mapping[str, float]) -> str:
    return "{" + ",".join([f"{_key(name)}:{text}" for name, p in posterior.items() if (text := _FOUR(p))]) + "}"
