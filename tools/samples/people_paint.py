"""What makes another person of a portrait: hair of another colour, a beard, glasses, a cap, and other proportions.

All of it is in the pixels of NASA's portrait of Eileen Collins, in layers (H, W, 4) of BGR times alpha, and alpha.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from layers import over
from portraits import Picture
from timeline import Array, smoothstep

Colour = tuple[float, float, float]  # BGR
# of skin: forehead, temples, jaw and neck
_SKIN = ((184, 84), (190, 79), (205, 79), (228, 80), (246, 85), (262, 90), (267, 94), (269, 112), (268, 128),
         (276, 131), (268, 142), (262, 158), (257, 176), (254, 190), (190, 190), (186, 170), (182, 148), (180, 131),
         (171, 122), (179, 110), (182, 95))  # fmt: skip


def grid(shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Column and row of each pixel."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    return x, y


def _polygon(shape: tuple[int, ...], points: Sequence[tuple[float, float]]) -> Picture:
    out = np.zeros(shape[:2], np.uint8)
    cv2.fillPoly(out, [np.rint(np.array(points) * 16).astype(np.int32)], 255, cv2.LINE_AA, 4)
    return np.asarray(out.astype(np.float32) / 255)


def hairy(head: Picture) -> Picture:
    """How much of each pixel of the head is hair, (H, W) 0..1: by its place, and by its colour where they meet."""
    skin = _polygon(head.shape, _SKIN)
    near = cv2.dilate(skin, np.ones((11, 11), np.uint8)) - cv2.erode(skin, np.ones((11, 11), np.uint8))
    b, r = head[..., 0].astype(np.float64), np.maximum(head[..., 2].astype(np.float64), 1.0)
    brown = smoothstep((0.66 - b / r) / 0.10)
    out = np.where(near > 0, np.maximum(brown, smoothstep((90.0 - r) / 40.0)), 1.0 - skin)
    out[np.arange(head.shape[0]) > 136] = 0.0  # the neck's shade is as brown as hair
    return np.asarray(cv2.GaussianBlur(out, (0, 0), 0.8), dtype=np.float32)


def dyed(head: Picture, gain: Colour, contrast: float = 1.0) -> Picture:
    """The head with its hair in other colours: its grey times `gain`, about a middle of 110 by `contrast`."""
    share = hairy(head)[..., None]
    alpha = head[..., 3:]
    grey = head[..., :3].mean(axis=2, keepdims=True)
    tone = np.clip(110.0 * alpha + contrast * (grey - 110.0 * alpha), 0, 255) * np.array(gain)
    out = head.copy()
    out[..., :3] = head[..., :3] * (1 - share) + np.clip(tone, 0, 250) * share
    return out


def _strands(shape: tuple[int, ...], seed: int, fine: float, long: float, fan: float) -> Array:
    """Hair that falls from the middle of the lips and fans out, as noise of standard deviation 1, (H, W)."""
    x, y = grid(shape)
    raw = np.random.default_rng(seed).normal(0.0, 1.0, (shape[0], shape[1]))
    smooth = cv2.GaussianBlur(raw, (0, 0), sigmaX=fine, sigmaY=long)
    bent = x - fan * (x - 224.0) * np.clip((y - 120.0) / 60.0, -0.5, 1.2) + 2.0 * np.sin(y / 9.0)
    out = cv2.remap(smooth / smooth.std(), bent.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
    return np.asarray(out, dtype=np.float64)


def _hair_layer(where: Array, colour: Colour, seed: int, fan: float = 0.35, rough: float = 0.22) -> Picture:
    """Hair of one colour where `where` (H, W) passes through a half, its border ragged."""
    strands = _strands(where.shape, seed, 0.7, 3.5, fan)
    alpha = smoothstep((where + 0.07 * strands - 0.30) / 0.45)
    tone = np.clip(1.0 + rough * strands + 0.12 * _strands(where.shape, seed + 1, 2.0, 7.0, fan), 0.45, 1.7)
    out: Picture = np.dstack([np.clip(np.array(colour) * tone[..., None], 0, 245) * alpha[..., None], alpha]).astype(
        np.float32
    )
    return cv2.GaussianBlur(out, (0, 0), 0.6)  # type: ignore[return-value]


def _soft(shape: tuple[int, ...], points: Sequence[tuple[float, float]], blur: float) -> Array:
    return np.asarray(cv2.GaussianBlur(_polygon(shape, points), (0, 0), blur), dtype=np.float64)


def beard(head: Picture, colour: Colour, seed: int) -> Picture:
    """A full beard with its moustache; the lips and what is below them are free."""
    outer = ((180, 118), (187, 128), (193, 138), (202, 138), (212, 133.5), (224, 135), (236, 133.5), (246, 138),
             (255, 138), (262, 128), (269, 116), (267, 146), (260, 164), (248, 178), (226, 187), (204, 180),
             (190, 164), (182, 146))  # fmt: skip
    lips = ((203, 141.5), (213, 138.5), (224, 139.5), (236, 138.5), (245, 141.5), (238, 150), (224, 154), (210, 150))
    where = _soft(head.shape, outer, 3.0) * (1 - _soft(head.shape, lips, 1.4))
    return over(head, _hair_layer(where, colour, seed))


def moustache(head: Picture, colour: Colour, seed: int) -> Picture:
    """A broad one that hangs down beside the mouth."""
    where = ((224, 131), (214, 132), (203, 137), (194, 147), (197, 152), (206, 147), (215, 143.5), (224, 142.5),
             (234, 143.5), (243, 147), (252, 152), (255, 147), (246, 137), (234, 132))  # fmt: skip
    return over(head, _hair_layer(_soft(head.shape, where, 1.5), colour, seed, 0.9, 0.12))


def brows(head: Picture, colour: Colour, seed: int, thick: float) -> Picture:
    """Brows of another colour, `thick` pixels high at their inner ends."""
    out = head
    inner_last = np.array([[0.0, 0.15], [0.0, 0.7], [0.0, 1.0], [0.0, 0.9]]) * thick
    for points, height in ((((187, 92), (196, 89), (205, 89), (215, 92)), inner_last),
                           (((234, 93), (244, 91.5), (254, 91.5), (263, 96)), inner_last[::-1])):  # fmt: skip
        line = np.array(points)
        both = [*(line - 0.35 * height), *(line + 0.65 * height)[::-1]]
        where = _soft(head.shape, [(float(x), float(y)) for x, y in both], 1.2)
        out = over(out, _hair_layer(where, colour, seed, 0.0, 0.08))
    return out


def long_hair(head: Picture, colour: Colour, seed: int) -> Picture:
    """Hair that falls on both sides of the face to the shoulders, and a straight fringe down to the brows."""
    sides = (((196, 40), (184, 72), (180, 100), (181, 130), (186, 160), (186, 200), (178, 226), (146, 226), (146, 160),
              (150, 90), (165, 50)),
             ((252, 40), (266, 76), (270, 100), (268, 130), (262, 160), (262, 200), (270, 226), (306, 226), (306, 160),
              (302, 90), (285, 50)))  # fmt: skip
    out = head
    for points in sides:
        out = over(out, _hair_layer(_soft(head.shape, points, 3.0), colour, seed, 0.0))
    fringe = ((182, 62), (181, 86), (196, 87), (224, 86), (250, 88), (269, 92), (270, 62), (226, 50))
    return over(out, _hair_layer(_soft(head.shape, fringe, 2.0), colour, seed + 2, 0.2))


def glasses(
    head: Picture, colour: Colour, thick: tuple[float, float], half: tuple[float, float], bend: float, tint: float
) -> Picture:
    """Glasses with their shadow on the skin, and a little of the sky in the panes.

    The frame is `thick` above and below; a pane is 2 `half` wide and high; of `bend` 2 it is an oval, of more it has
    corners; `tint` 0..1 darkens it.
    """
    n = 4
    h, w = head.shape[:2]
    frame, pane = np.zeros((h * n, w * n), np.uint8), np.zeros((h * n, w * n), np.uint8)

    def at(x: float, y: float) -> tuple[int, int]:
        return round((x + 0.5) * n), round((y + 0.5) * n)

    line = round(thick[0] * n)
    for x, y in ((202.0, 103.0), (246.5, 104.5)):
        turn = np.linspace(0, 2 * np.pi, 80, endpoint=False)
        rim_x, rim_y = (np.sign(f) * np.abs(f) ** (2 / bend) for f in (np.cos(turn), np.sin(turn)))
        edge = np.array([at(x + half[0] * u, y + half[1] * v) for u, v in zip(rim_x, rim_y, strict=True)], np.int32)
        cv2.polylines(frame, [edge], True, 255, round(thick[1] * n), cv2.LINE_AA)
        cv2.polylines(frame, [edge[40:]], False, 255, line, cv2.LINE_AA)
        cv2.fillPoly(pane, [edge], 255, cv2.LINE_AA)
    gap = 22.25 - half[0]
    cv2.ellipse(frame, at(224.25, 103.5), (round((gap + 0.7) * n), round(5.0 * n)), 0, 180, 360, 255, line, cv2.LINE_AA)
    for x0, x1, y0 in ((202.0 - half[0], 178.0, 101.0), (246.5 + half[0], 271.0, 102.0)):
        cv2.line(frame, at(x0, y0), at(x1, y0 - 1.5), 255, line, cv2.LINE_AA)
    rim, glass = (np.asarray(cv2.resize(m, (w, h), interpolation=cv2.INTER_AREA), np.float32) / 255
                  for m in (frame, pane))  # fmt: skip
    x_at, y_at = grid(head.shape)
    shade = cv2.GaussianBlur(cv2.warpAffine(rim, np.array([[1, 0, 0.5], [0, 1, 2.5]]), (w, h)), (0, 0), 1.6)
    sky = glass * (0.05 + 0.16 * np.exp(-((((x_at % 44.5) - 13.0 + 0.5 * (y_at - 103.0)) / 4.0) ** 2)))
    out = head.copy()
    out[..., :3] *= (1 - 0.4 * shade)[..., None]
    for mask, bgr in ((np.float32(tint) * glass, (46.0, 52.0, 62.0)), (sky, (238.0, 232.0, 226.0)), (rim, colour)):
        out = over(out, np.dstack([mask[..., None] * np.array(bgr), mask]).astype(np.float32))
    return out


def cap(head: Picture, colours: tuple[Colour, Colour], seed: int) -> Picture:
    """A knitted cap down to the brows, its turned-up band in the second colour."""
    x, y = grid(head.shape)
    u = (x - 225.0) / 76.0
    low, band = 83.0 - 10.0 * u**2 + 2.0, 59.0 - 11.0 * u**2
    dome = smoothstep((1.0 - np.hypot(u, (y - 66.0) / 64.0)) / 0.02)
    side = smoothstep((1.0 - np.abs(u) / 1.02) / 0.02)
    body = np.where(y < 66, dome, side) * smoothstep((low - y) / 1.6 + 0.5)
    wide = np.arcsin(np.clip(u, -1, 1))
    rows = np.mod(y / 4.2 + 0.35 * np.abs(np.sin(36.0 * wide)), 1.0)
    ribs = 0.80 + 0.20 * np.abs(np.cos(36.0 * wide))
    knit = np.where(y < band, 0.88 + 0.18 * np.abs(np.cos(np.pi * rows)), ribs)
    knit = knit * (1.06 - 0.42 * np.abs(u) ** 2.2) * (1 - 0.35 * np.exp(-(((y - band) / 2.2) ** 2)))
    knit = knit + 0.05 * _strands(head.shape, seed, 0.8, 1.2, 0.0)
    colour = np.where((y < band)[..., None], np.array(colours[0]), np.array(colours[1]))
    shadow = smoothstep((low + 9.0 - y) / 9.0) * (1 - body) * smoothstep((y - low + 4) / 3.0)
    out = head.copy()
    out[..., :3] *= (1 - 0.45 * shadow)[..., None]
    layer = np.dstack([np.clip(colour * knit[..., None], 0, 245) * body[..., None], body]).astype(np.float32)
    return over(out, cv2.GaussianBlur(layer, (0, 0), 0.5))  # type: ignore[arg-type]


def freckles(head: Picture, seed: int) -> Picture:
    """Over nose and cheeks."""
    rng = np.random.default_rng(seed)
    x, y = grid(head.shape)
    marks = np.zeros(head.shape[:2])
    for _ in range(90):
        at = rng.normal((224.0, 119.0), (24.0, 7.0))
        marks += rng.uniform(0.2, 0.5) * np.exp(-((x - at[0]) ** 2 + (y - at[1]) ** 2) / rng.uniform(0.8, 2.2))
    out = head.copy()
    out[..., :3] *= 1 - np.clip(marks, 0, 0.6)[..., None] * np.array([0.6, 0.5, 0.32])
    return out.astype(np.float32)


Bump = tuple[float, float, float, float, float, float, float, float]


def reshaped(layer: Picture, origin: tuple[float, float], bumps: Sequence[Bump]) -> Picture:
    """The layer with other proportions, after bumps (x, y, rx, ry, dx, dy, sx, sy).

    About each (x, y), over (rx, ry), it is shifted by (dx, dy) and scaled by 1 + (sx, sy). `origin` is the portrait's
    point at the layer's first pixel.
    """
    x, y = grid(layer.shape)
    px, py = x + origin[0], y + origin[1]
    u, v = px.copy(), py.copy()
    for cx, cy, rx, ry, dx, dy, sx, sy in bumps:
        near = np.exp(-0.5 * (((px - cx) / rx) ** 2 + ((py - cy) / ry) ** 2))
        u -= near * (dx + sx / (1 + sx) * (px - cx))
        v -= near * (dy + sy / (1 + sy) * (py - cy))
    out = cv2.remap(layer, (u - origin[0]).astype(np.float32), (v - origin[1]).astype(np.float32), cv2.INTER_CUBIC)
    out[..., 3] = np.clip(out[..., 3], 0, 1)
    return np.asarray(out, dtype=np.float32)
