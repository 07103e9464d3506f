"""The spread over seeds as a table for people, and as CSV and JSON for programs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from facetrack_cli.core.types import Array
from facetrack_cli.evaluation.experiments.repeat import HOLD, Group, Spread
from facetrack_cli.evaluation.experiments.sheet import NO_FIGURE, Sheet, clip_name, document, rounded

if TYPE_CHECKING:
    from facetrack_cli.recipe.model import Recipe

HEADS: Final = (
    "part",
    "spread, px",
    "farthest\nrun, px",
    "at frame",
    "part ways\nat frame",
    "runs that\nleave",
    "groups at\nthe end",
)
COLUMNS: Final = ("frame", "target", "part", "x", "y", "std_x", "std_y", "from_median", "away")
MOST_NAMED: Final = 10  # seeds in one line of the table


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
        return Sheet(title, HEADS, tuple(_row(name, one) for name, one in self.named), tuple(self.notes()), left=(0,))

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
                if t >= len(one.frame):
                    continue
                figures = [*one.mean[t], *one.std[t], one.from_median[t]]
                cells = ["" if math.isnan(value) else f"{value:.3f}" for value in figures]
                lines.append(",".join([f"{one.frame[t]}", one.target, one.part, *cells, f"{one.away[:, t].sum()}"]))
        return "\n".join(lines) + "\n"

    def json(self) -> str:
        """Everything, per frame too, with the recipe in full."""
        from facetrack_cli.recipe.model import to_dict

        fields = {
            "clip": str(self.clip),
            "truth": None if self.truth is None else str(self.truth),
            "label": self.label,
            "seeds": list(self.seeds),
            "complete": self.complete,
            "identical": self.identical,
            "parting": self.parting,
            "fraction": self.fraction,
            "notes": self.notes(),
            "warnings": list(self.warnings),
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
    told = [
        f"seed {leave.seed} leaves at {leave.frame}, gets {leave.farthest:.0f} px away"
        + ("" if leave.back is None else f", is back at {leave.back}")
        for leave in one.leaves
    ]
    return _first(told, "")


def _ends(groups: Sequence[Group]) -> str:
    if len(groups) == 1:
        return f"in the end all are together{_off(groups[0])}"
    told = [f"{_seeds(group.seeds)} at ({group.x:.0f}, {group.y:.0f}){_off(group)}" for group in groups]
    return f"in the end {_first(told, ' groups')}"


def _first(told: Sequence[str], what: str) -> str:
    """The first of them, and how many more there are."""
    more = len(told) - MOST_NAMED
    return "; ".join([*told[:MOST_NAMED], *([f"and {more} more{what}"] if more > 0 else [])])


def _seeds(seeds: Sequence[int]) -> str:
    if len(seeds) > MOST_NAMED:
        return f"{len(seeds)} runs"
    return f"seed{'s' * (len(seeds) > 1)} {', '.join(map(str, seeds))}"


def _off(group: Group) -> str:
    return "" if group.error is None else f", off by {group.error:.1f} px"


def _part(one: Spread) -> dict[str, Any]:
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
            {
                "seeds": list(group.seeds),
                "x": rounded(group.x, 3),
                "y": rounded(group.y, 3),
                "error_px": rounded(group.error, 3),
            }
            for group in one.groups
        ],
        "spread_px": rounded(float(np.nanmedian(one.spread)), 3),
        "frame": one.frame.tolist(),
        "x": _numbers(one.mean[:, 0]),
        "y": _numbers(one.mean[:, 1]),
        "std_x": _numbers(one.std[:, 0]),
        "std_y": _numbers(one.std[:, 1]),
        "from_median": _numbers(one.from_median),
        "away": one.away.sum(axis=0).tolist(),
    }


def _numbers(values: Array) -> list[float | None]:
    return [rounded(value, 3) for value in values.tolist()]
