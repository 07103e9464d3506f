"""What a shell completes: recipes, their keys, files and folders. It answers at each key, so it loads no recipe."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeAlias

import click
from click.shell_completion import CompletionItem

from facetrack_cli.core.models import shipped_recipes

Complete: TypeAlias = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def completes(metavar: str) -> Complete | None:
    """The completion of a value that the help calls `metavar`; None: click completes it by the value's type."""
    return _COMPLETE.get(metavar.rstrip("."))


def _files(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    return [CompletionItem(incomplete, type="file")]


def _folders(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    return [CompletionItem(incomplete, type="dir")]


def _runs(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Folders of runs; without one, any folder."""
    typed, _, begun = incomplete.rpartition("/")
    found = []
    with contextlib.suppress(OSError):
        for one in sorted(Path(f"{typed}/" if "/" in incomplete else ".").iterdir()):
            if one.name.startswith(begun) and any((one / name).is_file() for name in ("run.json", "trajectory.json")):
                found.append(CompletionItem(f"{typed}/{one.name}" if "/" in incomplete else one.name))
    return _folders(ctx, param, incomplete) + found


def _recipes(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Names of shipped recipes, and files."""
    names = [path.stem for path in shipped_recipes()]
    # files first: Bash then takes them only where no name fits
    return _files(ctx, param, incomplete) + [CompletionItem(name) for name in names if name.startswith(incomplete)]


def _keys(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Keys that the recipe of the command line has, or any shipped one."""
    shipped = {path.stem: path for path in shipped_recipes()}
    given = [ctx.params.get(name) for name in ("config", "recipe")]
    names = [name for one in given for name in ([one] if isinstance(one, str) else one or ())]
    files = [shipped.get(name.removesuffix(".yaml"), Path(name)) for name in names] or list(shipped.values())
    found: dict[str, None] = {}
    for file in files:
        with contextlib.suppress(OSError, ValueError):
            found.update(dict.fromkeys(_keys_of(file.read_text(encoding="utf-8"))))
    return [CompletionItem(f"{key}=") for key in found if key.startswith(incomplete)]


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


_COMPLETE: dict[str, Complete] = {
    "FILE": _files,
    "FILE.png": _files,
    "DIR": _folders,
    "RUN_DIR": _runs,
    "TRAJECTORY": lambda ctx, param, incomplete: _files(ctx, param, incomplete) + _runs(ctx, param, incomplete)[1:],
    "RECIPE": _recipes,
    "KEY=VALUE": _keys,
}
