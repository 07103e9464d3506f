"""What a frame costs the adaptive trackers, over what it costs to decode it: ratios measured within one run.

    python benchmarks/adaptive_speed.py                            the sample clip `zoom`, enlarged to 640x480
    python benchmarks/adaptive_speed.py CLIP X Y W H               any clip and the face's box in its first frame
    python benchmarks/adaptive_speed.py --recipes adaptive --crf 18

The clip is scaled to 640x480 and encoded again (H.264), since a step is weighed against decoding that very file. What
is timed is the whole step, once the frame is decoded: predict, move, weigh, estimate, judge, learn. Trackers and
decoders take turns, and of each frame the least time of several rounds counts. J is the mean number of particles.

To reach: 100 particles, always so many, at most a quarter of decoding. OPENBLAS_NUM_THREADS and --threads (of OpenCV)
are the user's own unless set.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import imageio_ffmpeg
import numpy as np
from face_speed import seconds_each
from speed import report

from facetrack_cli.core.types import Frame, Image, Start, TargetStart
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.start.init_file import find_init, read_init
from facetrack_cli.video.source import open_source

SAMPLE = Path(__file__).parent.parent / "sample_videos" / "zoom.mp4"
SIZE = 640, 480
FRAMES = 60
ROUNDS = 25
RECIPES: dict[str, tuple[str, list[str]]] = {
    "adaptive, always 100": ("adaptive", ["filter.adapt=false"]),
    "... B from 32 of them": ("adaptive", ["filter.adapt=false", "motion.velocity.samples=32"]),
    "adaptive": ("adaptive", []),
    "adaptive_noise": ("adaptive_noise", []),
    "adaptive_velocity": ("adaptive_velocity", []),
    "adaptive_appearance": ("adaptive_appearance", []),
    "fixed_template": ("fixed_template", []),
    "adaptive_robust": ("adaptive_robust", []),
}


def pictures(clip: Path, box: list[float]) -> tuple[list[Image], Start]:
    """The frames of the clip at SIZE, and where its face is in the first one."""
    if not box:
        target = next(iter(read_init(find_init(clip) or clip).targets.values()))
        assert target.box is not None
        box = list(target.box)
    with open_source(clip, stop=FRAMES) as source:
        read = [frame.bgr for frame in source]
    height, width = read[0].shape[:2]
    zoom = SIZE[0] / width, SIZE[1] / height
    if zoom[0] > 1:  # an image that was enlarged is smoother than a camera's
        rng = np.random.default_rng(0)
        large = [cv2.resize(one, SIZE, interpolation=cv2.INTER_CUBIC) for one in read]
        noise = (rng.normal(0, 1.5, (SIZE[1], SIZE[0], 1)) for _ in large)
        frames = [np.clip(one + grain, 0, 255).astype(np.uint8) for one, grain in zip(large, noise, strict=True)]
    else:
        frames = [cv2.resize(one, SIZE, interpolation=cv2.INTER_AREA).astype(np.uint8) for one in read]
    left, top, w, h = (zoom[i % 2] * (value + 0.5 * (i < 2)) - 0.5 * (i < 2) for i, value in enumerate(box))
    return frames, Start(0, {"face": TargetStart(box=(left, top, w, h))}, str(clip))


def encoded(frames: list[Image], path: Path, crf: int) -> Path:
    """A file of the frames."""
    writer = imageio_ffmpeg.write_frames(
        str(path), SIZE, fps=25, pix_fmt_in="bgr24", quality=None, output_params=["-crf", str(crf)]
    )
    writer.send(None)
    for frame in frames:
        writer.send(np.ascontiguousarray(frame))
    writer.close()
    return path


def tracking(config: str, overrides: list[str], frames: list[Image], start: Start) -> Callable[[], list[float]]:
    """A round: the seconds that a tracker takes for each frame after the first."""
    built = build_tracker(load_recipe(config, overrides), start)

    def work() -> list[float]:
        copying: list[float] = []

        def fresh() -> Iterator[Frame]:
            # as a decoder leaves it: nothing derived of it yet, and its pixels not gone from the cache
            for i, frame in enumerate(frames):
                began = time.perf_counter()
                copy = frame.copy()
                copying.append(time.perf_counter() - began)
                yield Frame(i, i / 25, copy)

        taken = seconds_each(track(built, fresh(), 0))
        return [whole - copied for whole, copied in zip(taken, copying, strict=True)][1:]

    work()
    return work


def decoding(path: Path, threads: int | None) -> Iterator[object]:
    given = [] if threads is None else [cv2.CAP_PROP_N_THREADS, threads]
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, given)
    while capture.read()[0]:
        yield None
    capture.release()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clip", nargs="?", type=Path, default=SAMPLE)
    parser.add_argument("box", nargs="*", type=float, help="left, top, width, height of the face in its first frame")
    parser.add_argument("--recipes", nargs="*", help="which ones (default: all)")
    parser.add_argument("--crf", type=int, default=20, help="quality of the file that is decoded; less is better (20)")
    parser.add_argument("--threads", type=int, help="that OpenCV may take (default: as it decides)")
    given = parser.parse_args()
    if given.threads is not None:
        cv2.setNumThreads(given.threads)
    frames, start = pictures(given.clip, given.box)
    chosen = {k: v for k, v in RECIPES.items() if not given.recipes or v[0] in given.recipes}
    works = [tracking(*one, frames, start) for one in chosen.values()]
    counts = []
    for config, overrides in chosen.values():
        tracker = build_tracker(load_recipe(config, overrides), start)
        results = list(track(tracker, (Frame(i, i / 25, frame) for i, frame in enumerate(frames)), 0))
        counts.append(float(np.mean([result.rows.particles[0] for result in results[1:]])))
    with tempfile.TemporaryDirectory() as folder:
        path = encoded(frames, Path(folder) / "clip.mp4", given.crf)
        works += [lambda: seconds_each(decoding(path, None))[1:], lambda: seconds_each(decoding(path, 1))[1:]]
        rounds = [[work() for work in works] for _ in range(ROUNDS)]
    # decoding with threads hands out frames in bursts, so that its least time is that of a whole round
    *taken, _, alone = (np.min(one, axis=0).mean() for one in zip(*rounds, strict=True))
    usual = min(float(np.mean(one[-2])) for one in rounds)
    box = start.targets["face"].box
    assert box is not None
    print(
        f"{SIZE[0]}x{SIZE[1]}, face {box[2]:.0f}x{box[3]:.0f}, crf {given.crf}; OpenCV's threads {cv2.getNumThreads()},"
        f" of BLAS {os.environ.get('OPENBLAS_NUM_THREADS', 'its own')};"
        f" decoding {usual * 1e3:.2f} ms as it comes, {alone * 1e3:.2f} ms by one thread"
    )
    print(f"{'a step over':24s} {'decoding':>9s} {'by 1 thread':>12s} {'ms':>7s} {'J':>5s}")
    for label, seconds, count in zip(chosen, taken, counts, strict=True):
        print(f"{label:24s} {seconds / usual:9.3f} {seconds / alone:12.3f} {seconds * 1e3:7.3f} {count:5.0f}")
        if label.endswith("always 100"):
            report(f"{label}, over decoding", seconds / usual, "<= 0.25", seconds <= 0.25 * usual)


if __name__ == "__main__":
    main()
