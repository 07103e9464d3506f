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
`window_ncc.py`. The arithmetic of all parts and sensors in a frame is in `landmark_kernels.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from facetrack_cli.core.types import Array, Mask
from facetrack_cli.engine.protocols import Belief, Linear
from facetrack_cli.trackers.face import landmark_kernels as kernels
from facetrack_cli.trackers.face.cascaded_regression import PlacedPoints
from facetrack_cli.trackers.face.landmark_kernels import BY_NETWORK, KEEP, MAX_LOG_ODDS
from facetrack_cli.trackers.face.motion import SensorReading, modes
from facetrack_cli.trackers.face.stabilized import EYES

REGRESSION, NETWORK, DETECTOR = 0.05 * EYES, 0.02 * EYES, 0.05 * EYES  # the least r of a sensor
FADES: Final = 0.98  # k of a start that a sensor has placed
SURE: Final = 0.97  # probability that a sensor says something of a part that is visible, before it is learned
AREA: Final = 4 * math.pi * (kernels.ASTRAY * EYES) ** 2  # square pixels, of what it takes for it
# of whether a face is turned to the camera
_HIDE, _SHOW = 0.01, 0.05  # probabilities a frame
_FALSE: Final = 0.1  # probability that a face is found that does not look to the camera
_MANY: Final = 50.0  # looks over which it is learned how often a face is found
# of landmarks without windows
NO_FACE: Final = -1.0  # log odds where the network sees no face
MOTION, NOISE = 0.05 * EYES, 0.015 * EYES  # s and r at first, pixels
MIN_MOTION: Final = 0.02 * EYES
BIAS: Final = 0.08 * EYES  # lasting error of the network itself


Judge: TypeAlias = Callable[[SensorReading, Mask], Array]
"""Of S + 1 readings, the last that of windows, those of sensors without the shift that the parts have in common (then
the head has slipped, and no sensor errs), of which some differ in parts (K,): log odds (S + 1, K) by this frame that
each sees the part, nan where they follow from its distance from the particle filter's place."""


class BiasFilter(NamedTuple):
    """What is known of the errors of S sensors of K parts, in pixels of the stabilized image.

    Attributes
    ----------
    bias, var : b (S, K, 2) and its variance (S, K)
    noise : r^2 (S, K)
    reliability : (S, K), probability that a sensor sees the part, and not something else
    error_rate : (S, K), how often it does not
    min_std : (S,), the least r
    keep : k
    """

    bias: Array
    var: Array
    noise: Array
    reliability: Array
    error_rate: Array
    min_std: Array
    keep: float = 1.0

    @classmethod
    def begin(cls, z: Array, x0: Array, std: Array, min_std: Array, keep: float = 1.0) -> BiasFilter:
        """After first measurements z (S, K, 2) of parts at x0 (K, 2), nan if there is none; std (S,) is r at first."""
        seen, noise = np.isfinite(z[..., :1] + z[..., 1:]), np.repeat(std[:, None] ** 2, len(x0), axis=1)
        bias, var = np.where(seen, z - x0, 0.0), np.where(seen[..., 0], noise, (kernels.MAX_NOISE * EYES) ** 2)
        return cls(bias, var, noise, np.full_like(var, SURE), np.full_like(var, 1 - SURE), min_std, keep)

    def reading(self, z: Array, visible: Array, before: Array) -> tuple[SensorReading, Array, Array, bool]:
        """Measurements z (S, K, 2) without their biases, of parts that were at `before` (K, 2), with P(visible) (K,).

        Two readings in one have the product of their normal densities; where they are too far apart, the second counts.

        Returns
        -------
        The readings; (K, 2), regression and network in one, nan where neither sees a part; (2,), how far all parts have
        moved together, which the head has not followed: the mean under N(0, SLIP^2 I) of the shift, whose measurement
        is the median of the parts'; whether the detector is too far from regression and network in any part.
        """
        said = SensorReading(np.empty_like(z), np.empty_like(self.var), np.empty_like(self.var), AREA)
        at, shift = np.empty_like(before), np.empty(2)
        apart = kernels.read(z, visible, *self[:5], self.keep, before, EYES, *said[:3], at, shift)
        return said, at, shift, apart

    def updated(
        self, z: Array, readings: SensorReading, at: Array, cov: Array, visible: Array, judge: Judge
    ) -> tuple[BiasFilter, Array | None]:
        """The filter after a frame, and log odds (K,) that windows see the parts; None if nobody contradicts them.

        Parameters
        ----------
        z, readings : (S, K, 2), the measurements, nan where there is none; the same without biases
        at, cov, visible : (K, 2), (K, 2, 2) and (K,), where the particle filter has the parts, and P(visible)
        judge : what says who is right, where some are too far apart to be right together
        """
        (sensors, parts), differ, cross = self.var.shape, np.empty(len(at), np.bool_), np.empty_like(self.var)
        all_ = np.empty((sensors + 1, parts, 2)), np.empty((sensors + 1, parts)), np.empty((sensors + 1, parts))
        after, own, nothing = [values.copy() for values in self[:5]], None, np.empty((0, 0))
        given = *readings[:3], at, cov, visible, *all_, differ, cross
        if kernels.learn(*given, nothing, z, self.min_std, self.keep, EYES, *after):
            odds = judge(SensorReading(*all_, readings.area), differ)
            kernels.learn(*given, odds, z, self.min_std, self.keep, EYES, *after)
            own = odds[-1]
        return BiasFilter._make([*after, self.min_std, self.keep]), own

    def landmark_odds(self, landmarks: PlacedPoints, at: Array) -> Array:
        """(J,): log odds that landmarks are visible, less where the network errs in the nearest of its parts (K, 2)."""
        away = np.hypot(*(landmarks.at[:, None] - at).transpose(2, 0, 1))
        p = self.reliability[BY_NETWORK, np.where(np.isnan(away), np.inf, away).argmin(axis=1)]
        return np.asarray(landmarks.odds + np.minimum(np.log(p / (1 - p)), 0))


def who_is_right(readings: SensorReading, *scores: Array) -> Array:
    """Log odds (S, K) by one frame that readings see the parts, and not something else.

    Each set of readings may be right, and is if its members agree and the parts are seen there; all other readings are
    anywhere. What two independent sensors say alike is hardly wrong, even where windows follow something else.

    Parameters
    ----------
    readings : S of them
    scores : (2^S, K) each, log likelihoods of what is seen at the places of the sets, in the order of `modes`
    """
    _, p, w = modes(readings)
    log_p = w + sum(np.clip(score - score[:-1].max(axis=0), -MAX_LOG_ODDS, 0) for score in scores)
    log_p[:-1] += np.log(2 * math.pi / p[:-1] / readings.area)
    share, sets = np.exp(log_p - log_p.max(axis=0)), np.arange(len(log_p))
    odds = []
    for i, sure in enumerate(np.clip(readings.sure, 1e-6, 1 - 1e-6)):
        member = (sets >> i) % 2 == 0
        odds.append(np.log(share[member].sum(axis=0) / share[~member].sum(axis=0)) - np.log(sure / (1 - sure)))
    return np.stack(odds)


def in_common(offsets: Array, mask: Mask) -> Array:
    """(2,): the median of the offsets (K, 2) in the `mask` (K,), and 0 of less than three."""
    kernels.median_shift(offsets, mask, shift := np.empty(2))
    return shift


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
        cov = np.zeros((len(self.var), 2, 2))
        cov[:, 0, 0] = cov[:, 1, 1] = self.var + self.bias_std**2
        return cov

    def mapped(self, turned: complex, shift: complex) -> LandmarkFilter:
        """In another stabilized image, to which places of this one come as `Similarity.into` says."""
        places = np.concatenate([self.carried[None], self.last]), self.rest, self.offset[None]
        new = [np.empty_like(values) for values in places]
        kernels.relay((turned.real, turned.imag, shift.real, shift.imag), *places, *new)
        return self._replace(rest=new[1], offset=new[2][0], carried=new[0][0], last=new[0][1:])

    def after(self, z: Array | None, log_odds: Array | float) -> LandmarkFilter:
        """A frame later.

        Parameters
        ----------
        z : (J, 2), None where the sensor sees no face
        log_odds : (J,), log odds by this frame that the landmarks are visible
        """
        after = [values.copy() for values in self[:8]]
        odds = np.full(len(self.var), log_odds, np.float64)
        kernels.follow(z is not None, self.carried if z is None else z, odds, EYES, *after, self.min_motion)
        return LandmarkFilter._make([*after, self.bias_std, self.min_motion])

    def belief(self) -> Belief:
        """For the smoother. The lasting error of the sensor does not move, and is left out."""
        eye = np.broadcast_to(np.eye(2), (len(self.rest), 2, 2))
        noise = ((1 - KEEP**2) * self.motion_var)[:, None, None] * eye
        motion = Linear(KEEP * eye, (1 - KEEP) * self.carried, noise)
        return Belief(self.at, self.var[:, None, None] * eye, motion, self.visible < 0.5)
