"""Which part is drawn how, and the strokes that the page is made of."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from facetrack_cli.core.types import Array, Mask, Whole
from facetrack_cli.report.figures.data import alone, beyond, envelope, frame_spans, frames_of, limits
from facetrack_cli.report.figures.style import ABSENT, COLOURS, DASHES, HIDDEN, INK, LOST, clean, line_style
from facetrack_cli.trajectory.table import Series, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from facetrack_cli.evaluation.rows import Pair

MANY = 12  # parts that have a line of their own in every panel
TRACKED = "#D5E4EE"
CORRECTED: dict[str, Any] = {
    "marker": "^", "color": INK, "linestyle": "none", "markersize": 5, "clip_on": False, "zorder": 5,
}  # fmt: skip


@dataclass(frozen=True)
class Panel:
    """A plot of a page: what stands above it, as much of the notes between semicolons as fits; `height` in inches."""

    title: str
    note: str
    height: float
    draw: Callable[[Axes], None]


@dataclass(frozen=True)
class Line:
    """A part, its truth where there is one, and how it is drawn. `group` is the colour of its target."""

    ours: Series
    pair: Pair | None
    name: str
    look: dict[str, Any]
    group: str

    @property
    def colour(self) -> str:
        return str(self.look["color"])


def lines_of(table: Table, pairs: Sequence[Pair]) -> list[Line]:
    """A line for each part.

    Each part of a single target has its own colour; of several targets each has one colour, as in the annotated video,
    and its parts differ by their dashes. More than `MANY` parts of one target run through a range of colours.
    """
    truth = {(p.ours.target, p.ours.part): p for p in pairs}
    targets = table.targets
    several = len(targets) > 1
    places = dict.fromkeys(targets, 0)
    found = []
    for number, s in enumerate(table.series):
        place, nth = targets.index(s.target), places[s.target]
        places[s.target] += 1
        group = COLOURS[place % len(COLOURS)]
        if len(table.series) > MANY:
            ramp = group if several else _ramp(number / (len(table.series) - 1))
            look: dict[str, Any] = {"color": ramp, "linewidth": 0.6, "alpha": 0.75}
        elif several:
            # the targets of a second round of colours would look like those of the first
            dash = DASHES[(nth + place // len(COLOURS)) % len(DASHES)]
            look = {"color": group, "linestyle": dash, "linewidth": 1.2}
        else:
            look = {**line_style(number), "linewidth": 1.2}
        found.append(Line(s, truth.get((s.target, s.part)), _name(s, table), look, group))
    return found


def _name(s: Series, table: Table) -> str:
    """As short as tells the parts apart: of several targets with a part each, the target's name."""
    sole = sum(other.target == s.target for other in table.series) == 1
    if len(table.targets) > 1:
        name = s.target if sole else f"{s.target}/{s.part}"
    else:
        name = s.target if sole and s.part == "box" and s.target else s.part
    return clean(name.replace("_", " "), 40)


def _ramp(share: float) -> str:
    """A colour between purple and yellow-green, dark enough for paper."""
    import matplotlib
    from matplotlib.colors import to_hex

    return to_hex(matplotlib.colormaps["viridis"](0.88 * share))


@dataclass(frozen=True)
class Pen:
    """Draws series over frames: `bins` points along a long one, spans at least `least` frames wide."""

    bins: int
    least: float

    def line(self, axes: Axes, frame: Whole, value: Array, dot: str = ".", **look: Any) -> None:
        """A line, with gaps where a value is unknown; a dot where one stands alone, a wedge where the axis ends.

        Of a long series the whole range is pale and the mean over it strong, so that lines do not hide each other.
        """
        drawn = envelope(frame, value, self.bins)
        x, y = drawn.x, drawn.y
        if drawn.mean_x is None or drawn.mean_y is None:
            axes.plot(x, y, solid_joinstyle="round", **look)
        else:
            axes.plot(x, y, **{**look, "linewidth": 0.7, "alpha": 0.4, "linestyle": "-"})
            axes.plot(drawn.mean_x, drawn.mean_y, **{**look, "linewidth": min(look["linewidth"], 1.0)})
        lonely = alone(y)
        colour, order = look["color"], look.get("zorder", 2)
        if lonely.any():
            fill: dict[str, Any] = {} if dot == "." else {"markerfacecolor": "none", "markeredgewidth": 0.8}
            axes.plot(x[lonely], y[lonely], dot, color=colour, markersize=6, zorder=order, **fill)
        low, high = sorted(axes.get_ylim())
        for outside, place, wedge in zip(beyond(y, low, high), (low, high), "v^", strict=True):
            if outside.any():
                at = np.full(int(outside.sum()), place)
                axes.plot(x[outside], at, wedge, color=colour, markersize=4, clip_on=False, zorder=4)

    def band(self, axes: Axes, frame: Whole, low: Array, high: Array, colour: str, alpha: float) -> None:
        """The area between two lines that are known in the same rows."""
        x, y, *_ = envelope(frame, low, self.bins)
        _, top, *_ = envelope(frame, high, self.bins)
        if len(frame) > 2 * self.bins:  # each bin has its least and its greatest value: the band holds both
            y, top = _pairwise(y, np.fmin), _pairwise(top, np.fmax)
        axes.fill_between(x, y, top, color=colour, alpha=alpha, linewidth=0)

    def shade(self, axes: Axes, rows: Sequence[tuple[Whole, Mask]], colour: str) -> None:
        """Behind everything: pale where any of these rows holds, stronger where all do; of many, where over half do."""
        frame, holds = shares(rows)
        levels = [(holds > 0.5, 0.22)] if len(rows) > MANY else [(holds > 0, 0.16), (holds == 1, 0.22)]
        for mask, alpha in levels[-1:] if len(rows) == 1 else levels:
            for start, end in frame_spans(frame, mask, self.least):
                axes.axvspan(start, end, color=colour, alpha=alpha, linewidth=0, zorder=0.5)

    def status(self, axes: Axes, lines: Sequence[Line]) -> None:
        """A row a part: pale where tracked, vermilion where lost, grey where absent, a diamond where it was given.

        Below it stands what truth says.

        Of many parts there is room for what is lost or absent alone.
        """
        many = len(lines) > MANY
        truth = not many and any(line.pair is not None for line in lines)
        top, tall = (-0.5, 1.0) if many else (-0.4, 0.44) if truth else (-0.38, 0.76)
        for row, line in enumerate(lines):
            s = line.ours
            self._bars(axes, s.frame, (s.status == "tracked") | (s.status == "init"), (row + top, tall), TRACKED)
            self._bars(axes, s.frame, s.status == "lost", (row + top, tall), LOST)
            self._bars(axes, s.frame, s.status == "absent", (row + top, tall), ABSENT)
            if many:
                continue
            if line.pair is not None:
                other = line.pair.truth
                for status, colour in (("hidden", HIDDEN), ("absent", ABSENT)):
                    self._bars(axes, other.frame, other.status == status, (row + 0.1, 0.3), colour)
            starts = s.frame[s.status == "init"]
            if starts.size:
                middle = np.full(len(starts), row + top + tall / 2)
                axes.plot(starts, middle, "D", color=INK, markersize=3, clip_on=False)
        axes.set_ylim(len(lines) - 0.45, -0.55)
        axes.grid(False, axis="y")
        axes.spines["left"].set_visible(False)
        axes.set_yticks([])
        if not many:
            axes.set_yticks(
                [row + top + tall / 2 for row in range(len(lines))], [clean(line.name, 16) for line in lines]
            )
        for label, line in zip(axes.get_yticklabels(), lines, strict=False):
            label.set(fontsize=7.5, color=line.colour)

    def corrections(self, axes: Axes, lines: Sequence[Line]) -> None:
        """Small triangles below the axis of time, at the frames in which something was put right by hand."""
        frames = np.unique(np.concatenate([line.ours.frame[line.ours.corrected] for line in lines]))
        axes.plot(frames, np.zeros(len(frames)), transform=axes.get_xaxis_transform(), **CORRECTED)

    def _bars(self, axes: Axes, frame: Whole, mask: Mask, place: tuple[float, float], colour: str) -> None:
        found = frame_spans(frame, mask, self.least)
        if found:
            bars = [(start, end - start) for start, end in found]
            axes.broken_barh(bars, place, facecolors=colour, linewidth=0, antialiased=False)


def shares(rows: Sequence[tuple[Whole, Mask]]) -> tuple[Whole, Array]:
    """All frames of any series, and the share of those with the frame for which the mask holds in it."""
    frame = frames_of([f for f, _ in rows])
    count, there = np.zeros(len(frame)), np.zeros(len(frame))
    for f, mask in rows:
        at = slice(None) if len(f) == len(frame) else np.searchsorted(frame, f)
        count[at] += mask
        there[at] += 1
    return frame, count / there


def limit(axes: Axes, values: Iterable[Array], floor: float | None = None, ticks: int = 4) -> None:
    """Limits that hold the values, but for a few far outside; few ticks."""
    from matplotlib.ticker import MaxNLocator

    found = limits(values, floor=floor)
    if found is None:
        return
    axes.set_ylim(found)
    places = MaxNLocator(ticks, steps=[1, 2, 2.5, 5, 10]).tick_values(*found)
    inside = [float(place) for place in places if found[0] <= place <= found[1]]
    axes.set_yticks(inside, numbers(inside))


def numbers(ticks: Sequence[float]) -> list[str]:
    """Labels of ticks, all with as many decimals as one of them needs."""
    if any(abs(tick) >= 1e7 for tick in ticks):
        return [f"{tick:.3g}" for tick in ticks]
    decimals = next((d for d in range(4) if all(abs(t - round(t, d)) < 1e-9 for t in ticks)), 4)
    return [f"{tick + 0.0:,.{decimals}f}".replace("-", "\N{MINUS SIGN}") for tick in ticks]


def _pairwise(y: Array, pick: np.ufunc) -> Array:
    """The extreme of each point and the one after it."""
    after = np.append(y[1:], np.nan)
    out = np.asarray(pick(y, after), dtype=np.float64)
    out[np.isnan(y)] = np.nan
    return out


def columns_for(labels: Sequence[str], width: float) -> tuple[int, int]:
    """(columns, rows) of a legend of these labels, filled column by column, over `width` inches."""
    lengths = [len(label) for label in labels]
    for rows in range(1, len(labels)):
        columns = math.ceil(len(labels) / rows)
        # as matplotlib deals them out: the first columns have one more
        widest = [max(column) for column in np.array_split(lengths, columns)]
        if sum(0.068 * most + 0.56 for most in widest) <= width - 0.2:
            return columns, rows
    return 1, len(labels)
