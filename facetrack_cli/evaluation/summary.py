"""All measures of a trajectory against the ground truth as one value: its figures by name, as JSON, CSV and tables.

    evaluation = evaluate(match(trajectory, truth, ...))
    evaluation.all.points.mean_px
    scalars(evaluation)["lost.precision"]

`Sheet` is any table of results, on a terminal and piped.
"""

import math
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from shutil import get_terminal_size
from textwrap import fill
from typing import Any, Final, get_args, get_type_hints

import click
import numpy as np
from rich.cells import cell_len

from facetrack_cli.core.errors import InputError, flat, visible
from facetrack_cli.core.files import absolute
from facetrack_cli.core.numbers import csv_text, document
from facetrack_cli.core.types import Whole
from facetrack_cli.evaluation import accuracy
from facetrack_cli.evaluation.identities import PeopleMeasures
from facetrack_cli.evaluation.rows import NEAR_IOU, Measure, Pair, Rows, Value, column, normalised_rows
from facetrack_cli.trajectory.trajectory import Trajectory, joined

WIDTH: Final = 100  # columns of a table that is not printed on a terminal
NO_FIGURE: Final = "\N{EN DASH}"


@dataclass(frozen=True)
class Sheet:
    """A table of text. `heads` may hold line breaks; columns in `left` hold names; `notes` stand below the table."""

    title: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()
    left: tuple[int, ...] = (0,)

    def show(self) -> None:
        """Print the table, as wide as its cells, and the notes, as wide as the terminal, or WIDTH columns."""
        heads = [head.split("\n") for head in self.heads]
        tall = max(map(len, heads))
        table = [[[""] * (tall - len(head)) + head for head in heads]]
        for row in self.rows:  # a recipe has a line for each of its overrides
            table.append([re.sub(r"(?<=[:,])(?=[\w.]+=)", "\n  ", visible(cell)).split("\n") for cell in row])
        widths = [max(cell_len(line) for cell in cells for line in cell) for cells in zip(*table, strict=True)]
        click.echo(f"{flat(self.title)}\n")
        for number, columns in enumerate(table):
            for line in zip_longest(*columns, fillvalue=""):
                gaps = [" " * (width - cell_len(cell)) for width, cell in zip(widths, line, strict=True)]
                padded = (cell + gaps[i] if i in self.left else gaps[i] + cell for i, cell in enumerate(line))
                click.echo("   ".join(padded).rstrip())
            if number == 0:
                click.echo("\N{BOX DRAWINGS LIGHT HORIZONTAL}" * (sum(widths) + 3 * len(widths) - 3))
        click.echo()
        for note in self.notes:
            click.echo(fill(visible(note), get_terminal_size().columns if sys.stdout.isatty() else WIDTH))


def clip_name(clip: Path) -> str:
    """A clip in titles: a file's name; a folder with the folder above it, since many are called img."""
    place = absolute(clip)
    return f"{place.parent.name}/{place.name}" if place.is_dir() and place.parent.name else place.name


@dataclass(frozen=True)
class PartMeasures:
    """One part, or all with an empty `part` and target "all", which alone have `people`; None: it was not measured."""

    target: str
    part: str
    points: accuracy.PointMeasures | None
    boxes: accuracy.BoxMeasures | None
    lost: accuracy.LostMeasures | None
    confidence: accuracy.ConfidenceMeasures | None
    coverage: accuracy.CoverageMeasures | None
    jitter: accuracy.JitterMeasures | None
    people: PeopleMeasures | None = None

    @property
    def figures(self) -> dict[str, Value]:
        """The value of each of MEASURES, None where it is not defined or was not measured."""
        values = {}
        for name in MEASURES:
            group, _, figure = name.partition(".")
            value = getattr(getattr(self, group), figure, None)
            values[name] = None if value is None or not math.isfinite(value) else value
        return values


# all measures by name, whatever was measured: `points.rows`, `points.missing`, ..., `jitter.truth_px`
MEASURES: Final[Mapping[str, Measure]] = {
    f"{group}.{name}": hint.__metadata__[0]
    for group, kind in get_type_hints(PartMeasures).items()
    for name, hint in get_type_hints((get_args(kind) or (object,))[0], include_extras=True).items()
    if hasattr(hint, "__metadata__")
}


@dataclass(frozen=True)
class Evaluation:
    """What was measured on the `rows` that both have; `units`: the length that normalises each target's errors."""

    normalise: str
    failure: float
    rows: tuple[Rows, ...]
    units: Mapping[str, str]
    parts: tuple[PartMeasures, ...]
    all: PartMeasures
    notes: tuple[str, ...]

    @property
    def frames(self) -> Whole:
        return np.unique(column(self.rows, "frame"))

    @property
    def counts(self) -> dict[str, int]:
        """How many rows, one for each frame and part, are visible, hidden and absent."""
        return {status: int(column(self.rows, status).sum()) for status in ("visible", "hidden", "absent")}


def evaluate(
    pairs: Sequence[Pair],
    notes: Sequence[str] = (),
    *,
    normalise: str = "size",
    failure: float = accuracy.FAILURE,
    size: tuple[int, int] | None = None,
    reference: Sequence[Trajectory] = (),
    people: PeopleMeasures | None = None,
) -> Evaluation:
    """Measure the pairs of `match`.

    `normalise` and `reference`: see `lengths_of`; `failure`: the normalised error above which a row has failed; `size`:
    (width, height) of the frames where it is known, to which GOT-10k clips boxes. Raises InputError without any row,
    UsageError for a length that the ground truth does not have.
    """
    # the rows that the ground truth itself calls lost, as a trajectory does that serves as ground truth, are unknown
    pairs = [Pair(*(table.take(pair.truth.status != "lost") for table in pair)) for pair in pairs]
    if not any(len(pair.ours) for pair in pairs):
        raise InputError("there is no row that both the trajectory and the ground truth have; nothing can be measured")
    rows, units = normalised_rows(pairs, normalise, reference)

    def measured(target: str, part: str, some: slice, people: PeopleMeasures | None = None) -> PartMeasures:
        own = rows[some]
        points = [part for pair, part in zip(pairs[some], own, strict=True) if not pair.is_box]
        return PartMeasures(
            target,
            part,
            points=accuracy.measure_points(points, failure) if points else None,
            boxes=_boxes(pairs[some], own, size) if len(points) < len(own) else None,
            lost=accuracy.measure_lost(own),
            confidence=accuracy.measure_confidence(own),
            coverage=accuracy.measure_coverage(own),
            jitter=accuracy.measure_jitter(own),
            people=people,
        )

    parts = tuple(measured(part.target, part.part, slice(i, i + 1)) for i, part in enumerate(rows))
    whole = measured("all", "", slice(None), people)
    if whole.points is not None and whole.points.mean_px is not None and whole.points.auc is None:
        texts = "; ".join(dict.fromkeys(units.values()))
        notes = [*notes, f"errors are not normalised and nothing is near ({texts}): give --normalise PIXELS"]
    return Evaluation(normalise, failure, rows, units, parts, whole, tuple(notes))


def _boxes(pairs: Sequence[Pair], parts: Sequence[Rows], size: tuple[int, int] | None) -> accuracy.BoxMeasures:
    """The rows of all pairs of boxes as if they were one target's; rows that a correction gave do not count."""
    pairs, rows = zip(*(both for both in zip(pairs, parts, strict=True) if both[0].is_box), strict=True)
    ours, truth = (joined([s.renamed(str(i), "box") for i, s in enumerate(each)]) for each in zip(*pairs, strict=True))
    later = column(rows, "later")
    return accuracy.measure_boxes(
        ours.boxes,
        truth.boxes,
        visible=column(rows, "visible") & ~later,
        hidden=column(rows, "hidden") & ~later & ~column(rows, "left_out"),
        init=column(rows, "init"),
        size=size,
    )


def scalars(evaluation: Evaluation) -> dict[str, float]:
    """The figures of all parts together, by name; what is not defined is left out."""
    return {name: float(value) for name, value in evaluation.all.figures.items() if value is not None}


CURVES: Final = ("success", "precision", "normalised_precision")
MAX_PARTS: Final = 12  # in tables of status, confidence, spread and jitter


def to_json(evaluation: Evaluation, ours: Trajectory, truth: Trajectory) -> str:
    """Figures stand below the groups of their names, as `all.points.mean_px`; an undefined figure is null."""
    frames = evaluation.frames
    fields = {
        "trajectory": str(ours.path),
        **({"trajectory_read_as": ours.header["read_as"]} if "read_as" in ours.header else {}),
        "truth": {"path": str(truth.path)} | {key: truth.header[key] for key in ("read_as", "shift")},
        "options": {"normalise": evaluation.normalise, "failure": evaluation.failure},
        "frames": {"count": len(frames), "first": int(frames[0]), "last": int(frames[-1])},
        "rows": evaluation.counts,
        "units": dict(evaluation.units),
        "all": _groups(evaluation.all),
        "parts": [{"target": part.target, "part": part.part, **_groups(part)} for part in evaluation.parts],
        "notes": list(evaluation.notes),
    }
    return document("facetrack-evaluation", fields, indent=1)


def _groups(part: PartMeasures) -> dict[str, Any]:
    """The figures by group and name; a group that was not measured is left out."""
    groups: dict[str, Any] = {}
    for name, value in part.figures.items():
        group, _, figure = name.partition(".")
        if getattr(part, group) is not None:
            groups.setdefault(group, {})[figure] = value
    if part.boxes is not None:
        curves = [(name, getattr(part.boxes, name).tolist()) for name in CURVES]
        groups["boxes"]["curves"] = {name: [v if math.isfinite(v) else None for v in each] for name, each in curves}
    return groups


def to_csv(evaluation: Evaluation, ours: Trajectory, truth: Trajectory) -> str:
    """A header with all MEASURES, a row for each part, then a row for all parts together, whose target is "all"."""
    rows = [
        [ours.path, truth.path, part.target, part.part]
        + ["" if value is None else repr(value) for value in part.figures.values()]
        for part in (*evaluation.parts, evaluation.all)
    ]
    return csv_text(["trajectory", "truth", "target", "part", *MEASURES], rows)


_TABLES: Final = {
    "people": ("People", "targets against people, whatever their names; on a person where boxes overlap by half"),
    "points": ("Points", "distance to the ground truth"),
    "boxes": ("Boxes", "overlap with the ground truth"),
    "lost": ("Lost", "status against the ground truth; covered: hidden or absent; gone: covered or not near"),
    "confidence": (
        "Confidence",
        "how well it tells near rows from others (AUROC: 0.5 not at all, 1 always), and right ones by its value",
    ),
    "coverage": ("Spread", "std_x, std_y against the error of visible rows"),
    "jitter": ("Jitter", "how far visible rows are from the middle of those before and after"),
}


def show(evaluation: Evaluation, ours: Trajectory, truth: Trajectory) -> None:
    """Print what was compared, all tables, and the notes."""
    read_as = f" (read as {ours.header['read_as']})" if "read_as" in ours.header else ""
    shift = f", shifted by {truth.header['shift']:+d} frames" if truth.header["shift"] else ""
    click.echo(flat(f"{ours.path}{read_as} against {truth.path} (read as {truth.header['read_as']}{shift})"))
    for line in facts(evaluation):
        click.echo(flat(line))
    click.echo()
    for sheet in sheets(evaluation):
        sheet.show()
    for note in evaluation.notes:
        click.echo(flat(f"note: {note}"))


def facts(evaluation: Evaluation) -> Iterator[str]:
    """Lines on what was compared, by which length errors are normalised, and what is near and right."""
    frames = evaluation.frames
    rows = ", ".join(f"{n:,} {name}" for name, n in evaluation.counts.items() if n or name == "visible")
    count = f"{len(frames):,} frame{'s' if len(frames) != 1 else ''}"
    yield f"{count}, {frames[0]} to {frames[-1]}; rows, one a frame and part: {rows}"
    for target, text in evaluation.units.items():
        yield f"length{f' of {target}' if len(evaluation.units) > 1 else ''}: {text}"
    if evaluation.all.points:
        failed = f"it has failed above {100 * evaluation.failure:g} % of it"
        yield f"a point is near if its error is less than 1/6 of the length; {failed}"
    if evaluation.all.boxes:
        yield f"a box is near if its IoU with the ground truth is more than {NEAR_IOU:g}"
    if evaluation.all.confidence:
        yield "a row is right if its centre is off by less than 1/4 of the length, of a box 1/4 of its size"


def sheets(evaluation: Evaluation) -> Iterator[Sheet]:
    """All tables. A title is a name and what the table shows.

    Of more than MAX_PARTS parts the tables of status, confidence, spread and jitter show all parts together alone.
    """
    several = len({part.target for part in evaluation.parts}) > 1

    def name(target: str, part: str) -> str:
        return flat(f"{target}/{part}" if several and part else part or target)

    every = [*evaluation.parts, *([evaluation.all] if len(evaluation.parts) > 1 else [])]
    for group, title in _TABLES.items():
        few = group in ("points", "boxes") or len(evaluation.parts) <= MAX_PARTS
        parts = [part for part in (every if few else every[-1:]) if getattr(part, group) is not None]
        if parts:
            values = [part.figures for part in parts]
            shown = {
                key: measure
                for key, measure in MEASURES.items()
                if key.startswith(f"{group}.") and measure.title and (not measure.rare or any(v[key] for v in values))
            }
            rows = []
            for part, own in zip(parts, values, strict=True):
                cells = [NO_FIGURE if (v := own[key]) is None else measure.write(v) for key, measure in shown.items()]
                rows.append((name(part.target, part.part), *cells))
            yield Sheet(": ".join(title), ("part", *(measure.title for measure in shown.values())), tuple(rows))
