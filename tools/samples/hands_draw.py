"""A hand and its arm as an image: skin with its grain, creases and nails under one lamp, and a knitted sleeve."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from hands_model import FINE, SHIFT, WRIST, Picture, Pose, Surface, capsule, digits, palm, step

UPPER_RADII = (18.5, 19.5)  # of the sleeve at the elbow and at the shoulder, in hand coordinates
LIGHT = np.array([-0.46, -0.52, 0.72]) / np.linalg.norm([-0.46, -0.52, 0.72])


@dataclass(frozen=True)
class Skin:
    """Colour of the skin, BGR 0..255, its grain (h, w) about 0 as a seamless tile, and the cloth of the sleeve."""

    colour: tuple[float, float, float]
    grain: Picture
    cloth: tuple[float, float, float]


@dataclass
class Layer:
    """A hand and its arm over the whole image: premultiplied colour (H, W, 3), and coverages (H, W) 0..1."""

    colour: Picture
    hand: Picture  # palm and fingers
    palm: Picture  # the palm as if the fingers were not there, which does not bend
    dot: Picture  # a disc of radius 4 about the box's centre
    alpha: Picture  # hand, wrist and sleeve
    lift: float  # how far above what is beneath, in pixels: of the shadow


def _lit(height: Picture, scale: float, roughness: Picture) -> tuple[Picture, Picture]:
    """Light on a surface, diffuse and glossy, of a height in hand units on the fine grid."""
    bumpy = cv2.GaussianBlur(height * np.float32(scale * FINE), (0, 0), 1.0) + roughness
    gx, gy = cv2.Sobel(bumpy, cv2.CV_32F, 1, 0, scale=0.125), cv2.Sobel(bumpy, cv2.CV_32F, 0, 1, scale=0.125)
    norm = np.sqrt(gx * gx + gy * gy + 1.0)
    facing = (-gx * LIGHT[0] - gy * LIGHT[1] + LIGHT[2]) / norm
    half = LIGHT + np.array([0.0, 0.0, 1.0])
    half /= np.linalg.norm(half)
    gloss = np.clip((-gx * half[0] - gy * half[1] + half[2]) / norm, 0, 1) ** 24
    # skin scatters: the light goes a little around the corner
    return np.asarray(np.clip((facing + 0.30) / 1.30, 0, 1), np.float32), gloss.astype(np.float32)


def _sample(tile: Picture, u: Picture, v: Picture, per_pixel: float) -> Picture:
    """A tile that repeats without a seam, read at hand coordinates."""
    h, w = tile.shape[:2]
    mu, mv = np.mod(u * per_pixel, w - 1).astype(np.float32), np.mod(v * per_pixel, h - 1).astype(np.float32)
    return np.asarray(cv2.remap(tile, mu, mv, cv2.INTER_LINEAR), dtype=np.float32)


def _skin_colour(surface: Surface, pose: Pose, skin: Skin) -> Picture:
    grain = _sample(skin.grain, surface.u, surface.v, 2.0)
    large = _sample(skin.grain, surface.u + 7, surface.v + 3, 0.55)
    # fine lines all over, and those across the joints
    light, gloss = _lit(surface.height, pose.scale, 0.10 * grain - 0.9 * surface.crease)
    # nooks between the fingers get less of the sky
    nook = cv2.GaussianBlur(surface.height, (0, 0), 2.4 * FINE * pose.scale) - surface.height
    sky = np.clip(1.0 - 0.075 * np.clip(nook, -1, 8), 0.35, 1.05)
    depth = np.clip(1.0 + 0.020 * np.minimum(surface.height - 6.0, 0), 0.6, 1.0)
    albedo = np.array(skin.colour, np.float32) / 255
    albedo = albedo * (1 + 0.035 * grain + 0.05 * large)[..., None]
    red = np.stack([0.16 * surface.tint, 0.15 * surface.tint, 0.03 * surface.tint], axis=-1)
    albedo = albedo * (1 - red - 0.10 * surface.crease[..., None] * np.array([1.1, 1.0, 0.6], np.float32))
    nail = surface.nail[..., None]
    rim = (4 * nail * (1 - nail)) * np.array([0.16, 0.14, 0.07], np.float32)
    albedo = albedo * (1 - 0.85 * nail) + np.array([0.70, 0.74, 0.93], np.float32) * 0.85 * nail - rim
    lit = (0.33 * sky + 0.74 * light * (0.5 + 0.5 * sky)) * depth
    # what is in shade goes red before it goes dark
    shade = np.stack([lit**1.16, lit**1.10, lit**0.92], axis=-1)
    out = 255 * (albedo * shade * 1.06 + (0.05 + 0.10 * surface.nail)[..., None] * gloss[..., None])
    return np.asarray(out, dtype=np.float32)


def _cloth_colour(along: Picture, across: Picture, height: Picture, pose: Pose, skin: Skin) -> Picture:
    """A knitted sleeve: ribs about the cuff, folds further up."""
    cuff = step((9.0 - along) / 1.5)
    ribs = 0.30 * np.sin(across * 2.6) * cuff
    wave = np.sin(along / 3.1 + 1.1 * np.sin(across / 4.0 + along / 9.0))
    folds = 0.9 * (1.0 - cuff) * wave * step(np.asarray(along / 30, np.float32))
    knit = 0.25 * np.sin(along * 4.2) * np.sin(across * 4.2)
    hem = -0.9 * np.exp(-(((along - 9.0) / 0.8) ** 2)) - 0.7 * np.exp(-(((along + 0.2) / 0.9) ** 2))
    light, _ = _lit(height + ribs + folds + hem, pose.scale, (0.8 * knit).astype(np.float32))
    shade = (0.34 + 0.80 * light + 0.05 * knit)[..., None]
    return np.asarray(np.array(skin.cloth, np.float32) * shade, dtype=np.float32)


def _edge(sdf: Picture, scale: float) -> Picture:
    return np.asarray(np.clip(0.5 - sdf * (scale * FINE), 0, 1), dtype=np.float32)


def _reduced(picture: Picture, window: tuple[int, int, int, int], size: tuple[int, int]) -> Picture:
    """A fine window (left, top, width, height in pixels of the clip) as part of a whole image, by area means."""
    left, top, w, h = window
    small = cv2.resize(picture, (w, h), interpolation=cv2.INTER_AREA)
    out = np.zeros((size[1], size[0], *picture.shape[2:]), np.float32)
    x0, y0, x1, y1 = max(left, 0), max(top, 0), min(left + w, size[0]), min(top + h, size[1])
    if x1 > x0 and y1 > y0:
        out[y0:y1, x0:x1] = small[y0 - top : y1 - top, x0 - left : x1 - left]
    return out


def _sleeve(d: Picture, off: Picture, pose: Pose, skin: Skin, end: float = np.inf) -> tuple[Picture, Picture, Picture]:
    """Colour and coverage of the sleeve, and its shade on the wrist; d along the arm from the hem, off its axis.

    The sleeve is rounded off at d = `end`, the elbow.
    """
    r = 10.2 + 0.085 * np.clip(d, 0, end)
    beyond = np.clip(d - end, 0, None)
    d = d + 1.6 * (1 - np.clip((off / r) ** 2, 0, 1)) - 1.2  # the hem goes round the arm
    away = np.hypot(off, beyond) if np.isfinite(end) else np.abs(off)
    dome = r * 0.9 * np.sqrt(np.clip(1 - (away / r) ** 2, 0.002, 1))
    cloth = _edge(np.asarray(np.maximum(away - r, -d), np.float32), pose.scale)
    shade = 1 - 0.45 * np.exp(-np.clip(-d, 0, None) / 1.2) * (d < 0)
    d, off, dome, shade = (np.asarray(v, np.float32) for v in (d, off, dome, shade))
    return _cloth_colour(d, off, dome, pose, skin), cloth, shade


def _upper_arm(x: Picture, y: Picture, elbow: tuple[float, float], pose: Pose, skin: Skin) -> tuple[Picture, Picture]:
    """Colour and coverage of the sleeve from the elbow to the shoulder; the elbow in the coordinates of FINGERS."""
    assert pose.shoulder is not None
    sx, sy = (float(v[0]) for v in pose.to_hand(*(np.array([v], np.float32) for v in pose.shoulder)))
    arm, _, across = capsule(x, y, (*elbow, 0.0), (sx - SHIFT[0], sy - SHIFT[1], 0.0), UPPER_RADII)
    colour = _cloth_colour(arm.v + 40, np.asarray(across * UPPER_RADII[0], np.float32), arm.height, pose, skin)
    return colour, _edge(arm.sdf, pose.scale)


def draw(pose: Pose, skin: Skin, size: tuple[int, int]) -> Layer:
    """The hand at its pose, with its arm to the edge of the image, in an image of `size` (width, height)."""
    reach = 46 * pose.scale
    ex, ey = pose.elbow
    left, top = int(np.floor(min(pose.x - reach, max(ex - 24, -30)))), int(np.floor(pose.y - reach))
    right = int(np.ceil(max(pose.x + reach, min(ex + 24, size[0] + 30))))
    bottom = int(np.ceil(max(pose.y + reach, min(ey, size[1] + 4))))
    if pose.shoulder is not None:
        room, (sx, sy) = round(26 * pose.scale), pose.shoulder
        left, right = min(left, round(sx) - room), max(right, round(sx) + room)
        top, bottom = min(top, round(sy) - room), min(max(bottom, round(ey) + room, round(sy) + room), size[1] + 4)
    w, h = right - left, bottom - top
    across_x, down_y = ((np.arange(n * FINE) + 0.5) / FINE - 0.5 + first for n, first in ((w, left), (h, top)))
    x, y = pose.to_hand(*np.meshgrid(across_x.astype(np.float32), down_y.astype(np.float32)))
    x, y = x - np.float32(SHIFT[0]), y - np.float32(SHIFT[1])  # the coordinates of FINGERS
    surface = palm(x, y)
    palm_sdf = surface.sdf.copy()
    for rows, cols, digit in digits(x, y, pose):
        surface.take_at(rows, cols, digit, 1.6)
    hand = _edge(surface.sdf, pose.scale)
    # the arm, towards the elbow
    elbow_x, elbow_y = (float(v[0]) for v in pose.to_hand(np.array([ex], np.float32), np.array([ey], np.float32)))
    away = np.array([elbow_x - SHIFT[0] - WRIST[0], elbow_y - SHIFT[1] - WRIST[1]])
    span = float(np.linalg.norm(away))
    away /= span
    end = (WRIST[0] + away[0] * span, WRIST[1] + away[1] * span, 3.0)
    arm, along, across = capsule(x, y, (*WRIST, 0.0), end, (8.6, 8.6 + 0.075 * span))
    arm.u, arm.v = arm.u + 3, arm.v + 34
    surface.take(arm, 2.5)
    bare = _edge(surface.sdf, pose.scale)
    off = across * (8.6 + 0.075 * span * np.clip(along, 0, 1))
    bent = pose.shoulder is not None
    knit, cloth, shade = _sleeve(along * span - 12.0, off, pose, skin, span - 12.0 if bent else np.inf)
    colour = _skin_colour(surface, pose, skin) * shade[..., None]
    alpha = np.maximum(bare, cloth)
    colour = (colour * bare[..., None]) * (1 - cloth[..., None]) + knit * cloth[..., None]
    if bent:
        cloth_above, above = _upper_arm(x, y, (end[0], end[1]), pose, skin)
        colour = colour + cloth_above * (above * (1 - alpha))[..., None]
        alpha = alpha + above * (1 - alpha)
    window = (left, top, w, h)
    dot = _edge(np.hypot(x + SHIFT[0], y + SHIFT[1]) - 4.0, pose.scale)
    pictures: Mapping[str, Picture] = {
        "colour": colour, "hand": np.minimum(hand, 1 - cloth), "palm": _edge(palm_sdf, pose.scale), "dot": dot,
        "alpha": alpha,
    }  # fmt: skip
    small = {name: _reduced(np.asarray(p, np.float32), window, size) for name, p in pictures.items()}
    return Layer(**small, lift=float(np.clip(5 + 30 * (pose.scale - 1), 3, 12)))
