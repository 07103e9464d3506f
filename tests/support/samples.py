"""The files of the sample clips, as tests read them."""

import csv
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from ruamel.yaml import YAML

from facetrack_cli.tracking.start import read_init
from facetrack_cli.video.source import open_source
from tests.support.results import file_rows

FOLDER = Path(__file__).parents[2] / "sample_videos"


class TrackClip:
    """A sample clip up to a frame, to be tracked in process: its start, frames, and rows of ground truth."""

    def __init__(self, name: str, stop: int) -> None:
        path = FOLDER / f"{name}.mp4"
        self.start = read_init(path.with_suffix(".init.yaml"))
        with open_source(path, stop=stop) as source:
            self.frames = list(source)
        self.truth = {(row.frame, row.part): row for row in file_rows(path.with_suffix(".truth.csv"))}


class BoxClip(NamedTuple):
    """pictures (T, H, W, 3) BGR; boxes (T, ..., 4) middle, width, height in pixels; hidden (T, ...).

    Where there is more than one target, `...` is their number.
    """

    name: str
    pictures: np.ndarray
    boxes: np.ndarray
    hidden: np.ndarray


def read_boxes(name: str, targets: int = 1) -> BoxClip:
    """A clip whose ground truth has a box for each of so many targets."""
    rows = read_rows(name)
    shape = (-1,) if targets == 1 else (-1, targets)
    boxes = np.array([[float(r[k]) for k in "xywh"] for r in rows]).reshape(*shape, 4)
    return BoxClip(name, read_pictures(name), boxes, np.array([r["status"] == "hidden" for r in rows]).reshape(shape))


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


def check_files(clip: BoxClip, frames: int) -> None:
    """A clip of a face is small, of 25 frames/s and 320x240; its ground truth has a row for each of `frames`."""
    assert (FOLDER / f"{clip.name}.mp4").stat().st_size < 600_000
    video = cv2.VideoCapture(str(FOLDER / f"{clip.name}.mp4"))
    assert video.get(cv2.CAP_PROP_FPS) == 25
    video.release()
    assert clip.pictures.shape == (frames, 240, 320, 3)
    expected = [(str(t), f"{t / 25:.2f}", "face", "box") for t in range(frames)]
    assert [(r["frame"], r["time_s"], r["target"], r["part"]) for r in read_rows(clip.name)] == expected


def check_init(clip: BoxClip, target: str = "face") -> None:
    """The init file of a clip of one target is the ground truth of its first frame."""
    init = YAML(typ="safe").load((FOLDER / f"{clip.name}.init.yaml").read_text(encoding="utf-8"))
    assert set(init) == {"frame", target} and init["frame"] == 0 and set(init[target]) == {"box"}
    left, top, width, height = init[target]["box"]
    # pixel centres are at whole numbers, so a box from `left` on has its middle half a pixel before left + width / 2
    middle = left + (width - 1) / 2, top + (height - 1) / 2
    np.testing.assert_allclose((*middle, width, height), clip.boxes[0], atol=0.011)


def likeness(a: np.ndarray, b: np.ndarray) -> float:
    """Correlation of two images."""
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def chroma(picture: np.ndarray, x: float, y: float, side: int) -> np.ndarray:
    """(2,) median Cr and Cb of a square about (x, y)."""
    part = cv2.getRectSubPix(picture, (side, side), (float(x), float(y)))
    middle: np.ndarray = np.median(cv2.cvtColor(part, cv2.COLOR_BGR2YCrCb).reshape(-1, 3)[:, 1:], axis=0)
    return middle
