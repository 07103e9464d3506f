"""How long it takes until a frame far away is there, as ratios to decoding one frame onward.

    python benchmarks/seek.py                 all of it
    python benchmarks/seek.py sd 4k hours     some

sd      720x576, H.264, 2,000 frames, keyframes at most 250 apart
4k      3840x2160, H.264, 2,000 frames, keyframes at most 250 apart (takes minutes to make)
hours   two hours of 160x120: how long the first far jump takes, which waits for the packets' times, and the next ones;
        beside decoding all frames up to there

A jump decodes about half the frames between two keyframes, 125 of them, which is its ratio if seeking costs nothing.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from facetrack_cli.video import ffmpeg
from facetrack_cli.video.seek import Frames
from facetrack_cli.video.source import open_source


def make(path: Path, size: str, seconds: int) -> Path:
    """A clip of a moving pattern, 25 frames/s."""
    source = f"testsrc2=size={size}:rate=25:duration={seconds}"
    encoder = ["-c:v", "libx264", "-preset", "superfast", "-bf", "2", "-g", "250", "-pix_fmt", "yuv420p"]
    code, said = ffmpeg.run(["-v", "error", "-y", "-f", "lavfi", "-i", source, *encoder, str(path)])
    if code:
        raise RuntimeError(ffmpeg.cause(said))
    return path


def onward(path: Path, frames: int) -> float:
    """Seconds to decode one frame after the other."""
    with open_source(path, stop=frames) as source:
        began = time.perf_counter()
        count = sum(1 for _ in source)
        return (time.perf_counter() - began) / count


def timed(frames: Frames, indices: Sequence[int]) -> list[float]:
    taken = []
    for index in indices:
        began = time.perf_counter()
        frames.read(index)
        taken.append(time.perf_counter() - began)
    return taken


def report(name: str, value: float, unit: str = "x a frame") -> None:
    print(f"{name:62s} {value:9.2f} {unit}", flush=True)


def measure(name: str, path: Path, total: int, sample: int, jumps: int) -> None:
    rng = np.random.default_rng(0)
    frame = onward(path, sample)
    with Frames(path) as frames:
        size = path.stat().st_size
        first = timed(frames, [total - 100])[0]
        far = timed(frames, rng.integers(300, total, jumps).tolist())
        back_from = total // 2 + 120
        frames.read(back_from)
        decoded = frames.decoded
        back = timed(frames, range(back_from - 1, back_from - 51, -1))
        decoded = frames.decoded - decoded
    report(f"{name}: the first far jump ({size >> 20} MB)", first / frame)
    report(f"{name}: the first far jump / decoding all before it", first / (frame * (total - 100)), "")
    report(f"{name}: a far jump, median of {jumps}", float(np.median(far)) / frame)
    report(f"{name}: a far jump, slowest of {jumps}", max(far) / frame)
    report(f"{name}: a step back, mean of 50", float(np.mean(back)) / frame)
    report(f"{name}: frames decoded for a step back", decoded / 50, "")
    report(f"{name}: memory at its highest", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, "MB")


CASES = {"sd": ("720x576", 80, 500, 30), "hours": ("160x120", 7200, 3000, 30), "4k": ("3840x2160", 80, 100, 8)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", help=f"some of {', '.join(CASES)}")
    asked = parser.parse_args().what or list(CASES)
    with tempfile.TemporaryDirectory() as folder:
        for name in asked:
            size, seconds, sample, jumps = CASES[name]
            path = make(Path(folder) / f"{name}.mp4", size, seconds)
            measure(name, path, seconds * 25, sample, jumps)


if __name__ == "__main__":
    main()
