"""facetrack init: where the track of a clip begins, as a file to edit."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FILE, FRAME, Page, argument, flag, group, option, say, verb
from facetrack_cli.core.errors import ExitCode, InputError, OutputError, UsageError

if TYPE_CHECKING:
    from facetrack_cli.core.types import Box, Frame, Start
    from facetrack_cli.recipe.model import Recipe


class Init:
    """Write where the track of a clip begins, as a file to edit.

    INPUT is a video or a folder of images. The first face that is found, and five points of it (nose,
    corners of the mouth, lips), become an init file, which `facetrack run` takes from beside the clip. Nothing that is
    there already is replaced without --overwrite.

    Recipes of regions need no points: to follow a head or hands, write boxes alone into such a file, or give --box to
    `facetrack run`. Of a recipe that follows a head and hands, --config finds the hands too, as the largest regions of
    the face's skin colour apart from it.

    With --pick you choose yourself, on a page that is served to this machine alone: its address is printed, and Save
    there writes the file and ends the command. On a machine far away, forward the port by ssh -L, as is printed too.

    \b
    Examples:
      facetrack init clip.mp4 --preview look.png
      facetrack init clip.mp4 --init-frame 120 --box 310,96,140,140
      facetrack init clip.mp4 --config signer --preview look.png
      facetrack init panel.mp4 --faces all --preview look.png
      facetrack init clip.mp4 --pick --open
      facetrack init frames/ -o - > start.yaml
    """

    clip: Path = argument("INPUT")
    out: str | None = option("-o --out FILE", "File to write [default: <clip>.init.yaml beside the clip]; - stdout.")
    init_frame: int | None = option(
        "--init-frame N", "Frame where the search begins, of --box, or shown first on the page.", type=FRAME
    )
    faces: Literal["one", "all"] = option(
        "--faces WHICH", "`one`, the largest face that stays, or `all` that are there with it [default: one].",
        type=click.Choice(["one", "all"]), default="one", show_default=False,
    )  # fmt: skip
    box: Box | None = options.box_option("The face's box in that frame: place the points in it.")
    config: str | None = option(
        "--config RECIPE",
        "Write what this recipe begins with: its points, or a head and hands; without, a face and five points.",
    )
    preview: Path | None = option("--preview FILE.png", "Also draw the result on its frame.", type=FILE)
    pick: bool = flag("--pick", "Choose on a page in the browser: boxes and points are drawn on the frame.")
    page: Page = group(Page)
    overwrite: bool = flag("--overwrite", "Replace files that are there already; --pick begins with what they hold.")

    path: Path | None  # what `out` means
    recipe: Recipe | None

    def run(self) -> int:
        from facetrack_cli.recipe.load import load_recipe
        from facetrack_cli.start.init_file import default_path

        if self.out == "":
            raise OutputError("--out is empty; name a file, or - for standard output")
        if self.faces == "all" and (self.box is not None or self.pick):
            raise UsageError("--faces all is of a search; leave out --box and --pick")
        if not self.pick:
            self.page.refuse("add --pick")
        self.path = None if self.out == "-" else Path(self.out) if self.out else default_path(self.clip)
        self._check_files()
        self.recipe = None if self.config is None else load_recipe(self.config)
        return self._pick() if self.pick else self._find()

    def _check_files(self) -> None:
        """Refuse before the search what would be refused after it."""
        from facetrack_cli.core.files import check_new
        from facetrack_cli.start.init_file import SUFFIXES

        path, preview = self.path, self.preview
        if path is not None and path.suffix.lower() not in SUFFIXES:
            raise OutputError(f"{path}: an init file ends in {', '.join(SUFFIXES)}; name it so")
        if preview is not None and preview.suffix.lower() != ".png":
            raise OutputError(f"{preview}: the preview is a PNG; let its name end in .png")
        if self.pick and not self.overwrite and path is not None and path.is_file():
            begin = f"facetrack init {self.clip} --pick --overwrite begins with it"
            raise OutputError(f"{path}: exists already; {begin}, and replaces it; or name another file with --out")
        for file in filter(None, (path, preview)):
            check_new(file, overwrite=self.overwrite)
        if preview is not None and self.clip.is_dir() and preview.parent.resolve() == self.clip.resolve():
            raise OutputError(f"{preview}: would be one more frame of the clip; write it outside {self.clip}")

    def _find(self) -> int:
        """Write what the cascades find; the exit code."""
        from facetrack_cli.start.init_file import write_init
        from facetrack_cli.start.preview import write_preview

        start, frame = self._start()
        if self.preview is not None:
            write_preview(self.preview, frame, start, overwrite=self.overwrite)
            say(f"{self.preview}: the start drawn on frame {start.frame}")
        if self.path is None:
            write_init(sys.stdout, start, clip=self.clip.name)
        else:
            write_init(self.path, start, clip=self.clip.name, overwrite=self.overwrite)
            what = ", ".join(start.targets) if len(start.targets) > 1 else "a face"
            say(f"{self.path}: {what} in frame {start.frame}; edit it, then: {self._next()}")
        return ExitCode.DONE

    def _start(self) -> tuple[Start, Frame]:
        """The start, and its frame."""
        from facetrack_cli.recipe.load import load_recipe
        from facetrack_cli.runs.plan import ClipRequest
        from facetrack_cli.runs.progress import progress
        from facetrack_cli.trackers.face.detectors import detector

        by = None if self.box is not None else detector().name
        begin = ClipRequest(self.clip, init=by, faces=self.faces, box=self.box, init_frame=self.init_frame)
        with progress(self.out == "-") as shown:
            shown.begin(f"{self.clip.name}: looking for a face")
            start = begin.find(self.recipe or load_recipe("factorized"), looked=shown.update)
        return start, begin.frame(start.frame)

    def _next(self) -> str:
        """The command that begins with the file, once it is there."""
        from facetrack_cli.recipe.gallery_option import wants_gallery
        from facetrack_cli.start.init_file import default_path, find_init

        found = (find_init(self.clip) or default_path(self.clip)) == self.path
        named = "" if found else f" --init {'FILE' if self.path is None else self.path}"
        if self.recipe is not None:
            named += f" --config {self.config}" + " --gallery FILE" * wants_gallery(self.recipe)
        return f"facetrack run {self.clip}{named}"

    def _pick(self) -> int:
        """Let somebody choose on the page; the exit code."""
        from facetrack_cli.editor.web.pick_session import PickSession
        from facetrack_cli.runs.signals import Stop
        from facetrack_cli.start.init_file import default_path, read_init, write_init
        from facetrack_cli.video.seek import Frames

        beside = self.path or default_path(self.clip)
        kept = beside.with_name(f"{beside.stem}.unsaved.yaml")  # what was chosen and not saved
        begun, goes_on = None, self.box is None and kept.is_file()
        source = kept if goes_on else self.path
        if source is not None and source.is_file():
            try:
                begun = read_init(source)
            except InputError as e:  # it will be replaced in any case
                say(f"facetrack: warning: {e}; the page begins without it")
        with Frames(self.clip) as frames, Stop().listening() as stop:
            session = PickSession(
                self.clip,
                frames,
                out=self.path,
                overwrite=self.overwrite,
                recipe=self.recipe,
                frame=self.init_frame,
                box=self.box,
                begun=begun,
                next_=self._next(),
                preview=self.preview,
            )
            saved = self.page.serve(session, stop)
        if not saved:
            say(f"facetrack: {stop.reason}; {_keep_unsaved(session.unsaved(), self.clip, kept)}")
            return stop.code or ExitCode.FAULT
        if goes_on:
            kept.unlink(missing_ok=True)
        if self.path is None and session.saved is not None:
            write_init(sys.stdout, session.saved, clip=self.clip.name)
        return ExitCode.DONE


def _keep_unsaved(start: Start | None, clip: Path, kept: Path) -> str:
    """Write what was chosen and not saved, if anything was; what became of it."""
    from facetrack_cli.start.init_file import write_init

    if start is None:
        return f"what was chosen the last time is still in {kept}" if kept.is_file() else "nothing was written"
    try:
        write_init(kept, start, clip=clip.name, overwrite=True)
    except OutputError as e:
        return f"what was chosen is lost: {e}"
    return f"what was chosen is kept in {kept}; the same command goes on with it"


command = verb(Init)
