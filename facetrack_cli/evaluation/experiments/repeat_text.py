"""The spread over seeds as a table for people, and as CSV and JSON for programs."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from facetrack_cli import __version__
from facetrack_cli.core.types import Array
from facetrack_cli.evaluation.experiments.repeat import HOLD, Group, Spread
from facetrack_cli.evaluation.experiments.sheet import NO_FIGURE, Sheet, clip_name

if TYPE_CHECKING:
    from facetrack_cli.recipe.model import Recipe

SCHEMA: Final = "facetrack-repeat"
VERSION: Final = 1
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
    def title(self) -> str:
        first, last = self.spreads[0].frame[[0, -1]]
        return f"{clip_name(self.clip)}: {len(self.seeds)} runs of {self.label} on frames {first} to {last}"

    @property
    def names(self) -> tuple[str, ...]:
        """Of each spread; the part alone where there is one target."""
        sole = len({one.target for one in self.spreads}) == 1
        return tuple(one.part if sole else one.name for one in self.spreads)

    @property
    def parting(self) -> int | None:
        """The source frame at which the first run leaves, at any part."""
        return min((one.parting for one in self.spreads if one.parting is not None), default=None)

    @property
    def identical(self) -> bool:
        return all(one.identical for one in self.spreads)


def sheet(found: Repetition) -> Sheet:
    """A row a part."""
    heads = (
        "part",
        "spread, px",
        "farthest\nrun, px",
        "at frame",
        "part ways\nat frame",
        "runs that\nleave",
        "groups at\nthe end",
    )
    return Sheet(
        heads,
        tuple(_row(name, one) for name, one in zip(found.names, found.spreads, strict=True)),
        tuple(notes(found)),
        left=(0,),
    )


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


def notes(found: Repetition) -> list[str]:
    """What one must know to read the table, who leaves, and where the runs end."""
    limits = dict.fromkeys(f"{one.limit:.1f}" for one in found.spreads)
    lines = [] if found.complete else [f"Interrupted: these are the frames that {len(found.seeds)} runs had reached."]
    if found.identical:
        draws = "" if found.recipe.random else ": this tracker draws no random numbers"
        lines.append(f"All {len(found.seeds)} runs are identical{draws}.")
        return lines
    lines += [
        "Spread: standard deviation over seeds, both axes together, in the median frame. Farthest run: from the median "
        "of all.",
        f"Runs part ways at the first of {HOLD} frames in a row in which one is farther than {' / '.join(limits)} px "
        f"({found.fraction:g} of the target's size) from the median of most.",
    ]
    partings = [(name, one) for name, one in zip(found.names, found.spreads, strict=True) if one.parting is not None]
    if not partings:
        lines.append("No run leaves the others.")
        return lines
    first = " and ".join(name for name, one in partings if one.parting == found.parting)
    lines.append(f"The first to part ways, at frame {found.parting}: {first}.")
    for name, one in partings:
        lines += [f"{name}: {text}." for text in (_leaves(one), _ends(one.groups))]
    return lines


def _leaves(one: Spread) -> str:
    told = [
        f"seed {leave.seed} leaves at {leave.frame}, gets {leave.farthest:.0f} px away"
        + ("" if leave.back is None else f", is back at {leave.back}")
        for leave in one.leaves[:MOST_NAMED]
    ]
    more = len(one.leaves) - len(told)
    return "; ".join([*told, *([f"and {more} more"] if more > 0 else [])])


def _ends(groups: Sequence[Group]) -> str:
    if len(groups) == 1:
        return f"in the end all are together{_off(groups[0])}"
    told = [f"{_named(group.seeds)} at ({group.x:.0f}, {group.y:.0f}){_off(group)}" for group in groups[:MOST_NAMED]]
    more = len(groups) - len(told)
    return "in the end " + "; ".join([*told, *([f"and {more} more groups"] if more > 0 else [])])


def _named(seeds: Sequence[int]) -> str:
    if len(seeds) > MOST_NAMED:
        return f"{len(seeds)} runs"
    return f"seed{'s' * (len(seeds) > 1)} {', '.join(map(str, seeds))}"


def _off(group: Group) -> str:
    return "" if group.error is None else f", off by {group.error:.1f} px"


def as_csv(found: Repetition) -> str:
    """A row a frame and part: mean centre, standard deviations, the farthest run from the median, and runs away."""
    lines = [",".join(COLUMNS)]
    for t in range(len(found.spreads[0].frame)):
        for one in found.spreads:
            if t >= len(one.frame):
                continue
            figures = [*one.mean[t], *one.std[t], one.from_median[t]]
            cells = ["" if math.isnan(value) else f"{value:.3f}" for value in figures]
            lines.append(",".join([f"{one.frame[t]}", one.target, one.part, *cells, f"{one.away[:, t].sum()}"]))
    return "\n".join(lines) + "\n"


def as_json(found: Repetition) -> str:
    """Everything, per frame too, with the recipe in full."""
    from facetrack_cli.recipe.model import to_dict

    whole: dict[str, Any] = {
        "schema": SCHEMA,
        "version": VERSION,
        "facetrack": __version__,
        "clip": str(found.clip),
        "truth": None if found.truth is None else str(found.truth),
        "label": found.label,
        "seeds": list(found.seeds),
        "complete": found.complete,
        "identical": found.identical,
        "parting": found.parting,
        "fraction": found.fraction,
        "notes": notes(found),
        "warnings": list(found.warnings),
        "parts": [_part(one) for one in found.spreads],
        "recipe": to_dict(found.recipe),
    }
    return json.dumps(whole, ensure_ascii=False, allow_nan=False) + "\n"


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
            {"seeds": list(group.seeds), "x": _number(group.x), "y": _number(group.y), "error_px": _number(group.error)}
            for group in one.groups
        ],
        "spread_px": _number(float(np.nanmedian(one.spread))),
        "frame": one.frame.tolist(),
        "x": _numbers(one.mean[:, 0]),
        "y": _numbers(one.mean[:, 1]),
        "std_x": _numbers(one.std[:, 0]),
        "std_y": _numbers(one.std[:, 1]),
        "from_median": _numbers(one.from_median),
        "away": one.away.sum(axis=0).tolist(),
    }


def _number(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, 3)


def _numbers(values: Array) -> list[float | None]:
    return [_number(value) for value in values.tolist()]
