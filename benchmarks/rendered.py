"""Clips of a covered face in random scenes, from the building blocks of the sample clips, with exact ground truth.

    python benchmarks/rendered.py OUT --seeds 0-9
    python benchmarks/rendered.py OUT --seeds 3 --kind object --grey

Settings chosen on a few fixed clips fit these few; of such clips there are as many as wanted. For each seed and kind
it writes OUT/<kind>-<seed>.mp4, with the ground truth and the init file beside it. The kinds are

    object    a seated person holds a map or a book before her face, from any side, whole or in part
    passer    another person walks past before the seated one
    gestures  one hand or both pass over the face, or stay before it

Target `face`, part `box`, is that of the sample clips: the frontal cascade's square, which goes with the head and its
scale, `hidden` while more than half of it is covered. Each frame is held to it by the same proofs. The other parts are
points, nose, mouth_left, mouth_right, lip_upper and lip_lower, which follow the expression and the turn of the head
too; each is `hidden` while more than half of a small square about it is covered, a fifth of the mouth's width in side.
A seed always gives the same clip; --grey takes its colours away. Needs the `samples` extra.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import product
from pathlib import Path
from unittest import mock

import cv2
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent.parent / "tools" / "samples"))

import faces
from clip_files import Clip, TruthRow, fastest, start_of, write_init, write_truth, write_video
from faces_ground import brick_wall, papered_wall
from faces_map import FINE as SHEET_FINE
from faces_map import SHEET, ZIGZAG, MapScene, city_map
from faces_passerby import PassingScene, hopper_cutout
from hands import skin
from hands_draw import Layer
from heads import ZOOM, Stage, unsteady
from heads_cutout import Cutout, astronaut_cutout
from heads_grounds import FINE, foliage, room
from occluders import book
from person import Place, person, prove_face, wall, wander
from person_hands import Motion, Scene, face_covered, loose, matched_skin, render
from portraits import Picture, Portrait, astronaut, hopper
from render import SIZE, expose, truth
from timeline import Array, syllables, track, unrest
from warp import Moment

Random = np.random.Generator
Frame = NDArray[np.uint8]
Stops = list[tuple[float, ...]]  # a frame, and the values there
Span = tuple[float, float]

FRAMES = (200, 251)
SCALE: Span = (0.75, 1.35)  # of the head, as a share of the first frame's
LIGHT: Span = (0.6, 1.3)  # as a share of the first frame's
EXPOSURE = 0.75  # in the first frame: leaves room for the light to rise
FIRST: Span = (0.95, 1.15)  # scale of the head in the first frame
FASTEST: Span = (2.5, 9.0)  # of the face in the image, pixels a frame: the limit of a clip
EVERY = (16, 40)  # frames from one pose, scale or light to the next
MOVES = (9, 26)  # frames from one place of the head to the next
PAN: Span = (0.0, 34.0)  # most that the camera goes to either side, in pixels
YAW, PITCH = 0.18, 0.06  # at most, in radians
TINT: Span = (0.85, 1.15)  # of each channel of the ground
SPOT = 0.2  # side of the square about a point that says if it is covered, in mouth widths
CALM = 15  # frames at the start and at the end in which nothing covers the face
LENGTH: Span = (8.0, 45.0)  # frames of an occlusion, from half in to half out
SHARE: Span = (0.4, 1.0)  # of the face that an object covers, when it does not cover all
WHOLE = 0.5  # probability that it does
PACE: Span = (4.0, 18.0)  # of an object that comes or goes, pixels a frame
WALK: Span = (1.8, 9.0)  # of the passer-by before the face, pixels a frame
HURRY: Span = (9.0, 15.0)  # of the passer-by elsewhere
HAND: Span = (3.0, 20.0)  # of a hand that comes or goes, pixels a frame
NEAR: Span = (1.0, 1.7)  # scale of a hand before the face: near the camera or not
GROUND, CORNER = (400, 310), (-40.0, -35.0)  # its size, and its first pixel's place while the camera is at rest
TITLES = ("ATLAS", "SIGNALS", "HARBOURS", "ALGEBRA", "BIRDS", "LETTERS", "OPTICS")
# where hands turn, from the middle of the face in pixels of the sample clip: x to the hand's own side, and y
AT = {"beside": (78.0, 16.0), "chest": (24.0, 84.0), "above": (66.0, -46.0), "other": (-70.0, 8.0)}
REST, REST_ZOOM = (76.0, 106.0), 0.64


@dataclass(frozen=True)
class Sitter:
    """A person who sits or walks past; `square` is left, top and side of the face in the portrait."""

    portrait: Portrait
    cutout: Cutout
    square: tuple[float, float, float]
    size: float  # of the drawing, so that both have faces of about one size
    cloth: tuple[float, float, float]

    @property
    def below(self) -> float:
        """How far under the middle of the head's box the body ends at scale 1, in pixels."""
        return (len(self.cutout.body) - 24 - (self.cutout.box[1] + self.cutout.box[3]) / 2) * ZOOM


def _sitters() -> list[Sitter]:
    """Eileen Collins and Grace Hopper, the latter made as wide as high: the proof of the face's place needs that."""
    cutout = hopper_cutout()
    beside = ((0, 0), (0, cutout.skull.shape[0] - cutout.skull.shape[1]))
    head, body = (np.pad(layer, (*beside, (0, 0))) for layer in (cutout.head, cutout.body))
    wide = replace(cutout, head=head, body=body, skull=np.pad(cutout.skull, beside))
    return [Sitter(astronaut(), astronaut_cutout(), faces.FACE, 1.0, (46.0, 96.0, 226.0)),
            Sitter(hopper(), wide, (85.5, 57.0, 132.0), 0.85, (44.0, 32.0, 30.0))]  # fmt: skip


def _goes(rng: Random, frames: int, strength: float, every: tuple[int, int] = EVERY) -> Array:
    """A quantity that starts at 0 and goes smoothly to new places in -strength..strength."""
    return wander(rng, frames, int(rng.integers(*every)), strength)


def _factor(rng: Random, frames: int, span: Span) -> Array:
    """A factor that starts at 1 and goes about in the span: in all of it, or in other clips in less."""
    w = _goes(rng, frames, rng.uniform(0.3, 1.0))
    return np.asarray(np.where(w < 0, span[0] ** -w, span[1] ** w), dtype=np.float64)


def _smooth(path: Array, sigma: float) -> Array:
    wide = path.reshape(len(path), -1)
    out = cv2.GaussianBlur(wide, (1, 0), sigmaX=0.1, sigmaY=sigma, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(out.reshape(path.shape), dtype=np.float64)


def _through(stops: Stops, frames: int) -> Array:
    """(values, frames) through the stops, which are in order; those of one frame are moved a frame apart."""
    t = [round(stop[0]) for stop in stops]
    for i in range(1, len(t)):
        t[i] = max(t[i], t[i - 1] + 1)
    return np.stack([track(list(zip(t, values, strict=True)), frames) for values in list(zip(*stops, strict=True))[1:]])


def _starts(rng: Random, frames: int, lengths: Sequence[float], gap: float) -> list[float]:
    """When to begin what takes so long, `gap` apart at least; the last are left out for want of time."""
    many = len(lengths)
    while many > 1 and sum(lengths[:many]) + gap * (many - 1) > frames - 2 * CALM:
        many -= 1
    free = max(frames - 2 * CALM - sum(lengths[:many]) - gap * (many - 1), 0.0)
    waits = np.sort(rng.uniform(0, free, many)).tolist()
    return [CALM + wait + sum(lengths[:i]) + gap * i for i, wait in enumerate(waits)]


def _ground(rng: Random) -> Picture:
    """One of the walls, or leaves, mirrored or not and tinted."""
    plain = np.pad(wall((150.0, 155.0, 148.0), int(rng.integers(1000))), ((70, 70), (80, 80), (0, 0)), "reflect")
    books = partial(room, edge=int(rng.integers(120, 280)))
    draw = (lambda *_: plain, brick_wall, papered_wall, foliage, books)[rng.integers(5)]
    out = np.clip(draw(*GROUND) * rng.uniform(*TINT, 3), 0, 255)[:, :: rng.choice([-1, 1])]
    return np.ascontiguousarray(out, dtype=np.float32)


def _camera(rng: Random, frames: int) -> Array:
    pan = np.stack([_goes(rng, frames, rng.uniform(*PAN)), _goes(rng, frames, 6.0)], axis=1)
    return pan + unsteady(frames, int(rng.integers(1000)), 0.35)


def _places(rng: Random, camera: Array, low: Array, high: Array) -> Array:
    """(frames, 2) places in the image between low and high (frames, 2), no faster than drawn for the clip."""
    limit, pan = rng.uniform(*FASTEST), camera * (1.0, 0.0)
    u = np.stack([_goes(rng, len(camera), 0.5, MOVES) + rng.uniform(-0.2, 0.2) for _ in range(2)], axis=1)
    way = np.clip(u, -0.5, 0.5) * np.maximum(high - low - np.ptp(pan, axis=0), 0)
    middle = (low + high) / 2 + pan - (pan.max(axis=0) + pan.min(axis=0)) / 2
    while np.hypot(*np.diff(middle + way, axis=0).T).max() > limit and np.ptp(way) > 1:
        way *= 0.92
    return np.asarray(middle + way, dtype=np.float64)


def _spots(portrait: Portrait, values: Mapping[str, Array], t: int, place: Place) -> dict[str, faces.Box]:
    """The points of a face whose expression is `values`, each the middle of its small square, in the image."""
    (x, y), moment = portrait.origin, Moment(**{name: float(v[t]) for name, v in values.items()})
    side = SPOT * place.k * portrait.anatomy.width
    return {part: (*place.see(x + u, y + v), side, side) for part, (u, v) in truth(portrait, moment).items()}


def _stage(rng: Random, who: Sitter, frames: int) -> tuple[Stage, faces.Spots]:
    """The person seated, who looks about and talks, nearer and farther, in changing light; and her points."""
    left, top, right, bottom = who.cutout.box
    scale = who.size * rng.uniform(*FIRST) * _factor(rng, frames, SCALE)
    half = np.stack([(right - left) * scale, (bottom - top) * scale], axis=1) * ZOOM / 2 + 5.0
    low = np.maximum(half, np.stack([half[:, 0], SIZE[1] - who.below * scale], axis=1))  # the body ends below the image
    high = np.minimum(np.array(SIZE) - half, np.stack([half[:, 0] + 1e3, low[:, 1] + 26], axis=1))
    camera = _camera(rng, frames)
    talk = int(rng.integers(5, frames // 2))
    opening, rounding = syllables(rng, [(talk, talk + frames // 3)], frames)
    values = {"yaw": _goes(rng, frames, YAW), "pitch": _goes(rng, frames, PITCH), "smile": _goes(rng, frames, 0.1),
              "close": 0.4 + _goes(rng, frames, 0.4), "jaw": 0.2 * opening, "pucker": 0.12 * rounding}  # fmt: skip
    look = lru_cache(2)(faces.looks(who.portrait, who.cutout, values))  # proof and drawing ask for the same frame
    stage = Stage(who.cutout, _ground(rng), CORNER, camera, _places(rng, camera, low, high), scale,
                  EXPOSURE * _factor(rng, frames, LIGHT), look, int(rng.integers(1000)))  # fmt: skip

    def spots(t: int) -> dict[str, faces.Box]:
        (x, y), middle = stage.head[t].tolist(), ((left + right) / 2, (top + bottom) / 2)
        return _spots(who.portrait, values, t, Place(x, y, ZOOM * float(scale[t]), middle))

    return stage, spots


def _sheet(rng: Random) -> Picture:
    """What is held: the map, or a book of its size."""
    if rng.uniform() < 0.5:
        return city_map()
    first, last = rng.choice(TITLES, 2, replace=False).tolist()
    cover = book(rng, *SHEET, (first, "AND", last), tuple(rng.integers(30, 190, 3).tolist()))
    pad = round((ZIGZAG + 2) * SHEET_FINE)
    layer = np.dstack([cover, np.ones(cover.shape[:2])])
    return np.pad(layer, ((pad, pad), (pad, pad), (0, 0))).astype(np.float32)


def _held(rng: Random, side: float, rest: Span, start: float, length: float, pace: float) -> Stops:
    """An occlusion: how far the sheet's middle is from that of the face, whose box has this side."""
    apart = (np.array(SHEET) + side) / 2  # where they touch
    beside = {(-1, 0): (-apart[0] - 34, rng.uniform(-20, 25)), (1, 0): (apart[0] + 34, rng.uniform(-20, 25)),
              (0, 1): (rng.uniform(-20, 20), apart[1] + 14)}  # fmt: skip
    come, go = (list(beside)[i] for i in rng.integers(3, size=2))
    spare = np.maximum((np.array(SHEET) - side) / 2 - 4, 0)
    to = rng.uniform(-spare, spare)
    if rng.uniform() > WHOLE:  # from the side it comes from, or from above
        edge = np.array(come if rng.uniform() < 0.6 else (0, -1))
        to = np.where(edge != 0, edge * (apart - rng.uniform(*SHARE) * side), to)
    way, back = (min(float(np.hypot(*(to - beside[end]))) / pace, length) for end in (come, go))
    end, place = start + length, (float(to[0]), float(to[1]))
    return [(start - way / 2 - 13, *rest), (start - way / 2, *beside[come]), (start + way / 2, *place),
            (end - back / 2, *place), (end + back / 2, *beside[go]), (end + back / 2 + 13, *rest)]  # fmt: skip


def object_clip(rng: Random) -> Clip:
    """The person holds a map or a book before the face, two or three times; else it is below, in sight or not."""
    frames, who = int(rng.integers(*FRAMES)), _sitters()[rng.integers(2)]
    (stage, spots), many = _stage(rng, who, frames), rng.integers(2, 4)
    lengths, paces = rng.uniform(*LENGTH, many), rng.uniform(*PACE, many)
    ways = np.minimum(150 / paces, lengths)  # frames to come, about
    rests, stops = rng.uniform() < 0.5, Stops()
    with mock.patch.object(faces, "FACE", who.square):
        at = np.array([faces.face_box(stage, t)[:3] for t in range(frames)])
        for i, start in enumerate(_starts(rng, frames, (lengths + ways).tolist(), 28)):
            side = float(at[min(int(start + lengths[i]), frames - 1), 2])
            rest = (rng.uniform(-15, 15), (side + SHEET[1]) / 2 + 14 if rests else 230.0)
            stops += _held(rng, side, rest, start + ways[i] / 2, lengths[i], paces[i])
        follows = _smooth(at[:, :2], rng.uniform(3, 9)) + unsteady(frames, int(rng.integers(1000)), 0.5)
        middle = follows + _through(stops, frames).T
        scene = MapScene(stage, middle, _goes(rng, frames, 0.12), _sheet(rng), skin(cloth=who.cloth, depth=1.0))
        seen = middle[:, 1] < SIZE[1] + SHEET[1] / 2 + 20
        return faces.face_clip(stage, lambda t: scene.things(t) if seen[t] else [], soft=5.0, dark=0.35, crf=20,
                               spots=spots)  # fmt: skip


def passer_clip(rng: Random) -> Clip:
    """The other person walks past up to three times, from either side, quickly or slowly."""
    frames, sitters = int(rng.integers(*FRAMES)), _sitters()
    who, other = (sitters[i] for i in rng.permutation(2))
    (stage, spots), hurry = _stage(rng, who, frames), rng.uniform(*HURRY)
    size, t = other.size * rng.uniform(0.95, 1.3), np.arange(frames)
    x, sides = np.full(frames, -300.0), np.ones(frames)
    halves = 60 / rng.uniform(*WALK, 3)  # frames from 60 pixels before the face to the face
    for start, half in zip(_starts(rng, frames, (2 * halves).tolist(), 780 / hurry), halves, strict=False):
        at, side = float((stage.head - stage.camera)[int(start + half), 0]), rng.choice([-1.0, 1.0])
        times = [start - 390 / hurry, start, start + 2 * half, start + 2 * half + 390 / hurry]
        line = np.interp(t, times, [165 - 355 * side, at - 60 * side, at + 60 * side, 165 + 355 * side])
        x, sides = (np.where(t >= times[0], new, old) for new, old in ((_smooth(line, 4.0), x), (side, sides)))
    steps = np.cumsum(np.abs(np.diff(x, prepend=x[0])).clip(0, 30)) / 52.0 * 2 * np.pi  # a step every 52 pixels
    high = float(stage.head[:, 1].mean()) + rng.uniform(-18, 14)
    y = max(high, SIZE[1] + 4 - other.below * size) - 1.6 * np.cos(steps)
    way = np.stack([x + 0.8 * np.sin(steps / 2), y], axis=1) + stage.camera * (1.0, 0.0)
    look = faces.looks(other.portrait, other.cutout, {"yaw": 0.14 * sides, "pitch": 0.02 * np.sin(t / 9.0)})
    passer = Stage(other.cutout, stage.ground, CORNER, stage.camera, way, np.full(frames, size), stage.light, look, 0)
    with mock.patch.object(faces, "FACE", who.square):
        return faces.face_clip(stage, PassingScene(stage, passer).things, soft=7.0, dark=0.22, crf=20, spots=spots)


@dataclass(frozen=True, kw_only=True)
class Seated(Scene):
    """The person of gestures.mp4: the body has the head's scale and is `lean` (n, 2) away; the ground is larger."""

    lean: Array
    camera: Array
    still: tuple[Layer, Layer] | None = None  # the hands, where they hardly move while the shutter is open

    def layers(self, t: float) -> tuple[Layer, Layer]:
        return self.still or super().layers(t)

    def place(self, t: float) -> tuple[Place, Place]:
        head = super().place(t)[1]
        x, y = (float(np.interp(t, np.arange(len(self.lean)), v)) for v in self.lean.T)
        return Place(head.x - x, head.y - y, head.k), head

    def at(self, t: int) -> Scene:
        """With the part of the ground that is seen in frame t; hands are drawn as often as their speed asks for."""
        fast = max(float(np.abs(np.gradient(hand.xy, axis=0)[t]).max()) for hand in self.hands)
        move = np.column_stack([np.eye(2), (CORNER + self.camera[t]) * FINE])
        seen = cv2.warpAffine(self.ground, move, (SIZE[0] * FINE, SIZE[1] * FINE), flags=cv2.INTER_LINEAR)
        still = self.layers(t) if fast < 4 else None
        return replace(self, ground=np.asarray(seen, dtype=np.float32), shots=3 if fast < 8 else 5, still=still)


def _passes(rng: Random, frames: int) -> tuple[Stops, Stops]:
    """Stops of both hands: frame, x to the hand's own side, y and scale."""
    stops: tuple[Stops, Stops] = ([(0, *REST, 1.0)], [(0, *REST, 1.0)])
    plans = []
    for _ in range(7):
        hands = ((0, 1), (0,), (1,))[rng.choice(3, p=[0.5, 0.25, 0.25])]
        hold = rng.uniform(*LENGTH) if len(hands) == 2 or rng.uniform() < 0.6 else 0.0
        near = rng.uniform(1.25 if hold else NEAR[0], NEAR[1])
        come, go = rng.choice(list(AT)[:3], 2).tolist()
        go = go if hold else "other"  # it passes over the face
        front = (rng.uniform(17, 23) if len(hands) == 2 else rng.uniform(-6, 12), rng.uniform(-10, 10))
        ways = [max(float(np.hypot(*np.subtract(front, AT[end]))) / rng.uniform(*HAND), 3.0) for end in (come, go)]
        plans.append((hands, hold, near, come, go, front, ways))
    starts = _starts(rng, frames, [24 + plan[1] + sum(plan[-1]) for plan in plans], 2)
    for start, (hands, hold, near, come, go, front, ways) in zip(starts, plans, strict=False):
        t, u = start + 12, start + 12 + ways[0] + hold
        stay: Stops = [(t + ways[0], *front, near), (u, *front, near)] if hold else []
        for i in hands:
            stops[i].extend([(start, *REST, 1.0), (t, *AT[come], (1 + near) / 2), *stay,
                             (u + ways[1], *AT[go], (1 + near) / 2), (u + ways[1] + 12, *REST, 1.0)])  # fmt: skip
    return stops


def gestures_clip(rng: Random) -> Clip:
    """Hands of the face's colour pass over the face or stay before it; the person is that of gestures.mp4."""
    frames, zoom = int(rng.integers(*FRAMES)), rng.uniform(0.54, 0.64)
    scale, camera = _factor(rng, frames, SCALE), _camera(rng, frames)
    k = (zoom * scale)[:, None]
    face = _places(rng, camera, k * (77, 105), np.hstack([SIZE[0] - 85 * k, 105 * k + 24]))
    hands = []
    for side, stops in zip((-1.0, 1.0), _passes(rng, frames), strict=True):
        x, y, near = _through(stops, frames)
        shape = loose(rng, frames, 1.0, (14, 30))
        shape |= {"scale": near * k[:, 0] / REST_ZOOM, "curl": 0.5 * shape["curl"], "spread": 0.8 * shape["spread"]}
        away = np.stack([side * x, y], axis=1) * k / REST_ZOOM
        hands.append(Motion(_smooth(face, 5.0) + away + unrest(rng, frames, 1.0, 2.0), **shape))
    cloth, talk = (rng.uniform(30, 130), rng.uniform(30, 110), rng.uniform(30, 130)), int(rng.integers(5, frames // 2))
    who = person(cloth, int(rng.integers(1000)), frames, ((talk, talk + 80),))
    lean = np.stack([_goes(rng, frames, 6.0), _goes(rng, frames, 1.5)], axis=1)
    front = np.full(frames, rng.integers(2), dtype=np.int64)
    scene = Seated(who, _ground(rng), face, scale, hands, front, matched_skin(cloth, 1.1), zoom,
                   lean=lean, camera=camera)  # fmt: skip
    light = EXPOSURE * _factor(rng, frames, LIGHT)
    pictures, rows = [], []
    for t in range(frames):
        picture, layers = render(scene.at(t), t)
        box, head = scene.box(t), scene.place(t)[1]
        prove_face(who, head, box)
        rows.append(TruthRow(t, "face", "box", *box, hidden=face_covered(box, layers)[2] > 0.5))
        for part, spot in _spots(who.portrait, who.moves, t, head).items():
            rows.append(TruthRow(t, "face", part, *spot[:2], hidden=face_covered(spot, layers)[2] > 0.5))
        pictures.append(expose(picture, float(light[t]), rng))
    return Clip(pictures, rows, {"face": start_of(*(row for row in rows if row.frame == 0))}, 20)


KINDS: dict[str, Callable[[Random], Clip]] = {"object": object_clip, "passer": passer_clip, "gestures": gestures_clip}


def _grey(picture: Frame) -> Frame:
    return np.repeat(np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), dtype=np.uint8)[..., None], 3, axis=2)


def _seeds(text: str) -> range:
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder of the clips")
    parser.add_argument("--seeds", type=_seeds, required=True, metavar="A-B", help="the first and the last, or one")
    parser.add_argument("--kind", choices=KINDS, action="append", help="all unless given; can be given again")
    parser.add_argument("--grey", action="store_true", help="all channels equal")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    for seed, kind in product(args.seeds, args.kind or KINDS):
        clip = KINDS[kind](np.random.default_rng((seed, list(KINDS).index(kind))))
        shown = [_grey(picture) for picture in clip.pictures] if args.grey else clip.pictures
        boxes = [row for row in clip.truth if row.part == "box"]
        name, hidden = f"{kind}-{seed}", sum(row.hidden for row in boxes)
        write_video(args.out / f"{name}.mp4", shown, clip.crf)
        write_truth(args.out / f"{name}.truth.csv", clip.truth)
        write_init(args.out / f"{name}.init.yaml", clip.starts)
        fast = f"at most {fastest(boxes):.1f} px a frame"
        print(f"{name}: {len(shown)} frames, {hidden} of them hidden, {fast}", flush=True)


if __name__ == "__main__":
    main()
