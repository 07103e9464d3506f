"""Runs of a recipe on clips with ground truth, and the calibration of its confidence that follows from them.

    found = run(recipe, [(clip, truth), ...], seeds=2)
    found.calibration.to_json()

Of each clip at most `MAX_ROWS` rows of a kind are taken, evenly spaced: a long one is no better than a short one.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.geometry import size_of_points
from facetrack_cli.core.types import BOX, Mask
from facetrack_cli.evaluation.experiments.calibration_fit import Fitted, Sample, bins_of, fit, joined
from facetrack_cli.evaluation.match import match
from facetrack_cli.evaluation.reliability import ReliabilityBin, mahalanobis_squared, reliability_bins
from facetrack_cli.evaluation.rows import Pair, rows_of
from facetrack_cli.evaluation.sheet import NO_FIGURE, Sheet, clip_name
from facetrack_cli.evaluation.summary import units_of
from facetrack_cli.recipe.model import ParticleFilter, ParticlesRecipe, Recipe
from facetrack_cli.runs.seeds import Plan, Report, run_plans
from facetrack_cli.runs.signals import Stop
from facetrack_cli.runs.start import Begin
from facetrack_cli.tracking.calibration import Calibration, PartKind, boxes_of, features
from facetrack_cli.trajectory.trajectory import Trajectory

MAX_ROWS: Final = 500  # of a kind of part in a clip
KINDS: Final[tuple[PartKind, ...]] = ("points", "box")


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

    def sheets(self) -> list[Sheet]:
        """A reliability table for each kind."""
        about = f"{self.recipe}, {self.seeds} run{'s' * (self.seeds > 1)} of {len(self.clips)} clips"
        return [_sheet(f"{about}: {kind}", one) for kind, one in self.fitted.items()]

    def bins(self) -> tuple[ReliabilityBin, ...]:
        """The calibrated rows of the clips left out, of all kinds together."""
        p = np.concatenate([one.left_out for one in self.fitted.values()])
        every = joined([one.sample for one in self.fitted.values()])
        return reliability_bins(p, every.right, every.visible)


def _sheet(title: str, one: Fitted) -> Sheet:
    raw, found = one.raw, one.found
    binned = [bins_of(one.sample, p) for p in (one.sample.known["confidence"], one.left_out)]
    rows = []
    for both in zip(*binned, strict=True):
        cells = [f"{both[0].low:.1f}-{both[0].high:.1f}"]
        for of, own in zip(binned, both, strict=True):
            shares = own.rows / sum(each.rows for each in of), own.mean_confidence, own.right
            cells += [NO_FIGURE if v is None or not own.rows else f"{100 * v:.1f}" for v in shares]
        rows.append(tuple(cells))
    heads = [f"{when}\n{what}, %" for when in ("raw", "calibrated") for what in ("rows", "mean", "right")]
    losses = ", ".join(f"{name} {loss:.3f}" for name, loss in one.losses.items())
    notes = (
        f"Clips left out: calibration error {raw.ece:.3f} raw, {found.ece:.3f} calibrated; Brier score "
        f"{raw.brier:.3f} raw, {found.brier:.3f} calibrated.",
        f"Of the right and visible rows of clips left out, {100 * one.checked.within_90:.0f} % are in the ellipse of "
        f"90 %, with the spread as it is {100 * one.checked.within_90_raw:.0f} %.",
        f"The map is {one.name}. Log loss on clips left out: {losses}.",
    )
    return Sheet(title, ("confidence", *heads), tuple(rows), notes)


def run(
    recipe: Recipe,
    clips: Sequence[tuple[Path, Trajectory]],
    seeds: int,
    last: int | None = None,
    workers: int = 1,
    stopped: Stop | None = None,
    report: Report = lambda done, total: None,
) -> Calibrated | None:
    """Run a recipe on clips with their ground truth, up to the frame before `last`; None once `stopped` says so.

    Raises UsageError for a recipe without confidence, and what keeps a clip from running.
    """
    stopped, recipe = stopped or Stop(), uncalibrated(recipe)
    numbers = tuple(range(seeds if recipe.random else 1))
    plans, runs, truths = [], {}, dict(clips)
    for clip in sorted(truths, key=clip_name):  # their order must not show in the last digit
        start = Begin(clip, stop=last).find(recipe, truths[clip], stopped)
        plans.append(Plan(recipe.name, clip, recipe, start, numbers, last))
    for ended in run_plans(plans, workers, stopped, report):
        if ended.error is not None:
            raise ended.error
        runs[ended.plan.clip] = [one.trajectory for one in ended.runs], truths[ended.plan.clip]
    return of_runs(recipe.name, runs, len(numbers)) if len(runs) == len(plans) else None


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

    def raw(one: ParticleFilter) -> ParticleFilter:
        return one.model_copy(update={"confidence": one.confidence.model_copy(update={"calibration": None})})

    if isinstance(recipe, ParticlesRecipe):
        targets = {name: None if one is None else raw(one) for name, one in recipe.targets.items()}
        return recipe.model_copy(update={"targets": targets})
    return raw(recipe) if isinstance(recipe, ParticleFilter) else recipe  # type: ignore[return-value]


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
    units = units_of(pairs, "size", truth.parts)
    for pair in pairs:
        ours = pair.ours
        points = [one for one in run.of_target(ours.target) if one.part != BOX and len(one)]
        size = size_of_points(np.array([(one.x[0], one.y[0]) for one in points])) if points else 0.0
        one, mine = rows_of(pair, units[ours.target].at(ours.frame)), boxes_of(ours)
        known = features(ours, mine, size)
        kept = one.judged & ~one.init & np.all([np.isfinite(values) for values in known.values()], axis=0)
        far = mahalanobis_squared(one.offset, one.std, one.cov_xy)
        samples.append(Sample(known, one.right, one.visible, np.full(len(ours), clip), far).take(kept))
        boxes.append(mine[kept])
    return joined(samples), np.concatenate(boxes)
