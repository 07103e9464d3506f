"""Label Studio's JSON of video rectangles (labelstud.io/tags/videorectangle): a task with its annotation.

A part is a region with every frame in its `sequence`, so that nothing is interpolated; see `annotation.py`. `enabled`
is false where a row is lost, or there is none: Label Studio draws such a rectangle in its own frame, and ends the span
of the region there. Lengths are percent of the image. A point is the rectangle of the window around it. The labelling
configuration needs a Video `video` and a VideoRectangle `box`.

Its frames are no pictures: a frame, from 1, is the player's time x the `framerate` of the configuration, so that at a
variable rate, or where pictures begin late, a picture has the frame in which it comes up; see `counted`. `time` is
frame / framerate. `auto` marks places that Label Studio interpolated: nobody has put them there.
"""

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.numbers import dumps
from facetrack_cli.core.types import Array, Whole
from facetrack_cli.trajectory.formats.annotation import Mark, box_mark, collected, counted, named, tracks
from facetrack_cli.trajectory.formats.lines import read_text
from facetrack_cli.trajectory.reader import MAX_FRAME
from facetrack_cli.trajectory.select import has_windows
from facetrack_cli.trajectory.trajectory import Trajectory, every_frame, joined

KIND = "videorectangle"


def write_labelstudio(table: Trajectory, size: tuple[int, int], fps: float, clip: str) -> str:
    """The JSON text; `size` (width, height) of the clip, `fps`, the configuration's framerate, and the clip's name.

    Points without windows are left out where other parts have some, else they are an InputError.
    """
    numbers, pictures = counted(*every_frame(table), fps)
    shown, count = dict(zip(pictures.tolist(), numbers.tolist(), strict=True)), int(numbers[-1])
    scale = 100 / np.array([*size, *size], dtype=np.float64)
    results: list[dict[str, Any]] = []
    for one in tracks(joined(list(filter(has_windows, table.parts)) or table.parts)):
        if (sizeless := np.flatnonzero(~np.isfinite(one.ltwh).all(axis=1))).size:
            why = "has no w and h, and Label Studio's video has rectangles alone; export to cvat"
            raise InputError(f"{one.label}: frame {one.frame[sizeless[0]]} {why}")
        sequence = []
        for picture, state, box in zip(one.frame.tolist(), one.state.tolist(), one.ltwh * scale, strict=True):
            if (frame := shown.get(picture)) is None:
                continue
            x, y, w, h = (round(value, 5) for value in box.tolist())
            timed = {"frame": frame, "time": round(frame / fps, 5)}
            place = {"x": x, "y": y, "width": w, "height": h, "rotation": 0}
            sequence.append({**timed, "enabled": state == "seen", **place})
        value = {"framesCount": count, "duration": round(count / fps, 5), "sequence": sequence, "labels": [one.label]}
        about = {"from_name": "box", "to_name": "video", "type": KIND, "origin": "manual"}
        results.append({"id": f"facetrack{len(results) + 1}", **about, "value": value})
    return dumps([{"data": {"video": clip}, "annotations": [{"result": results}]}]) + "\n"


class _Place(BaseModel):
    frame: Annotated[int, Field(ge=1, le=MAX_FRAME)]
    enabled: bool = True
    auto: bool = False
    time: float | None = None
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


def read_labelstudio(
    path: Path, size: tuple[int, int], clock: tuple[Whole, Array] | None = None, *, fps: float = 0.0
) -> Trajectory:
    """The regions of the one task in an export (JSON) of images of `size`: visible, or absent where not enabled.

    `clock` has the frames of the clip and their seconds, as `every_frame` gives them, and `fps` is the framerate where
    the file tells none; without them a frame is a picture. Of the places that are on one picture the last that is not
    interpolated counts; it is `by_hand`. Frames between two places have no row. InputError for more than one task or
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
    regions: dict[str, dict[int, tuple[str, _Place]]] = {}
    for raw in annotations[0].result:
        if raw.get("type") != KIND:
            continue
        try:
            region = _Region.model_validate(raw)
        except ValidationError as e:
            raise _other(path, e) from None
        if len(region.value.labels) != 1:
            raise InputError(f"{path}: region {region.id} has {len(region.value.labels)} labels; give it one")
        given_to = regions.setdefault(label := region.value.labels[0], {})
        for one in region.value.sequence:
            place = f"{path}: region {region.id} ({label}), frame {one.frame}"
            if one.frame in given_to:
                raise InputError(f"{place}: is there twice, here or in another region of the same label; remove one")
            given_to[one.frame] = place, one
    picture = _pictures([one for sequence in regions.values() for _, one in sequence.values()], clock, fps)
    marks: dict[tuple[str, str], dict[int, Mark]] = {}
    for name, sequence in regions.items():
        own = marks.setdefault(named(name), {})
        for frame, (place, one) in sorted(sequence.items()):
            if not one.auto or picture(frame) not in own:
                own[picture(frame)] = _mark(place, one, size)
    return collected(path, marks, "Label Studio: frames from 1, percent of the image", 0)


def _pictures(places: Sequence[_Place], clock: tuple[Whole, Array] | None, fps: float) -> Callable[[int], int]:
    """The picture that is shown in a frame of Label Studio, by the framerate that the times of these places tell."""
    if clock is None:
        return lambda frame: frame - 1
    timed = sorted((one.frame, one.time) for one in places if one.time is not None and not one.auto)
    if timed and timed[0][1] < timed[-1][1]:
        (first, first_s), (last, last_s) = timed[0], timed[-1]
        rate = (last - first) / (last_s - first_s)
        # that of the run may differ by what is rounded in the file
        if 1 <= rate <= 1000 and min(abs(last - fps * last_s), abs(last - 1 - fps * last_s)) > 0.02:
            fps = rate
    numbers, pictures = counted(*clock, fps)
    return lambda frame: int(pictures[max(int(np.searchsorted(numbers, frame, side="right")) - 1, 0)])


def _mark(place: str, one: _Place, size: tuple[int, int]) -> Mark:
    (width, height), turn = size, math.radians(one.rotation)
    left, top, w, h = one.x * width / 100, one.y * height / 100, one.width * width / 100, one.height * height / 100
    # a rectangle is turned about its left top corner: the upright one of its size has the same centre
    left += (w * math.cos(turn) - h * math.sin(turn) - w) / 2
    top += (w * math.sin(turn) + h * math.cos(turn) - h) / 2
    return box_mark(place, left, top, w, h, status="visible" if one.enabled else "absent", by_hand=not one.auto)


def _other(path: Path, error: Exception) -> InputError:
    why = "it is no JSON"
    if isinstance(error, ValidationError):
        first = error.errors()[0]
        why = f"{'.'.join(map(str, first['loc']))}: {first['msg'].lower()}"
    return InputError(f"{path}: is not Label Studio's JSON of a video ({why}); export it again, as JSON")
