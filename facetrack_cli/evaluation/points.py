"""Errors of points, Euclidean distances in pixels, against the ground truth, and the recovery of parts after
occlusions. A *normalised* error is divided by a length of the ground truth (rows.py). Failure rate and AUC are those of
the facial landmark literature (300-W, COFW, WFLW), with a row for an image.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from facetrack_cli.core.numbers import spans
from facetrack_cli.core.types import Array
from facetrack_cli.evaluation.rows import COUNT, HALVES, PERCENT, PX, UNIT, Measure, Rows, Value, column, mean, median

FAILURE = 0.1  # normalised error above which a row has failed, as in COFW and WFLW; 300-W takes 0.08
HELD = 5  # a part is back once it is near for so many rows in a row
LAST = 25  # visible rows at the end whose median error tells whether a part is lost for good
LOST = 1 / 4  # of the normalising length: a part whose last rows are further off is lost for good


@dataclass(frozen=True)
class PointMeasures:
    """Errors of one part, or of several together.

    rows           visible rows with a known true position and a position of ours; the figures below are of these
    missing        visible rows for which we have no position; they count as failures, and in nothing else
    ..._px         error in pixels: mean, median, standard deviation, 95th percentile
    failure_rate   share of the visible rows whose normalised error is above the failure threshold, or missing
    auc            area under the cumulative distribution of their normalised error up to that threshold, divided by it
    hidden_...     the same of hidden rows whose true position is known
    lost_for_good  parts whose median error over their last 25 visible rows exceeds 1/4 of the normalising length
    """

    rows: Annotated[int, Measure("visible\nrows", COUNT)]
    missing: Annotated[int, Measure("", COUNT, "less")]
    mean_px: Annotated[Value, Measure("mean\npx", PX, "less")]
    median_px: Annotated[Value, Measure("median\npx", PX, "less")]
    std_px: Annotated[Value, Measure("std\npx", PX, "less")]
    p95_px: Annotated[Value, Measure("95th\npx", PX, "less")]
    mean_normalised: Annotated[Value, Measure("mean\n% of length", PERCENT, "less")]
    median_normalised: Annotated[Value, Measure("", PERCENT, "less")]
    failure_rate: Annotated[Value, Measure("failed\n%", PERCENT, "less")]
    auc: Annotated[Value, Measure("AUC\n", UNIT, "more")]
    hidden_rows: Annotated[int, Measure("hidden\nrows", COUNT, rare=True)]
    hidden_mean_px: Annotated[Value, Measure("mean\npx", PX, "less", rare=True)]
    hidden_median_px: Annotated[Value, Measure("median\npx", PX, "less", rare=True)]
    lost_for_good: Annotated[int | None, Measure("lost for\ngood", COUNT, "less")]


@dataclass(frozen=True)
class Occlusion:
    """A stretch of rows of one target in which parts of it are hidden or absent; `first` and `last` are its frames.

    `frames_to_return`: from the first frame after it to the first of 5 rows in a row in which every part that was
    covered is near; None if there is none before the next occlusion or the end. `decided` is False where fewer than 5
    rows follow of which it is known whether those parts are near, and where a correction of them came before.
    """

    target: str
    parts: tuple[str, ...]
    first: int
    last: int
    frames_to_return: int | None
    decided: bool


@dataclass(frozen=True)
class RecoveryMeasures:
    """How many occlusions there are, can be decided, and end with a return; `recovered` is the share of the decided."""

    occlusions: Annotated[int, Measure("", COUNT)]
    decided: Annotated[int, Measure("", COUNT)]
    returned: Annotated[int, Measure("", COUNT)]
    recovered: Annotated[Value, Measure("", PERCENT, "more")]
    frames_median: Annotated[Value, Measure("", HALVES, "less")]
    frames_worst: Annotated[Value, Measure("", COUNT, "less")]


def measure_points(parts: Sequence[Rows], failure: float = FAILURE) -> PointMeasures:
    """Errors over all rows of the parts but those that a correction gave; `failure` is a normalised error."""
    parts = [part.take(~part.later) for part in parts]
    error, unit, visible, hidden = (column(parts, name) for name in ("error", "unit", "visible", "hidden"))
    seen, missing = visible & np.isfinite(error), visible & np.isinf(error)
    px, covered = error[seen], error[hidden & np.isfinite(error)]
    # rows without a length have no normalised error; those without a position fail by any length
    scaled = (seen | missing) & np.isfinite(unit)
    normalised = error[scaled] / unit[scaled]
    finite = normalised[np.isfinite(normalised)]
    for_good = [lost for part in parts if (lost := lost_for_good(part)) is not None]
    return PointMeasures(
        rows=len(px),
        missing=int(np.sum(missing)),
        mean_px=mean(px),
        median_px=median(px),
        std_px=float(np.std(px)) if len(px) else None,
        p95_px=float(np.percentile(px, 95)) if len(px) else None,
        mean_normalised=mean(finite),
        median_normalised=median(finite),
        failure_rate=mean(normalised > failure),
        auc=auc(normalised, failure),
        hidden_rows=len(covered),
        hidden_mean_px=mean(covered),
        hidden_median_px=median(covered),
        lost_for_good=sum(for_good) if for_good else None,
    )


def auc(errors: Array, limit: float) -> Value:
    """Area under the cumulative distribution of `errors` (R,) from 0 to `limit`, over `limit`; None without rows."""
    return mean(np.clip(1 - errors / limit, 0.0, 1.0))


def lost_for_good(part: Rows) -> bool | None:
    """Whether a part ends lost; None where no visible row has a true position and a length."""
    seen = np.flatnonzero(part.visible & part.placed & np.isfinite(part.unit))[-LAST:]
    return bool(np.median(part.error[seen] / part.unit[seen]) > LOST) if len(seen) else None


def occlusions(parts: Sequence[Rows]) -> tuple[Occlusion, ...]:
    """The occlusions of every target, in the order of targets and frames."""
    targets = dict.fromkeys(part.target for part in parts)
    return tuple(span for name in targets for span in _of_target([part for part in parts if part.target == name]))


def _of_target(parts: Sequence[Rows]) -> Iterator[Occlusion]:
    frames = np.unique(column(parts, "frame"))
    # a part without a row in a frame is not known to be covered there, nor to be near
    covered, near, judged, by_hand = np.zeros((4, len(frames), len(parts)), dtype=np.bool_)
    for k, part in enumerate(parts):
        at = np.searchsorted(frames, part.frame)
        covered[at, k], near[at, k], judged[at, k], by_hand[at, k] = part.covered, part.near, part.judged, part.by_hand
    stretches = spans(np.any(covered, axis=1))
    nexts = [*[first for first, _ in stretches], len(frames)][1:]
    for (first, end), until in zip(stretches, nexts, strict=True):
        hit = np.flatnonzero(covered[first:end].any(axis=0))
        back = next((end + a for a, b in spans(np.all(near[end:until, hit], axis=1)) if b - a >= HELD), None)
        helped = by_hand[first : until if back is None else back + 1, hit].any()
        after = None if back is None else int(frames[back] - frames[end])
        decided = int(judged[end:until, hit].all(axis=1).sum()) >= HELD and not bool(helped)
        names = tuple(parts[k].part for k in hit.tolist())
        yield Occlusion(parts[0].target, names, int(frames[first]), int(frames[end - 1]), after, decided)


def measure_recovery(spans: Sequence[Occlusion]) -> RecoveryMeasures | None:
    """Over occlusions; None if there is none."""
    if not spans:
        return None
    decided = [span for span in spans if span.decided]
    frames = [span.frames_to_return for span in decided if span.frames_to_return is not None]
    return RecoveryMeasures(
        occlusions=len(spans),
        decided=len(decided),
        returned=len(frames),
        recovered=len(frames) / len(decided) if decided else None,
        frames_median=median(np.array(frames)),
        frames_worst=float(max(frames)) if frames else None,
    )
