"""How often `facetrack suggest` takes the recipe that ground truth would take.

    python benchmarks/suggest.py clip.mp4 frames/ ... --json trials.json

Each clip has its ground truth beside it, as `<clip>.truth.csv` or `groundtruth.csv` in its folder. A track begins with
the first true box; recipes are tried on the frames after it as suggest does, and tracked over the whole clip, of which
success AUC is the measure. A pick is good if its AUC is within .02 of the best one's. "always" is what one recipe for
every clip would give. With --search it begins with the face that is found, as suggest does without --box, and tries
`face` too.
"""

import argparse
import json
import sys
from dataclasses import asdict
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from facetrack_cli.core.geometry import iou
from facetrack_cli.core.types import Start, TargetStart
from facetrack_cli.evaluation.experiments.suggest import ANY, FACE, NO_SKIN, _tracked, is_grey, piece, suggest
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.seeds import variant
from facetrack_cli.runs.start import Begin, completed, frames_of
from facetrack_cli.trajectory.formats.read import read_truth

NEAR = 0.02  # of success AUC


def truth_of(clip: Path) -> dict[int, Any]:
    beside = [clip.with_suffix(".truth.csv"), clip.parent / "groundtruth.csv"]
    path = next(one for one in beside if one.exists())
    part = next(one for one in read_truth(path).parts if np.isfinite(one.boxes).all(axis=1).any())
    known = np.isfinite(part.boxes).all(axis=1) & ~np.isin(part.status, ("lost", "absent"))
    return dict(zip(part.frame[known].tolist(), part.boxes[known], strict=True))


def ways(search: bool) -> tuple[str, ...]:
    return FACE if search else ANY


def measured(clip: Path, most: int, *, search: bool) -> dict[str, Any]:
    truth = truth_of(clip)
    first = min(truth)
    begin, start = Begin(clip), Start(first, {"face": TargetStart(tuple(truth[first].tolist()))}, "truth")
    if search:
        begin = Begin(clip, init_frame=first)
        start = begin.find(load_recipe(FACE[0]))
        first = start.frame
    frames = piece(begin, start)
    # the first one of these is the default
    names = [f"{one}:{NO_SKIN}" if one == "skin_ncc_robust" and is_grey(frames[0]) else one for one in ways(search)]
    recipes = [(name, load_recipe(*variant(name))) for name in names]
    trials = {one.recipe.partition(":")[0]: one for one in suggest(recipes, frames, start, str(clip))}
    aucs = {}
    for name, recipe in recipes:
        own = completed(recipe, start, lambda: frames[0], str(clip))
        with begin.open(first) as source:
            whole = list(islice(frames_of(source, first, "truth"), most))
        boxes = _tracked(recipe, own, whole).boxes
        pairs = [(boxes[t - first], box) for t, box in truth.items() if 0 <= t - first < len(boxes)]
        ours, theirs = np.array(pairs).transpose(1, 0, 2)
        overlap = np.nan_to_num(iou(ours, theirs))
        aucs[name.partition(":")[0]] = float(np.mean([(overlap > t).mean() for t in np.linspace(0, 1, 21)]))
    return {name: {**asdict(one), "score": one.score, "auc": aucs[name]} for name, one in trials.items()}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="+", type=Path)
    parser.add_argument("--most", type=int, default=500, help="frames of a clip, which are kept in memory")
    parser.add_argument("--search", action="store_true", help="begin with the face that is found, and try face too")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    found = {}
    for clip in args.clips:
        found[str(clip)] = rows = measured(clip, args.most, search=args.search)
        said = ", ".join(f"{name} {one['score']:.2f} -> {one['auc']:.3f}" for name, one in rows.items())
        print(f"{clip}: {said}", flush=True)
        if args.json:
            args.json.write_text(json.dumps(found, indent=1))
    best = np.array([max(one["auc"] for one in rows.values()) for rows in found.values()])
    means = {"suggest": [next(iter(rows.values()))["auc"] for rows in found.values()]}
    means |= {
        f"always {name}": [rows[name]["auc"] if name in rows else 0.0 for rows in found.values()]
        for name in ways(args.search)
    }
    for way, aucs in means.items():
        off = best - aucs
        mean = f"AUC {np.mean(aucs):.3f}, {off.mean():.3f} off the best"
        print(f"{way}: good in {(off <= NEAR).sum()} of {len(best)}, {mean}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
