"""Whether `facetrack regress` sees what it should, and nothing else: the table in docs/regress.md.

    python benchmarks/bands.py sample_videos -j 2

For each golden, groups of as many seeds as a check runs, none of which was recorded or is used by a check:

- unseen seeds of the recipe as it is must pass, also with noise of one grey level on every frame, as another decoder
  may give;
- `motion.sigma` and `likelihood.sigma` changed by 30 % must fail, and so must a likelihood that scores x + (1.5, 0).

A cell tells how many groups failed, and the farthest statistic in units of its band: the largest of groups that must
pass, the smallest of those that must fail.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from facetrack_cli.core.types import BOX, Array, Frame, Particles
from facetrack_cli.engine.loop import Tracker, track
from facetrack_cli.engine.protocols import Likelihood
from facetrack_cli.engine.target import ParticleTarget
from facetrack_cli.evaluation.goldens.bands import judge, measure
from facetrack_cli.evaluation.goldens.goldens import Golden, find_goldens, read_golden
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.recipe.model import ParticleRecipe
from facetrack_cli.recipe.shared import RandomWalk
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.trackers.points.settings import ColourRatio
from facetrack_cli.trackers.regions.settings import FirstOrder, Product
from facetrack_cli.trackers.skin.settings import SkinNcc
from facetrack_cli.trajectory.trajectory import Collector
from facetrack_cli.video.source import open_source

FIRST_SEED = 20_000
SHIFT = 1.5  # pixels


class Case(NamedTuple):
    """What is disturbed: factors of the two sigmas, the shift of the likelihood, noise in grey levels."""

    name: str
    must_fail: bool
    motion: float = 1.0
    likelihood: float = 1.0
    shift: bool = False
    noise: int = 0


CASES = (
    Case("unseen seeds", False),
    Case("noise of 1", False, noise=1),
    Case("motion -30 %", True, motion=0.7),
    Case("motion +30 %", True, motion=1.3),
    Case("likelihood -30 %", True, likelihood=0.7),
    Case("likelihood +30 %", True, likelihood=1.3),
    Case("shift 1.5 px", True, shift=True),
)


@dataclass(frozen=True)
class Shifted(Likelihood):
    """A likelihood that looks 1.5 pixels to the right of where it is asked to."""

    within: Likelihood

    def init(self, frame: Frame, x0: Array) -> Any:
        return self.within.init(frame, x0)

    def score(self, learned: Any, frame: Frame, x: Array, parents: Array) -> Array:
        return self.within.score(learned, frame, _shifted(x), parents)

    def learn(self, learned: Any, frame: Frame, state: Array, particles: Particles) -> Any:
        return self.within.learn(learned, frame, state, particles)

    def distances(self, learned: Any, frame: Frame, x: Array) -> Array:
        return self.within.distances(learned, frame, _shifted(x))


def _shifted(x: Array) -> Array:
    moved = x.copy()
    moved[..., 0] += SHIFT
    return moved


def _changes(recipe: ParticleRecipe, case: Case) -> list[str]:
    """The overrides that disturb a recipe as the case says."""
    motion, likelihood = recipe.motion, recipe.likelihood
    found = []
    if case.motion != 1 and isinstance(motion, RandomWalk):
        found.append(f"motion.sigma={motion.sigma.of((recipe.points or (BOX,))[0]).value * case.motion:.6g}")
    if case.motion != 1 and isinstance(motion, FirstOrder):
        rows = [[length.value * case.motion for length in row] for row in motion.position.B]
        found.append(f"motion.position.B={rows}")
    if case.likelihood != 1 and isinstance(likelihood, ColourRatio | SkinNcc):
        found.append(f"likelihood.sigma={likelihood.sigma * case.likelihood:.6g}")
    if case.likelihood != 1 and isinstance(likelihood, Product):
        if likelihood.contour is not None:
            found.append(f"likelihood.contour.sigma={likelihood.contour.sigma.value * case.likelihood:.6g}")
        if likelihood.histogram is not None:
            found.append(f"likelihood.histogram.lambda_h={likelihood.histogram.lambda_h / case.likelihood:.6g}")
        if likelihood.correlation is not None:
            found.append(f"likelihood.correlation.sigma={likelihood.correlation.sigma * case.likelihood:.6g}")
    return found


def tracker_of(golden: Golden, case: Case) -> Tracker | None:
    """None where there is nothing to disturb."""
    recipe = load_recipe(golden.recipe)
    if isinstance(recipe, ParticleRecipe):
        recipe = load_recipe(golden.recipe, _changes(recipe, case))
    elif case.must_fail:
        return None
    tracker = build_tracker(recipe, golden.start.start_from("golden"))
    if not case.shift:
        return tracker
    return tuple(replace(t, likelihood=Shifted(t.likelihood)) if isinstance(t, ParticleTarget) else t for t in tracker)


def frames_of(clip: Path, golden: Golden, noise: int, seed: int) -> Iterator[Frame]:
    rng = np.random.default_rng(seed)
    with open_source(clip, start=golden.start.frame, stop=golden.stop) as source:
        for frame in source:
            if not noise:
                yield frame
                continue
            moved = frame.bgr.astype(np.int16) + rng.integers(-noise, noise + 1, frame.bgr.shape, dtype=np.int16)
            yield Frame(frame.index, frame.time_s, np.clip(moved, 0, 255).astype(np.uint8))


def one_run(folder: Path, path: Path, case: Case, seed: int) -> Array | None:
    """The statistics of one run, (1, F)."""
    cv2.setNumThreads(1)
    golden = read_golden(path)
    tracker = tracker_of(golden, case)
    if tracker is None:
        return None
    clip = folder / golden.clip.file
    results = track(tracker, frames_of(clip, golden, case.noise, seed), seed)
    collected = Collector()
    for result in results:
        collected.add(result.rows)
    table = collected.trajectory(path=clip)
    return measure([table], [band.statistic for band in golden.bands], golden.names)


def cell(golden: Golden, case: Case, runs: Array) -> tuple[str, int, bool]:
    """What to print, how many groups were judged, and whether they were as they must be."""
    k = golden.tested
    groups = [runs[i : i + k] for i in range(0, len(runs) - k + 1, k)]
    verdicts = [judge(golden.bands, group) for group in groups]
    failed = sum(bool(left) for _, left in verdicts)
    far = [farthest for farthest, _ in verdicts]
    told = min(far) if case.must_fail else max(far)
    return f"{failed}/{len(groups)} ({told:.2f})", len(groups), failed == (len(groups) if case.must_fail else 0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--groups", type=int, default=12, help="of unseen seeds; of each disturbance a quarter")
    parser.add_argument("--only", action="append", help="goldens whose file name has this in it; repeatable")
    parser.add_argument("-j", dest="jobs", type=int, default=2)
    given = parser.parse_args()
    print("| clip | recipe | seeds |" + "".join(f" {case.name} |" for case in CASES))
    print("|---" * (3 + len(CASES)) + "|")
    good, passed = True, 0
    with ProcessPoolExecutor(given.jobs) as pool:
        for path in find_goldens(given.folder):
            if given.only and not any(name in path.name for name in given.only):
                continue
            golden = read_golden(path)
            cells = []
            for case in CASES:
                count = golden.tested * (given.groups if case is CASES[0] else max(given.groups // 4, 1))
                seeds = range(FIRST_SEED, FIRST_SEED + count)
                runs = [r for r in pool.map(partial(one_run, given.folder, path, case), seeds) if r is not None]
                if not runs:
                    cells.append("")
                    continue
                text, groups, right = cell(golden, case, np.vstack(runs))
                cells.append(text)
                good &= right
                passed += 0 if case.must_fail else groups
            name, k = Path(golden.recipe).stem, golden.tested
            print(f"| {Path(golden.clip.file).stem} | {name} | {k} | " + " | ".join(cells) + " |", flush=True)
    print(f"\n{'as it must be' if good else 'NOT as it must be'}; {passed} groups that must pass")
    raise SystemExit(0 if good else 1)


if __name__ == "__main__":
    main()
