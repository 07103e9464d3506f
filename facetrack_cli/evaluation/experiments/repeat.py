"""How far the runs of one recipe differ from seed to seed, and where they part ways.

    spread = spread_of("face", "nose", seeds, frames, positions, limit=12.0)
    spread.std[:, 0], spread.parting, spread.leaves

Axes: S runs, T frames; positions (S, T, 2) are a part's centres in pixels, x before y. A run is *away* in a frame
when it is farther than `limit` from the median of all runs, which is taken along x and along y. It *leaves* at the
first of `HOLD` frames in a row in which it is away; the runs *part ways* where the first of them leaves.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from facetrack_cli.core.geometry import size_of_points
from facetrack_cli.core.numbers import csv_text, document
from facetrack_cli.core.types import Array, Mask, Whole
from facetrack_cli.evaluation.match import match
from facetrack_cli.evaluation.rows import places
from facetrack_cli.evaluation.sheet import NO_FIGURE, Sheet, clip_name, rounded
from facetrack_cli.recipe.model import Recipe, to_dict
from facetrack_cli.trajectory.trajectory import Trajectory

HOLD: Final = 5  # frames in a row that make leaving more than an excursion
MOST_NAMED: Final = 10  # runs that are told of in a note
COLUMNS: Final = ("frame", "target", "part", "x", "y", "std_x", "std_y", "from_median", "away")
HEADS: Final = ("part", "spread, px", "farthest\nrun, px", "at frame", "part ways\nat frame", "runs that\nleave")


class Leave(NamedTuple):
    """A run that leaves: the source frame, its seed, and how far it gets from the median, then or later."""

    frame: int
    seed: int
    farthest_px: float


@dataclass(frozen=True, eq=False)
class Spread:
    """One part over all runs; lengths are in pixels."""

    target: str
    part: str
    frame: Whole
    mean: Array  # (T, 2)
    std: Array  # (T, 2), with n - 1 below the sum
    from_median: Array  # (T,), of the farthest run
    away: Mask  # (S, T)
    limit: float
    leaves: tuple[Leave, ...]  # one a run, by frame
    errors: Array  # (S,), means over the last HOLD frames; nan without ground truth

    @property
    def typical(self) -> float:
        """The standard deviation of both axes together, sqrt(std_x^2 + std_y^2), in the median frame."""
        return float(np.nanmedian(np.hypot(*self.std.T)))

    @property
    def parting(self) -> int | None:
        """The source frame at which the first run leaves."""
        return self.leaves[0].frame if self.leaves else None


def target_size(tables: Sequence[Trajectory], target: str) -> float:
    """Pixels in the first frame: the largest distance of two parts; of one the root of its box's area; 1 if unknown."""
    parts = [one for one in tables[0].of_target(target) if len(one)]
    points = np.array([(one.x[0], one.y[0]) for one in parts])
    box = float(np.sqrt(parts[0].w[0] * parts[0].h[0])) if parts else 0.0
    size = size_of_points(points) if len(parts) > 1 else box
    return size if np.isfinite(size) and size > 0 else 1.0


def spreads(
    seeds: Sequence[int], tables: Sequence[Trajectory], fraction: float, truth: Trajectory | None = None
) -> tuple[Spread, ...]:
    """The spread of every part over the runs `tables`, one a seed, as far as all of them go."""
    pairs = [] if truth is None else match(tables[0], truth, partial=True, select=None)
    known = {pair.ours.names[0]: pair.truth for pair in pairs}
    found = []
    for first in tables[0].parts:
        name = first.names[0]
        runs = [one for table in tables if (one := table.find(*name)) is not None]
        frames = reduce(np.intersect1d, [one.frame for one in runs])
        positions = np.stack([places(one, frames) for one in runs])
        limit = fraction * target_size(tables, first.target)
        true = places(known[name], frames) if name in known else np.nan
        found.append(spread_of(*name, seeds, frames, positions, limit, true))
    return tuple(found)


def spread_of(
    target: str, part: str, seeds: Sequence[int], frame: Whole, positions: Array, limit: float, true: Array | float
) -> Spread:
    """The spread of one part; `limit` is in pixels, `true` (T, 2) has true positions, nan where they are not known."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a frame without any position is nan, which is expected
        mean = np.nanmean(positions, axis=0)
        std = np.nanstd(positions, axis=0, ddof=1)
        distance = np.hypot(*np.moveaxis(positions - np.nanmedian(positions, axis=0), 2, 0))  # (S, T)
        from_median = np.nanmax(distance, axis=0, initial=0.0)
        errors = np.nanmean(np.hypot(*np.moveaxis(positions - true, 2, 0))[:, -HOLD:], axis=1)
    # a run without a position is away, unless no run has one, as of a part that a correction calls absent
    away = ~(distance <= limit) & ~np.isnan(distance).all(axis=0)
    held = [np.flatnonzero(np.convolve(one, np.ones(HOLD), "valid") == HOLD) for one in away]
    leaves = [
        Leave(int(frame[at[0]]), seed, round(float(np.nan_to_num(far[at[0] :]).max()), 3))
        for seed, at, far in zip(seeds, held, distance, strict=True)
        if at.size
    ]
    return Spread(target, part, frame, mean, std, from_median, away, limit, tuple(sorted(leaves)), errors)


@dataclass(frozen=True)
class Repetition:
    """The runs of one recipe on a clip; `fraction` of the target's size is the limit beyond which runs part."""

    clip: Path
    label: str
    recipe: Recipe
    seeds: tuple[int, ...]
    spreads: tuple[Spread, ...]
    fraction: float
    truth: Path | None = None
    complete: bool = True  # False: interrupted, and all as long as the shortest run
    warnings: tuple[str, ...] = ()

    @property
    def named(self) -> list[tuple[str, Spread]]:
        """Each spread under its name: that of the part alone where there is one target."""
        sole = len({one.target for one in self.spreads}) == 1
        return [(one.part if sole else f"{one.target}/{one.part}", one) for one in self.spreads]

    @property
    def parting(self) -> int | None:
        """The source frame at which the first run leaves, at any part."""
        return min((leave.frame for one in self.spreads for leave in one.leaves), default=None)

    @property
    def identical(self) -> bool:
        """Whether no run differs from another in any frame."""
        return not any(one.from_median.any() or one.away.any() for one in self.spreads)

    def sheet(self) -> Sheet:
        """A row a part."""
        first, last = self.spreads[0].frame[[0, -1]]
        title = f"{clip_name(self.clip)}: {len(self.seeds)} runs of {self.label} on frames {first} to {last}"
        heads = HEADS if self.truth is None else (*HEADS, "error at\nthe end, px")
        rows = []
        for name, one in self.named:
            at, errors = int(np.argmax(one.from_median)), one.errors[np.isfinite(one.errors)]
            figures = (
                f"{one.typical:.2f}",
                f"{one.from_median[at]:.1f}",
                f"{one.frame[at]}" if one.from_median[at] else NO_FIGURE,
                NO_FIGURE if one.parting is None else f"{one.parting}",
                f"{len(one.leaves)} of {len(one.away)}",
                f"{errors.min():.1f} to {errors.max():.1f}" if errors.size else NO_FIGURE,
            )
            rows.append((name, *figures)[: len(heads)])
        return Sheet(title, heads, tuple(rows), tuple(self.notes()))

    def notes(self) -> list[str]:
        """What one must know to read the table, and who leaves."""
        limits = dict.fromkeys(f"{one.limit:.1f}" for one in self.spreads)
        lines = [] if self.complete else [f"Interrupted: these are the frames that {len(self.seeds)} runs had reached."]
        if self.identical:
            draws = "" if self.recipe.random else ": this tracker draws no random numbers"
            return [*lines, f"All {len(self.seeds)} runs are identical{draws}."]
        lines += [
            "Spread: standard deviation of both axes together, median of frames. Farthest run: from the median of all.",
            f"Runs part ways at the first of {HOLD} frames in a row in which one is farther than {' / '.join(limits)} "
            f"px ({self.fraction:g} of the target's size) from the median of all.",
        ]
        if self.parting is None:
            return [*lines, "No run leaves the others."]
        first = " and ".join(name for name, one in self.named if one.parting == self.parting)
        lines.append(f"The first to part ways, at frame {self.parting}: {first}.")
        for name, one in self.named:
            texts = [f"seed {seed} leaves at {frame}, gets {far:.0f} px away" for frame, seed, far in one.leaves]
            more = f"; and {len(texts) - MOST_NAMED} more" * (len(texts) > MOST_NAMED)
            lines += [f"{name}: {'; '.join(texts[:MOST_NAMED])}{more}."] * bool(texts)
        return lines

    def csv(self) -> str:
        """A row a frame and part: mean centre, standard deviations, the farthest run from the median, runs away."""
        rows: list[list[Any]] = []
        for t in range(len(self.spreads[0].frame)):
            for one in self.spreads:
                if t < len(one.frame):
                    figures = [*one.mean[t], *one.std[t], one.from_median[t]]
                    cells = ["" if np.isnan(value) else f"{value:.3f}" for value in figures]
                    rows.append([one.frame[t], one.target, one.part, *cells, one.away[:, t].sum()])
        return csv_text(COLUMNS, rows)

    def json(self) -> str:
        """Everything, per frame too, with the recipe in full."""
        plain = ("label", "seeds", "complete", "identical", "parting", "fraction", "warnings")
        fields = {
            "clip": str(self.clip),
            "truth": None if self.truth is None else str(self.truth),
            **{key: getattr(self, key) for key in plain},
            "notes": self.notes(),
            "parts": [_part(one) for one in self.spreads],
            "recipe": to_dict(self.recipe),
        }
        return document("facetrack-repeat", fields)


def _part(one: Spread) -> dict[str, Any]:
    curves = dict(zip(COLUMNS[3:8], (*one.mean.T, *one.std.T, one.from_median), strict=True))
    return {
        "target": one.target,
        "part": one.part,
        "limit_px": round(one.limit, 3),
        "parting": one.parting,
        "leaves": [leave._asdict() for leave in one.leaves],
        "error_px": [rounded(error, 3) for error in one.errors.tolist()],
        "spread_px": rounded(one.typical, 3),
        "frame": one.frame.tolist(),
        **{name: [rounded(value, 3) for value in curve.tolist()] for name, curve in curves.items()},
        "away": one.away.sum(axis=0).tolist(),
    }
