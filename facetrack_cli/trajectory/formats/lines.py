"""Text files of numbers without quotes, as the tracking benchmarks keep them: their lines, and errors in them.

Every reader of this folder builds on these: one message a fault, with the file, the line and the remedy.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.files import MAX_TABLE_BYTES, read_bounded
from facetrack_cli.core.types import Array, Whole
from facetrack_cli.trajectory.reader import MAX_FRAME, MAX_PIXELS
from facetrack_cli.trajectory.trajectory import Trajectory, build

FROM_ONE = np.array([1.0, 1.0, 0.0, 0.0])  # boxes (..., 4) that count pixels from 1, minus boxes that count from 0


def read_bytes(path: Path) -> bytes:
    """What is in a file. InputError if missing, a folder, a pipe, or larger than a table."""
    try:
        return read_bounded(path, MAX_TABLE_BYTES, "table of rows")
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; name the ground truth file in it") from None
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; name a ground truth file") from None
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e.strerror or e}; make it readable, or name another") from e


def read_text(path: Path) -> str:
    """The text of a file, with `\\n` after each line. InputError as of `read_bytes`, and if empty, or no text."""
    raw = read_bytes(path)
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise InputError(f"{path}: is UTF-16 text; save it as UTF-8")
    if b"\0" in raw[:8192]:
        raise InputError(f"{path}: is binary; name a ground truth file in UTF-8 text")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as e:
        line = raw.count(b"\n", 0, e.start) + 1
        raise InputError(f"{path}:{line}: is not UTF-8 text; save it as UTF-8, or name a ground truth file") from e
    if not text.strip():
        raise InputError(f"{path}: is empty; a ground truth file has a line a frame")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def delimiter(line: str) -> str | None:
    """What stands between the numbers: a comma where there is one, else tabs or blanks (None, as for str.split)."""
    return "," if "," in line else None


@dataclass(frozen=True)
class Lines:
    """T lines of the file `path`, without blanks at their ends, and their `places` in it, counted from 1."""

    path: Path
    texts: list[str]
    places: list[int]

    @classmethod
    def by_frame(cls, path: Path) -> Lines:
        """The lines of a file in which line i is frame i. A blank line is an error, but not at the end."""
        texts = [text.strip() for text in read_text(path).rstrip().split("\n")]
        found = cls(path, texts, list(range(1, len(texts) + 1)))
        found.refuse([not t for t in texts], "is blank, and each line is a frame; for none write nan,nan,nan,nan")
        return found

    @classmethod
    def with_frame(cls, path: Path) -> Lines:
        """The lines of a file in which each line names its frame, without blank lines."""
        return cls.numbered(path, read_text(path).split("\n"))

    @classmethod
    def numbered(cls, path: Path, texts: Sequence[str], first: int = 1) -> Lines:
        """These lines without the blank ones; `first` is the place of the first one in the file."""
        found = [(text.strip(), place) for place, text in enumerate(texts, first) if text.strip()]
        return cls(path, [text for text, _ in found], [place for _, place in found])

    def __len__(self) -> int:
        return len(self.texts)

    def take(self, rows: Any) -> Lines:
        """These rows: indices, a mask or a slice."""
        at = np.arange(len(self))[rows].tolist()
        return Lines(self.path, [self.texts[i] for i in at], [self.places[i] for i in at])

    def refuse(self, wrong: ArrayLike, why: str | Callable[[int], str]) -> None:
        """Raises InputError for the first line that is `wrong` (T,); `why` may depend on its index."""
        if (rows := np.flatnonzero(wrong)).size:
            message = why if isinstance(why, str) else why(int(rows[0]))
            raise InputError(f"{self.path}:{self.places[rows[0]]}: {message}")

    def numbers(self, columns: int, wanted: str, use: Sequence[int] | None = None) -> Array:
        """(T, columns or len(use)) numbers, nan for an empty cell. InputError with the line of what is not `wanted`."""
        use = use or range(columns)
        found: list[list[float]] = []
        for at, text in enumerate(self.texts):
            cells = text.split(delimiter(self.texts[0]))
            try:
                if len(cells) != columns or "_" in text:  # float() would take 1_0 for 10
                    raise ValueError
                found.append([float(cells[i]) for i in use])
            except ValueError:
                found.append(self._carefully(at, cells, columns, wanted, use))
        values = np.array(found, dtype=np.float64).reshape(len(found), -1)
        self.refuse(np.isinf(values).any(axis=1), "inf is no number to measure with; write nan if not known")
        return values

    def _carefully(self, at: int, cells: list[str], columns: int, wanted: str, use: Sequence[int]) -> list[float]:
        """The numbers of a line of which float() refused one: empty cells are nan, anything else is an error."""
        place, cells = f"{self.path}:{self.places[at]}", [cell.strip() for cell in cells]
        if wrong := [cell for cell in cells if len(cell.split()) > 1 or ";" in cell]:
            why = "write numbers with a point and one kind of comma, tab or blank between them"
            raise InputError(f"{place}: {wrong[0]!r} is no number; {why}, as in {wanted}")
        if len(cells) != columns:
            there = f"{len(cells)} value{'s' if len(cells) > 1 else ''}"
            raise InputError(f"{place}: {there} instead of {columns}; a line holds {wanted}")
        for cell in (cells[i] for i in use):
            try:
                float(cell.replace("_", "?") or "nan")
            except ValueError:
                raise InputError(f"{place}: {cell!r} is no number; a line holds {wanted}") from None
        return [float(cells[i] or "nan") for i in use]

    def whole(self, values: Array, name: str, least: int) -> Whole:
        """A column (T,) as whole numbers from `least` on."""
        with np.errstate(invalid="ignore"):
            fine = (values >= least) & (values <= MAX_FRAME) & (values == np.floor(values))
        self.refuse(~fine, lambda row: f"{name} {values[row]:.15g} is no whole number from {least} up; correct it")
        return values.astype(np.int64)

    def refuse_twice(self, keys: Whole, what: str) -> None:
        """Raises InputError if two rows of `keys` (T, C) are the same; `what` names the columns."""
        _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        earlier = first[inverse.reshape(-1)]
        why = f"the same {what} as in line {{}}; keep one of them"
        self.refuse(earlier != np.arange(len(keys)), lambda row: why.format(self.places[earlier[row]]))

    def boxes(self, frame: Whole, ltwh: Array, *, ids: Any = "", status: Any = "visible", **others: Any) -> Trajectory:
        """The boxes (T, 4) of these lines, left, top, width, height from 0; `ids` (T,) name the targets.

        A row of nan, or without width and height, is absent. `status` (T,) may say hidden or absent already; rows that
        it calls absent may hold any box, which is not kept. Raises InputError with the line for a box that is half nan,
        of a negative size, without area, or beyond any image.
        """
        said = np.broadcast_to(status, len(frame)).astype("<U8")
        unknown, empty = np.isnan(ltwh), ltwh[:, 2:] == 0
        absent = (said == "absent") | unknown.all(axis=1) | empty.all(axis=1)
        with np.errstate(invalid="ignore"):
            for wrong, why in (
                (unknown, "nan in a box that is known by half; give all four numbers, or four times nan"),
                (ltwh[:, 2:] < 0, "the box has a negative size; a box is left, top, width, height"),
                (empty, "the box has no area; four zeros say that there is none"),
                (np.abs(ltwh) > MAX_PIXELS, "the box is farther out than any image; correct it"),
            ):
                self.refuse(wrong.any(axis=1) & ~absent, why)
        left, top, w, h = np.where(absent[:, None], np.nan, ltwh).T
        place = {"x": left + (w - 1) / 2, "y": top + (h - 1) / 2, "w": w, "h": h}
        targets, which = np.unique(np.broadcast_to(ids, len(frame)), return_inverse=True)
        pairs = [(str(target), "box") for target in targets.tolist()]
        return build(pairs, which, frame, **place, status=np.where(absent, "absent", said), path=self.path, **others)
