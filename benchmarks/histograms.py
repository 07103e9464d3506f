"""What colour histograms of many boxes take, as ratios to what OpenCV takes to decode the frame, within one run.

    python benchmarks/histograms.py

Boxes of 80x80 pixels at 640x480, scattered as a tracker's particles are: `spread` is the standard deviation of their
places over the box's side, that of their scales is 0.05. `as chosen` is `Histogram.score` whole: cutting out, HSV,
binning, counting and comparing; the other two are the same with either way of counting forced. The reference is a face,
or noise, which uses every bin there is: no target can cost more.
To reach: less than 0.25 of decoding with 200 boxes and the recipes' 8x4 bins.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import numpy as np
from speed import best, decode, enlarged, report

from facetrack_cli.core.types import Array, Frame
from facetrack_cli.trackers.regions import histogram_kernels as kernel
from facetrack_cli.trackers.regions import settings as regions
from facetrack_cli.trackers.regions.histogram import Histogram, Reference
from facetrack_cli.video.source import open_source

SIDE = 80.0
FRAMES = 60
COUNTS = (100, 200, 2000)
SETTINGS = regions.Histogram(hue_bins=8, saturation_bins=4, regions=(3, 3), lambda_h=20.0, max_size=None)
RECIPE = Histogram(SETTINGS, (SIDE, SIDE))
FINE = SETTINGS.model_copy(update={"hue_bins": 10, "saturation_bins": 10, "value_bins": 10})
LARGER = Histogram(FINE, (SIDE, SIDE))
CASES = [
    ("8x4 bins in 3x3", RECIPE, "face"),
    ("8x4 bins in 3x3", RECIPE, "noise"),
    ("8x4 bins in 1x1", Histogram(SETTINGS.model_copy(update={"regions": (1, 1)}), (SIDE, SIDE)), "face"),
    ("10x10+10 bins in 3x3", LARGER, "face"),
    ("10x10+10 bins in 3x3", LARGER, "noise"),
]


def scattered(centre: tuple[float, float], n: int, spread: float) -> Array:
    rng = np.random.default_rng(0)
    x = np.zeros((n, 1, 6))
    x[:, 0, :2] = np.array(centre) + rng.normal(0, spread * SIDE, (n, 2))
    x[:, 0, 2] = rng.normal(1, 0.05, n)
    return x


def scoring(
    likelihood: Histogram, learned: Reference, frames: list[Frame], x: Array, forced: str | None
) -> Callable[[], None]:
    def work() -> None:
        for frame in frames:
            likelihood.score(learned, frame, x)

    def work_forced() -> None:
        other = "match_direct" if forced == "match_integral" else "match_integral"
        with mock.patch.object(kernel, other, getattr(kernel, str(forced))):
            work()

    return work_forced if forced else work


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path, start = enlarged(Path(folder), FRAMES)
        with open_source(path) as source:
            frames = list(source)
        points = np.array([point for one in start.targets.values() for point in one.points.values()])
        centre = float(points[:, 0].mean()), float(points[:, 1].mean())

        print("over decoding a frame at 640x480:                                as chosen    direct  integral")
        reached = 0.0
        noise = np.random.default_rng(0).integers(0, 256, frames[0].bgr.shape, dtype=np.uint8)
        first = {"face": frames[0], "noise": Frame(0, 0.0, noise)}
        for name, likelihood, target in CASES:
            learned = likelihood.init(first[target], scattered(centre, 1, 0.0)[0])
            used = int(learned.root.any(axis=0).sum())
            for n in COUNTS:
                for spread in (0.1, 0.2):
                    x = scattered(centre, n, spread)
                    some = frames if n < 1000 else frames[:6]
                    works = [
                        scoring(likelihood, learned, some, x, forced)
                        for forced in (None, "match_direct", "match_integral")
                    ]
                    for work in works:
                        work()
                    *ours, decoding = best(*works, lambda: decode(path), times=7)
                    ratios = [taken / len(some) / (decoding / len(frames)) for taken in ours]
                    label = f"{name}, {target} ({used} used), {n} boxes, spread {spread}"
                    print(f"{label:62s}" + "".join(f"{ratio:12.3f}" for ratio in ratios), flush=True)
                    if n == 200 and likelihood is not LARGER:
                        reached = max(reached, ratios[0])
        report("histograms of 200 boxes / decoding, the worst", reached, "< 0.25", reached < 0.25)


if __name__ == "__main__":
    main()
