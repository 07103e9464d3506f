"""Events in what a face or a hand does, with times and probabilities: a mouth is open, eyes blink, a head nods.

Each kind is a hidden Markov model of one measure. Its states are rest, halfway and away from rest. A kind that goes
both ways has rest and either side; a measure that is itself a probability has no and yes. A state lasts an exponential
time, and each state may follow, so a pause between rows makes the state after it less sure.

The likelihood of a row is normal about the level of its state. Its variance is that of people at rest or away (`std`)
and that of the noise: the row's doubt (measures.py), and what its spread has beyond the step that people make. Before,
the value is moved towards rest by that noise: errors last, so that many frames say no more of them than one. Values
beyond the outer levels count as on them. Rows beside lost ones do not count.

The level at rest, its variation and the step from it are learned from the clip by expectation maximization. What people
do (`KINDS`) is their prior, with the weight of `PRIOR` frames. Each shot of a film has its own. Frames are not
independent: the log likelihood of each has the factor `weight`.

Steps, variations and weights of mouths and smiles are those of a grid with the best recall and precision on tracks of
eight people by regressions that have not seen them (`benchmarks/measures.py`). Those of blinks were fitted to the same
people's openings of the eyes with noise added. Those of nods, shakes, winks and speech were set by hand.

An event is where rest has less than half of the posterior. Its probability is that of a visit to the state away from
rest meanwhile, 1 - p(rows, no visit) / p(rows). Below `threshold` it is no event."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from typing import Final, NamedTuple

import numpy as np

from facetrack_cli.core.numbers import spans
from facetrack_cli.core.types import Array, Whole
from facetrack_cli.trajectory.head import GAP_S
from facetrack_cli.trajectory.measures import Measured, settled, stretches

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
