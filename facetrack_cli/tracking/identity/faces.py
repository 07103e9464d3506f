"""Faces for a gallery: each is read as the tracker reads one that begins in the same box, with some cut off the mark.

Nothing is random: copies and counter-examples follow a fixed sequence that fills the range evenly, so that equal input
gives an equal gallery.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Array, Box, Frame
from facetrack_cli.tracking.identity.people import Person, Reading, count, faces_of, place
from facetrack_cli.tracking.models.patches import Patches
from facetrack_cli.tracking.models.spaces import affine_state_of_box

SHIFT, STRETCH, TURN = 0.03, 0.05, 3.0  # most of a copy: of the box's sides, of its size, degrees
NEGATIVES: Final = 6  # counter-examples that are cut around each face; more where faces are few
LEAST_NEGATIVES: Final = 240


@dataclass(frozen=True, slots=True)
class Faces:
    """What was read. d = rows * columns; every patch of zero mean and unit variance.

    `patches` (n, d) float32, of `persons` (n,) by name; of each of `pictures` (n,) first the face as it was found, then
    its copies, cut a little off. `negatives` (k, d) are cut so far off that no face is in its place. `used` and
    `skipped` are pictures and frames for each person, `proportion` is the median of the boxes' width over height.
    """

    patches: NDArray[np.float32]
    persons: tuple[str, ...]
    pictures: tuple[int, ...]
    negatives: NDArray[np.float32]
    used: dict[str, int]
    skipped: dict[str, int]
    proportion: float


def read_faces(
    people: Sequence[Person],
    reading: Reading,
    warn: Callable[[str], None],
    advance: Callable[[int], None] = lambda done: None,
) -> Faces:
    """The faces of all persons. What shows none is passed over, which `warn` is told.

    `advance` is called with the number of pictures and frames looked at so far. Raises InputError for an init file that
    cannot be meant, and for a person of whom nothing is left.
    """
    most = count(people, reading)
    faces = _Faces(reading, max(NEGATIVES, math.ceil(LEAST_NEGATIVES / most)))
    looked = 0
    for person in people:
        faces.begin(person.name)
        for item in person.items:
            for frame, box in faces_of(item, reading, warn):
                looked += 1
                advance(looked)
                if frame is None or box is None:
                    faces.skip()
                elif why := faces.add(frame, box, place(item, frame)):
                    warn(f"{place(item, frame)}: {why}; skipped")
        if not faces.used[person.name]:
            raise InputError(
                f"{person.folder}: no face of {person.name} was found; give its box in an init file beside a picture, "
                "add another picture, or remove the folder"
            )
    return faces.whole()


class _Faces:
    """Patches as they come in; of pictures nothing is kept."""

    def __init__(self, reading: Reading, negatives: int) -> None:
        self.used: Counter[str] = Counter()
        self.skipped: Counter[str] = Counter()
        self._reading = reading
        self._negatives = negatives
        self._name = ""
        self._persons: list[str] = []
        self._pictures: list[int] = []
        self._patches: list[NDArray[np.float32]] = []
        self._off: list[NDArray[np.float32]] = []
        self._proportions: list[float] = []
        self._seen: dict[bytes, tuple[str, str]] = {}

    def begin(self, name: str) -> None:
        self._name = name
        self.used[name] = self.skipped[name] = 0

    def skip(self) -> None:
        self.skipped[self._name] += 1

    def add(self, frame: Frame, box: Box, at: str) -> str:
        """Why the face in the box is not taken, if so; `at` says where it is."""
        number, copies = sum(self.used.values()), self._reading.jitter
        patches = Patches(size=(box[2], box[3]), shape=self._reading.shape)
        [x] = affine_state_of_box(*box)
        ways = near(number * copies, copies), off(number * self._negatives, self._negatives)
        every = np.concatenate([x[None], *(moved(x, box, way) for way in ways)])[:, None]
        read = patches.read(frame, every, patches.factor(every[0]))
        if not read[0].any():
            self.skip()
            return "nothing to see in the face's box"
        same = self._seen.setdefault(read[0].tobytes(), (self._name, at))
        if same != (self._name, at):
            self.skip()
            return f"the same face as {same[1]}" + ("" if same[0] == self._name else f", which is {same[0]}")
        faces, negatives = (part[part.any(axis=1)] for part in (read[: 1 + copies], read[1 + copies :]))
        self.used[self._name] += 1
        self._persons += [self._name] * len(faces)
        self._pictures += [number] * len(faces)
        self._patches.append(faces)
        self._off.append(negatives)
        self._proportions.append(box[2] / box[3])
        return ""

    def whole(self) -> Faces:
        middle = float(np.median(self._proportions))
        used, skipped = dict(self.used), dict(self.skipped)
        patches, negatives = np.concatenate(self._patches), np.concatenate(self._off)
        return Faces(patches, tuple(self._persons), tuple(self._pictures), negatives, used, skipped, middle)


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
