"""A trajectory or truth file as arrays: what evaluation, plots and exports compute with.

    table = read_trajectory(Path("out/trajectory.csv"))
    nose = table.find("face", "nose")
    nose.frame, nose.x, nose.y       # (T,) each

Axes: T rows of one part, in the order of their frames. A number that is not known is nan, a text "".
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.errors import InputError
from facetrack_cli.trajectory import SCHEMA, Row, read_csv
from facetrack_cli.types import Array

Whole: TypeAlias = NDArray[np.int64]
Mask: TypeAlias = NDArray[np.bool_]
Texts: TypeAlias = NDArray[np.str_]


@dataclass(frozen=True, eq=False)
class Series:
    """One part of one target over time; every array is (T,), frames strictly increasing.

    (x, y) is the centre and (w, h) the size in pixels, `angle` in degrees, `confidence` 0..1, `std_*` in pixels.
    `status` is init, tracked, lost in a trajectory; visible, hidden, absent in truth; "" where nothing is said.
    `corners` (T, 4, 2) are there only where a file gives rotated boxes or polygons of four corners.
    """

    target: str
    part: str
    frame: Whole
    time_s: Array
    x: Array
    y: Array
    w: Array
    h: Array
    angle: Array
    confidence: Array
    status: Texts
    std_x: Array
    std_y: Array
    particles: Array
    ess: Array
    corners: Array | None = None

    def __len__(self) -> int:
        return len(self.frame)

    @property
    def name(self) -> str:
        """`target/part`, as results name it."""
        return f"{self.target}/{self.part}"

    @property
    def boxes(self) -> Array:
        """(T, 4): left, top, width, height; a box over whole pixels has its centre at left + (w - 1) / 2."""
        return np.stack([self.x - (self.w - 1) / 2, self.y - (self.h - 1) / 2, self.w, self.h], axis=1)

    def take(self, rows: Whole | Mask) -> Series:
        """These rows alone."""
        arrays: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self)}
        picked: dict[str, Any] = {key: v[rows] for key, v in arrays.items() if isinstance(v, np.ndarray)}
        return replace(self, **picked)


@dataclass(frozen=True, eq=False)
class Table:
    """All series of one file. `header` is what a JSON trajectory says of its run: source, recipe, seed, init."""

    path: Path
    series: tuple[Series, ...]
    header: Mapping[str, Any] = field(default_factory=dict)

    @property
    def frames(self) -> Whole:
        """The frames that any series has a row for, increasing."""
        return np.unique(np.concatenate([s.frame for s in self.series]))

    @property
    def targets(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(s.target for s in self.series))

    def find(self, target: str, part: str) -> Series | None:
        return next((s for s in self.series if (s.target, s.part) == (target, part)), None)


def series(target: str, part: str, frame: Any, **columns: Any) -> Series:
    """A series from what is known of it; frames in any order, which must differ; columns left out are not known."""
    order = np.argsort(np.asarray(frame, dtype=np.int64), kind="stable")
    texts = columns.pop("status", None)
    corners = columns.pop("corners", None)
    t = len(order)

    def floats(name: str) -> Array:
        given = columns.pop(name, None)
        return np.full(t, np.nan) if given is None else np.asarray(given, dtype=np.float64)[order]

    known = {f.name: floats(f.name) for f in fields(Series) if f.name not in _NOT_FLOAT}
    if columns:
        raise TypeError(f"a series has no {', '.join(columns)}")
    return Series(
        target=target,
        part=part,
        frame=np.asarray(frame, dtype=np.int64)[order],
        status=np.full(t, "", dtype="<U8") if texts is None else np.asarray(texts, dtype=np.str_)[order],
        corners=None if corners is None else np.asarray(corners, dtype=np.float64)[order],
        **known,
    )


_NOT_FLOAT = ("target", "part", "frame", "status", "corners")
_FLOATS = tuple(f.name for f in fields(Series) if f.name not in _NOT_FLOAT)


def from_rows(path: Path, rows: Iterable[Row], header: Mapping[str, Any] | None = None) -> Table:
    """Rows in any order as a table; series in the order of their first rows.

    Raises InputError when there are no rows, or two of one frame, target and part.
    """
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.target, row.part), []).append(row)
    if not groups:
        raise InputError(f"{path}: has a header and no rows; there is nothing in it to measure")
    found = []
    for (target, part), members in groups.items():
        columns = dict(zip(Row._fields, zip(*members, strict=True), strict=True))
        values = {name: np.array(columns[name], dtype=np.float64) for name in _FLOATS}  # None becomes nan
        one = series(target, part, columns["frame"], status=columns["status"], **values)
        twice = np.flatnonzero(np.diff(one.frame) == 0)
        if twice.size:
            raise InputError(
                f"{path}: frame {one.frame[twice[0]]} has two rows of {one.name}; keep one row a frame, target and part"
            )
        found.append(one)
    return Table(path, tuple(found), header or {})


def read_trajectory(path: Path) -> Table:
    """A trajectory or truth file of facetrack: CSV, JSON or JSON lines, told apart by how it begins.

    Raises InputError, with the line where there is one, for a file that is none of them.
    """
    if path.is_dir() and (inside := next((p for p in _inside(path) if p.is_file()), None)):
        path = inside
    if _first_byte(path) != b"{":
        return from_rows(path, read_csv(path))
    header, frames = _read_json(path)
    return from_rows(path, _json_rows(path, frames), header)


def _inside(folder: Path) -> Iterator[Path]:
    return (folder / f"trajectory.{form}" for form in ("json", "csv", "jsonl"))


def _first_byte(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(64).removeprefix(b"\xef\xbb\xbf").lstrip()[:1]
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder without a trajectory.csv or .json; name the file") from None
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e.strerror or e}; name a trajectory or truth file") from e


def _read_json(path: Path) -> tuple[dict[str, Any], list[Any]]:
    """Header and frames of a JSON or JSON-lines trajectory."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as e:
        raise InputError(f"{path}: byte {e.start} is not UTF-8 text; a trajectory is UTF-8") from e
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e.strerror or e}") from e
    try:
        whole = json.loads(text)
    except RecursionError as e:
        raise InputError(f"{path}: is nested too deep for a trajectory") from e
    except json.JSONDecodeError as whole_error:
        whole, frames = {}, []
        for number, line in enumerate(text.splitlines(), 1):
            if not line.strip():
                continue
            try:
                record = json.loads(line)
            except (json.JSONDecodeError, RecursionError):
                # the first line of a JSON object is no record: then the error of the whole says more
                place = f"{whole_error.lineno}" if number == 1 else str(number)
                why = whole_error.msg if number == 1 else "is no whole record"
                raise InputError(f"{path}:{place}: is not JSON: {why}; was the run cut short?") from None
            kind = record.get("type") if isinstance(record, dict) else None
            if kind == "frame":
                frames.append(record)
            elif kind == "header":
                whole = record
        _check_schema(path, whole)
        return whole, frames
    if isinstance(whole, dict) and whole.get("type") == "header":  # JSON lines that end after their header
        whole["frames"] = []
    _check_schema(path, whole)
    frames = whole.pop("frames", None)
    if not isinstance(frames, list):
        raise InputError(f'{path}: has no list "frames"; it is no trajectory of facetrack')
    return whole, frames


def _check_schema(path: Path, header: Any) -> None:
    if not isinstance(header, dict) or header.get("schema") != SCHEMA:
        raise InputError(f'{path}: does not say "schema": "{SCHEMA}"; it is no trajectory of facetrack')


def _json_rows(path: Path, frames: list[Any]) -> Iterator[Row]:
    for at, frame in enumerate(frames):
        try:
            for target in frame["targets"]:
                shared = {key: target[key] for key in ("particles", "identity", "identity_prob") if key in target}
                for part in target["parts"]:
                    row = Row(
                        **{
                            **dict.fromkeys(("x", "y")),
                            **part,
                            **shared,
                            "frame": frame["frame"],
                            "time_s": frame.get("time_s"),
                            "target": target["target"],
                        }
                    )
                    _check_row(row)
                    yield row
        except (KeyError, TypeError, ValueError, AttributeError) as e:
            raise InputError(f"{path}: record {at} of frames is not as facetrack writes it: {e}") from None


def _check_row(row: Row) -> None:
    if not isinstance(row.frame, int) or isinstance(row.frame, bool) or row.frame < 0:
        raise ValueError(f"frame {row.frame!r} is no whole number from 0 up")
    for name in _FLOATS:
        value = getattr(row, name)
        if value is not None and (isinstance(value, bool) or not isinstance(value, (int, float))):
            raise ValueError(f"{name} {value!r} is no number")
