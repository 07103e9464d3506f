"""A face of 28 points and two irises, drawn by hand, that opens its mouth, smiles, blinks, looks, moves and turns."""

import numpy as np

from facetrack_cli.core.face_points import IRISES, POINTS
from facetrack_cli.trajectory.trajectory import joined, one_part

# in distances between the eyes, which are at (-.5, 0) and (.5, 0); y points down
SHAPE = {
    "mouth_left": (-0.4, 1.1), "mouth_right": (0.4, 1.1), "lip_upper": (0, 1.0), "lip_lower": (0, 1.25),
    "inner_lip_upper": (0, 1.09), "inner_lip_lower": (0, 1.1),
    "eye_left_outer": (-0.75, 0), "eye_left_inner": (-0.25, 0), "eye_left_upper": (-0.5, -0.07),
    "eye_left_lower": (-0.5, 0.08), "eye_right_inner": (0.25, 0), "eye_right_outer": (0.75, 0),
    "eye_right_upper": (0.5, -0.07), "eye_right_lower": (0.5, 0.08),
    "brow_left_outer": (-0.9, -0.25), "brow_left_middle": (-0.55, -0.4), "brow_left_inner": (-0.2, -0.3),
    "brow_right_inner": (0.2, -0.3), "brow_right_middle": (0.55, -0.4), "brow_right_outer": (0.9, -0.25),
    "nose": (0, 0.55), "nose_left": (-0.22, 0.66), "nose_right": (0.22, 0.66),
    "jaw_left": (-1.05, 0.9), "chin_left": (-0.6, 1.6), "chin": (0, 1.75), "chin_right": (0.6, 1.6),
    "jaw_right": (1.05, 0.9), "iris_left": (-0.5, -0.01), "iris_right": (0.5, -0.01),
}  # fmt: skip
MOVES = {
    "open": {"inner_lip_lower": (0, 1), "lip_lower": (0, 1), "chin": (0, 0.5)},
    "smile": {"mouth_left": (0, -1), "mouth_right": (0, -1)},
    "brows": {"brow_left_middle": (0, -1), "brow_right_middle": (0, -1)},
    "looks": dict.fromkeys(IRISES, (1, 0)),
    "shut": {f"eye_{side}_upper": (0, 0.15) for side in ("left", "right")},
}


def moving_face(
    frames, *, unit=100.0, place=(320.0, 200.0), roll=0.0, std=0.5, noise=0.0, names=(*POINTS, *IRISES), seed=0, **moves
):
    """The trajectory of `face`; `moves` are (T,) amounts in distances between the eyes, of `shut` from 0 to 1."""
    rng, t = np.random.default_rng(seed), np.arange(frames)
    turn = np.radians(roll)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    parts = []
    for name in names:
        at = np.tile(np.array(SHAPE[name], float), (frames, 1))
        for move, amount in moves.items():
            at += np.asarray(amount, float).reshape(-1, 1) * MOVES[move].get(name, (0, 0))
        x, y = unit * rotation @ at.T + np.array(place)[:, None] + rng.normal(0, noise, (2, frames)) * (noise > 0)
        same = {"std_x": np.full(frames, std), "std_y": np.full(frames, std), "cov_xy": np.zeros(frames)}
        same |= {"w": np.full(frames, unit / 3), "h": np.full(frames, unit / 3), "status": ["tracked"] * frames}
        parts.append(one_part("face", name, t, time_s=t / 25, x=x, y=y, confidence=np.ones(frames), **same))
    side, (x, y) = np.full(frames, unit / 0.363), unit * rotation @ (0, 0.45) + place
    box = {"w": side, "h": side, "angle": np.full(frames, roll), "status": ["tracked"] * frames}
    whole = one_part(
        "face", "box", t, time_s=t / 25, x=np.full(frames, x), y=np.full(frames, y), confidence=np.ones(frames), **box
    )
    return joined([*parts, whole])
