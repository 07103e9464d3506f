"""The corrections of a run and the rows that follow from them. Every step can be undone."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import chain, zip_longest
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import BOX, Correction, Start, TargetStart
from facetrack_cli.editor.retrack import Read, Store, Task, Track, Tracking, frames_of
from facetrack_cli.engine.corrected import all_or, completed, is_complete, with_confirmed
from facetrack_cli.run_folder.finished import Run, stamp
from facetrack_cli.runs.plan import Report, silent
from facetrack_cli.runs.signals import Stopped, never
from facetrack_cli.start.assembly import name_targets
from facetrack_cli.start.init_file import TARGET, read_init
from facetrack_cli.trajectory.select import choose
from facetrack_cli.trajectory.trajectory import Trajectory

MAX_STEPS: Final = 1000  # steps that can be undone
Tracks: TypeAlias = Mapping[str, Sequence[Track]]  # of each target


class Step(NamedTuple):
    """Corrections, and the tracks that follow from them."""

    corrections: tuple[Correction, ...]
    tracks: Tracks


class Fixer:
    """A run with its corrections and rows `now`. A call that fails or is stopped leaves both as they were.

    One call at a time may change them; other threads may read them meanwhile.
    """

    def __init__(self, run: Run, read: Read) -> None:
        self.run, self._recorded = run, run.rows
        self._store = Store()
        self._tracking = Tracking(run, self._store, read)
        # the rows complete a correction that does not place all parts; a correction past the end stays as it is
        at_first = (completed_by(one, run.rows) if one.frame <= run.last else one for one in run.start.corrections)
        self._at_first = self._ordered(at_first)
        plans = {name: self._plan(name, self._at_first) for name in run.rows.targets}
        self._known = {name: [Track(**vars(one)) for one in plan] for name, plan in plans.items()}
        self._past: list[Step] = []
        self._take(Step(self._at_first, {name: tuple(those) for name, those in self._known.items()}))

    @property
    def start(self) -> Start:
        """The run's start with the corrections of now."""
        return replace(self.run.start, corrections=self.corrections)

    @property
    def changed(self) -> bool:
        """Whether the corrections differ from those in the run's files."""
        return self.corrections != self._at_first

    @property
    def can_undo(self) -> bool:
        return bool(self._past)

    def find(self, frame: int, target: str) -> Correction | None:
        return next((one for one in self.corrections if (one.frame, one.target) == (frame, target)), None)

    def put(self, given: Sequence[Correction], *, report: Report = silent, stop: Stopped = never) -> None:
        """Add corrections, or replace those of the same frames and targets, and track what follows from them."""
        for one in given:
            self.check(one)
        done = {(one.frame, one.target): completed_by(one, self.rows) for one in given}
        others = [one for one in self.corrections if (one.frame, one.target) not in done]
        self._become([*others, *done.values()], report, stop)

    def remove(self, frame: int, target: str, *, report: Report = silent, stop: Stopped = never) -> None:
        """Remove a correction. The target is tracked from the correction before, if these rows are not known yet."""
        if self.find(frame, target) is None:
            raise InputError(f"{target} has no correction at frame {frame}")
        self._become([one for one in self.corrections if (one.frame, one.target) != (frame, target)], report, stop)

    def undo(self) -> None:
        """Undo the last step; nothing is tracked for it."""
        if self._past:
            self._take(self._past.pop())

    def apply(self, corrections: Sequence[Correction], *, report: Report = silent, stop: Stopped = never) -> None:
        """Replace all corrections by these, which may lie past the run's end. The track before a correction places
        the parts that the correction does not place.
        """
        for one in corrections:
            self.check(one, beyond=True)
        self._become(corrections, report, stop)

    def check(self, one: Correction, *, beyond: bool = False) -> None:
        """InputError if a correction does not fit the run; it may lie `beyond` its end."""
        run = self.run
        if one.target not in run.parts:
            raise InputError(f"there is no {one.target} in the run; it has {', '.join(run.rows.targets)}")
        if not run.first < one.frame <= run.last and not (beyond and one.frame > run.last):
            why = ", in which it begins; begin it again with facetrack init" if one.frame == run.first else ""
            remedy = f"the run can be from {run.first + 1} to {run.last}"
            raise InputError(f"frame {one.frame} cannot be corrected{why}; {remedy}")
        if not one.confirmed:
            self._tracking.check(one)

    def saved(self) -> None:
        """The run's files have the corrections of now."""
        self._at_first = self.corrections
        self.run = replace(self.run, files={form: (path, stamp(path)) for form, (path, _) in self.run.files.items()})

    def close(self) -> None:
        self._store.close()

    def _become(self, corrections: Sequence[Correction], report: Report, stop: Stopped) -> None:
        """Take these corrections, and track the stretches of which no track is known."""
        plans = {name: self._plan(name, corrections) for name in self._known}
        found: dict[str, list[Track]] = {name: [] for name in plans}
        ends: dict[str, Track] = {}  # the last track of each target, one frame longer where the next needs it
        done = total = 0
        while any(plans.values()):
            # one stretch of each target a round, so that targets corrected in the same frames share the images
            tasks: list[Task] = []
            for name, plan in plans.items():
                while plan:
                    task = self._begun(plan[0], ends.get(name))
                    if (known := self._find(task, task.stop)) is None:
                        tasks.append(task)
                        break
                    found[name].append(known)
                    ends[name] = known
                    plan.pop(0)
            # each round goes through the frames of its tasks once
            begun = {task.target for task in tasks}
            after = (plan[1:] if name in begun else plan for name, plan in plans.items())
            rounds = [tasks, *([one for one in row if one] for row in zip_longest(*after))]
            left = sum(stop - first for tasks_ in rounds for first, stop in frames_of(tasks_))
            total = max(total, done + left)

            def step(n: int, _: int | None, before: int = done, total: int = total) -> None:
                report(before + n, max(total, before + n))

            for task, track in zip(tasks, self._tracking.track(tasks, self.rows, report=step, stop=stop), strict=True):
                # a known track stays, although it was tracked again to get one frame more
                plan = plans[task.target]
                shorter = self._find(task, plan[1].first if len(plan) > 1 else task.stop)
                found[task.target].append(shorter or track)
                ends[task.target] = track
                plan.pop(0)
            done += sum(stop - first for first, stop in frames_of(tasks))
        begins = [track.begin for tracks in found.values() for track in tracks if track.begin is not None]
        others = (one for one in corrections if one.frame > self.run.last or one.confirmed)
        became = self._ordered([*begins, *others])
        for name, tracks in found.items():
            self._known[name] += [track for track in tracks if track not in self._known[name]]
        if became == self.corrections:
            return
        self._past = [*self._past, self._step][-MAX_STEPS:]
        self._take(Step(became, {name: tuple(tracks) for name, tracks in found.items()}))

    def _take(self, step: Step) -> None:
        self._step = step
        rows = with_confirmed(self._store.spliced(self._recorded, step.tracks), step.corrections)
        self.corrections, self.rows = self.now = step.corrections, rows

    def _ordered(self, corrections: Iterable[Correction]) -> tuple[Correction, ...]:
        places = {name: place for place, name in enumerate(self.run.rows.targets)}
        return tuple(sorted(corrections, key=lambda one: (one.frame, places[one.target])))

    def _plan(self, target: str, corrections: Iterable[Correction]) -> list[Task]:
        """The tasks of one target, from each beginning to the next. A task goes one frame further where the next
        correction does not place all parts.
        """
        plan: list[Task] = []
        begin, first = None, self.run.first
        ours = (one for one in corrections if one.target == target and not one.confirmed)
        within = (one for one in ours if one.frame <= self.run.last)
        for one in sorted(within, key=lambda one: one.frame):
            more = 0 if is_complete(one, self.run.parts[target]) else 1
            plan.append(Task(target, begin, first, one.frame + more))
            begin, first = one, one.frame
        plan.append(Task(target, begin, first, self.run.last + 1))
        return plan

    def _begun(self, task: Task, before: Track | None) -> Task:
        """A task whose beginning is completed by the rows of the track before it in that frame."""
        if task.begin is None or before is None or is_complete(task.begin, self.run.parts[task.target]):
            return task
        return replace(task, begin=completed_by(task.begin, before.rows(self.run.rows, self._store)))

    def _find(self, task: Task, stop: int) -> Track | None:
        """A known track of a task, up to a frame."""
        known = self._known[task.target]
        return next((track for track in known if track.begin == task.begin and track.stop >= stop), None)


def completed_by(one: Correction, rows: Trajectory) -> Correction:
    """The correction with all parts placed: the rows place the parts that it does not place."""
    return completed(one, choose(rows.at(one.frame), one.target))


def merged(new: Correction, before: Correction | None, parts: tuple[str, ...]) -> Correction:
    """A `new` correction merged with the correction `before` it of the same frame and target, if there is one."""
    frame, target, points = new.frame, new.target, new.given.points
    if new.absent is True or (parts == (BOX,) and new.absent):
        return Correction(frame, target, absent=True)
    gone = set(new.absent)
    if new.given.box is not None and (parts == (BOX,) or not points):
        return replace(new, given=TargetStart(box=new.given.box))
    if new.confirmed:
        lists = [parts if one.confirmed is True else one.confirmed for one in (new, before) if one is not None]
        return replace(new, confirmed=all_or([part for part in parts if part in chain(*lists)], parts))
    old = Correction(frame, target) if before is None or before.confirmed else before
    by_hand = {part: at for part, at in {**old.given.points, **points}.items() if part not in gone or part in points}
    kept = {part: at for part, at in old.kept.items() if part not in by_hand and part not in gone}
    hidden = [part for part in parts if part in {*gone, *old.hidden(parts)} and part not in by_hand]
    return Correction(frame, target, TargetStart(points=by_hand), kept, all_or(hidden, parts), old.learn)


def corrections_of(path: Path, run: Run) -> tuple[Correction, ...]:
    """The corrections of an init file that begins as the run does. InputError if it does not."""
    start = _named(read_init(path), run)
    if start.frame != run.start.frame:
        begins = f"begins at frame {start.frame}, and the run at {run.start.frame}"
        raise InputError(f"{path}: {begins}; run the clip again with it")
    for name, one in start.targets.items():
        theirs = run.start.targets.get(name, one)
        points = {part: theirs.points.get(part) for part in one.points}
        if one.box not in (None, theirs.box) or points != one.points:
            raise InputError(f"{path}: {name} does not begin where it does in the run; run the clip again with it")
    return start.corrections


def _named(start: Start, run: Run) -> Start:
    """The start with the targets that the recipe follows; the run gives the targets that the file does not have."""
    names, out = run.recipe.followed, run.recipe.left_out
    given = {name: one for name, one in start.targets.items() if name not in out}
    if not names or not given:
        return start
    if len(given) == 1 and not given.keys() & set(names):
        [called] = given
        given = {TARGET: given[called]}
        of_it = [replace(one, target=TARGET) for one in start.corrections if one.target == called]
        start = replace(start, corrections=tuple(of_it))
    rest = {name: one for name, one in run.start.targets.items() if name not in given and name != names[0]}
    if not given.keys() & {names[0], TARGET}:
        rest[names[0]] = run.start.targets[names[0]]
    return name_targets(replace(start, targets={**given, **rest}), names, None, left_out=out, later=run.recipe.later)
