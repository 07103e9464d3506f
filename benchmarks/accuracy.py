"""How well recipes track clips with truth, over many seeds: the tables in docs/results.md.

    python benchmarks/accuracy.py sample_videos/occlusion.mp4 --config factorized --config independent --seeds 20

All lengths are pixels. A part is *lost for good* in a run when its median error over the last 25 frames in which it is
visible exceeds a quarter of the target's initial size. After each span in which parts are hidden, the run is *back* at
the first of 5 frames in a row in which every part that was hidden is off by less than a sixth of that size.
"""

from __future__ import annotations

import argparse
import time
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from facetrack_cli.build import build_tracker
from facetrack_cli.recipe import load_recipe
from facetrack_cli.spaces import size_of_points
from facetrack_cli.start import find_init, read_init
from facetrack_cli.track import track
from facetrack_cli.trajectory import read_csv
from facetrack_cli.types import Array, Frame, Start
from facetrack_cli.video.source import open_source

WITHIN = 35


class Clip(NamedTuple):
    """A clip in memory with its truth: (T, K, 2) positions and (T, K) whether each part is visible."""

    name: str
    frames: list[Frame]
    start: Start
    parts: tuple[str, ...]
    truth: Array
    visible: np.ndarray[tuple[int, int], np.dtype[np.bool_]]

    @property
    def size(self) -> float:
        return size_of_points(self.truth[0])


class Run(NamedTuple):
    """One seed: errors (T, K), confidence (T, K), whether lost (T, K), and seconds spent a frame."""

    errors: Array
    confidence: Array
    lost: np.ndarray[tuple[int, int], np.dtype[np.bool_]]
    seconds: float


def load_clip(path: Path) -> Clip:
    init = find_init(path)
    if init is None:
        raise SystemExit(f"{path}: there is no init file beside the clip")
    start = read_init(init)
    rows = read_csv(path.with_name(path.stem + ".truth.csv"))
    parts = tuple(dict.fromkeys(row.part for row in rows))
    with open_source(path, start=start.frame) as source:
        frames = list(source)
    place = {(row.frame, row.part): row for row in rows}
    truth = [[place[f.index, p] for p in parts] for f in frames]
    return Clip(
        path.stem,
        frames,
        start,
        parts,
        np.array([[(row.x, row.y) for row in line] for line in truth], dtype=float),
        np.array([[row.status == "visible" for row in line] for line in truth]),
    )


def run(clip: Clip, config: str, overrides: tuple[str, ...], seed: int) -> Run:
    tracker = build_tracker(load_recipe(config, overrides), clip.start)
    order = [tracker[0].parts.index(part) for part in clip.parts]
    x, confidence, lost = [], [], []
    began = time.perf_counter()
    for result in track(tracker, iter(clip.frames), seed):
        parts = [result.targets[0].parts[i] for i in order]
        x.append([(p.x, p.y) for p in parts])
        confidence.append([p.confidence for p in parts])
        lost.append([p.status == "lost" for p in parts])
    seconds = (time.perf_counter() - began) / len(clip.frames)
    errors = np.hypot(*np.moveaxis(np.array(x) - clip.truth, 2, 0))
    return Run(errors, np.array(confidence), np.array(lost), seconds)


def hidden_spans(clip: Clip) -> list[tuple[int, int, list[int]]]:
    """Spans (first, last + 1, parts) of frames in which some part is hidden."""
    covered = ~clip.visible.all(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], covered, [False]]).astype(int)))
    return [
        (int(a), int(b), np.flatnonzero((~clip.visible[a:b]).any(axis=0)).tolist())
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]


def frames_to_return(clip: Clip, one: Run) -> list[float]:
    """For each hidden span, frames from its end until the run is back; inf if it is not before the next or the end."""
    spans = hidden_spans(clip)
    ends = [*[a for a, _, _ in spans], len(clip.frames)][1:]
    out = []
    for (_, begin, parts), end in zip(spans, ends, strict=True):
        good = (one.errors[begin:end, parts] < clip.size / 6).all(axis=1)
        runs = np.flatnonzero(np.convolve(good, np.ones(5), "valid") == 5) if end - begin >= 5 else np.array([])
        out.append(float(runs[0]) if runs.size else float("inf"))
    return out


def lost_for_good(clip: Clip, one: Run) -> Array:
    """(K,) bool."""
    tail = [one.errors[np.flatnonzero(clip.visible[:, k])[-25:], k] for k in range(len(clip.parts))]
    return np.array([np.median(t) > clip.size / 4 for t in tail])


def summarise(clip: Clip, config: str, runs: list[Run]) -> str:
    errors = np.array([one.errors for one in runs])
    visible = [float(e[clip.visible].mean()) for e in errors]
    cells = [f"{np.mean(visible):.2f} ± {np.std(visible):.2f}"]
    for k in range(len(clip.parts)):
        cells.append(f"{errors[:, clip.visible[:, k], k].mean():.2f}")
    cells.append(f"{errors[:, ~clip.visible].mean():.1f}" if not clip.visible.all() else "")
    cells.append(f"{sum(lost_for_good(clip, one).any() for one in runs)}/{len(runs)}")
    returns = np.array([frames_to_return(clip, one) for one in runs])
    if returns.size:
        back = (returns <= WITHIN).all(axis=1)
        finite = returns[np.isfinite(returns)]
        cells.append(f"{100 * back.mean():.0f} %")
        cells.append(f"{np.median(finite):.0f} / {finite.max():.0f}" if finite.size else "never")
    else:
        cells += ["", ""]
    cells.append(f"{1000 * np.median([one.seconds for one in runs]):.2f}")
    return f"| {config} | " + " | ".join(cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="+", type=Path)
    parser.add_argument("--config", action="append", required=True)
    parser.add_argument("--set", dest="overrides", action="append", default=[])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("-j", dest="jobs", type=int, default=2)
    given = parser.parse_args()
    for path in given.clips:
        clip = load_clip(path)
        spans = ", ".join(f"{a}-{b - 1} ({', '.join(clip.parts[k] for k in p)})" for a, b, p in hidden_spans(clip))
        print(
            f"\n{clip.name}: {len(clip.frames)} frames, size {clip.size:.1f} px, {given.seeds} seeds; hidden: {spans}\n"
        )
        names = " | ".join(clip.parts)
        print(
            f"| recipe | visible points | {names} | hidden points | lost for good | back within {WITHIN} |"
            " frames to return, median / worst | ms a frame |"
        )
        print("|---" * (8 + len(clip.parts) - 1) + "|")
        for config in given.config:
            with ProcessPoolExecutor(given.jobs) as pool:
                runs = list(pool.map(partial(run, clip, config, tuple(given.overrides)), range(given.seeds)))
            print(summarise(clip, config, runs), flush=True)


if __name__ == "__main__":
    main()
