"""Tables of text: on a terminal, piped, and as Markdown."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import click

WIDE: Final = 100  # columns of a table that is not printed on a terminal
ENDLESS: Final = 10_000
LEAST_NAME: Final = 20  # columns that a name has at least before it is broken
NO_FIGURE: Final = "\N{EN DASH}"
OVERRIDES: Final = r",(?=[\w.]+=)"  # a comma before a key, which those in windows=[25,25] are not


@dataclass(frozen=True)
class Sheet:
    """A table of text: `heads` may hold line breaks; the columns in `left` hold names; `notes` stand below."""

    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()
    left: tuple[int, ...] = (1,)


def clip_name(clip: Path) -> str:
    """A clip in titles: a file's name; a folder with the one above it, since so many are called img."""
    place = Path(os.path.abspath(clip))  # noqa: PTH100 -- Path.resolve follows links
    return f"{place.parent.name}/{place.name}" if place.is_dir() and place.parent.name else place.name


def markdown(given: Sheet, title: str) -> str:
    """The table as Markdown, padded so that it reads as text too."""
    heads = [head.replace("\n", " ") for head in given.heads]
    cells = [[cell.replace("|", "\\|") for cell in row] for row in [heads, *given.rows]]
    wide = [max(len(row[i]) for row in cells) for i in range(len(heads))]

    def line(row: Sequence[str]) -> str:
        padded = [
            cell.ljust(w) if i in given.left else cell.rjust(w)
            for i, (cell, w) in enumerate(zip(row, wide, strict=True))
        ]
        return f"| {' | '.join(padded)} |"

    rule = [f":{'-' * (w - 1)}" if i in given.left else f"{'-' * (w - 1)}:" for i, w in enumerate(wide)]
    text = "\n".join([line(cells[0]), f"| {' | '.join(rule)} |", *(line(row) for row in cells[1:])])
    return f"{title}\n\n{text}\n\n" + "".join(f"- {note}\n" for note in given.notes)


def show(given: Sheet, title: str) -> None:
    """Print the table: as wide as the terminal, or 100 columns where there is none; wider only for what must fit."""
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=SIMPLE_HEAD, pad_edge=False, header_style="bold", show_edge=False, padding=(0, 1))
    tall = max(head.count("\n") for head in given.heads)
    for i, head in enumerate(given.heads):
        left = i in given.left
        cells = [head, *(broken(row[i]) if left else row[i] for row in given.rows)]
        longest = max(len(line) for cell in cells for line in cell.split("\n"))
        # names are broken rather than cut, figures never are
        table.add_column(
            Text("\n" * (tall - head.count("\n")) + head, justify="left" if left else "right"),
            justify="left" if left else "right",
            no_wrap=not left,
            overflow="fold",
            min_width=min(longest, LEAST_NAME) if left else longest,
        )
    for row in given.rows:
        table.add_row(*(Text(broken(cell) if i in given.left else cell) for i, cell in enumerate(row)))

    console = Console(width=None if sys.stdout.isatty() else WIDE, emoji=False, highlight=False, markup=False)
    room = console.width
    needed = console.measure(table, options=console.options.update(width=ENDLESS)).minimum
    # rich would leave with a code of its own where nobody reads any more, so it prints nothing itself
    with console.capture() as text:
        console.print(Text(title, style="bold"), soft_wrap=True)
        console.print()
        console.width = max(room, needed)
        console.print(table)
        console.width = room
        console.print()
        for note in given.notes:
            console.print(Text(note))
    lines = "\n".join(line.rstrip() for line in text.get().splitlines())
    encoding = sys.stdout.encoding or "utf-8"
    click.echo(lines.encode(encoding, "replace").decode(encoding))  # a ? where there is no arrow keeps columns straight


def broken(label: str) -> str:
    """A long label of a recipe and its overrides, with a line for each of them."""
    name, colon, rest = label.partition(":")
    if len(label) <= LEAST_NAME or "=" not in rest:
        return label
    return "\n".join([f"{name}{colon}", *(f"  {one}" for one in re.split(OVERRIDES, rest))])
