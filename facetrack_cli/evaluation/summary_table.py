"""An evaluation as tables for people: plain text of a fixed generous width, with bold heads on a terminal."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from rich.console import Console
from rich.table import Table
from rich.text import Text

from facetrack_cli.evaluation.points import HELD
from facetrack_cli.evaluation.summary import Evaluation, Measured, Value, figures
from facetrack_cli.evaluation.summary_data import About

WIDTH: Final = 200  # more than any table of ours takes: lines are never cut
MANY: Final = 12  # parts; of more, the tables of trust show all together alone

MOST: Final = 20  # occlusions that are listed
DASH: Final = "\N{EN DASH}"


@dataclass(frozen=True)
class _Column:
    """A column of figures: its head in two lines, the figure's name, and how it is written."""

    head: str
    name: str
    write: Callable[[float], str]


def _whole(value: float) -> str:
    return f"{value:,.0f}"


def _half(value: float) -> str:
    return f"{value:g}"  # a median of whole frames


def _px(value: float) -> str:
    return f"{value:.2f}"


def _percent(value: float) -> str:
    return f"{100 * value:.1f}"


def _unit(value: float) -> str:
    return f"{value:.3f}"


POINTS: Final = (
    _Column("visible\nrows", "points.rows", _whole),
    _Column("mean\npx", "points.mean_px", _px),
    _Column("median\npx", "points.median_px", _px),
    _Column("std\npx", "points.std_px", _px),
    _Column("95th\npx", "points.p95_px", _px),
    _Column("mean\n% of length", "points.mean_normalised", _percent),
    _Column("failed\n%", "points.failure_rate", _percent),
    _Column("AUC\n", "points.auc", _unit),
    _Column("lost for\ngood", "points.lost_for_good", _whole),
    _Column("hidden\nrows", "points.hidden_rows", _whole),
    _Column("mean\npx", "points.hidden_mean_px", _px),
    _Column("median\npx", "points.hidden_median_px", _px),
)
BOXES: Final = (
    _Column("visible\nrows", "boxes.rows", _whole),
    _Column("success\nAUC", "boxes.success_auc", _unit),
    _Column("precision\n20 px, %", "boxes.precision_20", _percent),
    _Column("normalised\nAUC", "boxes.normalised_auc", _unit),
    _Column("GOT-10k\nAO", "boxes.ao", _unit),
    _Column("SR 0.5\n%", "boxes.sr50", _percent),
    _Column("SR 0.75\n%", "boxes.sr75", _percent),
    _Column("VOT\naccuracy", "boxes.vot_accuracy", _unit),
    _Column("good\n%", "boxes.good_rate", _percent),
    _Column("strict\n%", "boxes.strict_rate", _percent),
    _Column("hidden\nrows", "boxes.hidden_rows", _whole),
    _Column("mean\nIoU", "boxes.hidden_overlap", _unit),
)
LOST: Final = (
    _Column("rows\n", "lost.rows", _whole),
    _Column("covered\nrows", "lost.covered", _whole),
    _Column("called\nlost", "lost.called", _whole),
    _Column("precision\ncovered %", "lost.precision", _percent),
    _Column("precision\ngone %", "lost.precision_gone", _percent),
    _Column("recall\ncovered %", "lost.recall", _percent),
    _Column("recall\ngone %", "lost.recall_gone", _percent),
    _Column("false\nalarms %", "lost.false_alarms", _percent),
    _Column("tracked:\nnear %", "lost.tracked_near", _percent),
    _Column("& visible:\nnear %", "lost.tracked_visible_near", _percent),
    _Column("delay lost\nframes", "lost.delay_lost", _half),
    _Column("delay back\nframes", "lost.delay_back", _half),
)
SURE: Final = (
    _Column("rows\n", "confidence.rows", _whole),
    _Column("near\n%", "confidence.near", _percent),
    _Column("AUROC\nnear", "confidence.auroc_near", _unit),
    _Column("AUROC\nvisible", "confidence.auroc_visible", _unit),
    _Column("calibration\nerror", "confidence.ece", _unit),
    _Column("Brier\n", "confidence.brier", _unit),
)
SPREAD: Final = (
    _Column("rows\n", "coverage.rows", _whole),
    _Column("in the 50 %\nellipse, %", "coverage.within_50", _percent),
    _Column("in the 90 %\nellipse, %", "coverage.within_90", _percent),
    _Column("std would\nfit times", "coverage.factor", _px),
    _Column("without\nspread", "coverage.zero_std", _whole),
    _Column("std not\nknown", "coverage.unknown_std", _whole),
)
HIDDEN: Final = ("points.hidden_rows", "boxes.hidden_rows")
# shown where they are not 0 alone
RARE: Final = ("coverage.zero_std", "coverage.unknown_std")


def to_text(evaluation: Evaluation, about: About, *, colour: bool = False) -> str:
    """All tables; with `colour`, with the escapes of a terminal."""
    out = io.StringIO()
    console = Console(
        file=out,
        width=WIDTH,
        force_terminal=colour,
        color_system="standard" if colour else None,
        markup=False,
        highlight=False,
        emoji=False,
    )
    say = _Say(console, several=len({one.target for one in evaluation.parts}) > 1)
    _begin(say, evaluation, about)
    rows = [*evaluation.parts, *([evaluation.all] if len(evaluation.parts) > 1 else [])]
    trust = rows if len(evaluation.parts) <= MANY else rows[-1:]
    say.table("POINTS", "distance to the truth", POINTS, [one for one in rows if one.points])
    say.table("BOXES", "overlap with the truth", BOXES, [one for one in rows if one.boxes])
    _occlusions(say, evaluation)
    words = "covered: hidden or absent; gone: covered or not near"
    say.table("LOST", f"status against the truth; {words}", LOST, [one for one in trust if one.trust.lost])
    worth = "how well it tells near rows from others (AUROC: 0.5 not at all, 1 wholly); it is no probability"
    say.table("CONFIDENCE", worth, SURE, [one for one in trust if one.trust.confidence])
    _calibration(say, evaluation)
    covers = "std_x, std_y against the error of visible rows"
    say.table("SPREAD", covers, SPREAD, [one for one in trust if one.trust.coverage])
    if evaluation.notes:
        say.title("NOTES")
        for note in evaluation.notes:
            say.line(note)
    return "\n".join(line.rstrip() for line in out.getvalue().splitlines()) + "\n"


class _Say:
    def __init__(self, console: Console, several: bool) -> None:
        self._console = console
        self._several = several  # targets

    def line(self, text: str, style: str | None = None) -> None:
        self._console.print(" ".join(text.splitlines()), style=style, soft_wrap=True)

    def title(self, title: str, note: str = "") -> None:
        self._console.print()
        self._console.print(Text.assemble((title, "bold"), (f"  {note}", "dim") if note else ""), soft_wrap=True)

    def name(self, target: str, part: str) -> str:
        return f"{target}/{part}" if self._several and part else part or target

    def table(self, title: str, note: str, columns: Sequence[_Column], rows: Sequence[Measured]) -> None:
        if not rows:
            return
        found = [figures(one) for one in rows]
        covered = any(values[name] for values in found for name in HIDDEN)
        shown = [
            column
            for column in columns
            if (covered or ".hidden_" not in column.name)
            and (column.name not in RARE or any(values[column.name] for values in found))
        ]
        self.title(title, note)
        table = _table(["part", *(column.head for column in shown)])
        for one, values in zip(rows, found, strict=True):
            cells = [_cell(values[column.name], column.write) for column in shown]
            table.add_row(self.name(one.target, one.part), *cells, style=None if one.part else "bold")
        self._console.print(table)

    def grid(self, heads: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> None:
        table = _table(heads, left)
        for row in rows:
            table.add_row(*row)
        self._console.print(table)


def _table(heads: Sequence[str], left: int = 1) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    for at, head in enumerate(heads):
        table.add_column(head, justify="left" if at < left else "right", no_wrap=True, vertical="bottom")
    return table


def _cell(value: Value, write: Callable[[float], str]) -> str:
    return DASH if value is None else write(value)


def _begin(say: _Say, evaluation: Evaluation, about: About) -> None:
    shift = f", shifted by {about.shift:+d} frames" if about.shift else ""
    ours = f"{about.trajectory}" + (f" (read as {about.results_read_as})" if about.results_read_as else "")
    say.line(f"{ours} against {about.truth} (read as {about.read_as}{shift})", "bold")
    counts = {"visible": evaluation.visible, "hidden": evaluation.hidden, "absent": evaluation.absent}
    rows = ", ".join(f"{count:,} {name}" for name, count in counts.items() if count or name == "visible")
    frames = f"{evaluation.frames:,} frame{'s' if evaluation.frames != 1 else ''}"
    say.line(f"{frames}, {evaluation.first} to {evaluation.last}; rows, one a frame and part: {rows}")
    for target, text in evaluation.units.items():
        say.line(f"length{f' of {target}' if len(evaluation.units) > 1 else ''}: {text}")
    if evaluation.all.points:
        failure = f"{100 * evaluation.options.failure:g} %"
        say.line(
            f"a point is near if it is off by less than 1/6 of the length; it failed if by more than {failure} of it"
        )
    if evaluation.all.boxes:
        say.line("a box is near if its overlap with the truth, intersection over union, is more than 0.5")


def _occlusions(say: _Say, evaluation: Evaluation) -> None:
    recovery = evaluation.recovery
    if recovery is None:
        return
    back = f"{recovery.returned} of {recovery.decided} come back" if recovery.decided else "none can be decided"
    median = "" if recovery.frames_median is None else f", the median after {_half(recovery.frames_median)}"
    say.title(
        "OCCLUSIONS", f"frames until all parts that were covered are near for {HELD} rows in a row; {back}{median}"
    )
    rows = []
    for one in evaluation.occlusions[:MOST]:
        by_hand = one.frames_to_return is not None and not one.decided
        returned = "by hand" if by_hand else "cannot be told" if not one.decided else "never"
        rows.append(
            (
                f"{one.first}-{one.last}",
                ", ".join(say.name(one.target, part) for part in one.parts[:MANY])
                + (", ..." * (len(one.parts) > MANY)),
                returned if one.frames_to_return is None or not one.decided else str(one.frames_to_return),
            )
        )
    say.grid(["frames", "parts", "back after"], rows, left=2)
    if len(evaluation.occlusions) > MOST:
        say.line(f"... and {len(evaluation.occlusions) - MOST} more; --json has them all")


def _calibration(say: _Say, evaluation: Evaluation) -> None:
    confidence = evaluation.all.trust.confidence
    if confidence is None or not confidence.bins:
        return
    bins = confidence.bins
    say.line("")
    say.grid(
        ["confidence", *(f"{one.low:.1f}-{one.high:.1f}" for one in bins)],
        [
            ["rows", *(_whole(one.rows) for one in bins)],
            ["near, %", *(_cell(one.near, _percent) for one in bins)],
            ["visible, %", *(_cell(one.visible, _percent) for one in bins)],
        ],
    )
