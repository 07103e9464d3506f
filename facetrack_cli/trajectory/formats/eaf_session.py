"""A file of ELAN that people work in: tiers are added to it, and its annotations are read.

What is added is put between its bytes, which stay: slots of time in their order, then tiers, types and vocabularies
below those that are there. Only the number of the last annotation is another.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, NamedTuple
from urllib.parse import unquote
from xml.etree import ElementTree as ET
from xml.parsers import expat

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.files import read_bounded

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


class Note(NamedTuple):
    """An annotation: its tier, the tier's participant, from when to when, in ms of the clip, and its text."""

    tier: str
    participant: str
    begin: int
    end: int
    text: str


class Tier(NamedTuple):
    name: str
    participant: str
    notes: tuple[Note, ...]


def read_tiers(path: Path, clip: str) -> list[Tier]:
    """The tiers of a file, with annotations that have times. Raises InputError for a file that is not ELAN's."""
    root = _read(path)[1]
    offset = offset_of(root, clip) or 0
    slots = {one.get("TIME_SLOT_ID"): one.get("TIME_VALUE") for one in root.iter("TIME_SLOT")}
    found = []
    for tier in root.iter("TIER"):
        name, participant, notes = tier.get("TIER_ID", ""), tier.get("PARTICIPANT", ""), []
        for one in tier.iter("ALIGNABLE_ANNOTATION"):
            ends = [slots.get(one.get(f"TIME_SLOT_REF{n}")) for n in (1, 2)]
            if all(end is not None and end.isascii() and end.isdigit() for end in ends):
                begin, end = (int(str(time)) + offset for time in ends)
                notes.append(Note(name, participant, begin, end, (one.findtext("ANNOTATION_VALUE") or "").strip()))
        found.append(Tier(name, participant, tuple(notes)))
    return found


def offset_of(root: ET.Element, clip: str) -> int | None:
    """The time of the clip, in ms, at which the file's own times begin; None where it does not link to the clip."""
    for media in root.iter("MEDIA_DESCRIPTOR"):
        if unquote(media.get("MEDIA_URL", "")).replace("\\", "/").rpartition("/")[2] == unquote(clip):
            origin = media.get("TIME_ORIGIN", "0")
            return int(origin) if origin.isascii() and origin.isdigit() else 0
    return None


def add_tiers(path: Path, ours: str, clip: str) -> tuple[bytes, list[str], bool]:
    """The file with the tiers of `ours`, the text of an .eaf; the names that they have there; whether it has the clip.

    Tiers whose name is there get another. InputError for a file that cannot take them.
    """
    data, root, marks = _read(path)
    new, offset = ET.fromstring(ours), offset_of(root, clip)
    tiers, slots = _named_apart(root, new), sorted(_moved(new, offset or 0), key=lambda one: one[0])
    added: list[tuple[int, int, bytes]] = []  # where, how many bytes are replaced, by what
    at, there = 0, [(mark.at, int(mark.about["TIME_VALUE"])) for mark in marks if mark.about.get("TIME_VALUE")]
    end = next(mark for mark in marks if mark.tag == "TIME_ORDER" and mark.ends)
    rows: dict[int, list[ET.Element]] = {}
    for time, slot in slots:
        while at < len(there) and there[at][1] <= time:
            at += 1
        rows.setdefault(there[at][0] if at < len(there) else end.at, []).append(slot)
    begin = next(mark for mark in marks if mark.tag == "TIME_ORDER")
    for where, those in rows.items():
        text = _text(those, 2)
        if data[begin.at : end.at].count(b"<") == 1 and data[: end.at].endswith(b"/>"):  # <TIME_ORDER/>
            text = b"<TIME_ORDER>\n        " + text.rstrip() + b"\n    </TIME_ORDER>"
            added.append((begin.at, end.at - begin.at, text))
        elif where == end.at:
            added.append((where, 0, b"    " + text[:-4]))
        else:
            added.append((where, 0, text))
    for tag in ("TIER", "LINGUISTIC_TYPE", "LANGUAGE", "CONTROLLED_VOCABULARY"):
        after = [mark.at for mark in marks if mark.depth == 1 and mark.tag in ORDER[ORDER.index(tag) + 1 :]]
        where = after[0] if after else next(mark.at for mark in marks if not mark.depth and mark.ends)
        if those := new.findall(tag):
            text = _text(those, 1)
            added.append((where, 0, text if after else b"    " + text[:-4]))
    numbers = [int(str(one.get("ANNOTATION_ID"))[1:]) for one in new.iter("ALIGNABLE_ANNOTATION")]
    for mark in marks:
        if mark.about.get("NAME") == "lastUsedAnnotationId" and mark.text and numbers:
            added.append((*mark.text, str(max(numbers)).encode()))
    parts, done = [], 0
    for where, replaced, text in sorted(added, key=lambda one: one[0]):
        parts += [data[done:where], text]
        done = where + replaced
    return b"".join([*parts, data[done:]]), tiers, offset is not None


def _moved(new: ET.Element, offset: int) -> list[tuple[int, ET.Element]]:
    """The slots at the file's times; what lies before its beginning is no annotation, or begins there."""
    slots = {str(one.get("TIME_SLOT_ID")): one for one in new.iter("TIME_SLOT")}
    times = {name: max(int(str(one.get("TIME_VALUE"))) - offset, 0) for name, one in slots.items()}
    for tier in new.findall("TIER"):
        for holder in list(tier):
            names = [str(holder[0].get(f"TIME_SLOT_REF{n}")) for n in (1, 2)]
            if times[names[0]] >= times[names[1]]:
                tier.remove(holder)
                for name in names:
                    del times[name]
    for name, time in times.items():
        slots[name].set("TIME_VALUE", str(time))
    return [(time, slots[name]) for name, time in times.items()]


def _named_apart(root: ET.Element, new: ET.Element) -> list[str]:
    """Give what is new names that the file does not have; types and vocabularies of ours that it has stay out."""
    taken = {key: {one.get(key) for one in root.iter() if one.get(key)} for key in IDS}
    numbers = [
        int(one[1:] if key == "ANNOTATION_ID" else one[2:])
        for key, begins in (("ANNOTATION_ID", "a"), ("TIME_SLOT_ID", "ts"))
        for one in taken[key]
        if one and one.startswith(begins) and one[len(begins) :].isascii() and one[len(begins) :].isdigit()
    ]
    last = root.findtext(".//PROPERTY[@NAME='lastUsedAnnotationId']") or ""
    first = max([*numbers, int(last) if last.isascii() and last.isdigit() else 0])
    given: dict[tuple[str, str], str] = {}
    same = {one.get("LINGUISTIC_TYPE_ID") for one in root.findall("LINGUISTIC_TYPE") if _is_ours(root, new, one)}
    for one in list(new):
        kind = one.get("LINGUISTIC_TYPE_ID") or one.get("CV_ID")
        if kind in same or (one.tag == "LANGUAGE" and one.get("LANG_ID") in taken["LANG_ID"]):
            new.remove(one)
    for one in new.iter():
        for key in (key for key in IDS if one.get(key)):
            name = str(one.get(key))
            if key in ("TIME_SLOT_ID", "ANNOTATION_ID"):
                begins = "ts" if key == "TIME_SLOT_ID" else "a"
                given[key, name] = f"{begins}{first + int(name[len(begins) :])}"
            elif name in taken[key]:
                given[key, name] = next(f"{name}-{n}" for n in range(2, 10**6) if f"{name}-{n}" not in taken[key])
    for one in new.iter():
        for key in set(one.keys()) & {*IDS, *REFS}:
            name = str(one.get(key))
            one.set(key, given.get((REFS.get(key, key), name), name))
    return [str(one.get("TIER_ID")) for one in new.findall("TIER")]


def _is_ours(root: ET.Element, new: ET.Element, one: ET.Element) -> bool:
    """Whether a type of the file is one of the new ones, with all of its vocabulary."""
    name = one.get("LINGUISTIC_TYPE_ID")
    ours = next((other for other in new.findall("LINGUISTIC_TYPE") if other.get("LINGUISTIC_TYPE_ID") == name), None)
    if ours is None or any(ours.get(key) != one.get(key) for key in ("CONTROLLED_VOCABULARY_REF", "CONSTRAINTS")):
        return False
    entries = [
        {e.get("CVE_ID") for e in of.iterfind(f"CONTROLLED_VOCABULARY[@CV_ID='{name}']/*")} for of in (new, root)
    ]
    return entries[0] <= entries[1]


class Mark(NamedTuple):
    """Where an element begins, or `ends`, in the bytes; `text`: where what is in it begins, and how long that is."""

    tag: str
    depth: int
    ends: bool
    at: int
    about: dict[str, str]
    text: tuple[int, int] | None = None


def _read(path: Path) -> tuple[bytes, ET.Element, list[Mark]]:
    """The bytes of a file, its tree, and where each element is in the bytes."""
    try:
        data = read_bounded(path)
    except OSError as e:
        raise InputError(f"{path}: cannot be read: {e.strerror or e}; name an .eaf") from None
    if b"<!DOCTYPE" in data[:4096] or b"<!ENTITY" in data:
        raise InputError(f"{path}: declares a document type, which ELAN's files do not; it is not read")
    marks: list[Mark] = []
    parser, depth = expat.ParserCreate("UTF-8"), 0

    def start(tag: str, about: dict[str, Any]) -> None:
        nonlocal depth
        marks.append(Mark(tag, depth, False, parser.CurrentByteIndex, about))
        depth += 1

    def stop(tag: str) -> None:
        nonlocal depth
        depth -= 1
        marks.append(Mark(tag, depth, True, parser.CurrentByteIndex, {}))

    def said(text: str) -> None:
        if marks and not marks[-1].ends and marks[-1].tag == "PROPERTY":
            marks[-1] = marks[-1]._replace(text=(parser.CurrentByteIndex, len(text.encode())))

    parser.StartElementHandler, parser.EndElementHandler, parser.CharacterDataHandler = start, stop, said
    parser.buffer_text = False
    try:
        parser.Parse(data, True)
        root = ET.fromstring(data)
    except (expat.ExpatError, ET.ParseError, ValueError, LookupError) as e:
        raise InputError(f"{path}: is no XML in UTF-8 ({e}); save it by ELAN again") from None
    if root.tag != "ANNOTATION_DOCUMENT" or root.find("TIME_ORDER") is None:
        raise InputError(f"{path}: is XML, but not ELAN's: it begins with {root.tag}; name an .eaf")
    version = root.get("FORMAT") or root.get("VERSION") or ""
    if not version.replace(".", "", 1).isdigit() or float(version) < LEAST_FORMAT:
        raise InputError(f"{path}: is of EAF {version or 'without a version'}; save it by ELAN 4.9 or later")
    return data, root, marks


def _text(elements: list[ET.Element], depth: int) -> bytes:
    """Elements as they stand at a depth, each on lines of its own, before one that stands there."""
    texts = []
    for one in elements:
        ET.indent(one, "    ", level=depth)
        one.tail = ""
        texts.append(ET.tostring(one, encoding="unicode") + "\n" + "    " * depth)
    return "".join(texts).encode()
