"""CVAT for video 1.1, the XML that CVAT reads and writes (docs.cvat.ai, "XML annotation format", interpolation).

A part is a track of points, or of boxes; see `annotation.py`. Every frame is a keyframe, so that nothing is
interpolated. `occluded` is a lost row, whose place is the tracker's estimate; `outside` is a part that has no place, or
no row. Numbers have two decimals, as CVAT writes them. Reading takes skeletons too, whose points are the parts.
"""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import BOX
from facetrack_cli.trajectory.formats.annotation import (
    HALF_PIXEL,
    Mark,
    box_mark,
    collected,
    named,
    numbers,
    point_mark,
    tracks,
)
from facetrack_cli.trajectory.formats.eaf import clean
from facetrack_cli.trajectory.formats.lines import read_text
from facetrack_cli.trajectory.reader import MAX_FRAME
from facetrack_cli.trajectory.trajectory import Trajectory

OTHERS = ("polygon", "polyline", "ellipse", "cuboid", "mask")


def write_cvat(table: Trajectory, size: tuple[int, int] | None, clip: str) -> str:
    """The XML text; `size` (width, height) of the images and the name of the clip, where they are known.

    InputError for boxes without a size.
    """
    root = ET.Element("annotations")
    ET.SubElement(root, "version").text = "1.1"
    found, last = list(tracks(table)), int(table.frames[-1])
    task = ET.SubElement(ET.SubElement(root, "meta"), "task")
    about = {"name": clip or "facetrack", "size": last + 1, "mode": "interpolation", "overlap": 0}
    for name, value in {**about, "start_frame": 0, "stop_frame": last}.items():
        ET.SubElement(task, name).text = clean(str(value))
    labels = ET.SubElement(task, "labels")
    for one in found:
        label = ET.SubElement(labels, "label")
        ET.SubElement(label, "name").text = clean(one.label)
        ET.SubElement(label, "type").text = "rectangle" if one.part == BOX else "points"
        ET.SubElement(label, "attributes")
    if size is not None:
        original = ET.SubElement(task, "original_size")
        ET.SubElement(original, "width").text, ET.SubElement(original, "height").text = map(str, size)
    ET.SubElement(task, "source").text = clean(clip)
    for ident, one in enumerate(found):
        track = ET.SubElement(root, "track", id=str(ident), label=clean(one.label), source="file")
        corners = np.concatenate([one.ltwh[:, :2], one.ltwh[:, :2] + one.ltwh[:, 2:]], axis=1)
        if one.part == BOX and not np.isfinite(corners).all():
            raise InputError(f"{one.label}: a box without w and h has no room in CVAT; fill those columns")
        columns = (one.frame, one.state, corners, one.xy + HALF_PIXEL, one.angle)
        for frame, state, edges, xy, angle in zip(*(column.tolist() for column in columns), strict=True):
            shape = {"frame": str(frame), "keyframe": "1"}
            shape |= {"outside": str(int(state == "gone")), "occluded": str(int(state == "lost"))}
            if one.part == BOX:
                shape |= {name: f"{value:.2f}" for name, value in zip(("xtl", "ytl", "xbr", "ybr"), edges, strict=True)}
                shape |= {"rotation": f"{angle % 360:.2f}"} if angle == angle else {}  # not nan
            else:
                shape["points"] = f"{xy[0]:.2f},{xy[1]:.2f}"
            ET.SubElement(track, "box" if one.part == BOX else "points", shape, z_order="0")
    ET.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def read_cvat(path: Path, *, shift: int = 0) -> Trajectory:
    """The tracks: status visible, hidden (occluded) or absent (outside); `by_hand` are keyframes.

    Tracks of the same label are one part, as after a split: of two in a frame the visible one counts. A track of
    several points has the parts point_01, ... InputError, with the track and the frame, for what cannot be read.
    """
    root = _root(path)
    found: dict[tuple[str, str], dict[int, Mark]] = {}
    for track in root.iter("track"):
        target = str(track.get("label", ""))
        for shape in track:
            place = f"{path}: track {track.get('id')} ({target}), frame {shape.get('frame')}"
            if shape.tag in OTHERS:
                raise InputError(f"{place}: a {shape.tag}; boxes and points are read: remove that track")
            if shape.tag not in ("box", "points", "skeleton"):
                continue
            frame = str(shape.get("frame"))
            if not (frame.isascii() and frame.isdigit() and int(frame) <= MAX_FRAME):
                raise InputError(f"{place}: that is no frame number; export the file from CVAT again")
            for pair, mark in _marks(place, target, shape):
                before = found.setdefault(pair, {}).get(int(frame))
                if before is not None and before.status != "absent" != mark.status:
                    raise InputError(f"{place}: another track of the same label is there in that frame; remove one")
                if before is None or before.status == "absent":
                    found[pair][int(frame)] = mark
    return collected(path, found, "CVAT for video 1.1: frames from 0", shift)


def _marks(place: str, target: str, shape: ET.Element) -> list[tuple[tuple[str, str], Mark]]:
    if shape.tag == "skeleton":
        return [((target, str(one.get("label"))), _point(place, one, shape)) for one in shape.iter("points")]
    if shape.tag == "box":
        left, top, right, bottom = numbers(place, *(shape.get(name) for name in ("xtl", "ytl", "xbr", "ybr")))
        (angle,) = numbers(place, shape.get("rotation", 0))
        turned = {"angle": angle} if angle else {}
        return [(named(target), box_mark(place, left, top, right - left, bottom - top, **_about(shape), **turned))]
    points = str(shape.get("points")).split(";")
    if len(points) == 1:
        return [(named(target), _point(place, shape, shape))]
    pairs = [point.split(",") for point in points]
    if any(len(pair) != 2 for pair in pairs):
        raise InputError(f"{place}: points are written x,y;x,y; export the file from CVAT again")
    return [((target, f"point_{i:02d}"), point_mark(place, *pair, **_about(shape))) for i, pair in enumerate(pairs, 1)]


def _point(place: str, point: ET.Element, shape: ET.Element) -> Mark:
    pair = str(point.get("points")).split(",")
    if len(pair) != 2:
        raise InputError(f"{place}: a point is written x,y; export the file from CVAT again")
    return point_mark(place, *pair, **_about(point if point.get("outside") else shape))


def _about(shape: ET.Element) -> dict[str, Any]:
    gone, covered = shape.get("outside") == "1", shape.get("occluded") == "1"
    return {"status": "absent" if gone else "hidden" if covered else "visible", "by_hand": shape.get("keyframe") != "0"}


def _root(path: Path) -> ET.Element:
    if path.is_file():
        with path.open("rb") as file:
            if file.read(4) == b"PK\x03\x04":
                raise InputError(f"{path}: is a ZIP archive; unpack it, and name the annotations.xml in it")
    text = read_text(path)
    if "<!DOCTYPE" in text:
        raise InputError(f"{path}: declares a document type, which CVAT's files do not; it is not read")
    try:
        root = ET.fromstring(text)
    except ET.ParseError as e:
        raise InputError(f"{path}:{e.position[0]}: is no XML ({e}); export the file from CVAT again") from None
    if root.tag != "annotations":
        raise InputError(f"{path}: is XML, but not CVAT's: it begins with {root.tag}, not with annotations")
    if root.find("track") is None and root.find("image") is not None:
        raise InputError(f'{path}: is "CVAT for images", without tracks; export it as "CVAT for video 1.1"')
    return root
