"""Does tracking of real clips stay as accurate as it was? .ci/run asks, where the clips are.

    python benchmarks/real_clips.py ../shared/clips                       # check; exit code 1 if a measure is too low
    python benchmarks/real_clips.py ../shared/clips --record --seeds 6    # write real_clips.csv anew

A clip is a folder with a video or img/, and its reference: groundtruth.csv (boxes), mesh.csv (points of a face by
MediaPipe, in units of the distance between the eyes) or hands.csv (boxes of hands by MediaPipe). A check tracks each
clip once, with seed 0, and with two more seeds where a measure lies below its limit: one seed may be an unlucky one.
It fails where the mean of the three lies below the limit in real_clips.csv: the mean of the recorded seeds, less four
standard deviations, or less .03 if that is more. It fails where a clip of the folder is not read to its end without a
warning.

    auc       of a box that begins as the first true box: success AUC, as OTB has it
    within    share of frames of the reference with nose and corners of the mouth within .2 of the reference
    opening   correlation of the distance between the lips with that of the reference
    hands     share of the reference's hands that the row of that name follows: its centre lies in the box of the
              reference, enlarged by half
    on hand   share of rows of hands, not lost, that follow either hand, in frames in which the reference has one
"""

from __future__ import annotations

import argparse
import csv
import math
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from statistics import mean
from typing import Final, NamedTuple

import cv2
import numpy as np
import signers
from boxes import clip_in
from reference import HANDS, MESH, hands_in, points_in

from facetrack_cli import track_video
from facetrack_cli.core.models import VARIABLE
from facetrack_cli.core.types import Start, TargetStart
from facetrack_cli.evaluation.accuracy import measure_boxes
from facetrack_cli.trajectory.formats.boxes import read_truth
from facetrack_cli.trajectory.trajectory import UNSEEN, Trajectory
from facetrack_cli.video.source import open_source

LIMITS: Final = Path(__file__).with_suffix(".csv")
CORNERS: Final = ("nose", "mouth_left", "mouth_right")
LIPS: Final = ("lip_upper", "lip_lower")
MIN_TOLERANCE: Final = 0.03
MIN_VARIATION: Final = 0.03  # of the lips' distance, in distances between the eyes: less says nothing of `opening`


class Case(NamedTuple):
    """A clip by its folder, and a recipe."""

    clip: str
    recipe: str


BOXES: Final = ("david", "girl", "jumping", "albert_brooks", "alek_wek_1", "alek_wek_4")
WORDS: Final = ("again", "bird", "brother", "help", "milk", "no", "please", "sister", "walk", "yes")
VIDEOS: Final = (".avi", ".mkv", ".mp4", ".mpg", ".webm")
CASES: Final = (
    *(Case(clip, "correlation_filter") for clip in BOXES),
    Case("jumping", "adaptive_robust"),
    *(Case(f"people/person{i}", "face") for i in range(1, 9)),
    *(Case(f"signers/{word}", "signer") for word in WORDS),
)


def measure(folder: Path, case: Case, seed: int) -> dict[str, float]:
    os.environ[VARIABLE] = str(LIMITS.parent)  # the limits are of `face` without its network
    cv2.setNumThreads(1)
    clip = folder / case.clip
    truth = read_truth(clip / "groundtruth.csv") if (clip / "groundtruth.csv").exists() else None
    start = None
    if truth is not None:
        left, top, width, height = truth.boxes[0].tolist()
        start = Start(int(truth.frame[0]), {"face": TargetStart((left, top, width, height))}, "the truth")
    hands = hands_in(clip / HANDS) if (clip / HANDS).exists() else {}
    ours = track_video(clip_in(clip), case.recipe, init=start, seed=seed)
    if truth is not None:
        true = truth.take(np.isin(truth.frame, ours.frame))
        mine = ours.take(np.isin(ours.frame, truth.frame))
        return {"auc": float(measure_boxes(mine.boxes, true.boxes).success_auc or 0.0)}
    if hands:
        _, named, off, *_ = signers.measure(ours, hands).tolist()
        return {"hands": named, "on hand": 1 - off}
    return face(points_in(clip / MESH), ours)


def face(true: Mapping[int, Mapping[str, tuple[float, float, float]]], ours: Trajectory) -> dict[str, float]:
    near, lips, true_lips = [], [], []
    parts = {one.part: one for one in ours.parts}
    for frame, known in true.items():
        rows = {name: one.row(frame) for name, one in parts.items()}
        at = {name: np.array([parts[name].x[i], parts[name].y[i]]) for name, i in rows.items() if i is not None}
        unit = known["nose"][2]
        near.append(all(name in at and math.dist(at[name], known[name][:2]) <= 0.2 * unit for name in CORNERS))
        if all(rows[name] is not None and parts[name].status[rows[name]] not in UNSEEN for name in LIPS):
            lips.append(math.dist(*(at[name] for name in LIPS)) / unit)
            true_lips.append(math.dist(*(known[name][:2] for name in LIPS)) / unit)
    found = {"within": float(np.mean(near))}
    if np.std(true_lips) >= MIN_VARIATION:
        found["opening"] = float(np.corrcoef(lips, true_lips)[0, 1])
    return found


def check_whole(clip: Path) -> str:
    """What is wrong with the reading of a clip, which is whole; "" if nothing is."""
    with open_source(clip) as source:
        count = sum(1 for _ in source)
    # a container without a count of frames has an estimate by its duration
    if source.complete and not source.warnings and abs((source.frames_hint or 0) - count) <= 1:
        return ""
    return f"{clip}: {count} frames read of {source.frames_hint}; warnings: {source.warnings}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--record", action="store_true")
    parser.add_argument("--seeds", type=int, default=6, help="to record from [default: 6, from 1 on]")
    parser.add_argument("-j", dest="jobs", type=int, default=2)
    given = parser.parse_args()
    if not given.folder.is_dir():
        print(f"{given.folder}: no such folder; the accuracy on real clips is not checked")
        return 0
    seeds = range(1, 1 + given.seeds) if given.record else range(1)
    with ProcessPoolExecutor(given.jobs) as pool:
        runs = [[pool.submit(measure, given.folder, case, seed) for seed in seeds] for case in CASES]
        if given.record:
            record([[run.result() for run in of_case] for of_case in runs])
            return 0
        clips = [path for path in sorted(given.folder.rglob("*")) if path.suffix in VIDEOS or path.name == "img"]
        damaged = [said for said in pool.map(check_whole, clips) if said]
        found = dict(zip(CASES, (of_case[0].result() for of_case in runs), strict=True))
        if low := compare(found):
            print("below a limit with seed 0; the mean of seeds 0, 1 and 2:")
            more = {case: [pool.submit(measure, given.folder, case, seed) for seed in (1, 2)] for case in dict(low)}
            each = {case: [found[case], *(run.result() for run in of_case)] for case, of_case in more.items()}
            low = compare(
                {case: {name: mean(one[name] for one in all_) for name in all_[0]} for case, all_ in each.items()}
            )
    print(*damaged, *(line for _, line in low), sep="\n")
    print(f"{len(clips)} clips read, {len(damaged)} not whole; {len(CASES)} tracked, {len(low)} measures too low")
    return 1 if damaged or low else 0


def record(runs: Sequence[Sequence[Mapping[str, float]]]) -> None:
    with LIMITS.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["clip", "recipe", "measure", "mean", "std", "limit"])
        for case, of_case in zip(CASES, runs, strict=True):
            for name in of_case[0]:
                values = np.array([found[name] for found in of_case])
                limit = values.mean() - max(4 * values.std(ddof=1), MIN_TOLERANCE)
                table.writerow([*case, name, *(f"{value:.3f}" for value in (values.mean(), values.std(ddof=1), limit))])


def compare(found: Mapping[Case, Mapping[str, float]]) -> list[tuple[Case, str]]:
    """Prints the measures of cases; returns a line for each that lies below its limit."""
    low = []
    with LIMITS.open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            if (case := Case(row["clip"], row["recipe"])) not in found:
                continue
            value = found[case][row["measure"]]
            line = (
                f"{row['clip']} {row['recipe']}: {row['measure']} {value:.3f} (recorded {row['mean']} ± {row['std']})"
            )
            print(line)
            if not value >= float(row["limit"]):
                low.append((case, f"TOO LOW {line}, limit {row['limit']}"))
    return low


if __name__ == "__main__":
    raise SystemExit(main())
