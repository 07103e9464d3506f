"""Saves a corrected run: all files are written beside the old files, and then replace them together.

In the film of a run the track of one person in one shot is corrected as a run of its own: its start is its first row,
and its corrections are what its rows say is by hand. Saved, its rows take their place in the film's; who is who stays.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.types import BOX, Correction, Start, TargetStart
from facetrack_cli.editor.history import Fixer
from facetrack_cli.engine.corrected import all_or, correctable_parts
from facetrack_cli.engine.loop import track
from facetrack_cli.engine.protocols import Belief
from facetrack_cli.recipe.model import ParticleRecipe, ParticlesRecipe
from facetrack_cli.run_folder.lease import FolderLease
from facetrack_cli.run_folder.manifest import FILTERED, outdated, read_run, write_rows
from facetrack_cli.runs.clip import past_end
from facetrack_cli.runs.finished import Run, Write, given_all, recipe_of, rewrite, run_files, stamp
from facetrack_cli.runs.people import ORIGIN, film_of, people_in, write_people
from facetrack_cli.runs.plan import Report, silent
from facetrack_cli.runs.signals import Stopped, StoppedError, never
from facetrack_cli.start.assembly import tracker_for
from facetrack_cli.start.init_file import as_yaml, write_init
from facetrack_cli.trackers.smoothed import lagged
from facetrack_cli.trajectory.people import read_still
from facetrack_cli.trajectory.reader import CORRECTED, UNSAVED, corrections_record, read_header
from facetrack_cli.trajectory.trajectory import Collector, Trajectory, successive
from facetrack_cli.trajectory.views import choose
from facetrack_cli.trajectory.writers import as_written, summary_of
from facetrack_cli.video.source import open_source


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
        results = track(tracker, iter(source), run.recipe.seed, clip=str(run.clip))
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
            yield Correction(frame, person, points=points, absent=all_or(absent, parts))
        else:
            yield Correction(frame, person, confirmed=all_or([*hand], correctable_parts(parts)))


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
