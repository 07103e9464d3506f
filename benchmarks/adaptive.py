"""Faces that are followed by adapting to them (Zhou et al. 2003): tables of docs/results.md, "Adaptive appearance".

    python benchmarks/adaptive.py --clips clips --table auc --table samples --table ablation --table trust
    python benchmarks/adaptive.py --clips clips --table auc --peers --seeds 3        # with opencv-contrib
    python benchmarks/adaptive.py --clips clips --table shift

Every tracker begins once, with the first true box, and is left alone; the seeds are 0 on. --clips is a folder with a
folder for each clip, which holds a video or images and groundtruth.csv; zoom and lamp are among the samples.

    auc       success AUC ± its standard deviation over seeds / precision at 20 px (runs that end lost: the median
              overlap of the last tenth of the frames is below 0.1), as OTB has them
    samples   of zoom and lamp besides: correlation and mean relative error of the scale with the true one, mean error
              of the angle in degrees, mean number of particles
    ablation  success AUC of steps, of parts left out and of parts added
    trust     of frames with an overlap below .2 and above .5 the share that is called lost, and the chance that one of
              the latter has more confidence than one of the former
    shift     mean distance in pixels of the true place from the last one, and from that predicted by eq. 12

An estimate is a parallelogram, most ground truth an upright box. For overlaps it counts as the upright box with its
centre and the lengths of its sides (--polygons: as it is).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import TypeAlias

import cv2
import numpy as np
from adaptive_runs import MADE, Run, clip_of, follow

from facetrack_cli.core.errors import FacetrackError
from facetrack_cli.core.types import Array
from facetrack_cli.engine.target import ParticleTarget
from facetrack_cli.evaluation.compare import default_truth
from facetrack_cli.evaluation.reliability import auroc
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.plan import ClipRequest
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.trackers.appearance.appearance import Appearance
from facetrack_cli.trackers.appearance.velocity import PredictedWalk
from facetrack_cli.trajectory.formats.read import read_truth
from facetrack_cli.video.source import open_source

REAL = ("david", "girl", "jumping", "albert_brooks", "alek_wek_1", "alek_wek_4")
STEPS = ("fixed_template", "adaptive_appearance", "adaptive_velocity", "adaptive_noise", "adaptive", "adaptive_robust")
PEERS = ("csrt", "kcf", "mil", "mosse")
LESS = (
    "adaptive",
    "adaptive:motion.velocity=null",
    "adaptive_velocity",
    "adaptive:likelihood.mixing.w=0",
    "adaptive:likelihood.mixing.s=0",
    "adaptive:likelihood.mixing.f=0",
    "adaptive:motion.shear=null",
)
MORE = (
    "adaptive:motion.velocity.search=1",
    "adaptive:motion.velocity.towards=appearance",
    "adaptive:filter.centre=true",
    "adaptive:motion.shear=0",
    "adaptive:motion.turn=0.008",
    "adaptive:likelihood.outlier=0.1",
    "adaptive:likelihood.pixels=5,target.estimate=mean",
    "adaptive_robust",
    "adaptive_robust:motion.velocity.search=0",
    "adaptive_robust:motion.velocity.towards=last",
    "adaptive_robust:filter.centre=false",
    "adaptive_robust:motion.turn=null",
    "adaptive_robust:likelihood.outlier=null",
    "adaptive_robust:likelihood.pixels=null,target.estimate=map",
)


# --- tables ----------------------------------------------------------------------------------------------------------

Found: TypeAlias = "dict[tuple[str, str], list[Run]]"  # by clip and recipe


def auc_table(found: Found, clips: Sequence[str], configs: Sequence[str], polygons: bool) -> None:
    print(f"\n| | {' | '.join(clips)} | mean | particles |\n{'|---' * (len(clips) + 3)}|")
    for config in configs:
        cells, means = [], []
        for clip in clips:
            runs = found[clip, config]
            auc = np.array([run.polygon_auc() if polygons else run.auc for run in runs])
            near = float(np.mean([run.measures.precision_20 or 0.0 for run in runs]))
            spread = f" ± {auc.std(ddof=1):.3f}" if len(auc) > 1 else ""
            lost = sum(run.ends_lost for run in runs)
            cells.append(f"{auc.mean():.3f}{spread} / {near:.2f}" + (f" ({lost})" if lost else ""))
            means.append((auc.mean(), near, np.mean([run.particles[1:].mean() for run in runs])))
        auc_, near_, many = np.mean(means, axis=0)
        particles = f"{many:.0f}" if many > 0 else ""
        print(f"| `{config}` | {' | '.join(cells)} | {auc_:.3f} / {near_:.2f} | {particles} |", flush=True)


def samples_table(found: Found, configs: Sequence[str]) -> None:
    print("\n| | clip | AUC | of parallelograms | scale: correlation | relative error | angle, ° | particles |")
    print("|---" * 8 + "|")
    for config in configs:
        for clip in MADE:
            rows = []
            for run in found[clip, config]:
                true = run.truth[:, 2] / run.truth[0, 2]
                turn = (run.angle - run.true_angle + 180) % 360 - 180
                off, follows = np.abs(run.scale / true - 1).mean(), np.corrcoef(run.scale, true)[0, 1]
                rows.append((run.auc, run.polygon_auc(), follows, off, np.abs(turn).mean(), run.particles[1:].mean()))
            auc, polygon, follows, off, turned, many = np.mean(rows, axis=0)
            spread = np.std([row[0] for row in rows], ddof=1) if len(rows) > 1 else 0.0
            print(
                f"| `{config}` | {clip} | {auc:.3f} ± {spread:.3f} | {polygon:.3f} | {follows:.3f} "
                f"| {100 * off:.1f} % | {turned:.2f} | {many:.0f} |",
                flush=True,
            )


def ablation_table(found: Found, clips: Sequence[str], configs: Sequence[str]) -> None:
    print(f"\n| | {' | '.join(clips)} | mean | particles | end lost |\n{'|---' * (len(clips) + 4)}|")
    for config in configs:
        runs = [found[clip, config] for clip in clips]
        each = [np.mean([run.auc for run in those]) for those in runs]
        many = np.mean([np.mean([run.particles[1:].mean() for run in those]) for those in runs])
        lost = sum(run.ends_lost for those in runs for run in those)
        cells = [*(f"{auc:.3f}" for auc in each), f"**{np.mean(each):.3f}**", f"{many:.0f}"]
        print(f"| `{config}` | {' | '.join(cells)} | {lost}/{sum(map(len, runs))} |", flush=True)


def trust_table(found: Found, clips: Sequence[str], configs: Sequence[str]) -> None:
    print("\n| | off: overlap below .2 | of these called lost | of those on, above .5, called lost | AUROC |")
    print("|---" * 5 + "|")
    for config in configs:
        runs = [run for clip in clips for run in found[clip, config]]
        known = [np.isfinite(run.truth[:, 0]) & (np.arange(len(run.frame)) > 0) for run in runs]
        of = np.concatenate([run.measures.overlap[rows] for run, rows in zip(runs, known, strict=True)])
        lost = np.concatenate([run.lost[rows] for run, rows in zip(runs, known, strict=True)])
        sure = np.concatenate([run.confidence[rows] for run, rows in zip(runs, known, strict=True)])
        off, on = of < 0.2, of > 0.5
        worth = auroc(sure[on | off], on[on | off])
        print(
            f"| `{config}` | {100 * off.mean():.1f} % | {100 * lost[off].mean() if off.any() else np.nan:.0f} % "
            f"| {100 * lost[on].mean():.1f} % | {np.nan if worth is None else worth:.2f} |",
            flush=True,
        )


def shift_row(clip: Path, config: str) -> list[float]:
    """Mean distance of the true place from the last one, and from it by one step of eq. 12 with the printed sign, by
    one step with ours, and by all of its steps. In every frame all begins again at the ground truth of the last one.
    """
    cv2.setNumThreads(1)
    truth = read_truth(default_truth(clip))
    recipe = load_recipe(config)
    start = ClipRequest(clip).find(recipe, truth)
    (target,) = build_tracker(recipe, start)
    assert isinstance(target, ParticleTarget)
    motion, model = target.motion, target.likelihood
    assert isinstance(motion, PredictedWalk) and isinstance(model, Appearance)
    (one,) = truth.parts
    places = dict(
        zip(one.frame.tolist(), np.stack([one.x, one.y, one.w, one.h, np.nan_to_num(one.angle)], 1), strict=True)
    )
    rng, last = np.random.default_rng(0), None
    rows: list[list[float]] = []
    first = places[start.frame]

    def state(frame: int) -> Array:
        x, y, w, h, angle = places[frame]
        c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        a, b = w / first[2], h / first[3]
        return np.array([[x, y, c * a, -s * b, s * a, c * b]])

    with open_source(clip, start=start.frame) as source:
        for frame in source:
            if last is not None and frame.index in places and last.index in places:
                here, there = state(last.index), state(frame.index)[0, :2]
                mixture = model.init(last, here)
                flow = motion.begin(rng, last, here)
                patch = motion.patches.read(frame, here[None], motion.patches.factor(here))[0]
                step = (flow.gain @ (flow.rows @ (patch - flow.patch))[:, None])[:2, 0]
                ahead = motion.predict(flow, frame, partial(model.error, mixture), partial(model.expected, mixture))
                guesses = (np.zeros(2), step, -step, ahead.shift[0, :2])
                rows.append([float(np.linalg.norm(there - here[0, :2] - guess)) for guess in guesses])
            last = frame
    found: list[float] = np.mean(rows, axis=0).tolist()
    return found


def shift_table(clips: Sequence[str], folder: Path | None, configs: Sequence[str]) -> None:
    print("\n| | clip | where it was | one step, sign as printed | one step | all steps |")
    print("|---" * 6 + "|")
    for config in configs:
        for clip in clips:
            cells = " | ".join(f"{value:.2f}" for value in shift_row(clip_of(clip, folder), config))
            print(f"| `{config}` | {clip} | {cells} |", flush=True)


def run_all(clips: Sequence[str], folder: Path | None, configs: Sequence[str], given: argparse.Namespace) -> Found:
    found: Found = {}
    todo = [(clip, config) for clip in clips for config in dict.fromkeys(configs)]
    with ProcessPoolExecutor(given.jobs) as pool:
        each = [pool.submit(follow, clip_of(clip, folder), config, given.seeds) for clip, config in todo]
        for (clip, config), one in zip(todo, each, strict=True):
            found[clip, config] = one.result()
            print(f"{config}, {clip}: done", file=sys.stderr, flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=Path, metavar="FOLDER", help="default: zoom and lamp alone")
    parser.add_argument("--only", action="append", metavar="CLIP")
    parser.add_argument("--table", action="append", choices=("auc", "samples", "ablation", "trust", "shift"))
    parser.add_argument("--config", action="append", help="in place of the recipes of each table")
    parser.add_argument("--peers", action="store_true", help="OpenCV's trackers in place of ours")
    parser.add_argument("--polygons", action="store_true")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("-j", dest="jobs", type=int, default=2)
    given = parser.parse_args()
    tables = given.table or ["auc"]
    clips = given.only or ([*REAL, *MADE] if given.clips else list(MADE))
    main_ = given.config or list(PEERS if given.peers else STEPS)
    ablation = given.config or [*LESS, *MORE]
    wanted = [*main_ * bool({"auc", "samples", "trust"} & set(tables)), *ablation * ("ablation" in tables)]
    if "shift" in tables:
        shift_table(clips, given.clips, given.config or ["adaptive", "adaptive_robust"])
    found = run_all(clips, given.clips, wanted, given)
    if "auc" in tables:
        auc_table(found, clips, main_, given.polygons)
    if "samples" in tables:
        samples_table(found, main_)
    if "ablation" in tables:
        ablation_table(found, clips, ablation)
    if "trust" in tables:
        trust_table(found, clips, main_)


if __name__ == "__main__":
    try:
        main()
    except FacetrackError as e:
        raise SystemExit(str(e)) from None
