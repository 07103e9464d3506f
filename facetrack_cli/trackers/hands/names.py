"""Which of two followed hands is which: a hidden Markov model of two states, named as they are or exchanged (ours).

A hand at (u, v) from the face's middle, in its sizes, whose skin has a long axis of angle a and of length l, 0 for a
disc and 1 for a line, is the left one of the picture by

    log p(left) - log p(right) = 0.4 u - 1.3 u v - 7.0 l sin 2a

A hand is the end of a forearm, which leans to where it comes from; and a hand is on its own side, but not beside the
face. The weights are a logistic regression on ten real clips of signs and nine rendered ones, and are the same to 0.05
(0.3 of the last one) without any of the real clips. Frames are not independent: their log odds count for `TEMPER`.

Names may be exchanged where hands meet: p(exchanged | before) = ANY + MEET * overlap.
"""

from __future__ import annotations

import math
from typing import Final

import cv2
import numpy as np

from facetrack_cli.core.types import Array
from facetrack_cli.trackers.hands.evidence import Map
from facetrack_cli.trackers.hands.joint import Belief, Face, crop
from facetrack_cli.trackers.hands.settings import HandsSettings

SIGNS: Final = (1.0, -1.0)  # of each hand, of the way to the other hand's side
WEIGHTS: Final = np.array([0.4, -1.3, -7.0])  # of u, u v, and l sin 2a
TEMPER: Final = 0.4
ANY, MEET, MEETS = 0.002, 0.2, 0.8  # probabilities, and the sizes between two hands from which on they overlap
APART: Final = (1.2, 2.2)  # radii between two hands, at which each begins to tell its name, and does
WINDOW: Final = 0.8  # radii, standard deviation of the window in which the axis is measured


def exchanged(belief: Belief, face: Face) -> float:
    """The probability that the filter has exchanged the hands since the frame before."""
    apart = math.dist(*belief.at) / face.size
    return ANY + MEET * min(max(2 * (1 - apart / MEETS), 0.0), 1.0)


def log_odds(settings: HandsSettings, evidence: Map, belief: Belief, scale: float, face: Face) -> float:
    """log p(frame | named as they are) - log p(frame | exchanged); a size is `scale` pixels of the evidence."""
    apart, both = math.dist(*belief.at) / face.size / settings.radius, bool((belief.seen >= 0.5).all())
    clear = min(max((apart - APART[0]) / (APART[1] - APART[0]), 0.0), 1.0) if both else 1.0
    total = 0.0
    for at, seen, sign in zip(belief.at, belief.seen, SIGNS, strict=True):
        if seen >= 0.5:
            u, v = (at - face.at) / face.size
            lean = _lean(evidence, at * scale, settings.radius * face.size * scale)
            total += sign * float(WEIGHTS @ (u, u * v, lean))
    return TEMPER * clear * total


def update(p: float, exchanged: float, log_odds: float) -> float:
    """The probability that hands are named as they are after a frame, from that after the frame before."""
    p = p * (1 - exchanged) + (1 - p) * exchanged
    return p / (p + (1 - p) * math.exp(-log_odds))


def _lean(evidence: Map, at: Array, radius: float) -> float:
    """l sin 2a of the long axis of the skin about a place, y down."""
    near, (left, top) = crop(evidence, at, math.ceil(2 * radius))
    if not near.size:
        return 0.0
    x, y = np.arange(left, left + near.shape[1]) - at[0], np.arange(top, top + near.shape[0]) - at[1]
    of = cv2.moments(near * np.exp(-0.5 * (x**2 + y[:, None] ** 2) / (WINDOW * radius) ** 2))
    return float(2 * of["mu11"] / (of["mu20"] + of["mu02"] + 1e-6))
