"""A rendered clip and its three files, video, ground truth and init file: the same for every clip."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from math import hypot
from pathlib import Path
from typing import NamedTuple

import imageio_ffmpeg
import numpy as np
from numpy.typing import NDArray

FPS = 25
CRF = 16
HEADER = "frame,time_s,target,part,x,y,w,h,angle,confidence,status,std_x,std_y,particles,ess,identity,identity_prob"


class TruthRow(NamedTuple):
    """Where a part of a target is in one frame: its centre and, if it is a box, its size, in pixels.

    A box that rolls has its angle in degrees, clockwise as seen; w and h are then the lengths of its sides.
    """

    frame: int
    target: str
    part: str
    x: float
    y: float
    w: float | None = None
    h: float | None = None
    hidden: bool = False
    angle: float | None = None


@dataclass(frozen=True)
class Start:
    """Where a target begins: box (left, top, width, height) and points by part, in pixels of frame 0."""

    box: tuple[float, float, float, float]
    points: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Clip:
    """Pictures (H, W, 3) BGR of one size, rows of ground truth frame by frame, and where each target begins."""

    pictures: list[NDArray[np.uint8]]
    truth: list[TruthRow]
    starts: Mapping[str, Start]
    crf: int = CRF  # of x264: more is smaller and coarser


def start_of(row: TruthRow, *points: TruthRow) -> Start:
    """The start of a target from its box's row of frame 0, and its points'. Pixel centres are at whole numbers."""
    assert row.w is not None and row.h is not None and row.frame == 0, f"no box in frame 0: {row}"
    box = (row.x - (row.w - 1) / 2, row.y - (row.h - 1) / 2, row.w, row.h)
    return Start(box, {point.part: (point.x, point.y) for point in points})


def write_video(path: Path, pictures: list[NDArray[np.uint8]], crf: int = CRF) -> None:
    """The images as H.264, the same bytes for the same images."""
    # one thread and bit-exact headers, so that the same frames give the same file
    params = ["-crf", str(crf), "-preset", "veryslow", "-g", "50", "-flags", "+cgop", "-threads", "1", "-fflags",
              "+bitexact", "-flags:v", "+bitexact+cgop", "-movflags", "+faststart"]  # fmt: skip
    height, width = pictures[0].shape[:2]
    writer = imageio_ffmpeg.write_frames(
        str(path), (width, height), fps=FPS, codec="libx264", pix_fmt_out="yuv420p", quality=None, macro_block_size=1,
        output_params=params, ffmpeg_log_level="error",
    )  # fmt: skip
    writer.send(None)
    for picture in pictures:
        writer.send(np.ascontiguousarray(picture[:, :, ::-1]))
    writer.close()


def write_truth(path: Path, rows: list[TruthRow]) -> None:
    """A row a frame, target and part, in the columns of facetrack's trajectories."""
    with path.open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(HEADER.split(","))
        for row in rows:
            size = ["" if side is None else f"{side:.2f}" for side in (row.w, row.h)]
            head = [row.frame, f"{row.frame / FPS:.2f}", row.target, row.part, f"{row.x:.2f}", f"{row.y:.2f}", *size]
            angle = "" if row.angle is None else f"{row.angle:.2f}"
            out.writerow([*head, angle, "", "hidden" if row.hidden else "visible"] + [""] * 6)


def write_init(path: Path, starts: Mapping[str, Start]) -> None:
    """Boxes and points of frame 0, as `facetrack run` reads them."""
    lines = [f"# {path.name}: the ground truth of the clip's first frame", "frame: 0"]
    for target, start in starts.items():
        box = ", ".join(f"{value}" if isinstance(value, int) else f"{value:.2f}" for value in start.box)
        lines += [f"{target}:", f"  box: [{box}]  # left, top, width, height"]
        lines += ["  points:"] if start.points else []
        lines += [f"    {part}: [{x:.2f}, {y:.2f}]" for part, (x, y) in start.points.items()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def fastest(rows: list[TruthRow]) -> float:
    """Pixels from one frame to the next, of the part that moves most."""
    paths: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for row in rows:
        paths.setdefault((row.target, row.part), []).append((row.x, row.y))
    return max(hypot(bx - ax, by - ay) for path in paths.values() for (ax, ay), (bx, by) in pairwise(path))
