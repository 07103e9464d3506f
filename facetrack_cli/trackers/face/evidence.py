"""Which face of a frame is the target: all that speaks for it and against it, added in one place (ours).

A detector sees faces anywhere in a frame, or the points are seen where the face is expected. That face k of K is the
target has the log odds

    prior + looks + place,      p_k = exp(odds_k) / (1 + sum_j exp(odds_j))

    prior       SHOT / K, after a cut CUT / K: a lone face is most likely the target; 0 where the clip has shown others
    looks       the face in grey, its colours and, with the extra `people`, dlib's embedding, against views of the
                target: `same_person` in people/descriptor.py, where each is bounded by how often it is wrong
    place       NEAR where the target was last seen, -AWAY elsewhere while it is held to be covered; 0 after a cut

A face that is seen in the place of a target that was not seen for a while may be of somebody who walks by. The log
odds that it is the target are AGAIN + looks, the mean of LOOKS_AGAIN looks at most. Light and what is around are those
of before, and grey views of a head that turns differ as much as those of two people, so the embedding alone looks, and
counts less where the face is small. If it speaks for somebody else, place says nothing any more, two looks must agree
that the target is back, and the prior grows from 0 by 1 a second up to SHOT, since who walks by does not stay. This
takes the extra `people`.

Where somebody has drawn the box, views are laid out as a detector has the face in them, so that they are alike, too. A
view that by its embedding is of somebody else does not count as one of the target.

No term has a veto: skin changes with the light, hair with a hat.
People change places over cuts, so the looks decide there, and hardly elsewhere. What looks like a cut and was a flash,
a whip pan, a hand across the lens or lost frames, is none as soon as the frames after it say so, or the face is seen.

Looks are small grey pictures of the upright face, without mean and of unit norm. They cost little, and say when the
face looks otherwise than in all views so far: then the view is kept.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Final, NamedTuple

import cv2
import numpy as np

from facetrack_cli.core.geometry import centre
from facetrack_cli.core.types import Array, Frame
from facetrack_cli.trackers.face.detectors import Detection
from facetrack_cli.trackers.face.stabilized import BOX, FACE, Similarity
from facetrack_cli.trackers.people.descriptor import (
    SENSES,
    FaceDescriptor,
    Picture,
    embedding_model,
    same_person,
    together,
)

SHOT, CUT = 5.0, 2.3  # log odds that the one face of a frame is the target, in one shot and after a cut
BOUND: Final = 4.0  # of the log odds by looks
AGAIN: Final = 2.0  # log odds that the face that is seen in a target's place after it was not seen is the target
SEEN_PX: Final = 100  # pixels of a face's box below which an embedding of one view tells less of who it is
WHO: Final = ("embedding",)  # senses that tell somebody who walks by from the target
NEAR: Final = 3.0  # log odds of a face where the target was
AWAY: Final = 2.0  # ... less, of a face elsewhere while the target is covered
STAYS: Final = 0.5  # seconds that a face is seen before it is the target, and after which a cut was one
KNOWN: Final = 1.5  # log odds by a look above which a face is the target at once
SURE: Final = 0.9  # probability below which it is said that the face may be another one
MAYBE: Final = 0.05  # probability below which a face is no sighting
SAME: Final = 0.6  # sizes of a face within which it is the same one at the next look
NEW: Final = 0.6  # correlation with all looks below which another one is kept
ALIKE: Final = 0.9  # correlation with a look from which a face in its place is the same without further looks
APART: Final = 0.2  # seconds between looks at a face in its place
LOOKS_AGAIN: Final = 3  # looks after which a face in its place is the same, if they do not say otherwise
MAX_LOOKS: Final = 6  # looks that are kept
SIDE: Final = 16  # pixels of a look


class View(NamedTuple):
    """How the target looks in a frame."""

    look: Array  # (SIDE^2,)
    picture: Picture
    sure: bool = False  # whether it is of nobody else, by `own_views`


class Sighting(NamedTuple):
    """A face that is seen while the target is lost."""

    face: Detection  # in the frame
    since: float  # time in s since which it is seen
    p: float = 0.0  # probability that it is the target
    by_looks: float = 0.0  # log odds of that by its looks alone, the mean of `views` looks
    latest: float = 0.0  # the same of the latest look; nan without the embedding, and then it is no view
    views: int = 1

    def after(self, before: Sighting | None) -> Sighting:
        """With what the sighting `before` tells, if it is of the same face: near it, and looks like it."""
        if before is None or abs(self.latest - before.latest) > BOUND:
            return self
        old, new = before.face.box, self.face.box
        if math.dist(centre(old), centre(new)) >= SAME * max(old[2], new[2]):
            return self
        views = before.views + self.views
        mean = before.by_looks + (self.by_looks - before.by_looks) * self.views / max(views, 1)
        return self._replace(since=before.since, by_looks=mean, views=views)

    def is_target(self, frame: Frame, views: int = 1) -> bool:
        """Whether it is followed from this frame on: if it looks so in that many views, else if it stays."""
        known = self.latest > KNOWN and self.views >= views
        return self.p > 0.5 and (known or frame.time_s - self.since >= STAYS)


def by_place(last: Similarity, faces: Sequence[Similarity], *, covered: bool) -> Array:
    """Log odds (K,) of faces of one shot by where they lie, of a target that was seen `last` and may be `covered`."""
    x, scale = np.array([face.centre for face in faces]).reshape(-1, 2), np.array([face.scale for face in faces])
    off = np.hypot(*(x - last.centre).T) / (FACE * last.scale)
    near = (off < 1) & (np.abs(np.log(scale / last.scale)) < math.log(1.6))
    return np.asarray(np.where(near, NEAR, -AWAY * covered))


def prior(*, cut: bool, company: bool, stranger_s: float | None = None) -> float:
    """The log odds that a lone face is the target.

    It may not have been seen since a `cut`, the clip may have shown `company`, several faces in one frame, and somebody
    else may be in its place, for `stranger_s` seconds.
    """
    if stranger_s is not None and not cut:
        return min(stranger_s, SHOT)
    return 0.0 if company else CUT if cut else SHOT


def probabilities(looks: Array, others: Array, alone: float) -> Array:
    """The probabilities (K,) that the faces of a frame are the target.

    `looks` and `others` (K,) are log odds by looks and by place, `alone` is the `prior` of a lone face.
    """
    odds = looks + others + alone / max(len(looks), 1)
    most = max(float(odds.max(initial=0.0)), 0.0)
    p = np.exp(odds - most)
    return np.asarray(p / (math.exp(-most) + p.sum()))


def by_looks(views: Sequence[View], faces: Sequence[Picture], senses: Collection[str] = SENSES) -> Array:
    """Bounded log odds (K,) that the person in the pictures of K faces is that of the `views`; 0 without views."""
    if not faces or not views:
        return np.zeros(len(faces))
    odds = nearest([view.picture.looks for view in views], [face.looks for face in faces], senses)
    return np.clip(odds, -BOUND, BOUND)


def nearest(views: Sequence[FaceDescriptor], faces: Sequence[FaceDescriptor], senses: Collection[str]) -> Array:
    """Log odds (K,) that K faces are the person of some views: each sense goes by the view that is nearest.

    The median colour of views in two lights, as it is taken of a track, may be that of somebody else.
    """
    odds, v = same_person([together(views), *faces], {*senses} - {"colour"})[0, 1:], len(views)
    if "colour" in senses:
        odds = odds + same_person([*views, *faces], ("colour",))[:v, v:].max(axis=0)
    return np.asarray(odds)


def bounds(views: Sequence[View], faces: Sequence[Picture]) -> Array:
    """(3, K): the least that `by_looks` may say, what all senses but the embedding say, and the most.

    The embedding takes a hundred times as long as they do.
    """
    if not faces or not views:
        return np.zeros((3, len(faces)))
    rest = nearest([view.picture.plain for view in views], [face.plain for face in faces], SENSES)
    _, against, most = SENSES["embedding"] if embedding_model() is not None else ((), 0.0, 0.0)
    return np.clip([rest - against, rest, rest + most], -BOUND, BOUND)


def is_likely(views: Sequence[View], face: Picture, others: float) -> bool:
    """Whether a face is the person of the `views`, by its looks and the log odds by all `others`.

    Of embeddings the nearest counts. That is likely of the view that is most alike in grey.
    """
    least, rest, most = bounds(views, [face])[:, 0] + others
    if (least > 0) == (most > 0):
        return bool(least > 0)
    alike = sorted(views, key=lambda view: -float(view.picture.plain.face[0] @ face.plain.face[0]))
    return any(rest + same_person([view.picture.looks, face.looks], WHO)[0, 1] > 0 for view in alike)


def sighted(
    faces: Sequence[Detection], shown: Sequence[Picture], views: Sequence[View], before: Sighting | None, frame: Frame
) -> list[Sighting]:
    """The sightings of a frame's faces, which pictures have `shown`, after that `before`; `p` comes later.

    The embedding looks where a face may be the target now; else the other senses say how likely each is so far.
    """
    _, rest, most = bounds(views, shown)
    each = [Sighting(face, frame.time_s, 1.0, by, math.nan, 0) for face, by in zip(faces, rest.tolist(), strict=True)]
    sightings = [one.after(before) for one in each]
    if embedding_model() is None or most.max() > KNOWN or any(one.is_target(frame) for one in sightings):
        by_all = zip(each, by_looks(views, shown).tolist(), strict=True)
        sightings = [one._replace(by_looks=by, latest=by, views=1).after(before) for one, by in by_all]
    return sightings


def weight_of(side: float) -> float:
    """How much the embedding of a face counts whose box has a `side` in pixels; 0 where it cannot outweigh AGAIN."""
    weight = min(side / SEEN_PX, 1.0)
    return weight if embedding_model() is not None and weight * BOUND > AGAIN else 0.0


def by_who(views: Sequence[View], face: Picture) -> float:
    """Log odds by the embedding that a face is the person of the `views`; less of a small face, 0 where none says."""
    weight = weight_of(face.side)
    return weight * float(by_looks(views, [face], WHO)[0]) if weight and views else 0.0


def own_views(views: Sequence[View]) -> tuple[View, ...]:
    """The views without those of somebody who walked by while nobody noticed: not the person of the sure views."""
    sure, own = [view for view in views if view.sure], list[View]()
    for view in views:
        odds = BOUND if view.sure else by_who(sure, view.picture)
        if odds + AGAIN > 0:
            own.append(view._replace(sure=odds > KNOWN))
            sure += [view] * (odds > KNOWN and not view.sure)
    return tuple(own)


def look_of(still: Frame) -> Array:
    """The look (SIDE^2,) of an upright face, from a stabilized image."""
    left, top, width, height = (round(value) for value in BOX)
    grey = cv2.cvtColor(still.bgr[top : top + height, left : left + width], cv2.COLOR_BGR2GRAY)
    small = cv2.resize(grey, (SIDE, SIDE), interpolation=cv2.INTER_AREA).astype(np.float64).ravel()
    small -= np.add.reduce(small) / len(small)
    return np.asarray(small / max(math.sqrt(small @ small), 1e-9))


def likeness(views: Sequence[View], look: Array) -> float:
    """The highest correlation of a look with the looks of the views; -1 without any."""
    return max((float(view.look @ look) for view in views), default=-1.0)


def kept(views: tuple[View, ...], view: View) -> tuple[View, ...]:
    """The last views with a further one; that of the start stays.

    Views are compared with those before them, as a face grows light by and by, before one of these goes.
    """
    if len(views) == MAX_LOOKS:
        views = own_views(views)
    return (*views, view) if len(views) < MAX_LOOKS else (views[0], *views[2:], view)
