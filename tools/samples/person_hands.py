"""The hands of a person who faces the camera: raised, in the colour of the face, each on an arm from the shoulder.

The back of each hand is to the camera, so the thumbs are outside. The hand at the left of the image is the left one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from hands import skin
from hands_draw import Layer, Skin, draw
from hands_model import Pose
from heads_cutout import astronaut_cutout
from layers import inside, over, reduced
from numpy.typing import NDArray
from person import BODY_AT, FACE, SHOULDERS, Person, Place
from portraits import Picture
from render import SIZE
from timeline import Array, Keys, track

TARGETS = ("left_hand", "right_hand")  # as seen in the first frame
BOX = (60.0, 72.0)  # about palm and fingers of a hand of scale 1, turned a little, in pixels
REACH = 122.0  # from the middle of a hand of scale 1 to its elbow, when the forearm is seen at full length
SHUTTER = 0.35  # of the time between two frames, in which what moves is blurred
_OUT = (-1.0, 1.0)  # which side of the body the hand belongs to


def face_colour() -> Array:
    """(3,) BGR of the portrait's skin between brow and chin: the median over cheeks, nose and brow."""
    head = astronaut_cutout().head
    y, x = np.mgrid[: head.shape[0], : head.shape[1]]
    oval = np.hypot((x - 223) / 33, (y - 120) / 46) < 1
    mouth_or_eyes = (np.hypot((x - 223) / 26, (y - 147) / 13) < 1) | ((np.abs(y - 101) < 11) & (np.abs(x - 223) > 8))
    return np.asarray(np.median(head[oval & ~mouth_or_eyes][:, :3], axis=0), dtype=np.float64)


def matched_skin(cloth: tuple[float, float, float], scale: float) -> Skin:
    """Skin that, drawn on a hand, has the mean colour of the face, and the cloth of the sleeve."""
    wanted, of = face_colour(), replace(skin(), cloth=cloth)
    for _ in range(4):
        layer = draw(Pose(160.0, 120.0, scale, elbow=(150.0, 300.0)), of, SIZE)
        found = layer.colour[layer.hand > 0.99].mean(axis=0)
        b, g, r = (float(c) * float(f) for c, f in zip(of.colour, wanted / found, strict=True))
        of = replace(of, colour=(b, g, r))
    return of


@dataclass(frozen=True)
class Motion:
    """How a hand goes: the middle of its box (n, 2) in the image; (n,) scale, turn, curl and spread."""

    xy: Array
    scale: Array
    turn: Array
    curl: Array
    spread: Array


def loose(rng: np.random.Generator, frames: int, scale: float, every: tuple[int, int]) -> dict[str, Array]:
    """Scale, turn, curl and spread of a hand that changes its shape at times, `every` so many frames."""
    at = [0]
    while at[-1] < frames:
        at.append(at[-1] + int(rng.integers(*every)))

    def keys(low: float, high: float) -> Keys:
        return [(t, float(v)) for t, v in zip(at, rng.uniform(low, high, len(at)), strict=True)]

    curls = [(t, float(v)) for t, v in zip(at, rng.choice([0.02, 0.08, 0.15, 0.3, 0.55], len(at)), strict=True)]
    return {
        "scale": scale * track(keys(0.93, 1.09), frames),
        "turn": track(keys(-0.22, 0.22), frames),
        "curl": track(curls, frames),
        "spread": track(keys(0.45, 1.1), frames),
    }


def pose_at(motion: Motion, side: int, place: Place, t: float) -> Pose:
    """The hand at moment t, which may lie between frames. The elbow follows the hand, and the wrist bends a little."""
    frames = np.arange(len(motion.scale))
    x, y = (float(np.interp(t, frames, column)) for column in motion.xy.T)
    scale, turn, curl, spread = (
        float(np.interp(t, frames, v)) for v in (motion.scale, motion.turn, motion.curl, motion.spread)
    )
    shoulder = np.array(place.see(*SHOULDERS[side]))
    # at rest the elbow is beside the body; a raised hand lifts it, and one at the other side draws it in
    raised = np.clip((shoulder[1] + 30 - y) / 100, 0.0, 1.0)
    home = shoulder + place.k * np.array([_OUT[side] * (24 + 50 * raised), 176 - 60 * raised])
    away = home - (x, y)
    far = REACH * scale
    elbow = home if np.hypot(*away) < far else np.array([x, y]) + away * far / np.hypot(*away)
    arm = float(np.arctan2(x - elbow[0], elbow[1] - y))
    lean = float(np.clip(0.45 * arm + turn, -0.55, 0.55))
    return Pose(x, y, scale, lean, curl, spread, (float(elbow[0]), float(elbow[1])), side == 0,
                (float(shoulder[0]), float(shoulder[1])))  # fmt: skip


@dataclass(frozen=True)
class Scene:
    """All that happens: the person and its place by frame, both hands and which is in front, by frame."""

    who: Person
    ground: Picture
    face: Array  # (n, 2) the middle of the face's box
    scale: Array  # (n,) of the face
    hands: Sequence[Motion]
    front: NDArray[np.int64]  # (n,) 0 or 1
    skin: Skin
    zoom: float  # pixels of the image for one of the portrait, at scale 1
    shots: int = 3  # odd; moments while the shutter is open, more for faster hands

    def place(self, t: float) -> tuple[Place, Place]:
        """Where the body and the head are at moment t: the head sways on the body."""
        frames = np.arange(len(self.scale))
        x, y, s = (float(np.interp(t, frames, v)) for v in (*self.face.T, self.scale))
        mean_x, mean_y = self.face.mean(axis=0)
        body = Place(mean_x + 0.35 * (x - mean_x), mean_y + 0.35 * (y - mean_y), self.zoom)
        return body, Place(x, y, self.zoom * s)

    def box(self, t: int) -> tuple[float, float, float, float]:
        """The ground truth of the face in frame t: middle, width and height, in pixels."""
        side = float(FACE[2] * self.zoom * self.scale[t])
        return float(self.face[t, 0]), float(self.face[t, 1]), side, side

    def poses(self, t: float) -> tuple[Pose, Pose]:
        """Both hands at moment t."""
        body = self.place(t)[0]
        return pose_at(self.hands[0], 0, body, t), pose_at(self.hands[1], 1, body, t)

    def layers(self, t: float) -> tuple[Layer, Layer]:
        """Both hands with their arms at moment t, as drawn."""
        left, right = self.poses(t)
        return draw(left, self.skin, SIZE), draw(right, self.skin, SIZE)


def _with_hands(picture: Picture, layers: Sequence[Layer], front: int) -> Picture:
    for i in (1 - front, front):
        layer = layers[i]
        moved = cv2.warpAffine(layer.alpha, np.array([[1.0, 0.0, 3.0], [0.0, 1.0, 4.0]]), SIZE)
        shadow = 0.22 * cv2.GaussianBlur(moved, (0, 0), 5.0) + 0.10 * cv2.GaussianBlur(moved, (0, 0), 1.6)
        picture = picture * (1 - shadow[..., None])
        picture = picture * (1 - layer.alpha[..., None]) + layer.colour
    return picture


def render(scene: Scene, t: int) -> tuple[Picture, tuple[Layer, Layer]]:
    """Frame t before light and noise, (H, W, 3), the mean of a few moments, and the hands' layers at the middle one."""
    head, at = scene.who.head(t)
    shown = []
    for u in sorted(np.linspace(-0.5, 0.5, scene.shots).tolist(), key=abs):
        moment = t + SHUTTER * u
        body, place = scene.place(moment)
        picture = reduced(over(over(scene.ground, body.lay(scene.who.body, BODY_AT)), place.lay(head, at)))
        layers = scene.layers(moment)
        if u == 0:
            middle = layers
        shown.append(cv2.GaussianBlur(_with_hands(picture, layers, int(scene.front[t])), (0, 0), 0.45))
    return np.asarray(np.mean(shown, axis=0), dtype=np.float32), middle


def face_covered(box: tuple[float, float, float, float], layers: Sequence[Layer]) -> tuple[float, float, float]:
    """What share of the face's box is under the left hand or its arm, under the right one, and under either."""
    within = inside(box)
    left, right = (layer.alpha for layer in layers)
    area = float(within.sum())
    shares = [float((within * alpha).sum()) / area for alpha in (left, right, left + right - left * right)]
    return shares[0], shares[1], shares[2]


def hand_covered(layers: Sequence[Layer], front: int) -> tuple[float, float]:
    """What share of each hand is under the other hand or its arm."""
    low = layers[1 - front].hand
    share = float((low * layers[front].alpha).sum() / low.sum())
    return (share, 0.0) if front == 1 else (0.0, share)


def hand_box(pose: Pose) -> tuple[float, float, float, float]:
    """The ground truth of a hand: middle, width and height of its box, in pixels."""
    return pose.x, pose.y, BOX[0] * pose.scale, BOX[1] * pose.scale


def _centroid(mask: Picture) -> Array:
    y, x = np.mgrid[: mask.shape[0], : mask.shape[1]]
    return np.array([float((mask * v).sum(dtype=np.float64)) for v in (x, y)]) / float(mask.sum(dtype=np.float64))


def prove_hand(pose: Pose, layer: Layer, box: tuple[float, float, float, float]) -> None:
    """The drawn hand is where the ground truth says: its middle to 0.1 px, and 97 % of palm and fingers in the box.

    Raises:
        AssertionError: it is not.
    """
    off = _centroid(layer.dot) - (box[0], box[1])
    assert np.abs(off).max() < 0.1, f"the middle is off by {off} at {pose}"
    share = float((layer.hand * inside(box)).sum() / layer.hand.sum())
    assert share > 0.97, f"only {share:.3f} of the hand is in its box at {pose}"


def ycc(bgr: Array) -> Array:
    """(..., 2) Cb and Cr of (..., 3) BGR, full range, BT.601."""
    b, g, r = (bgr[..., i] for i in range(3))
    luma = 0.299 * r + 0.587 * g + 0.114 * b
    return np.stack([(b - luma) * 0.564 + 128, (r - luma) * 0.713 + 128], axis=-1)
