"""Where a track begins when nobody said so: the first face that OpenCV's frontal cascades agree on.

One cascade proposes, on a picture brought to a fixed size, so that a frame of 4K costs no more than one of 640 pixels;
a face counts if one of two others sees it in the same place, which leaves hardly a spurious one. Of several faces the
largest is taken; one in the dark only if none in a better light follows. Nothing here is random.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from math import isfinite
from typing import Final

import cv2
import numpy as np

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.geometry import centre, inside, overlap
from facetrack_cli.core.types import Box, Frame, Image, Point, Start, TargetStart
from facetrack_cli.tracking.start.points import cascade, place

PARTS: Final = ("nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower")
"""What can be placed; left and right as seen in the picture."""

BOUND: Final = 250
"""Frames looked at before giving up: ten seconds of most clips."""

LONGEST, SHORTEST = 640, 320  # a picture is searched with its longer side brought between these
SMALLEST: Final = 0.06  # of the picture's shorter side: smaller faces have no features to follow
CONTRAST: Final = 16.0  # standard deviation of grey in a face: 28 to 68 in usual clips, 12 where one can just guess it
TARGET: Final = "face"


class NotHereError(InputError):
    """A frame lacks what a start needs; a later one may have it."""


def haar_start(
    frames: Iterable[Frame],
    parts: Sequence[str] = PARTS,
    *,
    bound: int = BOUND,
    clip: str = "the clip",
    complete: Callable[[Frame, Start], Start] = lambda frame, start: start,
) -> Start:
    """The start at the first of the frames that shows a face: its box, and the parts placed in it (pixels, to 0.01).

    Looks at no more than `bound` frames, on past faces too dark to follow; if all are, at the one of most contrast.
    `complete` adds what else the frame must show; where it raises NotHereError the next frame is tried.
    Raises InputError, naming the `clip`, if none of the frames shows a face whose parts are all in the picture, or that
    of `complete`; UsageError if a part is asked for that is none of the five.
    """
    check_parts(parts)
    first = last = None
    lacking: NotHereError | None = None
    dim: tuple[float, Start] | None = None
    for count, frame in enumerate(frames, start=1):
        first = frame.index if first is None else first
        last = frame.index
        for box in find_faces(frame.bgr):
            contrast = _contrast(frame.bgr, box)
            if dim is not None and contrast <= dim[0]:
                continue
            points = place(frame.bgr, box)
            if not all(inside(points[part], frame.size) for part in parts):
                continue
            try:
                dim = contrast, complete(frame, _start(frame, box, points, parts, "haar"))
            except NotHereError as e:
                lacking = lacking or e
                continue
            if contrast >= CONTRAST:
                return dim[1]
        if count >= bound:
            break
    if dim is not None:
        return dim[1]
    if first is None:
        raise InputError(f"{clip}: no frame to look for a face in; ask for frames that the clip has")
    if lacking is not None:
        later = "" if last == first else f"; no frame to {last} shows more"
        raise InputError(f"{lacking}{later}")
    looked = f"frame {first}" if first == last else f"frames {first} to {last}"
    raise InputError(
        f"{clip}: no face found in {looked}; give its box with --box X,Y,W,H, an init file with --init FILE, "
        "or a later frame with --init-frame N"
    )


def box_start(frame: Frame, box: Box, parts: Sequence[str] = PARTS, *, clip: str = "the clip") -> Start:
    """The start in a frame where the face's box (left, top, width, height; pixels) is known.

    Where a cascade sees the face in the box, the parts are placed by what it sees, else by the box itself. Raises
    InputError if the box has no area or is not in the picture, or a part would be outside; UsageError as `haar_start`.
    """
    check_parts(parts)
    width, height = frame.size
    if not all(map(isfinite, box)) or box[2] <= 0 or box[3] <= 0:
        raise InputError(f"{clip}: the box {_text(box)} has no area; give left, top, width and height in pixels")
    if min(box[2:]) < 2 or max(box[2] / width, box[3] / height) > 2:
        wrong = (
            "smaller than 2 pixels" if min(box[2:]) < 2 else f"far larger than the picture of {width}x{height} pixels"
        )
        raise InputError(f"{clip}: the box {_text(box)} is {wrong}; draw it from the brows to the chin")
    if not inside(centre(box), frame.size):
        raise InputError(
            f"{clip}: the box {_text(box)} is not in the picture of {width}x{height} pixels; "
            "give left, top, width and height in pixels of the frame"
        )
    points = place(frame.bgr, _face_in(frame.bgr, box) or box)
    outside = [part for part in parts if not inside(points[part], frame.size)]
    if outside:
        raise InputError(
            f"{clip}: with the box {_text(box)}, {', '.join(outside)} would be outside the picture; "
            "draw the box from the brows to the chin, or give the points in an init file with --init FILE"
        )
    return _start(frame, box, points, parts, "--box")


def check_parts(parts: Sequence[str]) -> None:
    """UsageError for a part that is none of the five."""
    unknown = [part for part in parts if part not in PARTS]
    if unknown:
        raise UsageError(
            f"no cascade can place {', '.join(unknown)}, only {', '.join(PARTS)}; "
            "say where the parts are in an init file, with --init FILE"
        )


def find_faces(image: Image) -> list[Box]:
    """Boxes of the frontal faces in a picture (BGR), the largest first, in whole pixels."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    height, width = grey.shape
    zoom = float(np.clip(1.0, SHORTEST / max(width, height), LONGEST / max(width, height)))
    if zoom != 1:
        size = max(round(width * zoom), 1), max(round(height * zoom), 1)
        grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA if zoom < 1 else cv2.INTER_LINEAR)
    seen = np.asarray(grey, np.uint8)
    smallest = max(20, round(SMALLEST * min(seen.shape)))
    faces = []
    for box in _detect("frontalface_alt2", seen, 3, smallest, max(seen.shape)):
        seconded = sum(_seconded(name, seen, box) for name in ("frontalface_default", "frontalface_alt"))
        if seconded:
            # one that all three see is taken before a slightly larger one that two see
            faces.append((box[2] * (2 + seconded), box))
    faces.sort(key=lambda face: (-face[0], face[1]))
    return [(round(x / zoom), round(y / zoom), round(w / zoom), round(h / zoom)) for _, (x, y, w, h) in faces]


def _contrast(image: Image, box: Box) -> float:
    x, y, w, h = map(int, box)
    return float(cv2.cvtColor(image[y : y + h, x : x + w], cv2.COLOR_BGR2GRAY).std())


def _detect(name: str, grey: Image, neighbours: int, smallest: int, largest: int) -> list[tuple[int, int, int, int]]:
    found = cascade(name).detectMultiScale(grey, 1.1, neighbours, 0, (smallest, smallest), (largest, largest))
    return [(int(x), int(y), int(w), int(h)) for x, y, w, h in found]


def _seconded(name: str, grey: Image, box: tuple[int, int, int, int]) -> bool:
    """Whether another cascade sees a face in the same place."""
    x, y, w, h = box
    margin = round(0.35 * w)
    left, top = max(x - margin, 0), max(y - margin, 0)
    patch = np.ascontiguousarray(grey[top : y + h + margin, left : x + w + margin])
    near = _detect(name, patch, 2, max(20, round(0.7 * w)), round(1.4 * w))
    return any(overlap((x, y, w, h), (bx + left, by + top, bw, bh)) > 0.5 for bx, by, bw, bh in near)


def _face_in(image: Image, box: Box) -> Box | None:
    """The face that fits a hand-drawn box best, if a cascade sees one."""
    height, width = image.shape[:2]
    x, y, w, h = box
    left, top = max(int(x - 0.4 * w), 0), max(int(y - 0.4 * h), 0)
    patch = image[top : min(int(y + 1.4 * h) + 1, height), left : min(int(x + 1.4 * w) + 1, width)]
    zoom = min(1.0 if min(w, h) >= 40 else 80 / min(w, h), LONGEST / max(patch.shape[:2]), 200 / min(w, h))
    size = max(round(patch.shape[1] * zoom), 1), max(round(patch.shape[0] * zoom), 1)
    grey = cv2.cvtColor(cv2.resize(patch, size, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY)
    smallest = max(20, round(0.45 * min(w, h) * zoom))
    faces = [
        (fx / zoom + left, fy / zoom + top, fw / zoom, fh / zoom)
        for fx, fy, fw, fh in _detect("frontalface_alt2", np.asarray(grey, np.uint8), 2, smallest, max(grey.shape))
    ]
    best = max(faces, key=lambda face: (overlap(face, box), face), default=None)
    return best if best is not None and overlap(best, box) > 0.35 else None


def _start(frame: Frame, box: Box, points: dict[str, Point], parts: Sequence[str], origin: str) -> Start:
    # to 0.01 px, as in an init file: a run from that file begins where a run without it does
    placed = {part: (round(points[part][0], 2), round(points[part][1], 2)) for part in parts}
    return Start(frame.index, {TARGET: TargetStart(box=box, points=placed)}, origin)


def _text(box: Box) -> str:
    return ",".join(f"{value:g}" for value in box)
