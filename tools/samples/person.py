"""A person to the waist in dark clothes before a plain wall: the head of a portrait on a drawn body, talking a little.

Places of the person are in the portrait's pixels; `Place` says where they are in the image. The ground truth of the
face is its upright box from brow to chin, as a frontal Haar cascade draws it, which goes with the head and its scale
alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np
from hands_draw import LIGHT
from heads_cutout import Cutout, astronaut_cutout, edges
from heads_grounds import FINE
from layers import reduced
from portraits import MARGIN, Picture, Portrait, astronaut
from render import SIZE, face
from timeline import Array, syllables, track
from warp import Moment

FACE = (223.0, 114.0, 97.0)  # x and y of the middle of the face's box, and its side
SHOULDERS = ((109.0, 281.0), (333.0, 281.0))  # the joints, as seen
BODY_AT = (-180.0, 120.0)  # the first pixel of the image of the body
_BODY = (800, 600)  # its width and height
# right half of the outline of the body, from the collar down, relative to the middle; the left one mirrors it
_OUTLINE = ((0, 164), (26, 166), (40, 171), (44, 184), (45, 200), (52, 212), (74, 222), (104, 232), (128, 244),
            (142, 262), (146, 290), (140, 330), (132, 380), (128, 430), (128, 480), (132, 560), (138, 720))  # fmt: skip
_MIDDLE = 221.0


@dataclass(frozen=True)
class Place:
    """Where the portrait's `anchor` is in the image, and how many pixels of the image one of its pixels is."""

    x: float
    y: float
    k: float
    anchor: tuple[float, float] = FACE[:2]

    def see(self, px: float, py: float) -> tuple[float, float]:
        """A point of the portrait in the image."""
        return self.x + self.k * (px - self.anchor[0]), self.y + self.k * (py - self.anchor[1])

    def lay(self, layer: Picture, at: tuple[float, float] = (0.0, 0.0)) -> Picture:
        """A layer of the portrait, whose first pixel is its point `at`, in an image FINE times too large."""
        x, y = self.see(*at)
        k, half = FINE * self.k, (FINE - 1) / 2
        move = np.array([[k, 0, FINE * x + half], [0, k, FINE * y + half]])
        size = (SIZE[0] * FINE, SIZE[1] * FINE)
        # the body's cloth is finer than the image; the wall is drawn in the picture's own grid
        return np.asarray(cv2.warpAffine(layer, move, size, flags=cv2.INTER_LINEAR), dtype=np.float32)


@dataclass(frozen=True)
class Person:
    """The person's layers, premultiplied BGR and alpha, and how the face moves, by the names of warp.Moment."""

    portrait: Portrait  # its skin is the cut-out head, with alpha
    cutout: Cutout
    body: Picture
    moves: Mapping[str, Array]

    def head(self, t: int) -> tuple[Picture, tuple[float, float]]:
        """The head in frame t, and the portrait's point at its first pixel."""
        moment = Moment(**{name: float(values[t]) for name, values in self.moves.items()})
        return face(self.portrait, moment)[0], self.portrait.origin


def _noise(rng: np.random.Generator, sigma_x: float, sigma_y: float) -> Array:
    raw = cv2.GaussianBlur(rng.normal(0.0, 1.0, _BODY[::-1]), (0, 0), sigmaX=sigma_x, sigmaY=sigma_y)
    return np.asarray(raw / raw.std(), dtype=np.float64)


def sweater(cloth: tuple[float, float, float], seed: int) -> Picture:
    """A knitted pullover with a turtleneck, drawn about a round body with folds, (H, W, 4)."""
    rng = np.random.default_rng(seed)
    half = np.array(_OUTLINE, dtype=np.float64)
    along = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(half, axis=0).T))])
    fine = np.arange(0, along[-1], 2.0)
    right = np.stack([np.interp(fine, along, column) for column in half.T], axis=1)
    right = cv2.GaussianBlur(right, (1, 0), sigmaX=0.1, sigmaY=3.0, borderType=cv2.BORDER_REPLICATE)
    outline = np.concatenate([right, (right * (-1, 1))[::-1]]) + np.array([_MIDDLE, 0.0]) - BODY_AT
    mask = np.zeros(_BODY[::-1], np.uint8)
    cv2.fillPoly(mask, [np.rint(outline * 16).astype(np.int32)], 255, cv2.LINE_AA, 4)
    y, x = np.mgrid[: _BODY[1], : _BODY[0]].astype(np.float64)
    x, y = x + BODY_AT[0] - _MIDDLE, y + BODY_AT[1]
    inside = cv2.distanceTransform((mask > 127).astype(np.uint8), cv2.DIST_L2, 5).astype(np.float64)
    depth = 60.0 * np.sqrt(1 - (1 - np.clip(inside / 80.0, 0, 1)) ** 2)
    neck = 1 / (1 + np.exp((y - 208.0) / 3.0))
    folds = 2.6 * _noise(rng, 26.0, 9.0) + 1.3 * _noise(rng, 9.0, 22.0)
    seams = -3.0 * np.exp(-(((np.abs(x) - 112 + 0.16 * (y - 268)) / 3.0) ** 2)) * (y > 236) * (y < 380)
    rolled = 3.0 * np.exp(-(((y - 203.0 + 0.004 * x**2) / 5.0) ** 2)) * (np.abs(x) < 52)
    bumpy = cv2.GaussianBlur(depth + folds * (1 - neck) + seams + rolled + 1.2 * np.sin(x * 1.1) * neck, (0, 0), 1.6)
    bumpy += 0.16 * _noise(rng, 0.8, 1.6)
    gx, gy = cv2.Sobel(bumpy, cv2.CV_64F, 1, 0, scale=0.125), cv2.Sobel(bumpy, cv2.CV_64F, 0, 1, scale=0.125)
    facing = (-gx * LIGHT[0] - gy * LIGHT[1] + LIGHT[2]) / np.sqrt(gx**2 + gy**2 + 1)
    light = 0.34 + 0.80 * np.clip((facing + 0.3) / 1.3, 0, 1)
    chin = 1 - 0.55 * np.exp(-(((y - 176.0) / 22.0) ** 2)) * (np.abs(x) < 70)  # the chin's shadow on the collar
    alpha = cv2.GaussianBlur(mask.astype(np.float64) / 255, (0, 0), 0.9)[..., None]
    colour = np.array(cloth) * np.clip(light * chin, 0.15, 1.2)[..., None]
    return np.asarray(np.concatenate([colour * alpha, alpha], axis=2), dtype=np.float32)


def wall(bgr: tuple[float, float, float], seed: int) -> Picture:
    """A plastered wall under a lamp at the upper left, FINE times too large."""
    rng = np.random.default_rng(seed)
    w, h = SIZE[0] * FINE, SIZE[1] * FINE
    y, x = np.mgrid[:h, :w].astype(np.float64)
    lamp = 1.06 - 0.20 * np.hypot(x / w - 0.3, 0.8 * (y / h - 0.2))

    def noise(sigma: float) -> Array:
        raw = cv2.GaussianBlur(rng.normal(0, 1, (h, w)), (0, 0), sigma)
        return np.asarray(raw / raw.std(), dtype=np.float64)

    plaster = 0.028 * noise(1.6 * FINE) + 0.022 * noise(5.0 * FINE) + 0.018 * noise(22.0 * FINE)
    return np.asarray(np.array(bgr) * (lamp * (1 + plaster))[..., None], dtype=np.float32)


def wander(rng: np.random.Generator, frames: int, every: int, strength: float) -> Array:
    """(frames,) a value that starts at 0 and goes smoothly to a new place in -strength..strength `every` frames."""
    at = range(0, frames + every, every)
    values = [0.0, *rng.uniform(-strength, strength, len(at) - 1)]
    return track(list(zip(at, (float(v) for v in values), strict=True)), frames)


def person(cloth: tuple[float, float, float], seed: int, frames: int, talks: tuple[tuple[int, int], ...]) -> Person:
    """Eileen Collins's head on a drawn body, talking in the spans of frames given, and looking about a little."""
    cutout, portrait = astronaut_cutout(), astronaut()
    margin = ((MARGIN, MARGIN), (MARGIN, MARGIN), (0, 0))
    inside = np.dstack([portrait.mouth, np.ones(portrait.mouth.shape[:2], np.float32)])
    cut = replace(portrait, skin=np.pad(cutout.head, margin), mouth=inside.astype(np.float32))
    rng = np.random.default_rng(seed)
    opening, rounding = syllables(rng, talks, frames)

    def rove(strength: float) -> Array:
        return wander(rng, frames, 24, strength)

    moves = {"jaw": 0.20 * opening, "pucker": 0.12 * rounding, "yaw": rove(0.12), "pitch": rove(0.05),
             "smile": rove(0.08), "brow": np.abs(rove(0.8)), "close": 0.4 + 0.4 * rove(1.0)}  # fmt: skip
    return Person(cut, cutout, sweater(cloth, seed + 1), moves)


def prove_face(who: Person, place: Place, box: tuple[float, float, float, float]) -> None:
    """The rendered head lies about the box (middle, width, height) as the portrait's head about the portrait's face.

    Raises:
        AssertionError: the head's outline above the chin, measured in the image, is off by 0.3 px or more.
    """
    skull = np.dstack([who.cutout.skull] * 4)
    alpha = reduced(place.lay(skull))[..., 3]
    found = np.array([*edges(alpha.max(axis=0)), *edges(alpha.max(axis=1))])
    left, top, right, bottom = who.cutout.box
    x, y, w, h = box
    expected = np.array([x + w / FACE[2] * (left - FACE[0]), x + w / FACE[2] * (right - FACE[0]),
                         y + h / FACE[2] * (top - FACE[1]), y + h / FACE[2] * (bottom - FACE[1])])  # fmt: skip
    assert np.abs(found - expected).max() < 0.3, f"the head is drawn from {found}, the ground truth says {expected}"
