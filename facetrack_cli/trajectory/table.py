"""A trajectory or truth file as arrays: what evaluation, plots and exports compute with.

    table = read_trajectory(Path("out/trajectory.csv"))
    nose = table.find("face", "nose")
    nose.frame, nose.x, nose.y       # (T,) each

Axes: T rows of one part, in the order of their frames. A number that is not known is nan, a text "".
"""

from __future__ import annotations

import csv
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Array, Mask, Texts, Whole
from facetrack_cli.trajectory.csv_reader import read_csv
from facetrack_cli.trajectory.diagnostics import ToldSeries, from_columns, from_records
from facetrack_cli.trajectory.json_reader import read_records
from facetrack_cli.trajectory.limits import check_columns, refuse_pipe
from facetrack_cli.trajectory.row import REQUIRED, Row


@dataclass(frozen=True, eq=False)
class Series:
    """One part of one target over time; every array is (T,), frames strictly increasing.

    (x, y) is the centre and (w, h) the size in pixels, `angle` in degrees, `confidence` 0..1, `std_*` in pixels.
    `status` is init, tracked, lost, absent in a trajectory; visible, hidden, absent in truth; "" where nothing is said.
    `by_hand` marks rows that a correction gave, of which a CSV says nothing. `corners` (T, 4, 2) are there only where a
    file gives rotated boxes or polygons of four corners.
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
    by_hand: Mask
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

    @property
    def corrected(self) -> Mask:
        """(T,) rows that corrections gave; a CSV shows them as `init` after the first row, or where `absent` begins."""
        absent = self.status == "absent"
        shown = (self.status == "init") | (absent & ~np.concatenate([absent[:1], absent[:-1]]))
        found: Mask = self.by_hand | (shown & (np.arange(len(self)) > 0))
        return found

    def take(self, rows: Whole | Mask) -> Series:
        """These rows alone."""
        arrays: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self)}
        picked: dict[str, Any] = {key: v[rows] for key, v in arrays.items() if isinstance(v, np.ndarray)}
        return replace(self, **picked)


@dataclass(frozen=True, eq=False)
class Table:
    """All series of one file. `header` is what a JSON trajectory says of its run: source, recipe, seed, init.

    `told` is what a tracker that adapts says of its targets, for those of which it says anything.
    """

    path: Path
    series: tuple[Series, ...]
    header: Mapping[str, Any] = field(default_factory=dict)
    told: tuple[ToldSeries, ...] = ()

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
    corners, by_hand = columns.pop("corners", None), columns.pop("by_hand", None)
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
        by_hand=np.zeros(t, dtype=np.bool_) if by_hand is None else np.asarray(by_hand, dtype=np.bool_)[order],
        corners=None if corners is None else np.asarray(corners, dtype=np.float64)[order],
        **known,
    )


_NOT_FLOAT = ("target", "part", "frame", "status", "by_hand", "corners")


_FLOATS = tuple(f.name for f in fields(Series) if f.name not in _NOT_FLOAT)


class _Columns(NamedTuple):
    """R rows of any parts, in any order: `names[which[r]]` is the (target, part) of row r."""

    names: Sequence[tuple[str, str]]
    which: Whole
    frame: Whole
    status: Texts
    identity: Texts
    identity_prob: Array
    by_hand: Mask
    floats: Mapping[str, Array]


def from_rows(path: Path, rows: Iterable[Row], header: Mapping[str, Any] | None = None) -> Table:
    """Rows in any order as a table; series in the order of their first rows.

    Raises InputError when there are no rows, or two of one frame, target and part.
    """
    columns = dict(zip(Row._fields, zip(*rows, strict=True), strict=False))
    if not columns:
        return _grouped(path, None, header)
    numbers: dict[tuple[str, str], int] = {}
    which = _numbered(numbers, columns["target"], columns["part"])
    floats = {name: np.array(columns[name], dtype=np.float64) for name in _FLOATS}  # None becomes nan
    frame = np.array(columns["frame"], dtype=np.int64)
    status, identity = (np.array(columns[name], dtype=np.str_) for name in ("status", "identity"))
    prob = np.array(columns["identity_prob"], dtype=np.float64)
    by_hand = np.array(columns["by_hand"], dtype=np.bool_)
    return _grouped(path, _Columns(list(numbers), which, frame, status, identity, prob, by_hand, floats), header)


def _numbered(numbers: dict[tuple[str, str], int], targets: Iterable[str], parts: Iterable[str]) -> Whole:
    """(R,) the number of each pair of names; new ones are added to `numbers`."""
    pairs = zip(targets, parts, strict=True)
    return np.array([numbers.setdefault(pair, len(numbers)) for pair in pairs], dtype=np.int64)


def _grouped(path: Path, columns: _Columns | None, header: Mapping[str, Any] | None) -> Table:
    if columns is None or not len(columns.which):
        raise InputError(f"{path}: has a header and no rows; there is nothing in it to measure")
    check_columns(
        path, columns.floats, lambda row: f"frame {columns.frame[row]}, {'/'.join(columns.names[columns.which[row]])}"
    )
    found = []
    counts = np.bincount(columns.which, minlength=len(columns.names))
    groups = np.split(np.argsort(columns.which, kind="stable"), np.cumsum(counts)[:-1])
    for (target, part), at in zip(columns.names, groups, strict=True):
        values = {name: column[at] for name, column in columns.floats.items()}
        one = series(target, part, columns.frame[at], status=columns.status[at], by_hand=columns.by_hand[at], **values)
        twice = np.flatnonzero(np.diff(one.frame) == 0)
        if twice.size:
            raise InputError(
                f"{path}: frame {one.frame[twice[0]]} has two rows of {one.name}; keep one row a frame, target and part"
            )
        found.append(one)
    targets = (columns.names[number][0] for number in columns.which)
    told = from_columns(path, targets, columns.frame, columns.identity, columns.identity_prob)
    return Table(path, tuple(found), header or {}, told)


def read_trajectory(path: Path) -> Table:
    """A trajectory or truth file of facetrack: CSV, JSON or JSON lines, told apart by how it begins.

    Raises InputError, with the line where there is one, for a file that is none of them.
    """
    path, first = _begins(path)
    # columns as a whole are quick; what they refuse is read once more row by row, to allow it or to say what is wrong
    if first != b"{":
        columns = _csv_columns(path)
        return from_rows(path, read_csv(path)) if columns is None else _grouped(path, columns, None)
    header, frames = read_records(path)
    told, columns = from_records(path, frames), _json_columns(frames)
    table = from_rows(path, _json_rows(path, frames), header) if columns is None else _grouped(path, columns, header)
    return replace(table, told=told)


def _inside(folder: Path) -> Iterator[Path]:
    return (folder / f"trajectory.{form}" for form in ("json", "csv", "jsonl"))


def _begins(path: Path) -> tuple[Path, bytes]:
    """The file, inside of `path` if that is a folder, and its first character."""
    try:
        if path.is_dir():
            path = next((inside for inside in _inside(path) if inside.is_file()), path)
        refuse_pipe(path)
        with path.open("rb") as file:
            return path, file.read(64).removeprefix(b"\xef\xbb\xbf").lstrip()[:1]
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder without a trajectory.csv or .json; name the file") from None
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e.strerror or e}; name a trajectory or truth file") from e


_BLOCK = 1_000  # lines or frames that become columns at a time: few enough to stay in the processor's cache


_Block: TypeAlias = dict[str, NDArray[Any]]  # the columns of `_Columns` by name


def _csv_columns(path: Path) -> _Columns | None:
    numbers: dict[tuple[str, str], int] = {}
    blocks: list[_Block] = []
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            lines = csv.reader(file)
            header = [name.strip() for name in next(lines, [])]
            if len(set(header)) < len(header) or not set(REQUIRED) <= set(header):
                return None
            while block := list(itertools.islice(lines, _BLOCK)):
                cells = dict(zip(header, zip(*block, strict=True), strict=True))
                blocks.append(_csv_block(cells, len(block), numbers))
    except (OSError, ValueError, csv.Error):
        return None
    return _joined(numbers, blocks)


def _csv_block(cells: Mapping[str, Sequence[str]], rows: int, numbers: dict[tuple[str, str], int]) -> _Block:
    blank = ("",) * rows
    targets, parts = ([name.strip() for name in cells[column]] for column in ("target", "part"))
    if any("" in column for column in (targets, parts, cells["frame"])):
        raise ValueError
    return {
        "which": _numbered(numbers, targets, parts),
        "frame": np.array(list(map(int, _digits(cells["frame"]))), dtype=np.int64),
        **{name: np.array(list(map(str.strip, cells.get(name, blank)))) for name in ("status", "identity")},
        "identity_prob": _floats(cells.get("identity_prob", blank)),
        "by_hand": np.zeros(rows, dtype=np.bool_),
        **{name: _floats(cells.get(name, blank)) for name in _FLOATS},
        "particles": _floats(_digits(cells.get("particles", blank))),
    }


def _joined(numbers: Mapping[tuple[str, str], int], blocks: Sequence[_Block]) -> _Columns | None:
    """The blocks end to end; None if there are none."""
    if not blocks:
        return None
    whole: dict[str, Any] = {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}
    own = {name: whole.pop(name) for name in _Columns._fields[1:-1]}
    return _Columns(list(numbers), **own, floats=whole)


def _floats(cells: Sequence[str]) -> Array:
    """(R,) with nan for empty cells; ValueError for what is no finite number."""
    values = np.array([float(cell) if cell else np.nan for cell in cells])
    if "_" in "".join(cells):  # float() takes 1_0 for 10
        raise ValueError
    if np.count_nonzero(np.isfinite(values)) != len(cells) - cells.count(""):
        raise ValueError
    return values


def _digits(cells: Sequence[str]) -> Sequence[str]:
    """The cells, if they are whole numbers of at most 18 digits or empty; else ValueError."""
    text = "".join(cells)
    if text and (not (text.isascii() and text.isdigit()) or max(map(len, cells)) > 18):
        raise ValueError
    return cells


def _json_columns(frames: list[Any]) -> _Columns | None:
    numbers: dict[tuple[str, str], int] = {}
    try:
        blocks = [_json_block(frames[i : i + _BLOCK], numbers) for i in range(0, len(frames), _BLOCK)]
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
        return None
    return _joined(numbers, blocks)


def _json_block(frames: list[Any], numbers: dict[tuple[str, str], int]) -> _Block:
    parts: list[dict[str, Any]] = []
    columns: dict[str, list[Any]] = {name: [] for name in ("frame", "time_s", "target", "particles")}
    for frame in frames:
        number, time_s = frame["frame"], frame.get("time_s")
        for target in frame["targets"]:
            those = target["parts"]
            parts += those
            for name, value in zip(columns, (number, time_s, target["target"], target.get("particles")), strict=True):
                columns[name] += [value] * len(those)
    if not _PART_KEYS.issuperset(itertools.chain.from_iterable(parts)):
        raise ValueError
    columns |= {name: [part.get(name) for part in parts] for name in _PART_KEYS}
    columns["status"] = [part.get("status", "") for part in parts]
    columns["by_hand"] = [part.get("by_hand", False) for part in parts]
    if not all(set(map(type, column)) <= _JSON_TYPES.get(name, _NUMBER) for name, column in columns.items()):
        raise ValueError
    if min(columns["frame"], default=0) < 0 or "" in columns["target"] or "" in columns["part"]:
        raise ValueError
    return {
        "which": _numbered(numbers, columns["target"], columns["part"]),
        "frame": np.array(columns["frame"], dtype=np.int64),
        "status": np.array(columns["status"], dtype=np.str_),
        "identity": np.full(len(parts), ""),  # of the targets: told.py reads it
        "identity_prob": np.full(len(parts), np.nan),
        "by_hand": np.array(columns["by_hand"], dtype=np.bool_),
        **{name: np.array(columns[name], dtype=np.float64) for name in _FLOATS},
    }


_PART_KEYS = frozenset(("part", "status", "by_hand", *_FLOATS)) - {"time_s", "particles"}


_NUMBER = frozenset((int, float, type(None)))


_JSON_TYPES: Mapping[str, frozenset[type]] = {
    "frame": frozenset((int,)),
    "by_hand": frozenset((bool,)),
    **dict.fromkeys(("target", "part", "status"), frozenset((str,))),
}


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
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as e:
            raise InputError(f"{path}: record {at} of frames is not as facetrack writes it: {e}") from None


def _check_row(row: Row) -> None:
    if not isinstance(row.frame, int) or isinstance(row.frame, bool) or not 0 <= row.frame < 10**18:
        raise ValueError(f"frame {row.frame!r} is no whole number from 0 up")
    for name in ("target", "part", "status", "identity"):
        value = getattr(row, name)
        if not isinstance(value, str) or (not value and name in ("target", "part")):
            raise ValueError(f"{name} {value!r} is no name")
    if not isinstance(row.by_hand, bool):
        raise ValueError(f"by_hand {row.by_hand!r} is neither true nor false")
    for name in (*_FLOATS, "identity_prob"):
        value = getattr(row, name)
        if value is not None and (isinstance(value, bool) or not isinstance(value, (int, float))):
            raise ValueError(f"{name} {value!r} is no number")
        float(value or 0)  # may be too large
