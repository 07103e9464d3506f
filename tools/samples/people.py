"""A small gallery of people: five images each of the two in the portraits, and of four who are made up.

For recognition beside tracking, as in Zhou, Chellappa and Moghaddam, "Adaptive Visual Tracking and Recognition using
Particle Filters" (ICME 2003), whose gallery has faces in frontal view. `zoom.mp4` shows `hopper`, `lamp.mp4` `collins`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import people_paint as paint
from closeups import alone, placed, rotation
from faces_passerby import hopper_cutout
from heads_cutout import Cutout, astronaut_cutout
from heads_grounds import FINE
from lamp import SQUARE, Lamps, normals, relief
from layers import over, reduced
from numpy.typing import NDArray
from people_paint import Bump, Colour, reshaped
from portraits import Picture, Portrait, astronaut, hopper
from render import SIZE, expose, face
from warp import Moment
from zoom import SQUARE as HOPPER

SIDE = 160  # of an image
PICTURES = 5
QUALITY = 88  # of JPEG


@dataclass(frozen=True)
class Person:
    """How somebody is made of a portrait: painted on its head, with other proportions, and what the face does."""

    head: Callable[[Picture], Picture] = lambda layer: layer
    bumps: tuple[Bump, ...] = ()
    suit: Colour | None = None  # the body's grey takes this colour
    rest: Moment = field(default_factory=Moment)
    seed: int = 0


def _otto(head: Picture) -> Picture:
    head = paint.dyed(head, (0.22, 0.24, 0.28), 1.1)
    return paint.brows(paint.beard(head, (30.0, 36.0, 48.0), 301), (30.0, 34.0, 44.0), 303, 5.5)


def _ines(head: Picture) -> Picture:
    head = paint.dyed(head, (0.26, 0.25, 0.25), 1.0)
    return paint.glasses(
        paint.long_hair(head, (30.0, 29.0, 31.0), 311), (30.0, 26.0, 48.0), (2.5, 2.5), (17.5, 14.5), 2.0, 0.0
    )


def _viktor(head: Picture) -> Picture:
    head = paint.dyed(head, (1.62, 1.62, 1.6), 0.75)
    head = paint.brows(paint.moustache(head, (206.0, 212.0, 216.0), 321), (150.0, 156.0, 162.0), 322, 4.0)
    return paint.glasses(head, (40.0, 44.0, 56.0), (2.0, 0.5), (16.0, 11.0), 3.0, 0.0)


def _marta(head: Picture) -> Picture:
    head = paint.freckles(paint.dyed(head, (0.30, 0.46, 0.86), 1.1), 331)
    return paint.cap(head, ((120.0, 70.0, 40.0), (208.0, 214.0, 218.0)), 332)


# the two of the portraits, and four who are nobody
PEOPLE: Mapping[str, Person] = {
    "collins": Person(seed=201),
    "hopper": Person(seed=202),
    "otto": Person(
        _otto,
        ((224, 165, 60, 26, 0, 0, 0.20, 0.0), (224, 124, 15, 17, 0, 2, 0.22, 0.08),
         (224, 102, 46, 9, 0, 0, -0.06, -0.12), (166, 80, 22, 50, 15, 0, 0, 0), (290, 80, 22, 50, -17, 0, 0, 0),
         (224, 68, 44, 11, 0, -10, 0, 0)),
        (52.0, 66.0, 58.0), Moment(close=1.0, smile=-0.22), 203,
    ),
    "ines": Person(
        _ines,
        ((224, 130, 70, 60, 0, 0, -0.10, 0.0), (224, 103, 40, 12, 0, 1, 0.04, 0.12),
         (224, 148, 20, 12, 0, 0, -0.12, 0.15)),
        (120.0, 70.0, 110.0), Moment(close=1.0, smile=-0.25, pucker=0.06), 204,
    ),
    "viktor": Person(
        _viktor,
        ((224, 68, 50, 11, 0, -11, 0, 0), (224, 122, 14, 18, 0, 4, 0.28, 0.15), (224, 172, 40, 16, 0, 6, -0.08, 0.0),
         (224, 103, 30, 10, 0, 1, -0.10, -0.10), (166, 85, 24, 50, 13, 0, 0, 0), (290, 85, 24, 50, -14, 0, 0, 0)),
        (96.0, 74.0, 52.0), Moment(close=0.9, smile=-0.2), 205,
    ),
    "marta": Person(
        _marta,
        ((224, 140, 60, 40, 0, 0, 0.14, -0.06), (224, 124, 14, 12, 0, -3, -0.12, -0.15),
         (224, 102, 44, 10, 0, 0, 0.08, 0.10), (224, 146, 22, 12, 0, 2, 0.08, 0.10)),
        (60.0, 110.0, 60.0), Moment(close=0.9, smile=-0.12), 206,
    ),
}  # fmt: skip


@cache
def _source(name: str) -> tuple[Portrait, Cutout, tuple[float, float, float]]:
    if name == "hopper":
        return hopper(), hopper_cutout(), HOPPER
    return astronaut(), astronaut_cutout(), SQUARE


@cache
def _surface() -> Picture:
    """Normals of the head in NASA's portrait."""
    return normals(relief(astronaut_cutout()))


def _suited(body: Picture, colour: Colour) -> Picture:
    out = body.copy()
    grey = body[..., :3].mean(axis=2, keepdims=True) / 110.0
    out[..., :3] = np.clip(grey * np.array(colour), 0, 250) * (body[..., 3:] > 0)
    return out


def _ground(rng: np.random.Generator) -> Picture:
    """A blurred wall of some cool colour."""
    y, x = np.mgrid[: SIZE[1], : SIZE[0]].astype(np.float64)
    low = cv2.GaussianBlur(rng.normal(0, 1, (SIZE[1], SIZE[0])), (0, 0), 22.0)
    slope = rng.uniform(-0.25, 0.25) * (x / SIZE[0] - 0.5) + rng.uniform(-0.2, 0.1) * (y / SIZE[1] - 0.5)
    tone = 1.0 + slope + 0.09 * low / low.std()
    out = rng.uniform(95, 170) * np.array([1.06, 1.0, 0.93]) * tone[..., None]
    return np.asarray(out, dtype=np.float32)


def picture(name: str, i: int) -> NDArray[np.uint8]:
    """Picture i of a person, (SIDE, SIDE, 3) BGR: its own light, ground, expression and framing."""
    person = PEOPLE[name]
    rng = np.random.default_rng([person.seed, i])
    portrait, cutout, square = _source(name)
    head = person.head(cutout.head)
    cutout = replace(cutout, head=head)
    shown = alone(portrait, cutout)
    r = person.rest
    moment = replace(
        r, yaw=rng.uniform(-0.06, 0.06), pitch=rng.uniform(-0.05, 0.05), smile=r.smile + rng.uniform(-0.07, 0.05),
        jaw=max(0.0, rng.uniform(-0.08, 0.06)), brow=rng.uniform(0.0, 0.7), pull=rng.uniform(-0.2, 0.2),
    )  # fmt: skip
    # the relief is NASA's portrait's, laid square on square
    k = square[2] / SQUARE[2]
    move = np.array([[k, 0, square[0] - k * SQUARE[0]], [0, k, square[1] - k * SQUARE[1]]])
    h, w = cutout.head.shape[:2]
    surface = cv2.warpAffine(_surface(), move, (w, h), borderMode=cv2.BORDER_REPLICATE)
    side = rng.uniform(0.1, 0.4)
    strength = np.array([[side, 0.0] if rng.uniform() < 0.5 else [0.0, side]])
    still = np.array([moment.yaw]), np.zeros(1), np.zeros((1, 2))
    lit = Lamps(np.asarray(surface, np.float32), np.zeros((1, 1, 3), np.float32), (1, 1), strength, *still)
    layer, above, _ = face(shown, moment)
    where = above.astype(np.float32)
    layer[..., :3] *= cv2.remap(lit.at(0)[0], where[..., 0], where[..., 1], cv2.INTER_LINEAR)
    layer = reshaped(layer, shown.origin, person.bumps)
    middle = np.array([square[0] + square[2] / 2 - 0.5, square[1] + square[2] / 2 - 0.5])
    at = np.array([SIZE[0] / 2, SIZE[1] / 2 + 2.0]) + rng.uniform(-7, 7, 2)
    about = rng.uniform(84, 104) / square[2] * rotation(np.radians(rng.uniform(-4, 4)))
    neck = np.array(portrait.anatomy.neck)
    body = cutout.body if person.suit is None else _suited(cutout.body, person.suit)
    fine = cv2.resize(_ground(rng), (SIZE[0] * FINE, SIZE[1] * FINE), interpolation=cv2.INTER_LINEAR)
    fine = over(np.asarray(fine, np.float32), placed(body, about, neck, at + about @ (neck - middle)))
    fine = over(fine, placed(layer, about, middle - np.array(shown.origin), at))
    left, top = (SIZE[0] - SIDE) // 2, (SIZE[1] - SIDE) // 2
    seen = reduced(fine)[top : top + SIDE, left : left + SIDE]
    return expose(np.clip(seen, 0, None), rng.uniform(0.72, 1.0), rng)


def write_gallery(folder: Path) -> None:
    """<folder>/<person>/<number>.jpg"""
    for name in PEOPLE:
        (folder / name).mkdir(parents=True, exist_ok=True)
        for i in range(PICTURES):
            done, data = cv2.imencode(".jpg", picture(name, i), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
            assert done
            (folder / name / f"{i + 1}.jpg").write_bytes(data.tobytes())
