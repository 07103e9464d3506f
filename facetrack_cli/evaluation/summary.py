"""All measures of a trajectory against the truth as one value, and its figures by name.

evaluation = evaluate(match(trajectory, truth, ...))
evaluation.all.points.mean_px
scalars(evaluation)["lost.precision"]
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import iou
from facetrack_cli.evaluation.boxes import BoxMeasures, measure_boxes
from facetrack_cli.evaluation.points import (
    FAILURE,
    Occlusion,
    PointMeasures,
    RecoveryMeasures,
    measure_points,
    measure_recovery,
    occlusions,
)
from facetrack_cli.evaluation.rows import Figure, Rows, column, is_box, rows_of, says_box
from facetrack_cli.evaluation.trust import ConfidenceMeasures, CoverageMeasures, LostMeasures, Trust, measure_trust
from facetrack_cli.evaluation.units import Unit, check_normalise, unit_of
from facetrack_cli.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from facetrack_cli.evaluation.rows import Pair

Value: TypeAlias = float | int | None


@dataclass(frozen=True)
class Options:
    """`normalise`: by what errors are divided (units.py); `failure`: the normalised error above which a row failed.

    `size` is the picture's (width, height) where it is known, to which GOT-10k and VOT clip boxes.
    """

    normalise: str = "size"
    failure: float = FAILURE
    size: tuple[int, int] | None = None


@dataclass(frozen=True)
class HiddenBoxes:
    """Hidden rows whose true box is known, which no other measure of boxes counts: how many, and their mean IoU."""

    rows: int
    overlap: Figure


@dataclass(frozen=True)
class Measured:
    """One part, or with an empty `part` and the target "all", all of them together. What was not measured is None.

    The measures of boxes have no value for `all` but what is counted or averaged over rows: their arrays are curves.
    """

    target: str
    part: str
    points: PointMeasures | None
    boxes: BoxMeasures | None
    hidden_boxes: HiddenBoxes | None
    trust: Trust

    @property
    def name(self) -> str:
        return f"{self.target}/{self.part}" if self.part else self.target


@dataclass(frozen=True)
class Evaluation:
    """What was measured of one trajectory.

    `frames` are those that ours and the truth share, from `first` to `last`; `visible`, `hidden` and `absent` count
    rows, one a frame and part. `units` say by what length the errors of each target are normalised. `recovery` is None
    without occlusions. `notes` are lines of text, among them why a figure is not defined.
    """

    options: Options
    frames: int
    first: int
    last: int
    visible: int
    hidden: int
    absent: int
    units: Mapping[str, str]
    parts: tuple[Measured, ...]
    all: Measured
    occlusions: tuple[Occlusion, ...]
    recovery: RecoveryMeasures | None
    notes: tuple[str, ...]


def evaluate(
    pairs: Sequence[Pair],
    notes: Sequence[str] = (),
    options: Options | None = None,
    *,
    reference: Sequence[Trajectory] = (),
) -> Evaluation:
    """Measure the pairs of `match`. Lengths are taken from their truth, and from the truth series in `reference`.

    Raises InputError without any row, UsageError for a length that the truth does not have.
    """
    options = options or Options()
    pairs = [_told(pair) for pair in pairs]
    if not any(len(pair.ours) for pair in pairs):
        raise InputError("there is no row that both the trajectory and the truth have; nothing can be measured")
    units = units_of(pairs, options.normalise, reference)
    rows = [rows_of(pair, units[pair.ours.target].at(pair.ours.frame)) for pair in pairs]
    every = list(zip(pairs, rows, strict=True))
    found = occlusions(rows)
    evaluation = Evaluation(
        options=options,
        frames=len(np.unique(np.concatenate([part.frame for part in rows]))),
        first=min(int(part.frame[0]) for part in rows if len(part)),
        last=max(int(part.frame[-1]) for part in rows if len(part)),
        visible=sum(int(part.visible.sum()) for part in rows),
        hidden=sum(int(part.hidden.sum()) for part in rows),
        absent=sum(int(part.absent.sum()) for part in rows),
        units={target: unit.text for target, unit in units.items()},
        parts=tuple(_measured(part.target, part.part, [(pair, part)], options) for pair, part in every),
        all=_measured("all", "", every, options),
        occlusions=found,
        recovery=measure_recovery(found),
        notes=(),
    )
    return replace(evaluation, notes=(*notes, *_strange_start(rows), *_why_undefined(evaluation, rows)))


def units_of(pairs: Sequence[Pair], normalise: str = "size", reference: Sequence[Trajectory] = ()) -> dict[str, Unit]:
    """By target, the length that normalises its errors."""
    check_normalise(normalise)
    found = {}
    for target in dict.fromkeys(pair.ours.target for pair in pairs):
        own = [pair for pair in pairs if pair.ours.target == target]
        truth = {pair.truth.part: pair.truth for pair in own}
        # the size is that of the parts which are tracked; what else the truth knows serves where a length needs it
        if len(truth) == 1 or normalise != "size":
            # one target may go by another name in the truth than in the trajectory
            named = [s for s in reference if s.target == own[0].truth.target]
            alone = reference if len({s.target for s in reference}) == 1 else []
            truth = {**{s.part: s for s in named or alone}, **truth}
        frames = np.unique(np.concatenate([pair.ours.frame for pair in own]))
        box = says_box(own[0].ours, own[0].truth) and bool(np.any(own[0].truth.w > 0))
        series = [own[0].truth] if box and normalise == "size" else list(truth.values())
        found[target] = unit_of(normalise, target, series, box=box, frames=frames)
    return found


def _told(pair: Pair) -> Pair:
    """Without the rows that the truth itself calls lost, as a trajectory does that serves as truth."""
    known = pair.truth.status != "lost"
    return pair if known.all() else pair._replace(ours=pair.ours.take(known), truth=pair.truth.take(known))


def _measured(target: str, part: str, those: Sequence[tuple[Pair, Rows]], options: Options) -> Measured:
    boxed = [(pair, rows) for pair, rows in those if is_box(pair.ours, pair.truth)]
    points = [rows for pair, rows in those if not is_box(pair.ours, pair.truth)]
    return Measured(
        target=target,
        part=part,
        points=measure_points(points, options.failure) if points else None,
        boxes=pooled([_boxes(pair, rows, options) for pair, rows in boxed]) if boxed else None,
        hidden_boxes=_hidden(boxed) if boxed else None,
        trust=measure_trust([rows for _, rows in those]),
    )


def _boxes(pair: Pair, rows: Rows, options: Options) -> BoxMeasures:
    return measure_boxes(
        pair.ours.boxes,
        pair.truth.boxes,
        valid=rows.visible & ~rows.later,
        our_corners=pair.ours.corners,
        true_corners=pair.truth.corners,
        size=options.size,
        first_is_init=bool(len(rows)) and bool(rows.init[0]),
    )


def _hidden(those: Sequence[tuple[Pair, Rows]]) -> HiddenBoxes:
    # to call absent what is hidden is right, and what was given by hand is no merit
    boxed = [(pair, rows.hidden & ~rows.left_out & ~rows.later) for pair, rows in those]
    overlap = np.concatenate([iou(pair.ours.boxes, pair.truth.boxes)[rows] for pair, rows in boxed])
    known = np.concatenate([~np.isnan(pair.truth.boxes[rows]).any(axis=1) for pair, rows in boxed])
    overlap = np.nan_to_num(overlap[known])  # without a box of ours nothing overlaps
    return HiddenBoxes(len(overlap), float(np.mean(overlap)) if len(overlap) else None)


_COUNTED_BY: Final = {  # which rows a measure of boxes averages over; all others average over `frames`
    **dict.fromkeys(("ao", "sr50", "sr75", "got10k_success"), "got10k_frames"),
    "vot_accuracy": "vot_frames",
}


def pooled(every: Sequence[BoxMeasures]) -> BoxMeasures:
    """The measures of several targets as if all their rows were one's: every one of them is a mean over rows."""
    if len(every) == 1:
        return every[0]
    values: dict[str, Any] = {}
    for f in fields(BoxMeasures):
        given = [getattr(one, f.name) for one in every]
        if f.type == "int":
            values[f.name] = sum(given)
        elif f.name in ("overlap", "centre_error"):
            values[f.name] = np.concatenate(given)
        else:
            weights = [getattr(one, _COUNTED_BY.get(f.name, "frames")) for one in every]
            terms = [weight * value for weight, value in zip(weights, given, strict=True) if weight]
            # without any row the value is the one that says so
            values[f.name] = sum(terms[1:], terms[0]) / sum(weights) if terms else given[0]
    return BoxMeasures(**values)


# --- figures by name ---------------------------------------------------------------------------------------------

BOX_FIGURES: Final = {
    "rows": "frames",
    "missing": "missing",
    "success_auc": "auc",
    "precision_20": "precision_20",
    "normalised_auc": "normalised_auc",
    "normalised_20": "normalised_20",
    "ao": "ao",
    "sr50": "sr50",
    "sr75": "sr75",
    "vot_accuracy": "vot_accuracy",
    "good_rate": "good_rate",
    "strict_rate": "strict_rate",
}
"""Names of the figures of boxes, and what boxes.py calls them."""
_LESS: Final = frozenset(
    (
        *(
            "mean_px",
            "median_px",
            "std_px",
            "p95_px",
            "mean_normalised",
            "median_normalised",
            "failure_rate",
            "missing",
        ),
        *("hidden_mean_px", "hidden_median_px", "lost_for_good", "frames_median", "frames_worst"),
        *("false_alarms", "delay_lost", "delay_back", "ece", "brier"),
    )
)
_NEITHER: Final = frozenset(
    (
        *("rows", "hidden_rows", "occlusions", "decided", "returned", "covered", "called", "spans", "spans_called"),
        *("near", "within_50", "within_90", "factor", "zero_std", "unknown_std"),
    )
)


def _figures_of(kind: type) -> dict[str, str]:
    return {f.name: f.name for f in fields(kind) if str(f.type) in ("Figure", "int", "float", "int | None")}


GROUPS: Final[Mapping[str, Mapping[str, str]]] = {
    "points": _figures_of(PointMeasures),
    "boxes": {**BOX_FIGURES, "hidden_rows": "", "hidden_overlap": ""},
    "occlusions": _figures_of(RecoveryMeasures),
    "lost": _figures_of(LostMeasures),
    "confidence": _figures_of(ConfidenceMeasures),
    "coverage": _figures_of(CoverageMeasures),
}
"""The first words of the names of figures, below them the second words and the fields that hold them."""


def names() -> tuple[str, ...]:
    """The names of all figures, whatever was measured: `points.rows`, `points.missing`, ..., `coverage.unknown_std`."""
    return tuple(f"{group}.{figure}" for group, those in GROUPS.items() for figure in those)


def measured_groups(measured: Measured, recovery: RecoveryMeasures | None = None) -> dict[str, object]:
    """What holds the figures of each of GROUPS; None where it was not measured."""
    return {
        "points": measured.points,
        "boxes": measured.boxes,
        "occlusions": recovery,
        "lost": measured.trust.lost,
        "confidence": measured.trust.confidence,
        "coverage": measured.trust.coverage,
    }


def figures(measured: Measured, recovery: RecoveryMeasures | None = None) -> dict[str, Value]:
    """Every figure by its name, None where it is not defined or was not measured."""
    holders = measured_groups(measured, recovery)
    values = {
        f"{group}.{figure}": getattr(holders[group], field, None)
        for group, those in GROUPS.items()
        for figure, field in those.items()
    }
    if measured.hidden_boxes is not None:
        values["boxes.hidden_rows"] = measured.hidden_boxes.rows
        values["boxes.hidden_overlap"] = measured.hidden_boxes.overlap
    return {name: None if v is None or not math.isfinite(v) else v for name, v in values.items()}


def scalars(evaluation: Evaluation) -> dict[str, float]:
    """The figures of all parts together, by stable names; what is not defined is left out."""
    found = figures(evaluation.all, evaluation.recovery)
    return {name: float(value) for name, value in found.items() if value is not None}


def higher_is_better(name: str) -> bool | None:
    """Whether more of a figure is better; None where neither is, as of a count of rows, or of a coverage."""
    figure = name.rpartition(".")[2]
    return None if figure in _NEITHER else figure not in _LESS


_WHY: Final = (  # a figure that is not defined although the other is, and why
    ("points.mean_px", "points.rows", "no visible row has a true position and one of ours, so there is no error"),
    ("boxes.success_auc", "boxes.rows", "no visible row has a true box, so there is no overlap"),
    ("boxes.ao", "boxes.success_auc", "only the given row has a true box: AO, SR and VOT's accuracy count none"),
    (
        "occlusions.recovered",
        "occlusions.occlusions",
        "fewer than 5 rows of known truth follow each occlusion, or corrections do: recovery is not known",
    ),
    ("lost.precision", "lost.rows", "no row is called lost, so lost has no precision"),
    ("lost.recall", "lost.rows", "the truth marks no row as hidden or absent, so lost has no recall"),
    ("confidence.auroc_near", "confidence.near", "AUROC compares near rows with others, and there is only one kind"),
    ("confidence.ece", "confidence.near", "confidence is not within 0 and 1: as a mere score it is not calibrated"),
    ("coverage.within_50", "coverage.rows", "no visible row has a true position and a std, so there is no coverage"),
    ("coverage.factor", "coverage.within_50", "half of the rows have no spread at all: no factor would mend that"),
)


def _strange_start(rows: Sequence[Rows]) -> list[str]:
    """Whether the rows that the tracker was given at its start lie nowhere near the truth."""
    given = [part.take(part.init & ~part.later & part.placed) for part in rows]
    error, unit = column(given, "error"), column(given, "unit")
    known = np.isfinite(error) & np.isfinite(unit)
    if not known.any() or np.median(error[known] / unit[known]) <= 1:
        return []
    off = float(np.median(error[known]))
    return [f"the track starts {off:.0f} px from the truth: is that of another clip, another size, or other frames?"]


def _why_undefined(evaluation: Evaluation, rows: Sequence[Rows]) -> list[str]:
    found = figures(evaluation.all, evaluation.recovery)
    why = [text for name, other, text in _WHY if found[name] is None and found[other] is not None]
    if found["points.mean_px"] is not None and found["points.auc"] is None:
        texts = "; ".join(dict.fromkeys(evaluation.units.values()))
        why.append(f"errors are not normalised and nothing is near ({texts}): give --normalise PIXELS")
    if all(part.init.all() for part in rows):
        return [*why, "all rows were given to the tracker, so lost, confidence and coverage are not measured"]
    for group, name in (("lost", "status"), ("confidence", "confidence"), ("coverage", "std")):
        if getattr(evaluation.all.trust, group) is None:
            why.append(f"the trajectory has no {name}, so {group} is not measured")
    return why
