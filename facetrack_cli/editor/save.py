"""Saves a corrected run: all files are written beside the old files, and then replace them together."""

import contextlib
from dataclasses import replace
from functools import partial
from pathlib import Path

from facetrack_cli.core.errors import OutputError
from facetrack_cli.editor.film_track import save_track
from facetrack_cli.editor.history import Fixer
from facetrack_cli.engine.loop import track
from facetrack_cli.engine.smoothing import Belief
from facetrack_cli.run_folder.finished import Run, stamp
from facetrack_cli.run_folder.manifest import FILTERED, outdated, read_manifest, write_rows
from facetrack_cli.runs.clip import past_end
from facetrack_cli.runs.plan import Report, silent
from facetrack_cli.runs.signals import Stopped, StoppedError, never
from facetrack_cli.runs.smooth import Write, given_all, repaint, replace_files
from facetrack_cli.start.assembly import tracker_for
from facetrack_cli.start.init_file import as_yaml, write_init
from facetrack_cli.trackers.smoothed import lagged
from facetrack_cli.trajectory.header import CORRECTED, UNSAVED
from facetrack_cli.trajectory.trajectory import Collector, Trajectory
from facetrack_cli.trajectory.writers import summary_of
from facetrack_cli.video.source import open_source


def save(fixer: Fixer, *, video: bool = True, report: Report = silent, stop: Stopped = never) -> list[str]:
    """Write the rows, the corrections, and with `video` the run's video, if it has one; a line on each file.

    Raises OutputError or InputError if a file cannot be written, StoppedError once `stop` says so; nothing is changed.
    """
    run, rows, folder = fixer.run, fixer.rows, fixer.run.folder
    if not fixer.changed:
        forget(run)
        return [f"{folder}: nothing was corrected, all is as it was"]
    if run.film:
        lines = save_track(run, rows, video=video, report=report, stop=stop)
        forget(run)
        fixer.saved()
        return lines
    files: dict[Path, Write] = {}
    if "smoothed" in rows.header:
        filtered, rows = _given_all(fixer, report, stop)
        if filtered is not None:
            files[folder / FILTERED] = partial(write_rows, "csv", rows=filtered)
    files |= {
        path: partial(write_rows, form, rows=rows, corrections=fixer.corrections)
        for form, (path, _) in run.files.items()
    }
    files[folder / CORRECTED] = lambda write: write(as_yaml(fixer.start, run.clip.name).encode())
    known = read_manifest(folder)
    ended = known and replace(known, lost_frames=summary_of(rows).lost_frames)
    paint = (
        partial(repaint, run.painted, rows=rows, report=report, stop=stop) if video and run.video is not None else None
    )
    written, notes = replace_files(folder, files, ended, [folder / UNSAVED], paint, lambda: _check(run))
    notes += past_end(fixer.corrections, run.last, str(folder / CORRECTED))
    if run.video is not None and not video:
        notes.append(f"{run.video}: left as it was, it shows the track of before")
    fixer.saved()
    return [*(f"{path}: written" for path in written), *notes, *outdated(folder)]


def _given_all(fixer: Fixer, report: Report, stop: Stopped) -> tuple[Trajectory | None, Trajectory]:
    """The rows of a smoothed run, whose clip is tracked again with the corrections: the filter's, and the smoothed.

    Of a run with a lag there are no others. Raises StoppedError once `stop` says so.
    """
    run, lag = fixer.run, fixer.run.rows.header["smoothed"]["lag"]
    collected, beliefs = Collector(), {name: list[tuple[Belief, ...]]() for name in run.rows.targets}
    total, stream = run.last - run.first + 1, run.header.source.stream
    with open_source(run.clip, fps=run.fps, start=run.first, stop=run.last + 1, stream=stream) as source:
        tracker = tracker_for(run.recipe, fixer.start, source.size, source.fps)
        results = track(tracker, iter(source), run.recipe.seed, clip=str(run.clip))
        for done, result in enumerate(lagged(results, lag) if lag else results, 1):
            if stop():
                raise StoppedError
            collected.add(result.rows)
            for name, target in zip(beliefs, () if lag else result.targets, strict=False):
                beliefs[name].append(() if target.beliefs is None else target.beliefs())
            report(done, total)
    rows = collected.trajectory(header=run.rows.header, path=run.rows.path)
    return (None, rows) if lag else (rows, given_all(rows, beliefs))


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
    if not fixer.changed:
        forget(fixer.run)
        return None
    write_init(path, fixer.start, clip=fixer.run.clip.name, overwrite=True)
    return path


def forget(run: Run) -> None:
    """Remove the file that `keep` wrote."""
    with contextlib.suppress(OSError):
        (run.folder / UNSAVED).unlink(missing_ok=True)
