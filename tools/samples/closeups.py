"""Scenes of a face that comes nearer and goes, rolls and turns: where its box is, and the proof of it.

A person cut out of a portrait, as in `heads.py`, is placed by a similarity: place, scale and roll. The ground truth is
the square of the portrait that a frontal Haar cascade finds, carried along; a turn of the head moves it by the mean
shift of what is in it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from clip_files import Clip, TruthRow, start_of
from heads import SHUTTER
from heads_cutout import Cutout
from heads_grounds import FINE
from layers import over, reduced
from numpy.typing import NDArray
from portraits import MARGIN, Picture, Portrait
from render import SIZE, expose, face
from timeline import Array
from warp import Moment, to_picture, turn

_TIMES = (-0.5, 0.0, 0.5)
_BODY_ROLL = 0.5  # of the head's roll, about the neck
Lit = Callable[[int], tuple[Picture, Picture, Picture]]  # factors (H, W, 3) of the light on head, body and ground


@dataclass(frozen=True)
class Closeup:
    """All that one clip needs; paths by frame, in clip pixels, radians and clip pixels for one of the portrait."""

    portrait: Portrait  # whose skin and mouth have an alpha: the head alone
    cutout: Cutout
    square: tuple[float, float, float]  # left, top and side of the face in the portrait
    ground: Picture
    corner: tuple[float, float]  # where the ground's first pixel is while the camera is at rest
    camera: Array  # (n, 2)
    head: Array  # (n, 2) where the middle of the square is, were the head not turned
    scale: Array  # (n,)
    roll: Array  # (n,) clockwise
    moments: list[Moment]  # what face and head do; no roll, shift or scale there
    light: Array  # (n,) the exposure
    seed: int
    crf: int
    lit: Lit | None = None  # a lamp: of head and body in the portrait's pixels, of the ground in its own

    @cached_property
    def middle(self) -> Array:
        """(2,) of the square, in the portrait's pixels, pixel centres at whole numbers."""
        left, top, side = self.square
        return np.array([left + (side - 1) / 2, top + (side - 1) / 2])

    @cached_property
    def turned(self) -> Array:
        """(2,) the mean shift of the square's points for a yaw and a pitch of 1, in the portrait's pixels."""
        left, top, side = self.square
        y, x = np.mgrid[: round(side), : round(side)].astype(np.float64)
        grid = np.stack([x.ravel() + left, y.ravel() + top], axis=1)
        shift = turn(grid, self.portrait.anatomy, Moment(yaw=1.0, pitch=1.0)) - grid
        return np.asarray(shift.mean(axis=0))


def rotation(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def box(shot: Closeup, t: int) -> tuple[float, float, float, float, float]:
    """The ground truth of frame t: middle, width, height, in pixels, and the roll in degrees, clockwise."""
    m, k, roll = shot.moments[t], float(shot.scale[t]), float(shot.roll[t])
    shift = k * rotation(roll) @ (shot.turned * (m.yaw, m.pitch))
    x, y = shot.head[t] + shift
    side = k * shot.square[2]
    return float(x), float(y), side, side, float(np.degrees(roll))


def placed(layer: Picture, turn_by: Array, fixed: Array, at: Array) -> Picture:
    """A layer of the portrait in the fine image: scaled and rotated by `turn_by`, its point `fixed` at `at`."""
    a = FINE * turn_by
    k = float(np.sqrt(np.linalg.det(a)))
    if k < 1:  # or fine threads would flicker
        layer = cv2.GaussianBlur(layer, (0, 0), 0.5 * float(np.sqrt(1 / k**2 - 1)) + 1e-3)  # type: ignore[assignment]
    shift = FINE * at + (FINE - 1) / 2 - a @ fixed
    how = cv2.INTER_CUBIC if k > 1 else cv2.INTER_LINEAR
    out = cv2.warpAffine(layer, np.column_stack([a, shift]), (SIZE[0] * FINE, SIZE[1] * FINE), flags=how)
    out[..., -1] = np.clip(out[..., -1], 0, 1)
    return np.asarray(out, dtype=np.float32)


def _at(path: Array, moment: float) -> Array:
    frames = np.arange(len(path))
    return np.array([np.interp(moment, frames, p) for p in path.reshape(len(path), -1).T])


def render(shot: Closeup, t: int) -> Picture:
    """Frame t before exposure and noise, (H, W, 3): the mean of a few moments while the shutter is open."""
    layer, above, _ = face(shot.portrait, shot.moments[t])
    body, ground, neck = shot.cutout.body, shot.ground, np.array(shot.portrait.anatomy.neck)
    if shot.lit is not None:
        on_head, on_body, on_ground = shot.lit(t)
        where = above.astype(np.float32)
        factor = cv2.remap(on_head, where[..., 0], where[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        layer, body, ground = layer.copy(), body.copy(), ground * on_ground
        layer[..., :3] *= factor
        body[..., :3] *= on_body
    shown = []
    for moment in (t + SHUTTER * u for u in _TIMES):
        k, roll = float(_at(shot.scale, moment)[0]), float(_at(shot.roll, moment)[0])
        head, camera = _at(shot.head, moment), _at(shot.camera, moment)
        about = k * rotation(roll)
        corner = np.array(shot.corner) + camera
        move = np.array([[1, 0, FINE * corner[0]], [0, 1, FINE * corner[1]]])
        moved = cv2.warpAffine(ground, move, (SIZE[0] * FINE, SIZE[1] * FINE), flags=cv2.INTER_LINEAR)
        picture = np.asarray(moved, dtype=np.float32)
        nape = head + about @ (neck - shot.middle)
        picture = over(picture, placed(body, k * rotation(_BODY_ROLL * roll), neck, nape))
        picture = over(picture, placed(layer, about, shot.middle - np.array(shot.portrait.origin), head))
        shown.append(reduced(picture))
    return np.asarray(np.clip(np.mean(shown, axis=0), 0, None), dtype=np.float32)


def prove(shot: Closeup, t: int) -> None:
    """Frame t shows the square where the ground truth has it: its two halves, drawn, and points of the turned face.

    Raises:
        AssertionError: it does not, to 0.1 px and 0.2 degrees; to 0.15 pixels of the portrait for the points.
    """
    m, k, roll = shot.moments[t], float(shot.scale[t]), float(shot.roll[t])
    left, top, side = shot.square
    pixel = np.arange(max(shot.cutout.head.shape[:2]))

    def along(first: float, length: float) -> Array:
        start = first - 0.5
        out = np.minimum(pixel + 0.5, start + length) - np.maximum(pixel - 0.5, start)
        return np.asarray(np.clip(out, 0, 1), dtype=np.float64)

    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    middles = []
    for first in (left, left + side / 2):
        half = np.outer(along(top, side), along(first, side / 2))[..., None].astype(np.float32)
        fine = placed(np.dstack([half, half]), k * rotation(roll), shot.middle, shot.head[t])
        alpha = reduced(fine)[..., 1].astype(np.float64)
        middles.append(np.array([(alpha * x).sum(), (alpha * y).sum()]) / alpha.sum())
    across = middles[1] - middles[0]
    shift = k * rotation(roll) @ (shot.turned * (m.yaw, m.pitch))
    found = np.array([*(np.mean(middles, axis=0) + shift), 2 * np.hypot(*across)])
    bx, by, w, _, angle = box(shot, t)
    assert np.abs(found - (bx, by, w)).max() < 0.1, f"frame {t}: the face is at {found}, not {bx, by, w}"
    drawn = float(np.degrees(np.arctan2(across[1], across[0])))
    assert abs(drawn - angle) < 0.2, f"frame {t}: the face is rolled by {drawn}, the ground truth says {angle}"
    a, origin = shot.portrait.anatomy, shot.portrait.origin
    u, v = np.meshgrid(np.linspace(left + 0.1 * side, left + 0.9 * side, 5), np.linspace(top, a.points["nose"][1], 4))
    points = np.stack([u.ravel(), v.ravel()], axis=1)
    q = to_picture(points, False, a, m, origin).astype(np.float32)
    shown = cv2.remap(face(shot.portrait, m)[1], q[None, :, 0], q[None, :, 1], cv2.INTER_LINEAR)[0]
    assert np.abs(shown - points).max() < 0.15, f"frame {t}: the image shows {shown}, not {points}"


def alone(portrait: Portrait, cutout: Cutout, exposure: float = 1.0) -> Portrait:
    """The portrait with the head alone, cut out, and the inside of its mouth: both with an alpha, for `face`."""
    margin = ((MARGIN, MARGIN), (MARGIN, MARGIN), (0, 0))
    h, w = (n - 2 * MARGIN for n in portrait.skin.shape[:2])
    inside = np.dstack([portrait.mouth, np.ones(portrait.mouth.shape[:2], np.float32)]).astype(np.float32)
    return Portrait(portrait.anatomy, portrait.origin, np.pad(cutout.head[:h, :w], margin), inside, exposure)


def closeup_clip(shot: Closeup) -> Clip:
    """The clip of target `face`, never hidden."""
    rng = np.random.default_rng(shot.seed)
    pictures: list[NDArray[np.uint8]] = []
    rows = []
    for t in range(len(shot.scale)):
        prove(shot, t)
        x, y, w, h, angle = box(shot, t)
        rows.append(TruthRow(t, "face", "box", x, y, w, h, angle=angle))
        pictures.append(expose(render(shot, t), float(shot.light[t]), rng))
    return Clip(pictures, rows, {"face": start_of(rows[0])}, shot.crf)
