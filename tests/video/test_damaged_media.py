"""Clips that are damaged on purpose, each with the verdict that is recorded of it in damaged_media.txt.

The clips are made from sample clips by a seed, so that none of them is stored. To record verdicts anew, on purpose:
`python -m tests.video.test_damaged_media`, then look at the difference.
"""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Image
from facetrack_cli.video.source import open_source
from tests.support import media
from tests.support.damage import KINDS, damaged

SAMPLES = Path(__file__).parents[2] / "sample_videos"
RECORD = Path(__file__).with_name("damaged_media.txt")
CLIPS = ("expressions.mp4", "signing.mp4", "gestures.mkv", "lamp.ts")
SEEDS = 6
BY_DAY = 43  # every so many cases are tried by day, all of them by night
WRONG = 24, 16  # a frame is wrong if so many levels or more are amiss in so many pixels, which can just be seen
CASES = [f"{clip} {kind} {seed}" for clip in CLIPS for kind in KINDS for seed in range(SEEDS)]


@cache
def whole(name: str) -> tuple[bytes, list[Image]]:
    """A sample clip in the container that the suffix names, and its frames in grey."""
    with tempfile.TemporaryDirectory() as folder:
        path = (SAMPLES / name).with_suffix(".mp4")
        if Path(name).suffix != ".mp4":
            path = Path(folder) / name
            media.ffmpeg("-i", (SAMPLES / name).with_suffix(".mp4"), "-c", "copy", "-fflags", "+bitexact", path)
        with open_source(path) as source:
            frames = [grey(frame.bgr) for frame in source]
            assert source.complete and source.warnings == []
        return path.read_bytes(), frames


def grey(image: Image) -> Image:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def verdict(case: str) -> str:
    """What is said of a damaged clip, and what is true of it, each in a word."""
    name, kind, seed = case.split()
    data, shown = whole(name)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_bytes(damaged(data, kind, int(seed)))
        try:
            with open_source(path) as source:
                frames = [grey(frame.bgr) for frame in source]
        except InputError:
            return "refused"
    pairs = zip(shown, frames, strict=False)
    wrong = sum(int((cv2.absdiff(a, b) > WRONG[0]).sum()) >= WRONG[1] for a, b in pairs)
    truth = "cut" if len(frames) != len(shown) else "wrong" if wrong else "same"
    assert source.complete == (not source.warnings)
    return f"{'complete' if source.complete else 'damaged'} {truth}"


def recorded() -> dict[str, str]:
    lines = [line for line in RECORD.read_text().splitlines() if not line.startswith("#")]
    return dict(line.split(": ") for line in lines)


@pytest.mark.parametrize(
    "case", [case if i % BY_DAY == 0 else pytest.param(case, marks=pytest.mark.nightly) for i, case in enumerate(CASES)]
)
def test_the_recorded_verdict(case: str) -> None:
    assert verdict(case) == recorded()[case]


def test_what_the_record_says() -> None:
    """Few clips of which several bytes are damaged are called complete."""
    found = recorded()
    assert list(found) == CASES
    several = {case: said for case, said in found.items() if case.split()[1] not in ("byte", "bit")}
    unseen = [case for case, said in several.items() if said.startswith(("complete wrong", "complete cut"))]
    assert len(unseen) * 100 <= 4 * len(several)
    assert not [case for case in unseen if case.split()[1] == "bytes"]


if __name__ == "__main__":
    head = "# Damaged clips: sample, kind and seed of the damage; what is said of the clip, and what is true of it.\n"
    RECORD.write_text(head + "".join(f"{case}: {verdict(case)}\n" for case in CASES))
