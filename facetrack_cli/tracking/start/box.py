"""The start in a box that somebody gives."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Final

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import centre, inside
from facetrack_cli.core.types import Box, Frame, Start, TargetStart
from facetrack_cli.tracking.start.detectors import detector
from facetrack_cli.tracking.start.haar import PARTS, check_parts

_ALL_OF_IT: Final = "draw it from the brows to the chin"


def box_start(
    frame: Frame, box: Box, parts: Sequence[str] = PARTS, *, by: str | None = None, clip: str = "the clip"
) -> Start:
    """The start in a frame where the face's box (left, top, width, height; pixels) is known.

    The parts are placed in the face that a detector sees in the box, else in the box. `by`: as for `detector`.
    InputError for a wrong box.
    """
    check_parts(parts)
    size = f"the frame of {frame.size[0]}x{frame.size[1]} pixels"
    if not all(map(isfinite, box)) or min(box[2:]) <= 0:
        wrong = "has no area; give left, top, width and height in pixels"
    elif min(box[2:]) < 2:
        wrong = f"is smaller than 2 pixels; {_ALL_OF_IT}"
    elif max(box[2] / frame.size[0], box[3] / frame.size[1]) > 2:
        wrong = f"is far larger than {size}; {_ALL_OF_IT}"
    elif not inside(centre(box), frame.size):
        wrong = f"is not in {size}; give left, top, width and height in pixels of the frame"
    else:
        look = detector(by)
        points = look.place(frame.bgr, box)
        outside = [part for part in parts if not inside(points[part], frame.size)]
        if not outside:
            # to 0.01 px, as in an init file: a run from that file begins in the same place
            placed = {part: (round(points[part][0], 2), round(points[part][1], 2)) for part in parts}
            target = TargetStart(box=box, points=placed)
            return Start(frame.index, {"face": target}, "--box", detector=look.name, placed=True)
        wrong = f"would put {', '.join(outside)} outside the frame; {_ALL_OF_IT}, or give the points with --init FILE"
    raise InputError(f"{clip}: the box {','.join(f'{value:g}' for value in box)} {wrong}")
