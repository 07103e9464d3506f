"""Tracking targets anew over a part of a run, while the others stay as they are recorded."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, TypeAlias

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.numbers import union
from facetrack_cli.core.types import Correction, Frame
from facetrack_cli.editor.run_folder import Run
from facetrack_cli.editor.tracks import Store, Track
from facetrack_cli.recipe.model import ParticlesRecipe
from facetrack_cli.tracking.build.build import build_tracker, tracker_for
from facetrack_cli.tracking.corrected import CorrectedTarget
from facetrack_cli.tracking.exclusion import Cover
from facetrack_cli.tracking.loop import Target
from facetrack_cli.trajectory.trajectory import Collector, Trajectory
from facetrack_cli.trajectory.writers import as_written

_APART_S: Final = 0.002  # a clip whose frames have other times than the run's is another clip

Read: TypeAlias = Callable[[int], Frame]
Report: TypeAlias = Callable[[int, int], None]  # frames done, frames in all


class StoppedError(Exception):
    """The wish to stop was granted; nothing has changed."""


@dataclass(frozen=True)
class Task:
    """One target to track anew from a beginning, None for the start, up to and not including frame `stop`."""

    target: str
    begin: Correction | None
    first: int
    stop: int


class Tracking:
    """Tracks anew, over and over, in the frames that `read` gives."""

    def __init__(self, run: Run, store: Store, read: Read) -> None:
        self._run, self._store, self._read = run, store, read
        self._start: Frame | None = None
        self._alone = not (isinstance(run.recipe, ParticlesRecipe) and run.recipe.exclusion is not None)

    def check(self, correction: Correction) -> None:
        """InputError if a correction does not fit the clip or the recipe."""
        start = replace(self._run.start, corrections=(correction,))
        tracker_for(self._run.recipe, start, self._run.header.source.size)

    def track(
        self,
        tasks: Sequence[Task],
        rows: Trajectory,
        *,
        report: Report = lambda done, total: None,
        stop: Callable[[], bool] = lambda: False,
    ) -> list[Track]:
        """The tracks of these tasks; where targets keep off each other, `rows` tell where the others are.

        A target has one task at most. Raises StoppedError once `stop` says so, InputError if the clip is not the run's.
        """
        live = [_Live(self._run, task, self._first()) for task in tasks]
        frames = frames_of(tasks)
        total = sum(stop - first for first, stop in frames)
        done = 0
        for first, end in frames:
            for index in range(first, end):
                if stop():
                    raise StoppedError
                frame = self._frame(index)
                now = [one for one in live if one.task.first <= index < one.task.stop]
                for one in sorted(now, key=lambda one: one.place):
                    one.step(frame, [] if self._alone else self._covers(one, now, rows, index))
                done += 1
                report(done, total)
        return [one.track(self._store) for one in live]

    def _first(self) -> Frame:
        if self._start is None:
            self._start = self._read(self._run.start.frame)
        return self._start

    def _frame(self, index: int) -> Frame:
        frame = self._read(index)
        then = float(self._run.rows.parts[0].time_s[index - self._run.first])
        if abs(frame.time_s - then) > _APART_S:
            raise InputError(
                f"{self._run.clip}: frame {index} is at {frame.time_s:.4f} s, and in the run at {then:.4f} s; "
                "name the run's clip with --clip"
            )
        return frame

    def _covers(self, one: _Live, now: Sequence[_Live], rows: Trajectory, index: int) -> list[Cover]:
        """What the other targets explain: those that are tracked now as they are, the rest as they are recorded.

        As in a run, targets before it are where they are in this frame, those after it where they were.
        """
        found: list[Cover | None] = []
        running = {other.task.target: other for other in now}
        for place, name in enumerate(self._run.targets):
            if place == one.place:
                continue
            ahead = place > one.place
            other = running.get(name)
            if other is not None and (other.begun or not ahead):
                found.append(other.target.cover(other.state, ahead=ahead))
            else:
                found.append(recorded_cover(rows, max(index - ahead, self._run.first), name))
        return [cover for cover in found if cover is not None]


def recorded_cover(rows: Trajectory, frame: int, name: str) -> Cover | None:
    """What a target explains by its row; None of points, and where it is absent."""
    parts = rows.of_target(name)
    at = parts[0].row(frame)
    assert at is not None
    x, y, w, h = (float(getattr(parts[0], key)[at]) for key in "xywh")
    return None if len(parts) > 1 or math.isnan(x) else Cover(np.array([x, y]), np.array([w, h]) / 2)


class _Live:
    """A target that is being tracked."""

    def __init__(self, run: Run, task: Task, first: Frame) -> None:
        self.task = task
        self.place = run.targets.index(task.target)
        corrections = () if task.begin is None else (task.begin,)
        target: Target = build_tracker(run.recipe, replace(run.start, corrections=corrections))[self.place]
        if task.begin is not None:
            assert isinstance(target, CorrectedTarget)
            target = target.resumed(first)
        self.target = target
        self.begun = False
        self.state: Any = None
        self._collected = Collector()
        # a stream of its own for each target, as in a run
        spawned = (self.place,) if self.place else ()
        self._rng = np.random.default_rng(np.random.SeedSequence(run.recipe.seed, spawn_key=spawned))

    def step(self, frame: Frame, covers: Sequence[Cover]) -> None:
        if self.begun:
            self.state, result = self.target.advance(self._rng, self.state, frame, covers)
        else:
            self.state, result = self.target.begin(self._rng, frame)
            self.begun = True
        self._collected.add(result.rows)

    def track(self, store: Store) -> Track:
        rows = as_written(self._collected.trajectory())
        return Track(self.task.target, self.task.begin, self.task.first, self.task.stop, store.add(rows))


def frames_of(tasks: Iterable[Task]) -> list[tuple[int, int]]:
    """[first, stop) of the frames that any task needs, in order."""
    return union((task.first, task.stop) for task in tasks)
