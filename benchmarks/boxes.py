"""How well recipes follow a box, and whether they know when it is hidden: docs/results.md.

    python benchmarks/boxes.py clips/*/ sample_videos/map.mp4 --config correlation_filter --config mil --seeds 10

A clip is a video with its ground truth beside it, or a folder that holds groundtruth.csv and a video or img/. Each
recipe begins with the first true box, once a seed. Settings are given as for `facetrack compare`, as in
`correlation_filter:likelihood.colour=0`. To compare with csrt, install opencv-contrib-python-headless.

    AUC        success AUC of visible frames, as OTB has it, with its standard deviation over seeds
    quarter    share of visible frames with a centre within a quarter of the true box along x and y
    off, lost  of frames with an overlap below .2, those called lost; on, lost: of visible ones above .5
    ECE        expected calibration error, ten bins, of `confidence` as the probability that the target is visible and
               the centre within half a box
    90 %       share of visible frames whose true centre is in the 90 % ellipse of std_x, std_y and cov_xy
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from reference import HANDS, MESH

from facetrack_cli.core.errors import FacetrackError
from facetrack_cli.core.types import Array, Mask, Start, TargetStart
from facetrack_cli.engine.loop import track
from facetrack_cli.evaluation.accuracy import ELLIPSE_90, calibration_error, mahalanobis_squared, measure_boxes
from facetrack_cli.evaluation.compare import default_truth
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.plan import truth_start
from facetrack_cli.runs.seeds import variant
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.trajectory.formats.boxes import read_truth
from facetrack_cli.trajectory.trajectory import Collector, Trajectory
from facetrack_cli.video.source import open_source


class Rows(NamedTuple):
    """Frames of one run after its first: overlap, error (T, 2) in boxes, whether visible, lost, and inside of 90 %."""

    auc: float
    overlap: Array
    error: Array
    visible: Mask
    lost: Mask
    confidence: Array
    inside: Mask


def clip_in(path: Path) -> Path:
    """The video or the images of a clip."""
    if not path.is_dir() or not any((path / name).exists() for name in ("groundtruth.csv", MESH, HANDS)):
        return path
    videos = [one for one in sorted(path.iterdir()) if one.is_file() and one.suffix not in (".csv", ".txt")]
    return videos[0] if videos else path / "img"


def truth_of(clip: Path) -> Trajectory:
    """The ground truth of the first target that is a face, or else of the first."""
    whole = read_truth(default_truth(clip))
    return next((one for one in whole.parts if one.target == "face"), whole.parts[0])


def run(clip: Path, config: str, seed: int) -> Rows:
    cv2.setNumThreads(1)
    truth = truth_of(clip)
    name, overrides = variant(config)
    start = truth_start(truth, ())
    target = next(iter(start.targets))
    start = Start(start.frame, {"face": TargetStart(start.targets[target].box)}, start.origin)
    collected = Collector()
    with open_source(clip, start=start.frame) as source:
        for result in track(build_tracker(load_recipe(name, overrides), start), iter(source), seed):
            collected.add(result.rows)
    ours = collected.trajectory()
    _, mine, theirs = np.intersect1d(ours.frame, truth.frame, return_indices=True)
    ours, true = ours.take(mine[1:]), truth.take(theirs[1:])
    visible = true.status != "hidden"
    found = measure_boxes(ours.boxes, true.boxes, visible=visible)
    every = measure_boxes(ours.boxes, true.boxes, visible=np.ones(len(visible), np.bool_))
    off = np.stack([ours.x - true.x, ours.y - true.y], axis=1)
    std = np.stack([ours.std_x, ours.std_y], axis=1)
    return Rows(
        auc=float(found.success_auc or 0.0),
        overlap=every.overlap,
        error=np.abs(off) / true.boxes[:, 2:],
        visible=visible,
        lost=ours.status == "lost",
        confidence=ours.confidence,
        inside=mahalanobis_squared(off, std, np.nan_to_num(ours.cov_xy)) <= ELLIPSE_90,
    )


def table(clips: Sequence[Path], configs: Sequence[str], seeds: int, jobs: int) -> None:
    columns = [*(name(clip) for clip in clips), "mean", "quarter", "off, lost", "on, lost", "ECE", "90 %"]
    print(f"| | {' | '.join(columns)} |\n{'|---' * (len(columns) + 1)}|")
    with ProcessPoolExecutor(jobs) as pool:
        waiting = [
            (config, [[pool.submit(run, clip, config, seed) for seed in each(config, seeds)] for clip in clips])
            for config in configs
        ]
        for config, of_clips in waiting:
            runs = [[one.result() for one in of_clip] for of_clip in of_clips]
            auc = [np.array([one.auc for one in of_clip]) for of_clip in runs]
            cells = [f"{one.mean():.3f} ± {one.std():.3f}" for one in auc]
            whole = np.mean(auc, axis=0)
            near = np.mean([[quarter(one) for one in of_clip] for of_clip in runs])
            cells += [
                f"{whole.mean():.3f} ± {whole.std():.3f}",
                f"{near:.3f}",
                *trust([one for of in runs for one in of]),
            ]
            print(f"| `{config}` | {' | '.join(cells)} |", flush=True)


def quarter(one: Rows) -> float:
    return float(np.mean(np.all(one.error[one.visible] <= 0.25, axis=1)))


def each(config: str, seeds: int) -> range:
    """The seeds of a recipe: one of what does not draw at random."""
    return range(seeds if load_recipe(*variant(config)).random else 1)


def trust(runs: Sequence[Rows]) -> Iterator[str]:
    """Cells of `lost`, calibration and coverage."""
    overlap, visible, lost, confidence, inside = (
        np.concatenate([getattr(one, key) for one in runs])
        for key in ("overlap", "visible", "lost", "confidence", "inside")
    )
    error = np.concatenate([one.error for one in runs])
    off, on = overlap < 0.2, (overlap > 0.5) & visible
    yield f"{lost[off].mean():.3f} ({off.mean():.3f} of all)" if off.any() else "–"
    yield f"{lost[on].mean():.3f}"
    near = visible & (error <= 0.5).all(axis=1)
    if not np.isfinite(confidence).all():
        yield from ("–", "–")
        return
    yield f"{calibration_error(confidence, near):.3f}"
    yield f"{inside[visible].mean():.3f}"


def name(clip: Path) -> str:
    return clip.parent.name if clip.name == "img" or (clip.parent / "groundtruth.csv").exists() else clip.stem


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="+", type=Path)
    parser.add_argument("--config", action="append", required=True)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("-j", dest="jobs", type=int, default=2)
    given = parser.parse_args()
    table([clip_in(path) for path in given.clips], given.config, given.seeds, given.jobs)


if __name__ == "__main__":
    try:
        main()
    except FacetrackError as e:
        raise SystemExit(str(e)) from None
