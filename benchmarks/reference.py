"""Points of another program as the reference of a clip, and regressions that have not seen the clip."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Final

import numpy as np

from facetrack_cli.core.types import Array, Box
from facetrack_cli.trackers.face import cascaded_regression, eyes

MESH: Final = "mesh.csv"
EYES: Final = "eyes.csv"
HANDS: Final = "hands.csv"
SHIPPED: Final = cascaded_regression.DEFAULT, eyes.DEFAULT


def points_in(path: Path) -> dict[int, dict[str, tuple[float, float, float]]]:
    """By frame and part x, y and the distance between the eyes of a table with columns frame, part, x, y, unit."""
    found: dict[int, dict[str, tuple[float, float, float]]] = {}
    with path.open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            found.setdefault(int(row["frame"]), {})[row["part"]] = float(row["x"]), float(row["y"]), float(row["unit"])
    return found


def hands_in(path: Path) -> dict[int, dict[str, Box]]:
    """By frame and hand the boxes of a table with columns frame, hand, x, y, w, h."""
    found: dict[int, dict[str, Box]] = {}
    with path.open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            box = float(row["x"]), float(row["y"]), float(row["w"]), float(row["h"])
            found.setdefault(int(row["frame"]), {})[row["hand"]] = box
    return found


def inside(x: float, y: float, box: Box) -> bool:
    """Whether a point lies in a box enlarged by half."""
    left, top, width, height = box
    return abs(x - left - width / 2) <= 0.75 * width and abs(y - top - height / 2) <= 0.75 * height


def take_regression(folder: Path | None, name: str) -> None:
    """Let recipes use the regressions of a folder that have not seen the clip: without_NAME.npz and, where it is there,
    eyes_without_NAME.npz. None: the package's.
    """
    cascaded_regression.DEFAULT, eyes.DEFAULT = SHIPPED
    cascaded_regression.load_regression.cache_clear()
    eyes.load_eyes.cache_clear()
    if folder is not None:
        cascaded_regression.DEFAULT = str((folder / f"without_{name}.npz").resolve())
        if (lids := folder / f"eyes_without_{name}.npz").exists():
            eyes.DEFAULT = str(lids.resolve())


def openings_in(path: Path) -> tuple[list[int], Array]:
    """The frames and the openings (T,) of an eyes.csv (frame, opening_left, opening_right), mean of both eyes."""
    with path.open(encoding="utf-8") as file:
        rows = [(int(r["frame"]), float(r["opening_left"]), float(r["opening_right"])) for r in csv.DictReader(file)]
    return [frame for frame, *_ in rows], np.array([both for _, *both in rows]).mean(axis=1)
