"""The map from what is known of a row to the probability that it is right, fitted to rows with ground truth.

R rows of C clips. Every clip weighs the same, however many rows it has: their weights add up to 1. Rows of one clip are
much alike, so a clip counts as `ALIKE` independent rows. With n of those in all, a row is taken as right with
probability (n y + 1) / (n + 2), where y is 1 if it is and else 0 (Platt, 1999): few clips do not give 0 or 1.

The map is the candidate of the least log loss in cross-validation, each clip by the map that was fitted to the others.
Of each clip at most `MAX_ROWS` rows of a kind are taken, evenly spaced: a long one is no better than a short one.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.geometry import size_of_points
from facetrack_cli.core.types import BOX, Array, Mask, Whole
from facetrack_cli.engine.confidence import (
    Calibration,
    Feature,
    Isotonic,
    Logistic,
    Map,
    PartKind,
    boxes_of,
)
from facetrack_cli.evaluation.accuracy import (
    ELLIPSE_50,
    ELLIPSE_90,
    calibration_error,
    mahalanobis_squared,
)
from facetrack_cli.evaluation.rows import Pair, match, normalised_rows
from facetrack_cli.evaluation.summary import clip_name
from facetrack_cli.recipe.model import LIKELY, ParticleFilterSettings, ParticlesRecipe, Recipe
from facetrack_cli.trajectory.trajectory import Trajectory

MAX_ROWS: Final = 500  # of a kind of part in a clip
MAX_SPREAD_FACTOR: Final = 20.0
"""What a spread is multiplied by at most; divided by no more."""
RISES: Final[Mapping[Feature, int]] = {
    "confidence": 1, "log_odds": 1, "spread": -1, "ess": 0, "lost": -1, "size": 1,
}  # fmt: skip
"""Whether p rises with a feature or falls; 0: either."""
KINDS: Final[tuple[PartKind, ...]] = ("points", "box")
ALIKE: Final = 20
LEVELS: Final = 20  # quantiles of a score that isotonic regression tells apart
RIDGE: Final = 1.0  # precision of the coefficients of standardised features; an independent row adds at most 1/4
NOTHING: Final = 1e-6  # a coefficient that is the rounding of the processor
STEPS: Final = 50  # of Newton's method, at most
Fit: TypeAlias = Callable[["Sample"], Map]


@dataclass(frozen=True, eq=False)
class Sample:
    """Rows of one kind of part: features (R,), whether they are right and visible (R,), numbers of their clips (R,).

    `far` (R,): squared Mahalanobis distance of the true centre, by the row's own spread.
    """

    known: Mapping[Feature, Array]
    right: Mask
    visible: Mask
    clip: Whole
    far: Array

    def __len__(self) -> int:
        return len(self.right)

    @property
    def clips(self) -> list[int]:
        return [int(number) for number in np.unique(self.clip)]

    @property
    def weight(self) -> Array:
        """(R,) the weights of the rows; the weights of a clip add up to 1."""
        return np.asarray(1 / np.bincount(self.clip)[self.clip])

    @property
    def smoothed(self) -> Array:
        """(R,) the probability with which each row is taken as right."""
        return np.asarray(np.where(self.right, 1 - self.least, self.least))

    @property
    def least(self) -> float:
        """Nothing is less probable than this, nor more probable than 1 less this."""
        return 1 / (ALIKE * len(self.clips) + 2)

    def take(self, rows: Mask | Whole) -> "Sample":
        known = {name: values[rows] for name, values in self.known.items()}
        return Sample(known, self.right[rows], self.visible[rows], self.clip[rows], self.far[rows])

    @property
    def lost(self) -> float:
        """The share of the lost rows that are right, as of rows with that probability; below `LIKELY`."""
        rows = self.known["lost"] > 0
        n = ALIKE * self.weight[rows].sum()
        right = float(self.weight[rows] @ self.right[rows]) * ALIKE
        return _short(min((right + 1) / (n + 2), LIKELY - 0.01))

    @property
    def spread(self) -> float:
        """The factor for the standard deviations; 1 if no row is right and visible."""
        kept = self.right & self.visible
        far, weight = self.far[kept], self.weight[kept]
        if not len(far):
            return 1.0
        order = np.argsort(far)
        reached = np.cumsum(weight[order]) / weight.sum()
        at = far[order][min(int(np.searchsorted(reached, 0.9)), len(far) - 1)]
        return _short(float(np.clip(np.sqrt(at / ELLIPSE_90), 1 / MAX_SPREAD_FACTOR, MAX_SPREAD_FACTOR)))

    def within(self, ellipse: float, by: Array | float = 1.0) -> float:
        """Share of the right and visible rows within an ellipse, whose axes are multiplied by `by` (R,)."""
        kept = self.right & self.visible
        inside = self.far <= ellipse * np.square(by)
        return float(np.average(inside[kept], weights=self.weight[kept])) if kept.any() else 0.0


def joined(samples: Sequence[Sample]) -> Sample:
    names: list[Feature] = list(RISES)
    known = {name: np.concatenate([one.known[name] for one in samples]) for name in names}
    others = [np.concatenate([getattr(s, name) for s in samples]) for name in ("right", "visible", "clip", "far")]
    return Sample(known, *others)


class Figures(NamedTuple):
    """Expected calibration error, Brier score and mean log loss of probabilities, all clips alike."""

    ece: float
    brier: float
    log_loss: float


@dataclass(frozen=True, eq=False)
class Fitted:
    """A map, the name of its candidate, and what it was fitted to. `left_out` (R,): of each clip by the others' map."""

    map: Map
    name: str
    sample: Sample
    left_out: Array
    losses: Mapping[str, float]

    @property
    def raw(self) -> Figures:
        return figures(self.sample, self.sample.known["confidence"])

    @property
    def found(self) -> Figures:
        return figures(self.sample, self.left_out)

    @property
    def checked(self) -> dict[str, int | float]:
        """Calibration error and Brier score on each clip by the map of the others, and those of raw confidence.

        `within_..`: share of the right and visible rows in the ellipses that should hold 50 and 90 % of them.
        """
        raw, found, right = self.raw, self.found, np.average(self.sample.right, weights=self.sample.weight)
        values = {"right": right, "ece": found.ece, "brier": found.brier, "ece_raw": raw.ece, "brier_raw": raw.brier}
        one, by = self.sample, np.ones(len(self.sample))
        for clip in one.clips if len(one.clips) > 1 else ():
            by[one.clip == clip] = one.take(one.clip != clip).spread
        values |= {"within_50": one.within(ELLIPSE_50, by), "within_90": one.within(ELLIPSE_90, by)}
        values |= {"within_90_raw": one.within(ELLIPSE_90)}
        return {"rows": len(self.sample), **{name: round(float(value), 4) for name, value in values.items()}}


def pool(y: Array, weight: Array) -> Array:
    """The non-decreasing (n,) nearest to y (n,), in weighted squares: pool adjacent violators (Ayer et al., 1955)."""
    means: list[float] = []
    weights: list[float] = []
    counts: list[int] = []
    for value, w in zip(y.tolist(), weight.tolist(), strict=True):
        means.append(value)
        weights.append(w)
        counts.append(1)
        while len(means) > 1 and means[-2] >= means[-1]:
            w = weights[-2] + weights[-1]
            means[-2:] = [(means[-2] * weights[-2] + means[-1] * weights[-1]) / w]
            weights[-2:] = [w]
            counts[-2:] = [counts[-2] + counts[-1]]
    return np.repeat(means, counts)


def features(columns: Mapping[str, Any], boxes: Mask, size: float) -> dict[Feature, Array]:
    """The features (R,) of rows of which these (R,) are `boxes`; `size`, in pixels, is that of the points."""
    c = columns["confidence"]
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = np.where(boxes | (size == 0), np.sqrt(columns["w"] * columns["h"]), size)
        return {
            "confidence": c,
            "log_odds": np.log((c + 0.01) / (1.01 - c)),
            "spread": np.log(np.clip(np.hypot(columns["std_x"], columns["std_y"]) / sides, 1e-3, 10.0)),
            "ess": np.log10(np.clip(columns["ess"] / columns["particles"], 1e-3, 1.0)),
            "lost": (columns["status"] == "lost").astype(float),
            # what is small in the picture is placed less exactly, in terms of its size
            "size": np.log(np.clip(sides, 3.0, 1000.0)),
        }


def probability(fitted: Map, values: Mapping[Feature, Array]) -> Array:
    """p (R,) of rows whose features have these values (R,), by a map; nan where a value is nan."""
    if isinstance(fitted, Isotonic):
        x, p = np.array(fitted.knots).T
        score = fitted.score
        known = probability(score, values) if isinstance(score, Logistic) else values[score]
        return np.asarray(np.interp(known, x, p))
    logit = sum((slope * values[name] for name, slope in fitted.coefficients.items()), 0.0 * values["confidence"])
    p = 1 / (1 + np.exp(-np.clip(logit + fitted.intercept, -700, 700)))
    return np.asarray(np.clip(p, fitted.least, 1 - fitted.least))


def fit_isotonic(score: Feature | tuple[Feature, ...], sample: Sample) -> Isotonic:
    """Isotonic regression of what is right on a feature, or on the logistic regression of several.

    Its knots are at the means of at most `LEVELS` quantiles.
    """
    of = fit_logistic(score, sample) if isinstance(score, tuple) else score
    x, weight = probability(of, sample.known) if isinstance(of, Logistic) else sample.known[of], sample.weight
    order = np.argsort(x, kind="stable")
    at = np.empty(len(x))
    at[order] = np.cumsum(weight[order])
    # a value has one level: that of its last row
    values, which = np.unique(x, return_inverse=True)
    last = np.zeros(len(values))
    np.maximum.at(last, which, at)
    level = np.ceil(LEVELS * last / at.max() - 1e-9).astype(np.int64)[which]
    _, level = np.unique(level, return_inverse=True)
    total: Array = np.bincount(level, weight).astype(np.float64)
    means, y = (np.bincount(level, weight * values) / total for values in (x, sample.smoothed))
    sign = -1 if not isinstance(of, Logistic) and RISES[of] < 0 else 1
    p = sign * pool(sign * y, total)
    # of those that six digits cannot tell apart the last
    last_of = {_short(at): _short(level) for at, level in zip(means.tolist(), p.tolist(), strict=True)}
    knots = [list(pair) for pair in last_of.items()]
    # of a level stretch the two ends say all
    inner = [1 <= i < len(knots) - 1 and knots[i - 1][1] == knot[1] == knots[i + 1][1] for i, knot in enumerate(knots)]
    return Isotonic(score=of, knots=[knot for knot, flat in zip(knots, inner, strict=True) if not flat])


def fit_logistic(names: Sequence[Feature], sample: Sample) -> Logistic:
    """Logistic regression with a ridge on these features. A feature of the wrong sign or without effect is left out."""
    names, weight = list(names), ALIKE * sample.weight
    while True:
        x = np.array([sample.known[name] for name in names]).reshape(len(names), len(sample)).T
        middle = np.average(x, axis=0, weights=weight)
        scale = np.sqrt(np.average((x - middle) ** 2, axis=0, weights=weight))
        scale = np.where(scale > 1e-9, scale, np.inf)  # what never differs has no coefficient
        beta = newton(np.column_stack([np.ones(len(x)), (x - middle) / scale]), sample.smoothed, weight)
        slopes = beta[1:] / scale
        wrong = [name for name, own in zip(names, beta[1:], strict=True) if abs(own) < NOTHING or RISES[name] * own < 0]
        if not wrong:
            break
        names.remove(min(wrong, key=lambda name: RISES[name] * beta[1 + names.index(name)]))
    coefficients = {name: _short(slope) for name, slope in zip(names, slopes.tolist(), strict=True)}
    return Logistic(
        intercept=_short(float(beta[0] - slopes @ middle)), coefficients=coefficients, least=_short(sample.least)
    )


def newton(x: Array, y: Array, weight: Array) -> Array:
    """(D,): maximises sum weight (y log p + (1 - y) log (1 - p)) - `RIDGE` / 2 |beta[1:]|^2, p = logistic(x beta).

    x (R, D) begins with a column of ones, y (R,) is within 0 and 1.
    """
    penalty = RIDGE * np.diag([0.0] + [1.0] * (x.shape[1] - 1))
    beta, value = np.zeros(x.shape[1]), -np.inf
    for _ in range(STEPS):
        p = 1 / (1 + np.exp(-x @ beta))
        slope = x.T @ (weight * (y - p)) - penalty @ beta
        step = np.linalg.solve((x.T * (weight * p * (1 - p))) @ x + penalty + 1e-12 * np.eye(len(beta)), slope)
        value = _objective(x, y, weight, penalty, beta)
        while _objective(x, y, weight, penalty, beta + step) < value and np.abs(step).max() > 1e-12:
            step /= 2
        beta = beta + step
        if np.abs(step).max() < 1e-10:
            break
    return beta


def _objective(x: Array, y: Array, weight: Array, penalty: Array, beta: Array) -> float:
    z = x @ beta
    return float(np.sum(weight * (y * z - np.logaddexp(0, z))) - beta @ penalty @ beta / 2)


def _short(value: float) -> float:
    """To six digits, so that rounding of the processor does not show."""
    return float(f"{value:.6g}")


CANDIDATES: Final[Mapping[str, Fit]] = {
    "isotonic of confidence": partial(fit_isotonic, "confidence"),
    "isotonic of spread": partial(fit_isotonic, "spread"),
    "logistic of confidence": partial(fit_logistic, ("confidence",)),
    "logistic of confidence, spread": partial(fit_logistic, ("confidence", "spread")),
    "logistic of all": partial(fit_logistic, tuple(RISES)),
    "isotonic of logistic of all": partial(fit_isotonic, tuple(RISES)),
}


def fit(sample: Sample, *, boxes: bool = False) -> Fitted:
    """The best candidate, fitted to all rows; p of lost `boxes` is bounded.

    Raises InputError for a single clip, of which none can be left out.
    """
    if len(sample.clips) < 2:
        raise InputError(
            "a calibration is checked on clips that are left out; give two clips or more with ground truth"
        )
    every = {name: left_out(sample, one, boxes=boxes) for name, one in CANDIDATES.items()}
    losses = {name: figures(sample, p).log_loss for name, p in every.items()}
    best = min(losses, key=lambda name: round(losses[name], 6))  # of equals the first
    return Fitted(CANDIDATES[best](sample), best, sample, every[best], losses)


def left_out(sample: Sample, one: Fit, *, boxes: bool = False) -> Array:
    """(R,) p of each clip, by the map that was fitted to the others."""
    p = np.empty(len(sample))
    for clip in sample.clips:
        mine = sample.clip == clip
        others, known = sample.take(~mine), {name: values[mine] for name, values in sample.known.items()}
        p[mine] = probability(one(others), known)
        if boxes:
            p[mine] = np.where(known["lost"] > 0, np.minimum(p[mine], others.lost), p[mine])
    return p


def figures(sample: Sample, p: Array) -> Figures:
    """Of probabilities p (R,) of a sample, all clips alike."""
    chance = np.clip(np.where(sample.right, p, 1 - p), 1e-6, 1)
    each = (p - sample.right) ** 2, -np.log(chance)
    brier, loss = (float(np.average(values, weights=sample.weight)) for values in each)
    return Figures(calibration_error(p, sample.right, sample.weight), brier, loss)


@dataclass(frozen=True, eq=False)
class Calibrated:
    """What was fitted to a recipe's runs, `seeds` of each clip, by kind of part."""

    recipe: str
    clips: tuple[str, ...]
    seeds: int
    fitted: Mapping[PartKind, Fitted]

    @property
    def calibration(self) -> Calibration:
        """What is stored; the order of the clips says nothing."""
        maps = {kind: one.map for kind, one in self.fitted.items()}
        checked = {kind: one.checked for kind, one in self.fitted.items()}
        spread = {kind: one.sample.spread for kind, one in self.fitted.items()}
        clips = sorted(self.clips)
        lost = self.fitted["box"].sample.lost if "box" in self.fitted else 0.0
        return Calibration(
            recipe=self.recipe, maps=maps, lost=lost, spread=spread, checked=checked, clips=clips, seeds=self.seeds
        )


def of_runs(
    recipe: str,
    runs: Mapping[Path, tuple[Sequence[Trajectory], Trajectory]],
    seeds: int,
    kind_of: Callable[[Path], str] = str,
) -> Calibrated:
    """The calibration that follows from runs of a recipe without one: of each clip `seeds` runs, and its ground truth.

    Clips of one kind count as one clip. Raises InputError as `collect` does.
    """
    kinds = list(dict.fromkeys(map(kind_of, runs)))
    samples = collect(list(runs.values()), [kinds.index(kind_of(clip)) for clip in runs])
    # a kind of a single clip has no map, unless it is the only one: then that is the error
    several = {kind: one for kind, one in samples.items() if len(one.clips) > 1} or samples
    return Calibrated(
        recipe, tuple(map(clip_name, runs)), seeds, {kind: fit(one, boxes=kind == BOX) for kind, one in several.items()}
    )


def uncalibrated(recipe: Recipe) -> Recipe:
    """The recipe with the confidence that it computes itself. Raises UsageError for a recipe that computes none."""
    if not recipe.judges or not recipe.filters:
        raise UsageError(f"{recipe.name} gives no confidence to calibrate; take a recipe that does")

    def raw(one: ParticleFilterSettings) -> ParticleFilterSettings:
        return one.model_copy(update={"confidence": one.confidence.model_copy(update={"calibration": None})})

    if isinstance(recipe, ParticlesRecipe):
        targets = {name: None if one is None else raw(one) for name, one in recipe.targets.items()}
        return recipe.model_copy(update={"targets": targets})
    return raw(recipe) if isinstance(recipe, ParticleFilterSettings) else recipe  # type: ignore[return-value]


def collect(
    clips: Sequence[tuple[Sequence[Trajectory], Trajectory]], numbers: Sequence[int] = ()
) -> dict[PartKind, Sample]:
    """The rows of each kind of part: of each clip the runs, one a seed, and the ground truth.

    Clips with the same of `numbers`, by default each has its own, count as one clip. Raises InputError as `match`
    does, and where no row has confidence and known ground truth.
    """
    found: dict[PartKind, Sample] = {}
    numbered = zip(numbers or range(len(clips)), clips, strict=True)
    every = [[_rows(run, truth, number) for run in runs] for number, (runs, truth) in numbered]
    for kind in KINDS:
        thinned = []
        for runs in every:
            whole = joined([one.take(boxes == (kind == BOX)) for one, boxes in runs])
            thinned.append(
                whole.take(np.unique(np.linspace(0, len(whole) - 1, min(len(whole), MAX_ROWS)).astype(np.int64)))
            )
        if len(sample := joined(thinned)):
            found[kind] = sample
    if not found:
        raise InputError("no row has both a confidence and known ground truth; give clips with the truth of its parts")
    return found


def _rows(run: Trajectory, truth: Trajectory, clip: int) -> tuple[Sample, Mask]:
    """The rows of a run whose truth is known, and whether each is of a box."""
    pairs, samples, boxes = [], [], []
    alone = [one.name for one in run.parts if one.part == BOX]
    # boxes without names are those of the only box, though points have windows
    select = alone[0] if truth.targets == ("",) and len(alone) == 1 else None
    for ours, true in match(run, truth, partial=True, select=select):
        stated = true.status != "lost"  # as a trajectory has it that serves as ground truth
        pairs.append(Pair(ours.take(stated), true.take(stated)))
    rows, _ = normalised_rows(pairs, "size", truth.parts)
    for pair, one in zip(pairs, rows, strict=True):
        ours = pair.ours
        points = [one for one in run.of_target(ours.target) if one.part != BOX and len(one)]
        size = size_of_points(np.array([(one.x[0], one.y[0]) for one in points])) if points else 0.0
        mine = boxes_of(ours)
        known = features(vars(ours), mine, size)
        kept = one.judged & ~one.init & np.all([np.isfinite(values) for values in known.values()], axis=0)
        far = mahalanobis_squared(one.offset, one.std, one.cov_xy)
        samples.append(Sample(known, one.right, one.visible, np.full(len(ours), clip), far).take(kept))
        boxes.append(mine[kept])
    return joined(samples), np.concatenate(boxes)
