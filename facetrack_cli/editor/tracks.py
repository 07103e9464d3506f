"""What a run is made of: for each target the rows that follow from each beginning, the start or a correction."""

from __future__ import annotations

import contextlib
import pickle
import tempfile
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from facetrack_cli.core.errors import OutputError
from facetrack_cli.core.types import Correction
from facetrack_cli.trajectory.select import choose
from facetrack_cli.trajectory.trajectory import Trajectory, successive

Place: TypeAlias = tuple[int, int]  # the first byte, and how many


class Store:
    """Rows in a temporary file, so that undo over many corrections takes no memory. Serves several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._end = 0
        try:
            # without a buffer: what does not fit is forgotten
            self._file: Any = tempfile.TemporaryFile(prefix="facetrack-fix-", buffering=0)  # noqa: SIM115
        except OSError as e:
            raise OutputError(f"no temporary file can be made: {e.strerror or e}; set TMPDIR to a folder") from e

    def add(self, rows: Trajectory) -> Place:
        """Where they stand from now on."""
        data = pickle.dumps(rows)
        with self._lock:
            at, written = self._end, 0
            try:
                self._file.seek(at)
                while written < len(data):
                    written += self._file.write(data[written:])
            except OSError as e:
                raise OutputError(
                    f"{tempfile.gettempdir()}: cannot be written: {e.strerror or e}; free some space, or set TMPDIR"
                ) from e
            self._end += len(data)
            return at, len(data)

    def read(self, place: Place) -> Trajectory:
        with self._lock:
            self._file.seek(place[0])
            data = self._file.read(place[1])
        found: Trajectory = pickle.loads(data)
        return found

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._file.close()


@dataclass(frozen=True)
class Track:
    """Rows of a target from frame `first` up to before `stop`, as they follow from `begin`; None is the start.

    `at` is where they stand in the store; None: they are the run's recorded ones.
    """

    target: str
    begin: Correction | None
    first: int
    stop: int
    at: Place | None = None

    def rows(self, recorded: Trajectory, store: Store, stop: int | None = None) -> Trajectory:
        """The rows up to before `stop`, of a run that recorded these."""
        whole = recorded if self.at is None else store.read(self.at)
        some = whole.between(self.first, self.stop if stop is None else stop)
        return choose(some, self.target) if self.at is None else some


def spliced(recorded: Trajectory, tracks: Mapping[str, Sequence[Track]], store: Store) -> Trajectory:
    """The rows of a run: of each target its tracks, by their first frames, each up to the next."""
    if all(track.at is None for those in tracks.values() for track in those):
        return recorded
    pieces = []
    for those in tracks.values():
        stops = [*(track.first for track in those[1:]), those[-1].stop]
        for track, stop in zip(those, stops, strict=True):
            pieces.append(track.rows(recorded, store, stop))
    return successive(pieces, recorded)
