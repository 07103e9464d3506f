"""What is known over time of a face's landmarks and of the sensors that measure them (ours).

**Bias of a sensor.** A regression, a network or a detector measures where the parts are with an error that has two
shares. One lasts for seconds, since it depends on the person, the expression and the light: the bias b. The other is
new in each frame. With a_t the parts in frame t, in pixels of the stabilized image,

    z_t = a_t + b_t + N(0, r^2 I),    b_t = k b_{t-1} + N(0, q I)

A Kalman filter for each part, the same along x and y, follows b; r follows from how far measurements have been off
(Mehra, IEEE Transactions on Automatic Control 1970). Where somebody has placed the points of the start, the bias may
stay for ever (k = 1). A start that a sensor has placed may itself be wrong: then b fades.

**Mistakes of a sensor.** It may take something else for a part, for a while: teeth or the chin for a lip. Whether it
does is a chain of two states for each part, observed by how far z is from where windows and all sensors together have
the part. How often it does is learned from the clip.

**Landmarks without windows.** Eyes, brows, jaw and the like have a Kalman filter each. With m the place at rest, moved
with the points that are visible,

    a_t - m_t = 1/2 (a_{t-1} - m_{t-1}) + N(0, 3/4 s^2 I),    z_t = a_t + N(0, r^2 I) while the point is visible

How far a point moves with expressions (s), and how much its measurements tremble (r), are running means of the clip.
A hidden point lies where the visible ones say, up to s. Whether it is visible is a chain of two states, as in
`window_ncc.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np

from facetrack_cli.core.types import Array, Mask
from facetrack_cli.engine.protocols import Linear
from facetrack_cli.engine.smoothing import Belief
from facetrack_cli.trackers.face.cascaded_regression import PlacedPoints
from facetrack_cli.trackers.face.motion import SensorReading, modes
from facetrack_cli.trackers.face.stabilized import EYES
from facetrack_cli.trackers.face.window_ncc import BOUNDS, BY_SENSOR, visible_after

# of sensors
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
MAX_LOG_ODDS: Final = 4.0  # bound of what one frame says of it, and of what the head's filter is told
# of whether a face is turned to the camera
_HIDE, _SHOW = 0.01, 0.05  # probabilities a frame
_FALSE: Final = 0.1  # probability that a face is found that does not look to the camera
_MANY: Final = 50.0  # looks over which it is learned how often a face is found
# of landmarks without windows
KEEP: Final = 0.5
NO_FACE: Final = -1.0  # log odds where the network sees no face
MEMORY: Final = 100.0  # frames over which s and r are learned, and four times that for the place at rest
MOTION, NOISE = 0.05 * EYES, 0.015 * EYES  # s and r at first, pixels
MIN_MOTION, MIN_NOISE, MAX_LANDMARK_NOISE = 0.02 * EYES, 0.005 * EYES, 0.05 * EYES
BIAS: Final = 0.08 * EYES  # lasting error of the network itself


class BiasFilter(NamedTuple):
    """What is known of a sensor's errors of K parts, in pixels of the stabilized image.

    Attributes
    ----------
    bias, var : b (K, 2) and its variance (K,)
    noise : r^2 (K,)
    reliability : (K,), probability that it sees the part, and not something else
    error_rate : (K,), how often it does not
    min_std : the least r
    keep : k
    """

    bias: Array
    var: Array
    noise: Array
    reliability: Array
    error_rate: Array
    min_std: float
    keep: float = 1.0

    @classmethod
    def begin(cls, z: Array, x0: Array, std: float, min_std: float, keep: float = 1.0) -> BiasFilter:
        """After a first measurement z (K, 2) of parts at x0 (K, 2), nan where there is none; `std` is r at first."""
        seen, ones = _measured(z), np.ones(len(x0))
        bias, var = np.where(seen[:, None], z - x0, 0.0), np.where(seen, std**2, MAX_NOISE**2)
        return cls(bias, var, std**2 * ones, SURE * ones, (1 - SURE) * ones, min_std, keep)

    def reading(self, z: Array, visible: Array) -> SensorReading:
        """A measurement z (K, 2) without its bias, of parts that are visible with a probability (K,)."""
        seen = _measured(z)
        if not seen.any():
            return SensorReading(np.zeros_like(z), self._var_ahead + self.noise, np.zeros(len(z)), AREA)
        sure = np.where(seen, self._reliability_ahead * (BLIND + (1 - BLIND) * visible), 0.0)
        at = np.where(seen[:, None], z - self.keep * self.bias, 0.0)
        noise = self.noise + MISLED**2 * (1 - visible.min())
        return SensorReading(at, self._var_ahead + noise, sure, AREA)

    def updated(
        self,
        z: Array,
        state: Array,
        cov: Array,
        visible: Array,
        log_odds: Array | float = math.nan,
        cross: Array | float = 0.0,
    ) -> BiasFilter:
        """The filter after a frame.

        Parameters
        ----------
        z : (K, 2), the measurement; nan where there is none
        state, cov : (K, 2) and (K, 2, 2), where the particle filter has the parts
        visible : (K,), probability that a part is visible
        log_odds : (K,), log odds by this frame that the sensor sees the part; nan where they follow from `state` alone
        cross : (K,), its share of the squared distance from an independent sensor, in square pixels; `state` alone
            would flatter a sensor that has moved it
        """
        var, bias = self._var_ahead, self.keep * self.bias
        if not np.isfinite(z).any():
            return self._replace(bias=bias, var=var, reliability=self._reliability_ahead)
        off, spread = z - bias - state, 0.5 * (cov[:, 0, 0] + cov[:, 1, 1])
        squared = 0.5 * np.sum(off**2, axis=1)
        seen, total = np.isfinite(squared), var + self.noise + spread
        far = total + ASTRAY**2
        alone = 0.5 * np.sum((off - in_common(off, seen)) ** 2, axis=1)
        evidence = np.where(np.isnan(log_odds), np.log(far / total) - alone * (1 / total - 1 / far), log_odds)
        ahead = self._reliability_ahead
        bounded = np.nan_to_num(np.clip(evidence, -MAX_LOG_ODDS, MAX_LOG_ODDS))
        reliability = 1 / (1 + np.exp(-(np.log(ahead / (1 - ahead)) + visible * bounded)))
        rate = self.error_rate + OFTEN * seen * visible * (1 - reliability - self.error_rate)
        # a hidden part misplaces all of them
        use = np.where(seen & (squared < MAX_SQUARED_DISTANCE * total), visible * visible.min(), 0.0) * reliability
        gain = use * var / total
        noise = self.noise + LEARNS * use * (np.maximum(np.nan_to_num(squared), cross) - self.noise)
        return self._replace(
            bias=bias + gain[:, None] * np.nan_to_num(off),
            var=(1 - gain) * var,
            noise=np.clip(noise, self.min_std**2, MAX_NOISE**2),
            reliability=reliability,
            error_rate=np.clip(rate, *LIMITS),
        )

    def landmark_odds(self, landmarks: PlacedPoints, at: Array) -> Array:
        """(J,): log odds that landmarks are visible, less where the sensor errs in the nearest of the parts (K, 2)."""
        away = np.hypot(*(landmarks.at[:, None] - at).transpose(2, 0, 1))
        p = self.reliability[np.where(np.isnan(away), np.inf, away).argmin(axis=1)]
        return np.asarray(landmarks.odds + np.minimum(np.log(p / (1 - p)), 0))

    @property
    def _reliability_ahead(self) -> Array:
        begins = np.minimum(ENDS * self.error_rate / (1 - self.error_rate), 1 - ENDS)
        return np.asarray(self.reliability * (1 - begins) + (1 - self.reliability) * ENDS)

    @property
    def _var_ahead(self) -> Array:
        return np.asarray(self.keep**2 * self.var + DRIFT**2)


def who_is_right(readings: Sequence[SensorReading], *scores: Array) -> Array:
    """Log odds (S, K) by one frame that readings see the parts, and not something else.

    Each set of readings may be right, and is if its members agree and the parts are seen there; all other readings are
    anywhere. What two independent sensors say alike is hardly wrong, even where windows follow something else.

    Parameters
    ----------
    readings : S of them; wrong ones are anywhere in the area of the first
    scores : (2^S, K) each, log likelihoods of what is seen at the places of the sets, in the order of `modes`
    """
    _, p, w = modes(readings, len(readings[0].sure))
    log_p = w + sum(np.clip(score - score[:-1].max(axis=0), -MAX_LOG_ODDS, 0) for score in scores)
    log_p[:-1] += np.log(2 * math.pi / p[:-1] / readings[0].area)
    share, sets = np.exp(log_p - log_p.max(axis=0)), np.arange(len(log_p))
    odds = []
    for i, reading in enumerate(readings):
        member = (sets >> i) % 2 == 0
        sure = np.clip(reading.sure, 1e-6, 1 - 1e-6)
        odds.append(np.log(share[member].sum(axis=0) / share[~member].sum(axis=0)) - np.log(sure / (1 - sure)))
    return np.stack(odds)


def joined(first: SensorReading, second: SensorReading) -> SensorReading:
    """Two readings in one; where they are far apart, the second alone."""
    if not second.sure.any():
        return first
    weight = np.where(apart(first, second), 0.0, first.sure / first.var), second.sure / second.var
    total = np.maximum(weight[0] + weight[1], 1e-12)
    z = (weight[0][:, None] * first.z + weight[1][:, None] * second.z) / total[:, None]
    sure = np.maximum(first.sure, second.sure)
    return SensorReading(z, np.where(sure > 0, sure / total, first.var), sure, first.area)


def apart(first: SensorReading, second: SensorReading) -> Mask:
    """(K,): the parts of which two readings cannot both be right."""
    if not (both := np.minimum(first.sure, second.sure) > 0).any():
        return np.asarray(both)
    far = np.sum((first.z - second.z) ** 2, axis=1) > MAX_SQUARED_DISTANCE * (first.var + second.var)
    return np.asarray(both & far)


def in_common(offsets: Array, mask: Mask) -> Array:
    """(2,): the median of the offsets (K, 2) in the `mask` (K,): the head has slipped by that, and no sensor errs."""
    count = int(mask.sum())
    if count < 3:
        return np.zeros(2)
    each = np.sort(offsets[mask], axis=0)  # NumPy's median takes ten times as long
    return np.asarray(0.5 * (each[(count - 1) // 2] + each[count // 2]))


def common_shift(reading: SensorReading, state: Array) -> Array:
    """(2,): how far all parts have moved together from `state` (K, 2), which the head has not followed.

    The mean under N(0, SLIP^2 I) of the shift, whose measurement is the median of the parts'.
    """
    sure = reading.sure > 0.5
    shift = in_common(reading.z - state, sure)
    return np.asarray(shift * SLIP**2 / (SLIP**2 + np.median(reading.var[sure]))) if shift.any() else shift


class Facing(NamedTuple):
    """Whether a face is turned to the camera and not covered: a chain of two states that a detector observes.

    Attributes
    ----------
    shown : the probability that it is
    counts : looks at a shown face that found it, and looks that did not, as running sums
    """

    shown: float = 1.0
    counts: tuple[float, float] = (9.0, 1.0)

    def undetected(self) -> Facing:
        """For a start in which the detector does not find the face: then it means little that it does not later."""
        return self._replace(counts=(10 * _FALSE, 10 * (1 - _FALSE)))

    def log_odds(self, sensors: float) -> float:
        """Bounded log odds that a face is in its place, by the detector and by the log odds of the sensors."""
        seen = math.log(max(self.shown, 1e-6) / max(1 - self.shown, 1e-6))
        return min(max(seen * self.counts[0] / sum(self.counts) + min(sensors, 0.0), -MAX_LOG_ODDS), MAX_LOG_ODDS)

    def predicted(self) -> Facing:
        return self._replace(shown=self.shown * (1 - _HIDE) + (1 - self.shown) * _SHOW)

    def updated(self, *, detected: bool) -> Facing:
        """After a look of the detector."""
        yes, no = self.counts
        rate = yes / (yes + no)
        here, elsewhere = (rate, _FALSE) if detected else (1 - rate, 1 - _FALSE)
        shown = self.shown * here / (self.shown * here + (1 - self.shown) * elsewhere)
        keep = 1 - 1 / _MANY
        return Facing(shown, (keep * yes + shown * detected, keep * no + shown * (not detected)))


def _measured(z: Array) -> Mask:
    """(K,): the parts of which z (K, 2) has a place."""
    return np.asarray(np.isfinite(z).all(axis=1), np.bool_)


class LandmarkFilter(NamedTuple):
    """J landmarks without windows, in pixels of the stabilized image.

    Attributes
    ----------
    rest : (J, 2), the places at rest
    offset, var : a - m (J, 2), and its variance (J,)
    motion_var, noise_var : s^2 and r^2 (J,)
    visible : (J,), probability
    carried : m (J, 2), the places at rest where the visible landmarks carry them
    last : (2, J, 2), the last two measurements
    bias_std : (J,), lasting error of the sensor
    min_motion : (J,), the least s
    """

    rest: Array
    offset: Array
    var: Array
    motion_var: Array
    noise_var: Array
    visible: Array
    carried: Array
    last: Array
    bias_std: Array
    min_motion: Array

    @classmethod
    def begin(cls, z: Array, bias_std: Array | float = BIAS, min_motion: Array | float = MIN_MOTION) -> LandmarkFilter:
        """At the first measurement z (J, 2)."""
        ones = np.ones(len(z))
        noise, motion = NOISE**2 * ones, np.maximum(MOTION * ones, min_motion) ** 2
        last = np.stack([z, z])
        return cls(z, np.zeros_like(z), noise, motion, noise, ones, z, last, bias_std * ones, min_motion * ones)

    @property
    def at(self) -> Array:
        """The places a (J, 2)."""
        return self.carried + self.offset

    @property
    def cov(self) -> Array:
        """(J, 2, 2): the covariance of the places, with what the sensor is off for long."""
        return (self.var + self.bias_std**2)[:, None, None] * np.eye(2)

    def mapped(self, to: Callable[[Array], Array]) -> LandmarkFilter:
        """In another stabilized image; the similarity `to` maps places of this image to it."""
        carried = to(self.carried)
        return self._replace(rest=to(self.rest), carried=carried, offset=to(self.at) - carried, last=to(self.last))

    def after(self, z: Array | None, log_odds: Array | float) -> LandmarkFilter:
        """A frame later.

        Parameters
        ----------
        z : (J, 2), None where the sensor sees no face
        log_odds : (J,), log odds by this frame that the landmarks are visible
        """
        v = visible_after(self.visible, np.clip(log_odds, *BY_SENSOR))
        offset, var = KEEP * self.offset, KEEP**2 * self.var + (1 - KEEP**2) * self.motion_var
        if z is None:
            return self._replace(offset=offset, var=var, visible=v)
        carried = carried_by(self.rest, z, v)
        gain = v * var / (var + self.noise_var)
        offset = offset + gain[:, None] * (z - carried - offset)
        rate = v / MEMORY
        jitter = np.sum((z - 2 * self.last[1] + self.last[0]) ** 2, axis=1) / 12  # noise of z, where it is smooth
        # what moves is no noise
        noise = self.noise_var + rate * (np.minimum(jitter, 4 * self.noise_var) - self.noise_var)
        motion = self.motion_var + rate * (0.5 * np.sum(offset**2, axis=1) - self.motion_var)
        return self._replace(
            rest=self.rest + (rate / 4)[:, None] * offset,
            offset=offset,
            var=(1 - gain) * var,
            motion_var=np.maximum(motion, self.min_motion**2),
            noise_var=np.clip(noise, MIN_NOISE**2, MAX_LANDMARK_NOISE**2),
            visible=v,
            carried=carried,
            last=np.stack([self.last[1], z]),
        )

    def belief(self) -> Belief:
        """For the smoother. The lasting error of the sensor does not move, and is left out."""
        eye = np.broadcast_to(np.eye(2), (len(self.rest), 2, 2))
        noise = ((1 - KEEP**2) * self.motion_var)[:, None, None] * eye
        motion = Linear(KEEP * eye, (1 - KEEP) * self.carried, noise)
        return Belief(self.at, self.var[:, None, None] * eye, motion, self.visible < 0.5)


def carried_by(rest: Array, z: Array, weight: Array) -> Array:
    """`rest` (J, 2) moved, turned and scaled to come nearest to z (J, 2), by least squares with weights (J,)."""
    w = np.clip(weight, *BOUNDS) / np.clip(weight, *BOUNDS).sum()
    a, b = rest @ (1, 1j), z @ (1, 1j)
    middle, to = w @ a, w @ b
    turn = (w * np.conj(a - middle)) @ (b - to) / max(float(w @ np.abs(a - middle) ** 2), 1e-9)
    place = to + turn * (a - middle)
    return np.stack([place.real, place.imag], axis=1)
