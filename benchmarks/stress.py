"""Real clips of one face made harder, with truth that is known: what a tracker loses, by what is done to the clip.

    python benchmarks/stress.py clips/people/*/ -o stress                 # writes the clips, and prints nothing
    python benchmarks/stress.py clips/people/*/ -o stress --config face   # tracks them, too, and prints the table

A clip is a folder with a video and mesh.csv (frame, part, x, y, unit: reference points, unit the distance between the
eyes). Of each variant and clip the first frames are as they were, so that the track begins there:

    skip        every third frame only                  hat, glasses, beard   put on at frame 20, for good
    hand, book  before mouth or face for 40 frames      light                 steps of brightness
    blur        out of focus                            zoom                  twice as large and back
    roll        turned by 40 degrees and back           away                  out of the picture for 2 s, back elsewhere

The table has, for each variant, the share of frames whose visible nose and mouth corners are within .35 eye distances
of the reference; of hidden points the median error, and those called lost; of visible ones those called lost; and the
worst clip. `TRACKER.csv` of each clip stays beside it.
"""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import cv2
import imageio_ffmpeg
import numpy as np

from facetrack_cli.core.types import Array, Image
from facetrack_cli.recipe.load import load_recipe
from facetrack_cli.runs.api import track_video
from facetrack_cli.runs.seeds import variant
from facetrack_cli.video.source import open_source

FRAMES, PUT_ON, LONGEST = 180, 20, 640  # of a variant; the frame of the change; pixels of its longer side
CORE = ("nose", "mouth_left", "mouth_right")
Points = dict[str, tuple[float, float]]


class Shot(NamedTuple):
    """A frame, its points, the distance between the eyes, and the names of points that are hidden."""

    image: Image
    points: Points
    unit: float
    hidden: frozenset[str] = frozenset()


def shots(clip: Path) -> list[Shot]:
    """The first frames of a clip, reduced."""
    known: dict[int, dict[str, tuple[float, float, float]]] = {}
    for row in csv.DictReader((clip / "mesh.csv").open(encoding="utf-8")):
        known.setdefault(int(row["frame"]), {})[row["part"]] = float(row["x"]), float(row["y"]), float(row["unit"])
    [video] = [path for path in clip.iterdir() if path.suffix in (".mp4", ".webm", ".mkv")]
    found = []
    with open_source(video) as source:
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
    points = {part: tuple((matrix[:, :2] @ at + matrix[:, 2]).tolist()) for part, at in shot.points.items()}
    scale = float(np.hypot(*matrix[:, 0]))
    out = frozenset(part for part, (x, y) in points.items() if not (0 <= x < w and 0 <= y < h))
    return Shot(np.asarray(image, np.uint8), points, shot.unit * scale, shot.hidden | out)  # type: ignore[arg-type]


def covered(shot: Shot, picture: Array, mask: Array) -> Shot:
    """A shot with a picture (H, W, 3) before it, where the mask (H, W) is 1."""
    soft = cv2.GaussianBlur(mask, (0, 0), max(0.012 * shot.unit, 0.5))[..., None]
    shade = cv2.GaussianBlur(mask, (0, 0), 0.08 * shot.unit)[..., None]
    image = shot.image * (1 - 0.35 * np.clip(shade - soft, 0, 1)) * (1 - soft) + picture * soft
    near = cv2.GaussianBlur(mask, (0, 0), 0.08 * shot.unit)
    h, w = mask.shape
    at = {part: (int(np.clip(y, 0, h - 1)), int(np.clip(x, 0, w - 1))) for part, (x, y) in shot.points.items()}
    hidden = frozenset(part for part, place in at.items() if near[place] > 0.6)
    return shot._replace(image=np.clip(image, 0, 255).astype(np.uint8), hidden=shot.hidden | hidden)


def face_axes(shot: Shot) -> tuple[Array, Array, Array]:
    """The middle of the mouth, and the face's axes across and down, of a length of one eye distance."""
    left, right, nose = (np.array(shot.points[part]) for part in ("mouth_left", "mouth_right", "nose"))
    mouth = 0.5 * (left + right)
    across = (right - left) / max(float(np.hypot(*(right - left))), 1e-6) * shot.unit
    return mouth, across, np.array([-across[1], across[0]])


def hand(shot: Shot, t: float, skin: Array, rng: np.random.Generator) -> Shot:
    """A flat hand before the mouth, raised from below as t goes from 0 to 1."""
    mouth, across, down = face_axes(shot)
    turn = 0.5
    along = -math.cos(turn) * down + math.sin(turn) * across
    side = math.cos(turn) * across + math.sin(turn) * down
    tip = mouth - 0.15 * down + (1 - t) * 4 * down
    mask, lines = np.zeros(shot.image.shape[:2], np.float32), np.zeros(shot.image.shape[:2], np.float32)

    def place(u: float, v: float) -> tuple[int, int]:
        x, y = (tip + u * side - v * along).tolist()
        return round(float(np.clip(x, -9999, 9999))), round(float(np.clip(y, -9999, 9999)))

    width = max(round(0.36 * shot.unit), 2)
    for finger, (u, v) in enumerate(((-0.55, 0.15), (-0.18, 0.0), (0.19, 0.05), (0.55, 0.3))):
        for target, value in ((mask, width), (lines, max(width // 9, 1))):
            offset = 0.0 if target is mask else 0.19
            if target is mask or finger < 3:
                cv2.line(target, place(u + offset, v), place(0.8 * u + offset, 1.3), 1.0, value, cv2.LINE_AA)
    palm = np.array(
        [place(-0.8, 1.1), place(0.8, 1.1), place(0.7, 2.6), place(0.4, 6.0), place(-0.4, 6.0), place(-0.7, 2.6)]
    )
    cv2.fillConvexPoly(mask, cv2.convexHull(palm), 1.0, cv2.LINE_AA)
    y, x = np.mgrid[: mask.shape[0], : mask.shape[1]]
    light = 1 + 0.12 * np.sin((x * across[0] + y * across[1]) / shot.unit**2 * 2.2)
    grain = cv2.GaussianBlur(rng.normal(0, 1, mask.shape).astype(np.float32), (0, 0), 1.5)
    picture = skin * (light * (1 - 0.4 * cv2.GaussianBlur(lines, (0, 0), 1.0)) + 0.05 * grain)[..., None]
    return covered(shot, picture, mask)


def book(shot: Shot, t: float, cover: Array) -> Shot:
    """A book before the whole face, moved in from the side."""
    mouth, across, down = face_axes(shot)
    h, w = shot.image.shape[:2]
    middle = mouth - 0.5 * down + (1 - t) * 4.5 * across
    corners = [middle + a * 1.4 * across + b * 1.7 * down for a, b in ((-1, -1), (1, -1), (1, 1))]
    source = np.array([[0, 0], [cover.shape[1], 0], [cover.shape[1], cover.shape[0]]], np.float32)
    matrix = cv2.getAffineTransform(source, np.array(corners, np.float32))
    picture = cv2.warpAffine(cover, matrix, (w, h), flags=cv2.INTER_AREA)
    mask = cv2.warpAffine(np.ones(cover.shape[:2], np.float32), matrix, (w, h))
    return covered(shot, picture, mask)


def worn(shot: Shot, kind: str) -> Shot:
    """A hat, dark glasses or a beard; what of the mouth a beard covers stays visible."""
    mouth, across, down = face_axes(shot)
    mask, grain = np.zeros(shot.image.shape[:2], np.float32), np.ones(shot.image.shape[:2])
    eyes = mouth - 1.05 * down

    def shape(points: Sequence[tuple[float, float]], about: Array) -> Array:
        return np.round([about + u * across + v * down for u, v in points]).astype(np.int32)

    if kind == "hat":
        cv2.fillPoly(
            mask,
            [
                shape(
                    [
                        (-1.5, -0.45),
                        (1.5, -0.45),
                        (1.5, -0.7),
                        (0.9, -0.8),
                        (0.75, -1.7),
                        (-0.75, -1.7),
                        (-0.9, -0.8),
                        (-1.5, -0.7),
                    ],
                    eyes,
                )
            ],
            1.0,
        )
        colour: Array = np.array([40.0, 60.0, 90.0])
    elif kind == "glasses":
        for u in (-0.5, 0.5):
            cv2.fillPoly(
                mask, [shape([(u - 0.36, -0.2), (u + 0.36, -0.2), (u + 0.3, 0.22), (u - 0.3, 0.22)], eyes)], 1.0
            )
        cv2.line(
            mask,
            *[tuple(p) for p in shape([(-0.9, -0.1), (0.9, -0.1)], eyes).tolist()],
            1.0,
            max(round(0.06 * shot.unit), 1),
        )
        colour = np.array([25.0, 22.0, 20.0])
    else:
        ring = [(0.95 * math.cos(a), 0.25 + 0.75 * math.sin(a)) for a in np.linspace(0, math.pi, 20)]
        inner = [(0.5 * math.cos(a), 0.05 + 0.3 * math.sin(a)) for a in np.linspace(math.pi, 0, 20)]
        cv2.fillPoly(mask, [shape([*ring, *inner], mouth)], 1.0)
        colour, grain = np.array([35.0, 45.0, 60.0]), 0.75 + 0.5 * np.random.default_rng(0).random(mask.shape)
    found = covered(shot, np.broadcast_to(colour, shot.image.shape) * grain[..., None], mask)
    return found._replace(hidden=shot.hidden)


def ramp(t: int, first: int, last: int, rise: int = 8) -> float:
    """From 0 to 1 in frames from `first` on, and back to 0 up to `last`."""
    return float(np.clip(min((t - first) / rise, (last - t) / rise), 0, 1))


def varied(all_shots: list[Shot], kind: str, seed: int) -> Iterator[Shot]:
    rng = np.random.default_rng(seed)
    first = all_shots[0]
    mouth, _, down = face_axes(first)
    x, y = np.round(mouth - 1.7 * down).astype(int).tolist()
    r = max(round(0.15 * first.unit), 1)
    skin = np.asarray(first.image[max(y - r, 0) : y + r, max(x - r, 0) : x + r].reshape(-1, 3).mean(axis=0), float)
    skin = skin if np.isfinite(skin).all() else np.array([110.0, 140.0, 190.0])
    cover = cv2.resize(rng.integers(30, 220, (9, 7, 3)).astype(np.float32), (210, 270), interpolation=cv2.INTER_NEAREST)
    h, w = first.image.shape[:2]
    taken = all_shots[::3] if kind == "skip" else all_shots
    for t, shot in enumerate(taken[:FRAMES]):
        middle = np.array(shot.points["nose"])
        if kind in ("hat", "glasses", "beard"):
            yield worn(shot, kind) if t >= PUT_ON else shot
        elif kind == "hand":
            yield hand(shot, ramp(t, 30, 80), skin, rng)
        elif kind == "book":
            yield book(shot, ramp(t, 30, 70), cover)
        elif kind == "light":
            gain = (1.0, 0.45, 1.3, 0.7)[t // 30 % 4]
            yield shot._replace(image=np.clip(shot.image * gain, 0, 255).astype(np.uint8))
        elif kind == "blur":
            sigma = 0.12 * shot.unit * ramp(t, 25, 10_000)
            yield shot._replace(image=np.asarray(cv2.GaussianBlur(shot.image, (0, 0), sigma))) if sigma > 0.3 else shot
        elif kind == "zoom":
            scale = 2 ** math.sin(math.pi * ramp(t, PUT_ON, PUT_ON + 100, 50))
            yield moved(shot, similarity(middle, scale, 0.0, middle))
        elif kind == "roll":
            angle = math.radians(40) * math.sin(2 * math.pi * max(t - PUT_ON, 0) / 120)
            yield moved(shot, similarity(middle, 1.0, angle, middle))
        elif kind == "away":
            side, scale = -1.0 if t < 80 else 1.0, 0.6 if t >= 80 else 1.0
            far = ramp(t, PUT_ON + 10, 120, 25) * (w + 3 * shot.unit) * side
            if 55 <= t < 100:
                far = (w + 3 * shot.unit) * side
            to = np.array([far + (w / 2 + (middle[0] - w / 2) * 0.5 if t >= 80 else middle[0]), middle[1]])
            yield moved(shot, similarity(middle, scale, 0.0, to))
        else:
            yield shot


def similarity(about: Array, scale: float, angle: float, to: Array) -> Array:
    """(2, 3): the map that turns and enlarges about a place and brings that `to` another."""
    a = scale * np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    return np.column_stack([a, to - a @ about])


KINDS = ("plain", "skip", "hat", "glasses", "beard", "hand", "book", "light", "blur", "zoom", "roll", "away")


def write(clip: Path, out: Path, kind: str, seed: int = 0) -> Path:
    """The variant as a video, its reference beside it (frame, part, x, y, unit, hidden); as it is where it exists."""
    path = out / f"{clip.name}-{kind}.mp4"
    if path.with_suffix(".mesh.csv").exists():
        return path
    rows, writer = ["frame,part,x,y,unit,hidden"], None
    for t, shot in enumerate(varied(shots(clip), kind, seed)):
        h, w = (2 * (side // 2) for side in shot.image.shape[:2])
        if writer is None:
            writer = imageio_ffmpeg.write_frames(
                str(path), (w, h), fps=25, quality=8, macro_block_size=2, pix_fmt_in="bgr24"
            )
            writer.send(None)
        writer.send(np.ascontiguousarray(shot.image[:h, :w]))
        rows += [
            f"{t},{part},{x:.2f},{y:.2f},{shot.unit:.2f},{int(part in shot.hidden)}"
            for part, (x, y) in shot.points.items()
        ]
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


def score(path: Path, config: str, seed: int, change: Callable[[Path], None] = lambda path: None) -> Scores:
    cv2.setNumThreads(1)
    change(path)
    name, overrides = variant(config)
    ours = track_video(path, load_recipe(name, overrides), seed=seed)
    found = {part: ours.find("face", part) for part in (*CORE, "lip_upper", "lip_lower")}
    frames: dict[int, list[bool]] = {}
    error: list[float] = []
    lost: dict[bool, list[bool]] = {True: [], False: []}
    for row in csv.DictReader(path.with_suffix(".mesh.csv").open(encoding="utf-8")):
        one, hidden, frame = found[row["part"]], row["hidden"] == "1", int(row["frame"])
        at = None if one is None else one.row(frame)
        off = math.inf
        if one is not None and at is not None:
            off = math.hypot(one.x[at] - float(row["x"]), one.y[at] - float(row["y"])) / float(row["unit"])
            lost[hidden].append(bool(one.status[at] == "lost"))
        if hidden:
            error.append(off)
        elif row["part"] in CORE:
            frames.setdefault(frame, []).append(off <= 0.35)
    right = float(np.mean([all(each) for each in frames.values()]))
    return Scores(
        right,
        float(np.median(error)) if error else math.nan,
        *(float(np.mean(lost[k])) if lost[k] else math.nan for k in (True, False)),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="+", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of the variants")
    parser.add_argument("--config", help="the recipe to track them by")
    parser.add_argument("--variants", default=",".join(KINDS))
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("-j", "--jobs", type=int, default=2)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    kinds = args.variants.split(",")
    clips = [clip for clip in args.clips if (clip / "mesh.csv").exists()]
    with ProcessPoolExecutor(args.jobs) as pool:
        jobs = list(product(kinds, clips))
        paths = list(pool.map(write, [clip for _, clip in jobs], [args.out] * len(jobs), [kind for kind, _ in jobs]))
        if args.config is None:
            return
        runs = list(product(paths, range(args.seeds)))
        scored = list(
            pool.map(partial(score), [path for path, _ in runs], [args.config] * len(runs), [seed for _, seed in runs])
        )
    print(f"{'variant':<10}{'right':>8}{'worst':>8}  {'clip':<12}{'hidden: off':>12}{'lost':>7}{'visible: lost':>15}")
    for kind in kinds:
        mine = [
            (path.stem.rpartition("-")[0], one)
            for (path, _), one in zip(runs, scored, strict=True)
            if path.stem.endswith(f"-{kind}")
        ]
        worst, low = min(mine, key=lambda each: each[1].right)
        means = (
            np.nanmean([one for _, one in mine], axis=0)
            if any(math.isfinite(one.hidden) for _, one in mine)
            else np.array(
                [
                    np.mean([one.right for _, one in mine]),
                    math.nan,
                    math.nan,
                    np.mean([one.visible_lost for _, one in mine]),
                ]
            )
        )
        print(f"{kind:<10}{means[0]:8.3f}{low.right:8.3f}  {worst:<12}{means[1]:12.3f}{means[2]:7.2f}{means[3]:15.3f}")


if __name__ == "__main__":
    main()
