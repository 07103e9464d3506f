"""ELAN's annotation format, EAF 3.0 (www.mpi.nl/tools/elan/EAFv3.0.xsd): written, added to a file, and read.

docs/export.md has the tiers. Their values are controlled vocabularies, described in the file. Times are those of the
frames, in milliseconds; a span ends when the frame after it begins. The media URL is the path as it is, not
percent-encoded: ELAN writes it so, and takes what follows `file:` for the name of the file.

What is added to a file that people work in is put between its bytes, which stay: slots of time in their order, then
tiers, types and vocabularies below those that are there. Only the number of the last annotation is another.
"""

import contextlib
import os
import re
import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Final, NamedTuple
from urllib.parse import unquote
from xml.etree import ElementTree as ET
from xml.parsers import expat

import numpy as np

from facetrack_cli.core import numbers
from facetrack_cli.core.errors import InputError, reading
from facetrack_cli.core.face_points import HANDS
from facetrack_cli.core.files import read_bounded
from facetrack_cli.core.types import BOX
from facetrack_cli.trajectory.face_events import KINDS, events_of
from facetrack_cli.trajectory.head import LABELS, head_motion
from facetrack_cli.trajectory.measures import Measured
from facetrack_cli.trajectory.trajectory import Trajectory, aligned
from facetrack_cli.trajectory.views import frame_milliseconds

XSI = "http://www.w3.org/2001/XMLSchema-instance"
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
REFS: Final = {
    "TIME_SLOT_REF1": "TIME_SLOT_ID", "TIME_SLOT_REF2": "TIME_SLOT_ID", "LINGUISTIC_TYPE_REF": "LINGUISTIC_TYPE_ID",
    "CONTROLLED_VOCABULARY_REF": "CV_ID", "CVE_REF": "CVE_ID", "LANG_REF": "LANG_ID",
}  # fmt: skip
"""Attributes that name what another attribute declares."""


def write_eaf(table: Trajectory, video: Path, folder: Path, written: datetime) -> str:
    """The XML text, which will stand in `folder`. InputError for times that do not increase."""
    begin, end = frame_milliseconds(table)
    tiers = [
        (kind, target, spans)
        for name in table.targets
        for kind, target, measured in _tiers(name, table.of_target(name), table.measures[name])
        # readers have trouble with tiers without annotations
        if (spans := [(begin[a], end[b], text) for a, b, text in measured if end[b] > begin[a]])
    ]
    about = {"AUTHOR": "facetrack", "DATE": written.astimezone().isoformat(timespec="seconds")}
    schema = {"FORMAT": "3.0", "VERSION": "3.0", "xmlns:xsi": XSI, "xsi:noNamespaceSchemaLocation": SCHEMA}
    root = ET.Element("ANNOTATION_DOCUMENT", {**about, **schema})
    _header(root, video, folder, sum(len(spans) for *_, spans in tiers))
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
            element = ET.SubElement(ET.SubElement(tier, "ANNOTATION"), "ALIGNABLE_ANNOTATION", own)
            ET.SubElement(element, "ANNOTATION_VALUE").text = clean(text)
    _types(root, list(dict.fromkeys(kind for kind, _, _ in tiers)))
    ET.indent(root, "    ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


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


def _tiers(
    target: str, parts: Sequence[Trajectory], measures: Mapping[str, Measured]
) -> Iterator[tuple[str, str, list[tuple[int, int, str]]]]:
    """Kind, target, and its spans, of which there may be none."""
    name = target or "target"
    yield "seen", name, [(first, last, "seen") for first, last in seen_in(parts)]
    yield "lost", name, spans_of(parts)
    yield "hidden", name, spans_of(parts, "hidden")
    yield "absent", name, spans_of([part.take(~part.vanished) for part in parts], "absent")  # as corrections say
    for kind, moved in head_motion(parts).items():
        yield kind, name, moved
    for kind, events in events_of(name, measures).items():
        yield kind, name, [(event.first_frame, event.last_frame, event.value) for event in events]


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
    """What stands below the tiers, in the schema's order: types, language, vocabularies."""
    for kind in kinds:
        about = {"GRAPHIC_REFERENCES": "false", "LINGUISTIC_TYPE_ID": kind, "TIME_ALIGNABLE": "true"}
        vocabulary = {"CONTROLLED_VOCABULARY_REF": kind} if kind in VOCABULARIES else {}
        ET.SubElement(root, "LINGUISTIC_TYPE", {**vocabulary, **about})
    language = {"LANG_DEF": "http://cdb.iso.org/lg/CDB-00138502-001", "LANG_ID": "eng", "LANG_LABEL": "English (eng)"}
    ET.SubElement(root, "LANGUAGE", language)
    for kind in kinds:
        if kind in VOCABULARIES:
            group = ET.SubElement(root, "CONTROLLED_VOCABULARY", CV_ID=kind)
            ET.SubElement(group, "DESCRIPTION", LANG_REF="eng").text = "motion of the target in the image plane"
            for label in VOCABULARIES[kind]:
                entry = ET.SubElement(group, "CV_ENTRY_ML", CVE_ID=_entry(kind, label))
                ET.SubElement(entry, "CVE_VALUE", LANG_REF="eng").text = label


def _entry(kind: str, label: str) -> str:
    return f"cveid_{kind}_{label}"


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
    root = _read(path)[1]
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
    return text.isascii() and text.isdigit()


def _offset_of(root: ET.Element, clip: str) -> int | None:
    """The time of the clip, in ms, at which the file's own times begin; None where it does not link to the clip."""
    for media in root.iter("MEDIA_DESCRIPTOR"):
        if unquote(media.get("MEDIA_URL", "")).replace("\\", "/").rpartition("/")[2] == unquote(clip):
            origin = media.get("TIME_ORIGIN", "0")
            return int(origin) if _is_whole(origin) else 0
    return None


def add_tiers(path: Path, ours: str, clip: str) -> tuple[bytes, list[str], bool]:
    """The file with the tiers of `ours`, the text of an .eaf; the names that they have there; whether it has the clip.

    Tiers whose name is there get another. InputError for a file that cannot take them.
    """
    data, root, spans = _read(path)
    new, offset = ET.fromstring(ours), _offset_of(root, clip)
    tiers, slots = _named_apart(root, new), sorted(_moved(new, offset or 0), key=lambda slot: slot[0])
    edits: list[tuple[int, int, bytes]] = []  # where, how many bytes are replaced, by what

    def insert(where: int, elements: list[ET.Element], depth: int, *, last: bool) -> None:
        """Each on a line of its own, before what stands at `where`, or as the `last` ones of their parent."""
        texts = []
        for element in elements:
            ET.indent(element, "    ", level=depth)
            element.tail = ""
            texts.append(ET.tostring(element, encoding="unicode") + "\n" + "    " * depth)
        text = "".join(texts)
        edits.append((where, 0, ("    " + text[:-4] if last else text).encode()))

    order = next(span for span in spans if span.tag == "TIME_ORDER")
    times = [(span.begin, int(span.about["TIME_VALUE"])) for span in spans if span.about.get("TIME_VALUE")]
    at, rows = 0, dict[int, list[ET.Element]]()
    for time, slot in slots:
        while at < len(times) and times[at][1] <= time:
            at += 1
        rows.setdefault(times[at][0] if at < len(times) else order.end, []).append(slot)
    for where, elements in rows.items():
        insert(where, elements, 2, last=where == order.end)
    if rows and data[order.begin : order.end].endswith(b"/>") and data.count(b"<", order.begin, order.end) == 1:
        text = edits.pop()[2].decode().rstrip()
        edits.append((order.begin, order.end - order.begin, f"<TIME_ORDER>\n    {text}\n    </TIME_ORDER>".encode()))
    for tag in ("TIER", "LINGUISTIC_TYPE", "LANGUAGE", "CONTROLLED_VOCABULARY"):
        later = ORDER[ORDER.index(tag) + 1 :]
        after = next((span.begin for span in spans if span.depth == 1 and span.tag in later), None)
        if elements := new.findall(tag):
            insert(spans[0].end if after is None else after, elements, 1, last=after is None)
    numbers = [int(str(note.get("ANNOTATION_ID"))[1:]) for note in new.iter("ALIGNABLE_ANNOTATION")]
    for span in spans:
        if span.about.get("NAME") == "lastUsedAnnotationId" and span.text and numbers:
            edits.append((*span.text, str(max(numbers)).encode()))
    parts, done = [], 0
    for where, replaced, addition in sorted(edits, key=lambda edit: edit[0]):
        parts += [data[done:where], addition]
        done = where + replaced
    return b"".join([*parts, data[done:]]), tiers, offset is not None


def _moved(new: ET.Element, offset: int) -> list[tuple[int, ET.Element]]:
    """The slots at the file's times; what lies before its beginning is no annotation, or begins there."""
    slots = {str(slot.get("TIME_SLOT_ID")): slot for slot in new.iter("TIME_SLOT")}
    times = {name: max(int(str(slot.get("TIME_VALUE"))) - offset, 0) for name, slot in slots.items()}
    for tier in new.findall("TIER"):
        for holder in list(tier):
            first, last = (str(holder[0].get(f"TIME_SLOT_REF{n}")) for n in (1, 2))
            if times[first] >= times[last]:
                tier.remove(holder)
                del times[first], times[last]
    for name, time in times.items():
        slots[name].set("TIME_VALUE", str(time))
    return [(time, slots[name]) for name, time in times.items()]


def _named_apart(root: ET.Element, new: ET.Element) -> list[str]:
    """Give what is new names that the file does not have; types and vocabularies of ours that it has stay out."""
    taken = {key: {element.get(key, "") for element in root.iter()} - {""} for key in IDS}
    prefixes = {"ANNOTATION_ID": "a", "TIME_SLOT_ID": "ts"}
    numbers = [
        name.removeprefix(prefix) for key, prefix in prefixes.items() for name in taken[key] if name.startswith(prefix)
    ]
    numbers.append(root.findtext(".//PROPERTY[@NAME='lastUsedAnnotationId']") or "")
    first = max([0, *map(int, filter(_is_whole, numbers))])
    same = {kind.get("LINGUISTIC_TYPE_ID") for kind in root.findall("LINGUISTIC_TYPE") if _is_ours(root, new, kind)}
    for element in list(new):
        kind = element.get("LINGUISTIC_TYPE_ID") or element.get("CV_ID")
        if kind in same or (element.tag == "LANGUAGE" and element.get("LANG_ID") in taken["LANG_ID"]):
            new.remove(element)
    names: dict[tuple[str, str], str] = {}
    for element in new.iter():
        for key in (key for key in IDS if element.get(key)):
            name = str(element.get(key))
            if prefix := prefixes.get(key):
                names[key, name] = f"{prefix}{first + int(name.removeprefix(prefix))}"
            elif name in taken[key]:
                names[key, name] = next(f"{name}-{n}" for n in range(2, 10**6) if f"{name}-{n}" not in taken[key])
    for element in new.iter():
        for key in set(element.keys()) & {*IDS, *REFS}:
            name = str(element.get(key))
            element.set(key, names.get((REFS.get(key, key), name), name))
    return [str(tier.get("TIER_ID")) for tier in new.findall("TIER")]


def _is_ours(root: ET.Element, new: ET.Element, kind: ET.Element) -> bool:
    """Whether a type of the file is one of the new ones, with all of its vocabulary."""
    name = kind.get("LINGUISTIC_TYPE_ID")
    ours = next((kind for kind in new.findall("LINGUISTIC_TYPE") if kind.get("LINGUISTIC_TYPE_ID") == name), None)
    if ours is None or any(ours.get(key) != kind.get(key) for key in ("CONTROLLED_VOCABULARY_REF", "CONSTRAINTS")):
        return False
    path = f"CONTROLLED_VOCABULARY[@CV_ID='{name}']/*"
    return {entry.get("CVE_ID") for entry in new.iterfind(path)} <= {
        entry.get("CVE_ID") for entry in root.iterfind(path)
    }


@dataclass
class _Span:
    """Where an element stands in the bytes: its beginning, that of its closing tag, and where its text is, how long."""

    tag: str
    depth: int
    about: dict[str, str]
    begin: int
    end: int = 0
    text: tuple[int, int] | None = None


def _read(path: Path) -> tuple[bytes, ET.Element, list[_Span]]:
    """The bytes of a file, its tree, and where each element is in the bytes."""
    with reading(path, "name an .eaf"):
        data = read_bounded(path)
    if b"<!DOCTYPE" in data[:4096] or b"<!ENTITY" in data:
        raise InputError(f"{path}: declares a document type, which ELAN's files do not; it is not read")
    spans: list[_Span] = []
    open_spans: list[_Span] = []
    parser, builder = expat.ParserCreate("UTF-8"), ET.TreeBuilder()

    def start(tag: str, about: dict[str, Any]) -> None:
        span = _Span(tag, len(open_spans), about, parser.CurrentByteIndex)
        spans.append(span)
        open_spans.append(span)
        builder.start(tag, about)

    def stop(tag: str) -> None:
        open_spans.pop().end = parser.CurrentByteIndex
        builder.end(tag)

    def text(piece: str) -> None:
        open_spans[-1].text = parser.CurrentByteIndex, len(piece.encode())
        builder.data(piece)

    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = start, stop, text
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, ValueError, LookupError) as e:
        raise InputError(f"{path}: is no XML in UTF-8 ({e}); save it by ELAN again") from None
    root = builder.close()
    if root.tag != "ANNOTATION_DOCUMENT" or root.find("TIME_ORDER") is None:
        raise InputError(f"{path}: is XML, but not ELAN's: it begins with {root.tag}; name an .eaf")
    version = root.get("FORMAT") or root.get("VERSION") or ""
    if not version.replace(".", "", 1).isdigit() or float(version) < LEAST_FORMAT:
        raise InputError(f"{path}: is of EAF {version or 'without a version'}; save it by ELAN 4.9 or later")
    return data, root, spans
