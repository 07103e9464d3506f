"""What comes before the face: a book, held flat or by its spine, drawn from nothing but lines and noise."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from portraits import Picture
from timeline import Array

FINE = 3  # the book is drawn this many times finer than the clip, and reduced at the end


@dataclass(frozen=True)
class Held:
    """An object in the image: its drawing, FINE times enlarged, the grip in it, where that is and how it tilts."""

    drawing: Picture
    grip: tuple[float, float]  # in pixels of the clip from the top left of the drawing
    path: Array  # (frames, 2) pixels of the clip
    tilt: Array  # (frames,) degrees, clockwise


def book(rng: np.random.Generator, width: int, height: int, lines: tuple[str, ...], bgr: tuple[int, ...]) -> Picture:
    """A book of width x height clip pixels: cloth, gilt frame and title, (H * FINE, W * FINE, 3)."""
    w, h = width * FINE, height * FINE
    y, x = np.mgrid[:h, :w]
    weave = 7.0 * np.sin(x * 1.3) * np.sin(y * 1.3) + cv2.GaussianBlur(rng.normal(0, 26, (h, w)), (0, 0), 1.6)
    wear = cv2.GaussianBlur(rng.normal(0, 160, (h, w)), (0, 0), 9.0)
    light = 1.0 + 0.12 * (0.5 - y / h) + 0.05 * (0.5 - x / w)
    out = (np.array(bgr, dtype=np.float64) + (weave + wear)[..., None] * 0.9) * light[..., None]
    picture = np.clip(out, 0, 255).astype(np.uint8)
    gilt = (88, 168, 205)
    inset = 4 * FINE if height > 30 else 2 * FINE
    cv2.rectangle(picture, (inset, inset), (w - 1 - inset, h - 1 - inset), gilt, FINE, cv2.LINE_AA)
    face, size = cv2.FONT_HERSHEY_TRIPLEX, 0.026 * min(h / (len(lines) + 1.0), 22 * FINE)
    for i, line in enumerate(lines):
        (tw, th), _ = cv2.getTextSize(line, face, size, 2)
        at = ((w - tw) // 2, int(h * (i + 1) / (len(lines) + 1) + th / 2))
        cv2.putText(picture, line, at, face, size, gilt, 2, cv2.LINE_AA)
    rim = np.minimum(np.minimum(x, w - 1 - x), np.minimum(y, h - 1 - y))[..., None]
    worn: Picture = (picture * np.clip(0.55 + 0.45 * rim / (1.2 * FINE), 0, 1)).astype(np.float32)
    return worn


def cover(scene: Picture, held: Held, frame: int) -> tuple[Picture, Picture]:
    """The scene with the object and its soft shadow before it, and how far each pixel is covered, (H, W) 0..1."""
    size = (scene.shape[1] * FINE, scene.shape[0] * FINE)
    turn = cv2.getRotationMatrix2D((held.grip[0] * FINE, held.grip[1] * FINE), -float(held.tilt[frame]), 1.0)
    turn[:, 2] += (held.path[frame] - np.array(held.grip)) * FINE + (FINE - 1) / 2
    drawn = cv2.warpAffine(held.drawing, turn, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    mask = cv2.warpAffine(np.ones(held.drawing.shape[:2], np.float32), turn, size, flags=cv2.INTER_LINEAR)
    small = (scene.shape[1], scene.shape[0])
    alpha = np.asarray(cv2.resize(mask, small, interpolation=cv2.INTER_AREA), dtype=np.float32)
    colour = cv2.resize(drawn * mask[..., None], small, interpolation=cv2.INTER_AREA)
    shift = np.array([[1.0, 0.0, 3.0], [0.0, 1.0, 4.0]])
    shadow = cv2.GaussianBlur(cv2.warpAffine(alpha, shift, small), (0, 0), 4.0)[..., None]
    dark = scene * (1.0 - 0.35 * shadow)
    return (dark * (1.0 - alpha[..., None]) + colour).astype(np.float32), alpha
