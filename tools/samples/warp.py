"""The moving face: smooth maps from the portrait to the image, and back.

A point of the portrait goes through four maps: expression, turn of the head, pose of the head, camera. The lips part,
so the expression has two branches, one for the skin above the mouth and one for that below; they differ only within the
lens between the corners, which is where the mouth opens. Points are arrays (..., 2), x before y, in pixels.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from timeline import Array, smoothstep

Point = tuple[float, float]


@dataclass(frozen=True)
class Anatomy:
    """Where things are in a portrait, in its pixels. The edges run from corner to corner along the parting lips."""

    points: Mapping[str, Point]
    upper_edge: tuple[Point, ...]
    lower_edge: tuple[Point, ...]
    chin_y: float
    brow_y: float
    head: Point
    head_radii: Point
    neck: Point
    width: float = field(init=False)
    centre: Point = field(init=False)

    def __post_init__(self) -> None:
        (lx, ly), (rx, ry) = self.points["mouth_left"], self.points["mouth_right"]
        object.__setattr__(self, "width", float(np.hypot(rx - lx, ry - ly)))
        object.__setattr__(self, "centre", ((lx + rx) / 2, (ly + ry) / 2))

    def across(self, x: Array) -> Array:
        """-1 at the left corner of the mouth, 1 at the right."""
        return (x - self.centre[0]) / (self.width / 2)

    def edges(self, x: Array) -> tuple[Array, Array]:
        """y of the upper lip's lower edge and of the lower lip's upper edge; one line beyond the corners."""
        upper = np.interp(x, *np.array(self.upper_edge).T)
        lower = np.interp(x, *np.array(self.lower_edge).T)
        return upper, np.maximum(upper, lower)


@dataclass(frozen=True)
class Moment:
    """All that moves, at one frame. Lengths of the mouth are in mouth widths, angles in radians, shifts in pixels."""

    jaw: float = 0.0  # opening at the middle of the lips
    smile: float = 0.0  # widening, as a share of the width; the corners rise with it
    pucker: float = 0.0  # narrowing, as a share of the width; the lips thicken with it
    close: float = 0.0  # 0 as in the portrait, 1 lips together
    pull: float = 0.0  # one corner out and up: the right if positive, the left if negative
    brow: float = 0.0  # brows up
    yaw: float = 0.0
    pitch: float = 0.0
    roll: float = 0.0
    scale: float = 0.0  # of the head, beyond 1
    head_x: float = 0.0
    head_y: float = 0.0
    cam_x: float = 0.0
    cam_y: float = 0.0
    cam_roll: float = 0.0
    light: float = 1.0


Map = Callable[[Array], Array]


def _bump(p: Array, at: Point, sx: float, sy: float, above: float | None = None) -> Array:
    """A Gaussian hill of height 1; `above` is its spread upwards where that differs, to leave the nose alone."""
    dx, dy = p[..., 0] - at[0], p[..., 1] - at[1]
    return np.exp(-0.5 * ((dx / sx) ** 2 + (dy / np.where(dy < 0, above or sy, sy)) ** 2))


def _skin(p: Array, a: Anatomy, m: Moment) -> Array:
    """(..., 2) displacement that both branches share: corners, pucker, cheeks, brows."""
    w = a.width
    out = np.zeros_like(p)
    left, right = a.points["mouth_left"], a.points["mouth_right"]
    for corner, sign in ((left, -1.0), (right, 1.0)):
        pull = max(0.0, sign * m.pull)
        near = _bump(p, corner, 0.30 * w, 0.36 * w, above=0.26 * w)
        out[..., 0] += sign * w * (0.5 * m.smile + 0.14 * pull - 0.10 * m.jaw) * near
        out[..., 1] += w * (-0.60 * m.smile - 0.12 * pull + 0.22 * m.jaw) * near
        cheek = (corner[0] + sign * 0.35 * w, corner[1] - 0.65 * w)
        out[..., 1] -= w * (0.20 * m.smile + 0.05 * pull) * _bump(p, cheek, 0.4 * w, 0.3 * w)
    near = _bump(p, a.centre, 0.62 * w, 0.5 * w, above=0.22 * w)
    out[..., 0] -= 1.38 * m.pucker * (p[..., 0] - a.centre[0]) * near
    out[..., 1] += 0.45 * m.pucker * (p[..., 1] - a.centre[1]) * near
    out[..., 1] -= w * 0.12 * m.brow * _bump(p, (a.centre[0], a.brow_y), 1.1 * w, 0.22 * w)
    return out


def _lens(x: Array, a: Anatomy, half_width: Array, softness: Array) -> Array:
    """1 at the middle of the mouth, 0 from the half width on, where it ends the softer, the larger `softness`, >= 0."""
    u = np.clip(1.0 - np.abs((x - a.centre[0]) / half_width) ** 2.4, 0.0, None)
    return u ** (1.0 + softness)


def upper(p: Array, a: Anatomy, m: Moment) -> Array:
    """Where the expression takes points of the skin above the mouth."""
    w = a.width
    top, bottom = a.edges(p[..., 0])
    v = np.clip(top - p[..., 1], 0.0, None) / w
    lift = 1.0 - smoothstep(v / 0.42)
    lens = _lens(p[..., 0], a, np.full_like(v, w / 2), v)
    out = p + _skin(p, a, m)
    out[..., 1] += lift * (-0.14 * m.jaw * w * lens + 0.4 * m.close * (bottom - top))
    return out


def lower(p: Array, a: Anatomy, m: Moment) -> Array:
    """Where the expression takes points of the skin below the mouth; the chin goes with the jaw."""
    w = a.width
    top, bottom = a.edges(p[..., 0])
    v = np.clip(p[..., 1] - bottom, 0.0, None) / w
    chin = (a.chin_y - a.centre[1]) / w
    wide = smoothstep(v / (0.9 * chin))
    drop = (1.0 - smoothstep((v - 0.8 * chin) / 1.25)) * _lens(p[..., 0], a, w * (0.5 + 0.8 * wide), 0.6 * wide)
    out = p + _skin(p, a, m)
    out[..., 1] += 0.86 * m.jaw * w * drop - 0.65 * m.close * (bottom - top) * (1.0 - smoothstep(v / 0.6))
    return out


def turn(p: Array, a: Anatomy, m: Moment) -> Array:
    """The head turned a little: what is nearer the camera, the nose above all, is shifted more."""
    w = a.width
    rho2 = ((p[..., 0] - a.centre[0]) / (1.5 * w)) ** 2 + ((p[..., 1] - a.centre[1] + 0.6 * w) / (2.3 * w)) ** 2
    depth = 1.1 * w * np.clip(1.0 - rho2, 0.0, None) ** 1.5 + 0.22 * w * _bump(p, a.points["nose"], 0.25 * w, 0.35 * w)
    out = p.copy()
    out[..., 0] += m.yaw * depth
    out[..., 1] += m.pitch * depth
    return out


def pose(p: Array, a: Anatomy, m: Moment) -> Array:
    """The head on the neck: shifted, rolled and scaled about it; the ground and the body stay, with a soft passage."""
    rho = np.hypot((p[..., 0] - a.head[0]) / a.head_radii[0], (p[..., 1] - a.head[1]) / a.head_radii[1])
    share = 1.0 - smoothstep((rho - 0.95) / 0.85)
    d = p - np.array(a.neck)
    c, s = np.cos(m.roll) * (1 + m.scale), np.sin(m.roll) * (1 + m.scale)
    moved = np.stack([c * d[..., 0] - s * d[..., 1], s * d[..., 0] + c * d[..., 1]], axis=-1)
    moved += np.array([m.head_x, m.head_y])
    out: Array = p + share[..., None] * (moved - d)
    return out


def camera(p: Array, a: Anatomy, m: Moment, origin: Point) -> Array:
    """From the portrait to the image; at rest, `origin` is the portrait's point at the picture's top left."""
    c, s = np.cos(m.cam_roll), np.sin(m.cam_roll)
    d = p - np.array(a.centre)
    out: Array = np.stack([c * d[..., 0] - s * d[..., 1], s * d[..., 0] + c * d[..., 1]], axis=-1)
    out += np.array(a.centre) - np.array(origin) + np.array([m.cam_x, m.cam_y])
    return out


def camera_back(q: Array, a: Anatomy, m: Moment, origin: Point) -> Array:
    """The inverse of `camera`."""
    c, s = np.cos(m.cam_roll), np.sin(m.cam_roll)
    d = q - (np.array(a.centre) - np.array(origin) + np.array([m.cam_x, m.cam_y]))
    out: Array = np.stack([c * d[..., 0] + s * d[..., 1], -s * d[..., 0] + c * d[..., 1]], axis=-1) + np.array(a.centre)
    return out


def invert(forward: Map, q: Array, tolerance: float = 0.001, rounds: int = 200) -> Array:
    """Points p (n, 2) with forward(p) within `tolerance` of q (n, 2), by fixed-point steps on those not there yet.

    Raises:
        ArithmeticError: some point does not converge: the map folds.
    """
    p = q.copy()
    todo = np.arange(len(q))
    for i in range(rounds):
        step = q[todo] - forward(p[todo])
        away = np.abs(step).max(axis=1) > tolerance
        todo, step = todo[away], step[away]
        if not len(todo):
            return p
        # damped in the end, for places that are stretched to more than twice their size
        p[todo] += step if i < 8 else 0.6 * step
    raise ArithmeticError(f"the warp folds: {len(todo)} points do not converge, near {q[todo[0]]}")


def to_picture(p: Array, below: bool, a: Anatomy, m: Moment, origin: Point) -> Array:
    """Where points (n, 2) of the portrait are in the image; `below` chooses the skin below the mouth."""
    return camera(pose(turn((lower if below else upper)(p, a, m), a, m), a, m), a, m, origin)


def to_skull(q: Array, a: Anatomy, m: Moment, origin: Point) -> Array:
    """From the image (n, 2) to the portrait before any expression: where the teeth are."""
    p = invert(lambda x: pose(x, a, m), camera_back(q, a, m, origin))
    return invert(lambda x: turn(x, a, m), p)


def to_skin(k: Array, below: bool, a: Anatomy, m: Moment) -> Array:
    """From skull coordinates (n, 2) to the portrait's skin of one branch."""
    branch = lower if below else upper
    return invert(lambda x: branch(x, a, m), k)
