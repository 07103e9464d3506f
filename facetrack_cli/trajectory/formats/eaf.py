"""ELAN's annotation format, EAF 3.0 (www.mpi.nl/tools/elan/EAFv3.0.xsd): written, added to a file, and read.

docs/export.md has the tiers. Their values are controlled vocabularies, described in the file. Times are those of the
frames, in milliseconds; a span ends when the frame after it begins. The media URL is the path as it is, not
percent-encoded: ELAN writes it so, and takes what follows `file:` for the name of the file.

To a file that people work in slots of time are added in their order, then tiers, types and vocabularies below those
that are there. All that it has stays; only the number of the last annotation is another.
"""

import contextlib
import os
import re
import uuid
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from itertools import accumulate, chain, count
from pathlib import Path
from typing import Final, NamedTuple
from urllib.parse import unquote
from xml.etree import ElementTree as ET

import numpy as np

from facetrack_cli.core import numbers
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.face_points import HANDS
from facetrack_cli.core.types import BOX
from facetrack_cli.trajectory.face_events import KINDS, events_of
from facetrack_cli.trajectory.formats.boxes import read_text
from facetrack_cli.trajectory.head import LABELS, head_motion
from facetrack_cli.trajectory.trajectory import Trajectory, aligned
from facetrack_cli.trajectory.views import frame_milliseconds

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
    slots, others, last = _elements(table, root)
    header = ET.SubElement(root, "HEADER", MEDIA_FILE="", TIME_UNITS="milliseconds")
    whole = Path(os.path.normpath(video.absolute())).as_posix()  # a link keeps the name that the user knows it by
    mime = MIME.get(video.suffix.lower(), "*")
    media = {"MEDIA_URL": "file:///" + clean(whole.lstrip("/")), "MIME_TYPE": f"video/{mime}"}
    with contextlib.suppress(ValueError):  # another drive of Windows: no way leads there
        relative = Path(os.path.relpath(whole, folder)).as_posix()
        media["RELATIVE_MEDIA_URL"] = clean(relative if relative.startswith("../") else f"./{relative}")
    ET.SubElement(header, "MEDIA_DESCRIPTOR", media)
    urn = uuid.uuid5(uuid.NAMESPACE_URL, f"{media['MEDIA_URL']} {last} {about['DATE']}")
    ET.SubElement(header, "PROPERTY", NAME="URN").text = f"urn:nl-mpi-tools-elan-eaf:{urn}"
    ET.SubElement(header, "PROPERTY", NAME="lastUsedAnnotationId").text = str(last)
    ET.SubElement(root, "TIME_ORDER").extend(slots)
    root.extend(others)
    return _text(root)


def _elements(table: Trajectory, root: ET.Element, offset: int = 0) -> tuple[list[ET.Element], list[ET.Element], int]:
    """The slots of time in their order, what stands below them in the schema's, and the number of the last annotation.

    Their names are free in the document `root`; what it has of our types and vocabularies is not among them.
    """
    taken = {element.get(key, "") for element in root.iter() for key in IDS}
    numbered = [name[1:].removeprefix("s") for name in taken if name[:1] in ("a", "t")]
    numbered.append(root.findtext(".//PROPERTY[@NAME='lastUsedAnnotationId']") or "")
    first = last = max([0, *map(int, filter(_is_whole, numbered))])

    def free(name: str) -> str:
        name = next(text for text in chain([name], (f"{name}-{n}" for n in count(2))) if text not in taken)
        taken.add(name)
        return name

    there = [own.attrib for own in root.iter("LINGUISTIC_TYPE")]
    tiers, ends, names = list[ET.Element](), list[tuple[int, ET.Element, str]](), dict[str, str]()
    for kind, target, spans in _tiers(table, offset):
        if kind not in names:
            names[kind] = kind if _type(kind, kind) in there else free(kind)
        # readers find a tier by a path with its name in straight quotes
        name = free(clean(f"{kind}@{target}").translate(QUOTES))
        about = {"LINGUISTIC_TYPE_REF": names[kind], "TIER_ID": name, "ANNOTATOR": "facetrack"}
        tiers.append(ET.Element("TIER", {**about, "PARTICIPANT": clean(target)}))
        for begin, end, text in spans:
            last += 1
            entry = {"CVE_REF": f"cveid_{names[kind]}_{text}"} if kind in VOCABULARIES else {}
            holder = ET.SubElement(tiers[-1], "ANNOTATION")
            note = ET.SubElement(holder, "ALIGNABLE_ANNOTATION", {"ANNOTATION_ID": f"a{last}", **entry})
            ET.SubElement(note, "ANNOTATION_VALUE").text = clean(text)
            ends += [(begin, note, "TIME_SLOT_REF1"), (end, note, "TIME_SLOT_REF2")]
    slots = []  # every annotation has two of its own, as ELAN makes them
    for number, (time, note, ref) in enumerate(sorted(ends, key=lambda end: end[0]), first + 1):
        slots.append(ET.Element("TIME_SLOT", TIME_SLOT_ID=f"ts{number}", TIME_VALUE=str(time)))
        note.set(ref, f"ts{number}")
    types, vocabularies = list[ET.Element](), list[ET.Element]()
    for kind, name in names.items():
        if _type(kind, name) not in there:
            types.append(ET.Element("LINGUISTIC_TYPE", _type(kind, name)))
            if kind in VOCABULARIES:
                vocabularies.append(ET.Element("CONTROLLED_VOCABULARY", CV_ID=name))
                about_it = ET.SubElement(vocabularies[-1], "DESCRIPTION", LANG_REF="eng")
                about_it.text = "motion of the target in the image plane"
            for label in VOCABULARIES.get(kind, ()):
                entry_of = ET.SubElement(vocabularies[-1], "CV_ENTRY_ML", CVE_ID=f"cveid_{name}_{label}")
                ET.SubElement(entry_of, "CVE_VALUE", LANG_REF="eng").text = label
    language = {"LANG_DEF": "http://cdb.iso.org/lg/CDB-00138502-001", "LANG_ID": "eng", "LANG_LABEL": "English (eng)"}
    languages = [ET.Element("LANGUAGE", language)] if "eng" not in taken else []
    return slots, [*tiers, *types, *languages, *vocabularies], last


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
    """The spans of frames in which a target of a film has rows, and a hand is not absent; none if another than a hand
    has them always.
    """
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
            origin = media.get("TIME_ORIGIN", "0")
            return int(origin) if _is_whole(origin) else 0
    return None


def add_tiers(path: Path, table: Trajectory, clip: str) -> tuple[str, list[str], bool]:
    """The text of the file with the tiers of a table; the names that they have there; whether it has the clip.

    Tiers whose name is there get another. InputError for a file that cannot take them.
    """
    root = _read(path)
    offset = _offset_of(root, clip)
    slots, others, last = _elements(table, root, offset or 0)
    order = root.find("TIME_ORDER")
    assert order is not None
    known = (slot.get("TIME_VALUE", "") for slot in order)
    latest = [*accumulate((int(time) if _is_whole(time) else -1 for time in known), max)]  # 64 bits may not hold them
    for n, slot in enumerate(slots):
        order.insert(bisect_right(latest, int(slot.get("TIME_VALUE", 0))) + n, slot)
    for element in others:
        above = ORDER[: ORDER.index(element.tag) + 1]
        root.insert(max(i for i, child in enumerate(root, 1) if child.tag in above), element)
    for number in root.iterfind(".//PROPERTY[@NAME='lastUsedAnnotationId']"):
        number.text = str(last)
    return _text(root), [element.get("TIER_ID", "") for element in others if element.tag == "TIER"], offset is not None


def read_xml(path: Path, tool: str) -> ET.Element:
    """The root of a file of a `tool`. InputError for a file that is no XML, or declares what could be dangerous."""
    text = read_text(path)
    if "<!DOCTYPE" in text:
        raise InputError(f"{path}: declares a document type, which {tool}'s files do not; it is not read")
    try:
        return ET.fromstring(text, ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))
    except ET.ParseError as e:
        raise InputError(f"{path}:{e.position[0]}: is no XML ({e}); save it by {tool} again") from None


def _read(path: Path) -> ET.Element:
    root = read_xml(path, "ELAN")
    if root.tag != "ANNOTATION_DOCUMENT" or root.find("TIME_ORDER") is None:
        raise InputError(f"{path}: is XML, but not ELAN's: it begins with {root.tag}; name an .eaf")
    version = root.get("FORMAT") or root.get("VERSION") or ""
    if not version.replace(".", "", 1).isdigit() or float(version) < LEAST_FORMAT:
        raise InputError(f"{path}: is of EAF {version or 'without a version'}; save it by ELAN 4.9 or later")
    return root


def _text(root: ET.Element) -> str:
    ET.indent(root, "    ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
