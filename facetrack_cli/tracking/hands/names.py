"""Which of two followed hands is which: a hidden Markov model of two states, named as they are or exchanged (ours).

A frame speaks for a name by two cues. A hand is the end of a forearm that comes from its own elbow: the long axis of
its skin points there. And a hand is more often on its own side. Names may be exchanged where hands meet:

    p(exchanged | before) = ANY + MEET * overlap

Frames are not independent, so the axis of one hand counts for `MOST` at most.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from facetrack_cli.core.types import Array
from facetrack_cli.recipe.hands import Hands
from facetrack_cli.tracking.hands.evidence import Map
from facetrack_cli.tracking.hands.joint import SIGNS, Belief, Face

ELBOWS: Final = np.array([[-1.8, 3.0], [1.8, 3.0]])  # about the face's middle, in its sizes
AXIS, MOST = 2.0, 0.2  # log odds for the difference of both ways along the axis, and their limit of one hand in a frame
OWN: Final = 0.2  # sizes beyond the face's middle from which on a hand is on the other side
ANY, MEET, MEETS = 0.002, 0.2, 0.8  # probabilities, and the sizes between two hands from which on they overlap
APART: Final = (1.2, 2.2)  # radii between two hands, at which the axis of each begins to be seen, and is seen
WINDOW: Final = 0.8  # radii, standard deviation of the window in which the axis is measured


def exchanged(belief: Belief, face: Face) -> float:
    """The probability that the filter has exchanged the hands since the frame before."""
    apart = math.dist(*belief.at) / face.size
    return ANY + MEET * min(max(2 * (1 - apart / MEETS), 0.0), 1.0)


def log_odds(settings: Hands, evidence: Map, belief: Belief, scale: float, face: Face) -> float:
    """log p(frame | named as they are) - log p(frame | exchanged); a size is `scale` pixels of the evidence."""
    apart, both = math.dist(*belief.at) / face.size / settings.radius, bool((belief.seen >= 0.5).all())
    clear = min(max((apart - APART[0]) / (APART[1] - APART[0]), 0.0), 1.0) if both else 1.0
    total = 0.0
    for at, seen, sign in zip(belief.at, belief.seen, SIGNS, strict=True):
        if seen < 0.5:
            continue
        across, along = _axis(evidence, at * scale, settings.radius * face.size * scale)
        x, y = (at - face.at - face.size * ELBOWS).T
        own, other = ((x**2 - y**2) * across + 2 * x * y * along) / np.maximum(x**2 + y**2, 1e-9)
        total += min(max(AXIS * clear * sign * (own - other), -MOST), MOST)
        beyond = sign * (at[0] - face.at[0]) / face.size
        total -= settings.side * (max(OWN + beyond, 0.0) ** 2 - max(OWN - beyond, 0.0) ** 2)
    return total


def update(p: float, exchanged: float, log_odds: float) -> float:
    """The probability that hands are named as they are after a frame, from that after the frame before."""
    p = p * (1 - exchanged) + (1 - p) * exchanged
    return p / (p + (1 - p) * math.exp(-log_odds))


def _axis(evidence: Map, at: Array, radius: float) -> Array:
    """(2,): cosine and sine of twice the angle of the long axis of the skin about a place, 0 to 1 long."""
    reach = math.ceil(2 * radius)
    (left, top), (height, width) = np.rint(at).astype(int) - reach, evidence.shape
    x, y = (np.arange(max(low, 0), min(low + 2 * reach + 1, n)) for low, n in ((left, width), (top, height)))
    if not (len(x) and len(y)):
        return np.zeros(2)
    window = evidence[y[0] : y[-1] + 1, x[0] : x[-1] + 1].astype(float)
    u, v = x - at[0], (y - at[1])[:, None]
    window = window * np.exp(-0.5 * (u**2 + v**2) / (WINDOW * radius) ** 2)
    mass = window.sum() + 1e-3
    u, v = u - (window * u).sum() / mass, v - (window * v).sum() / mass
    xx, yy, xy = ((window * each).sum() for each in (u * u, v * v, u * v))
    return np.array([xx - yy, 2 * xy]) / (xx + yy + 1e-6)
