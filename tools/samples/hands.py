"""The clip of two hands over a cluttered desk: they move things, wave together, meet, and cross each other four times.

After the hand experiment of Odobez, Ba & Gatica-Perez (2003), figures 6 and 7. Both hands have the same colours, since
one is the other's mirror image. All places are in pixels of the image as the camera at rest would see it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from clip_files import Clip, TruthRow, start_of
from hands_desk import FINE, ORIGIN, Picture, Sheet, desk, pencil, place, playing_card
from hands_draw import Layer, Skin, draw
from hands_model import BOX, Pose
from numpy.typing import NDArray
from render import SIZE, expose
from timeline import Keys, track

FRAMES = 250
SWITCH = 164  # from here the right hand is the upper one; the hands and arms are apart then
TARGETS = ("left_hand", "right_hand")  # as seen in the first frame; the left one's thumb is at its right
CENTRE = ((SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2)
LENS = 0.5  # blur of the lens, in pixels
CRF = 20  # the whole ground moves, which costs more than a talking head
GRIP = (-2.0, -24.0)  # of a hand that holds something, in hand coordinates


@dataclass(frozen=True)
class Camera:
    """Where the camera looks, beyond its place at rest: shift in pixels, zoom, and roll in radians."""

    x: float
    y: float
    zoom: float
    roll: float

    def see(self, x: float, y: float) -> tuple[float, float]:
        """Where a place of the desk is in the image."""
        dx, dy = x - CENTRE[0] - self.x, y - CENTRE[1] - self.y
        c, s = np.cos(self.roll) * self.zoom, np.sin(self.roll) * self.zoom
        return float(CENTRE[0] + c * dx - s * dy), float(CENTRE[1] + s * dx + c * dy)

    def look(self, ground: Picture) -> Picture:
        """The image (H, W, 3) of the ground, by area means."""
        right, down, at = (np.array(self.see(*p)) for p in ((1.0, 0.0), (0.0, 1.0), (-ORIGIN[0], -ORIGIN[1])))
        a = np.stack([right - self.see(0.0, 0.0), down - self.see(0.0, 0.0)], axis=1)
        # both grids are FINE times finer, with pixel centres at whole numbers
        half = (FINE - 1) / 2
        b = at * FINE + half - a @ np.array([half, half])
        size = (SIZE[0] * FINE, SIZE[1] * FINE)
        fine = cv2.warpAffine(ground, np.column_stack([a, b]), size, flags=cv2.INTER_LINEAR)
        return np.asarray(cv2.resize(fine, SIZE, interpolation=cv2.INTER_AREA), dtype=np.float32)


@dataclass(frozen=True)
class Moment:
    """One frame: the camera, both hands in the image, which is the upper one, and what lies where: x, y, degrees."""

    camera: Camera
    hands: tuple[Pose, Pose]
    upper: int
    things: tuple[tuple[float, float, float], ...]


MOVES: dict[str, dict[str, Keys]] = {
    "left_hand": {
        "x": [(0, 92), (8, 92), (20, 78), (28, 78), (44, 122), (50, 122), (58, 96), (67, 132), (78, 74), (88, 108),
              (94, 96), (120, 222), (128, 236), (137, 214), (165, 76), (168, 76), (179, 132), (184, 128),
              (192, 80), (217, 216), (223, 228), (249, 90)],
        "y": [(0, 124), (8, 124), (20, 142), (28, 142), (44, 92), (52, 96), (66, 104), (80, 98), (94, 112), (108, 106),
              (122, 100), (132, 108), (140, 104), (152, 99), (166, 112), (180, 104), (192, 114), (205, 122), (218, 118),
              (236, 134), (249, 120)],
        "scale": [(0, 1.0), (18, 0.93), (32, 0.90), (50, 1.0), (70, 1.06), (92, 1.02), (107, 1.14), (126, 1.06),
                  (146, 1.12), (166, 0.96), (182, 1.0), (204, 0.90), (222, 0.94), (249, 0.98)],
        "turn": [(0, 0), (20, -0.06), (44, 0.04), (54, -0.14), (62, 0.16), (72, -0.16), (84, 0.12), (96, 0),
                 (120, 0.08), (130, -0.10), (140, 0.04), (164, -0.08), (180, 0.06), (196, -0.04), (218, 0.08),
                 (249, -0.04)],
        "curl": [(0, 0.10), (16, 0.14), (23, 0.50), (45, 0.48), (52, 0.08), (62, 0.22), (72, 0.06), (84, 0.20),
                 (96, 0.10), (112, 0.28), (128, 0.08), (142, 0.16), (160, 0.34), (176, 0.10), (196, 0.22), (214, 0.06),
                 (249, 0.14)],
        "spread": [(0, 1.0), (23, 0.45), (45, 0.45), (54, 1.1), (64, 0.8), (76, 1.1), (100, 0.7), (128, 1.15),
                   (150, 0.7), (176, 1.0), (200, 0.65), (220, 1.1), (249, 0.9)],
    },
    "right_hand": {
        "x": [(0, 232), (6, 232), (16, 246), (26, 222), (36, 250), (46, 226), (56, 204), (67, 240), (78, 180),
              (88, 214), (94, 224), (120, 92), (128, 106), (137, 84), (165, 224), (168, 224), (179, 176), (184, 180),
              (192, 228), (217, 86), (223, 98), (249, 230)],
        "y": [(0, 118), (10, 114), (30, 126), (48, 112), (64, 116), (80, 108), (94, 128), (108, 124), (122, 112),
              (132, 118), (140, 124), (152, 127), (166, 118), (180, 112), (192, 108), (205, 104), (218, 98), (236, 98),
              (249, 112)],
        "scale": [(0, 1.0), (24, 1.06), (46, 0.98), (70, 1.04), (92, 0.96), (107, 0.90), (126, 0.95), (146, 0.90),
                  (164, 1.0), (182, 1.04), (204, 1.15), (222, 1.06), (249, 1.10)],
        "turn": [(0, 0), (14, 0.14), (24, -0.14), (36, 0.14), (48, -0.06), (54, -0.14), (62, 0.16), (72, -0.16),
                 (84, 0.12), (96, 0), (120, -0.08), (130, 0.10), (142, -0.04), (164, 0.08), (180, -0.06), (198, 0.04),
                 (218, -0.08), (249, 0.02)],
        "curl": [(0, 0.12), (14, 0.06), (24, 0.20), (36, 0.06), (50, 0.14), (62, 0.26), (72, 0.08), (90, 0.14),
                 (104, 0.30), (120, 0.46), (136, 0.46), (142, 0.12), (160, 0.08), (178, 0.24), (196, 0.12), (214, 0.26),
                 (249, 0.10)],
        "spread": [(0, 1.0), (14, 1.1), (24, 0.8), (36, 1.1), (62, 0.7), (78, 1.05), (104, 0.7), (120, 0.5),
                   (136, 0.5), (146, 1.0), (176, 0.8), (196, 1.1), (216, 0.75), (249, 1.0)],
    },
}  # fmt: skip
CAMERA: dict[str, Keys] = {
    "x": [(0, 0), (30, 14), (58, -8), (84, -20), (112, 8), (138, 18), (160, -6), (186, -16), (212, 12), (249, 4)],
    "y": [(0, 0), (26, -8), (52, 8), (90, -4), (120, 10), (150, -8), (176, 4), (206, -10), (249, 2)],
    "zoom": [(0, 1.0), (50, 1.03), (100, 0.98), (150, 1.03), (200, 0.98), (249, 1.01)],
    "roll": [(0, 0), (40, 0.02), (90, -0.02), (140, 0.015), (190, -0.02), (249, 0.01)],
}
# what is moved: who holds it, from which frame to which, where it lies before, and how it is turned
HELD = ((0, 23, 46, -12.0), (1, 120, 137, 62.0))


def things() -> tuple[Sheet, Sheet]:
    """What the hands move: the left one a playing card, the right one a pencil."""
    return playing_card("Q", "diamond"), pencil(62, (92, 150, 70))


def moments() -> tuple[Moment, ...]:
    """What happens when."""
    t = np.arange(FRAMES)
    rng = np.random.default_rng(41)
    shake = [cv2.GaussianBlur(rng.normal(0, 1, (1, FRAMES)), (0, 0), 1.6)[0] * 0.8 for _ in range(2)]
    camera = {name: track(keys, FRAMES) for name, keys in CAMERA.items()}
    moves = [{name: track(keys, FRAMES) for name, keys in MOVES[target].items()} for target in TARGETS]
    for i, m in enumerate(moves):
        m["x"] = m["x"] + 0.9 * np.sin(t / 3.7 + i)
        m["y"] = m["y"] + 1.1 * np.sin(t / 4.9 + 2 * i)
    still = [_poses(moves, first) for _, first, *_ in HELD]
    out = []
    for k in range(FRAMES):
        at = Camera(
            float(camera["x"][k] + shake[0][k]), float(camera["y"][k] + shake[1][k]), float(camera["zoom"][k]),
            float(camera["roll"][k]),
        )  # fmt: skip
        hands = _poses(moves, k)
        lie = []
        for (who, first, last, degrees), begin in zip(HELD, still, strict=True):
            now = _poses(moves, min(max(k, first), last))[who]
            turned = np.degrees(now.turn - begin[who].turn)
            lie.append((*now.to_picture(*GRIP), degrees + float(turned)))
        seen = tuple(_seen(pose, at) for pose in hands)
        out.append(Moment(at, (seen[0], seen[1]), 0 if k < SWITCH else 1, tuple(lie)))
    return tuple(out)


def _poses(moves: list[dict[str, NDArray[np.float64]]], k: int) -> tuple[Pose, Pose]:
    """Both hands at frame k, as the camera at rest would see them. The elbow follows, and the wrist bends a little."""
    out = []
    for i, m in enumerate(moves):
        x, y, scale, turn, curl, spread = (float(m[n][k]) for n in ("x", "y", "scale", "turn", "curl", "spread"))
        home = (20.0, 300.0)[i]
        elbow = (home + 0.22 * (x - (92.0, 232.0)[i]), 345.0)
        arm = float(np.arctan2(x - elbow[0], elbow[1] - y))
        out.append(Pose(x, y, scale, 0.5 * arm + turn, curl, spread, elbow, i == 1))
    return out[0], out[1]


def _seen(pose: Pose, camera: Camera) -> Pose:
    x, y = camera.see(pose.x, pose.y)
    scale, turn = pose.scale * camera.zoom, pose.turn + camera.roll
    return Pose(x, y, scale, turn, pose.curl, pose.spread, camera.see(*pose.elbow), pose.mirrored)


def skin(cloth: tuple[float, float, float] = (120.0, 84.0, 60.0), depth: float = 1.25) -> Skin:
    """Colour and grain of a cheek of NASA's portrait of Eileen Collins, as scikit-image has it, over the cloth given.

    Hands are a little deeper in colour than a face made up for a portrait; `depth` 1 is the cheek itself.
    """
    from skimage import data

    rgb = np.asarray(data.astronaut())  # type: ignore[no-untyped-call, unused-ignore]
    cheek = np.ascontiguousarray(rgb[114:138, 185:205, ::-1]).astype(np.float32)
    grey = cheek.mean(axis=2)
    grain = cv2.resize(grey - cv2.GaussianBlur(grey, (0, 0), 3), None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    # mirrored, so that it repeats without a seam
    tile = np.block([[grain, grain[:, ::-1]], [grain[::-1], grain[::-1, ::-1]]])
    b, g, r = (255 * (float(v) / 255) ** depth for v in cheek.reshape(-1, 3).mean(axis=0))
    return Skin((b, g, r), (tile / tile.std()).astype(np.float32), cloth)


def compose(m: Moment, ground: Picture, movable: tuple[Sheet, ...], of: Skin) -> tuple[Picture, tuple[Layer, Layer]]:
    """The image (H, W, 3) without noise, and the layers of both hands."""
    with_things = ground.copy()
    for sheet, (x, y, degrees) in zip(movable, m.things, strict=True):
        place(with_things, sheet, x + ORIGIN[0], y + ORIGIN[1], degrees)
    out = m.camera.look(with_things)
    layers = draw(m.hands[0], of, SIZE), draw(m.hands[1], of, SIZE)
    for i in (1 - m.upper, m.upper):
        layer = layers[i]
        d = layer.lift * (1.0 if i == m.upper else 0.8)
        moved = cv2.warpAffine(layer.alpha, np.array([[1.0, 0.0, 0.7 * d], [0.0, 1.0, 0.8 * d]]), SIZE)
        shadow = 0.30 * cv2.GaussianBlur(moved, (0, 0), 0.7 * d) + 0.22 * cv2.GaussianBlur(moved, (0, 0), 1.8)
        out = out * (1 - shadow[..., None])
        out = out * (1 - layer.alpha[..., None]) + layer.colour
    return np.asarray(cv2.GaussianBlur(out, (0, 0), LENS), dtype=np.float32), layers


def covered(m: Moment, layers: tuple[Layer, Layer]) -> tuple[float, float]:
    """What share of each hand is under the other hand or its arm."""
    low = layers[1 - m.upper].hand
    share = float((low * layers[m.upper].alpha).sum() / low.sum())
    return (share, 0.0) if m.upper == 1 else (0.0, share)


def _centroid(mask: Picture) -> NDArray[np.float64]:
    y, x = np.mgrid[: mask.shape[0], : mask.shape[1]]
    total = float(mask.sum(dtype=np.float64))
    return np.array([float((mask * x).sum()) / total, float((mask * y).sum()) / total])


class Proof:
    """Holds the rendered masks to the ground truth: what is drawn, measured in the image, is where it says."""

    def __init__(self, of: Skin) -> None:
        # the palm does not bend: its area and its centre at scale 1, measured on a drawing three times as large
        large = draw(Pose(159.5, 119.5, 3.0, curl=0.1, elbow=(159.5, 400.0)), of, SIZE)
        self.centre = (_centroid(large.palm) - (159.5, 119.5)) / 3
        self.area = float(large.palm.sum()) / 9

    def hold(self, pose: Pose, layer: Layer) -> None:
        """A disc about the box's centre, and the palm's centre, to 0.1 px; its area to 1 %; nine tenths in the box.

        Raises:
            AssertionError: it is not so.
        """
        off = _centroid(layer.dot) - (pose.x, pose.y)
        assert np.abs(off).max() < 0.1, f"the centre is off by {off} at {pose}"
        off = _centroid(layer.palm) - pose.to_picture(*self.centre)
        assert np.abs(off).max() < 0.1, f"the palm is off by {off} at {pose}"
        ratio = float(layer.palm.sum()) / (self.area * pose.scale**2)
        assert abs(ratio - 1) < 0.01, f"the palm has {ratio} of its area at {pose}"
        left, right = pose.x - BOX[0] / 2 * pose.scale, pose.x + BOX[0] / 2 * pose.scale
        top, bottom = pose.y - BOX[1] / 2 * pose.scale, pose.y + BOX[1] / 2 * pose.scale
        y, x = np.mgrid[: SIZE[1], : SIZE[0]]
        inside = (x > left) & (x < right) & (y > top) & (y < bottom)
        share = float((layer.hand * inside).sum() / layer.hand.sum())
        assert share > 0.9, f"only {share:.2f} of the hand is in its box at {pose}"


def hands() -> Clip:
    """The clip, with the ground truth of both hands."""
    ground, movable, of = desk(), things(), skin()
    proof = Proof(of)
    rng = np.random.default_rng(103)
    pictures, rows = [], []
    for t, m in enumerate(moments()):
        picture, layers = compose(m, ground, movable, of)
        for pose, layer in zip(m.hands, layers, strict=True):
            proof.hold(pose, layer)
        if t in (SWITCH - 1, SWITCH):
            assert float((layers[0].alpha * layers[1].alpha).max()) == 0, "the arms change places while they touch"
        shares = covered(m, layers)
        for target, pose, share in zip(TARGETS, m.hands, shares, strict=True):
            w, h = BOX[0] * pose.scale, BOX[1] * pose.scale
            rows.append(TruthRow(t, target, "box", pose.x, pose.y, w, h, share > 0.5))
        pictures.append(expose(picture, 1.0, rng))
    return Clip(pictures, rows, {row.target: start_of(row) for row in rows[:2]}, CRF)
