"""Points of a face that a regression or a network places and no window follows: eyes, brows, jaw, ... (ours).

With z the place of a point in the stabilized image, m its place at rest, moved with the points that are visible,

    a_t - m_t = 1/2 (a_{t-1} - m_{t-1}) + N(0, 3/4 s^2 I),    z_t = a_t + N(0, r^2 I) while the point is visible

is followed by a Kalman filter for each point, the same along x and y. How far a point moves with expressions (s), and
how much the places tremble (r), are running means of the clip. What is hidden lies where the visible points say, up
to s. Whether a point is visible is a chain of two states, as in `window_ncc`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from facetrack_cli.core.types import Array
from facetrack_cli.engine.protocols import Linear
from facetrack_cli.engine.smoothing import Belief
from facetrack_cli.trackers.face.stabilized import EYES
from facetrack_cli.trackers.face.window_ncc import BOUNDS, BY_TOLD, visible_after

KEEP: Final = 0.5
NO_FACE: Final = -1.0  # log odds where the network sees no face
MEMORY: Final = 100.0  # frames over which s and r are learned, and four times that for the place at rest
MOVES, TREMBLES = 0.05 * EYES, 0.015 * EYES  # s and r at first, pixels
MIN_MOVES, MIN_TREMBLES, MAX_TREMBLES = 0.02 * EYES, 0.005 * EYES, 0.05 * EYES
OFF: Final = 0.08 * EYES  # by how much the network itself is off for long


class MeshPoints(NamedTuple):
    """Of J points: places at rest (J, 2), a - m (J, 2) and its variance (J,), s^2 and r^2 (J,), P(visible) (J,).

    `moved` (J, 2) is m, and `before` (2, J, 2) the last places that were measured; `wrong` (J,): by how much the sensor
    is off for long; `least` (J,): the least s; all in pixels.
    """

    rest: Array
    off: Array
    var: Array
    moves: Array
    trembles: Array
    visible: Array
    moved: Array
    before: Array
    wrong: Array
    least: Array

    @classmethod
    def begin(cls, z: Array, wrong: Array | float = OFF, least: Array | float = MIN_MOVES) -> MeshPoints:
        """At the first measurement z (J, 2)."""
        ones = np.ones(len(z))
        r2, s2, both = TREMBLES**2 * ones, np.maximum(MOVES * ones, least) ** 2, np.stack([z, z])
        return cls(z, np.zeros_like(z), r2, s2, r2, ones, z, both, wrong * ones, least * ones)

    @property
    def at(self) -> Array:
        """The places a (J, 2)."""
        return self.moved + self.off

    @property
    def cov(self) -> Array:
        """(J, 2, 2): how sure they are."""
        return (self.var + self.wrong**2)[:, None, None] * np.eye(2)

    def mapped(self, to: Callable[[Array], Array]) -> MeshPoints:
        """In another stabilized image; the similarity `to` maps places of this image to it."""
        rest, moved = to(self.rest), to(self.moved)
        return self._replace(rest=rest, moved=moved, off=to(self.at) - moved, before=to(self.before))

    def after(self, z: Array | None, odds: Array | float) -> MeshPoints:
        """A frame later, with z (J, 2), None where the network sees no face, and the log odds (J,) of being visible."""
        v = visible_after(self.visible, np.clip(odds, *BY_TOLD))
        off, var = KEEP * self.off, KEEP**2 * self.var + (1 - KEEP**2) * self.moves
        if z is None:
            return self._replace(off=off, var=var, visible=v)
        moved = led(self.rest, z, v)
        gain = v * var / (var + self.trembles)
        off = off + gain[:, None] * (z - moved - off)
        rate = v / MEMORY
        jitter = np.sum((z - 2 * self.before[1] + self.before[0]) ** 2, axis=1) / 12  # noise of z, where it is smooth
        # what moves is no noise
        jitter = np.minimum(jitter, 4 * self.trembles)
        trembles = np.clip(self.trembles + rate * (jitter - self.trembles), MIN_TREMBLES**2, MAX_TREMBLES**2)
        moves = np.maximum(self.moves + rate * (0.5 * np.sum(off**2, axis=1) - self.moves), self.least**2)
        rest = self.rest + (rate / 4)[:, None] * off
        before = np.stack([self.before[1], z])
        return MeshPoints(rest, off, (1 - gain) * var, moves, trembles, v, moved, before, self.wrong, self.least)

    def belief(self) -> Belief:
        """What is known after a frame, for the smoother; by what the network is off for long does not move."""
        eye = np.broadcast_to(np.eye(2), (len(self.rest), 2, 2))
        motion = Linear(KEEP * eye, (1 - KEEP) * self.moved, ((1 - KEEP**2) * self.moves)[:, None, None] * eye)
        return Belief(self.at, self.var[:, None, None] * eye, motion, self.visible < 0.5)


def led(rest: Array, z: Array, weight: Array) -> Array:
    """`rest` (J, 2) moved, turned and scaled to come nearest to z (J, 2), by least squares with weights (J,)."""
    w = np.clip(weight, *BOUNDS)[:, None] / np.clip(weight, *BOUNDS).sum()
    a, b = rest @ (1, 1j), z @ (1, 1j)
    middle, to = (w[:, 0] @ a), (w[:, 0] @ b)
    turn = (w[:, 0] * np.conj(a - middle)) @ (b - to) / max(float(w[:, 0] @ np.abs(a - middle) ** 2), 1e-9)
    found = to + turn * (a - middle)
    return np.stack([found.real, found.imag], axis=1)
