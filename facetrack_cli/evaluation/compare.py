"""Recipes side by side on one clip with ground truth: what each run scores, and in which order the recipes stand.

    score = score_run(run, truth, options)
    places = rank(entries, "points.mean_normalised")

*Spread* is the standard deviation over seeds, with n - 1 below the sum. *Order*: by the mean over seeds of one measure.
A recipe stands clearly above another where the intervals mean +- 2 standard errors do not overlap; its place is the
range from 1 + the number of recipes clearly above it to the number of all less those clearly below it. A deterministic
tracker runs once and its interval is its value; of a single seed of any other nothing is known but the value.
*Failure*: points, a part is lost for good (`accuracy.py`); boxes, the last tenth of true boxes has a median IoU below
0.1.
"""

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from facetrack_cli.core.errors import FacetrackError, InputError, UsageError
from facetrack_cli.core.numbers import csv_text, document
from facetrack_cli.core.types import Array, Whole
from facetrack_cli.evaluation.accuracy import share_up_to
from facetrack_cli.evaluation.rows import PERCENT, column, match
from facetrack_cli.evaluation.summary import MEASURES, NO_FIGURE, Sheet, clip_name, evaluate, scalars
from facetrack_cli.recipe.model import Recipe, to_dict
from facetrack_cli.runs.plan import ClipRequest
from facetrack_cli.runs.progress import Progress
from facetrack_cli.runs.seeds import SeedPlan, SeedRun, run_plans
from facetrack_cli.runs.signals import Stop
from facetrack_cli.trajectory.reader import MAX_FRAME, frame_size_of
from facetrack_cli.trajectory.trajectory import Trajectory, joined

TAIL: Final = 0.1  # of the rows with a true box: those that tell whether the target is lost at the end
TAIL_IOU: Final = 0.1
ERRORS: Final = 2.0  # standard errors to either side
CUMULATIVE_AT: Final = np.linspace(0, 0.25, 101)  # error in units of the normalising length
USUAL: Final = {  # the measures in the table
    "boxes": ("boxes.success_auc", "boxes.precision_20", "boxes.good_rate"),
    "points": ("points.mean_normalised", "points.mean_px", "points.median_px"),
}
TRUTH_NAMES: Final = ("groundtruth.csv", "groundtruth_rect.txt", "groundtruth.txt")


@dataclass(frozen=True, eq=False)
class Score:
    """The measures of a run; the curves (n,) are shares of rows at the thresholds above."""

    seed: int
    figures: Mapping[str, float]
    failed: bool
    frames_per_s: float  # of the tracker alone, decoding apart
    frame: Whole  # (T,) source frames
    error: Array  # (T,) mean distance in pixels over all parts with a known true position, else nan
    hidden: Whole  # the frames in which some part is hidden or absent
    success: Array | None = None
    precision: Array | None = None
    cumulative: Array | None = None  # of visible rows by their normalised error; None without a length


@dataclass
class Entry:
    """One recipe: its scores, one a seed, or the `error` that kept it from running."""

    label: str
    scores: list[Score] = field(default_factory=list)
    error: FacetrackError | None = None
    recipe: Recipe | None = None
    warnings: list[str] = field(default_factory=list)

    @property
    def deterministic(self) -> bool:
        return self.recipe is not None and not self.recipe.random

    def values(self, measure: str) -> Array:
        """(n,): the measure in the runs in which it is defined."""
        return np.array([score.figures[measure] for score in self.scores if measure in score.figures])

    def mean(self, measure: str) -> float | None:
        values = self.values(measure)
        return float(values.mean()) if values.size else None

    def spread(self, measure: str) -> float | None:
        """Standard deviation over seeds; None with fewer than two runs."""
        values = self.values(measure)
        return float(values.std(ddof=1)) if values.size > 1 else None

    def interval(self, measure: str) -> tuple[float, float]:
        """Mean +- 2 standard errors."""
        values, spread = self.values(measure), self.spread(measure)
        alone = 0.0 if self.deterministic else math.inf
        reach = alone if spread is None else ERRORS * spread / math.sqrt(values.size)
        return float(values.mean()) - reach, float(values.mean()) + reach

    def figure(self, measure: str) -> str:
        """The mean as text, with the standard deviation if there is one; shares in percent to two decimals."""
        values = [value for value in (self.mean(measure), self.spread(measure)) if value is not None]
        write = MEASURES[measure].write
        texts = [f"{100 * value:.2f}" if write is PERCENT else write(value) for value in values]
        return " ± ".join(texts) or NO_FIGURE

    @property
    def frames_per_s(self) -> float | None:
        """All frames over all time: the harmonic mean of the runs, which are equally long."""
        rates = [score.frames_per_s for score in self.scores]
        return len(rates) / sum(1 / rate for rate in rates) if rates and min(rates) > 0 else None


def check_measure(measure: str) -> None:
    """UsageError for a measure that cannot rank recipes; it lists those that can."""
    able = [name for name, declared in MEASURES.items() if declared.better is not None]
    if measure not in able:
        near = [name for name in able if measure.rpartition(".")[2] in name] or able
        raise UsageError(f"--rank-by {measure}: is nothing to rank by; there are {', '.join(near)}")


def rank(entries: Sequence[Entry], measure: str) -> list[tuple[Entry, tuple[int, int] | None]]:
    """All entries in the order of their mean of `measure`, and where they stand: from the first place to the last, the
    same where it is clear. Entries without a value come last, in the given order, with None.
    """
    sign = 1.0 if MEASURES[measure].better == "more" else -1.0
    valued = [entry for entry in entries if entry.mean(measure) is not None]
    valued.sort(key=lambda entry: -sign * (entry.mean(measure) or 0.0))
    bounds = [sorted(sign * end for end in entry.interval(measure)) for entry in valued]
    above = [sum(other[0] > high for other in bounds) for _, high in bounds]
    below = [sum(other[1] < low for other in bounds) for low, _ in bounds]
    places = [(1 + n, len(valued) - m) for n, m in zip(above, below, strict=True)]
    return [*zip(valued, places, strict=True), *((entry, None) for entry in entries if entry not in valued)]


def score_run(
    run: SeedRun,
    truth: Trajectory,
    *,
    select: str | None = None,
    partial: bool = False,
    stop: int | None = None,
    note: Callable[[str], None] = lambda _: None,
) -> Score:
    """Measure a run that ends before the frame `stop`; the others, and what it raises, are as of `match`."""
    first = int(run.trajectory.frames[0])
    kept = [own for part in truth.parts if len(own := part.between(first, stop or MAX_FRAME))]
    if not kept:
        asked = f"from frame {first} on" if stop is None else f"from frame {first} to {stop - 1}"
        raise InputError(f"{truth.path}: has no row {asked}; correct it, or give frames that it knows")
    within = joined(kept, header=truth.header, path=truth.path)
    pairs = match(run.trajectory, within, partial=partial, select=select, note=note)
    evaluation = evaluate(pairs, size=frame_size_of(run.trajectory), reference=truth.parts)
    rows, boxes, points = evaluation.rows, evaluation.all.boxes, evaluation.all.points
    frame, place = np.unique(column(rows, "frame"), return_inverse=True)
    error, unit = column(rows, "error"), column(rows, "unit")
    finite, seen = np.isfinite(error), column(rows, "visible") & column(rows, "placed") & np.isfinite(unit)
    count, total = (np.bincount(place[finite], weights, len(frame)) for weights in (None, error[finite]))
    overlaps = [part.boxes.overlap[np.isfinite(part.boxes.overlap)] for part in evaluation.parts if part.boxes]
    tails = [np.median(each[-math.ceil(TAIL * each.size) :]) for each in overlaps if each.size]
    return Score(
        seed=run.seed,
        figures=scalars(evaluation),
        failed=bool(points and points.lost_for_good) or any(tail < TAIL_IOU for tail in tails),
        frames_per_s=run.frames_per_s,
        frame=frame,
        error=np.where(count > 0, total / np.maximum(count, 1), np.nan),
        hidden=np.unique(np.concatenate([part.frame[~part.visible] for part in rows])),
        success=None if boxes is None else boxes.success,
        precision=None if boxes is None else boxes.precision,
        cumulative=share_up_to(error[seen] / unit[seen], CUMULATIVE_AT) if points and seen.any() else None,
    )


def run_recipes(
    recipes: Mapping[str, Recipe],
    request: ClipRequest,
    truth: Trajectory,
    seeds: int,
    *,
    select: str | None,
    partial: bool,
    workers: int,
    stop: Stop,
    shown: Progress,
) -> list[Entry]:
    """Every recipe, by label, with its scores, or with what kept it from running; none if it is stopped before.

    `select` and `partial` are as of `match`. Raises the error if all fail of one.
    """
    how: dict[str, Any] = {"select": select, "partial": partial, "stop": request.stop}
    entries = {label: Entry(label, recipe=recipe) for label, recipe in recipes.items()}
    plans = []
    for label, recipe in recipes.items():
        try:
            start = request.find(recipe, truth, stop)
            own = range(seeds if recipe.random else 1)  # what draws no random numbers has one run to show
            plans.append(SeedPlan(label, request.clip, recipe, start, tuple(own), request.stop, request.fps))
        except FacetrackError as e:
            if stop():
                return []
            entries[label].error = e
    alike = len({(plan.start.frame, plan.recipe.points) for plan in plans}) == 1
    notes: list[str] = []
    shown.begin(clip_name(request.clip))
    with contextlib.closing(run_plans(plans, workers, stop, shown.update)) as ends:
        for ended in ends:
            entry = entries[ended.plan.label]
            try:
                if ended.error is not None:
                    raise ended.error
                for run in ended.runs:
                    entry.warnings += run.warnings
                    entry.scores.append(score_run(run, truth, **how, note=notes.append))
            except FacetrackError as e:
                entry.error = e
                if alike and ended.error is None and not any(entry.scores for entry in entries.values()):
                    break  # what is wrong with the ground truth is wrong for every other run too
    errors = [entry.error for entry in entries.values() if entry.error is not None]
    if errors and not any(entry.scores for entry in entries.values()) and stop.code is None:
        raise errors[0]
    warnings = [line for entry in entries.values() for line in entry.warnings]
    for kind, lines in (("warning", warnings), ("note", notes)):
        for line in dict.fromkeys(lines):
            shown.say(f"facetrack: {kind}: {line}")
    return list(entries.values())


def default_truth(clip: Path) -> Path:
    """`<clip>.truth.csv` beside a clip, else one of `TRUTH_NAMES` in its folder or beside it; InputError for none."""
    images = clip.is_dir()
    beside, stem = (clip.resolve().parent, clip.resolve().name) if images else (clip.parent, clip.stem)
    named = [folder / name for folder in ([clip] if images else []) + [beside] for name in TRUTH_NAMES]
    for path in (beside / f"{stem}.truth.csv", *named):
        if path.is_file():
            return path
    raise InputError(f"{clip}: there is neither {stem}.truth.csv nor groundtruth.csv beside it; name it with --truth")


@dataclass(frozen=True)
class Comparison:
    """All that a comparison found. `entries` in the order in which they were asked for, ranked by `rank_by`, or else by
    the first of the USUAL measures.
    """

    clip: Path
    truth: Path
    seeds: int
    entries: tuple[Entry, ...]
    rank_by: str | None = None
    complete: bool = True

    @property
    def measures(self) -> tuple[str, ...]:
        """The measures in the table; the measure that ranks comes first."""
        first = next((score for entry in self.entries for score in entry.scores), None)
        kind = "points" if first is None or first.success is None else "boxes"
        return tuple(dict.fromkeys([*filter(None, [self.rank_by]), *USUAL[kind]]))

    @property
    def places(self) -> list[tuple[Entry, tuple[int, int] | None]]:
        return rank(self.entries, self.measures[0])

    def sheet(self) -> Sheet:
        """A row for each recipe by rank; recipes that could not run come last, and notes say why."""
        frames = np.concatenate([score.frame for entry in self.entries for score in entry.scores])
        recipes = f"{len(self.entries)} recipe{'s' * (len(self.entries) > 1)}"
        on = f"frames {frames.min()} to {frames.max()}, ground truth {self.truth.name}"
        fastest = max((entry.frames_per_s or 0.0 for entry in self.entries), default=0.0)
        heads = ("rank", "recipe", *map(_head, self.measures), "failed", "frames\nper s", "time a\nframe")
        rows = tuple(self._row(*place, fastest) for place in self.places)
        return Sheet(f"{clip_name(self.clip)}: {recipes} on {on}", heads, rows, tuple(self.notes()), left=(1,))

    def _row(self, entry: Entry, place: tuple[int, int] | None, fastest: float) -> tuple[str, ...]:
        rate = entry.frames_per_s
        text = NO_FIGURE if place is None else "\N{EN DASH}".join(map(str, dict.fromkeys(place)))
        if not entry.scores:
            return (text, entry.label, "not run", *(NO_FIGURE,) * (len(self.measures) + 2))
        figures = map(entry.figure, self.measures)
        speed = (NO_FIGURE,) * 2 if rate is None else (f"{rate:,.0f}", f"×{fastest / rate:,.2f}")
        failed = f"{sum(score.failed for score in entry.scores)} of {len(entry.scores)}"
        return (text, entry.label, *figures, failed, *speed)

    def notes(self) -> list[str]:
        """Notes below the table: how to read it, and why recipes did not run."""
        several = any(len(entry.scores) > 1 for entry in self.entries)
        over = f"Mean ± standard deviation over {self.seeds} seeds" if several else "One run each"
        by, places = self.measures[0], self.places
        how = f"ranked by {by}, {MEASURES[by].better} is better" if places[0][1] else f"not ranked, none has {by}"
        lines = [f"{over}; {how}."]
        if any(place and place[0] != place[1] for _, place in places):
            more = "" if several else "; one seed tells nothing of a difference, give --seeds"
            lines.append(f"Recipes that share ranks: the means ± 2 standard errors overlap{more}.")
        if once := [entry.label for entry in self.entries if entry.deterministic and entry.scores]:
            lines.append(f"Deterministic, run once: {', '.join(once)}.")
        if not self.complete:
            lines.append("Interrupted: these are the runs that were complete.")
        return lines + [f"{entry.label}: not run: {entry.error}" for entry in self.entries if entry.error]

    def csv(self) -> str:
        """A row for each recipe and seed with all figures; a recipe that did not run has a row that says why."""
        measured = [name for name in MEASURES if any(name in s.figures for e in self.entries for s in e.scores)]
        rows: list[list[Any]] = []
        for entry in self.entries:
            for score in entry.scores:
                figures = {name: f"{value:.6f}".rstrip("0").rstrip(".") for name, value in score.figures.items()}
                own = [entry.label, score.seed, int(score.failed), f"{score.frames_per_s:.2f}"]
                rows.append([*own, *(figures.get(name, "") for name in measured), ""])
            if entry.error:
                rows.append([entry.label, *[""] * (3 + len(measured)), entry.error])
        return csv_text(["recipe", "seed", "failed", "frames_per_s", *measured, "error"], rows)

    def json(self) -> str:
        """Everything, with the recipes in full. No time but frames_per_s is in it."""
        fields = {
            "clip": str(self.clip),
            "truth": str(self.truth),
            "seeds": self.seeds,
            "ranked_by": self.measures[0],
            "less_is_better": MEASURES[self.measures[0]].better == "less",
            "complete": self.complete,
            "notes": self.notes(),
            "recipes": [self._recipe(*place) for place in self.places],
        }
        return document("facetrack-compare", fields, indent=1)

    def _recipe(self, entry: Entry, place: tuple[int, int] | None) -> dict[str, Any]:
        return {
            "label": entry.label,
            "rank": place,
            "error": None if entry.error is None else str(entry.error),
            "deterministic": entry.deterministic,
            "warnings": list(dict.fromkeys(entry.warnings)),
            "failures": sum(score.failed for score in entry.scores),
            "frames_per_s": None if entry.frames_per_s is None else round(entry.frames_per_s, 2),
            "mean": {n: round(m, 6) for n in MEASURES if (m := entry.mean(n)) is not None},
            "std": {n: round(s, 6) for n in MEASURES if (s := entry.spread(n)) is not None},
            "runs": [
                {"seed": score.seed, "failed": score.failed, "frames_per_s": round(score.frames_per_s, 2)}
                | {name: round(value, 6) for name, value in score.figures.items()}
                for score in entry.scores
            ],
            "recipe": to_dict(entry.recipe) if entry.recipe is not None else None,
        }


def _head(measure: str) -> str:
    way = "\N{DOWNWARDS ARROW}" if MEASURES[measure].better == "less" else "\N{UPWARDS ARROW}"
    return f"{MEASURES[measure].title.strip() or measure} {way}"
