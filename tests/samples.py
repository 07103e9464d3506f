"""The files of the sample clips, as tests read them."""

import csv
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

FOLDER = Path(__file__).parent.parent / "sample_videos"


class BoxClip(NamedTuple):
    """pictures (T, H, W, 3) BGR; boxes (T, targets, 4) middle, width, height in pixels; hidden (T, targets)."""

    pictures: np.ndarray
    boxes: np.ndarray
    hidden: np.ndarray


def read_boxes(name: str, targets: int) -> BoxClip:
    """A clip whose truth has a box for each of so many targets."""
    rows = read_rows(name)
    boxes = np.array([[float(r[k]) for k in "xywh"] for r in rows]).reshape(-1, targets, 4)
    hidden = np.array([r["status"] == "hidden" for r in rows]).reshape(-1, targets)
    return BoxClip(read_pictures(name), boxes, hidden)


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
