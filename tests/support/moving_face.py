"""A real face cut out of a sample clip, which moves, grows and rolls over another ground; its points are known."""

from functools import cache
from typing import NamedTuple

import cv2
import numpy as np

from facetrack_cli.core.geometry import warp_affine
from facetrack_cli.core.types import Frame, Start, TargetStart
from tests.support.samples import TrackClip

SIZE = (320, 240)
PARTS = ("nose", "mouth_left", "mouth_right", "lip_upper", "lip_lower")
EYES = 0.363  # the distance between the eyes, in sides of the face's box
SOURCE = TrackClip("expressions", 60)
_X, _Y, _SIDE, _ = SOURCE.start.targets["face"].box


class Pose(NamedTuple):
    """Where the middle of the face is, in pixels, how large its box is, in pixels, and its roll in degrees."""

    x: float
    y: float
    side: float = 80.0
    roll: float = 0.0


@cache
def ground(seed=0):
    """(H, W, 3): blobs of all sizes."""
    rng = np.random.default_rng(seed)
    noise = sum(cv2.GaussianBlur(rng.normal(0, s, (SIZE[1], SIZE[0], 3)), (0, 0), s) for s in (2.0, 6.0, 15.0))
    return 120 + 45 * noise / noise.std()


def matrix(pose):
    """(2, 3) from the sample clip to the frame."""
    turn = cv2.getRotationMatrix2D((_X + _SIDE / 2, _Y + _SIDE / 2), -pose.roll, pose.side / _SIDE)
    turn[:, 2] += np.array([pose.x, pose.y]) - (_X + _SIDE / 2, _Y + _SIDE / 2)
    return turn


@cache
def oval():
    """(H, W): 1 on the face of the sample clip, with a soft border."""
    height, width = SOURCE.frames[0].bgr.shape[:2]
    y, x = np.mgrid[:height, :width]
    r = np.hypot((x - _X - _SIDE / 2) / 0.56, (y - _Y - 0.52 * _SIDE) / 0.72) / _SIDE
    return np.clip((1 - r) * 10, 0, 1).astype(np.float32)


def paste(picture, pose, source=0):
    """`picture` with the face of a frame of the sample clip on it."""
    to = matrix(pose)
    share = warp_affine(oval(), to, SIZE)[..., None]
    return picture * (1 - share) + share * warp_affine(SOURCE.frames[source].bgr.astype(np.float32), to, SIZE)


def frame(index, picture):
    return Frame(index, index / 25, np.clip(picture, 0, 255).round().astype(np.uint8))


def clip(poses, seed=0):
    """A frame for each pose; none where it is None. The face talks as in the sample clip."""
    return [
        frame(i, ground(seed) if pose is None else paste(ground(seed), pose, i % 40)) for i, pose in enumerate(poses)
    ]


def truth(pose, source):
    """(5, 2): where the PARTS are."""
    at = np.array([[SOURCE.truth[source, part].x, SOURCE.truth[source, part].y] for part in PARTS])
    return at @ matrix(pose)[:, :2].T + matrix(pose)[:, 2]


def start(pose):
    points = {part: tuple(at) for part, at in zip(PARTS, truth(pose, 0).tolist(), strict=True)}
    box = (pose.x - pose.side / 2, pose.y - pose.side / 2, pose.side, pose.side)
    return Start(0, {"face": TargetStart(box, points)}, "clip.init.yaml")
