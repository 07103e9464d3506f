"""Faces for a gallery: each is read as the tracker reads one that begins in the same box.

Copies and counter-examples follow a fixed sequence that fills the range evenly: equal input gives an equal gallery.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Array, Box, Frame
from facetrack_cli.tracking.identity.people import Person, Reading, Warn, count, faces_of
from facetrack_cli.tracking.identity.subspaces import Rows
from facetrack_cli.tracking.models.patches import Patches
from facetrack_cli.tracking.models.spaces import affine_state_of_box

SHIFT, STRETCH, TURN = 0.03, 0.05, 3.0  # most of a copy: of the box's sides, of its size, degrees
NEGATIVES: Final = 6  # counter-examples that are cut around each face; more where faces are few
LEAST_NEGATIVES: Final = 240


class Faces(NamedTuple):
    """What was read: `patches` (n, d) of zero mean and unit variance, of `persons` (n,) by name.

    Of each of `images` (n,) first comes the face, then its copies, cut a little off; `negatives` (k, d) show no face in
    its place. `used` and `skipped` are images and frames for each person, `proportion` is the median of the boxes'
    width over height.
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
    around = max(NEGATIVES, math.ceil(LEAST_NEGATIVES / count(people, reading)))
    used, skipped = ({person.name: 0 for person in people} for _ in range(2))
    persons: list[str] = []
    images: list[int] = []
    found: list[tuple[Rows, Rows, float]] = []  # patches, negatives and proportion of each face
    seen: dict[bytes, tuple[str, str]] = {}
    looked = 0
    for person in people:
        for item in person.items:
            for frame, box in faces_of(item, reading, warn):
                looked += 1
                advance(looked)
                if frame is None or box is None:
                    skipped[person.name] += 1
                    continue
                number, at = len(found), item.place(frame)
                patches, negatives = _cut(frame, box, reading, number, around)
                name, where = seen.setdefault(patches[0].tobytes(), (person.name, at))
                why = "" if where == at else f"the same face as {where}"
                why += "" if name == person.name else f", which is {name}"
                why = why if patches[0].any() else "nothing to see in the face's box"
                (skipped if why else used)[person.name] += 1
                if why:
                    warn(f"{at}: {why}; skipped")
                    continue
                patches, negatives = (rows[rows.any(axis=1)] for rows in (patches, negatives))
                persons += [person.name] * len(patches)
                images += [number] * len(patches)
                found.append((patches, negatives, box[2] / box[3]))
        if not used[person.name]:
            remedy = "give its box in an init file beside an image, add another image, or remove the folder"
            raise InputError(f"{person.folder}: no face of {person.name} was found; {remedy}")
    all_patches, all_negatives, proportions = zip(*found, strict=True)
    every, off_mark = np.concatenate(all_patches), np.concatenate(all_negatives)
    return Faces(every, tuple(persons), tuple(images), off_mark, used, skipped, float(np.median(proportions)))


def _cut(frame: Frame, box: Box, reading: Reading, number: int, around: int) -> tuple[Rows, Rows]:
    """The patches of the face in the box and of its copies, and those of so many places `around` it."""
    patches, copies = Patches(size=(box[2], box[3]), shape=reading.shape), reading.jitter
    [x] = affine_state_of_box(*box)
    ways = near(number * copies, copies), off(number * around, around)
    every = np.concatenate([x[None], *(moved(x, box, way) for way in ways)])[:, None]
    read = patches.read(frame, every, patches.factor(every[0]))
    return read[: 1 + copies], read[1 + copies :]


def near(first: int, number: int) -> Array:
    """(number, 4) ways to draw a face's box a little off: right, down (box sides), log of size, turn (radians)."""
    u = 2.0 * _even(first, number) - 1.0
    return u * [SHIFT, SHIFT, math.log1p(STRETCH), math.radians(TURN)]


def off(first: int, number: int) -> Array:
    """(number, 4) as `near`, in which no face is in its place: half beside it, or too large, small, turned."""
    u = _even(first, number)
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


def _even(first: int, number: int) -> Array:
    """(number, 4) points in [0, 1) of a sequence that fills it evenly, however many are taken (Halton)."""
    return np.stack([_mirrored(first + 1 + np.arange(number), base) for base in (2, 3, 5, 7)], axis=1)


def _mirrored(n: NDArray[np.int64], base: int) -> Array:
    """The digits of n in a base, read backwards behind the point."""
    found, digit = np.zeros(len(n)), 1.0
    while n.any():
        digit /= base
        found += digit * (n % base)
        n = n // base
    return found
