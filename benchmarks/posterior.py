"""How far the posterior can be trusted, recipe by recipe: error, coverage, effective sample size, jitter.

    python benchmarks/posterior.py sample_videos/occlusion.mp4 sample_videos/expressions.mp4 \
        --config factorized --config factorized:filter.look_ahead=none,filter.particles=200 --seeds 10

A clip has its ground truth, and an init file or else the first frame of the truth, beside it; a folder that holds
groundtruth.csv and a video or img/ is one too. Figures are means over clips of the mean over seeds, with the standard
deviation over seeds of the mean over clips.

    error      mean error of visible points in % of the target's size; of boxes 1 - success AUC in %
    hidden     the same of hidden points; of boxes 1 - mean overlap
    50, 90 %   share of visible rows whose true centre is in the ellipse that should hold so many
    ESS        median effective sample size
    ECE        expected calibration error of `confidence`
    jitter     as `facetrack eval` has it, in pixels
    evidence   log evidence a frame, in nats

    python benchmarks/posterior.py CLIP... --config sir:motion.sigma=.05 --config sir:motion.sigma=.1 --pairs

--pairs counts, over clips and pairs of configs whose errors differ by more than their spread, how often the one with
the greater evidence has the smaller error. It says something of settings of motion, prior and filter alone.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
from boxes import clip_in

from facetrack_cli.core.types import Array, Start, TargetStart
from facetrack_cli.evaluation.compare import default_truth
from facetrack_cli.evaluation.match import match
from facetrack_cli.evaluation.summary import evaluate
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.clip import rows_of
from facetrack_cli.runs.plan import Job, resolve, truth_start
from facetrack_cli.runs.seeds import variant
from facetrack_cli.runs.signals import Stop
from facetrack_cli.trajectory.formats.read import read_truth

COLUMNS = ("error %", "hidden %", "50 %", "90 %", "ESS", "ECE", "jitter px", "evidence")


def run(clip: Path, config: str, seed: int) -> Array:
    """The figures of COLUMNS, nan where a clip has none."""
    cv2.setNumThreads(1)
    name, overrides = variant(config)
    recipe = load_recipe(name, overrides).model_copy(update={"seed": seed})
    truth = read_truth(default_truth(clip))
    init = clip.with_name(f"{clip.stem}.init.yaml")
    begin: Path | Start = init
    if not init.exists():
        start = truth_start(truth, recipe.points)
        begin = Start(start.frame, {"face": TargetStart(next(iter(start.targets.values())).box)}, start.origin)
    job = Job(clip, recipe, None, video=False, init=begin)
    _, track = rows_of(resolve(job, kept=True), Stop())
    assert track is not None
    pairs = match(track, truth, partial=True, select=None)
    found = evaluate(pairs).all
    boxed, points, cover, trusted = found.boxes, found.points, found.coverage, found.confidence
    if boxed is not None and points is None:
        error, hidden = (
            1 - (boxed.success_auc or 0.0),
            None if boxed.hidden_overlap is None else 1 - boxed.hidden_overlap,
        )
    else:
        assert points is not None and points.mean_px is not None and points.mean_normalised is not None
        unit = points.mean_px / points.mean_normalised
        error, hidden = points.mean_normalised, None if points.hidden_mean_px is None else points.hidden_mean_px / unit
    evidence = np.concatenate([np.empty(0), *(one.get("evidence") for one in track.diagnostics.values())])
    values = (
        100 * error,
        None if hidden is None else 100 * hidden,
        None if cover is None or cover.within_50 is None else 100 * cover.within_50,
        None if cover is None or cover.within_90 is None else 100 * cover.within_90,
        float(np.nanmedian(track.ess)),
        None if trusted is None else trusted.ece,
        None if found.jitter is None else found.jitter.median_px,
        float(np.nanmean(evidence)) if np.isfinite(evidence).any() else None,
    )
    return np.array([np.nan if value is None else value for value in values])


def table(clips: Sequence[Path], configs: Sequence[str], seeds: int, jobs: int, each: bool) -> Array:
    """Prints a line for each config, and returns the figures (configs, clips, seeds, columns)."""
    every = []
    print(f"| | {' | '.join(COLUMNS)} |\n{'|---' * (len(COLUMNS) + 1)}|", flush=True)
    with ProcessPoolExecutor(jobs) as pool:
        waiting = {
            config: [[pool.submit(run, clip, config, seed) for seed in range(seeds)] for clip in clips]
            for config in configs
        }
        for config, of_clips in waiting.items():
            runs = np.array([[one.result() for one in of_clip] for of_clip in of_clips])  # (clips, seeds, columns)
            every.append(runs)
            if each:
                for clip, figures in zip(clips, runs, strict=True):
                    print(f"| {config}, {clip.stem} | {' | '.join(cells(figures))} |", flush=True)
            print(f"| **{config}** | {' | '.join(cells(_mean(runs, 0)))} |", flush=True)
    return np.array(every)


def picked(figures: Array) -> tuple[int, int]:
    """Pairs of configs and clips whose errors differ clearly, and those in which the evidence picks the better one."""
    error, evidence = figures[..., 0], figures[..., COLUMNS.index("evidence")].mean(axis=2)
    mean, spread = error.mean(axis=2), error.std(axis=2)
    clear = right = 0
    for i, j in combinations(range(len(figures)), 2):
        apart = np.abs(mean[i] - mean[j]) > 2 * np.hypot(spread[i], spread[j])
        clear += int(apart.sum())
        right += int(np.sum(apart & ((mean[i] < mean[j]) == (evidence[i] > evidence[j]))))
    return clear, right


def cells(figures: Array) -> list[str]:
    """Mean and standard deviation of figures (seeds, columns)."""
    means, spreads = _mean(figures, 0), np.nan_to_num(np.nanstd(figures, axis=0))
    return [f"{m:.3g} ± {s:.2g}" if np.isfinite(m) else "" for m, s in zip(means, spreads, strict=True)]


def _mean(values: Array, axis: int) -> Array:
    known = np.isfinite(values)
    return np.where(known.any(axis), np.where(known, values, 0).sum(axis) / np.maximum(known.sum(axis), 1), np.nan)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="+", type=Path)
    parser.add_argument("--config", action="append", required=True, metavar="RECIPE[:KEY=VALUE,...]")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--each", action="store_true", help="a line for each clip too")
    parser.add_argument("--pairs", action="store_true", help="how often the evidence picks the better config")
    parser.add_argument("-j", "--jobs", type=int, default=2)
    given = parser.parse_args()
    figures = table([clip_in(clip) for clip in given.clips], given.config, given.seeds, given.jobs, given.each)
    if given.pairs:
        clear, right = picked(figures)
        print(f"the evidence picks the better one in {right} of {clear} pairs")


if __name__ == "__main__":
    main()
