"""The corrections of a run, the rows that follow from them, and how both are saved. Every step can be undone.

A target is tracked again from a correction to its next one, alone; the other targets stay as recorded. Where targets
depend on each other, `save` tracks all of them again. It writes all files beside the old files, and then replaces them
together.

In the film of a run the track of one person in one shot is corrected as a run of its own: its start is its first row,
and its corrections are what its rows say is by hand. Saved, its rows take their place in the film's; who is who stays.
"""

import contextlib
import pickle
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain, count
from pathlib import Path
from typing import Any

from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.files import writing
from facetrack_cli.core.types import BOX, Correction, Frame, Start, TargetStart
from facetrack_cli.editor.session import fitted
from facetrack_cli.engine import corrected, loop
from facetrack_cli.engine.protocols import Belief
from facetrack_cli.recipe.model import ParticleRecipe, ParticlesRecipe
from facetrack_cli.run_folder.lease import FolderLease
from facetrack_cli.run_folder.manifest import FILTERED, outdated, read_run, write_rows
from facetrack_cli.runs.clip import past_end
from facetrack_cli.runs.finished import Run, Write, given_all, recipe_of, rewrite, run_files, stamp
from facetrack_cli.runs.people import ORIGIN, film_of, people_in, write_people
from facetrack_cli.runs.plan import Report, silent
from facetrack_cli.runs.signals import Stopped, StoppedError, never
from facetrack_cli.start.assembly import build_tracker, tracker_for
from facetrack_cli.start.init_file import as_yaml, read_init, write_init
from facetrack_cli.start.presence import among_others
from facetrack_cli.trackers.smoothed import lagged
from facetrack_cli.trajectory.people import read_still
from facetrack_cli.trajectory.reader import CORRECTED, UNSAVED, corrections_record, read_header
from facetrack_cli.trajectory.trajectory import Collector, Trajectory, successive
from facetrack_cli.trajectory.views import choose
from facetrack_cli.trajectory.writers import as_written, summary_of
from facetrack_cli.video.source import Frames, open_source


@dataclass(frozen=True)
class Track:
    """One target in the frames [first, stop) from a correction, `begin`, or from the run's start (None).

    `file` has its rows; None of the recorded rows of the run.
    """

    target: str
    begin: Correction | None
    first: int
    stop: int
    file: Path | None = None


class Fixer:
    """A run with its corrections and rows `now`. A call that fails or is stopped leaves both as they were.

    One call at a time may change them; other threads may read them meanwhile. `read` gives the frames of the clip.
    Rows that were tracked are in a temporary folder: undo over many corrections takes no memory.
    """

    def __init__(self, run: Run, read: Callable[[int], Frame]) -> None:
        self.run, self._read = run, read
        with _kept_apart():
            self._folder = tempfile.TemporaryDirectory(prefix="facetrack-fix-", ignore_cleanup_errors=True)
        # the rows complete a correction that does not place all parts; a correction past the end stays as it is
        saved = (completed_by(fix, run.rows) if fix.frame <= run.last else fix for fix in run.start.corrections)
        self._saved = self._ordered(saved)
        self._known = {name: self._plan(name, self._saved) for name in run.rows.targets}
        self._past: list[tuple[Correction, ...]] = []
        self.now = self._saved, corrected.with_confirmed(run.rows, self._saved)

    @property
    def corrections(self) -> tuple[Correction, ...]:
        return self.now[0]

    @property
    def rows(self) -> Trajectory:
        return self.now[1]

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
        others = [fix for fix in self.corrections if (fix.frame, fix.target) not in new]
        self._become([*others, *new.values()], report, stop)

    def remove(self, frame: int, target: str, *, report: Report = silent, stop: Stopped = never) -> None:
        """Remove a correction. The target is tracked from the correction before, if these rows are not known yet."""
        if (removed := self.find(frame, target)) is None:
            raise InputError(f"{target} has no correction at frame {frame}")
        self._become([fix for fix in self.corrections if fix is not removed], report, stop)

    def undo(self) -> None:
        """Undo the last step; nothing is tracked for it."""
        if self._past:
            self.now = self._followed(self._past.pop(), lambda: None)

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
        self._saved, self.now = self.corrections, (self.corrections, rows)
        self.run = replace(self.run, files={form: (path, stamp(path)) for form, (path, _) in self.run.files.items()})

    def close(self) -> None:
        self._folder.cleanup()

    def _become(self, corrections: Sequence[Correction], report: Report, stop: Stopped) -> None:
        """Take these corrections, and track the stretches of which no track is known."""
        corrections = self._ordered(corrections)
        plans = chain(*(self._plan(name, corrections) for name in self._known))
        frames, total = count(1), sum(track.stop - track.first for track in plans if self._find(track) is None)

        def step() -> None:
            if stop():
                raise StoppedError
            done = next(frames)
            report(done, max(total, done))

        now = self._followed(corrections, step)
        if now[0] != self.corrections:
            self._past.append(self.corrections)
            self.now = now

    def _followed(
        self, corrections: tuple[Correction, ...], step: Callable[[], None]
    ) -> tuple[tuple[Correction, ...], Trajectory]:
        """The corrections with all parts placed, and their rows; `step` is called before each frame that is tracked."""
        tracks = [track for name in self._known for track in self._tracks(self._plan(name, corrections), step)]
        placed = [track.begin for track, _ in tracks if track.begin is not None]
        became = self._ordered([*placed, *(fix for fix in corrections if fix.frame > self.run.last or fix.confirmed)])
        rows = self.run.rows
        if any(track.file is not None for track, _ in tracks):
            rows = successive([self._rows(track).between(track.first, stop) for track, stop in tracks], rows)
        return became, corrected.with_confirmed(rows, became)

    def _ordered(self, corrections: Iterable[Correction]) -> tuple[Correction, ...]:
        order = self.run.rows.targets.index
        return tuple(sorted(corrections, key=lambda fix: (fix.frame, order(fix.target))))

    def _plan(self, target: str, corrections: Iterable[Correction]) -> list[Track]:
        """The tracks of one target, from each correction to the next, without their rows."""
        last = self.run.last
        begins = [fix for fix in corrections if fix.target == target and not fix.confirmed and fix.frame <= last]
        firsts = [self.run.first, *(fix.frame for fix in begins)]
        return [Track(target, *span) for span in zip([None, *begins], firsts, [*firsts[1:], last + 1], strict=True)]

    def _tracks(self, plan: Sequence[Track], step: Callable[[], None]) -> Iterator[tuple[Track, int]]:
        """The tracks of a plan, those that are known or new ones, and the frame at which each ends. A track goes one
        frame further where the next correction does not place all parts: its rows place the others.
        """
        before: Track | None = None
        for track, after in zip(plan, [*(track.begin for track in plan[1:]), None], strict=True):
            if before is not None and track.begin is not None:
                track = replace(track, begin=completed_by(track.begin, self._rows(before)))
            more = after is not None and not corrected.is_complete(after, self.run.parts[track.target])
            longer = replace(track, stop=track.stop + more)
            longer = self._find(longer) or self._track(longer, step)
            before = longer if more else None
            # rows stay, although they were tracked again to get one frame more
            yield self._find(track) or longer, track.stop

    def _find(self, track: Track) -> Track | None:
        """The track that is known, or a longer one."""
        known = self._known[track.target]
        return next((each for each in known if each.begin == track.begin and each.stop >= track.stop), None)

    def _track(self, track: Track, step: Callable[[], None]) -> Track:
        """Track a target alone; `step` is called before each frame."""
        run, place, begin = self.run, self.run.rows.targets.index(track.target), track.begin
        start = replace(run.start, corrections=() if begin is None else (begin,))
        target: loop.Target = build_tracker(run.recipe, start)[place]
        if run.film:
            target = among_others(target)
        if begin is not None:
            assert isinstance(target, corrected.CorrectedTarget)
            target = replace(target, first=self._first)
        rng, state, collected = loop.stream(run.recipe.seed, place), None, Collector()
        for index in range(track.first, track.stop):
            step()
            frame = self._read(index)
            state, result = target.begin(rng, frame) if index == track.first else target.advance(rng, state, frame, ())
            collected.add(result.rows)
        known = self._known[track.target]
        file = Path(self._folder.name, f"{place}-{len(known)}")
        with _kept_apart():
            file.write_bytes(pickle.dumps(as_written(collected.trajectory())))
        known.append(replace(track, file=file))
        return known[-1]

    def _rows(self, track: Track) -> Trajectory:
        """The rows of its target, from its first frame on."""
        if track.file is None:
            return choose(self.run.rows, track.target)
        rows: Trajectory = pickle.loads(track.file.read_bytes())
        return rows

    @cached_property
    def _first(self) -> Frame:
        return self._read(self.run.start.frame)


_kept_apart = partial(writing, Path("temporary files"), "set TMPDIR to another folder")


@contextlib.contextmanager
def fixing(run: Run) -> Iterator[tuple[Fixer, Frames]]:
    """A run with its corrections, and the frames of its clip."""
    clip = Frames(run.clip, fps=run.fps, stream=run.header.source.stream)
    with clip as frames, contextlib.closing(Fixer(run, frames.read)) as fixer:
        yield fixer, frames


def completed_by(correction: Correction, rows: Trajectory) -> Correction:
    """The correction with all parts placed: the rows place the parts that it does not place."""
    return corrected.completed(correction, choose(rows.at(correction.frame), correction.target))


def merged(new: Correction, before: Correction | None, parts: tuple[str, ...]) -> Correction:
    """A `new` correction merged with the correction `before` it of the same frame and target, if there is one."""
    frame, target, points = new.frame, new.target, new.points
    if new.absent is True or (parts == (BOX,) and new.absent):
        return Correction(frame, target, absent=True)
    gone = set(new.absent)
    if new.box is not None and (parts == (BOX,) or not points):
        return replace(new, points={})
    if new.confirmed:
        lists = [parts if fix.confirmed is True else fix.confirmed for fix in (new, before) if fix is not None]
        return replace(new, confirmed=corrected.all_or([part for part in parts if part in chain(*lists)], parts))
    old = Correction(frame, target) if before is None or before.confirmed else before
    by_hand = {part: at for part, at in {**old.points, **points}.items() if part not in gone or part in points}
    kept = {part: at for part, at in old.kept.items() if part not in by_hand and part not in gone}
    hidden = [part for part in parts if part in {*gone, *old.hidden(parts)} and part not in by_hand]
    return Correction(frame, target, None, by_hand, kept, corrected.all_or(hidden, parts), old.learn)


def corrections_of(path: Path, run: Run) -> tuple[Correction, ...]:
    """The corrections of an init file that begins as the run does. InputError if it does not."""
    whole = read_init(path)
    start = fitted(whole, run.recipe)
    if len(start.corrections) < len(whole.corrections):
        raise InputError(f"{path}: corrects what the run does not follow, which is {', '.join(run.parts)}")
    began = {name: run.start.targets.get(name, target) for name, target in start.targets.items()}
    for name, target in start.targets.items():
        points = {part: began[name].points.get(part) for part in target.points}
        if start.frame != run.start.frame or target.box not in (None, began[name].box) or points != target.points:
            raise InputError(f"{path}: {name} does not begin where it does in the run; run the clip again with it")
    return start.corrections


def save(fixer: Fixer, *, video: bool = True, report: Report = silent, stop: Stopped = never) -> list[str]:
    """Write the rows, the corrections, and with `video` the run's video, if it has one; a line on each file.

    Raises OutputError or InputError if a file cannot be written, StoppedError once `stop` says so; nothing is changed.
    """
    run, rows, folder = fixer.run, fixer.rows, fixer.run.folder
    if not fixer.changed:
        keep(fixer)
        return [f"{folder}: nothing was corrected, all is as it was"]
    if run.film:
        lines = _save_track(run, rows, video=video, report=report, stop=stop)
        fixer.saved(rows)
        keep(fixer)
        return lines
    files: dict[Path, Write] = {}
    if is_tracked_again(run):
        filtered, rows = _tracked_again(fixer, report, stop)
        if filtered is not None:
            files[folder / FILTERED] = partial(write_rows, "csv", rows=filtered)
    files[folder / CORRECTED] = lambda write: write(as_yaml(fixer.start, run.clip.name).encode())
    clip = run.clip if video and run.video is not None else None
    init = {key: value for key, value in rows.header["init"].items() if key != "corrections"}
    header = {**rows.header, "init": {**init, **corrections_record(fixer.corrections)}}
    rows = replace(rows, header={**header, "lost_frames": summary_of(rows).lost_frames})
    how: Any = {"report": report, "stop": stop, "check": lambda: _check(run)}
    written, notes = rewrite(folder, rows, files, [folder / UNSAVED], clip, **how)
    notes += past_end(fixer.corrections, run.last, str(folder / CORRECTED))
    if run.video is not None and not video:
        notes.append(f"{run.video}: left as it was, it shows the track of before")
    fixer.saved(rows)
    return [*(f"{path}: written" for path in written), *notes, *outdated(folder, folder / CORRECTED)]


def is_tracked_again(run: Run) -> bool:
    """Whether the whole clip is tracked again to save a corrected run: its targets, or its frames, depend on others."""
    exclusive = isinstance(run.recipe, ParticleRecipe | ParticlesRecipe) and run.recipe.exclusion is not None
    return "smoothed" in run.rows.header or bool(run.recipe.later) or exclusive


def _tracked_again(fixer: Fixer, report: Report, stop: Stopped) -> tuple[Trajectory | None, Trajectory]:
    """The rows of a run whose clip is tracked again with the corrections: the filter's, and the smoothed.

    Smoothing needs all frames; where two hands are one filter's, or targets exclude each other, what corrects one of
    them moves the others. A run with a lag, or without smoothing, keeps no other rows of the filter. Raises
    StoppedError once `stop` says so.
    """
    run = fixer.run
    smoothed = run.rows.header.get("smoothed", {"lag": 0})
    lag, kept = smoothed["lag"], "smoothed" in run.rows.header and not smoothed["lag"]
    collected, beliefs = Collector(), {name: list[tuple[Belief, ...]]() for name in run.rows.targets}
    total, stream = run.last - run.first + 1, run.header.source.stream
    with open_source(run.clip, fps=run.fps, start=run.first, stop=run.last + 1, stream=stream) as source:
        tracker = tracker_for(run.recipe, fixer.start, source.size)
        results = loop.track(tracker, iter(source), run.recipe.seed, clip=str(run.clip))
        for done, result in enumerate(lagged(results, lag) if lag else results, 1):
            if stop():
                raise StoppedError
            collected.add(result.rows)
            for name, target in zip(beliefs, result.targets if kept else (), strict=False):
                beliefs[name].append(() if target.beliefs is None else target.beliefs())
            report(done, total)
    rows = as_written(collected.trajectory(header=run.rows.header, path=run.rows.path))
    return (rows, as_written(given_all(rows, beliefs))) if kept else (None, rows)


def _check(run: Run) -> None:
    """OutputError if a file of the run has changed since it was opened, or a folder has the name of a file."""
    for path, opened in run.files.values():
        if stamp(path) != opened:
            raise OutputError(f"{path}: was written by somebody else since it was opened; begin again")
    if (run.folder / CORRECTED).is_dir():
        raise OutputError(f"{run.folder / CORRECTED}: is a folder, where a file is to be; move it away, and save again")


def keep(fixer: Fixer) -> Path | None:
    """Write the corrections that are not saved, so that the next session goes on with them. None if there are none."""
    path = fixer.run.folder / UNSAVED
    if fixer.changed:
        write_init(path, fixer.start, clip=fixer.run.clip.name, overwrite=True)
        return path
    with contextlib.suppress(OSError):
        path.unlink(missing_ok=True)
    return None


def open_track(folder: Path, person: str, frame: int, clip: Path | None = None) -> Run:
    """The track of a person in the film of a run that has this frame; `clip` is where the film is now.

    Raises InputError where the person is not seen in the frame, or the film is gone.
    """
    people, whole = people_in(folder), read_run(folder)
    track = next((each for each in people.tracks if each.person == person and each.first <= frame < each.stop), None)
    if track is None:
        raise InputError(f"{folder}: {person} is not seen in frame {frame}; facetrack people {folder} says who is when")
    where, how = film_of(people, whole, clip)
    if where is None or not where.exists():
        raise InputError(f"{where or folder}: the film is not there; name it with --clip")
    rows = choose(whole, person).between(track.first, track.stop)
    recipe = recipe_of(whole.path, whole.header["recipe"], [Path(), folder, folder.parent, where.parent])
    first = {part: rows.parts[k].take(slice(0, 1)) for k, (_, part) in enumerate(rows.names)}
    left, top, width, height = first[BOX].boxes[0].round(2).tolist()
    points = {part: (round(float(first[part].x[0]), 2), round(float(first[part].y[0]), 2)) for part in recipe.points}
    target = TargetStart((left, top, width, height), points)
    start = Start(track.first, {person: target}, ORIGIN, tuple(_by_hand(rows, person)))
    files = {form: (path, stamp(path)) for form, path in run_files(folder).items()}
    return Run(folder, rows, read_header(whole), recipe, start, where, how["fps"], files, film=True)


def _by_hand(rows: Trajectory, person: str) -> Iterator[Correction]:
    """The corrections that the rows say are by hand."""
    for frame in sorted({*rows.frame[rows.by_hand].tolist()} - {int(rows.frame[0])}):
        now = rows.at(frame)
        parts = [name for _, name in now.names]
        cells = zip(parts, now.status.tolist(), now.x.tolist(), now.y.tolist(), now.by_hand.tolist(), strict=True)
        hand = {part: (status, (x, y)) for part, status, x, y, by_hand in cells if by_hand}
        points = {part: place for part, (status, place) in hand.items() if status == "init" and part != BOX}
        absent = [part for part, (status, _) in hand.items() if status == "absent"]
        if points or absent:
            yield Correction(frame, person, points=points, absent=corrected.all_or(absent, parts))
        else:
            yield Correction(frame, person, confirmed=corrected.all_or([*hand], corrected.correctable_parts(parts)))


def _save_track(run: Run, rows: Trajectory, *, video: bool, report: Report, stop: Stopped) -> list[str]:
    """Write the film of a run with these rows of one of its tracks; a line on each file. Raises as `save` does."""
    folder, [person] = run.folder, rows.targets
    with FolderLease(folder) as lease:
        people, whole = people_in(folder), read_run(folder)
        if not any((span.person, span.first, span.stop) == (person, run.first, run.last + 1) for span in people.tracks):
            raise InputError(f"{folder}: who is who was changed meanwhile; open the page again")
        pieces = [choose(whole, name) for name in whole.targets]
        at = whole.targets.index(person)
        before, after = pieces[at].between(0, run.first), pieces[at].between(run.last + 1, int(whole.frame.max()) + 1)
        pieces[at : at + 1] = [piece for piece in (before, rows, after) if len(piece)]
        film = replace(successive(pieces), header=whole.header, path=whole.path)
        people = people.model_copy(update={"corrections": (*people.corrections, f"fix {person}@{run.first}f")})
        names = [*(record.still for record in people.people), *(record.still for record in people.tracks)]
        stills = {name: read_still(folder, name) for name in names if name}
        clip = run.clip if video and run.video is not None else None
        notes = write_people(folder, film, people, stills, clip, report, stop, lease)
    return [*(f"{path}: written" for path, _ in run.files.values()), *notes]
