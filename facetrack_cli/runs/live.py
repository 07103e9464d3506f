"""Tracking of what comes in: a line of JSON for each frame, as soon as it is tracked, with the frame's age."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from facetrack_cli.core.types import Box, Image
from facetrack_cli.recipe.face import DetectorName
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.runs.api import track_frames
from facetrack_cli.runs.signals import never
from facetrack_cli.trajectory.trajectory import FrameResult, Trajectory
from facetrack_cli.video.live import camera, piped
from facetrack_cli.video.source import open_source


def is_live(clip: Path) -> bool:
    """Whether an input is a camera, by its number, or standard input."""
    return str(clip) == "-" or (str(clip).isdecimal() and not clip.exists())


def images_of(clip: Path) -> Iterator[Image]:
    """The images of a camera, of standard input, or of a clip."""
    if str(clip) == "-":
        yield from piped(sys.stdin.buffer)
    elif is_live(clip):
        yield from camera(int(str(clip)))
    else:
        with open_source(clip) as source:
            for frame in source:
                yield frame.bgr


def follow(
    images: Iterator[Image],
    recipe: Recipe,
    init: Path | DetectorName | Box | None,
    write: Callable[[str], None],
    stopped: Callable[[], bool] = never,
) -> int:
    """Track `images` and write a line for each; the number of lines. Times are seconds since the first image came.

    Raises InputError for images that are none, or no start in the first of them.
    """
    came: dict[int, float] = {}

    def counted() -> Iterator[Image]:
        for index, image in enumerate(images):
            came[index] = time.monotonic()
            yield image
            if stopped():
                return

    count, began = 0, None
    for result in track_frames(counted(), recipe, init=init):
        at = came[result.frame.index]
        began = at if began is None else began
        for index in [one for one in came if one <= result.frame.index]:
            del came[index]
        line = record(result, at - began, time.monotonic() - at)
        write(json.dumps(line, allow_nan=False))
        count += 1
        if stopped():
            break
    return count


def record(result: FrameResult, time_s: float, age_s: float) -> dict[str, Any]:
    """A frame as JSON: what is not finite is null."""
    targets = [{"target": one.rows.target, "parts": list(_parts(one.rows))} for one in result.targets]
    return {"frame": result.frame.index, "time_s": round(time_s, 4), "age_s": round(age_s, 4), "targets": targets}


def _parts(rows: Trajectory) -> Iterator[dict[str, Any]]:
    for i, which in enumerate(rows.which.tolist()):
        values = {name: float(getattr(rows, name)[i]) for name in ("x", "y", "w", "h", "confidence")}
        finite = {name: round(value, 4) if abs(value) < float("inf") else None for name, value in values.items()}
        yield {"part": rows.names[which][1], **finite, "status": str(rows.status[i])}
