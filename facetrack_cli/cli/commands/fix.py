"""facetrack fix: correct a finished run, on a page or by an init file."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import Page, flag, option, page_options, say
from facetrack_cli.cli.types import FILE, RUN, frame_at, moment
from facetrack_cli.core.errors import ExitCode, FacetrackError, UsageError

if TYPE_CHECKING:
    from facetrack_cli.core.types import Correction
    from facetrack_cli.editor.history import Fixer
    from facetrack_cli.run_folder.finished import Run
    from facetrack_cli.runs.signals import Stop
    from facetrack_cli.video.seek import Frames


@click.command()
@click.argument("folder", type=RUN)
@options.clip
@option("--init", type=FILE, help="No page: take the corrections of this init file, and no others.")
@option(
    "--import",
    "imported",
    type=FILE,
    help="No page: add what was corrected in CVAT (XML), Label Studio (JSON) or ELAN.",
)
@option(
    "--person", type=moment("NAME@TIME"),
    help="Of a film: the points of this person in the shot at a time (1:23, or 2075f).",
)  # fmt: skip
@flag("--no-video", help="Leave annotated.mp4 as it is.")
@page_options
@flag("--quiet", "-q", help="With --init: say nothing but errors.")
def command(
    folder: Path, clip: Path | None, init: Path | None, imported: Path | None, person: tuple[str, str] | None,
    no_video: bool, page: Page, quiet: bool,
) -> int:  # fmt: skip
    """Correct a finished run, on a page.

    RUN_DIR is the folder that facetrack run wrote, with JSON. The page shows the clip with its trajectory, and leads
    from one doubtful frame to the next. Where a part is wrong, drag it to its place, or mark it as absent: the target
    is tracked again from there to its next correction, and every other row stays the same, to the byte. Save writes the
    trajectories and the annotated video again, and RUN_DIR/corrected.init.yaml, with which facetrack run makes the same
    trajectory. The page goes on after it, until Done.

    The rows of a smoothed run are given the whole clip, so at Save all of it is tracked and smoothed again.

    Where a recipe has mutual exclusion, the corrected target avoids the others at their recorded places, and their rows
    stay; a whole run from the file moves them, too.

    With --import, the corrections are what differs from the run in a file of an annotation tool, to which facetrack
    export --to cvat, labelstudio or eaf has brought it: parts that were moved, and parts that were marked as not
    visible. Of ELAN's .eaf the segments of the tiers seen and absent count, and of a film the participants, who are the
    names of its people.

    The video is drawn from the rows, which do not hold the particles: they are no longer in it.

    \b
    Examples:
      facetrack fix out
      facetrack fix out --clip /archive/clip.mp4 --open
      facetrack fix out --init corrected.init.yaml --no-video
      facetrack fix out --import annotations.xml
      facetrack fix film --person Eileen@0:03

    \b
    Exit codes: 0 done, 2 usage or output, 3 input, 130 interrupted,
    143 terminated.
    """
    from facetrack_cli.editor.history import Fixer
    from facetrack_cli.run_folder.finished import check_size, open_run
    from facetrack_cli.runs.signals import Stop
    from facetrack_cli.trajectory.people import PEOPLE
    from facetrack_cli.video.seek import Frames

    if init is not None and imported is not None:
        raise UsageError("--import adds to the run's corrections, --init replaces them; leave one of them out")
    if (file := init or imported) is not None:
        page.refuse(f"leave it or {'--init' if init else '--import'} out")
    elif quiet:
        raise UsageError("--quiet goes with --init and --import; the page's address must be said")
    if imported is not None and imported.suffix.lower() == ".eaf" and (folder / PEOPLE).is_file():
        return _rename(folder, clip, imported, quiet, video=not no_video)
    opened = _track(folder, clip, *person) if person else open_run(folder, clip)
    with Frames(opened.clip, fps=opened.fps, stream=opened.header.source.stream) as frames:
        check_size(opened, frames.size)
        with contextlib.closing(Fixer(opened, frames.read)) as fixer, Stop().listening() as stop:
            if file is None:
                return _serve(fixer, frames, page, stop, video=not no_video)
            return _apply(fixer, file, stop, quiet, adds=init is None, video=not no_video)


def _track(folder: Path, clip: Path | None, name: str, at: str) -> Run:
    """The track of a person of a film."""
    from facetrack_cli.editor.save import open_track
    from facetrack_cli.runs.people import people_in, rows_in
    from facetrack_cli.trajectory.clock import Clock

    return open_track(folder, name, frame_at(at, Clock(rows_in(folder), people_in(folder).fps)), clip)


def _apply(fixer: Fixer, file: Path, stop: Stop, quiet: bool, *, adds: bool, video: bool) -> int:
    """Take the corrections of --init or --import, and save; the exit code."""
    from facetrack_cli.editor.history import corrections_of, merged
    from facetrack_cli.editor.import_annotations import imported_corrections
    from facetrack_cli.editor.save import save
    from facetrack_cli.runs.progress import progress
    from facetrack_cli.runs.signals import StoppedError
    from facetrack_cli.trajectory.header import UNSAVED

    folder = fixer.run.folder
    unsaved = folder / UNSAVED
    if unsaved.is_file() and not (file.is_file() and file.samefile(unsaved)):
        raise UsageError(
            f"{unsaved}: corrections that were not saved are there; facetrack fix {folder} goes on with them, "
            f"--init {unsaved} takes them; or remove it"
        )
    if not adds:
        corrections = corrections_of(file, fixer.run)
    elif not (corrections := imported_corrections(file, fixer.run, fixer.rows)):
        say(f"facetrack: {file} is as the run has it; nothing was written")
        return ExitCode.DONE
    else:
        parts = fixer.run.parts
        corrections = tuple(merged(one, fixer.find(one.frame, one.target), parts[one.target]) for one in corrections)
    with progress(quiet) as shown:
        try:
            shown.begin(folder.name or str(folder))
            (fixer.put if adds else fixer.apply)(corrections, report=shown.update, stop=stop)
            if adds:
                frames = ", ".join(str(frame) for frame in sorted({one.frame for one in corrections})[:10])
                count = f"{len(corrections)} correction{'s' if len(corrections) > 1 else ''}, in frames {frames}"
                shown.say(f"{file}: {count}; export the run again before more is corrected there")
            shown.begin("saving")
            for line in save(fixer, video=video, report=shown.update, stop=stop):
                shown.say(line)
        except StoppedError:
            shown.say(f"facetrack: {stop.reason}; {folder} is as it was")
            return stop.code or ExitCode.FAULT
    return ExitCode.DONE


def _rename(folder: Path, given: Path | None, file: Path, quiet: bool, *, video: bool) -> int:
    """Take the names that a film's people have in a file of ELAN; the exit code."""
    from functools import partial

    from facetrack_cli.editor.import_annotations import renames
    from facetrack_cli.runs.people import people_in, recast, rows_in
    from facetrack_cli.runs.progress import progress
    from facetrack_cli.runs.signals import Stop, StoppedError
    from facetrack_cli.trajectory.header import clip_of
    from facetrack_cli.trajectory.people import rename

    clip = given or clip_of(rows_in(folder))
    names = renames(file, people_in(folder).names, clip.name if clip else "")
    if not names:
        say(f"facetrack: {file} is as the run has it; nothing was written")
        return ExitCode.DONE
    changes = [(f"rename {one}={name}", partial(rename, name=one, to=name)) for one, name in names.items()]
    with Stop().listening() as stop, progress(quiet) as shown:
        try:
            recast(folder, changes, clip=given, video=video, report=shown.looked, stop=stop)
        except StoppedError:
            shown.say(f"facetrack: {stop.reason}; {folder} is as it was")
            return stop.code or ExitCode.FAULT
        shown.say(f"{folder}: {', '.join(f'{one} is {name}' for one, name in names.items())}")
    return ExitCode.DONE


def _serve(fixer: Fixer, frames: Frames, page: Page, stop: Stop, *, video: bool) -> int:
    """Serve the page until it is saved or stopped; the exit code."""
    from facetrack_cli.editor.history import corrections_of
    from facetrack_cli.editor.web.fix_session import FixSession
    from facetrack_cli.trajectory.header import UNSAVED

    folder = fixer.run.folder
    kept = folder / UNSAVED
    unsaved: tuple[Correction, ...] = ()
    try:
        if kept.is_file():
            unsaved = corrections_of(kept, fixer.run)
    except FacetrackError as e:  # they are not of this run any more
        say(f"facetrack: warning: {e}; the page begins without it")
    if unsaved:
        many = len(unsaved) > 1
        said = f"{len(unsaved)} corrections were" if many else "one correction was"
        say(f"{kept}: {said} not saved the last time; the page begins with {'them' if many else 'it'}")
    session = FixSession(fixer, frames, video=video, unsaved=unsaved)
    if not page.serve(session, stop):
        goes_on = f"all else is as it was; {fixer.run.fixed_by} goes on with them"
        none = "what was saved stays" if session.saves else "nothing was written"
        what = f"the corrections are kept in {kept}, {goes_on}" if kept.is_file() else none
        say(f"facetrack: {stop.reason}; {what}")
        return stop.code or ExitCode.FAULT
    return ExitCode.DONE
