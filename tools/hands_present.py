"""Fit `IN_PICTURE` of facetrack_cli/trackers/hands/target.py: when a hand of a signer is in the picture.

usage: python tools/hands_present.py FOLDER [--present CSV] [--seeds 2]

FOLDER is as in benchmarks/signers.py: real clips, and beside each a detector's boxes of hands in hands.csv. CSV has
`clip,hand,first,last`, in which frames a hand is in the picture, by eye; a hand that it does not name is there in all.
Each clip is tracked as it is, and cut at `CUT` of its height. Of a cut clip hands are where the detector saw them, or
on the line between, and before and after they hang, below the picture; where that is not sure, frames do not count.
Prints the weights, and the calibration error with each clip left out.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "benchmarks"))
from boxes import clip_in
from reference import HANDS, hands_in

from facetrack_cli import load_recipe, track_frames
from facetrack_cli.core.face_points import HANDS as NAMES
from facetrack_cli.core.types import Array, Image
from facetrack_cli.trackers.hands import target

CUT, SURE, NEAR = 0.81, 15.0, 10  # of the height; pixels from there, and frames from when a hand is seen first or last
WEIGHT, PRIOR = 0.25, 1e-4  # of a frame of a cut clip; of the weights' squares


def cues_of(images: list[Image], seed: int) -> dict[int, Array]:
    """By frame the cues (2, 4) of its hands."""
    last: list[Array] = []
    found: dict[int, Array] = {}
    asked = target.in_picture

    def noted(cues: Sequence[Sequence[float]]) -> list[float]:
        last[:] = [np.array(cues)]
        return asked(cues)

    target.in_picture = noted
    try:
        for one in track_frames(images, load_recipe("signer"), seed=seed):
            if last:
                found[one.frame.index] = last.pop()
    finally:
        target.in_picture = asked
    return found


def cut_truth(middles: dict[int, float], height: float, frame: int) -> float:
    """Whether a hand is in the cut clip, 0 or 1, or nan; `middles` are its heights where the detector saw it."""
    seen = sorted(middles)
    if not seen:
        return np.nan
    y = float(np.interp(frame, seen, [middles[one] for one in seen]))
    if seen[0] <= frame <= seen[-1]:
        return 1.0 if y < height - SURE else 0.0 if y > height + SURE else np.nan
    return 0.0 if y > height + SURE or min(abs(frame - seen[0]), abs(frame - seen[-1])) > NEAR else np.nan


def logistic(x: Array, y: Array, w: Array) -> Array:
    """Weights of a logistic regression of y (n,), 0 or 1, on x (n, d), by Newton's steps."""
    b, prior = np.zeros(x.shape[1]), PRIOR * w.sum() * np.diag([0.0] + [1.0] * (x.shape[1] - 1))
    for _ in range(60):
        p = 1 / (1 + np.exp(-np.clip(x @ b, -30, 30)))
        slope = (x * (w * p * (1 - p))[:, None]).T @ x + prior
        b = b + np.clip(np.linalg.solve(slope + 1e-9 * np.eye(len(b)), x.T @ (w * (y - p)) - prior @ b), -2, 2)
    return np.asarray(b)


def error(p: Array, y: Array) -> float:
    bins = np.minimum((p * 10).astype(int), 9)
    return float(sum(abs(np.sum(p[bins == i] - y[bins == i])) for i in range(10)) / len(p))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--present", type=Path)
    parser.add_argument("--seeds", type=int, default=2)
    asked = parser.parse_args()
    spans = {}
    if asked.present:
        with asked.present.open(encoding="utf-8") as file:
            spans = {(r["clip"], r["hand"]): (int(r["first"]), int(r["last"])) for r in csv.DictReader(file)}
    rows: list[tuple[str, bool, float, Array]] = []
    for table in sorted(asked.folder.glob(f"*/{HANDS}")):
        name, boxes, source = table.parent.name, hands_in(table), cv2.VideoCapture(str(clip_in(table.parent)))
        images: list[Image] = []
        while (read := source.read())[0]:
            images.append(np.asarray(read[1], np.uint8))
        height = round(CUT * len(images[0]))
        for cut in (False, True):
            shown = [np.ascontiguousarray(one[:height]) for one in images] if cut else images
            for seed in range(asked.seeds):
                for frame, cues in cues_of(shown, seed).items():
                    for hand, of_hand in zip(NAMES, cues, strict=True):
                        first, last = spans.get((name, hand), (0, len(images)))
                        middles = {f: at[hand][1] + at[hand][3] / 2 for f, at in boxes.items() if hand in at}
                        truth = cut_truth(middles, height, frame) if cut else float(first <= frame <= last)
                        rows.append((name, cut, truth, of_hand))
        print(name, len(rows), flush=True)
    rows = [one for one in rows if np.isfinite(one[2])]
    names, cuts, y, x = (np.array([one[i] for one in rows]) for i in range(4))
    w, p = np.where(cuts, WEIGHT, 1.0), np.zeros(len(y))
    for name in sorted(set(names)):
        out = names == name
        p[out] = 1 / (1 + np.exp(-x[out] @ logistic(x[~out], y[~out], w[~out])))
    print("weights", np.round(logistic(x, y, w), 1).tolist())
    print(f"calibration error, each clip left out: {error(p, y):.3f}; as they are {error(p[~cuts], y[~cuts]):.3f}")


if __name__ == "__main__":
    main()
