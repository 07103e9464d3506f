"""What commands share: kinds of values, a help in sections, groups of options.

A kind of value says what the help calls it, how it is read, and what a shell completes. A shell asks at each key, so
completion loads no recipe. A group of options reaches its command as one value, as `extent` of `@extent_options`.
"""

from __future__ import annotations

import contextlib
import functools
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import click
from click.shell_completion import CompletionItem

from facetrack_cli.core.errors import ExitCode, UsageError, write_line
from facetrack_cli.core.models import shipped_recipes
from facetrack_cli.trajectory.formats import TRUTH_FORMATS

if TYPE_CHECKING:
    from facetrack_cli.core.types import Box
    from facetrack_cli.editor.session import Page as PageSession
    from facetrack_cli.evaluation.rows import Pair
    from facetrack_cli.runs.progress import Progress
    from facetrack_cli.runs.signals import Stop
    from facetrack_cli.trajectory.trajectory import Trajectory
    from facetrack_cli.trajectory.views import Clock


class Text(click.ParamType):  # type: ignore[type-arg]  # it has arguments since Click 8.4
    """A value that the help calls `metavar`, which `parse` reads, or refuses by BadParameter.

    A shell completes it as a "file" or a "dir", and by what `names` gives.
    """

    name = "text"

    def __init__(
        self, metavar: str, parse: Callable[[str], Any] = str, completed: str = "",
        names: Callable[[], Iterable[str]] = tuple,
    ) -> None:  # fmt: skip
        self.metavar, self.parse, self.completed, self.names = metavar, parse, completed, names

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        return self.metavar

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "" and self.completed and isinstance(param, click.Option):
            raise UsageError(f"{max(param.opts, key=len)} is empty; give a name, or leave it out")
        return self.parse(value) if isinstance(value, str) else value

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        # files first: Bash then takes them only where no name fits
        files = [CompletionItem(incomplete, type=self.completed)] if self.completed else []
        return files + [CompletionItem(name) for name in self.names() if name.startswith(incomplete)]


def words(metavar: str, pattern: str, remedy: str) -> Text:
    """Values that a pattern takes apart into words; `remedy` says what to give."""

    def parse(value: str) -> tuple[str, ...]:
        match = re.fullmatch(pattern, value)
        each = tuple(word.strip() for word in match.groups()) if match else ()
        if not each or not all(each):
            raise click.BadParameter(f"{value!r}: {remedy}")
        return each

    return Text(metavar, parse)


# how values are read


def _box(value: str) -> Box:
    """`left,top,width,height` in pixels."""
    with contextlib.suppress(ValueError):
        x, y, w, h = (float(part) for part in value.split(","))
        if abs(x) < 1e6 and abs(y) < 1e6 and 0 < w < 1e6 and 0 < h < 1e6:
            return (x, y, w, h)
    raise click.BadParameter(f"{value!r}: give four numbers with commas, in pixels: left,top,width,height")


def _rate(value: str) -> Fraction:
    """Frames per second."""
    with contextlib.suppress(ValueError, ZeroDivisionError):
        if 0 < (rate := Fraction(value)) <= 100_000:
            return rate
    raise click.BadParameter(f"{value!r}: give frames per second as 25, 29.97 or 30000/1001")


FILE, INPUT, TRAJECTORY = (Text(metavar, Path, "file") for metavar in ("FILE", "INPUT", "TRAJECTORY"))
FOLDER, PROJECT, RUN = (Text(metavar, Path, "dir") for metavar in ("DIR", "PROJECT", "RUN_DIR"))
PNG, NPZ = Text("FILE.png", Path, "file"), Text("FILE.npz", Path, "file")
FILE_OR_DASH, FOLDER_OR_DASH, GALLERY = Text("FILE", str, "file"), Text("DIR", str, "dir"), Text("FILE", str, "file")
INIT = Text("FILE", lambda value: value if value in ("haar", "yunet") else Path(value), "file")
RECIPE = Text("RECIPE", str, "file", lambda: (path.stem for path in shipped_recipes()))
KEY, BOX, RATE = Text("KEY=VALUE"), Text("X,Y,W,H", _box), Text("RATE", _rate)
FRAME = click.IntRange(0)


def moment(metavar: str) -> Text:
    """A name at a time."""
    return words(metavar, "(.*)@([^@]*)", "give a name and a time, as person_2@1:23 or person_2@2075f")


def frame_at(at: str, clock: Clock) -> int:
    """The frame of a moment: 2075f, 83, 1:23 or 0:01:23.5. UsageError for anything else."""
    try:
        if at[-1:].lower() == "f":
            return int(at[:-1])
        seconds = 0.0
        for part in at.split(":"):
            seconds = 60 * seconds + float(part)
        return clock.frame(seconds)
    except (ValueError, OverflowError):
        raise UsageError(f"@{at}: is no time; give 1:23, 83 (seconds) or 2075f (a frame)") from None


Decorator: TypeAlias = Callable[[Callable[..., Any]], Callable[..., Any]]


class Option(click.Option):
    """An option whose variable is named after its flag, as FACETRACK_RUN_SET, whatever its parameter is called."""

    def _variable(self, ctx: click.Context) -> str:
        return f"{ctx.auto_envvar_prefix}_{max(self.opts, key=len).lstrip('-').replace('-', '_').upper()}"

    def resolve_envvar_value(self, ctx: click.Context) -> str | None:
        return os.environ.get(self._variable(ctx)) or None

    def get_error_hint(self, ctx: click.Context | None) -> str:
        """What an error names: the variable, if the value is its."""
        if ctx and ctx.get_parameter_source(str(self.name)) is click.core.ParameterSource.ENVIRONMENT:
            return self._variable(ctx)
        return super().get_error_hint(ctx)


EVERY = f"{__name__}.every"  # in the `meta` of a context: its help shows all options
say = write_line  # on standard error
option = functools.partial(click.option, cls=Option)
flag = functools.partial(option, is_flag=True)


class Command(click.Command):
    """A command of many options: its help has them in sections, and --help shows those that most need.

    `sections` has a title by the name of the first option of each; --help shows the `basic` ones, --help-all all.
    """

    def __init__(self, *args: Any, sections: Mapping[str, str] | None = None, basic: str, **more: Any) -> None:
        super().__init__(*args, **more)
        self.sections = sections or {}
        self.basic = {*basic.split(), "help", "help_all"}
        self.params.append(
            click.Option(
                ["--help-all"], is_flag=True, is_eager=True, expose_value=False, callback=_show_all,
                help="Show all options, and exit.",
            )
        )  # fmt: skip

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        title, rows = "Options", dict[str, list[tuple[str, str]]]()
        params = self.get_params(ctx)  # --help is the last
        for param in params[-1:] + params[:-1] if self.sections else params:
            title, row = self.sections.get(str(param.name), title), param.get_help_record(ctx)
            if row is not None and (param.name in self.basic or ctx.meta.get(EVERY)):
                rows.setdefault("Options" if param.name == "help_all" else title, []).append(row)
        for title, listed in rows.items():
            with formatter.section(title):
                formatter.write_dl(listed)


def _show_all(ctx: click.Context, _: click.Parameter, value: bool) -> None:
    if value:
        ctx.meta[EVERY] = True
        click.echo(ctx.get_help())
        ctx.exit()


def refuse(*rules: tuple[object, str]) -> None:
    """UsageError with the message of the first rule whose condition holds."""
    for condition, message in rules:
        if condition:
            raise UsageError(message)


def gathered(name: str, kind: type[Any], *options: Decorator) -> Decorator:
    """A decorator that adds options to a command, which gets them as one value `name` of a dataclass."""

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(command)
        def call(**values: Any) -> Any:
            group = kind(**{field.name: values.pop(field.name) for field in fields(kind)})
            return command(**{name: group}, **values)

        for add in reversed(options):
            add(call)
        return call

    return decorate


# options of several commands


def jobs(text: str) -> Decorator:
    return option("-j", "--jobs", type=click.IntRange(1, 1000), default=1, show_default=False, help=text)


def set_(text: str) -> Decorator:
    return option("--set", "overrides", type=KEY, multiple=True, help=text)


def format_of(name: str, text: str) -> Decorator:
    """How to read a file that another program may have written."""
    return option(
        name, type=click.Choice(TRUTH_FORMATS), metavar="FORMAT", default="auto", show_default=False,
        help=f"{text} [default: by its shape].",
    )  # fmt: skip


config = option(
    "--config",
    "--recipe",
    type=RECIPE,
    help="Recipe: a file, or a name [default: face; with --box correlation_filter].",
)
clip = option("--clip", type=INPUT, help="The clip, if it is elsewhere now.")
target = option("--target", type=Text("NAME[/PART]"), help="One target, or one part of it, alone.")
overwrite = flag("--overwrite", help="Replace files that are there already.")
quiet = flag("--quiet", "-q", help="Say nothing but errors.")
port = option("--port", type=click.IntRange(1, 65535), help="Port of the page [default: any that is free].")


@dataclass
class Extent:
    """Where the tracks of a clip begin, and which of its frames are read."""

    init: Path | Literal["haar", "yunet"] | None
    box: Box | None
    start: int
    stop: int | None
    fps: Fraction | None

    def check(self) -> None:
        """UsageError where options contradict each other."""
        from facetrack_cli.runs.plan import check_span

        both = self.init is not None and self.box is not None
        refuse((both, "--init and --box both say where the track starts; give one of them"))
        check_span(self.start, self.stop)


extent_options = gathered(
    "extent", Extent,
    option("--init", type=INIT,
           help="Init file; `haar` or `yunet` looks for a face even if one lies beside the clip."),
    option("--box", type=BOX, help="The face, head or hand in the first frame, in pixels."),
    option("--start", type=FRAME, default=0, show_default=False, help="First frame, from 0."),
    option("--stop", type=FRAME, help="Frame to stop before."),
    option("--fps", type=RATE, help="Frames per second of a folder of images."),
)  # fmt: skip


@dataclass
class TruthOptions:
    """How a file of ground truth is read."""

    truth_format: str
    shift: int
    partial: bool
    target: str | None

    def read(self, path: Path, beside: Trajectory | None = None) -> Trajectory:
        from facetrack_cli.trajectory.formats.boxes import read_truth

        return read_truth(path, self.truth_format, shift=self.shift, beside=beside)

    def pairs(self, ours: Trajectory, theirs: Trajectory, note: Callable[[str], None]) -> list[Pair]:
        """The rows of a trajectory beside those of the ground truth; `note` gets what to know of it."""
        from facetrack_cli.evaluation.rows import match

        return match(ours, theirs, partial=self.partial, select=self.target, note=note)


truth_options = gathered(
    "reference", TruthOptions,
    format_of("--truth-format", f"How to read it: {', '.join(TRUTH_FORMATS[1:])}"),
    option("--shift", type=int, metavar="N", default=0, show_default=False,
           help="Add N to the frame numbers of the ground truth."),
    flag("--partial", help="Take the frames that both have, though ground truth or track lacks some."),
    target,
)  # fmt: skip


@dataclass
class Page:
    """The page in the browser."""

    port: int | None
    browse: bool

    def serve(self, session: PageSession) -> int:
        """Serve a page until it is saved or stopped, and say what it did; the exit code."""
        from facetrack_cli.editor.server import run_page
        from facetrack_cli.runs.signals import Stop

        with Stop().listening() as stop:
            run_page(session, stop, say, port=self.port or 0, browse=self.browse)
        if session.ended is None:
            say(f"facetrack: {stop.reason}; {session.left()}")
            return stop.code or ExitCode.FAULT
        for line in (*session.ended["messages"], f"next: {session.ended['next']}"):
            say(line)
        return ExitCode.DONE


page_options = gathered(
    "page", Page,
    port,
    flag("--open", "browse", help="Also open the page in the browser."),
)  # fmt: skip


@contextmanager
def working(quiet: bool, folder: Path, stopped: str = "") -> Iterator[tuple[Stop, Progress]]:
    """Work on a run that Ctrl-C ends: then `stopped` says what became of it, and the command leaves."""
    from facetrack_cli.runs.progress import progress
    from facetrack_cli.runs.signals import Stop, StoppedError

    with Stop().listening() as stop, progress(quiet) as shown:
        try:
            shown.begin(folder.name or str(folder))
            yield stop, shown
        except StoppedError:
            shown.say(f"facetrack: {stop.reason}; {stopped or f'{folder} is as it was'}")
            raise click.exceptions.Exit(stop.code or ExitCode.FAULT) from None
