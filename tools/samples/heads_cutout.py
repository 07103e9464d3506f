"""A head and the body under it, cut out of a portrait: two soft-edged layers without a trace of the old ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from portraits import Picture

# measured by hand on skimage.data.astronaut(); the outline runs clockwise from the top of the hair
_HAIR = ((237, 16), (262, 22), (280, 35), (295, 55), (300, 75), (301, 95), (296, 112), (286, 125), (277, 130),
         (274, 134), (270, 137), (268, 135))  # fmt: skip
_JAW = ((267, 142), (264, 152), (259, 164), (256, 173))
_RING = ((275, 185), (290, 202), (300, 220), (304, 234))
_BELOW = ((315, 240), (330, 251), (342, 272), (350, 290), (358, 320), (362, 335), (364, 347), (380, 345), (400, 343),
          (430, 348), (460, 369), (480, 398), (492, 435), (497, 455), (505, 470), (511, 490), (511, 511), (20, 511),
          (25, 475), (22, 430), (19, 400), (27, 345), (35, 310), (42, 280), (50, 262), (70, 243), (90, 222), (112, 207),
          (114, 190), (119, 182), (126, 165), (140, 154), (160, 148), (183, 148))  # fmt: skip
_LEFT = ((181, 140), (180, 131), (175, 131), (171, 123), (165, 115), (158, 105), (155, 95), (153, 75), (158, 62),
         (170, 50), (185, 40), (191, 33), (205, 24), (220, 17))  # fmt: skip
_NECK = ((255, 178), (253, 186), (246, 189), (230, 190), (212, 188), (199, 185), (189, 179), (186, 167), (183, 150))
# behind the neck: the back of the ring and the black collar in it, which show when the head moves in it
_COLLAR = ((183, 149), (205, 150), (230, 157), (248, 168), (256, 175), (262, 200), (240, 205), (180, 200))
CHIN_Y = 178.0


@dataclass(frozen=True)
class Cutout:
    """A person in two layers, each (H, W, 4): BGR times alpha, and alpha 0..1, in the portrait's pixels.

    The head is all that is above the collar, with the neck; `skull` is its alpha without the neck, and `box` the
    (left, top, right, bottom) of that, where the cover passes through a half.
    """

    head: Picture
    body: Picture
    skull: Picture
    box: tuple[float, float, float, float]


def _filled(shape: tuple[int, ...], *outline: tuple[tuple[int, int], ...]) -> NDArray[np.uint8]:
    """1 within the closed polygon, (H, W)."""
    out = np.zeros(shape[:2], np.uint8)
    cv2.fillPoly(out, [np.array([p for run in outline for p in run], np.int32)], 1)
    return out


def _edges_found(picture: NDArray[np.uint8], rough: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The outline drawn by hand, moved to where the colours part, within 4 pixels; below the collar it stays."""
    labels = np.where(rough > 0, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    near = np.ones((9, 9), np.uint8)
    labels[cv2.erode(rough, near) > 0] = cv2.GC_FGD
    labels[cv2.dilate(rough, near) == 0] = cv2.GC_BGD
    labels[240:] = np.where(rough[240:] > 0, cv2.GC_FGD, cv2.GC_BGD)
    cv2.setRNGSeed(0)
    cv2.grabCut(picture, labels, None, np.zeros((1, 65)), np.zeros((1, 65)), 4, cv2.GC_INIT_WITH_MASK)  # type: ignore[call-overload]
    found = ((labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)).astype(np.uint8)
    return np.asarray(cv2.medianBlur(found, 5), dtype=np.uint8)


def spread(picture: Picture, known: Picture) -> Picture:
    """The image with what is not known (0 in `known`) filled with the colours about it, near ones first."""
    out, weight = picture * known[..., None], known.copy()
    result = picture.copy()
    missing = known < 0.5
    for sigma in (1.5, 4.0, 12.0, 40.0):
        share = cv2.GaussianBlur(weight, (0, 0), sigma)
        colour = cv2.GaussianBlur(out, (0, 0), sigma) / np.maximum(share, 1e-6)[..., None]
        take = missing & (share > 0.02)
        result[take] = colour[take]
        missing &= ~take
    return result


def edges(profile: NDArray[np.floating[Any]]) -> tuple[float, float]:
    """Where a profile first rises through a half and last falls through it, between its pixels."""
    above = np.nonzero(profile > 0.5)[0]
    i, j = int(above[0]), int(above[-1])
    first = i - (profile[i] - 0.5) / (profile[i] - profile[i - 1])
    return float(first), float(j + (profile[j] - 0.5) / (profile[j] - profile[j + 1]))


def soft_layer(picture: Picture, mask: NDArray[np.uint8] | Picture, softness: float) -> Picture:
    """What the mask (0..1) keeps, with a soft rim whose colours are from within: no fringe of the ground shows."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    within = cv2.erode((mask > 0.5).astype(np.uint8), disc).astype(np.float32)
    alpha = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), softness)
    out: Picture = np.dstack([spread(picture, within) * alpha[..., None], alpha]).astype(np.float32)
    return out


def astronaut_cutout() -> Cutout:
    """Eileen Collins in her suit, NASA, in the public domain."""
    from skimage import data

    picture = np.ascontiguousarray(np.asarray(data.astronaut())[:, :, ::-1])  # type: ignore[no-untyped-call, unused-ignore]
    whole = _edges_found(picture, _filled(picture.shape, _HAIR, _JAW, _RING, _BELOW, _LEFT))
    # a little wider than the jaw, so that the found edge bounds it, but for the collar and the ring
    above = _filled(picture.shape, _HAIR, _JAW, _NECK, _LEFT)
    above[:146] = cv2.dilate(above, np.ones((9, 9), np.uint8))[:146]
    head = whole & above
    chin = np.arange(picture.shape[0])[:, None] <= CHIN_Y
    collar = _filled(picture.shape, _COLLAR)
    body = (whole & (1 - head)) | collar
    colours = picture.astype(np.float32)
    about = np.asarray(cv2.dilate(head, np.ones((7, 7), np.uint8)), dtype=np.uint8)
    bare = cv2.erode(whole & (1 - about), np.ones((3, 3), np.uint8))
    dark = spread(colours, np.asarray(bare, dtype=np.float32))
    behind = np.where((about & collar)[..., None] > 0, dark, colours)
    top = soft_layer(colours, head, 0.9)
    skull = np.asarray(top[..., 3] * chin, dtype=np.float32)
    (left, right), (upper, lower) = edges(skull.max(axis=0)), edges(skull.max(axis=1))
    return Cutout(top, soft_layer(behind.astype(np.float32), body, 0.9), skull, (left, upper, right, lower))
