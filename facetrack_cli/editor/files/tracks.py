"""Rows of one target, tracked anew, in the very text in which they go into the files; kept in a temporary file.

A track is what follows from one beginning: the start, or a correction. It is never changed, so that undo has only to
take up the tracks of before.
"""

from __future__ import annotations

import contextlib
import tempfile
import threading
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import OutputError
from facetrack_cli.core.types import Correction, Frame, Result, Status, TargetResult
from facetrack_cli.editor.files.run_index import UNKNOWN, Offsets
from facetrack_cli.trajectory.row import Format, Header
from facetrack_cli.trajectory.writers import CsvWriter, JsonLinesWriter

_NUMBERS: dict[Status, int] = {"init": 0, "tracked": 1, "lost": 2, "absent": 3}


class Store:
    """Text that is only ever added to, outside of memory; may be read from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._size = 0
        try:
            self._file: BinaryIO = tempfile.TemporaryFile(prefix="facetrack-fix-")  # noqa: SIM115
        except OSError as e:
            raise OutputError(f"no file can be kept for a while: {e.strerror or e}; set TMPDIR to a folder") from e

    def add(self, data: bytes) -> int:
        """Where it stands from now on."""
        with self._lock:
            try:
                self._file.seek(self._size)
                self._file.write(data)
            except OSError as e:
                raise OutputError(
                    f"{tempfile.gettempdir()}: cannot be written: {e.strerror or e}; free some space, or set TMPDIR"
                ) from e
            at, self._size = self._size, self._size + len(data)
            return at

    def read(self, begin: int, end: int) -> bytes:
        with self._lock:
            self._file.seek(begin)
            return self._file.read(end - begin)

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._file.close()


@dataclass(frozen=True, eq=False)
class Track:
    """Rows of a target from frame `first` on, up to and not including `stop`, as they follow from `begin`.

    `begin` None is the start. Of n frames, the CSV of row i is the text `edges[i, 0]` to `edges[i, 1]` of the `store`,
    its object in JSON goes on to `edges[i, 2]`. Without a store they are the recorded ones. `confidence` and `status`
    (n, parts) are as in Index.
    """

    target: str
    begin: Correction | None
    first: int
    stop: int
    store: Store | None
    edges: Offsets
    confidence: NDArray[np.uint16]
    status: NDArray[np.uint8]

    def text(self, frame: int, form: Format) -> bytes:
        assert self.store is not None
        csv, json, end = self.edges[frame - self.first].tolist()
        return self.store.read(csv, json) if form == "csv" else self.store.read(json, end)


class Recorder:
    """Takes down a target's results, a frame at a time, and makes a track of them."""

    def __init__(self, store: Store, target: str, begin: Correction | None, first: int) -> None:
        self._store, self._target, self._begin, self._first = store, target, begin, first
        self._text = _Text()
        self._csv, self._json = CsvWriter(self._text, {}), JsonLinesWriter(self._text, _NO_HEADER)
        self._text.taken()
        self._edges = array("q")
        self._confidence = array("H")
        self._status = bytearray()

    def add(self, frame: Frame, result: TargetResult) -> None:
        alone = Result(frame, (result,))
        self._csv.write(alone)
        csv = self._text.taken()
        self._json.write(alone)
        line = self._text.taken()
        mark = b'"targets":['
        json = line[line.index(mark) + len(mark) : -len(b"]}\n")]
        at = self._store.add(csv + json)
        self._edges.extend((at, at + len(csv), at + len(csv) + len(json)))
        for part in result.parts:
            sure = part.confidence
            # rounded as it is written, and not as round() has it
            self._confidence.append(UNKNOWN if sure is None or sure != sure else round(float(f"{sure:.4f}") * 10000))
            self._status.append(_NUMBERS[part.status])

    def track(self) -> Track:
        n = len(self._edges) // 3
        return Track(
            self._target,
            self._begin,
            self._first,
            self._first + n,
            self._store,
            np.array(self._edges, np.int64).reshape(n, 3),
            np.array(self._confidence, np.uint16).reshape(n, -1),
            np.frombuffer(bytes(self._status), np.uint8).reshape(n, -1),
        )


_NO_HEADER: Header = {}


class _Text:
    """A sink that hands over what was written."""

    def __init__(self) -> None:
        self._parts: list[str] = []

    def write(self, record: str) -> None:
        self._parts.append(record)

    def finish(self, tail: object) -> None:
        raise AssertionError("records are taken, and never finished")

    def taken(self) -> bytes:
        data = "".join(self._parts).encode(errors="backslashreplace")
        self._parts.clear()
        return data


def pieces(tracks: list[Track], last: int) -> Iterator[tuple[int, int, Track]]:
    """(first, stop, track) of one target's tracks in the order of their beginnings: each up to the next."""
    for i, track in enumerate(tracks):
        stop = tracks[i + 1].first if i + 1 < len(tracks) else last + 1
        yield track.first, stop, track
