"""A closer look at a frame: turned, enlarged, or with room around it.

Detectors see faces that are upright, of some sizes, and not cut off by the border. A view of the frame is a similarity;
in it a face may be all that. What is seen there counts only if the regression, too, sees nose and mouth in it.
"""

import math
from collections.abc import Iterator, Sequence
from itertools import product
from typing import Final

import numpy as np

from facetrack_cli.core.geometry import centre, overlap, square
from facetrack_cli.core.types import Box, Frame, Point, factor_for
from facetrack_cli.tracking.face.stabilized import Similarity
from facetrack_cli.tracking.start.detectors import MAX_SEARCHED_PX, MIN_SEARCHED_PX, Detector, Found

FACE_PX: Final = 67  # pixels of a face's box in the view of a face that is known
NEAR: Final = 3  # sizes of the face's box that this view shows
ROOM: Final = 1.5  # sizes of the frame that the view with room around it shows
FINER: Final = 2  # times that the frame is enlarged, each time twofold
SHARED_PX: Final = 96  # pixels that neighbouring tiles share; larger faces are seen in the coarser view
MIN_OVERLAP: Final = 0.3
TURNS: Final = range(4)


def seen(detector: Detector, frame: Frame, view: Similarity, side: int) -> list[Found]:
    """The faces that a detector sees in a view of `side` pixels, where they are in the frame."""
    still, turn = view.read(frame, side), round(2 * view.angle / math.pi) % 4

    def at(point: Point) -> Point:
        x, y = (view.matrix @ (np.array(point) - (side - 1) / 2) + view.centre).tolist()
        return x, y

    def moved(one: Found) -> Found:
        box = square(np.array(at(centre(one.box))), one.box[2] * view.scale)
        x, y, w, h = (round(value, 2) for value in box)  # to 0.01 px, as in an init file
        eyes = None if one.eyes is None else (at(one.eyes[0]), at(one.eyes[1]))
        return Found((x, y, w, h), eyes, {name: at(point) for name, point in one.points.items()}, one.sure, turn)

    return [moved(one) for one in detector.find(still)]


def near(detector: Detector, frame: Frame, box: Box, turn: int) -> Found | None:
    """The face about in a box, which lies there after quarter turns."""
    view = Similarity(np.array(centre(box)), box[2] / FACE_PX, turn * math.pi / 2)
    return _nearest(seen(detector, frame, view, NEAR * FACE_PX), box)


def righted(detector: Detector, frame: Frame, face: Found) -> Found:
    """The face as it lies, where a turned view shows its nose and mouth; else as it is."""
    odds, best = face.placed(frame).sure, face
    for turn in TURNS if odds <= 0 else ():
        one = near(detector, frame, face.box, turn)
        if one is not None and (sure := one.placed(frame).sure) > max(odds, 0):
            odds, best = sure, one
    return best


def everywhere(detector: Detector, frame: Frame) -> list[Found]:
    """The faces that turned and enlarged views show, and one with room around the frame."""
    found: list[Found] = []
    for view, side in _views(frame.size):
        for one in seen(detector, frame, view, side):
            new = all(overlap(one.box, other.box) < MIN_OVERLAP for other in found)
            if new and one.placed(frame).sure > 0:
                found.append(one)
    return found


def _views(size: tuple[int, int]) -> Iterator[tuple[Similarity, int]]:
    longest = max(size)
    side = min(max(longest, MIN_SEARCHED_PX), MAX_SEARCHED_PX)
    middle = (np.array(size) - 1) / 2
    yield Similarity(middle, ROOM * longest / side), side
    for turn in TURNS[1:]:
        yield Similarity(middle, longest / side, turn * math.pi / 2), side
    factor = factor_for(longest, MAX_SEARCHED_PX)
    for _ in range(FINER):
        if (factor := factor // 2) >= 1:
            for x, y in product(*(_starts(length, factor) for length in size)):
                yield Similarity(np.array([x, y]) + factor * (MAX_SEARCHED_PX - 1) / 2, factor), MAX_SEARCHED_PX


def _starts(length: int, factor: int) -> Sequence[float]:
    """Where tiles begin along a side of the frame."""
    tile = factor * MAX_SEARCHED_PX
    count = max(math.ceil((length - factor * SHARED_PX) / (tile - factor * SHARED_PX)), 1)
    return np.linspace(0, max(length - tile, 0), count).tolist()


def _nearest(faces: Sequence[Found], box: Box) -> Found | None:
    best = max(faces, key=lambda one: overlap(one.box, box), default=None)
    return None if best is None or overlap(best.box, box) < MIN_OVERLAP else best
