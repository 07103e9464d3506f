"""Options that several commands take: alone, and in groups that reach a command as one value."""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Callable, Iterable
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import click

from facetrack_cli.core.errors import OutputError, UsageError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from facetrack_cli.core.types import Box
    from facetrack_cli.evaluation.rows import Pair
    from facetrack_cli.trajectory.table import Table

Function: TypeAlias = Callable[..., Any]
Decorator: TypeAlias = Callable[[Function], Function]


def option(names: str, metavar: str, text: str, *, show_default: bool = True, **more: Any) -> Decorator:
    """An option of one value, and what its help says; `names` as "-o --out"."""
    return click.option(*names.split(), metavar=metavar, help=text, show_default=show_default, **more)


def flag(names: str, text: str) -> Decorator:
    return click.option(*names.split(), is_flag=True, help=text)


def grouped(name: str, kind: Any, *options: Decorator) -> Decorator:
    """A decorator for `options` that a command takes as one argument `name`: `kind`, a named tuple of their values."""

    def decorate(command: Function) -> Function:
        def called(*args: Any, **values: Any) -> Any:
            return command(*args, **{name: kind(*(values.pop(field) for field in kind._fields))}, **values)

        wrapped: Function = functools.wraps(command)(called)
        for option in reversed(options):
            wrapped = option(wrapped)
        return wrapped

    return decorate


class Whole(click.IntRange):
    """A whole number in a range; click itself would call it an integer range."""

    name = "whole number"


FILE: Any = click.Path(path_type=Path)
FRAME = Whole(min=0)
FIGURES = ("png", "svg", "pdf")  # those of report/figures/style.py, which would load numpy

# --- one by one ----------------------------------------------------------------------------------------------------


def _figure(value: str) -> Path:
    if not value:
        raise OutputError("--out is empty; name a file that ends in .png, .svg or .pdf")
    if Path(value).suffix[1:].lower() not in FIGURES:
        raise UsageError(f"{value}: cannot tell the kind of file; let its name end in .png, .svg or .pdf")
    return Path(value)


def figure_file(default: str) -> Decorator:
    """--out of a figure; `default` says in words where it goes without."""
    told = f"File to write: .png, .svg or .pdf [default: {default}]."
    return option("-o --out", "FILE", told, type=_figure)


def array_file(what: str) -> Decorator:
    """--out of an .npz file that holds a `what`, as a gallery."""

    def parse(value: str) -> Path:
        if Path(value).suffix != ".npz":
            raise UsageError(f"{value}: a {what} is an .npz file; let its name end so")
        return Path(value)

    told = f"Where the {what} goes."
    return option("-o --out", "FILE", told, type=parse, default=f"{what}.npz")


config = option("--config", "RECIPE", "Recipe: a file, or a name.", default="factorized")
overrides = option("--set overrides", "KEY=VALUE", "Override a key of the recipe; repeatable.", multiple=True)
gallery = option(
    "--gallery", "FILE", "People to recognise, as facetrack gallery fit writes them; for recipes of affine targets."
)
clip = option("--clip", "INPUT", "The clip, if it is elsewhere now.", type=FILE)
title = option("--title", "TEXT", "Title of the page [default: clip and recipe].")
target = option("--target", "NAME[/PART]", "One target, or one part of it, alone.")
overwrite = flag("--overwrite", "Replace files that are there already.")
quiet = flag("--quiet -q", "Say nothing but errors.")


def jobs(what: str) -> Decorator:
    """--jobs, of which `what` says what so many of them share."""
    return option("-j --jobs workers", "N", what, type=Whole(min=1), default=1, show_default=False)


def _box(value: str) -> Box:
    """`left,top,width,height` in pixels."""
    try:
        x, y, w, h = (float(part) for part in value.split(","))
    except ValueError:
        raise click.BadParameter(f"{value!r}: give four numbers with commas: left,top,width,height") from None
    if not (abs(x) < 1e6 and abs(y) < 1e6 and 0 < w < 1e6 and 0 < h < 1e6):
        raise click.BadParameter(f"{value!r}: give pixels of the frame, width and height above 0")
    return (x, y, w, h)


def box(told: str) -> Decorator:
    """--box, which is what `told` says."""
    return option("--box", "X,Y,W,H", told, type=_box)


# --- in groups -----------------------------------------------------------------------------------------------------


class Extent(NamedTuple):
    """Where the tracks of a clip begin, and its frames: --init, --box, --start, --stop and --fps."""

    init: Path | Literal["haar"] | None
    box: Box | None
    start: int
    stop: int | None
    fps: Fraction | None

    def check(self, *clips: Path) -> None:
        """UsageError where they contradict each other, or have no meaning for these clips."""
        if self.init is not None and self.box is not None:
            raise UsageError("--init and --box both say where the track starts; give one of them")
        if self.stop is not None and self.stop <= self.start:
            told = f"after --start {self.start}" if self.start else "at all"
            raise UsageError(f"--stop {self.stop} leaves no frame {told}; it is the frame to stop before")
        if self.fps is not None and all(one.is_file() for one in clips):
            raise UsageError("--fps is for image folders; a video brings its own rate")


def _init(value: str) -> Path | str:
    if not value:
        raise UsageError("--init is empty; name an init file, or haar to look for a face")
    return value if value == "haar" else Path(value)


def _rate(value: str) -> Fraction:
    """Frames per second."""
    try:
        found = Fraction(value)
    except (ValueError, ZeroDivisionError):
        found = Fraction(0)
    if not 0 < found <= 100_000:
        raise click.BadParameter(f"{value!r}: give frames per second as 25, 29.97 or 30000/1001")
    return found


def extent(start: str) -> Decorator:
    """The options of an `Extent`, of which `start` explains --start."""
    return grouped(
        "extent",
        Extent,
        option("--init", "FILE", "Init file; `haar` looks for a face even if one lies beside the clip.", type=_init),
        box("The face, head or hand in the first frame, in pixels."),
        option("--start", "N", start, type=FRAME, default=0, show_default=False),
        option("--stop", "N", "Frame to stop before.", type=FRAME),
        option("--fps", "RATE", "Frames per second of image folders.", type=_rate),
    )


# those of trajectory/formats/read.py, which is not imported, so that helps come at once
TRUTH_FORMATS = ("auto", "facetrack", "boxes", "otb", "got10k", "mot", "vot", "pts")
FORMAT: Any = click.Choice(TRUTH_FORMATS)


class Truth(NamedTuple):
    """A file of ground truth and how to read it; `path` None without --truth."""

    path: Path | None
    form: str
    shift: int | None
    partial: bool
    target: str | None

    def refuse_without_file(self, *, target: bool) -> None:
        """UsageError for an option that says how to use a file which is not named; --target only if `target`."""
        given = {
            "--truth-format": self.form != "auto",
            "--shift": self.shift is not None,
            "--partial": self.partial,
            "--target": target and self.target,
        }
        if self.path is None and (idle := [option for option, value in given.items() if value]):
            raise UsageError(f"{idle[0]} says how to use ground truth; give its file with --truth FILE")

    def read(self) -> Table:
        from facetrack_cli.trajectory.formats.read import read_truth

        assert self.path is not None
        return read_truth(self.path, self.form, shift=self.shift or 0)

    def pairs(self, ours: Table, theirs: Table, note: Callable[[str], None]) -> list[Pair]:
        """The rows of a trajectory beside those of the ground truth; `note` gets what to know of it."""
        from facetrack_cli.evaluation.match import match

        return match(ours, theirs, partial=self.partial, select=self.target, check_shift=self.shift is None, note=note)


def truth(told: str) -> Decorator:
    """The options of a `Truth`, of which `told` explains --truth."""
    return grouped(
        "truth",
        Truth,
        option("--truth path", "FILE", told, type=FILE),
        option(
            "--truth-format form",
            "FORMAT",
            f"How to read it: {', '.join(TRUTH_FORMATS[1:])} [default: by its shape].",
            type=FORMAT,
            default="auto",
            show_default=False,
        ),
        option(
            "--shift",
            "N",
            "Add N to the frame numbers of the ground truth; 0 takes them as they are even if another shift would "
            "fit better.",
            type=int,
        ),
        flag("--partial", "Take the frames that both have, though ground truth or track lacks some."),
        target,
    )


class Page(NamedTuple):
    """The page in the browser."""

    port: int | None
    browse: bool

    def refuse(self, remedy: str) -> None:
        """UsageError if there is to be no page, but an option of it was given."""
        if self.port is not None or self.browse:
            raise UsageError(f"{'--open' if self.port is None else '--port'} is for the page; {remedy}")


page = grouped(
    "page",
    Page,
    option(
        "--port", "N", "Port of the page on this machine [default: any that is free].", type=Whole(min=1, max=65535)
    ),
    flag("--open browse", "Also open the page in the browser."),
)

# --- what commands print -------------------------------------------------------------------------------------------


def say(line: str) -> None:
    """A line on standard error, also where a name holds line breaks."""
    click.echo(" ".join(line.splitlines()), err=True)


def colour() -> bool:
    """Whether standard output shows colours."""
    return sys.stdout.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def write_figure(
    path: Path, make: Callable[[], Figure], *, overwrite: bool, inputs: Iterable[Path] = (), dpi: float = 120.0
) -> None:
    """The figure, in the form that the file's ending names; refuses before `make` what would be refused after it."""
    from facetrack_cli.core.files import check_new, write_new
    from facetrack_cli.report.figures import need_matplotlib, render

    check_new(path, overwrite=overwrite, inputs=inputs)
    need_matplotlib()
    write_new(path, render(make(), path.suffix[1:].lower(), dpi=dpi), overwrite=overwrite)
