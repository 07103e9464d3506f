"""The probability that a row is right, from what its recipe knows of it (ours).

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
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeAlias

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.files import read_bounded
from facetrack_cli.core.types import BOX, Array, Mask
from facetrack_cli.engine.smoothing import Belief
from facetrack_cli.recipe.model import LIKELY
from facetrack_cli.trajectory.trajectory import SPREAD, Trajectory

FORMAT: Final = "facetrack-calibration"
MAX_SPREAD_FACTOR: Final = 20.0
"""What a spread is multiplied by at most; divided by no more."""
Feature: TypeAlias = Literal["confidence", "log_odds", "spread", "ess", "lost", "size"]
RISES: Final[Mapping[Feature, int]] = {
    "confidence": 1, "log_odds": 1, "spread": -1, "ess": 0, "lost": -1, "size": 1,
}  # fmt: skip
"""Whether p rises with a feature or falls; 0: either."""
PartKind: TypeAlias = Literal["points", "box"]
_Share: TypeAlias = Annotated[float, Field(ge=0, le=1)]


class _StoredPart(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, defer_build=True)


class Logistic(_StoredPart):
    """p = 1 / (1 + exp(-(intercept + sum of coefficient * feature))), within `least` and 1 - `least`."""

    method: Literal["logistic"] = "logistic"
    intercept: float
    coefficients: dict[Feature, float]
    least: Annotated[float, Field(ge=0, le=0.5)]

    def __call__(self, values: Mapping[Feature, Array]) -> Array:
        """p (R,) of rows whose features have these values (R,); nan where a value is nan."""
        logit = sum((slope * values[name] for name, slope in self.coefficients.items()), self.intercept)
        p = 1 / (1 + np.exp(-np.minimum(np.maximum(logit, -700), 700)))
        p = np.minimum(np.maximum(p, self.least), 1 - self.least)
        return np.asarray(p + np.zeros_like(values["confidence"]))


class Isotonic(_StoredPart):
    """p is linear between `knots`, pairs of a value of the score and p, and level beyond them.

    The score is a feature, or the probability of a logistic regression on several.
    """

    method: Literal["isotonic"] = "isotonic"
    score: Feature | Logistic
    knots: Annotated[list[Annotated[list[float], Field(min_length=2, max_length=2)]], Field(min_length=1)]

    @field_validator("knots")
    @classmethod
    def _ordered(cls, knots: list[list[float]], info: Any) -> list[list[float]]:
        x, p = np.array(knots).T
        score = info.data.get("score")
        falls = isinstance(score, str) and RISES[score] < 0  # type: ignore[index]
        if np.any(np.diff(x) <= 0) or np.any(np.diff(p) * (-1 if falls else 1) < 0) or p.min() < 0 or p.max() > 1:
            raise ValueError(
                f"values must rise from knot to knot, and p, within 0 and 1, {'fall' if falls else 'rise'}"
            )
        return knots

    @cached_property
    def _table(self) -> tuple[Array, Array]:
        x, p = np.array(self.knots).T
        return x, p

    def __call__(self, values: Mapping[Feature, Array]) -> Array:
        """As of `Logistic`."""
        score = self.score(values) if isinstance(self.score, Logistic) else values[self.score]
        return np.interp(score, *self._table)


Map: TypeAlias = Annotated[Logistic | Isotonic, Field(discriminator="method")]


class CrossChecked(_StoredPart):
    """On each clip the map of the others: the calibration error and Brier score, and those of raw confidence.

    `within_..`: share of the right and visible rows in the ellipses that should hold 50 and 90 % of them.
    """

    rows: Annotated[int, Field(ge=0)]
    right: _Share
    ece: _Share
    brier: _Share
    ece_raw: _Share
    brier_raw: _Share
    within_50: _Share
    within_90: _Share
    within_90_raw: _Share


class Calibration(_StoredPart):
    """A map for each kind of part, and what it was fitted to: a recipe's runs, `seeds` of each clip.

    `lost`: the share of the rows of lost boxes that are right; p of such a row, and of its points, is no greater.
    `spread`: by what the standard deviations are multiplied, so that of the rows that are right and visible 90 % are in
    the ellipse that should hold so many.
    """

    format: Literal["facetrack-calibration"] = FORMAT
    version: Literal[1] = 1
    recipe: str
    right: Literal["error of the centre below 1/4 of the size"] = "error of the centre below 1/4 of the size"
    maps: dict[PartKind, Map]
    lost: Annotated[float, Field(ge=0, lt=LIKELY)]
    spread: dict[PartKind, Annotated[float, Field(gt=0, le=MAX_SPREAD_FACTOR)]]
    checked: dict[PartKind, CrossChecked]
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
        lost = rows.status == "lost"
        boxes, p, factor = boxes_of(rows), np.full(len(rows), np.nan), np.ones(len(rows))
        values = features(rows, boxes, size)
        for kind, fitted in self.maps.items():
            chosen = boxes if kind == "box" else ~boxes
            if chosen.any():
                p, factor = np.where(chosen, fitted(values), p), np.where(chosen, self.spread[kind], factor)
        if (lost & boxes).any():
            p = np.where(lost, np.minimum(p, self.lost), p)
        factor = np.where(np.isnan(rows.ess), 1.0, factor)
        kept = (rows.status == "init") | np.isnan(rows.confidence) | np.isnan(rows.ess)
        spread = {name: getattr(rows, name) * (factor**2 if name == "cov_xy" else factor) for name in SPREAD}
        judged = np.where(p < LIKELY, "lost", np.where(lost, "hidden", rows.status))
        status = np.where(kept | np.isnan(p), rows.status, judged)
        return replace(rows, confidence=np.where(kept, rows.confidence, p), status=status, **spread)

    def to_json(self) -> str:
        return json.dumps(self.model_dump(), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def boxes_of(rows: Trajectory) -> Mask:
    """(R,) which rows are of boxes."""
    return np.array([part == BOX for _, part in rows.names], np.bool_)[rows.which]


def features(rows: Trajectory, boxes: Mask, size: float) -> dict[Feature, Array]:
    """The features (R,) of rows of which these (R,) are `boxes`; `size`, in pixels, is that of the points."""
    c = rows.confidence
    sides = np.where(boxes | (size == 0), np.sqrt(rows.w * rows.h), size)
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = np.log(np.minimum(np.maximum(np.hypot(rows.std_x, rows.std_y) / sides, 1e-3), 10))
        ess = np.log10(np.minimum(np.maximum(rows.ess / rows.particles, 1e-3), 1))
    odds = np.log((c + 0.01) / (1.01 - c))
    # what is small in the picture is placed less exactly, in terms of its size
    logs = np.log(np.clip(sides, 3.0, 1000.0)) + 0.0 * c
    lost = (rows.status == "lost") * 1.0
    return {"confidence": c, "log_odds": odds, "spread": spread, "ess": ess, "lost": lost, "size": logs}


def load_calibration(path: Path) -> Calibration:
    """The calibration in a file. Raises InputError for anything else."""
    remedy = "make it with tools/calibrations.py, or take confidence.calibration=null"
    try:
        stored = json.loads(read_bounded(path, what="calibration"))
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e.strerror}; check the file's permissions") from None
    except (ValueError, RecursionError):
        raise InputError(f"{path}: is no calibration, which is JSON; {remedy}") from None
    if not isinstance(stored, dict) or stored.get("format") != FORMAT:
        raise InputError(f'{path}: is no calibration: its "format" is not {FORMAT}; {remedy}')
    if stored.get("version") != 1:
        raise InputError(f"{path}: is of another version than 1, the only one that is known; {remedy}")
    try:
        return Calibration.model_validate(stored)
    except ValidationError as e:
        first = e.errors()[0]
        place = ".".join(str(key) for key in first["loc"] if not str(key).startswith("literal["))
        message = first["msg"].removeprefix("Value error, ")
        raise InputError(f"{path}: {place}: {message[:1].lower()}{message[1:]}; {remedy}") from None
