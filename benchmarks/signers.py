"""Hands of signers on clips with a reference: how many are followed, with names, and how many rows are on no hand.

usage: python benchmarks/signers.py FOLDER [--config signer] [--config head_hands] [--seeds 5] [--smooth]

FOLDER has a folder for each clip: a video and hands.csv (frame, hand, x, y, w, h), the boxes of hands in it by another
detector. A hand is followed where a row that is neither lost nor absent has its centre in the box, enlarged by half.
`on no hand` counts such rows in no box of their frame: of all, and, `where both`, of frames in which the reference
sees both hands, since it misses hands that are blurred or leave the picture.

Or FOLDER has clips with their ground truth beside them, such as signing.mp4 of the samples. Then rows that are called
lost count, too, since the ground truth knows every hand.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from boxes import clip_in
from reference import HANDS, hands_in, inside

from facetrack_cli import track_video
from facetrack_cli.core.errors import FacetrackError
from facetrack_cli.core.face_points import HANDS as NAMES
from facetrack_cli.core.types import Box
from facetrack_cli.evaluation.compare import default_truth
from facetrack_cli.trajectory.formats.boxes import read_truth
from facetrack_cli.trajectory.reader import read_trajectory
from facetrack_cli.trajectory.trajectory import SEEN, Trajectory


class Clip(NamedTuple):
    """`reference` is by frame and hand; `all_rows`, whether rows that are called lost count."""

    name: str
    video: Path
    reference: Mapping[int, Mapping[str, Box]]
    all_rows: bool = False


def clips_in(folder: Path) -> list[Clip]:
    found = [Clip(one.parent.name, clip_in(one.parent), hands_in(one)) for one in sorted(folder.glob(f"*/{HANDS}"))]
    for video in sorted(folder.glob("*.mp4")):
        truth = read_truth(default_truth(video))
        hands = [one for one in truth.parts if one.target in NAMES]
        known: dict[int, dict[str, Box]] = {}
        for one in hands:
            for frame, x, y, w, h in zip(one.frame.tolist(), one.x, one.y, one.w, one.h, strict=True):
                known.setdefault(frame, {})[one.target] = (x - w / 2, y - h / 2, w, h)
        if hands:
            found.append(Clip(video.stem, video, known, all_rows=True))
    return found


def tracked(clip: Clip, recipe: str, seed: int, smooth: bool) -> Trajectory:
    if not smooth:
        return track_video(clip.video, recipe, seed=seed)
    with TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        words = ["run", clip.video, "--config", recipe, "--seed", seed, "--smooth", "--no-video", "-q", "-o", out]
        subprocess.run([sys.executable, "-m", "facetrack_cli", *map(str, words)], check=True)
        return read_trajectory(out / "trajectory.json")


def measure(rows: Trajectory, reference: Mapping[int, Mapping[str, Box]], all_rows: bool = False) -> np.ndarray:
    """(5,): hands followed, followed with names, rows on no hand of all and where both are seen, head not lost."""
    at = {
        (int(one.frame[i]), one.target): (float(one.x[i]), float(one.y[i]))
        for one in rows.parts
        if one.target in NAMES
        for i in np.flatnonzero((all_rows | ~np.isin(one.status, ("lost", "absent"))) & np.isfinite(one.x))
    }
    hands = followed = named = 0
    for frame, boxes in reference.items():
        rights = []
        for names in (list(boxes), [NAMES[1 - NAMES.index(hand)] for hand in boxes]):
            pairs = [(at.get((frame, name)), boxes[hand]) for hand, name in zip(boxes, names, strict=True)]
            rights.append(sum(place is not None and inside(*place, box) for place, box in pairs))
        hands, named, followed = hands + len(boxes), named + rights[0], followed + max(rights)
    away = {
        key: not any(inside(*place, box) for box in reference.get(key[0], {}).values()) for key, place in at.items()
    }
    both = [far for (frame, _), far in away.items() if len(reference.get(frame, {})) == 2]
    head = next(one for one in rows.parts if one.target not in NAMES)
    shares = followed / max(hands, 1), named / max(hands, 1), float(np.mean([*away.values()])) if away else 0.0
    return np.array([*shares, float(np.mean(both)) if both else 0.0, float(np.mean(np.isin(head.status, SEEN)))])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--config", action="append")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--smooth", action="store_true")
    asked = parser.parse_args()
    for recipe in asked.config or ["signer"]:
        print(f"{recipe:18s} followed  names  on no hand  where both  head   (mean over {asked.seeds} seeds)")
        found = []
        for clip in clips_in(asked.folder):
            try:
                each = [
                    measure(tracked(clip, recipe, seed, asked.smooth), clip.reference, clip.all_rows)
                    for seed in range(asked.seeds)
                ]
            except FacetrackError as e:
                print(f"{clip.name:18s} {e}")
                each = [np.array([0.0, 0.0, 0.0, 0.0, 0.0])]
            found.append(each)
            print(f"{clip.name:18s} {_line(np.mean(each, axis=0))}", flush=True)
        per_seed = [np.mean([each[seed % len(each)] for each in found], axis=0) for seed in range(asked.seeds)]
        print(f"{'mean':18s} {_line(np.mean(per_seed, axis=0))}")
        print(f"{'spread of seeds':18s} {_line(np.std(per_seed, axis=0))}\n")


def _line(figures: np.ndarray) -> str:
    return "{:8.3f} {:6.3f} {:11.3f} {:11.3f} {:6.3f}".format(*figures)


if __name__ == "__main__":
    main()
