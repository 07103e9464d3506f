"""A long clip without ground truth: how far each recipe stays from what the start's search finds again.

    python benchmarks/agreement.py CLIP --config factorized --config independent --seeds 10

Every 50th frame is given to the search on its own. Its points are right to about 6 % of the mouth's width, so
this cannot tell good trackers apart; but it shows for minutes of video whether a tracker is still on the features. A
part agrees where it is within a quarter of the target's initial size.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.face_points import DETECTORS
from facetrack_cli.core.geometry import size_of_points
from facetrack_cli.core.types import Array, Start
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.start.search import search_start
from facetrack_cli.trackers.face.detectors import detector
from facetrack_cli.video.source import open_source


def detections(path: Path, every: int, by: str) -> tuple[Start, dict[int, Array]]:
    """The start of the clip, and the points (K, 2) found again in every so many frames that show a face."""
    parts = load_recipe("factorized").points
    found: dict[int, Array] = {}
    start: Start | None = None
    with open_source(path) as source:
        for frame in source:
            if frame.index % every and start is not None:
                continue
            try:
                here = search_start([frame], parts, detector=detector(by))
            except InputError:
                continue
            start = start or here
            found[frame.index] = np.array([next(iter(here.targets.values())).points[part] for part in parts])
    if start is None:
        raise SystemExit(f"{path}: {by} finds no face")
    return start, found


def run(path: Path, start: Start, found: dict[int, Array], config: str, seed: int) -> tuple[Array, float, Array]:
    """Distances (T, K) to the points found again, the share of part-frames called lost, whether the end is right."""
    tracker = build_tracker(load_recipe(config), start)
    off, lost, rows = [], 0, 0
    with open_source(path, start=start.frame) as source:
        for result in track(tracker, iter(source), seed):
            one = result.targets[0].rows.take(slice(0, next(iter(found.values())).shape[0]))  # without a box
            lost += int(np.sum(one.status == "lost"))
            rows += len(one)
            if result.frame.index in found and result.frame.index > start.frame:
                off.append(np.hypot(*(np.stack([one.x, one.y], axis=1) - found[result.frame.index]).T))
    errors = np.array(off)
    return errors, lost / rows, np.median(errors[-10:], axis=0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clip", type=Path)
    parser.add_argument("--config", action="append", required=True)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--every", type=int, default=50)
    parser.add_argument("--by", choices=DETECTORS, default="haar")
    parser.add_argument("-j", dest="jobs", type=int, default=2)
    given = parser.parse_args()
    start, found = detections(given.clip, given.every, given.by)
    size = size_of_points(found[start.frame])
    print(f"{given.clip.name}: start at frame {start.frame}, size {size:.1f} px, {len(found)} frames found again\n")
    print("| recipe | seeds | median distance | mean distance | agrees | called lost | wrong at the end |")
    print("|---|---|---|---|---|---|---|")
    for config in given.config:
        with ProcessPoolExecutor(given.jobs) as pool:
            runs = list(pool.map(partial(run, given.clip, start, found, config), range(given.seeds)))
        errors = np.array([e for e, _, _ in runs])
        means = errors.mean(axis=(1, 2))
        wrong = sum(bool((end > size / 4).any()) for _, _, end in runs)
        print(
            f"| {config} | {len(runs)} | {np.median(errors):.1f} px | {means.mean():.1f} ± {means.std():.1f} px "
            f"| {100 * (errors < size / 4).mean():.1f} % | {100 * np.mean([r[1] for r in runs]):.1f} % "
            f"| {wrong}/{len(runs)} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
