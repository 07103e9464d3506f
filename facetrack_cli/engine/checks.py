"""Whether a start fits the clip and the recipe."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import centre, inside
from facetrack_cli.core.types import BOX, Box, Start, TargetStart

if TYPE_CHECKING:
    from facetrack_cli.engine.loop import Tracker
    from facetrack_cli.recipe.model import Recipe

MIN_WINDOW_PX: Final = 3.0  # pixels; windows are not made smaller
MIN_BOX_PX: Final = 6  # pixels of a side; in less there is nothing to see


def box_of(start: Start, name: str) -> Box:
    """The target's box; InputError if it has none."""
    box = start.targets[name].box
    if box is None:
        points = ", or follow its points, by a recipe such as factorized" if start.targets[name].points else ""
        need = f"{name} has no box, which the recipe follows; add one, as in box: [x, y, w, h]"
        raise InputError(f"{start.origin}: {need}{points}")
    return box


def check_size(origin: str, name: str, box: Box) -> Box:
    """A target's box, which `origin` gave; InputError if it is too small to see anything in it."""
    if min(box[2:]) < MIN_BOX_PX:
        least = f"{MIN_BOX_PX}x{MIN_BOX_PX} pixels"
        raise InputError(f"{origin}: the box of {name} is smaller than {least}; give a larger one")
    return box


def size_of_box(start: Start, name: str) -> float:
    """The unit of length of a region or a single point: the mean side of its box, in pixels."""
    box = start.targets[name].box
    if box is None:
        raise InputError(f"{start.origin}: {name} has a single point and no box to measure lengths by; add a box")
    return float(np.sqrt(box[2] * box[3]))


def check_windows(recipe: Recipe, tracker: Tracker, size: tuple[int, int], origin: str) -> None:
    """Refuse windows and boxes, given by `origin`, larger than the frame (width, height): memory without bound."""
    for target in tracker:
        for part, (w, h) in target.windows.items():
            if recipe.points and part == BOX:
                continue  # a face may fill the frame
            if max(w / size[0], h / size[1]) > 1 and max(w, h) > MIN_WINDOW_PX:
                larger = f"larger than the frame of {size[0]}x{size[1]}; make it smaller"
                if not recipe.points:
                    raise InputError(f"{origin}: the box of {target.name}, {w:g}x{h:g} pixels, is {larger}")
                raise recipe.error("target.windows", f"the window of {part} would be {w:.0f}x{h:.0f} pixels, {larger}")


def check_start(start: Start, size: tuple[int, int], parts: Sequence[str], frames: int | None = None) -> None:
    """InputError if the start does not fit the clip of that (width, height) in pixels, or lacks any of the `parts`.

    `frames` is the clip's number of frames if it is known for certain.
    """
    origin, larger = start.origin, f"is larger than the frame of {size[0]}x{size[1]} pixels; make it smaller"
    if frames is not None and start.frame >= frames:
        more = f"the clip ends with frame {frames - 1}; choose one that it has"
        raise InputError(f"{origin}: starts at frame {start.frame}, but {more}")
    for name, target in start.targets.items():
        if missing := ", ".join(part for part in parts if part not in target.points):
            boxes = ", or follow its box by a recipe of regions, as contour_histogram" if target.box is not None else ""
            remedy = f"add it, or have all points placed with --box X,Y,W,H{boxes}"
            raise InputError(f"{origin}: no point for {missing} of {name}, which the recipe follows; {remedy}")
        _check_places(origin, name, target, size)
        for part, (w, h) in target.windows.items():
            if w > size[0] or h > size[1]:
                raise InputError(f"{origin}: the window of {part} of {name}, {w:g}x{h:g}, {larger}")
    for one in start.corrections:
        if one.frame <= start.frame:
            begins = f"but the track begins at frame {start.frame}; remove that correction, or begin earlier"
            raise InputError(f"{origin}: corrects {one.target} at frame {one.frame}, {begins}")
        # kept points are where the tracker saw them, which may be beyond the border
        name, box = f"{one.target} at frame {one.frame}", one.given.box
        _check_places(origin, name, one.given, size)
        if box is not None and (box[2] > size[0] or box[3] > size[1]):
            raise InputError(f"{origin}: the box of {name}, {box[2]:g}x{box[3]:g} pixels, {larger}")


def _check_places(origin: str, name: str, target: TargetStart, size: tuple[int, int]) -> None:
    """InputError if the box's centre, or a point, is outside of a frame of that (width, height)."""
    outside = f"is outside the frame of {size[0]}x{size[1]} pixels; correct it"
    if target.box is not None and not inside(centre(target.box), size):
        numbers = ", ".join(f"{value:g}" for value in target.box)
        raise InputError(f"{origin}: the centre of the box [{numbers}] of {name} {outside}")
    for part, (x, y) in target.points.items():
        if not inside((x, y), size):
            raise InputError(f"{origin}: {part} of {name} at [{x:g}, {y:g}] {outside}")
