"""A comparison as a table for people, and as CSV and JSON for programs."""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from facetrack_cli import __version__
from facetrack_cli.evaluation.experiments.compare import Entry, Place, kind_of, less_is_better, rank
from facetrack_cli.evaluation.experiments.sheet import NO_FIGURE, Sheet, clip_name
from facetrack_cli.evaluation.summary import MEASURES

if TYPE_CHECKING:
    from facetrack_cli.recipe.model import Recipe

SCHEMA: Final = "facetrack-compare"
VERSION: Final = 1
# what a measure is called in the table, its factor and its decimals
TITLES: Final = {
    "boxes.success_auc": ("success\nAUC", 1, 3),
    "boxes.precision_20": ("precision\nat 20 px", 1, 3),
    "boxes.good_rate": ("good\ntracking", 1, 3),
    "points.mean_normalised": ("normalised\nerror, %", 100, 2),
    "points.mean_px": ("mean\nerror, px", 1, 2),
    "points.median_px": ("median\nerror, px", 1, 2),
}


@dataclass(frozen=True)
class Comparison:
    """All that a comparison found. `entries` in the order in which they were asked for; `recipes` by label."""

    clip: Path
    truth: Path
    seeds: int
    entries: tuple[Entry, ...]
    measure: str
    workers: int = 1
    complete: bool = True
    recipes: dict[str, Recipe] = field(default_factory=dict)

    @property
    def kind(self) -> str:
        """`boxes` or `points`: what the first recipe that ran is measured as."""
        return kind_of(self.entries)

    @property
    def title(self) -> str:
        frames = np.concatenate([score.frame for entry in self.entries for score in entry.scores])
        return (
            f"{clip_name(self.clip)}: {len(self.entries)} recipes on frames {frames.min()} to {frames.max()}, "
            f"truth {self.truth.name}"
        )

    @property
    def places(self) -> list[Place]:
        return rank(self.entries, self.measure)

    @property
    def measures(self) -> tuple[str, ...]:
        """Those in the table, the one that ranks first."""
        usual = [name for name in TITLES if name.startswith(self.kind)]
        return tuple(dict.fromkeys([self.measure, *usual]))


def sheet(comparison: Comparison) -> Sheet:
    """Recipes in their order; those that could not run at the end, and why below."""
    found = comparison.places
    rates = [rate for place in found if (rate := place.entry.frames_per_s) is not None]
    heads = (
        "rank",
        "recipe",
        *(_head(name) for name in comparison.measures),
        "failed",
        "frames\nper s",
        "time a\nframe",
    )
    rows = [_row(place, comparison, max(rates, default=0.0)) for place in found]
    return Sheet(heads, tuple(rows), tuple(notes(comparison)))


def _head(measure: str) -> str:
    title = TITLES.get(measure, (measure.replace(".", ".\n"), 1, 3))[0]
    arrow = "\N{DOWNWARDS ARROW}" if less_is_better(measure) else "\N{UPWARDS ARROW}"
    return f"{title} {arrow}"


def _row(place: Place, comparison: Comparison, fastest: float) -> tuple[str, ...]:
    entry = place.entry
    if not entry.scores:
        blank = [NO_FIGURE for _ in comparison.measures]
        return (place.text, entry.label, "not run", *blank[1:], NO_FIGURE, NO_FIGURE, NO_FIGURE)
    rate = entry.frames_per_s
    return (
        place.text,
        entry.label,
        *(_value(entry, name) for name in comparison.measures),
        f"{entry.failures} of {len(entry.scores)}",
        NO_FIGURE if rate is None else f"{rate:,.0f}" if rate >= 10 else f"{rate:.1f}",
        NO_FIGURE if rate is None else _times(fastest / rate),
    )


def _times(ratio: float) -> str:
    return f"\N{MULTIPLICATION SIGN}{ratio:.2f}" if ratio < 9.95 else f"\N{MULTIPLICATION SIGN}{ratio:,.0f}"


def _value(entry: Entry, measure: str) -> str:
    _, factor, decimals = TITLES.get(measure, ("", 1, 3))
    mean, spread = entry.mean(measure), entry.spread(measure)
    if mean is None:
        return NO_FIGURE
    text = f"{factor * mean:.{decimals}f}"
    return text if spread is None or entry.deterministic else f"{text} ± {factor * spread:.{decimals}f}"


def notes(comparison: Comparison) -> list[str]:
    """What one must know to read the table, and why recipes did not run."""
    several = any(len(entry.scores) > 1 for entry in comparison.entries)
    once = [entry.label for entry in comparison.entries if entry.deterministic and entry.scores]
    failed = (
        "the median IoU over the last tenth of the frames is below 0.1"
        if comparison.kind == "boxes"
        else "a part's median error over its last 25 visible frames exceeds a quarter of the target's size"
    )
    places = [place for place in comparison.places if place.first is not None]
    lines = []
    if several:
        lines.append(
            f"Mean ± standard deviation over {comparison.seeds} seeds; "
            f"ranked by {comparison.measure}, {'less' if less_is_better(comparison.measure) else 'more'} is better."
        )
    else:
        lines.append(f"One run each; ranked by {comparison.measure}.")
    if any(place.first != place.last for place in places):
        lines.append(
            "A rank such as 1\N{EN DASH}2: not distinguishable, the means ± 2 standard errors overlap"
            + ("." if several else "; one seed tells nothing of a difference, give --seeds.")
        )
    lines.append(f"Failed: runs at whose end {failed}.")
    many = comparison.workers > 1
    shared = f" by {comparison.workers} processes, which slow each other down" if many else ""
    lines.append(
        f"Frames/s: the tracker alone, decoding apart, all timed in the same run{shared}; only ratios between rows "
        "mean anything. Time a frame: over that of the fastest."
    )
    if once:
        lines.append(f"Deterministic, run once: {', '.join(once)}.")
    if not comparison.complete:
        lines.append("Interrupted: these are the runs that were complete.")
    lines += [f"{entry.label}: not run: {entry.why}" for entry in comparison.entries if entry.why]
    return lines


# --- for programs ------------------------------------------------------------------------------------------------


def as_csv(comparison: Comparison) -> str:
    """A row a recipe and seed with every figure; a recipe that did not run has one row, which says why."""
    measured = [name for name in MEASURES if any(name in s.figures for e in comparison.entries for s in e.scores)]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["recipe", "seed", "failed", "frames_per_s", *measured, "error"])
    for entry in comparison.entries:
        for score in entry.scores:
            figures = [_plain(score.figures.get(name)) for name in measured]
            writer.writerow([entry.label, score.seed, int(score.failed), f"{score.frames_per_s:.2f}", *figures, ""])
        if entry.why:
            writer.writerow([entry.label, "", "", "", *("" for _ in measured), entry.why])
    return out.getvalue()


def _plain(value: float | None) -> str:
    return "" if value is None else f"{value:.6f}".rstrip("0").rstrip(".")


def as_json(comparison: Comparison) -> str:
    """Everything, with the recipes in full. No time but frames_per_s is in it."""
    from facetrack_cli.recipe.model import to_dict

    places = {place.entry.label: place for place in comparison.places}
    order = [place.entry for place in comparison.places]
    found: dict[str, Any] = {
        "schema": SCHEMA,
        "version": VERSION,
        "facetrack": __version__,
        "clip": str(comparison.clip),
        "truth": str(comparison.truth),
        "seeds": comparison.seeds,
        "ranked_by": comparison.measure,
        "less_is_better": less_is_better(comparison.measure),
        "complete": comparison.complete,
        "notes": notes(comparison),
        "recipes": [
            {
                "label": entry.label,
                "rank": None
                if places[entry.label].first is None
                else [places[entry.label].first, places[entry.label].last],
                "error": entry.why or None,
                "deterministic": entry.deterministic,
                "begins": entry.begins or None,
                "warnings": list(entry.warnings),
                "failures": entry.failures,
                "frames_per_s": _rounded(entry.frames_per_s, 2),
                "mean": {n: _rounded(m) for n in MEASURES if (m := entry.mean(n)) is not None},
                "std": {n: _rounded(s) for n in MEASURES if (s := entry.spread(n)) is not None},
                "runs": [
                    {
                        "seed": score.seed,
                        "failed": score.failed,
                        "frames_per_s": _rounded(score.frames_per_s, 2),
                        **{name: _rounded(value) for name, value in score.figures.items()},
                    }
                    for score in entry.scores
                ],
                "recipe": to_dict(comparison.recipes[entry.label]) if entry.label in comparison.recipes else None,
            }
            for entry in order
        ],
    }
    return json.dumps(found, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _rounded(value: float | None, digits: int = 6) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, digits)
