"""The clip of quick scale changes: a face comes near and goes, twice the size and three fifths, rolling and turning.

After the video of Zhou, Chellappa and Moghaddam, "Adaptive Visual Tracking and Recognition using Particle Filters"
(ICME 2003): "a sudden scale increase followed by a decrease within about 50 frames". Who is seen is Grace Hopper.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from clip_files import Clip
from closeups import Closeup, alone, closeup_clip
from faces_passerby import hopper_cutout
from heads import path, unsteady
from heads_cutout import Cutout
from heads_grounds import foliage
from portraits import hopper
from timeline import Keys, track
from warp import Moment

FRAMES = 240
SQUARE = (86.0, 57.5, 132.0)  # left, top and side of the face in the portrait, as the frontal cascade finds it
BASE = 0.5  # clip pixels for one of the portrait, at scale 1
_MORE = 60  # rows of cloth below the portrait, for when she is far


def _longer(cutout: Cutout) -> Cutout:
    """With more of the jacket below: its last rows repeated."""
    last = cutout.body[-8:-4].mean(axis=0, keepdims=True)
    body = np.concatenate([cutout.body[:-4], np.repeat(last, _MORE, axis=0)])
    return replace(cutout, body=np.asarray(body, dtype=np.float32))


def zoom_shot() -> Closeup:
    """Near and back between 12 and 62, slowly far until 118, near again at 166, far, and back."""
    n = FRAMES
    cutout = _longer(hopper_cutout())
    size = np.exp(track([(0, 0.0), (12, 0.0), (37, np.log(2.0)), (40, np.log(2.0)), (62, 0.05), (74, 0.0),
                         (112, np.log(0.6)), (122, np.log(0.6)), (160, np.log(1.55)), (168, np.log(1.55)),
                         (192, np.log(0.72)), (204, np.log(0.7)), (228, np.log(1.1)), (239, np.log(1.12))],
                        n))  # fmt: skip
    camera = unsteady(n, 81, 0.5) + path(
        [(0, 0), (40, 14), (80, -16), (120, 8), (160, 24), (200, -18), (239, 4)],
        [(0, 0), (50, 8), (100, -8), (150, 6), (200, -6), (239, 0)],
        n,
    )
    head = unsteady(n, 82, 0.5) + path(
        [(0, 112), (10, 114), (38, 176), (58, 224), (84, 152), (106, 82), (122, 88), (148, 184), (166, 150),
         (186, 106), (208, 192), (228, 230), (239, 208)],
        [(0, 112), (10, 112), (38, 126), (62, 108), (88, 128), (112, 150), (122, 148), (144, 122), (166, 120),
         (194, 146), (206, 142), (222, 124), (239, 112)],
        n,
    )  # fmt: skip
    roll = np.radians(track([(0, 0), (14, 0), (36, 9), (58, -7), (80, 3), (104, -12), (128, 6), (150, 12), (172, -4),
                             (194, -11), (216, 8), (239, -3)], n))  # fmt: skip
    keys: dict[str, Keys] = {
        "yaw": [(0, 0), (16, 0), (40, 0.16), (60, -0.20), (78, 0.05), (92, 0.36), (104, 0.30), (120, -0.05),
                (132, -0.36), (144, -0.30), (162, 0.04), (184, 0.30), (200, 0.0), (214, -0.26), (230, 0), (239, 0.06)],
        "pitch": [(0, 0), (20, 0.0), (50, 0.06), (80, -0.08), (120, 0.06), (160, -0.05), (200, 0.08), (239, 0)],
        "brow": [(0, 0), (60, 0), (70, 0.9), (84, 0), (160, 0), (168, 0.8), (180, 0), (239, 0)],
        "smile": [(0, 0), (20, 0), (50, 0.1), (90, -0.04), (130, 0.08), (180, -0.05), (239, 0)],
    }  # fmt: skip
    values = {name: track(k, n) for name, k in keys.items()}
    moments = [Moment(**{name: float(v[t]) for name, v in values.items()}) for t in range(n)]
    light = 0.92 * track([(0, 1), (60, 1.04), (130, 0.92), (190, 1.02), (239, 0.98)], n)
    return Closeup(alone(hopper(), cutout), cutout, SQUARE, foliage(460, 330), (-70.0, -45.0), camera, head,
                   BASE * size, roll, moments, light, 105, 20)  # fmt: skip


def zoom() -> Clip:
    """The clip, with the ground truth of the face."""
    return closeup_clip(zoom_shot())
