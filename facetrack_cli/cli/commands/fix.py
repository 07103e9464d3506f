"""facetrack fix: correct a finished run, on a page or by an init file."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FILE, Page, flag, option, say
from facetrack_cli.core.errors import ExitCode, FacetrackError, UsageError

if TYPE_CHECKING:
    from facetrack_cli.core.types import Correction
    from facetrack_cli.editor.history import Fixer
    from facetrack_cli.runs.signals import Stop
    from facetrack_cli.video.seek import Frames


@click.command()
@click.argument("run", metavar="RUN_DIR", type=FILE)
@options.clip
@option("--init", "FILE", "No page: take the corrections of this init file, and no others.", type=FILE)
@flag("--no-video", "Leave annotated.mp4 as it is.")
@options.page
@flag("--quiet -q", "With --init: say nothing but errors.")
def command(run: Path, clip: Path | None, init: Path | None, no_video: bool, page: Page, quiet: bool) -> int:
    """Correct a finished run, on a page.

    RUN_DIR is the folder that facetrack run wrote, with JSON. The page shows the clip with its trajectory, and leads
    from one doubtful frame to the next. Where a part is wrong, drag it to its place, or mark it as absent: the target
    is tracked again from there to its next correction, and every other row stays the same, to the byte. Save writes the
    trajectories and the annotated video again, and RUN_DIR/corrected.init.yaml, with which facetrack run makes the same
    trajectory.

    Where a recipe has mutual exclusion, the corrected target avoids the others at their recorded places, and their rows
    stay; a whole run from the file moves them, too.

    The video is drawn from the rows, which do not hold the particles: they are no longer in it.

    \b
    Examples:
      facetrack fix out
      facetrack fix out --clip /archive/clip.mp4 --open
      facetrack fix out --init corrected.init.yaml --no-video

    \b
    Exit codes: 0 done, 2 usage or output, 3 input, 130 interrupted,
    143 terminated.
    """
    from facetrack_cli.editor.files.run_folder import check_size, check_writable, open_run
    from facetrack_cli.editor.history import Fixer
    from facetrack_cli.runs.signals import Stop
    from facetrack_cli.video.seek import Frames

    if init is not None:
        page.refuse("leave it or --init out")
    elif quiet:
        raise UsageError("--quiet goes with --init; the page's address must be said")
    with open_run(run, clip) as opened, Frames(opened.clip, fps=opened.fps) as frames:
        check_size(opened, frames.size)
        check_writable(opened)
        with contextlib.closing(Fixer(opened, frames.read)) as fixer, Stop().listening() as stop:
            if init is not None:
                return _apply(fixer, init, stop, video=not no_video, quiet=quiet)
            return _serve(fixer, frames, stop, page, video=not no_video)


def _apply(fixer: Fixer, init: Path, stop: Stop, *, video: bool, quiet: bool) -> int:
    """Take the corrections of a file, and save; the exit code."""
    from facetrack_cli.editor.files.run_folder import UNSAVED
    from facetrack_cli.editor.history import corrections_of
    from facetrack_cli.editor.retrack import StoppedError
    from facetrack_cli.editor.save import save
    from facetrack_cli.runs.progress import progress

    folder = fixer.run.folder
    unsaved = folder / UNSAVED
    if unsaved.is_file() and not (init.is_file() and init.samefile(unsaved)):
        raise UsageError(
            f"{unsaved}: corrections that were not saved are there; facetrack fix {folder} goes on with them, "
            f"--init {unsaved} takes them; or remove it"
        )
    corrections = corrections_of(init, fixer.run)
    with contextlib.closing(progress(quiet)) as shown:
        try:
            shown.begin(folder.name or str(folder), "frames", None)
            fixer.apply(corrections, report=shown.update, stop=stop)
            shown.begin("saving", "frames", None)
            said = save(fixer, video=video, report=shown.update, stop=stop)
        except StoppedError:
            shown.say(f"facetrack: {stop.reason}; {folder} is as it was")
            return stop.code or ExitCode.FAULT
        for line in said:
            shown.say(line)
    return ExitCode.DONE


def _serve(fixer: Fixer, frames: Frames, stop: Stop, page: Page, *, video: bool) -> int:
    """Serve the page until it is saved or stopped; the exit code."""
    from facetrack_cli.editor.files.run_folder import UNSAVED
    from facetrack_cli.editor.web.fix_session import FixSession
    from facetrack_cli.editor.web.pictures import Pictures
    from facetrack_cli.editor.web.serve import run_page

    folder = fixer.run.folder
    kept = folder / UNSAVED
    unsaved = _unsaved(fixer, kept)
    if unsaved:
        many = len(unsaved) > 1
        said = f"{len(unsaved)} corrections were" if many else "one correction was"
        say(f"{kept}: {said} not saved the last time; the page begins with {'them' if many else 'it'}")
    session = FixSession(fixer, frames, Pictures(frames), video=video, unsaved=unsaved)
    run_page(session, stop, say, port=page.port or 0, browse=page.browse)
    if session.ended is None:
        goes_on = f"all else is as it was; facetrack fix {folder} goes on with them"
        what = f"the corrections are kept in {kept}, {goes_on}" if kept.is_file() else "nothing was written"
        say(f"facetrack: {stop.reason}; {what}")
        return stop.code or ExitCode.FAULT
    for line in (*session.ended["said"], f"next: {session.ended['next']}"):
        say(line)
    return ExitCode.DONE


def _unsaved(fixer: Fixer, path: Path) -> tuple[Correction, ...]:
    """The corrections of a session that was not saved, if they still are of this run."""
    from facetrack_cli.editor.history import corrections_of

    if not path.is_file():
        return ()
    try:
        return corrections_of(path, fixer.run)
    except FacetrackError as e:
        say(f"facetrack: warning: {e}; the page begins without it")
        return ()
