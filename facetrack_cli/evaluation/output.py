"""An evaluation as JSON and CSV for programs, and as tables for people."""

import csv
import io
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.table import Table
from rich.text import Text

from facetrack_cli.core.errors import flat
from facetrack_cli.core.numbers import document
from facetrack_cli.evaluation.measure import HALVES, PERCENT
from facetrack_cli.evaluation.points import HELD
from facetrack_cli.evaluation.reliability import ReliabilityBin
from facetrack_cli.evaluation.rows import NEAR_IOU
from facetrack_cli.evaluation.summary import MEASURES, Evaluation, Measured

CURVES: Final = ("success", "precision", "normalised_precision")
WIDTH: Final = 200  # more than any table takes: lines are never cut
MANY: Final = 12  # parts; of more, the tables of trust show all together alone
MOST: Final = 20  # occlusions that are listed
DASH: Final = "\N{EN DASH}"


@dataclass(frozen=True)
class About:
    """What was compared: the files, how they were read (the trajectory: if not facetrack's own), and the shift."""

    trajectory: Path
    truth: Path
    read_as: str
    shift: int = 0
    results_read_as: str | None = None


def to_json(evaluation: Evaluation, about: About) -> str:
    """Figures stand below the first words of their names, as `all.points.mean_px`; what is not defined is null."""
    options, frames = evaluation.options, evaluation.frames
    fields = {
        "trajectory": str(about.trajectory),
        **({"trajectory_read_as": about.results_read_as} if about.results_read_as else {}),
        "truth": {"path": str(about.truth), "read_as": about.read_as, "shift": about.shift},
        "options": {"normalise": options.normalise, "failure": options.failure},
        "frames": {"count": len(frames), "first": int(frames[0]), "last": int(frames[-1])},
        "rows": evaluation.counts,
        "units": dict(evaluation.units),
        "all": _groups(evaluation.all),
        "parts": [{"target": one.target, "part": one.part, **_groups(one)} for one in evaluation.parts],
        "occlusions": [asdict(one) for one in evaluation.occlusions],
        "notes": list(evaluation.notes),
    }
    return document("facetrack-evaluation", fields, indent=1)


def _groups(one: Measured) -> dict[str, Any]:
    """What was measured, by the first words of the measures' names; what was not is left out."""
    out: dict[str, Any] = {}
    for name, value in one.figures.items():
        group, _, figure = name.partition(".")
        if getattr(one, group) is not None:
            out.setdefault(group, {})[figure] = value
    if one.boxes is not None:
        curves = [(name, getattr(one.boxes, name).tolist()) for name in CURVES]
        out["boxes"]["curves"] = {name: [v if math.isfinite(v) else None for v in each] for name, each in curves}
    if one.confidence is not None:
        out["confidence"]["bins"] = [asdict(each) for each in one.confidence.bins]
    return out


def to_csv(evaluation: Evaluation, about: About) -> str:
    """A header with all MEASURES, a row a part, then one of all parts together, whose target is "all"."""
    out = io.StringIO()
    write = csv.writer(out, lineterminator="\n")
    write.writerow(["trajectory", "truth", "target", "part", *MEASURES])
    for one in (*evaluation.parts, evaluation.all):
        values = ["" if value is None else repr(value) for value in one.figures.values()]
        write.writerow([about.trajectory, about.truth, one.target, one.part, *values])
    return out.getvalue()


_TABLES: Final = {
    "points": ("POINTS", "distance to the ground truth"),
    "boxes": ("BOXES", "overlap with the ground truth"),
    "lost": ("LOST", "status against the ground truth; covered: hidden or absent; gone: covered or not near"),
    "confidence": (
        "CONFIDENCE",
        "how well it tells near rows from others (AUROC: 0.5 not at all, 1 always), and right ones by its value",
    ),
    "coverage": ("SPREAD", "std_x, std_y against the error of visible rows"),
    "jitter": ("JITTER", "how far visible rows are from the middle of those before and after"),
}


def to_text(evaluation: Evaluation, about: About, *, colour: bool = False) -> str:
    """All tables; with `colour`, with the escapes of a terminal."""
    console = Console(
        width=WIDTH, force_terminal=colour, color_system="standard" if colour else None, markup=False, emoji=False
    )
    with console.capture() as captured:
        for block in _blocks(evaluation, about):
            console.print(block, soft_wrap=isinstance(block, Text))
    return "\n".join(line.rstrip() for line in captured.get().splitlines()) + "\n"


def _blocks(found: Evaluation, about: About) -> Iterator[Text | Table]:
    several = len({one.target for one in found.parts}) > 1

    def name(target: str, part: str) -> str:
        return flat(f"{target}/{part}" if several and part else part or target)

    yield from _head(found, about)
    every = [*found.parts, *([found.all] if len(found.parts) > 1 else [])]
    for group, words in _TABLES.items():
        if group == "lost":
            yield from _occlusions(found, name)
        few = group in ("points", "boxes") or len(found.parts) <= MANY
        rows = [one for one in (every if few else every[-1:]) if getattr(one, group) is not None]
        if rows:
            yield _title(*words)
            yield _measured(group, rows, name)
        if group == "confidence" and found.all.confidence is not None and found.all.confidence.bins:
            yield Text()
            yield _calibration(found.all.confidence.bins)
    if found.notes:
        yield _title("NOTES")
        yield from map(_line, found.notes)


def _line(text: str, style: str = "") -> Text:
    return Text(flat(text), style)


def _title(title: str, note: str = "") -> Text:
    return Text.assemble("\n", (title, "bold"), (f"  {note}", "dim") if note else "")


def _grid(heads: Sequence[str], left: int = 1) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    for at, head in enumerate(heads):
        table.add_column(head, justify="left" if at < left else "right", no_wrap=True, vertical="bottom")
    return table


def _head(found: Evaluation, about: About) -> Iterator[Text]:
    frames = found.frames
    shift = f", shifted by {about.shift:+d} frames" if about.shift else ""
    ours = f"{about.trajectory}" + (f" (read as {about.results_read_as})" if about.results_read_as else "")
    yield _line(f"{ours} against {about.truth} (read as {about.read_as}{shift})", "bold")
    rows = ", ".join(f"{n:,} {name}" for name, n in found.counts.items() if n or name == "visible")
    count = f"{len(frames):,} frame{'s' if len(frames) != 1 else ''}"
    yield _line(f"{count}, {frames[0]} to {frames[-1]}; rows, one a frame and part: {rows}")
    for target, text in found.units.items():
        yield _line(f"length{f' of {target}' if len(found.units) > 1 else ''}: {text}")
    if found.all.points:
        failed = f"it has failed above {100 * found.options.failure:g} % of it"
        yield _line(f"a point is near if its error is less than 1/6 of the length; {failed}")
    if found.all.boxes:
        yield _line(f"a box is near if its IoU with the ground truth is more than {NEAR_IOU:g}")
    if found.all.confidence:
        yield _line("a row is right if its centre is off by less than 1/4 of the length, of a box 1/4 of its size")


def _measured(group: str, rows: Sequence[Measured], name: Callable[[str, str], str]) -> Table:
    """A row for each part and a column for each measure of a group."""
    values = [one.figures for one in rows]
    shown = {
        key: one
        for key, one in MEASURES.items()
        if key.startswith(f"{group}.") and one.title and (not one.rare or any(each[key] for each in values))
    }
    table = _grid(["part", *(one.title for one in shown.values())])
    for row, each in zip(rows, values, strict=True):
        cells = (DASH if (value := each[key]) is None else one.write(value) for key, one in shown.items())
        table.add_row(name(row.target, row.part), *cells, style=None if row.part else "bold")
    return table


def _occlusions(found: Evaluation, name: Callable[[str, str], str]) -> Iterator[Text | Table]:
    whole, every = found.all.occlusions, found.occlusions
    if whole is None:
        return
    back = f"{whole.returned} of {whole.decided} come back" if whole.decided else "none can be decided"
    median = "" if whole.frames_median is None else f", the median after {HALVES(whole.frames_median)}"
    yield _title("OCCLUSIONS", f"frames until all covered parts are near for {HELD} rows in a row; {back}{median}")
    table = _grid(["frames", "parts", "back after"], left=2)
    for one in every[:MOST]:
        known = one.frames_to_return is not None
        after = (str(one.frames_to_return) if known else "never") if one.decided else "cannot be decided"
        if known and not one.decided:
            after = "by hand"
        parts = [name(one.target, part) for part in one.parts[:MANY]] + ["..."] * (len(one.parts) > MANY)
        table.add_row(f"{one.first}-{one.last}", ", ".join(parts), after)
    yield table
    if len(every) > MOST:
        yield _line(f"... and {len(every) - MOST} more; --json has them all")


def _calibration(bins: Sequence[ReliabilityBin]) -> Table:
    table = _grid(["confidence", *(f"{one.low:.1f}-{one.high:.1f}" for one in bins)])
    table.add_row("rows", *(f"{one.rows:,.0f}" for one in bins))
    for title, name in (("right, %", "right"), ("visible, %", "visible")):
        shares = [getattr(one, name) for one in bins]
        table.add_row(title, *(DASH if one is None else PERCENT(one) for one in shares))
    return table
