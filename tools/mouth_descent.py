"""Makes configs/mouth_descent.npz, by which nose and mouth are found in a face, from real clips.

    python tools/mouth_descent.py clips face_landmark.tflite            # writes configs/mouth_descent.npz
    python tools/mouth_descent.py clips face_landmark.tflite --without person1 -o without_person1.npz

`clips` is searched for clips of one face each. Of a clip with a mesh.csv beside it (frame, part, x, y) the points in
that are the truth; of others it is the mean of four crops of the network (facetrack models get mesh). Frames are
moved, scaled, rolled, mirrored, blurred as by motion, reduced, compressed and coloured at random. The odds are learned
from frames that boards, discs and fingers cover, with the colours of other pictures or of the face's own skin. Each
clip has the same weight.

`std` in the file is the root mean square error of each part on clips that a model of the others has not seen, five
groups of clips in turn; `--quick` leaves that out and takes the errors of training.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Container, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent.parent / "benchmarks"))

from reference import MESH, points_in

from facetrack_cli.core.face_points import MESH as NUMBERS
from facetrack_cli.core.face_points import POINTS
from facetrack_cli.core.models import shipped_folder
from facetrack_cli.core.types import Array, Frame, Image, Mask
from facetrack_cli.trackers.face import cascaded_regression
from facetrack_cli.trackers.face.cascaded_regression import SIDE, CascadedRegression, channels, read
from facetrack_cli.trackers.face.detectors import detector
from facetrack_cli.trackers.face.mesh import Mesh
from facetrack_cli.trackers.face.stabilized import EYE_LINE, EYES, MIDDLE, Similarity
from facetrack_cli.video.source import open_source

PARTS = ("nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower")
OTHERS = tuple(point for point in POINTS if point not in PARTS)
NAMES = (*PARTS, *OTHERS)
MIRRORED = [
    NAMES.index(re.sub("left|right", lambda side: "right" if side[0] == "left" else "left", one)) for one in NAMES
]
IN_MESH = [NUMBERS[name] for name in NAMES]
CORNERS_OF_EYES = [33, 133, 362, 263]
CROPS = ((3.8, 0.75), (3.2, 0.55), (4.2, 0.75), (3.8, 0.95))
FRAMES, SAMPLES, STARTS = 120, 300, 2  # of a clip; of each; from which a sample begins
COVERED = 0.6  # share of the samples for the odds in which something covers the face
HIDDEN = 0.6  # share of what is around a part that is covered, from which on it is hidden; below half of it, visible
LEAST = 6  # frames of a clip that shows a face
MOVED, SCALED, ROLLED = 0.075, 0.1, 0.075  # standard deviations: distances between the eyes, logarithm, radians
BEGINS = 0.05  # standard deviation of the mean shape where a sample begins, distances between the eyes
SCALES = (1.6, 1.2, 1.0, 0.8)
RIDGE = (1.5, 0.4, 0.2, 0.15)  # in mean squares of a channel
ODDS_RIDGE = 0.03
JITTER = 0.03  # distances between the eyes, by which a network may be off
VIDEOS = {".mp4", ".webm", ".mpg", ".mkv", ".avi"}
AGREED = 0.1  # of crops: greatest standard deviation of a part, distances between the eyes
PAD = 24  # pixels around the part that is read, so that a sample can be moved


class Clip(NamedTuple):
    """Pictures (T, SIDE + 2 PAD, ..., 3) of upright faces and the points (T, 28, 2) in them, the K parts first.

    `apart`: median distance between the eyes in the clip, pixels. Pictures may be `zoom` times as large.
    """

    name: str
    pictures: Sequence[Image]
    points: Array
    apart: float
    zoom: int = 1


def upright(eyes: Array, nose: Array) -> Similarity:
    """The stabilized image whose eyes are at `eyes` (2, 2); of a turned face its size is that down to the nose."""
    middle, across = eyes.mean(axis=0), eyes[1] - eyes[0]
    apart = max(float(np.hypot(*across)), 1.6 * float(np.hypot(*(nose - middle))), 1.0)
    angle = float(np.arctan2(across[1], across[0]))
    there = Similarity(np.zeros(2), apart / EYES, angle)
    return there._replace(centre=middle - there.to_frame(np.array([MIDDLE, EYE_LINE])))


def faces_in(path: Path, mesh: Mesh, more: Container[int] = ()) -> Iterator[tuple[Frame, Similarity, Array]]:
    """The faces that the network sees in FRAMES frames of a clip and `more`: frame, face, places (468, 2) in it."""
    finder = detector()
    with open_source(path) as source:
        total = sum(1 for _ in source)
    with open_source(path) as source:
        for frame in source:
            if frame.index % max(total // FRAMES, 1) and frame.index not in more:
                continue
            faces = finder.find(frame)
            if not faces:
                continue
            x, y, w, h = faces[0].box
            head = Similarity(np.array([x + (w - 1) / 2, y + (h - 1) / 2]), w / (EYES / 0.363))
            for _ in range(2):  # the second time upright
                points = mesh.measure(frame, head, CROPS)
                if points is None:
                    break
                agreed = np.std(points[:, IN_MESH], axis=0).max() < AGREED * EYES
                at = head.to_frame(points.mean(axis=0))
                head = upright(at[CORNERS_OF_EYES].reshape(2, 2, 2).mean(axis=1), at[1])
            if points is not None and agreed:
                yield frame, head, at


def picture_of(frame: Frame, head: Similarity, at: Array, zoom: int = 1) -> tuple[Image, Array]:
    """The picture of a face, as in `Clip`, and the points `at` (K, 2) of the frame in it."""
    corner = cascaded_regression.CORNER - PAD
    middle = corner + (SIDE + 2 * PAD - 1) / 2
    crop = Similarity(head.to_frame(middle), head.scale / zoom, head.angle).read(frame, (SIDE + 2 * PAD) * zoom)
    return crop.bgr, (head.to_stabilized(at) - corner + 0.5) * zoom - 0.5


def load(path: Path, mesh: Mesh) -> Clip | None:
    """The faces of a clip that the network sees."""
    reference = path.with_name(MESH)
    known = points_in(reference) if reference.exists() else {}
    seen: list[tuple[Image, Array, float]] = []
    for frame, head, at in faces_in(path, mesh):
        parts = at[IN_MESH]
        if known:
            if len(known.get(frame.index, {})) < len(PARTS):
                continue
            parts[: len(PARTS)] = [known[frame.index][part][:2] for part in PARTS]
        seen.append((*picture_of(frame, head, parts), head.scale * EYES))
    if len(seen) < LEAST:
        return None
    pictures, parts_of, apart = zip(*seen, strict=True)
    return Clip(str(path), pictures, np.array(parts_of), float(np.median(apart)))


class Sample(NamedTuple):
    """A picture (SIDE, SIDE, 3), its parts (K, 2), and how much of what is around each is covered (K,)."""

    picture: Image
    points: Array
    covered: Array


def sample(rng: np.random.Generator, clip: Clip, others: Sequence[Clip] = (), share: float = 0.0) -> Sample:
    """A picture of the clip, changed at random; with a probability `share` covered by colours of it or of `others`."""
    side, eyes = SIDE * clip.zoom, EYES * clip.zoom
    i = int(rng.integers(len(clip.pictures)))
    picture, points = clip.pictures[i], clip.points[i]
    if rng.random() < 0.5:
        picture = np.ascontiguousarray(picture[:, ::-1])
        points = np.stack([picture.shape[1] - 1 - points[:, 0], points[:, 1]], axis=1)[MIRRORED]
    angle, size = rng.normal(0, ROLLED), np.exp(rng.normal(0, SCALED))
    turn = size * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    shift = (side - 1) / 2 + rng.normal(0, MOVED * eyes, 2) - turn @ np.full(2, (picture.shape[0] - 1) / 2)
    to = np.column_stack([turn, shift])
    moved = cv2.warpAffine(picture, to, (side, side), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    if rng.random() < 0.15:
        moved = cv2.cvtColor(cv2.cvtColor(moved, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    if rng.random() < 0.12:
        half = rng.uniform(1.5, 6.5) * np.array([np.cos(way := rng.uniform(0, np.pi)), np.sin(way)])
        kernel = np.zeros((19, 19), np.float32)
        one_end, other_end = (np.round(9 + end * half).astype(int).tolist() for end in (-1, 1))
        cv2.line(kernel, one_end, other_end, 1.0)
        moved = cv2.filter2D(moved, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE)
    if rng.random() < 0.4:
        k = rng.uniform(1, 3.5)
        small = cv2.resize(moved, None, fx=1 / k, fy=1 / k, interpolation=cv2.INTER_AREA)
        if rng.random() < 0.5:
            coded = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, int(rng.uniform(30, 90))])[1]
            small = np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)
        moved = cv2.resize(small, (side, side))
    light = moved * np.exp(rng.normal(0, 0.06, 3)) * np.exp(rng.normal(0, 0.2))
    found = Sample(np.clip(light, 0, 255).astype(np.uint8), points @ turn.T + shift, np.zeros(len(points)))
    return cover(rng, found, others) if rng.random() < share else found


def cover(rng: np.random.Generator, one: Sample, others: Sequence[Clip]) -> Sample:
    """The sample with something before it."""
    side = len(one.picture)
    picture, mask = one.picture.astype(np.float64), shape(rng, one.points, side)
    soft = cv2.GaussianBlur(mask, (0, 0), rng.uniform(0.6, 1.6))
    shadow = np.clip(cv2.GaussianBlur(mask, (0, 0), 3) - soft, 0, 1) * rng.uniform(0, 0.7) * (rng.random() < 0.5)
    picture = picture * (1 - shadow - soft)[..., None].clip(0) + texture(rng, one.picture, others) * soft[..., None]
    around = cv2.GaussianBlur(mask, (0, 0), 0.1 * EYES * side / SIDE)
    column, row = np.clip(one.points.astype(np.int64), 0, side - 1).T
    return Sample(np.clip(picture, 0, 255).astype(np.uint8), one.points, around[row, column])


def texture(rng: np.random.Generator, own: Image, others: Sequence[Clip]) -> Array:
    """A picture of skin as in `own` (S, S, 3), of a piece of another picture, or of colours."""
    size = len(own)
    kind = rng.random()
    if kind < 0.35:
        side = int(rng.integers(12, 28)) * size // SIDE
        y, x = rng.integers(0, size - side, 2).tolist()
        piece = cv2.resize(own[y : y + side, x : x + side], (size, size), interpolation=cv2.INTER_CUBIC)
        found = piece * np.exp(rng.normal(0, 0.15))
    elif kind < 0.7:
        pictures = others[int(rng.integers(len(others)))].pictures
        whole, side = pictures[int(rng.integers(len(pictures)))], int(rng.integers(30, 110)) * size // SIDE
        y, x = rng.integers(0, whole.shape[0] - side, 2).tolist()
        turned = np.rot90(cv2.resize(whole[y : y + side, x : x + side], (size, size)), int(rng.integers(4)))
        found = turned * np.exp(rng.normal(0, 0.3))
    else:
        cells = rng.uniform(20, 230, (*[int(rng.integers(2, 12))] * 2, 3)).astype(np.float32)
        how = cv2.INTER_NEAREST if rng.random() < 0.5 else cv2.INTER_LINEAR
        contrast = rng.choice([0.0, 0.5])
        found = rng.uniform(20, 230, 3) * (1 - contrast) + contrast * cv2.resize(cells, (size, size), interpolation=how)
    return np.asarray(found + rng.normal(0, rng.uniform(0, 6), (size, size, 3)))


def shape(rng: np.random.Generator, points: Array, side: int) -> NDArray[np.float32]:
    """A mask (side, side) of a board, a disc or fingers near one of the points (K, 2)."""
    mask, eyes = np.zeros((side, side), np.float32), EYES * side / SIDE
    at, kind = points[rng.integers(len(points))] + rng.normal(0, 0.25 * eyes, 2), rng.random()
    if kind < 0.35:
        board = cv2.boxPoints((at.tolist(), (rng.uniform(0.5, 2.2, 2) * eyes).tolist(), rng.uniform(0, 180)))
        cv2.fillConvexPoly(mask, np.round(board).astype(np.int32), 1.0)
    elif kind < 0.6:
        half = np.round(rng.uniform(0.3, 1.0, 2) * eyes).astype(int).tolist()
        cv2.ellipse(mask, np.round(at).astype(int).tolist(), half, rng.uniform(0, 180), 0, 360, 1.0, -1)
    else:
        count, angle, width = int(rng.integers(1, 5)), rng.uniform(0, 2 * np.pi), rng.uniform(0.22, 0.4) * eyes
        along = np.array([np.cos(angle), np.sin(angle)])
        for i in range(count):
            across = (i - (count - 1) / 2) * 1.02 * width * np.array([-along[1], along[0]])
            tip = at + along * rng.uniform(-0.1, 0.5) * eyes + across
            ends = np.round([tip, tip - 3 * eyes * along]).astype(int).tolist()
            cv2.line(mask, ends[0], ends[1], 1.0, max(int(width), 2))
    return mask


def train(clips: Sequence[Clip], seed: int = 0) -> CascadedRegression:
    rng = np.random.default_rng(seed)
    drawn = [sample(rng, clip) for clip in clips for _ in range(SAMPLES)]
    seen, points = [channels(one.picture) for one in drawn], np.array([one.points[: len(PARTS)] for one in drawn])
    which = np.repeat(np.arange(len(seen)), STARTS)
    mean = points.mean(axis=0)
    x = mean + rng.normal(0, BEGINS * EYES, (len(which), 1, 2))
    stages = []
    for scale, ridge in zip(SCALES, RIDGE, strict=True):
        phi = np.stack([read(seen[i], at, scale) for i, at in zip(which, x, strict=True)])
        stages.append(solved(phi, (points[which] - x).reshape(len(which), -1), ridge))
        x = x + (phi @ stages[-1]).reshape(x.shape)
    std = np.sqrt(((x - points[which]) ** 2).sum(axis=2).mean(axis=0) / 2)
    blind = np.zeros((1, len(NAMES)), np.float32)
    model = CascadedRegression(NAMES, mean, np.array(stages, np.float32), np.array(SCALES), std, blind)
    return model._replace(odds=odds_of(rng, model, clips))


def odds_of(rng: np.random.Generator, model: CascadedRegression, clips: Sequence[Clip]) -> NDArray[np.float32]:
    """The regressions that tell whether points are visible, around parts where the model has placed them."""
    drawn = [sample(rng, clip, clips, COVERED) for clip in clips for _ in range(SAMPLES // 2)]
    found, visible = [], np.array([1 - 2 * one.covered for one in drawn])
    for one in drawn:
        seen, at = channels(one.picture), one.points + rng.normal(0, JITTER * EYES, one.points.shape)
        at[: len(PARTS)] = model.placed_from(seen, model.mean).at - cascaded_regression.CORNER
        found.append(read(seen, at, cascaded_regression.ODDS_SCALE)[:-1].reshape(len(at), -1))
    phi = np.array(found)
    phi = np.concatenate([phi, np.ones_like(phi[..., :1])], axis=2)
    odds = [solved(phi[:, j], visible[:, j], ODDS_RIDGE) for j in range(len(NAMES))]
    return np.asarray(odds, np.float32).T


def solved(phi: NDArray[np.float32], wanted: Array, ridge: float) -> Array:
    """The matrix R of the ridge regression phi R = wanted."""
    gram = (phi.T @ phi).astype(np.float64)
    gram[np.diag_indices(len(gram))] += ridge * np.trace(gram) / len(gram)
    return np.asarray(np.linalg.solve(gram, phi.T.astype(np.float64) @ wanted))


class Errors(NamedTuple):
    """Of samples of a clip: root mean square error (K,) along an axis without the mean error; scores (N, K), covers."""

    std: Array
    scores: Array
    covered: Array


def errors(model: CascadedRegression, clip: Clip, others: Sequence[Clip]) -> Errors:
    """What a model that has not seen the clip makes of it."""
    rng, corner = np.random.default_rng(1), cascaded_regression.CORNER.astype(int)
    off, scores, covers = [], [], []
    for share in (0.0,) * 50 + (1.0,) * 50:
        one = sample(rng, clip, others, share)
        still = np.zeros((160, 160, 3), np.uint8)
        still[corner[1] : corner[1] + SIDE, corner[0] : corner[0] + SIDE] = one.picture
        at, k = one.points + corner, len(PARTS)
        placed = model.fit(still)
        if not share:
            off.append(placed.at - at[:k])
        at[:k] = placed.at
        scores.append(model.visible(cascaded_regression.face_channels(still), at))
        covers.append(one.covered)
    return Errors(np.sqrt(np.var(off, axis=0).mean(axis=1)), np.array(scores), np.array(covers))


def calibrated(model: CascadedRegression, found: Sequence[Errors]) -> CascadedRegression:
    """The model with the errors of clips left out, and scores as logarithms of the likelihood ratio (Platt 1999)."""
    odds = model.odds.copy()
    scores, covers = (np.concatenate([getattr(one, key) for one in found]) for key in ("scores", "covered"))
    for j in range(len(NAMES)):
        known = (covers[:, j] > HIDDEN) | (covers[:, j] < HIDDEN / 2)
        a, b = platt(scores[known, j], covers[known, j] < HIDDEN / 2)
        odds[:, j] *= a
        odds[-1, j] += b
    return model._replace(std=np.median([one.std for one in found], axis=0), odds=odds)


def platt(s: Array, visible: Mask) -> tuple[float, float]:
    """The log likelihood ratio a s + b of being visible, for scores s (N,)."""
    weight = np.where(visible, 0.5 / visible.mean(), 0.5 / (1 - visible.mean()))
    a, b = 1.0, 0.0
    for _ in range(50):  # Newton's method
        p = 1 / (1 + np.exp(-(a * s + b)))
        phi = np.stack([s, np.ones_like(s)], axis=1)
        step = np.linalg.solve((phi.T * (weight * p * (1 - p))) @ phi, phi.T @ (weight * (visible - p)))
        a, b = a + step[0], b + step[1]
    return a, b


def clips_in(folder: Path, without: Sequence[str]) -> Iterator[Path]:
    for path in sorted(folder.rglob("*")):
        if (path.suffix in VIDEOS or path.name == "img") and not any(one in str(path) for one in without):
            yield path


def arguments(about: str | None, networks: str, output: str) -> argparse.Namespace:
    """Of a tool that trains regressions on clips, with `networks`, for the shipped file `output`."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", type=Path)
    parser.add_argument(networks, type=Path)
    parser.add_argument("--without", action="append", default=[], help="clips whose path holds this are left out")
    parser.add_argument("-o", "--output", type=Path, default=shipped_folder() / output)
    parser.add_argument("--quick", action="store_true")
    return parser.parse_args()


def main() -> None:
    args = arguments(__doc__, "mesh", cascaded_regression.DEFAULT)
    mesh = Mesh(args.mesh)
    found = (load(path, mesh) for path in clips_in(args.clips, args.without))
    clips = [clip for clip in found if clip is not None]
    model = train(clips)
    if not args.quick:
        model = calibrated(model, [one for i in range(5) for one in left_out(clips, i)])
    model.save(args.output)
    print(f"{args.output}: {len(clips)} clips, std {np.round(model.std / EYES, 3).tolist()} eye distances")


def left_out(clips: Sequence[Clip], group: int) -> list[Errors]:
    """The errors on each fifth clip of a model of the others."""
    model = train([clip for i, clip in enumerate(clips) if i % 5 != group])
    return [errors(model, clip, clips) for clip in clips[group::5]]


if __name__ == "__main__":
    main()
