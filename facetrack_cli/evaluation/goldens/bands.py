"""Statistics of a recipe's runs on a clip, and the bands in which new runs must lie.

A statistic is the mean of a quantity of one part over a span of frames: x, y and sizes over about 25 frames; spread,
effective sample size, step length, confidence and the share of frames lost over a quarter of the clip; every quantity
also over the whole clip, of each part and of all parts together.

The band of a statistic is its range over the recorded seeds, widened by MARGIN of the distance between the 10th and
the 90th percentile and by the least difference that counts. A check runs RUNS other seeds. It fails if all of them
lie on the same side outside of a band. So a seed that loses the target does not fail a check, and rounding on another
processor does not either: of the shipped goldens an unchanged tracker fails less than 1 check in 10,000.
"""

import itertools
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np

from facetrack_cli.core.types import Array
from facetrack_cli.trajectory.trajectory import Trajectory

Name: TypeAlias = Literal[
    "x", "y", "w", "h", "angle", "std_x", "std_y", "ess", "step", "particles", "confidence", "lost", "identity"
]  # fmt: skip

RUNS: Final = 4
MARGIN: Final = 0.1
DETERMINISTIC: Final = 10  # half a band of a tracker without chance, in units of `least`
BLOCK_FRAMES: Final = 25


class Quantity(NamedTuple):
    """How a quantity is averaged and shown. `least`: the least difference that counts; `quarters`: spans are quarters.

    With an `offset` the mean is that of log(value + offset); `least` is then relative.
    """

    least: float
    words: str
    suffix: str = ""
    offset: float | None = None
    quarters: bool = False


QUANTITIES: Final[dict[Name, Quantity]] = {
    "x": Quantity(0.1, "mean x", " px"),
    "y": Quantity(0.1, "mean y", " px"),
    "w": Quantity(0.01, "mean width", " px", 0.0),
    "h": Quantity(0.01, "mean height", " px", 0.0),
    "angle": Quantity(0.1, "mean angle", "°"),
    "std_x": Quantity(0.03, "mean std_x", " px", 0.05, quarters=True),
    "std_y": Quantity(0.03, "mean std_y", " px", 0.05, quarters=True),
    "ess": Quantity(0.03, "mean ess", "", 0.0, quarters=True),
    "step": Quantity(0.03, "mean step", " px", 0.05, quarters=True),
    "particles": Quantity(0.01, "mean number of particles", "", 0.0, quarters=True),
    "confidence": Quantity(0.02, "mean confidence", quarters=True),
    "lost": Quantity(0.03, "share of frames lost or hidden", quarters=True),
    "identity": Quantity(0.02, "mean probability of who it is", quarters=True),
}
_MAY_BE_FIXED: Final = ("w", "h", "angle", "particles")


class Statistic(NamedTuple):
    """A quantity of one series (`target/part`, or "" for all) averaged over source frames first..last."""

    series: str
    quantity: Name
    first: int
    last: int


class Band(NamedTuple):
    """A statistic and the band of recorded runs; `low` and `high` are None where no run has a value.

    `missing`: how many recorded runs have no value. Values are means, of logarithms for quantities with an offset.
    """

    series: str
    quantity: Name
    first: int
    last: int
    low: float | None
    high: float | None
    missing: int

    @property
    def statistic(self) -> Statistic:
        return Statistic(*self[:4])


@dataclass(frozen=True)
class Deviation:
    """A band that all tested runs have left. `far`: in half widths of the band from its middle; `runs`: their range."""

    band: Band
    far: float
    runs: tuple[float, float]

    @property
    def shown(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The range of the runs and the band, in the quantity's unit; nan where no run has a value."""
        offset = QUANTITIES[self.band.quantity].offset
        edges = [math.nan if v is None else v for v in (*self.runs, self.band.low, self.band.high)]
        a, b, low, high = (v if offset is None else math.exp(min(v, 50.0)) - offset for v in edges)
        return (a, b), (low, high)

    def __str__(self) -> str:
        q, (runs, band) = QUANTITIES[self.band.quantity], self.shown
        width = max(band[1] - band[0], 1e-6) if math.isfinite(band[0]) else 1.0
        digits = min(max(1 - math.floor(math.log10(width)), 0), 4)

        def text(pair: tuple[float, float]) -> str:
            if not math.isfinite(pair[0]):
                return "no value"
            low, high = (f"{v:.{digits}f}" for v in pair)
            return (low if low == high else f"{low}..{high}") + q.suffix

        return f"{q.words} {text(runs)}, band {text(band)}"


def last_names(tables: Sequence[Trajectory]) -> dict[str, Counter[str]]:
    """For each target that is named in any run: how many runs end with which name."""
    found: dict[str, Counter[str]] = {}
    for table in tables:
        for target in table.targets:
            if named := [name for name in table.of_target(target)[0].identity.tolist() if name]:
                found.setdefault(target, Counter())[named[-1]] += 1
    return found


def names(tables: Sequence[Trajectory]) -> dict[str, str]:
    """The name of each target with which most runs end; of as many, the first by the alphabet."""
    return {
        target: min(counts, key=lambda name: (-counts[name], name)) for target, counts in last_names(tables).items()
    }


def select_statistics(tables: Sequence[Trajectory], named: Mapping[str, str]) -> list[Statistic]:
    """The statistics that runs of this clip have: quantities that the tracker gives, and that are not fixed."""
    found = []
    for name, q in QUANTITIES.items():
        series = []
        for i, one in enumerate(tables[0].parts):
            values = np.stack([_values(name, table.parts[i], named) for table in tables])
            known = values[np.isfinite(values)]
            if known.size and not (name in _MAY_BE_FIXED and np.ptp(known) < 1e-9):
                series.append(one.name)
        spans = _spans(tables[0].parts[0].frame[1:].tolist(), quarters=q.quarters)
        found += [Statistic(one, name, *span) for one in series for span in spans]
        if len(series) > 1 and spans:
            found.append(Statistic("", name, spans[0][0], spans[-1][1]))
    return found


def measure(tables: Sequence[Trajectory], statistics: Sequence[Statistic], named: Mapping[str, str]) -> Array:
    """(S, F): each run's statistics, nan where a run has no value in a span.

    `named`: the name whose probability is measured, by target. Every table must have the series and frames of these.
    """
    rows = []
    for table in tables:
        parts = {one.name: one for one in table.parts}
        known = {
            (name, series): _values(name, part, named)
            for name in dict.fromkeys(s.quantity for s in statistics)
            for series, part in parts.items()
        }
        row = []
        for s in statistics:
            of = [s.series] if s.series else [t.series for t in statistics if t.series and t.quantity == s.quantity]
            chosen = [known[s.quantity, name][_within(parts[name], s)] for name in dict.fromkeys(of)]
            values = np.concatenate(chosen)
            values = values[np.isfinite(values)]
            row.append(float(values.mean()) if values.size else math.nan)
        rows.append(row)
    return np.array(rows, dtype=float)


def _within(part: Trajectory, s: Statistic) -> Array:
    return np.asarray((part.frame >= s.first) & (part.frame <= s.last))


def _values(quantity: Name, one: Trajectory, named: Mapping[str, str]) -> Array:
    """(T,) of a series. Identity: the probability of the name in `named`, 0 in frames where another is more likely."""
    if quantity == "identity":
        same = one.identity == named.get(one.target, "")
        return np.where(one.identity == "", np.nan, np.where(same, one.identity_prob, 0.0))
    if quantity == "lost":
        return one.unseen.astype(float)
    if quantity == "step":
        values = np.hypot(np.diff(one.x, prepend=math.nan), np.diff(one.y, prepend=math.nan))
    else:
        values = getattr(one, quantity)
    offset = QUANTITIES[quantity].offset
    with np.errstate(divide="ignore", invalid="ignore"):
        return values if offset is None else np.asarray(np.log(values + offset))


def _spans(frames: list[int], *, quarters: bool) -> list[tuple[int, int]]:
    """First and last frame of each span, and of the whole clip; no frame is left out."""
    if not frames:
        return []
    blocks = max(round(len(frames) / BLOCK_FRAMES), 1)
    count = min(4, max(len(frames) // BLOCK_FRAMES, 1)) if quarters else blocks
    edges = [round(i * len(frames) / count) for i in range(count + 1)]
    found = [(frames[a], frames[b - 1]) for a, b in itertools.pairwise(edges)]
    return [*found, *([(frames[0], frames[-1])] if count > 1 else [])]


def deterministic(recorded: Array) -> bool:
    """Whether every run (S, F) has the same statistics."""
    return bool((np.nan_to_num(recorded) == np.nan_to_num(recorded[0])).all())


def bands_of(statistics: Sequence[Statistic], recorded: Array) -> list[Band]:
    """The band of each statistic over recorded runs (S, F)."""
    found = []
    for s, column in zip(statistics, recorded.T, strict=True):
        known, least = column[np.isfinite(column)], QUANTITIES[s.quantity].least
        if not known.size:
            found.append(Band(*s, None, None, len(column)))
            continue
        margin = DETERMINISTIC * least
        if len(column) > 1:
            margin = least + MARGIN * float(np.subtract(*np.percentile(known, [90, 10])))
        low, high = round(float(known.min()) - margin, 4), round(float(known.max()) + margin, 4)
        found.append(Band(*s, low, high, len(column) - known.size))
    return found


def judge(bands: Sequence[Band], tested: Array) -> tuple[float, list[Deviation]]:
    """Tested runs (K, F) against bands: how far the farthest statistic is, above 1 outside, and the bands left.

    The farthest deviation comes first; of all parts together last.
    """
    farthest, left = 0.0, []
    for band, values in zip(bands, tested.T, strict=True):
        known = values[np.isfinite(values)]
        runs = (float(known.min()), float(known.max())) if known.size else (math.nan, math.nan)
        far = _far(band, known, len(values) - known.size)
        farthest = max(farthest, far)
        if far > 1:
            left.append(Deviation(band, far, runs))
    return farthest, sorted(left, key=lambda one: (one.band.series == "", -one.far))


def _far(band: Band, known: Array, missing: int) -> float:
    """How far the nearest tested run lies from the band's middle, in half widths; 0 if runs lie on both sides."""
    if band.low is None or band.high is None:
        return math.inf if known.size and not missing else 0.0
    if missing and (band.missing or known.size):
        return 0.0
    if not known.size:
        return math.inf
    away = (known - (band.low + band.high) / 2) / ((band.high - band.low) / 2)
    return max(float(away.min()), float(-away.max()), 0.0)
