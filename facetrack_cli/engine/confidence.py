"""How far an estimate can be trusted, from the frame alone; and the probability that its row is right (ours).

A row is right if the error of its centre is less than a quarter of the size. `tools/calibrations.py` fits a map from
the features below to that probability, one for points and one for boxes, and a recipe names its file:

    confidence   as the recipe says it without a calibration
    log_odds     log (c + 0.01) / (1.01 - c) of that confidence c
    spread       log sqrt(std_x^2 + std_y^2) / size, within 0.001 and 10
    ess          log10 ess / particles, no less than -3
    lost         1 where the status is lost, else 0

The size is sqrt(w * h) of a box, or of a single point's window; of points the largest distance between two of them at
the start. The maps are logistic regression (Platt, 1999, on several features) and isotonic regression (Zadrozny &
Elkan, KDD 2002), between whose knots p is linear, of a feature or of such a logistic regression. None falls where
confidence rises, nor rises where spread does.

Without a calibration the window at the estimate is compared with the template, and the distance d is placed between
two levels of this clip:

    good_i    the running mean of d at the estimate over `memory` frames in which the part was not in doubt. It begins
              as the median of d over a ring of windows in the first frame that are off by 1/13 of the window's size
    bad_i     the quantile `beside` of d over a ring of windows off by the whole window's size in the first frame, or d
              of a blank window if that is less. A lower quantile is stricter
    confidence = clip((bad - d) / (bad - good), 0, 1), and 0 for a part that looks like all that is around it

A part is `lost` once its confidence has stayed under `lost_below` for `patience` frames, `tracked` once it is not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal, NamedTuple, TypeAlias, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from facetrack_cli.core.errors import InputError, reading
from facetrack_cli.core.files import read_bounded
from facetrack_cli.core.types import BOX, Array, Frame, Mask, Whole
from facetrack_cli.engine.kernels.compiled import AS_IT_IS, HIDDEN, INIT, LOST, calibrate
from facetrack_cli.recipe.model import LIKELY, ConfidenceSettings
from facetrack_cli.trajectory.trajectory import SPREAD, Status, Trajectory

if TYPE_CHECKING:
    from facetrack_cli.engine.protocols import Belief

Feature: TypeAlias = Literal["confidence", "log_odds", "spread", "ess", "lost", "size"]
PartKind: TypeAlias = Literal["points", "box"]
Metric: TypeAlias = Callable[[Frame, Array], Array]  # `distances` of a likelihood and what it has learned


class _StoredPart(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, defer_build=True)


class Logistic(_StoredPart):
    """p = 1 / (1 + exp(-(intercept + sum of coefficient * feature))), within `least` and 1 - `least`."""

    method: Literal["logistic"] = "logistic"
    intercept: float
    coefficients: dict[Feature, float]
    least: Annotated[float, Field(ge=0, le=0.5)]


class Isotonic(_StoredPart):
    """p is linear between `knots`, pairs of a value of the score and p, and level beyond them.

    The score is a feature, or the probability of a logistic regression on several.
    """

    method: Literal["isotonic"] = "isotonic"
    score: Feature | Logistic
    knots: Annotated[list[Annotated[list[float], Field(min_length=2, max_length=2)]], Field(min_length=1)]


Map: TypeAlias = Annotated[Logistic | Isotonic, Field(discriminator="method")]


class Calibration(_StoredPart):
    """A map for each kind of part, and what it was fitted to: a recipe's runs, `seeds` of each clip.

    `checked`: how right it is on each clip by the map of the others, and how right raw confidence and spread are.
    `lost`: the share of the rows of lost boxes that are right; p of such a row, and of its points, is no greater.
    `spread`: by what the standard deviations are multiplied, so that of the rows that are right and visible 90 % are in
    the ellipse that should hold so many.
    """

    format: Literal["facetrack-calibration"] = "facetrack-calibration"
    version: Literal[1] = 1
    recipe: str
    right: Literal["error of the centre below 1/4 of the size"] = "error of the centre below 1/4 of the size"
    maps: dict[PartKind, Map]
    lost: Annotated[float, Field(ge=0, lt=LIKELY)]
    spread: dict[PartKind, Annotated[float, Field(gt=0, le=20)]]
    checked: dict[PartKind, dict[str, int | float]]
    clips: list[str]
    seeds: int

    def believed(self, parts: Sequence[str], belief: Belief) -> Belief:
        """The filter's belief of these parts, with the spread that their rows have."""
        return belief._replace(cov=belief.cov * self.spread.get("box" if BOX in parts else "points", 1.0) ** 2)

    def applied(self, rows: Trajectory, size: float) -> Trajectory:
        """The rows of a target in a frame, with p as their confidence.

        `size` is the largest distance between points, in pixels. Rows of status init and rows without particles keep
        their confidence; the latter also keep their spread. p is nan where the confidence is nan, or where there is no
        map. A row is lost where p is below 1/2. Other rows that the tracker does not see are hidden: their target is
        seen, or their place is likely right.
        """
        values, status = np.array([getattr(rows, name) for name in CALIBRATED]), rows.status
        how = np.where(status == "lost", LOST, np.where(status == "init", INIT, AS_IT_IS))
        if self.changes(values, how, boxes_of(rows), size):
            status = np.where(how == HIDDEN, "hidden", np.where(how == LOST, "lost", status))
        spread = dict(zip(SPREAD, values[5:], strict=True))
        return replace(rows, confidence=values[0], status=status, **spread)

    def changes(self, values: Array, how: Whole, boxes: Mask, size: float) -> bool:
        """As `applied`, to columns (10, R) in the order of `CALIBRATED`, and to how each row is seen, in place.

        Returns whether any is seen otherwise.
        """
        return bool(calibrate(values, how, boxes, size, *self._tables, self.lost, LIKELY))

    @cached_property
    def _tables(self) -> tuple[Array, Array, Array, Whole, Array]:
        """The maps and spreads of points and of boxes, as the kernel takes them."""
        kinds: list[PartKind] = ["points", "box"]
        maps = [self.maps.get(kind) for kind in kinds]
        scores = [one.score if isinstance(one, Isotonic) else one for one in maps]
        each = [one.coefficients if isinstance(one, Logistic) else {one: 1.0} for one in scores]
        ends = [(one.intercept, one.least) if isinstance(one, Logistic) else (0.0, np.nan) for one in scores]
        steps = [one.knots if isinstance(one, Isotonic) else [] for one in maps]
        knots = np.zeros((2, 2, max(1, *map(len, steps))))
        for table, own in zip(knots, steps, strict=True):
            table[:, : len(own)] = np.array(own).reshape(-1, 2).T
        counts = np.array([-1 if one is None else len(own) for one, own in zip(maps, steps, strict=True)])
        slopes = np.array([[own.get(name, 0.0) for name in get_args(Feature)] for own in each])
        return slopes, np.array(ends), knots, counts, np.array([self.spread.get(kind, 1.0) for kind in kinds])


CALIBRATED: Final = ("confidence", "w", "h", "ess", "particles", *SPREAD)


def boxes_of(rows: Trajectory) -> Mask:
    """(R,) which rows are of boxes."""
    return np.array([part == BOX for _, part in rows.names], np.bool_)[rows.which]


def load_calibration(path: Path) -> Calibration:
    """The calibration in a file. Raises InputError for anything else."""
    remedy = "make it with tools/calibrations.py, or take confidence.calibration=null"
    try:
        with reading(path):
            return Calibration.model_validate_json(read_bounded(path, what="calibration"))
    except ValidationError as e:
        first = e.errors(include_url=False)[0]
        why = ": ".join(filter(None, (".".join(map(str, first["loc"])), first["msg"])))
        raise InputError(f"{path}: is no calibration: {why}; {remedy}") from None


class Judgement(NamedTuple):
    """What is known of each of K parts after a frame. `good`, `bad`, `confidence` (K,); `below`: frames in a row."""

    good: Array
    bad: Array
    confidence: Array
    below: Whole
    status: tuple[Status, ...]


def begin(settings: ConfidenceSettings, metric: Metric, frame: Frame, x0: Array, windows: Array) -> Judgement:
    """The judgement of the first frame, whose parts are at x0 (K, D) and `windows` (K, 2) pixels large."""
    k = len(x0)
    angles = np.arange(16) * (2 * np.pi / 16)
    ring = np.zeros((16, *x0.shape))
    ring[..., :2] = np.stack([np.cos(angles), np.sin(angles)], axis=1)[:, None] * windows
    near, far = (np.sort(metric(frame, x0 + places), axis=0) for places in (ring / 13, ring))
    # the median and np.quantile, which import numpy.ma, and that takes a hundredth of a short run
    low, share = divmod(settings.beside * (len(ring) - 1), 1)
    a, b = far[int(low)], far[min(int(low) + 1, len(ring) - 1)]
    near, beside = near[7:9].mean(axis=0), b - (b - a) * (1 - share) if share >= 0.5 else a + (b - a) * share
    blank = Frame(frame.index, frame.time_s, np.full_like(frame.bgr, 128))
    bad = np.minimum(beside, metric(blank, x0[None])[0])
    return Judgement(near, bad, np.ones(k), np.zeros(k, np.int64), tuple(["init"] * k))


def judge(settings: ConfidenceSettings, last: Judgement, distance: Array) -> Judgement:
    """The judgement of the next frame, whose windows at the estimates have `distance` (K,) from the templates."""
    good, span = last.good, last.bad - last.good
    share = np.minimum(np.maximum((last.bad - distance) / np.maximum(span, 1e-6), 0.0), 1.0)
    confidence = np.where(span > 1e-6, share, 0.0)
    if settings.memory is not None:
        good = np.where(confidence < settings.lost_below, good, good + (distance - good) / settings.memory)
    return decide(settings, last._replace(good=good), confidence)


def decide(settings: ConfidenceSettings, last: Judgement, confidence: Array) -> Judgement:
    """The judgement of the next frame, with this confidence (K,)."""
    below = np.where(confidence < settings.lost_below, last.below + 1, 0)
    status: tuple[Status, ...] = tuple(["lost" if n >= settings.patience else "tracked" for n in below.tolist()])
    return Judgement(last.good, last.bad, confidence, below, status)


def resume(
    settings: ConfidenceSettings, first: Judgement, fresh: Mask, metric: Metric, frame: Frame, x0: Array, windows: Array
) -> Judgement:
    """The judgement where a target begins again at x0 (K, D), with `windows` (K, 2).

    Parts that are `fresh` (K,) are judged from here on, others by the `first` frame; one in doubt is `lost` at once.
    """
    impatient = np.full(len(first.below), settings.patience - 1, np.int64)
    kept = judge(settings, first._replace(below=impatient), metric(frame, x0[None])[0])
    new = begin(settings, metric, frame, x0, windows)
    mixed = [np.where(fresh, now, before) for now, before in zip(new[:-1], kept[:-1], strict=True)]
    return Judgement._make([*mixed, tuple(np.where(fresh, new.status, kept.status).tolist())])
