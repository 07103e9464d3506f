"""A closer look at a frame: turned, enlarged, or with room around it.

Detectors see faces that are upright, of some sizes, and not cut off by the border. A view of the frame is a similarity;
in it a face may be all that. What is seen there counts only if the regression, too, sees nose and mouth in it.
"""

import math
from collections.abc import Iterator
from itertools import product
from typing import Final

import numpy as np

from facetrack_cli.core.geometry import centre, overlap, square
from facetrack_cli.core.types import Array, Box, Frame, Point, factor_for
from facetrack_cli.tracking.face.stabilized import FACE, Similarity
from facetrack_cli.tracking.start.detectors import MAX_SEARCHED_PX, MIN_SEARCHED_PX, Detector, Found

FACE_PX: Final = 67  # pixels of a face's box in the view of a face that is known
NEAR: Final = 3  # sizes of the face's box that this view shows
ROOM: Final = 1.5  # sizes of the frame that the view with room around it shows
FINER: Final = 2  # times that the frame is enlarged, each time twofold
SHARED_PX: Final = 96  # pixels that neighbouring tiles share; larger faces are seen in the coarser view
LEAST_PX: Final = 24  # pixels of a face's box in a view in which it is looked for
MIN_OVERLAP: Final = 0.3
CERTAIN: Final = 8.0  # log odds of nose and mouth: at least 10 of turned and small faces, at most 7 of what is none
TURNS: Final = range(4)


def seen(detector: Detector, frame: Frame, view: Similarity, side: int) -> list[Found]:
    """The faces that a detector sees in a view of `side` pixels, where they are in the frame."""
    still, turn = view.read(frame, side), quarters(view.angle)

    def at(point: Point) -> Point:
        x, y = (view.matrix @ (np.array(point) - (side - 1) / 2) + view.centre).tolist()
        return x, y

    def moved(one: Found) -> Found:
        box = square(np.array(at(centre(one.box))), one.box[2] * view.scale)
        x, y, w, h = (round(value, 2) for value in box)  # to 0.01 px, as in an init file
        eyes = None if one.eyes is None else (at(one.eyes[0]), at(one.eyes[1]))
        return Found((x, y, w, h), eyes, {name: at(point) for name, point in one.points.items()}, one.sure, turn, True)

    return [moved(one) for one in detector.find(still)]


def near(detector: Detector, frame: Frame, box: Box, turn: int) -> Found | None:
    """The face about in a box, which lies there after quarter turns."""
    view = Similarity(np.array(centre(box)), box[2] / FACE_PX, turn * math.pi / 2)
    best = max(seen(detector, frame, view, NEAR * FACE_PX), key=lambda one: overlap(one.box, box), default=None)
    return None if best is None or overlap(best.box, box) < MIN_OVERLAP else best


def righted(detector: Detector, frame: Frame, face: Found) -> Found:
    """The face as it lies, where a turned view shows its nose and mouth; else as it is."""
    if face.placed(frame).sure > 0:
        return face
    odds, best = CERTAIN, face
    for turn in TURNS:
        one = near(detector, frame, face.box, turn)
        if one is not None and (sure := one.placed(frame).sure) > odds:
            odds, best = sure, one
    return best


def everywhere(detector: Detector, frame: Frame) -> list[Found]:
    """The faces that turned and enlarged views show, and one with room around the frame."""
    found = _each(detector, frame, _views(frame.size))
    return [one for one in found if one.placed(frame).sure > CERTAIN]


def again(detector: Detector, frame: Frame, face: Similarity) -> list[Found]:
    """The faces of a frame that lie as one that was lost, and are about as large or larger."""
    side, factor = face.scale * FACE, factor_for(max(frame.size), MAX_SEARCHED_PX)
    turn, least = quarters(face.angle), factor
    while least > 1 and side < LEAST_PX * least:
        least //= 2
    if not turn and least == factor:
        return detector.find(frame)
    return _each(detector, frame, _tiles(frame.size, least, turn))


def quarters(angle: float) -> int:
    """The quarter turns, 0 to 3, nearest to an angle in radians."""
    return round(2 * angle / math.pi) % 4


def _each(detector: Detector, frame: Frame, views: Iterator[tuple[Similarity, int]]) -> list[Found]:
    """What views show, each face once: as the regression sees it best."""
    found: list[Found] = []
    for view, side in views:
        for one in seen(detector, frame, view, side):
            same = next((i for i, other in enumerate(found) if overlap(one.box, other.box) >= MIN_OVERLAP), None)
            if same is None:
                found.append(one)
            elif one.placed(frame).sure > found[same].placed(frame).sure:
                found[same] = one
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
            yield from _tiles(size, factor)


def _tiles(size: tuple[int, int], factor: int, turn: int = 0) -> Iterator[tuple[Similarity, int]]:
    """Squares that cover a frame reduced by `factor`, seen after quarter turns."""
    for x, y in product(*(_starts(length, factor) for length in size)):
        middle = np.array([x, y]) + factor * (MAX_SEARCHED_PX - 1) / 2
        yield Similarity(middle, factor, turn * math.pi / 2), MAX_SEARCHED_PX


def _starts(length: int, factor: int) -> Array:
    """Where tiles begin along a side of the frame."""
    tile, shared = factor * MAX_SEARCHED_PX, factor * SHARED_PX
    return np.linspace(0, max(length - tile, 0), max(math.ceil((length - shared) / (tile - shared)), 1))
