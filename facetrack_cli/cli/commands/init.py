"""facetrack init: where the track of a clip begins, as a file to edit."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FILE, FRAME, Page, flag, option, say
from facetrack_cli.core.errors import ExitCode, InputError, OutputError

if TYPE_CHECKING:
    from facetrack_cli.core.types import Box, Frame, Start

SUFFIXES = (".yaml", ".yml", ".json")


@click.command()
@click.argument("clip", metavar="INPUT", type=FILE)
@option("-o --out", "FILE", "File to write [default: <clip>.init.yaml beside the clip]; - stdout.")
@option("--init-frame", "N", "Frame where the search begins, of --box, or shown first on the page.", type=FRAME)
@options.box("The face's box in that frame: place the points in it.")
@option(
    "--config",
    "RECIPE",
    "Write what this recipe begins with: its points, or a head and hands; without, a face and five points.",
)
@option("--preview", "FILE.png", "Also draw the result on its frame.", type=FILE)
@flag("--pick", "Choose on a page in the browser: boxes and points are drawn on the frame.")
@options.page
@flag("--overwrite", "Replace files that are there already; --pick begins with what they hold.")
def command(
    clip: Path,
    out: str | None,
    init_frame: int | None,
    box: Box | None,
    config: str | None,
    preview: Path | None,
    pick: bool,
    page: Page,
    overwrite: bool,
) -> int:
    """Write where the track of a clip begins, as a file to edit.

    INPUT is a video or a folder of images. The first face that the Haar cascades find, and five points of it (nose,
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
      facetrack init clip.mp4 --config head_hands --preview look.png
      facetrack init clip.mp4 --pick --open
      facetrack init frames/ -o - > start.yaml
    """
    from facetrack_cli.tracking.start import default_path, write_init

    path = None if out == "-" else Path(out) if out else default_path(clip)
    if out == "":
        raise OutputError("--out is empty; name a file, or - for standard output")
    if not pick:
        page.refuse("add --pick")
    _check_outputs(clip, path, preview, overwrite)
    if pick:
        return _pick(clip, path, init_frame, box, config, preview, page, overwrite)
    start, frame = _find(clip, init_frame or 0, box, config)
    if preview is not None:
        from facetrack_cli.tracking.start.preview import write_preview

        write_preview(preview, frame, start, overwrite=overwrite)
        say(f"{preview}: the start drawn on frame {start.frame}")
    if path is None:
        write_init(sys.stdout, start, clip=clip.name)
    else:
        write_init(path, start, clip=clip.name, overwrite=overwrite)
        what = ", ".join(start.targets) if len(start.targets) > 1 else "a face"
        say(f"{path}: {what} in frame {start.frame}; edit it, then: {_next(clip, path, config)}")
    return ExitCode.DONE


def _next(clip: Path, path: Path | None, config: str | None) -> str:
    """The command that begins with the file, once it is there."""
    from facetrack_cli.recipe.gallery_option import wants_gallery
    from facetrack_cli.recipe.load import load_recipe
    from facetrack_cli.tracking.start import default_path, find_init

    found = (find_init(clip) or default_path(clip)) == path
    named = "" if found else f" --init {'FILE' if path is None else path}"
    if config is not None:
        named += f" --config {config}" + " --gallery FILE" * wants_gallery(load_recipe(config))
    return f"facetrack run {clip}{named}"


def _pick(
    clip: Path,
    path: Path | None,
    init_frame: int | None,
    box: Box | None,
    config: str | None,
    preview: Path | None,
    page: Page,
    overwrite: bool,
) -> int:
    """Let somebody choose on the page; the exit code."""
    from facetrack_cli.editor.web.pick_session import PickSession
    from facetrack_cli.editor.web.pictures import Pictures
    from facetrack_cli.editor.web.serve import run_page
    from facetrack_cli.recipe.load import load_recipe
    from facetrack_cli.runs.signals import Stop
    from facetrack_cli.tracking.start import default_path, read_init, write_init
    from facetrack_cli.video.seek import Frames

    recipe = None if config is None else load_recipe(config)
    beside = path or default_path(clip)
    kept = beside.with_name(f"{beside.stem}.unsaved.yaml")  # what was chosen and not saved
    begun, goes_on = None, box is None and kept.is_file()
    source = kept if goes_on else path
    if source is not None and source.is_file():
        try:
            begun = read_init(source)
        except InputError as e:  # it will be replaced in any case
            say(f"facetrack: warning: {e}; the page begins without it")
    with Frames(clip) as frames, Stop().listening() as stop:
        session = PickSession(
            clip,
            frames,
            Pictures(frames),
            out=path,
            overwrite=overwrite,
            recipe=recipe,
            frame=init_frame,
            box=box,
            begun=begun,
            next_=_next(clip, path, config),
            preview=preview,
        )
        run_page(session, stop, say, port=page.port or 0, browse=page.browse)
    if session.ended is None:
        say(f"facetrack: {stop.reason}; {_keep_unsaved(session.unsaved(), clip, kept)}")
        return stop.code or ExitCode.FAULT
    if goes_on:
        kept.unlink(missing_ok=True)
    if path is None and session.saved is not None:
        write_init(sys.stdout, session.saved, clip=clip.name)
    for line in (*session.ended["said"], f"next: {session.ended['next']}"):
        say(line)
    return ExitCode.DONE


def _keep_unsaved(start: Start | None, clip: Path, kept: Path) -> str:
    """Write what was chosen and not saved, if anything was; what became of it."""
    from facetrack_cli.tracking.start import write_init

    if start is None and kept.is_file():
        return f"what was chosen the last time is still in {kept}"
    if start is None:
        return "nothing was written"
    try:
        write_init(kept, start, clip=clip.name, overwrite=True)
    except OutputError as e:
        return f"what was chosen is lost: {e}"
    return f"what was chosen is kept in {kept}; the same command goes on with it"


def _check_outputs(clip: Path, path: Path | None, preview: Path | None, overwrite: bool) -> None:
    """Refuse before the search what would be refused after it."""
    from facetrack_cli.core.files import check_new

    if path is not None and path.suffix.lower() not in SUFFIXES:
        raise OutputError(f"{path}: an init file ends in {', '.join(SUFFIXES)}; name it so")
    if preview is not None and preview.suffix.lower() != ".png":
        raise OutputError(f"{preview}: the preview is a PNG; let its name end in .png")
    for file in (path, preview):
        if file is not None:
            check_new(file, overwrite=overwrite)
    if preview is not None and clip.is_dir() and preview.parent.resolve() == clip.resolve():
        raise OutputError(f"{preview}: would be one more frame of the clip; write it outside {clip}")


def _find(clip: Path, init_frame: int, box: Box | None, config: str | None) -> tuple[Start, Frame]:
    """The start, and its frame."""
    from facetrack_cli.recipe.load import load_recipe
    from facetrack_cli.tracking.start import PARTS, box_start, haar_start, name_targets
    from facetrack_cli.video.source import open_source

    recipe = None if config is None else load_recipe(config)
    points = PARTS if recipe is None else recipe.points

    def complete(frame: Frame, start: Start) -> Start:
        if recipe is None:
            return start
        return name_targets(start, recipe.followed, frame, left_out=recipe.left_out, clip=str(clip))

    looked_at: list[Frame] = []
    with open_source(clip, start=init_frame) as source:
        frames = _last(source, looked_at)
        if box is None:
            return haar_start(frames, points, clip=str(clip), complete=complete), looked_at[0]
        frame = next(frames, None)
        if frame is None:
            raise InputError(f"{clip}: has no frame {init_frame}; choose an earlier one with --init-frame")
        return complete(frame, box_start(frame, box, points, clip=str(clip))), frame


def _last(frames: Iterable[Frame], kept: list[Frame]) -> Iterator[Frame]:
    for frame in frames:
        kept[:] = [frame]
        yield frame
