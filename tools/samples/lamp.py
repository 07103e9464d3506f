"""The clip of changing light: a lamp beside the face comes and goes, the exposure falls to two fifths, the head turns.

After "pose and illumination variations" of Zhou, Chellappa and Moghaddam, "Adaptive Visual Tracking and Recognition
using Particle Filters" (ICME 2003). Who is seen is Eileen Collins. The lamp's light falls on the relief of her face.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from clip_files import Clip
from closeups import Closeup, alone, closeup_clip
from faces_ground import brick_wall
from heads import path, unsteady
from heads_cutout import Cutout, astronaut_cutout
from heads_grounds import FINE
from portraits import Picture, astronaut
from timeline import Array, Keys, syllables, track
from warp import Moment

FRAMES = 250
SQUARE = (175.0, 65.0, 99.0)  # left, top and side of the face in the portrait, as the frontal cascade finds it
BASE = 0.66  # clip pixels for one of the portrait, at scale 1
_WARM = (0.84, 0.96, 1.10)  # of the lamp, BGR
_CORNER = (-45.0, -40.0)
# of the face's relief: column, row, spreads and height of a hill, all in the portrait's pixels
_HILLS = ((223, 128, 7.5, 7.5, 10.0), (223, 113, 7.5, 13.0, 6.0), (217, 129, 4.0, 4.0, 2.0), (231, 129, 4.0, 4.0, 2.0),
          (204, 107, 11.0, 6.0, -6.5), (243, 107, 11.0, 6.0, -6.5), (223, 93, 34.0, 6.0, 4.0),
          (196, 126, 12.0, 10.0, 5.0), (251, 126, 12.0, 10.0, 5.0), (223, 146, 20.0, 7.0, 4.5),
          (223, 159, 15.0, 3.0, -3.0), (223, 170, 11.0, 7.0, 6.0))  # fmt: skip


def relief(cutout: Cutout) -> Picture:
    """The height of the head over the portrait, (H, W) in its pixels: an oval with nose, eyes and cheeks, and hair."""
    h, w = cutout.head.shape[:2]
    y, x = np.mgrid[:h, :w].astype(np.float64)
    rho2 = ((x - 225.0) / 80.0) ** 2 + ((y - 100.0) / 98.0) ** 2
    out = 84.0 * np.sqrt(np.clip(1.0 - rho2, 0.03, None))
    for at_x, at_y, wide, high, top in _HILLS:
        out += top * np.exp(-0.5 * (((x - at_x) / wide) ** 2 + ((y - at_y) / high) ** 2))
    grey = cutout.head[..., :3].mean(axis=2)
    strands = cv2.GaussianBlur(grey, (0, 0), 1.2) - cv2.GaussianBlur(grey, (0, 0), 6.0)
    return np.asarray(cv2.GaussianBlur(out + 0.03 * strands, (0, 0), 1.5), dtype=np.float32)


def swollen(alpha: Picture, most: float) -> Picture:
    """A relief for what has an outline alone: it rises from there like a quarter of a circle of radius `most`."""
    away = np.minimum(cv2.distanceTransform((alpha > 0.5).astype(np.uint8), cv2.DIST_L2, 5), most)
    return np.asarray(cv2.GaussianBlur(np.sqrt(away * (2 * most - away) + 1), (0, 0), 6.0), dtype=np.float32)


def normals(height: Picture) -> Picture:
    """(H, W, 3) of unit length: right, down, to the camera."""
    gy, gx = np.gradient(height.astype(np.float64))
    out = np.stack([-gx, -gy, np.ones_like(gx)], axis=2)
    return np.asarray(out / np.linalg.norm(out, axis=2, keepdims=True), dtype=np.float32)


@dataclass(frozen=True)
class Lamps:
    """How the lamps light a frame: strengths (n, 2) of the one at the left and the one at the right, 0..1."""

    head: Picture  # normals in the portrait
    body: Picture
    ground: tuple[int, int]  # (H, W) of the ground, in its pixels
    strength: Array
    yaw: Array  # (n,) of the head, radians
    roll: Array  # (n,)
    camera: Array  # (n, 2)
    dim: float = 0.42  # how much of the room's light a lamp at full strength leaves

    def _on(self, surface: Picture, t: int, yaw: float, roll: float) -> Picture:
        """The factor of the light (H, W, 3) on a surface that has been turned since its normals were taken."""
        out = np.ones((*surface.shape[:2], 3)) * self._room(t)
        for side, strength in zip((-1.0, 1.0), self.strength[t], strict=True):
            x, y, z = np.array([side * 0.86, -0.26, 0.44])
            x, y = np.cos(roll) * x + np.sin(roll) * y, np.cos(roll) * y - np.sin(roll) * x
            x, z = np.cos(yaw) * x - np.sin(yaw) * z, np.cos(yaw) * z + np.sin(yaw) * x
            fall = np.clip(surface @ np.array([x, y, z], dtype=np.float32), 0, None)
            # what the portrait shows was lit from the camera: the rim was darker there
            fall = fall / (0.35 + 0.65 * surface[..., 2])
            out += 1.1 * strength * np.tanh(fall)[..., None] * np.array(_WARM)
        return np.asarray(out, dtype=np.float32)

    def _room(self, t: int) -> float:
        return 1.0 - (1.0 - self.dim) * float(self.strength[t].max())

    def at(self, t: int) -> tuple[Picture, Picture, Picture]:
        """Factors of the light on head, body and ground."""
        h, w = self.ground
        y, x = np.mgrid[:h, :w].astype(np.float32) / FINE
        x, y = x + np.float32(_CORNER[0] + self.camera[t, 0]), y + np.float32(_CORNER[1] + self.camera[t, 1])
        wall = np.full((h, w, 3), self._room(t), np.float32)
        for middle, strength in zip((-30.0, 350.0), self.strength[t], strict=True):
            glow = np.exp(-np.hypot(x - middle, 0.8 * (y - 70.0)) / 110.0)
            wall += np.float32(1.1 * strength) * glow[..., None] * np.array(_WARM, np.float32)
        yaw, roll = float(self.yaw[t]), float(self.roll[t])
        return self._on(self.head, t, yaw, roll), self._on(self.body, t, 0.0, 0.5 * roll), wall


def lamp_shot() -> Closeup:
    """A lamp at the left from 22 to 84 and from 128 to 180, one at the right from 196 to 236; dark from 88 to 124."""
    n = FRAMES
    cutout, portrait = astronaut_cutout(), astronaut()
    opening, rounding = syllables(np.random.default_rng(91), [(6, 40), (140, 172)], n)
    keys: dict[str, Keys] = {
        "smile": [(0, 0), (30, 0), (48, -0.1), (90, -0.1), (120, 0.04), (150, -0.08), (200, 0.04), (249, 0)],
        "close": [(0, 0), (30, 0), (44, 0.8), (92, 0.8), (112, 0), (136, 0), (146, 0.8), (176, 0.8), (200, 0),
                  (249, 0)],
        "yaw": [(0, 0), (14, 0), (32, 0.2), (50, -0.1), (70, -0.32), (82, -0.28), (104, 0.06), (122, 0.32), (134, 0.28),
                (156, -0.06), (176, -0.28), (198, 0.08), (220, 0.26), (249, 0.0)],
        "pitch": [(0, 0), (30, 0.05), (60, -0.06), (100, 0.06), (140, -0.05), (180, 0.05), (220, -0.04), (249, 0)],
        "brow": [(0, 0), (80, 0), (90, 0.8), (110, 0), (249, 0)],
    }  # fmt: skip
    values = {name: track(k, n) for name, k in keys.items()}
    values |= {"jaw": 0.2 * opening, "pucker": 0.12 * rounding}
    camera = unsteady(n, 92, 0.4) + path(
        [(0, 0), (40, -14), (90, 12), (140, -8), (190, 16), (249, 0)],
        [(0, 0), (60, 5), (130, -6), (200, 4), (249, 0)],
        n,
    )
    head = unsteady(n, 93, 0.4) + path(
        [(0, 196), (12, 194), (44, 120), (62, 112), (88, 176), (108, 216), (124, 208), (150, 138), (168, 118),
         (196, 164), (216, 212), (234, 186), (249, 170)],
        [(0, 104), (20, 102), (50, 116), (80, 98), (110, 118), (140, 96), (170, 112), (205, 98), (230, 112),
         (249, 106)],
        n,
    )  # fmt: skip
    scale = track([(0, 1), (16, 1), (52, 1.2), (90, 0.92), (122, 0.85), (156, 1.12), (182, 1.25), (216, 0.95),
                   (249, 1.05)], n)  # fmt: skip
    roll = np.radians(track([(0, 0), (20, 2), (50, -4), (88, 5), (120, -3), (160, 5), (200, -5), (249, 1)], n))
    left = track([(0, 0), (22, 0), (40, 1), (62, 1), (84, 0), (128, 0), (148, 0.9), (160, 0.9), (180, 0), (249, 0)], n)
    right = track([(0, 0), (196, 0), (206, 1), (218, 1), (236, 0), (249, 0)], n)
    light = 0.9 * track([(0, 1), (70, 1), (92, 0.4), (112, 0.4), (146, 0.95), (184, 1.0), (204, 0.8), (240, 1.0),
                         (249, 1.0)], n)  # fmt: skip
    ground = brick_wall(410, 320)
    lit = Lamps(
        normals(relief(cutout)), normals(swollen(cutout.body[..., 3], 60.0)), ground.shape[:2],
        np.stack([left, right], axis=1), values["yaw"], roll, camera,
    )  # fmt: skip
    moments = [Moment(**{name: float(v[t]) for name, v in values.items()}) for t in range(n)]
    return Closeup(alone(portrait, cutout), cutout, SQUARE, ground, _CORNER, camera, head, BASE * scale, roll, moments,
                   light, 106, 20, lit.at)  # fmt: skip


def lamp() -> Clip:
    """The clip, with the ground truth of the face."""
    return closeup_clip(lamp_shot())
