"""Recipes as --config names them, run over a clip with many seeds: for the commands that compare and check.

All seeds of a plan advance side by side over one decoding of the clip, so memory stays flat but for the results.
Every tracker is given a frame of its own, and only its own work is timed. Several processes share plans, and then their
seeds; the results of a seed do not depend on that.
"""

import contextlib
import re
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from facetrack_cli.core.errors import FacetrackError, InputError, UsageError
from facetrack_cli.core.types import Frame, Start, own_frame
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import OVERRIDES, load_recipe, with_gallery
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.runs.plan import Report, silent
from facetrack_cli.runs.signals import Stop
from facetrack_cli.runs.workers import cores, side_by_side
from facetrack_cli.start.assembly import check_gallery, tracker_for
from facetrack_cli.trajectory.trajectory import Collector, Trajectory
from facetrack_cli.video.source import open_source


def variant(config: str) -> tuple[str, tuple[str, ...]]:
    """A recipe and its overrides, from `name`, a file, or `name:key=value,key=value`."""
    name, colon, rest = config.partition(":")
    if not colon or "=" not in rest or Path(config).exists():
        return config, ()
    return name, tuple(re.split(OVERRIDES, rest))


def labels(configs: Sequence[str]) -> list[str]:
    """A label for each --config that differs from all others: the recipe's name, else its path, and its overrides.

    Raises UsageError for one that is given twice.
    """
    short = []
    for name, overrides in map(variant, configs):
        stem = Path(name).stem if Path(name).suffix else name
        short.append(f"{stem}:{','.join(overrides)}" if overrides else stem)
    unique = [s if short.count(s) == 1 else text for s, text in zip(short, configs, strict=True)]
    if twice := [text for text in unique if unique.count(text) > 1]:
        raise UsageError(f"--config {twice[0]} is given twice; a recipe is compared with others")
    return unique


def load_recipes(asked: Sequence[tuple[str, Sequence[str]]], gallery: str | None) -> list[Recipe]:
    """The recipes of names or files and their overrides, with the people of a gallery (see `with_gallery`).

    The gallery is read where it must be good: where it is given for all, or a single recipe names one.
    """
    recipes = with_gallery([load_recipe(name, overrides) for name, overrides in asked], gallery)
    for recipe in recipes if gallery is not None or len(recipes) == 1 else ():
        check_gallery(recipe)
    return recipes


class SeedPlan(NamedTuple):
    """A recipe on a clip, with some seeds. `label` names it in results; `stop` is the frame to end before."""

    label: str
    clip: Path
    recipe: Recipe
    start: Start
    seeds: tuple[int, ...]
    stop: int | None = None
    fps: Fraction | None = None


@dataclass(frozen=True, eq=False)
class SeedRun:
    """One seed's trajectory. `frames_per_s` is the tracker's alone: decoding is not counted, nor the first frame."""

    seed: int
    trajectory: Trajectory
    frames_per_s: float
    warnings: tuple[str, ...] = ()  # what was wrong with the clip, a line each


class PlanResult(NamedTuple):
    """The runs of a plan in the order of its seeds, or the error that kept it from running."""

    plan: SeedPlan
    runs: tuple[SeedRun, ...] = ()
    error: FacetrackError | None = None


def run_plans(
    plans: Sequence[SeedPlan], workers: int = 1, stopped: Stop | None = None, report: Report = silent
) -> Generator[PlanResult, None, None]:
    """Run all plans, in `workers` processes, until `stopped` says so; each is yielded as it ends, in their order."""
    stopped = stopped or Stop()
    each = [len(plan.seeds) * _length(plan.clip, plan.fps, plan.start.frame, plan.stop) for plan in plans]
    total = sum(each) if all(each) else 0  # of the frames, if all clips state how many they have
    pieces = -(-workers // max(len(plans), 1))  # of each plan, so that no process is idle
    shares = [
        (number, tuple(share.tolist()))
        for number, plan in enumerate(plans)
        for share in np.array_split(plan.seeds, min(pieces, len(plan.seeds)))
    ]
    tasks, done = [(plans[number], share) for number, share in shares], dict[int, object]()
    threads = max(1, cores() // workers)
    results = side_by_side(tasks, _work, workers, stopped, lambda frames: report(frames, total), threads=threads)
    with contextlib.closing(results):
        for number, plan in enumerate(plans):
            own = [i for i, share in enumerate(shares) if share[0] == number]
            while not done.keys() >= {*own} and (result := next(results, None)) is not None:
                done[result[0]] = result[1]
            if stopped():
                return
            values = [done.pop(i) for i in own if i in done]
            error = next((value for value in values if isinstance(value, Exception)), None)
            if error is not None and not isinstance(error, FacetrackError):
                raise error
            yield PlanResult(plan, tuple(run for value in values if isinstance(value, list) for run in value), error)


def _work(task: tuple[SeedPlan, tuple[int, ...]], stop: Stop, report: Callable[[int], None]) -> list[SeedRun]:
    """The runs of some seeds of a plan; none if it is stopped."""
    plan, seeds = task
    frame: Frame

    def present() -> Iterator[Frame]:
        while True:  # images derived from a frame are kept in it: each tracker makes its own, and is timed for it
            yield own_frame(frame)

    with open_source(plan.clip, fps=plan.fps, start=plan.start.frame, stop=plan.stop) as source:
        tracker = tracker_for(plan.recipe, plan.start, source.size)
        runs = [track(tracker, present(), seed, clip=str(plan.clip)) for seed in seeds]
        logs, seconds = [Collector() for _ in seeds], [0.0 for _ in seeds]
        count, notes = 0, tuple[str, ...]()
        for frame in source:  # noqa: B007 -- `present` yields it
            if stop():
                return []
            for i, run in enumerate(runs):
                began = time.perf_counter()
                result = next(run)
                seconds[i] += (time.perf_counter() - began) * (count > 0)
                logs[i].add(result.rows)
                notes = notes or result.notes
            count += 1
            report(count * len(seeds))
        if count == 0:
            raise InputError(f"{plan.clip}: frame {plan.start.frame}, where {plan.start.origin} begins, cannot be read")
    about: dict[str, Any] = {"path": source.path, "header": {"source": {"size": list(source.size)}}}
    warnings = (*source.warnings, *notes)
    both = zip(seeds, logs, [(count - 1) / max(spent, 1e-9) for spent in seconds], strict=True)
    return [SeedRun(seed, log.trajectory(**about), rate, warnings) for seed, log, rate in both]


@cache
def _length(clip: Path, fps: Fraction | None, first: int, stop: int | None) -> int:
    """The frames of a clip to track, as it states; else 0, as if it cannot be opened, which its plan reports."""
    with contextlib.suppress(FacetrackError), open_source(clip, fps=fps, start=first, stop=stop) as source:
        return source.frames_hint or 0
    return 0
