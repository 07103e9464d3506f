"""The clip of a city map: it covers the face wholly three times, and two hands of the face's colour hold it in sight.

After the first experiment of Gonzalez and Collet, "Face Tracking using a Combination of Colour and Pattern Matching
Based on Particle Filter", table 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from clip_files import Clip
from faces import Before, face_clip, motion, panned, standing
from faces_ground import papered_wall
from hands import skin
from hands_draw import Skin, draw
from hands_model import SHIFT, Pose
from heads import Stage, path, unsteady
from layers import over, reduced
from numpy.typing import NDArray
from portraits import Picture
from render import SIZE
from timeline import Array, Keys, track

FRAMES = 250
FINE = 3  # the map is drawn this many times finer than the clip
SHEET = (104, 90)  # of the map, in pixels of the clip
FOLDS = 4  # panels side by side
ZIGZAG = 2.0  # how far the folds put the upper border up and down, in pixels
CLOTH = (46.0, 96.0, 226.0)  # of the sleeves: the person's suit
SOFT, DARK = 5.0, 0.35  # the shadow of what is before the person


def city_map() -> Picture:
    """A street map folded like a fan: BGR times alpha, and alpha, FINE times enlarged, with room for the folds."""
    rng = np.random.default_rng(61)
    w, h = SHEET[0] * FINE, SHEET[1] * FINE
    page = np.full((h, w, 3), (226, 232, 228), np.uint8)
    parks = [(rng.uniform((0, 0), (w, h)), rng.uniform(9, 22, 2) * FINE, rng.uniform(-20, 20)) for _ in range(9)]
    for at, sides, turned in parks:
        box = cv2.boxPoints((at.tolist(), sides.tolist(), float(turned)))
        cv2.fillPoly(page, [np.rint(box).astype(np.int32)], (158, 204, 172), cv2.LINE_AA)
    t = np.linspace(-0.05, 1.05, 60)
    river = np.stack([t * w, h * (0.34 + 0.30 * t + 0.07 * np.sin(7 * t))], axis=1)
    turn = np.radians(9.0)
    across, along = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])

    def street(middle: NDArray[np.float64], way: NDArray[np.float64], bgr: tuple[int, ...], wide: int) -> None:
        ends = [np.rint(middle + s * 400 * way).astype(int).tolist() for s in (-1, 1)]
        cv2.line(page, ends[0], ends[1], (176, 176, 176), wide + 2, cv2.LINE_AA)
        cv2.line(page, ends[0], ends[1], bgr, wide, cv2.LINE_AA)

    for i in range(-18, 19):
        for way, side in ((along, across), (across, along)):
            jitter = np.array([w / 2, h / 2]) + (i * 7.2 + rng.uniform(-1.6, 1.6)) * FINE * side
            street(jitter, way, (250, 252, 252), 3 if i % 3 else 6)
    cv2.polylines(page, [np.rint(river).astype(np.int32)], False, (206, 176, 130), 8 * FINE, cv2.LINE_AA)
    for place, slope in (((0.3, 0.5), (0.9, -0.75)), ((0.62, 0.45), (0.25, 1.0)), ((0.5, 0.72), (1.0, 0.12))):
        street(np.array(place) * (w, h), np.array(slope), (96, 196, 226), 7)
    metro = np.stack([t * w, h * (0.82 - 0.62 * t + 0.1 * np.sin(5 * t))], axis=1)
    cv2.polylines(page, [np.rint(metro).astype(np.int32)], False, (168, 60, 120), 5, cv2.LINE_AA)
    for x, y in metro[5:56:10]:
        cv2.circle(page, (round(x), round(y)), 6, (168, 60, 120), -1, cv2.LINE_AA)
        cv2.circle(page, (round(x), round(y)), 3, (250, 250, 250), -1, cv2.LINE_AA)
    for x, y in rng.uniform((0.05, 0.08), (0.9, 0.95), (34, 2)) * (w, h):  # names
        for k in range(int(rng.integers(3, 8))):
            cv2.line(page, (int(x) + 4 * k, int(y)), (int(x) + 4 * k + 2, int(y) - 4), (96, 90, 84), 1, cv2.LINE_AA)
    cv2.rectangle(page, (0, 0), (w - 1, 11 * FINE), (128, 82, 46), -1)
    cv2.putText(page, "CITY MAP", (8 * FINE, 8 * FINE + 2), cv2.FONT_HERSHEY_TRIPLEX, 0.27 * FINE, (240, 240, 236), 2,
                cv2.LINE_AA)  # fmt: skip
    return _folded(page.astype(np.float32), rng)


def _folded(page: Picture, rng: np.random.Generator) -> Picture:
    """Panels towards the light are brighter, creases are dark, and the borders go up and down with the folds."""
    h, w = page.shape[:2]
    pad = round((ZIGZAG + 2) * FINE)
    y, x = np.mgrid[-pad : h + pad, -pad : w + pad].astype(np.float32)
    phase = x / w * FOLDS
    saw = np.abs(np.mod(phase, 2.0) - 1.0) - 0.5  # a triangle, a panel up and a panel down
    v = y + 2 * ZIGZAG * FINE * saw
    mid = np.minimum(np.mod(phase, 1.0), 1 - np.mod(phase, 1.0)) * w / FOLDS
    cross = np.abs(v - h / 2)
    shade = np.where(np.mod(np.floor(phase), 2) == 0, 1.03, 0.88) - 0.14 * np.exp(-((mid / 2.2) ** 2))
    shade = shade - 0.10 * np.exp(-((cross / 2.0) ** 2)) + 0.04 * np.sign(h / 2 - v)
    wrinkle = cv2.GaussianBlur(rng.normal(0, 1, x.shape), (0, 0), 7.0)
    shade = shade + 0.02 * wrinkle / wrinkle.std()
    colour = cv2.remap(page, x, v.astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    rim = np.minimum.reduce([x + 0.5, w - 0.5 - x, v + 0.5, h - 0.5 - v])
    alpha = np.clip(rim + 0.5, 0, 1)
    out: Picture = np.dstack([np.clip(colour * shade[..., None], 0, 250) * alpha[..., None], alpha]).astype(np.float32)
    return out


@dataclass(frozen=True)
class MapScene:
    """Who holds the map, and where: its middle (n, 2) in pixels and its tilt (n,) in radians, clockwise."""

    stage: Stage
    middle: Array
    tilt: Array
    sheet: Picture  # as city_map draws it
    skin: Skin

    def hands(self, t: int) -> tuple[Pose, Pose]:
        """Both hands at the map's borders, the fingers on it and the thumbs behind it."""
        (x, y), tilt = self.middle[t], float(self.tilt[t])
        c, s = np.cos(tilt), np.sin(tilt)
        out = []
        for side, low, bend in ((-1.0, 12.0, 0.85), (1.0, 9.0, 0.95)):
            u, v = side * (SHEET[0] / 2 + 3.0), low
            at = (float(x + c * u - s * v), float(y + s * u + c * v))
            body = float(self.stage.body[t, 0])
            # the elbows hang at the sides and follow the hands a little
            elbow = (body + side * 92.0 + 0.45 * (at[0] - body - side * 52.0), 330.0)
            out.append(Pose(*at, 0.84, -side * bend + tilt, 0.20, 0.35, elbow, side > 0))
        return out[0], out[1]

    def things(self, t: int) -> list[Before]:
        """Map and hands, as one thing before the person."""
        return [_held(self, t)]


def _drawn(pose: Pose, of: Skin) -> tuple[Picture, Picture]:
    """The hand with its arm, (H, W, 4), and how much of it is before the map: all but the thumb."""
    layer = draw(pose, of, SIZE)
    whole = np.dstack([layer.colour, layer.alpha])
    y, x = np.mgrid[: SIZE[1], : SIZE[0]].astype(np.float32)
    u, v = pose.to_hand(x, y)
    u, v = u - SHIFT[0], v - SHIFT[1]  # the coordinates in which fingers are measured
    thumb = np.clip((u - 14.4) * pose.scale + 0.5, 0, 1) * np.clip((v + 9.5) * pose.scale + 0.5, 0, 1)
    return whole, np.asarray(1 - thumb, dtype=np.float32)


def _held(scene: MapScene, t: int) -> Before:
    """Map and hands as one layer: the hands behind it, the map, the fingers before it with their shadow on it."""
    (x, y), tilt = scene.middle[t], float(scene.tilt[t])
    c, s = np.cos(tilt), np.sin(tilt)
    pad = round((ZIGZAG + 2) * FINE)
    grip = np.array([SHEET[0] * FINE / 2 + pad - 0.5, SHEET[1] * FINE / 2 + pad - 0.5])
    turn = np.array([[c, -s], [s, c]])
    shift = np.array([x, y]) * FINE + (FINE - 1) / 2 - turn @ grip
    fine = cv2.warpAffine(scene.sheet, np.column_stack([turn, shift]), (SIZE[0] * FINE, SIZE[1] * FINE),
                          flags=cv2.INTER_LINEAR)  # fmt: skip
    paper = reduced(np.asarray(fine, np.float32))
    drawn = [_drawn(pose, scene.skin) for pose in scene.hands(t)]
    out = np.zeros_like(paper)
    for whole, _ in drawn:
        out = over(out, whole)
    out = over(out, paper)
    for whole, front in drawn:
        fingers = whole * front[..., None]
        move = np.array([[1.0, 0.0, 1.2], [0.0, 1.0, 1.8]])
        shadow = cv2.GaussianBlur(cv2.warpAffine(fingers[..., 3], move, SIZE), (0, 0), 1.4)
        # a shadow falls on the map alone
        out[..., :3] *= (1 - 0.4 * shadow * paper[..., 3])[..., None]
        out = over(out, fingers)
    return Before(out, motion(scene.middle, t))


def map_scene() -> MapScene:
    """What happens when: from below at 34, from the left at 118, quickly, from the right at 178, slowly."""
    n = FRAMES
    head = path(
        [(0, 152), (14, 164), (26, 148), (40, 156), (52, 162), (66, 154), (82, 158), (92, 190), (106, 168), (116, 178),
         (128, 176), (142, 162), (152, 138), (166, 176), (180, 144), (200, 154), (214, 148), (228, 156), (239, 184),
         (249, 168)],
        [(0, 92), (20, 88), (38, 94), (56, 91), (76, 88), (92, 98), (108, 90), (130, 93), (152, 98), (168, 88),
         (190, 93), (212, 90), (236, 97), (249, 92)],
        n,
    )  # fmt: skip
    pan: Keys = [(0, 0), (18, 0), (40, -30), (70, -34), (100, 38), (120, 34), (145, 10), (175, -38), (200, -30),
                 (232, 0), (249, 36)]  # fmt: skip
    camera = panned(pan, n, 62)
    scale = track([(0, 1.08), (40, 1.1), (92, 1.14), (130, 1.08), (168, 1.05), (200, 1.1), (249, 1.08)], n)
    stage = standing(
        papered_wall(400, 310), (-40.0, -35.0), camera, head + camera, scale,
        {
            "smile": [(0, 0), (12, -0.1), (60, -0.1), (90, 0.05), (112, 0), (150, -0.1), (230, 0), (249, 0.05)],
            "close": [(0, 0), (12, 0.8), (36, 0.8), (80, 0), (112, 0.4), (146, 0.9), (176, 0.9), (230, 0), (249, 0)],
            "yaw": [(0, 0), (14, 0.12), (28, -0.1), (50, 0.0), (80, 0.04), (92, 0.15), (106, -0.12), (130, 0.05),
                    (152, -0.15), (168, 0.14), (190, 0), (228, 0), (240, 0.12), (249, 0.05)],
            "pitch": [(0, 0), (20, -0.05), (40, 0.05), (80, 0.0), (96, 0.06), (150, -0.05), (176, 0.04), (249, 0)],
        },
        [(10, 34), (144, 178)], 63,
    )  # fmt: skip
    middle = path(
        [(0, 158), (20, 154), (33, 154), (46, 158), (64, 158), (84, 152), (96, 146), (108, 62), (117, 62), (123, 172),
         (140, 168), (150, 158), (164, 168), (180, 250), (188, 250), (206, 154), (226, 152), (242, 170), (249, 168)],
        [(0, 204), (16, 201), (33, 204), (46, 101), (64, 103), (84, 204), (96, 206), (108, 112), (117, 104), (123, 101),
         (140, 102), (150, 206), (164, 204), (180, 116), (188, 106), (206, 100), (226, 102), (242, 204), (249, 203)],
        n,
    )  # fmt: skip
    tremble = unsteady(n, 64, 0.5)
    tilt = track([(0, 0.03), (33, 0.0), (46, -0.05), (64, 0.03), (84, 0), (108, -0.16), (117, -0.12), (124, 0.06),
                  (140, -0.02), (150, 0.05), (180, 0.18), (206, -0.04), (226, 0.04), (249, 0)], n)  # fmt: skip
    return MapScene(stage, middle + tremble + camera, tilt, city_map(), skin(cloth=CLOTH, depth=1.0))


def map_clip() -> Clip:
    """The clip, with the ground truth of the face."""
    scene = map_scene()
    return face_clip(scene.stage, scene.things, soft=SOFT, dark=DARK, crf=20)
