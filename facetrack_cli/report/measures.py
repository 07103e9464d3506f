"""The measures against the truth, chosen and worded for the report; `facetrack eval` prints all of them."""

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
    rows: list[tuple[str, ...]]


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
    ("Called lost, and hidden or absent in truth (precision)", "lost.precision", None),
    ("Hidden or absent in truth, and called lost (recall)", "lost.recall", None),
    ("Called tracked, and near the truth", "lost.tracked_near", None),
    ("Frames until a hidden part is called lost (median)", "lost.delay_lost", 1),
    ("Parts that come back after an occlusion", "occlusions.recovered", None),
    ("Frames until they are back (median)", "occlusions.frames_median", 1),
    ("Mean error while hidden (px)", "points.hidden_mean_px", 2),
    ("Confidence tells near from not near (area under ROC)", "confidence.auroc_near", 3),
    ("Truth within the 50 % ellipse of the particles", "coverage.within_50", None),
    ("Truth within the 90 % ellipse of the particles", "coverage.within_90", None),
)


def measures(evaluation: Evaluation) -> list[Measures]:
    """Tables of the errors of points, of boxes, and of how far the tracker can be trusted; empty ones are left out."""
    whole = evaluation.all.figures
    several = len({part.target for part in evaluation.parts}) > 1
    rows = [(part.name if several else part.part, part.figures) for part in evaluation.parts]
    if len(rows) > 1:
        rows.insert(0, ("all", whole))
    found = [
        _by_part("Error of points while they are visible", "points", _POINTS, rows),
        _by_part("Overlap and place of boxes", "boxes", _BOXES, rows),
        Measures(
            "How far the tracker's own word can be trusted",
            ("all parts together", "value"),
            [(what, _cell(whole[name], digits)) for what, name, digits in _TRUST if whole.get(name) is not None],
        ),
    ]
    return [table for table in found if table.rows]


def about(evaluation: Evaluation) -> str:
    """What was compared, in a sentence or two."""
    rows = [f"{n:,} {word}" for word, n in evaluation.counts.items() if n]
    several, frames = len(evaluation.units) > 1, evaluation.frames
    units = "; ".join(f"{text}{f' ({name})' if several else ''}" for name, text in evaluation.units.items())
    near = []
    if evaluation.all.points is not None:
        failure = f"{100 * evaluation.options.failure:g}\u00a0%"
        near.append(f"A point has failed if it is off by more than {failure} of that, and is near if by less than 1/6.")
    if evaluation.all.boxes is not None:
        near.append(f"A box is near if it overlaps the truth by more than {NEAR_IOU:g}.")
    return (
        f"{count(len(frames), 'frame')} that the run and the truth share, {frames[0]} to "
        f"{frames[-1]}; rows in truth: {', '.join(rows) or 'none'}. Normalised errors are divided by {units}. "
        f"{' '.join(near)}"
    )


def _by_part(
    caption: str,
    group: str,
    columns: Sequence[tuple[str, str, int | None]],
    rows: Sequence[tuple[str, Mapping[str, Value]]],
) -> Measures:
    names = [(title, f"{group}.{name}", digits) for title, name, digits in columns]
    shown = [column for column in names if any(values.get(column[1]) is not None for _, values in rows)]
    return Measures(
        caption,
        ("", *(title for title, _, _ in shown)),
        [
            (part, *(_cell(values.get(name), digits) for _, name, digits in shown))
            for part, values in rows
            if any(values.get(name) is not None for _, name, _ in shown)
        ],
    )


def _cell(value: Value, digits: int | None) -> str:
    return percent(value) if digits is None else number(value, digits)
