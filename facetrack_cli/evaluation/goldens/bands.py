"""Whether runs of a tracker still belong with those recorded before: statistics of a run, and their bands.

    statistics = choose(tables)
    verdict = judge(statistics, measure(tables, statistics), measure(new, statistics))

A single position says little: seeds differ, and rounding on another processor changes a run as another seed does. A
statistic averages over a span of frames of one part: mean x and y over about 25 frames; over a quarter of the clip mean
log std_x, std_y, ess and step length |x_t - x_{t-1}|, mean confidence, share of frames lost; and of a tracker that
gives them, mean log w, h and number of particles, mean angle and probability of the target's identity.

*The test* is a permutation test (`permutation_test.py`) of three families of statistics, each with a false alarm
probability of ALPHA at most, so together below 1 in 1000:

- *local*: the largest |z| over all statistics;
- *overall*: the largest |z| over their means for each quantity, of all parts and of each part, which sees a small
  change that is everywhere, as of a sigma;
- *joint*: the Mahalanobis distance of the means of all parts, which sees a combination that is new, as a wide spread
  with a high confidence where runs with a wide spread have a low one.

The band of a statistic is what this criterion amounts to for it, in its own unit.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np

from facetrack_cli.core.types import Array, Whole
from facetrack_cli.evaluation.goldens.permutation_test import FAR, bend, joint, largest, picks_of, place, unbend
from facetrack_cli.trajectory.trajectory import Trajectory

Name: TypeAlias = Literal[
    "x", "y", "w", "h", "angle", "std_x", "std_y", "ess", "step", "particles", "confidence", "lost", "identity"
]  # fmt: skip

SEEN_SPREAD: Final = 0.22  # changes of mean logarithms that must be seen; see `runs_to_test`
SEEN_STEP: Final = 0.13
REPEATABLE: Final = 10  # bands of trackers without chance, in units of `least`


class Quantity(NamedTuple):
    """How a quantity is averaged and shown. `unit`: resolution of what is recorded; `least`: the least spread assumed.

    With an `offset` the mean is that of log(value + offset), and is shown as exp(mean) - offset.
    """

    frames: int
    unit: float
    least: float
    words: str
    suffix: str = ""
    offset: float | None = None

    def shown(self, value: float) -> float:
        return value if self.offset is None else math.exp(min(value, 50.0)) - self.offset


BLOCK, QUARTER = 25, 0
QUANTITIES: Final[dict[Name, Quantity]] = {
    "x": Quantity(BLOCK, 0.05, 0.1, "mean x", " px"),
    "y": Quantity(BLOCK, 0.05, 0.1, "mean y", " px"),
    "w": Quantity(BLOCK, 0.005, 0.01, "mean width", " px", 0.0),
    "h": Quantity(BLOCK, 0.005, 0.01, "mean height", " px", 0.0),
    "angle": Quantity(BLOCK, 0.05, 0.1, "mean angle", "°"),
    "std_x": Quantity(QUARTER, 0.01, 0.03, "mean std_x", " px", 0.05),
    "std_y": Quantity(QUARTER, 0.01, 0.03, "mean std_y", " px", 0.05),
    "ess": Quantity(QUARTER, 0.01, 0.03, "mean ess", "", 0.0),
    "step": Quantity(QUARTER, 0.01, 0.03, "mean step", " px", 0.05),
    "particles": Quantity(QUARTER, 0.005, 0.01, "mean number of particles", "", 0.0),
    "confidence": Quantity(QUARTER, 0.005, 0.02, "mean confidence"),
    "lost": Quantity(QUARTER, 0.005, 0.03, "share of frames lost"),
    "identity": Quantity(QUARTER, 0.005, 0.02, "mean probability of who it is"),
}


class Statistic(NamedTuple):
    """A quantity of one series (`target/part`) averaged over source frames first..last."""

    quantity: Name
    series: str
    first: int
    last: int


@dataclass(frozen=True)
class Deviation:
    """What left its band. `far`: how far, in units of the critical value, above 1.

    Local: `value`, `low`, `high` of the statistic, in the quantity's unit. Overall (`relative`): its change against the
    recorded, a ratio for quantities averaged as logarithms, else a difference; of all parts where its series is "".
    Joint: of `together`, the changes of the overall statistics that weigh most; no values.
    """

    statistic: Statistic
    far: float
    value: float = math.nan
    low: float = math.nan
    high: float = math.nan
    relative: bool = False
    together: tuple[Deviation, ...] = ()

    @property
    def family(self) -> str:
        return "joint" if self.together else "overall" if self.relative else "local"

    @property
    def change(self) -> str:
        """The statistic and its value, as `mean std_x +12 %`."""
        return f"{QUANTITIES[self.statistic.quantity].words} {self._number(self.value)}{self._suffix}"

    def __str__(self) -> str:
        if self.together:
            return f"{', '.join(one.change for one in self.together)} against the recorded, which do not go together"
        band = f"band {self._number(self.low)}..{self._number(self.high)}"
        return (
            f"{self.change} against the recorded, {band}{self._suffix}" if self.relative else f"{self.change}, {band}"
        )

    @property
    def _suffix(self) -> str:
        q = QUANTITIES[self.statistic.quantity]
        return " %" if self.relative and q.offset is not None else q.suffix

    def _number(self, value: float) -> str:
        """With the decimals that show a band of this width; a ratio as a change in percent."""
        if self._suffix == " %":
            return f"{100 * (value - 1):+.0f}"
        digits = min(max(1 - math.floor(math.log10(max(self.high - self.low, 1e-6))), 0), 4)
        return f"{value:{'+' if self.relative else ''}.{digits}f}"


@dataclass(frozen=True)
class Verdict:
    """Passed without `deviations`: local ones first, then overall, then joint, each the farthest first.

    `closest`: the farthest statistic in units of the critical value; `p`: the probability of a set of runs like this.
    """

    p: float
    closest: float
    deviations: tuple[Deviation, ...]

    @property
    def passed(self) -> bool:
        return not self.deviations


# --- who a target is -----------------------------------------------------------------------------------------------


def last_names(tables: Sequence[Trajectory]) -> dict[str, Counter[str]]:
    """For each target that is named in any run: how many runs end with which name."""
    found: dict[str, Counter[str]] = {}
    for table in tables:
        for target in table.targets:
            if named := [name for name in table.of_target(target)[0].identity.tolist() if name]:
                found.setdefault(target, Counter())[named[-1]] += 1
    return found


def names(tables: Sequence[Trajectory]) -> dict[str, str]:
    """The name of each target, the one with which most runs end; of as many, the first by the alphabet."""
    return {
        target: min(counts, key=lambda name: (-counts[name], name)) for target, counts in last_names(tables).items()
    }


# --- measuring -----------------------------------------------------------------------------------------------------


def choose(tables: Sequence[Trajectory]) -> tuple[Statistic, ...]:
    """The statistics that runs of this clip have: none that the tracker never gives, and nothing that is fixed."""
    found, named = [], names(tables)
    for name, q in QUANTITIES.items():
        for i, one in enumerate(tables[0].parts):
            values = np.stack([_values(name, table.parts[i], named) for table in tables])
            known = values[np.isfinite(values)]
            if known.size and not (name in _MAY_BE_FIXED and np.ptp(known) < 1e-9):
                found += [Statistic(name, one.name, *span) for span in _spans(one.frame[1:].tolist(), q)]
    return tuple(found)


def measure(
    tables: Sequence[Trajectory], statistics: Sequence[Statistic], named: Mapping[str, str] | None = None
) -> Array:
    """(S, F), in whole units of each quantity, nan where a run has no value in a span.

    `named`: the name whose probability is measured, by target; by default the one that most of these runs give. Every
    table must have the series, and the frames, that the statistics were chosen from.
    """
    rows, named = [], names(tables) if named is None else named
    for table in tables:
        by_name = {one.name: one for one in table.parts}
        pairs = dict.fromkeys((s.quantity, s.series) for s in statistics)
        known = {(name, series): _values(name, by_name[series], named) for name, series in pairs}
        row = []
        for s in statistics:
            frame = by_name[s.series].frame
            values = known[s.quantity, s.series][(frame >= s.first) & (frame <= s.last)]
            values = values[np.isfinite(values)]
            row.append(float(values.mean()) / QUANTITIES[s.quantity].unit if values.size else math.nan)
        rows.append(row)
    return np.round(np.array(rows, dtype=float))


def runs_to_test(statistics: Sequence[Statistic], recorded: Array) -> int:
    """How many runs to test: 4, or up to 12 where seeds differ so much that four could not see small changes.

    A change of the spread is judged by the part whose runs differ least. One where all runs are the same; 4 without any
    spread, and so without a sigma that could change.
    """
    if len(recorded) < 2 or alike(recorded):
        return 1
    noise = [_noise(statistics, recorded, ("std_x", "std_y"), s) for s in dict.fromkeys(s.series for s in statistics)]
    if not any(noise):
        return 4
    spread, step = min(n for n in noise if n), _noise(statistics, recorded, ("step",), "")
    for k in (4, 6, 8):
        error = FAR * math.sqrt(1 / k + 1 / len(recorded))
        if error * spread <= SEEN_SPREAD and error * step <= SEEN_STEP:
            return k
    return 12


def _noise(statistics: Sequence[Statistic], recorded: Array, quantities: tuple[Name, ...], series: str) -> float:
    """Standard deviation over runs of the mean logarithm over a series, or over all of them; 0 if there is none."""
    columns = [i for i, s in enumerate(statistics) if s.quantity in quantities and series in ("", s.series)]
    if not columns:
        return 0.0
    return float(np.nanmean(recorded[:, columns], axis=1).std(ddof=1)) * QUANTITIES[quantities[0]].unit


def alike(recorded: Array) -> bool:
    """Whether every run has the same statistics: a deterministic tracker."""
    return bool((np.nan_to_num(recorded) == np.nan_to_num(recorded[0])).all())


_MAY_BE_FIXED: Final = ("w", "h", "angle", "particles")


def _values(quantity: Name, one: Trajectory, named: Mapping[str, str]) -> Array:
    """(T,) of a series. Identity: the probability of the name in `named`, 0 in frames where another is more likely."""
    if quantity == "identity":
        same = one.identity == named.get(one.target, "")
        return np.where(one.identity == "", np.nan, np.where(same, one.identity_prob, 0.0))
    if quantity == "lost":
        return np.asarray(one.status == "lost", dtype=float)
    if quantity == "step":
        values = np.hypot(np.diff(one.x, prepend=math.nan), np.diff(one.y, prepend=math.nan))
    else:
        values = getattr(one, quantity)
    offset = QUANTITIES[quantity].offset
    with np.errstate(divide="ignore", invalid="ignore"):
        return values if offset is None else np.asarray(np.log(values + offset))


def _spans(frames: list[int], q: Quantity) -> list[tuple[int, int]]:
    """First and last frame of each span; no frame is left out."""
    if not frames:
        return []
    count = max(round(len(frames) / q.frames), 1) if q.frames else min(4, max(len(frames) // BLOCK, 1))
    edges = [round(i * len(frames) / count) for i in range(count + 1)]
    return [(frames[a], frames[b - 1]) for a, b in itertools.pairwise(edges)]


# --- judging -------------------------------------------------------------------------------------------------------


def judge(statistics: Sequence[Statistic], recorded: Array, tested: Array) -> Verdict:
    """Whether the runs `tested` (K, F) belong with those `recorded` (S, F); both as `measure` gives them."""
    units = np.array([QUANTITIES[s.quantity].unit for s in statistics])
    least = np.array([QUANTITIES[s.quantity].least for s in statistics])
    if alike(recorded):
        return _judge_repeatable(statistics, recorded[0] * units, tested.mean(axis=0) * units, least)
    placed = place(np.vstack([tested, recorded]) * units, least)
    counted = bend(placed.z)
    picks = picks_of(len(tested), len(recorded))
    local = largest(counted, picks)
    groups, members = _groups(statistics)
    means = np.stack([counted[:, columns].mean(axis=1) for columns in members], axis=1)
    overall_placed = place(means, np.full(len(members), 0.05))
    clipped = np.clip(overall_placed.z, -FAR, FAR)
    overall = largest(clipped, picks)
    # a mean of deviations, each in units of its own scale, is a weighted mean of them with the weights 1 / scale
    natural = overall_placed.scale / np.array([np.mean(1 / placed.scale[columns]) for columns in members])
    whole = [i for i, group in enumerate(groups) if (group.series, group.last) == (groups[0].series, groups[0].last)]
    together = joint(clipped[:, whole], picks)

    def at(i: int) -> Deviation:
        edges = (local.mean[i], local.centre[i] - local.half[i], local.centre[i] + local.half[i])
        shown = QUANTITIES[statistics[i].quantity].shown
        value, low, high = (shown(placed.median[i] + placed.scale[i] * unbend(float(v))) for v in edges)
        return Deviation(statistics[i], float(local.far[i]), value, low, high)

    def changed(i: int) -> Deviation:
        edges = (overall.mean[i] - overall.centre[i], -overall.half[i], overall.half[i])
        logarithm = QUANTITIES[groups[i].quantity].offset is not None
        value, low, high = (math.exp(v * natural[i]) if logarithm else v * natural[i] for v in edges)
        return Deviation(groups[i], float(overall.far[i]), value, low, high, relative=True)

    deviations = [*map(at, _outside(local.far)), *map(changed, _outside(overall.far))]
    if together.far > 1:
        most = [whole[i] for i in np.argsort(-together.shares, kind="stable")[:3].tolist() if together.shares[i] > 0.1]
        deviations.append(Deviation(groups[most[0]], together.far, together=tuple(changed(i) for i in most)))
    closest = max(float(local.far.max()), float(overall.far.max()), together.far)
    return Verdict(min(1.0, 3 * min(local.p, overall.p, together.p)), closest, tuple(deviations))


def _judge_repeatable(statistics: Sequence[Statistic], recorded: Array, tested: Array, least: Array) -> Verdict:
    """A deterministic tracker has no spread: its band is what rounding on another processor may amount to."""
    half = REPEATABLE * least
    missing = np.isnan(recorded) != np.isnan(tested)
    far = np.where(missing, FAR, np.nan_to_num(np.abs(tested - recorded)) / half)
    deviations = []
    for i in _outside(far):
        shown = QUANTITIES[statistics[i].quantity].shown
        value, low, high = (shown(float(v)) for v in (tested[i], recorded[i] - half[i], recorded[i] + half[i]))
        deviations.append(Deviation(statistics[i], float(far[i]), value, low, high))
    return Verdict(0.0 if deviations else 1.0, float(far.max()), tuple(deviations))


def _outside(far: Array) -> list[int]:
    """Statistics outside their bands, the farthest first."""
    return [i for i in np.argsort(-far, kind="stable").tolist() if far[i] > 1]


def _groups(statistics: Sequence[Statistic]) -> tuple[list[Statistic], list[Whole]]:
    """The overall statistics (of series "" for all parts), and which statistics each is the mean of.

    x and y are also averaged over the first frames alone: once some runs are lost, a shift of the others is hidden.
    """
    series = tuple(dict.fromkeys(s.series for s in statistics))
    groups, members = [], []
    for quantity in dict.fromkeys(s.quantity for s in statistics):
        own = [i for i, s in enumerate(statistics) if s.quantity == quantity]
        ends = sorted({statistics[i].last for i in own})
        early = ends[max(len(ends) // 4, 2) - 1 :][:1] if quantity in ("x", "y") else []
        for name, last in itertools.product(("", *series) if len(series) > 1 else series, [ends[-1], *early]):
            columns = [i for i in own if name in ("", statistics[i].series) and statistics[i].last <= last]
            if columns:
                groups.append(Statistic(quantity, name, statistics[columns[0]].first, last))
                members.append(np.array(columns, dtype=np.int64))
    return groups, members
