"""Points of faces on clips that nobody tuned on: docs/results.md.

    python benchmarks/face.py clips/*/ --config face --config factorized --init haar --seeds 10
    python benchmarks/face.py clips/*/ --config face --init haar --start box

A clip is a folder with reference_points.csv (frame, part, x, y, score, unit: another detector's points, unit the
distance between the eyes) and a video or img/. A track begins where the run itself finds a face; or, by --start, with
the first box of groundtruth.csv, or with what the search finds given as in an init file. Over all frames with a
reference, a frame without a row counting as off and lost:

    .35, .2      share of frames with all points within .35, and within .2, of the distance between the eyes
    off, lost    of points that are off by more than .35, those called lost
    lost, off    of points called lost, those off by more than .35
    false        of points within .2, those called lost
    back         frames from the end of a time in which all points are called lost until all are within .35; the median

A recipe's settings are given as for `facetrack compare`. `--regressions` is a folder of regressions that have
not seen a clip NAME, without_NAME.npz (tools/mouth_descent.py). The first figure is the mean over clips, with the
standard deviation over seeds; shares of points are of those of all clips and seeds together.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from boxes import clip_in
from reference import points_in, take_regression

from facetrack_cli.core.errors import FacetrackError
from facetrack_cli.core.face_points import DetectorName
from facetrack_cli.core.types import Array, Mask, Start, TargetStart
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.runs.api import track_video
from facetrack_cli.runs.plan import ClipRequest
from facetrack_cli.runs.seeds import variant
from facetrack_cli.trackers.face.detectors import detector
from facetrack_cli.trajectory.formats.boxes import read_truth
from facetrack_cli.trajectory.trajectory import UNSEEN, Trajectory

NAMES = (".35", ".2", "off, lost", "lost, off", "false", "back")
REFERENCE = "reference_points.csv"


class Points(NamedTuple):
    """Errors (T, K) of points in units of the face, inf where there is no row; whether they are lost."""

    error: Array
    lost: Mask


def start_of(clip: Path, recipe: Recipe, by: DetectorName | None, how: str) -> Start:
    """Where a clip of `clips` begins: as it is found, or told by a box, or by an init file."""
    if how == "box":
        truth = read_truth(clip / "groundtruth.csv")
        left, top, width, height = truth.boxes[0].tolist()
        target = TargetStart((left, top, width, height))
        given = Start(int(truth.frame[0]), {"face": target}, "--box", detector=detector(by).name)
        return ClipRequest(clip_in(clip), init=given).find(recipe)
    found = ClipRequest(clip_in(clip), init=by).find(recipe)
    return found if how == "found" else replace(found, origin="a file", detector=found.origin)


def run(clip: Path, config: str, init: DetectorName | None, how: str, seed: int, regressions: Path | None) -> Points:
    cv2.setNumThreads(1)
    take_regression(regressions, clip.name)
    name, overrides = variant(config)
    recipe = load_recipe(name, overrides)
    start = start_of(clip, recipe, init, how)
    return against_reference(track_video(clip_in(clip), recipe, init=start, seed=seed), clip / REFERENCE)


def against_reference(ours: Trajectory, path: Path) -> Points:
    frames = points_in(path)
    parts = sorted({part for known in frames.values() for part in known})
    error, lost = np.full((len(frames), len(parts)), np.inf), np.ones((len(frames), len(parts)), np.bool_)
    for k, part in enumerate(parts):
        one = ours.find("face", part)
        for t, (frame, known) in enumerate(sorted(frames.items())):
            at = None if one is None else one.row(frame)
            if one is not None and at is not None and part in known:
                x, y, unit = known[part]
                error[t, k], lost[t, k] = np.hypot(one.x[at] - x, one.y[at] - y) / unit, one.status[at] in UNSEEN
    return Points(error, lost)


def joined(runs: Sequence[Points]) -> Points:
    """All points of several runs, in one row each."""
    return Points(*(np.concatenate([getattr(one, key).ravel() for one in runs]) for key in Points._fields))


def back(one: Points) -> list[int]:
    """Frames from the end of each time in which all is lost until all is right."""
    away, good = np.append(one.lost.all(axis=1), False), np.all(one.error <= 0.35, axis=1)
    ends = np.flatnonzero(away[:-1] & ~away[1:]) + 1
    return [int(np.argmax(good[end:])) for end in ends.tolist() if good[end:].any()]


def reference_figures(runs: Sequence[Points]) -> list[float]:
    all_ = joined(runs)
    off, near, lost = all_.error > 0.35, all_.error <= 0.2, all_.lost
    times = [time for one in runs for time in back(one)]
    shares = [mean(np.all(one.error <= 0.2, axis=1)) for one in runs]
    found = [float(np.mean(shares)), mean(lost[off]), mean(off[lost]), mean(lost[near])]
    return [*found, float(np.median(times)) if times else float("nan")]


def mean(values: Array | Mask) -> float:
    return float(np.mean(values)) if values.size else float("nan")


def table(
    clips: Sequence[Path],
    configs: Sequence[str],
    init: DetectorName | None,
    how: str,
    seeds: int,
    regressions: Path | None,
    jobs: int,
) -> None:
    columns = [*([clip.name for clip in clips] if len(clips) <= 8 else []), *NAMES]
    print(f"| | {' | '.join(columns)} |\n{'|---' * (len(columns) + 1)}|")
    with ProcessPoolExecutor(jobs) as pool:
        waiting = [
            (
                config,
                [
                    [pool.submit(run, clip, config, init, how, seed, regressions) for seed in range(seeds)]
                    for clip in clips
                ],
            )
            for config in configs
        ]
        for config, of_clips in waiting:
            runs = [[one.result() for one in of_clip] for of_clip in of_clips]
            each = np.array(
                [[mean(np.all(one.error <= 0.35, axis=1)) for one in of_clip] for of_clip in runs]
            )  # (C, S)
            cells = [f"{one.mean():.3f} ± {one.std():.3f}" for one in each] if len(clips) <= 8 else []
            whole = each.mean(axis=0)
            cells.append(f"{whole.mean():.3f} ± {whole.std():.3f}")
            cells += [f"{value:.3f}" for value in reference_figures([one for of_clip in runs for one in of_clip])]
            print(f"| `{config}` | {' | '.join(cells)} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="+", type=Path)
    parser.add_argument("--config", action="append", required=True, metavar="RECIPE[:key=value,...]")
    parser.add_argument("--init", choices=("haar", "yunet"), help="what finds the start [default: what is installed]")
    parser.add_argument("--start", choices=("found", "box", "file"), default="found", help="[default: found]")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--regressions", type=Path, help="folder of those that have not seen a clip: without_NAME.npz")
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    try:
        table(args.clips, args.config, args.init, args.start, args.seeds, args.regressions, args.jobs)
    except FacetrackError as e:
        raise SystemExit(f"face.py: {e}") from None


if __name__ == "__main__":
    main()
