"""What a face does, on real clips: how far its points move as those of MediaPipe's mesh do: docs/results.md.

    python benchmarks/expressions.py clips/people/*/ --regressions left_out --seeds 5
    python benchmarks/expressions.py clips/people/*/ --regressions left_out --config face:head.landmarks.network=mesh

A clip is a folder with a video and mesh.csv (frame, part, x, y, unit: MediaPipe's points, unit the distance between the
eyes). `--regressions` is a folder of regressions that have not seen a person: without_NAME.npz for each clip NAME, by
`tools/mouth_descent.py --without NAME`. Of each clip:

    opening, width   correlation of the distance between the lips, and between the corners, with the mesh's over rows
                     that are not lost, times the share of those; of clips in which the mesh's varies by .03 or more
    median           median error of the five points without constant offsets, in distances between the eyes
    .35              share of frames with nose and corners of the mouth within .35
    90 %             share of points in the ellipse that should hold 90 % of them
    moves            the same without constant offsets
    lost             share of points called lost
    start            mean error of the points of the start
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from boxes import clip_in
from reference import MESH, points_in, take_regression

from facetrack_cli.core.types import Array
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.api import track_video
from facetrack_cli.runs.seeds import variant
from facetrack_cli.trajectory.trajectory import UNSEEN

PARTS = ("nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower")
VARIES, RIGHT, ELLIPSE = 0.03, 0.35, 4.605  # the last: chi squared of two degrees of freedom, 90 %


class Scores(NamedTuple):
    opening: float
    width: float
    median: float
    right: float
    inside: float
    moves: float
    lost: float
    start: float


def reference(path: Path) -> tuple[list[int], Array, Array]:
    """The frames, places (T, K, 2) and units (T,) of a mesh.csv, of frames with all parts."""
    found = points_in(path)
    frames = sorted(frame for frame, known in found.items() if known.keys() >= {*PARTS})
    table = np.array([[found[frame][part] for part in PARTS] for frame in frames])
    return frames, table[..., :2], table[:, 0, 2]


def score(clip: Path, config: str, seed: int, regressions: Path | None) -> Scores:
    cv2.setNumThreads(1)
    take_regression(regressions, clip.name)
    name, overrides = variant(config)
    ours = track_video(clip_in(clip), load_recipe(name, overrides), seed=seed)
    frames, true, unit = reference(clip / MESH)
    parts = [ours.find("face", part) for part in PARTS]
    rows = [[None if one is None else one.row(frame) for one in parts] for frame in frames]
    kept = [t for t, each in enumerate(rows) if None not in each]
    true, unit = true[kept], unit[kept, None]

    def column(name: str) -> Array:
        return np.array([[getattr(one, name)[i] for one, i in zip(parts, rows[t], strict=True)] for t in kept])

    at, lost = np.stack([column("x"), column("y")], axis=2), np.isin(column("status"), UNSEEN)
    off = (at - true) / unit[..., None]
    error = np.hypot(*np.moveaxis(off - np.median(off, axis=0), 2, 0))
    spread = np.stack([column("std_x"), column("std_y")], axis=2) / unit[..., None]
    spread = np.maximum(spread, 1e-9)  # of rows that are given it is 0
    inside, without = (
        float(np.mean(np.sum((one / spread) ** 2, axis=2) <= ELLIPSE)) for one in (off, off - np.median(off, axis=0))
    )
    same: list[float] = []
    for a, b in ((3, 4), (1, 2)):
        shown = ~(lost[:, a] | lost[:, b])
        mine, mesh = (np.hypot(*(one[:, a] - one[:, b]).T) / unit[:, 0] for one in (at, true))
        alike = np.corrcoef(mine[shown], mesh[shown])[0, 1] * shown.mean()
        same.append(float(alike) if mesh.std() >= VARIES else float("nan"))
    whole = np.hypot(*np.moveaxis(off, 2, 0))
    right = np.all(whole[:, :3] <= RIGHT, axis=1).sum() / len(frames)
    opening, width = same
    return Scores(opening, width, float(np.median(error)), right, inside, without, lost.mean(), whole[0].mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="+", type=Path)
    parser.add_argument("--config", action="append", default=[])
    parser.add_argument("--regressions", type=Path)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("-j", "--jobs", type=int, default=2)
    args = parser.parse_args()
    clips: Sequence[Path] = args.clips
    names = ("opening", "width", "median", ".35", "90 %", "moves", "lost", "start")
    for config in args.config or ["face"]:
        jobs = list(product(clips, [config], range(args.seeds), [args.regressions]))
        with ProcessPoolExecutor(args.jobs) as pool:
            found = np.array(list(pool.map(score, *zip(*jobs, strict=True))))
        table = found.reshape(len(clips), args.seeds, -1)
        print(f"\n| `{config}` | {' | '.join(names)} |\n|---|{'---|' * len(names)}")
        for clip, runs in zip(clips, table, strict=True):
            print(line(clip.name, runs))
        print(line("mean", np.nanmean(table, axis=0)), flush=True)


def line(name: str, runs: Array) -> str:
    """A row of the table: means and standard deviations over seeds."""
    both = zip(runs.mean(axis=0).tolist(), runs.std(axis=0).tolist(), strict=True)
    return f"| {name} | " + " | ".join(f"{mean:.3f} ± {std:.3f}" for mean, std in both) + " |"


if __name__ == "__main__":
    main()
