"""Scenes of one face as a box: where the box is, what is before it, and the proof of both.

The person stands as in `heads.py`, cut out of a portrait; things come before it as layers, each moving as one piece.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np
from clip_files import Clip, TruthRow, start_of
from heads import SHUTTER, ZOOM, Stage, Window, placed, prove, render, unsteady
from heads_cutout import Cutout, astronaut_cutout
from layers import inside, reduced
from numpy.typing import NDArray
from portraits import MARGIN, Picture, Portrait, astronaut
from render import SIZE, expose, face
from timeline import Array, Keys, syllables, track
from warp import Moment

# left, top and side of the face in the portrait, as the frontal cascade finds it when the portrait is as small as here
FACE = (172.5, 62.0, 102.0)
Box = tuple[float, float, float, float]  # middle, width and height, in pixels


@dataclass(frozen=True)
class Before:
    """A thing before the person: BGR times alpha, and alpha, (H, W, 4), and its motion, in pixels a frame."""

    layer: Picture
    motion: tuple[float, float]


Things = Callable[[int], list[Before]]
Spots = Callable[[int], Mapping[str, Box]]  # by the point's name, the box about the point that says if it is covered


def motion(path: Array, t: int) -> tuple[float, float]:
    """Pixels a frame of a path (n, 2) about frame t."""
    first, last = max(t - 1, 0), min(t + 1, len(path) - 1)
    x, y = (path[last] - path[first]) / (last - first)
    return float(x), float(y)


def panned(keys: Keys, frames: int, seed: int) -> Array:
    """(frames, 2) a camera held by hand that pans to the sides, so that the face does not rest in the image."""
    return unsteady(frames, seed, 0.35) + np.stack([track(keys, frames), np.zeros(frames)], axis=1)


def face_box(stage: Stage, t: int) -> Box:
    """The ground truth of frame t. The box goes with head and scale; what the face does in it does not move it."""
    left, top, right, bottom = stage.cutout.box
    k = ZOOM * float(stage.scale[t])
    x = float(stage.head[t, 0]) + k * (FACE[0] + FACE[2] / 2 - (left + right) / 2)
    y = float(stage.head[t, 1]) + k * (FACE[1] + FACE[2] / 2 - (top + bottom) / 2)
    return x, y, k * FACE[2], k * FACE[2]


def looks(portrait: Portrait, cutout: Cutout, values: dict[str, Array]) -> Callable[[int], tuple[Picture, Window]]:
    """How a portrait's head, cut out of it, looks in a frame, while mouth, brows and head do what `values` say."""
    margin = ((MARGIN, MARGIN), (MARGIN, MARGIN), (0, 0))
    inside = np.dstack([portrait.mouth, np.ones(portrait.mouth.shape[:2], np.float32)])
    h, w = (n - 2 * MARGIN for n in portrait.skin.shape[:2])
    shown = replace(portrait, skin=np.pad(cutout.head[:h, :w], margin), mouth=inside.astype(np.float32))

    def look(t: int) -> tuple[Picture, Window]:
        return face(shown, Moment(**{name: float(v[t]) for name, v in values.items()}))[0], shown.origin

    return look


def standing(
    ground: Picture, corner: Window, camera: Array, head: Array, scale: Array, expression: dict[str, Keys],
    spans: list[tuple[int, int]], seed: int,
) -> Stage:  # fmt: skip
    """The person of NASA's portrait before a ground, who talks in the frames of `spans`."""
    n, cutout = len(head), astronaut_cutout()
    opening, rounding = syllables(np.random.default_rng(seed), spans, n)
    values = {name: track(keys, n) for name, keys in expression.items()}
    values |= {"jaw": 0.2 * opening, "pucker": 0.12 * rounding}
    light = np.full(n, 0.92)
    return Stage(cutout, ground, corner, camera, head, scale, light, looks(astronaut(), cutout, values), seed)


def cover(picture: Picture, thing: Before, soft: float, dark: float) -> Picture:
    """The image with the thing and its shadow before it; what moves is blurred while the shutter is open."""
    steps = np.linspace(-0.5, 0.5, 9) * SHUTTER
    moved = [_moved(thing.layer, u * thing.motion[0], u * thing.motion[1]) for u in steps]
    layer = np.mean(moved, axis=0) if max(map(abs, thing.motion)) > 0.5 else thing.layer
    shadow = cv2.GaussianBlur(_moved(layer[..., 3], 0.7 * soft, soft), (0, 0), soft)[..., None] * dark
    return np.asarray(picture * (1 - shadow) * (1 - layer[..., 3:]) + layer[..., :3], dtype=np.float32)


def _moved(layer: Picture, x: float, y: float) -> Picture:
    move = np.array([[1.0, 0.0, x], [0.0, 1.0, y]])
    return np.asarray(cv2.warpAffine(layer, move, SIZE, flags=cv2.INTER_LINEAR), dtype=np.float32)


def covered(at: Box, things: list[Before]) -> float:
    """The share of the box that is covered by any of the things."""
    within = inside(at)
    free = np.ones_like(within)
    for thing in things:
        free = free * (1 - thing.layer[..., 3])
    return float((within * (1 - free)).sum() / within.sum())


def _prove(stage: Stage, t: int) -> None:
    """The head is where the ground truth has it, and the portrait's square that is the face is in the face's box.

    Raises:
        AssertionError: it is not so, to 1 px for the drawn head and to 0.1 px for the square.
    """
    prove(stage, t)
    square = np.zeros((*stage.cutout.skull.shape, 4), np.float32)
    left, top, side = FACE
    pixel = np.arange(square.shape[0])
    columns, rows = (np.clip(pixel - first + 0.5, 0, 1) * np.clip(first + side - pixel + 0.5, 0, 1)
                     for first in (left, top))  # fmt: skip
    square[..., 3] = np.outer(rows, columns)
    alpha = reduced(placed(square, (0.0, 0.0), stage, stage.head[t], float(stage.scale[t])))[..., 3].astype(np.float64)
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    total, at = alpha.sum(), face_box(stage, t)
    found = (float((alpha * x).sum() / total), float((alpha * y).sum() / total), float(total**0.5))
    off = np.abs(np.array(found) - at[:3]).max()
    assert off < 0.1, f"frame {t}: the face is at {found}, the ground truth says {at}"


def draw(stage: Stage, t: int, things: list[Before], soft: float, dark: float) -> Picture:
    """Frame t before light and noise, (H, W, 3)."""
    picture = render(stage, t)
    for thing in things:
        picture = cover(picture, thing, soft, dark)
    return picture


def face_clip(stage: Stage, things: Things, *, soft: float, dark: float, crf: int, spots: Spots = lambda t: {}) -> Clip:
    """The clip of target `face`, its box and points, each hidden while more than half of its box is covered."""
    rng = np.random.default_rng(stage.seed)
    pictures: list[NDArray[np.uint8]] = []
    rows = []
    for t in range(len(stage.scale)):
        _prove(stage, t)
        before, at = things(t), face_box(stage, t)
        rows.append(TruthRow(t, "face", "box", *at, hidden=covered(at, before) > 0.5))
        for part, spot in spots(t).items():
            rows.append(TruthRow(t, "face", part, *spot[:2], hidden=covered(spot, before) > 0.5))
        pictures.append(expose(draw(stage, t, before, soft, dark), float(stage.light[t]), rng))
    return Clip(pictures, rows, {"face": start_of(*(row for row in rows if row.frame == 0))}, crf)
