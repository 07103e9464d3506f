"""How well recipes track the points of clips with ground truth, over many seeds: tables in docs/results.md.

    python benchmarks/accuracy.py sample_videos/occlusion.mp4 --config factorized --config independent --seeds 20

All lengths are pixels. What is measured is what `facetrack eval` measures; beside the mean error stands its standard
deviation over seeds. A run counts as *lost for good* if one of its parts is, and as *back* if after every span in which
parts are hidden they return within so many frames.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from facetrack_cli.core.errors import FacetrackError
from facetrack_cli.evaluation.compare import Scoring, default_truth, within
from facetrack_cli.evaluation.match import match
from facetrack_cli.evaluation.measure import Value
from facetrack_cli.evaluation.points import Occlusion, measure_recovery
from facetrack_cli.evaluation.rows import Pair
from facetrack_cli.evaluation.summary import Evaluation, evaluate
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.runs.plan import ClipRequest
from facetrack_cli.runs.seeds import SeedPlan, SeedRun, run_plans
from facetrack_cli.trajectory.formats.read import read_truth
from facetrack_cli.trajectory.trajectory import Trajectory

WITHIN = 35


def runs_of(
    clip: Path, recipes: Mapping[str, Recipe], seeds: int, jobs: int
) -> Iterator[tuple[str, Sequence[SeedRun], list[list[Pair]]]]:
    """Of each recipe in turn its label and its runs, one a seed, each with its pairs with the clip's ground truth."""
    truth = read_truth(default_truth(clip))
    plans = [
        SeedPlan(label, clip, recipe, ClipRequest(clip).find(recipe, truth), tuple(range(seeds)))
        for label, recipe in recipes.items()
    ]
    yield from paired(plans, truth, jobs)


def paired(
    plans: Sequence[SeedPlan], truth: Trajectory, jobs: int, *, partial: bool = False
) -> Iterator[tuple[str, Sequence[SeedRun], list[list[Pair]]]]:
    """Of each plan in turn its label and its runs, one a seed, each with its pairs with the ground truth."""
    for ended in run_plans(plans, jobs):
        if ended.error is not None:
            raise ended.error
        known = within(truth, ended.runs[0].trajectory, Scoring())
        pairs = [match(run.trajectory, known, partial=partial, select=None) for run in ended.runs]
        yield ended.plan.label, ended.runs, pairs


def back(occlusion: Occlusion) -> bool:
    return occlusion.frames_to_return is not None and occlusion.frames_to_return <= WITHIN


def mean(values: Iterable[Value], decimals: int) -> str:
    known = [value for value in values if value is not None]
    return f"{np.mean(known):.{decimals}f}" if known else ""


def row(label: str, runs: Sequence[SeedRun], each: Sequence[Evaluation]) -> str:
    over_all = [one.all.figures for one in each]
    visible = [error for one in over_all if (error := one["points.mean_px"]) is not None]
    cells = [label, f"{np.mean(visible):.2f} ± {np.std(visible):.2f}" if visible else ""]
    for parts in zip(*(one.parts for one in each), strict=True):
        cells.append(mean((part.figures["points.mean_px"] for part in parts), 2))
    cells.append(mean((one["points.hidden_mean_px"] for one in over_all), 1))
    cells.append(f"{sum(bool(one['points.lost_for_good']) for one in over_all)}/{len(each)}")
    recovery = measure_recovery([occlusion for one in each for occlusion in one.occlusions])
    if recovery is None:
        cells += ["", ""]
    else:
        cells.append(f"{100 * np.mean([all(map(back, one.occlusions)) for one in each]):.0f} %")
        some = recovery.frames_median is not None
        cells.append(f"{recovery.frames_median:.0f} / {recovery.frames_worst:.0f}" if some else "never")
    cells.append(f"{1000 / np.median([run.frames_per_s for run in runs]):.2f}")
    return f"| {' | '.join(cells)} |"


def heading(clip: Path, one: Evaluation, seeds: int) -> str:
    spans = ", ".join(f"{o.first}-{o.last} ({', '.join(o.parts)})" for o in one.occlusions)
    columns = (
        *("recipe", "visible points", *(part.part for part in one.parts), "hidden points", "lost for good"),
        *(f"back within {WITHIN}", "frames to return, median / worst", "ms a frame"),
    )
    return (
        f"\n{clip.stem}: {len(one.frames)} frames; {', '.join(one.units.values())}; {seeds} seeds; hidden: {spans}\n\n"
        f"| {' | '.join(columns)} |\n{'|---' * len(columns)}|"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="+", type=Path)
    parser.add_argument("--config", action="append", required=True)
    parser.add_argument("--set", dest="overrides", action="append", default=[])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("-j", dest="jobs", type=int, default=2)
    given = parser.parse_args()
    recipes = {config: load_recipe(config, given.overrides) for config in given.config}
    for clip in given.clips:
        for i, (label, runs, pairs) in enumerate(runs_of(clip, recipes, given.seeds, given.jobs)):
            each = [evaluate(those) for those in pairs]
            if i == 0:
                if all(part.figures["points.mean_px"] is None for part in each[0].parts):
                    raise SystemExit(f"{clip}: its ground truth has no points; of boxes: benchmarks/regions.py")
                print(heading(clip, each[0], given.seeds))
            print(row(label, runs, each), flush=True)


if __name__ == "__main__":
    try:
        main()
    except FacetrackError as e:
        raise SystemExit(str(e)) from None
