"""What a frame costs over particles, parts, image size and length of the clip, as ratios measured within one run.

    python benchmarks/curves.py                      all curves
    python benchmarks/curves.py particles sizes      some

The sample clip `expressions` (of `adaptive`: `zoom`), enlarged and encoded again. What is timed is processor time: of a
step in its thread, the least of several rounds for each frame; of decoding that very file by one thread. A step is all
that a tracker does once the frame is decoded.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import cv2
import imageio_ffmpeg
import numpy as np

from facetrack_cli.core.types import Frame, Image, Start, TargetStart
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.start.init_file import find_init, read_init, write_init
from facetrack_cli.video.source import open_source

SAMPLES = Path(__file__).parent.parent / "sample_videos"
RECIPES = ("factorized", "face", "correlation_filter", "adaptive")
FRAMES, ROUNDS = 40, 5
PARTICLES = (25, 50, 100, 200, 400, 800)
SIZES = ((320, 240), (640, 480), (1280, 960), (1920, 1440))
LENGTHS = (100, 400, 1600)
PARTS = ("nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower")


def pictures(recipe: str, size: tuple[int, int]) -> tuple[list[Image], Start]:
    """Frames of `size` with the noise of a camera, and where the face is in the first one."""
    clip = SAMPLES / ("zoom.mp4" if recipe == "adaptive" else "expressions.mp4")
    with open_source(clip, stop=FRAMES) as source:
        read, (width, height) = [frame.bgr for frame in source], source.size
    rng, (x, y) = np.random.default_rng(0), (size[0] / width, size[1] / height)
    frames = []
    for one in read:
        large = cv2.resize(one, size, interpolation=cv2.INTER_CUBIC) + rng.normal(0, 1.0, (size[1], size[0], 1))
        frames.append(np.clip(large, 0, 255).astype(np.uint8))
    [(name, given)] = read_init(find_init(clip) or clip).targets.items()
    points = {part: (x * u + 0.5 * (x - 1), y * v + 0.5 * (y - 1)) for part, (u, v) in given.points.items()}
    box = given.box and (x * given.box[0], y * given.box[1], x * given.box[2], y * given.box[3])
    if box is None and recipe == "correlation_filter":
        left, top = np.min([*points.values()], axis=0)
        side = 2.2 * float(np.ptp([u for u, _ in points.values()]))
        box, points = (float(left) - 0.25 * side, float(top) - 0.5 * side, side, side), {}
    return frames, Start(0, {name: TargetStart(box, points)}, str(clip))


def step(recipe: str, overrides: Sequence[str], frames: list[Image], start: Start) -> float:
    """Seconds of a step, in the mean over the frames after the first."""
    tracker = build_tracker(load_recipe(recipe, overrides), start)
    least = np.full(len(frames), np.inf)
    for _ in range(ROUNDS + 1):  # in the first one kernels are loaded
        # as a decoder leaves it: nothing derived of it yet
        results, taken = track(tracker, (Frame(i, i / 25, one.copy()) for i, one in enumerate(frames)), 0), []
        began = time.thread_time()
        for _ in results:
            taken.append(time.thread_time() - began)
            began = time.thread_time()
        least = np.minimum(least, taken)
    copying = min(_seconds(frames[0].copy) for _ in range(50))
    return float(least[1:].mean()) - copying


def _seconds(work: Callable[[], object]) -> float:
    began = time.thread_time()
    work()
    return time.thread_time() - began


def encoded(frames: Sequence[Image], path: Path, count: int = FRAMES) -> Path:
    """A file of so many frames, played forwards and backwards, in the sample clips' own quality."""
    height, width = frames[0].shape[:2]
    writer = imageio_ffmpeg.write_frames(
        str(path), (width, height), fps=25, pix_fmt_in="bgr24", quality=None, output_params=["-crf", "15"],
        macro_block_size=2,
    )  # fmt: skip
    writer.send(None)
    both = [*frames, *frames[::-1]]
    for i in range(count):
        writer.send(both[i % len(both)])
    writer.close()
    return path


def decoding(path: Path) -> float:
    """Seconds of processor time for a frame, the least of several rounds."""

    def once() -> float:
        capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
        began, count = time.process_time(), 0
        while capture.read()[0]:
            count += 1
        return (time.process_time() - began) / count

    return min(once() for _ in range(ROUNDS))


def particles(folder: Path) -> Iterator[str]:
    """A step over the number of particles, at 640x480."""
    yield table("particles", PARTICLES)
    for recipe in RECIPES:
        frames, start = pictures(recipe, (640, 480))
        file = decoding(encoded(frames, folder / "clip.mp4"))
        more = ["filter.adapt=false"] if recipe == "adaptive" else []
        yield row(recipe, (step(recipe, [f"filter.particles={n}", *more], frames, start) / file for n in PARTICLES))


def parts(folder: Path) -> Iterator[str]:
    """A step over the number of points, which are tracked alone, at 640x480."""
    counts = range(1, len(PARTS) + 1)
    yield table("points", counts)
    frames, start = pictures("independent", (640, 480))
    file = decoding(encoded(frames, folder / "clip.mp4"))
    asked = ([f"target.parts=[{', '.join(PARTS[:n])}]"] for n in counts)
    yield row("independent", (step("independent", one, frames, start) / file for one in asked))


def sizes(folder: Path) -> Iterator[str]:
    """A step over the size of the image, of which the face is a fixed part."""
    yield table("image", (f"{w}x{h}" for w, h in SIZES))
    for recipe in RECIPES:
        found = []
        for size in SIZES:
            frames, start = pictures(recipe, size)
            found.append(step(recipe, [], frames, start) / decoding(encoded(frames, folder / "clip.mp4")))
        yield row(recipe, found)


def lengths(folder: Path) -> Iterator[str]:
    """A whole `run --no-video` over the frames of the clip, start-up and all, at 640x480."""
    yield table("frames", LENGTHS)
    frames, start = pictures("factorized", (640, 480))
    clips = [encoded(frames, folder / f"{n}.mp4", n) for n in LENGTHS]
    for clip in clips:
        write_init(clip.with_suffix(".init.yaml"), start)
    files = [n * decoding(clip) for n, clip in zip(LENGTHS, clips, strict=True)]
    for recipe in ("factorized", "face"):
        yield row(recipe, (whole(clip, recipe) / seconds for clip, seconds in zip(clips, files, strict=True)))


def whole(clip: Path, recipe: str) -> float:
    """Processor seconds of a run."""
    command = [sys.executable, "-m", "facetrack_cli", "run", str(clip), "--config", recipe, "--no-video", "--quiet"]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([*command, "--overwrite", "-o", str(clip.with_suffix(""))], check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def table(name: str, heads: Iterable[object]) -> str:
    shown = [str(head) for head in heads]
    return f"| {name} | {' | '.join(shown)} |\n|---|{'---|' * len(shown)}"


def row(name: str, ratios: Iterator[float] | list[float]) -> str:
    return f"| `{name}` | {' | '.join(f'{ratio:.2f}' for ratio in ratios)} |"


CURVES = {"particles": particles, "parts": parts, "sizes": sizes, "lengths": lengths}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("curves", nargs="*", choices=[*CURVES, []], help="which ones (default: all)")
    cv2.setNumThreads(1)
    for name in parser.parse_args().curves or CURVES:
        print(f"\n{CURVES[name].__doc__} Over decoding a frame.\n")
        with tempfile.TemporaryDirectory() as folder:
            for line in CURVES[name](Path(folder)):
                print(line, flush=True)


if __name__ == "__main__":
    main()
