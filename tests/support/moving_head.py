"""Frames of a head of two colours that moves and grows before a plain ground; its box is known."""

from functools import cache

import cv2
import numpy as np

from facetrack_cli.core.types import Frame, Start, TargetStart

W, H = 40.0, 52.0
START = (100.0, 60.0, W, H)


def scene(cx, cy, s, *, grey=False):
    """A head of two colours, an ellipse in the box of (W s, H s) around (cx, cy), before a plain ground with lines."""
    y, x = np.mgrid[:200, :260].astype(float)
    ground = np.stack([120 + 30 * np.sin(x / 9), 110 + 25 * np.cos(y / 11), 90 + 0.2 * x], axis=2)
    u, v = (x - cx) / (W * s / 2), (y - cy) / (H * s / 2)
    skin = np.stack([110 + 20 * u, 150 + 25 * v, 215 + 20 * np.sin(6 * u) * np.cos(5 * v)], axis=2)
    hair = np.array([30.0, 45.0, 70.0])
    head = np.where((v < -0.45)[..., None], hair, skin)
    # eyes and mouth, so that the inside moves with the outline
    for du, dv in ((-0.4, -0.1), (0.4, -0.1), (0.0, 0.5)):
        head[(np.abs(u - du) < 0.18) & (np.abs(v - dv) < 0.09)] = (40, 40, 60)
    cover = np.clip((1 - np.hypot(u, v)) * W * s / 2 + 0.5, 0, 1)[..., None]
    picture = np.clip(ground * (1 - cover) + head * cover, 0, 255).astype(np.uint8)
    return cv2.cvtColor(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR) if grey else picture


def path(n):
    """Centre and scale in frame n; frame 0 has START."""
    return 119.5 + 45 * np.sin(n / 9), 85.5 + 20 * (1 - np.cos(n / 7)), 1 + 0.2 * np.sin(n / 15)


@cache
def clip(count=45, **options):
    return [Frame(n, n / 25, scene(*path(n), **options)) for n in range(count)]


def truth(count=45):
    places = np.array([path(n) for n in range(count)])
    w, h = W * places[:, 2], H * places[:, 2]
    return np.stack([places[:, 0] - (w - 1) / 2, places[:, 1] - (h - 1) / 2, w, h], axis=1)


def start(box=START, name="head"):
    return Start(0, {name: TargetStart(box=box)}, "clip.init.yaml")
