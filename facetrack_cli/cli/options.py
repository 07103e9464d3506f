"""Commands as classes: each field is an option, and what several commands take is a group of them.

`option`, `flag` and `argument` make a field, `group` one for all options of another class, and `verb` the command.
"""

from __future__ import annotations

import contextlib
import inspect
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar

import click

from facetrack_cli.cli.words import completes
from facetrack_cli.core.errors import FacetrackError, OutputError, UsageError
from facetrack_cli.core.log import log_line
from facetrack_cli.trajectory.formats import TRUTH_FORMATS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from facetrack_cli.core.files import Folder
    from facetrack_cli.core.types import Box
    from facetrack_cli.editor.web.session import Page as PageSession
    from facetrack_cli.evaluation.compare import Comparison
    from facetrack_cli.evaluation.rows import Pair
    from facetrack_cli.runs.progress import Progress
    from facetrack_cli.runs.signals import Stop
    from facetrack_cli.trajectory.trajectory import Trajectory

FILE: Any = click.Path(path_type=Path)


class Whole(click.IntRange):
    """A whole number in a range; click itself would call it an integer range."""

    name = "whole number"


class Number(click.FloatRange):
    """A number in a range: nan and infinity are none."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        found = super().convert(value, param, ctx)
        if not math.isfinite(found):
            self.fail(f"{value!r} is no finite number.", param, ctx)
        return found


_Row = TypeVar("_Row")
FRAME = Whole(min=0)
FIGURES = ("png", "svg", "pdf")  # those that report/figures/style.py renders
TABLES = ("json", "csv", "md")
Figures: TypeAlias = Callable[[], Iterable[tuple[str, bytes]]]


class Option(click.Option):
    """An option whose default the user may set by a variable, as FACETRACK_RUN_JOBS=4 for --jobs of run."""

    def variable(self, ctx: click.Context) -> str:
        words = f"{ctx.command_path} {max(self.opts, key=len).lstrip('-')}"
        return words.replace(" ", "_").replace("-", "_").upper()

    def resolve_envvar_value(self, ctx: click.Context) -> str | None:
        return os.environ.get(self.variable(ctx)) or None

    def process_value(self, ctx: click.Context, value: Any) -> Any:
        try:
            return super().process_value(ctx, value)
        except (click.ClickException, FacetrackError) as error:
            if ctx.get_parameter_source(str(self.name)) is not click.core.ParameterSource.ENVIRONMENT:
                raise
            message = error.message if isinstance(error, click.ClickException) else str(error)
            raise UsageError(f"{self.variable(ctx)}: {message.rstrip('.')}") from None

    def get_help_extra(self, ctx: click.Context) -> Any:
        """Beside the default, the variable that has replaced it."""
        value = self.resolve_envvar_value(ctx)
        return super().get_help_extra(ctx) | ({} if value is None else {"envvars": (f"{self.variable(ctx)}={value}",)})


def option(names: str, text: str, **more: Any) -> Any:
    """A field for an option, whose help says `text`; `names` as "-o --out FILE". A default is shown."""
    *own, metavar = names.split()
    shown: dict[str, Any] = {"metavar": metavar, "help": text, "show_default": "default" in more}
    shown["shell_complete"] = completes(metavar)
    return partial(Option, own, **shown | more)


def flag(names: str, text: str) -> Any:
    return partial(Option, names.split(), is_flag=True, help=text)


def argument(metavar: str, **more: Any) -> Any:
    """A field for a file or folder that is named without an option."""
    return partial(
        click.Argument, [], **{"metavar": metavar, "type": FILE, "shell_complete": completes(metavar), **more}
    )


def group(kind: type[Any]) -> Any:
    """A field for all options of another class, of which it will be an instance."""
    return kind


def verb(kind: type[Any], name: str | None = None) -> click.Command:
    """The command of a class: its docstring is the help, its fields are the options, and `run` does the work."""

    def call(**values: Any) -> Any:
        return _filled(kind, values).run()

    about = inspect.cleandoc(kind.__doc__ or "")
    made = Verb(name, params=list(_parameters(kind)), callback=call, help=about)
    made.sections = getattr(kind, "sections", {})
    return made


class Verb(click.Command):
    """A command whose help has its options in `sections`: a title by the name of the first option of each."""

    sections: Mapping[str, str]

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        params = [one for one in self.get_params(ctx) if isinstance(one, click.Option)]
        if self.sections:  # --help is of no section
            params = [params[-1], *params[:-1]]
        rows = [(one.name, row) for one in params if (row := one.get_help_record(ctx)) is not None]
        for title, own in sections(rows, lambda row: self.sections.get(row[0] or ""), "Options"):
            with formatter.section(title):
                formatter.write_dl([row for _, row in own])


def sections(rows: Iterable[_Row], begins: Callable[[_Row], str | None], title: str) -> list[tuple[str, list[_Row]]]:
    """The rows below titles: that of `begins` where a section begins, `title` before any does."""
    found: list[tuple[str, list[_Row]]] = [(title, [])]
    for row in rows:
        if (begun := begins(row)) is not None:
            found.append((begun, []))
        found[-1][1].append(row)
    return [(name, own) for name, own in found if own]


def given_beside(known: set[str]) -> str:
    """The first option on the command line of a field that is not `known`, as --stop; "" if there is none."""
    ctx = click.get_current_context()
    typed = click.core.ParameterSource.COMMANDLINE
    others = [one for one in ctx.command.params if one.name not in known]
    return next((max(one.opts, key=len) for one in others if ctx.get_parameter_source(str(one.name)) is typed), "")


def _parameters(kind: type[Any]) -> Iterator[click.Parameter]:
    for name, field in vars(kind).items():
        if isinstance(field, type):
            yield from _parameters(field)
        elif isinstance(field, partial):
            yield field.func([*field.args[0], name], **field.keywords)


def _filled(kind: type[Any], values: dict[str, Any]) -> Any:
    made = kind()
    for name, field in vars(kind).items():
        if isinstance(field, (type, partial)):
            vars(made)[name] = values[name] if isinstance(field, partial) else _filled(field, values)
    return made


def _box(value: str) -> Box:
    """`left,top,width,height` in pixels."""
    try:
        x, y, w, h = (float(part) for part in value.split(","))
    except ValueError:
        raise click.BadParameter(f"{value!r}: give four numbers with commas: left,top,width,height") from None
    if not (abs(x) < 1e6 and abs(y) < 1e6 and 0 < w < 1e6 and 0 < h < 1e6):
        raise click.BadParameter(f"{value!r}: give pixels of the frame, width and height above 0")
    return (x, y, w, h)


def box_option(text: str) -> Any:
    return option("--box X,Y,W,H", text, type=_box)


def figure_file(default: str) -> Any:
    """--out of a figure; `default` says in words where it goes without."""

    def parse(value: str) -> Path:
        if not value:
            raise OutputError("--out is empty; name a file that ends in .png, .svg or .pdf")
        if Path(value).suffix[1:].lower() not in FIGURES:
            raise UsageError(f"{value}: cannot tell the kind of file; let its name end in .png, .svg or .pdf")
        return Path(value)

    return option("-o --out FILE", f"File to write: .png, .svg or .pdf [default: {default}].", type=parse)


def array_file(what: str) -> Any:
    """--out of an .npz file that holds a `what`, as a gallery."""

    def parse(value: str) -> Path:
        if Path(value).suffix != ".npz":
            raise UsageError(f"{value}: a {what} is an .npz file; let its name end so")
        return Path(value)

    return option("-o --out FILE", f"Where the {what} goes.", type=parse, default=f"{what}.npz")


def jobs_option(text: str) -> Any:
    return option("-j --jobs N", text, type=Whole(1, 1000), default=1, show_default=False)


CONFIG = option("--config --recipe RECIPE", "Recipe: a file, or a name [default: face; with --box correlation_filter].")
OVERRIDES = option("--set KEY=VALUE", "Override a key of the recipe; repeatable.", multiple=True)
GALLERY = option(
    "--gallery FILE",
    "People to recognise, as facetrack gallery fit writes them; with --faces all as facetrack people --save does.",
)
CLIP = option("--clip INPUT", "The clip, if it is elsewhere now.", type=FILE)
TITLE = option("--title TEXT", "Title of the page [default: clip and recipe].")
TARGET = option("--target NAME[/PART]", "One target, or one part of it, alone.")
OVERWRITE = flag("--overwrite", "Replace files that are there already.")
QUIET = flag("--quiet -q", "Say nothing but errors.")


def _init(value: str) -> Path | str:
    if not value:
        raise UsageError("--init is empty; name an init file, or haar to look for a face")
    return value if value in ("haar", "yunet") else Path(value)


def _rate(value: str) -> Fraction:
    """Frames per second."""
    try:
        found = Fraction(value)
    except (ValueError, ZeroDivisionError):
        found = Fraction(0)
    if not 0 < found <= 100_000:
        raise click.BadParameter(f"{value!r}: give frames per second as 25, 29.97 or 30000/1001")
    return found


class Extent:
    """Where the tracks of a clip begin, and which of its frames are read."""

    init: Path | Literal["haar", "yunet"] | None = option(
        "--init FILE", "Init file; `haar` or `yunet` looks for a face even if one lies beside the clip.", type=_init
    )
    box: Box | None = box_option("The face, head or hand in the first frame, in pixels.")
    start: int = option("--start N", "First frame, from 0.", type=FRAME, default=0, show_default=False)
    stop: int | None = option("--stop N", "Frame to stop before.", type=FRAME)
    fps: Fraction | None = option("--fps RATE", "Frames per second of a folder or .zip of images.", type=_rate)

    def check(self, *clips: Path) -> None:
        """UsageError where options contradict each other, or have no meaning for these clips."""
        if self.init is not None and self.box is not None:
            raise UsageError("--init and --box both say where the track starts; give one of them")
        if self.stop is not None and self.stop <= self.start:
            place = f"after --start {self.start}" if self.start else "at all"
            raise UsageError(f"--stop {self.stop} leaves no frame {place}; it is the frame to stop before")
        if self.fps is not None and all(one.is_file() for one in clips):
            from facetrack_cli.video.files import brings_rate

            if all(map(brings_rate, clips)):
                raise UsageError("--fps is for image folders and archives; a video brings its own rate")


def format_of(names: str, text: str) -> Any:
    """How to read a file that another program may have written."""
    text += " [default: by its shape]."
    return option(f"{names} FORMAT", text, type=click.Choice(TRUTH_FORMATS), default="auto", show_default=False)


class TruthOptions:
    """How a file of ground truth is read."""

    truth_format: str = format_of("--truth-format", f"How to read it: {', '.join(TRUTH_FORMATS[1:])}")
    shift: int = option(
        "--shift N", "Add N to the frame numbers of the ground truth.", type=int, default=0, show_default=False
    )
    partial: bool = flag("--partial", "Take the frames that both have, though ground truth or track lacks some.")
    target: str | None = TARGET

    def refuse(self, *, target: bool) -> None:
        """UsageError, since there is no file, for an option that says how to read it; for --target only if `target`."""
        given = {
            "--truth-format": self.truth_format != "auto",
            "--shift": self.shift != 0,
            "--partial": self.partial,
            "--target": target and self.target,
        }
        if idle := [name for name, value in given.items() if value]:
            raise UsageError(f"{idle[0]} says how to use ground truth; give its file with --truth FILE")

    def read(self, path: Path, beside: Trajectory | None = None) -> Trajectory:
        from facetrack_cli.trajectory.formats.read import read_truth

        return read_truth(path, self.truth_format, shift=self.shift, beside=beside)

    def pairs(self, ours: Trajectory, theirs: Trajectory, note: Callable[[str], None]) -> list[Pair]:
        """The rows of a trajectory beside those of the ground truth; `note` gets what to know of it."""
        from facetrack_cli.evaluation.match import match

        return match(ours, theirs, partial=self.partial, select=self.target, note=note)


class Page:
    """The page in the browser."""

    port: int | None = option(
        "--port N", "Port of the page on this machine [default: any that is free].", type=Whole(min=1, max=65535)
    )
    browse: bool = flag("--open", "Also open the page in the browser.")

    def refuse(self, remedy: str) -> None:
        """UsageError if there is to be no page, but an option of it was given."""
        if self.port is not None or self.browse:
            raise UsageError(f"{'--open' if self.port is None else '--port'} is for the page; {remedy}")

    def serve(self, session: PageSession, stop: Stop) -> bool:
        """Serve a page until it is saved or stopped, and say what it did; whether it was saved."""
        from facetrack_cli.editor.web.server import run_page

        run_page(session, stop, say, port=self.port or 0, browse=self.browse)
        if session.ended is None:
            return False
        for line in (*session.ended["messages"], f"next: {session.ended['next']}"):
            say(line)
        return True


def say(line: str) -> None:
    """A line on standard error, also where a name holds line breaks."""
    click.echo(log_line(line), err=True)


def write_figure(
    path: Path, make: Callable[[], Figure], *, overwrite: bool, inputs: Iterable[Path] = (), dpi: float = 120.0
) -> None:
    """The figure, in the form that the file's ending names; refuses before `make` what would be refused after it."""
    from facetrack_cli.core.files import check_new, write_new
    from facetrack_cli.report.figures.style import need_matplotlib, render

    check_new(path, overwrite=overwrite, inputs=inputs)
    need_matplotlib()
    write_new(path, render(make(), path.suffix[1:].lower(), dpi=dpi), overwrite=overwrite)


class Results:
    """Where the results of many runs go, and how many processes make them."""

    as_json: bool = flag("--json", "Print JSON instead of the table.")
    as_csv: bool = flag("--csv", "Print CSV instead of the table.")
    no_plots: bool = flag("--no-plots", "Draw nothing.")
    overwrite: bool = OVERWRITE
    jobs: int = jobs_option("Processes that share the runs.")
    quiet: bool = flag("--quiet -q", "Print the table, and nothing else but errors.")

    @contextlib.contextmanager
    def open(
        self, clip: Path, out: str | None, default: str, stem: str, plots: Sequence[str]
    ) -> Iterator[tuple[Stop, Progress, Callable[[Any, Figures], None]]]:
        """The wish to stop, the progress, and what publishes results as `stem`.json and so on in `out`, or `default`.

        Raises OutputError where there can be no results.
        """
        from facetrack_cli.core.files import Folder
        from facetrack_cli.runs.progress import progress
        from facetrack_cli.runs.signals import Stop

        names = [*(f"{stem}.{ending}" for ending in TABLES), *(() if self.no_plots else plots)]
        with (
            Stop().listening() as stopped,
            progress(self.quiet) as shown,
            Folder(out, default, names, overwrite=self.overwrite, clip=clip) as folder,
        ):
            yield stopped, shown, partial(self._publish, names, shown, folder)

    def _publish(
        self, names: Sequence[str], shown: Progress, folder: Folder, found: Comparison, figures: Figures
    ) -> None:
        """Write all files, without matplotlib all but the plots, and print the table, or the data."""
        texts, sheet = (found.json(), found.csv()), found.sheet()
        try:
            for name, text in zip(names, (*texts, sheet.markdown()), strict=False):  # the others are plots
                folder.write(name, text)
            if not self.no_plots and self._can_draw(shown):
                for name, png in figures():
                    folder.write(name, png)
        finally:  # what took long is not lost for a full disk
            if self.as_json or self.as_csv:
                click.echo(texts[0 if self.as_json else 1], nl=False)
            else:
                sheet.show()
        shown.say(f"{found.clip} -> {folder.summary()}")

    def _can_draw(self, shown: Progress) -> bool:
        from facetrack_cli.report.figures.style import need_matplotlib

        try:
            need_matplotlib()
        except UsageError as e:
            shown.say(f"facetrack: warning: no plots: {e}")
            return False
        return True
