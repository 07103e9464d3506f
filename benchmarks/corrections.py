"""How many corrections a clip wants, by an annotator who is simulated: tables of docs/results.md.

    python benchmarks/corrections.py sample_videos/expressions.mp4 sample_videos/occlusion.mp4 \
        --config factorized --config sir
    python benchmarks/corrections.py clips/david/david.webm clips/girl/img --config histogram --config adaptive
    python benchmarks/corrections.py sample_videos/occlusion.mp4 --config factorized --absent

He watches the run, and when a part was wrong in 5 visible frames on end he goes back to the first of them and puts
right what is wrong there; the other parts are kept where they were. From there it is tracked on. He corrects the same
target at most once in 5 frames. A point is wrong when it is further from the ground truth than a quarter of the
distance of the corners of the mouth at the start (without those: of the largest distance of two points); a box when its
overlap with the true one is below 0.3, and he gives the true box. Targets are taken one by one. Seeds are 0 on.

    alone       nobody corrects
    default     what is corrected is learned again there: a box, or those points alone
    kept        with `learn: false`: all is known as the first frame taught it
    all         with `learn: true`: all points are learned again, those that are kept and the size too

A cell: corrections of each 1,000 frames, their mean and standard deviation over seeds / mean error of points over
visible rows in pixels, or mean overlap of boxes / frames in which nothing that is visible is wrong, % / where the clip
has covered points, the mean error of what is visible beside them.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import islice
from pathlib import Path

# before numpy: two processes share the cores
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import cv2
import numpy as np
from annotator import BOUND, Outcome, Truth, Way, Work

from facetrack_cli.core.errors import FacetrackError, InputError, RecipeError
from facetrack_cli.core.geometry import size_of_points
from facetrack_cli.core.types import BOX, Array, Frame, Mask, Start
from facetrack_cli.evaluation.compare import default_truth
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import OpenCvRecipe, Recipe
from facetrack_cli.runs.plan import ClipRequest
from facetrack_cli.runs.seeds import variant
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.trajectory.formats.boxes import read_truth
from facetrack_cli.trajectory.trajectory import Trajectory
from facetrack_cli.video.source import open_source

CORNERS = ("mouth_left", "mouth_right")


def truth_of(table: Trajectory, target: str, parts: Sequence[str], frames: Sequence[Frame]) -> Truth:
    place = {frame.index: t for t, frame in enumerate(frames)}
    places = np.full((len(frames), len(parts), 4), np.nan)
    covered = np.zeros((len(frames), len(parts)), dtype=np.bool_)
    for k, part in enumerate(parts):
        one = table.find(table.targets[0] if len(table.targets) == 1 else target, part)
        if one is None:
            raise InputError(f"{table.path}: has no {target}/{part}, which the recipe follows")
        rows = np.array([row for row, frame in enumerate(one.frame.tolist()) if frame in place])
        at = [place[frame] for frame in one.frame[rows].tolist()]
        places[at, k] = np.stack([one.x, one.y, one.w, one.h], axis=1)[rows]
        covered[at, k] = one.status[rows] == "hidden"
    return _truth(target, parts, places, covered)


def _truth(target: str, parts: Sequence[str], places: Array, covered: Mask) -> Truth:
    bound = np.nan
    if tuple(parts) != (BOX,):
        corners = [places[0, list(parts).index(part), :2] for part in CORNERS if part in parts]
        bound = BOUND * size_of_points(np.array(corners) if len(corners) == 2 else places[0, :, :2])
    seen = np.isfinite(places[..., :2]).all(axis=2) & ~covered
    return Truth(target, tuple(parts), places, seen, covered, bound)


def clips_of(clip: Path, recipe: Recipe, given: argparse.Namespace) -> Iterator[tuple[Start, list[Frame], Truth]]:
    """Each target of a clip, from the frame where the recipe begins."""
    table = read_truth(default_truth(clip))
    start = ClipRequest(clip).find(recipe, table)
    with open_source(clip, start=start.frame) as source:
        frames = list(islice(source, None if given.stop is None else given.stop - start.frame))
    for target in build_tracker(recipe, start):
        yield start, frames, truth_of(table, target.name, target.parts, frames)


# --- tables ------------------------------------------------------------------------------------------------------


def ways_of(recipe: Recipe) -> dict[str, Way]:
    found = {"alone": Way(corrects=False), "default": Way(corrects=True)}
    if not isinstance(recipe, OpenCvRecipe):
        found["kept"] = Way(corrects=True, learn=False)
    if recipe.points:  # boxes are learned again by default
        found["all"] = Way(corrects=True, learn=True)
    return found


def cell(runs: Sequence[Outcome], work: Work, way: Way) -> str:
    box, frames = work.truth.parts == (BOX,), len(work.frames)
    digits = 3 if box else 2
    shown = [f"{np.mean([run.value for run in runs]):.{digits}f}", f"{100 * np.mean([run.right for run in runs]):.1f}"]
    if not np.isnan(runs[0].beside):
        shown.append(f"{np.mean([run.beside for run in runs]):.{digits}f}")
    if way.corrects:
        rate = 1000 * np.array([run.corrections for run in runs]) / frames
        spread = f" ± {rate.std(ddof=1):.1f}" if len(rate) > 1 else ""
        shown.insert(0, f"**{rate.mean():.1f}**{spread}")
    return " / ".join(shown)


def rows(config: str, clip: Path, columns: Sequence[str], given: argparse.Namespace) -> None:
    name, overrides = variant(config)
    recipe = load_recipe(name, overrides)
    for start, frames, truth in clips_of(clip, recipe, given):
        work = Work(recipe, start, frames, truth)
        cells = dict.fromkeys(columns, "")
        # the images go to the processes once
        with ProcessPoolExecutor(given.jobs, initializer=_held.append, initargs=(work,)) as pool:
            for name, way in ways_of(recipe).items():
                runs = list(pool.map(partial(_run, way=way), range(given.seeds if recipe.random else 1)))
                cells[name] = cell(runs, work, way)
        label = clip.parent.name if clip.name == "img" else clip.stem
        several = f": {truth.target}" if len(start.targets) > 1 else ""
        print(f"| `{config}` | {label}{several} ({len(frames)}) | {' | '.join(cells.values())} |", flush=True)


_held: list[Work] = []


def _run(seed: int, way: Way) -> Outcome:
    return _held[0].run(seed, way)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="+", type=Path)
    parser.add_argument("--config", action="append", required=True, help="as for facetrack compare")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--stop", type=int, help="the frame to stop before")
    parser.add_argument("-j", dest="jobs", type=int, default=2)
    given = parser.parse_args()
    cv2.setNumThreads(1)  # its threads would not live on in the processes that are forked
    columns = list(ways_of(load_recipe("factorized")))
    heading = ["recipe", "clip (frames)", *columns]
    print(f"\n{given.seeds} seeds\n\n| {' | '.join(heading)} |\n{'|---' * len(heading)}|", flush=True)
    for config in given.config:
        for clip in given.clips:
            try:
                rows(config, clip, columns, given)
            except (InputError, RecipeError) as e:
                print(e, file=sys.stderr)


if __name__ == "__main__":
    try:
        main()
    except FacetrackError as e:
        raise SystemExit(str(e)) from None
