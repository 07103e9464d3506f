"""Join shots of the other sample clips to `film.mp4`, with its ground truth: `python tools/samples/film.py`.

Two people, six cuts, of which one is a dissolve; somebody who leaves and comes back, in other clothes too; a shot of
two, and a shot of nobody.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from clip_files import TruthRow, write_truth, write_video
from numpy.typing import NDArray

SAMPLES = Path(__file__).parents[2] / "sample_videos"
DISSOLVE = 12  # frames
Picture = NDArray[np.uint8]
Box = tuple[float, float, float, float]  # middle, width, height
Shown = tuple[Picture, dict[str, Box]]


class Piece(NamedTuple):
    """Frames [first, stop) of a sample clip, and who is in it."""

    clip: str
    first: int
    stop: int
    person: str


def read(piece: Piece) -> list[Shown]:
    """The images of a piece, and the boxes of who is in them and not covered."""
    video, boxes = cv2.VideoCapture(str(SAMPLES / f"{piece.clip}.mp4")), {}
    for line in (SAMPLES / f"{piece.clip}.truth.csv").read_text(encoding="utf-8").splitlines()[1:]:
        frame, _, _, part, x, y, w, h, _, _, status, *_ = line.split(",")
        if part == "box" and status == "visible":
            boxes[int(frame)] = float(x), float(y), float(w), float(h)
    found: list[Shown] = []
    for t in range(piece.stop):
        image = video.read()[1]
        if t >= piece.first:
            found.append((np.asarray(image, np.uint8), {piece.person: boxes[t]} if piece.person and t in boxes else {}))
    return found


def side_by_side(left: list[Shown], right: list[Shown]) -> list[Shown]:
    """Two shots as one of two people: of each the middle half, around the face of its first frame."""
    found: list[Shown] = []
    half = left[0][0].shape[1] // 2
    corner = [round(min(max(next(iter(one[0][1].values()))[0] - half / 2, 0), half)) for one in (left, right)]
    for pair in zip(left, right, strict=True):
        cut = [image[:, x : x + half] for (image, _), x in zip(pair, corner, strict=True)]
        boxes: dict[str, Box] = {}
        for k, (_, seen) in enumerate(pair):
            boxes |= {name: (x - corner[k] + k * half, y, w, h) for name, (x, y, w, h) in seen.items()}
        found.append((np.hstack(cut), boxes))
    return found


def film() -> list[Shown]:
    shots = [
        read(Piece("lamp", 0, 45, "collins")),
        read(Piece("zoom", 0, 45, "hopper")),
        side_by_side(read(Piece("map", 0, 50, "collins")), read(Piece("zoom", 45, 95, "hopper"))),
        read(Piece("map", 60, 110, "collins")),
        read(Piece("hands", 0, 25, "")),
        read(Piece("zoom", 110, 160, "hopper")),
        read(Piece("gestures", 0, 40, "collins")),
    ]
    frames = shots[0]
    for k, shot in enumerate(shots[1:], 1):
        if k == 5:  # hopper comes in while the desk fades
            for i in range(DISSOLVE):
                share = (i + 1) / (DISSOLVE + 1)
                (old, before), (new, after) = frames[i - DISSOLVE], shot[i]
                mixed = np.asarray(cv2.addWeighted(old, 1 - share, new, share, 0), np.uint8)
                frames[i - DISSOLVE] = mixed, before if share < 0.5 else after
            shot = shot[DISSOLVE:]
        frames += shot
    return frames


def main() -> None:
    frames = film()
    truth = [
        TruthRow(t, name, "box", x, y, w, h)
        for t, (_, seen) in enumerate(frames)
        for name, (x, y, w, h) in seen.items()
    ]
    write_truth(SAMPLES / "film.truth.csv", truth)
    write_video(SAMPLES / "film.mp4", [image for image, _ in frames], 20)
    print(f"film.mp4: {len(frames)} frames")


if __name__ == "__main__":
    main()
