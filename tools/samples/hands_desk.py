"""The ground under the hands: a cluttered desk, and what lies on it to be taken up and moved."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from occluders import FINE as BOOK_FINE
from occluders import book
from timeline import smoothstep

Picture = NDArray[np.float32]
FINE = 3  # as books have it
WORLD = (460, 350)  # the desk in pixels of the clip
ORIGIN = (70.0, 55.0)  # the picture's upper left corner on it, when the camera is at rest
assert FINE == BOOK_FINE


@dataclass(frozen=True)
class Sheet:
    """A thing that lies flat: colour (h, w, 3) and coverage (h, w), both FINE times enlarged, and how thick it is."""

    colour: Picture
    alpha: Picture
    height: float


def _card(picture: Picture, height: float = 0.8, round_by: float = 0.0) -> Sheet:
    h, w = picture.shape[:2]
    alpha = np.ones((h, w), np.float32)
    if round_by:
        y, x = np.mgrid[:h, :w].astype(np.float32)
        r = round_by * FINE
        dx = np.maximum(np.abs(x - (w - 1) / 2) - (w / 2 - r), 0)
        dy = np.maximum(np.abs(y - (h - 1) / 2) - (h / 2 - r), 0)
        alpha = np.clip(r - np.hypot(dx, dy) + 0.5, 0, 1).astype(np.float32)
    return Sheet(np.asarray(picture, np.float32), alpha, height)


def _flat(w: float, h: float, bgr: tuple[float, ...]) -> NDArray[np.uint8]:
    return np.full((round(h * FINE), round(w * FINE), 3), bgr, np.uint8)


def _wood(rng: np.random.Generator) -> Picture:
    """Planks of oak along x, with rings, pores and seams."""
    w, h = WORLD[0] * FINE, WORLD[1] * FINE
    y, x = np.mgrid[:h, :w].astype(np.float32)
    out = np.zeros((h, w, 3), np.float32)
    plank = 74 * FINE
    for i in range(h // plank + 1):
        rows = slice(i * plank, min((i + 1) * plank, h))
        px, py = x[rows] + 977 * i, y[rows] - i * plank
        slow = cv2.GaussianBlur(rng.normal(0, 1, px.shape).astype(np.float32), (0, 0), 60, sigmaY=14) * 260
        rings = np.sin((py + 3.0 * slow + 20 * np.sin(px / 700)) / (5.5 + 1.5 * i % 3))
        pores = cv2.GaussianBlur(rng.normal(0, 1, px.shape).astype(np.float32), (0, 0), 14, sigmaY=0.8) * 4
        tone = 1 + 0.07 * rings + 0.07 * pores + rng.uniform(-0.07, 0.07)
        seam = 1 - 0.5 * np.exp(-((py / 2.0) ** 2))
        out[rows] = np.array([104, 117, 127], np.float32) * (tone * seam)[..., None]
    return out


def _paper(rng: np.random.Generator, w: int, h: int, lines: int, ink: tuple[int, ...], title: str = "") -> Sheet:
    """A printed page: words as runs of little strokes, and a line drawing if there is room."""
    page = _flat(w, h, (226, 232, 234))
    top = 9 * FINE
    if title:
        cv2.putText(page, title, (7 * FINE, 12 * FINE), cv2.FONT_HERSHEY_TRIPLEX, 0.30 * FINE, ink, 2, cv2.LINE_AA)
        top = 19 * FINE
    for i in range(lines):
        x, base = 7 * FINE, top + i * 5 * FINE
        end = (w - 7) * FINE if rng.uniform() > 0.2 else int(w * FINE * rng.uniform(0.4, 0.9))
        while x < end and base < (h - 5) * FINE:
            n = int(rng.integers(2, 9))
            for _ in range(n):
                low, high = base, base - int(rng.integers(5, 8))
                cv2.line(page, (x, low), (x + int(rng.integers(-1, 2)), high), ink, 1, cv2.LINE_AA)
                cv2.circle(page, (x + 2, low - 2), 2, ink, 1, cv2.LINE_AA)
                x += int(rng.integers(4, 7))
            x += 6
    return _card(page.astype(np.float32), 0.5)


def _graph(rng: np.random.Generator, w: int, h: int) -> Sheet:
    """A sheet of squared paper with curves in red and blue."""
    page = _flat(w, h, (222, 228, 226))
    for k in range(0, max(w, h), 5):
        tone = (206, 196, 160) if k % 25 else (186, 166, 120)
        cv2.line(page, (k * FINE, 0), (k * FINE, h * FINE), tone, 1)
        cv2.line(page, (0, k * FINE), (w * FINE, k * FINE), tone, 1)
    t = np.linspace(0, 1, 200)
    for ink, a, b in (((60, 60, 190), 9.0, 0.45), ((170, 80, 40), 6.0, 0.60)):
        y = b - 0.25 * np.sin(a * t + rng.uniform(0, 3)) * np.exp(-1.2 * t)
        curve = np.stack([(8 + t * (w - 16)) * FINE, y * h * FINE], axis=1).astype(np.int32)
        cv2.polylines(page, [curve], False, ink, 3, cv2.LINE_AA)
    return _card(page.astype(np.float32), 0.5)


def _print(rgb: NDArray[np.uint8], w: int, h: int, border: float = 3.0) -> Sheet:
    """A photograph on paper, with a white border."""
    out = _flat(w, h, (236, 238, 238)).astype(np.float32)
    b = round(border * FINE)
    size = (out.shape[1] - 2 * b, out.shape[0] - 2 * b)
    out[b:-b, b:-b] = cv2.resize(rgb[:, :, ::-1].astype(np.float32), size, interpolation=cv2.INTER_AREA) * 0.94
    return _card(out, 0.6)


def playing_card(rank: str, suit: str) -> Sheet:
    """A card with a heart, a diamond or a spade in the middle."""
    w, h = 33, 46
    page = _flat(w, h, (232, 236, 238))
    ink = (40, 36, 34) if suit == "spade" else (48, 40, 190)
    cx, cy, r = w * FINE // 2, h * FINE // 2, 6 * FINE
    if suit == "diamond":
        shape = np.array([(cx, cy - int(1.6 * r)), (cx + r, cy), (cx, cy + int(1.6 * r)), (cx - r, cy)])
    else:
        t = np.linspace(0, 2 * np.pi, 80)
        x, y = 16 * np.sin(t) ** 3, -(13 * np.cos(t) - 5 * np.cos(2 * t) - 2 * np.cos(3 * t) - np.cos(4 * t))
        flip = -1 if suit == "spade" else 1
        shape = np.stack([cx + x * r / 14, cy + flip * y * r / 14], axis=1)
        if suit == "spade":
            stem = np.array([(cx, cy), (cx - 8, cy + int(1.5 * r)), (cx + 8, cy + int(1.5 * r))], np.int32)
            cv2.fillPoly(page, [stem], ink, cv2.LINE_AA)
    cv2.fillPoly(page, [np.asarray(shape, np.int32)], ink, cv2.LINE_AA)
    cv2.putText(page, rank, (3 * FINE, 10 * FINE), cv2.FONT_HERSHEY_DUPLEX, 0.30 * FINE, ink, 2, cv2.LINE_AA)
    corner = page[: 12 * FINE, : 11 * FINE][::-1, ::-1].copy()
    page[-12 * FINE :, -11 * FINE :] = corner
    cv2.rectangle(page, (1, 1), (w * FINE - 2, h * FINE - 2), (170, 172, 172), 2)
    return _card(page.astype(np.float32), 0.6, 2.6)


def _coin(radius: float, bgr: tuple[float, ...], rng: np.random.Generator) -> Sheet:
    """A disc of metal with a rim, a relief and beads."""
    n = round(2 * radius * FINE) + 3
    y, x = (np.mgrid[:n, :n].astype(np.float32) - (n - 1) / 2) / FINE
    r = np.hypot(x, y)
    relief = cv2.GaussianBlur(rng.normal(0, 1, (n, n)).astype(np.float32), (0, 0), 3.2) * 6 * (r < 0.68 * radius)
    beads = 0.7 * np.cos(np.arctan2(y, x) * 28) * np.exp(-(((r - 0.8 * radius) / 0.5) ** 2))
    surface = relief + beads + 1.6 * np.exp(-(((r - 0.94 * radius) / 0.5) ** 2))
    lit = 0.9 + 0.25 * (cv2.Sobel(surface, cv2.CV_32F, 1, 0) + cv2.Sobel(surface, cv2.CV_32F, 0, 1)) * 0.5
    lit -= 0.12 * (x + y) / radius
    out = np.array(bgr, np.float32) * np.clip(lit, 0.35, 1.5)[..., None]
    return Sheet(out.astype(np.float32), np.clip((radius - r) * FINE + 0.5, 0, 1).astype(np.float32), 1.2)


def pencil(length: int, bgr: tuple[float, ...], width: int = 6) -> Sheet:
    """A six-sided pencil, sharpened at the left, with its ferrule and rubber at the right."""
    w, h = length * FINE, width * FINE
    y, x = np.mgrid[:h, :w].astype(np.float32)
    v = np.abs(y - (h - 1) / 2) / (h / 2)
    side = np.select([y < h * 0.3, y < h * 0.7], [1.15, 1.0], 0.72)
    out = np.array(bgr, np.float32) * side[..., None]
    cone = 13 * FINE
    wood = np.array([140, 178, 206], np.float32) * side[..., None]
    out = np.where((x < cone + 3 * np.cos(y / h * 18))[..., None], wood, out)
    out = np.where((x < 4.2 * FINE)[..., None], np.array([52, 50, 50], np.float32), out)
    out = np.where((x > w - 13 * FINE)[..., None], np.array([150, 158, 160], np.float32) * side[..., None], out)
    out = np.where((x > w - 7 * FINE)[..., None], np.array([128, 134, 206], np.float32) * side[..., None], out)
    alpha = np.clip((np.minimum(1.0, x / cone) - v) * h / 2 + 0.5, 0, 1)
    return Sheet(out.astype(np.float32), alpha.astype(np.float32), 2.0)


def _ruler(length: int) -> Sheet:
    """A wooden ruler, of nearly the colour of skin."""
    page = _flat(length, 15, (128, 172, 204))
    for k in range(3, length - 3, 3):
        n = (k - 3) // 3
        long = 6 if n % 10 == 0 else 4 if n % 5 == 0 else 3
        cv2.line(page, (k * FINE, 0), (k * FINE, long * FINE), (50, 60, 70), 1)
        if n % 10 == 0:
            at = (k * FINE - 4, 12 * FINE)
            cv2.putText(page, str(n // 10), at, cv2.FONT_HERSHEY_SIMPLEX, 0.15 * FINE, (50, 60, 70), 1, cv2.LINE_AA)
    return _card(page.astype(np.float32), 1.2)


def _note(bgr: tuple[float, ...], words: tuple[str, ...]) -> Sheet:
    page = _flat(42, 42, bgr)
    for i, word in enumerate(words):
        at = (5 * FINE, (13 + 11 * i) * FINE)
        cv2.putText(page, word, at, cv2.FONT_HERSHEY_SCRIPT_SIMPLEX, 0.36 * FINE, (70, 50, 40), 2, cv2.LINE_AA)
    return _card(page.astype(np.float32), 0.6)


def cup(radius: float = 25.0) -> Sheet:
    """A cup of coffee on its saucer, from above."""
    n = round(2 * radius * FINE) + 3
    y, x = (np.mgrid[:n, :n].astype(np.float32) - (n - 1) / 2) / FINE
    r = np.hypot(x, y) / radius
    lean = (x + y) / radius

    def ring(at: float, wide: float) -> Picture:
        return np.asarray(np.exp(-(((r - at) / wide) ** 2)), np.float32)

    china = np.array([170, 120, 84], np.float32)
    out = china * (0.95 - 0.10 * lean + 0.25 * ring(0.94, 0.04) - 0.2 * ring(0.78, 0.06))[..., None]
    cupped = smoothstep((0.62 - r) * 40)[..., None]
    out = out * (1 - cupped) + cupped * np.array([222, 226, 226], np.float32) * (0.92 - 0.1 * lean)[..., None]
    coffee = smoothstep((0.52 - r) * 40)[..., None]
    foam = np.array([70, 128, 178], np.float32) * (0.75 + 0.35 * ring(0.40, 0.12) + 0.12 * lean)[..., None]
    out = out * (1 - coffee) + coffee * foam
    alpha = np.clip((1 - r) * radius * FINE + 0.5, 0, 1)
    return Sheet(out.astype(np.float32), alpha.astype(np.float32), 4.0)


def place(ground: Picture, sheet: Sheet, x: float, y: float, degrees: float) -> None:
    """Lay the thing down in place, its middle at (x, y) pixels of the clip, turned clockwise, with its soft shadow."""
    h, w = sheet.alpha.shape
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    cx, cy = (x + 0.5) * FINE - 0.5, (y + 0.5) * FINE - 0.5
    m = np.array([[c, -s, cx - c * (w - 1) / 2 + s * (h - 1) / 2], [s, c, cy - s * (w - 1) / 2 - c * (h - 1) / 2]])
    reach = int(np.hypot(w, h) / 2 + 14 * FINE)
    x0, y0 = max(int(cx) - reach, 0), max(int(cy) - reach, 0)
    x1, y1 = min(int(cx) + reach, ground.shape[1]), min(int(cy) + reach, ground.shape[0])
    if x1 <= x0 or y1 <= y0:
        return
    m[:, 2] -= (x0, y0)
    size = (x1 - x0, y1 - y0)
    colour = cv2.warpAffine(sheet.colour, m, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    alpha = cv2.warpAffine(sheet.alpha, m, size, flags=cv2.INTER_LINEAR)
    off = sheet.height * FINE
    moved = cv2.warpAffine(alpha, np.array([[1.0, 0, 0.8 * off], [0, 1.0, 0.9 * off]]), size)
    shadow = cv2.GaussianBlur(moved, (0, 0), 0.6 * off + 0.6)[..., None]
    part = ground[y0:y1, x0:x1]
    ground[y0:y1, x0:x1] = part * (1 - 0.5 * shadow) * (1 - alpha[..., None]) + colour * alpha[..., None]


def desk() -> Picture:
    """The ground with everything that stays where it is, (WORLD[1] * FINE, WORLD[0] * FINE, 3)."""
    from skimage import data

    rng = np.random.default_rng(31)
    out = _wood(rng)

    def photo(name: str) -> NDArray[np.uint8]:
        return np.asarray(getattr(data, name)(), dtype=np.uint8)

    def bound(w: int, h: int, lines: tuple[str, ...], bgr: tuple[int, ...]) -> Sheet:
        return _card(book(rng, w, h, lines, bgr), 3.0, 1.0)

    mat = _flat(215, 150, (104, 112, 70))
    for k in range(10, 215, 10):
        cv2.line(mat, (k * FINE, 0), (k * FINE, 150 * FINE), (128, 138, 96), 1 if k % 50 else 2)
        cv2.line(mat, (0, k * FINE), (215 * FINE, k * FINE), (128, 138, 96), 1 if k % 50 else 2)
    things: list[tuple[Sheet, float, float, float]] = [
        (_card(mat.astype(np.float32), 1.0, 4.0), 235, 165, -4),
        (_paper(rng, 92, 122, 24, (70, 60, 60), "THE HAND"), 92, 130, -14),
        (_graph(rng, 100, 80), 345, 120, 11),
        (_paper(rng, 84, 110, 20, (80, 70, 60)), 330, 235, -9),
        (bound(120, 84, ("PARTICLE", "FILTERS"), (64, 50, 108)), 60, 55, 7),
        (bound(96, 70, ("ATLAS",), (60, 96, 150)), 130, 280, -6),
        (bound(86, 112, ("MOTION",), (92, 62, 38)), 418, 185, 4),
        (bound(130, 60, ("LETTERS",), (66, 84, 46)), 255, 40, -3),
        (_print(photo("coffee"), 78, 54), 172, 94, -12),
        (_print(photo("chelsea"), 76, 54), 346, 236, 14),
        (_print(photo("astronaut")[:300, 70:400], 52, 49), 226, 232, -7),
        (_print(photo("rocket"), 72, 50), 52, 218, 16),
        (_note((120, 214, 240), ("call", "at ten")), 390, 72, -8),
        (_note((176, 190, 240), ("t - 1", "then t")), 176, 258, 9),
        (_ruler(130), 300, 84, -31),
        (cup(), 392, 268, 0),
        (cup(21.0), 28, 150, 0),
        (playing_card("K", "heart"), 258, 120, 24),
        (playing_card("7", "spade"), 274, 130, 47),
        (playing_card("A", "diamond"), 110, 84, -33),
        (pencil(92, (58, 176, 226)), 196, 156, 28),
        (pencil(80, (70, 64, 190)), 352, 190, -58),
        (pencil(84, (150, 96, 50)), 104, 214, -20),
    ]  # fmt: skip
    copper, brass, silver = (84, 124, 178), (93, 159, 188), (169, 172, 176)
    coins = [(206, 118, 8.5, copper), (300, 184, 8.0, copper), (222, 108, 7.0, silver), (246, 196, 8.5, brass),
             (262, 206, 6.5, copper), (132, 150, 8.0, copper), (318, 140, 7.5, silver), (178, 238, 9.0, brass),
             (332, 66, 8.0, copper)]  # fmt: skip
    things += [(_coin(radius, bgr, rng), at_x, at_y, float(rng.uniform(0, 360))) for at_x, at_y, radius, bgr in coins]
    for sheet, at_x, at_y, degrees in things:
        place(out, sheet, at_x, at_y, degrees)
    y, x = np.mgrid[: out.shape[0], : out.shape[1]].astype(np.float32)
    lamp = 1.06 - 0.16 * np.hypot(x / out.shape[1] - 0.35, y / out.shape[0] - 0.3)
    return np.asarray(np.clip(out * lamp[..., None], 0, 255), dtype=np.float32)
