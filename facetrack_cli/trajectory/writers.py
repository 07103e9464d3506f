"""Writing trajectories a frame at a time, with flat memory: CSV, JSON and JSON lines.

The CSV holds what was measured and nothing of when or where, so the same numbers give the same bytes. JSON holds the
same rows, grouped by frame, with the diagnostics of each target, between a header (source, recipe, seed, init) and a
footer (how the run ended). JSON lines are the header, a line a frame, and the footer, each with its `type`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from itertools import groupby, islice
from typing import Any, Literal, NamedTuple, Protocol, TypeAlias

import numpy as np

from facetrack_cli import __version__
from facetrack_cli.core.numbers import dumps, fixed
from facetrack_cli.core.types import Array
from facetrack_cli.trajectory.diagnostics import KNOWN, Diagnostic, Diagnostics
from facetrack_cli.trajectory.trajectory import COLUMNS, DECIMALS, Trajectory, by_frame

SCHEMA = "facetrack-trajectory"
VERSION = 1
Format: TypeAlias = Literal["csv", "json", "jsonl"]
FORMATS: tuple[Format, ...] = ("csv", "json", "jsonl")
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


class Sink(Protocol):
    """Where records go. `write` takes a whole record: a sink that runs full keeps whole records only."""

    def write(self, record: str) -> None: ...
    def finish(self, tail: Callable[[int], str]) -> None: ...


class Writer(Protocol):
    """A trajectory being written, some frames at a time. `close` ends it properly, whatever ended the run."""

    def write(self, rows: Trajectory) -> None: ...
    def close(self, footer: Footer) -> None: ...


class CsvWriter:
    """Header line, then a row for each frame, target and part."""

    def __init__(self, sink: Sink, header: Header) -> None:
        self._sink = sink
        sink.write(",".join(COLUMNS) + "\n")

    def write(self, rows: Trajectory) -> None:
        for lines in csv_frames(rows):
            self._sink.write(lines)

    def close(self, footer: Footer) -> None:
        self._sink.finish(lambda _: "")


class JsonWriter:
    """One object; the frames stand in a list, one to a line, so that neither writing nor `grep` holds them all."""

    def __init__(self, sink: Sink, header: Header) -> None:
        self._sink = sink
        self._between = ""
        head = "".join(f"{dumps(key)}: {dumps(value)},\n" for key, value in _head(header).items())
        sink.write("{\n" + head + '"frames": [\n')

    def write(self, rows: Trajectory) -> None:
        for frame in json_frames(rows):
            # the comma goes with the record that follows it: a file cut back to whole records still closes
            self._sink.write(self._between + "{" + frame + "}")
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

    def write(self, rows: Trajectory) -> None:
        for frame in json_frames(rows):
            self._sink.write('{"type":"frame",' + frame + "}\n")

    def close(self, footer: Footer) -> None:
        self._sink.finish(lambda records: dumps({"type": "footer", **_foot(footer, records - 1)}) + "\n")


WRITERS: Mapping[Format, Callable[[Sink, Header], Writer]] = {
    "csv": CsvWriter,
    "json": JsonWriter,
    "jsonl": JsonLinesWriter,
}


def _head(header: Header) -> dict[str, Any]:
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


# --- rows as text ------------------------------------------------------------------------------------------------


def csv_frames(rows: Trajectory) -> Iterator[str]:
    """The lines of each frame, without the header."""
    for _, _, cells in _frames(rows, _CSV):
        yield "".join([",".join(line) + "\n" for line in cells])


def json_frames(rows: Trajectory) -> Iterator[str]:
    """The members of each frame's object; numbers have the digits of the CSV."""
    for frame, which, cells in _frames(rows, _JSON):
        targets = []
        for target, group in groupby(zip(which, cells, strict=True), key=lambda one: rows.names[one[0]][0]):
            known = [dict(zip(_JSON, line, strict=True)) for _, line in group]
            head = _members(known[0], _OF_TARGET)
            if target in rows.diagnostics:
                head += _reported(rows.diagnostics[target], frame)
            parts = ["{" + ",".join(_members(one, _OF_PART)) + "}" for one in known]
            targets.append("{" + ",".join(head) + ',"parts":[' + ",".join(parts) + "]}")
        time_s = cells[0][_TIME] or "null"
        yield f'"frame":{frame},"time_s":{time_s},"targets":[{",".join(targets)}]'


def as_written(rows: Trajectory) -> Trajectory:
    """The rows with the numbers that a file of them holds."""

    def rounded(values: Array, decimals: int) -> Array:
        texts = map(_form(decimals), values.ravel().tolist())
        return np.array([float(text) if text else np.nan for text in texts]).reshape(values.shape)

    def reported(found: Diagnostics) -> Diagnostics:
        values = {}
        for one in found.declared:
            if (value := found.values.get(one.name)) is not None:
                if isinstance(one.decimals, tuple):
                    values[one.name] = np.stack([rounded(value[:, i], d) for i, d in enumerate(one.decimals)], axis=1)
                else:
                    values[one.name] = rounded(value, one.decimals)
        return replace(found, values=values)

    columns: dict[str, Any] = {name: rounded(getattr(rows, name), decimals) for name, decimals in DECIMALS.items()}
    diagnostics = {target: reported(found) for target, found in rows.diagnostics.items()}
    return replace(rows, **columns, cov_xy=np.full(len(rows), np.nan), corners=None, diagnostics=diagnostics)


def _frames(
    rows: Trajectory, forms: Mapping[str, Callable[[Any], str]]
) -> Iterator[tuple[int, list[int], list[tuple[str, ...]]]]:
    """Each frame with its rows by part: the indices of their names, and their columns as text, "" if not known."""
    texts = {name: [forms[name](pair[at]) for pair in rows.names] for at, name in enumerate(_NAMES)}
    frames = by_frame(rows)
    while block := list(islice(frames, _BLOCK)):
        some = rows.take(np.array([i for _, at in block for i in at], np.int64))
        which = some.which.tolist()
        columns = []
        for name, form in forms.items():
            if name in _NAMES:
                columns.append([texts[name][i] for i in which])
            else:
                columns.append([form(value) for value in getattr(some, name).tolist()])
        lines, first = list(zip(*columns, strict=True)), 0
        for frame, at in block:
            rows_ = slice(first, first + len(at))
            yield frame, which[rows_], lines[rows_]
            first += len(at)


def _reported(found: Diagnostics, frame: int) -> list[str]:
    """`"name":value` of the diagnostics of one frame: those of some names, then numbers, then lists; known ones first.

    What is not finite is left out: of several names one, of a list all of it.
    """
    at = found.row(frame)
    members = []
    for one in sorted(found.declared, key=_rank):
        if at is None or one.name not in found.values:
            continue
        value = found.values[one.name][at].tolist()
        numbers = [value] if one.shape == () else value
        decimals = one.decimals if isinstance(one.decimals, tuple) else (one.decimals,) * len(numbers)
        texts = [_form(d)(number) for d, number in zip(decimals, numbers, strict=True)]
        if one.shape is None:
            known = [f"{_key(name)}:{text}" for name, text in zip(found.labels[one.name], texts, strict=True) if text]
            text = "{" + ",".join(known) + "}" if known else ""
        else:
            text = ",".join(texts) if all(texts) else ""
            text = f"[{text}]" if one.shape and text else text
        members += [f"{_key(one.name)}:{text}"] if text else []
    return members


def _rank(one: Diagnostic) -> tuple[bool, bool, int]:
    return one.shape is not None, bool(one.shape), _RANKS.get(one.name, len(_RANKS))


_RANKS = {name: at for at, name in enumerate(KNOWN)}
_form = lru_cache(fixed)
_key = lru_cache(4096)(dumps)  # the names of a gallery come again in every frame
_OF_TARGET = ("target", "particles", "identity", "identity_prob")
_OF_PART = ("part", "x", "y", "w", "h", "angle", "confidence", "status", "by_hand", "std_x", "std_y", "ess")


def _members(known: Mapping[str, str], names: Iterable[str]) -> list[str]:
    return [f'"{name}":{known[name]}' for name in names if known[name]]


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""') + '"' if any(c in text for c in ',"\r\n') else text


def _string(text: str) -> str:
    return dumps(text) if text else ""


_NUMBERS: Mapping[str, Callable[[Any], str]] = {
    "frame": str,
    "particles": fixed(0),
    **{name: fixed(decimals) for name, decimals in DECIMALS.items()},
}
_CSV: Mapping[str, Callable[[Any], str]] = {name: _NUMBERS.get(name, _quoted) for name in COLUMNS}
_JSON: Mapping[str, Callable[[Any], str]] = {
    **{name: _NUMBERS.get(name, _string) for name in COLUMNS},
    "by_hand": lambda value: "true" if value else "",
}
_TIME = COLUMNS.index("time_s")
_NAMES = ("target", "part")
_BLOCK = 1_000  # frames that become text at a time
