"""Whether `lost` means what it says: status against ground truth, over many seeds: the table in docs/confidence.md.

    python benchmarks/lost.py sample_videos/expressions.mp4 sample_videos/occlusion.mp4 --seeds 10 \\
        --config factorized --config factorized_robust

What is measured is what `facetrack eval` measures, over the rows of all seeds together, one a frame and part, without
the first frame. A row is *hidden* if ground truth says so, *near* if it is off by less than a sixth of the target's
initial size (a box: if it overlaps the true one by more than half), *gone* if it is hidden or not near.

    precision     of the rows called lost, those hidden; in brackets, those gone
    recall        of the hidden rows, those called lost
    false alarms  of the rows visible and near, those called lost
    tracked near  of the rows called tracked, those near; in brackets, of those that are visible as well
    in ellipses   of the visible rows, those whose true position lies within the 50 and the 90 % ellipse of std_x, std_y
    delay         frames from a part's being hidden until it is called lost, and from its return until it is tracked
                  and near; medians over the spans in which that came about
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Mapping
from pathlib import Path

from accuracy import runs_of

from facetrack_cli.core.errors import FacetrackError
from facetrack_cli.evaluation.measure import Value
from facetrack_cli.evaluation.summary import evaluate
from facetrack_cli.recipe.load import load_recipe

COLUMNS = (
    *("recipe", "lost_below", "patience", "precision (gone)", "recall", "false alarms"),
    *("tracked near (visible)", "in ellipses of 50, 90 %", "delay: lost, back"),
)


def row(label: str, found: Mapping[str, Value]) -> str:
    def share(name: str) -> str:
        return "–" if (value := found[name]) is None else f"{100 * value:.1f} %"

    def frames(name: str) -> str:
        return "–" if (value := found[name]) is None else f"{value:.0f}"

    cells = (
        label,
        f"{share('lost.precision')} ({share('lost.precision_gone')})",
        share("lost.recall"),
        share("lost.false_alarms"),
        f"{share('lost.tracked_near')} ({share('lost.tracked_visible_near')})",
        f"{share('coverage.within_50')}, {share('coverage.within_90')}",
        f"{frames('lost.delay_lost')}, {frames('lost.delay_back')}",
    )
    return f"| {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="+", type=Path)
    parser.add_argument("--config", action="append", required=True)
    parser.add_argument("--set", dest="overrides", action="append", default=[])
    parser.add_argument("--lost-below", default="0.3", help="values with commas")
    parser.add_argument("--patience", default="3", help="values with commas")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("-j", dest="jobs", type=int, default=2)
    given = parser.parse_args()
    recipes = {
        f"{config} | {below} | {patience}": load_recipe(
            config,
            # with a calibration lost does not follow from the raw confidence
            (
                "confidence.calibration=null",
                *given.overrides,
                f"confidence.lost_below={below}",
                f"confidence.patience={patience}",
            ),
        )
        for config, below, patience in itertools.product(
            given.config, given.lost_below.split(","), given.patience.split(",")
        )
    }
    for clip in given.clips:
        for i, (label, _, pairs) in enumerate(runs_of(clip, recipes, given.seeds, given.jobs)):
            # the rows of all seeds count together, as those of several parts do
            together = evaluate([pair for those in pairs for pair in those])
            if i == 0:
                rows, hidden = sum(len(pair.ours) for pair in pairs[0]), together.counts["hidden"] // given.seeds
                print(f"\n{clip.stem}: {rows} rows a run with the first frame, {hidden} hidden; {given.seeds} seeds\n")
                print(f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|")
            print(row(label, together.all.figures), flush=True)


if __name__ == "__main__":
    try:
        main()
    except FacetrackError as e:
        raise SystemExit(str(e)) from None
