"""What is corrected into the run's folder: all files are written beside the old ones, and then replace them."""

import contextlib
from pathlib import Path

from facetrack_cli.core.claims import Claim
from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.files import FULL, beside, discard
from facetrack_cli.core.sets import sweep
from facetrack_cli.editor.history import Fixer
from facetrack_cli.editor.retrack import Report, Stop, silent
from facetrack_cli.editor.run_folder import Run, stamp, write_rows
from facetrack_cli.runs.clip import past_end
from facetrack_cli.runs.signals import StoppedError, never
from facetrack_cli.tracking.start import write_init
from facetrack_cli.tracking.start.init_file import as_yaml
from facetrack_cli.trajectory.header import CORRECTED, UNSAVED
from facetrack_cli.trajectory.manifest import commit, outdated, read_manifest
from facetrack_cli.trajectory.trajectory import FrameResult, Trajectory, recorded
from facetrack_cli.trajectory.writers import footer_of
from facetrack_cli.video.overlay.overlay import Overlay
from facetrack_cli.video.source import open_source
from facetrack_cli.video.writer import VideoWriter


def save(fixer: Fixer, *, video: bool = True, report: Report = silent, stop: Stop = never) -> list[str]:
    """Write the rows of now, the corrections, and with `video` the video, if the run has one; a line on each file.
    Raises OutputError or InputError if something cannot be written, StoppedError once `stop` says so; the folder is
    then as it was.
    """
    run = fixer.run
    if not fixer.changed:
        forget(run)
        return [f"{run.folder}: nothing was corrected, all is as it was"]
    with Claim(run.folder) as claim:
        return _save(fixer, claim, video, report, stop)


def _save(fixer: Fixer, claim: Claim, video: bool, report: Report, stop: Stop) -> list[str]:
    run, rows = fixer.run, fixer.rows
    _check(run)
    files: list[Path] = []
    notes: list[str] = []
    at = run.folder
    try:
        sweep(run.folder)
        if run.video is not None and video:
            files.append(run.video)
            notes += repaint(run, run.video, rows, report, stop)
        for form, (path, _) in run.files.items():
            at = path
            files.append(at)
            with beside(at).open("wb") as file:
                write_rows(form, file.write, rows, fixer.corrections)
        at = run.folder / CORRECTED
        files.append(at)
        beside(at).write_bytes(as_yaml(fixer.start, run.clip.name).encode())
        _check(run)
        known = read_manifest(run.folder)
        ended = known and known.model_copy(update={"lost_frames": footer_of(rows).lost_frames})
        commit(run.folder, files, ended, [run.folder / UNSAVED], claim=claim)
    except BaseException as e:
        for path in files:
            discard(path)
        if not isinstance(e, OSError):
            raise
        remedy = "free some space" if e.errno in FULL else "make it writable"
        raise OutputError(f"{at}: cannot be written: {e.strerror or e}; {remedy}, and save again") from e
    notes += past_end(fixer.corrections, run.last, str(run.folder / CORRECTED))
    if run.video is not None and not video:
        notes.append(f"{run.video}: left as it was, it shows the track of before")
    return [*(f"{path}: written" for path in files), *notes, *outdated(run.folder)]


def _check(run: Run) -> None:
    """OutputError if what is to be replaced is not what was opened, or no file."""
    for path, opened in run.files.values():
        if stamp(path) != opened:
            raise OutputError(f"{path}: was written by somebody else since it was opened; begin again")
    if (run.folder / CORRECTED).is_dir():
        raise OutputError(f"{run.folder / CORRECTED}: is a folder, where a file is to be; move it away, and save again")


def repaint(run: Run, path: Path, rows: Trajectory, report: Report, stop: Stop) -> tuple[str, ...]:
    """Write the annotated video `beside` its path, without particles, which rows do not have; its warnings. Raises
    StoppedError once `stop` says so, InputError if the clip lacks frames of the run; nothing is written then.
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
    """Write the corrections that are not saved, for the next time; None if there are none. Raises OutputError."""
    path = fixer.run.folder / UNSAVED
    if not fixer.changed:
        forget(fixer.run)
        return None
    write_init(path, fixer.start, clip=fixer.run.clip.name, overwrite=True)
    return path


def forget(run: Run) -> None:
    """Remove what `keep` wrote."""
    with contextlib.suppress(OSError):
        (run.folder / UNSAVED).unlink(missing_ok=True)
