"""Speed, as ratios measured within one run; single times of a noisy machine are not worth quoting.

    python benchmarks/speed.py                 all of it
    python benchmarks/speed.py kernel tracker  some

kernel    the colour kernel against cv2.remap + NumPy, 1,000 windows of 15x15              to reach: 10 times as fast
tracker   the tracker's own time for a frame at 640x480 against decoding it                 to reach: at most 0.5
          factorized_robust against factorized                                              to reach: at most 2
pipeline  `run --no-video` on 1,000 frames against a bare decoding loop                     to reach: at most 1.2
video     `run` with MP4 against the slower of decoding and encoding alone                  to reach: at most 1.2

    python benchmarks/speed.py --against 35a92ca --recipe face clips/*.mp4

--against measures processor time a frame of this tree and of another commit, one thread, decoding included, in turns
A B A B: for each clip the median of the ratios this / other, and the least and the greatest. `--faces all` is of films,
people and their names included. Without clips it takes the sample clips that faces are in. Where FACETRACK_MESH names
a Python that has mediapipe, its face mesh takes turns too.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Final

import cv2
import imageio_ffmpeg
import numpy as np

from facetrack_cli.core.types import Frame, Start, TargetStart
from facetrack_cli.engine.loop import track
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.start.assembly import build_tracker
from facetrack_cli.start.init_file import find_init, read_init, write_init
from facetrack_cli.trackers.points import point_kernels as windows
from facetrack_cli.video.source import open_source
from facetrack_cli.video.writer import VideoWriter

SAMPLE = Path(__file__).parent.parent / "sample_videos" / "expressions.mp4"


def best(*works: Callable[[], object], times: int) -> list[float]:
    """The least time of each of several works, done in turn: what each takes when nothing else disturbs it."""
    taken: list[list[float]] = [[] for _ in works]
    for _ in range(times):
        for work, seconds in zip(works, taken, strict=True):
            began = time.perf_counter()
            work()
            seconds.append(time.perf_counter() - began)
    return [min(seconds) for seconds in taken]


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
    rows, x, out = windows.flat(image), centres[:, None], np.empty((n, 1))
    padded = windows.read_window(rows, 200.0, 200.0, side, side)
    template = padded[:, :side].ravel() / padded[:, :side].mean()
    ratios, offsets = padded.ravel() / padded[:, :side].mean(), np.array([0, padded.size])
    sides, parts = np.array([[side, side]]), np.array([0])

    def ours() -> None:
        windows.colour_ratio_distances(rows, ratios, offsets, sides, parts, x, 0, 0, 1, 1.0, out)

    def theirs() -> np.ndarray:
        return remap_distances(image, template, side, centres)

    ours()
    # OpenCV rounds places to 1/32 pixel, hence the tolerance
    np.testing.assert_allclose(out[:, 0], theirs(), atol=0.02)
    a, b = best(theirs, ours, times=50)
    ratio = a / b
    report("kernel: cv2.remap + NumPy / ours", ratio, ">= 10", ratio >= 10)


def enlarged(folder: Path, frames: int) -> tuple[Path, Start]:
    """The sample clip at 640x480, played again and again until it has `frames` frames; and where its face is."""
    path = folder / "clip.mp4"
    start = read_init(find_init(SAMPLE) or SAMPLE)
    rng = np.random.default_rng(0)
    with open_source(SAMPLE) as source:
        pictures = [cv2.resize(f.bgr, (640, 480), interpolation=cv2.INTER_CUBIC) for f in source]
    there_and_back = pictures + pictures[::-1]
    # the sample clips' own quality; and enlarging blurs the sensor's noise away, without which decoding is too easy
    writer = imageio_ffmpeg.write_frames(
        str(path), (640, 480), fps=25, pix_fmt_in="bgr24", quality=None, output_params=["-crf", "15"]
    )
    writer.send(None)
    for i in range(frames):
        noise = rng.normal(0, 1.0, (480, 640, 1)).astype(np.float32)
        noisy = there_and_back[i % len(there_and_back)] + noise
        writer.send(np.clip(noisy, 0, 255).astype(np.uint8))
    writer.close()
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

        def run(config: str) -> Callable[[], object]:
            built = build_tracker(load_recipe(config), start)

            def work() -> None:
                # as new, or the reduced images of the last round would be there already
                fresh = (Frame(frame.index, frame.time_s, frame.bgr) for frame in frames)
                for _ in track(built, fresh, 0):
                    pass

            work()
            return work

        a, b, c = best(run("factorized"), run("factorized_robust"), lambda: decode(path), times=7)
        report("tracker: factorized, a frame at 640x480 / decoding it", a / c, "<= 0.5", a / c <= 0.5)
        report("tracker: factorized_robust / factorized", b / a, "<= 2", b / a <= 2)


def started(arguments: list[str]) -> None:
    command = [sys.executable, "-m", "facetrack_cli", "run", *arguments, "--quiet", "--overwrite"]
    subprocess.run(command, check=True)


def runs(path: Path, out: Path, extra: list[str]) -> tuple[Callable[[], object], Callable[[], object]]:
    """A run of the whole clip, and one of its first two frames, which is what starting up takes."""
    common = [str(path), "--config", "factorized", "-o", str(out), *extra]
    return (lambda: started(common)), (lambda: started([*common, "--stop", "2"]))


def pipeline() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path, _ = enlarged(Path(folder), 1200)
        whole, start_up = runs(path, Path(folder) / "out", ["--no-video"])
        a, b, c = best(whole, start_up, lambda: decode(path), times=7)
        ratio = (a - b) / c
        report("pipeline: run --no-video, 1,200 frames / decoding them", ratio, "<= 1.2", ratio <= 1.2)


def video() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path, _ = enlarged(Path(folder), 600)
        with open_source(path) as source:
            frames = [frame.bgr for frame in source]

        def encode() -> None:
            with VideoWriter(Path(folder) / "again.mp4", (640, 480), Fraction(25)) as writer:
                for i, picture in enumerate(frames):
                    writer.write(picture, i / 25)

        whole, start_up = runs(path, Path(folder) / "out", [])
        a, b, c, d = best(whole, start_up, encode, lambda: decode(path), times=5)
        ratio = (a - b) / max(c, d)
        report("video: run with MP4, 600 frames / slower of both alone", ratio, "<= 1.2", ratio <= 1.2)


CHILD: Final = """
import os, sys, time
tree, recipe, faces = sys.argv[1:]
sys.path.insert(0, tree)
os.environ["FACETRACK_MODELS"] = tree  # without networks that are there by chance
import cv2
cv2.setNumThreads(1)
from facetrack_cli import track_video
for line in sys.stdin:
    stop, clip = line.rstrip().split(" ", 1)
    began = time.process_time()
    track_video(clip, recipe, stop=int(stop), seed=0, faces=faces)
    print("took", time.process_time() - began, flush=True)
"""
MESH: Final = """
import itertools, sys, time
import cv2
cv2.setNumThreads(1)
import mediapipe
for line in sys.stdin:
    stop, clip = line.rstrip().split(" ", 1)
    began, capture = time.process_time(), cv2.VideoCapture(clip)
    model = mediapipe.solutions.face_mesh.FaceMesh(max_num_faces=1)
    for there, image in itertools.islice(iter(capture.read, (False, None)), int(stop)):
        model.process(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
    print("took", time.process_time() - began, flush=True)
"""
ONE_THREAD: Final = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "NUMBA")}
WARM: Final = 15  # frames of a run that is subtracted: start-up, and a film has people to name in them


class Worker:
    """A process that tracks one clip after another, and says what processor time it took."""

    def __init__(self, python: str, *arguments: str) -> None:
        environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": ""}
        command = [python, "-c", *arguments]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=environment)

    def took(self, clip: Path, stop: int) -> float:
        assert self.process.stdin is not None and self.process.stdout is not None
        print(stop, clip, file=self.process.stdin, flush=True)
        for line in self.process.stdout:
            if line.startswith("took "):
                return float(line.split()[1])
        raise SystemExit(f"{clip}: a process that measures has ended with {self.process.wait()}")

    def a_frame(self, clip: Path, frames: int) -> float:
        return (self.took(clip, WARM + frames) - self.took(clip, WARM)) / frames


def against(revision: str, how: tuple[str, str], clips: Sequence[Path], frames: int, rounds: int) -> None:
    here = Path(__file__).parent.parent
    with tempfile.TemporaryDirectory() as folder:
        other = Path(folder) / "other"
        subprocess.run(["git", "-C", here, "worktree", "add", "--quiet", "--detach", other, revision], check=True)
        try:
            workers = {"this": Worker(sys.executable, CHILD, str(here), *how)}
            workers[revision] = Worker(sys.executable, CHILD, str(other), *how)
            if python := os.environ.get("FACETRACK_MESH"):
                workers["mesh"] = Worker(python, MESH)
            for clip in clips:
                for worker in workers.values():
                    worker.took(clip.resolve(), WARM)  # kernels are compiled
                turns = [[one.a_frame(clip.resolve(), frames) for one in workers.values()] for _ in range(rounds)]
                for name, *each in zip(list(workers)[1:], *np.array(turns)[:, 1:], strict=True):
                    ratios = np.array(turns)[:, 0] / np.array(each)
                    spread = f"{np.median(ratios):.2f} ({ratios.min():.2f} to {ratios.max():.2f})"
                    print(f"{clip.name:24s} this / {name:12s} {spread}", flush=True)
            for worker in workers.values():
                worker.process.kill()
        finally:
            subprocess.run(["git", "-C", here, "worktree", "remove", "--force", other], check=True)


def main() -> None:
    parts = {"kernel": kernel, "tracker": tracker, "pipeline": pipeline, "video": video}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", help=f"which of {', '.join(parts)} (default: all), or clips")
    parser.add_argument("--against", metavar="REV", help="measure a commit beside this tree; what follows are clips")
    parser.add_argument("--recipe", default="face")
    parser.add_argument("--faces", choices=("one", "all"), default="one")
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    if given.against:
        clips = [Path(one) for one in given.parts] or [SAMPLE, SAMPLE.with_name("occlusion.mp4")]
        against(given.against, (given.recipe, given.faces), clips, given.frames, given.rounds)
        return
    if unknown := set(given.parts) - set(parts):
        parser.error(f"no such part: {', '.join(sorted(unknown))}")
    for name in given.parts or parts:
        parts[name]()


if __name__ == "__main__":
    main()
