"""A face that was lost, found again: which face of a frame is the target (ours).

A detector sees faces anywhere in the frame. One that stays for half a second, alone or as the likeliest of several, is
the target unless its looks clearly say no. Looks are small grey pictures of the upright face, without mean and of unit
norm: one of the start, and others that were seen since. The correlation of two of one person is .77 in the median, and
of two people .10 (fourteen clips; .16 and .56 are the lowest and the highest twentieth).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple, TypeVar

import cv2
import numpy as np

from facetrack_cli.core.geometry import centre
from facetrack_cli.core.types import Array, Box, Frame
from facetrack_cli.tracking.face.stabilized import BOX, FACE, Similarity
from facetrack_cli.tracking.people.identity import same_person
from facetrack_cli.tracking.people.looks import Picture, together
from facetrack_cli.tracking.start.detectors import Found

STAYS: Final = 0.5  # seconds that a face is seen before it is the target
SAME: Final = 0.6  # sizes of a face within which it is the same one at the next look
NEW: Final = 0.6  # correlation with all looks below which another one is kept
OTHER: Final = 0.2  # below which a face is somebody else
KNOWN: Final = 2.0  # log odds that a face is the target, above which it is after a cut
MAX_LOOKS: Final = 6  # looks that are kept
SIDE: Final = 16  # pixels of a look
_T = TypeVar("_T")


class Sighting(NamedTuple):
    """A face that is seen while the target is lost: its box, its roll, and since when, in s."""

    box: Box
    roll: float
    since: float

    @classmethod
    def of(cls, face: Found, frame: Frame) -> Sighting:
        return cls(face.box, face.roll, frame.time_s)

    def similarity(self) -> Similarity:
        return Similarity(np.array(centre(self.box)), self.box[2] / FACE, self.roll)


def look_of(still: Frame) -> Array:
    """The look (SIDE^2,) of an upright face, from a stabilized image."""
    left, top, width, height = (round(value) for value in BOX)
    grey = cv2.cvtColor(still.bgr[top : top + height, left : left + width], cv2.COLOR_BGR2GRAY)
    small = cv2.resize(grey, (SIDE, SIDE), interpolation=cv2.INTER_AREA).astype(np.float64).ravel()
    small -= small.mean()
    return np.asarray(small / max(float(np.linalg.norm(small)), 1e-9))


def likeness(looks: tuple[Array, ...], look: Array) -> float:
    """The highest correlation of a look with the known looks."""
    return max(float(one @ look) for one in looks)


def kept(looks: tuple[_T, ...], look: _T) -> tuple[_T, ...]:
    """The last looks with a further one; that of the start stays."""
    return (*looks, look) if len(looks) < MAX_LOOKS else (looks[0], *looks[2:], look)


def recognised(known: Sequence[Picture], faces: Sequence[Similarity], frame: Frame, least: float = KNOWN) -> int | None:
    """Which of the faces, upright in stabilized images, is that of the `known` pictures; None if no face is."""
    if not faces:
        return None
    looks = [together(one.looks for one in known)]
    looks += [Picture.of(frame, face._replace(scale=face.scale * FACE)).looks for face in faces]
    odds = same_person(looks)[0, 1:]
    if looks[0].embedding.size:  # of few views both say more than the embedding alone
        odds = odds + same_person([one._replace(embedding=one.embedding[:, :0]) for one in looks])[0, 1:]
    return int(odds.argmax()) if odds.max() > least else None


def sighted(before: Sighting | None, faces: list[Found], frame: Frame, looks: tuple[Array, ...]) -> Sighting | None:
    """The likeliest face of a frame after the last sighting; None if each is somebody else."""
    found: list[tuple[float, Sighting]] = []
    for face in faces:
        one = Sighting.of(face, frame)
        like = likeness(looks, look_of(one.similarity().read(frame)))
        if like >= OTHER:
            found.append((like, one))
    if not found:
        return None
    best = max(found, key=lambda one: one[0])[1]
    if before is None:
        return best
    off = math.dist(centre(before.box), centre(best.box))
    return best._replace(since=before.since) if off < SAME * max(before.box[2], best.box[2]) else best
