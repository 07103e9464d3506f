"""facetrack init: where the track of a clip begins, as a file to edit."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from facetrack_cli.errors import InputError, OutputError
from facetrack_cli.options import FRAME
from facetrack_cli.options import box as box_of

if TYPE_CHECKING:
    from facetrack_cli.types import Box, Frame, Start

SUFFIXES = (".yaml", ".yml", ".json")


@click.command()
@click.argument("clip", metavar="INPUT", type=click.Path(path_type=Path))
@click.option(
    "-o", "--out", metavar="FILE", help="File to write [default: <clip>.init.yaml beside the clip]; - stdout."
)
@click.option("--init-frame", metavar="N", type=FRAME, default=0, help="Frame where the search begins, or of --box.")
@click.option("--box", metavar="X,Y,W,H", callback=box_of, help="The face's box in that frame: place the points in it.")
@click.option(
    "--config",
    metavar="RECIPE",
    help="Write what this recipe begins with: its points, or a head and hands; without, a face and five points.",
)
@click.option(
    "--preview", metavar="FILE.png", type=click.Path(path_type=Path), help="Also draw the result on its frame."
)
@click.option("--overwrite", is_flag=True, help="Replace files that are there already.")
def command(
    clip: Path,
    out: str | None,
    init_frame: int,
    box: Box | None,
    config: str | None,
    preview: Path | None,
    overwrite: bool,
) -> None:
    """Write where the track of a clip begins, as a file to edit.

    INPUT is a video or a folder of images. The first face that the Haar cascades find, and five points of it (nose,
    corners of the mouth, lips), become an init file, which `facetrack run` takes from beside the clip. Nothing that is
    there already is replaced without --overwrite.

    Recipes of regions need no points: to follow a head or hands, write boxes alone into such a file, or give --box to
    `facetrack run`. Of a recipe that follows a head and hands, --config finds the hands too, as the largest regions of
    the face's skin colour apart from it.

    \b
    Examples:
      facetrack init clip.mp4 --preview look.png
      facetrack init clip.mp4 --init-frame 120 --box 310,96,140,140
      facetrack init clip.mp4 --config head_hands --preview look.png
      facetrack init frames/ -o - > start.yaml
    """
    from facetrack_cli.recipe import load_recipe
    from facetrack_cli.recipe_gallery import wants_gallery
    from facetrack_cli.start import default_path, find_init, write_init

    path = None if out == "-" else Path(out) if out else default_path(clip)
    if out == "":
        raise OutputError("--out is empty; name a file, or - for standard output")
    _check_outputs(clip, path, preview, overwrite)
    start, frame = _find(clip, init_frame, box, config)
    if preview is not None:
        from facetrack_cli.start.preview import write_preview

        write_preview(preview, frame, start, overwrite=overwrite)
        click.echo(f"{preview}: the start drawn on frame {start.frame}", err=True)
    if path is None:
        write_init(sys.stdout, start, clip=clip.name)
    else:
        write_init(path, start, clip=clip.name, overwrite=overwrite)
        named = "" if find_init(clip) == path else f" --init {path}"
        if config is not None:
            named += f" --config {config}" + " --gallery FILE" * wants_gallery(load_recipe(config))
        what = ", ".join(start.targets) if len(start.targets) > 1 else "a face"
        click.echo(f"{path}: {what} in frame {start.frame}; edit it, then: facetrack run {clip}{named}", err=True)


def _check_outputs(clip: Path, path: Path | None, preview: Path | None, overwrite: bool) -> None:
    """Refuse before the search what would be refused after it."""
    from facetrack_cli.start.files import check_new

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
    from facetrack_cli.recipe import load_recipe
    from facetrack_cli.start import PARTS, box_start, haar_start, name_targets
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
