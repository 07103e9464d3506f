"""Label Studio's JSON of video rectangles (labelstud.io/tags/videorectangle): a task with its annotation.

A part is a region with every frame in its `sequence`, so that nothing is interpolated; see `annotation.py`. `enabled`
is false where a row is lost, or there is none: Label Studio draws such a rectangle in its own frame, and ends the span
of the region there. Its frames are those of a clock, from 1: the time of the player times the rate. `time` is frame /
fps, lengths are percent of the image. A point is the rectangle of the window around it. The labelling configuration
needs a Video `video` and a VideoRectangle `box`.
"""

import json
import math
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.numbers import dumps
from facetrack_cli.trajectory.clock import Clock
from facetrack_cli.trajectory.formats.annotation import Mark, box_mark, collected, named, tracks
from facetrack_cli.trajectory.formats.lines import read_text
from facetrack_cli.trajectory.reader import MAX_FRAME
from facetrack_cli.trajectory.trajectory import Trajectory

KIND = "videorectangle"
_COUNTED = Clock(None, 1.0)


def write_labelstudio(table: Trajectory, size: tuple[int, int], fps: float, clip: str) -> str:
    """The JSON text; `size` (width, height) and `fps` of the clip, and what the task calls it.

    InputError for points without the size of a window.
    """
    clock = Clock(table, fps)
    count, scale = clock.tick(int(table.frames[-1])) + 1, 100 / np.array([*size, *size], dtype=np.float64)
    results: list[dict[str, Any]] = []
    for one in tracks(table):
        if (sizeless := np.flatnonzero(~np.isfinite(one.ltwh).all(axis=1))).size:
            why = "has no w and h, and Label Studio's video has rectangles alone; export to cvat"
            raise InputError(f"{one.label}: frame {one.frame[sizeless[0]]} {why}")
        sequence: list[dict[str, Any]] = []
        for frame, state, box in zip(one.frame.tolist(), one.state.tolist(), one.ltwh * scale, strict=True):
            x, y, w, h = (round(value, 5) for value in box.tolist())
            number = clock.tick(frame) + 1
            if sequence and sequence[-1]["frame"] == number:  # of two pictures within one frame the first is shown
                continue
            timed = {"frame": number, "time": round(number / fps, 5)}
            place = {"x": x, "y": y, "width": w, "height": h, "rotation": 0}
            sequence.append({**timed, "enabled": state == "seen", **place})
        value = {"framesCount": count, "duration": round(count / fps, 5), "sequence": sequence, "labels": [one.label]}
        about = {"from_name": "box", "to_name": "video", "type": KIND, "origin": "manual"}
        results.append({"id": f"facetrack{len(results) + 1}", **about, "value": value})
    return dumps([{"data": {"video": clip}, "annotations": [{"result": results}]}]) + "\n"


class _Place(BaseModel):
    frame: Annotated[int, Field(ge=1, le=MAX_FRAME)]
    enabled: bool = True
    x: float
    y: float
    width: float
    height: float
    rotation: float = 0


class _Value(BaseModel):
    sequence: tuple[_Place, ...]
    labels: tuple[str, ...] = ()


class _Region(BaseModel):
    id: str = ""
    type: Literal["videorectangle"]
    value: _Value


class _Annotation(BaseModel):
    result: tuple[dict[str, Any], ...]
    was_cancelled: bool = False


class _Task(BaseModel):
    annotations: tuple[_Annotation, ...]


def read_labelstudio(path: Path, size: tuple[int, int], clock: Clock = _COUNTED, *, shift: int = 0) -> Trajectory:
    """The regions of the one task in an export (JSON) of images of `size`: visible, or absent where not enabled.

    `clock` is that of the clip; without it pictures are as many as frames. Of several frames of Label Studio in which
    one picture is shown the last one counts.
    Every place of a sequence is `by_hand`; frames between two places have no row. InputError for more than one task or
    annotation, for regions without a label, and for two regions of one label in a frame.
    """
    try:
        given = json.loads(read_text(path))
        tasks = TypeAdapter(tuple[_Task, ...]).validate_python(given if isinstance(given, list) else [given])
    except (ValueError, RecursionError) as e:
        raise _other(path, e) from None
    annotations = [one for task in tasks for one in task.annotations if not one.was_cancelled]
    if len(tasks) != 1 or len(annotations) != 1:
        found = f"{len(tasks)} tasks with {len(annotations)} annotations"
        raise InputError(f"{path}: has {found}; export the one task of the clip, and keep one annotation of it")
    marks: dict[tuple[str, str], dict[int, Mark]] = {}
    told: dict[str, set[int]] = {}  # frames of a label
    for raw in annotations[0].result:
        if raw.get("type") != KIND:
            continue
        try:
            region = _Region.model_validate(raw)
        except ValidationError as e:
            raise _other(path, e) from None
        if len(region.value.labels) != 1:
            raise InputError(f"{path}: region {region.id} has {len(region.value.labels)} labels; give it one")
        label = region.value.labels[0]
        own, numbers = marks.setdefault(named(label), {}), told.setdefault(label, set())
        for one in sorted(region.value.sequence, key=lambda one: one.frame):
            place = f"{path}: region {region.id} ({label}), frame {one.frame}"
            if one.frame in numbers:
                raise InputError(f"{place}: is there twice, here or in another region of the same label; remove one")
            numbers.add(one.frame)
            own[clock.shown(one.frame - 1)] = _mark(place, one, size)
    return collected(path, marks, "Label Studio: frames from 1, percent of the image", shift)


def _mark(place: str, one: _Place, size: tuple[int, int]) -> Mark:
    (width, height), turn = size, math.radians(one.rotation)
    left, top, w, h = one.x * width / 100, one.y * height / 100, one.width * width / 100, one.height * height / 100
    # a rectangle is turned about its left top corner: the upright one of its size has the same centre
    left += (w * math.cos(turn) - h * math.sin(turn) - w) / 2
    top += (w * math.sin(turn) + h * math.cos(turn) - h) / 2
    return box_mark(place, left, top, w, h, status="visible" if one.enabled else "absent")


def _other(path: Path, error: Exception) -> InputError:
    why = "it is no JSON"
    if isinstance(error, ValidationError):
        first = error.errors()[0]
        why = f"{'.'.join(map(str, first['loc']))}: {first['msg'].lower()}"
    return InputError(f"{path}: is not Label Studio's JSON of a video ({why}); export it again, as JSON")
