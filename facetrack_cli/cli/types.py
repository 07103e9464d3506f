"""Values of options and arguments: what the help calls them, how they are read, and what a shell completes.

A shell asks at each key, so completion loads no recipe.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import click
from click.shell_completion import CompletionItem

from facetrack_cli.core.errors import UsageError
from facetrack_cli.core.models import shipped_recipes

if TYPE_CHECKING:
    from facetrack_cli.core.types import Box
    from facetrack_cli.trajectory.clock import Clock

Complete: TypeAlias = Callable[[click.Context, str], list[CompletionItem]]
FIGURES = ("png", "svg", "pdf")  # those that report/figures/style.py renders


class Whole(click.IntRange):
    """A whole number in a range; click itself would call it an integer range."""

    name = "whole number"

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        return "N"


class Number(click.FloatRange):
    """A number in a range: nan and infinity are none."""

    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is no finite number.", param, ctx)
        return number


class Text(click.ParamType):  # type: ignore[type-arg]  # it has arguments since Click 8.4
    """A value that the help calls `metavar`.

    `parse` reads it and raises BadParameter, `complete` completes it. An option that is not to be empty is told to name
    `what`.
    """

    name = "text"

    def __init__(
        self, metavar: str, parse: Callable[[str], Any] = str, complete: Complete | None = None, what: str = ""
    ) -> None:
        self.metavar, self.parse, self.complete, self.what = metavar, parse, complete, what

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        return self.metavar

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "" and self.what and isinstance(param, click.Option):
            raise UsageError(f"{max(param.opts, key=len)} is empty; name {self.what}")
        return self.parse(value) if isinstance(value, str) else value

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        return self.complete(ctx, incomplete) if self.complete else []


def words(metavar: str, pattern: str, remedy: str) -> Text:
    """Values that a pattern takes apart into words; `remedy` says what to give."""

    def parse(value: str) -> tuple[str, ...]:
        match = re.fullmatch(pattern, value)
        each = tuple(word.strip() for word in match.groups()) if match else ()
        if not each or not all(each):
            raise click.BadParameter(f"{value!r}: {remedy}")
        return each

    return Text(metavar, parse)


# what a shell completes


def _files(ctx: click.Context, incomplete: str) -> list[CompletionItem]:
    return [CompletionItem(incomplete, type="file")]


def _folders(ctx: click.Context, incomplete: str) -> list[CompletionItem]:
    return [CompletionItem(incomplete, type="dir")]


def _runs(ctx: click.Context, incomplete: str) -> list[CompletionItem]:
    """Folders of runs; without one, any folder."""
    above, slash, prefix = incomplete.rpartition("/")
    runs: list[Path] = []
    with contextlib.suppress(OSError):
        folders = sorted(path for path in Path(f"{above}{slash}" or ".").iterdir() if path.name.startswith(prefix))
        runs = [path for path in folders if (path / "run.json").is_file() or (path / "trajectory.json").is_file()]
    return _folders(ctx, incomplete) + [CompletionItem(f"{above}{slash}{path.name}") for path in runs]


def _recipes(ctx: click.Context, incomplete: str) -> list[CompletionItem]:
    """Names of shipped recipes, and files."""
    names = [path.stem for path in shipped_recipes()]
    # files first: Bash then takes them only where no name fits
    return _files(ctx, incomplete) + [CompletionItem(name) for name in names if name.startswith(incomplete)]


def _keys(ctx: click.Context, incomplete: str) -> list[CompletionItem]:
    """Keys that the recipe of the command line has, or any shipped one."""
    shipped = {path.stem: path for path in shipped_recipes()}
    values = [ctx.params.get(name) for name in ("config", "recipe")]
    names = [name for value in values for name in ([value] if isinstance(value, str) else value or ())]
    files = [shipped.get(name.removesuffix(".yaml"), Path(name)) for name in names] or list(shipped.values())
    keys: dict[str, None] = {}
    for file in files:
        with contextlib.suppress(OSError, ValueError):
            keys.update(dict.fromkeys(_keys_of(file.read_text(encoding="utf-8"))))
    return [CompletionItem(f"{key}=") for key in keys if key.startswith(incomplete)]


def _keys_of(text: str) -> Iterator[str]:
    """The keys of a recipe that have values, with dots between the levels, as its lines show them."""
    above: list[tuple[int, str]] = []  # indentation and name of the sections around a line
    for indent, name, value in re.findall(r"^( *)(\w+):(.*)$", text, re.MULTILINE):
        while above and above[-1][0] >= len(indent):
            above.pop()
        key = ".".join([*(one for _, one in above), name])
        value = value.partition(" #")[0].strip()
        if value.startswith("{"):
            yield from (f"{key}.{below}" for below in re.findall(r"(\w+):", value))
        elif value:
            yield key
        else:
            above.append((len(indent), name))


# how values are read


def _box(value: str) -> Box:
    """`left,top,width,height` in pixels."""
    try:
        x, y, w, h = (float(part) for part in value.split(","))
    except ValueError:
        raise click.BadParameter(f"{value!r}: give four numbers with commas: left,top,width,height") from None
    if not (abs(x) < 1e6 and abs(y) < 1e6 and 0 < w < 1e6 and 0 < h < 1e6):
        raise click.BadParameter(f"{value!r}: give pixels of the frame, width and height above 0")
    return (x, y, w, h)


def _rate(value: str) -> Fraction:
    """Frames per second."""
    with contextlib.suppress(ValueError, ZeroDivisionError):
        if 0 < (rate := Fraction(value)) <= 100_000:
            return rate
    raise click.BadParameter(f"{value!r}: give frames per second as 25, 29.97 or 30000/1001")


def _file(metavar: str, *endings: str) -> Text:
    """A file to write, whose kind the end of its name says."""
    listed = " or".join(", ".join(f".{one}" for one in endings).rsplit(",", 1))

    def parse(value: str) -> Path:
        if Path(value).suffix[1:].lower() not in endings:
            raise UsageError(f"{value}: cannot tell the kind of file; let its name end in {listed}")
        return Path(value)

    return Text(metavar, parse, _files, f"a file that ends in {listed}")


FILE, INPUT = Text("FILE", Path, _files, "a file"), Text("INPUT", Path, _files)
PNG, NPZ, FIGURE = _file("FILE.png", "png"), _file("FILE.npz", "npz"), _file("FILE", *FIGURES)
FOLDER, PROJECT = Text("DIR", Path, _folders, "a folder"), Text("PROJECT", Path, _folders)
RUN = Text("RUN_DIR", Path, _runs)
TRAJECTORY = Text("TRAJECTORY", Path, lambda ctx, incomplete: _files(ctx, incomplete) + _runs(ctx, incomplete)[1:])
FILE_OR_DASH = Text("FILE", complete=_files, what="a file, or - for standard output")
FOLDER_OR_DASH = Text("DIR", complete=_folders, what="a folder, or - for standard output")
GALLERY = Text("FILE", complete=_files, what="a gallery, as facetrack gallery fit writes it")
INIT = Text(
    "FILE", lambda value: value if value in ("haar", "yunet") else Path(value), _files,
    "an init file, or haar to look for a face",
)  # fmt: skip
RECIPE, KEY = Text("RECIPE", complete=_recipes), Text("KEY=VALUE", complete=_keys)
BOX, RATE = Text("X,Y,W,H", _box), Text("RATE", _rate)
FRAME = Whole(min=0)


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
