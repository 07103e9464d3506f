"""Smooths a finished run: each row is estimated from the whole clip, by the posterior of `run --keep-posterior`."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.files import check_folder, make_folder, remove_folders
from facetrack_cli.run_folder.finished import open_run, read_files, run_files, write_rows
from facetrack_cli.run_folder.manifest import FILTERED, OWNED, POSTERIOR, VIDEO, outdated, read_manifest
from facetrack_cli.run_folder.recovery import trajectory_of
from facetrack_cli.runs.job import Report, silent
from facetrack_cli.runs.posterior import read_posterior
from facetrack_cli.runs.rewrite import Stop, repaint, replace_files
from facetrack_cli.runs.signals import never
from facetrack_cli.tracking.smoothed import MotionName, smoothed_rows
from facetrack_cli.trajectory.select import choose
from facetrack_cli.trajectory.trajectory import Trajectory, successive


def smooth(run: str | Path, *, motion: MotionName = "recipe") -> Trajectory:
    """The rows of a run estimated from its whole clip; `run` is the folder, made with `facetrack run --keep-posterior`.

    With `motion` "fitted" the noise of each part's motion is estimated from the clip, not taken from the recipe. Rows
    that were given by hand stay, and so do rows of a part that is never seen again. Nothing is written; `smoothed` in
    the header says how. Raises InputError for a folder without a JSON trajectory or posterior, or with damaged ones.
    """
    folder = Path(run)
    return _smoothed(folder, _read(folder), motion)


def save_smoothed(
    folder: Path,
    to: Path | None = None,
    *,
    motion: MotionName = "recipe",
    overwrite: bool = False,
    video: bool = True,
    clip: Path | None = None,
    report: Report = silent,
    stop: Stop = never,
) -> tuple[list[Path], tuple[str, ...]]:
    """Write the smoothed run into `to`, None for its own folder; the files, and warnings, also on outdated files.

    The trajectories are written and, with `video`, the annotated video of the run, drawn again from `clip`. In its own
    folder the filter's rows are kept in trajectory.filtered.csv, and the posterior is removed. Raises OutputError or
    InputError, StoppedError once `stop` says so; nothing is written then.
    """
    rows, place = _read(folder), folder if to is None else to
    drawn = video and (folder / VIDEO).is_file()
    in_place = place.resolve() == folder.resolve()
    if not in_place:
        check_folder(place, OWNED, overwrite=overwrite, inputs=[])
    elif not overwrite:
        raise OutputError(f"{folder}: has the filter's rows, which --overwrite replaces; or name a folder with -o")
    run = open_run(folder, clip) if drawn else None
    after = _smoothed(folder, rows, motion)
    files = {
        place / f"trajectory.{form}": partial(write_rows, form, rows=after, corrections=None)
        for form in run_files(folder)
    }
    known = read_manifest(folder)
    stays = dict(known.files) if known is not None and in_place else {}
    if in_place:
        files[place / FILTERED] = partial(write_rows, "csv", rows=rows)
        stays.pop(POSTERIOR, None)  # smoothed rows are not smoothed again
    ended = known and replace(known, smoothed=True, files=stays)
    paint = None if run is None else partial(repaint, run, rows=after, report=report, stop=stop)
    made = make_folder(place)
    try:
        written, notes = replace_files(place, files, ended, [folder / POSTERIOR] if in_place else [], paint)
    finally:
        remove_folders(made)
    return written, (*notes, *outdated(place))


def _read(folder: Path) -> Trajectory:
    """The run's rows. A save that was interrupted is finished first."""
    trajectory_of(folder)
    return read_files(run_files(folder))


def _smoothed(folder: Path, rows: Trajectory, motion: MotionName) -> Trajectory:
    if not (folder / POSTERIOR).exists():
        raise InputError(f"{folder}: has no {POSTERIOR}; run again with --keep-posterior, or --smooth")
    beliefs = read_posterior(folder / POSTERIOR, rows)
    pieces = [smoothed_rows(choose(rows, name), beliefs[name], motion) for name in rows.targets]
    after = successive(pieces, rows)
    return replace(after, header={**rows.header, "smoothed": {"motion": motion}})
