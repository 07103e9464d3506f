"""The rows of a run as they are now: the recorded ones, and over them what was tracked anew."""

from __future__ import annotations

import json
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.numbers import dumps
from facetrack_cli.editor.files.run_index import STATUS, Book, Index
from facetrack_cli.editor.files.tracks import Track, pieces

_BLOCK = 1 << 20


@dataclass(frozen=True, eq=False)
class Rows:
    """Never changed. `tracks`: of each target, those that it is made of, by their first frames."""

    index: Index
    tracks: Mapping[str, Sequence[Track]]

    @cached_property
    def _firsts(self) -> dict[str, list[int]]:
        return {name: [track.first for track in tracks] for name, tracks in self.tracks.items()}

    def track_at(self, target: str, frame: int) -> Track:
        """The track that this frame's rows are of."""
        return self.tracks[target][bisect_right(self._firsts[target], frame) - 1]

    def target(self, frame: int, name: str) -> dict[str, Any]:
        """A target's object of this frame."""
        track = self.track_at(name, frame)
        if track.store is not None:
            text = track.text(frame, "json")
        else:
            text = self.index.main.text(frame - self.index.first, self.index.targets.index(name))
        found: dict[str, Any] = json.loads(text)
        return found

    def targets(self, frame: int) -> list[dict[str, Any]]:
        """The objects of all targets in one frame."""
        return [self.target(frame, name) for name in self.index.targets]

    @cached_property
    def status(self) -> NDArray[np.uint8]:
        """(F, P) numbers of STATUS."""
        found = self.index.status.copy()
        for first, stop, track in self._written():
            found[first - self.index.first : stop - self.index.first, self.index.columns(track.target)] = track.status[
                : stop - first
            ]
        return found

    @cached_property
    def confidence(self) -> NDArray[np.uint16]:
        """(F, P) in steps of 1/10000, or UNKNOWN."""
        found = self.index.confidence.copy()
        for first, stop, track in self._written():
            rows = slice(first - self.index.first, stop - self.index.first)
            found[rows, self.index.columns(track.target)] = track.confidence[: stop - first]
        return found

    def lost_frames(self) -> dict[str, int]:
        """How often each part is lost, in the order in which they first are, as a run counts them."""
        lost = self.status == STATUS.index("lost")
        names = [f"{target}/{part}" for target, parts in self.index.parts.items() for part in parts]
        counts = lost.sum(axis=0).tolist()
        order = np.argsort(lost.argmax(axis=0), kind="stable").tolist()
        return {names[column]: counts[column] for column in order if counts[column]}

    def write(self, book: Book, to: BinaryIO, init: Mapping[str, Any]) -> None:
        """One of the run's files as it is to be now: `init` in its header, every byte beside these rows as it was."""
        at = 0
        for begin, end, text in self._replaced(book, init):
            _copy(book, at, begin, to)
            to.write(text)
            at = end
        _copy(book, at, None, to)

    def _replaced(self, book: Book, init: Mapping[str, Any]) -> Iterator[tuple[int, int, bytes]]:
        """(begin, end, text) of what stands in a file and what is to stand there, in the file's order."""
        if book.form != "csv":
            yield (*book.head["init"], dumps(init).encode(errors="backslashreplace"))
        written = list(self._written())
        edges = sorted({edge for first, stop, _ in written for edge in (first, stop)})
        columns = {name: number for number, name in enumerate(self.index.targets)}
        for first, stop in pairwise(edges):
            # of the same tracks in every frame, in the order of the targets
            those = sorted((columns[t.target], t) for f, s, t in written if f <= first and stop <= s)
            for frame in range(first, stop) if those else ():
                for column, track in those:
                    begin, after = book.edges[frame - self.index.first, column : column + 2].tolist()
                    yield begin, after - book.gap, track.text(frame, book.form)
        if book.form != "csv":
            yield (*book.foot["lost_frames"], dumps(self.lost_frames()).encode(errors="backslashreplace"))

    def _written(self) -> Iterator[tuple[int, int, Track]]:
        """(first, stop, track) of what was tracked anew."""
        for tracks in self.tracks.values():
            yield from (piece for piece in pieces(list(tracks), self.index.last) if piece[2].store is not None)


def recorded(index: Index, begins: Mapping[str, Sequence[Any]]) -> dict[str, list[Track]]:
    """The tracks that a run has of itself; `begins` of each target: None, and its corrections in their order."""
    none = np.empty((0, 3), np.int64)
    found: dict[str, list[Track]] = {}
    for target in index.targets:
        columns = index.columns(target)
        firsts = [index.first if begin is None else begin.frame for begin in begins[target]]
        found[target] = [
            Track(
                target,
                begin,
                first,
                stop,
                None,
                none,
                index.confidence[first - index.first : stop - index.first, columns],
                index.status[first - index.first : stop - index.first, columns],
            )
            for begin, first, stop in zip(begins[target], firsts, [*firsts[1:], index.last + 1], strict=True)
        ]
    return found


def _copy(book: Book, begin: int, end: int | None, to: BinaryIO) -> None:
    while end is None or begin < end:
        data = book.read(begin, begin + _BLOCK if end is None else min(end, begin + _BLOCK))
        if not data:
            return
        to.write(data)
        begin += len(data)
