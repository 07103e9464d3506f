"""Annotation tools, written and read: CVAT for video 1.1 (XML), Label Studio's video rectangles (JSON), ELAN (EAF 3.0).

CVAT and Label Studio have a track for each part, over all frames, with a box or a point, and whether the part is
visible. Labels are `target/part`, or the target alone for its box. Boxes are measured from the corner of the image, as
here; a pixel's centre is at .5 there, and a whole number here, so that points move by half a pixel. Every frame is a
keyframe, so that nothing is interpolated.

CVAT (docs.cvat.ai, "XML annotation format", interpolation): `occluded` is a lost row, whose place is the tracker's
estimate; `outside` is a part that has no place, or no row. Numbers have two decimals, as CVAT writes them. Skeletons
are read too: their points are the parts.

Label Studio (labelstud.io/tags/videorectangle): a task with its annotation, a region for each part. `enabled` is false
where a row is lost, or there is none: the region's span ends there. Lengths are percent of the image. A point is the
rectangle of the window around it. Its frames are no pictures: a frame, from 1, is the player's time x the `framerate`
of the configuration (docs/export.md). At a variable rate, or where pictures begin late, a picture has the frame in
which it comes up. `auto` marks places that Label Studio interpolated: nobody has put them there.

ELAN (www.mpi.nl/tools/elan/EAFv3.0.xsd): docs/export.md has the tiers. Their values are controlled vocabularies,
described in the file. Times are those of the frames, in milliseconds; a span ends when the frame after it begins. The
media URL is the path as it is, not percent-encoded: ELAN writes it so, and takes what follows `file:` for the name.
To a file that people work in slots of time are added in their order, then tiers, types and vocabularies below those
that are there. All that it has stays; only the number of the last annotation is another.
"""

import contextlib
import json
import math
import os
import re
import uuid
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from itertools import accumulate, chain, count
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias
from urllib.parse import unquote
from xml.etree import ElementTree as ET
from xml.sax.saxutils import escape

import numpy as np

from facetrack_cli.core import numbers
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.face_points import HANDS
from facetrack_cli.core.geometry import shown_angle
from facetrack_cli.core.numbers import dumps
from facetrack_cli.core.types import BOX, Array, Whole
from facetrack_cli.trajectory.formats.boxes import read_text
from facetrack_cli.trajectory.head import LABELS, head_motion
from facetrack_cli.trajectory.measures import KINDS, events_of
from facetrack_cli.trajectory.reader import MAX_FRAME, MAX_PIXELS
from facetrack_cli.trajectory.trajectory import SEEN, Trajectory, aligned, build, joined
from facetrack_cli.trajectory.views import check_sized, every_frame, frame_milliseconds, has_windows

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


Clock: TypeAlias = tuple[Whole, Array]  # frames (T,) and their seconds (T,), as `every_frame` gives them
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
    values = [math.nan]
    with contextlib.suppress(TypeError, ValueError, OverflowError):
        values = [float(text) for text in texts]
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
    """The XML text; `size` (width, height) and `name` of the clip, if known. InputError for boxes without a size."""
    tracks, last = list(_tracks(table)), int(table.frames[-1])
    kinds = [(escape(clean(label)), "rectangle" if track.part == BOX else "points") for label, track in tracks]
    labels = "".join(f"<label><name>{text}</name><type>{kind}</type><attributes/></label>" for text, kind in kinds)
    source = escape(clean(name))
    sides = "<original_size><width>{}</width><height>{}</height></original_size>".format(*size) if size else ""
    root = ET.fromstring(
        f"<annotations><version>1.1</version><meta><task><name>{source or 'facetrack'}</name>"
        f"<size>{last + 1}</size><mode>interpolation</mode><overlap>0</overlap>"
        f"<start_frame>0</start_frame><stop_frame>{last}</stop_frame><labels>{labels}</labels>{sides}"
        f"<source>{source}</source></task></meta></annotations>"
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


def read_cvat(path: Path, *, shift: int = 0) -> Trajectory:
    """The tracks: status visible, hidden (occluded) or absent (outside); `by_hand` are keyframes.

    Tracks of the same label are one part, as after a split: of two in a frame the visible one counts. A track of
    several points has the parts point_01, ...; pixels are counted from 0, and so are frames, to which `shift` is added.
    InputError, with the track and the frame, for what cannot be read.
    """
    root = read_xml(path, "CVAT")
    if root.tag != "annotations" or (root.find("track") is None and root.find("image") is not None):
        raise InputError(f'{path}: is XML, but not of CVAT\'s tracks; export it as "CVAT for video 1.1"')
    marks: _Marks = {}
    for track in root.iter("track"):
        label = str(track.get("label", ""))
        for shape in track:
            frame = shape.get("frame", "")
            place = f"{path}: track {track.get('id')} ({label}), frame {frame}"
            if not _is_whole(frame) or int(frame) > MAX_FRAME:
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
    by_hand, seen = shape.get("keyframe") != "0", "hidden" if shape.get("occluded") == "1" else "visible"
    about: dict[str, Any] = {"status": "absent" if shape.get("outside") == "1" else seen, "by_hand": by_hand}
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
    """The JSON text of one task, in which each part is a rectangle, for the framerate `fps` of the configuration.

    `size` is (width, height) of the clip in pixels, `name` its name. Points without windows are left out where other
    parts have some, else they are an InputError.
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
    """The frames (N,), from 1, of a player at a rate, and the pictures (N,) that come up in them, of several the first.

    `times` (T,) are the seconds of the pictures `frames` (T,), nan where they have none.
    """
    there = np.where(np.isfinite(times), np.rint(np.round(times * rate, 3)), frames).astype(np.int64) + 1
    numbers, first = np.unique(there, return_index=True)
    return numbers, frames[first]


def read_labelstudio(path: Path, size: tuple[int, int], clock: Clock | None = None, *, fps: float = 0.0) -> Trajectory:
    """The regions of the one task in an export (JSON): visible, or absent where not enabled.

    Of the places that are on one picture the last that is not interpolated counts; it is `by_hand`. Frames between two
    places have no row. `size` is (width, height) of the clip in pixels; without its `clock` a frame is a picture; `fps`
    is the framerate beside a clock where the file tells none. InputError for more than one task or annotation, regions
    without a label, or two of one label in a frame.
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
                if type(frame := record["frame"]) is not int or not 1 <= frame <= MAX_FRAME:
                    raise ValueError(f"{frame!r} is no frame")
                there = f"{where} ({labels[0]}), frame {frame}"
                x, w = (float(record[name]) * size[0] / 100 for name in ("x", "width"))
                y, h = (float(record[name]) * size[1] / 100 for name in ("y", "height"))
                # a rectangle is turned about its left top corner: the upright one of its size has the same centre
                turn, time = math.radians(float(record.get("rotation", 0))), record.get("time")
                left = x + (w * math.cos(turn) - h * math.sin(turn) - w) / 2
                top = y + (w * math.sin(turn) + h * math.cos(turn) - h) / 2
                status = "visible" if record.get("enabled", True) else "absent"
                mark = _box(there, left, top, w, h, status=status, by_hand=not record.get("auto"))
                if (labels[0], frame) in places:
                    raise InputError(f"{there}: is there twice, here or in another region of its label; remove one")
                places[labels[0], frame] = None if time is None else float(time), mark
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError) as e:
        why = f"it has no {e}" if isinstance(e, KeyError) else f"{e!s:.60}"
        raise InputError(f"{path}: is not Label Studio's JSON of a video ({why}); export it again, as JSON") from None
    order = sorted(places, key=lambda place: place[1])
    frames = np.array([n for _, n in order], np.int64)
    shown = frames - 1
    if clock is not None:
        timed = sorted((n, time) for (_, n), (time, mark) in places.items() if mark.by_hand and time is not None)
        if timed and timed[0][1] < timed[-1][1]:
            (first, first_s), (last, last_s) = timed[0], timed[-1]
            rate = (last - first) / (last_s - first_s)
            # that of the run may differ by what is rounded in the file
            if 1 <= rate <= 1000 and min(abs(last - fps * last_s), abs(last - 1 - fps * last_s)) > 0.02:
                fps = rate
        numbers, pictures = _frames_of(*clock, fps)
        shown = pictures[np.maximum(np.searchsorted(numbers, frames, side="right") - 1, 0)]
    marks: _Marks = {_named(label): {} for label, _ in places}
    for place, picture in zip(order, shown.tolist(), strict=True):
        own, (_, mark) = marks[_named(place[0])], places[place]
        if mark.by_hand or picture not in own:
            own[picture] = mark
    return _trajectory(path, marks, "Label Studio: frames from 1, percent of the image")


XSI = "http://www.w3.org/2001/XMLSchema-instance"
ET.register_namespace("xsi", XSI)
SCHEMA = "http://www.mpi.nl/tools/elan/EAFv3.0.xsd"
MIME = {".mp4": "mp4", ".m4v": "mp4", ".mpeg": "mpeg", ".mpg": "mpeg", ".webm": "webm"}
MIME |= {".mov": "quicktime", ".avi": "x-msvideo", ".mkv": "x-matroska"}
VOCABULARIES: Final[Mapping[str, Sequence[str]]] = {
    "seen": ("seen",), **LABELS, "still": ("still",),
    **{tier: [*filter(None, (kind.value, kind.longer, kind.other))] for tier, kind in KINDS.items()},
}  # fmt: skip
"""The values of each tier that has a vocabulary."""
QUOTES = str.maketrans({"'": "\N{RIGHT SINGLE QUOTATION MARK}", '"': "\N{RIGHT DOUBLE QUOTATION MARK}"})
ORDER: Final = (
    "LICENSE", "HEADER", "TIME_ORDER", "TIER", "LINGUISTIC_TYPE", "LOCALE", "LANGUAGE", "CONSTRAINT",
    "CONTROLLED_VOCABULARY", "LEXICON_REF", "EXTERNAL_REF",
)  # fmt: skip
"""The schema's, of what stands at the top."""
LEAST_FORMAT: Final = 2.8  # earlier vocabularies are written in another way
IDS: Final = ("TIME_SLOT_ID", "ANNOTATION_ID", "TIER_ID", "LINGUISTIC_TYPE_ID", "CV_ID", "CVE_ID", "LANG_ID")


def write_eaf(table: Trajectory, video: Path, folder: Path, written: datetime) -> str:
    """The XML text, which will stand in `folder`. InputError for times that do not increase."""
    about = {"AUTHOR": "facetrack", "DATE": written.astimezone().isoformat(timespec="seconds")}
    schema = {"FORMAT": "3.0", "VERSION": "3.0", "xmlns:xsi": XSI, "xsi:noNamespaceSchemaLocation": SCHEMA}
    root = ET.Element("ANNOTATION_DOCUMENT", {**about, **schema})
    header = ET.SubElement(root, "HEADER", MEDIA_FILE="", TIME_UNITS="milliseconds")
    whole = Path(os.path.normpath(video.absolute())).as_posix()  # a link keeps the name that the user knows it by
    mime = MIME.get(video.suffix.lower(), "*")
    media = {"MEDIA_URL": "file:///" + clean(whole.lstrip("/")), "MIME_TYPE": f"video/{mime}"}
    with contextlib.suppress(ValueError):  # another drive of Windows: no way leads there
        relative = Path(os.path.relpath(whole, folder)).as_posix()
        media["RELATIVE_MEDIA_URL"] = clean(relative if relative.startswith("../") else f"./{relative}")
    ET.SubElement(header, "MEDIA_DESCRIPTOR", media)
    urn = uuid.uuid5(uuid.NAMESPACE_URL, f"{media['MEDIA_URL']} {about['DATE']}")
    ET.SubElement(header, "PROPERTY", NAME="URN").text = f"urn:nl-mpi-tools-elan-eaf:{urn}"
    ET.SubElement(header, "PROPERTY", NAME="lastUsedAnnotationId").text = "0"
    ET.SubElement(root, "TIME_ORDER")
    return _with_tiers(root, table)[0]


def _with_tiers(root: ET.Element, table: Trajectory, offset: int = 0) -> tuple[str, list[str]]:
    """The text of a document with the tiers of a table, and the names that these have: one that is there gets a number.

    Types and vocabularies of ours that are there serve again.
    """
    taken = {element.get(key, "") for element in root.iter() for key in IDS}
    numbered = [name[1:].removeprefix("s") for name in taken if name[:1] in ("a", "t")]
    numbered.append(root.findtext(".//PROPERTY[@NAME='lastUsedAnnotationId']") or "")
    first = last = max([0, *map(int, filter(_is_whole, numbered))])
    there, order = [own.attrib for own in root.iter("LINGUISTIC_TYPE")], root.find("TIME_ORDER")
    assert order is not None

    def free(name: str) -> str:
        name = next(text for text in chain([name], (f"{name}-{n}" for n in count(2))) if text not in taken)
        taken.add(name)
        return name

    def put(tag: str, about: dict[str, str]) -> ET.Element:
        """An element at the end of those of its kind."""
        element, above = ET.Element(tag, about), ORDER[: ORDER.index(tag) + 1]
        root.insert(max(i for i, child in enumerate(root, 1) if child.tag in above), element)
        return element

    if "eng" not in taken:
        about = {"LANG_DEF": "http://cdb.iso.org/lg/CDB-00138502-001", "LANG_ID": "eng"}
        put("LANGUAGE", {**about, "LANG_LABEL": "English (eng)"})
    tiers, ends, names = list[str](), list[tuple[int, ET.Element, str]](), dict[str, str]()
    for kind, target, spans in _tiers(table, offset):
        if kind not in names:
            names[kind] = kind if _type(kind, kind) in there else free(kind)
            if _type(kind, names[kind]) not in there:
                put("LINGUISTIC_TYPE", _type(kind, names[kind]))
                if kind in VOCABULARIES:
                    vocabulary = put("CONTROLLED_VOCABULARY", {"CV_ID": names[kind]})
                    described = ET.SubElement(vocabulary, "DESCRIPTION", LANG_REF="eng")
                    described.text = "motion of the target in the image plane"
                for label in VOCABULARIES.get(kind, ()):
                    entry = ET.SubElement(vocabulary, "CV_ENTRY_ML", CVE_ID=f"cveid_{names[kind]}_{label}")
                    ET.SubElement(entry, "CVE_VALUE", LANG_REF="eng").text = label
        # readers find a tier by a path with its name in straight quotes
        tiers.append(free(clean(f"{kind}@{target}").translate(QUOTES)))
        about = {"LINGUISTIC_TYPE_REF": names[kind], "TIER_ID": tiers[-1], "ANNOTATOR": "facetrack"}
        tier = put("TIER", {**about, "PARTICIPANT": clean(target)})
        for begin, end, text in spans:
            last += 1
            value = {"CVE_REF": f"cveid_{names[kind]}_{text}"} if kind in VOCABULARIES else {}
            holder = ET.SubElement(tier, "ANNOTATION")
            note = ET.SubElement(holder, "ALIGNABLE_ANNOTATION", {"ANNOTATION_ID": f"a{last}", **value})
            ET.SubElement(note, "ANNOTATION_VALUE").text = clean(text)
            ends += [(begin, note, "TIME_SLOT_REF1"), (end, note, "TIME_SLOT_REF2")]
    known = (slot.get("TIME_VALUE", "") for slot in order)
    latest = [*accumulate((int(time) if _is_whole(time) else -1 for time in known), max)]  # 64 bits may not hold them
    # every annotation has two slots of its own, as ELAN makes them
    for n, (time, note, ref) in enumerate(sorted(ends, key=lambda end: end[0])):
        note.set(ref, f"ts{first + n + 1}")
        slot = ET.Element("TIME_SLOT", TIME_SLOT_ID=f"ts{first + n + 1}", TIME_VALUE=str(time))
        order.insert(bisect_right(latest, time) + n, slot)
    for number in root.iterfind(".//PROPERTY[@NAME='lastUsedAnnotationId']"):
        number.text = str(last)
    ET.indent(root, "    ")
    text = ET.tostring(root, encoding="unicode").replace("\r", "&#13;")  # else readers take it for an end of line
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n', tiers


def _type(kind: str, name: str) -> dict[str, str]:
    """What the file says of the type of a kind of tier, under this name."""
    vocabulary = {"CONTROLLED_VOCABULARY_REF": name} if kind in VOCABULARIES else {}
    return {**vocabulary, "GRAPHIC_REFERENCES": "false", "LINGUISTIC_TYPE_ID": name, "TIME_ALIGNABLE": "true"}


def spans_of(parts: Sequence[Trajectory], status: str = "lost") -> list[tuple[int, int, str]]:
    """Spans (first frame, last, names) in which the same parts of a target have a `status`, in rows without a gap."""
    frames, columns = aligned(parts, "status")
    has, names = columns["status"] == status, np.array([part.part for part in parts])
    apart = (np.diff(frames) > 1) | (has[1:] != has[:-1]).any(axis=1)
    texts = [(a, b, ", ".join(names[has[a]])) for a, b in numbers.spans(has.any(axis=1), apart)]
    return [(int(frames[a]), int(frames[b - 1]), status if text == BOX else text) for a, b, text in texts]


def seen_in(parts: Sequence[Trajectory]) -> list[tuple[int, int]]:
    """The spans of frames in which a target of a film, or a hand, is seen; none if another than a hand always is."""
    frames = np.unique(np.concatenate([part.frame for part in parts]))
    there = ~np.isin(frames, np.concatenate([part.frame[part.vanished] for part in parts]))
    runs = numbers.spans(there, np.diff(frames) > 1)
    always = len(runs) == 1 and there.all() and parts[0].target not in HANDS
    return [] if always else [(int(frames[a]), int(frames[b - 1])) for a, b in runs]


def _tiers(table: Trajectory, offset: int) -> Iterator[tuple[str, str, list[tuple[int, int, str]]]]:
    """Kind, target and annotations, in ms from `offset` on, of each tier that has some: readers have trouble without.

    What ends before is no annotation, and what begins before begins there.
    """
    begin, end = ({f: max(time - offset, 0) for f, time in of.items()} for of in frame_milliseconds(table))
    for target in table.targets:
        parts = table.of_target(target)
        kinds = {
            "seen": [(first, last, "seen") for first, last in seen_in(parts)],
            "lost": spans_of(parts),
            "hidden": spans_of(parts, "hidden"),
            "absent": spans_of([part.take(~part.vanished) for part in parts], "absent"),  # as corrections say
            **head_motion(parts),
        }
        for kind, events in events_of(target, table.measures[target]).items():
            kinds[kind] = [(event.first_frame, event.last_frame, event.value) for event in events]
        for kind, spans in kinds.items():
            if times := [(begin[a], end[b], text) for a, b, text in spans if end[b] > begin[a]]:
                yield kind, target or "target", times


def clean(text: str) -> str:
    """Text without the characters that XML 1.0 has no way to write."""
    return re.sub("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]", "\ufffd", text)


class Tier(NamedTuple):
    """A tier, and its `notes`: begin and end in ms of the clip, and the text."""

    name: str
    participant: str
    notes: tuple[tuple[int, int, str], ...]


def read_tiers(path: Path, clip: str) -> list[Tier]:
    """The tiers of a file, with annotations that have times. InputError for a file that is not ELAN's."""
    root = _read(path)
    offset = _offset_of(root, clip) or 0
    slots = {slot.get("TIME_SLOT_ID"): slot.get("TIME_VALUE", "") for slot in root.iter("TIME_SLOT")}
    tiers = []
    for tier in root.iter("TIER"):
        notes = []
        for note in tier.iter("ALIGNABLE_ANNOTATION"):
            ends = [slots.get(note.get(f"TIME_SLOT_REF{n}"), "") for n in (1, 2)]
            if all(map(_is_whole, ends)):
                begin, end = (int(time) + offset for time in ends)
                notes.append((begin, end, (note.findtext("ANNOTATION_VALUE") or "").strip()))
        tiers.append(Tier(tier.get("TIER_ID", ""), tier.get("PARTICIPANT", ""), tuple(notes)))
    return tiers


def _is_whole(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) < 100  # int() takes some thousands


def _offset_of(root: ET.Element, clip: str) -> int | None:
    """The time of the clip, in ms, at which the file's own times begin; None where it does not link to the clip."""
    for media in root.iter("MEDIA_DESCRIPTOR"):
        if unquote(media.get("MEDIA_URL", "")).replace("\\", "/").rpartition("/")[2] == unquote(clip):
            return int(origin) if _is_whole(origin := media.get("TIME_ORIGIN", "0")) else 0
    return None


def add_tiers(path: Path, table: Trajectory, clip: str) -> tuple[str, list[str], bool]:
    """As `_with_tiers` of a file, and whether it has the clip. InputError for a file that cannot take them."""
    root = _read(path)
    offset = _offset_of(root, clip)
    return (*_with_tiers(root, table, offset or 0), offset is not None)


def read_xml(path: Path, tool: str) -> ET.Element:
    """The root of a file of a `tool`. InputError for a file that is no XML, or declares what could be dangerous."""
    text = read_text(path)
    if "<!DOCTYPE" in text:
        raise InputError(f"{path}: declares a document type, which {tool}'s files do not; it is not read")
    try:
        return ET.fromstring(text)
    except ET.ParseError as e:
        raise InputError(f"{path}:{e.position[0]}: is no XML ({e}); save it by {tool} again") from None


def _read(path: Path) -> ET.Element:
    root = read_xml(path, "ELAN")
    if root.tag != "ANNOTATION_DOCUMENT" or root.find("TIME_ORDER") is None:
        raise InputError(f"{path}: is XML, but not ELAN's: it begins with {root.tag}; name an .eaf")
    version = root.get("FORMAT") or root.get("VERSION") or ""
    if not version.replace(".", "", 1).isdecimal() or float(version) < LEAST_FORMAT:
        raise InputError(f"{path}: is of EAF {version or 'without a version'}; save it by ELAN 4.9 or later")
    return root
