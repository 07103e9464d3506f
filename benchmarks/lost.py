"""Whether `lost` means what it says: status against truth, over many seeds: the table in docs/confidence.md.

    python benchmarks/lost.py sample_videos/*.mp4 --config factorized --config factorized_robust --seeds 10

Counted are rows, one a frame and part, without the first frame. A row is *hidden* if truth says so, *near* if it is off
by less than a sixth of the target's initial size, *gone* if it is hidden or not near.

    precision     of the rows called lost, those hidden; in brackets, those gone
    recall        of the hidden rows, those called lost
    false alarms  of the rows visible and near, those called lost
    tracked near  of the rows called tracked, those near; in brackets, of those that are visible as well
    within 2 std  of the x and y of the visible rows, those within two of the row's std of the truth
    delay         frames from a part's being hidden until it is called lost, and from its return until it is tracked
                  and near; medians over the spans in which that came about
"""

from __future__ import annotations

import argparse
import itertools
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
from accuracy import Clip, load_clip

from facetrack_cli.build import build_tracker
from facetrack_cli.recipe import load_recipe
from facetrack_cli.track import track

NEAR = 1 / 6  # of the target's size
COLUMNS = (
    *("recipe", "lost_below", "patience", "precision (gone)", "recall", "false alarms"),
    *("tracked near (visible)", "within 2 std", "delay: lost, back"),
)
Bools: TypeAlias = "np.ndarray[tuple[int, ...], np.dtype[np.bool_]]"


class Run(NamedTuple):
    """One seed, without the first frame: whether lost and whether near (T, K), and whether within 2 std (T, K, 2)."""

    lost: Bools
    near: Bools
    within: Bools


def run(clip: Clip, config: str, overrides: tuple[str, ...], seed: int) -> Run:
    tracker = build_tracker(load_recipe(config, overrides), clip.start)
    order = [tracker[0].parts.index(part) for part in clip.parts]
    results = [result.targets[0].parts for result in track(tracker, iter(clip.frames), seed)][1:]
    rows = [[parts[i] for i in order] for parts in results]
    off = np.abs(np.array([[(p.x, p.y) for p in row] for row in rows]) - clip.truth[1:])
    std = np.sqrt(np.array([[(p.cov[0], p.cov[2]) for p in row] for row in rows]))
    lost = np.array([[p.status == "lost" for p in row] for row in rows])
    return Run(lost, np.hypot(off[..., 0], off[..., 1]) < NEAR * clip.size, off <= 2 * std)


def share(of: Bools, those: Bools) -> str:
    """How much of `of` is also `those`; a dash if there is nothing to count."""
    return f"{100 * np.sum(of & those) / np.sum(of):.1f} %" if of.any() else "–"


def delays(clip: Clip, lost: Bools, near: Bools) -> str:
    """Medians over all seeds and spans; `lost` and `near` are (seeds, T, K)."""
    until_lost: list[int] = []
    until_back: list[int] = []
    for k in range(len(clip.parts)):
        edges = np.diff(np.concatenate([[1], clip.visible[:, k].astype(int), [1]]))
        begins, ends = np.flatnonzero(edges == -1), np.flatnonzero(edges == 1)
        for (begin, end), one in itertools.product(zip(begins, ends, strict=True), range(len(lost))):
            called = np.flatnonzero(lost[one, begin:end, k])
            back = np.flatnonzero(~lost[one, end:, k] & near[one, end:, k])
            until_lost += called[:1].tolist()
            until_back += back[:1].tolist()
    return ", ".join(f"{np.median(v):.0f}" if v else "–" for v in (until_lost, until_back))


def summarise(clip: Clip, labels: tuple[str, ...], runs: list[Run]) -> str:
    lost, near, within = (np.array(of_all) for of_all in zip(*runs, strict=True))
    visible = np.broadcast_to(clip.visible[1:], lost.shape)
    cells = (
        f"{share(lost, ~visible)} ({share(lost, ~visible | ~near)})",
        share(~visible, lost),
        share(visible & near, lost),
        f"{share(~lost, near)} ({share(~lost & visible, near)})",
        share(np.repeat(visible[..., None], 2, axis=3), within),
        delays(clip._replace(visible=clip.visible[1:]), lost, near),
    )
    return f"| {' | '.join((*labels, *cells))} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="+", type=Path)
    parser.add_argument("--config", action="append", required=True)
    parser.add_argument("--set", dest="overrides", action="append", default=[])
    parser.add_argument("--lost-below", default="0.3", help="values with commas")
    parser.add_argument("--patience", default="3", help="values with commas")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("-j", dest="jobs", type=int, default=2)
    given = parser.parse_args()
    settings = list(itertools.product(given.lost_below.split(","), given.patience.split(",")))
    with ProcessPoolExecutor(given.jobs) as pool:
        for path in given.clips:
            clip = load_clip(path)
            hidden = int((~clip.visible).sum())
            print(f"\n{clip.name}: {clip.visible.size} rows a run, {hidden} hidden; {given.seeds} seeds\n")
            print(f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|")
            for config, (below, patience) in itertools.product(given.config, settings):
                overrides = (*given.overrides, f"confidence.lost_below={below}", f"confidence.patience={patience}")
                runs = list(pool.map(partial(run, clip, config, overrides), range(given.seeds)))
                print(summarise(clip, (config, below, patience), runs), flush=True)


if __name__ == "__main__":
    main()
