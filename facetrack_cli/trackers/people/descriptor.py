"""Who is who in a film (ours): what each face looks like in a few frames of its track, and whose track it is.

Of a track the frames are taken in which the tracker is surest, spread over its length. Always there: the upright face
in grey, its skin and hair by colour, and what is worn below the chin. With the extra `people`, dlib's embedding of the
face as well: the ResNet of D. King, "High Quality Face Recognition with Deep Metric Learning" (2017), 128 numbers.

Two tracks are of one person with log odds that are the sum of what three senses say: the face in grey, dlib's embedding
of it where that is there, and the colours of skin, hair and clothes. Each is a logistic regression on pairs of tracks,
and says no more than it is right about people left out. Tracks that are seen at the same time are of two people. Where
one begins in the place where another has ended, in one shot or over a cut, that speaks for one person.

Clusters of tracks are joined while the mean log odds between them favour it, the likeliest first, whatever the order of
time. Then each track has a posterior over the people of the film and "somebody new", and what is not clear is a doubt.
This is recognition of an open set, without a gallery: Zhou et al. (2003) recognise one of a gallery while they track.
"""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from importlib import util
from pathlib import Path
from threading import Lock
from typing import Any, Final, NamedTuple

import cv2
import numpy as np

from facetrack_cli.core.geometry import share_inside, shown_angle
from facetrack_cli.core.npz import Kind, Stored
from facetrack_cli.core.types import Array, Box, Frame, Image, Mask, Whole, checked_name
from facetrack_cli.trackers.face.detectors import Detector, packaged
from facetrack_cli.trackers.face.stabilized import BOX, FACE, Similarity
from facetrack_cli.trajectory.trajectory import Trajectory

VIEWS: Final = 8  # frames of a track that are looked at
AS_GOOD: Final = 0.5  # of the best view's worth, what another view that counts has at least
SHARED: Final = 2  # views one after another of which dlib's network sees the best, so that what it sees is spread
CHIP_PX: Final = 150  # sides of the face that dlib's network sees
CHIP_SIDES: Final = 1.1  # sides of the face's box that it shows
FACE_PX: Final = 24  # sides of the face in grey
WIDE_PX, WIDE_SIDES = 96, 3.0  # sides of the image of head and shoulders, and of the face's box that it shows
STILL_SIDES: Final = 2.2  # of the face's box in the picture of a person
STILL_PX: Final = 240
KNOWN_PEOPLE: Final = Kind("facetrack-people", 1, "file of known people", "facetrack people RUN --save FILE")
MODEL: Final = "dlib_face_recognition_resnet_model_v1.dat"
_one_at_a_time: Final = Lock()  # for dlib's network
_SKIN, _HAIR, _WORN = np.s_[48:54, 40:56], np.s_[24:30, 38:58], np.s_[75:94, 19:77]  # where they are in that image
_BINS: Final = 6  # of each colour of what is worn
_SHARP: Final = (0.09, 0.17)  # shares of fine details of a face that cannot be told from others, and of one that can
_SCORE: Final = (0.75, 0.9)  # the same of the detector's score
FACE_SCORE: Final = 0.65  # mean of the detector's score over the better half of the views of a face, at least


class FaceDescriptor(NamedTuple):
    """What M views of a face show."""

    face: Array  # (M, 576), grey without mean and of unit norm
    skin: Array  # (M, 3), in Lab
    hair: Array  # (M, 3)
    worn: Array  # (M, 36), a histogram of colours
    embedding: Array  # (M, 128), or (M, 0) without dlib
    worth: Array  # (M, 1), how much of a face can be told from it, 0..1


@dataclass(frozen=True, eq=False)
class Picture:
    """A face in one frame."""

    chip: Image  # (CHIP_PX, CHIP_PX, 3), upright
    wide: Image  # (WIDE_PX, WIDE_PX, 3), with what is around it
    side: float  # of its box in the frame, in pixels

    @classmethod
    def of(cls, frame: Frame, face: Similarity) -> "Picture":
        """The scale of `face` is the side of its box in pixels."""
        around = _upright(frame, face._replace(angle=0.0), WIDE_SIDES, WIDE_PX)
        return cls(_upright(frame, face, CHIP_SIDES, CHIP_PX), around, face.scale)

    @cached_property
    def plain(self) -> FaceDescriptor:
        """Of this one view, without dlib's embedding, which takes a hundred times as long as all else."""
        each = _face(self.chip), *_colours(self.wide), np.zeros(0), np.array([_sharp(self.chip)])
        return FaceDescriptor(*(one[None] for one in each))

    @cached_property
    def looks(self) -> FaceDescriptor:
        """Of this one view."""
        return self.plain._replace(embedding=embedded(self.chip)[None])


def together(looks: Iterable[FaceDescriptor]) -> FaceDescriptor:
    """The looks of all views."""
    return FaceDescriptor(*map(np.concatenate, zip(*looks, strict=True)))


def save_people(path: Path, people: Mapping[str, FaceDescriptor]) -> None:
    """Write the looks of people by name. Raises OutputError."""
    which = np.repeat(np.arange(len(people)), [len(one.face) for one in people.values()])
    arrays = {"names": np.array(list(people)), "which": which.astype("<i8")}
    KNOWN_PEOPLE.write(path, {**arrays, **together(people.values())._asdict()})


def load_people(path: Path) -> dict[str, FaceDescriptor]:
    """The people that `save_people` wrote. Raises InputError for anything else."""
    return KNOWN_PEOPLE.read(path, _people)


def _people(stored: Stored) -> dict[str, FaceDescriptor]:
    names, which = stored.texts("names"), np.array(stored.whole("which"))
    every = FaceDescriptor._make(stored.reals(name, 2) for name in FaceDescriptor._fields)
    sizes = {len(values) for values in every} | {len(which)}
    if len(sizes) > 1 or set(which.tolist()) != set(range(len(names))) or len(set(names)) < len(names):
        raise ValueError("its arrays do not belong together")
    if [one.shape[1] for one in every[:4]] != [FACE_PX**2, 3, 3, _BINS**2] or every.embedding.shape[1] not in (0, 128):
        raise ValueError("its faces have another size than this facetrack reads")
    each = (FaceDescriptor(*(values[which == k] for values in every)) for k in range(len(names)))
    return dict(zip(map(checked_name, names), each, strict=True))


class View(NamedTuple):
    """A frame in which a track is to be looked at: where its face is, and how good the view is."""

    frame: int
    face: Similarity
    quality: float


def views_of(box: Trajectory) -> list[View]:
    """The frames in which to look at a track, of the rows of its box."""
    good = np.flatnonzero(~box.unseen & np.isfinite(box.x))
    if not len(good):
        return []
    sure = np.where(np.isnan(box.confidence[good]), 1.0, box.confidence[good])
    size = np.clip(box.w[good] / CHIP_PX, 0.1, 1.0)
    worth, angles = sure * np.sqrt(size), shown_angle(box.angle, 1 / box.pixel_aspect)
    found = []
    for part in np.array_split(np.arange(len(good)), min(VIEWS, len(good))):
        k = int(part[np.argmax(worth[part])])
        i = int(good[k])
        turn = math.radians(float(angles[i])) if np.isfinite(angles[i]) else 0.0
        face = Similarity(np.array([box.x[i], box.y[i]]), float(box.w[i]), turn)
        found.append(View(int(box.frame[i]), face, float(worth[k])))
    return found


class Describer:
    """Looks at views of one track, in the order of their frames."""

    def __init__(self, detector: Detector) -> None:
        self._detector = detector
        self.scores: list[float] = []  # of the detector, in each view; 0 where it sees no face
        self._seen: list[FaceDescriptor] = []  # without embeddings
        self._pictures: list[Picture] = []
        self._places: list[Image] = []
        self._first: Similarity | None = None
        self.best: tuple[float, Image] | None = None  # the best still

    def see(self, frame: Frame, view: View) -> None:
        """Take in the view of a frame."""
        picture = Picture.of(frame, view.face)
        upright = view.face._replace(scale=view.face.scale / FACE).read(frame)
        found, looks = self._detector.measure(upright.bgr, BOX), picture.plain
        self.scores.append(0.0 if found is None else found.score)
        self._seen.append(looks._replace(worth=looks.worth * np.interp(self.scores[-1], _SCORE, (0.0, 1.0))))
        self._pictures.append(picture)
        self._first = self._first or view.face
        place = cv2.cvtColor(_upright(frame, self._first, 1.0, FACE_PX), cv2.COLOR_BGR2GRAY)
        self._places.append(np.asarray(place, np.uint8))
        edges = cv2.Laplacian(cv2.cvtColor(picture.chip, cv2.COLOR_BGR2GRAY), cv2.CV_32F)
        (x, y), half = view.face.centre, STILL_SIDES * view.face.scale / 2
        shown = share_inside((x - half, y - half, 2 * half, 2 * half), frame.size)
        sharp = view.quality * float(np.log1p(edges.var())) * shown**2
        if self.best is None or sharp > self.best[0]:
            self.best = sharp, still(frame, view.face)

    def looks(self, most: int = VIEWS) -> FaceDescriptor:
        """What was seen; ValueError if that is nothing. dlib's network sees the `most` best views at most.

        Views without an embedding have that of the nearest view.
        """
        seen = together(self._seen)
        worth = seen.worth[:, 0]
        better = (k + int(worth[k : k + SHARED].argmax()) for k in range(0, len(worth), SHARED))
        good = [k for k in better if worth[k] >= AS_GOOD * worth.max()]
        best = sorted(sorted(good, key=lambda k: -worth[k])[:most])
        nearest = np.abs(np.subtract.outer(np.arange(len(worth)), best)).argmin(axis=1)
        return seen._replace(embedding=np.concatenate([self._pictures[k].looks.embedding for k in best])[nearest])

    @property
    def is_face(self) -> bool:
        """Whether it is one over its track: in the better half of the views; a fist looks like a face now and then."""
        return float(np.mean(sorted(self.scores)[len(self.scores) // 2 :])) >= FACE_SCORE

    def change(self) -> float:
        """Grey levels by which the face changes in its place between two views at most."""
        places = np.array(self._places, np.float64)
        off = np.abs(places - places[0] - np.median(places - places[0], axis=(1, 2), keepdims=True))
        return float(off.mean(axis=(1, 2)).max())


def still(frame: Frame, face: Similarity) -> Image:
    """The picture (STILL_PX, STILL_PX, 3) of a person; the scale of `face` is the side of its box in pixels."""
    return _upright(frame, face._replace(angle=0.0), STILL_SIDES, STILL_PX)


def _upright(frame: Frame, face: Similarity, sides: float, side: int) -> Image:
    """The image (side, side, 3) of so many sides of a face's box; the scale of `face` is the box's side in pixels."""
    return face._replace(scale=sides * face.scale / side).read(frame, side).bgr


def _sharp(chip: Image) -> float:
    """How sharp an upright face is, 0..1: the share of its contrast that is in the finest details but one."""
    grey = cv2.cvtColor(chip, cv2.COLOR_BGR2GRAY).astype(np.float32)
    fine, coarse, flat = (cv2.GaussianBlur(grey, (0, 0), sigma) for sigma in (2.4, 3.84, 12.0))
    share = float((fine - coarse).std()) / max(float((grey - flat).std()), 1e-3)
    return float(np.interp(share, _SHARP, (0.0, 1.0)))


def _face(chip: Image) -> Array:
    grey = cv2.cvtColor(chip, cv2.COLOR_BGR2GRAY)
    small = cv2.resize(grey, (FACE_PX, FACE_PX), interpolation=cv2.INTER_AREA).astype(np.float64)
    small -= cv2.GaussianBlur(small, (0, 0), FACE_PX / 3)  # light from one side
    small = (small - small.mean()).ravel()
    return np.asarray(small / max(float(np.linalg.norm(small)), 1e-9))


def _colours(wide: Image) -> list[Array]:
    """Skin between eyes and mouth, hair above the brows, and what is worn below the chin, of a head upright."""
    lab = cv2.cvtColor(wide, cv2.COLOR_BGR2LAB).astype(np.float64)
    skin, hair = (np.median(lab[part].reshape(-1, 3), axis=0) for part in (_SKIN, _HAIR))
    chroma, _ = np.histogramdd(lab[_WORN].reshape(-1, 3)[:, 1:], bins=_BINS, range=((100, 160), (100, 160)))
    return [skin, hair, (chroma / max(chroma.sum(), 1)).ravel()]


@cache
def embedding_model() -> Path | None:
    """The file of dlib's network; None without the extra `people`."""
    return packaged("face_recognition_models", "models", MODEL) if util.find_spec("dlib") else None


@cache
def _network(model: Path) -> Any:
    import dlib  # type: ignore[import-untyped, import-not-found, unused-ignore]

    return dlib.face_recognition_model_v1(str(model))


def embedded(chip: Image) -> Array:
    """dlib's embedding (128,) of an upright face (150, 150, 3); (0,) without the extra `people`."""
    model = embedding_model()
    if model is None:
        return np.zeros(0)
    with _one_at_a_time:
        return np.asarray(_network(model).compute_face_descriptor(np.ascontiguousarray(chip[:, :, ::-1])))


# --- who each track is of

SURE: Final = 0.9  # probability of a person below which a track is a doubt
_BOUND: Final = 8.0  # of the log odds that one pair of tracks gives
_NEAREST: Final = VIEWS * VIEWS // 8  # of the distances between the views of two tracks
# by tools/same_person.py: weights of what `distances` gives, the most that it says against one person, and for one
SENSES: Final = {
    "face": ((14.84, -1.12, -14.23), 3.1, 3.9),
    "embedding": ((37.09, -6.67, -59.58), 4.2, 4.4),
    "colour": ((-1.06, 19.55, -6.99, 2.56, 2.89), 2.6, 3.2),
}
_LAB: Final = np.array([0.4, 1.0, 1.0])  # brightness changes with the light
_NEAR: Final = (3.0, 10.0, 10.0, 0.3)  # scales: of skin, twice, and hair, all in Lab, and of clothes
_SAME_PLACE: Final = 3.0  # log odds of a track that begins where another one of its shot has ended
_GOES_ON: Final = 1.0  # the same over a cut
_IN_PLACE, _AS_LARGE = 0.25, 0.2  # sides of the box by which it has moved then, and its growth, at most
AT_ONCE_S: Final = 0.5
LEAST: Final = 0.15  # worth of a track below which its face cannot be told again
UNKNOWN: Final = -1
_NEW: Final = 0.0  # log odds of somebody new, of which nothing is known


class TrackSummary(NamedTuple):
    """A track: its name, the frames [first, stop) in which it is, its first and its last box, its shot, its looks."""

    name: str
    first: int
    stop: int
    begins: Box
    ends: Box
    shot: int
    looks: FaceDescriptor


class Doubt(NamedTuple):
    """A track that may be of another person (None: of somebody new) with probability `p`."""

    track: int
    other: int | None
    p: float


class Cast(NamedTuple):
    """The person (T,) of each track with its probability `p` (T,); what is in doubt.

    The first numbers are of the `known` people, in their order; others are counted by first appearance. A track that
    shows no face that could be told again is UNKNOWN.
    """

    person: Whole
    p: Array
    doubts: tuple[Doubt, ...]


def cast_of(tracks: Sequence[TrackSummary], known: Sequence[FaceDescriptor] = (), fps: float = 25.0) -> Cast:
    """Who each track is of, of `known` people and others; of a film of `fps` frames per second.

    A track of which no face can be told again is of the person in whose place it goes on, or of nobody (UNKNOWN).
    """
    if not tracks:
        return Cast(np.zeros(0, np.int64), np.zeros(0), ())
    k, every = len(known), [*known, *(one.looks for one in tracks)]
    senses = _senses(every)
    follows, goes_on = (np.pad(one, (k, 0)) for one in places(tracks, fps))
    odds = senses.sum(axis=0)
    rest = odds - np.minimum(senses.min(axis=0), 0)  # without the sense that speaks against it most
    if len(senses) > 2:  # one of three alone does not part what is in one place
        odds = np.where((follows | goes_on) & (rest > 0), rest, odds)
    odds = np.clip(odds + _SAME_PLACE * follows + _GOES_ON * goes_on, -_BOUND, _BOUND)
    first, stop = (np.array([getattr(one, key) for one in tracks]) for key in ("first", "stop"))
    apart = np.pad((first[:, None] < stop) & (first < stop[:, None]) & ~np.eye(len(tracks), dtype=bool), (k, 0))
    apart[:k, :k] = ~np.eye(k, dtype=bool)
    nobody = np.array([i >= k and worth_of(one) < LEAST for i, one in enumerate(every)])
    nothing = (nobody[:, None] | nobody) & ~(follows | goes_on)
    label = np.unique(clusters(odds, apart | nothing), return_inverse=True)[1]  # counted as they come
    own, other, p_other = _judged(label, odds, apart)
    shown = np.bincount(label, ~nobody) > 0
    person = np.where(shown, np.cumsum(shown) - 1, UNKNOWN)  # of each cluster, where a face of it can be told again
    names = [None if number == UNKNOWN else number for number in person.tolist()] + [None]
    doubts = [Doubt(i - k, names[other[i]], float(p_other[i])) for i in np.flatnonzero(own < SURE).tolist() if i >= k]
    return Cast(person[label[k:]], own[k:], tuple(doubts))


def same_person(looks: Sequence[FaceDescriptor], senses: Collection[str] = SENSES) -> Array:
    """(T, T) log odds, bounded, that two tracks show one person, by what some of the SENSES see in them."""
    return np.asarray(_senses(looks, senses).sum(axis=0))


def _best(looks: FaceDescriptor) -> Whole:
    """The views (VIEWS,) that are worth most; few stand for more."""
    worth = looks.worth[:, 0]
    return np.resize(np.flatnonzero(worth >= AS_GOOD * worth.max()), VIEWS)


def worth_of(looks: FaceDescriptor) -> float:
    """How much of a face the best views of a track show, 0..1."""
    return float(np.mean(looks.worth[_best(looks)]))


def _senses(looks: Sequence[FaceDescriptor], senses: Collection[str] = SENSES) -> Array:
    """(S, T, T) the log odds by each sense."""
    each = [(*SENSES[name], far) for name, far in distances(looks, senses).items()]
    return np.array([np.clip(np.tensordot(by, far, 1), -against, most) for by, against, most, far in each])


def distances(looks: Sequence[FaceDescriptor], senses: Collection[str] = SENSES) -> dict[str, Array]:
    """(D, T, T) what some SENSES weigh of each pair of tracks: its worth, and that times its worth and its distance.

    A face that is blurred, small, covered or turned away says less, whatever it looks like; its colours say as much.
    Colours that are far apart say little: the light may be another one, and so may the clothes.
    """
    best, found = [FaceDescriptor(*(values[_best(one)] for values in one)) for one in looks], dict[str, Array]()
    worth = np.array([one.worth.mean() for one in best])
    worth = np.minimum(worth[:, None], worth)
    for key in ("face", "embedding"):  # known people may have been saved without
        if key in senses and all(getattr(one, key).shape[1] for one in looks):
            x = np.concatenate([getattr(one, key) for one in best])
            found[key] = worth * np.array([np.ones_like(worth), worth, _nearest(x)])
    if "colour" not in senses:
        return found
    skin, hair, worn = (
        np.array([np.median(getattr(one, key), axis=0) for one in best]) for key in ("skin", "hair", "worn")
    )
    clothes = [0.5 * np.sum((worn - one) ** 2 / (worn + one + 1e-9), axis=1) for one in worn]
    far = np.array([_far(skin), _far(skin), _far(hair), clothes]) / np.reshape(_NEAR, (4, 1, 1))
    return found | {"colour": np.array([np.ones_like(worth), *np.exp(-far)])}


def _far(colours: Array) -> Array:
    """(T, T) distances of colours (T, 3) in Lab."""
    return np.asarray(np.linalg.norm((colours[:, None] - colours) * _LAB, axis=2))


def _nearest(x: Array) -> Array:
    """(T, T): the mean of the smallest eighth of the distances between views x (T * VIEWS, D) of two tracks."""
    t, squared = len(x) // VIEWS, np.sum(x**2, axis=1)
    found = np.empty((t, t))
    for i in range(t):
        rows = slice(i * VIEWS, (i + 1) * VIEWS)
        each = np.sqrt(np.maximum(squared[rows, None] + squared - 2 * x[rows] @ x.T, 0))
        each = each.reshape(VIEWS, t, VIEWS).transpose(1, 0, 2).reshape(t, -1)
        found[i] = np.partition(each, _NEAREST - 1, axis=1)[:, :_NEAREST].mean(axis=1)
    return 0.5 * (found + found.T)


def places(tracks: Sequence[TrackSummary], fps: float) -> tuple[Mask, Mask]:
    """(T, T) pairs of tracks of which one begins in the place where the other has ended: in one shot, or over a cut.

    Over a cut it begins within half a second, as large as it was.
    """
    shot, first, stop = (np.array([getattr(one, key) for one in tracks]) for key in ("shot", "first", "stop"))
    begins, ends = (np.array([getattr(one, key) for one in tracks]).reshape(-1, 4) for key in ("begins", "ends"))
    side, other = ends[:, None, 2], begins[:, 2]
    off = np.hypot(*(ends[:, None, :2] - begins[:, :2]).transpose(2, 0, 1)) / np.maximum(side, other)
    wait, alike = first - stop[:, None], np.abs(np.log(side / other)) < _AS_LARGE
    within = (off < 0.7) & (wait >= 0) & (shot[:, None] == shot)
    over = (off < _IN_PLACE) & alike & (wait >= 0) & (wait <= AT_ONCE_S * fps) & (shot[:, None] != shot)
    return np.asarray(within | within.T), np.asarray(over | over.T)


def clusters(odds: Array, apart: Mask) -> Whole:
    """(T,) the first track of each track's cluster: average linkage of log odds (T, T), joined while they are above 0.

    Clusters that hold two tracks that are `apart` (T, T) are never joined.
    """
    mean = np.where(apart, -np.inf, odds)
    np.fill_diagonal(mean, -np.inf)
    label, size = np.arange(len(odds)), np.ones(len(odds))
    while len(odds) > 1:
        i, j = np.unravel_index(int(np.argmax(mean)), mean.shape)
        if not mean[i, j] > 0:
            break
        joined = (size[i] * mean[i] + size[j] * mean[j]) / (size[i] + size[j])
        joined[[i, j]] = -np.inf
        mean[i], mean[:, i], size[i] = joined, joined, size[i] + size[j]
        mean[j] = mean[:, j] = -np.inf
        label[label == j] = i
    return label


def _judged(person: Whole, odds: Array, apart: Mask) -> tuple[Array, Whole, Array]:
    """By the posterior of each track over the people of the film and somebody new, the last one.

    The probability (T,) of its person, the likeliest other one, and the probability of that.
    """
    every, t = np.arange(len(person)), len(person)
    member = person[:, None] == np.arange(int(person.max()) + 1)
    others = member[None] & ~np.eye(t, dtype=bool)[:, :, None]  # (T, T, P), of a track without itself
    many = others.sum(axis=1)
    mean = np.einsum("ij,ijp->ip", odds, others) / np.maximum(many, 1)
    able = (many > 0) & ~np.einsum("ij,ijp->ip", apart, others).astype(bool)
    logs = np.column_stack([np.where(able, mean, -np.inf), np.full(t, _NEW)])
    p = np.exp(logs - logs.max(axis=1, keepdims=True))
    p /= p.sum(axis=1, keepdims=True)
    own = np.where(many[every, person] == 0, member.shape[1], person)  # who is alone is the new one
    rest = p.copy()
    rest[every, own] = -1
    other = rest.argmax(axis=1)
    return p[every, own], other, p[every, other]
