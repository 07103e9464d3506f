"""Diagnostics over time: identity, particles, and scale, noise and error as in figure 2 of Zhou et al. 2003."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from facetrack_cli.core.types import Array
from facetrack_cli.report.figures.style import COLOURS, GUIDE, STATUS, Axes, Line, Panel, Pen, clean, limit
from facetrack_cli.trajectory.diagnostics import AFFINE, EVIDENCE, POSTERIOR, SURE, Diagnostic, Diagnostics
from facetrack_cli.trajectory.trajectory import Trajectory

MAX_NAMES = 5  # people with a colour and a name, of more the most likely
MAX_IDENTITY_PANELS = 6  # panels of identities, one for each target
# drawn in the panel of identities and in the positions of the page; evidence says little but as a sum
_ELSEWHERE = (POSTERIOR.name, AFFINE.name, EVIDENCE.name)
# title, note and height in inches of diagnostics that do not have reports of their declaration
_LOOK: Final[Mapping[str, tuple[str, str, float]]] = {
    "scale": ("scale", "1 at the start", 0.85),
    "noise": ("noise η", "of the motion, relative to its usual", 0.7),
    "error": ("error ε", "of the prediction; about 1 where the appearance model is right", 0.7),
    "entropy": ("entropy", "of the posterior", 0.55),
}


def panels(table: Trajectory, lines: Sequence[Line], pen: Pen) -> Iterator[Panel]:
    """A panel for each thing that the tracker reports."""
    first = {line.ours.target: line for line in reversed(lines)}
    yield from _particles(table, first, pen)
    identities = [target for target in table.targets if is_known(table.beliefs(target)[2])]
    for target in identities[:MAX_IDENTITY_PANELS]:
        yield _identity(table, target, pen, target if len(first) > 1 else "")
    reported = {target: values for target, values in table.diagnostics.items() if target in first}
    declared = {kind.name: kind for each in reported.values() for kind in each.declared if kind.name in each.values}
    for name in [*_LOOK, *(name for name in declared if name not in (*_LOOK, *_ELSEWHERE))]:
        reports = {target: each for target, each in reported.items() if is_known(each.get(name))}
        if reports and name in declared:
            yield _curves(declared[name], reports, lines, pen)


def _curves(diagnostic: Diagnostic, reports: Mapping[str, Diagnostics], lines: Sequence[Line], pen: Pen) -> Panel:
    colours = {line.ours.target: line.group for line in lines}
    title, note, height = _LOOK.get(diagnostic.name, (diagnostic.name, diagnostic.meaning, 0.7))
    people = max(len(each.labels.get(POSTERIOR.name, ())) for each in reports.values())
    undecided = f"undecided among {people}: {np.log(people):.2f}" if people > 1 else ""

    def draw(axes: Axes) -> None:
        for target, each in reports.items():
            for column in np.atleast_2d(each.get(diagnostic.name).T):
                pen.line(axes, each.frame, column, color=colours[target], linewidth=1.2)
        # a scale is near 1; what is 0 at best begins there
        limit(axes, 0.0 if diagnostic.least == 0 and diagnostic.name != "scale" else None, 3)

    notes = [note, undecided if diagnostic.name == "entropy" else ""]
    return Panel(title + (f" ({diagnostic.unit})" if diagnostic.unit else ""), notes, height, draw)


def _particles(table: Trajectory, first: Mapping[str, Line], pen: Pen) -> Iterator[Panel]:
    """The number of particles, which the parts of a target share, where it changes."""
    counts = {name: first[name].ours.particles for name in table.targets}
    changing = [name for name, value in counts.items() if is_known(value) and np.ptp(value[np.isfinite(value)]) > 0]
    means = [f"{clean(n, 20) + ' ' if len(changing) > 1 else ''}{np.nanmean(counts[n]):.0f}" for n in changing[:3]]

    def draw(axes: Axes) -> None:
        for name in changing:
            pen.line(axes, first[name].ours.frame, counts[name], color=first[name].group, linewidth=1.2)
        limit(axes, 0.0, 3)

    if changing:
        yield Panel("particles", [f"mean {', '.join(means)}"], 0.85, draw)


def _identity(table: Trajectory, target: str, pen: Pen, whose: str) -> Panel:
    """A line for each person; the likeliest have a colour and their name, the others are grey."""
    frame, names, values = table.beliefs(target)
    most = np.where(np.isfinite(values), values, -1.0)
    rank: list[int] = np.lexsort((-most.max(axis=0), -np.round(most[-1], 2))).tolist()  # the likeliest at the end first
    leading, best = rank[:MAX_NAMES], names[rank[0]]
    passed, others = table.recognised(target, best), len(names) - len(leading)
    sure = f"{clean(best, 24)} above {SURE:g} from frame {passed:,}" if passed is not None else f"nobody above {SURE:g}"
    grey = f"grey: {others} other{'s' * (others != 1)}" if others else ""

    def draw(axes: Axes) -> None:
        axes.set(ylim=(-0.04, 1.08), yticks=[0, 0.5, SURE])
        axes.axhline(SURE, **GUIDE)
        if passed is not None:
            axes.axvline(passed, **GUIDE)
        for k in rank[MAX_NAMES:]:
            pen.line(axes, frame, values[:, k], color=STATUS["hidden"], linewidth=0.6, alpha=0.6)
        for turn, k in enumerate(leading):
            look: dict[str, Any] = {"color": COLOURS[turn % len(COLOURS)], "label": clean(names[k], 24)}
            pen.line(axes, frame, values[:, k], linewidth=1.3, zorder=2.5, **look)
        axes.legend(loc="center right")

    kept = target in table.diagnostics and POSTERIOR.name in table.diagnostics[target].labels
    return Panel(POSTERIOR.name if kept else "identity", [clean(whose, 24), sure, grey], 1.3, draw)


def is_known(value: Array) -> bool:
    return bool(np.isfinite(value).any())
