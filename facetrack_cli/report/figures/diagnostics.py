"""Diagnostics over time: identity, particles, and scale, noise and error as in figure 2 of Zhou et al. 2003."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from facetrack_cli.core.types import Array, Whole
from facetrack_cli.evaluation.rows import Pair
from facetrack_cli.report.figures.style import COLOURS, GUIDE, STATUS, TRUTH, Axes, Line, Panel, Pen, clean, limit
from facetrack_cli.trajectory.diagnostics import AFFINE, EVIDENCE, POSTERIOR, SURE, Diagnostic, Diagnostics
from facetrack_cli.trajectory.trajectory import Trajectory, header_value

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
            yield _curves(table, declared[name], reports, lines, pen)


def _curves(
    table: Trajectory, diagnostic: Diagnostic, reports: Mapping[str, Diagnostics], lines: Sequence[Line], pen: Pen
) -> Panel:
    colours = {line.ours.target: line.group for line in lines}
    title, note, height = _LOOK.get(diagnostic.name, (diagnostic.name, diagnostic.meaning, 0.7))
    bounds = bounds_of(table) if diagnostic.name == "noise" else None
    ends = () if bounds is None else bounds[:2]
    pairs = [line.pair for line in lines if line.pair is not None and diagnostic.name == "scale"]
    truth = [true for pair in pairs if (true := _true_scale(pair, reports)) is not None]
    notes = [note, "dashed: its bounds" if ends else ""]
    notes += ["dotted: ground truth, root of width × height"] if truth else []
    people = max(len(each.labels.get(POSTERIOR.name, ())) for each in reports.values())
    notes += [f"undecided among {people}: {np.log(people):.2f}"] if diagnostic.name == "entropy" and people > 1 else []

    def draw(axes: Axes) -> None:
        # a scale is near 1; what is 0 at best begins there
        values = [
            *(each.get(diagnostic.name) for each in reports.values()),
            *(value for _, value in truth),
            np.array(ends),
        ]
        limit(axes, values, 0.0 if diagnostic.least == 0 and diagnostic.name != "scale" else None, 3)
        for target, each in reports.items():
            for column in np.atleast_2d(each.get(diagnostic.name).T):
                pen.line(axes, each.frame, column, color=colours[target], linewidth=1.2)
        for end in ends:
            axes.axhline(end, **GUIDE)
        for frame, value in truth:
            pen.line(axes, frame, value, dot="o", **TRUTH)

    return Panel(title + (f" ({diagnostic.unit})" if diagnostic.unit else ""), notes, height, draw)


def bounds_of(table: Trajectory) -> tuple[float, float, float] | None:
    """(least, most, rate) of eta in eq. 13, as the recipe of the run has them; None without them."""
    motion = header_value(table, "recipe", "motion")
    noise = motion.get("noise") if isinstance(motion, Mapping) else None
    values = [noise.get(key) for key in ("least", "most", "rate")] if isinstance(noise, Mapping) else []
    bounds = [float(v) for v in values if isinstance(v, int | float) and not isinstance(v, bool)]
    if len(bounds) != 3 or not np.isfinite(bounds).all() or bounds[2] <= 0:
        return None
    return bounds[0], bounds[1], bounds[2]


def eta(error: Array, least: float, most: float, rate: float) -> Array:
    """Eq. 13: least + (most - least) tanh(error / rate)."""
    return np.asarray(least + (most - least) * np.tanh(error / rate))


def adaptation(table: Trajectory) -> Panel | None:
    """Figure 2(a): eta over the error, and a histogram of the errors of this run; None if there are none."""
    bounds = bounds_of(table)
    reported = [values.get("error") for target, values in table.diagnostics.items() if target in table.targets]
    errors = np.concatenate([np.empty(0), *reported])
    errors = errors[np.isfinite(errors)]
    if bounds is None or not errors.size:
        return None
    least, most, rate = bounds
    # errors far out share the last bar, so that they do not compress the others
    reach = min(max(2 * rate, 1.05 * float(np.quantile(errors, 0.98))), 5 * rate)

    def draw(axes: Axes) -> None:
        counts, edges = np.histogram(np.minimum(errors, reach), 60, (0, reach))
        low, high = min(least, most), max(least, most)
        tall = 0.9 * (high - low or 1.0) / max(int(counts.max()), 1)
        grey = STATUS["hidden"]
        axes.bar(edges[:-1], counts * tall, np.diff(edges), low, align="edge", color=grey, alpha=0.4, linewidth=0)
        x = np.linspace(0, reach, 300)
        axes.plot(x, eta(x, *bounds), color=COLOURS[0], linewidth=1.6)
        for end in (least, most):
            axes.axhline(end, **GUIDE)
        margin = 0.06 * (high - low or 1.0)
        axes.set(xlim=(0, reach), ylim=(low - margin, high + margin), xlabel="error ε")
        axes.set_yticks(sorted({least, most}), [f"{end:.3g}" for end in sorted({least, most})])
        axes.tick_params(bottom=False, left=False)

    middle = np.median(errors)
    notes = [
        f"{least:.3g} + ({most:.3g} \N{MINUS SIGN} {least:.3g}) tanh(ε / {rate:.3g})",
        f"bars: the errors of this run, median {middle:.2f}",
        f"η there {float(eta(middle, least, most, rate)):.2f}",
        *(["last bar: all beyond"] if (errors > reach).any() else []),
    ]
    return Panel("noise η over error ε", notes, 1.15, draw)


def _particles(table: Trajectory, first: Mapping[str, Line], pen: Pen) -> Iterator[Panel]:
    """The number of particles, which the parts of a target share, where it changes."""
    counts = {name: first[name].ours.particles for name in table.targets}
    changing = [name for name, value in counts.items() if is_known(value) and np.ptp(value[np.isfinite(value)]) > 0]
    if not changing:
        return
    settings = header_value(table, "recipe", "filter")
    usual = settings.get("particles") if isinstance(settings, Mapping) else None
    usual = usual if type(usual) is int else None
    means = [f"{clean(n, 20) + ' ' if len(changing) > 1 else ''}{np.nanmean(counts[n]):.0f}" for n in changing[:3]]

    def draw(axes: Axes) -> None:
        limit(axes, [*(counts[name] for name in changing), np.array([usual or np.nan])], 0.0, 3)
        for name in changing:
            pen.line(axes, first[name].ours.frame, counts[name], color=first[name].group, linewidth=1.2)
        if usual is not None:
            axes.axhline(usual, **GUIDE)

    notes = [f"mean {', '.join(means)}", f"dashed: J0 = {usual}" if usual is not None else ""]
    yield Panel("particles", notes, 0.85, draw)


def _identity(table: Trajectory, target: str, pen: Pen, whose: str) -> Panel:
    """A line for each person; the likeliest have a colour and their name, the others are grey."""
    frame, names, values = table.beliefs(target)
    most = np.where(np.isfinite(values), values, -1.0)
    peak = most.max(axis=0)
    rank: list[int] = np.lexsort((-peak, -np.round(most[-1], 2))).tolist()  # the likeliest at the end first
    leading = rank[:MAX_NAMES]
    if len(names) > MAX_NAMES:
        leading = [k for k in leading if peak[k] > 0.1] or leading[:1]
        # and a name that led for a while
        leading += [k for k in rank if k not in leading and peak[k] > 0.5][: MAX_NAMES + 1 - len(leading)]
    others = len(names) - len(leading)
    best = names[leading[0]]
    passed = table.recognised(target, best)
    sure = f"{clean(best, 24)} above {SURE:g} from frame {passed:,}" if passed is not None else f"nobody above {SURE:g}"
    grey = f"grey: {others} other{'s' * (others != 1)}" if others else ""

    def draw(axes: Axes) -> None:
        axes.set_ylim(-0.04, 1.08)
        axes.set_yticks([0, 0.5, SURE], ["0", "0.5", f"{SURE:g}"])
        axes.axhline(SURE, **GUIDE)
        if passed is not None:
            axes.axvline(passed, **GUIDE)
        for k in reversed(rank):
            if k not in leading:
                pen.line(axes, frame, values[:, k], color=STATUS["hidden"], linewidth=0.6, alpha=0.6, zorder=1.6)
        for turn, k in reversed(list(enumerate(leading))):
            pen.line(axes, frame, values[:, k], color=COLOURS[turn % len(COLOURS)], linewidth=1.3, zorder=2.5)
        finite = [values[np.isfinite(values[:, k]), k] for k in leading]
        ends = [float(probability[-1]) if probability.size else 0.0 for probability in finite]
        _labels(axes, ends, [clean(names[k], 24) for k in leading])

    kept = target in table.diagnostics and POSTERIOR.name in table.diagnostics[target].labels
    return Panel(POSTERIOR.name if kept else "identity", [clean(whose, 24), sure, grey], 1.3, draw)


def _labels(axes: Axes, ends: Sequence[float], names: Sequence[str]) -> None:
    """Names at the right of their lines, in their colours, moved apart."""
    from matplotlib.patheffects import withStroke

    order = sorted(range(len(ends)), key=lambda i: (ends[i], -i))
    step, at, top = 0.125, -1.0, 0.92
    places = {}
    for i in order:
        below = ends[i] - 0.09 if ends[i] < 0.85 else min(ends[i] - 0.09, 0.79)  # clear of the dashed line
        at = places[i] = max(below, at + step, 0.06)
    for i in reversed(order):  # too many at the top: all lower
        places[i] = min(places[i], top)
        top = places[i] - step
    look: Any = {"xycoords": ("axes fraction", "data"), "xytext": (-4, 0), "textcoords": "offset points", "zorder": 5}
    look |= {"ha": "right", "va": "center", "path_effects": [withStroke(linewidth=2.5, foreground="white")]}
    for i, name in enumerate(names):
        axes.annotate(name, (1, places[i]), fontsize=8, color=COLOURS[i % len(COLOURS)], **look)


def _true_scale(pair: Pair, reported: Mapping[str, Diagnostics]) -> tuple[Whole, Array] | None:
    """(frames, scale) of the true box relative to the first frame that it shares with the reported scale."""
    ours = reported.get(pair.ours.target)
    if ours is None:
        return None
    true, scale = np.sqrt(pair.truth.w * pair.truth.h), ours.get("scale")
    true = np.where(np.isfinite(true) & (true > 0), true, np.nan)
    _, mine, theirs = np.intersect1d(ours.frame, pair.truth.frame, return_indices=True)
    both = np.flatnonzero(np.isfinite(scale[mine]) & np.isfinite(true[theirs]))
    if not both.size:
        return None
    return pair.truth.frame, true * (scale[mine[both[0]]] / true[theirs[both[0]]])


def is_known(value: Array) -> bool:
    return bool(np.isfinite(value).any())
