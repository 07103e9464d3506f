"""How far eyes are open, on real clips, and the blinks that follow from it: docs/results.md.

    python benchmarks/eyes.py clips/people/*/ --regressions left_out --seeds 5
    FACETRACK_MODELS=models python benchmarks/eyes.py clips/people/*/ --regressions left_out

A clip is a folder with a video and eyes.csv (frame, left_outer_x, left_outer_y, ...: the points of both eyes by another
program). `--regressions` is a folder of regressions that have not seen a person: eyes_without_NAME.npz for each clip
NAME, by `tools/eye_descent.py --without NAME`. Networks are used where their files are. Of each clip and seed:

    r             correlation of the opening, mean of both eyes, with the reference's, times the share of rows with one
    blinks        of the reference, found, right; a blink is a run of at most 15 frames in which the opening is below
                  half of its running median of 61 frames, widened to where it passes .75 of that
    90 %          share of corners and lids in the ellipse that should hold 90 % of them
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from boxes import clip_in

sys.path.insert(0, str(Path(__file__).parent.parent / "tools"))

from eye_descent import TABLE, eyes_in

from facetrack_cli.core.types import Array
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.api import track_video
from facetrack_cli.trackers.face import eyes
from facetrack_cli.trajectory.trajectory import SEEN

HALF, LONGEST, NEAR = 30, 15, 2  # frames
ELLIPSE: Final = 4.605  # chi squared of two degrees of freedom, 90 %


def blinks(opening: Array) -> list[tuple[int, int]]:
    """First and last frames of the blinks in an opening (T,)."""
    usual = np.array([np.nanmedian(opening[max(0, t - HALF) : t + HALF + 1]) for t in range(len(opening))])
    low, near = opening < 0.5 * usual, opening < 0.75 * usual
    edges = np.flatnonzero(np.diff(np.concatenate([[False], near, [False]]).astype(int)))
    spans = zip(edges[::2].tolist(), (edges[1::2] - 1).tolist(), strict=True)
    return [(a, b) for a, b in spans if low[a : b + 1].any() and b - a < LONGEST]


def score(clip: Path, seed: int, regressions: Path | None) -> tuple[float, int, int, int, int, float]:
    """r; blinks of the reference, of them found; blinks found, of them right; share in the ellipse."""
    if regressions is not None:
        eyes.DEFAULT = str((regressions / f"eyes_without_{clip.name}.npz").resolve())
        eyes.load_eyes.cache_clear()
    ours, known = track_video(clip_in(clip), load_recipe("face"), seed=seed), eyes_in(clip / TABLE)
    frames = np.arange(max(known) + 1)
    true = np.stack([known.get(t, np.full((8, 2), np.nan)) for t in frames.tolist()])
    at, inside = np.full(true.shape, np.nan), []
    for j, point in enumerate(eyes.POINTS):
        part = ours.find("face", point)
        assert part is not None
        rows, seen = part, np.isin(part.status, SEEN) & (part.frame < len(frames))
        at[rows.frame[seen], j] = np.stack([rows.x, rows.y], axis=1)[seen]
        off = (at - true)[rows.frame[seen], j]
        cov = np.array([[rows.std_x**2, rows.cov_xy], [rows.cov_xy, rows.std_y**2]]).transpose(2, 0, 1)[seen]
        squared = np.einsum("ti,tij,tj->t", off, np.linalg.inv(cov), off)
        inside.extend((squared < ELLIPSE)[np.isfinite(squared)].tolist())
    both, reference = (eyes.openings(one).mean(axis=1) for one in (at, true))
    shown, asked = np.isfinite(both) & np.isfinite(reference), np.isfinite(reference)
    r = np.corrcoef(both[shown], reference[shown])[0, 1] * shown.sum() / asked.sum()
    theirs, mine = blinks(reference), blinks(both)
    pairs = [[a - NEAR <= d and c - NEAR <= b for c, d in mine] for a, b in theirs]
    hit = np.array(pairs, bool).reshape(len(theirs), len(mine))
    return (
        float(r),
        len(theirs),
        int(hit.any(axis=1).sum()),
        len(mine),
        int(hit.any(axis=0).sum()),
        float(np.mean(inside)),
    )


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", type=Path, nargs="+")
    parser.add_argument("--regressions", type=Path)
    parser.add_argument("--seeds", type=int, default=1)
    args = parser.parse_args(argv)
    cv2.setNumThreads(1)
    every = []
    for clip in args.clips:
        found = np.array([score(clip, seed, args.regressions) for seed in range(args.seeds)])
        every.append(found)
        r, there, hit, mine, right, inside = found.mean(axis=0)
        spread = f" ± {found[:, 0].std():.3f}" if args.seeds > 1 else ""
        told = f"blinks {there:.0f}, {hit:.1f} of them found; {mine:.1f} told, {right:.1f} of them right"
        print(f"{clip.name}: r {r:.3f}{spread}, {told}; 90 % {inside:.3f}", flush=True)
    whole = np.array(every).mean(axis=1)
    there, hit, mine, right = whole[:, 1:5].sum(axis=0)
    print(f"all: r {whole[:, 0].mean():.3f}, recall {hit / there:.3f}, precision {right / max(mine, 1):.3f}, "
          f"90 % {whole[:, 5].mean():.3f}")  # fmt: skip


if __name__ == "__main__":
    main()
