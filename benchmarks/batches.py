"""What a batch costs beside the tracking, and what follows for a thousand hours of video. Writes nothing.

    python benchmarks/batches.py decide 10000            # seconds to find that so many clips are finished
    python benchmarks/batches.py overhead 200 --workers 2    # -j, --shard and --cluster against two plain loops
    python benchmarks/batches.py simulate --track 2.0 --overhead 0.1 --send 0.005   # figures of the other two

`overhead` tracks short clips in turn by: a loop in one process; a loop of the shell that starts facetrack for each;
-j; --shard; --cluster. A quarter of the clips, and all of them, tell what the start takes and what a clip does;
`more` is how much more than in the loop in one process: seconds on the clock, times those at a time, which other work
on the machine spoils, and seconds of the processor. At the end stands the latter in percent of a clip of 11 s, whole,
with its video. To reach: at most 5 %.

`simulate` hands out 1,000 hours, as clips of 10 s and of 10 min, to 1, 10 and 100 machines of 8 cores: each core
takes the next clip when it has done one, and the head sends one after another.
"""

from __future__ import annotations

import argparse
import ctypes
import heapq
import os
import resource
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

CLIP = Path(__file__).parents[1] / "sample_videos" / "expressions.mp4"
FACETRACK = [sys.executable, "-m", "facetrack_cli"]
RUN = [*FACETRACK, "run"]
LOOP = """
import sys
from facetrack_cli.__main__ import main
for clip in open(sys.argv[2]).read().splitlines():
    main(["run", clip, *sys.argv[3:], "-o", sys.argv[1] + clip[-9:-4]])
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    kinds = parser.add_subparsers(dest="what", required=True)
    for what in ("decide", "overhead"):
        kind = kinds.add_parser(what)
        kind.add_argument("clips", type=int)
        kind.add_argument("--stop", default="60", help="frames of a clip")
        kind.add_argument("--config", default="factorized")
        kind.add_argument("--workers", type=int, default=2)
    kind = kinds.add_parser("simulate")
    for name in ("track", "overhead", "send"):
        kind.add_argument(f"--{name}", type=float, required=True, help="seconds a clip of ten seconds")
    given = parser.parse_args()
    if given.what == "simulate":
        simulate(given.track, given.overhead, given.send)
        return
    adopt()
    with tempfile.TemporaryDirectory() as folder:
        options = ["--config", given.config, "--no-video", "-q", "--threads", "1"]
        if given.what == "decide":
            decide(Path(folder), given.clips, [*options, "--stop", given.stop])
        else:
            overhead(Path(folder), given.clips, options, given.stop, given.workers)


def clips(folder: Path, count: int) -> Path:
    """A folder of so many clips, which are links to one."""
    made = folder / "clips"
    made.mkdir(parents=True)
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
        print(f"{count} finished clips {took:6.2f} s on the clock, {used:6.2f} s of processor")


def overhead(folder: Path, count: int, options: list[str], stop: str, workers: int) -> None:
    one = clips(folder / "one", 1) / "clip00000.mp4"
    timed([*RUN, str(one), *options, "-o", str(folder / "warm")])  # kernels are compiled
    without_video = [word for word in options if word != "--no-video"]
    whole = timed([*RUN, str(one), *without_video, "-o", str(folder / "whole")])[1]
    whole -= timed([*RUN, str(one), *options, "--stop", "1", "-o", str(folder / "start")])[1]
    print(f"{count} clips of {stop} frames, {workers} at a time; a whole clip of 11 s: {whole:.2f} s of processor")
    print(
        f"{'':24}{'clock: start':>14}{'a clip':>9}{'more':>9}{'processor: start':>19}{'a clip':>9}{'more':>9}", end=""
    )
    print(f"{'of 11 s':>10}")
    few, base = max(1, count // 4), (0.0, 0.0)
    for kind, at_once in ((0, 1), (1, 1), (2, workers), (3, workers), (4, workers)):
        sums = []
        for number in (few, count):
            place = folder / f"{kind}-{number}"
            name, command = list(kinds(place, clips(place, number), [*options, "--stop", stop], workers).items())[kind]
            sums.append(timed(command))
        (clock, used), (fewer_clock, fewer_used) = sums[1], sums[0]
        clip = (clock - fewer_clock) * at_once / (count - few), (used - fewer_used) / (count - few)
        base = base if kind else clip
        more = clip[0] - base[0], clip[1] - base[1]
        start = clock - count * clip[0] / at_once, used - count * clip[1]
        row = f"{name:24}{start[0]:14.1f}{clip[0]:9.3f}{more[0]:9.3f}{start[1]:19.1f}{clip[1]:9.3f}{more[1]:9.3f}"
        print(f"{row}{more[1] / whole:10.1%}", flush=True)
    print(f"to send a task and hear of its end: {sending(200):.4f} s")


def kinds(place: Path, inputs: Path, options: list[str], workers: int) -> dict[str, list[str]]:
    """The command lines to compare."""
    listed = place / "list.txt"
    listed.write_text("\n".join(sorted(str(one) for one in inputs.glob("*.mp4"))) + "\n")
    words, out = shlex.join([*RUN, *options]), place / "out"
    shell = f"while read -r clip; do {words} -o {out}/$(basename $clip .mp4) $clip; done < {listed}"
    shards = "".join(f"{words} {inputs} --shard {i}/{workers} -o {out} & " for i in range(1, workers + 1))
    batch, file = [*RUN, str(inputs), *options, "-o", str(out)], place / "scheduler.json"
    dask = f"--scheduler-file {file} --no-dashboard >/dev/null 2>&1 &"
    start = f"{sys.executable} -m distributed.cli.dask_scheduler --port 0 {dask}"
    start += f" until [ -s {file} ]; do sleep 0.1; done;"
    start += f" {sys.executable} -m distributed.cli.dask_worker --nthreads 1 --nworkers {workers} {dask}"
    return {
        "a loop in one process": [sys.executable, "-c", LOOP, f"{out}/", str(listed), *options],
        "a loop of the shell": ["bash", "-c", shell],
        f"-j {workers}": [*batch, "-j", str(workers)],
        f"--shard I/{workers}": ["bash", "-c", f"{shards} wait"],
        f"--cluster, {workers} workers": [
            "bash",
            "-c",
            f"{start} {shlex.join([*batch, '--cluster', str(file)])}; kill $(jobs -p); wait",
        ],
    }


def sending(count: int) -> float:
    """Seconds for each of so many tasks that do nothing, by the scheduler in a process of its own."""
    from distributed import Client, LocalCluster, wait

    with (
        LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        wait([client.submit(int, pure=False) for _ in range(10)])
        began = time.perf_counter()
        wait([client.submit(int, pure=False) for _ in range(count)])
        return (time.perf_counter() - began) / count


def simulate(track: float, overhead: float, send: float) -> None:
    print("1,000 hours on machines of 8 cores: hours, and the share of the cores' time that is tracking")
    print(f"{'machines':>10}{'clips of 10 s':>24}{'clips of 10 min':>24}")
    for machines in (1, 10, 100):
        row = f"{machines:10}"
        for length in (10.0, 600.0):
            count, work = round(3.6e6 / length), track * length / 10 + overhead
            free = [0.0] * (8 * machines)
            for i in range(count):
                heapq.heapreplace(free, max(free[0], i * send) + work)
            took = max(free)
            row += f"{took / 3600:14.2f} h {count * track * length / 10 / (took * len(free)):6.1%}"
        print(row)


def adopt() -> None:
    """Take over processes whose parent ends, so that the processor's time of all of them is counted (Linux)."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(36, 1, 0, 0, 0)


def timed(command: list[str]) -> tuple[float, float]:
    """Seconds on the clock and of the processor."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=environment)
    took = time.perf_counter() - began
    try:
        while True:  # those that were taken over
            os.waitpid(-1, 0)
    except ChildProcessError:
        pass
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return took, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


if __name__ == "__main__":
    main()
