"""Values of options that several commands take."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from facetrack_cli.core.types import Box


class Whole(click.IntRange):
    """A whole number in a range; click itself would call it an integer range."""

    name = "whole number"


FRAME = Whole(min=0)
# those of formats/read.py, which is not imported, so that helps come at once
TRUTH_FORMATS = ("auto", "facetrack", "boxes", "otb", "got10k", "mot", "vot", "pts")
truth_format = click.option(
    "--truth-format",
    metavar="FORMAT",
    type=click.Choice(TRUTH_FORMATS),
    default="auto",
    help=f"How to read it: {', '.join(TRUTH_FORMATS[1:])} [default: by its shape].",
)
shift = click.option(
    "--shift",
    metavar="N",
    type=int,
    help="Add N to the frame numbers of the truth; 0 takes them as they are even if another shift would fit better.",
)
partial = click.option(
    "--partial", is_flag=True, help="Take the frames that both have, though truth or trajectory lacks some."
)
target = click.option("--target", metavar="NAME[/PART]", help="One target, or one part of it, alone.")


def box(ctx: click.Context, param: click.Parameter, value: str | None) -> Box | None:
    """`left,top,width,height` in pixels."""
    if value is None:
        return None
    try:
        x, y, w, h = (float(part) for part in value.split(","))
    except ValueError:
        raise click.BadParameter(f"{value!r}: give four numbers with commas: left,top,width,height") from None
    if not (abs(x) < 1e6 and abs(y) < 1e6 and 0 < w < 1e6 and 0 < h < 1e6):
        raise click.BadParameter(f"{value!r}: give pixels of the frame, width and height above 0")
    return (x, y, w, h)


def rate(ctx: click.Context, param: click.Parameter, value: str | None) -> Fraction | None:
    """Frames per second."""
    if value is None:
        return None
    try:
        found = Fraction(value)
    except (ValueError, ZeroDivisionError):
        found = Fraction(0)
    if not 0 < found <= 100_000:
        raise click.BadParameter(f"{value!r}: give frames per second as 25, 29.97 or 30000/1001")
    return found


init = click.option(
    "--init", metavar="FILE", help="Init file; `haar` looks for a face even if one lies beside the clip."
)
face_box = click.option(
    "--box", metavar="X,Y,W,H", callback=box, help="The face, head or hand in the first frame, in pixels."
)
gallery = click.option(
    "--gallery",
    metavar="FILE",
    help="People to recognise, as facetrack gallery fit writes them; for recipes of affine targets.",
)
overwrite_file = click.option("--overwrite", is_flag=True, help="Replace the file that is there already.")
port = click.option(
    "--port",
    metavar="N",
    type=Whole(min=1, max=65535),
    help="Port of the page on this machine [default: any that is free].",
)
browse = click.option("--open", "browse", is_flag=True, help="Also open the page in the browser.")
