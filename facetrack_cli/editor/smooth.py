"""A finished run smoothed: its rows given the whole clip, from what its filters knew (`run --keep-posterior`)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from facetrack_cli.core.claims import Claim
from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.files import beside, check_folder, discard, make_folder, remove_folders
from facetrack_cli.core.sets import sweep
from facetrack_cli.editor.retrack import Report, Stop, silent
from facetrack_cli.editor.run_folder import open_run, read_files, run_files, write_rows
from facetrack_cli.editor.save import repaint
from facetrack_cli.report.make import trajectory_of
from facetrack_cli.runs.job import VIDEO
from facetrack_cli.runs.posterior import POSTERIOR, read_posterior
from facetrack_cli.runs.signals import never
from facetrack_cli.tracking.smoothed import MotionName, smoothed_rows
from facetrack_cli.trajectory.manifest import FILTERED, OWNED, commit, outdated, read_manifest
from facetrack_cli.trajectory.select import choose
from facetrack_cli.trajectory.trajectory import Trajectory, successive
from facetrack_cli.trajectory.writers import Format


def smooth(run: str | Path, *, motion: MotionName = "recipe") -> Trajectory:
    """The rows of a run given all of its clip; `run` is the folder, made with `facetrack run --keep-posterior`.

    With `motion` "fitted" the noise of each part's motion is not the recipe's, but what the clip itself shows. Rows
    that were given by hand, and those of parts that are never seen again, stay. Nothing is written; `smoothed` in the
    header says how. Raises InputError for a folder without a JSON trajectory or posterior, or with damaged ones.
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
    """Write the smoothed run into `to`, None for its own folder; the files, warnings of its video, and a line on what
    is older now.

    It has the trajectories and, with `video`, the annotated video of the run, drawn again from `clip`. In its own
    folder the rows of before go to trajectory.filtered.csv, and the posterior is removed. Raises OutputError or
    InputError, StoppedError once `stop` says so; nothing is written then.
    """
    rows, place = _read(folder), folder if to is None else to
    drawn = video and (folder / VIDEO).is_file()
    forms = list(run_files(folder))
    if place.resolve() == folder.resolve():
        if not overwrite:
            raise OutputError(f"{folder}: has the filter's rows, which --overwrite replaces; or name a folder with -o")
    else:
        check_folder(place, OWNED, overwrite=overwrite, inputs=[])
    run = open_run(folder, clip) if drawn else None
    after, notes = _smoothed(folder, rows, motion), tuple[str, ...]()
    made = make_folder(place)
    files: list[Path] = []
    try:
        with Claim(place) as claim:
            sweep(place)
            if run is not None:
                files.append(place / VIDEO)
                notes = repaint(run, place / VIDEO, after, report, stop)
            texts: list[tuple[str, Format, Trajectory]] = [(f"trajectory.{form}", form, after) for form in forms]
            known = read_manifest(folder)
            stays = dict(known.files) if known is not None and place.resolve() == folder.resolve() else {}
            if place.resolve() == folder.resolve():
                texts.append((FILTERED, "csv", rows))
                stays.pop(POSTERIOR, None)  # what is smoothed is not smoothed again
            for name, form, those in texts:
                files.append(place / name)
                with beside(place / name).open("wb") as file:
                    write_rows(form, file.write, those)
            gone = [folder / POSTERIOR] * (place.resolve() == folder.resolve())
            ended = known and known.model_copy(update={"smoothed": True, "files": stays})
            commit(place, files, ended, gone, claim=claim)
    except OSError as e:
        remedy = "free some space, or make it writable"
        raise OutputError(f"{e.filename or files[-1]}: cannot be written: {e.strerror or e}; {remedy}") from e
    finally:
        for path in files:
            discard(path)
        remove_folders(made)
    return files, (*notes, *outdated(place))


def _read(folder: Path) -> Trajectory:
    """The run's rows, finished if a save was interrupted."""
    trajectory_of(folder)
    return read_files(run_files(folder))


def _smoothed(folder: Path, rows: Trajectory, motion: MotionName) -> Trajectory:
    if not (folder / POSTERIOR).exists():
        raise InputError(f"{folder}: has no {POSTERIOR}; run again with --keep-posterior, or --smooth")
    beliefs = read_posterior(folder / POSTERIOR, rows)
    pieces = [smoothed_rows(choose(rows, name), beliefs[name], motion) for name in rows.targets]
    after = successive(pieces, rows)
    return replace(after, header={**rows.header, "smoothed": {"motion": motion}})
