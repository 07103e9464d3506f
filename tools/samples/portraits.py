"""The two portraits, both in the public domain, as installed packages carry them, with what was measured by hand."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from timeline import Array, smoothstep
from warp import Anatomy, Point

Picture = NDArray[np.float32]
MARGIN = 90
PARTS = ("nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower")


@dataclass(frozen=True)
class Portrait:
    """A portrait ready to be warped: skin and inside of the mouth, BGR float32, both with MARGIN pixels around."""

    anatomy: Anatomy
    origin: Point
    skin: Picture
    mouth: Picture
    exposure: float  # leaves room for the light to rise before the skin is clipped


def _padded(picture: Picture) -> Picture:
    """With a margin: mirrored at the left and below, drawn out at the right and above, where a mirror would show."""
    left = np.pad(picture, ((0, 0), (MARGIN, 0), (0, 0)), "reflect")
    right = np.rot90(_drawn_out(np.rot90(left), 1.0), -1)
    return _drawn_out(np.pad(right, ((0, MARGIN), (0, 0), (0, 0)), "reflect"), 12.0)


def _drawn_out(wide: Picture, blur: float) -> Picture:
    """MARGIN rows more at the top: the first rows repeated, blurred along themselves, with the picture's own grain."""
    sky = cv2.GaussianBlur(wide[:6].mean(axis=0, keepdims=True), (0, 0), blur, borderType=cv2.BORDER_REPLICATE)
    grain = wide[:12] - cv2.GaussianBlur(wide[:12], (0, 0), 3)
    top = np.repeat(sky, MARGIN, axis=0) + 0.4 * np.tile(grain, (MARGIN // 12 + 1, 1, 1))[:MARGIN]
    wide = wide.copy()
    blend = smoothstep(np.linspace(0.0, 1.0, 8))[:, None, None]
    wide[:8] = blend * wide[:8] + (1 - blend) * sky
    return np.ascontiguousarray(np.concatenate([top, wide]), dtype=np.float32)


def _grid(shape: tuple[int, ...]) -> tuple[Array, Array]:
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    return x, y


def _depths(a: Anatomy, shape: tuple[int, ...]) -> Picture:
    """The dark of an open mouth, with a tongue low in it."""
    x, y = _grid(shape)
    z, v = a.across(x), (y - a.centre[1]) / a.width
    dark = np.array([22.0, 20.0, 40.0])
    tongue = np.exp(-((z / 0.6) ** 4) - (np.clip(0.60 - v, 0, None) / 0.17) ** 2)[..., None]
    out: Picture = (dark + tongue * np.array([34.0, 32.0, 70.0])).astype(np.float32)
    return out


def astronaut() -> Portrait:
    """Eileen Collins, NASA; a smile that shows the upper teeth, which stay with the skull when the lips move."""
    from skimage import data

    rgb = np.asarray(data.astronaut())  # type: ignore[no-untyped-call, unused-ignore]
    picture = np.ascontiguousarray(rgb[:, :, ::-1]).astype(np.float32)
    a = Anatomy(
        points={
            "nose": (223.0, 127.0),
            "mouth_left": (202.5, 139.6),
            "mouth_right": (244.0, 140.4),
            "lip_upper": (223.0, 139.6),
            "lip_lower": (223.0, 154.6),
        },
        upper_edge=((202.5, 139.6), (206, 140.4), (210, 141.1), (215, 142.0), (219, 142.9), (223, 143.2), (227, 143.1),
                    (231, 142.6), (235, 142.0), (239, 141.3), (244.0, 140.4)),
        lower_edge=((202.5, 139.6), (204.5, 142.5), (207, 144.8), (210, 146.8), (213, 148.4), (217, 149.5),
                    (222, 150.0), (227, 149.9), (231, 149.2), (235, 147.5), (238, 145.5), (241, 143.2), (244.0, 140.4)),
        chin_y=178.0,
        brow_y=90.0,
        head=(226.0, 95.0),
        head_radii=(78.0, 92.0),
        neck=(222.0, 190.0),
    )  # fmt: skip
    x, y = _grid(picture.shape)
    top, bottom = a.edges(x)
    inside = (y > top + 0.2) & (y < bottom - 0.9) & (np.abs(a.across(x)) < 1)
    hole = cv2.dilate(inside.astype(np.uint8), np.ones((25, 25), np.uint8)) - inside.astype(np.uint8)
    teeth = cv2.inpaint(picture.astype(np.uint8), hole, 3, cv2.INPAINT_TELEA).astype(np.float32)
    below = smoothstep((y - bottom + 1.2) / 1.8)[..., None]
    mouth = teeth * (1 - below) + _depths(a, picture.shape) * below
    return Portrait(a, (64.0, -14.0), _padded(picture), _padded(mouth.astype(np.float32)), 0.70)


def hopper() -> Portrait:
    """Grace Hopper, US Navy, at 0.57 of its size; the mouth is shut, so its inside is painted."""
    from matplotlib import cbook

    scale = 0.57
    path = Path(str(cbook.get_sample_data("grace_hopper.jpg", asfileobj=False)))
    full = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if full is None:
        raise FileNotFoundError(f"{path}: cannot be read; install matplotlib again")
    small = cv2.resize(full.astype(np.float32), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    picture = np.asarray(small, dtype=np.float32)

    def at(px: float, py: float) -> Point:
        return (px + 0.5) * scale / 0.625 - 0.5, (py + 0.5) * scale / 0.625 - 0.5

    slit = tuple(at(*p) for p in ((142.0, 174.6), (148, 174.1), (155, 173.6), (160, 173.4), (166, 174.0), (172, 173.4),
                                  (180, 172.9), (187, 172.7), (191.5, 173.6)))  # fmt: skip
    a = Anatomy(
        points={
            "nose": at(166.0, 148.0),
            "mouth_left": slit[0],
            "mouth_right": slit[-1],
            "lip_upper": at(165.5, 170.5),
            "lip_lower": at(166.0, 182.5),
        },
        upper_edge=slit,
        lower_edge=slit,
        chin_y=at(0, 204)[1],
        brow_y=at(0, 101)[1],
        head=at(164, 115),
        head_radii=(at(76, 0)[0], at(0, 106)[1]),
        neck=at(166, 232),
    )
    x, y = _grid(picture.shape)
    z, top = a.across(x), a.edges(x)[0]
    low = top + 0.115 * a.width * np.sqrt(np.clip(1 - (z / 0.95) ** 2, 0, None))
    gaps = 0.80 + 0.20 * np.abs(np.sin(np.pi * (z * 3.6 + 0.0))) ** 0.4
    shade = np.clip(1.05 - 0.75 * np.abs(z) ** 1.6, 0, 1) * gaps
    ivory = shade[..., None] * np.array([120.0, 150.0, 182.0])
    below = smoothstep((y - low + 0.8) / 1.6)[..., None]
    mouth = ivory * (1 - below) + _depths(a, picture.shape) * below
    return Portrait(a, (a.centre[0] - 172.0, 0.0), _padded(picture), _padded(mouth.astype(np.float32)), 0.88)
