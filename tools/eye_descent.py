"""Makes configs/eye_descent.npz, by which eyes are found in a face, from real clips.

    python tools/eye_descent.py clips models            # writes configs/eye_descent.npz
    python tools/eye_descent.py clips models --without person1 -o without_person1.npz

`clips` is searched for clips of one face each, `models` holds the networks (facetrack models get mesh). Of a clip with
an eyes.csv beside it (frame, left_outer_x, left_outer_y, ...; left is the person's) the points in that are the truth;
of others it is what the iris network says. Shut and half shut eyes are drawn more often than they occur. Frames are
changed at random and covered as by `mouth_descent.py`, at twice the size, and have glints and dark glasses. Each clip
has the same weight.

`std` in the file, and the scale of the odds, are those on clips that a model of the others has not seen, five groups of
clips in turn; `--quick` leaves that out.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from mouth_descent import (
    COVERED,
    HIDDEN,
    IN_MESH,
    LEAST,
    NAMES,
    Clip,
    Sample,
    arguments,
    clips_in,
    faces_in,
    picture_of,
    platt,
    sample,
    solved,
)
from numpy.typing import NDArray

from facetrack_cli.core.types import Array, Frame
from facetrack_cli.trackers.face import eyes, image_kernels
from facetrack_cli.trackers.face.cascaded_regression import (
    CORNER,
    SIDE,
    CascadedRegression,
    channels,
    load_regression,
    read,
)
from facetrack_cli.trackers.face.eyes import CORNERS, POINTS, SIDES, EyeRegression, openings, views
from facetrack_cli.trackers.face.mesh import Iris, Mesh
from facetrack_cli.trackers.face.stabilized import EYES, MIDDLE, Similarity

ZOOM = int(eyes.ZOOM)
IN_NAMES = [NAMES.index(point) for point in POINTS]
TABLE = "eyes.csv"
SHUT = 0.8  # of the median opening, below which all frames are read
LARGE = 20.0  # pixels between the eyes, from which the network is the truth
STEPS = 5  # of opening relative to its median, each as often as the root of how often it occurs
PICTURES, SAMPLES = 400, 200  # of a clip
SCALES, RIDGE = (1.6, 1.0), (1.0, 0.2)  # as of nose and mouth; the patch forgives what two stages are off
FOLLOWS = 0.003  # ridge of how corners follow nose and mouth
LIDS_RIDGE, ODDS_RIDGE = 0.1, 0.3
CLOSED, WEIGHT = 0.15, 5.0  # opening below which an eye has that weight, since the regression draws to the mean
BEGINS, JITTER = 0.03, 0.03  # standard deviations: of where the cascade and where a patch begins, eye distances
GLINTS, SHADES = 0.2, 0.25  # shares of samples, and of those in which something covers the face
# of the stabilized image in a picture of twice its size
HEAD = Similarity((MIDDLE - CORNER + 0.5) * ZOOM - 0.5, ZOOM)


def eyes_in(path: Path) -> dict[int, Array]:
    """By frame the points (8, 2) of a table of eyes, in the order of POINTS; its left is the person's."""
    if not path.exists():
        return {}
    theirs = [one.replace("eye_left", "R").replace("eye_right", "left").replace("R", "right") for one in POINTS]
    with path.open(encoding="utf-8") as file:
        return {
            int(row["frame"]): np.array([[float(row[f"{point}_{axis}"]) for axis in "xy"] for point in theirs])
            for row in csv.DictReader(file)
        }


def load(path: Path, mesh: Mesh, iris: Iris) -> Clip | None:
    """The faces of a clip, those with shut eyes more often."""
    known, shut = eyes_in(path.with_name(TABLE)), set()
    if known:
        opening = openings(np.array([*known.values()])).mean(axis=1)
        shut = {frame for frame, one in zip(known, opening, strict=True) if one < SHUT * np.median(opening)}
    seen = []
    for frame, head, at in faces_in(path, mesh, shut):
        points = at[IN_MESH]
        if frame.index not in known if known else head.scale * EYES < LARGE:
            continue
        corners = head.to_stabilized(points[IN_NAMES][CORNERS])
        points[IN_NAMES] = known[frame.index] if known else head.to_frame(iris.measure(frame, head, corners)[0])
        seen.append((*picture_of(frame, head, points, ZOOM), head.scale * EYES))
    if len(seen) < LEAST:
        return None
    pictures, points_of, apart = zip(*seen, strict=True)
    opening = openings(np.array(points_of)[:, IN_NAMES]).mean(axis=1)
    step = np.minimum(opening / np.median(opening) * STEPS, STEPS).astype(int)
    often = 1 / np.sqrt(np.bincount(step)[step])
    drawn = np.random.default_rng(0).choice(len(seen), PICTURES, p=often / often.sum())
    return Clip(str(path), [pictures[i] for i in drawn], np.array(points_of)[drawn], float(np.median(apart)), ZOOM)


def glints(rng: np.random.Generator, one: Sample) -> Sample:
    """The sample with reflections near the eyes, and light that falls from a side."""
    picture = one.picture.astype(np.float32)
    for _ in range(int(rng.integers(1, 5))):
        at = one.points[rng.choice(IN_NAMES)] + rng.normal(0, 0.1 * EYES * ZOOM, 2)
        half = rng.uniform(0.5, 5, 2)
        cv2.ellipse(picture, (at.tolist(), (2 * half).tolist(), rng.uniform(0, 180)), (rng.uniform(180, 255),) * 3, -1)
    y, x = np.mgrid[: len(picture), : len(picture)] / len(picture) - 0.5
    way = rng.normal(0, 0.7, 2)
    picture *= np.exp(way[0] * x + way[1] * y)[..., None]
    return one._replace(picture=np.clip(picture, 0, 255).astype(np.uint8))


def shades(rng: np.random.Generator, one: Sample) -> Sample:
    """The sample with dark glasses."""
    picture, unit, covered = one.picture.copy(), EYES * ZOOM, one.covered.copy()
    half, colour = rng.uniform((0.3, 0.22), (0.45, 0.36)) * unit, rng.uniform(0, 60) + rng.normal(0, 6, 3)
    middles = one.points[IN_NAMES][CORNERS].reshape(2, 2, 2).mean(axis=1) + rng.normal(0, 0.04 * unit, 2)
    for middle in middles:
        cv2.ellipse(picture, (middle.tolist(), (2 * half).tolist(), rng.normal(0, 8)), colour.clip(0).tolist(), -1)
    ends = np.round(middles).astype(int).tolist()
    cv2.line(picture, ends[0], ends[1], colour.clip(0).tolist(), int(rng.uniform(0.02, 0.1) * unit))
    covered[IN_NAMES] = 1.0
    return one._replace(picture=picture, covered=covered)


class Drawn(NamedTuple):
    """A sample as the model sees it: frame, channels of the upper half, nose and mouth as found (5, 2); the true eyes
    (8, 2), how much of each is covered (2,).

    Places are in the stabilized image.
    """

    frame: Frame
    seen: NDArray[np.float32]
    parts: Array
    true: Array
    covered: Array


def draw(
    rng: np.random.Generator, mouth: CascadedRegression, clip: Clip, others: Sequence[Clip] = (), share: float = 0.0
) -> Drawn:
    one = sample(rng, clip, others, share)
    one = shades(rng, one) if rng.random() < SHADES * share else one
    one = glints(rng, one) if rng.random() < GLINTS else one
    seen = channels(np.asarray(cv2.resize(one.picture, (SIDE, SIDE), interpolation=cv2.INTER_AREA), np.uint8))
    covered = one.covered[IN_NAMES][np.array(SIDES)].mean(axis=1)
    true = HEAD.to_stabilized(one.points[IN_NAMES])
    upper = seen[: SIDE // 2].copy()  # holds the eyes; the whole takes gigabytes
    return Drawn(Frame(0, 0.0, one.picture), upper, mouth.placed_from(seen, mouth.mean).at, true, covered)


def drawn_of(mouth: CascadedRegression, clip: Clip, clips: Sequence[Clip]) -> tuple[list[Drawn], list[Drawn]]:
    """Samples of a clip: of eyes that are free, and of eyes some of which are covered."""
    rng = np.random.default_rng(0)
    free = [draw(rng, mouth, clip) for _ in range(SAMPLES)]
    return free, [draw(rng, mouth, clip, clips, COVERED) for _ in range(SAMPLES // 2)]


def patches(model: EyeRegression, one: Drawn, off: Array) -> NDArray[np.float32]:
    """phi (2, WIDTH) of both eyes, whose corners are found `off` (2,)."""
    middles = (model.corners(one.seen, one.parts) + off).reshape(2, 2, 2).mean(axis=1)
    out = np.empty((2, eyes.WIDTH), np.float32)
    image_kernels.read_eyes(eyes.patches(one.frame, HEAD, middles), eyes.OFFSETS, out)
    return out


def train(mouth: CascadedRegression, clips: Sequence[tuple[list[Drawn], list[Drawn]]]) -> EyeRegression:
    rng = np.random.default_rng(1)
    free, some = ([one for clip in clips for one in clip[i]] for i in (0, 1))
    true = np.array([one.true[CORNERS] for one in free]) - CORNER
    mean, follows = true.mean(axis=0), np.array([np.append(one.parts - CORNER - mouth.mean, 1.0) for one in free])
    first = solved(follows, (true - mean).reshape(len(free), -1), FOLLOWS)
    x = mean + (follows @ first).reshape(true.shape) + rng.normal(0, BEGINS * EYES, (len(free), 1, 2))
    stages = []
    for scale, ridge in zip(SCALES, RIDGE, strict=True):
        seen = np.stack([read(one.seen, at, scale) for one, at in zip(free, x, strict=True)])
        stages.append(solved(seen, (true - x).reshape(len(x), -1), ridge))
        x = x + (seen @ stages[-1]).reshape(x.shape)
    blind = np.zeros((eyes.WIDTH, 9), np.float32)
    model = EyeRegression(mouth.mean, mean, first, np.array(SCALES), np.ones(4), np.array(stages, np.float32), blind)
    looks, wanted = [], []
    for one in free:
        off = rng.normal(0, JITTER * EYES, 2)
        looks.append(patches(model, one, off))
        found = views(HEAD, (model.corners(one.seen, one.parts) + off).reshape(2, 2, 2).mean(axis=1))
        for eye, (*at, a, b), way in zip(SIDES, found.tolist(), (1, -1), strict=True):
            view = Similarity(np.array(at), math.hypot(a, b), math.atan2(b, a))
            wanted.append((view.to_stabilized(HEAD.to_frame(one.true[eye])) - MIDDLE) * (way, 1))
    opening = openings(np.array([one.true for one in free]))
    weight = np.sqrt(np.where(opening < CLOSED, WEIGHT, 1.0)).reshape(-1, 1)
    lids = solved(
        (np.concatenate(looks) * weight).astype(np.float32), np.array(wanted).reshape(-1, 8) * weight, LIDS_RIDGE
    )
    covers = np.concatenate([1 - 2 * one.covered for one in some])
    odds = solved(np.concatenate([patches(model, one, np.zeros(2)) for one in some]), covers, ODDS_RIDGE)
    return model._replace(lids=np.column_stack([lids, odds]).astype(np.float32))


class Errors(NamedTuple):
    """Of samples of a clip: errors (N, 8, 2); log odds and covers (M, 2)."""

    off: Array
    odds: Array
    covered: Array


def errors(model: EyeRegression, clip: tuple[list[Drawn], list[Drawn]]) -> Errors:
    """What a model that has not seen the clip makes of it."""
    free, some = ([model.fit(one.frame, HEAD, one.seen, one.parts) for one in each] for each in clip)
    off = np.array([found.at - one.true for found, one in zip(free, clip[0], strict=True)])
    odds = np.array([found.odds[[0, 4]] for found in some])
    return Errors(off, odds, np.array([one.covered for one in clip[1]]))


def calibrated(model: EyeRegression, found: Sequence[Errors]) -> EyeRegression:
    """The model with the errors of clips left out, and scores as logarithms of the likelihood ratio (Platt 1999)."""
    odds, covered = (np.concatenate([getattr(one, key).ravel() for one in found]) for key in ("odds", "covered"))
    known = (covered > HIDDEN) | (covered < HIDDEN / 2)
    a, b = platt(odds[known], covered[known] < HIDDEN / 2)
    lids = model.lids.copy()
    lids[:, -1] *= a
    lids[-1, -1] += b
    std = np.median([np.sqrt(np.mean(one.off**2, axis=(0, 2))) for one in found], axis=0)
    return model._replace(lids=lids, std=std[np.array(SIDES)].mean(axis=0))


def main() -> None:
    args = arguments(__doc__, "models", eyes.DEFAULT)
    mesh, iris = Mesh(args.models / "face_landmark.tflite"), Iris(args.models / "iris_landmark.tflite")
    found = (load(path, mesh, iris) for path in clips_in(args.clips, args.without))
    clips, mouth = [clip for clip in found if clip is not None], load_regression()
    drawn = [drawn_of(mouth, clip, clips) for clip in clips]
    model = train(mouth, drawn)
    if not args.quick:
        groups = [train(mouth, [one for i, one in enumerate(drawn) if i % 5 != group]) for group in range(5)]
        model = calibrated(model, [errors(groups[i % 5], one) for i, one in enumerate(drawn)])
    model.save(args.output)
    print(f"{args.output}: {len(clips)} clips, std {np.round(model.std / EYES, 3).tolist()} eye distances")


if __name__ == "__main__":
    main()
