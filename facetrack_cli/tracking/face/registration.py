"""Where the parts are in the windows that a filter tracks, by what a detector says of them (ours).

The windows follow what the first frame showed at a part; over many frames, and when the head turns, they may slip, and
a start may be wrong. A detector that looks at the face every few frames says where the parts are, less exactly, but
without slipping. With the window's place w, the part's a = w - b, and the detection z,

    b_t = b_{t-1} + N(0, q I),    w - z = b + c + N(0, r^2 I)

where c is what the detector always has differently from whoever placed the points in the first frame. Both are followed
by a Kalman filter for each part, the same along x and y. A window that still looks as in the first frame slips less
(q times 1 - .95 of how like it is), and q follows from how far detections have been off (Mehra 1970), so that a head
that turns much is measured more than one that hardly moves.

Whether the face is turned to the camera, or covered, is a chain of two states. The detector finds a face that is with a
probability learned from the clip, and another one seldom.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from facetrack_cli.core.types import Array, Mask
from facetrack_cli.tracking.face.still import EYES

_DRIFT = 0.027  # standard deviation of b in a frame, at first, in distances between the eyes
_STEADY = 0.005  # the least q, in terms of r^2
_LEARNS = 0.1  # share of a measurement in q
_ANCHOR = 0.95
_BY_HAND = 0.03  # how exact points are that somebody has placed, in distances between the eyes
_HIDE, _SHOW = 0.01, 0.05  # probabilities a frame
_FALSE = 0.1  # probability that a face is found that does not look to the camera
_MANY = 50.0  # measurements over which it is learned how often a face is found


class Registration(NamedTuple):
    """b and c (2, K, 2), their covariances (K, 2, 2), q in pixels^2 of the still face; P(shown) and what it rests on.

    `since`: frames since the last detection. `found` counts looks at a face that was shown: those that found it, and
    those that did not.
    """

    bias: Array
    cov: Array
    drift: float
    shown: float = 1.0
    since: int = 0
    found: tuple[float, float] = (9.0, 1.0)

    @classmethod
    def begin(cls, parts: int, std: float, *, searched: bool) -> Registration:
        """At the start, whose points the detector has placed itself if it was `searched`; `std`: r."""
        cov = np.diag([0.5 * std**2, 0.0] if searched else [(_BY_HAND * EYES) ** 2, std**2])
        return cls(np.zeros((2, parts, 2)), np.repeat(cov[None], parts, axis=0), (_DRIFT * EYES) ** 2)

    def unseen(self) -> Registration:
        """Where the detector does not find the face of the start: then it means little that it does not later."""
        return self._replace(found=(10 * _FALSE, 10 * (1 - _FALSE)))

    def predict(self, anchored: Array, *, looks: bool) -> Registration:
        """A frame later, in which windows (K,) are so like the first frame; `looks`: whether there is a detector."""
        if not looks:
            return self
        cov = self.cov.copy()
        cov[:, 0, 0] += self.drift * (1 - _ANCHOR * anchored)
        shown = self.shown * (1 - _HIDE) + (1 - self.shown) * _SHOW
        return self._replace(cov=cov, shown=shown, since=self.since + 1)

    def looked(self, *, found: bool) -> Registration:
        """After the detector has found the face, or not."""
        yes, no = self.found
        rate = yes / (yes + no)
        here, else_ = (rate, _FALSE) if found else (1 - rate, 1 - _FALSE)
        shown = self.shown * here / (self.shown * here + (1 - self.shown) * else_)
        keep = 1 - 1 / _MANY
        return self._replace(shown=shown, found=(keep * yes + shown * found, keep * no + shown * (not found)))

    def measured(self, windows: Array, z: Array, known: Mask, std: float) -> Registration:
        """After a detection z (K, 2) of the `known` parts, while windows are at (K, 2); others move as these do."""
        total = self.cov.sum(axis=(1, 2))
        gain = self.cov.sum(axis=2) / (total + std**2)[:, None]  # (K, 2)
        off = windows - z - self.bias.sum(axis=0)
        off[~known] = off[known].mean(axis=0)
        needed = (0.5 * float(np.sum(off[known] ** 2, axis=1).mean()) - std**2) / max(self.since, 1)
        drift = self.drift + _LEARNS * (min(max(needed, 0.0), 10 * self.drift) - self.drift)
        bias, cov = self.bias + gain.T[..., None] * off, self.cov - gain[:, :, None] * self.cov.sum(axis=1)[:, None]
        return self._replace(bias=bias, cov=cov, drift=max(drift, _STEADY * std**2), since=0)

    def again(self, parts: Mask, std: float) -> Registration:
        """Where somebody has placed some parts (K,) anew."""
        fresh = Registration.begin(len(parts), std, searched=False)
        bias = self.bias.copy()
        bias[0, parts] = 0.0
        cov = self.cov.copy()
        cov[parts, 0], cov[parts, :, 0] = 0.0, 0.0
        cov[parts, 0, 0] = fresh.cov[parts, 0, 0]
        return self._replace(bias=bias, cov=cov, shown=1.0, since=0)
