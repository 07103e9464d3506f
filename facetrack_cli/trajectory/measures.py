"""What a face does, and hands beside it, as numbers with a spread and a noise: docs/measures.md says what each is.

`share` is how long the head's own horizontal is in the image, by its pose: 1 from the front, or where the pose is not
known, and at least .5. Distances along it are over `share`, so that they do not shrink when the head turns.

The spread is of first order: derivatives, by central differences, times the covariance of each point in its row. It
takes points as independent and the pose as known. The spread of an angle is that of the points alone: what a person's
proportions add (head.py) is the same in all frames.

The noise is the spread without an offset that all frames of a clip share as long as the head stands alike. It has three
parts: the jitter from frame to frame, by the median of second differences; a share of how far the measure varies in the
clip, since a tracker follows a face's motion in part; a share of the spread, all of it where the head is turned or
nearer than usual.

Of hands (ours) the speed is that of the straight line through a hand's places within `REACH_S`. Its noise is that of
the places, by the lower quartile of their second differences, since a hand that moves has large ones; what noise alone
makes of the speed's square is taken from it. The gap of two boxes is that of the ellipses within them along the line of
their centres, and its noise that of the centres in the rows and `OUTLINE` of the outlines.

Events have times and probabilities: a mouth is open, eyes blink, a head nods.
Each kind is a hidden Markov model of one measure. Its states are rest, halfway and away from rest. A kind that goes
both ways has rest and either side; a measure that is itself a probability has no and yes. A state lasts an exponential
time, and each state may follow, so a pause between rows makes the state after it less sure.

The likelihood of a row is normal about the level of its state. Its variance is that of people at rest or away (`std`)
and that of the noise: the row's doubt, and what its spread has beyond the step that people make. Before,
the value is moved towards rest by that noise: errors last, so that many frames say no more of them than one. Values
beyond the outer levels count as on them. Rows beside lost ones do not count.

The level at rest, its variation and the step from it are learned from the clip by expectation maximization. What people
do (`KINDS`) is their prior, with the weight of `PRIOR` frames. Each shot of a film has its own. Frames are not
independent: the log likelihood of each has the factor `weight`.

Steps, variations and weights of mouths and smiles are those of a grid with the best recall and precision on tracks of
eight people by regressions that have not seen them (`benchmarks/measures.py`). Those of blinks were fitted to the same
people's openings of the eyes with noise added. Those of nods, shakes, winks and speech were set by hand.

An event is where rest has less than half of the posterior. Its probability is that of a visit to the state away from
rest meanwhile, 1 - p(rows, no visit) / p(rows). Below `threshold` it is no event.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations, pairwise
from typing import Any, Final, NamedTuple

import numpy as np

from facetrack_cli.core.face_points import EYE_DISTANCE, HANDS, IRISES
from facetrack_cli.core.numbers import spans
from facetrack_cli.core.types import BOX, Array, Mask, Whole
from facetrack_cli.trajectory.head import GAP_S, NORMAL, gauss, head_pose, nanmedian, noise_of, rotation_of, with_eyes
from facetrack_cli.trajectory.trajectory import SEEN, Trajectory, aligned, joined

LENGTH, DEGREES = "eye distances", "degrees"
SIDES, EYES = ("left", "right"), ("eye_left", "eye_right")
BROWS = tuple((f"brow_left_{place}", f"brow_right_{place}") for place in ("middle", "inner", "outer"))
LIPS, INNER = ("lip_upper", "lip_lower"), ("inner_lip_upper", "inner_lip_lower")
CORNERS = ("mouth_left", "mouth_right")
LIDS = tuple(tuple(f"{eye}_{place}" for place in ("upper", "lower", "outer", "inner")) for eye in EYES)
ENDS = ("eye_left_outer", "eye_left_inner"), ("eye_right_inner", "eye_right_outer")  # of an eye, from the left
GAZE = (*IRISES, *ENDS[0], *ENDS[1])
STEP: Final = 1e-3  # pixels, of the differences
# the noise's shares of what a measure varies and of its spread, by which `benchmarks/measures.py` finds nine changes of
# ten within 90 % on eight people
VARIES, SHARE = 0.6, 0.15
UNIT: Final = 0.2  # how far off the unit may be, where the head has moved
NEAR_S: Final = 0.3
# a mouth that talks: its swings are so large and last at most so long, and within a second or so there are so many
SWING, SWING_S, AROUND_S, SWINGS, SWINGS_STD = 0.03, 0.5, 0.6, 1.6, 0.5
TURNED, NEARER = 40.0, 0.15  # degrees, and the logarithm of the size, from the clip's median: there the share is 1
MOST_STD: Final = 0.15  # of a length or a ratio: where a clip's median spread is larger, it is not measured
BRIDGE_S, REACH_S = 0.4, 0.07
HOLD, BORDER = 1.0, 0.3  # face sizes a second: below is a hold, give or take
OUTLINE: Final = 0.1  # face sizes
QUARTILE: Final = 0.3186  # of the absolute value of a standard normal number


class Face(NamedTuple):
    """Where each part is in T frames, as x + iy (T,), and how large the box, as w + ih; `share` and `lean` (T,) are the
    length and the direction, e^(i angle), of the head's own horizontal in the image.
    """

    at: Mapping[str, Any]
    share: Array
    lean: Any

    @property
    def across(self) -> Any:
        """(T,) from the left eye to the right one as they are apart from the front, as x + iy."""
        box = EYE_DISTANCE * self.at[BOX].real * self.lean if BOX in self.at else np.nan
        if not self.at.keys() >= {*EYES}:
            return box
        apart = (self.at["eye_right"] - self.at["eye_left"]) / self.share
        return np.where(np.isfinite(apart), apart, box)  # an eye may be hidden

    @property
    def gaze(self) -> Any:
        """(T,) the irises in the frames of their eyes, whose corners are at -1/2 and 1/2; mean of both, as x + iy."""
        each = [(self.at[i] - self.at[a]) / (self.at[b] - self.at[a]) for i, (a, b) in zip(IRISES, ENDS, strict=True)]
        return sum(each) / 2 - 0.5

    def apart(self, point: str, other: str) -> Array:
        return np.asarray(np.abs(self.at[point] - self.at[other]))

    def height(self, above: Sequence[str], below: Sequence[str]) -> Array:
        """(T,) how far the middle of some points is above that of others, in distances between the eyes."""
        middles = [sum(self.at[name] for name in names) / len(names) for names in (below, above)]
        return np.asarray(((middles[0] - middles[1]) / (1j * self.across)).real)

    def opening(self, eyes: Sequence[int]) -> Array:
        """(T,) the distance of lids over the width of an eye, mean of some eyes."""
        each = [self.apart(*LIDS[k][:2]) / self.apart(*LIDS[k][2:]) for k in eyes]
        return np.asarray(sum(each) * self.share / len(each))


class Measure(NamedTuple):
    """What is measured, and of which parts; `of` is None of an angle of the head's pose, or of other measures."""

    name: str
    unit: str
    needs: tuple[str, ...] = ()
    of: Callable[[Face], Array] | None = None


MEASURES: Final = (
    Measure("mouth_opening", LENGTH, LIPS, lambda f: f.apart(*LIPS) / abs(f.across)),
    Measure("lips_apart", LENGTH, INNER, lambda f: f.apart(*INNER) / abs(f.across)),
    Measure("lips_pressed", LENGTH, LIPS + INNER, lambda f: (f.apart(*INNER) - f.apart(*LIPS)) / abs(f.across)),
    Measure("lips_rounded", "ratio", LIPS + CORNERS, lambda f: f.apart(*LIPS) / f.apart(*CORNERS) * f.share),
    Measure("mouth_width", LENGTH, CORNERS, lambda f: f.apart(*CORNERS) / abs(f.across) / f.share),
    Measure("smile", LENGTH, CORNERS + LIPS, partial(Face.height, above=CORNERS, below=LIPS)),
    *(Measure(f"smile_{side}", LENGTH, (corner, *LIPS), partial(Face.height, above=(corner,), below=LIPS))
      for side, corner in zip(SIDES, CORNERS, strict=True)),
    Measure("jaw_sideways", LENGTH, ("chin", "nose"), lambda f: ((f.at["chin"] - f.at["nose"]) / f.across).real),
    *(Measure(f"brow_{name}", LENGTH, parts + EYES, partial(Face.height, above=parts, below=EYES))
      for name, parts in zip(("raise", "inner", "outer"), BROWS, strict=True)),
    Measure("eye_opening", "eye widths", LIDS[0] + LIDS[1], partial(Face.opening, eyes=(0, 1))),
    *(Measure(f"eye_opening_{side}", "eye widths", LIDS[k], partial(Face.opening, eyes=(k,)))
      for k, side in enumerate(SIDES)),
    Measure("eyes_differ", "eye widths", LIDS[0] + LIDS[1], lambda f: f.opening((1,)) - f.opening((0,))),
    Measure("gaze_x", "eye widths", GAZE, lambda f: f.gaze.real),
    Measure("gaze_y", "eye widths", GAZE, lambda f: -f.gaze.imag),
    *(Measure(name, DEGREES) for name in ("roll", "yaw", "pitch")),
    Measure("thrust", "share"),
    Measure("talking", "probability"),
)  # fmt: skip
"""All measures, in the order of columns, which docs/measures.md describes; left and right are as seen in the image."""
HAND_MEASURES: Final = (
    Measure("speed", "face sizes a second"),
    *(Measure(name, "probability") for name in ("held", "touches_hand", "touches_face")),
)
USED: Final = {BOX, *(name for one in MEASURES for name in one.needs)}


class Measured(NamedTuple):
    """One measure of one target in T frames; nan where a point that it needs is lost or absent.

    `std` is the spread of a value, `doubt` what of it is not an offset that the whole clip shares.
    """

    name: str
    unit: str
    frame: Whole
    time_s: Array
    value: Array
    std: Array
    doubt: Array

    def between(self, begin: int, end: int) -> "Measured":
        """The rows from `begin` to before `end`."""
        return self._replace(**{name: getattr(self, name)[begin:end] for name in self._fields[2:]})

    @property
    def noise(self) -> Array:
        """(T,) the standard deviation without the offset that the clip shares, at most the spread."""
        values = self.value[np.isfinite(self.value)]
        if len(values) < 3:
            return self.std
        varies = VARIES * np.median(np.abs(values - np.median(values))) / NORMAL
        noise = np.sqrt(noise_of(values, 0.0) ** 2 + varies**2 + np.nan_to_num(self.doubt) ** 2)
        at_most = np.where(self.std > 0, self.std, np.inf)
        return np.asarray(np.where(np.isfinite(self.value), np.fmin(noise, at_most), np.nan))


@np.errstate(all="ignore")
def measures_of(parts: Sequence[Trajectory]) -> dict[str, Measured]:
    """The measures of one target by name, in the order of MEASURES: those whose points are among its parts."""
    parts = [part.squared for part in parts]
    pose, parts = head_pose(parts), [part for part in with_eyes(parts) if part.part in USED]
    if len(parts) < 2:
        return {}
    names, time_s = [part.part for part in parts], joined(parts).times
    sized = [replace(p, x=p.w, y=p.h, std_x=p.std_w, std_y=p.std_h) if p.part == BOX else p for p in parts]
    frame, columns = aligned(sized, "status", "x", "y", "angle", "std_x", "std_y", "cov_xy")
    seen = np.isin(columns.pop("status"), SEEN)
    x, y, angle, *spreads = (np.where(seen, column, np.nan).T for column in columns.values())
    spread = dict(zip(names, np.stack(spreads, axis=1), strict=True))  # (3, T) each
    values = {name: np.full((2, len(frame)), np.nan) for name in ("pitch", "yaw", "roll")}  # values and spreads
    if pose is not None:
        std = np.sqrt(np.diagonal(pose.of_points, axis1=1, axis2=2))
        for i, one in enumerate(values.values()):
            one[:, np.searchsorted(frame, pose.frame)] = pose.angles[:, i], std[:, i]
    for name in {*EYES, BOX} & {*names}:  # where eyes are hidden they are not the unit; not all say that of a box
        spread[name] = np.nan_to_num(spread[name])
    if BOX in names:
        values["roll"][0] = np.where(np.isfinite(values["roll"][0]), values["roll"][0], angle[names.index(BOX)])
    turned = rotation_of(np.radians(np.nan_to_num([values[name][0] for name in ("pitch", "yaw", "roll")])).T)
    axis = turned[:, 0, 0] + 1j * turned[:, 1, 0]
    face = Face(dict(zip(names, x + 1j * y, strict=True)), np.maximum(abs(axis), 0.5), axis / abs(axis))
    away = [(values["yaw"][0] / TURNED, 0.0)]
    if BOX in names:
        size = np.sqrt(np.prod([one[names.index(BOX)] for one in (x, y)], axis=0))
        of_size = np.hypot(*(spread[BOX][i] / one[names.index(BOX)] for i, one in enumerate((x, y)))) / 2
        values["thrust"] = np.stack([size / nanmedian(size) - 1, size / nanmedian(size) * of_size])
        away.append((np.log(size) / NEARER, 1.0))
    moved = np.zeros(len(frame))
    for a, b in stretches(time_s):
        moved[a:b] = np.minimum(sum(_moved(one[a:b], time_s[a:b], by) for one, by in away), 1)
    measures = {}
    for name, unit, needs, of in MEASURES:
        needs += () if unit != LENGTH else EYES if face.at.keys() >= {*EYES} else (BOX,)
        if of is not None and face.at.keys() >= {*needs}:
            both = np.stack([of(face), _spread(of, face, {part: spread[part] for part in needs})])
            values[name] = np.where(np.abs(both) < 1e6, both, np.nan)  # the face may have no size
        if name in values and (of or np.isfinite(values[name]).any()):
            value, std = values[name]
            if unit == DEGREES or not nanmedian(std) > MOST_STD:
                # what of a spread is no offset: a share, and all of it, with that of the unit, where the head has moved
                doubt = np.hypot(SHARE * std, moved * np.hypot(std, UNIT * value))
                measures[name] = Measured(name, unit, frame, time_s, value, std, doubt)
    if (mouth := measures.get("lips_apart", measures.get("mouth_opening"))) is not None:
        blank = np.full(len(frame), np.nan)
        measures["talking"] = Measured("talking", "probability", frame, time_s, _talking(mouth), blank, blank)
    return measures


def _talking(mouth: Measured) -> Array:
    """(T,) the probability that a mouth talks, by the number of its quick swings around each frame."""
    rows = settled(mouth)
    swings, talks = np.zeros(len(rows)), np.full(len(mouth.value), np.nan)
    if len(rows) > 2:
        value, time_s, doubt = mouth.value[rows], mouth.time_s[rows], np.nan_to_num(mouth.doubt[rows])
        for a, b in pairwise(_turning_points(value, max(SWING, 4 * noise_of(value, 0.0)))):
            clear = abs(value[b] - value[a]) > 2 * doubt[(a + b) // 2]
            swings[(a + b) // 2] += clear and time_s[b] - time_s[a] <= SWING_S
        sigma = AROUND_S / max(float(np.median(np.diff(time_s))), AROUND_S / 500)
        talks[rows] = above(gauss(swings, sigma) * sigma * np.sqrt(2 * np.pi) - SWINGS, SWINGS_STD)
    return talks


def _turning_points(signal: Array, least: float) -> list[int]:
    """Where a signal turns by at least `least`: highs and lows in turn, smaller wiggles passed over."""
    turns: list[int] = []
    low = high = 0
    up: bool | None = None
    for i, value in enumerate(signal.tolist()):
        high, low = i if value > signal[high] else high, i if value < signal[low] else low
        if up is not False and signal[high] - value >= least:
            turns.append(high)
            up, low, high = False, i, i
        elif up is not True and value - signal[low] >= least:
            turns.append(low)
            up, low, high = True, i, i
    return turns if up is None else [*turns, high if up else low]  # the last swing ends where it got farthest


def _moved(pose: Array, time_s: Array, by: float) -> Array:
    """(T,) how far a pose is from its median and, times `by`, moves within a second before and after, squared."""
    off = np.nan_to_num(pose - nanmedian(pose))
    step = np.nan_to_num(nanmedian(np.diff(time_s)), nan=1.0)  # times may not be known
    around = round(1 / max(float(step), 0.002))
    near = np.lib.stride_tricks.sliding_window_view(np.pad(off, around, mode="edge"), 2 * around + 1)
    return np.asarray(off**2 + (by * (near.max(axis=1) - near.min(axis=1)) / 2) ** 2)


def stretches(time_s: Array) -> list[tuple[int, int]]:
    """[begin, end) of rows without a pause between them, as in each shot of a film."""
    return spans(np.ones(len(time_s), np.bool_), np.diff(time_s) > GAP_S)


def settled(measure: Measured) -> Whole:
    """The rows that have a value, and are not within `NEAR_S` of one that has none, where points come and go."""
    finite = np.isfinite(measure.value + measure.time_s)
    rows, gone = np.flatnonzero(finite), np.flatnonzero(~finite)
    after = np.searchsorted(gone, rows)
    sides = [np.append(gone, -1)[after - 1], np.append(gone, -1)[after]]  # -1: there is none
    near = [(side >= 0) & (np.abs(measure.time_s[rows] - measure.time_s[side]) <= NEAR_S) for side in sides]
    return np.asarray(rows[~(near[0] | near[1])])


def above(value: Array, spread: Array | float) -> Array:
    """The probability that what was measured as a value, with this spread, is above 0."""
    return np.asarray(np.vectorize(math.erfc, otypes=[float])(-value / spread / math.sqrt(2)) / 2)


def _spread(of: Callable[[Face], Array], face: Face, spread: Mapping[str, Array]) -> Array:
    """(T,) the standard deviation of a measure, from std_x, std_y and cov_xy of each part that it needs."""
    variance = np.zeros(len(face.lean))
    for name, (std_x, std_y, cov_xy) in spread.items():
        moved = [of(face._replace(at={**face.at, name: face.at[name] + STEP * step})) for step in (1, -1, 1j, -1j)]
        along_x, along_y = (moved[0] - moved[1]) / (2 * STEP), (moved[2] - moved[3]) / (2 * STEP)
        variance += (along_x * std_x) ** 2 + (along_y * std_y) ** 2 + 2 * along_x * along_y * np.nan_to_num(cov_xy)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


@np.errstate(all="ignore")
def hand_measures(table: Trajectory) -> dict[str, dict[str, Measured]]:
    """The measures of each hand of a trajectory by name; none without a head that has a box."""
    boxes = {part.target: part for part in table.parts if part.part == BOX}
    hands, heads = [name for name in HANDS if name in boxes], [name for name in boxes if name not in HANDS]
    if not hands or len(heads) != 1:
        return {}
    parts = [boxes[name] for name in (*hands, *heads)]
    frame, columns = aligned(parts, "status", "x", "y", "w", "h", "std_x", "std_y")
    seen = np.isin(columns["status"], SEEN)
    x, y, w, h, *spreads = (np.where(seen, columns[key], np.nan) for key in ("x", "y", "w", "h", "std_x", "std_y"))
    size = float(nanmedian(np.sqrt(w[:, -1] * h[:, -1])))
    time_s = joined(parts).times
    if not size > 0 or len(frame) < 2 or not np.isfinite(time_s).all():
        return {}
    at = np.stack([_bridged(axis / size, time_s) for axis in (x, y)], axis=-1)  # (T, K, 2)
    half = np.stack([_bridged(side / size / 2, time_s) for side in (w, h)], axis=-1)
    var = np.nan_to_num(spreads[0] ** 2 + spreads[1] ** 2) / 2 / size**2
    measures: dict[str, dict[str, Measured]] = {}
    for k, name in enumerate(hands):
        speed, noise = _speed(at[:, k], seen[:, k], time_s)
        values = {"speed": speed, "held": above(HOLD - speed, math.hypot(noise, BORDER))}
        for j in range(len(parts)):
            if j != k:
                off = at[:, j] - at[:, k]
                apart = np.hypot(*off.T)
                way = off / np.maximum(apart, 1e-9)[:, None]
                reach = sum(1 / np.maximum(np.hypot(*(way / half[:, i]).T), 1e-9) for i in (j, k))
                spread = np.sqrt(var[:, j] + var[:, k] + OUTLINE**2)
                values["touches_face" if j == len(hands) else "touches_hand"] = above(reach - apart, spread)
        std = {"speed": np.where(np.isfinite(speed), noise, np.nan)}
        measures[name] = {
            key: Measured(key, unit, frame, time_s, values[key], *[std.get(key, speed * np.nan)] * 2)
            for key, unit, *_ in HAND_MEASURES
            if key in values
        }
    return measures


def _bridged(values: Array, time_s: Array) -> Array:
    """(T, K): where a column is nan for `BRIDGE_S` at most, the straight line between."""
    values = values.copy()
    for column in values.T:
        for a, b in spans(np.isnan(column)):
            if a and b < len(column) and time_s[b] - time_s[a - 1] <= BRIDGE_S:
                column[a:b] = np.interp(time_s[a:b], time_s[[a - 1, b]], column[[a - 1, b]])
    return values


def _speed(at: Array, seen: Mask, time_s: Array) -> tuple[Array, float]:
    """(T,) the speed of places (T, 2), nan where they are, and its spread."""
    step = max(float(np.median(np.diff(time_s))), 1e-6)
    k = max(round(REACH_S / step), 1)
    weights = np.arange(-k, k + 1) / np.sum(np.arange(-k, k + 1) ** 2)
    there = np.flatnonzero(seen[:-2] & seen[1:-1] & seen[2:])
    turns = np.abs(np.diff(at, n=2, axis=0)[there]).ravel()
    noise = float(np.quantile(turns, 0.25)) / QUARTILE / np.sqrt(6) if turns.size else np.nan
    spread = max(noise * float(np.hypot.reduce(weights)), 1e-3) / step
    speed = np.full(len(at), np.nan)
    for a, b in spans(np.isfinite(at.sum(axis=1)), np.diff(time_s) > 1.5 * step):
        if b - a > k:
            padded = np.pad(at[a:b], ((k, k), (0, 0)), mode="reflect", reflect_type="odd")
            way = np.stack([np.convolve(column, weights[::-1], mode="valid") for column in padded.T]) / step
            speed[a:b] = np.sqrt(np.maximum(np.sum(way**2, axis=0) - 2 * spread**2, 0.0))
    return speed, spread


PRIOR, ROUNDS = 100.0, 8
HALFWAY_S, LEAST_STEP, LEAST = 0.1, 0.75, 1e-9
QUIET: Final = 0.1  # quantile of the rows without much doubt that rest begins as, where it is no running median


class Kind(NamedTuple):
    """A kind of event: the measure that tells it, and what people do.

    `value` is its name. The first of `measures` that is there tells it: by its increase (`sign` 1), its decrease (-1)
    or both in turn (0). `step` is how far from rest people go; 0: the measure is a probability. `std` are standard
    deviations at rest and away, `lasts` mean seconds of both. `weight` is the factor of a frame's log likelihood,
    `threshold` the least probability of an event. Rest is the median over `reach_s` before and after, or one level
    where that is 0. `relative`: the measure is divided by it. An event takes `least_s` at least; after `longest_s` it
    has the name `longer`, or is none. `other` is the name of what has a probability below one half. `needs` is a
    measure without which the kind is not told.
    """

    value: str
    measures: tuple[str, ...]
    sign: int = 1
    step: float = 0.0
    std: tuple[float, float] = (0.0, 0.0)
    lasts: tuple[float, float] = (0.3, 0.3)
    weight: float = 0.3
    threshold: float = 0.5
    reach_s: float = 0.0
    relative: bool = False
    least_s: float = 0.0
    longest_s: float = math.inf
    longer: str = ""
    other: str = ""
    needs: str = ""


KINDS: Final = {
    "mouth": Kind("open", ("mouth_opening",), 1, 0.09, (0.02, 0.05), (0.5, 0.2), 0.5, 0.7),
    "smile": Kind("smile", ("mouth_width",), 1, 0.14, (0.03, 0.05), (3.0, 1.5), 0.15, 0.7, least_s=0.3),
    "blinks": Kind("blink", ("eye_opening",), -1, 0.5, (0.1, 0.1), (3.0, 0.15), 1.0, reach_s=1.0, relative=True,
                   longest_s=0.6, longer="shut"),
    "dips": Kind("nod", ("pitch",), 1, 12.0, (3.0, 4.0), (3.0, 0.3), reach_s=1.0, longest_s=1.0, needs="eye_opening"),
    "shakes": Kind("shake", ("yaw",), 0, 12.0, (3.0, 4.0), (3.0, 0.3), reach_s=1.0, longest_s=2.0),
    "wink_left": Kind("wink", ("eyes_differ",), 1, 0.2, (0.04, 0.08), (3.0, 0.3), reach_s=1.0),
    "wink_right": Kind("wink", ("eyes_differ",), -1, 0.2, (0.04, 0.08), (3.0, 0.3), reach_s=1.0),
    "speech": Kind("talks", ("talking",), lasts=(2.0, 2.0), least_s=0.5),
    "phases": Kind("hold", ("held",), least_s=0.1, other="movement"),
    "hand_contact": Kind("hand", ("touches_hand",), least_s=0.1),
    "face_contact": Kind("face", ("touches_face",), least_s=0.1),
}  # fmt: skip
"""All kinds by the names of their tiers."""


class FaceEvent(NamedTuple):
    """What a face or hand does, from `begin_s` to `end_s`, when the frame after it begins; most of all at `peak_s`."""

    begin_s: float
    target: str
    tier: str
    value: str
    peak_s: float
    end_s: float
    first_frame: int
    last_frame: int
    probability: float


def events_of(target: str, measures: Mapping[str, Measured]) -> dict[str, list[FaceEvent]]:
    """The events of one target by the kinds that its measures tell, each in the order of time."""
    events = {}
    for tier, kind in KINDS.items():
        best = next((measures[name] for name in kind.measures if name in measures), None)
        if best is not None and (not kind.needs or kind.needs in measures):
            shots = [best.between(*ends) for ends in stretches(best.time_s)] if kind.step else [best]
            events[tier] = sorted(event for shot in shots for event in _events(target, tier, kind, shot))
    return events


def _events(target: str, tier: str, kind: Kind, measure: Measured) -> Iterator[FaceEvent]:
    rows = settled(measure) if kind.step else np.flatnonzero(np.isfinite(measure.value + measure.time_s))
    if len(rows) < 2:
        return
    time_s, frame = measure.time_s[rows], measure.frame[rows]
    pause, usual = np.diff(time_s) > GAP_S, float(np.median(np.diff(time_s)))
    until = np.append(np.where(pause, time_s[:-1] + usual, time_s[1:]), time_s[-1] + usual)
    z, log_p = _log_likelihoods(kind, measure, rows)
    rest_s, away_s = kind.lasts
    lasts = (rest_s, *([HALFWAY_S if kind.sign else away_s] if kind.step else []), away_s)
    passes = [(kind.value, log_p, z)] + ([(kind.other, log_p[:, ::-1], -z)] if kind.other else [])
    for value, states, height in passes:
        chain = Chain.of(kind.weight * states, time_s, lasts)
        for a, b in spans(chain.posterior[:, 0] < 0.5, pause):
            chance = chain.visits(a, b, (1, 2) if kind.step and not kind.sign else (states.shape[1] - 1,))
            lasts_s = until[b - 1] - time_s[a]
            name = value if lasts_s <= kind.longest_s else kind.longer
            if chance >= kind.threshold and name and lasts_s >= kind.least_s:
                peak = a + int(np.argmax(height[a:b]))
                times = float(time_s[peak]), float(until[b - 1])
                yield FaceEvent(float(time_s[a]), target, tier, name, *times, int(frame[a]), int(frame[b - 1]), chance)


def _log_likelihoods(kind: Kind, measure: Measured, rows: Whole) -> tuple[Array, Array]:
    """(T,) how far a measure is away from rest in these rows, and (T, S) log likelihoods of the states."""
    value, time_s = measure.value[rows], measure.time_s[rows]
    if not kind.step:
        return value, np.log(np.clip(np.stack([1 - value, value], axis=1), LEAST, 1))
    std, doubt = (np.nan_to_num(spread[rows]) for spread in (measure.std, measure.doubt))
    if kind.reach_s:
        reach = round(kind.reach_s / max(float(np.median(np.diff(time_s))), kind.reach_s / 500))
        padded = np.pad(value, reach, mode="symmetric")
        rest = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1), axis=1)
    else:
        sure = doubt <= 2 * np.median(doubt)
        rest = np.full(len(value), np.quantile(kind.sign * value[sure], QUIET) * kind.sign)
    unit = np.maximum(np.abs(rest), LEAST) if kind.relative else 1.0
    z, std, doubt = (kind.sign or 1) * (value - rest) / unit, std / unit, doubt / unit
    noise = np.sqrt(doubt**2 + np.maximum(std**2 - kind.step**2, 0.0))
    z = np.sign(z) * np.maximum(np.abs(z) - noise, 0.0)
    levels = (0.0, 0.5, 1.0) if kind.sign else (0.0, -1.0, 1.0)  # of the states, in steps
    level, step, quiet = 0.0, kind.step, kind.std[0]
    for rounds_left in range(ROUNDS, -1, -1):
        off = np.clip(z - level, min(levels) * step, step)[:, None] - np.multiply(levels, step)
        variance = np.square((quiet, step / 4 if kind.sign else kind.std[1], kind.std[1])) + noise[:, None] ** 2
        log_p = -0.5 * (off**2 / variance + np.log(variance))
        if not rounds_left:
            break
        is_in = np.exp(log_p - np.logaddexp.reduce(log_p, axis=1, keepdims=True)) * kind.weight
        at_rest, away = is_in[:, 0], is_in[:, 1:].sum(axis=1) if not kind.sign else is_in[:, 2]
        # a few rows that are far off, as beside a hand before the mouth, say nothing of how it rests
        level = float(at_rest @ np.clip(z, -step, step) / (at_rest.sum() + PRIOR))
        excess = np.maximum(np.minimum(np.abs(z - level), step / 2) ** 2 - noise**2, 0.0)
        quiet = math.sqrt((at_rest @ excess + PRIOR * kind.std[0] ** 2) / (at_rest.sum() + PRIOR))
        height = np.abs(z - level) if not kind.sign else z - level
        step = max(float((away @ height + PRIOR * kind.step) / (away.sum() + PRIOR)), LEAST_STEP * kind.step)
    return (z if kind.sign else np.abs(z)), log_p


class Chain(NamedTuple):
    """A hidden Markov model of T rows in S states, all in logarithms; the first state is rest.

    `log_p` (T, S) are likelihoods, `share` (S,) how much of all time each has, `move` (T - 1, S, S) probabilities of
    steps from row to row; `forward` (T, S) of a state and all rows up to its own, `backward` (T, S) of all later rows
    given a state.
    """

    log_p: Array
    share: Array
    move: Array
    forward: Array
    backward: Array

    @classmethod
    def of(cls, log_p: Array, time_s: Array, lasts: Sequence[float]) -> "Chain":
        """States that last so many seconds on average; where one ends each is as likely, by steps of the usual time."""
        usual = float(np.median(np.diff(time_s)))
        stay = np.exp(-usual / np.asarray(lasts))[:, None]
        once = stay * np.eye(len(lasts)) + (1 - stay) / len(lasts)
        # a pause is as many steps
        count, steps = np.unique(np.maximum(np.rint(np.diff(time_s) / usual), 1), return_inverse=True)
        move = np.log([np.linalg.matrix_power(once, int(n)) for n in count])[steps]
        share = np.log((1 / (1 - stay[:, 0])) / np.sum(1 / (1 - stay)))
        forward, backward = np.empty_like(log_p), np.zeros_like(log_p)
        forward[0] = share + log_p[0]
        for t, step in enumerate(move):
            forward[t + 1] = np.logaddexp.reduce(forward[t][:, None] + step, axis=0) + log_p[t + 1]
        for t in range(len(move) - 1, -1, -1):
            backward[t] = np.logaddexp.reduce(move[t] + log_p[t + 1] + backward[t + 1], axis=1)
        return cls(log_p, share, move, forward, backward)

    @property
    def posterior(self) -> Array:
        """(T, S) the probability of each state given all rows."""
        return np.asarray(np.exp(self.forward + self.backward - np.logaddexp.reduce(self.forward[-1])))

    def visits(self, first: int, stop: int, states: Sequence[int]) -> float:
        """The probability, given all rows, that each of `states` is visited in rows `first` to before `stop`."""
        chance, whole = 0.0, np.logaddexp.reduce(self.forward[-1])
        for none in (list(chosen) for n in range(len(states) + 1) for chosen in combinations(states, n)):
            at = self.forward[max(first - 1, 0)]
            for t in range(first, stop):
                at = np.logaddexp.reduce(at[:, None] + self.move[t - 1], axis=0) if t else self.share
                at = at + self.log_p[t]
                at[none] = -np.inf
            chance += (-1) ** len(none) * math.exp(np.logaddexp.reduce(at + self.backward[stop - 1]) - whole)
        return min(max(chance, 0.0), 1.0)
