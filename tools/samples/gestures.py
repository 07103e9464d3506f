"""The clip of gestures before a face: one hand passes over it, then the other, then both, from several sides.

The hands have the colour of the face, and are nearer to the camera in some of the passes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from clip_files import Clip, TruthRow, start_of
from person import person, prove_face, wall, wander
from person_hands import Motion, Scene, face_covered, loose, matched_skin, render
from render import expose
from timeline import Array, track, unrest

FRAMES = 260
ZOOM = 0.64  # pixels of the image for one of the portrait
CLOTH = (62.0, 56.0, 38.0)
LIGHT = 0.86
CRF = 19
# frame, x, y and scale of each hand; what is between y = 40 and 130 near x = 160 is before the face
STOPS = (
    ((0, 84, 192, 1.00), (10, 84, 194, 1.00), (22, 88, 104, 1.05), (36, 226, 92, 1.10), (48, 200, 182, 1.00),
     (60, 84, 196, 1.00), (100, 90, 190, 1.00), (109, 136, 168, 1.05), (117, 134, 80, 1.10), (125, 76, 62, 1.05),
     (138, 82, 192, 1.00), (164, 82, 186, 1.05), (176, 138, 92, 1.55), (181, 139, 91, 1.55), (193, 70, 112, 1.15),
     (197, 72, 104, 1.00), (202, 82, 96, 1.00), (211, 226, 84, 1.00), (222, 196, 176, 1.00), (234, 100, 168, 1.00),
     (243, 142, 84, 1.10), (253, 76, 66, 1.05), (259, 72, 90, 1.00)),
    ((0, 236, 198, 1.00), (44, 236, 190, 1.00), (56, 232, 98, 1.20), (85, 92, 88, 1.45), (96, 124, 182, 1.15),
     (106, 238, 194, 1.00), (126, 240, 184, 1.05), (138, 222, 44, 1.20), (147, 176, 62, 1.30), (155, 176, 168, 1.20),
     (164, 236, 184, 1.05), (176, 178, 92, 1.55), (181, 177, 93, 1.55), (193, 244, 112, 1.15), (200, 240, 176, 1.00),
     (232, 226, 172, 1.00), (242, 180, 86, 1.10), (252, 244, 70, 1.05), (259, 248, 92, 1.00)),
)  # fmt: skip


# the person sways to the sides, hands and all
SWAY = ((0, 0), (30, 28), (62, 34), (96, -30), (130, -36), (160, 0), (186, 30), (215, 34), (245, -28), (259, -34))


def _motion(stops: Sequence[tuple[int, float, float, float]], sway: Array, rng: np.random.Generator) -> Motion:
    x, y, scale = (track([(stop[0], stop[i]) for stop in stops], FRAMES) for i in (1, 2, 3))
    shape = loose(rng, FRAMES, 1.0, (14, 30))
    # fingers straight and side by side more than spread or bent, since these gestures are meant to hide the face
    shape |= {"scale": scale, "curl": 0.5 * shape["curl"], "spread": 0.8 * shape["spread"]}
    return Motion(np.stack([x + sway, y], axis=1) + unrest(rng, FRAMES, 1.0, 2.0), **shape)


def scene() -> Scene:
    """What happens when."""
    rng = np.random.default_rng(71)
    sway = track(list(SWAY), FRAMES)
    face = np.stack([160 + sway + wander(rng, FRAMES, 26, 13.0), 86 + wander(rng, FRAMES, 26, 5.0)], axis=1)
    scale = 1.0 + wander(rng, FRAMES, 26, 0.07)
    motions = [_motion(stops, sway, rng) for stops in STOPS]
    who = person(CLOTH, 74, FRAMES, ((4, 70), (96, 170), (190, 250)))
    return Scene(who, wall((150.0, 158.0, 150.0), 73), face, scale, motions, np.ones(FRAMES, dtype=np.int64),
                 matched_skin(CLOTH, 1.1), ZOOM, 5)  # fmt: skip


def gestures() -> Clip:
    """The clip, with the ground truth of the face."""
    of = scene()
    rng = np.random.default_rng(75)
    pictures, rows = [], []
    for t in range(FRAMES):
        picture, layers = render(of, t)
        box = of.box(t)
        prove_face(of.who, of.place(t)[1], box)
        rows.append(TruthRow(t, "face", "box", *box, hidden=face_covered(box, layers)[2] > 0.5))
        pictures.append(expose(picture, LIGHT, rng))
    return Clip(pictures, rows, {"face": start_of(rows[0])}, CRF)
