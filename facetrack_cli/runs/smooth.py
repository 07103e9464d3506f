"""The files of a finished run, written again: all of them, or none, with the video drawn again from rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeAlias

from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.files import FULL, check_plain, discard, temporary_path
from facetrack_cli.run_folder.finished import Painted, open_run, read_files, run_files, write_rows
from facetrack_cli.run_folder.lease import FolderLease, sweep
from facetrack_cli.run_folder.manifest import (
    FILTERED,
    POSTERIOR,
    VIDEO,
    Manifest,
    commit,
    outdated,
    read_manifest,
    trajectory_of,
)
from facetrack_cli.runs.job import Report
from facetrack_cli.runs.posterior import read_posterior
from facetrack_cli.runs.signals import Stopped, StoppedError
from facetrack_cli.tracking.smoothed import Beliefs, renamed_hands, smoothed_rows
from facetrack_cli.trajectory.select import choose
from facetrack_cli.trajectory.trajectory import FrameResult, Trajectory, recorded, successive
from facetrack_cli.video.overlay.overlay import Overlay
from facetrack_cli.video.source import open_source
from facetrack_cli.video.writer import VideoWriter

Write: TypeAlias = Callable[[Callable[[bytes], object]], object]  # writes one file by calls of `write(data)`


def save_smoothed(folder: Path, clip: Path, report: Report, stop: Stopped) -> tuple[list[Path], tuple[str, ...]]:
    """Smooth a run of `clip` in its folder, with its video; the files, and warnings, also on outdated files.

    The filter's rows are kept in trajectory.filtered.csv, and the posterior is removed. Raises OutputError or
    InputError, StoppedError once `stop` says so; nothing is written then.
    """
    trajectory_of(folder)  # a save that was interrupted is finished first
    rows = read_files(run_files(folder))
    after = given_all(rows, read_posterior(folder / POSTERIOR, rows))
    files = {folder / FILTERED: partial(write_rows, "csv", rows=rows)}
    files |= {path: partial(write_rows, form, rows=after) for form, path in run_files(folder).items()}
    known = read_manifest(folder)
    stays = {name: one for name, one in known.files.items() if name != POSTERIOR} if known else {}
    ended = known and replace(known, smoothed=True, files=stays)
    paint = None
    if (folder / VIDEO).is_file():
        paint = partial(repaint, open_run(folder, clip).painted, rows=after, report=report, stop=stop)
    written, notes = replace_files(folder, files, ended, [folder / POSTERIOR], paint)
    return written, (*notes, *outdated(folder))


def given_all(rows: Trajectory, beliefs: Mapping[str, Beliefs]) -> Trajectory:
    """The rows of a filter, given the whole clip, by the `beliefs` of each target in each frame."""
    rows, beliefs = renamed_hands(rows, beliefs)
    after = successive([smoothed_rows(choose(rows, name), beliefs[name]) for name in rows.targets], rows)
    return replace(after, header={**rows.header, "smoothed": {"lag": None}})


def replace_files(
    folder: Path,
    files: Mapping[Path, Write],
    ended: Manifest | None,
    gone: Sequence[Path] = (),
    paint: Callable[[Path], Sequence[str]] | None = None,
    check: Callable[[], None] = lambda: None,
    lock: FolderLease | None = None,
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
        with nullcontext(lock) if lock else FolderLease(folder) as lock:
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
