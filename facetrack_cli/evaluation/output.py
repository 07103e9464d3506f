"""An evaluation as JSON and CSV for programs, and as tables for people."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from facetrack_cli import __version__
from facetrack_cli.evaluation.measure import HALVES, PERCENT, measures_of
from facetrack_cli.evaluation.points import HELD
from facetrack_cli.evaluation.rows import NEAR_IOU
from facetrack_cli.evaluation.summary import GROUPS, MEASURES, Evaluation, Measured

SCHEMA: Final = "facetrack-evaluation"
VERSION: Final = 1
CURVES: Final = ("success", "precision", "normalised_precision")


@dataclass(frozen=True)
class About:
    """What was compared: the files, how the ground truth was read, and by how many frames it was shifted.

    `results_read_as` says how a trajectory that is not facetrack's own was read.
    """

    trajectory: Path
    truth: Path
    read_as: str
    shift: int = 0
    results_read_as: str | None = None


def to_json(evaluation: Evaluation, about: About) -> str:
    """Figures stand below the first words of their names, as `all.points.mean_px`; what is not defined is null."""
    options, frames = evaluation.options, evaluation.frames
    whole = {
        "schema": SCHEMA,
        "version": VERSION,
        "facetrack": __version__,
        "trajectory": str(about.trajectory),
        **({"trajectory_read_as": about.results_read_as} if about.results_read_as else {}),
        "truth": {"path": str(about.truth), "read_as": about.read_as, "shift": about.shift},
        "options": {"normalise": options.normalise, "failure": options.failure},
        "frames": {"count": len(frames), "first": int(frames[0]), "last": int(frames[-1])},
        "rows": evaluation.counts,
        "units": dict(evaluation.units),
        "all": _groups(evaluation.all),
        "parts": [{"target": one.target, "part": one.part, **_groups(one)} for one in evaluation.parts],
        "occlusions": _plain(evaluation.occlusions),
        "notes": list(evaluation.notes),
    }
    return json.dumps(whole, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _groups(one: Measured) -> dict[str, Any]:
    """What was measured, by the first words of the measures' names; what was not is left out."""
    found = one.figures
    out: dict[str, Any] = {
        group: {name: found[f"{group}.{name}"] for name in measures_of(kind)}
        for group, kind in GROUPS.items()
        if getattr(one, group) is not None
    }
    if one.boxes is not None:
        out["boxes"]["curves"] = {name: _plain(getattr(one.boxes, name)) for name in CURVES}
    if one.confidence is not None:
        out["confidence"]["bins"] = _plain(one.confidence.bins)
    return out


def _plain(value: Any) -> Any:
    """Dataclasses as objects, tuples and arrays as lists, nan as None."""
    if is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, tuple | list):
        return [_plain(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def to_csv(evaluation: Evaluation, about: About) -> str:
    """A header and a row a part, then one of all parts together, whose target is "all".

    The columns are the same whatever was measured: trajectory, truth, target, part, and all MEASURES.
    """
    out = io.StringIO()
    write = csv.writer(out, lineterminator="\n")
    write.writerow(["trajectory", "truth", "target", "part", *MEASURES])
    for one in (*evaluation.parts, evaluation.all):
        values = ["" if value is None else repr(value) for value in one.figures.values()]
        write.writerow([about.trajectory, about.truth, one.target, one.part, *values])
    return out.getvalue()


# --- tables ------------------------------------------------------------------------------------------------------

WIDTH: Final = 200  # more than any table takes: lines are never cut
MANY: Final = 12  # parts; of more, the tables of trust show all together alone
MOST: Final = 20  # occlusions that are listed
DASH: Final = "\N{EN DASH}"
_TABLES: Final = {
    "points": ("POINTS", "distance to the ground truth"),
    "boxes": ("BOXES", "overlap with the ground truth"),
    "lost": ("LOST", "status against the ground truth; covered: hidden or absent; gone: covered or not near"),
    "confidence": (
        "CONFIDENCE",
        "how well it tells near rows from others (AUROC: 0.5 not at all, 1 always); it is no probability",
    ),
    "coverage": ("SPREAD", "std_x, std_y against the error of visible rows"),
}


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
    _Tables(console, evaluation).print(about)
    return "\n".join(line.rstrip() for line in out.getvalue().splitlines()) + "\n"


class _Tables:
    def __init__(self, console: Console, evaluation: Evaluation) -> None:
        self._console, self._evaluation = console, evaluation
        self._several = len({one.target for one in evaluation.parts}) > 1

    def print(self, about: About) -> None:
        self._head(about)
        found = self._evaluation
        rows = [*found.parts, *([found.all] if len(found.parts) > 1 else [])]
        for group, words in _TABLES.items():
            trust = group not in ("points", "boxes")
            if group == "lost":
                self._occlusions()
            self._table(group, words, rows if not trust or len(found.parts) <= MANY else rows[-1:])
        if found.notes:
            self._title("NOTES")
            for note in found.notes:
                self._line(note)

    def _line(self, text: str, style: str | None = None) -> None:
        self._console.print(" ".join(text.splitlines()), style=style, soft_wrap=True)

    def _title(self, title: str, note: str = "") -> None:
        self._console.print()
        self._console.print(Text.assemble((title, "bold"), (f"  {note}", "dim") if note else ""), soft_wrap=True)

    def _name(self, target: str, part: str) -> str:
        return f"{target}/{part}" if self._several and part else part or target

    def _table(self, group: str, words: tuple[str, str], rows: Sequence[Measured]) -> None:
        rows = [one for one in rows if getattr(one, group) is not None]
        values = [one.figures for one in rows]
        shown = {
            name: one
            for name, one in MEASURES.items()
            if name.startswith(f"{group}.") and one.title and (not one.rare or any(each[name] for each in values))
        }
        if rows:
            self._title(*words)
            cells = [
                [DASH if (value := each[name]) is None else one.write(value) for name, one in shown.items()]
                for each in values
            ]
            names = [self._name(one.target, one.part) for one in rows]
            whole = [not one.part for one in rows]
            self._grid(["part", *(one.title for one in shown.values())], names, cells, whole)
        if group == "confidence":
            self._calibration()

    def _grid(
        self,
        heads: Sequence[str],
        names: Sequence[str],
        cells: Sequence[Sequence[str]],
        bold: Sequence[bool] = (),
        left: int = 1,
    ) -> None:
        table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
        for at, head in enumerate(heads):
            table.add_column(head, justify="left" if at < left else "right", no_wrap=True, vertical="bottom")
        for name, row, strong in zip(names, cells, bold or [False] * len(names), strict=True):
            table.add_row(name, *row, style="bold" if strong else None)
        self._console.print(table)

    def _head(self, about: About) -> None:
        found, frames = self._evaluation, self._evaluation.frames
        shift = f", shifted by {about.shift:+d} frames" if about.shift else ""
        ours = f"{about.trajectory}" + (f" (read as {about.results_read_as})" if about.results_read_as else "")
        self._line(f"{ours} against {about.truth} (read as {about.read_as}{shift})", "bold")
        rows = ", ".join(f"{n:,} {name}" for name, n in found.counts.items() if n or name == "visible")
        count = f"{len(frames):,} frame{'s' if len(frames) != 1 else ''}"
        self._line(f"{count}, {frames[0]} to {frames[-1]}; rows, one a frame and part: {rows}")
        for target, text in found.units.items():
            self._line(f"length{f' of {target}' if len(found.units) > 1 else ''}: {text}")
        if found.all.points:
            failure = f"{100 * found.options.failure:g} %"
            self._line(
                f"a point is near if its error is less than 1/6 of the length; it has failed above {failure} of it"
            )
        if found.all.boxes:
            self._line(f"a box is near if its IoU with the ground truth is more than {NEAR_IOU:g}")

    def _occlusions(self) -> None:
        found = self._evaluation.all.occlusions
        if found is None:
            return
        back = f"{found.returned} of {found.decided} come back" if found.decided else "none can be decided"
        median = "" if found.frames_median is None else f", the median after {HALVES(found.frames_median)}"
        note = f"frames until all covered parts are near for {HELD} rows in a row; {back}{median}"
        self._title("OCCLUSIONS", note)
        every = self._evaluation.occlusions
        cells = []
        for one in every[:MOST]:
            by_hand = one.frames_to_return is not None and not one.decided
            unknown = "by hand" if by_hand else "cannot be decided" if not one.decided else "never"
            parts = [self._name(one.target, part) for part in one.parts[:MANY]]
            known = one.frames_to_return is not None and one.decided
            cells.append(
                (
                    ", ".join([*parts, *(["..."] if len(one.parts) > MANY else [])]),
                    str(one.frames_to_return) if known else unknown,
                )
            )
        names = [f"{one.first}-{one.last}" for one in every[:MOST]]
        self._grid(["frames", "parts", "back after"], names, cells, left=2)
        if len(every) > MOST:
            self._line(f"... and {len(every) - MOST} more; --json has them all")

    def _calibration(self) -> None:
        confidence = self._evaluation.all.confidence
        if confidence is None or not confidence.bins:
            return
        bins = confidence.bins
        cells = [
            [f"{one.rows:,}" for one in bins],
            *(
                [DASH if v is None else PERCENT(v) for v in those]
                for those in zip(*((b.near, b.visible) for b in bins), strict=True)
            ),
        ]
        self._line("")
        heads = ["confidence", *(f"{one.low:.1f}-{one.high:.1f}" for one in bins)]
        self._grid(heads, ["rows", "near, %", "visible, %"], cells)
