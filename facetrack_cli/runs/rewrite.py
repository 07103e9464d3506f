"""Rewrites the files of a finished run: all of them, or none, and the video drawn again from rows."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.files import FULL, discard, temporary_path
from facetrack_cli.run_folder.finished import Run
from facetrack_cli.run_folder.lock import FolderLock, sweep
from facetrack_cli.run_folder.manifest import VIDEO, Manifest, commit
from facetrack_cli.runs.job import Report
from facetrack_cli.runs.signals import StoppedError
from facetrack_cli.trajectory.trajectory import FrameResult, Trajectory, recorded
from facetrack_cli.video.overlay.overlay import Overlay
from facetrack_cli.video.source import open_source
from facetrack_cli.video.writer import VideoWriter

Stop: TypeAlias = Callable[[], bool]
Write: TypeAlias = Callable[[Callable[[bytes], object]], object]  # writes one file by calls of `write(data)`


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
