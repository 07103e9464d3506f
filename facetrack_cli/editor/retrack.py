"""Tracks targets again over a part of a run. The other targets stay as recorded."""

from __future__ import annotations

import contextlib
import math
import pickle
import tempfile
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, TypeAlias

import numpy as np

from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.numbers import union
from facetrack_cli.core.types import Correction, Frame
from facetrack_cli.engine.corrected import CorrectedTarget
from facetrack_cli.engine.loop import Footprint, Target, stream
from facetrack_cli.recipe.model import ParticlesRecipe
from facetrack_cli.run_folder.finished import Run
from facetrack_cli.runs.plan import Report, silent
from facetrack_cli.runs.signals import Stopped, StoppedError, never
from facetrack_cli.start.assembly import build_tracker, tracker_for
from facetrack_cli.start.presence import among_others
from facetrack_cli.trajectory.select import choose
from facetrack_cli.trajectory.trajectory import Collector, Trajectory, successive
from facetrack_cli.trajectory.writers import as_written

MAX_TIME_OFF_S: Final = 0.002  # a frame whose time differs more from the run's is of another clip
Read: TypeAlias = Callable[[int], Frame]
Place: TypeAlias = tuple[int, int]  # the first byte, and how many


class Store:
    """Rows in a temporary file: undo over many corrections takes no memory. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._end = 0
        try:
            self._file: Any = tempfile.TemporaryFile(prefix="facetrack-fix-", buffering=0)  # noqa: SIM115
        except OSError as e:
            raise OutputError(f"no temporary file can be made: {e.strerror or e}; set TMPDIR to a folder") from e

    def add(self, rows: Trajectory) -> Place:
        """Store the rows; their place in the file."""
        data = pickle.dumps(rows)
        with self._lock:
            at, written = self._end, 0
            try:
                self._file.seek(at)
                while written < len(data):
                    written += self._file.write(data[written:])
            except OSError as e:
                remedy = "free some space, or set TMPDIR"
                raise OutputError(f"{tempfile.gettempdir()}: cannot be written: {e.strerror or e}; {remedy}") from e
            self._end += len(data)
            return at, len(data)

    def read(self, place: Place) -> Trajectory:
        with self._lock:
            self._file.seek(place[0])
            found: Trajectory = pickle.loads(self._file.read(place[1]))
        return found

    def spliced(self, recorded: Trajectory, tracks: Mapping[str, Sequence[Track]]) -> Trajectory:
        """The rows of a run: of each target its tracks, by their first frames, each up to the next."""
        if all(track.at is None for those in tracks.values() for track in those):
            return recorded
        pieces = []
        for those in tracks.values():
            stops = [*(track.first for track in those[1:]), those[-1].stop]
            pieces += [track.rows(recorded, self, stop) for track, stop in zip(those, stops, strict=True)]
        return successive(pieces, recorded)

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._file.close()


@dataclass(frozen=True)
class Task:
    """One target to track from a beginning, None for the start, in the frames [first, stop)."""

    target: str
    begin: Correction | None
    first: int
    stop: int


@dataclass(frozen=True)
class Track(Task):
    """The rows of a task. `at` is their place in the store; None if they are the recorded rows of the run."""

    at: Place | None = None

    def rows(self, recorded: Trajectory, store: Store, stop: int | None = None) -> Trajectory:
        """The rows up to before `stop`, of a run that recorded these."""
        whole = recorded if self.at is None else store.read(self.at)
        some = whole.between(self.first, self.stop if stop is None else stop)
        return choose(some, self.target) if self.at is None else some


def frames_of(tasks: Iterable[Task]) -> list[tuple[int, int]]:
    """[first, stop) of the frames that any task needs, in order."""
    return union((task.first, task.stop) for task in tasks)


class Tracking:
    """Tracks tasks of a run, in the frames that `read` gives."""

    def __init__(self, run: Run, store: Store, read: Read) -> None:
        self._run, self._store, self._read = run, store, read
        self._alone = not (isinstance(run.recipe, ParticlesRecipe) and run.recipe.exclusion is not None)

    def check(self, correction: Correction) -> None:
        """InputError if a correction does not fit the clip or the recipe."""
        start = replace(self._run.start, corrections=(correction,))
        source = self._run.header.source
        tracker_for(self._run.recipe, start, source.size, source.fps)

    def track(
        self, tasks: Sequence[Task], rows: Trajectory, *, report: Report = silent, stop: Stopped = never
    ) -> list[Track]:
        """The tracks of tasks of different targets; with mutual exclusion, `rows` say where the others are. Raises
        StoppedError once `stop` says so, InputError if the clip is not the run's.
        """
        live = [_Live(self._run, task, self._start) for task in tasks]
        frames = frames_of(tasks)
        total = sum(end - first for first, end in frames)
        for done, index in enumerate((index for span in frames for index in range(*span)), 1):
            if stop():
                raise StoppedError
            frame = self._frame(index)
            now = [one for one in live if one.task.first <= index < one.task.stop]
            for one in sorted(now, key=lambda one: one.place):
                one.step(frame, [] if self._alone else self._footprints(one, now, rows, index))
            report(done, total)
        return [one.track(self._store) for one in live]

    @cached_property
    def _start(self) -> Frame:
        return self._read(self._run.start.frame)

    def _frame(self, index: int) -> Frame:
        frame = self._read(index)
        then = float(self._run.rows.parts[0].time_s[index - self._run.first])
        if abs(frame.time_s - then) > MAX_TIME_OFF_S:
            times = f"is at {frame.time_s:.4f} s, and in the run at {then:.4f} s"
            raise InputError(f"{self._run.clip}: frame {index} {times}; name the run's clip with --clip")
        return frame

    def _footprints(self, one: _Live, now: Sequence[_Live], rows: Trajectory, index: int) -> list[Footprint]:
        """What other targets explain, by state or row: those before it in this frame, those after it in the last."""
        found: list[Footprint | None] = []
        running = {other.task.target: other for other in now}
        for place, name in enumerate(self._run.rows.targets):
            ahead, other = place > one.place, running.get(name)
            if place == one.place:
                continue
            if other is not None and (other.begun or not ahead):
                there = other.target.footprint(other.state, ahead=ahead)
            else:
                there = recorded_footprint(rows, max(index - ahead, self._run.first), name)
            found.append(there and there._replace(target=name))
        return [one for one in found if one is not None]


def recorded_footprint(rows: Trajectory, frame: int, name: str) -> Footprint | None:
    """What a target explains by its row; None of points, and where it is absent."""
    parts = rows.of_target(name)
    at = parts[0].row(frame)
    assert at is not None
    x, y, w, h = (float(getattr(parts[0], key)[at]) for key in "xywh")
    return None if len(parts) > 1 or math.isnan(x) else Footprint(np.array([x, y]), np.array([w, h]) / 2)


class _Live:
    """A target that is being tracked."""

    def __init__(self, run: Run, task: Task, first: Frame) -> None:
        self.task, self.place = task, run.rows.targets.index(task.target)
        corrections = () if task.begin is None else (task.begin,)
        begin, fps = replace(run.start, corrections=corrections), run.header.source.fps
        self.target: Target = build_tracker(run.recipe, begin, fps)[self.place]
        if run.film:
            self.target = among_others(self.target)
        if task.begin is not None:
            assert isinstance(self.target, CorrectedTarget)
            self.target = replace(self.target, first=first)
        self.begun = False
        self.state: Any = None
        self._collected = Collector()
        self._rng = stream(run.recipe.seed, self.place)

    def step(self, frame: Frame, footprints: Sequence[Footprint]) -> None:
        if self.begun:
            self.state, result = self.target.advance(self._rng, self.state, frame, footprints)
        else:
            self.state, result = self.target.begin(self._rng, frame)
            self.begun = True
        self._collected.add(result.rows)

    def track(self, store: Store) -> Track:
        return Track(**vars(self.task), at=store.add(as_written(self._collected.trajectory())))
