"""The page of `facetrack plot`: what happened in one trajectory, a panel each over one axis of time."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from operator import attrgetter
from pathlib import PurePath
from typing import Any, Final, cast

import numpy as np

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.geometry import iou
from facetrack_cli.core.types import Array, Whole
from facetrack_cli.evaluation.rows import NOT_SEEN, Pair
from facetrack_cli.report.figures import style
from facetrack_cli.report.figures.style import Axes, Figure, Line, Panel
from facetrack_cli.trajectory.diagnostics import AFFINE, EVIDENCE, POSTERIOR, SURE, Diagnostic, Diagnostics
from facetrack_cli.trajectory.face_events import KINDS
from facetrack_cli.trajectory.measures import DEGREES, HAND_MEASURES, MEASURES, Measured
from facetrack_cli.trajectory.trajectory import Trajectory, header_value

USUAL = (
    "mouth_opening", "lips_apart", "mouth_width", "smile", "brow_raise", "eye_opening", "roll", "yaw", "pitch",
)  # fmt: skip
"""The measures of a face on the page."""
_UNIT = (-0.03, 1.06)  # the axis of what is from 0 to 1
Of = Callable[[Trajectory], Array]
_x, _y, _angle, _confidence, _particles, _ess = map(attrgetter, ("x", "y", "angle", "confidence", "particles", "ess"))


def page_figure(
    table: Trajectory, pairs: Sequence[Pair] | None = None, *, title: str | None = None, width: float = style.WIDTH
) -> Figure:
    """Position, size, confidence, status, particles, spread, diagnostics and error over time, as far as known.

    Of more than `MAX_LINES` parts, all panels but position and size show the median, the middle 80 % and the range.

    Parameters
    ----------
    table : the trajectory.
    pairs : its parts with their ground truth, as `match` of evaluation/rows.py makes them.
    title : by default clip and recipe.
    width : in inches.

    Raises
    ------
    InputError : where nothing is known, or there is no row.
    UsageError : without matplotlib, which the extra `plot` brings.
    """
    if not len(table):
        raise InputError(f"{table.path}: has no row that could be drawn")
    with style.style():
        return _Page(table, pairs or (), width).figure(_title(table) if title is None else title)


def measures_figure(table: Trajectory, names: Sequence[str]) -> Figure:
    """Measures over seconds with a band of a standard deviation of their noise, and bars where events of `names` are.

    `names` are measures, tiers of events or their values. An event is shown in the panel of the measure that tells it.
    Raises UsageError for a name that the table has not.
    """
    measures = {name: one for found in table.measures.values() for name, one in found.items()}
    events = [event for event in table.events if {event.tier, event.value} & {*names}]
    by = {word: kind.measures[0] for tier, kind in KINDS.items() for word in (tier, kind.value, kind.longer)}
    rows = list(dict.fromkeys(name if name in measures else by.get(name, name) for name in names))
    if missing := [name for name in rows if name not in measures]:
        choices = [*measures, *(word for word, measure in by.items() if word and measure in measures)]
        others = f"choose among {', '.join(choices)}" if choices else "it has no measures, which the recipe face gives"
        raise UsageError(f"{table.path}: has no {', '.join(missing)}; {others}")
    with style.style():
        figure = style.new_figure(style.WIDTH, 0.7 + 1.3 * len(rows))
        column = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
        for axes, name in zip(column, rows, strict=True):
            measured = {target: each[name] for target, each in table.measures.items() if name in each}
            for k, (target, one) in enumerate(measured.items()):
                colour = style.COLOURS[k % len(style.COLOURS)]
                _, time_s, value, noise = style.broken(one.frame, one.time_s, one.value, np.nan_to_num(one.noise))
                axes.fill_between(time_s, value - noise, value + noise, color=colour, alpha=0.2, linewidth=0)
                axes.plot(time_s, value, color=colour, linewidth=1.2, label=target)
                for event in events:
                    if event.target == target and name in KINDS[event.tier].measures:
                        axes.axvspan(event.begin_s, event.end_s, color=colour, alpha=0.15, linewidth=0)
                        peak = {"markersize": 4, "transform": axes.get_xaxis_transform()}
                        axes.plot(event.peak_s, 1, "v", color=colour, **peak)
            style.heading(axes, name.replace("_", " "), next(iter(measured.values())).unit)
        if len(table.targets) > 1:
            column[0].legend(loc="upper right")
        column[-1].set_xlabel("seconds")
    return figure


def size(s: Trajectory) -> Array:
    """(T,) the root of the area, pixels."""
    return np.asarray(np.sqrt(s.w * s.h))


def spread(s: Trajectory) -> Array:
    """(T,) the standard deviation of both axes together, pixels."""
    return np.asarray(np.hypot(s.std_x, s.std_y))


def error(pair: Pair) -> Array:
    """(T,) distance from the true centre in pixels; nan where either is not known, and where the part is absent."""
    wrong = np.hypot(pair.ours.x - pair.truth.x, pair.ours.y - pair.truth.y)
    return np.where(pair.truth.status == "absent", np.nan, wrong)


def _title(table: Trajectory) -> str:
    clip, name = header_value(table, "source", "path"), header_value(table, "recipe", "name")
    if isinstance(clip, str):
        return PurePath(clip).name + (f", {name}" if isinstance(name, str) else "")
    folder = table.path.resolve().parent.name  # of a run, named after clip and recipe
    return folder if table.path.stem == "trajectory" and folder else table.path.name


class _Page:
    def __init__(self, table: Trajectory, pairs: Sequence[Pair], width: float) -> None:
        self.table, self.width, self.frames = table, width, table.frames
        self.lines = style.lines_of(table, pairs)
        self.paired = [(line, line.pair, error(line.pair)) for line in self.lines if line.pair is not None]
        self.many = len(self.lines) > style.MAX_LINES
        self.least = float(self.frames[-1] - self.frames[0] + 1) / style.BINS  # frames to a pixel
        self.judged = bool((table.status != "").any())
        self.gone = [status for status in ("hidden", "lost", "absent") if (table.status == status).any()]
        self.truth = {status for _, pair, _ in self.paired for status in {*pair.truth.status.tolist()}}
        self.alone = len(self.lines) == 1 and bool(self.paired) and is_known(spread(table))
        self.corrected = np.unique(np.concatenate([line.ours.frame[line.ours.corrected] for line in self.lines]))

    def figure(self, title: str) -> Figure:
        panels = list(self._panels())
        if not panels:
            raise InputError(f"{self.table.path}: has no number that could be drawn in any row")
        legend = self._legend()
        columns, rows = style.columns_for(list(legend), self.width)
        lines = textwrap.wrap("   ·   ".join(self._summary()), int(self.width * 15))
        above = 0.31 + 0.16 * len(lines)
        top = above + 0.185 * rows
        body = sum(panel.height + 0.27 for panel in panels) + 0.55
        figure = style.new_figure(self.width, top + body)
        head, rest = cast("Any", figure.subfigures(2, 1, height_ratios=[top, body]))
        head.text(0.012, 1 - 0.09 / top, style.clean(title, int(self.width * 8)), va="top", weight="bold", size=12)
        head.text(0.012, 1 - 0.31 / top, "\n".join(lines), va="top", size=8.5, color=style.FAINT)
        if legend:
            place = {"loc": "upper left", "bbox_to_anchor": (0.004, 1 - (above - 0.02) / top)}
            spacing = {"handlelength": 2.4, "columnspacing": 1.6, "labelspacing": 0.35}
            head.legend([*legend.values()], [*legend], ncols=columns, **place, **spacing)
        self._stack(rest, panels)
        return figure

    def _stack(self, figure: Any, panels: Sequence[Panel]) -> None:
        heights = {"height_ratios": [panel.height for panel in panels]}
        grid = figure.subplots(len(panels), 1, sharex=True, squeeze=False, gridspec_kw=heights)
        column: list[Axes] = list(grid[:, 0])
        for axes, panel in zip(column, panels, strict=True):
            panel.draw(axes)
            axes.tick_params(bottom=False, left=False)
        if len(self.corrected):  # below the axis of time
            bottom = column[-1].get_xaxis_transform()
            column[-1].plot(self.corrected, 0.0 * self.corrected, transform=bottom, **style.CORRECTED)
        most = max(3, min(11, int(1.1 * self.width)))
        style.frame_axis(column[-1], self.frames, most)
        style.second_axis(column[0], self.table, most)
        for axes, panel in zip(column, panels, strict=True):
            style.heading(axes, panel.title, self._fitting(panel))

    def _fitting(self, panel: Panel) -> str:
        """The first of a panel's notes, as far as they fit."""
        notes = "; ".join(filter(None, panel.notes)).split("; ")
        while notes and len("; ".join(notes)) > (self.width - 1.0) / 0.062 - 1.3 * len(panel.title):
            notes.pop()
        return "; ".join(notes)

    def _legend(self) -> dict[str, Any]:
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        legend: dict[str, Any] = {}
        if not self.many:
            legend |= {line.name: Line2D([], [], **line.look) for line in self.lines}
        for target in self.table.targets if self.many else ():
            group = [line for line in self.lines if line.ours.target == target]
            of = f"{target}: " if len(self.table.targets) > 1 else ""
            what = f"{of}{len(group)} parts, {group[0].ours.part} to {group[-1].ours.part}"
            handle = Line2D([], [], color=group[0].group, linewidth=2)
            legend[style.clean(what if len(group) > 1 else target or group[0].name, 60)] = handle
        if self.paired and not self.many:
            legend["ground truth"] = Line2D([], [], **style.TRUTH)
        legend |= {status: Patch(color=style.STATUS[status], linewidth=0) for status in self.gone}
        if len(self.corrected):
            legend["corrected by hand"] = Line2D([], [], **style.CORRECTED)
        unseen = [status for status in NOT_SEEN if status in self.truth and not self.many]
        return legend | {f"{kind} in the ground truth": Patch(color=style.STATUS[kind], linewidth=0) for kind in unseen}

    def _summary(self) -> list[str]:
        count = len(self.frames)
        words = [f"{count:,} frame{'s' * (count != 1)}"]
        if isinstance(seed := self.table.header.get("seed"), int):
            words.append(f"seed {seed}")
        if self.judged:
            lost = [int((line.ours.status == "lost").sum()) for line in self.lines]
            percent = 100 * sum(lost) / len(self.table)
            share = f"{percent:.0f} %" if percent >= 9.95 else f"{max(percent, 0.1):.1f} %"
            over = "frames" if len(lost) == 1 else f"rows, {sum(map(bool, lost))} of {len(lost)} parts"
            words.append(f"called lost in {share} of {over}" if any(lost) else "never called lost")
        if len(self.corrected):
            words.append(f"corrected by hand in {len(self.corrected):,} of them")
        wrong = [error[~np.isin(pair.truth.status, NOT_SEEN)] for _, pair, error in self.paired]  # as in eval
        if wrong and is_known(every := np.concatenate(wrong)):
            words.append(f"median error {np.nanmedian(every):.2f} px")
        if self.table.header.get("complete") is False:
            words.append("the run was cut short")
        return words

    def _panels(self) -> Iterator[Panel]:
        table, lines, many = self.table, self.lines, self.many
        truth = "dotted: ground truth" if self.paired and not many else ""
        bands = "median, middle 80 % and range of the parts" if many else ""
        if is_known(table.x):
            yield Panel("x (px)", [truth], 1.15, partial(self._values, of=_x))
        if is_known(table.y):
            yield Panel("y (px)", ["up is up in the image", truth], 1.15, partial(self._values, of=_y, down=True))
        if is_known(size(table)):
            sizes = [line.ours for line in lines] + [pair.truth for _, pair, _ in self.paired if not many]
            still = all(_reach(size(s)) < 0.01 for s in sizes)
            notes = ["root of width × height", "constant" if still else truth]
            yield Panel("size (px)", notes, 0.45 if still else 0.85, partial(self._values, of=size, floor=0.0))
        if any(_reach(line.ours.angle) > 0 for line in lines):
            yield Panel("angle (°)", [truth], 0.85, partial(self._values, of=_angle))
        if is_known(table.confidence):
            yield Panel("confidence", [bands, self._shaded(" or ".join(self.gone))], 0.95, self._confidence)
        if self.judged:
            below = "below each row: ground truth" if self.truth & {*NOT_SEEN} else ""
            notes = ["a row a part, from first to last" if many else below]
            tall = max(0.2, min(0.165 * len(lines), 1.5))
            yield Panel("status", notes, tall, self._status)
        if is_known(table.ess):
            grey = many or len({_particles(line.ours).tobytes() for line in lines}) == 1
            behind = f"{'grey' if grey else 'pale'}: particles" if is_known(table.particles) else ""
            yield Panel("effective sample size", [bands, behind, "log scale"], 0.95, self._particles)
        elif is_known(table.particles):
            yield Panel("particles", [], 0.6, self._particles)
        if is_known(spread(table)):
            notes = [bands, "standard deviation of the particles, both axes together"]
            yield Panel("spread (px)", notes, 0.95, partial(self._positive, of=spread))
        for name, unit, formula, *_ in (*MEASURES, *HAND_MEASURES):
            by_target = {target: measured[name] for target, measured in table.measures.items() if name in measured}
            if by_target and name in {*USUAL, *(measure.name for measure in HAND_MEASURES)}:
                title = f"{'pose: ' if unit == DEGREES else ''}{name.replace('_', ' ')} ({unit})"
                notes = ["band: a standard deviation to either side", formula]
                yield Panel(title, notes, 0.7, partial(self._measure, by_target=by_target))
        yield from _reported(table, lines)
        if any(is_known(wrong) for _, _, wrong in self.paired):
            notes = [bands, self._shaded("hidden in the ground truth" if "hidden" in self.truth else "")]
            notes += ["bands: 50 and 90 % by the spread"] if self.alone else []
            yield Panel("error (px)", notes, 1.15, self._error)
        if any(pair.is_box for _, pair, _ in self.paired):
            yield Panel("overlap (IoU)", [bands, "with the true box"], 0.85, self._overlap)

    def _shaded(self, what: str) -> str:
        if not what or self.many:
            return what and f"shaded: more than half {what}"
        return f"shaded: {what}" + (", darker where all are" if len(self.lines) > 1 else "")

    def _values(self, axes: Axes, of: Of, floor: float | None = None, down: bool = False) -> None:
        """A line for each part and its ground truth; `down`: values increase downwards."""
        ours = [of(line.ours) for line in self.lines]
        true = [] if self.many else [of(pair.truth) for _, pair, _ in self.paired]  # of many, it would hide the lines
        for line, value in zip(self.lines, ours, strict=True):
            style.line(axes, line.ours.frame, value, **line.look)
        for (_, pair, _), value in zip(self.paired, true, strict=False):
            style.line(axes, pair.truth.frame, value, dot="o", **style.TRUTH)
        style.limit(axes, floor, 4 if floor is None else 2)
        if down:
            axes.invert_yaxis()

    def _confidence(self, axes: Axes) -> None:
        for status in self.gone:
            self._shade(axes, [line.ours for line in self.lines], status)
        usual = bool(np.nanmin(self.table.confidence) >= 0 and np.nanmax(self.table.confidence) <= 1)
        self._positive(axes, _confidence, _UNIT if usual else None)
        if usual:
            axes.set_yticks([0, 0.5, 1])

    def _shade(self, axes: Axes, parts: Sequence[Trajectory], status: str) -> None:
        """Pale where any part has the status, stronger where all have it; of many parts, where over half have it."""
        frame, held = style.stacked([(part.frame, part.status == status) for part in parts])
        share = np.nanmean(held, axis=0)
        levels = [(share > 0.5, 0.22)] if len(parts) > style.MAX_LINES else [(share > 0, 0.16), (share == 1, 0.22)]
        for mask, alpha in levels[-1:] if len(parts) == 1 else levels:
            style.shade(axes, frame, mask, status, alpha, self.least)

    def _status(self, axes: Axes) -> None:
        """A row a part, a diamond where it was given; below it the status in the ground truth. Many are bars alone."""
        lines, many = self.lines, self.many
        truth = not many and any(line.pair is not None for line in lines)
        top, tall = (-0.5, 1.0) if many else (-0.4, 0.44) if truth else (-0.38, 0.76)
        for row, line in enumerate(lines):
            for status in ("tracked", "hidden", "lost", "absent"):
                self._bars(axes, line.ours, status, (row + top, tall))
            if many:
                continue
            if line.pair is not None:
                for status in ("hidden", "absent"):
                    self._bars(axes, line.pair.truth, status, (row + 0.1, 0.3))
            starts = line.ours.frame[line.ours.status == "init"]
            if starts.size:
                middle = np.full(len(starts), row + top + tall / 2)
                axes.plot(starts, middle, "D", color=style.INK, markersize=3, clip_on=False)
        axes.set_ylim(len(lines) - 0.45, -0.55)
        axes.grid(False, axis="y")
        axes.spines["left"].set_visible(False)
        shown = [] if many else lines
        names = [style.clean(line.name, 16) for line in shown]
        axes.set_yticks([row + top + tall / 2 for row in range(len(shown))], names)
        for label, line in zip(axes.get_yticklabels(), shown, strict=True):
            label.set(fontsize=7.5, color=line.colour)

    def _bars(self, axes: Axes, part: Trajectory, status: str, place: tuple[float, float]) -> None:
        mask = np.isin(part.status, (status, "init") if status == "tracked" else status)
        if intervals := style.frame_spans(part.frame, mask, self.least):
            bars = [(start, end - start) for start, end in intervals]
            axes.broken_barh(bars, place, facecolors=style.STATUS[status], linewidth=0, antialiased=False)

    def _measure(self, axes: Axes, by_target: Mapping[str, Measured]) -> None:
        axes.locator_params(axis="y", nbins=3)
        for target, colour in {
            line.ours.target: line.group for line in self.lines if line.ours.target in by_target
        }.items():
            series = by_target[target]
            style.band(axes, series.frame, series.value - series.std, series.value + series.std, colour, 0.2)
            style.line(axes, series.frame, series.value, color=colour, linewidth=1.2)

    def _particles(self, axes: Axes) -> None:
        from matplotlib.ticker import LogLocator

        counts = [_particles(line.ours) for line in self.lines]
        sampled = is_known(self.table.ess)
        if sampled:  # whether a few are left, or many
            every = np.concatenate([self.table.particles, self.table.ess])
            high = 1.4 * max(2.0, float(np.nanmax(every)))
            low = max(0.8, min(0.7 * float(np.nanmin(every)), high / 15))
            axes.set(yscale="log", ylim=(low, high))
            axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if high < 120 * low else (1,)))
            axes.yaxis.set_major_formatter(lambda value, _: f"{value:,.3g}")
            axes.yaxis.minorticks_off()
        distinct = {value.tobytes(): line for line, value in zip(self.lines, counts, strict=True)}
        for line in distinct.values():
            colour = style.STATUS["hidden"] if len(distinct) == 1 or self.many else line.colour
            look: dict[str, Any] = {"color": colour, "linewidth": 2.2, "alpha": 0.55, "zorder": 1.5}
            style.line(axes, line.ours.frame, _particles(line.ours), **look)
        if sampled:
            self._positive(axes, _ess, axes.get_ylim())
        else:
            style.limit(axes, 0.0, 2)

    def _error(self, axes: Axes) -> None:
        self._shade(axes, [pair.truth for _, pair, _ in self.paired], "hidden")
        if self.alone:
            (line,) = self.lines
            sigma = spread(line.ours) / math.sqrt(2)  # along one axis
            for reach, alpha in ((2.146, 0.16), (1.177, 0.2)):  # radii of a circular normal distribution's 90 and 50 %
                style.band(axes, line.ours.frame, 0 * sigma, reach * sigma, line.colour, alpha)
        self._strokes(axes, [(line, pair.ours.frame, wrong) for line, pair, wrong in self.paired])
        style.limit(axes, 0.0)

    def _overlap(self, axes: Axes) -> None:
        axes.set(ylim=_UNIT, yticks=[0, 0.5, 1])
        boxes = [(line, *pair) for line, pair, _ in self.paired if pair.is_box]
        shares = [np.where(true.status == "absent", np.nan, iou(ours.boxes, true.boxes)) for _, ours, true in boxes]
        self._strokes(axes, [(line, ours.frame, v) for (line, ours, _), v in zip(boxes, shares, strict=True)])

    def _positive(self, axes: Axes, of: Of, ends: tuple[float, float] | None = None) -> None:
        self._strokes(axes, [(line, line.ours.frame, of(line.ours)) for line in self.lines])
        if ends is None:
            style.limit(axes, 0.0)
        else:
            axes.set_ylim(ends)

    def _strokes(self, axes: Axes, shown: Sequence[tuple[Line, Whole, Array]]) -> None:
        """A line each; of many parts the median of each target within bands."""
        if not self.many:
            for line, frame, value in shown:
                style.line(axes, frame, value, **line.look)
            return
        for target in dict.fromkeys(line.ours.target for line, _, _ in shown):
            group = [entry for entry in shown if entry[0].ours.target == target]
            frame, values = style.stacked([entry[1:] for entry in group])
            least, low, middle, high, most = style.quantiles(values, (0.0, 0.1, 0.5, 0.9, 1.0))
            colour = group[0][0].group
            style.band(axes, frame, least, most, colour, 0.14)
            style.band(axes, frame, low, high, colour, 0.28)
            style.line(axes, frame, middle, color=colour, linewidth=1.2)


def _reach(value: Array) -> float:
    """Greatest minus least, of what is known."""
    finite = value[np.isfinite(value)]
    return float(np.ptp(finite)) if finite.size else 0.0


# --- what a tracker reports: identity, and scale, noise and error as in figure 2 of Zhou et al. 2003 -----------------

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


def _reported(table: Trajectory, lines: Sequence[Line]) -> Iterator[Panel]:
    """A panel for each thing that the tracker reports."""
    colours = {line.ours.target: line.group for line in lines}
    identities = [target for target in table.targets if is_known(table.beliefs(target)[2])]
    for target in identities[:MAX_IDENTITY_PANELS]:
        yield _identity(table, target, target if len(colours) > 1 else "")
    reported = {target: values for target, values in table.diagnostics.items() if target in colours}
    declared = {kind.name: kind for each in reported.values() for kind in each.declared if kind.name in each.values}
    for name in [*_LOOK, *(name for name in declared if name not in (*_LOOK, *_ELSEWHERE))]:
        reports = {target: each for target, each in reported.items() if is_known(each.get(name))}
        if reports and name in declared:
            yield _curves(declared[name], reports, colours)


def _curves(diagnostic: Diagnostic, reports: Mapping[str, Diagnostics], colours: Mapping[str, str]) -> Panel:
    title, note, height = _LOOK.get(diagnostic.name, (diagnostic.name, diagnostic.meaning, 0.7))
    people = max(len(each.labels.get(POSTERIOR.name, ())) for each in reports.values())
    undecided = f"undecided among {people}: {np.log(people):.2f}" if people > 1 else ""

    def draw(axes: Axes) -> None:
        for target, each in reports.items():
            for column in np.atleast_2d(each.get(diagnostic.name).T):
                style.line(axes, each.frame, column, color=colours[target], linewidth=1.2)
        # a scale is near 1; what is 0 at best begins there
        style.limit(axes, 0.0 if diagnostic.least == 0 and diagnostic.name != "scale" else None, 3)

    notes = [note, undecided if diagnostic.name == "entropy" else ""]
    return Panel(title + (f" ({diagnostic.unit})" if diagnostic.unit else ""), notes, height, draw)


def _identity(table: Trajectory, target: str, whose: str) -> Panel:
    """A line for each person; the likeliest have a colour and their name, the others are grey."""
    frame, names, values = table.beliefs(target)
    most = np.where(np.isfinite(values), values, -1.0)
    rank: list[int] = np.lexsort((-most.max(axis=0), -np.round(most[-1], 2))).tolist()  # the likeliest at the end first
    leading, best = rank[:MAX_NAMES], names[rank[0]]
    passed, others = table.recognised(target, best), len(names) - len(leading)
    sure = "nobody" if passed is None else style.clean(best, 24)
    sure += f" above {SURE:g}" + ("" if passed is None else f" from frame {passed:,}")
    grey = f"grey: {others} other{'s' * (others != 1)}" if others else ""

    def draw(axes: Axes) -> None:
        axes.set(ylim=(-0.04, 1.08), yticks=[0, 0.5, SURE])
        axes.axhline(SURE, **style.GUIDE)
        if passed is not None:
            axes.axvline(passed, **style.GUIDE)
        for k in rank[MAX_NAMES:]:
            style.line(axes, frame, values[:, k], color=style.STATUS["hidden"], linewidth=0.6, alpha=0.6)
        for turn, k in enumerate(leading):
            colour, label = style.COLOURS[turn % len(style.COLOURS)], style.clean(names[k], 24)
            style.line(axes, frame, values[:, k], color=colour, label=label, linewidth=1.3, zorder=2.5)
        axes.legend(loc="center right")

    kept = target in table.diagnostics and POSTERIOR.name in table.diagnostics[target].labels
    return Panel(POSTERIOR.name if kept else "identity", [style.clean(whose, 24), sure, grey], 1.3, draw)


def is_known(value: Array) -> bool:
    return bool(np.isfinite(value).any())
