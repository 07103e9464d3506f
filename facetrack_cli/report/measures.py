"""The measures against the ground truth, chosen and worded for the report; `facetrack eval` prints all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from facetrack_cli.evaluation.measure import Value
from facetrack_cli.evaluation.rows import NEAR_IOU
from facetrack_cli.evaluation.summary import Evaluation
from facetrack_cli.report.text import count, number, percent


class Measures(NamedTuple):
    """A table: `head` above rows whose first cell names them."""

    caption: str
    head: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


_POINTS: Final = (
    ("mean (px)", "mean_px", 2),
    ("median (px)", "median_px", 2),
    ("95 % below (px)", "p95_px", 2),
    ("mean, normalised", "mean_normalised", 3),
    ("failures", "failure_rate", None),
    ("AUC", "auc", 3),
)
_BOXES: Final = (
    ("success AUC", "success_auc", 3),
    ("precision, 20 px", "precision_20", 3),
    ("normalised precision AUC", "normalised_auc", 3),
    ("AO", "ao", 3),
    ("SR 0.5", "sr50", 3),
    ("VOT accuracy", "vot_accuracy", 3),
    ("good tracking rate", "good_rate", None),
)
# (what it says, figure, decimals; None is a share)
_TRUST: Final = (
    ("Called lost, and hidden or absent in the ground truth (precision)", "lost.precision", None),
    ("Hidden or absent in the ground truth, and called lost (recall)", "lost.recall", None),
    ("Called tracked, and near the ground truth", "lost.tracked_near", None),
    ("Frames until a hidden part is called lost (median)", "lost.delay_lost", 1),
    ("Parts that come back after an occlusion", "occlusions.recovered", None),
    ("Frames until they are back (median)", "occlusions.frames_median", 1),
    ("Mean error while hidden (px)", "points.hidden_mean_px", 2),
    ("Confidence separates near from not near (area under ROC)", "confidence.auroc_near", 3),
    ("Ground truth within the 50 % ellipse of the particles", "coverage.within_50", None),
    ("Ground truth within the 90 % ellipse of the particles", "coverage.within_90", None),
)


def measures(evaluation: Evaluation) -> list[Measures]:
    """Tables of the errors of points, of boxes, and of how far the tracker can be trusted; empty ones are left out."""
    whole = evaluation.all.figures
    several = len({part.target for part in evaluation.parts}) > 1
    rows = [(part.name if several else part.part, part.figures) for part in evaluation.parts]
    if len(rows) > 1:
        rows.insert(0, ("all", whole))
    trust = [(what, _cell(whole[name], digits)) for what, name, digits in _TRUST if whole.get(name) is not None]
    found = [
        _by_part("Error of points while they are visible", "points", _POINTS, rows),
        _by_part("Overlap and place of boxes", "boxes", _BOXES, rows),
        Measures("How reliable the tracker's status and confidence are", ("all parts together", "value"), trust),
    ]
    return [table for table in found if table.rows]


def about(evaluation: Evaluation) -> str:
    """What was compared, in a sentence or two."""
    rows = ", ".join(f"{n:,} {status}" for status, n in evaluation.counts.items() if n) or "none"
    several, frames = len(evaluation.units) > 1, evaluation.frames
    units = "; ".join(f"{text}{f' ({name})' if several else ''}" for name, text in evaluation.units.items())
    found = [
        f"{count(len(frames), 'frame')} that the run and the ground truth share, {frames[0]} to "
        f"{frames[-1]}; rows of the ground truth: {rows}.",
        f"Normalised errors are divided by {units}.",
    ]
    if evaluation.all.points is not None:
        off = f"{100 * evaluation.options.failure:g}\u00a0%"
        found.append(f"A point has failed if it is off by more than {off} of that, and is near if by less than 1/6.")
    if evaluation.all.boxes is not None:
        found.append(f"A box is near if it overlaps the ground truth by more than {NEAR_IOU:g}.")
    return " ".join(found)


def _by_part(
    caption: str,
    group: str,
    columns: Sequence[tuple[str, str, int | None]],
    rows: Sequence[tuple[str, Mapping[str, Value]]],
) -> Measures:
    """A row for each part and a column for each measure, of those that are defined."""
    named = [(title, f"{group}.{name}", digits) for title, name, digits in columns]
    shown = [one for one in named if any(values.get(one[1]) is not None for _, values in rows)]
    cells = [
        (part, *(_cell(values.get(name), digits) for _, name, digits in shown))
        for part, values in rows
        if any(values.get(name) is not None for _, name, _ in shown)
    ]
    return Measures(caption, ("", *(title for title, _, _ in shown)), cells)


def _cell(value: Value, digits: int | None) -> str:
    return percent(value) if digits is None else number(value, digits)
