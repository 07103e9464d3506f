"""The files of the sample clips, as tests read them."""

import csv
import importlib
import sys
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np

from facetrack_cli.start.init_file import read_init
from facetrack_cli.video.source import open_source
from tests.support.results import file_rows

FOLDER = Path(__file__).parents[2] / "sample_videos"


def from_tools(name: str) -> ModuleType:
    """A module of tools/, which are not installed; it may import those beside it."""
    folder = str(FOLDER.parent / "tools")
    sys.path.insert(0, folder)
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(folder)


def cut(name: str, frames: int, path: Path) -> Path:
    """The first frames of a sample clip as a clip of its own; back and forth if it has not so many."""
    with open_source(FOLDER / f"{name}.mp4", stop=frames) as source:
        images = [frame.bgr for frame in source]
    height, width = images[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 25, (width, height))
    both = images + images[-2:0:-1]
    for k in range(frames):
        writer.write(both[k % len(both)])
    writer.release()
    return path


class TrackClip:
    """A sample clip up to a frame, to be tracked in process: its start, frames, and rows of ground truth."""

    def __init__(self, name: str, stop: int) -> None:
        path = FOLDER / f"{name}.mp4"
        self.start = read_init(path.with_suffix(".init.yaml"))
        with open_source(path, stop=stop) as source:
            self.frames = list(source)
        self.truth = {(row.frame, row.part): row for row in file_rows(path.with_suffix(".truth.csv"))}


def read_rows(name: str) -> list[dict[str, str]]:
    """The rows of a clip's ground truth."""
    with (FOLDER / f"{name}.truth.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def read_pictures(name: str) -> np.ndarray:
    """All images of a clip, (T, H, W, 3) BGR."""
    video = cv2.VideoCapture(str(FOLDER / f"{name}.mp4"))
    pictures = []
    while (got := video.read())[0]:
        pictures.append(got[1])
    video.release()
    return np.array(pictures)
