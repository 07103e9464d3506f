"""Tables of results: on a terminal, piped, and as Markdown."""

import math
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import click
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from facetrack_cli.core.errors import flat, visible
from facetrack_cli.core.files import absolute
from facetrack_cli.recipe.load import OVERRIDES

WIDTH: Final = 100  # columns of a table that is not printed on a terminal
MAX_WIDTH: Final = 10_000  # more columns than any table needs
MIN_NAME: Final = 20  # columns of a name before it is broken
NO_FIGURE: Final = "\N{EN DASH}"


@dataclass(frozen=True)
class Sheet:
    """A table of text. `heads` may hold line breaks; columns in `left` hold names; `notes` stand below the table."""

    title: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()
    left: tuple[int, ...] = (0,)

    def markdown(self) -> str:
        """The table as Markdown, padded so that it reads as text too."""
        heads = [head.replace("\n", " ") for head in self.heads]
        cells = [[cell.replace("|", "\\|") for cell in row] for row in [heads, *self.rows]]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]

        def line(row: Sequence[str]) -> str:
            each = enumerate(zip(row, widths, strict=True))
            return f"| {' | '.join(cell.ljust(w) if i in self.left else cell.rjust(w) for i, (cell, w) in each)} |\n"

        rule = [f":{'-' * (w - 1)}" if i in self.left else f"{'-' * (w - 1)}:" for i, w in enumerate(widths)]
        text = "".join([line(cells[0]), line(rule), *map(line, cells[1:])])
        return f"{self.title}\n\n{text}\n" + "".join(f"- {note}\n" for note in self.notes)

    def table(self, *, ruled: bool = True) -> Table:
        """The table for rich, without title and notes. Long names are broken, and figures are never cut."""
        look = {"box": SIMPLE_HEAD, "padding": (0, 1), "header_style": "bold"}
        if not ruled:
            look = {"box": None, "padding": (0, 2, 0, 0), "header_style": "dim"}
        table = Table(pad_edge=False, show_edge=False, **look)  # type: ignore[arg-type]
        rows = [[_broken(cell) if i in self.left else cell for i, cell in enumerate(row)] for row in self.rows]
        tall = max(head.count("\n") for head in self.heads)
        for i, (head, *column) in enumerate(zip(self.heads, *rows, strict=True)):
            left = i in self.left
            longest = max(len(line) for cell in (head, *column) for line in cell.split("\n"))
            table.add_column(
                Text("\n" * (tall - head.count("\n")) + head),
                justify="left" if left else "right",
                no_wrap=not left,
                overflow="fold",
                min_width=min(longest, MIN_NAME) if left else longest,
            )
        for row in rows:
            table.add_row(*(Text(visible(cell)) for cell in row))
        return table

    def show(self) -> None:
        """Print the table as wide as the terminal, or WIDTH columns; wider only for what must not be cut."""
        console = Console(width=None if sys.stdout.isatty() else WIDTH, emoji=False, highlight=False, markup=False)
        table, width = self.table(), console.width
        needed = console.measure(table, options=console.options.update(width=MAX_WIDTH)).minimum
        # rich would end the program with its own code where the reader of a pipe has left, so click prints
        with console.capture() as text:
            console.print(Text(flat(self.title), style="bold"), soft_wrap=True)
            console.print()
            console.width = max(width, needed)
            console.print(table)
            console.width = width
            console.print()
            for note in self.notes:
                console.print(Text(visible(note)))
        encoding = sys.stdout.encoding or "utf-8"
        # a ? in place of an arrow keeps columns straight
        click.echo(trimmed(text.get()).encode(encoding, "replace").decode(encoding), nl=False)


def trimmed(text: str) -> str:
    """Lines without blanks at their ends."""
    return "".join(f"{line.rstrip()}\n" for line in text.splitlines())


def _broken(label: str) -> str:
    """A long label of a recipe and its overrides, with a line for each of them."""
    name, colon, rest = label.partition(":")
    if len(label) <= MIN_NAME or "=" not in rest:
        return label
    return "\n".join([f"{name}{colon}", *(f"  {override}" for override in re.split(OVERRIDES, rest))])


def clip_name(clip: Path) -> str:
    """A clip in titles: a file's name; a folder with the folder above it, since many are called img."""
    place = absolute(clip)
    return f"{place.parent.name}/{place.name}" if place.is_dir() and place.parent.name else place.name


def rounded(value: float | None, digits: int) -> float | None:
    """None for what JSON has no number for."""
    return None if value is None or not math.isfinite(value) else round(value, digits)
