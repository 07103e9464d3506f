"""What each factor of a region recipe says of the target's true motion, and of the motion that correlation likes best.

    python benchmarks/region_terms.py sample_videos/textured.mp4 119 122 125 128 131 134 137 140 \
        --config contour_histogram_correlation --config contour_histogram_correlation_robust
    python benchmarks/region_terms.py sample_videos/hands.mp4 102 104 106 108 110 --target right_hand \
        --config histogram_correlation

A parent lies on the true box of the frame before; children, of the true scale, lie at every whole pixel within 20 of
the true place. Printed of each recipe: how far beside the ground truth correlation's best child lies, and by how much
it has more log-likelihood there than at the ground truth, for correlation and for the other factors of the recipe.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path

import numpy as np

from facetrack_cli.core.types import Frame, Particles
from facetrack_cli.engine.resampling import uniform
from facetrack_cli.engine.target import ParticleTarget
from facetrack_cli.evaluation.compare import default_truth
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.plan import ClipRequest
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.trackers.regions.product import Product
from facetrack_cli.trajectory.formats.read import read_truth
from facetrack_cli.video.source import open_source

REACH = 20


def target_of(recipe: str, clip: Path, name: str) -> ParticleTarget:
    """The target of that name, as the recipe follows it in the clip."""
    loaded = load_recipe(recipe)
    start = ClipRequest(clip).find(loaded, read_truth(default_truth(clip)))
    found = next(one for one in build_tracker(loaded, start) if one.name == name)
    assert isinstance(found, ParticleTarget)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clip", type=Path)
    parser.add_argument("frames", type=int, nargs="+")
    parser.add_argument("--config", action="append", required=True)
    parser.add_argument("--target", help="default: the first")
    given = parser.parse_args()
    parts = read_truth(default_truth(given.clip)).parts
    truth = next(one for one in parts if given.target in (None, one.target))
    frames: dict[int, Frame] = {}
    with open_source(given.clip) as source:
        for frame in source:
            if not frames or {frame.index, frame.index + 1} & set(given.frames):
                frames[frame.index] = frame
    print("| frame | true motion | recipe | its best, beside the truth | more log-likelihood there |")
    print("|---|---|---|---|---|")
    steps = np.arange(-REACH, REACH + 1.0)
    for number, recipe in itertools.product(given.frames, given.config):
        target = target_of(recipe, given.clip, truth.target)
        likelihood = target.likelihood
        assert isinstance(likelihood, Product)
        x, y, scale = truth.x, truth.y, truth.w / truth.w[0]
        children = np.zeros((len(steps) ** 2, 1, 6))
        children[:, 0, 0] = np.repeat(x[number] + steps, len(steps))
        children[:, 0, 1] = np.tile(y[number] + steps, len(steps))
        children[:, 0, 2] = scale[number]
        parents = np.zeros_like(children)
        parents[:, 0, :3] = x[number - 1], y[number - 1], scale[number - 1]
        cloud = Particles(parents, uniform(len(parents)))
        first = likelihood.init(frames[0], target.x0)
        known = likelihood.learn(first, frames[number - 1], target.x0, cloud)
        scores = {
            type(factor).__name__: factor.score(one, frames[number], children, parents)[:, 0]
            for factor, one in zip(likelihood.factors, known, strict=True)
        }
        correlation = scores["Correlation"]
        best, true = int(correlation.argmax()), len(children) // 2
        beside = children[best, 0, :2] - children[true, 0, :2]
        cells = [f"{number}", f"{x[number] - x[number - 1]:+.1f}, {y[number] - y[number - 1]:+.1f}", recipe]
        cells.append(f"{beside[0]:+.0f}, {beside[1]:+.0f}")
        cells.append(", ".join(f"{name} {one[best] - one[true]:+.1f}" for name, one in sorted(scores.items())))
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
