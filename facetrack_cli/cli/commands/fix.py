"""facetrack fix: correct a finished run, on a page or by an init file."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING

from facetrack_cli.cli import options
from facetrack_cli.cli.moments import at_moment, frame_at
from facetrack_cli.cli.options import FILE, Page, argument, flag, group, option, say, verb
from facetrack_cli.core.errors import ExitCode, FacetrackError, UsageError

if TYPE_CHECKING:
    from facetrack_cli.core.types import Correction
    from facetrack_cli.editor.history import Fixer
    from facetrack_cli.run_folder.finished import Run
    from facetrack_cli.runs.signals import Stop
    from facetrack_cli.video.seek import Frames


class Fix:
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
    export --to cvat or labelstudio has brought it: parts that were moved, and parts that were marked as not visible.

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

    folder: Path = argument("RUN_DIR")
    clip: Path | None = options.CLIP
    init: Path | None = option(
        "--init FILE", "No page: take the corrections of this init file, and no others.", type=FILE
    )
    imported: Path | None = option(
        "--import FILE", "No page: add what was corrected in CVAT (XML) or Label Studio (JSON).", type=FILE
    )
    person: tuple[str, str] | None = option(
        "--person NAME@TIME",
        "Of a film: the points of this person in the shot at a time (1:23, or 2075f).",
        type=at_moment,
    )
    no_video: bool = flag("--no-video", "Leave annotated.mp4 as it is.")
    page: Page = group(Page)
    quiet: bool = flag("--quiet -q", "With --init: say nothing but errors.")

    def run(self) -> int:
        from facetrack_cli.editor.history import Fixer
        from facetrack_cli.run_folder.finished import check_size, open_run
        from facetrack_cli.runs.signals import Stop
        from facetrack_cli.video.seek import Frames

        if self.init is not None and self.imported is not None:
            raise UsageError("--import adds to the run's corrections, --init replaces them; leave one of them out")
        if (file := self.init or self.imported) is not None:
            self.page.refuse(f"leave it or {'--init' if self.init else '--import'} out")
        elif self.quiet:
            raise UsageError("--quiet goes with --init and --import; the page's address must be said")
        opened = self._track(*self.person) if self.person else open_run(self.folder, self.clip)
        with Frames(opened.clip, fps=opened.fps, stream=opened.header.source.stream) as frames:
            check_size(opened, frames.size)
            with contextlib.closing(Fixer(opened, frames.read)) as fixer, Stop().listening() as stop:
                code = self._serve(fixer, frames, stop) if file is None else self._apply(fixer, file, stop)
        return code

    def _track(self, name: str, at: str) -> Run:
        """The track of a person of a film."""
        from facetrack_cli.editor.film_track import open_track
        from facetrack_cli.runs.people import people_in, rows_in
        from facetrack_cli.trajectory.clock import Clock

        frame = frame_at(at, Clock(rows_in(self.folder), people_in(self.folder).fps))
        return open_track(self.folder, name, frame, self.clip)

    def _apply(self, fixer: Fixer, file: Path, stop: Stop) -> int:
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
        if self.imported is None:
            corrections = corrections_of(file, fixer.run)
        elif not (corrections := imported_corrections(file, fixer.run, fixer.rows)):
            say(f"facetrack: {file} is as the run has it; nothing was written")
            return ExitCode.DONE
        else:
            parts = fixer.run.parts
            corrections = tuple(
                merged(one, fixer.find(one.frame, one.target), parts[one.target]) for one in corrections
            )
        with progress(self.quiet) as shown:
            try:
                shown.begin(folder.name or str(folder))
                (fixer.apply if self.imported is None else fixer.put)(corrections, report=shown.update, stop=stop)
                if self.imported is not None:
                    frames = ", ".join(str(frame) for frame in sorted({one.frame for one in corrections})[:10])
                    count = f"{len(corrections)} correction{'s' if len(corrections) > 1 else ''}, in frames {frames}"
                    shown.say(f"{file}: {count}; export the run again before more is corrected there")
                shown.begin("saving")
                for line in save(fixer, video=not self.no_video, report=shown.update, stop=stop):
                    shown.say(line)
            except StoppedError:
                shown.say(f"facetrack: {stop.reason}; {folder} is as it was")
                return stop.code or ExitCode.FAULT
        return ExitCode.DONE

    def _serve(self, fixer: Fixer, frames: Frames, stop: Stop) -> int:
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
        session = FixSession(fixer, frames, video=not self.no_video, unsaved=unsaved)
        if not self.page.serve(session, stop):
            goes_on = f"all else is as it was; {fixer.run.fixed_by} goes on with them"
            none = "what was saved stays" if session.saves else "nothing was written"
            what = f"the corrections are kept in {kept}, {goes_on}" if kept.is_file() else none
            say(f"facetrack: {stop.reason}; {what}")
            return stop.code or ExitCode.FAULT
        return ExitCode.DONE


command = verb(Fix)
