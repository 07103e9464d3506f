"""What each sense adds to the track of a face, clip by clip: with it and without it.

    python benchmarks/senses.py ../shared/clips                      # six hard clips, two people made hard
    python benchmarks/senses.py ../shared/clips --seeds 5 --people 1,2,3,4,5,6,7,8
    python benchmarks/senses.py ../shared/clips --check     # .ci/run: exit code 1 if a sense makes a clip worse

Clips are folders with reference_points.csv, whose track begins where the search finds a face, and
people/*/ with mesh.csv, of which the hard variants of benchmarks/stress.py are made. The figure is the share of frames
with nose and corners of the mouth within .35 distances between the eyes, the mean over seeds. Senses, where they are
installed:

    all         the recipe `face` as it is
    -cuts       no cut check
    -detector   no detector after the start
    -network    no landmark network ($FACETRACK_MODELS)
    -looks      nothing is said of who a face is
    -embedding  without the extra `people`: the face in grey and colours alone

A sense makes a clip worse where the share without it is higher by more than twice the spread over seeds, and .03.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import cv2
import numpy as np
import stress
from boxes import clip_in
from face import REFERENCE, against_reference

from facetrack_cli.core.models import model_path
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.api import track_video
from facetrack_cli.trackers.face import evidence
from facetrack_cli.trackers.people import descriptor as looks
from facetrack_cli.video.shots import Passing

KINDS = ("plain", "flash", "lens", "whip", "jump_cut", "jump_hat", "jumps")
OVERRIDES = {"-detector": ["head.detections=null"], "-network": ["head.landmarks.network=null"]}


def senses() -> list[str]:
    found = ["all", "-cuts", "-detector", "-looks"]
    found += ["-network"] if model_path("mesh") is not None else []
    return found + (["-embedding"] if looks.embedding_model() is not None else [])


def share(clip: Path, reference: Path, sense: str, seed: int) -> float:
    """Of frames within .35."""
    cv2.setNumThreads(1)
    with ExitStack() as without:
        if sense == "-cuts":
            without.enter_context(patch.object(Passing, "after", lambda self, frame: (self, "")))
        if sense == "-looks":
            without.enter_context(
                patch.object(evidence, "by_looks", lambda views, faces, *others: np.zeros(len(faces)))
            )
        if sense == "-embedding":
            without.enter_context(patch.object(looks, "embedding_model", lambda: None))
        ours = track_video(clip, load_recipe("face", OVERRIDES.get(sense, [])), seed=seed)
    error = against_reference(ours, reference).error
    return float(np.mean((error <= 0.35).all(axis=1)))


def clips(
    folder: Path, real: str, kinds: Sequence[str], people: list[str], made: Path
) -> Iterator[tuple[str, Path, Path]]:
    """Names, clips, and tables of their points."""
    for reference in sorted(folder.glob(f"{real}/{REFERENCE}")):
        yield reference.parent.name, clip_in(reference.parent), reference
    for kind, person in product(kinds, people):
        video = stress.write(folder / "people" / f"person{person}", made, kind)
        rows = video.with_suffix(".mesh.csv").read_text(encoding="utf-8").splitlines()
        core = [
            row.rpartition(",")[0] for row in rows if row.split(",")[1] in ("part", *stress.CORE) and row[-1] != "1"
        ]
        reference = video.with_suffix(".core.csv")
        reference.write_text("\n".join(core) + "\n", encoding="utf-8")
        yield video.stem, video, reference


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--people", default="2,6", help="whose hard variants are made")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--check", action="store_true", help="two clips alone")
    parser.add_argument("-j", dest="jobs", type=int, default=2)
    args = parser.parse_args()
    if not args.folder.is_dir():
        print(f"{args.folder}: no such folder; the senses are not compared")
        return 0
    names, worse = senses(), []
    with TemporaryDirectory() as made, ProcessPoolExecutor(args.jobs, get_context("spawn")) as pool:
        real, kinds, people = ("alek_wek_1", KINDS[1:2], "2") if args.check else ("*", KINDS, args.people)
        every = list(clips(args.folder, real, kinds, people.split(","), Path(made)))
        runs = [
            (clip, reference, name, seed)
            for _, clip, reference in every
            for name in names
            for seed in range(args.seeds)
        ]
        found = np.array(list(pool.map(share, *zip(*runs, strict=True)))).reshape(len(every), len(names), args.seeds)
    print(f"{'within .35':<20}" + "".join(f"{name:>12}" for name in names))
    for (clip, _, _), shares in zip(every, found, strict=True):
        mean, std = shares.mean(axis=1), shares.std(axis=1)
        print(f"{clip:<20}" + "".join(f"{value:12.3f}" for value in mean))
        far = np.maximum(2 * np.hypot(std, std[0]), 0.03)
        worse += [
            f"{clip}: {name} {value:.3f}, all {mean[0]:.3f}"
            for name, value in zip(names, mean - far, strict=True)
            if value > mean[0]
        ]
    print(f"{'mean':<20}" + "".join(f"{value:12.3f}" for value in found.mean(axis=(0, 2))))
    print(*(f"WORSE with it: {line}" for line in worse), sep="\n")
    return 1 if worse and args.check else 0


if __name__ == "__main__":
    raise SystemExit(main())
