"""What is known of a sensor of facial points, and of whether a face is turned to the camera (ours).

A sensor, a regression, a network or a detector, says where the parts are with an error that has two shares. One stays
for seconds, since it depends on the person, the expression and the light: the bias b. The other is new in each frame.
With a_t the parts in frame t, in pixels of the stabilized image,

    z_t = a_t + b_t + N(0, r^2 I),    b_t = k b_{t-1} + N(0, q I)

b is followed by a Kalman filter for each part, the same along x and y; r follows from how far measurements have been
off (Mehra, IEEE Transactions on Automatic Control 1970). Where somebody has placed the points of the start, a sensor
may always be off from them by the same (k = 1). A start that was placed by a sensor may itself be wrong: then b fades.

A sensor may take something else for a part, for a while: teeth or the chin for a lip. Whether it does is a chain of two
states for each part, observed by how far z is from where windows and all sensors together have the part. How often it
does is learned from the clip.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from facetrack_cli.core.types import Array, Mask
from facetrack_cli.trackers.face.descent import PlacedPoints
from facetrack_cli.trackers.face.motion import SensorReading, modes
from facetrack_cli.trackers.face.stabilized import EYES

DRIFT: Final = 0.001 * EYES  # standard deviation of b in a frame, pixels
REGRESSION, NETWORK, DETECTOR = 0.05 * EYES, 0.02 * EYES, 0.05 * EYES  # the least r of a sensor
MAX_NOISE: Final = 0.1 * EYES  # and the greatest
FADES: Final = 0.98  # k of a start that a sensor has placed
MISLED: Final = 0.1 * EYES  # r in a face of which a part is hidden: a sensor places all parts together
LEARNS: Final = 0.02  # share of a measurement in r^2
SLIP: Final = 0.1 * EYES  # standard deviation of what a head moves in a frame and its box does not
MAX_SQUARED_DISTANCE: Final = 9.0  # of squared distances, in variances
WINDOWS: Final = 0.97  # probability that windows see a part that is visible, and nothing like it
SURE: Final = 0.97  # probability that a sensor says something of a part that is visible, before it is learned
BLIND: Final = 0.1  # its share that is left of a part that is hidden
ASTRAY: Final = 0.25 * EYES  # standard deviation of z where a sensor takes something else for the part
AREA: Final = 4 * math.pi * ASTRAY**2  # square pixels
ENDS: Final = 0.1  # probability a frame that it no longer does
OFTEN: Final = 0.01  # share of a frame in how often it does
LIMITS: Final = (0.01, 0.9)  # of that
TOLD: Final = 4.0  # bound of what a frame says of it, in log odds
_HIDE, _SHOW = 0.01, 0.05  # probabilities a frame
_FALSE: Final = 0.1  # probability that a face is found that does not look to the camera
_TOLD: Final = 4.0  # bound of what is told to the head's filter, in log odds
_MANY: Final = 50.0  # looks over which it is learned how often a face is found


class Sensor(NamedTuple):
    """b (K, 2), its variance (K,) and r^2 (K,), in the stabilized image; `least` is the least r, and `keep` is k.

    `right` (K,): P(it sees the parts), and not something else; `wrong` (K,): how often it does not.
    """

    bias: Array
    var: Array
    noise: Array
    right: Array
    wrong: Array
    least: float
    keep: float = 1.0

    @classmethod
    def begin(cls, z: Array, x0: Array, std: float, least: float, keep: float = 1.0) -> Sensor:
        """After a first measurement z (K, 2) of parts at x0 (K, 2), nan where there is none; `std`: r at first."""
        known, ones = _known(z), np.ones(len(x0))
        bias, var = np.where(known[:, None], z - x0, 0.0), np.where(known, std**2, MAX_NOISE**2)
        return cls(bias, var, std**2 * ones, SURE * ones, (1 - SURE) * ones, least, keep)

    def measured(self, z: Array, visible: Array) -> SensorReading:
        """What z (K, 2) says of parts that are visible with a probability (K,)."""
        known = _known(z)
        if not known.any():
            nothing = np.zeros(len(z))
            return SensorReading(np.zeros_like(z), self._ahead + self.noise, nothing, AREA)
        sure = np.where(known, self._right_ahead * (BLIND + (1 - BLIND) * visible), 0.0)
        at = np.where(known[:, None], z - self.keep * self.bias, 0.0)
        noise = self.noise + MISLED**2 * (1 - visible.min())
        return SensorReading(at, self._ahead + noise, sure, AREA)

    def learned(
        self,
        z: Array,
        state: Array,
        cov: Array,
        visible: Array,
        told: Array | float = math.nan,
        cross: Array | float = 0.0,
    ) -> Sensor:
        """After z (K, 2), where the filter has the parts at `state` (K, 2), with `cov` (K, 2, 2).

        `told` (K,): the log odds of a frame that it sees the parts, nan where that follows from `state` alone.
        `cross` (K,): its share of the squared distance from an independent sensor, since the filter's state is partly
        what it has said itself.
        """
        var, before = self._ahead, self.keep * self.bias
        if not np.isfinite(z).any():
            return self._replace(bias=before, var=var, right=self._right_ahead)
        off, spread = z - before - state, 0.5 * (cov[:, 0, 0] + cov[:, 1, 1])
        squared = 0.5 * np.sum(off**2, axis=1)
        total = var + self.noise + spread
        use = np.where(np.isfinite(squared) & (squared < MAX_SQUARED_DISTANCE * total), visible * visible.min(), 0.0)
        far = total + ASTRAY**2
        alone = 0.5 * np.sum((off - in_common(off, np.isfinite(squared))) ** 2, axis=1)
        evidence = np.where(np.isnan(told), np.log(far / total) - alone * (1 / total - 1 / far), told)
        ahead = self._right_ahead
        odds = np.log(ahead / (1 - ahead)) + visible * np.nan_to_num(np.clip(evidence, -TOLD, TOLD))
        right = 1 / (1 + np.exp(-odds))
        wrong = np.clip(self.wrong + OFTEN * np.isfinite(squared) * visible * (1 - right - self.wrong), *LIMITS)
        use = use * right
        gain = use * var / total
        noise = np.clip(
            self.noise + LEARNS * use * (np.maximum(np.nan_to_num(squared), cross) - self.noise),
            self.least**2,
            MAX_NOISE**2,
        )
        bias = before + gain[:, None] * np.nan_to_num(off)
        return self._replace(bias=bias, var=(1 - gain) * var, noise=noise, right=right, wrong=wrong)

    def near(self, others: PlacedPoints, at: Array) -> Array:
        """The log odds (J,) that `others` are visible, less where it is wrong of the nearest of the parts at (K, 2)."""
        away = np.hypot(*(others.at[:, None] - at).transpose(2, 0, 1))
        right = self.right[np.where(np.isnan(away), np.inf, away).argmin(axis=1)]
        return np.asarray(others.odds + np.minimum(np.log(right / (1 - right)), 0))

    @property
    def _right_ahead(self) -> Array:
        """P(it sees the parts) in the next frame."""
        begins = np.minimum(ENDS * self.wrong / (1 - self.wrong), 1 - ENDS)
        return np.asarray(self.right * (1 - begins) + (1 - self.right) * ENDS)

    @property
    def _ahead(self) -> Array:
        """The variance of b in the next frame."""
        return np.asarray(self.keep**2 * self.var + DRIFT**2)


def who_is_right(readings: Sequence[SensorReading], *scores: Array) -> Array:
    """By how much a frame says that readings see the parts, and not something else, in log odds (S, K).

    Each set of readings may be right, and is if its members agree and the parts are seen there; all others are
    anywhere. What two independent sensors say alike is hardly wrong, though windows follow something else.

    Parts are anywhere in the area of the first of the S `readings`. `scores` (2^S, K) each: log likelihoods of what is
    seen at the sets' places, in the order of `modes`, as by windows.
    """
    _, p, w = modes(readings, len(readings[0].sure))
    known = w + sum(np.clip(one - one[:-1].max(axis=0), -TOLD, 0) for one in scores)
    known[:-1] += np.log(2 * math.pi / p[:-1] / readings[0].area)
    share, sets = np.exp(known - known.max(axis=0)), np.arange(len(known))
    each = []
    for i, one in enumerate(readings):
        says = (sets >> i) % 2 == 0
        sure = np.clip(one.sure, 1e-6, 1 - 1e-6)
        each.append(np.log(share[says].sum(axis=0) / share[~says].sum(axis=0)) - np.log(sure / (1 - sure)))
    return np.stack(each)


def joined(one: SensorReading, other: SensorReading) -> SensorReading:
    """What two sensors say together; where they are far apart, what the other says alone."""
    if not other.sure.any():
        return one
    weight = np.where(apart(one, other), 0.0, one.sure / one.var), other.sure / other.var
    total = np.maximum(weight[0] + weight[1], 1e-12)
    z = (weight[0][:, None] * one.z + weight[1][:, None] * other.z) / total[:, None]
    sure = np.maximum(one.sure, other.sure)
    return SensorReading(z, np.where(sure > 0, sure / total, one.var), sure, one.area)


def apart(one: SensorReading, other: SensorReading) -> Mask:
    """(K,): of which parts two sensors cannot both be right."""
    if not (both := np.minimum(one.sure, other.sure) > 0).any():
        return np.asarray(both)
    return np.asarray(both & (np.sum((one.z - other.z) ** 2, axis=1) > MAX_SQUARED_DISTANCE * (one.var + other.var)))


def in_common(off: Array, known: Mask) -> Array:
    """By how much (2,) all `known` (K,) parts are `off` (K, 2) alike: then the head has slipped, and no sensor errs."""
    many = int(known.sum())
    if many < 3:
        return np.zeros(2)
    each = np.sort(off[known], axis=0)  # their median; NumPy's takes ten times as long
    return np.asarray(0.5 * (each[(many - 1) // 2] + each[many // 2]))


def common_shift(measured: SensorReading, state: Array) -> Array:
    """By how much (2,) all parts have moved together since they were at `state` (K, 2): what the head has not followed.

    The mean under N(0, SLIP^2 I) of the shift, whose measurement is the median of the parts'.
    """
    known = measured.sure > 0.5
    off = in_common(measured.z - state, known)
    return np.asarray(off * SLIP**2 / (SLIP**2 + np.median(measured.var[known]))) if off.any() else off


class Facing(NamedTuple):
    """P(the face is turned to the camera and not covered): a chain of two states, observed by a detector of faces.

    `found` counts looks at a face that was shown: those that found it, and those that did not. The detector finds
    another face seldom.
    """

    shown: float = 1.0
    found: tuple[float, float] = (9.0, 1.0)

    def unseen(self) -> Facing:
        """Where the detector does not find the face of the start: then it means little that it does not later."""
        return self._replace(found=(10 * _FALSE, 10 * (1 - _FALSE)))

    def odds(self, sure: float) -> float:
        """Log odds, bounded, by which detector and sensor, with log odds `sure`, speak for a face in its place."""
        seen = math.log(max(self.shown, 1e-6) / max(1 - self.shown, 1e-6))
        return min(max(seen * self.found[0] / sum(self.found) + min(sure, 0.0), -_TOLD), _TOLD)

    def predicted(self) -> Facing:
        return self._replace(shown=self.shown * (1 - _HIDE) + (1 - self.shown) * _SHOW)

    def looked(self, *, found: bool) -> Facing:
        """After the detector has found the face, or not."""
        yes, no = self.found
        rate = yes / (yes + no)
        here, else_ = (rate, _FALSE) if found else (1 - rate, 1 - _FALSE)
        shown = self.shown * here / (self.shown * here + (1 - self.shown) * else_)
        keep = 1 - 1 / _MANY
        return Facing(shown, (keep * yes + shown * found, keep * no + shown * (not found)))


def _known(z: Array) -> Mask:
    """(K,): of which parts z (K, 2) says something."""
    return np.asarray(np.isfinite(z).all(axis=1), np.bool_)
