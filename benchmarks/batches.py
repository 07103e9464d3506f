"""What a batch costs beside the tracking: clips that are finished already, and processes of -j against a plain loop.

    python benchmarks/batches.py decide 10000        # seconds to find that so many clips are finished
    python benchmarks/batches.py overhead 40 --stop 60   # -j 2 against one process that tracks clip after clip

`overhead` gives the processor seconds of both, as well as the seconds on the clock: other work on the machine spoils
only the latter.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

CLIP = Path(__file__).parents[1] / "sample_videos" / "expressions.mp4"
RUN = [sys.executable, "-m", "facetrack_cli", "run"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["decide", "overhead"])
    parser.add_argument("clips", type=int)
    parser.add_argument("--stop", default="60")
    parser.add_argument("--config", default="factorized")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        options = ["--config", given.config, "--stop", given.stop, "--no-video", "-q"]
        (decide if given.what == "decide" else overhead)(Path(folder), given.clips, options)


def clips(folder: Path, count: int) -> Path:
    """A folder of so many clips, which are links to one."""
    made = folder / "clips"
    made.mkdir()
    for suffix in (".mp4", ".init.yaml"):
        first = folder / f"first{suffix}"
        shutil.copy2(CLIP.with_suffix(suffix), first)
        for i in range(count):
            (made / f"clip{i:05d}{suffix}").hardlink_to(first)
    return made


def decide(folder: Path, count: int, options: list[str]) -> None:
    inputs, out = clips(folder, count), folder / "out"
    one = folder / "one"
    subprocess.run([*RUN, str(inputs / "clip00000.mp4"), "-o", str(one), *options], check=True)
    name = options[1]
    for i in range(count):
        to = out / f"clip{i:05d}-{name}"
        to.mkdir(parents=True)
        for file in one.iterdir():
            (to / file.name).hardlink_to(file)
    for _ in range(3):
        took, used = timed([*RUN, str(inputs), "-o", str(out), *options])
        print(f"{count} finished clips: {took:.2f} s on the clock, {used:.2f} s of processor")


def overhead(folder: Path, count: int, options: list[str]) -> None:
    inputs = clips(folder, count)
    timed([*RUN, str(inputs / "clip00000.mp4"), "-o", str(folder / "warm"), *options])
    for jobs in ("1", "2", "1", "2"):
        out = folder / f"out{jobs}"
        shutil.rmtree(out, ignore_errors=True)
        took, used = timed([*RUN, str(inputs), "-o", str(out), "-j", jobs, "--threads", "1", *options])
        print(f"-j {jobs}: {took:6.1f} s on the clock, {used:6.1f} s of processor, {took / count:.2f} s a clip")


def timed(command: list[str]) -> tuple[float, float]:
    """Seconds on the clock and of the processor."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env={**os.environ, "OMP_NUM_THREADS": "1"})
    took, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    return took, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


if __name__ == "__main__":
    main()
