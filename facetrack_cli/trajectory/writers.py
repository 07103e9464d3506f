"""Writing trajectories a frame at a time, with flat memory: CSV, JSON and JSON lines.

The CSV holds what was measured and nothing of when or where, so the same numbers give the same bytes. JSON holds the
same rows, grouped by frame, with the diagnostics of each target, between a header (source, recipe, seed, init) and a
footer (how the run ended). JSON lines are the header, a line a frame, and the footer, each with its `type`.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from itertools import groupby, islice
from typing import Any, Literal, TypeAlias

import numpy as np

from facetrack_cli.core import __version__
from facetrack_cli.core.files import BytesSink
from facetrack_cli.core.numbers import dumps
from facetrack_cli.core.types import Array
from facetrack_cli.trajectory.diagnostics import EVIDENCE, KNOWN, Diagnostics
from facetrack_cli.trajectory.trajectory import COLUMNS, DECIMALS, SPREAD, Trajectory

SCHEMA = "facetrack-trajectory"
VERSION = 1
Format: TypeAlias = Literal["csv", "json", "jsonl"]
FORMATS: tuple[Format, ...] = ("csv", "json", "jsonl")
Header: TypeAlias = Mapping[str, Any]  # JSON-ready: source, recipe, seed, init
# what JSON says of a target, and of a part, in the order of its keys
OF_TARGET = ("target", "particles", "identity", "identity_prob")
OF_PART = ("part", "x", "y", "w", "h", "angle", "confidence", "status", "by_hand", *SPREAD, "ess")


@dataclass
class RunSummary:
    """How a run ended, or how far it is: the one record of it, in tables, in run.json, in checkpoints, and in memory.

    `complete`: all frames that were asked for are there. `lost_frames` counts the lost frames of each "target/part";
    `lost_at_end` are the parts that are lost in the last frame. `evidence`: log p(Y) of each target's frames after the
    first, in nats. `source_sha256`: of the clip, or "".
    """

    frames: int = 0
    complete: bool = True
    stopped: str | None = None
    warnings: tuple[str, ...] = ()
    lost_frames: dict[str, int] = field(default_factory=dict)
    lost_at_end: tuple[str, ...] = ()
    variable_fps: bool | None = None
    evidence: dict[str, float] = field(default_factory=dict)
    source_sha256: str = ""

    def count(self, rows: Trajectory) -> None:
        """Take in the rows of some more frames."""
        if not len(rows):  # of a film a frame may show nobody
            self.frames, self.lost_at_end = self.frames + 1, ()
            return
        frame, which = rows.frame.tolist(), rows.which.tolist()
        self.frames, last = self.frames + len(set(frame)), max(frame)
        lost = [(frame[i], which[i]) for i, status in enumerate(rows.status.tolist()) if status == "lost"]
        named = [(at, "/".join(rows.names[i])) for at, i in sorted(lost)]
        for _, name in named:
            self.lost_frames[name] = self.lost_frames.get(name, 0) + 1
        self.lost_at_end = tuple(name for at, name in named if at == last)
        for target, reported in rows.diagnostics.items():
            if nats := [nat for nat in reported.get(EVIDENCE.name).tolist() if math.isfinite(nat)]:
                self.evidence[target] = self.evidence.get(target, 0.0) + math.fsum(nats)


FOOTER = ("complete", "stopped", "variable_fps", "lost_frames", "warnings", "evidence", "source_sha256")


def summary_of(rows: Trajectory, **ended: Any) -> RunSummary:
    """The summary of a run with these rows."""
    summary = RunSummary(**ended)
    summary.count(rows)
    return summary


class Writer:
    """A trajectory being written in a `form`, some frames at a time. `close` ends it properly, whatever ended the run.

    csv has a header line, then a row for each frame, target and part. json is one object, whose frames stand in a list,
    one to a line, so that neither writing nor `grep` holds them all. jsonl is for programs that read meanwhile.
    """

    def __init__(self, form: Format, sink: BytesSink, header: Header, *, resumed: bool = False) -> None:
        """`resumed`: the sink holds the header and some frames already."""
        self._form, self._sink, self._between = form, sink, ",\n" * resumed
        if resumed:
            return
        head = {"schema": SCHEMA, "version": VERSION, "facetrack": __version__, **header}
        if form == "csv":
            sink.write(",".join(COLUMNS) + "\n")
        elif form == "json":
            sink.write("{\n" + "".join(f"{member},\n" for member in _members(head)) + '"frames": [\n')
        else:
            sink.write(dumps({"type": "header", **head}) + "\n")

    def write(self, rows: Trajectory) -> None:
        for frame in csv_frames(rows) if self._form == "csv" else json_frames(rows):
            record = frame if self._form == "csv" else '{"type":"frame",' + frame + "}\n"
            if self._form == "json":
                # the comma goes with the record that follows it: a file cut back to whole records still closes
                record, self._between = self._between + "{" + frame + "}", ",\n"
            self._sink.write(record)

    def close(self, summary: RunSummary) -> None:
        self._sink.finish(lambda records: tail(self._form, summary, records - 1))


def tail(form: Format, summary: RunSummary, frames: int) -> str:
    """How a file of so many frames ends."""
    evidence = {name: round(nats, 4) for name, nats in summary.evidence.items()}
    whole = {"frames_tracked": frames, **vars(summary), "evidence": evidence}
    names = ("complete", "stopped", "frames_tracked", *FOOTER[2:])
    foot = {name: whole[name] for name in names if whole[name] or name not in ("stopped", "source_sha256")}
    if form == "json":
        return "\n],\n" + ",\n".join(_members(foot)) + "\n}\n"
    return "" if form == "csv" else dumps({"type": "footer", **foot}) + "\n"


WRITERS: Mapping[Format, Callable[..., Writer]] = {form: partial(Writer, form) for form in FORMATS}


def _members(values: Mapping[str, Any]) -> list[str]:
    return [f"{dumps(key)}: {dumps(value)}" for key, value in values.items()]


def csv_frames(rows: Trajectory) -> Iterator[str]:
    """The lines of each frame, without the header."""
    for _, lines in _frames(rows, COLUMNS):
        yield "".join([",".join(line) + "\n" for _, line in lines])


def json_frames(rows: Trajectory) -> Iterator[str]:
    """The members of each frame's object; numbers have the digits of the CSV."""
    for frame, cells in _frames(rows, (*OF_TARGET, *OF_PART, "time_s"), named=True):
        targets = []
        for target, group in groupby(cells, key=lambda row: rows.names[row[0]][0]):
            lines = [line for _, line in group]
            head = list(filter(None, lines[0][: len(OF_TARGET)]))
            if target in rows.diagnostics:
                head += _reported(rows.diagnostics[target], frame)
            parts = ["{" + ",".join(filter(None, line[len(OF_TARGET) : -1])) + "}" for line in lines]
            targets.append("{" + ",".join(head) + ',"parts":[' + ",".join(parts) + "]}")
        time_s = cells[0][1][-1] or '"time_s":null'
        yield f'"frame":{frame},{time_s},"targets":[{",".join(targets)}]'


def as_written(rows: Trajectory) -> Trajectory:
    """The rows with the numbers that a file of them holds."""

    def rounded(values: Array, decimals: int | tuple[int, ...]) -> Array:
        if isinstance(decimals, tuple):
            return np.stack([rounded(*each) for each in zip(values.T, decimals, strict=True)], axis=1)
        texts = _numbers(f".{decimals}f")(values.ravel().tolist())
        return np.array([float(text or "nan") for text in texts]).reshape(values.shape)

    columns: dict[str, Any] = {name: rounded(getattr(rows, name), decimals) for name, decimals in DECIMALS.items()}
    diagnostics = {}
    for target, told in rows.diagnostics.items():
        values = {d.name: rounded(told.values[d.name], d.decimals) for d in told.declared if d.name in told.values}
        diagnostics[target] = replace(told, values=values)
    return replace(rows, **columns, corners=None, diagnostics=diagnostics)


def by_frame(rows: Trajectory) -> Iterator[tuple[int, list[int]]]:
    """Each frame and the indices of its rows, by part."""
    order = np.lexsort((rows.which, rows.frame))
    for frame, at in groupby(order.tolist(), key=rows.frame.tolist().__getitem__):
        yield frame, list(at)


_Row: TypeAlias = tuple[int, tuple[str, ...]]  # the index of its names, and its columns as text, "" if not known


def _frames(rows: Trajectory, columns: tuple[str, ...], *, named: bool = False) -> Iterator[tuple[int, list[_Row]]]:
    """Each frame with its rows by part."""
    if len(rows) and (rows.frame == rows.frame[0]).all():  # as a run writes them; no order is looked for
        yield int(rows.frame[0]), _lines(rows, columns, named)
        return
    frames = by_frame(rows)
    while block := list(islice(frames, _BLOCK)):
        some = rows.take(np.array([i for _, at in block for i in at], np.int64))
        lines = iter(_lines(some, columns, named))
        yield from ((frame, list(islice(lines, len(at)))) for frame, at in block)


def _lines(rows: Trajectory, columns: tuple[str, ...], named: bool) -> list[_Row]:
    """Each row, `named` as members of JSON."""
    digits, texts, which = _digits(rows), [], rows.which.tolist()
    quoted = _key if named else _quoted
    for name in columns:
        if (text := digits.get(name)) is None:
            own = name in ("target", "part")
            values = [rows.names[i][name == "part"] for i in which] if own else getattr(rows, name).tolist()
            text = [quoted(value) if value else "" for value in values]
        texts.append([f'"{name}":{value}' if value else "" for value in text] if named else text)
    return list(zip(which, zip(*texts, strict=True), strict=True))


@lru_cache(1)  # of the rows of one frame CSV and JSON ask, one after the other
def _digits(rows: Trajectory) -> dict[str, list[str]]:
    """The columns of numbers as text."""
    return {name: _numbers(spec)(getattr(rows, name).tolist()) for name, spec in _SPECS.items()}


def _reported(reported: Diagnostics, frame: int) -> list[str]:
    """`"name":value` of the diagnostics of one frame: those of some names, then numbers, then lists; known ones first.

    What is not finite is left out: of several names one, of a list all of it.
    """
    at = reported.row(frame)
    members = []
    ranks = {name: rank for rank, name in enumerate(KNOWN)}
    declared = [item for item in reported.declared if at is not None and item.name in reported.values]
    for item in sorted(declared, key=lambda d: (d.shape is not None, bool(d.shape), ranks.get(d.name, len(ranks)))):
        value = reported.values[item.name][at].tolist()
        numbers = [value] if item.shape == () else value
        decimals = item.decimals if isinstance(item.decimals, tuple) else (item.decimals,) * len(numbers)
        texts = [_numbers(f".{d}f")([number])[0] for d, number in zip(decimals, numbers, strict=True)]
        if item.shape is None:
            labels = reported.labels[item.name]
            texts = [f"{_key(name)}:{text}" for name, text in zip(labels, texts, strict=True) if text]
        if texts and all(texts):
            brackets = "{}" if item.shape is None else "[]" if item.shape else ""
            members.append(f"{_key(item.name)}:{brackets[:1]}{','.join(texts)}{brackets[1:]}")
    return members


@lru_cache
def _numbers(spec: str) -> Callable[[list[Any]], list[str]]:
    """Writes numbers, all at once; "" for what is not finite, and never -0."""
    whole, odd = f"%{spec}\n", {"nan": "", "inf": "", "-inf": "", format(-0.0, spec): format(0.0, spec)}
    return lambda values: [odd.get(text, text) for text in (whole * len(values) % tuple(values)).split("\n")[:-1]]


@lru_cache(4096)
def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""') + '"' if any(c in text for c in ',"\r\n') else text


_key = lru_cache(4096)(dumps)  # the names of a gallery come again in every frame
_SPECS = {"frame": ".0f", "particles": ".0f", **{name: f".{decimals}f" for name, decimals in DECIMALS.items()}}
_BLOCK = 1_000  # frames that become text at a time
