"""Who is in a folder of folders, which face in each image is meant, and the faces for a gallery.

One folder for each person, with the person's name; in it images, videos, and folders of a video's frames. An init file
beside one says where the face is; of another image the largest face is taken, of another clip that of some frames.

A face is read as the tracker reads one that begins in the same box. Copies and counter-examples are drawn with fixed
seeds: equal input gives an equal gallery.
"""

import math
import unicodedata
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from facetrack_cli.core.errors import InputError, reading
from facetrack_cli.core.types import Array, Box, Frame, Start
from facetrack_cli.engine.spaces import check_size
from facetrack_cli.start.init_file import SUFFIXES as INIT_SUFFIXES
from facetrack_cli.start.init_file import check_start, default_path, find_init, read_init
from facetrack_cli.trackers.appearance.appearance import AffineSpace, Patches
from facetrack_cli.trackers.appearance.gallery import Rows, name_problem
from facetrack_cli.trackers.face.detectors import Haar
from facetrack_cli.video import images
from facetrack_cli.video.source import open_source

SHIFT, STRETCH, TURN = 0.03, 0.05, 3.0  # most of a copy: of the box's sides, of its size, degrees
NEGATIVES: Final = 6  # counter-examples that are cut around each face; more where faces are few
MIN_NEGATIVES: Final = 240
PASSED_OVER: Final = frozenset((*INIT_SUFFIXES, ".csv", ".txt", ".md", ".npz"))  # what may lie beside images
Warn: TypeAlias = Callable[[str], None]


class Person(NamedTuple):
    """A person: the name of the folder without spaces around it, its images and clips in natural order."""

    name: str
    folder: Path
    items: tuple[Path, ...]


class Reading(NamedTuple):
    """How faces are taken: template (rows, columns); of each clip so many frames, evenly between `start` and `stop`."""

    shape: tuple[int, int] = (30, 26)
    frames: int = 15
    start: int = 0
    stop: int | None = None
    jitter: int = 0


def find_people(folder: Path, warn: Warn) -> list[Person]:
    """Everyone who has a folder in `folder`, in natural order. Raises InputError where it is no gallery."""
    people, strays, by_name = list[Person](), list[Path](), dict[str, Path]()
    for entry in _entries(folder):
        if not entry.is_dir():
            strays += [entry] * (entry.suffix.lower() not in PASSED_OVER)
            continue
        person = _person(entry, warn)
        if (other := by_name.setdefault(person.name.casefold(), entry)) is not entry:
            remedy = "rename one, or put their images into one folder"
            raise InputError(f"{entry} and {other}: are both called {person.name}; {remedy}")
        people.append(person)
    if len(people) < 2:
        raise InputError(f"{folder}: has no folders of two people; make one for each of them, as {folder / 'anna'}")
    for stray in strays:
        warn(f"{stray}: in no person's folder; passed over")
    return people


def count(people: Sequence[Person], reading: Reading) -> int:
    """How many images and frames `read_faces` looks at, at most."""
    items = [item for person in people for item in person.items]
    return sum(1 if _is_image(item) or find_init(item) else reading.frames for item in items)


def _entries(folder: Path) -> list[Path]:
    """What is in a folder and not hidden, in natural order."""
    with reading(folder, "name one that has a folder for each person"):
        entries = [entry for entry in folder.iterdir() if not entry.name.startswith(".")]
    return sorted(entries, key=lambda entry: images.natural_key(entry.name))


def _is_image(item: Path) -> bool:
    return item.suffix.lower() in images.SUFFIXES and not item.is_dir()


def _person(folder: Path, warn: Warn) -> Person:
    # letters with marks may be written in two ways, which look alike
    name = unicodedata.normalize("NFC", folder.name).strip()
    if problem := name_problem(name):
        raise InputError(f"{folder}: {problem}; rename the folder")
    items = []
    for entry in _entries(folder):
        if entry.is_dir() and not images.listing(entry):
            warn(f"{entry}: no images in this folder; skipped")
        elif entry.is_dir() or entry.suffix.lower() not in PASSED_OVER:
            items.append(entry)
    if not items:
        raise InputError(f"{folder}: no image or video in it; add one of {name}, or remove the folder")
    return Person(name, folder, tuple(items))


def faces_of(item: Path, reading: Reading, warn: Warn) -> Iterator[tuple[str, Frame | None, Box | None]]:
    """The frames of an image or a clip, each with its place for messages and the box of its face.

    What cannot be read, or shows no face, is None, after a warning.
    """
    alone, init = _is_image(item), find_init(item)
    start = None if init is None else _read_start(item, init, reading)
    lacks = f"no face found; skipped, or give its box in {default_path(item)}"
    try:
        wanted = [start.frame] if start else [0] if alone else _spread(item, reading)
        with open_source(item, start=wanted[0], stop=wanted[-1] + 1) as source:
            for frame in source:
                if frame.index not in wanted:
                    continue
                at = str(item) if alone else f"{item}: frame {frame.index}"
                if start is None:
                    boxes: Sequence[Box | None] = [face.box for face in Haar().find(frame)] or [None]
                else:
                    check_start(start, frame.size, ())
                    boxes = [target.box for target in start.targets.values()]
                if boxes[0] is None:
                    warn(f"{at}: {lacks}")
                elif alone and len(boxes) > 1:
                    box = ", ".join(f"{value:g}" for value in boxes[0])
                    other = f"for another give its box in {default_path(item)}"
                    warn(f"{item}: {len(boxes)} faces; the largest is taken, at [{box}], {other}")
                yield at, frame, boxes[0]
            for line in source.warnings:
                warn(line)
    except InputError as e:
        if start is not None:
            raise
        warn(f"{e}; skipped")
        yield str(item), None, None


def _spread(path: Path, reading: Reading) -> list[int]:
    """At most `reading.frames` frames of a clip, in the middles of as many equal pieces."""
    with open_source(path, start=reading.start, stop=reading.stop) as source:
        length = max(source.frames_hint or sum(1 for _ in source), 1)  # some containers do not say
    number = min(reading.frames, length)
    return [reading.start + (2 * i + 1) * length // (2 * number) for i in range(number)]


def _read_start(item: Path, init: Path, reading: Reading) -> Start:
    """The init file of a single box, with the checks that need no image."""
    start = read_init(init)
    [(name, target), *others] = start.targets.items()
    if others or target.box is None:
        raise InputError(f"{init}: is not of one box; leave the face of {item.parent.name} alone, with its box")
    check_size(str(init), name, target.box)
    first, stop = (0, 1) if _is_image(item) else (reading.start, reading.stop)
    if start.frame < first or (stop is not None and start.frame >= stop):
        remedy = "choose one that is used, which is 0 of an image, or change --start and --stop"
        raise InputError(f"{init}: starts at frame {start.frame}, which is not used; {remedy}")
    return start


class Faces(NamedTuple):
    """What was read: `patches` (n, d) of zero mean and unit variance, of `persons` (n,) by name.

    Of each of `images` (n,) first comes the face, then its copies; `negatives` (k, d) show no face in its place. `used`
    and `skipped` count images and frames of each person, `proportion` is the median of the boxes' width over height.
    """

    patches: Rows
    persons: tuple[str, ...]
    images: tuple[int, ...]
    negatives: Rows
    used: dict[str, int]
    skipped: dict[str, int]
    proportion: float


def read_faces(
    people: Sequence[Person], reading: Reading, warn: Warn, advance: Callable[[int], None] = lambda done: None
) -> Faces:
    """The faces of all persons; what shows none is skipped with a warning.

    `advance` is called with the number of images and frames looked at so far. Raises InputError for an init file that
    does not fit, and for a person of whom nothing is left.
    """
    around = max(NEGATIVES, math.ceil(MIN_NEGATIVES / count(people, reading)))
    used, skipped = ({person.name: 0 for person in people} for _ in range(2))
    persons: list[str] = []
    numbers: list[int] = []
    faces: list[tuple[Rows, Rows, float]] = []  # patches, negatives and proportion of each face
    seen: dict[bytes, str] = {}
    looks = ((owner.name, *look) for owner in people for item in owner.items for look in faces_of(item, reading, warn))
    for looked, (name, at, frame, box) in enumerate(looks, 1):
        advance(looked)
        skipped[name] += 1
        if frame is None or box is None:
            continue
        patches, negatives = _cut(frame, box, reading, len(faces), around)
        mine = f"{at}, which is {name}"
        where = seen.setdefault(patches[0].tobytes(), mine)
        if where is not mine or not patches[0].any():
            why = f"the same face as {where}" if patches[0].any() else "nothing to see in the face's box"
            warn(f"{at}: {why}; skipped")
            continue
        skipped[name] -= 1
        used[name] += 1
        patches, negatives = (rows[rows.any(axis=1)] for rows in (patches, negatives))
        persons += [name] * len(patches)
        numbers += [len(faces)] * len(patches)
        faces.append((patches, negatives, box[2] / box[3]))
    for person in people:
        if not used[person.name]:
            remedy = "give its box in an init file beside an image, add another image, or remove the folder"
            raise InputError(f"{person.folder}: no face of {person.name} was found; {remedy}")
    all_patches, all_negatives, proportions = zip(*faces, strict=True)
    every, off_mark = np.concatenate(all_patches), np.concatenate(all_negatives)
    return Faces(every, tuple(persons), tuple(numbers), off_mark, used, skipped, float(np.median(proportions)))


def _cut(frame: Frame, box: Box, reading: Reading, number: int, around: int) -> tuple[Rows, Rows]:
    """Patches of the face in the box and of its copies, and patches of `around` places beside it."""
    patches, copies = Patches(size=(box[2], box[3]), shape=reading.shape), reading.jitter
    [x] = AffineSpace(box[2:]).at(box)
    ways = near(number * copies, copies), off(number * around, around)
    every = np.concatenate([x[None], *(moved(x, box, way) for way in ways)])[:, None]
    read = patches.read(frame, every, patches.factor(every[0]))
    return read[: 1 + copies], read[1 + copies :]


def near(first: int, number: int) -> Array:
    """(number, 4) ways to draw a face's box a little off: right, down (box sides), log of size, turn (radians)."""
    u = np.random.default_rng(first).uniform(-1.0, 1.0, (number, 4))
    return u * [SHIFT, SHIFT, math.log1p(STRETCH), math.radians(TURN)]


def off(first: int, number: int) -> Array:
    """(number, 4) as `near`, in which no face is in its place: half beside it, or too large, small, turned."""
    u = np.random.default_rng(first).random((number, 4))
    kind = (first + np.arange(number)) % NEGATIVES
    side, far = 2.0 * np.pi * u[:, 0], 0.2 + 0.5 * u[:, 1]
    ways = np.stack([far * np.cos(side), far * np.sin(side), 0.4 * (u[:, 2] - 0.5), 0.5 * (u[:, 3] - 0.5)], axis=1)
    at_place = 0.1 * (2.0 * u[:, :2] - 1.0)
    turn = np.where(u[:, 3] < 0.5, -1.0, 1.0) * np.radians(30.0 + 150.0 * np.abs(2.0 * u[:, 3] - 1.0))
    for number_of_kind, size in ((3, 0.4 + 0.5 * u[:, 2]), (4, -0.4 - 0.6 * u[:, 2]), (5, 0.2 * (u[:, 2] - 0.5))):
        these = kind == number_of_kind
        ways[these, :2], ways[these, 2] = at_place[these], size[these]
        ways[these, 3] = turn[these] if number_of_kind == 5 else 0.2 * (u[these, 3] - 0.5)
    return ways


def moved(x: Array, box: Box, ways: Array) -> Array:
    """States (n, 6) of the face at x (6,), which fills the box, after each of the `ways` (n, 4)."""
    size, turn = np.exp(ways[:, 2]), ways[:, 3]
    cos, sin = size * np.cos(turn), size * np.sin(turn)
    return np.stack([x[0] + ways[:, 0] * box[2], x[1] + ways[:, 1] * box[3], cos, -sin, sin, cos], axis=1)
