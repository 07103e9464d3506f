"""facetrack gallery: learn who is who from images and videos, and draw it."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

# before numpy is imported: the matrices are small, and threads only wait for each other on a busy machine
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import re
from pathlib import Path

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import option, say, write_figure
from facetrack_cli.cli.types import FILE, FOLDER, FRAME, Text, Whole
from facetrack_cli.core.errors import InputError, UsageError, flat

if TYPE_CHECKING:
    from facetrack_cli.trackers.appearance.gallery import Gallery


MIN_SIDE, MAX_SIDE = 6, 128  # of a template, as in recipes


@click.group()
def command() -> None:
    """Learn who is who from images and videos, and draw it.

    A gallery is a file of faces with names, and of how faces differ. A recipe that recognises names people by it:

    \b
        facetrack gallery fit people/ -o gallery.npz
        facetrack gallery show gallery.npz
    """


def _template(value: str) -> tuple[int, int]:
    """(rows, columns) of COLUMNSxROWS."""
    found = re.fullmatch(r"(\d{1,4})[xX](\d{1,4})", value.strip())
    if not found or not all(MIN_SIDE <= int(side) <= MAX_SIDE for side in found.groups()):
        sides = f"{MIN_SIDE} to {MAX_SIDE}"
        raise click.BadParameter(f"{value!r}: give columns and rows from {sides}, as in 26x30 (26 wide, 30 high)")
    return int(found[2]), int(found[1])


@command.command()
@click.argument("folder", type=FOLDER)
@options.array_file("gallery")
@option("--frames", type=Whole(1, 10_000), default=15, help="Frames of each video, at most.")
@option("--start", type=FRAME, default=0, show_default=False, help="First frame of videos that is used.")
@option("--stop", type=FRAME, help="Frame of videos before which to stop.")
@option(
    "--jitter", type=Whole(0, 100), default=4,
    help="Copies of each face, cut up to 3 % beside it, 5 % larger or smaller, 3 degrees turned; 0 as published.",
)  # fmt: skip
@option(
    "--template", type=Text("WxH", _template), default="26x30",
    help="Points across and down a face; the recipe must have the same.",
)  # fmt: skip
@options.overwrite
@options.quiet
def fit(
    folder: Path, out: Path, frames: int, start: int, stop: int | None, jitter: int, template: tuple[int, int],
    overwrite: bool, quiet: bool,
) -> None:  # fmt: skip
    """Learn a gallery from a folder of people's folders.

    A person's folder has the person's name, and holds images, videos, or folders of a video's frames. Of each image
    the largest face is taken, of a video that of some frames, spread evenly. An init file beside an image or video, as
    anna1.init.yaml beside anna1.jpg, says where the face is.

    \b
    Examples:
      facetrack gallery fit people/ -o gallery.npz
      facetrack gallery fit clips/ --stop 250      # the rest is to try it on
    """
    from facetrack_cli.core.files import check_new
    from facetrack_cli.runs.progress import progress
    from facetrack_cli.start.gallery_images import Reading, count, find_people, read_faces
    from facetrack_cli.trackers.appearance.gallery_fit import fit_gallery

    if stop is not None and stop <= start:
        raise UsageError(f"nothing to use from frame {start} up to {stop}; --stop must be greater than --start")
    check_new(out, overwrite=overwrite)
    reading = Reading(template, frames, start, stop, jitter)
    with progress(quiet) as shown:

        def warn(line: str) -> None:
            shown.say(f"warning: {line}")

        people = find_people(folder, warn)
        total = count(people, reading)
        shown.begin(folder.name, "frames", total)
        faces = read_faces(people, reading, warn, lambda done: shown.update(done, total))
    try:
        gallery = fit_gallery(
            faces.patches,
            faces.persons,
            template,
            images=faces.images,
            negatives=faces.negatives,
            proportion=faces.proportion,
        )
    except InputError as e:
        more = "" if jitter else ", or let copies stand for it with --jitter 4"
        raise InputError(f"{folder}: {e}{more}") from None
    gallery.save(out)
    if quiet:
        return
    wide = max(map(len, (*gallery.names, "person")))
    say(f"{'person':<{wide}}{'used':>8}{'skipped':>9}")
    for name in gallery.names:
        say(f"{name:<{wide}}{faces.used[name]:>8}{faces.skipped[name]:>9}")
    for line in _summary(gallery):
        say(line)
    say(f"{out}: {len(gallery.names)} persons, {sum(gallery.counts)} images")


@command.command()
@click.argument("file", type=FILE, default="gallery.npz")
@options.figure_file("beside FILE, as gallery.png")
@options.overwrite
def show(file: Path, out: Path | None, overwrite: bool) -> None:
    """Summarise and draw a gallery; without FILE, gallery.npz.

    The figure has the mean face, the first eigenfaces of each space, and everyone who is in it.

    \b
    Examples:
      facetrack gallery show
      facetrack gallery show people.npz -o people.pdf
    """
    from facetrack_cli.report.figures.models import gallery_figure
    from facetrack_cli.trackers.appearance.gallery import load_gallery

    gallery = load_gallery(file)
    out = out or file.with_suffix(".png")
    write_figure(out, lambda: gallery_figure(gallery, title=file.name), overwrite=overwrite, inputs=[file])
    rows, cols = gallery.shape
    click.echo(flat(f"{file.name}: {len(gallery.names)} persons, {sum(gallery.counts)} images"))
    click.echo(flat(f"template: {cols} points across, {rows} down"))
    if gallery.proportion is not None:
        click.echo(flat(f"boxes: {gallery.proportion:.2f} times as wide as high"))
    for line in _summary(gallery):
        click.echo(flat(line))
    for number, (name, images) in enumerate(zip(gallery.names, gallery.counts, strict=True), start=1):
        click.echo(flat(f"{number:>4} {name}: {images} image{'s' if images != 1 else ''}"))
    click.echo(flat(f"figure: {out}"))


def _summary(gallery: Gallery) -> list[str]:
    from facetrack_cli.report.figures.models import calibrated, kept, stranger

    spaces = (("frontal faces", gallery.frontal), ("intra-personal", gallery.intra), ("extra-personal", gallery.extra))
    lines = [f"{name}: {kept(space)}" for name, space in spaces]
    return [*lines, calibrated(gallery), stranger(gallery), *(f"note: {note}" for note in gallery.notes)]
