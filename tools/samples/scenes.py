"""The clips: who is in them and what happens when. Values are joined smoothly; every clip begins as the portrait is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from occluders import Held, book
from portraits import Portrait, astronaut, hopper
from render import truth
from timeline import Array, Keys, syllables, track
from warp import Moment


@dataclass(frozen=True)
class Scene:
    """One clip, ready to be rendered; `seed` is for the noise of the sensor."""

    name: str
    portrait: Portrait
    moments: tuple[Moment, ...]
    objects: tuple[Held, ...]
    seed: int


def _moments(frames: int, keys: Mapping[str, Keys], added: Mapping[str, Array]) -> tuple[Moment, ...]:
    values = {name: track(k, frames) for name, k in keys.items()}
    for name, more in added.items():
        values[name] = values.get(name, np.zeros(frames)) + more
    return tuple(Moment(**{name: float(v[t]) for name, v in values.items()}) for t in range(frames))


def expressions() -> Scene:
    """Talking, a wide smile, a wide open mouth, a pucker, one-sided smiles; the light from 60 % to 140 %."""
    frames = 275
    opening, rounding = syllables(np.random.default_rng(11), [(20, 62), (142, 176), (236, 268)], frames)
    keys: dict[str, Keys] = {
        "smile": [(0, 0), (8, 0), (20, -0.15), (64, -0.15), (76, 0.09), (104, 0.09), (114, -0.04), (140, -0.08),
                  (176, -0.14), (212, -0.10), (222, 0.0), (236, -0.08), (262, -0.08), (274, 0.04)],
        "close": [(0, 0), (8, 0), (20, 0.9), (64, 0.9), (74, 0.0), (104, 0.0), (112, 0.3), (138, 0.3), (144, 0.95),
                  (184, 1.0), (210, 0.9), (220, 0.2), (236, 0.9), (264, 0.9), (274, 0)],
        "jaw": [(0, 0), (104, 0), (113, 0.45), (122, 0.38), (130, 0.46), (140, 0)],
        "pucker": [(0, 0), (174, 0), (183, 0.26), (192, 0.21), (204, 0.27), (212, 0)],
        "pull": [(0, 0), (210, 0), (218, 0.9), (226, 0.8), (236, -0.8), (246, 0), (274, 0)],
        "brow": [(0, 0), (40, 0), (46, 0.8), (56, 0), (104, 0), (112, 1.0), (134, 1.0), (142, 0), (180, 0.5), (200, 0)],
        "yaw": [(0, 0), (20, 0.05), (50, -0.16), (85, 0.12), (96, 0.14), (130, -0.04), (165, 0.17), (200, -0.12),
                (230, 0.08), (274, -0.05)],
        "pitch": [(0, 0), (30, 0.05), (44, -0.03), (52, 0.05), (60, 0.0), (110, -0.07), (150, 0.06), (200, 0.0),
                  (240, 0.07), (274, 0.0)],
        "roll": [(0, 0), (30, 0.05), (70, -0.10), (100, -0.06), (150, 0.11), (190, -0.02), (225, -0.11), (255, 0.05),
                 (274, 0.0)],
        "scale": [(0, 0), (60, 0.03), (120, -0.03), (160, 0.05), (220, -0.02), (274, 0.02)],
        "head_x": [(0, 0), (40, 5), (64, 5), (72, -5), (110, -3), (150, 7), (203, 6), (211, -4), (240, 0), (274, 2)],
        "head_y": [(0, 0), (50, 3), (90, -2), (128, -3), (160, 4), (200, 0), (232, 4), (274, 0)],
        "cam_x": [(0, 0), (46, 9), (63, 11), (72, -2), (100, -12), (140, -6), (158, 8), (200, 13), (209, 0), (240, -9),
                  (274, 3)],
        "cam_y": [(0, 0), (35, -6), (84, -12), (90, 0), (120, 4), (150, -8), (190, -15), (246, 2), (274, -4)],
        "cam_roll": [(0, 0), (60, -0.03), (130, 0.03), (210, -0.03), (274, 0.01)],
        "light": [(0, 1.0), (25, 1.0), (55, 0.62), (80, 0.75), (110, 1.38), (128, 1.4), (150, 0.9), (166, 0.6),
                  (186, 0.66), (215, 1.4), (235, 1.3), (260, 0.7), (274, 0.9)],
    }  # fmt: skip
    added = {"jaw": 0.26 * opening, "pucker": 0.14 * rounding}
    return Scene("expressions", astronaut(), _moments(frames, keys, added), (), seed=101)


def occlusion() -> Scene:
    """Talking and small smiles, while a book hides a lip and a corner of the mouth, first from the left."""
    frames = 260
    portrait = hopper()
    spans = [(8, 40), (52, 92), (104, 140), (158, 196), (210, 238)]
    opening, rounding = syllables(np.random.default_rng(12), spans, frames)
    keys: dict[str, Keys] = {
        "smile": [(0, 0), (92, 0), (104, 0.10), (118, 0.02), (196, -0.03), (236, 0.0), (246, 0.12), (259, 0.10)],
        "jaw": [(0, 0), (142, 0), (147, 0.22), (152, 0.2), (158, 0.0), (238, 0.0)],
        "pull": [(0, 0), (40, 0), (46, 0.5), (54, 0), (150, 0), (170, -0.5), (186, 0)],
        "brow": [(0, 0), (96, 0), (104, 0.8), (116, 0), (200, 0), (208, 0.8), (220, 0)],
        "yaw": [(0, 0), (28, 0.12), (60, -0.06), (96, -0.12), (130, 0.10), (170, 0.04), (206, -0.10), (240, 0.1),
                (259, 0.05)],
        "pitch": [(0, 0), (36, 0.04), (44, -0.03), (52, 0.02), (110, -0.05), (150, 0.03), (190, -0.03), (230, 0.04),
                  (259, 0.0)],
        "roll": [(0, 0), (40, 0.05), (90, -0.04), (136, 0.06), (180, -0.03), (220, -0.07), (259, 0.0)],
        "scale": [(0, 0), (60, 0.02), (120, -0.03), (190, 0.03), (259, 0.0)],
        "head_x": [(0, 0), (36, 5), (60, 0), (96, -5), (124, 5), (150, 2), (200, -4), (230, 4), (259, 0)],
        "head_y": [(0, 0), (50, 3), (96, -2), (150, 3), (200, -2), (259, 1)],
        "cam_x": [(0, 0), (22, 6), (32, -8), (64, -4), (92, 7), (112, 10), (119, -6), (150, -8), (176, 2), (204, 9),
                  (216, -4), (259, 4)],
        "cam_y": [(0, -6), (40, -14), (70, -4), (100, -16), (128, -22), (136, -8), (170, -4), (200, -14), (228, -20),
                  (259, -8)],
        "cam_roll": [(0, 0), (70, 0.04), (120, -0.03), (175, 0.04), (225, -0.04), (259, 0.0)],
        "light": [(0, 1.0), (60, 0.92), (120, 1.1), (180, 0.95), (240, 1.08), (259, 1.0)],
    }  # fmt: skip
    moments = _moments(frames, keys, {"jaw": 0.20 * opening, "pucker": 0.12 * rounding})
    return Scene("occlusion", portrait, moments, _books(portrait, moments), seed=102)


def _books(portrait: Portrait, moments: tuple[Moment, ...]) -> tuple[Held, ...]:
    """One book from the lower left, before lower lip and left corner; one from the right, before the other two.

    Whoever holds them goes along with the head, a little late and not with the lips.
    """
    rng = np.random.default_rng(13)
    rest = [truth(portrait, replace(m, jaw=0.0, smile=0.0, pucker=0.0, pull=0.0)) for m in moments]
    mouth = np.array([(np.array(t["mouth_left"]) + np.array(t["mouth_right"])) / 2 for t in rest])
    lag = np.ones(7) / 7
    follow = np.stack([np.convolve(np.pad(mouth[:, i], (4, 2), "edge"), lag, "valid") for i in (0, 1)], axis=1)
    n = len(moments)

    def path(xs: Keys, ys: Keys) -> Array:
        return follow + np.stack([track(xs, n), track(ys, n)], axis=1)

    flat = Held(
        book(rng, 118, 84, ("SIGNALS", "IN NOISE"), (58, 74, 40)),
        (117.0, 0.0),
        path([(0, -190), (40, -190), (52, 11), (75, 10), (100, 11), (112, -190), (259, -190)],
             [(0, 150), (40, 150), (52, 5), (64, 7), (84, 5), (100, 6), (112, 150), (259, 150)]),
        track([(0, 35), (40, 35), (52, 20), (80, 18), (100, 21), (112, 35), (259, 35)], n),
    )  # fmt: skip
    spine = Held(
        book(rng, 150, 21, ("SEAMANSHIP",), (52, 40, 112)),
        (0.0, 20.0),
        path([(0, 230), (145, 230), (157, -9), (180, -8), (205, -10), (217, 230), (259, 230)],
             [(0, 60), (145, 60), (157, 1), (172, 0), (190, 1), (205, 0), (217, 60), (259, 60)]),
        track([(0, 20), (145, 20), (157, 11), (180, 13), (205, 11), (217, 20), (259, 20)], n),
    )  # fmt: skip
    return flat, spine
