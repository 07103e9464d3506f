"""All that the report's page shows, as one value."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from facetrack_cli.formats.table import Table
from facetrack_cli.report.events import Clock, KeyFrame, Story
from facetrack_cli.report.frames import Pictures
from facetrack_cli.report.header import Header
from facetrack_cli.report.html import Image
from facetrack_cli.report.measures import Measures


@dataclass(frozen=True)
class Plot:
    """The page of plots, drawn wide and, for phones, narrow."""

    wide: Image
    narrow: Image


class Truth(NamedTuple):
    """What was measured against the file `path`: `about` in words, tables, and lines on what could not be."""

    path: str
    about: str
    tables: Sequence[Measures]
    notes: Sequence[str]


@dataclass(frozen=True)
class Content:
    """All that the page shows."""

    title: str
    table: Table
    header: Header
    clock: Clock
    story: Story
    keys: Sequence[KeyFrame]
    pictures: Pictures
    plot: Plot
    command: str
    truth: Truth | None = None
