"""Two clips of a head as a box: before strongly textured leaves with a tree in the way, and turning, before books.

A person, cut out of a portrait, stands before a drawn ground; both move with the camera, the person by itself too.
The ground truth is the upright box about the head from hair to chin, which goes with the head and its scale alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from clip_files import Clip, TruthRow, start_of
from heads_cutout import Cutout, astronaut_cutout, edges
from heads_grounds import FINE, foliage, room, trunk
from heads_turn import unroll
from layers import over, reduced
from numpy.typing import NDArray
from portraits import MARGIN, Picture, astronaut
from render import SIZE, expose, face
from timeline import Array, Keys, syllables, track, unrest
from warp import Moment

ZOOM = 0.52  # clip pixels for one of the portrait, at scale 1
SHUTTER = 0.35  # of the time between two frames, in which what moves is blurred
_TIMES = (-0.5, 0.0, 0.5)

Window = tuple[float, float]  # the portrait's point at the first pixel of an image of the head


@dataclass(frozen=True)
class Stage:
    """All that one clip needs: paths in clip pixels by frame, (n, 2) or (n,), and how the head looks in a frame."""

    cutout: Cutout
    ground: Picture
    corner: Window  # where the ground's first pixel is while the camera is at rest
    camera: Array  # (n, 2)
    head: Array  # (n, 2) middle of the head's box in the image
    scale: Array  # (n,)
    light: Array  # (n,)
    look: Callable[[int], tuple[Picture, Window]]
    seed: int
    tree: Picture | None = None
    tree_x: Array | None = None  # (n,)

    @cached_property
    def size(self) -> tuple[float, float]:
        """Width and height of the head's box at scale 1, in pixels."""
        left, top, right, bottom = self.cutout.box
        return (right - left) * ZOOM, (bottom - top) * ZOOM

    @cached_property
    def body(self) -> Array:
        """(n, 2) where the head's middle would be if head and body were one: the head sways a little on it."""
        width = 11
        smooth = np.stack([np.convolve(np.pad(p, width // 2, "edge"), np.ones(width) / width, "valid")
                           for p in (self.head - self.camera).T], axis=1)  # fmt: skip
        return self.head + np.clip(smooth + self.camera - self.head, -2.0, 2.0)


def box(stage: Stage, t: int) -> tuple[float, float, float, float]:
    """The ground truth of frame t: middle, width and height, in pixels."""
    (x, y), s = stage.head[t], stage.scale[t]
    return float(x), float(y), float(stage.size[0] * s), float(stage.size[1] * s)


def placed(layer: Picture, window: Window, stage: Stage, at: Array, scale: float) -> Picture:
    """A layer of the portrait in the fine image, its head's box about `at`."""
    left, top, right, bottom = stage.cutout.box
    k = FINE * ZOOM * scale
    middle = np.array([(left + right) / 2, (top + bottom) / 2])
    shift = FINE * at + (FINE - 1) / 2 + k * (np.array(window) - middle)
    out = cv2.warpAffine(layer, np.array([[k, 0, shift[0]], [0, k, shift[1]]]), (SIZE[0] * FINE, SIZE[1] * FINE),
                         flags=cv2.INTER_LINEAR)  # fmt: skip
    return np.asarray(out, dtype=np.float32)


def _shifted(picture: Picture, x: float, y: float) -> Picture:
    """A fine drawing with its first pixel's corner at (x, y) of the clip, in the fine image."""
    move = np.array([[1, 0, FINE * x], [0, 1, FINE * y]], dtype=np.float64)
    size = (SIZE[0] * FINE, SIZE[1] * FINE)
    return np.asarray(cv2.warpAffine(picture, move, size, flags=cv2.INTER_LINEAR), dtype=np.float32)


def render(stage: Stage, t: int) -> Picture:
    """Frame t before light and noise, (H, W, 3): the mean of a few moments while the shutter is open."""
    layer, window = stage.look(t)
    frames = np.arange(len(stage.scale))

    def at(path: Array, moment: float) -> Array:
        return np.array([np.interp(moment, frames, p) for p in path.T])

    shown = []
    for moment in (t + SHUTTER * u for u in _TIMES):
        scale = float(np.interp(moment, frames, stage.scale))
        cx, cy = at(stage.camera, moment)
        picture = _shifted(stage.ground, stage.corner[0] + cx, stage.corner[1] + cy)
        picture = over(picture, placed(stage.cutout.body, (0.0, 0.0), stage, at(stage.body, moment), scale))
        picture = over(picture, placed(layer, window, stage, at(stage.head, moment), scale))
        if stage.tree is not None and stage.tree_x is not None:
            x = float(np.interp(moment, frames, stage.tree_x)) - stage.tree.shape[1] / FINE / 2
            picture = over(picture, _shifted(stage.tree, x, stage.corner[1] + cy))
        shown.append(reduced(picture))
    return np.asarray(np.mean(shown, axis=0), dtype=np.float32)


def covered(stage: Stage, t: int) -> float:
    """The share of the head that the tree covers in frame t."""
    if stage.tree is None or stage.tree_x is None:
        return 0.0
    skull = placed(np.dstack([stage.cutout.skull] * 4), (0.0, 0.0), stage, stage.head[t], float(stage.scale[t]))
    x = float(stage.tree_x[t]) - stage.tree.shape[1] / FINE / 2
    tree = _shifted(stage.tree, x, stage.corner[1] + float(stage.camera[t, 1]))
    return float((skull[..., 3] * tree[..., 3]).sum() / skull[..., 3].sum())


def prove(stage: Stage, t: int) -> None:
    """The box is about the head as it is drawn: about the skull to 0.3 px, and about what the head looks like to 1 px.

    Below, the box ends at the chin, where the drawn head goes on into the neck, so only the skull is held to it there.

    Raises:
        AssertionError: it is not.
    """
    x, y, w, h = box(stage, t)
    sides = np.array([x - w / 2, x + w / 2, y - h / 2, y + h / 2])
    layer, window = stage.look(t)
    for drawn, origin, checked, within in (
        (np.dstack([stage.cutout.skull] * 4), (0.0, 0.0), 4, 0.3),
        (layer, window, 3, 1.0),
    ):
        alpha = reduced(placed(drawn, origin, stage, stage.head[t], float(stage.scale[t])))[..., 3]
        found = np.array([*edges(alpha.max(axis=0)), *edges(alpha.max(axis=1))])
        off = np.abs(found - sides)[:checked].max()
        assert off < within, f"frame {t}: drawn from {found}, the ground truth says {sides}"


def _clip(stage: Stage) -> Clip:
    rng = np.random.default_rng(stage.seed)
    pictures: list[NDArray[np.uint8]] = []
    rows = []
    for t in range(len(stage.scale)):
        prove(stage, t)
        rows.append(TruthRow(t, "head", "box", *box(stage, t), hidden=covered(stage, t) > 0.5))
        pictures.append(expose(render(stage, t), float(stage.light[t]), rng))
    return Clip(pictures, rows, {"head": start_of(rows[0])})


def path(xs: Keys, ys: Keys, frames: int) -> Array:
    return np.stack([track(xs, frames), track(ys, frames)], axis=1)


def unsteady(frames: int, seed: int, strength: float) -> Array:
    """(frames, 2) the tremor of a camera held by hand, in pixels."""
    return unrest(np.random.default_rng(seed), frames, strength, 2.5)


def textured_stage() -> Stage:
    """Before leaves and gourds, talking; the camera pans to and fro, and a birch passes before the head."""
    n = 200
    cutout, portrait = astronaut_cutout(), astronaut()
    margin = ((MARGIN, MARGIN), (MARGIN, MARGIN), (0, 0))
    inside = np.dstack([portrait.mouth, np.ones(portrait.mouth.shape[:2], np.float32)])
    person = replace(portrait, skin=np.pad(cutout.head, margin), mouth=inside.astype(np.float32))
    opening, rounding = syllables(np.random.default_rng(14), [(8, 44), (70, 104), (148, 186)], n)
    keys: dict[str, Keys] = {
        "smile": [(0, 0), (10, -0.12), (44, -0.12), (54, 0.06), (66, 0), (104, -0.1), (130, 0.05), (199, -0.08)],
        "close": [(0, 0), (10, 0.8), (44, 0.8), (54, 0), (64, 0), (72, 0.9), (104, 0.9), (116, 0), (136, 0), (146, 0.9),
                  (186, 0.9), (199, 0)],
        "yaw": [(0, 0), (18, 0.12), (38, 0.17), (58, 0.02), (76, -0.17), (100, 0.05), (124, 0.17), (150, 0.08),
                (168, -0.15), (184, -0.17), (199, 0)],
        "pitch": [(0, 0), (30, 0.05), (60, -0.06), (90, 0.06), (120, 0), (150, -0.06), (180, 0.05), (199, 0)],
        "brow": [(0, 0), (46, 0), (52, 0.9), (62, 0), (108, 0), (114, 0.9), (128, 0), (199, 0)],
    }  # fmt: skip
    values = {name: track(k, n) for name, k in keys.items()}
    values |= {"jaw": 0.24 * opening, "pucker": 0.13 * rounding}

    def look(t: int) -> tuple[Picture, Window]:
        return face(person, Moment(**{name: float(v[t]) for name, v in values.items()}))[0], person.origin

    camera = unsteady(n, 41, 0.5) + path(
        [(0, 40), (22, 62), (45, 24), (64, 58), (84, 20), (100, 30), (122, -22), (140, -34), (158, -70), (178, -55),
         (199, -68)],
        [(0, 0), (26, 9), (50, -9), (74, 11), (100, -5), (128, 13), (150, -12), (176, 8), (199, 0)],
        n,
    )  # fmt: skip
    head = path(
        [(0, 120), (22, 150), (40, 205), (56, 196), (74, 106), (98, 116), (118, 150), (134, 172), (146, 206),
         (163, 236), (184, 176), (199, 190)],
        [(0, 98), (30, 90), (55, 112), (74, 96), (100, 92), (125, 104), (150, 95), (170, 116), (199, 98)],
        n,
    )  # fmt: skip
    scale = track([(0, 1), (30, 1), (58, 1.18), (90, 0.9), (120, 1.0), (150, 1.05), (176, 0.88), (199, 1.0)], n)
    light = 0.92 * track([(0, 1), (50, 1.05), (90, 0.9), (140, 1.02), (170, 0.92), (199, 1.0)], n)
    return Stage(cutout, foliage(500, 310), (-85.0, -35.0), camera, head, scale, light, look, 103,
                 trunk(310, 17.0), 225.0 + 2.2 * camera[:, 0])  # fmt: skip


def turning_stage() -> Stage:
    """From the wall to the books and back, the head turning; the camera jumps after frame 56, and back after 66."""
    n = 220
    cutout = astronaut_cutout()
    rolled = unroll(cutout)
    yaw = track([(0, 0), (10, 0), (22, -34), (40, -37), (52, -4), (64, 34), (76, 40), (92, -38), (98, -38), (112, 38),
                 (118, 42), (132, 0), (140, -10), (152, -39), (158, -39), (174, 44), (192, 40), (206, -12), (219, 0)],
                n)  # fmt: skip

    def look(t: int) -> tuple[Picture, Window]:
        return rolled.at(float(np.radians(yaw[t]))), (0.0, 0.0)

    camera = unsteady(n, 42, 0.4) + path(
        [(0, 0), (30, 16), (60, 8), (90, -18), (120, 12), (160, 22), (190, -12), (219, 0)],
        [(0, 0), (40, 4), (56, 2), (60, 29), (66, 30), (70, 2), (100, -5), (150, 6), (219, 0)],
        n,
    )
    own = path(
        [(0, 232), (14, 232), (50, 84), (80, 88), (100, 132), (126, 74), (150, 96), (166, 96), (204, 226), (219, 220)],
        [(0, 106), (14, 106), (32, 100), (50, 106), (80, 104), (104, 112), (130, 100), (160, 106), (184, 98),
         (204, 106), (219, 104)],
        n,
    )  # fmt: skip
    scale = track([(0, 1), (50, 1.0), (80, 1.14), (106, 1.2), (140, 0.92), (166, 0.9), (204, 1.08), (219, 1.04)], n)
    light = np.full(n, 0.92)
    return Stage(cutout, room(400, 330, 212), (-40.0, -48.0), camera, own + camera, scale, light, look, 104)


def textured() -> Clip:
    """The clip before the leaves."""
    return _clip(textured_stage())


def turning() -> Clip:
    """The clip before the books."""
    return _clip(turning_stage())
