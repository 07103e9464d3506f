"""ELAN's annotation format, EAF 3.0 (www.mpi.nl/tools/elan/EAFv3.0.xsd): tiers of lost parts and of head motion.

docs/export.md has the tiers. Their values are controlled vocabularies, described in the file. Times are those of the
frames, in milliseconds; a span ends when the frame after it begins. The media URL is the path as it is, not
percent-encoded: ELAN writes it so, and takes what follows `file:` for the name of the file.
"""

import contextlib
import os
import re
import uuid
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from itertools import groupby
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from facetrack_cli.core import numbers
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.face_points import HANDS
from facetrack_cli.core.types import BOX
from facetrack_cli.trajectory.analysis.face_events import events_of
from facetrack_cli.trajectory.analysis.head_motion import head_motion, kinds_of
from facetrack_cli.trajectory.analysis.measures import Measured
from facetrack_cli.trajectory.trajectory import Trajectory, aligned

XSI = "http://www.w3.org/2001/XMLSchema-instance"
SCHEMA = "http://www.mpi.nl/tools/elan/EAFv3.0.xsd"
MIME = {".mp4": "mp4", ".m4v": "mp4", ".mpeg": "mpeg", ".mpg": "mpeg", ".webm": "webm"}
MIME |= {".mov": "quicktime", ".avi": "x-msvideo", ".mkv": "x-matroska"}
CONSTRAINTS = {
    "Time_Subdivision": "Time subdivision of parent annotation's time interval, no time gaps allowed within this "
    "interval",
    "Symbolic_Subdivision": "Symbolic subdivision of a parent annotation. Annotations refering to the same parent are "
    "ordered",
    "Symbolic_Association": "1-1 association with a parent annotation",
    "Included_In": "Time alignable annotations within the parent annotation's time interval, gaps are allowed",
}
"""The four that ELAN itself writes into every file, in its own words."""
VOCABULARIES = {
    "seen": {"seen": "is followed in the picture"},
    "horizontal": {"left": "moves to the left of the image", "right": "moves to the right of the image"},
    "vertical": {"up": "moves up in the image", "down": "moves down in the image"},
    "tilt": {label: f"turns {label} in the image plane" for label in ("clockwise", "counterclockwise")},
    "size": {"approach": "grows in the image", "recede": "shrinks in the image"},
    "nods": {"nod": "swings up and down, three times or more", "shake": "swings left and right, three times or more"},
    "still": {"still": "none of the motions of the other tiers for a second or more"},
    "mouth": {"open": "the mouth is open"},
    "smile": {"smile": "the mouth is wide, for half a second or more"},
    "blinks": {"blink": "the eyes are shut, for half a second at most", "shut": "the eyes are shut for longer"},
    "dips": {"nod": "the head goes down and back, by its pitch"},
    "shakes": {"shake": "the head turns to one side and to the other, by its yaw"},
    **{f"wink_{side}": {"wink": f"the {side} eye alone is shut"} for side in ("left", "right")},
    "speech": {"talks": "the mouth moves as in talking"},
    "phases": {"hold": "the hand is held still", "movement": "the hand moves"},
    "hand_contact": {"hand": "meets the other hand in the image"},
    "face_contact": {"face": "meets the face in the image"},
}
QUOTES = str.maketrans({"'": "\N{RIGHT SINGLE QUOTATION MARK}", '"': "\N{RIGHT DOUBLE QUOTATION MARK}"})
FRAME_S = 0.04  # how long a single frame lasts where nothing tells


def write_eaf(table: Trajectory, media: Path, folder: Path, *, written: datetime) -> str:
    """The XML text, which will stand in `folder`; `media` is the video. InputError for times that do not increase."""
    begin, end = times_of(table)
    tiers = [
        (kind, target, spans)
        for name in table.targets
        for kind, target, found in _tiers(name, table.of_target(name), table.measures[name])
        # readers have trouble with tiers without annotations
        if (spans := [(begin[a], end[b], text) for a, b, text in found if end[b] > begin[a]])
    ]
    about = {"AUTHOR": "facetrack", "DATE": written.astimezone().isoformat(timespec="seconds")}
    schema = {"FORMAT": "3.0", "VERSION": "3.0", "xmlns:xsi": XSI, "xsi:noNamespaceSchemaLocation": SCHEMA}
    root = ET.Element("ANNOTATION_DOCUMENT", {**about, **schema})
    _header(root, media, folder, sum(len(spans) for *_, spans in tiers))
    # every annotation has two slots of its own, as ELAN makes them; slots stand in the order of their times
    times = sorted((time, n) for n, time in enumerate(t for *_, spans in tiers for a, b, _ in spans for t in (a, b)))
    order = ET.SubElement(root, "TIME_ORDER")
    slots: dict[int, str] = {}
    for place, (time, n) in enumerate(times, 1):
        slots[n] = f"ts{place}"
        ET.SubElement(order, "TIME_SLOT", TIME_SLOT_ID=f"ts{place}", TIME_VALUE=str(time))
    count = 0
    for kind, target, spans in tiers:
        # readers find a tier by a path with its name in straight quotes
        name = clean(f"{kind}@{target}").translate(QUOTES)
        about = {"LINGUISTIC_TYPE_REF": kind, "TIER_ID": name, "ANNOTATOR": "facetrack"}
        tier = ET.SubElement(root, "TIER", {**about, "PARTICIPANT": clean(target)})
        for _, _, text in spans:
            count += 1
            entry = {"CVE_REF": _entry(kind, text)} if kind in VOCABULARIES else {}
            ends = {"TIME_SLOT_REF1": slots[2 * count - 2], "TIME_SLOT_REF2": slots[2 * count - 1]}
            own = {"ANNOTATION_ID": f"a{count}", **entry, **ends}
            one = ET.SubElement(ET.SubElement(tier, "ANNOTATION"), "ALIGNABLE_ANNOTATION", own)
            ET.SubElement(one, "ANNOTATION_VALUE").text = clean(text)
    _types(root, list(dict.fromkeys(kind for kind, _, _ in tiers)))
    ET.indent(root, "    ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def spans_of(parts: Sequence[Trajectory], status: str = "lost") -> list[tuple[int, int, str]]:
    """Spans (first frame, last, names) in which the same parts of a target have a `status`, in rows without a gap."""
    frames, columns = aligned(parts, "status")
    those = (columns["status"] == status).tolist()
    names = [", ".join(part.part for part, is_one in zip(parts, row, strict=True) if is_one) for row in those]
    breaks = np.cumsum(np.diff(frames, prepend=frames[:1]) > 1).tolist()
    found = []
    for (_, text), rows in groupby(zip(breaks, names, frames.tolist(), strict=True), key=lambda row: row[:2]):
        members = [frame for _, _, frame in rows]
        if text:
            found.append((members[0], members[-1], status if text == BOX else text))
    return found


def seen_in(parts: Sequence[Trajectory]) -> list[tuple[int, int]]:
    """The spans of frames in which a target of a film has rows, and a hand is not absent; none if another than a hand
    has them always.
    """
    frames = np.unique(np.concatenate([part.frame for part in parts]))
    there = ~np.isin(frames, np.concatenate([part.frame[part.vanished] for part in parts]))
    found = numbers.spans(there, np.diff(frames) > 1)
    always = len(found) == 1 and there.all() and parts[0].target not in HANDS
    return [] if always else [(int(frames[a]), int(frames[b - 1])) for a, b in found]


def _tiers(
    target: str, parts: Sequence[Trajectory], measures: Mapping[str, Measured]
) -> Iterator[tuple[str, str, list[tuple[int, int, str]]]]:
    """Kind, target, and its spans, of which there may be none."""
    name = target or "target"
    yield "seen", name, [(first, last, "seen") for first, last in seen_in(parts)]
    yield "lost", name, spans_of(parts)
    yield "hidden", name, spans_of(parts, "hidden")
    yield "absent", name, spans_of([part.take(~part.vanished) for part in parts], "absent")  # as corrections say
    moved = head_motion(parts)
    for kind in kinds_of(parts):
        if kind != "nods" or target not in HANDS:
            yield kind, name, [(span.first, span.last, span.label) for span in moved if span.kind == kind]
    for kind, events in events_of(name, measures).items():
        yield kind, name, [(event.first_frame, event.last_frame, event.value) for event in events]


def times_of(table: Trajectory) -> list[dict[int, int]]:
    """When each frame begins and when the next one does, in milliseconds, by frame."""
    frames, time_s = table.frames, table.times
    if (unknown := frames[~np.isfinite(time_s)]).size:
        raise InputError(f"frame {unknown[0]} has no time_s, and annotations need times; fill that column")
    if (back := np.flatnonzero(np.diff(time_s) <= 0)).size:
        (one, other), (first, second) = frames[back[0] :][:2], time_s[back[0] :][:2]
        raise InputError(f"frame {other} is at {second:g} s, not after frame {one} at {first:g} s; correct time_s")
    steps = np.diff(time_s) / np.diff(frames)
    usual = float(np.median(steps)) if steps.size else FRAME_S
    after = np.append(time_s[1:], time_s[-1] + usual)
    after = np.where(np.append(np.diff(frames) > 1, False), np.minimum(after, time_s + usual), after)
    milliseconds = [np.rint(np.maximum(t, 0) * 1000).astype(np.int64).tolist() for t in (time_s, after)]
    return [dict(zip(frames.tolist(), those, strict=True)) for those in milliseconds]


def _header(root: ET.Element, media: Path, folder: Path, annotations: int) -> None:
    header = ET.SubElement(root, "HEADER", MEDIA_FILE="", TIME_UNITS="milliseconds")
    whole = Path(os.path.normpath(media.absolute())).as_posix()  # a link keeps the name that the user knows it by
    mime = MIME.get(media.suffix.lower(), "*")
    about = {"MEDIA_URL": "file:///" + clean(whole.lstrip("/")), "MIME_TYPE": f"video/{mime}"}
    with contextlib.suppress(ValueError):  # another drive of Windows: no way leads there
        relative = Path(os.path.relpath(whole, folder)).as_posix()
        about["RELATIVE_MEDIA_URL"] = clean(relative if relative.startswith("../") else f"./{relative}")
    ET.SubElement(header, "MEDIA_DESCRIPTOR", about)
    urn = uuid.uuid5(uuid.NAMESPACE_URL, f"{about['MEDIA_URL']} {annotations} {root.get('DATE')}")
    ET.SubElement(header, "PROPERTY", NAME="URN").text = f"urn:nl-mpi-tools-elan-eaf:{urn}"
    ET.SubElement(header, "PROPERTY", NAME="lastUsedAnnotationId").text = str(annotations)


def _types(root: ET.Element, kinds: Sequence[str]) -> None:
    """What stands below the tiers, in the schema's order: types, language, constraints, vocabularies."""
    for kind in kinds:
        about = {"GRAPHIC_REFERENCES": "false", "LINGUISTIC_TYPE_ID": kind, "TIME_ALIGNABLE": "true"}
        given = {"CONTROLLED_VOCABULARY_REF": kind} if kind in VOCABULARIES else {}
        ET.SubElement(root, "LINGUISTIC_TYPE", {**given, **about})
    language = {"LANG_DEF": "http://cdb.iso.org/lg/CDB-00138502-001", "LANG_ID": "eng", "LANG_LABEL": "English (eng)"}
    ET.SubElement(root, "LANGUAGE", language)
    for stereotype, description in CONSTRAINTS.items():
        ET.SubElement(root, "CONSTRAINT", DESCRIPTION=description, STEREOTYPE=stereotype)
    for kind in kinds:
        if kind in VOCABULARIES:
            group = ET.SubElement(root, "CONTROLLED_VOCABULARY", CV_ID=kind)
            ET.SubElement(group, "DESCRIPTION", LANG_REF="eng").text = "motion of the target in the image plane"
            for label, description in VOCABULARIES[kind].items():
                entry = ET.SubElement(group, "CV_ENTRY_ML", CVE_ID=_entry(kind, label))
                ET.SubElement(entry, "CVE_VALUE", DESCRIPTION=description, LANG_REF="eng").text = label


def _entry(kind: str, label: str) -> str:
    return f"cveid_{kind}_{label}"


def clean(text: str) -> str:
    """Text without the characters that XML 1.0 has no way to write."""
    return re.sub("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]", "\ufffd", text)
