"""What a tracker that adapts told over time: who it is, particles, scale, noise, error (Zhou et al. 2003, figure 2)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from facetrack_cli.core.types import Array, Whole
from facetrack_cli.report.figures.lines import Line, Panel, Pen, limit
from facetrack_cli.report.figures.style import COLOURS, FAINT, HIDDEN, INK, clean
from facetrack_cli.trajectory.diagnostics import SURE, Diagnostic, Diagnostics
from facetrack_cli.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from facetrack_cli.evaluation.rows import Pair

NAMED = 5  # people with a colour and a name, of more the most likely
MOST = 6  # targets with a panel each for who they are
_DASHED: dict[str, Any] = {"color": FAINT, "linewidth": 0.8, "linestyle": (0, (4, 2.5)), "zorder": 1.5}
_ELSEWHERE = ("posterior", "affine")  # the panel of identities; the positions of the page
_TRUE_SCALE = "dotted: ground truth, root of width × height"
_TRUTH: dict[str, Any] = {"color": INK, "linewidth": 0.9, "linestyle": (0, (1, 1.6)), "zorder": 3}


def panels(table: Trajectory, lines: Sequence[Line], pen: Pen) -> list[Panel]:
    """The panels of what is reported of the table's targets; none of a tracker that reports nothing."""
    groups = {line.ours.target: line.group for line in reversed(lines)}
    several = len(groups) > 1
    found = list(_counts(table, lines, pen))
    identities = [target for target in table.targets if _known(table.beliefs(target)[2])]
    found += [_who(table, target, pen, target if several else "") for target in identities[:MOST]]
    reported = {target: one for target, one in table.diagnostics.items() if target in groups}
    truths = [true for line in lines if line.pair is not None and (true := _scale(line.pair, reported)) is not None]

    def add(one: Diagnostic) -> None:
        known = {target: each for target, each in reported.items() if _known(each.get(one.name))}
        title, note, height, ends = _LOOK.get(one.name, (one.name, one.meaning, 0.7, None))
        unit = f" ({one.unit})" if one.unit else ""
        bounds = ends(table) if ends is not None else ()
        true = truths if one.name == "scale" else []
        notes = [note, *(["dashed: its bounds"] if bounds else []), *([_TRUE_SCALE] if true else [])]
        if (
            one.name == "entropy"
            and (most := max((len(each.labels.get("posterior", ())) for each in known.values()), default=0)) > 1
        ):
            notes.append(f"undecided among {most}: {np.log(most):.2f}")

        def draw(axes: Axes) -> None:
            # around 1 a scale's changes show best; what is 0 at best begins there
            values = [*(each.get(one.name) for each in known.values()), *(value for _, value in true), np.array(bounds)]
            limit(axes, values, 0.0 if one.least == 0 and one.name != "scale" else None, 3)
            for target, each in known.items():
                for column in np.atleast_2d(each.get(one.name).T):
                    pen.line(axes, each.frame, column, color=groups[target], linewidth=1.2)
            for end in bounds:
                axes.axhline(end, **_DASHED)
            for frame, value in true:
                pen.line(axes, frame, value, dot="o", **_TRUTH)

        if known:
            found.append(Panel(title + unit, "; ".join(filter(None, notes)), height, draw))

    declared = {one.name: one for each in reported.values() for one in each.declared if one.name in each.values}
    order = [*_LOOK, *(name for name in declared if name not in _LOOK)]
    for name in order:
        if name in declared and name not in _ELSEWHERE:
            add(declared[name])
    return found


def bounds_of(header: Mapping[str, Any]) -> tuple[float, float, float] | None:
    """(least, most, rate) of eta in eq. 13, as the recipe of the run has them; None without them."""
    at: Any = header
    for key in ("recipe", "motion", "noise"):
        at = at.get(key) if isinstance(at, Mapping) else None
    if not isinstance(at, Mapping):
        return None
    values = [at.get(key) for key in ("least", "most", "rate")]
    found = [float(v) for v in values if isinstance(v, (int, float)) and not isinstance(v, bool)]
    if len(found) != 3 or not np.isfinite(found).all() or found[2] <= 0:
        return None
    return found[0], found[1], found[2]


def _ends(table: Trajectory) -> tuple[float, ...]:
    bounds = bounds_of(table.header)
    return bounds[:2] if bounds else ()


# title, note, height in inches, and where the axis has lines, of diagnostics that have a look of their own
_LOOK: dict[str, tuple[str, str, float, Callable[[Trajectory], tuple[float, ...]] | None]] = {
    "scale": ("scale", "1 at the start", 0.85, None),
    "noise": ("noise η", "of the motion, relative to its usual", 0.7, _ends),
    "error": ("error ε", "of the prediction; about 1 where the appearance model is right", 0.7, None),
    "entropy": ("entropy", "of the posterior", 0.55, None),
}


def eta(error: Array, least: float, most: float, rate: float) -> Array:
    """Eq. 13: least + (most - least) tanh(error / rate)."""
    return np.asarray(least + (most - least) * np.tanh(error / rate))


def adaptation(table: Trajectory) -> Panel | None:
    """Figure 2(a): eta over the error, and a histogram of where this run's errors fell; None if it tells of none."""
    bounds = bounds_of(table.header)
    targets = table.targets
    reported = [one for target, one in table.diagnostics.items() if target in targets]
    errors = np.concatenate([np.empty(0), *(one.get("error") for one in reported)])
    errors = errors[np.isfinite(errors)]
    if bounds is None or not errors.size:
        return None
    least, most, rate = bounds
    # those far out share the last bar, or they would press all others, and the curve, flat
    reach = min(max(2 * rate, 1.05 * float(np.quantile(errors, 0.98))), 5 * rate)

    def draw(axes: Axes) -> None:
        shares, edges = np.histogram(np.minimum(errors, reach), 60, (0, reach))
        low, high = min(least, most), max(least, most)
        tall = 0.9 * (high - low or 1.0) / max(int(shares.max()), 1)
        axes.bar(edges[:-1], shares * tall, np.diff(edges), low, align="edge", color=HIDDEN, alpha=0.4, linewidth=0)
        x = np.linspace(0, reach, 300)
        axes.plot(x, eta(x, *bounds), color=COLOURS[0], linewidth=1.6)
        for end in (least, most):
            axes.axhline(end, **_DASHED)
        axes.set_xlim(0, reach)
        margin = 0.06 * (high - low or 1.0)
        axes.set_ylim(low - margin, high + margin)
        axes.set_yticks(sorted({least, most}), [f"{end:.3g}" for end in sorted({least, most})])
        axes.set_xlabel("error ε")
        axes.tick_params(bottom=False, left=False)

    middle = np.median(errors)
    notes = [
        f"{least:.3g} + ({most:.3g} \N{MINUS SIGN} {least:.3g}) tanh(ε / {rate:.3g})",
        f"bars: the errors of this run, median {middle:.2f}",
        f"η there {float(eta(middle, least, most, rate)):.2f}",
        *(["last bar: all beyond"] if (errors > reach).any() else []),
    ]
    return Panel("noise η over error ε", "; ".join(notes), 1.15, draw)


def _counts(table: Trajectory, lines: Sequence[Line], pen: Pen) -> Iterator[Panel]:
    """The number of particles, where it changes."""
    first: dict[str, Line] = {}
    for line in lines:  # the parts of a target have the same
        first.setdefault(line.ours.target, line)
    counts = {name: line.ours.particles for name, line in first.items()}
    changing = [name for name, value in counts.items() if _known(value) and np.ptp(value[np.isfinite(value)]) > 0]
    if not changing:
        return
    base = table.header.get("recipe")
    base = base.get("filter") if isinstance(base, Mapping) else None
    usual = base.get("particles") if isinstance(base, Mapping) else None
    usual = usual if type(usual) is int else None
    means = [f"{clean(n, 20) + ' ' if len(changing) > 1 else ''}{np.nanmean(counts[n]):.0f}" for n in changing[:3]]

    def draw(axes: Axes) -> None:
        shown = [counts[name] for name in changing]
        limit(axes, [*shown, np.array([usual or np.nan])], 0.0, 3)
        for name in changing:
            pen.line(axes, first[name].ours.frame, counts[name], color=first[name].group, linewidth=1.2)
        if usual is not None:
            axes.axhline(usual, **_DASHED)

    dashed = f"dashed: J0 = {usual}" if usual is not None else ""
    yield Panel("particles", "; ".join(filter(None, [f"mean {', '.join(means)}", dashed])), 0.85, draw)


def _who(table: Trajectory, target: str, pen: Pen, whose: str) -> Panel:
    """A line for each person; the likeliest have a colour and their name, the others are grey."""
    frame, names, values = table.beliefs(target)
    most = np.where(np.isfinite(values), values, -1.0)
    # of those that ever mattered, the likeliest at the end first
    rank = np.lexsort((-most.max(axis=0), -np.round(most[-1], 2)))
    leading = rank[:NAMED].tolist()
    if len(names) > NAMED:
        leading = [k for k in leading if most[:, k].max() > 0.1] or leading[:1]
        for k in rank.tolist():  # a name that led for a while and then lost is what one looks for
            if k not in leading and most[:, k].max() > 0.5 and len(leading) < NAMED + 1:
                leading.append(k)
    others = len(names) - len(leading)
    best = names[leading[0]]
    passed = table.recognised(target, best)
    sure = f"{clean(best, 24)} above {SURE:g} from frame {passed:,}" if passed is not None else f"nobody above {SURE:g}"
    grey = f"grey: {others} other{'s' * (others != 1)}" if others else ""

    def draw(axes: Axes) -> None:
        axes.set_ylim(-0.04, 1.08)
        axes.set_yticks([0, 0.5, SURE], ["0", "0.5", f"{SURE:g}"])
        axes.axhline(SURE, **_DASHED)
        if passed is not None:
            axes.axvline(passed, **_DASHED)
        for k in rank[::-1].tolist():
            if k not in leading:
                pen.line(axes, frame, values[:, k], color=HIDDEN, linewidth=0.6, alpha=0.6, zorder=1.6)
        for turn, k in reversed(list(enumerate(leading))):
            pen.line(axes, frame, values[:, k], color=COLOURS[turn % len(COLOURS)], linewidth=1.3, zorder=2.5)
        ends = [float(_last(values[:, k])) for k in leading]
        _labels(axes, ends, [clean(names[k], 24) for k in leading])

    title = "posterior" if target in table.diagnostics and table.diagnostics[target].labels else "identity"
    notes = [clean(whose, 24), sure, grey]
    return Panel(title, "; ".join(filter(None, notes)), 1.3, draw)


def _labels(axes: Axes, ends: Sequence[float], names: Sequence[str]) -> None:
    """Names at the right of their lines, in the lines' colours, moved apart until all can be read."""
    from matplotlib.patheffects import withStroke

    order = sorted(range(len(ends)), key=lambda i: (ends[i], -i))
    step, at = 0.125, -1.0
    places = {}
    for i in order:
        below = ends[i] - 0.09 if ends[i] < 0.85 else min(ends[i] - 0.09, 0.79)  # clear of the dashed line
        at = places[i] = max(below, at + step, 0.06)
    over = max(0.0, at - 0.92)  # too many at the top: all of them lower
    for i in reversed(order):
        places[i] -= over
        if i != order[0]:
            over = max(0.0, places[order[order.index(i) - 1]] - (places[i] - step))
    for i, name in enumerate(names):
        axes.annotate(
            name,
            (1, places[i]),
            xycoords=("axes fraction", "data"),
            xytext=(-4, 0),
            textcoords="offset points",
            ha="right",
            va="center",
            fontsize=8,
            color=COLOURS[i % len(COLOURS)],
            path_effects=[withStroke(linewidth=2.5, foreground="white")],
            zorder=5,
        )


def _scale(pair: Pair, reported: Mapping[str, Diagnostics]) -> tuple[Whole, Array] | None:
    """(frames, scale) of the true box relative to the first frame that it shares with the reported scale."""
    ours = reported.get(pair.ours.target)
    if ours is None or not _known(ours.get("scale")):
        return None
    true = np.sqrt(pair.truth.w * pair.truth.h)
    true = np.where(np.isfinite(true) & (true > 0), true, np.nan)
    _, mine, theirs = np.intersect1d(ours.frame, pair.truth.frame, return_indices=True)
    both = np.flatnonzero(np.isfinite(ours.get("scale")[mine]) & np.isfinite(true[theirs]))
    if not both.size:
        return None
    first = both[0]
    return pair.truth.frame, true * (ours.get("scale")[mine][first] / true[theirs][first])


def _last(value: Array) -> float:
    known = value[np.isfinite(value)]
    return float(known[-1]) if known.size else 0.0


def _known(value: Array) -> bool:
    return bool(np.isfinite(value).any())
