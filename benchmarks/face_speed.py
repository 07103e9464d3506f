"""What a frame costs the trackers of faces by skin and template, as ratios measured within one run.

    python benchmarks/face_speed.py                  all of them
    python benchmarks/face_speed.py skin_ncc ncc     some

The sample clip `signing`, enlarged to the paper's 720x576, with 1,500 particles for the head and 3,500 for each hand.
What is timed is the whole step of all targets, once the frame is decoded: move, weigh, estimate, judge, learn. The
trackers take turns, and of each frame the least time of several rounds counts. Beside it, in the same run: decoding the
frame, and, where this OpenCV has them, its own trackers of the head's box.

To reach: skin_ncc at 20 times the paper's 30 frames/s, or at most half of what KCF takes (it needs opencv-contrib).
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import imageio_ffmpeg
import numpy as np
from speed import report

from facetrack_cli.core.errors import FacetrackError
from facetrack_cli.core.types import Frame, Image, Start, TargetStart
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.start.init_file import find_init, read_init
from facetrack_cli.video.source import open_source

SAMPLE = Path(__file__).parent.parent / "sample_videos" / "signing.mp4"
SIZE = 720, 576
ZOOM = 2.4  # of 240 lines
FRAMES = 60
ROUNDS = 15
SCALED = "motion.scale=0.01"
RECIPES: dict[str, tuple[str, list[str]]] = {
    "skin": ("skin", []),
    "skin_ncc": ("skin_ncc", []),
    "skin_ncc_robust": ("skin_ncc_robust", []),
    "ncc": ("ncc", []),
    "skin_ncc, size too": ("skin_ncc", [SCALED]),
    "skin_ncc, size too, from 32 pixels": (
        "skin_ncc",
        [SCALED, "likelihood.skin.max_size=32", "likelihood.ncc.max_size=32"],
    ),
    "skin_ncc, template adapts": ("skin_ncc", ["likelihood.ncc.adapt=0.1"]),
    "skin_ncc, not reduced": ("skin_ncc", ["likelihood.skin.max_size=null", "likelihood.ncc.max_size=null"]),
    "head_hands": ("head_hands", []),
    "head_hands_cloud": ("head_hands_cloud", []),
    "mosse": ("mosse", []),
    "kcf": ("kcf", []),
    "csrt": ("csrt", []),
}


def pictures() -> tuple[list[Image], Start]:
    """The frames of the clip at SIZE, and where its targets are in the first one."""
    margin = (round(320 * ZOOM) - SIZE[0]) // 2
    with open_source(SAMPLE, stop=FRAMES) as source:
        large = [cv2.resize(f.bgr, None, fx=ZOOM, fy=ZOOM, interpolation=cv2.INTER_CUBIC) for f in source]
    rng = np.random.default_rng(0)
    noise = [rng.normal(0, 1.0, (SIZE[1], SIZE[0], 1)) for _ in large]
    frames = [
        np.clip(one[:, margin : margin + SIZE[0]] + grain, 0, 255).astype(np.uint8)
        for one, grain in zip(large, noise, strict=True)
    ]
    targets = {}
    for name, target in read_init(find_init(SAMPLE) or SAMPLE).targets.items():
        assert target.box is not None
        left, top, w, h = (ZOOM * side for side in target.box)
        targets[name] = TargetStart(box=(left + 0.5 * (ZOOM - 1) - margin, top + 0.5 * (ZOOM - 1), w, h))
    return frames, Start(0, targets, str(SAMPLE))


def encoded(frames: list[Image], path: Path) -> Path:
    """A file of the frames in the sample clips' own quality."""
    writer = imageio_ffmpeg.write_frames(
        str(path), SIZE, fps=25, pix_fmt_in="bgr24", quality=None, output_params=["-crf", "15"]
    )
    writer.send(None)
    for frame in frames:
        writer.send(frame)
    writer.close()
    return path


def seconds_each(steps: Iterator[object]) -> list[float]:
    """What each of several steps takes."""
    taken = []
    began = time.perf_counter()
    for _ in steps:
        now = time.perf_counter()
        taken.append(now - began)
        began = time.perf_counter()
    return taken


def tracking(config: str, overrides: list[str], frames: list[Image], start: Start) -> Callable[[], list[float]]:
    """A round: the seconds that a tracker takes for each frame after the first."""
    recipe = load_recipe(config, overrides)
    names = recipe.followed or ("head",)
    built = build_tracker(recipe, Start(0, {name: start.targets[name] for name in names}, start.origin))

    def work() -> list[float]:
        # as new, or the reduced images of the last round would be there already
        fresh = (Frame(i, i / 25, frame) for i, frame in enumerate(frames))
        return seconds_each(track(built, fresh, 0))[1:]

    work()
    return work


def decoding(path: Path) -> Iterator[object]:
    capture = cv2.VideoCapture(str(path))
    while capture.read()[0]:
        yield None
    capture.release()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recipes", nargs="*", help="which ones (default: all)")
    parser.add_argument("--threads", type=int, help="that OpenCV may take (default: as it decides)")
    given = parser.parse_args()
    if given.threads is not None:
        cv2.setNumThreads(given.threads)
    frames, start = pictures()
    works: dict[str, Callable[[], list[float]]] = {}
    for label, (config, overrides) in RECIPES.items():
        if not given.recipes or config in given.recipes:
            try:
                works[label] = tracking(config, overrides, frames, start)
            except FacetrackError as e:
                print(f"{label}: left out, {e}")
    with tempfile.TemporaryDirectory() as folder:
        path = encoded(frames, Path(folder) / "clip.mp4")
        rounds = [[work() for work in works.values()] + [seconds_each(decoding(path))[1:]] for _ in range(ROUNDS)]
    *taken, decoded = (np.min(one, axis=0).mean() for one in zip(*rounds, strict=True))
    each = dict(zip(works, taken, strict=True))
    kcf = each.get("kcf")
    box = start.targets["head"].box
    assert box is not None
    print(f"{SIZE[0]}x{SIZE[1]}, head {box[2]:.0f}x{box[3]:.0f}; OpenCV's threads: {cv2.getNumThreads()}")
    print(f"{'a step over':36s} {'decoding':>9s} {'kcf':>9s} {'frames/s':>9s}")
    for label, seconds in each.items():
        beside = f"{seconds / kcf:9.3f}" if kcf else f"{'-':>9s}"
        print(f"{label:36s} {seconds / decoded:9.3f} {beside} {1 / seconds:9.0f}")
    if "skin_ncc" in each:
        seconds = each["skin_ncc"]
        report("faces: skin_ncc, over the paper's 30 frames/s", 1 / seconds / 30, ">= 20", seconds * 600 <= 1)
        if kcf:
            report("faces: kcf / skin_ncc", kcf / seconds, ">= 2", kcf >= 2 * seconds)


if __name__ == "__main__":
    main()
