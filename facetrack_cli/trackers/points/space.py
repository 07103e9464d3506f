"""Where points begin (Patras & Pantic 2004, section 3.1)."""

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import size_of_points
from facetrack_cli.core.types import Start
from facetrack_cli.engine.spaces import Placed, PointSpace, size_of_box
from facetrack_cli.trackers.points.settings import PointsSettings


def place_points(settings: PointsSettings, start: Start, name: str) -> Placed:
    """Points where the start has them; the unit is the largest distance of two, or the box's size around one."""
    placed, parts = start.targets[name], settings.parts
    if missing := ", ".join(part for part in parts if part not in placed.points):
        raise InputError(f"{start.origin}: {name} has no point for {missing}; the recipe wants them")
    x0 = np.array([placed.points[part] for part in parts], dtype=float)
    unit = size_of_points(x0) if len(parts) > 1 else size_of_box(start, name)
    if not unit:
        raise InputError(f"{start.origin}: all points of {name} are in one place; move them apart")
    windows = np.array([[side.pixels(unit) for side in settings.window(part)] for part in parts])
    for part, side in placed.windows.items():
        if part in parts:
            windows[parts.index(part)] = side
    return Placed(PointSpace(windows), x0, windows, unit)
