"""The clip of a passer-by: another person walks before the seated one and covers her face, slowly, then faster.

After the third experiment of Gonzalez and Collet, "Face Tracking using a Combination of Colour and Pattern Matching
Based on Particle Filter", table 1. Who passes is Grace Hopper, cut out of the Navy's portrait.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from clip_files import Clip
from faces import Before, face_clip, looks, motion, panned, standing
from faces_ground import brick_wall
from heads import Stage, path, placed
from heads_cutout import Cutout, edges, soft_layer, spread
from layers import over, reduced
from portraits import MARGIN, Picture, hopper
from timeline import Array, Keys, track

FRAMES = 240
SOFT, DARK = 7.0, 0.22  # the shadow of who passes
PORTRAIT = 0.57  # of the photograph, as portraits.py reduces it; outlines below are in pixels of the photograph
MORE = (120, 60)  # rows and columns of cloth that the portrait does not show, at its lower and right border
_BUTTON = (140, 22)  # its column in the last rows of the portrait, and how far from it cloth begins
_CHROMA = (1.12, 0.8)  # of Cb and Cr
_MOST = 25.0  # levels of chroma, which no colour of hers goes beyond: about that of the other one's skin
_HEAD = ((250, 23), (272, 25), (290, 32), (299, 41), (322, 50), (340, 64), (352, 86), (362, 87), (367, 95),
         (371, 140), (370, 176), (375, 192), (372, 216), (365, 240), (359, 258), (361, 272), (356, 288),
         (346, 300), (333, 306))  # fmt: skip
_NECK = ((329, 318), (327, 340), (315, 360), (300, 378), (285, 396), (275, 404), (246, 406), (236, 400),
         (222, 380), (210, 362), (204, 345), (204, 318), (200, 300))  # fmt: skip
_LEFT = ((186, 291), (171, 280), (160, 264), (161, 246), (157, 226), (153, 205), (155, 188), (155, 178),
         (153, 150), (152, 122), (155, 103), (166, 91), (174, 82), (182, 65), (196, 51), (217, 42), (219, 34),
         (234, 26))  # fmt: skip
_RIGHT_SIDE = ((331, 316), (345, 329), (370, 345), (410, 360), (440, 369), (470, 380), (488, 388), (497, 402),
               (506, 428), (514, 455), (524, 500), (533, 560), (538, 600), (545, 700), (548, 812))  # fmt: skip
_LEFT_SIDE = ((2, 812), (6, 700), (10, 600), (14, 560), (20, 500), (27, 440), (35, 410), (46, 388), (62, 377),
              (100, 364), (150, 347), (180, 333), (195, 322), (202, 312))  # fmt: skip


def _mask(shape: tuple[int, ...], *outline: tuple[tuple[int, int], ...]) -> Picture:
    """The closed polygon, given in pixels of the photograph, in those of the portrait, (H, W) 0..1."""
    out = np.zeros(shape[:2], np.uint8)
    points = (np.array([p for run in outline for p in run]) + 0.5) * PORTRAIT - 0.5
    cv2.fillPoly(out, [np.rint(points * 16).astype(np.int32)], 255, cv2.LINE_AA, 4)
    return np.asarray(out.astype(np.float32) / 255)


def _continued(picture: Picture) -> Picture:
    """The image with more of the jacket below and at the right: its borders drawn out, with its own grain."""
    rng = np.random.default_rng(71)
    rows, columns = MORE
    h, w = picture.shape[:2]
    out = np.pad(picture, ((0, rows), (0, columns), (0, 0)), "edge")
    cloth = np.median(picture[-12:, 20 : w // 3], axis=(0, 1))  # there is a button in the last rows
    near = np.abs(np.arange(w + columns) - _BUTTON[0])[:, None] < _BUTTON[1]
    last = np.where(near, cloth, out[h - 6 : h].mean(axis=0))[None]
    down = np.minimum(np.arange(rows) / 12.0, 1.0)[:, None, None]
    out[h:] = (1 - down) * cv2.GaussianBlur(last, (0, 0), 3.0) + down * cv2.GaussianBlur(last, (0, 0), 25.0)
    out[:h, w:] = cv2.GaussianBlur(out[:h, w - 6 : w].mean(axis=1, keepdims=True), (0, 0), 4.0)
    grain = cv2.GaussianBlur(rng.normal(0, 3.0, out.shape[:2]), (0, 0), 0.7)[..., None]
    out[h:] += grain[h:]
    out[:h, w:] += grain[:h, w:]
    return np.asarray(np.clip(out, 0, 255), dtype=np.float32)


def _like_the_other(picture: Picture) -> Picture:
    """With the colours of another camera, paler and evener: both portraits then have skin of nearly one Cb and Cr."""
    ycc = cv2.cvtColor(picture, cv2.COLOR_BGR2YCrCb)
    chroma = (ycc[..., 1:] - 0.5) * np.array(_CHROMA[::-1], np.float32)  # of floats OpenCV has grey at 0.5
    strong = np.linalg.norm(chroma, axis=2, keepdims=True) / _MOST
    ycc[..., 1:] = 0.5 + chroma * np.tanh(strong) / np.maximum(strong, 1e-6)
    return np.asarray(np.clip(1.08 * cv2.cvtColor(ycc, cv2.COLOR_YCrCb2BGR), 0, 255), dtype=np.float32)


def hopper_cutout() -> Cutout:
    """Grace Hopper in her uniform, US Navy, in the public domain; the jacket goes on below and at the right."""
    picture = _like_the_other(_continued(hopper().skin[MARGIN:-MARGIN, MARGIN:-MARGIN]))
    head = _mask(picture.shape, _HEAD, _NECK, _LEFT)
    trunk = _mask(picture.shape, _RIGHT_SIDE, _LEFT_SIDE)
    # what the head leaves bare when it turns: the collar's colours, and darker skin in it
    behind = spread(picture, np.asarray(1 - cv2.dilate(head, np.ones((5, 5), np.uint8)), dtype=np.float32))
    body = np.where(head[..., None] > 0.02, behind, picture).astype(np.float32)
    skull = head.copy()
    skull[round(331 * PORTRAIT) :] = 0
    (left, right), (upper, lower) = edges(skull.max(axis=0)), edges(skull.max(axis=1))
    return Cutout(soft_layer(picture, head, 0.8), soft_layer(body, trunk, 0.8), skull, (left, upper, right, lower))


@dataclass(frozen=True)
class PassingScene:
    """The seated person, and who passes, whose ground is not looked at."""

    stage: Stage
    passer: Stage

    def things(self, t: int) -> list[Before]:
        """Who passes, while she is in the image."""
        p = self.passer
        if not -150 < p.head[t, 0] < 478:
            return []
        layer, window = p.look(t)
        scale, at = float(p.scale[t]), p.head[t]
        body = placed(p.cutout.body, (0.0, 0.0), p, p.body[t], scale)
        head = placed(layer, window, p, at, scale)
        whole = reduced(over(body, head))
        return [Before(whole, motion(p.head, t))]


def _walk(keys: list[tuple[int, float]], frames: int) -> Array:
    """(frames,) through the keys at an even pace between them, the changes of pace rounded off."""
    t = np.arange(-30, frames + 30)
    line = np.interp(t, *np.array(keys, dtype=np.float64).T)
    smooth = cv2.GaussianBlur(line[:, None], (1, 0), sigmaX=0.1, sigmaY=5.0)[30:-30, 0]
    return np.asarray(smooth, dtype=np.float64)


def passerby_scene() -> PassingScene:
    """What happens when: past from the left between 20 and 150, slowly, and from the right between 168 and 222."""
    n = FRAMES
    t = np.arange(n)
    pan: Keys = [(0, 0), (24, -30), (52, -36), (74, -20), (92, 10), (118, 38), (150, 30), (170, -20), (190, -38),
                 (215, -36), (239, 20)]  # fmt: skip
    camera = panned(pan, n, 72)
    head = path(
        [(0, 158), (22, 166), (50, 156), (80, 163), (110, 158), (136, 172), (160, 154), (186, 160), (212, 166),
         (239, 158)],
        [(0, 92), (30, 95), (60, 90), (90, 93), (130, 89), (160, 94), (200, 91), (239, 93)],
        n,
    )  # fmt: skip
    scale = track([(0, 1.08), (60, 1.11), (120, 1.07), (180, 1.1), (239, 1.08)], n)
    stage = standing(
        brick_wall(400, 310), (-40.0, -35.0), camera, head + camera, scale,
        {
            "smile": [(0, 0), (14, -0.1), (70, -0.1), (110, 0.0), (160, -0.1), (220, 0), (239, 0.05)],
            "close": [(0, 0), (14, 0.8), (70, 0.8), (110, 0.0), (160, 0.8), (210, 0.5), (239, 0)],
            "yaw": [(0, 0), (26, -0.1), (60, 0.04), (120, 0.06), (140, 0.13), (160, -0.04), (184, 0.08), (214, -0.1),
                    (239, 0)],
            "pitch": [(0, 0), (30, 0.04), (90, 0.0), (140, -0.05), (180, 0.03), (239, 0)],
        },
        [(12, 60), (136, 172)], 73,
    )  # fmt: skip
    x = _walk([(10, -150), (66, 118), (98, 200), (156, 478), (161, 478), (229, -155)], n)
    pace = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(x)))]) / 52.0 * 2 * np.pi  # a step every 52 pixels
    y = 92.0 - 1.6 * np.cos(pace)
    way = np.stack([x + 0.8 * np.sin(pace / 2), y], axis=1) + camera
    yaw = track([(0, 0.16), (70, 0.16), (84, 0.05), (100, 0.16), (150, 0.16), (160, -0.16), (239, -0.16)], n)
    cutout = hopper_cutout()
    look = looks(hopper(), cutout, {"yaw": yaw, "pitch": 0.02 * np.sin(t / 9.0)})
    size = np.full(n, 1.04)
    passer = Stage(cutout, stage.ground, (0.0, 0.0), camera, way, size, stage.light, look, 0)
    return PassingScene(stage, passer)


def passerby() -> Clip:
    """The clip, with the ground truth of the seated person's face."""
    scene = passerby_scene()
    return face_clip(scene.stage, scene.things, soft=SOFT, dark=DARK, crf=20)
