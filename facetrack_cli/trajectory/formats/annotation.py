"""Annotation tools: CVAT for video 1.1 (XML) and Label Studio's video rectangles (JSON), written and read.

Both have a track for each part, over all frames, with a box or a point, and whether the part is visible. Labels are
`target/part`, or the target alone for its box. Boxes are measured from the corner of the image, as here; a pixel's
centre is at .5 there, and a whole number here, so that points move by half a pixel. Every frame is a keyframe, so that
nothing is interpolated.

CVAT (docs.cvat.ai, "XML annotation format", interpolation): `occluded` is a lost row, whose place is the tracker's
estimate; `outside` is a part that has no place, or no row. Numbers have two decimals, as CVAT writes them. Skeletons
are read too: their points are the parts.

Label Studio (labelstud.io/tags/videorectangle): a task with its annotation, a region for each part. `enabled` is false
where a row is lost, or there is none: the region's span ends there. Lengths are percent of the image. A point is the
rectangle of the window around it. Its frames are no pictures: a frame, from 1, is the player's time x the `framerate`
of the configuration (docs/export.md). At a variable rate, or where pictures begin late, a picture has the frame in
which it comes up. `auto` marks places that Label Studio interpolated: nobody has put them there.
"""

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias
from xml.etree import ElementTree as ET
from xml.sax.saxutils import escape

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import shown_angle
from facetrack_cli.core.numbers import dumps
from facetrack_cli.core.types import BOX, Array, Whole
from facetrack_cli.trajectory.formats.boxes import read_text
from facetrack_cli.trajectory.formats.eaf import clean, read_xml
from facetrack_cli.trajectory.reader import MAX_FRAME, MAX_PIXELS
from facetrack_cli.trajectory.trajectory import SEEN, Trajectory, build, joined
from facetrack_cli.trajectory.views import check_sized, every_frame, has_windows

_HALF_PIXEL = 0.5  # the centre of the first pixel is 0 here and 0.5 in the tools
_REGION = "videorectangle"


class _Mark(NamedTuple):
    """A part in one frame, in our pixels; `by_hand` is a keyframe."""

    x: float
    y: float
    w: float = math.nan
    h: float = math.nan
    status: str = "visible"
    by_hand: bool = True
    angle: float = math.nan


_Marks: TypeAlias = dict[tuple[str, str], dict[int, _Mark]]  # by (target, part), then by frame


def _tracks(table: Trajectory) -> Iterator[tuple[str, Trajectory]]:
    """The label and the rows of each part, in all frames from its first place to the last one of the table.

    `status` is seen, lost, or gone where there is no row, which has the last place.
    """
    last = int(table.frames[-1])
    for part in table.parts:
        rows = np.flatnonzero(np.isfinite(part.x) & np.isfinite(part.y))
        if rows.size:
            frame = np.arange(part.frame[rows[0]], last + 1)
            at = rows[np.searchsorted(part.frame[rows], frame, side="right") - 1]  # the last row that has a place
            seen = np.where(np.isin(part.status[at], SEEN), "seen", "lost")
            state = np.where(part.frame[at] == frame, seen, "gone")
            angle = shown_angle(part.angle[at], 1 / part.pixel_aspect)  # tools show the pixels of the file as squares
            name = part.target or "target"
            label = name if part.part == BOX else f"{name}/{part.part}"
            yield label, replace(part.take(at), frame=frame, status=state, angle=angle)


def _named(label: str) -> tuple[str, str]:
    """The target and the part of a label."""
    target, _, part = label.partition("/")
    return target, part or BOX


def _box(place: str, left: Any, top: Any, w: Any, h: Any, **about: Any) -> _Mark:
    """The mark of a box, or InputError with its `place` in the file."""
    left, top, w, h = _pixels(place, left, top, w, h)
    if w <= 0 or h <= 0:
        raise InputError(f"{place}: the box has no area; remove it, or mark it as not visible")
    return _Mark(left + (w - 1) / 2, top + (h - 1) / 2, w, h, **about)


def _pixels(place: str, *texts: Any) -> list[float]:
    try:
        values = [float(text) for text in texts]
    except (TypeError, ValueError, OverflowError):
        values = [math.nan]
    if not all(abs(value) <= MAX_PIXELS for value in values):
        raise InputError(f"{place}: {', '.join(map(str, texts))} are no pixels; export the file from its tool again")
    return values


def _trajectory(path: Path, marks: _Marks, read_as: str, shift: int = 0) -> Trajectory:
    """The marks as a trajectory, without places where something is absent."""
    rows = [(k, frame + shift, mark) for k, own in enumerate(marks.values()) for frame, mark in own.items()]
    if not rows:
        raise InputError(f"{path}: has no track of a box or a point; there is nothing in it to read")
    which, frame, each = zip(*rows, strict=True)
    columns: dict[str, Any] = dict(zip(_Mark._fields, map(np.array, zip(*each, strict=True)), strict=True))
    for name in ("x", "y", "w", "h", "angle"):
        columns[name] = np.where(columns["status"] == "absent", np.nan, columns[name])
    return build([*marks], which, frame, **columns, header={"read_as": read_as}, path=path)


def write_cvat(table: Trajectory, size: tuple[int, int] | None, name: str) -> str:
    """The XML text; `size` (width, height) of the images and the `name` of the clip, where they are known.

    InputError for boxes without a size.
    """
    tracks, last = list(_tracks(table)), int(table.frames[-1])
    kinds = [(_xml(label), "rectangle" if track.part == BOX else "points") for label, track in tracks]
    labels = "".join(f"<label><name>{name}</name><type>{kind}</type><attributes/></label>" for name, kind in kinds)
    sides = "<original_size><width>{}</width><height>{}</height></original_size>".format(*size) if size else ""
    root = ET.fromstring(
        f"<annotations><version>1.1</version><meta><task><name>{_xml(name or 'facetrack')}</name>"
        f"<size>{last + 1}</size><mode>interpolation</mode><overlap>0</overlap>"
        f"<start_frame>0</start_frame><stop_frame>{last}</stop_frame><labels>{labels}</labels>{sides}"
        f"<source>{_xml(name)}</source></task></meta></annotations>"
    )
    for ident, (label, track) in enumerate(tracks):
        element = ET.SubElement(root, "track", id=str(ident), label=clean(label), source="file")
        is_box, boxes = track.part == BOX, track.boxes
        if is_box:
            check_sized(track, "CVAT has no room for such a box: fill those columns")
        edges = np.concatenate([boxes[:, :2], boxes[:, :2] + boxes[:, 2:]], axis=1)
        places = edges if is_box else np.stack([track.x, track.y], axis=1) + _HALF_PIXEL
        columns = (track.frame.tolist(), track.status.tolist(), places.tolist(), track.angle.tolist())
        for frame, state, place, angle in zip(*columns, strict=True):
            shape = {"frame": str(frame), "keyframe": "1"}
            shape |= {"outside": str(int(state == "gone")), "occluded": str(int(state == "lost"))}
            values = [f"{value:.2f}" for value in place]
            if is_box:
                shape |= dict(zip(("xtl", "ytl", "xbr", "ybr"), values, strict=True))
                shape |= {"rotation": f"{angle % 360:.2f}"} if angle == angle else {}  # not nan
            else:
                shape["points"] = ",".join(values)
            ET.SubElement(element, "box" if is_box else "points", shape, z_order="0")
    ET.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _xml(text: str) -> str:
    return escape(clean(text))


def read_cvat(path: Path, *, shift: int = 0) -> Trajectory:
    """The tracks: status visible, hidden (occluded) or absent (outside); `by_hand` are keyframes.

    Tracks of the same label are one part, as after a split: of two in a frame the visible one counts. A track of
    several points has the parts point_01, ...; pixels are counted from 0, and so are frames, to which `shift` is added.

    Raises
    ------
    InputError : with the track and the frame, for what cannot be read.
    """
    root = read_xml(path, "CVAT")
    if root.tag != "annotations" or (root.find("track") is None and root.find("image") is not None):
        raise InputError(f'{path}: is XML, but not of CVAT\'s tracks; export it as "CVAT for video 1.1"')
    marks: _Marks = {}
    for track in root.iter("track"):
        label = str(track.get("label", ""))
        for shape in track:
            place, frame = f"{path}: track {track.get('id')} ({label}), frame {shape.get('frame')}", shape.get("frame")
            if frame is None or not (frame.isascii() and frame.isdigit() and int(frame) <= MAX_FRAME):
                raise InputError(f"{place}: that is no frame number; export the file from CVAT again")
            for name, mark in _shape_marks(place, label, shape):
                before = marks.setdefault(name, {}).get(int(frame))
                if before is not None and before.status != "absent" != mark.status:
                    raise InputError(f"{place}: another track of the same label is there in that frame; remove one")
                if before is None or before.status == "absent":
                    marks[name][int(frame)] = mark
    return _trajectory(path, marks, "CVAT for video 1.1: frames from 0", shift)


def _shape_marks(place: str, label: str, shape: ET.Element) -> Iterator[tuple[tuple[str, str], _Mark]]:
    """The parts of a shape of CVAT, each with its mark."""
    if shape.tag == "skeleton":
        for point in shape.iter("points"):
            for _, mark in _shape_marks(place, label, point):
                yield (label, str(point.get("label"))), mark
        return
    status = "hidden" if shape.get("occluded") == "1" else "visible"
    about: dict[str, Any] = {"status": "absent" if shape.get("outside") == "1" else status}
    about["by_hand"] = shape.get("keyframe") != "0"
    if shape.tag == "box":
        left, top, right, bottom = _pixels(place, *(shape.get(name) for name in ("xtl", "ytl", "xbr", "ybr")))
        (turn,) = _pixels(place, shape.get("rotation", 0))
        yield _named(label), _box(place, left, top, right - left, bottom - top, angle=turn or math.nan, **about)
        return
    pairs = [pair.split(",") for pair in str(shape.get("points")).split(";")]
    if shape.tag != "points" or any(len(pair) != 2 for pair in pairs):
        why = "is neither a box nor points x,y;x,y; remove that track, or export the file from CVAT again"
        raise InputError(f"{place}: {shape.tag} {shape.get('points', '')!r:.40} {why}")
    for number, pair in enumerate(pairs, 1):
        x, y = _pixels(place, *pair)
        name = _named(label) if len(pairs) == 1 else (label, f"point_{number:02d}")
        yield name, _Mark(x - _HALF_PIXEL, y - _HALF_PIXEL, **about)


def write_labelstudio(table: Trajectory, size: tuple[int, int], fps: float, name: str) -> str:
    """The JSON text of one task, in which each part is a rectangle.

    Points without windows are left out where other parts have some, else they are an InputError.

    Parameters
    ----------
    size : (width, height) of the clip, in pixels.
    fps : the framerate of the labelling configuration, in frames per second.
    name : of the clip.
    """
    numbers, pictures = _frames_of(*every_frame(table), fps)
    shown, count = dict(zip(pictures.tolist(), numbers.tolist(), strict=True)), int(numbers[-1])
    scale = 100 / np.array([*size, *size], dtype=np.float64)
    results: list[dict[str, Any]] = []
    for label, track in _tracks(joined(list(filter(has_windows, table.parts)) or table.parts)):
        check_sized(track, "Label Studio's video has rectangles alone: export to cvat")
        boxes = track.boxes * scale
        sequence = []
        for picture, state, box in zip(track.frame.tolist(), track.status.tolist(), boxes.tolist(), strict=True):
            if (frame := shown.get(picture)) is not None:
                x, y, w, h = (round(value, 5) for value in box)
                timed = {"frame": frame, "time": round(frame / fps, 5), "enabled": state == "seen"}
                sequence.append({**timed, "x": x, "y": y, "width": w, "height": h, "rotation": 0})
        value = {"framesCount": count, "duration": round(count / fps, 5), "sequence": sequence, "labels": [label]}
        about = {"from_name": "box", "to_name": "video", "type": _REGION, "origin": "manual"}
        results.append({"id": f"facetrack{len(results) + 1}", **about, "value": value})
    return dumps([{"data": {"video": name}, "annotations": [{"result": results}]}]) + "\n"


def _frames_of(frames: Whole, times: Array, rate: float) -> tuple[Whole, Whole]:
    """The frames (N,), from 1, of a player at a rate, and the pictures (N,) that come up in them.

    `times` (T,) are the seconds of the pictures `frames` (T,), nan where they have none. Of several pictures in a frame
    of the player the first counts.
    """
    there = np.where(np.isfinite(times), np.rint(np.round(times * rate, 3)), frames).astype(np.int64) + 1
    numbers, first = np.unique(there, return_index=True)
    return numbers, frames[first]


def _rectangle(where: str, record: Mapping[str, Any], size: tuple[int, int]) -> tuple[int, float | None, _Mark]:
    """The frame, from 1, the time and the mark of a place. KeyError, TypeError or ValueError for what is none."""
    if type(frame := record["frame"]) is not int or not 1 <= frame <= MAX_FRAME:
        raise ValueError(f"{frame!r} is no frame")
    x, w = (float(record[name]) * size[0] / 100 for name in ("x", "width"))
    y, h = (float(record[name]) * size[1] / 100 for name in ("y", "height"))
    turn, time = math.radians(float(record.get("rotation", 0))), record.get("time")
    # a rectangle is turned about its left top corner: the upright one of its size has the same centre
    left = x + (w * math.cos(turn) - h * math.sin(turn) - w) / 2
    top = y + (w * math.sin(turn) + h * math.cos(turn) - h) / 2
    about = {"status": "visible" if record.get("enabled", True) else "absent", "by_hand": not record.get("auto")}
    mark = _box(f"{where}, frame {frame}", left, top, w, h, **about)
    return frame, None if time is None else float(time), mark


def read_labelstudio(
    path: Path, size: tuple[int, int], clock: tuple[Whole, Array] | None = None, *, fps: float = 0.0
) -> Trajectory:
    """The regions of the one task in an export (JSON): visible, or absent where not enabled.

    Of the places that are on one picture the last that is not interpolated counts; it is `by_hand`. Frames between two
    places have no row.

    Parameters
    ----------
    path : the export.
    size : (width, height) of the clip, in pixels.
    clock : the frames (T,) of the clip and their seconds (T,), as `every_frame` gives them; None: a frame is a picture.
    fps : the framerate beside a clock where the file tells none, in frames per second.

    Raises
    ------
    InputError : for more than one task or annotation, regions without a label, or two of one label in a frame.
    """
    places: dict[tuple[str, int], tuple[float | None, _Mark]] = {}  # by label and frame
    try:
        content = json.loads(read_text(path))
        tasks = content if isinstance(content, list) else [content]
        annotations = [each for task in tasks for each in task["annotations"] if not each.get("was_cancelled")]
        if len(tasks) != 1 or len(annotations) != 1:
            count = f"{len(tasks)} tasks with {len(annotations)} annotations"
            raise InputError(f"{path}: has {count}; export the one task of the clip, and keep one annotation of it")
        for region in (region for region in annotations[0]["result"] if region.get("type") == _REGION):
            where, labels = f"{path}: region {region.get('id', '')}", region["value"].get("labels", [])
            if len(labels) != 1:
                raise InputError(f"{where} has {len(labels)} labels; give it one")
            for record in region["value"]["sequence"]:
                frame, time, mark = _rectangle(f"{where} ({labels[0]})", record, size)
                if (labels[0], frame) in places:
                    why = "is there twice, here or in another region of the same label; remove one"
                    raise InputError(f"{where} ({labels[0]}), frame {frame}: {why}")
                places[labels[0], frame] = time, mark
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError) as e:
        why = f"it has no {e}" if isinstance(e, KeyError) else f"{e!s:.60}"
        raise InputError(f"{path}: is not Label Studio's JSON of a video ({why}); export it again, as JSON") from None
    timed = sorted((n, time) for (_, n), (time, mark) in places.items() if mark.by_hand and time is not None)
    picture = _pictures(timed, clock, fps)
    marks: _Marks = {_named(label): {} for label, _ in places}
    for (label, n), (_, mark) in sorted(places.items(), key=lambda place: place[0][1]):
        own = marks[_named(label)]
        if mark.by_hand or picture(n) not in own:
            own[picture(n)] = mark
    return _trajectory(path, marks, "Label Studio: frames from 1, percent of the image")


def _pictures(
    timed: Sequence[tuple[int, float]], clock: tuple[Whole, Array] | None, fps: float
) -> Callable[[int], int]:
    """The picture that is shown in a frame of Label Studio, by the framerate that `timed` frames with times tell."""
    if clock is None:
        return lambda frame: frame - 1
    if timed and timed[0][1] < timed[-1][1]:
        (first, first_s), (last, last_s) = timed[0], timed[-1]
        rate = (last - first) / (last_s - first_s)
        # that of the run may differ by what is rounded in the file
        if 1 <= rate <= 1000 and min(abs(last - fps * last_s), abs(last - 1 - fps * last_s)) > 0.02:
            fps = rate
    numbers, pictures = _frames_of(*clock, fps)
    return lambda frame: int(pictures[max(int(np.searchsorted(numbers, frame, side="right")) - 1, 0)])
