"""The corrections of a run, and the rows that follow from them. Every step can be undone.

A target is tracked again from a correction to its next one. The other targets stay as recorded.
"""

from __future__ import annotations

import contextlib
import math
import pickle
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, count
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from facetrack_cli.core.errors import InputError, OutputError, reason
from facetrack_cli.core.numbers import union
from facetrack_cli.core.types import BOX, Correction, Frame, Start, TargetStart
from facetrack_cli.editor.pick_session import fitted
from facetrack_cli.engine.corrected import CorrectedTarget, all_or, completed, is_complete, with_confirmed
from facetrack_cli.engine.loop import Footprint, Target, stream
from facetrack_cli.recipe.model import ParticlesRecipe
from facetrack_cli.run_folder.finished import Run, stamp
from facetrack_cli.runs.plan import Report, silent
from facetrack_cli.runs.signals import Stopped, StoppedError, never
from facetrack_cli.start.assembly import build_tracker, tracker_for
from facetrack_cli.start.init_file import read_init
from facetrack_cli.start.presence import among_others
from facetrack_cli.trajectory.trajectory import Collector, Trajectory, successive
from facetrack_cli.trajectory.views import choose
from facetrack_cli.trajectory.writers import as_written

MAX_STEPS: Final = 1000  # steps that can be undone
MAX_TIME_OFF_S: Final = 0.002  # a frame whose time differs more from the run's is of another clip
Read: TypeAlias = Callable[[int], Frame]


class Store:
    """The rows of tracks in a temporary folder: undo over many corrections takes no memory.

    `recorded` are the rows of the run.
    """

    def __init__(self, recorded: Trajectory) -> None:
        self._recorded, self._numbers = recorded, count()
        with _writing():
            self._folder = tempfile.TemporaryDirectory(prefix="facetrack-fix-")

    def add(self, rows: Trajectory) -> Path:
        """Store the rows; their file."""
        path = Path(self._folder.name, str(next(self._numbers)))
        with _writing():
            path.write_bytes(pickle.dumps(rows))
        return path

    def rows(self, track: Track) -> Trajectory:
        """The rows of its target, from its first frame on."""
        if track.place is None:
            return choose(self._recorded, track.target)
        rows: Trajectory = pickle.loads(track.place.read_bytes())
        return rows

    def spliced(self, tracks: Mapping[str, Sequence[Track]]) -> Trajectory:
        """The rows of the run with these tracks, by target and by their first frames, each up to the next."""
        if all(track.place is None for each in tracks.values() for track in each):
            return self._recorded
        pieces = []
        for each in tracks.values():
            stops = [*(track.first for track in each[1:]), each[-1].stop]
            pieces += [self.rows(track).between(track.first, stop) for track, stop in zip(each, stops, strict=True)]
        return successive(pieces, self._recorded)

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._folder.cleanup()


@contextlib.contextmanager
def _writing() -> Iterator[None]:
    try:
        yield
    except OSError as e:
        remedy = "free some space, or set TMPDIR to another folder"
        raise OutputError(f"temporary files cannot be written: {reason(e)}; {remedy}") from e


@dataclass(frozen=True)
class Task:
    """One target to track in the frames [first, stop) from a correction, `begin`, or from the run's start (None)."""

    target: str
    begin: Correction | None
    first: int
    stop: int


@dataclass(frozen=True)
class Track(Task):
    """The rows of a task: their file in the store, or None if they are the recorded rows of the run."""

    place: Path | None = None


class Step(NamedTuple):
    """Corrections, and by target the tracks that follow from them, by their first frames."""

    corrections: tuple[Correction, ...]
    tracks: Mapping[str, Sequence[Track]]


class Fixer:
    """A run with its corrections and rows `now`. A call that fails or is stopped leaves both as they were.

    One call at a time may change them; other threads may read them meanwhile. `read` gives the frames of the clip.
    """

    def __init__(self, run: Run, read: Read) -> None:
        self.run, self._read, self._store = run, read, Store(run.rows)
        # the rows complete a correction that does not place all parts; a correction past the end stays as it is
        saved = (completed_by(fix, run.rows) if fix.frame <= run.last else fix for fix in run.start.corrections)
        self._saved = self._ordered(saved)
        plans = {name: self._plan(name, self._saved) for name in run.rows.targets}
        self._known = {name: [Track(**vars(task)) for task in plan] for name, plan in plans.items()}
        self._past: list[Step] = []
        self._take(Step(self._saved, {name: tuple(tracks) for name, tracks in self._known.items()}))

    @property
    def start(self) -> Start:
        """The run's start with the corrections of now."""
        return replace(self.run.start, corrections=self.corrections)

    @property
    def changed(self) -> bool:
        """Whether the corrections differ from those in the run's files."""
        return self.corrections != self._saved

    @property
    def can_undo(self) -> bool:
        return bool(self._past)

    def find(self, frame: int, target: str) -> Correction | None:
        return next((fix for fix in self.corrections if (fix.frame, fix.target) == (frame, target)), None)

    def put(self, corrections: Sequence[Correction], *, report: Report = silent, stop: Stopped = never) -> None:
        """Add corrections, or replace those of the same frames and targets, and track what follows from them."""
        for correction in corrections:
            self.check(correction)
        new = {(fix.frame, fix.target): completed_by(fix, self.rows) for fix in corrections}
        others = [correction for correction in self.corrections if (correction.frame, correction.target) not in new]
        self._become([*others, *new.values()], report, stop)

    def remove(self, frame: int, target: str, *, report: Report = silent, stop: Stopped = never) -> None:
        """Remove a correction. The target is tracked from the correction before, if these rows are not known yet."""
        if (removed := self.find(frame, target)) is None:
            raise InputError(f"{target} has no correction at frame {frame}")
        self._become([correction for correction in self.corrections if correction is not removed], report, stop)

    def undo(self) -> None:
        """Undo the last step; nothing is tracked for it."""
        if self._past:
            self._take(self._past.pop())

    def apply(self, corrections: Sequence[Correction], *, report: Report = silent, stop: Stopped = never) -> None:
        """Replace all corrections by these, which may lie past the run's end. The track before a correction places
        the parts that the correction does not place.
        """
        for correction in corrections:
            self.check(correction, beyond=True)
        self._become(corrections, report, stop)

    def check(self, correction: Correction, *, beyond: bool = False) -> None:
        """InputError if a correction does not fit the run, its recipe or its clip; it may lie `beyond` the end."""
        run, frame, source = self.run, correction.frame, self.run.header.source
        if correction.target not in run.parts:
            raise InputError(f"there is no {correction.target} in the run; it has {', '.join(run.rows.targets)}")
        if not run.first < frame <= run.last and not (beyond and frame > run.last):
            why = ", in which it begins; begin it again with facetrack init" if frame == run.first else ""
            remedy = f"the run can be from {run.first + 1} to {run.last}"
            raise InputError(f"frame {frame} cannot be corrected{why}; {remedy}")
        if not correction.confirmed:
            tracker_for(run.recipe, replace(run.start, corrections=(correction,)), source.size)

    def saved(self, rows: Trajectory) -> None:
        """The run's files have the corrections of now, and these rows."""
        self._saved, self.rows, self.now = self.corrections, rows, (self.corrections, rows)
        self.run = replace(self.run, files={form: (path, stamp(path)) for form, (path, _) in self.run.files.items()})

    def close(self) -> None:
        self._store.close()

    def _become(self, corrections: Sequence[Correction], report: Report, stop: Stopped) -> None:
        """Take these corrections, and track the stretches of which no track is known."""
        plans = {name: self._plan(name, corrections) for name in self._known}
        tracks: dict[str, list[Track]] = {name: [] for name in plans}
        last: dict[str, Track] = {}  # the last track of each target, one frame longer where the next needs it
        done = total = 0
        while any(plans.values()):
            # one stretch of each target a round, so that targets corrected in the same frames share the images
            tasks: list[Task] = []
            for name, plan in plans.items():
                while plan:
                    task = self._completed(plan[0], last.get(name))
                    if (results := self._find(task, task.stop)) is None:
                        tasks.append(task)
                        break
                    tracks[name].append(results)
                    last[name] = results
                    plan.pop(0)
            total = max(total, done + length_of(task for plan in plans.values() for task in plan))

            def step(n: int, _: int | None, before: int = done, total: int = total) -> None:
                report(before + n, max(total, before + n))

            for task, track in zip(tasks, self._track(tasks, step, stop), strict=True):
                # a known track stays, although it was tracked again to get one frame more
                plan = plans[task.target]
                shorter = self._find(task, plan[1].first if len(plan) > 1 else task.stop)
                tracks[task.target].append(shorter or track)
                last[task.target] = track
                plan.pop(0)
            done += length_of(tasks)
        placed = [track.begin for each in tracks.values() for track in each if track.begin is not None]
        others = (correction for correction in corrections if correction.frame > self.run.last or correction.confirmed)
        became = self._ordered([*placed, *others])
        for name, each in tracks.items():
            self._known[name] += [track for track in each if track not in self._known[name]]
        if became != self.corrections:
            self._past = [*self._past, self._step][-MAX_STEPS:]
            self._take(Step(became, {name: tuple(each) for name, each in tracks.items()}))

    def _take(self, step: Step) -> None:
        rows = with_confirmed(self._store.spliced(step.tracks), step.corrections)
        self._step, self.corrections, self.rows, self.now = step, step.corrections, rows, (step.corrections, rows)

    def _ordered(self, corrections: Iterable[Correction]) -> tuple[Correction, ...]:
        order = self.run.rows.targets.index
        return tuple(sorted(corrections, key=lambda fix: (fix.frame, order(fix.target))))

    def _plan(self, target: str, corrections: Iterable[Correction]) -> list[Task]:
        """The tasks of one target, from each correction to the next. A task goes one frame further where the next
        correction does not place all parts.
        """
        plan: list[Task] = []
        begin, first, last = None, self.run.first, self.run.last
        ours = (
            correction
            for correction in corrections
            if correction.target == target and not correction.confirmed and correction.frame <= last
        )
        for correction in sorted(ours, key=lambda correction: correction.frame):
            more = 0 if is_complete(correction, self.run.parts[target]) else 1
            plan.append(Task(target, begin, first, correction.frame + more))
            begin, first = correction, correction.frame
        return [*plan, Task(target, begin, first, last + 1)]

    def _completed(self, task: Task, before: Track | None) -> Task:
        """A task whose correction is completed by the rows of the track before it in that frame."""
        if task.begin is None or before is None or is_complete(task.begin, self.run.parts[task.target]):
            return task
        return replace(task, begin=completed_by(task.begin, self._store.rows(before)))

    def _find(self, task: Task, stop: int) -> Track | None:
        """A known track of a task, up to a frame."""
        results = self._known[task.target]
        return next((track for track in results if track.begin == task.begin and track.stop >= stop), None)

    def _track(self, tasks: Sequence[Task], report: Report, stop: Stopped) -> list[Track]:
        """Track tasks of different targets; with mutual exclusion, the rows of now say where the others are.

        Raises StoppedError once `stop` says so, InputError if the clip is not the run's.
        """
        targets = [_Live(self.run, task, self._first) for task in tasks]
        recipe, total = self.run.recipe, length_of(tasks)
        exclusive = isinstance(recipe, ParticlesRecipe) and recipe.exclusion is not None
        frames = (index for span in spans_of(tasks) for index in range(*span))
        for done, index in enumerate(frames, 1):
            if stop():
                raise StoppedError
            frame = self._frame(index)
            now = {live.task.target: live for live in targets if live.task.first <= index < live.task.stop}
            for live in sorted(now.values(), key=lambda live: live.place):
                live.step(frame, self._footprints(live, now, index) if exclusive else [])
            report(done, total)
        rows = [as_written(live.collected.trajectory()) for live in targets]
        return [Track(**vars(task), place=self._store.add(each)) for task, each in zip(tasks, rows, strict=True)]

    @cached_property
    def _first(self) -> Frame:
        return self._read(self.run.start.frame)

    def _frame(self, index: int) -> Frame:
        frame = self._read(index)
        then = float(self.run.rows.parts[0].time_s[index - self.run.first])
        if abs(frame.time_s - then) > MAX_TIME_OFF_S:
            times = f"is at {frame.time_s:.4f} s, and in the run at {then:.4f} s"
            raise InputError(f"{self.run.clip}: frame {index} {times}; name the run's clip with --clip")
        return frame

    def _footprints(self, live: _Live, now: Mapping[str, _Live], index: int) -> list[Footprint]:
        """What other targets explain, by state or row: those before it in this frame, those after it in the last."""
        footprints = []
        for place, name in enumerate(self.run.rows.targets):
            ahead, other = place > live.place, now.get(name)
            if place == live.place:
                continue
            if other is not None and (other.started or not ahead):
                footprint = other.target.footprint(other.state, ahead=ahead)
            else:
                footprint = recorded_footprint(self.rows, max(index - ahead, self.run.first), name)
            if footprint is not None:
                footprints.append(footprint._replace(target=name))
        return footprints


class _Live:
    """A target that is being tracked. `first` is the frame of the run's start."""

    def __init__(self, run: Run, task: Task, first: Frame) -> None:
        self.task, self.place = task, run.rows.targets.index(task.target)
        corrections = () if task.begin is None else (task.begin,)
        start = replace(run.start, corrections=corrections)
        self.target: Target = build_tracker(run.recipe, start)[self.place]
        if run.film:
            self.target = among_others(self.target)
        if task.begin is not None:
            assert isinstance(self.target, CorrectedTarget)
            self.target = replace(self.target, first=first)
        self.started, self.state, self.collected = False, None, Collector()
        self._rng = stream(run.recipe.seed, self.place)

    def step(self, frame: Frame, footprints: Sequence[Footprint]) -> None:
        if self.started:
            self.state, result = self.target.advance(self._rng, self.state, frame, footprints)
        else:
            self.state, result = self.target.begin(self._rng, frame)
            self.started = True
        self.collected.add(result.rows)


def spans_of(tasks: Iterable[Task]) -> list[tuple[int, int]]:
    """[first, stop) of the frames that any task needs, in order."""
    return union((task.first, task.stop) for task in tasks)


def length_of(tasks: Iterable[Task]) -> int:
    """The number of frames that any task needs."""
    return sum(stop - first for first, stop in spans_of(tasks))


def recorded_footprint(rows: Trajectory, frame: int, name: str) -> Footprint | None:
    """What a target explains by its row; None of points, and where it is absent."""
    row = choose(rows.at(frame), name)
    if len(row) > 1 or math.isnan(row.x[0]):
        return None
    return Footprint(np.array([row.x[0], row.y[0]]), np.array([row.w[0], row.h[0]]) / 2)


def completed_by(correction: Correction, rows: Trajectory) -> Correction:
    """The correction with all parts placed: the rows place the parts that it does not place."""
    return completed(correction, choose(rows.at(correction.frame), correction.target))


def merged(new: Correction, before: Correction | None, parts: tuple[str, ...]) -> Correction:
    """A `new` correction merged with the correction `before` it of the same frame and target, if there is one."""
    frame, target, points = new.frame, new.target, new.given.points
    if new.absent is True or (parts == (BOX,) and new.absent):
        return Correction(frame, target, absent=True)
    gone = set(new.absent)
    if new.given.box is not None and (parts == (BOX,) or not points):
        return replace(new, given=TargetStart(box=new.given.box))
    if new.confirmed:
        lists = [parts if fix.confirmed is True else fix.confirmed for fix in (new, before) if fix is not None]
        return replace(new, confirmed=all_or([part for part in parts if part in chain(*lists)], parts))
    old = Correction(frame, target) if before is None or before.confirmed else before
    by_hand = {part: at for part, at in {**old.given.points, **points}.items() if part not in gone or part in points}
    kept = {part: at for part, at in old.kept.items() if part not in by_hand and part not in gone}
    hidden = [part for part in parts if part in {*gone, *old.hidden(parts)} and part not in by_hand]
    return Correction(frame, target, TargetStart(points=by_hand), kept, all_or(hidden, parts), old.learn)


def corrections_of(path: Path, run: Run) -> tuple[Correction, ...]:
    """The corrections of an init file that begins as the run does. InputError if it does not."""
    whole = read_init(path)
    start = fitted(whole, run.recipe)
    if len(start.corrections) < len(whole.corrections):
        raise InputError(f"{path}: corrects what the run does not follow, which is {', '.join(run.parts)}")
    if start.frame != run.start.frame:
        begins = f"begins at frame {start.frame}, and the run at {run.start.frame}"
        raise InputError(f"{path}: {begins}; run the clip again with it")
    for name, target in start.targets.items():
        theirs = run.start.targets.get(name, target)
        points = {part: theirs.points.get(part) for part in target.points}
        if target.box not in (None, theirs.box) or points != target.points:
            raise InputError(f"{path}: {name} does not begin where it does in the run; run the clip again with it")
    return start.corrections
