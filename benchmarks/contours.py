"""The contour likelihood's time for a frame of 640x480, over the time that cv2 takes to decode it.

    python benchmarks/contours.py

A head of 80x100 pixels, 32 normals, particles scattered as by a tracker; ratios of least times within one run. Beside
it another way to find edges: gradients of the whole region by Sobel, of which each normal reads the nearest pixels.
That is not the same model (its edges lie on whole steps), so it is here for its speed alone.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from speed import best, decode, enlarged

from facetrack_cli.core.types import Array, Frame
from facetrack_cli.engine.kernels.compiled import exact
from facetrack_cli.recipe.sections import Length
from facetrack_cli.trackers.regions import settings as regions
from facetrack_cli.trackers.regions.contour import Contour
from facetrack_cli.video.source import open_source

FRAMES = 60
SIZE = (80.0, 100.0)
COUNTS = (100, 200, 2000)


@exact
def edges_of_gradients(gx: Any, gy: Any, x: Any, points: Any, normals: Any, n: int, threshold: float) -> Any:
    """As `nearest_edges`, from gradients (H, W) float32 read at the nearest pixel."""
    out = np.full((len(x), len(points)), np.inf)
    contrast = np.empty(2 * n + 3)
    height, width = gx.shape
    for p in range(len(x)):
        for k in range(len(points)):
            s, nx, ny = x[p, 2], normals[k, 0], normals[k, 1]
            px, py = x[p, 0] + s * points[k, 0] + 0.5, x[p, 1] + s * points[k, 1] + 0.5
            for j in range(2 * n + 3):
                ix, iy = px + (j - n - 1) * nx, py + (j - n - 1) * ny
                if ix >= 0 and iy >= 0 and ix < width and iy < height:
                    contrast[j] = abs(nx * gx[int(iy), int(ix)] + ny * gy[int(iy), int(ix)])
                else:
                    contrast[j] = np.nan
            for i in range(n + 1):
                found = False
                for j in (n + 1 + i, n + 1 - i):
                    found |= (
                        contrast[j] > threshold and contrast[j] > contrast[j - 1] and contrast[j] >= contrast[j + 1]
                    )
                if found:
                    out[p, k] = i
                    break
    return out


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path, start = enlarged(Path(folder), FRAMES)
        with open_source(path) as source:
            pictures = [frame.bgr for frame in source]
        (target,) = start.targets.values()
        centre = np.mean(list(target.points.values()), axis=0)
        unit = sum(SIZE) / 2
        settings = regions.Contour(sigma=Length(0.15), search=Length(0.25), threshold=20.0, outlier=0.3)
        reduced = Contour(settings, SIZE, 0.15 * unit, 0.25 * unit)
        whole = replace(reduced, settings=settings.model_copy(update={"max_size": None}))
        outline = whole.init(Frame(0, 0.0, pictures[0]), np.zeros((1, 6)))
        reach = min(whole.search, whole.sigma * math.sqrt(-2 * math.log(settings.outlier)))

        def particles(count: int) -> Array:
            x = np.zeros((count, 1, 6))
            x[:, 0, :3] = np.random.default_rng(0).normal((*centre, 1.0), (6.0, 6.0, 0.05), (count, 3))
            return x

        def score(model: Contour, count: int) -> Callable[[], object]:
            x = particles(count)
            learned = model.init(Frame(0, 0.0, pictures[0]), x[0])

            def work() -> None:
                for picture in pictures:
                    model.score(learned, Frame(0, 0.0, picture), x)

            work()
            return work

        def gradients(count: int) -> Callable[[], object]:
            boxes = np.ascontiguousarray(particles(count)[:, 0, :3])
            away = np.array(SIZE) * boxes[:, 2].max() / 2 + reach + 2
            extent = (*(boxes[:, :2].min(axis=0) - away), *(boxes[:, :2].max(axis=0) + away))
            n = math.ceil(reach)

            def work() -> None:
                for picture in pictures:
                    grey, left, top = Frame(0, 0.0, picture).grey(1, extent)
                    gx = cv2.Sobel(grey, cv2.CV_32F, 1, 0, scale=0.25)
                    gy = cv2.Sobel(grey, cv2.CV_32F, 0, 1, scale=0.25)
                    x = boxes - (left, top, 0)
                    edges_of_gradients(gx, gy, x, outline.points, outline.normals, n, settings.threshold)

            work()
            return work

        print("particles   max_size 64   every pixel   gradients, every pixel    times of decoding a frame")
        for count in COUNTS:
            works = score(reduced, count), score(whole, count), gradients(count)
            *ours, decoding = best(*works, lambda: decode(path), times=15)
            a, b, c = (seconds / decoding for seconds in ours)
            verdict = "" if count != 200 else "to reach: <= 0.3 at 64: " + ("reached" if a <= 0.3 else "MISSED")
            print(f"{count:9d} {a:13.2f} {b:13.2f} {c:24.2f}    {verdict}", flush=True)


if __name__ == "__main__":
    main()
