"""Who is in a folder of folders, and which face in each image is meant.

One folder for each person, with the person's name; in it images, videos, and folders of a video's frames. An init file
beside one says where the face is; of another image the largest face is taken, of another clip that of some frames.
"""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

from facetrack_cli.core.errors import InputError, reason
from facetrack_cli.core.types import Box, Frame, Start
from facetrack_cli.core.yaml_tree import printable
from facetrack_cli.tracking.identity.gallery import name_problem
from facetrack_cli.tracking.start.checks import check_size, check_start
from facetrack_cli.tracking.start.haar import find_faces
from facetrack_cli.tracking.start.init_file import SUFFIXES as INIT_SUFFIXES
from facetrack_cli.tracking.start.init_file import default_path, find_init, read_init
from facetrack_cli.video import images
from facetrack_cli.video.source import open_source

PASSED_OVER: Final = frozenset((*INIT_SUFFIXES, ".csv", ".txt", ".md", ".npz"))  # what may lie beside images
Warn: TypeAlias = Callable[[str], None]
Look: TypeAlias = "tuple[Frame | None, Box | None]"  # what cannot be read, or shows no face, is None


class Item(NamedTuple):
    """An image of a person, or a clip: a video or a folder of its frames; with the init file beside it, if any."""

    path: Path
    is_image: bool
    init: Path | None

    def place(self, frame: Frame) -> str:
        """Where a frame of it is, for messages."""
        return str(self.path) if self.is_image else f"{self.path}: frame {frame.index}"


class Person(NamedTuple):
    """A person by the name of the folder, without spaces around it, and what is in it, in natural order."""

    name: str
    folder: Path
    items: tuple[Item, ...]


class Reading(NamedTuple):
    """How faces are taken: template (rows, columns); of each clip so many frames, evenly between `start` and `stop`."""

    shape: tuple[int, int] = (30, 26)
    frames: int = 15
    start: int = 0
    stop: int | None = None
    jitter: int = 0


def find_people(folder: Path, warn: Warn) -> list[Person]:
    """Everyone who has a folder in `folder`, in natural order. Raises InputError where it is no gallery."""
    entries = _entries(folder)
    folders = [one for one in entries if one.is_dir()]
    beside = [one for one in entries if not one.is_dir() and one.suffix.lower() not in PASSED_OVER]
    if not folders and beside:
        example = folder / "anna" / beside[0].name
        raise InputError(f"{folder}: has images but no folders; make one for each person, as in {example}")
    if not folders:
        raise InputError(f"{folder}: is empty; put a folder of images in it for each person")
    if beside:
        more = f" and {len(beside) - 1} more" if len(beside) > 1 else ""
        warn(f"{beside[0]}{more}: in no person's folder; passed over")
    people = [_person(one, warn) for one in folders]
    if len(people) < 2:
        raise InputError(f"{folder}: {people[0].name} is the only person in it; add another folder, to be told apart")
    known: dict[str, Person] = {}
    for one in people:
        other = known.setdefault(one.name.casefold(), one)
        both = f"{one.folder} and {other.folder}"
        if other is not one and other.name == one.name:
            raise InputError(f"{both}: are both called {one.name}; rename one, or put their images into one folder")
        if other is not one:
            warn(f"{both}: are two persons; if they are one, put their images into one folder")
    return people


def count(people: Sequence[Person], reading: Reading) -> int:
    """How many images and frames `read_faces` looks at, at most."""
    items = [item for person in people for item in person.items]
    return sum(1 if item.is_image or item.init is not None else reading.frames for item in items)


def _entries(folder: Path) -> list[Path]:
    """What is in a folder and not hidden, in natural order."""
    try:
        if not folder.is_dir():
            what = "is no folder" if folder.exists() else "no such folder"
            raise InputError(f"{folder}: {what}; name one that has a folder for each person")
        found = [one for one in folder.iterdir() if not one.name.startswith(".")]
    except OSError as e:
        raise InputError(f"{folder}: {reason(e)}; check the name and the permissions") from e
    return sorted(found, key=lambda one: images.natural_key(one.name))


def _person(folder: Path, warn: Warn) -> Person:
    # letters with marks may be written in two ways, which look alike
    name = unicodedata.normalize("NFC", folder.name).strip()
    if problem := name_problem(name):
        raise InputError(f"{printable(str(folder))}: {problem}; rename the folder")
    items = []
    for one in _entries(folder):
        suffix = one.suffix.lower()
        if one.is_dir() and not images.listing(one):
            warn(f"{one}: no images in this folder; skipped")
        elif one.is_dir() or suffix not in PASSED_OVER:
            items.append(Item(one, suffix in images.SUFFIXES and not one.is_dir(), find_init(one)))
    if not items:
        raise InputError(f"{folder}: no image or video in it; add one of {name}, or remove the folder")
    return Person(name, folder, tuple(items))


def faces_of(item: Item, reading: Reading, warn: Warn) -> Iterator[Look]:
    """The frames of an item, each with the box of its face."""
    start = None if item.init is None else _read_start(item, item.init, reading)
    if item.is_image:
        try:
            frame = Frame(0, 0.0, images.read(item.path))
        except images.UnreadableError as e:
            warn(f"{item.path}: {e.why}; skipped")
            yield None, None
            return
        yield frame, _in_image(item, frame, warn) if start is None else _given(start, frame)
    elif start is None:
        yield from _in_clip(item, reading, warn)
    else:
        try:
            with open_source(item.path, start=start.frame, stop=start.frame + 1) as source:
                for frame in source:
                    yield frame, _given(start, frame)
        except InputError as e:
            fits = str(e).startswith(start.origin)
            raise InputError(str(e) if fits else f"{start.origin}: does not fit: {e}") from None


def _in_image(item: Item, frame: Frame, warn: Warn) -> Box | None:
    found = find_faces(frame.bgr)
    if not found:
        warn(f"{item.path}: no face found; skipped, or give its box in {default_path(item.path)}")
        return None
    if len(found) > 1:
        box = ", ".join(f"{value:g}" for value in found[0])
        other = f"for another give its box in {default_path(item.path)}"
        warn(f"{item.path}: {len(found)} faces; the largest is taken, at [{box}], {other}")
    return found[0]


def _in_clip(item: Item, reading: Reading, warn: Warn) -> Iterator[Look]:
    looked, without = 0, []
    try:
        wanted = _spread(item.path, reading)
        with open_source(item.path, start=wanted[0], stop=wanted[-1] + 1) as source:
            for frame in source:
                if frame.index not in wanted:
                    continue
                found = find_faces(frame.bgr)
                looked += 1
                if not found:
                    without.append(frame.index)
                yield frame, found[0] if found else None
            for line in source.warnings:
                warn(line)
    except InputError as e:
        warn(f"{e}; skipped")
        yield None, None
    if without:
        frames = f"frame{'s' * (len(without) > 1)} {', '.join(map(str, without))}"
        warn(f"{item.path}: no face found in {len(without)} of {looked} frames looked at; skipped {frames}")


def _spread(path: Path, reading: Reading) -> list[int]:
    """At most `reading.frames` frames of a clip, in the middles of as many equal pieces."""
    with open_source(path, start=reading.start, stop=reading.stop) as source:
        length = max(source.frames_hint or sum(1 for _ in source), 1)  # some containers do not say
    number = min(reading.frames, length)
    return [reading.start + (2 * i + 1) * length // (2 * number) for i in range(number)]


def _read_start(item: Item, path: Path, reading: Reading) -> Start:
    """The one face of an init file, checked as far as it can be without the image."""
    start = read_init(path)
    if len(start.targets) > 1:
        has = f"has {len(start.targets)} targets, {', '.join(start.targets)}"
        raise InputError(f"{path}: {has}; leave the face of {item.path.parent.name} alone")
    [(name, target)] = start.targets.items()
    if target.box is None:
        raise InputError(f"{path}: has no box of {name}; add box: [left, top, width, height]")
    check_size(str(path), name, target.box)
    if item.is_image and start.frame:
        raise InputError(f"{path}: starts at frame {start.frame}, but {item.path.name} is an image; write frame: 0")
    end = math.inf if reading.stop is None else reading.stop
    if not item.is_image and not reading.start <= start.frame < end:
        used = f"{reading.start} to {'the end' if reading.stop is None else reading.stop - 1}"
        remedy = "choose one of these, or change --start and --stop"
        raise InputError(f"{path}: starts at frame {start.frame}, and only frames {used} are to be used; {remedy}")
    return replace(start, origin=str(path))


def _given(start: Start, frame: Frame) -> Box:
    check_start(start, frame.size, ())
    box = next(iter(start.targets.values())).box
    assert box is not None
    return box
