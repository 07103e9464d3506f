"""Speed, as ratios measured within one run; single times of a noisy machine are not worth quoting.

    python benchmarks/speed.py                 all of it
    python benchmarks/speed.py kernel tracker  some

kernel    the colour kernel against cv2.remap + NumPy, 1,000 windows of 15x15              to reach: 10 times as fast
tracker   the tracker's own time for a frame at 640x480 against decoding it                 to reach: at most 0.5
pipeline  `run --no-video` on 1,000 frames against a bare decoding loop                     to reach: at most 1.2
video     `run` with MP4 against the slower of decoding and encoding alone                  to reach: at most 1.2
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np

from facetrack_cli import kernels
from facetrack_cli.build import build_tracker
from facetrack_cli.recipe import load_recipe
from facetrack_cli.start import find_init, read_init, write_init
from facetrack_cli.track import track
from facetrack_cli.types import Frame, Start, TargetStart
from facetrack_cli.video.source import open_source
from facetrack_cli.video.writer import VideoWriter

SAMPLE = Path(__file__).parent.parent / "sample_videos" / "expressions.mp4"


def best(work: Callable[[], object], times: int) -> float:
    """The least of several runs: what the work takes when nothing else disturbs it."""
    taken = []
    for _ in range(times):
        began = time.perf_counter()
        work()
        taken.append(time.perf_counter() - began)
    return min(taken)


def report(name: str, ratio: float, reach: str, ok: bool) -> None:
    print(f"{name:58s} {ratio:7.2f}   to reach: {reach:12s} {'reached' if ok else 'MISSED'}", flush=True)


def remap_distances(image: np.ndarray, ratio: np.ndarray, side: int, centres: np.ndarray) -> np.ndarray:
    """What the kernel does, by OpenCV and NumPy."""
    offsets = np.arange(side, dtype=np.float32) - (side - 1) / 2
    map_x = (centres[:, 0, None, None] + offsets[None, None, :]).repeat(side, axis=1).reshape(len(centres), -1)
    map_y = (centres[:, 1, None, None] + offsets[None, :, None]).repeat(side, axis=2).reshape(len(centres), -1)
    windows = cv2.remap(image, map_x.astype(np.float32), map_y.astype(np.float32), cv2.INTER_LINEAR)
    flat = windows.reshape(len(centres), -1).astype(np.float32)
    return np.asarray(np.abs(ratio - flat / flat.mean(axis=1, keepdims=True)).mean(axis=1))


def kernel() -> None:
    rng = np.random.default_rng(0)
    image = cv2.GaussianBlur(rng.integers(0, 256, (480, 640, 3), dtype=np.uint8), (0, 0), 2)
    side, n = 15, 1000
    centres = rng.uniform(40, 400, (n, 2))
    rows, x, out = kernels.flat(image), centres[:, None], np.empty((n, 1))
    padded = kernels.read_window(rows, 200.0, 200.0, side, side)
    template = padded[:, :side].ravel() / padded[:, :side].mean()
    ratios, offsets = padded.ravel() / padded[:, :side].mean(), np.array([0, padded.size])
    sides, parts = np.array([[side, side]]), np.array([0])

    def ours() -> None:
        kernels.colour_ratio_distances(
            rows, ratios, offsets, sides, parts, x, 0.0, 0.0, 1, 1.0, kernels.L1, 1.0, out
        )  # fmt: skip

    def theirs() -> np.ndarray:
        return remap_distances(image, template, side, centres)

    ours()
    # OpenCV rounds places to 1/32 pixel, hence the tolerance
    np.testing.assert_allclose(out[:, 0], theirs(), atol=0.02)
    ratio = best(theirs, 50) / best(ours, 50)
    report("kernel: cv2.remap + NumPy / ours", ratio, ">= 10", ratio >= 10)


def enlarged(folder: Path, frames: int) -> tuple[Path, Start]:
    """The sample clip at 640x480, played again and again until it has `frames` frames; and where its face is."""
    path = folder / "clip.mp4"
    start = read_init(find_init(SAMPLE) or SAMPLE)
    rng = np.random.default_rng(0)
    with open_source(SAMPLE) as source:
        pictures = [cv2.resize(f.bgr, (640, 480), interpolation=cv2.INTER_CUBIC) for f in source]
    there_and_back = pictures + pictures[::-1]
    with VideoWriter(path, (640, 480), Fraction(25)) as writer:
        for i in range(frames):
            # enlarging blurs the sensor's noise away, and a clip without any is decoded faster than real ones are
            noise = rng.normal(0, 2.0, (480, 640, 1)).astype(np.float32)
            noisy = np.clip(there_and_back[i % len(there_and_back)] + noise, 0, 255).astype(np.uint8)
            writer.write(noisy, i / 25)
    (name, target), *_ = start.targets.items()
    points = {part: (2 * x + 0.5, 2 * y + 0.5) for part, (x, y) in target.points.items()}
    large = Start(0, {name: TargetStart(points=points)}, str(path))
    write_init(path.with_name("clip.init.yaml"), large, overwrite=True)
    return path, large


def decode(path: Path) -> int:
    capture, count = cv2.VideoCapture(str(path)), 0
    while capture.read()[0]:
        count += 1
    capture.release()
    return count


def tracker() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path, start = enlarged(Path(folder), 300)
        with open_source(path) as source:
            frames: list[Frame] = list(source)
        for config in ("factorized", "factorized_robust"):
            built = build_tracker(load_recipe(config), start)

            def ours(built: object = built) -> None:
                for _ in track(built, iter(frames), 0):  # type: ignore[arg-type]
                    pass

            ours()
            ratio = best(ours, 5) / best(lambda: decode(path), 5)
            report(f"tracker: {config}, a frame at 640x480 / decoding it", ratio, "<= 0.5", ratio <= 0.5)


def started(arguments: list[str]) -> float:
    command = [sys.executable, "-m", "facetrack_cli", "run", *arguments, "--quiet", "--overwrite"]
    began = time.perf_counter()
    subprocess.run(command, check=True, env={**os.environ, "PYTHONWARNINGS": "ignore"})
    return time.perf_counter() - began


def run_time(path: Path, out: Path, extra: list[str]) -> float:
    """Seconds of a run, start-up apart: that of the whole clip less that of its first two frames."""
    common = [str(path), "--config", "factorized", "-o", str(out), *extra]
    started([*common, "--stop", "2"])
    whole = min(started(common) for _ in range(3))
    return whole - min(started([*common, "--stop", "2"]) for _ in range(3))


def pipeline() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path, _ = enlarged(Path(folder), 1200)
        decode(path)
        ratio = run_time(path, Path(folder) / "out", ["--no-video"]) / best(lambda: decode(path), 3)
        report("pipeline: run --no-video, 1,200 frames / decoding them", ratio, "<= 1.2", ratio <= 1.2)


def video() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path, _ = enlarged(Path(folder), 1200)
        with open_source(path) as source:
            frames = [frame.bgr for frame in source]

        def encode() -> None:
            with VideoWriter(Path(folder) / "again.mp4", (640, 480), Fraction(25)) as writer:
                for i, picture in enumerate(frames):
                    writer.write(picture, i / 25)

        slower = max(best(lambda: decode(path), 3), best(encode, 3))
        ratio = run_time(path, Path(folder) / "out", []) / slower
        report("video: run with MP4, 1,200 frames / slower of both alone", ratio, "<= 1.2", ratio <= 1.2)


def main() -> None:
    parts = {"kernel": kernel, "tracker": tracker, "pipeline": pipeline, "video": video}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[*parts, []], help="which ones (default: all)")
    for name in parser.parse_args().parts or parts:
        parts[name]()


if __name__ == "__main__":
    main()
