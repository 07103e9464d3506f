"""The clip of a signer: two fast hands of the face's colour, which cross before the chest and before the face.

The hands' strokes are drawn from a fixed seed between the places that the script below gives.
"""

from __future__ import annotations

import numpy as np
from clip_files import Clip, TruthRow, start_of
from person import person, prove_face, wall, wander
from person_hands import (
    TARGETS,
    Motion,
    Scene,
    face_covered,
    hand_box,
    hand_covered,
    loose,
    matched_skin,
    prove_hand,
    render,
)
from render import expose
from timeline import Array, track, unrest

FRAMES = 250
ZOOM = 0.52  # pixels of the image for one of the portrait
HAND = 0.84  # scale of the hands
CLOTH = (54.0, 44.0, 40.0)
LIGHT = 0.88
FASTEST = 12.0  # of a hand, in pixels a frame
SWITCH = 131  # from here the right hand is in front; the hands and arms are apart then
CRF = 19

Stop = tuple[int, float, float]
# frame, x, y of what must happen; between stops more than 16 frames apart the hand signs, in its own region
STOPS: dict[str, list[Stop]] = {
    "left_hand": [(0, 106, 166), (40, 118, 164), (52, 194, 160), (55, 195, 155), (69, 116, 166), (96, 112, 172),
                  (104, 114, 174), (116, 188, 162), (128, 110, 152), (133, 104, 146), (147, 152, 72), (158, 205, 80),
                  (162, 204, 78), (174, 132, 66), (186, 106, 140), (204, 106, 140), (215, 130, 72), (226, 196, 62),
                  (230, 198, 64), (242, 118, 76), (249, 108, 126)],
    "right_hand": [(0, 214, 160), (40, 202, 170), (52, 130, 172), (55, 129, 175), (69, 200, 162), (73, 202, 150),
                   (84, 182, 74), (94, 136, 66), (105, 194, 112), (117, 140, 174), (128, 210, 160), (133, 214, 150),
                   (147, 168, 64), (158, 112, 70), (162, 110, 74), (174, 188, 72), (184, 214, 134), (204, 212, 138),
                   (215, 190, 66), (226, 122, 74), (230, 120, 72), (242, 202, 66), (249, 208, 100)],
}  # fmt: skip
REGIONS = {"left_hand": (76.0, 142.0, 122.0, 192.0), "right_hand": (178.0, 244.0, 122.0, 192.0)}


def strokes(rng: np.random.Generator, stops: list[Stop], region: tuple[float, float, float, float]) -> list[Stop]:
    """The stops with signs between those that are far apart in time: strokes of 4 to 8 frames, and short rests."""
    out = [stops[0]]
    for stop in stops[1:]:
        while stop[0] - out[-1][0] > 16:
            t, x, y = out[-1]
            if rng.uniform() < 0.25:
                out.append((t + 2, x, y))
                continue
            length = int(rng.integers(5, 10))
            reach = 0.60 * FASTEST * length * rng.uniform(0.55, 1.0)
            angle = rng.uniform(0, 2 * np.pi)
            to_x = float(np.clip(x + reach * np.cos(angle), region[0], region[1]))
            to_y = float(np.clip(y + reach * np.sin(angle), region[2], region[3]))
            out.append((t + length, to_x, to_y))
        out.append(stop)
    return out


def _motion(name: str, rng: np.random.Generator) -> Motion:
    stops = strokes(rng, STOPS[name], REGIONS[name])
    way = np.stack([track([(t, x) for t, x, _ in stops], FRAMES), track([(t, y) for t, _, y in stops], FRAMES)], axis=1)
    return Motion(way + unrest(rng, FRAMES, 1.1, 1.5), **loose(rng, FRAMES, HAND, (9, 22)))


def _sway(rng: np.random.Generator) -> tuple[Array, Array]:
    """The middle of the face, (n, 2), and its scale, (n,)."""
    face = np.stack([160 + wander(rng, FRAMES, 20, 9.0), 69 + wander(rng, FRAMES, 20, 4.0)], axis=1)
    return face, 1.0 + wander(rng, FRAMES, 20, 0.05)


def scene() -> Scene:
    """What happens when."""
    rng = np.random.default_rng(61)
    face, scale = _sway(rng)
    motions = [_motion(name, rng) for name in TARGETS]
    who = person(CLOTH, 62, FRAMES, ((6, 60), (84, 150), (170, 240)))
    front = np.where(np.arange(FRAMES) < SWITCH, 0, 1)
    return Scene(who, wall((148.0, 152.0, 140.0), 63), face, scale, motions, front, matched_skin(CLOTH, HAND), ZOOM)


def signing() -> Clip:
    """The clip, with the ground truth of the face and of both hands."""
    of = scene()
    rng = np.random.default_rng(64)
    pictures, rows = [], []
    for t in range(FRAMES):
        picture, layers = render(of, t)
        box, front = of.box(t), int(of.front[t])
        prove_face(of.who, of.place(t)[1], box)
        rows.append(TruthRow(t, "head", "box", *box, hidden=face_covered(box, layers)[2] > 0.5))
        if t in (SWITCH - 1, SWITCH):
            assert float((layers[0].alpha * layers[1].alpha).max()) == 0, "the arms change places while they touch"
        for target, pose, layer, share in zip(TARGETS, of.poses(t), layers, hand_covered(layers, front), strict=True):
            prove_hand(pose, layer, hand_box(pose))
            rows.append(TruthRow(t, target, "box", *hand_box(pose), hidden=share > 0.5))
        pictures.append(expose(picture, LIGHT, rng))
    return Clip(pictures, rows, {row.target: start_of(row) for row in rows[:3]}, CRF)
