"""A comparison as a table for people, and as CSV and JSON for programs."""

import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from facetrack_cli.core.numbers import document
from facetrack_cli.evaluation.experiments.compare import Entry, Place, kind_of, less_is_better, rank
from facetrack_cli.evaluation.experiments.sheet import NO_FIGURE, Sheet, clip_name, rounded
from facetrack_cli.evaluation.summary import MEASURES
from facetrack_cli.recipe.model import to_dict

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
    """All that a comparison found. `entries` in the order in which they were asked for."""

    clip: Path
    truth: Path
    seeds: int
    entries: tuple[Entry, ...]
    measure: str
    workers: int = 1
    complete: bool = True

    @property
    def places(self) -> list[Place]:
        return rank(self.entries, self.measure)

    @property
    def measures(self) -> tuple[str, ...]:
        """Those in the table, the one that ranks first."""
        usual = [name for name in TITLES if name.startswith(kind_of(self.entries))]
        return tuple(dict.fromkeys([self.measure, *usual]))

    def sheet(self) -> Sheet:
        """Recipes in their order; those that could not run at the end, and why below."""
        frames = np.concatenate([score.frame for entry in self.entries for score in entry.scores])
        span = f"frames {frames.min()} to {frames.max()}"
        title = f"{clip_name(self.clip)}: {len(self.entries)} recipes on {span}, ground truth {self.truth.name}"
        fastest = max((entry.frames_per_s or 0.0 for entry in self.entries), default=0.0)
        heads = ("rank", "recipe", *map(_head, self.measures), "failed", "frames\nper s", "time a\nframe")
        return Sheet(title, heads, tuple(self._row(place, fastest) for place in self.places), tuple(self.notes()))

    def _row(self, place: Place, fastest: float) -> tuple[str, ...]:
        entry, rate = place.entry, place.entry.frames_per_s
        if not entry.scores:
            return (place.text, entry.label, "not run", *(NO_FIGURE,) * (len(self.measures) + 2))
        return (
            place.text,
            entry.label,
            *(_value(entry, name) for name in self.measures),
            f"{entry.failures} of {len(entry.scores)}",
            NO_FIGURE if rate is None else f"{rate:,.0f}" if rate >= 10 else f"{rate:.1f}",
            NO_FIGURE if rate is None else _times(fastest / rate),
        )

    def notes(self) -> list[str]:
        """What one must know to read the table, and why recipes did not run."""
        several = any(len(entry.scores) > 1 for entry in self.entries)
        once = [entry.label for entry in self.entries if entry.deterministic and entry.scores]
        lines = [f"One run each; ranked by {self.measure}."]
        if several:
            better = "less" if less_is_better(self.measure) else "more"
            over = f"Mean ± standard deviation over {self.seeds} seeds"
            lines = [f"{over}; ranked by {self.measure}, {better} is better."]
        if any(place.first != place.last for place in self.places):
            lines.append(
                "A rank such as 1\N{EN DASH}2: not distinguishable, the means ± 2 standard errors overlap"
                + ("." if several else "; one seed tells nothing of a difference, give --seeds.")
            )
        failed = "a part's median error over its last 25 visible frames exceeds a quarter of the target's size"
        if kind_of(self.entries) == "boxes":
            failed = "the median IoU over the last tenth of the frames is below 0.1"
        lines.append(f"Failed: runs at whose end {failed}.")
        shared = f" by {self.workers} processes, which slow each other down" if self.workers > 1 else ""
        lines.append(
            f"Frames/s: the tracker alone, decoding apart, all timed in the same run{shared}; only ratios between rows "
            "mean anything. Time a frame: over that of the fastest."
        )
        if once:
            lines.append(f"Deterministic, run once: {', '.join(once)}.")
        if not self.complete:
            lines.append("Interrupted: these are the runs that were complete.")
        return lines + [f"{entry.label}: not run: {entry.error}" for entry in self.entries if entry.error]

    def csv(self) -> str:
        """A row a recipe and seed with every figure; a recipe that did not run has one row, which says why."""
        measured = [name for name in MEASURES if any(name in s.figures for e in self.entries for s in e.scores)]
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(["recipe", "seed", "failed", "frames_per_s", *measured, "error"])
        for entry in self.entries:
            for score in entry.scores:
                figures = [_plain(score.figures.get(name)) for name in measured]
                writer.writerow([entry.label, score.seed, int(score.failed), f"{score.frames_per_s:.2f}", *figures, ""])
            if entry.error:
                writer.writerow([entry.label, "", "", "", *("" for _ in measured), entry.error])
        return out.getvalue()

    def json(self) -> str:
        """Everything, with the recipes in full. No time but frames_per_s is in it."""
        fields = {
            "clip": str(self.clip),
            "truth": str(self.truth),
            "seeds": self.seeds,
            "ranked_by": self.measure,
            "less_is_better": less_is_better(self.measure),
            "complete": self.complete,
            "notes": self.notes(),
            "recipes": [self._recipe(place) for place in self.places],
        }
        return document("facetrack-compare", fields, indent=1)

    def _recipe(self, place: Place) -> dict[str, Any]:
        entry = place.entry
        return {
            "label": entry.label,
            "rank": None if place.first is None else [place.first, place.last],
            "error": None if entry.error is None else str(entry.error),
            "deterministic": entry.deterministic,
            "begins": None if entry.start is None else f"{entry.start.origin}, frame {entry.start.frame}",
            "warnings": list(dict.fromkeys(entry.warnings)),
            "failures": entry.failures,
            "frames_per_s": rounded(entry.frames_per_s, 2),
            "mean": {n: rounded(m, 6) for n in MEASURES if (m := entry.mean(n)) is not None},
            "std": {n: rounded(s, 6) for n in MEASURES if (s := entry.spread(n)) is not None},
            "runs": [
                {
                    "seed": score.seed,
                    "failed": score.failed,
                    "frames_per_s": rounded(score.frames_per_s, 2),
                    **{name: rounded(value, 6) for name, value in score.figures.items()},
                }
                for score in entry.scores
            ],
            "recipe": to_dict(entry.recipe) if entry.recipe is not None else None,
        }


def _head(measure: str) -> str:
    title = TITLES.get(measure, (measure.replace(".", ".\n"), 1, 3))[0]
    arrow = "\N{DOWNWARDS ARROW}" if less_is_better(measure) else "\N{UPWARDS ARROW}"
    return f"{title} {arrow}"


def _times(ratio: float) -> str:
    return f"\N{MULTIPLICATION SIGN}{ratio:.2f}" if ratio < 9.95 else f"\N{MULTIPLICATION SIGN}{ratio:,.0f}"


def _value(entry: Entry, measure: str) -> str:
    _, factor, decimals = TITLES.get(measure, ("", 1, 3))
    mean, spread = entry.mean(measure), entry.spread(measure)
    if mean is None:
        return NO_FIGURE
    text = f"{factor * mean:.{decimals}f}"
    return text if spread is None or entry.deterministic else f"{text} ± {factor * spread:.{decimals}f}"


def _plain(value: float | None) -> str:
    return "" if value is None else f"{value:.6f}".rstrip("0").rstrip(".")
