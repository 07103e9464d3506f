"""Fits a calibration of confidence for each shipped recipe: configs/calibration/<recipe>.json.

    python tools/calibrations.py                                     # what is not there yet
    python tools/calibrations.py --again --config factorized --config face
    FACETRACK_CLIPS=../clips python tools/calibrations.py -j 2       # with the real clips in that folder
    FACETRACK_CLIPS=../clips python tools/calibrations.py --again --config face --regressions left_out

Each recipe is fitted to the sample clips that it has goldens of, to the videos of --clips that have a .truth.csv and an
init file beside them, and to the real clips of $FACETRACK_CLIPS: folders with a groundtruth.csv of a box and a video or
images, whose points are those of reference_points.csv (benchmarks/face.py); and people/*/ with mesh.csv
(benchmarks/expressions.py), whose tracks begin as a search finds them. The shipped files were fitted with twelve
rendered clips in --clips. `--regressions` is a folder of regressions without a clip each (tools/mouth_descent.py).
For each recipe it prints the calibration error and Brier score on clips left out, raw and calibrated. Recipes that have
a file are left as they are, so that it may be interrupted. Clips KIND-SEED.mp4 of one of the KINDS count as one clip. A
clip that a recipe cannot run on is named and left out, and so is a recipe with fewer than two clips.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import cv2

sys.path.insert(0, str(Path(__file__).parent.parent / "benchmarks"))

import calibration_fit
from boxes import clip_in
from reference import MESH, points_in, take_regression

from facetrack_cli.core.errors import FacetrackError
from facetrack_cli.core.models import shipped_recipes
from facetrack_cli.core.types import BOX
from facetrack_cli.evaluation.compare import default_truth
from facetrack_cli.evaluation.summary import clip_name
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.runs.api import track_video
from facetrack_cli.runs.plan import ClipRequest
from facetrack_cli.runs.seeds import load_recipes
from facetrack_cli.trajectory.formats.boxes import read_truth
from facetrack_cli.trajectory.trajectory import Trajectory

ROOT = Path(__file__).parent.parent
SAMPLES = ROOT / "sample_videos"
KINDS = ("object", "passer", "gestures")


def real(recipe: Recipe) -> list[Path]:
    """The real clips; of those with the points of a mesh there are no boxes."""
    folder = Path(os.environ.get("FACETRACK_CLIPS", os.devnull))
    kinds = "*/groundtruth.csv", *([f"people/*/{MESH}"] if recipe.points else [])
    return [clip_in(file.parent) for kind in kinds for file in sorted(folder.glob(kind))]


def clips_of(recipe: Recipe, more: Sequence[Path]) -> list[Path]:
    """The clips that the recipe is made for, and `more` clips of a face."""
    goldens = sorted((SAMPLES / "goldens").glob(f"*.{recipe.name}.json"))
    samples = [SAMPLES / f"{golden.name.partition('.')[0]}.mp4" for golden in goldens]
    return samples if len(recipe.followed) > 1 else [*more, *samples, *real(recipe)]


def truth_of(clip: Path, recipe: Recipe) -> Trajectory:
    """The ground truth of a clip, with the points of a mesh, or of another detector where it has boxes alone."""
    lines, points = ["frame,target,part,x,y,w,h"], clip.with_name(MESH)
    if not points.is_file():
        path = default_truth(clip)
        truth, points = read_truth(path), path.with_name("reference_points.csv")
        if not recipe.points or not points.is_file():
            return truth
        for frame, x, y, w, h in zip(truth.frame, truth.x, truth.y, truth.w, truth.h, strict=True):
            lines.append(f"{frame},face,{BOX},{x},{y},{w},{h}")
    for at, known in points_in(points).items():
        lines += [f"{at},face,{part},{x},{y},," for part, (x, y, _) in known.items()]
    with tempfile.TemporaryDirectory() as folder:
        both = Path(folder) / "truth.csv"
        both.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return read_truth(both)


def runs_of(clip: Path, recipe: Recipe, seeds: int, regressions: Path | None) -> tuple[list[Trajectory], Trajectory]:
    """Runs on a clip, one a seed, and its ground truth."""
    cv2.setNumThreads(1)
    real = regressions is not None and (regressions / f"without_{clip.parent.name}.npz").is_file()
    take_regression(regressions if real else None, clip.parent.name)
    truth = truth_of(clip, recipe)
    start = ClipRequest(clip).find(recipe, None if clip.with_name(MESH).is_file() else truth)
    numbers = range(seeds if recipe.random else 1)
    return [track_video(clip, recipe, init=start, seed=seed) for seed in numbers], truth


def fit(
    recipe: Recipe, clips: Sequence[Path], seeds: int, workers: int, regressions: Path | None
) -> calibration_fit.Calibrated:
    """The calibration by all clips that the recipe runs on. Raises InputError if it runs on none."""
    raw, found = calibration_fit.uncalibrated(recipe), {}
    with ProcessPoolExecutor(workers) as pool:
        ordered = sorted(clips, key=clip_name)  # their order must not show in the last digit
        waiting = {clip: pool.submit(runs_of, clip, raw, seeds, regressions) for clip in ordered}
        for clip, one in waiting.items():
            try:
                found[clip] = one.result()
            except FacetrackError as e:
                print(f"{recipe.name}: {clip.name} is left out: {e}", file=sys.stderr, flush=True)

    def kind_of(clip: Path) -> str:
        """Of a rendered clip the kind, or they outweigh real ones."""
        kind = clip.stem.rpartition("-")[0]
        return kind if kind in KINDS else str(clip)

    return calibration_fit.of_runs(recipe.name, found, seeds, kind_of)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=Path, help="folder of more clips, each with its ground truth and init file")
    parser.add_argument("--config", action="append", default=[], metavar="NAME", help="this recipe; repeatable")
    parser.add_argument("--seeds", type=int, default=1, help="runs of each clip [default: 1]")
    parser.add_argument("-j", "--jobs", type=int, default=1, help="processes")
    parser.add_argument("--regressions", type=Path, help="of face: without_NAME.npz for a clip in the folder NAME")
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "configs" / "calibration", help="folder of the files")
    parser.add_argument("--again", action="store_true", help="also those that have a file")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    more = (
        [] if args.clips is None else [one for one in sorted(args.clips.glob("*.mp4")) if default_truth(one).exists()]
    )
    print(f"{'recipe':<40} {'part':<6} clips right    raw: ECE Brier   calibrated: ECE Brier  map", flush=True)
    for path in shipped_recipes():
        file = args.out / f"{path.stem}.json"
        if (args.config and path.stem not in args.config) or (file.exists() and not args.again):
            continue
        gallery = str(SAMPLES / "people.npz") if "recognition" in path.stem else None
        began = time.monotonic()
        try:
            [recipe] = load_recipes([(str(path), ())], gallery)
            found = fit(recipe, clips_of(recipe, more), args.seeds, args.jobs, args.regressions)
        except FacetrackError as e:
            print(f"{path.stem}: no calibration: {e}", file=sys.stderr, flush=True)
            continue
        file.write_text(found.calibration.model_dump_json(indent=1) + "\n", encoding="utf-8")
        for kind, one in found.fitted.items():
            now, clips = SimpleNamespace(**one.checked), len(one.sample.clips)
            print(
                f"{path.stem:<40} {kind:<6} {clips:5} {now.right:5.2f} {now.ece_raw:11.3f} {now.brier_raw:5.3f} "
                f"{now.ece:17.3f} {now.brier:5.3f}   50 %: {now.within_50:.2f} 90 %: {now.within_90_raw:.2f} -> "
                f"{now.within_90:.2f}  {one.name} ({time.monotonic() - began:.0f} s)",
                flush=True,
            )


if __name__ == "__main__":
    main()
