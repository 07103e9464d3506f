"""Values as text; and spans, half-open intervals [begin, end) of rows, frames or places."""

import csv
import io
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from typing import Any, TypeVar

import numpy as np

from facetrack_cli.core import __version__
from facetrack_cli.core.types import Mask

_FORMULA = re.compile(r"\s*[-=+@]")
_Number = TypeVar("_Number", int, float)


def dumps(value: object) -> str:
    """A value as JSON on one line, in UTF-8."""
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def document(schema: str, fields: Mapping[str, object], indent: int | None = None) -> str:
    """A JSON file of version 1 of a schema."""
    whole = {"schema": schema, "version": 1, "facetrack": __version__, **fields}
    return json.dumps(whole, indent=indent, ensure_ascii=False, allow_nan=False) + "\n"


def csv_text(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table as CSV; a text that a spreadsheet would take for a formula is put behind an underscore."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([*map(_plain, row)] for row in chain([columns], rows))
    return text.getvalue()


def _plain(cell: Any) -> Any:
    if not isinstance(cell, str) or _FORMULA.match(cell) is None:
        return cell
    try:
        float(cell)
    except ValueError:
        return f"_{cell}"
    return cell


def clock(seconds: float) -> str:
    """Seconds as h:mm:ss.cc, without the hours if there are none; "-:--" for what is not finite."""
    if not math.isfinite(seconds):
        return "-:--"
    hundredths = round(abs(seconds) * 100)
    minutes, rest = divmod(hundredths, 6000)
    hours, minutes = divmod(minutes, 60)
    sign = "-" if seconds < 0 and hundredths else ""
    tail = f"{rest // 100:02d}.{rest % 100:02d}"
    return f"{sign}{hours}:{minutes:02d}:{tail}" if hours else f"{sign}{minutes}:{tail}"


def spans(mask: Mask, apart: Mask | None = None) -> list[tuple[int, int]]:
    """[begin, end) of each run of True in `mask` (T,); runs are also split where `apart` (T - 1,) is True."""
    joined = mask[:-1] & mask[1:]
    if apart is not None:
        joined &= ~apart
    begins = np.flatnonzero(mask & ~np.append(False, joined))
    ends = np.flatnonzero(mask & ~np.append(joined, False)) + 1
    return list(zip(begins.tolist(), ends.tolist(), strict=True))


def places(spans: Iterable[tuple[int, int]]) -> str:
    """Spans of frames, first and last, in words: `12 to 20, 31`."""
    return ", ".join(f"{a} to {b}" if b > a else str(a) for a, b in spans)


def union(intervals: Iterable[tuple[_Number, _Number]], gap: float = 0.0) -> list[tuple[_Number, _Number]]:
    """The spans, in order, joined where they overlap, touch, or are at most `gap` apart."""
    joined: list[tuple[_Number, _Number]] = []
    for begin, end in sorted(intervals):
        if joined and begin - joined[-1][1] <= gap:
            joined[-1] = joined[-1][0], max(joined[-1][1], end)
        else:
            joined.append((begin, end))
    return joined
