"""Runs that are killed at random moments and go on, and what their checkpoints cost.

python benchmarks/resume.py [--kills 100] [--seed 0]      # ten recipes, each compared with a run that nothing ended
python benchmarks/resume.py --cost 8                      # CPU time with checkpoints over that without, in pairs
"""

from __future__ import annotations

import argparse
import random
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

SAMPLES = Path(__file__).parents[1] / "sample_videos"
RECIPES = ["factorized", "independent", "face", "correlation_filter", "adaptive_robust", "head_hands"]
RECIPES += ["skin_ncc_robust", "contour_histogram_correlation", "auxiliary_prior", "adaptive_recognition"]
CLIPS = {"head_hands": "signing", "adaptive_recognition": "map"}
OFTEN = 20  # frames between two checkpoints, in place of 1,000


def command(every: int, *words: str | Path) -> list[str]:
    code = f"from facetrack_cli.runs import record as c; c.EVERY_FRAMES = {every}; "
    code += "c.EVERY_S = 1e9; import sys; from facetrack_cli.__main__ import main; sys.exit(main())"
    return [sys.executable, "-c", code, "run", *map(str, words), "-q"]


def same(folder: Path, other: Path) -> bool:
    names = sorted(path.name for path in folder.iterdir())
    if names != sorted(path.name for path in other.iterdir()):
        return False
    tables = [name for name in names if name.startswith("trajectory")]
    return all((folder / name).read_bytes() == (other / name).read_bytes() for name in tables)


def killed(recipe: str, kills: int, rng: random.Random, folder: Path) -> tuple[int, int]:
    """Runs of a recipe, each killed twice: how many there were, and how many differ from one that nothing ended."""
    words: list[str | Path] = [SAMPLES / f"{CLIPS.get(recipe, 'expressions')}.mp4", "--config", recipe, "--stop", "160"]
    if recipe == "adaptive_recognition":
        words += ["--gallery", SAMPLES / "people.npz"]
    whole = folder / recipe
    subprocess.run(command(OFTEN, *words, "-o", whole), check=True)
    began = time.monotonic()
    subprocess.run(command(OFTEN, *words, "-o", whole, "--overwrite"), check=True)
    length = time.monotonic() - began
    runs = different = done = 0
    while done < kills:
        out = folder / f"{recipe}-{runs}"
        for _ in range(2):
            child = subprocess.Popen(command(OFTEN, *words, "-o", out))
            time.sleep(rng.uniform(0.2, 1.0) * length)
            done += child.poll() is None
            child.kill()
            child.wait()
        subprocess.run(command(OFTEN, *words, "-o", out), check=True)
        runs += 1
        different += not same(out, whole)
    return done, different


def cost(pairs: int, folder: Path) -> list[float]:
    """CPU time of a run with a checkpoint every 250 frames, over one without any, in alternation."""

    def cpu(every: int, name: str) -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        words: list[str | Path] = [
            SAMPLES / "expressions.mp4",
            "--config",
            "factorized",
            "-o",
            folder / name,
            "--overwrite",
        ]
        subprocess.run(command(every, *words), check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    cpu(10**9, "warm")
    return [cpu(250, "with") / cpu(10**9, "without") for _ in range(pairs)]


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cost", type=int, default=0, metavar="PAIRS")
    given = parser.parse_args(arguments)
    rng = random.Random(given.seed)
    with tempfile.TemporaryDirectory() as name:
        if given.cost:
            ratios = cost(given.cost, Path(name))
            mean, spread = statistics.mean(ratios), statistics.stdev(ratios)
            print(f"CPU time with checkpoints over without: {mean:.3f} +- {spread:.3f}")
            return
        kills = bad = 0
        for recipe in RECIPES:
            done, different = killed(recipe, -(-given.kills // len(RECIPES)), rng, Path(name))
            kills, bad = kills + done, bad + different
            print(f"{recipe}: {done} kills, {different} results that differ", flush=True)
        print(f"in all {kills} kills, {bad} results that differ")


if __name__ == "__main__":
    main()
