"""The shape of a hand seen from above: tapered capsules about the bones, joined smoothly, with places on the skin.

Hand coordinates are pixels at scale 1, x to the right and y down, with the fingers up, of the hand at the left, which
has its thumb at the right; the other hand is its mirror image. The origin is the centre of the hand's box.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from timeline import smoothstep

Picture = NDArray[np.float32]
LAYERS = ("sdf", "height", "u", "v", "tint", "crease", "nail")
FINE = 3  # hands are drawn this many times finer than the clip, and reduced at the end
BOX = (56.0, 64.0)  # of palm and fingers at scale 1
SHIFT = (-4.0, 3.0)  # puts the box's centre at the origin
# for each finger: knuckle, angle from straight up (degrees), lengths of the phalanges, radii from knuckle to tip
FINGERS = {
    "index": ((9.6, -1.0), 9.0, (13.8, 8.8, 7.0), (4.0, 3.6, 3.2, 2.6)),
    "middle": ((3.2, -3.2), 0.5, (15.2, 10.0, 7.4), (4.1, 3.7, 3.3, 2.7)),
    "ring": ((-3.2, -1.8), -8.0, (14.0, 9.6, 7.4), (3.9, 3.5, 3.1, 2.6)),
    "little": ((-9.2, 2.0), -19.0, (11.0, 7.0, 6.4), (3.5, 3.0, 2.7, 2.2)),
}
THUMB = ((7.5, 21.0), (16.4, 10.5), (22.0, 2.0), (24.6, -5.2))
THUMB_RADII = (6.0, 4.3, 3.7, 2.7)
WRIST = (-0.2, 30.0)


@dataclass(frozen=True)
class Pose:
    """One hand at one frame: where the centre of its box is in the image, its scale, its turn, and its fingers."""

    x: float
    y: float
    scale: float = 1.0
    turn: float = 0.0  # radians, clockwise in the image
    curl: float = 0.1  # 0 straight, 1 a fist
    spread: float = 1.0  # of the fingers
    elbow: tuple[float, float] = (0.0, 400.0)  # in the image
    mirrored: bool = False
    shoulder: tuple[float, float] | None = None  # in the image; without one the sleeve goes on beyond the elbow

    def to_hand(self, x: Picture, y: Picture) -> tuple[Picture, Picture]:
        """Hand coordinates of points of the image."""
        dx, dy = (x - self.x) / self.scale, (y - self.y) / self.scale
        c, s = np.float32(np.cos(self.turn)), np.float32(np.sin(self.turn))
        u, v = c * dx + s * dy, -s * dx + c * dy
        return (-u if self.mirrored else u), v

    def to_picture(self, u: float, v: float) -> tuple[float, float]:
        """A point of the hand in the image."""
        u = -u if self.mirrored else u
        c, s = np.cos(self.turn), np.sin(self.turn)
        return float(self.x + self.scale * (c * u - s * v)), float(self.y + self.scale * (s * u + c * v))


@dataclass
class Surface:
    """What is seen at each fine pixel: signed distance to the outline, height, and a place on the skin."""

    sdf: Picture
    height: Picture
    u: Picture
    v: Picture
    tint: Picture = field(init=False)  # redness of knuckles and tips
    crease: Picture = field(init=False)
    nail: Picture = field(init=False)

    def __post_init__(self) -> None:
        self.tint, self.crease, self.nail = (np.zeros_like(self.sdf) for _ in range(3))

    def take(self, other: Surface, smooth: float) -> None:
        """Join the other one, where it is higher, with a seam as smooth as asked for."""
        over = other.height > self.height
        near = np.maximum(smooth - np.abs(other.height - self.height), 0) ** 2 / (4 * smooth)
        self.height = np.maximum(self.height, other.height) + near
        close = np.maximum(smooth - np.abs(other.sdf - self.sdf), 0) ** 2 / (4 * smooth)
        self.sdf = np.minimum(self.sdf, other.sdf) - close
        for name in LAYERS[2:]:
            setattr(self, name, np.where(over, getattr(other, name), getattr(self, name)))

    def take_at(self, rows: slice, cols: slice, other: Surface, smooth: float) -> None:
        """Join one that is known in a window of the grid only."""
        part = Surface(*(getattr(self, name)[rows, cols] for name in LAYERS[:4]))
        for name in LAYERS[4:]:
            setattr(part, name, getattr(self, name)[rows, cols])
        part.take(other, smooth)
        for name in LAYERS:
            getattr(self, name)[rows, cols] = getattr(part, name)


def step(u: Picture) -> Picture:
    """0 up to u = 0, 1 from u = 1 on, and smooth between."""
    return np.asarray(smoothstep(np.asarray(u, np.float64)), dtype=np.float32)


def capsule(
    x: Picture, y: Picture, a: tuple[float, ...], b: tuple[float, ...], radii: tuple[float, float]
) -> tuple[Surface, Picture, Picture]:
    """A tapered capsule between points (x, y, z); also the way along its axis 0..1, unbounded, and across -1..1."""
    ax, ay = b[0] - a[0], b[1] - a[1]
    length = max(float(np.hypot(ax, ay)), 1e-3)
    ex, ey = ax / length, ay / length
    along = np.asarray(((x - a[0]) * ex + (y - a[1]) * ey) / length, np.float32)
    across = np.asarray((x - a[0]) * -ey + (y - a[1]) * ex, np.float32)
    t = np.clip(along, 0, 1)
    r = radii[0] + (radii[1] - radii[0]) * t
    distance = np.hypot(x - a[0] - t * ax, y - a[1] - t * ay)
    q = distance / r
    # round on top; beyond the rim it falls steeply, so that it can be joined smoothly
    dome = np.where(q < 0.95, np.sqrt(np.maximum(1 - q * q, 0.0975)), 0.3122 - 3.04 * (q - 0.95))
    height = a[2] + (b[2] - a[2]) * t + r * dome
    sdf, high, aside = (np.asarray(v, np.float32) for v in (distance - r, height, across / r))
    return Surface(sdf, high, across, along * np.float32(length)), along, aside


def _blob(x: Picture, y: Picture, at: tuple[float, ...], radius: float) -> Picture:
    return np.asarray(np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / (2 * radius**2)), dtype=np.float32)


def palm(x: Picture, y: Picture) -> Surface:
    """The back of the hand: four bones side by side and the ball of the thumb, under one skin."""
    out: Surface | None = None
    for i, (knuckle, *_) in enumerate(FINGERS.values()):
        base = (5.4 - 3.5 * i, 27.0, 0.0)
        bone, _, _ = capsule(x, y, (*knuckle, 0.5), base, (4.6, 6.4))
        if out is None:
            out = bone
        else:
            out.take(bone, 3.0)
    assert out is not None
    web, _, _ = capsule(x, y, (9.0, 6.0, -2.5), (9.5, 20.0, -1.0), (4.5, 6.0))
    out.take(web, 3.5)
    out.u, out.v = x.copy(), y.copy()
    for knuckle, *_ in FINGERS.values():
        bump = _blob(x, y, knuckle, 2.2)
        out.height += 0.9 * bump
        out.tint += 0.7 * bump
    # between two knuckles the skin sinks in
    for (a, *_), (b, *_) in zip(list(FINGERS.values())[:-1], list(FINGERS.values())[1:], strict=True):
        out.height -= 0.9 * _blob(x, y, ((a[0] + b[0]) / 2, (a[1] + b[1]) / 2 - 0.5), 1.8)
    # two veins
    for x0, bend in ((-4.5, 1.2), (3.0, -1.0)):
        off = x - x0 - bend * np.sin(y / 4.5) - 0.12 * y
        out.height += 0.35 * np.exp(-((off / 0.9) ** 2)) * step((y - 3) / 4.0) * step((24 - y) / 5.0)
    return out


def _digit(x: Picture, y: Picture, joints: list[tuple[float, ...]], radii: tuple[float, ...], seed: float) -> Surface:
    """A finger along its joints (x, y, z), with creases over the joints and a nail on the last phalanx."""
    out: Surface | None = None
    way = 0.0
    last = len(joints) - 2
    for i in range(last + 1):
        a, b = joints[i], joints[i + 1]
        part, along, across = capsule(x, y, a, b, (radii[i], radii[i + 1]))
        length = float(np.hypot(b[0] - a[0], b[1] - a[1]))
        full = float(np.linalg.norm(np.subtract(b, a)))
        part.u, part.v = part.u + np.float32(seed), part.v + np.float32(way + 31 * seed)
        flat = np.clip(1 - across**2, 0, 1)
        if i > 0:
            knuckle = np.exp(-((along * length / 2.0) ** 2))
            part.height += 0.35 * knuckle * flat
            part.tint += 0.55 * knuckle
            for line in (-1.3, 0.0, 1.3):
                part.crease += (0.9 if line == 0 else 0.5) * np.exp(-(((along * length - line) / 0.42) ** 2)) * flat
        if i == last:
            facing = length / full  # a nail of a bent finger is seen aslant
            p = (along * length - 0.80 * length) / max(2.9 * facing, 0.4)
            part.nail = np.clip((1.0 - np.sqrt(p**2 + (across / 0.68) ** 4)) * 4.0, 0, 1).astype(np.float32)
            part.tint += 0.5 * step((along - 0.3) / 0.5)
        way += full
        if out is None:
            out = part
        else:
            out.take(part, 0.8)
    assert out is not None
    return out


def _joints(name: str, curl: float, spread: float) -> list[tuple[float, ...]]:
    """Knuckle to tip (x, y, z) of a finger: every joint bends down by its share of the curl."""
    (x, y), angle, lengths, _ = FINGERS[name]
    side = np.radians(angle) * spread
    z, bend = 0.0, 0.0
    out: list[tuple[float, ...]] = [(x, y, z)]
    for length, (rest, more) in zip(lengths, ((-0.06, 0.85), (0.20, 1.25), (0.10, 0.75)), strict=True):
        bend += rest + more * curl
        reach = length * np.cos(bend)
        x, y, z = x + reach * np.sin(side), y - reach * np.cos(side), z - length * np.sin(bend)
        out.append((float(x), float(y), float(z)))
    return out


def _thumb(curl: float, spread: float) -> list[tuple[float, ...]]:
    points = np.array(THUMB)
    turn = np.radians(-26.0 * curl - 8.0 * (1.0 - spread))  # towards the fingers
    c, s = np.cos(turn), np.sin(turn)
    turned = (points - points[0]) @ np.array([[c, s], [-s, c]]) + points[0]
    return [(float(x), float(y), -2.0 - 1.0 * i - 2.5 * curl * i) for i, (x, y) in enumerate(turned)]


def digits(x: Picture, y: Picture, pose: Pose) -> Iterator[tuple[slice, slice, Surface]]:
    """Each finger, in the window of the grid that it lies in."""
    chains = [(_joints(name, pose.curl, pose.spread), FINGERS[name][3], 40.0 + 17 * i) for i, name in
              enumerate(FINGERS)]  # fmt: skip
    chains.append((_thumb(pose.curl, pose.spread), THUMB_RADII, 150.0))
    for joints, radii, seed in chains:
        away = np.full(x.shape, np.inf, np.float32)
        for jx, jy, _ in joints:
            away = np.minimum(away, np.hypot(x - jx, y - jy))
        rows, cols = np.nonzero(away < 15)
        if len(rows):
            window = slice(rows.min(), rows.max() + 1), slice(cols.min(), cols.max() + 1)
            yield *window, _digit(x[window], y[window], joints, radii, seed)
