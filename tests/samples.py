"""The files of the sample clips, as tests read them."""

import csv
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

FOLDER = Path(__file__).parent.parent / "sample_videos"


class BoxClip(NamedTuple):
    """pictures (T, H, W, 3) BGR; boxes (T, ..., 4) middle, width, height in pixels; hidden (T, ...).

    Where there is more than one target, `...` is their number.
    """

    name: str
    pictures: np.ndarray
    boxes: np.ndarray
    hidden: np.ndarray


def read_boxes(name: str, targets: int = 1) -> BoxClip:
    """A clip whose truth has a box for each of so many targets."""
    rows = read_rows(name)
    shape = (-1,) if targets == 1 else (-1, targets)
    boxes = np.array([[float(r[k]) for k in "xywh"] for r in rows]).reshape(*shape, 4)
    return BoxClip(name, read_pictures(name), boxes, np.array([r["status"] == "hidden" for r in rows]).reshape(shape))


def read_rows(name: str) -> list[dict[str, str]]:
    """The rows of a clip's truth."""
    with (FOLDER / f"{name}.truth.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def read_pictures(name: str) -> np.ndarray:
    """All pictures of a clip, (T, H, W, 3) BGR."""
    video = cv2.VideoCapture(str(FOLDER / f"{name}.mp4"))
    pictures = []
    while (got := video.read())[0]:
        pictures.append(got[1])
    video.release()
    return np.array(pictures)


def chroma(picture: np.ndarray, x: float, y: float, side: int) -> np.ndarray:
    """(2,) median Cr and Cb of a square about (x, y)."""
    part = cv2.getRectSubPix(picture, (side, side), (float(x), float(y)))
    middle: np.ndarray = np.median(cv2.cvtColor(part, cv2.COLOR_BGR2YCrCb).reshape(-1, 3)[:, 1:], axis=0)
    return middle
