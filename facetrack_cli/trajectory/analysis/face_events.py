"""Events in what a face does, with times and probabilities: a mouth opens and closes, eyes blink, a head nods.
And intervals in which a hand is held still, moves, or touches the other one or the face (hands.py).

A measure has two levels, at rest and away from it, if the clip shows both. They are the means below and above the cut
at which two normal distributions describe its values best (Kittler & Illingworth, "Minimum error thresholding", Pattern
Recognition 1986); the threshold is midway. They count only if they are `APART` times the measure's spread apart, and if
the likelihood gains on a single level, whose width is that of the values, or the spread where that is less: by the
share `GAIN` more than it costs to say which frames are at which level. So noise that the spread explains is no event.

The state changes where a measure passes the threshold by twice its noise from frame to frame. The probability of a
state is that of the measure being on this side, by its spread, in the clearest frame; that of an event is the product
over the states before and after it, and of `blink` and `nod`, which are short, in it. A state that the clip or a pause
of `GAP_S` cuts off makes none. Rest, of what is short, is the median over `REST_S` before and after.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from facetrack_cli.core.numbers import spans
from facetrack_cli.core.types import Array
from facetrack_cli.trajectory.analysis.measures import Measured

GAIN, APART, GAP_S, REST_S, MIN_FRAMES = 0.5, 3.0, 0.25, 1.0, 3  # the last are frames at either level
# the events of a kind; the measure that tells it, or the one in its place; the sign of its change; its longest, in s
KINDS: Final = {
    "mouth": (("mouth_opens", "mouth_closes"), "lips_apart", "mouth_opening", 1, math.inf),
    "blinks": (("blink",), "eye_opening", "", -1, 0.5),
    "dips": (("nod",), "pitch", "", 1, 1.0),
}


# what hands do, by the measure that is its probability: what it is above one half, and below
INTERVALS: Final = {"phases": ("held", ("hold", "movement")), "hand_contact": ("touches_hand", ("hand",)),
                    "face_contact": ("touches_face", ("face",))}  # fmt: skip
BRIEF_S: Final = 0.1  # an interval of a hand that is shorter than this is part of those around it


class FaceEvent(NamedTuple):
    """What a face or hand does in `frame`, at `time_s`: the mouth is open, a hand is held, from `first` to `last`."""

    time_s: float
    target: str
    name: str
    frame: int
    first: int
    last: int
    probability: float


def events_of(target: str, measures: Mapping[str, Measured]) -> dict[str, list[FaceEvent]]:
    """The events of one target by those of KINDS that its measures tell. A nod needs eyes: a mouth moves lips alike."""
    found: dict[str, list[FaceEvent]] = {}
    for kind, (names, best, other, sign, longest) in KINDS.items():
        one = measures.get(best, measures.get(other))
        if one is not None and (kind != "dips" or "eye_opening" in measures):
            found[kind] = []
            for first, last, back, before, within, after in _away(one, sign, longest):
                begins = before * within * (after if len(names) == 1 else 1.0)
                for name, row, chance in zip(names, (first, back), (begins, within * after), strict=False):
                    if math.isfinite(chance):
                        at, begun, until = one.frame[[row, first, last]].tolist()
                        found[kind].append(FaceEvent(float(one.time_s[row]), target, name, at, begun, until, chance))
    for kind, (measure, names) in INTERVALS.items():
        if measure in measures:
            found[kind] = sorted(_intervals(target, measures[measure], names))
    return found


def _intervals(target: str, one: Measured, names: Sequence[str]) -> Iterator[FaceEvent]:
    """Where a probability is above one half, and below if that has a name, with its mean there."""
    rows = np.flatnonzero(np.isfinite(one.value + one.time_s))
    if not len(rows):
        return
    p, time_s, frame = one.value[rows], one.time_s[rows], one.frame[rows]
    pause = np.diff(time_s) > GAP_S
    for begin, stop in spans(np.ones(len(rows), np.bool_), pause):
        state = p[begin:stop] > 0.5
        step = (time_s[stop - 1] - time_s[begin]) / max(stop - begin - 1, 1)
        both = [spans(state), spans(~state)]
        for a, b in sorted(both[0] + both[1], key=lambda span: span[1] - span[0]):
            if (b - a) * step < BRIEF_S and (a > 0 or b < len(state)):
                state[a:b] = state[a - 1] if a else state[b]
        for name, those, chance in zip(names, (state, ~state), (p, 1 - p), strict=False):
            for a, b in spans(those):
                first, last = begin + a, begin + b - 1
                yield FaceEvent(float(time_s[first]), target, name, int(frame[first]), int(frame[first]),
                                int(frame[last]), float(chance[first : last + 1].mean()))  # fmt: skip


def _away(one: Measured, sign: int, longest: float) -> Iterator[tuple[int, int, int, float, float, float]]:
    """First and last row away from rest, the next one; probabilities before, in, after, nan where nothing is known."""
    rows = np.flatnonzero(np.isfinite(one.value + one.time_s))
    if len(rows) < 2 * MIN_FRAMES:
        return
    value, time_s, short = sign * one.value[rows], one.time_s[rows], math.isfinite(longest)
    if short:
        reach = round(REST_S / max(float(np.median(np.diff(time_s))), REST_S / 500))
        around = np.lib.stride_tricks.sliding_window_view(np.pad(value, reach, mode="symmetric"), 2 * reach + 1)
        value = value - np.median(around, axis=1)
    noise = max(float(np.median(np.abs(np.diff(value, n=2)))) / 0.6745 / math.sqrt(6), 1e-9)
    spread = np.fmax(one.std[rows], noise)
    beyond = value - _threshold(value, noise, float(np.median(spread)))
    clear = np.abs(beyond) > 2 * noise
    away = beyond[np.maximum.accumulate(np.where(clear, np.arange(len(rows)), 0))] > 0
    pause = np.diff(time_s) > GAP_S
    states = sorted(spans(away, pause) + spans(~away, pause))
    sure = (float(np.max((beyond if away[a] else -beyond)[a:b] / spread[a:b])) for a, b in states)
    chance = [math.erfc(-z / math.sqrt(2)) / 2 for z in sure]
    for k, (a, b) in enumerate(states):
        if away[a] and not (short and time_s[min(b, len(rows) - 1)] - time_s[a] > longest):
            before = chance[k - 1] if a and not pause[a - 1] else math.nan
            after = chance[k + 1] if b < len(rows) and not pause[b - 1] else math.nan
            yield int(rows[a]), int(rows[b - 1]), int(rows[min(b, len(rows) - 1)]), before, chance[k], after


def _threshold(value: Array, noise: float, spread: float) -> float:
    """Midway between the two levels of a measure; nan if it has only one."""
    x, n = np.sort(value - value.mean()), len(value)
    k = np.arange(MIN_FRAMES, n - MIN_FRAMES + 1)  # values below the cut
    share, sums, squares = k / n, np.cumsum(x)[k - 1], np.cumsum(x**2)[k - 1]
    low, high = sums / k, -sums / (n - k)
    variances = squares / k - low**2, (np.sum(x**2) - squares) / (n - k) - high**2, x.var()
    below, above, whole = (np.maximum(variance, noise**2) for variance in variances)
    one, cost = np.minimum(whole, spread**2), -share * np.log(share) - (1 - share) * np.log(1 - share)
    gain = (np.log(one) + whole / one - 1 - share * np.log(below) - (1 - share) * np.log(above)) / 2 - cost
    best = int(np.argmax(gain))
    told_apart = gain[best] > GAIN * cost[best] and high[best] - low[best] > APART * spread
    return float(value.mean() + (low[best] + high[best]) / 2) if told_apart else math.nan
