"""Settings of a recipe searched on several clips, and what they gain on clips that had no part in their choice.

    found = tune(load, ranges, cases, "points.mean_normalised", Search(trials=30), stop, shown)
    found.folds, found.gain

*Trials.* Optuna's tree-structured Parzen estimator (Bergstra et al. 2011) proposes settings by the mean over all clips.
Every setting runs once on all clips with the same seeds, so that one grid of values (setting, clip, seed) serves all
folds. *Folds.* For each clip, the setting with the best mean over the other clips is measured on it; the recipe as it
is takes part in the choice. So no clip judges a setting that it helped to choose; that it helped to propose the
candidates, which the other clips then choose among, is all that it did. *Gain.* See `Tuning.gain`.
"""

import contextlib
import math
import re
import time
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Final, Literal, NamedTuple, TypeAlias

import numpy as np

from facetrack_cli.core.errors import FacetrackError, InputError, RecipeError, UsageError, needed
from facetrack_cli.core.numbers import document
from facetrack_cli.core.types import Array
from facetrack_cli.core.yaml_tree import rewritten
from facetrack_cli.evaluation import summary
from facetrack_cli.evaluation.experiments import compare
from facetrack_cli.evaluation.measure import PX, Measure
from facetrack_cli.evaluation.sheet import NO_FIGURE, Sheet, clip_name, rounded
from facetrack_cli.recipe.files import read_recipe
from facetrack_cli.recipe.model import Recipe, to_dict
from facetrack_cli.runs.progress import Progress
from facetrack_cli.runs.seeds import Plan, SeedRun, load_recipes, run_plans
from facetrack_cli.runs.signals import Stop
from facetrack_cli.runs.start import Begin, far_from_truth
from facetrack_cli.trajectory import diagnostics
from facetrack_cli.trajectory.trajectory import Trajectory

EVIDENCE: Final = diagnostics.EVIDENCE.name  # the measure of --by evidence
MEASURES: Final = {**summary.MEASURES, EVIDENCE: Measure("evidence,\nnats a frame", PX, "more")}
DIGITS: Final = 4  # significant digits of a number that is tried
_NUMBER = r"-?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_SPAN: Final = re.compile(rf"({_NUMBER}) ?(?:px)?\.\.({_NUMBER}) ?(px)?(:log)?")
_BETWEEN: Final = re.compile(r",(?![^\[{]*[\]}])")  # commas between choices, not those of [1, 2]
Texts: TypeAlias = Sequence[str]
Load: TypeAlias = Callable[[Texts], Recipe]
"""The recipe with these `key=value` put into it; raises RecipeError for a key or value that it refuses."""


@dataclass(frozen=True)
class Range:
    """The values of a key: `choices` as `--set` writes them, or numbers from `low` to `high`, in steps of 1 if `whole`.

    `log`: sampled evenly in the logarithm. `unit` is `px` or nothing.
    """

    key: str
    choices: tuple[str, ...] = ()
    low: float = 0.0
    high: float = 0.0
    unit: str = ""
    log: bool = False
    whole: bool = False

    def text(self, value: float | str) -> str:
        """A value as `--set` writes it, numbers rounded to DIGITS."""
        if isinstance(value, str):
            return value
        if self.whole:
            return str(int(value))
        near = min(max(float(f"{value:.{DIGITS}g}"), self.low), self.high)
        return f"{near:.12g}{self.unit}"

    def distribution(self, optuna: Any) -> Any:
        if self.choices:
            return optuna.distributions.CategoricalDistribution(self.choices)
        if self.whole:
            return optuna.distributions.IntDistribution(int(self.low), int(self.high), log=self.log)
        return optuna.distributions.FloatDistribution(self.low, self.high, log=self.log)


def read_range(given: str) -> Range:
    """From `key=LOW..HIGH`, `key=LOW..HIGH:log` or `key=a,b,c`. UsageError for anything else."""
    key, _, rest = (part.strip() for part in given.partition("="))
    if not key or not rest:
        raise UsageError(f"--set-range {given}: write KEY=LOW..HIGH, as motion.sigma=0.02..0.3, or KEY=a,b,c")
    if (found := _SPAN.fullmatch(rest)) is None:
        choices = tuple(one.strip() for one in _BETWEEN.split(rest))
        if len(set(choices)) < max(len(choices), 2) or not all(choices) or ".." in rest:
            remedy = "LOW..HIGH, LOW..HIGH:log, or two or more different values with commas"
            raise UsageError(f"--set-range {given}: {rest!r} is no range; write {remedy}")
        return Range(key, choices)
    low, high = float(found[1]), float(found[2])
    if not low < high:
        raise UsageError(
            f"--set-range {given}: the range begins at {found[1]} and ends at {found[2]}; give the smaller number first"
        )
    if found[4] and low <= 0:
        raise UsageError(f"--set-range {given}: a logarithmic range begins above 0")
    return Range(key, (), low, high, found[3] or "", bool(found[4]))


def load_with(name: str, overrides: Texts, values: Texts) -> Recipe:
    """The recipe of a name or file with these `key=value`."""
    return load_recipes([(name, (*overrides, *values))], None)[0]


def checked(one: Range, load: Load) -> Range:
    """The range, `whole` if its key takes whole numbers alone. Raises RecipeError for an end that is refused."""
    for text in one.choices or (one.text(one.low), one.text(one.high)):
        load([f"{one.key}={text}"])
    if one.choices or one.unit or one.low % 1 or one.high % 1:
        return one
    try:
        load([f"{one.key}={one.low + 0.5}"])
    except RecipeError:
        return replace(one, whole=True)
    return one


class Case(NamedTuple):
    """A clip with where its tracks begin, and its ground truth, if any, with how runs are measured by it."""

    plan: Plan
    truth: Trajectory | None
    options: compare.Scoring

    def value(self, run: SeedRun, measure: str, note: Callable[[str], None] = lambda _: None) -> float:
        """The measure of a run. InputError where the measure is not defined."""
        if measure == EVIDENCE:
            return evidence(run.trajectory)
        assert self.truth is not None
        figures = compare.score_run(run, self.truth, self.options, note).figures
        if measure not in figures:
            raise InputError(
                f"{self.plan.clip}: {measure} is not defined here; choose another --measure, or other clips"
            )
        return figures[measure]


def case_of(
    begin: Begin, recipe: Recipe, truth: Trajectory | None, stopped: Stop, select: str | None, *, partial: bool
) -> Case:
    """A clip to try settings on. Raises InputError where its tracks begin nowhere."""
    with begin.open() as source:
        options = compare.Scoring(select, partial, begin.stop, source.size)
    start = begin.find(recipe, truth, stopped)
    return Case(Plan(recipe.name, begin.clip, recipe, start, (), begin.stop, begin.fps), truth, options)


def usual_measure(cases: Sequence[Case]) -> str:
    """By ground truth: that of points if all clips have points, else that of boxes.

    Both are within 0 and 1: a mean error is decided by the one clip on which the tracker gets lost.
    """
    kinds = [compare.kinds_of(one.plan, one.truth, one.options) for one in cases if one.truth is not None]
    return "points.auc" if all("points" in one for one in kinds) else "boxes.success_auc"


def less_is_better(measure: str) -> bool:
    return MEASURES[measure].better == "less"


def evidence(trajectory: Trajectory) -> float:
    """The mean log marginal likelihood of a frame in nats, log p(y_t | y_1 .. y_{t-1}), summed over the targets."""
    found = [one.get(EVIDENCE) for one in trajectory.diagnostics.values()]
    known = [values[np.isfinite(values)] for values in found]
    if not known or not all(map(len, known)):
        raise InputError(f"{trajectory.path}: this recipe reports no evidence; tune it by ground truth")
    return float(sum(values.mean() for values in known))


@dataclass(frozen=True)
class Search:
    """How many runs each setting has, how many settings are proposed, and the seed of the proposals."""

    _: KW_ONLY
    seeds: int = 3
    trials: int = 30
    seed: int = 0
    workers: int = 1


@dataclass(frozen=True, eq=False)
class Setting:
    """`values` by range, as `--set` writes them, none of the recipe as it is; `scores` (C, S) of clips and seeds."""

    values: tuple[str, ...]
    scores: Array


@dataclass(frozen=True, eq=False)
class Fold:
    """The setting that is best on all other clips, and its gain (S,) on this one, run by run; above 0 is better."""

    clip: Path
    setting: Setting
    before: Array
    after: Array
    gain: Array


@dataclass(frozen=True, eq=False)
class Tuning:
    """What a search found. The first of `settings` is the recipe as it is; `refused` are why settings could not run."""

    recipe: Recipe
    ranges: tuple[Range, ...]
    clips: tuple[Path, ...]
    measure: str
    search: Search
    settings: tuple[Setting, ...]
    trials: int
    refused: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def complete(self) -> bool:
        return self.trials == self.search.trials

    @property
    def sign(self) -> float:
        return -1.0 if less_is_better(self.measure) else 1.0

    def best(self, without: int | None = None) -> Setting:
        """The best mean over all clips but one; of equal ones the first, so that the recipe as it is comes before."""
        kept = [c for c in range(len(self.clips)) if c != without] or [0]
        return max(self.settings, key=lambda one: self.sign * float(one.scores[kept].mean()))

    @cached_property
    def folds(self) -> tuple[Fold, ...]:
        """One for each clip; of a single clip, which has no others, its own best setting."""
        found = []
        for c, clip in enumerate(self.clips):
            one = self.best(without=c)
            before, after = self.settings[0].scores[c], one.scores[c]
            found.append(Fold(clip, one, before, after, self.sign * (after - before)))
        return tuple(found)

    @property
    def gain(self) -> tuple[float, float]:
        """The mean gain over clips, and its spread: 2 standard errors, over clips or over seeds, whichever is more.

        Infinite where one seed of a tracker that draws random numbers tells nothing.
        """
        gains = np.stack([fold.gain for fold in self.folds])  # (C, S)
        c, s = gains.shape
        seeds = np.sqrt(gains.var(axis=1, ddof=1).sum() / s) / c if s > 1 else np.inf if self.recipe.random else 0.0
        clips = gains.mean(axis=1).std(ddof=1) / np.sqrt(c) if c > 1 else 0.0
        return float(gains.mean()), compare.ERRORS * float(max(seeds, clips))


def tune(
    load: Load,
    ranges: Sequence[Range],
    cases: Sequence[Case],
    measure: str,
    search: Search,
    stop: Stop,
    shown: Progress,
) -> Tuning | None:
    """Search the ranges; None if `stop` says so before the recipe as it is was measured, else what there is by then.

    Raises UsageError without Optuna, and the errors of the recipe as it is; settings that cannot run are left out.
    """
    with needed("trials", "optuna", "tune"):
        import optuna
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    recipe, notes, refused = load(()), list[str](), list[str]()
    shown.begin(f"{search.trials} trials", "trials", search.trials)
    scores = _scores(recipe, cases, measure, search, stop, partial(shown.update, 0, search.trials), notes.append)
    if scores is None:
        return None
    settings, trials = [Setting((), scores)], 0
    direction: Literal["minimize", "maximize"] = "minimize" if less_is_better(measure) else "maximize"
    study = optuna.create_study(direction=direction, sampler=optuna.samplers.TPESampler(seed=search.seed))
    space = {one.key: one.distribution(optuna) for one in ranges}
    while trials < search.trials and not stop():
        asked = study.ask(space)
        values = tuple(one.text(asked.params[one.key]) for one in ranges)
        known = next((one for one in settings if one.values == values), None)
        try:
            if known is None:
                tried = load([f"{one.key}={text}" for one, text in zip(ranges, values, strict=True)])
                scores = _scores(tried, cases, measure, search, stop, partial(shown.update, trials, search.trials))
                if scores is None:
                    break
                known = Setting(values, scores)
                settings.append(known)
        except FacetrackError as e:
            refused.append(str(e))
            study.tell(asked, state=optuna.trial.TrialState.FAIL)
        else:
            study.tell(asked, float(known.scores.mean()))
        trials += 1
    far = [far_from_truth(one.plan.start, one.truth) for one in cases if one.truth is not None]
    return Tuning(
        recipe,
        tuple(ranges),
        tuple(one.plan.clip for one in cases),
        measure,
        search,
        tuple(settings),
        trials,
        tuple(dict.fromkeys(refused)),
        tuple(dict.fromkeys([*filter(None, far), *notes])),
    )


def _scores(
    recipe: Recipe,
    cases: Sequence[Case],
    measure: str,
    search: Search,
    stop: Stop,
    at: Callable[[float], None],
    note: Callable[[str], None] = lambda _: None,
) -> Array | None:
    """(C, S) of a recipe by clip and seed; None once stopped. `at` hears frames/s, `note` what is wrong with a clip.

    Raises what keeps the recipe from running, or from being measured.
    """
    seeds, began = tuple(range(search.seeds if recipe.random else 1)), time.monotonic()
    plans = [replace(one.plan, recipe=recipe, seeds=seeds) for one in cases]

    def report(frames: int, _: int) -> None:
        at(frames / (time.monotonic() - began))

    values = []
    with contextlib.closing(run_plans(plans, search.workers, stop, report)) as found:
        for one, ended in zip(cases, found, strict=False):
            if ended.error is not None:
                raise ended.error
            values.append([one.value(run, measure, note) for run in ended.runs])
            for line in (line for run in ended.runs for line in run.warnings):
                note(line)
    return np.array(values) if len(values) == len(cases) else None


def sheet(found: Tuning) -> Sheet:
    """A row for each held-out clip; the last note says whether the gain is larger than the spread."""
    write = partial(compare.figure, MEASURES[found.measure], spread=True)
    only = len(found.clips) == 1
    rows: list[tuple[str, ...]] = [
        (
            clip_name(fold.clip),
            ", ".join(fold.setting.values) or "as it is",
            write(fold.before),
            write(fold.after),
            _signed(found, float(fold.gain.mean())),
        )
        for fold in found.folds
    ]
    means = [
        np.mean([getattr(fold, name).mean() for fold in found.folds], keepdims=True) for name in ("before", "after")
    ]
    rows.append(("mean", "", *map(write, means), _signed(found, found.gain[0])))
    heads = ("clip", "chosen on it") if only else ("held-out clip", "chosen on\nthe others")
    keys, clips = ", ".join(one.key for one in found.ranges), f"{len(found.clips)} clip{'s' * (not only)}"
    title = f"{found.recipe.name}: {keys} by {found.measure} on {clips}"
    return Sheet(title, (*heads, "recipe\nas it is", "tuned", "gain"), tuple(rows), tuple(notes(found)), left=(0, 1))


def _plain(found: Tuning, value: float) -> str:
    return compare.figure(MEASURES[found.measure], np.array([value]), spread=False)


def _signed(found: Tuning, gain: float) -> str:
    text = _plain(found, gain)
    return text if text.startswith("-") else f"+{text}"


def notes(found: Tuning) -> list[str]:
    """Notes below the table: how to read it, how far folds differ, and whether the gain exceeds the spread."""
    seeds = found.settings[0].scores.shape[1]
    better = "less" if less_is_better(found.measure) else "more"
    over = f"Mean ± standard deviation over {seeds} seeds" if seeds > 1 else "One run each"
    lines = [f"{over} of {found.measure}, {better} is better; of gains, more is."]
    if not found.complete:
        lines.append(f"Interrupted after {found.trials} of {found.search.trials} trials.")
    if len(found.clips) > 1:
        lines.append(
            f"{len(found.settings) - 1} settings and the recipe as it is ran on all clips; each clip is measured with "
            "what is best on the others. Trials were proposed by the mean over all clips."
        )
    best = found.best()
    for i, one in enumerate(found.ranges):
        chosen = [_value(found, fold.setting, i) for fold in found.folds]
        differ = _over(one, chosen) if len(found.clips) > 1 else ""
        was = _shipped(found, one.key)
        lines.append(f"{one.key}: {differ}{_value(found, best, i)} by all clips; {was} in the recipe as it is.")
    if found.refused:
        more = f" (and {len(found.refused) - 1} more reasons)" if len(found.refused) > 1 else ""
        lines.append(f"Settings that could not run: {found.refused[0]}{more}")
    if found.measure == EVIDENCE:
        lines.append(
            "Evidence compares settings of motion, filter and prior; not those of a likelihood whose density is not "
            "normalised, which grows with what it calls likely."
        )
    return [*lines, verdict(found)]


def verdict(found: Tuning) -> str:
    """Whether the gain is larger than the spread, in a sentence."""
    gain, reach = found.gain
    if not math.isfinite(reach):
        return f"The gain is {_signed(found, gain)}; one seed tells nothing of its spread, give --seeds."
    said = f"{_signed(found, gain)} ± {_plain(found, reach)} (2 standard errors)"
    larger = gain > reach
    if len(found.clips) == 1:
        over = "larger" if larger else "not larger"
        return (
            f"No clip was held out: the gain of {said} is {over} than the spread of the seeds, but it is on the clip "
            "that the setting was chosen on, which flatters it. Give more clips."
        )
    on = sum(fold.gain.mean() > 0 for fold in found.folds)
    where = f"on {on} of {len(found.clips)} held-out clips it is better"
    if larger:
        return f"The gain of {said} is larger than the spread: {where}."
    return f"The gain of {said} is not larger than the spread: {where}. Keep the recipe as it is, or give more clips."


def as_json(found: Tuning) -> str:
    """Everything, with every setting's values, and the recipe as it is in full."""
    gain, reach = found.gain
    fields = {
        "recipe": found.recipe.name,
        "clips": list(map(str, found.clips)),
        "measure": found.measure,
        "less_is_better": less_is_better(found.measure),
        "seeds": found.settings[0].scores.shape[1],
        "trials": found.trials,
        "seed": found.search.seed,
        "complete": found.complete,
        "best": _named(found, found.best()),
        "gain": rounded(gain, 6),
        "spread": rounded(reach, 6),
        "larger_than_spread": gain > reach,
        "held_out": len(found.clips) > 1,
        "folds": [
            {
                "clip": str(fold.clip),
                "chosen": _named(found, fold.setting),
                "before": [rounded(value, 6) for value in fold.before.tolist()],
                "after": [rounded(value, 6) for value in fold.after.tolist()],
            }
            for fold in found.folds
        ],
        "settings": [
            {"values": _named(found, one), "scores": [[rounded(v, 6) for v in row] for row in one.scores.tolist()]}
            for one in found.settings
        ],
        "refused": found.refused,
        "warnings": found.warnings,
        "notes": notes(found),
        "as_it_is": to_dict(found.recipe),
    }
    return document("facetrack-tune", fields, indent=1)


def tuned_recipe(found: Tuning, overrides: Sequence[str]) -> str:
    """The recipe's own text, comments too, with the overrides and the best setting of all clips, below a line on it."""
    best = [f"{one.key}={text}" for one, text in zip(found.ranges, found.best().values, strict=False)]
    what = f"{', '.join(best) or 'as it is'}, the best by {found.measure}"
    clips = ", ".join(clip_name(clip) for clip in found.clips)
    text = rewritten(read_recipe(found.recipe.path), [*overrides, *best])
    return f"# {found.recipe.name}, tuned: {what} on {clips}.\n{text}"


def _named(found: Tuning, one: Setting) -> dict[str, str]:
    return {each.key: text for each, text in zip(found.ranges, one.values, strict=False)}


def _value(found: Tuning, one: Setting, i: int) -> str:
    return one.values[i] if one.values else _shipped(found, found.ranges[i].key)


def _over(one: Range, chosen: Sequence[str]) -> str:
    """What the folds chose of a range."""
    different = list(dict.fromkeys(chosen))
    if len(different) == 1:
        return f"all folds choose {different[0]}, "
    try:
        ordered = sorted(different, key=lambda text: float(text.removesuffix("px")))
    except ValueError:
        return f"folds choose {', '.join(different)}, "
    return f"folds choose {ordered[0]} to {ordered[-1]}, "


def _shipped(found: Tuning, key: str) -> str:
    """The value of a key in the recipe as it is; a dash where the recipe has no such key."""
    node: Any = to_dict(found.recipe)
    for name in key.split("."):
        node = node.get(name.strip()) if isinstance(node, dict) else None
    return NO_FIGURE if node is None or isinstance(node, dict) else str(node)
