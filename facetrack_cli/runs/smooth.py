"""The files of a finished run, written again: all of them, or none, with the video drawn anew from rows.

`smooth` estimates each row from the whole clip, by the posterior of `run --keep-posterior`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeAlias

from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.files import (
    FULL,
    check_folder,
    check_plain,
    discard,
    make_folder,
    remove_folders,
    temporary_path,
)
from facetrack_cli.run_folder.finished import Painted, open_run, read_files, run_files, write_rows
from facetrack_cli.run_folder.lock import FolderLock, sweep
from facetrack_cli.run_folder.manifest import (
    FILTERED,
    OWNED,
    POSTERIOR,
    VIDEO,
    Manifest,
    commit,
    outdated,
    read_manifest,
    trajectory_of,
)
from facetrack_cli.runs.job import Report, silent
from facetrack_cli.runs.posterior import read_posterior
from facetrack_cli.runs.signals import Stopped, StoppedError, never
from facetrack_cli.tracking.smoothed import renamed_hands, smoothed_rows
from facetrack_cli.trajectory.select import choose
from facetrack_cli.trajectory.trajectory import FrameResult, Trajectory, recorded, successive
from facetrack_cli.video.overlay.overlay import Overlay
from facetrack_cli.video.source import open_source
from facetrack_cli.video.writer import VideoWriter

Write: TypeAlias = Callable[[Callable[[bytes], object]], object]  # writes one file by calls of `write(data)`


def smooth(run: str | Path) -> Trajectory:
    """The rows of a run estimated from its whole clip; `run` is the folder, made with `facetrack run --keep-posterior`.

    Rows that were given by hand stay, and so do rows of a part that is never seen again. Nothing is written;
    `smoothed` in the header says so. Raises InputError for a folder without a JSON trajectory or posterior, or with
    damaged ones.
    """
    folder = Path(run)
    return _smoothed(folder, _read(folder))


def save_smoothed(
    folder: Path,
    to: Path | None = None,
    *,
    overwrite: bool = False,
    video: bool = True,
    clip: Path | None = None,
    report: Report = silent,
    stop: Stopped = never,
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
    after = _smoothed(folder, rows)
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
    paint = None if run is None else partial(repaint, run.painted, rows=after, report=report, stop=stop)
    made = make_folder(place)
    try:
        written, notes = replace_files(place, files, ended, [place / POSTERIOR] if in_place else [], paint)
    finally:
        remove_folders(made)
    return written, (*notes, *outdated(place))


def _read(folder: Path) -> Trajectory:
    """The run's rows. A save that was interrupted is finished first."""
    trajectory_of(folder)
    return read_files(run_files(folder))


def _smoothed(folder: Path, rows: Trajectory) -> Trajectory:
    if not (folder / POSTERIOR).exists():
        raise InputError(f"{folder}: has no {POSTERIOR}; run again with --keep-posterior, or --smooth")
    rows, beliefs = renamed_hands(rows, read_posterior(folder / POSTERIOR, rows))
    pieces = [smoothed_rows(choose(rows, name), beliefs[name]) for name in rows.targets]
    after = successive(pieces, rows)
    return replace(after, header={**rows.header, "smoothed": {"lag": None}})


def replace_files(
    folder: Path,
    files: Mapping[Path, Write],
    ended: Manifest | None,
    gone: Sequence[Path] = (),
    paint: Callable[[Path], Sequence[str]] | None = None,
    check: Callable[[], None] = lambda: None,
    lock: FolderLock | None = None,
) -> tuple[list[Path], list[str]]:
    """Write all files of a run's `folder`, then let them replace the old ones together; the files, and warnings.

    Each value of `files` writes one file by calls of `write(data)`. `paint` draws the video into its temporary file.
    `check` raises, at the beginning and before anything is replaced, if the folder has changed; `lock` is the folder's,
    if it is held. `ended` is the new run.json, `gone` are files to remove. OutputError for a file that cannot be
    written; the folder is then as it was.
    """
    written: list[Path] = []
    notes: list[str] = []
    check_plain(folder / VIDEO, *files)
    try:
        with nullcontext(lock) if lock else FolderLock(folder) as lock:
            check()
            sweep(folder)
            if paint is not None:
                written.append(folder / VIDEO)
                notes += paint(folder / VIDEO)
            for path, write in files.items():
                written.append(path)
                with temporary_path(path).open("wb") as file:
                    write(file.write)
            check()
            commit(lock, folder, written, ended, gone)
    except OSError as e:
        remedy = "free some space" if e.errno in FULL else "make it writable"
        at = written[-1] if written else folder
        raise OutputError(f"{at}: cannot be written: {e.strerror or e}; {remedy}, and save again") from e
    finally:
        for path in written:
            discard(path)
    return written, notes


def repaint(
    on: Painted, path: Path, rows: Trajectory, report: Report, stop: Stopped, order: Sequence[str] = ()
) -> tuple[str, ...]:
    """Write the annotated video into its temporary file, without particles, which rows do not have; its warnings.

    Targets have the colours of their places in `order`.

    Raises StoppedError once `stop` says so, InputError if the clip lacks frames of the run; nothing is written then.
    """
    total, done = on.last - on.first + 1, 0
    with open_source(on.clip, fps=on.fps, start=on.first, stop=on.last + 1, stream=on.stream) as source:
        overlay = Overlay(source.size, fps=float(source.fps), title=on.title, order=order)
        sound = source.path if source.is_video else None
        video = VideoWriter(path, source.size, source.fps, source.aspect, audio_from=sound, replace=False)
        try:
            for done, frame in enumerate(source, 1):
                if stop():
                    raise StoppedError
                video.write(overlay.draw(FrameResult(frame, recorded(frame.index, rows.at(frame.index)))), frame.time_s)
                report(done, total)
            if done < total:
                missing = on.first + done
                raise InputError(f"{on.clip}: has no frame {missing}, which the run has; name its clip with --clip")
        except BaseException:
            video.discard()
            raise
        video.close()
        return tuple(video.warnings)
