"""The files of the sample clips, as tests read them."""

import csv
from pathlib import Path

import cv2
import numpy as np

FOLDER = Path(__file__).parent.parent / "sample_videos"


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
