"""An evaluation as JSON and CSV for programs, and as tables for people."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.text import Text

from facetrack_cli.core.errors import flat
from facetrack_cli.core.numbers import csv_text, document
from facetrack_cli.evaluation.measure import HALVES, PERCENT
from facetrack_cli.evaluation.points import HELD
from facetrack_cli.evaluation.reliability import ReliabilityBin
from facetrack_cli.evaluation.rows import NEAR_IOU
from facetrack_cli.evaluation.sheet import MAX_WIDTH, NO_FIGURE, Sheet, trimmed
from facetrack_cli.evaluation.summary import MEASURES, Evaluation, PartMeasures

CURVES: Final = ("success", "precision", "normalised_precision")
MAX_PARTS: Final = 12  # in tables of status, confidence, spread and jitter
MAX_OCCLUSIONS: Final = 20  # in their table


@dataclass(frozen=True)
class About:
    """What was compared: the files, how they were read (the trajectory: if not facetrack's own), and the shift."""

    trajectory: Path
    truth: Path
    read_as: str
    shift: int = 0
    results_read_as: str | None = None


def to_json(evaluation: Evaluation, about: About) -> str:
    """Figures stand below the groups of their names, as `all.points.mean_px`; an undefined figure is null."""
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


def _groups(one: PartMeasures) -> dict[str, Any]:
    """The figures by group and name; a group that was not measured is left out."""
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
    """A header with all MEASURES, a row for each part, then a row for all parts together, whose target is "all"."""
    rows = (
        [about.trajectory, about.truth, one.target, one.part]
        + ["" if value is None else repr(value) for value in one.figures.values()]
        for one in (*evaluation.parts, evaluation.all)
    )
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


def to_text(evaluation: Evaluation, about: About, *, colour: bool = False) -> str:
    """All tables; with `colour`, with the escapes of a terminal."""
    console = Console(
        width=MAX_WIDTH, force_terminal=colour, color_system="standard" if colour else None, markup=False, emoji=False
    )
    with console.capture() as captured:
        console.print(Text(flat(_compared(about)), "bold"))
        for line in facts(evaluation):
            console.print(Text(flat(line)))
        for sheet in sheets(evaluation):
            title, _, what = sheet.title.partition(": ")
            console.print(Text.assemble("\n", (title.upper(), "bold"), ("  " + what, "dim")) if what else "")
            console.print(sheet.table(ruled=False))
            for note in sheet.notes:
                console.print(note)
        if evaluation.notes:
            console.print(Text("\nNOTES", "bold"))
            for note in evaluation.notes:
                console.print(Text(flat(note)))
    return trimmed(captured.get())


def _compared(about: About) -> str:
    shift = f", shifted by {about.shift:+d} frames" if about.shift else ""
    ours = f"{about.trajectory}" + (f" (read as {about.results_read_as})" if about.results_read_as else "")
    return f"{ours} against {about.truth} (read as {about.read_as}{shift})"


def facts(found: Evaluation) -> Iterator[str]:
    """Lines on what was compared, by which length errors are normalised, and what is near and right."""
    frames = found.frames
    rows = ", ".join(f"{n:,} {name}" for name, n in found.counts.items() if n or name == "visible")
    count = f"{len(frames):,} frame{'s' if len(frames) != 1 else ''}"
    yield f"{count}, {frames[0]} to {frames[-1]}; rows, one a frame and part: {rows}"
    for target, text in found.units.items():
        yield f"length{f' of {target}' if len(found.units) > 1 else ''}: {text}"
    if found.all.points:
        failed = f"it has failed above {100 * found.options.failure:g} % of it"
        yield f"a point is near if its error is less than 1/6 of the length; {failed}"
    if found.all.boxes:
        yield f"a box is near if its IoU with the ground truth is more than {NEAR_IOU:g}"
    if found.all.confidence:
        yield "a row is right if its centre is off by less than 1/4 of the length, of a box 1/4 of its size"


def sheets(found: Evaluation) -> Iterator[Sheet]:
    """All tables. A title is a name and, of all but the second table of confidence, what the table shows.

    Of more than MAX_PARTS parts the tables of status, confidence, spread and jitter show all parts together alone.
    """
    several = len({part.target for part in found.parts}) > 1

    def name(target: str, part: str) -> str:
        return flat(f"{target}/{part}" if several and part else part or target)

    every = [*found.parts, *([found.all] if len(found.parts) > 1 else [])]
    for group, title in _TABLES.items():
        if group == "lost" and found.all.occlusions is not None:
            yield _occlusions(found, name)
        few = group in ("points", "boxes") or len(found.parts) <= MAX_PARTS
        rows = [one for one in (every if few else every[-1:]) if getattr(one, group) is not None]
        if rows:
            values = [one.figures for one in rows]
            shown = {
                key: measure
                for key, measure in MEASURES.items()
                if key.startswith(f"{group}.") and measure.title and (not measure.rare or any(v[key] for v in values))
            }
            cells = [
                tuple(NO_FIGURE if (v := each[key]) is None else measure.write(v) for key, measure in shown.items())
                for each in values
            ]
            named = [(name(one.target, one.part), *own) for one, own in zip(rows, cells, strict=True)]
            yield Sheet(": ".join(title), ("part", *(one.title for one in shown.values())), tuple(named))
        if group == "confidence" and found.all.confidence is not None and found.all.confidence.bins:
            yield _reliability(found.all.confidence.bins)


def _occlusions(found: Evaluation, name: Callable[[str, str], str]) -> Sheet:
    whole = found.all.occlusions
    assert whole is not None
    back = f"{whole.returned} of {whole.decided} come back" if whole.decided else "none can be decided"
    median = "" if whole.frames_median is None else f", the median after {HALVES(whole.frames_median)}"
    rows = []
    for one in found.occlusions[:MAX_OCCLUSIONS]:
        known = one.frames_to_return is not None
        after = (str(one.frames_to_return) if known else "never") if one.decided else "cannot be decided"
        if known and not one.decided:
            after = "by hand"
        parts = [name(one.target, part) for part in one.parts[:MAX_PARTS]] + ["..."] * (len(one.parts) > MAX_PARTS)
        rows.append((f"{one.first}-{one.last}", ", ".join(parts), after))
    more = len(found.occlusions) - MAX_OCCLUSIONS
    return Sheet(
        f"Occlusions: frames until all covered parts are near for {HELD} rows in a row; {back}{median}",
        ("frames", "parts", "back after"),
        tuple(rows),
        (f"... and {more} more; --json has them all",) if more > 0 else (),
        left=(0, 1),
    )


def _reliability(bins: Sequence[ReliabilityBin]) -> Sheet:
    rows = [("rows", *(f"{one.rows:,.0f}" for one in bins))]
    for title, shares in (("right, %", [one.right for one in bins]), ("visible, %", [one.visible for one in bins])):
        rows.append((title, *(NO_FIGURE if share is None else PERCENT(share) for share in shares)))
    return Sheet("Rows by confidence", ("confidence", *(f"{one.low:.1f}-{one.high:.1f}" for one in bins)), tuple(rows))
