"""Where everything stands in the files of a run: offsets of bytes, and what the overview needs of the rows.

The text itself stays on the disk. Of each frame and target the place of its lines (CSV) or of its object (JSON, JSON
lines) is known, so that a few rows can be read, or replaced, and every other byte passed on as it is.

Axes: F frames, T targets, P parts, those of the first target first.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import InputError
from facetrack_cli.trajectory.row import Format

Span: TypeAlias = tuple[int, int]
Offsets: TypeAlias = NDArray[np.int64]
Parts: TypeAlias = Mapping[str, tuple[str, ...]]  # of each target

UNKNOWN: Final = 65535
"""Of a confidence that the tracker does not tell; others are in steps of 1/10000, as they are written."""
STATUS: Final = ("init", "tracked", "lost", "absent")


class Book:
    """One file of a run, open for reading at any place, from several threads.

    `edges` (F, T + 1): where each target's text begins in each frame, and in the last column where it would go on;
    between two targets stand `gap` bytes.
    """

    def __init__(self, path: Path, form: Format) -> None:
        self.path, self.form = path, form
        self.gap = 0 if form == "csv" else 1
        self.edges: Offsets = np.empty((0, 1), np.int64)
        self.head: dict[str, Span] = {}
        self.foot: dict[str, Span] = {}
        self._lock = threading.Lock()
        try:
            self._file: BinaryIO = path.open("rb")
        except OSError as e:
            raise InputError(f"{path}: cannot be read: {e.strerror or e}; make it readable") from e
        self._seen = _stamp(path)

    def read(self, begin: int, end: int) -> bytes:
        with self._lock:
            self._file.seek(begin)
            return self._file.read(end - begin)

    def text(self, row: int, target: int) -> bytes:
        """What stands of a target in the frame `row`, counted from the run's first."""
        begin, after = self.edges[row, target : target + 2].tolist()
        return self.read(begin, after - self.gap)

    @property
    def untouched(self) -> bool:
        """Whether the file at `path` is still the one that was opened."""
        return self._seen == _stamp(self.path)

    def lines(self) -> Iterator[bytes]:
        """All lines from the beginning, while nobody else reads."""
        self._file.seek(0)
        return iter(self._file.readline, b"")

    def close(self) -> None:
        self._file.close()


def _stamp(path: Path) -> tuple[int, int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns


@dataclass(frozen=True)
class Index:
    """All files of a run, which say the same. `main` is the JSON, or the JSON lines where there is none.

    `first` is the first frame, `header` and `footer` what stands around the rows; `confidence` (F, P) in steps of
    1/10000, or UNKNOWN; `status` (F, P) numbers of STATUS.
    """

    main: Book
    books: tuple[Book, ...]
    first: int
    parts: Parts
    header: Mapping[str, Any]
    footer: Mapping[str, Any]
    confidence: NDArray[np.uint16]
    status: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.status)

    @property
    def last(self) -> int:
        return self.first + len(self) - 1

    @property
    def targets(self) -> tuple[str, ...]:
        return tuple(self.parts)

    def columns(self, target: str) -> slice:
        """Where the parts of a target stand along P."""
        before = 0
        for name, parts in self.parts.items():
            if name == target:
                return slice(before, before + len(parts))
            before += len(parts)
        raise KeyError(target)

    def time_of(self, row: int) -> float | None:
        """The time of a frame in seconds, as the rows say."""
        begin = int(self.main.edges[row, 0])
        known = re.search(rb'"time_s":([-0-9.]+),"targets":\[$', self.main.read(max(begin - 60, 0), begin))
        return None if known is None else float(known[1])

    def close(self) -> None:
        for book in self.books:
            book.close()
