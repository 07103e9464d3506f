"""Real clips of one face made harder, with truth that is known: what a tracker loses, by what is done to the clip.

    python benchmarks/stress.py clips/people/*/ -o stress                 # writes the clips, and prints nothing
    python benchmarks/stress.py clips/people/*/ -o stress --config face   # tracks them, too, and prints the table

A clip is a folder with a video and mesh.csv (frame, part, x, y, unit: reference points, unit the distance between the
eyes). Of each variant and clip the first frames are as they were, so that the track begins there:

    skip        every third frame only                  hat, glasses, beard   put on at frame 20, for good
    hand, book  before mouth or face for 40 frames      light                 steps of brightness
    blur        out of focus                            zoom                  twice as large and back
    roll        turned by 40 degrees and back           away                  out of the picture for 2 s, back elsewhere
    jumps       by half of the face between two frames  dressed               a book, then tilted with a hat on
    flash       three of them                           strobe                half of the light, two frames in four
    whip        the camera away and back in 9 frames    lens                  dark for 8 frames, as by a hand
    jump_cut    later, larger and elsewhere, and back   jump_hat              later, with a hat on in other light
    passer      the person of the next folder walks by before the face, and stops there for a second

The table has, for each variant, the share of frames whose visible nose and mouth corners are within .35 eye distances
of the reference, and the worst clip; of hidden points the median error, and the share called lost; of visible ones the
share called lost.
"""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import imageio_ffmpeg
import numpy as np
from boxes import clip_in
from numpy.typing import NDArray
from reference import MESH, points_in, take_regression

from facetrack_cli.core.types import Array, Image
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.api import track_video
from facetrack_cli.runs.seeds import variant
from facetrack_cli.trajectory.trajectory import UNSEEN
from facetrack_cli.video.source import open_source

FRAMES, PUT_ON, LONGEST = 180, 20, 640  # of a variant; the frame of the change; pixels of its longer side
GONE, BACK, SEEN_AGAIN = 55, 80, 100  # frames of "away": out of the picture, to the right of it, in it again
CORE = ("nose", "mouth_left", "mouth_right")
Points = dict[str, tuple[float, float]]
Reals = NDArray[np.floating[Any]]


class Shot(NamedTuple):
    """A frame, its points, the distance between the eyes, and the names of points that are hidden."""

    image: Image
    points: Points
    unit: float
    hidden: frozenset[str] = frozenset()


def shots(clip: Path) -> list[Shot]:
    """The first frames of a clip, reduced."""
    known, found = points_in(clip / MESH), list[Shot]()
    with open_source(clip_in(clip)) as source:
        for frame in source:
            if len(found) == 3 * FRAMES:
                break
            if frame.index not in known:
                continue
            zoom = min(LONGEST / max(frame.size), 1.0)
            image = cv2.resize(frame.bgr, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_AREA)
            points = {part: (x * zoom, y * zoom) for part, (x, y, _) in known[frame.index].items()}
            found.append(Shot(np.asarray(image, np.uint8), points, known[frame.index]["nose"][2] * zoom))
    return found


def moved(shot: Shot, matrix: Array) -> Shot:
    """A shot under a similarity (2, 3)."""
    h, w = shot.image.shape[:2]
    beyond = np.median(shot.image[:, [0, -1]].reshape(-1, 3), axis=0).tolist()
    image = cv2.warpAffine(shot.image, matrix, (w, h), flags=cv2.INTER_LINEAR, borderValue=beyond)
    places = {part: (matrix[:, :2] @ at + matrix[:, 2]).tolist() for part, at in shot.points.items()}
    points = {part: (x, y) for part, (x, y) in places.items()}
    scale = float(np.hypot(*matrix[:, 0]))
    out = frozenset(part for part, (x, y) in points.items() if not (0 <= x < w and 0 <= y < h))
    return Shot(np.asarray(image, np.uint8), points, shot.unit * scale, shot.hidden | out)


def similarity(about: Array, scale: float, angle: float, to: Array) -> Array:
    """(2, 3): the map that turns and enlarges about a place and brings that `to` another."""
    a = scale * np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    return np.column_stack([a, to - a @ about])


def covered(shot: Shot, picture: Reals, mask: Reals) -> Shot:
    """A shot with a picture (H, W, 3) before it, where the mask (H, W) is 1, and its shadow around."""
    soft = cv2.GaussianBlur(mask, (0, 0), max(0.012 * shot.unit, 0.5))[..., None]
    near = cv2.GaussianBlur(mask, (0, 0), 0.08 * shot.unit)
    shadow = np.clip(near[..., None] - soft, 0, 1)
    image = shot.image * (1 - 0.35 * shadow) * (1 - soft) + picture * soft
    h, w = mask.shape
    at = {part: (int(np.clip(y, 0, h - 1)), int(np.clip(x, 0, w - 1))) for part, (x, y) in shot.points.items()}
    hidden = frozenset(part for part, place in at.items() if near[place] > 0.6)
    return shot._replace(image=np.clip(image, 0, 255).astype(np.uint8), hidden=shot.hidden | hidden)


def blank(shot: Shot) -> NDArray[np.float32]:
    """A mask (H, W) of nothing."""
    return np.zeros(shot.image.shape[:2], np.float32)


def face_axes(shot: Shot) -> tuple[Array, Array, Array]:
    """The middle of the mouth, and the face's axes across and down, of a length of one eye distance."""
    left, right = (np.array(shot.points[part]) for part in ("mouth_left", "mouth_right"))
    mouth = 0.5 * (left + right)
    across = (right - left) / max(float(np.hypot(*(right - left))), 1e-6) * shot.unit
    return mouth, across, np.array([-across[1], across[0]])


FINGERS = (-0.55, 0.15), (-0.18, 0.0), (0.19, 0.05), (0.55, 0.3)  # across and down the hand, of their tips
PALM = (-0.8, 1.1), (0.8, 1.1), (0.7, 2.6), (0.4, 6.0), (-0.4, 6.0), (-0.7, 2.6)


def hand(shot: Shot, t: float, skin: Array, rng: np.random.Generator) -> Shot:
    """A flat hand before the mouth, raised from below as t goes from 0 to 1."""
    mouth, across, down = face_axes(shot)
    turn = 0.5
    along = -math.cos(turn) * down + math.sin(turn) * across
    side = math.cos(turn) * across + math.sin(turn) * down
    tip = mouth - 0.15 * down + (1 - t) * 4 * down

    def place(u: float, v: float) -> tuple[int, int]:
        x, y = np.clip(tip + u * side - v * along, -9999, 9999).tolist()
        return round(x), round(y)

    mask, lines = blank(shot), blank(shot)
    width = max(round(0.36 * shot.unit), 2)
    for u, v in FINGERS:
        cv2.line(mask, place(u, v), place(0.8 * u, 1.3), 1.0, width, cv2.LINE_AA)
    for u, v in FINGERS[:-1]:  # the line between a finger and the next
        cv2.line(lines, place(u + 0.19, v), place(0.8 * u + 0.19, 1.3), 1.0, max(width // 9, 1), cv2.LINE_AA)
    cv2.fillConvexPoly(mask, cv2.convexHull(np.array([place(*at) for at in PALM])), 1.0, cv2.LINE_AA)
    y, x = np.mgrid[: mask.shape[0], : mask.shape[1]]
    light = 1 + 0.12 * np.sin((x * across[0] + y * across[1]) / shot.unit**2 * 2.2)
    grain = cv2.GaussianBlur(rng.normal(0, 1, mask.shape).astype(np.float32), (0, 0), 1.5)
    dark = 1 - 0.4 * cv2.GaussianBlur(lines, (0, 0), 1.0)
    return covered(shot, skin * (light * dark + 0.05 * grain)[..., None], mask)


def book(shot: Shot, t: float, cover: Reals) -> Shot:
    """A book before the whole face, moved in from the side."""
    mouth, across, down = face_axes(shot)
    h, w = shot.image.shape[:2]
    middle = mouth - 0.5 * down + (1 - t) * 4.5 * across
    corners = [middle + a * 1.4 * across + b * 1.7 * down for a, b in ((-1, -1), (1, -1), (1, 1))]
    source = np.array([[0, 0], [cover.shape[1], 0], [cover.shape[1], cover.shape[0]]], np.float32)
    matrix = cv2.getAffineTransform(source, np.array(corners, np.float32))
    picture = cv2.warpAffine(cover, matrix, (w, h), flags=cv2.INTER_AREA)
    mask = cv2.warpAffine(np.ones(cover.shape[:2], np.float32), matrix, (w, h))
    return covered(shot, np.asarray(picture, np.float32), np.asarray(mask, np.float32))


def outline(at: Iterable[tuple[float, float]], about: Array, across: Array, down: Array) -> NDArray[np.int32]:
    """Corners (M, 2) of a polygon on a face, in pixels."""
    return np.round([about + u * across + v * down for u, v in at]).astype(np.int32)


def worn(shot: Shot, mask: Reals, picture: Reals) -> Shot:
    """A shot with something put on, after which its points count as visible: a beard has a mouth, too."""
    return covered(shot, np.broadcast_to(picture, shot.image.shape), mask)._replace(hidden=shot.hidden)


BRIM = (-1.5, -0.45), (1.5, -0.45), (1.5, -0.7), (0.9, -0.8)
CROWN = (0.75, -1.7), (-0.75, -1.7), (-0.9, -0.8), (-1.5, -0.7)
LENS = (-0.36, -0.2), (0.36, -0.2), (0.3, 0.22), (-0.3, 0.22)


def hat(shot: Shot) -> Shot:
    mouth, across, down = face_axes(shot)
    mask = blank(shot)
    cv2.fillPoly(mask, [outline((*BRIM, *CROWN), mouth - 1.05 * down, across, down)], 1.0)
    return worn(shot, mask, np.array([40.0, 60.0, 90.0]))


def glasses(shot: Shot) -> Shot:
    mouth, across, down = face_axes(shot)
    mask, eyes = blank(shot), mouth - 1.05 * down
    for eye in (-0.5, 0.5):
        cv2.fillPoly(mask, [outline([(eye + u, v) for u, v in LENS], eyes, across, down)], 1.0)
    one_end, other_end = outline([(-0.9, -0.1), (0.9, -0.1)], eyes, across, down).tolist()
    cv2.line(mask, one_end, other_end, 1.0, max(round(0.06 * shot.unit), 1))
    return worn(shot, mask, np.array([25.0, 22.0, 20.0]))


def beard(shot: Shot) -> Shot:
    mouth, across, down = face_axes(shot)
    mask = blank(shot)
    chin = [(0.95 * math.cos(a), 0.25 + 0.75 * math.sin(a)) for a in np.linspace(0, math.pi, 20)]
    lips = [(0.5 * math.cos(a), 0.05 + 0.3 * math.sin(a)) for a in np.linspace(math.pi, 0, 20)]
    cv2.fillPoly(mask, [outline([*chin, *lips], mouth, across, down)], 1.0)
    hair = 0.75 + 0.5 * np.random.default_rng(0).random(mask.shape)
    return worn(shot, mask, np.array([35.0, 45.0, 60.0]) * hair[..., None])


def blurred(shot: Shot, sigma: float) -> Shot:
    return shot._replace(image=np.asarray(cv2.GaussianBlur(shot.image, (0, 0), sigma))) if sigma > 0.3 else shot


def passed(shot: Shot, t: float, other: Shot) -> Shot:
    """With somebody else's head before it, which comes from the right and leaves to the left as t goes from 0 to 1."""
    (mouth, across, down), (their_mouth, right, _) = face_axes(shot), face_axes(other)
    off = 5 * (1 - 2 * t) ** 3  # slow in the middle
    angle = math.atan2(across[1], across[0]) - math.atan2(right[1], right[0])
    matrix = similarity(their_mouth, 1.1 * shot.unit / other.unit, angle, mouth + off * across + 0.1 * down)
    size = shot.image.shape[1::-1]
    picture = cv2.warpAffine(other.image, matrix, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    mask, (x, y) = blank(shot), mouth + off * across - 0.75 * down
    axes = round(1.35 * shot.unit), round(1.9 * shot.unit)
    cv2.ellipse(mask, (round(x), round(y)), axes, math.degrees(math.atan2(across[1], across[0])), 0, 360, 1.0, -1)
    return covered(shot, np.asarray(picture, np.float32), mask)


def exposed(shot: Shot, gain: float, more: float = 0.0) -> Shot:
    """In other light; what is too dark or too light to see counts as hidden."""
    gone = frozenset(shot.points) if gain < 0.3 else frozenset[str]()
    image = np.clip(shot.image.astype(np.float32) * gain + more, 0, 255).astype(np.uint8)
    return shot._replace(image=image, hidden=shot.hidden | gone)


def whipped(shot: Shot, t: float) -> Shot:
    """While the camera whips away and back, as t goes from 0 to 1."""
    width = shot.image.shape[1]
    off, blur = round(1.2 * width * math.sin(math.pi * t)), round(0.47 * width * abs(math.cos(math.pi * t))) + 1
    image = np.asarray(cv2.blur(np.roll(shot.image, -off, axis=1), (blur, 1)), np.uint8)
    return shot._replace(image=image, hidden=shot.hidden | frozenset(shot.points))


def away(shot: Shot, t: int) -> Shot:
    """Out of the picture to the left, and from frame 80 on in again from the right, smaller."""
    width, back = shot.image.shape[1], t >= BACK
    (x, y), gone = shot.points["nose"], width + 3 * shot.unit
    far = 1.0 if GONE <= t < SEEN_AGAIN else ramp(t, PUT_ON + 10, 120, 25)
    to = width / 2 + (x - width / 2) * 0.5 + far * gone if back else x - far * gone
    return moved(shot, similarity(np.array([x, y]), 0.6 if back else 1.0, 0.0, np.array([to, y])))


def jumped(shot: Shot, to: Array, before: Array) -> Shot:
    """Elsewhere, larger and turned, by (x, y, log scale, radians), blurred by half of the way from `before`."""
    nose, way = np.array(shot.points["nose"]), 0.5 * shot.unit * (to - before)[:2]
    x, y, log_scale, angle = to.tolist()
    there = moved(shot, similarity(nose, math.exp(log_scale), angle, nose + shot.unit * np.array([x, y])))
    steps = min(max(round(float(np.hypot(*way))), 1), 24)
    image = np.zeros(shot.image.shape, np.float32)
    for u, v in (way * ((k + 0.5) / steps - 0.5) for k in range(steps)):  # the truth is the middle of the exposure
        shift = np.array([[1.0, 0.0, -u], [0.0, 1.0, -v]])
        image += cv2.warpAffine(there.image, shift, shot.image.shape[1::-1], borderMode=cv2.BORDER_REPLICATE)
    return there._replace(image=(image / steps).astype(np.uint8))


def ramp(t: int, first: int, last: int, rise: int = 8) -> float:
    """From 0 to 1 in frames from `first` on, and back to 0 up to `last`."""
    return float(np.clip(min((t - first) / rise, (last - t) / rise), 0, 1))


def skin_of(shot: Shot) -> Array:
    """The mean colour (3,) of the forehead."""
    mouth, _, down = face_axes(shot)
    x, y = np.round(mouth - 1.7 * down).astype(int).tolist()
    r = max(round(0.15 * shot.unit), 1)
    forehead = shot.image[max(y - r, 0) : y + r, max(x - r, 0) : x + r].reshape(-1, 3)
    return np.asarray(forehead.mean(axis=0), float) if len(forehead) else np.array([110.0, 140.0, 190.0])


def varied(all_shots: list[Shot], kind: str, seed: int, others: Sequence[Shot] = ()) -> Iterator[Shot]:
    """The shots of a variant; `others` are of somebody else."""
    rng, skin = np.random.default_rng(seed), skin_of(all_shots[0])
    cells = rng.integers(30, 220, (9, 7, 3)).astype(np.float32)
    cover = np.asarray(cv2.resize(cells, (210, 270), interpolation=cv2.INTER_NEAREST), np.float32)
    put_on = {"hat": hat, "glasses": glasses, "beard": beard}
    taken = all_shots[::3] if kind == "skip" else all_shots
    to = np.zeros(4)
    for t, shot in enumerate(taken[:FRAMES]):
        nose = np.array(shot.points["nose"])
        if kind in put_on:
            yield put_on[kind](shot) if t >= PUT_ON else shot
        elif kind == "hand":
            yield hand(shot, ramp(t, 30, 80), skin, rng)
        elif kind == "book":
            yield book(shot, ramp(t, 30, 70), cover)
        elif kind == "light":
            gain = (1.0, 0.45, 1.3, 0.7)[t // 30 % 4]
            yield shot._replace(image=np.clip(shot.image * gain, 0, 255).astype(np.uint8))
        elif kind == "blur":
            yield blurred(shot, 0.12 * shot.unit * ramp(t, 25, 10_000))
        elif kind == "zoom":
            scale = 2 ** math.sin(math.pi * ramp(t, PUT_ON, PUT_ON + 100, 50))
            yield moved(shot, similarity(nose, scale, 0.0, nose))
        elif kind == "roll":
            angle = math.radians(40) * math.sin(2 * math.pi * max(t - PUT_ON, 0) / 120)
            yield moved(shot, similarity(nose, 1.0, angle, nose))
        elif kind == "away":
            yield away(shot, t)
        elif kind == "jumps":
            before = to
            if t >= PUT_ON and t % 6 == 0:  # half a face is 1.4 eye distances
                to = np.clip(rng.normal(0, (0.7, 0.7, 0.12, 0.25)), -1.4, 1.4)
            yield jumped(shot, to, before)
        elif kind == "dressed":
            angle = math.radians(25) * min(ramp(t, 80, 10_000, 12), 1.0)
            tilted = moved(book(shot, ramp(t, 30, 65), cover), similarity(nose, 1.0, angle, nose))
            yield hat(tilted) if t >= 95 else tilted
        elif kind == "flash":
            light = {4: 1.0, 5: 0.5, 40: 1.0, 41: 1.0, 42: 0.4, 80: 0.8}.get(t, 0.0)
            yield exposed(shot, 1 - 0.85 * light, 225 * light)
        elif kind == "strobe":
            yield exposed(shot, 0.35 if PUT_ON <= t < 90 and t % 4 > 1 else 1.0)
        elif kind == "lens":
            yield exposed(shot, 0.03 if 30 <= t < 38 or 70 <= t < 74 else 1.0)
        elif kind == "passer":
            yield passed(shot, (t - 40) / 70, others[t % len(others)]) if 40 <= t <= 110 else shot
        elif kind == "whip":
            yield whipped(shot, (t - 40) / 8) if 40 <= t <= 48 else shot
        elif kind.startswith("jump_"):
            later = taken[len(taken) // 2 + t - 50] if 50 <= t < 100 and len(taken) > 100 else shot
            worn_later = exposed(hat(later), 0.8) if kind == "jump_hat" and t >= 50 else later
            middle = np.array(shot.image.shape[1::-1]) * (0.6, 0.5)
            turned = similarity(np.array(later.points["nose"]), 1.4, 0.0, middle)
            yield moved(worn_later, turned) if 50 <= t < 100 else worn_later
        else:
            yield shot


KINDS = (
    "plain", "skip", "hat", "glasses", "beard", "hand", "book", "light", "blur", "zoom", "roll", "away", "jumps",
    "dressed", "flash", "strobe", "lens", "whip", "jump_cut", "jump_hat", "passer",
)  # fmt: skip


def write(clip: Path, out: Path, kind: str, seed: int = 0) -> Path:
    """The variant as a video, its reference beside it (frame, part, x, y, unit, hidden); as it is where it exists."""
    path = out / f"{clip.name}-{kind}.mp4"
    if path.with_suffix(".mesh.csv").exists():
        return path
    rows, writer = ["frame,part,x,y,unit,hidden"], None
    folders = sorted(path.parent for path in clip.resolve().parent.glob(f"*/{MESH}"))
    next_folder = folders[(folders.index(clip.resolve()) + 1) % len(folders)]
    others = shots(next_folder) if kind == "passer" else []
    for t, shot in enumerate(varied(shots(clip), kind, seed, others)):
        h, w = (2 * (side // 2) for side in shot.image.shape[:2])
        if writer is None:
            how = {"fps": 25, "quality": 8, "macro_block_size": 2, "pix_fmt_in": "bgr24"}
            writer = imageio_ffmpeg.write_frames(str(path), (w, h), **how)
            writer.send(None)
        writer.send(np.ascontiguousarray(shot.image[:h, :w]))
        for part, (x, y) in shot.points.items():
            rows.append(f"{t},{part},{x:.2f},{y:.2f},{shot.unit:.2f},{int(part in shot.hidden)}")
    assert writer is not None
    writer.close()
    path.with_suffix(".mesh.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


class Scores(NamedTuple):
    """Of one run: the share of frames that are right, errors of hidden points, and of hidden and visible ones lost."""

    right: float
    hidden: float
    hidden_lost: float
    visible_lost: float


def score(path: Path, config: str, seed: int, regressions: Path | None) -> Scores:
    cv2.setNumThreads(1)
    take_regression(regressions, path.stem.rpartition("-")[0])
    name, overrides = variant(config)
    ours = track_video(path, load_recipe(name, overrides), seed=seed)
    found = {part: ours.find("face", part) for part in (*CORE, "lip_upper", "lip_lower")}
    right: dict[int, list[bool]] = {}
    errors: list[float] = []
    lost: dict[bool, list[bool]] = {True: [], False: []}
    for row in csv.DictReader(path.with_suffix(".mesh.csv").open(encoding="utf-8")):
        one, hidden, frame = found[row["part"]], row["hidden"] == "1", int(row["frame"])
        at = None if one is None else one.row(frame)
        off = math.inf
        if one is not None and at is not None:
            off = math.hypot(one.x[at] - float(row["x"]), one.y[at] - float(row["y"])) / float(row["unit"])
            lost[hidden].append(str(one.status[at]) in UNSEEN)
        if hidden:
            errors.append(off)
        elif row["part"] in CORE:
            right.setdefault(frame, []).append(off <= 0.35)
    hidden_lost, visible_lost = (float(np.mean(lost[k])) if lost[k] else math.nan for k in (True, False))
    off = float(np.median(errors)) if errors else math.nan
    return Scores(float(np.mean([all(each) for each in right.values()])), off, hidden_lost, visible_lost)


def mean_of_known(values: Sequence[float]) -> float:
    known = [value for value in values if not math.isnan(value)]
    return float(np.mean(known)) if known else math.nan


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="+", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the variants")
    parser.add_argument("--config", help="the recipe to track them by")
    parser.add_argument("--regressions", type=Path, help="folder of those that have not seen a clip: without_NAME.npz")
    parser.add_argument("--variants", default=",".join(KINDS))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("-j", "--jobs", type=int, default=2)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    kinds = args.variants.split(",")
    clips = [clip for clip in args.clips if (clip / MESH).exists()]
    with ProcessPoolExecutor(args.jobs) as pool:
        jobs = [(clip, args.out, kind) for kind, clip in product(kinds, clips)]
        paths = list(pool.map(write, *zip(*jobs, strict=True)))
        if args.config is None:
            return
        runs = [(path, args.config, seed, args.regressions) for path, seed in product(paths, range(args.seeds))]
        scores = list(pool.map(score, *zip(*runs, strict=True)))
    print(f"{'variant':<10}{'right':>8}{'worst':>8}  {'clip':<12}{'hidden: off':>12}{'lost':>7}{'visible: lost':>15}")
    for kind in kinds:
        mine = [
            (path.stem.rpartition("-")[0], one)
            for (path, *_), one in zip(runs, scores, strict=True)
            if path.stem.endswith(f"-{kind}")
        ]
        worst, low = min(mine, key=lambda each: each[1].right)
        mean = Scores(*map(mean_of_known, zip(*(one for _, one in mine), strict=True)))
        print(f"{kind:<10}{mean.right:8.3f}{low.right:8.3f}  {worst:<12}{mean.hidden:12.3f}", end="")
        print(f"{mean.hidden_lost:7.2f}{mean.visible_lost:15.3f}")


if __name__ == "__main__":
    main()
