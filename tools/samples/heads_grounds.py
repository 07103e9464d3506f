"""What is behind the heads, and before one of them: leaves with gourds among them, a room with books, a tree.

All of it is drawn, from fixed seeds, FINE times finer than the clips, (H * FINE, W * FINE, 3) BGR float32.
"""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray
from portraits import Picture
from timeline import Array

FINE = 2

# BGR; the last of the leaves and all gourds have colours such as hair and skin have
_GREENS = ((52, 104, 62), (40, 88, 70), (66, 128, 92), (36, 74, 44), (74, 140, 128))
_AUTUMN = ((62, 118, 158), (46, 84, 122), (88, 150, 186), (110, 154, 206), (52, 66, 150))
_GOURDS = ((128, 164, 212), (104, 142, 196), (70, 112, 152), (146, 182, 222), (56, 92, 130))
_SPINES = ((40, 62, 92), (52, 84, 118), (34, 44, 70), (70, 112, 146), (38, 40, 96), (58, 70, 60), (88, 60, 46),
           (46, 46, 50), (120, 150, 172), (60, 96, 132))  # fmt: skip


def _noise(rng: np.random.Generator, shape: tuple[int, int], sigma: float, strength: float) -> Array:
    """Smooth noise of the given standard deviation, (H, W)."""
    raw = cv2.GaussianBlur(rng.normal(0.0, 1.0, shape), (0, 0), sigma)
    return np.asarray(raw / raw.std() * strength, dtype=np.float64)


def _tint(rng: np.random.Generator, bgr: tuple[int, ...], light: float) -> tuple[float, float, float]:
    b, g, r = (float(np.clip(c * light + rng.normal(0, 6), 0, 255)) for c in bgr)
    return b, g, r


def _leaf(rng: np.random.Generator, canvas: NDArray[np.uint8], depth: float) -> None:
    """One leaf anywhere; depth 0 is far and dark, 1 near and bright."""
    length = rng.uniform(9, 25) * FINE
    angle = rng.uniform(0, 2 * np.pi)
    centre = rng.uniform((0, 0), (canvas.shape[1], canvas.shape[0]))
    palette = _AUTUMN if rng.uniform() < 0.38 else _GREENS
    colour = _tint(rng, palette[rng.integers(len(palette))], 0.38 + 0.75 * depth)
    t = np.linspace(0, 1, 14)
    half = 0.5 * rng.uniform(0.28, 0.5) * np.sin(np.pi * t**0.85)
    bend = rng.uniform(-0.25, 0.25) * np.sin(np.pi * t)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def placed(along: Array, across: Array) -> NDArray[np.int32]:
        points = np.stack([along - 0.5, across], axis=1) * length @ turn.T + centre
        return np.asarray(np.rint(points * 8), dtype=np.int32)

    sides = placed(np.concatenate([t, t[::-1]]), np.concatenate([bend + half, (bend - half)[::-1]]))
    cv2.fillPoly(canvas, [sides], colour, cv2.LINE_AA, 3)
    lit = placed(np.concatenate([t, t[::-1]]), np.concatenate([bend + half, bend[::-1]]))
    cv2.fillPoly(canvas, [lit], _tint(rng, colour, 1.18), cv2.LINE_AA, 3)  # type: ignore[arg-type]
    cv2.polylines(canvas, [placed(t, bend)], False, _tint(rng, colour, 1.45), 1, cv2.LINE_AA, 3)  # type: ignore[arg-type]


def _gourd(rng: np.random.Generator, canvas: NDArray[np.uint8], centre: tuple[float, float]) -> None:
    """A ribbed oval of about the size of the head, darker above, with its shadow on the leaves."""
    a, b = rng.uniform(31, 41) * FINE, rng.uniform(40, 50) * FINE
    height, width = canvas.shape[:2]
    y, x = np.mgrid[:height, :width].astype(np.float32)
    u, v = (x - centre[0] * FINE) / a, (y - centre[1] * FINE) / b
    rho = np.hypot(u, v)
    shadow = np.exp(-0.5 * (np.clip(np.hypot(u - 0.1, v - 0.12) - 0.95, 0, None) / 0.09) ** 2)[..., None]
    ribs = 0.86 + 0.14 * np.abs(np.cos(4.5 * np.arcsin(np.clip(u / np.sqrt(np.clip(1.02 - v**2, 0.04, None)), -1, 1))))
    shade = ribs * (0.55 + 0.5 * np.sqrt(np.clip(1 - rho**2, 0, 1))) * (1.0 - 0.22 * u - 0.12 * v)
    base = np.array(_GOURDS[rng.integers(len(_GOURDS))], dtype=np.float64)
    top = np.array(_GOURDS[2], dtype=np.float64) * 0.75
    cap = 1.0 / (1.0 + np.exp((v + rng.uniform(0.25, 0.6) + 0.12 * np.cos(9 * u)) / 0.07))[..., None]
    mottled = 1.0 + _noise(rng, (height, width), 2.5 * FINE, 0.07)
    body = (base * (1 - cap) + top * cap) * (shade * mottled)[..., None]
    alpha = np.clip((1.0 - rho) * min(a, b) + 0.5, 0, 1)[..., None]
    under = canvas * (1 - 0.55 * shadow)
    canvas[:] = np.clip(under * (1 - alpha) + body * alpha, 0, 255).astype(np.uint8)


def foliage(width: int, height: int) -> Picture:
    """Leaves, green and of autumn, with gourds of the size of a head among them; width and height in clip pixels."""
    rng = np.random.default_rng(21)
    canvas = np.full((height * FINE, width * FINE, 3), (16, 26, 18), np.uint8)
    many = int(width * height / 28)
    for i in range(many):
        _leaf(rng, canvas, 0.8 * i / many)
    columns = max(2, width // 118)
    for row in range(max(1, height // 112)):
        for column in range(columns):
            jitter = rng.uniform(-18, 18, 2)
            at = ((column + 0.5 + 0.4 * (row % 2) - 0.2) * width / columns + jitter[0], 62 + row * 112 + jitter[1])
            _gourd(rng, canvas, at)
    for i in range(many // 5):
        _leaf(rng, canvas, 0.6 + 0.4 * i / (many // 5))
    soft = cv2.GaussianBlur(canvas.astype(np.float32), (0, 0), 0.62 * FINE)
    return np.asarray(soft, dtype=np.float32)


def trunk(height: int, thick: float) -> Picture:
    """A birch's stem, a little crooked: BGR times alpha, and alpha, (height * FINE, 2 thick * FINE, 4)."""
    rng = np.random.default_rng(22)
    h, w = height * FINE, round(2 * thick * FINE)
    y, x = np.mgrid[:h, :w].astype(np.float64)
    crooked = _noise(rng, (h, 1), 40 * FINE, 2.0 * FINE)[:, :1]
    half = 0.5 * thick * FINE * (1.0 + 0.05 * np.sin(y / (47.0 * FINE)))
    u = (x - w / 2 - crooked) / half
    bark = _noise(rng, (h, w), 1.2 * FINE, 9.0) + _noise(rng, (h, w), 14.0 * FINE, 10.0)
    picture = np.array([172.0, 186.0, 194.0]) + bark[..., None]
    for _ in range(height // 4):
        at, wide, tall = rng.uniform(0, h), rng.uniform(0.15, 0.7), rng.uniform(0.6, 2.6) * FINE
        mark = np.exp(-(((u - rng.uniform(-1, 1)) / wide) ** 4) - ((y - at) / tall) ** 2)[..., None]
        picture = picture * (1 - 0.75 * mark)
    picture *= (0.35 + 0.65 * np.sqrt(np.clip(1 - (0.93 * u - 0.12) ** 2, 0, 1)))[..., None]
    alpha = np.clip((1 - np.abs(u)) * half + 0.5, 0, 1)[..., None]
    out: Picture = np.concatenate([np.clip(picture, 0, 255) * alpha, alpha], axis=2).astype(np.float32)
    return out


def _books(rng: np.random.Generator, canvas: Picture, left: int, right: int, floor: int, tall: int) -> None:
    """A row of books from left to right that stand on `floor`, in fine pixels."""
    x = left
    while x < right - 4 * FINE:
        if rng.uniform() < 0.05:  # a gap
            x += round(rng.uniform(5, 12) * FINE)
            continue
        thick = min(round(rng.uniform(5, 14) * FINE), right - x)
        high = round(tall * rng.uniform(0.68, 0.93))
        colour = np.array(_tint(rng, _SPINES[rng.integers(len(_SPINES))], rng.uniform(0.8, 1.25)))
        v = np.linspace(-1, 1, thick)[:, None]
        canvas[floor - high : floor, x : x + thick] = colour * (0.62 + 0.38 * np.sqrt(1 - 0.9 * v**2))
        bright = np.clip(colour * rng.uniform(1.5, 2.2) + 14, 0, 225)
        for at in rng.uniform(0.08, 0.9, rng.integers(1, 4)):
            row, thin = floor - round(at * high), round(rng.uniform(0.6, 2.4) * FINE)
            canvas[max(row, floor - high) : row + thin, x + 1 : x + thick - 1] = bright
        canvas[floor - high : floor, x : x + 1] *= 0.45
        x += thick


def room(width: int, height: int, edge: int) -> Picture:
    """Bookshelves from the left up to `edge`, then a plain wall with an image on it; all in clip pixels."""
    rng = np.random.default_rng(23)
    h, w, side = height * FINE, width * FINE, edge * FINE
    y, x = np.mgrid[:h, :w].astype(np.float64)
    light = 1.0 - 0.16 * (y / h) - 0.10 * np.abs(x / w - 0.7)
    wall = np.array([138.0, 158.0, 170.0]) * light[..., None] + _noise(rng, (h, w), 10.0 * FINE, 1.5)[..., None]
    out = wall.astype(np.float32)
    # a framed image: hills
    fx, fy, fw, fh = side + 96 * FINE, 44 * FINE, 70 * FINE, 52 * FINE
    out[fy : fy + fh, fx : fx + fw] = (40, 52, 66)
    inner = out[fy + 4 * FINE : fy + fh - 4 * FINE, fx + 4 * FINE : fx + fw - 4 * FINE]
    v, u = np.mgrid[0 : 1 : inner.shape[0] * 1j, 0 : 1 : inner.shape[1] * 1j]
    hills = 0.55 + 0.1 * np.sin(7 * u + 1) + 0.04 * np.sin(19 * u)
    inner[:] = np.where(
        (v > hills)[..., None], np.array([64.0, 96.0, 88.0]) * (1.3 - 0.5 * v[..., None]), (186, 176, 160)
    )
    # the case: boards, uprights, rows of books
    out[:, :side] = (22, 32, 44)
    pitch, board = 54 * FINE, 4 * FINE
    bays = np.linspace(0, side, max(2, round(edge / 95)) + 1).astype(int)
    for floor in range(pitch - 8 * FINE, h + pitch, pitch):
        for a, b in pairwise(bays.tolist()):
            canvas = np.concatenate([out, np.zeros((pitch, w, 3), np.float32)]) if floor > h else out
            _books(rng, canvas, a + 5 * FINE, b - 2 * FINE, floor, pitch - board)
            out = canvas[:h]
        out[floor : floor + board, :side] = (58, 88, 116)
        out[floor + board : floor + board + 5 * FINE, :side] *= 0.55
    for at in bays:
        out[:, max(at - 1 * FINE, 0) : at + 4 * FINE] = (62, 94, 124)
        out[:, at + 4 * FINE : at + 5 * FINE] *= 0.5
    grain = 1.0 + _noise(rng, (h, w), 0.8 * FINE, 0.03)
    out = out * grain[..., None].astype(np.float32)
    shade = np.where(x > side + 4 * FINE, np.exp(-(x - side) / (7.0 * FINE)), 0.0)  # the case's shadow on the wall
    out *= (1 - 0.4 * shade)[..., None].astype(np.float32)
    return np.asarray(cv2.GaussianBlur(out, (0, 0), 0.4 * FINE), dtype=np.float32)
