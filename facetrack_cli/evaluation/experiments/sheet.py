"""What an experiment found, as text: a table on a terminal, piped or as Markdown, and JSON."""

import math
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import click

from facetrack_cli.core.errors import flat, visible
from facetrack_cli.core.files import absolute
from facetrack_cli.runs.seeds import OVERRIDES

WIDE: Final = 100  # columns of a table that is not printed on a terminal
ENDLESS: Final = 10_000
LEAST_NAME: Final = 20  # columns that a name has at least before it is broken
NO_FIGURE: Final = "\N{EN DASH}"


@dataclass(frozen=True)
class Sheet:
    """A table of text: `heads` may hold line breaks; the columns in `left` hold names; `notes` stand below."""

    title: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()
    left: tuple[int, ...] = (1,)

    def markdown(self) -> str:
        """The table as Markdown, padded so that it reads as text too."""
        heads = [head.replace("\n", " ") for head in self.heads]
        cells = [[cell.replace("|", "\\|") for cell in row] for row in [heads, *self.rows]]
        wide = [max(map(len, column)) for column in zip(*cells, strict=True)]

        def line(row: Sequence[str]) -> str:
            padded = [
                cell.ljust(w) if i in self.left else cell.rjust(w)
                for i, (cell, w) in enumerate(zip(row, wide, strict=True))
            ]
            return f"| {' | '.join(padded)} |\n"

        rule = [f":{'-' * (w - 1)}" if i in self.left else f"{'-' * (w - 1)}:" for i, w in enumerate(wide)]
        text = "".join([line(cells[0]), line(rule), *map(line, cells[1:])])
        return f"{self.title}\n\n{text}\n" + "".join(f"- {note}\n" for note in self.notes)

    def show(self) -> None:
        """Print the table: as wide as the terminal, 100 columns where there is none; wider only for what must fit."""
        from rich.box import SIMPLE_HEAD
        from rich.console import Console
        from rich.table import Table
        from rich.text import Text

        table = Table(box=SIMPLE_HEAD, pad_edge=False, header_style="bold", show_edge=False, padding=(0, 1))
        rows = [[broken(cell) if i in self.left else cell for i, cell in enumerate(row)] for row in self.rows]
        tall = max(head.count("\n") for head in self.heads)
        for i, (head, *column) in enumerate(zip(self.heads, *rows, strict=True)):
            left = i in self.left
            longest = max(len(line) for cell in (head, *column) for line in cell.split("\n"))
            # names are broken rather than cut, figures never are
            table.add_column(
                Text("\n" * (tall - head.count("\n")) + head, justify="left" if left else "right"),
                justify="left" if left else "right",
                no_wrap=not left,
                overflow="fold",
                min_width=min(longest, LEAST_NAME) if left else longest,
            )
        for row in rows:
            table.add_row(*(Text(visible(cell)) for cell in row))

        console = Console(width=None if sys.stdout.isatty() else WIDE, emoji=False, highlight=False, markup=False)
        room = console.width
        needed = console.measure(table, options=console.options.update(width=ENDLESS)).minimum
        # rich would leave with a code of its own where nobody reads any more, so it prints nothing itself
        with console.capture() as text:
            console.print(Text(flat(self.title), style="bold"), soft_wrap=True)
            console.print()
            console.width = max(room, needed)
            console.print(table)
            console.width = room
            console.print()
            for note in self.notes:
                console.print(Text(visible(note)))
        lines = "\n".join(line.rstrip() for line in text.get().splitlines())
        encoding = sys.stdout.encoding or "utf-8"
        # a ? where there is no arrow keeps columns straight
        click.echo(lines.encode(encoding, "replace").decode(encoding))


def broken(label: str) -> str:
    """A long label of a recipe and its overrides, with a line for each of them."""
    name, colon, rest = label.partition(":")
    if len(label) <= LEAST_NAME or "=" not in rest:
        return label
    return "\n".join([f"{name}{colon}", *(f"  {one}" for one in re.split(OVERRIDES, rest))])


def clip_name(clip: Path) -> str:
    """A clip in titles: a file's name; a folder with the one above it, since so many are called img."""
    place = absolute(clip)
    return f"{place.parent.name}/{place.name}" if place.is_dir() and place.parent.name else place.name


def rounded(value: float | None, digits: int) -> float | None:
    """None for what JSON has no number for."""
    return None if value is None or not math.isfinite(value) else round(value, digits)
