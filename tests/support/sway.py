"""Clips of a texture that sways, which five points follow fast, and what tests ask of their runs."""

import sys
import time
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np

from facetrack_cli.video.source import open_source
from facetrack_cli.video.writer import VideoWriter

FACETRACK = [sys.executable, "-m", "facetrack_cli"]
INIT = """\
frame: 0
points: {nose: [60, 40], mouth_left: [48, 62], mouth_right: [72, 62], lip_upper: [60, 58], lip_lower: [60, 68]}
"""
SMALL = ["--config", str(Path(__file__).with_name("face.yaml"))]  # five points, fast
ROWS = 5  # of a frame
TABLES = ["trajectory.csv", "trajectory.json"]


def make_clip(path, frames=30, cover=None):
    """A clip with an init file beside it; its lower half is inverted from the frame `cover` on."""
    coarse = np.random.default_rng(3).integers(40, 220, (12, 16, 3), dtype=np.uint8)
    still = cv2.resize(coarse, (128, 96), interpolation=cv2.INTER_CUBIC)
    with VideoWriter(path, (128, 96), Fraction(25)) as video:
        for i in range(frames):
            image = np.roll(still, round(3 * np.sin(i / 8)), axis=1)
            if cover is not None and i >= cover:
                image[50:] = 255 - image[50:]
            video.write(image, i / 25)
    path.with_suffix(".init.yaml").write_text(INIT)
    return path


def count(path):
    """Frames of a video that can be decoded."""
    with open_source(path) as source:
        n = sum(1 for _ in source)
        assert source.complete
        return n


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def one_line(text):
    lines = text.splitlines()
    assert len(lines) == 1 and "Traceback" not in text, text
    return lines[0]


def until(true, process=None, seconds=60.0):
    """Wait until something is true, and return it; the `process` must live meanwhile."""
    deadline = time.monotonic() + seconds
    while not (value := true()):
        assert process is None or process.poll() is None, process.stderr and process.stderr.read()
        assert time.monotonic() < deadline, "it never came"
        time.sleep(0.005)
    return value
