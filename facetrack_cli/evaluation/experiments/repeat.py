"""How far the runs of one recipe differ from seed to seed, and where they part ways.

    spread = spread_of("face", "nose", seeds, frames, positions, limit=12.0)
    spread.std[:, 0], spread.parting, spread.groups

Axes: S runs, T frames; positions (S, T, 2) are a part's centres in pixels, x before y.

*Parting.* At every frame the crowd is all runs, as long as each is within `limit` of their median. Otherwise it is the
largest set of runs within `limit` of one of them (of equal ones the one that shares most with the crowd of the frame
before), and a run is *away* when it is farther than `limit` from the crowd's median. So runs that fall into two halves
are told apart too, where the median of all would lie between them. A run *leaves* at the first of `HOLD` frames in a
row in which it is away, and is back at the first of as many in which it is not. The part's runs *part ways* at the
frame at which the first of them leaves. Medians are taken along x and along y.

`Repetition` holds the spread of all parts, as a table for reading, as CSV and as JSON.
"""

import itertools
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Any, Final

import numpy as np

from facetrack_cli.core.geometry import size_of_points
from facetrack_cli.core.numbers import document
from facetrack_cli.core.types import Array, Mask, Whole
from facetrack_cli.evaluation.experiments.sheet import NO_FIGURE, Sheet, clip_name, rounded
from facetrack_cli.evaluation.match import match
from facetrack_cli.evaluation.rows import places
from facetrack_cli.recipe.model import Recipe, to_dict
from facetrack_cli.trajectory.trajectory import Trajectory

HOLD: Final = 5  # frames in a row that make leaving, or coming back, more than an excursion
FRACTION: Final = 0.25  # of the target's size: the default limit
MOST_NAMED: Final = 10  # seeds in one line of the table
COLUMNS: Final = ("frame", "target", "part", "x", "y", "std_x", "std_y", "from_median", "away")
HEADS: Final = ("part", "spread, px", "farthest\nrun, px", "at frame", "part ways\nat frame", "runs that\nleave")


@dataclass(frozen=True)
class Leave:
    """A run that leaves the crowd: its seed, source frames, and how far it got from the crowd's median in pixels."""

    seed: int
    frame: int
    back: int | None  # None: it never came back
    farthest: float


@dataclass(frozen=True)
class Group:
    """Runs that end at one place: the mean centre, and the mean error to the ground truth, if any; pixels."""

    seeds: tuple[int, ...]
    x: float
    y: float
    error: float | None = None


@dataclass(frozen=True, eq=False)
class Spread:
    """One part over all runs. `std` has n - 1 below the sum; `from_median` (T,) is the farthest run from the median.

    `away` (S, T) says which runs are outside the crowd. Lengths are in pixels.
    """

    target: str
    part: str
    seeds: tuple[int, ...]
    frame: Whole
    mean: Array  # (T, 2)
    std: Array  # (T, 2)
    from_median: Array
    away: Mask
    limit: float
    leaves: tuple[Leave, ...]
    groups: tuple[Group, ...]

    @property
    def name(self) -> str:
        return f"{self.target}/{self.part}"

    @property
    def identical(self) -> bool:
        """Whether no run differs from another at any frame."""
        return not (self.from_median.any() or self.away.any())

    @property
    def parting(self) -> int | None:
        """The source frame at which the first run leaves."""
        return min((leave.frame for leave in self.leaves), default=None)

    @property
    def spread(self) -> Array:
        """(T,): the standard deviation of both axes together, sqrt(std_x^2 + std_y^2)."""
        return np.asarray(np.hypot(self.std[:, 0], self.std[:, 1]), dtype=np.float64)


def target_size(tables: Sequence[Trajectory], target: str) -> float:
    """The target's size in its first frame, in pixels, as recipes measure lengths.

    The largest distance between two parts; of a single part the root of its box's area. 1.0 where neither is known.
    """
    parts = [one for one in tables[0].of_target(target) if len(one)]
    if len(parts) > 1:
        size = size_of_points(np.array([(one.x[0], one.y[0]) for one in parts]))
    else:
        size = float(np.sqrt(parts[0].w[0] * parts[0].h[0])) if parts else 0.0
    return size if np.isfinite(size) and size > 0 else 1.0


def spreads(
    seeds: Sequence[int], tables: Sequence[Trajectory], fraction: float = FRACTION, truth: Sequence[Trajectory] = ()
) -> tuple[Spread, ...]:
    """The spread of every part over the runs `tables`, one a seed; `truth`: as `matched` returns it.

    Runs that were cut short count as far as all of them go.
    """
    known = {one.names[0]: one for one in truth}
    found = []
    for first in tables[0].parts:
        name = first.names[0]
        runs = [one for table in tables if (one := table.find(*name)) is not None]
        frames = reduce(np.intersect1d, [one.frame for one in runs])
        kept = [one.take(np.isin(one.frame, frames)) for one in runs]
        positions = np.stack([np.stack([one.x, one.y], axis=1) for one in kept])
        limit = fraction * target_size(tables, first.target)
        true = places(known[name], frames) if name in known else None
        found.append(spread_of(*name, seeds, frames, positions, limit, true))
    return tuple(found)


def matched(table: Trajectory, truth: Trajectory | None) -> list[Trajectory]:
    """The parts of the ground truth under the names of a run's."""
    pairs = [] if truth is None else match(table, truth, partial=True, select=None, check_shift=False)
    return [pair.truth.renamed(pair.ours.target, pair.ours.part) for pair in pairs]


def spread_of(
    target: str,
    part: str,
    seeds: Sequence[int],
    frame: Whole,
    positions: Array,
    limit: float,
    truth: Array | None = None,
) -> Spread:
    """The spread of one part: positions (S, T, 2), `limit` in pixels, `truth` (T, 2) where it is known."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a frame without any position is nan, which is expected
        mean = np.nanmean(positions, axis=0)
        std = np.nanstd(positions, axis=0, ddof=1) if len(seeds) > 1 else np.zeros_like(mean)
        median = np.nanmedian(positions, axis=0)
        distance = np.hypot(*np.moveaxis(positions - median, 2, 0))  # (S, T)
        from_median = np.nanmax(distance, axis=0, initial=0.0)
    to_crowd, away = _crowds(positions, distance, limit)
    leaves = [
        Leave(
            seed,
            int(frame[first]),
            None if after is None else int(frame[after]),
            float(np.max(np.nan_to_num(to_crowd[s, first:after]), initial=0.0)),
        )
        for s, seed in enumerate(seeds)
        for first, after in stretches(away[s], HOLD)
    ]
    leaves.sort(key=lambda leave: (leave.frame, leave.seed))
    groups = _groups(seeds, positions[:, -HOLD:], limit, None if truth is None else truth[-HOLD:])
    return Spread(target, part, tuple(seeds), frame, mean, std, from_median, away, limit, tuple(leaves), groups)


def stretches(mask: Mask, hold: int) -> list[tuple[int, int | None]]:
    """(first, after) of each time that (T,) `mask` turns true for `hold` places or more, until false for as many.

    `after` is None where it is not false for so long again; what is shorter than `hold`, at the end too, is no stretch.
    """
    turns: list[int] = []  # in, out, in, ...
    bounds = [0, *(np.flatnonzero(np.diff(mask)) + 1).tolist(), len(mask)]
    for first, after in itertools.pairwise(bounds):
        if after - first >= hold and bool(mask[first]) != len(turns) % 2:
            turns.append(first)
    return list(itertools.zip_longest(turns[::2], turns[1::2]))


def _crowds(positions: Array, distance: Array, limit: float) -> tuple[Array, Mask]:
    """(S, T) distances to the crowd's median and whether a run is away from it; `distance` is to the median of all."""
    to_crowd, away = distance.copy(), np.zeros(distance.shape, dtype=np.bool_)
    everyone = np.ones(len(positions), dtype=np.bool_)
    before, last = everyone, -2
    # one crowd is the rule, so that only the other frames are looked at one by one; where no run has a position, as of
    # a part that a correction calls absent, none is away from others
    apart = ~(distance <= limit).all(axis=0) & ~np.isnan(distance).all(axis=0)
    for t in np.flatnonzero(apart).tolist():
        crowd = _crowd(positions[:, t], before if last == t - 1 else everyone, limit)
        middle = np.median(positions[crowd, t], axis=0) if crowd.any() else np.full(2, np.nan)
        to_crowd[:, t] = np.hypot(*(positions[:, t] - middle).T)
        away[:, t] = ~(to_crowd[:, t] <= limit)  # a run without a position is away too
        before, last = crowd, t
    return to_crowd, away


def _crowd(points: Array, before: Mask, limit: float) -> Mask:
    """(S,): the largest set of points (S, 2) within `limit` of one of them; of equal ones that most like `before`."""
    apart = np.hypot(*np.moveaxis(points[:, None] - points[None], 2, 0))
    near = apart <= limit
    tightness = -np.where(near, apart, 0.0).sum(axis=1)
    return np.asarray(near[np.lexsort((tightness, (near & before).sum(axis=1), near.sum(axis=1)))[-1]])


def _groups(seeds: Sequence[int], last: Array, limit: float, truth: Array | None) -> tuple[Group, ...]:
    """The crowd of the last frames (S, t, 2), then that of the rest, and so on; last come runs without a position."""
    points = np.median(last, axis=1)
    error = None if truth is None else np.hypot(*np.moveaxis(last - truth, 2, 0))  # (S, t)
    left = np.arange(len(seeds))
    found = []
    while left.size:
        crowd = _crowd(points[left], np.ones(left.size, dtype=np.bool_), limit)
        members = left[crowd] if crowd.any() else left
        known = error is not None and np.isfinite(error[members]).any()
        wrong = float(np.nanmean(error[members])) if error is not None and known else None
        x, y = points[members].mean(axis=0).tolist()
        found.append(Group(tuple(seeds[i] for i in members), x, y, wrong))
        left = np.setdiff1d(left, members)
    return tuple(found)


@dataclass(frozen=True)
class Repetition:
    """The runs of one recipe on a clip; `fraction` of the target's size is the limit beyond which runs part.

    `complete` is False where they were interrupted: they are as long as the shortest then.
    """

    clip: Path
    label: str
    recipe: Recipe
    seeds: tuple[int, ...]
    spreads: tuple[Spread, ...]
    fraction: float
    truth: Path | None = None
    complete: bool = True
    warnings: tuple[str, ...] = ()

    @property
    def named(self) -> list[tuple[str, Spread]]:
        """Each spread under its name: that of the part alone where there is one target."""
        sole = len({one.target for one in self.spreads}) == 1
        return [(one.part if sole else one.name, one) for one in self.spreads]

    @property
    def parting(self) -> int | None:
        """The source frame at which the first run leaves, at any part."""
        return min((one.parting for one in self.spreads if one.parting is not None), default=None)

    @property
    def identical(self) -> bool:
        return all(one.identical for one in self.spreads)

    def sheet(self) -> Sheet:
        """A row a part."""
        first, last = self.spreads[0].frame[[0, -1]]
        title = f"{clip_name(self.clip)}: {len(self.seeds)} runs of {self.label} on frames {first} to {last}"
        return Sheet(
            title,
            (*HEADS, "groups at\nthe end"),
            tuple(_row(name, one) for name, one in self.named),
            tuple(self.notes()),
            left=(0,),
        )

    def notes(self) -> list[str]:
        """What one must know to read the table, who leaves, and where the runs end."""
        limits = dict.fromkeys(f"{one.limit:.1f}" for one in self.spreads)
        lines = [] if self.complete else [f"Interrupted: these are the frames that {len(self.seeds)} runs had reached."]
        if self.identical:
            draws = "" if self.recipe.random else ": this tracker draws no random numbers"
            return [*lines, f"All {len(self.seeds)} runs are identical{draws}."]
        lines += [
            "Spread: standard deviation over seeds, both axes together, in the median frame. Farthest run: from the "
            "median of all.",
            f"Runs part ways at the first of {HOLD} frames in a row in which one is farther than {' / '.join(limits)} "
            f"px ({self.fraction:g} of the target's size) from the median of most.",
        ]
        partings = [(name, one) for name, one in self.named if one.parting is not None]
        if not partings:
            return [*lines, "No run leaves the others."]
        first = " and ".join(name for name, one in partings if one.parting == self.parting)
        lines.append(f"The first to part ways, at frame {self.parting}: {first}.")
        return lines + [f"{name}: {text}." for name, one in partings for text in (_leaves(one), _ends(one.groups))]

    def csv(self) -> str:
        """A row a frame and part: mean centre, standard deviations, the farthest run from the median, runs away."""
        lines = [",".join(COLUMNS)]
        for t in range(len(self.spreads[0].frame)):
            for one in self.spreads:
                if t < len(one.frame):
                    figures = [*one.mean[t], *one.std[t], one.from_median[t]]
                    cells = ["" if np.isnan(value) else f"{value:.3f}" for value in figures]
                    lines.append(",".join([f"{one.frame[t]}", one.target, one.part, *cells, f"{one.away[:, t].sum()}"]))
        return "\n".join(lines) + "\n"

    def json(self) -> str:
        """Everything, per frame too, with the recipe in full."""
        fields = {
            "clip": str(self.clip),
            "truth": None if self.truth is None else str(self.truth),
            "label": self.label,
            "seeds": self.seeds,
            "complete": self.complete,
            "identical": self.identical,
            "parting": self.parting,
            "fraction": self.fraction,
            "notes": self.notes(),
            "warnings": self.warnings,
            "parts": [_part(one) for one in self.spreads],
            "recipe": to_dict(self.recipe),
        }
        return document("facetrack-repeat", fields)


def _row(name: str, one: Spread) -> tuple[str, ...]:
    at = int(np.argmax(one.from_median))
    leaving = {leave.seed for leave in one.leaves}
    return (
        name,
        f"{np.nanmedian(one.spread):.2f}",
        f"{one.from_median[at]:.1f}",
        NO_FIGURE if one.identical else f"{one.frame[at]}",
        NO_FIGURE if one.parting is None else f"{one.parting}",
        f"{len(leaving)} of {len(one.seeds)}",
        " + ".join(str(len(group.seeds)) for group in one.groups),
    )


def _leaves(one: Spread) -> str:
    texts = [
        f"seed {leave.seed} leaves at {leave.frame}, gets {leave.farthest:.0f} px away"
        + ("" if leave.back is None else f", is back at {leave.back}")
        for leave in one.leaves
    ]
    return _first(texts, "")


def _ends(groups: Sequence[Group]) -> str:
    if len(groups) == 1:
        return f"in the end all are together{_off(groups[0])}"
    texts = [f"{_seeds(group.seeds)} at ({group.x:.0f}, {group.y:.0f}){_off(group)}" for group in groups]
    return f"in the end {_first(texts, ' groups')}"


def _first(texts: Sequence[str], what: str) -> str:
    """The first of them, and how many more there are."""
    more = [f"and {len(texts) - MOST_NAMED} more{what}"] * (len(texts) > MOST_NAMED)
    return "; ".join([*texts[:MOST_NAMED], *more])


def _seeds(seeds: Sequence[int]) -> str:
    if len(seeds) > MOST_NAMED:
        return f"{len(seeds)} runs"
    return f"seed{'s' * (len(seeds) > 1)} {', '.join(map(str, seeds))}"


def _off(group: Group) -> str:
    return "" if group.error is None else f", off by {group.error:.1f} px"


def _part(one: Spread) -> dict[str, Any]:
    curves = dict(zip(COLUMNS[3:8], (*one.mean.T, *one.std.T, one.from_median), strict=True))
    return {
        "target": one.target,
        "part": one.part,
        "limit_px": round(one.limit, 3),
        "parting": one.parting,
        "leaves": [
            {"seed": leave.seed, "frame": leave.frame, "back": leave.back, "farthest_px": round(leave.farthest, 3)}
            for leave in one.leaves
        ],
        "groups": [
            {"seeds": group.seeds, "x": rounded(group.x, 3), "y": rounded(group.y, 3)}
            | {"error_px": rounded(group.error, 3)}
            for group in one.groups
        ],
        "spread_px": rounded(float(np.nanmedian(one.spread)), 3),
        "frame": one.frame.tolist(),
        **{name: [rounded(value, 3) for value in curve.tolist()] for name, curve in curves.items()},
        "away": one.away.sum(axis=0).tolist(),
    }
