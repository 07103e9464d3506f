"""The page of `facetrack plot`: what happened in one trajectory, panel under panel over one axis of time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from operator import attrgetter
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.geometry import iou
from facetrack_cli.core.types import Array
from facetrack_cli.report.figures.data import frames_of, quantiles
from facetrack_cli.report.figures.diagnostics import adaptation, panels
from facetrack_cli.report.figures.lines import CORRECTED, MANY, Line, Panel, Pen, columns_for, limit, lines_of, numbers
from facetrack_cli.report.figures.style import (
    ABSENT,
    FAINT,
    HIDDEN,
    INK,
    LOST,
    WIDTH,
    clean,
    heading,
    new_figure,
    style,
)
from facetrack_cli.report.figures.timeline import set_time
from facetrack_cli.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

    from facetrack_cli.evaluation.rows import Pair

BINS = 1000  # about the pixels across a panel
_TRUTH: dict[str, Any] = {"color": INK, "linewidth": 0.9, "linestyle": (0, (1, 1.6)), "zorder": 3}

Of = Callable[[Trajectory], Array]
_x, _y, _angle, _confidence, _particles, _ess = map(attrgetter, ("x", "y", "angle", "confidence", "particles", "ess"))


def page_figure(
    table: Trajectory, pairs: Sequence[Pair] | None = None, *, title: str | None = None, width: float = WIDTH
) -> Figure:
    """Position, size, confidence, status, particles, spread and error over time: a panel each, of what is known.

    `pairs` (match.py) bring the truth; the title names clip and recipe unless given; `width` is in inches, the height
    follows. Up to `MANY` parts have a line each; of more, all panels but position and size show the median, the middle
    80 % and the whole range over parts. Long tracks are drawn by their envelope (plot_data.py). Raises InputError where
    nothing is known. Of a tracker that adapts there is what it told, too (told.py).
    """
    with style():
        return _Page(table, pairs or (), width).figure(_title(table) if title is None else title)


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


def overlap(pair: Pair) -> Array:
    """(T,) intersection over union with the true box; nan where either is not known, and where the part is absent."""
    found = iou(pair.ours.boxes, pair.truth.boxes)
    return np.where(pair.truth.status == "absent", np.nan, found)


def _title(table: Trajectory) -> str:
    source, recipe = table.header.get("source"), table.header.get("recipe")
    clip = source.get("path") if isinstance(source, dict) else None
    name = recipe.get("name") if isinstance(recipe, dict) else None
    if isinstance(clip, str):
        return PurePath(clip).name + (f", {name}" if isinstance(name, str) else "")
    # trajectory.csv lies in a folder that is named after clip and recipe
    folder = table.path.resolve().parent.name
    return folder if table.path.stem == "trajectory" and folder else table.path.name


class _Page:
    def __init__(self, table: Trajectory, pairs: Sequence[Pair], width: float) -> None:
        self.table, self.width = table, width
        self.lines = lines_of(table, pairs)
        self.pairs = [line.pair for line in self.lines if line.pair is not None]
        self.errors = [error(pair) for pair in self.pairs]
        self.many = len(self.lines) > MANY
        self.frames = frames = frames_of([line.ours.frame for line in self.lines])
        # so many strokes take long and say no more
        bins = max(300, min(BINS, 60_000 // len(self.lines))) if self.many else BINS
        self.pen = Pen(bins, float(frames[-1] - frames[0] + 1) / BINS)
        self.ours_told = any((line.ours.status != "").any() for line in self.lines)
        self.ever_lost, self.ever_absent = self._ever("lost"), self._ever("absent")
        self.corrected = np.unique(np.concatenate([line.ours.frame[line.ours.corrected] for line in self.lines]))

    def figure(self, title: str) -> Figure:
        from matplotlib.legend_handler import HandlerTuple

        panels, foot = self._panels(), adaptation(self.table)
        if not panels:
            raise InputError(f"{self.table.path}: has no number that could be drawn in any row")
        legend = self._legend()
        columns, rows = columns_for(list(legend), self.width)
        said = _wrap(self._summary(), int(self.width * 15))
        above = 0.31 + 0.16 * len(said)
        top = above + 0.185 * rows
        body = sum(panel.height + 0.27 for panel in panels) + 0.55
        below = [] if foot is None else [foot.height + 0.75]
        figure = new_figure(self.width, top + body + sum(below))
        pieces: Any = figure.subfigures(2 + len(below), 1, height_ratios=[top, body, *below])
        head, rest = pieces[:2]
        head.text(0.012, 1 - 0.09 / top, clean(title, int(self.width * 8)), va="top", weight="bold", size=12)
        head.text(0.012, 1 - 0.31 / top, "\n".join(said), va="top", size=8.5, color=FAINT)
        if legend:
            head.legend(
                list(legend.values()),
                list(legend),
                loc="upper left",
                bbox_to_anchor=(0.004, 1 - (above - 0.02) / top),
                ncols=columns,
                handlelength=2.4,
                columnspacing=1.6,
                labelspacing=0.35,
                handler_map={tuple: HandlerTuple(ndivide=None, pad=0)},
            )
        self._stack(rest, panels)
        if foot is not None:  # has an axis of its own
            axes = pieces[2].subplots()
            foot.draw(axes)
            heading(axes, foot.title, self._fitting(foot))
        return figure

    def _stack(self, figure: SubFigure, panels: Sequence[Panel]) -> None:
        heights = {"height_ratios": [panel.height for panel in panels]}
        grid: Any = figure.subplots(len(panels), 1, sharex=True, squeeze=False, gridspec_kw=heights)
        column: list[Axes] = list(grid[:, 0])
        for axes, panel in zip(column, panels, strict=True):
            panel.draw(axes)
            axes.tick_params(bottom=False, left=False)
        if len(self.corrected):
            self.pen.corrections(column[-1], self.lines)
        timed = set_time(column[0], column[-1], self.table, max(3, min(11, int(1.1 * self.width))))
        for axes, panel in zip(column, panels, strict=True):
            heading(axes, panel.title, self._fitting(panel), 13 if timed and axes is column[0] else 0)

    def _legend(self) -> dict[str, Any]:
        """Labels and their handles, in order."""
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        found: dict[str, Any] = {}
        if not self.many:
            found |= {line.name: Line2D([], [], **line.look) for line in self.lines}
        else:
            for target in self.table.targets:
                group = [line for line in self.lines if line.ours.target == target]
                picked = [group[round(i * (len(group) - 1) / 5)] for i in range(6)]
                strokes = tuple(Line2D([], [], color=line.colour, linewidth=2) for line in picked)
                of = f"{target}: " if len(self.table.targets) > 1 else ""
                what = f"{of}{len(group)} parts, {group[0].ours.part} to {group[-1].ours.part}"
                found[clean(what if len(group) > 1 else target or group[0].name, 60)] = strokes
        if self.pairs and not self.many:
            found["truth"] = Line2D([], [], **_TRUTH)
        if self.ever_lost:
            found["lost"] = Patch(color=LOST, linewidth=0)
        if self.ever_absent:
            found["absent"] = Patch(color=ABSENT, linewidth=0)
        if len(self.corrected):
            found["put right by hand"] = Line2D([], [], **CORRECTED)
        for status, colour in (("hidden", HIDDEN), ("absent", ABSENT)) if not self.many else ():
            if any((pair.truth.status == status).any() for pair in self.pairs):
                found[f"{status} in truth"] = Patch(color=colour, linewidth=0)
        return found

    def _fitting(self, panel: Panel) -> str:
        """As much of a panel's note as there is room for."""
        notes, room = panel.note.split("; "), (self.width - 1.0) / 0.062 - 1.3 * len(panel.title)
        while notes and len("; ".join(notes)) > room:
            notes.pop()
        return "; ".join(notes)

    def _summary(self) -> list[str]:
        """What can be said in a line or two, under the title."""
        count = len(self.frames)
        said = [f"{count:,} frame{'s' * (count != 1)}"]
        seed = self.table.header.get("seed")
        if isinstance(seed, int):
            said.append(f"seed {seed}")
        if self.ours_told:
            lost = [int((line.ours.status == "lost").sum()) for line in self.lines]
            percent = 100 * sum(lost) / sum(len(line.ours) for line in self.lines)
            share = f"{percent:.0f} %" if percent >= 9.95 else f"{max(percent, 0.1):.1f} %"
            over = "frames" if len(lost) == 1 else f"rows, {sum(map(bool, lost))} of {len(lost)} parts"
            said.append(f"lost in {share} of {over}" if any(lost) else "never lost")
        if len(self.corrected):
            said.append(f"put right by hand in {len(self.corrected):,} of them")
        if self.pairs:
            # as eval counts: what is hidden stands apart
            seen = [~np.isin(pair.truth.status, ("hidden", "absent")) for pair in self.pairs]
            wrong = np.concatenate([e[rows] for e, rows in zip(self.errors, seen, strict=True)])
            if np.isfinite(wrong).any():
                said.append(f"median error {np.nanmedian(wrong):.2f} px")
        if self.table.header.get("complete") is False:
            said.append("the run was cut short")
        if len(self.frames) > 2 * self.pen.bins:
            said.append(f"pale: range over {round(self.pen.least * BINS / self.pen.bins)} frames, line: their mean")
        return said

    # which panels there are

    def _panels(self) -> list[Panel]:
        found: list[Panel] = []

        def add(there: bool, title: str, notes: Sequence[str], height: float, draw: Callable[[Axes], None]) -> None:
            if there:
                found.append(Panel(title, "; ".join(filter(None, notes)), height, draw))

        truth = "dotted: truth" if self.pairs and not self.many else ""
        bands = "median, middle 80 % and range of the parts" if self.many else ""
        shown = [status for status, ever in (("lost", self.ever_lost), ("absent", self.ever_absent)) if ever]
        lost = self._shaded(" or ".join(shown)) if shown else ""
        sizes = [line.ours for line in self.lines] + [pair.truth for pair in self.pairs if not self.many]
        still = all(_reach(size(s)) < 0.01 for s in sizes)
        turns = any(_reach(line.ours.angle) > 0 for line in self.lines)
        add(self._known(_x), "x (px)", [truth], 1.15, lambda axes: self._values(axes, _x))
        add(self._known(_y), "y (px)", ["up is up in the picture", truth], 1.15, self._y)
        notes = ["root of width × height", "constant" if still else truth]
        add(self._known(size), "size (px)", notes, 0.45 if still else 0.85, lambda axes: self._values(axes, size, 0.0))
        add(turns, "angle (°)", [truth], 0.85, lambda axes: self._values(axes, _angle))
        add(self._known(_confidence), "confidence", [bands, lost], 0.95, self._confidence)
        covered = any(np.isin(pair.truth.status, ("hidden", "absent")).any() for pair in self.pairs)
        tall = max(0.2, min(0.165 * len(self.lines), 1.5))
        said = "a row a part, from first to last" if self.many else "below each row: truth" if covered else ""
        add(self.ours_told, "status", [said], tall, lambda axes: self.pen.status(axes, self.lines))
        counted, ess = self._known(_particles), self._known(_ess)
        alike = len({_particles(line.ours).tobytes() for line in self.lines}) == 1
        add(
            ess,
            "effective sample size",
            [bands, ("grey" if alike or self.many else "pale") + ": particles" if counted else "", "log scale"],
            0.95,
            self._particles,
        )
        add(counted and not ess, "particles", [], 0.6, self._particles)
        notes = [bands, "standard deviation of the particles, both axes together"]
        add(self._known(spread), "spread (px)", notes, 0.95, lambda axes: self._positive(axes, spread))
        found += panels(self.table, self.lines, self.pen)
        measured = any(np.isfinite(wrong).any() for wrong in self.errors)
        add(measured, "error (px)", [bands, *self._said_of_error()], 1.15, self._error)
        boxes = [pair.is_box for pair in self.pairs]
        add(any(boxes), "overlap (IoU)", [bands, "with the true box"], 0.85, self._overlap)
        return found

    def _known(self, of: Of) -> bool:
        return any(bool(np.isfinite(of(line.ours)).any()) for line in self.lines)

    def _ever(self, status: str) -> bool:
        return any(bool((line.ours.status == status).any()) for line in self.lines)

    def _shaded(self, what: str) -> str:
        if self.many:
            return f"shaded: more than half {what}"
        return f"shaded: {what}" + (", darker where all are" if len(self.lines) > 1 else "")

    def _said_of_error(self) -> list[str]:
        hidden = any((pair.truth.status == "hidden").any() for pair in self.pairs)
        return [
            self._shaded("hidden in truth") if hidden else "",
            "" if self._belief() is None else "bands: 50 and 90 % by the spread",
        ]

    # what they show

    def _values(self, axes: Axes, of: Of, floor: float | None = None) -> None:
        """A line for each part, and its truth."""
        ours = [of(line.ours) for line in self.lines]
        true = [] if self.many else [of(pair.truth) for pair in self.pairs]  # of many, truth would hide them
        limit(axes, ours + true, floor, 2 if floor is not None else 4)
        for line, value in zip(self.lines, ours, strict=True):
            self.pen.line(axes, line.ours.frame, value, **line.look)
        for pair, value in zip(self.pairs, true, strict=False):
            self.pen.line(axes, pair.truth.frame, value, dot="o", **_TRUTH)

    def _y(self, axes: Axes) -> None:
        self._values(axes, _y)
        axes.invert_yaxis()

    def _confidence(self, axes: Axes) -> None:
        for ever, status, colour in ((self.ever_lost, "lost", LOST), (self.ever_absent, "absent", ABSENT)):
            if ever:
                self.pen.shade(axes, [(line.ours.frame, line.ours.status == status) for line in self.lines], colour)
        values = np.concatenate([line.ours.confidence for line in self.lines])
        usual = bool(np.nanmin(values) >= 0 and np.nanmax(values) <= 1)
        self._positive(axes, _confidence, (-0.03, 1.06) if usual else None)
        if usual:
            axes.set_yticks([0, 0.5, 1])

    def _particles(self, axes: Axes) -> None:
        from matplotlib.ticker import LogLocator

        counts = [_particles(line.ours) for line in self.lines]
        ess = [_ess(line.ours) for line in self.lines]
        if self._known(_ess):  # what matters is whether a few are left, or many
            every = np.concatenate([*counts, *ess])
            high = 1.4 * max(2.0, float(np.nanmax(every)))
            low = max(0.8, min(0.7 * float(np.nanmin(every)), high / 15))
            axes.set_yscale("log")
            axes.set_ylim(low, high)
            axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if high < 120 * low else (1,)))
            axes.yaxis.set_major_formatter(lambda value, _: numbers([value])[0])
            axes.yaxis.minorticks_off()
        else:
            limit(axes, counts, 0.0, 2)
        distinct = {value.tobytes(): line for line, value in zip(self.lines, counts, strict=True)}
        for line in distinct.values():
            colour = HIDDEN if len(distinct) == 1 or self.many else line.colour
            look: dict[str, Any] = {"color": colour, "linewidth": 2.2, "alpha": 0.55, "zorder": 1.5}
            self.pen.line(axes, line.ours.frame, _particles(line.ours), **look)
        if self._known(_ess):
            self._positive(axes, _ess, axes.get_ylim())

    def _error(self, axes: Axes) -> None:
        hidden = [(pair.truth.frame, pair.truth.status == "hidden") for pair in self.pairs]
        self.pen.shade(axes, hidden, HIDDEN)
        paired = [line for line in self.lines if line.pair is not None]
        shown = [(line, pair.ours, e) for line, pair, e in zip(paired, self.pairs, self.errors, strict=True)]
        limit(axes, self.errors, 0.0)
        belief = self._belief()
        if belief is not None:
            line, sigma = belief
            for reach, alpha in ((2.146, 0.16), (1.177, 0.2)):  # radii of a circular normal distribution's 90 and 50 %
                self.pen.band(axes, line.ours.frame, 0 * sigma, reach * sigma, line.colour, alpha)
        self._strokes(axes, shown)

    def _overlap(self, axes: Axes) -> None:
        axes.set_ylim(-0.03, 1.06)
        axes.set_yticks([0, 0.5, 1])
        paired = ((line, line.pair) for line in self.lines if line.pair is not None)
        self._strokes(axes, [(line, p.ours, overlap(p)) for line, p in paired if p.is_box])

    def _belief(self) -> tuple[Line, Array] | None:
        """Of a single part with truth: its spread along one axis."""
        if len(self.lines) != 1 or not self.pairs or not self._known(spread):
            return None
        return self.lines[0], spread(self.lines[0].ours) / math.sqrt(2)

    def _positive(self, axes: Axes, of: Of, ends: tuple[float, float] | None = None) -> None:
        """Values from 0 up."""
        shown = [(line, line.ours, of(line.ours)) for line in self.lines]
        if ends is None:
            limit(axes, [value for _, _, value in shown], 0.0)
        else:
            axes.set_ylim(ends)
        self._strokes(axes, shown)

    def _strokes(self, axes: Axes, shown: Sequence[tuple[Line, Trajectory, Array]]) -> None:
        """A line each, or of many parts the median of each target within bands."""
        if not self.many:
            for line, s, value in shown:
                self.pen.line(axes, s.frame, value, **line.look)
            return
        for target in dict.fromkeys(s.target for _, s, _ in shown):
            group = [one for one in shown if one[1].target == target]
            frame = frames_of([s.frame for _, s, _ in group])
            matrix = np.full((len(group), len(frame)), np.nan)
            for row, (_, s, value) in zip(matrix, group, strict=True):
                row[slice(None) if len(value) == len(frame) else np.searchsorted(frame, s.frame)] = value
            least, low, middle, high, most = quantiles(matrix, (0.0, 0.1, 0.5, 0.9, 1.0))
            colour = group[0][0].group
            self.pen.band(axes, frame, least, most, colour, 0.14)
            self.pen.band(axes, frame, low, high, colour, 0.28)
            self.pen.line(axes, frame, middle, color=colour, linewidth=1.2)


def _wrap(said: Sequence[str], most: int) -> list[str]:
    """Joined in lines of at most so many characters."""
    lines = [said[0]]
    for one in said[1:]:
        longer = f"{lines[-1]}   ·   {one}"
        lines = [*lines[:-1], longer] if len(longer) <= most else [*lines, one]
    return lines


def _reach(value: Array) -> float:
    """Greatest minus least, of what is known."""
    known = value[np.isfinite(value)]
    return float(np.ptp(known)) if known.size else 0.0
