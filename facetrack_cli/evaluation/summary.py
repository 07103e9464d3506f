"""All measures of a trajectory against the ground truth as one value, and its figures by name.

evaluation = evaluate(match(trajectory, truth, ...))
evaluation.all.points.mean_px
scalars(evaluation)["lost.precision"]
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, get_args, get_type_hints

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Whole
from facetrack_cli.evaluation import points as errors
from facetrack_cli.evaluation import reliability
from facetrack_cli.evaluation.boxes import BoxMeasures, measure_boxes
from facetrack_cli.evaluation.identities import PeopleMeasures
from facetrack_cli.evaluation.measure import Measure, Value, measures_of
from facetrack_cli.evaluation.rows import Pair, Rows, Unit, check_normalise, column, rows_of, unit_of
from facetrack_cli.trajectory.trajectory import Trajectory, joined


@dataclass(frozen=True)
class Options:
    """`normalise`: see `check_normalise`; `failure`: the normalised error above which a row has failed; `size`: (width,
    height) of the frames where it is known, to which GOT-10k and VOT clip boxes.
    """

    normalise: str = "size"
    failure: float = errors.FAILURE
    size: tuple[int, int] | None = None


@dataclass(frozen=True)
class PartMeasures:
    """One part, or with an empty `part` and the target "all", all of them together; what was not measured is None.

    All together alone have `occlusions` and `people`.
    """

    target: str
    part: str
    points: errors.PointMeasures | None
    boxes: BoxMeasures | None
    occlusions: errors.RecoveryMeasures | None
    lost: reliability.LostMeasures | None
    confidence: reliability.ConfidenceMeasures | None
    coverage: reliability.CoverageMeasures | None
    jitter: reliability.JitterMeasures | None
    people: PeopleMeasures | None = None

    @property
    def name(self) -> str:
        return f"{self.target}/{self.part}" if self.part else self.target

    @property
    def figures(self) -> dict[str, Value]:
        """The value of each of MEASURES, None where it is not defined or was not measured."""
        found = {}
        for name in MEASURES:
            group, _, figure = name.partition(".")
            value = getattr(getattr(self, group), figure, None)
            found[name] = None if value is None or not math.isfinite(value) else value
        return found


# the first words of the names of measures, and the dataclass whose fields are the second ones
GROUPS: Final = {name: get_args(hint)[0] for name, hint in get_type_hints(PartMeasures).items() if get_args(hint)}
# all measures by name, whatever was measured: `points.rows`, `points.missing`, ..., `coverage.unknown_std`
MEASURES: Final[Mapping[str, Measure]] = {
    f"{group}.{name}": one for group, kind in GROUPS.items() for name, one in measures_of(kind).items()
}


@dataclass(frozen=True)
class Evaluation:
    """What was measured on the `rows` that both have; `units`: the length that normalises each target's errors."""

    options: Options
    rows: tuple[Rows, ...]
    units: Mapping[str, str]
    parts: tuple[PartMeasures, ...]
    all: PartMeasures
    occlusions: tuple[errors.Occlusion, ...]
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
    options: Options | None = None,
    *,
    reference: Sequence[Trajectory] = (),
    people: PeopleMeasures | None = None,
) -> Evaluation:
    """Measure the pairs of `match`. Lengths are taken from their ground truth, and from the parts in `reference`.
    Raises InputError without any row, UsageError for a length that the ground truth does not have.
    """
    options = options or Options()
    # the rows that the ground truth itself calls lost, as a trajectory does that serves as ground truth, are unknown
    known = [pair.truth.status != "lost" for pair in pairs]
    pairs = [Pair(*(one.take(rows) for one in pair)) for pair, rows in zip(pairs, known, strict=True)]
    if not any(len(pair.ours) for pair in pairs):
        raise InputError("there is no row that both the trajectory and the ground truth have; nothing can be measured")
    units = units_of(pairs, options.normalise, reference)
    every = [(pair, rows_of(pair, units[pair.ours.target].at(pair.ours.frame))) for pair in pairs]
    rows = tuple(one for _, one in every)
    found = errors.occlusions(rows)
    whole = _measured("all", "", every, options)
    whole = replace(whole, occlusions=errors.measure_recovery(found), people=people)
    parts = tuple(_measured(one.target, one.part, [(pair, one)], options) for pair, one in every)
    texts = {target: unit.text for target, unit in units.items()}
    evaluation = Evaluation(options, rows, texts, parts, whole, found, ())
    return replace(evaluation, notes=(*notes, *_strange_start(rows), *_why_undefined(evaluation)))


def units_of(pairs: Sequence[Pair], normalise: str, reference: Sequence[Trajectory]) -> dict[str, Unit]:
    """By target, the length that normalises its errors."""
    check_normalise(normalise)
    found = {}
    for target in dict.fromkeys(pair.ours.target for pair in pairs):
        own = [pair for pair in pairs if pair.ours.target == target]
        truth = {pair.truth.part: pair.truth for pair in own}
        # the size is that of the tracked parts; other parts of the ground truth serve where a length needs them
        if len(truth) == 1 or normalise != "size":
            # a target may have another name in the ground truth than in the trajectory
            named = [s for s in reference if s.target == own[0].truth.target]
            alone = reference if len({s.target for s in reference}) == 1 else []
            truth = {**{s.part: s for s in named or alone}, **truth}
        frames = np.unique(np.concatenate([pair.ours.frame for pair in own]))
        box = own[0].declared_box and bool(np.any(own[0].truth.w > 0))
        series = [own[0].truth] if box and normalise == "size" else list(truth.values())
        found[target] = unit_of(normalise, series, box=box, frames=frames)
    return found


def _measured(target: str, part: str, every: Sequence[tuple[Pair, Rows]], options: Options) -> PartMeasures:
    rows = [one for _, one in every]
    points = [one for pair, one in every if not pair.is_box]
    boxed = [(pair, one) for pair, one in every if pair.is_box]
    of_points = errors.measure_points(points, options.failure) if points else None
    of_boxes = _boxes(boxed, options.size) if boxed else None
    trusted = reliability.measure_lost(rows), reliability.measure_confidence(rows), reliability.measure_coverage(rows)
    jitter = reliability.measure_jitter(rows)
    return PartMeasures(target, part, of_points, of_boxes, None, *trusted, jitter)


def _boxes(those: Sequence[tuple[Pair, Rows]], size: tuple[int, int] | None) -> BoxMeasures:
    """The rows of all pairs as if they were one target's; rows that a correction gave do not count."""
    pairs, rows = zip(*those, strict=True)
    ours, truth = (joined([s.renamed(str(i), "box") for i, s in enumerate(each)]) for each in zip(*pairs, strict=True))
    later = column(rows, "later")
    return measure_boxes(
        ours.boxes,
        truth.boxes,
        visible=column(rows, "visible") & ~later,
        hidden=column(rows, "hidden") & ~later & ~column(rows, "left_out"),
        init=column(rows, "init"),
        our_corners=ours.corners,
        true_corners=truth.corners,
        size=size,
    )


def scalars(evaluation: Evaluation) -> dict[str, float]:
    """The figures of all parts together, by name; what is not defined is left out."""
    return {name: float(value) for name, value in evaluation.all.figures.items() if value is not None}


_WHY: Final = (  # a figure that is not defined although the other is, and why
    ("points.mean_px", "points.rows", "no visible row has a true position and one of ours, so there is no error"),
    ("boxes.success_auc", "boxes.rows", "no visible row has a true box, so there is no overlap"),
    ("boxes.ao", "boxes.success_auc", "AO, SR and the accuracy of VOT leave out given rows; no others have a true box"),
    (
        "occlusions.recovered",
        "occlusions.occlusions",
        "fewer than 5 rows of known ground truth follow each occlusion, or corrections do: recovery is not known",
    ),
    ("lost.precision", "lost.rows", "no row is called lost, so lost has no precision"),
    ("lost.recall", "lost.rows", "the ground truth marks no row as hidden or absent, so lost has no recall"),
    ("confidence.auroc_near", "confidence.near", "AUROC compares near rows with others, and there is only one kind"),
    ("confidence.ece", "confidence.right", "confidence is not within 0 and 1, so its calibration is not defined"),
    ("coverage.within_50", "coverage.rows", "no visible row has a true position and a std, so there is no coverage"),
    ("coverage.factor", "coverage.within_50", "half of the rows have no spread, which no factor changes"),
)


def _strange_start(rows: Sequence[Rows]) -> list[str]:
    """A note where the rows that the tracker was given at its start are far from the ground truth."""
    given = [part.take(part.init & ~part.later & part.placed) for part in rows]
    error, unit = column(given, "error"), column(given, "unit")
    known = np.isfinite(error) & np.isfinite(unit)
    if not known.any() or np.median(error[known] / unit[known]) <= 1:
        return []
    off = float(np.median(error[known]))
    return [f"the track starts {off:.0f} px from the ground truth: is that of another clip, size or frames?"]


def _why_undefined(evaluation: Evaluation) -> list[str]:
    found = evaluation.all.figures
    why = [text for name, other, text in _WHY if found[name] is None and found[other] is not None]
    if found["points.mean_px"] is not None and found["points.auc"] is None:
        texts = "; ".join(dict.fromkeys(evaluation.units.values()))
        why.append(f"errors are not normalised and nothing is near ({texts}): give --normalise PIXELS")
    if column(evaluation.rows, "init").all():
        return [*why, "all rows were given to the tracker, so lost, confidence and coverage are not measured"]
    for group, name in (("lost", "status"), ("confidence", "confidence"), ("coverage", "std")):
        if getattr(evaluation.all, group) is None:
            why.append(f"the trajectory has no {name}, so {group} is not measured")
    return why
