"""A closer look at a frame: turned, enlarged, or with room around it.

Detectors see faces that are upright, of some sizes, and not cut off by the border. A view of the frame is a similarity;
in it a face may be all that. What is seen there counts only if the regression, too, sees nose and mouth in it.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import product
from typing import Final

import numpy as np

from facetrack_cli.core.geometry import centre, overlap, square
from facetrack_cli.core.types import Box, Frame, Point, factor_for
from facetrack_cli.trackers.face.detectors import MAX_SEARCHED_PX, MIN_SEARCHED_PX, Detection, Detector
from facetrack_cli.trackers.face.stabilized import FACE, Similarity

FACE_PX: Final = 67  # pixels of a face's box in the view around a detected face
NEAR: Final = 3  # sizes of the face's box that this view shows
ROOM: Final = 1.5  # sizes of the frame that the view with room around it shows
SHARED_PX: Final = 96  # pixels that neighbouring tiles share; larger faces are seen in the coarser view
LEAST_PX: Final = {"haar": 40, "yunet": 24}  # pixels of the box of a face that a detector sees well in a view
MIN_OVERLAP: Final = 0.3
CERTAIN: Final = 8.0  # log odds of nose and mouth: at least 10 of turned and small faces, at most 7 of what is none
TURNS: Final = range(8)
SKEW: Final = (1.0, 1.4)  # by how much a view shows more if it is turned by an odd number of eighths


def seen(detector: Detector, frame: Frame, view: Similarity, side: int) -> Iterator[Detection]:
    """The faces that a detector sees in a view of `side` pixels, where they are in the frame."""

    def at(point: Point) -> Point:
        x, y = (view.matrix @ (np.array(point) - (side - 1) / 2) + view.centre).tolist()
        return x, y

    for face in detector.find(view.read(frame, side)):
        box = square(np.array(at(centre(face.box))), face.box[2] * view.scale)
        x, y, w, h = (round(value, 2) for value in box)  # to 0.01 px, as in an init file
        eyes = None if face.eyes is None else (at(face.eyes[0]), at(face.eyes[1]))
        points = {name: at(point) for name, point in face.points.items()}
        yield face._replace(box=(x, y, w, h), eyes=eyes, points=points, turn=eighths(view.angle), closer=True)


def near(detector: Detector, frame: Frame, box: Box, turn: int) -> Detection | None:
    """The face about in a box, which is turned there by eighths of a turn."""
    view = Similarity(np.array(centre(box)), box[2] / FACE_PX, turn * math.pi / 4)
    best = max(seen(detector, frame, view, NEAR * FACE_PX), key=lambda face: overlap(face.box, box), default=None)
    return None if best is None or overlap(best.box, box) < MIN_OVERLAP else best


def righted(detector: Detector, frame: Frame, face: Detection) -> Detection:
    """The face as it lies and as large as it is, where a closer view shows its nose and mouth; else as it is."""
    best, odds = face, face.placed(frame).log_odds
    factor = factor_for(max(frame.size), MAX_SEARCHED_PX)
    small = factor > 1 and face.box[2] < LEAST_PX[detector.name] * factor
    for turn in TURNS if odds <= 0 or small else ():
        closer = near(detector, frame, face.box, turn)
        if closer is not None and (closer_odds := closer.placed(frame).log_odds) > max(odds, CERTAIN):
            best, odds = closer, closer_odds
    return best


def everywhere(detector: Detector, frame: Frame) -> list[Detection]:
    """The faces that turned and enlarged views show, and one with room around the frame."""
    longest, middle = max(frame.size), (np.array(frame.size) - 1) / 2
    factor = factor_for(longest, MAX_SEARCHED_PX)
    side = min(max(longest, MIN_SEARCHED_PX), MAX_SEARCHED_PX)
    views = [Similarity(middle, ROOM * longest / side)]
    views += [Similarity(middle, SKEW[turn % 2] * longest / side, turn * math.pi / 4) for turn in TURNS[1:]]
    tiles = [tile for finer in (2, 4) if factor >= finer for tile in _tiles(frame.size, factor // finer)]
    return _certain(detector, frame, [*((view, side) for view in views), *tiles])


def again(detector: Detector, frame: Frame, face: Similarity) -> list[Detection]:
    """The faces of a frame that lie as one that was lost, and those upright: it may have been turned before it went."""
    turn, whole = eighths(face.angle), factor_for(max(frame.size), MAX_SEARCHED_PX)
    factor = min(whole, 2 ** max(math.floor(math.log2(face.scale * FACE / LEAST_PX[detector.name])), 0))
    upright = detector.find(frame)
    if not turn and factor == whole:
        return upright
    # first, or a crowd of upright and larger faces would leave no room for the one that was lost
    return [*_certain(detector, frame, _tiles(frame.size, factor, turn), upright), *upright]


def eighths(angle: float) -> int:
    """The eighths of a turn, 0 to 7, nearest to an angle in radians."""
    return round(4 * angle / math.pi) % 8


def _certain(
    detector: Detector, frame: Frame, views: Iterable[tuple[Similarity, int]], others: Sequence[Detection] = ()
) -> list[Detection]:
    """The faces of views in which the regression sees nose and mouth, each once, and none of the `others`."""
    faces: list[Detection] = []
    for face in (face for view, side in views for face in seen(detector, frame, view, side)):
        new = all(overlap(face.box, other.box) < MIN_OVERLAP for other in (*others, *faces))
        if new and face.placed(frame).log_odds > CERTAIN:
            faces.append(face)
    return faces


def _tiles(size: tuple[int, int], factor: int, turn: int = 0) -> Iterator[tuple[Similarity, int]]:
    """Squares that cover a frame reduced by `factor`, seen after eighths of a turn."""
    tile, shared = factor * MAX_SEARCHED_PX, factor * SHARED_PX
    counts = (max(math.ceil((length - shared) / (tile - shared)), 1) for length in size)
    starts = (np.linspace(0, max(length - tile, 0), count) for length, count in zip(size, counts, strict=True))
    for x, y in product(*starts):
        middle = np.array([x, y]) + factor * (MAX_SEARCHED_PX - 1) / 2
        yield Similarity(middle, SKEW[turn % 2] * factor, turn * math.pi / 4), MAX_SEARCHED_PX
