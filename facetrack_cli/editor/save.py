"""Saves a corrected run: all files are written beside the old files, and then replace them together."""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeAlias

from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.files import FULL, discard, temporary_path
from facetrack_cli.editor.history import Fixer
from facetrack_cli.editor.retrack import Report, Stop, silent
from facetrack_cli.editor.run_folder import Run, stamp, write_rows
from facetrack_cli.run_folder.lock import FolderLock, sweep
from facetrack_cli.run_folder.manifest import VIDEO, Manifest, commit, outdated, read_manifest
from facetrack_cli.runs.clip import past_end
from facetrack_cli.runs.signals import StoppedError, never
from facetrack_cli.tracking.start import write_init
from facetrack_cli.tracking.start.init_file import as_yaml
from facetrack_cli.trajectory.header import CORRECTED, UNSAVED
from facetrack_cli.trajectory.trajectory import FrameResult, Trajectory, recorded
from facetrack_cli.trajectory.writers import ending_of
from facetrack_cli.video.overlay.overlay import Overlay
from facetrack_cli.video.source import open_source
from facetrack_cli.video.writer import VideoWriter

Write: TypeAlias = Callable[[Callable[[bytes], object]], object]  # writes one file by calls of `write(data)`


def save(fixer: Fixer, *, video: bool = True, report: Report = silent, stop: Stop = never) -> list[str]:
    """Write the rows, the corrections, and with `video` the run's video, if it has one; a line on each file.

    Raises OutputError or InputError if a file cannot be written, StoppedError once `stop` says so; the folder is then
    as it was.
    """
    run, rows, folder = fixer.run, fixer.rows, fixer.run.folder
    if not fixer.changed:
        forget(run)
        return [f"{folder}: nothing was corrected, all is as it was"]
    files: dict[Path, Write] = {
        path: partial(write_rows, form, rows=rows, corrections=fixer.corrections)
        for form, (path, _) in run.files.items()
    }
    files[folder / CORRECTED] = lambda write: write(as_yaml(fixer.start, run.clip.name).encode())
    known = read_manifest(folder)
    ended = known and replace(known, lost_frames=ending_of(rows).lost_frames)
    paint = partial(repaint, run, rows=rows, report=report, stop=stop) if video and run.video is not None else None
    written, notes = replace_files(folder, files, ended, [folder / UNSAVED], paint, lambda: _check(run))
    notes += past_end(fixer.corrections, run.last, str(folder / CORRECTED))
    if run.video is not None and not video:
        notes.append(f"{run.video}: left as it was, it shows the track of before")
    return [*(f"{path}: written" for path in written), *notes, *outdated(folder)]


def replace_files(
    folder: Path,
    files: Mapping[Path, Write],
    ended: Manifest | None,
    gone: Sequence[Path] = (),
    paint: Callable[[Path], Sequence[str]] | None = None,
    check: Callable[[], None] = lambda: None,
) -> tuple[list[Path], list[str]]:
    """Write all files of a run's `folder`, then let them replace the old ones together; the files, and warnings.

    Each value of `files` writes one file by calls of `write(data)`. `paint` draws the video into its temporary file.
    `check` raises, at the beginning and before anything is replaced, if the folder has changed. `ended` is the new
    run.json, `gone` are files to remove. OutputError for a file that cannot be written; the folder is then as it was.
    """
    written: list[Path] = []
    notes: list[str] = []
    try:
        with FolderLock(folder) as lock:
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


def _check(run: Run) -> None:
    """OutputError if a file of the run has changed since it was opened, or a folder has the name of a file."""
    for path, opened in run.files.values():
        if stamp(path) != opened:
            raise OutputError(f"{path}: was written by somebody else since it was opened; begin again")
    if (run.folder / CORRECTED).is_dir():
        raise OutputError(f"{run.folder / CORRECTED}: is a folder, where a file is to be; move it away, and save again")


def repaint(run: Run, path: Path, rows: Trajectory, report: Report, stop: Stop) -> tuple[str, ...]:
    """Write the annotated video into its temporary file, without particles, which rows do not have; its warnings.

    Raises StoppedError once `stop` says so, InputError if the clip lacks frames of the run; nothing is written then.
    """
    total, done = run.last - run.first + 1, 0
    with open_source(run.clip, fps=run.fps, start=run.first, stop=run.last + 1) as source:
        overlay = Overlay(source.size, fps=float(source.fps), title=run.recipe.name)
        sound = source.path if source.is_video else None
        video = VideoWriter(path, source.size, source.fps, audio_from=sound, replace=False)
        try:
            for done, frame in enumerate(source, 1):
                if stop():
                    raise StoppedError
                video.write(overlay.draw(FrameResult(frame, recorded(frame.index, rows.at(frame.index)))), frame.time_s)
                report(done, total)
            if done < total:
                missing = run.first + done
                raise InputError(f"{run.clip}: has no frame {missing}, which the run has; name its clip with --clip")
        except BaseException:
            video.discard()
            raise
        video.close()
        return tuple(video.warnings)


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
