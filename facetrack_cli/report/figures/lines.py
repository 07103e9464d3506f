"""Lines over time: how each part is drawn, strokes that show gaps and thin long series, and legends."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from facetrack_cli.core.numbers import spans, union
from facetrack_cli.core.types import Array, Mask, Whole
from facetrack_cli.evaluation.rows import Pair
from facetrack_cli.report.figures.style import COLOURS, DASHES, INK, STATUS, Axes, clean, line_style
from facetrack_cli.trajectory.trajectory import Trajectory

MAX_LINES = 12  # parts with a line of their own in every panel


@dataclass(frozen=True)
class Panel:
    """A plot of a page: its title, notes beside it, drawn as far as they fit, and its height in inches."""

    title: str
    notes: Sequence[str]
    height: float
    draw: Callable[[Axes], None]


@dataclass(frozen=True)
class Line:
    """A part, its ground truth where there is one, and how it is drawn. `group` is the colour of its target."""

    ours: Trajectory
    pair: Pair | None
    name: str
    look: dict[str, Any]
    group: str

    @property
    def colour(self) -> str:
        return str(self.look["color"])


def lines_of(table: Trajectory, pairs: Sequence[Pair]) -> list[Line]:
    """A line for each part. The parts of a single target differ by colour; more than `MAX_LINES` parts share a range of
    colours. Of several targets each has the colour of the annotated video, and its parts differ by their dashes.
    """
    import matplotlib
    from matplotlib.colors import to_hex

    truth, targets = {pair.ours.names[0]: pair for pair in pairs}, table.targets
    nth = {one.names[0]: number for target in targets for number, one in enumerate(table.of_target(target))}
    found = []
    for number, one in enumerate(table.parts):
        place = targets.index(one.target)
        group = COLOURS[place % len(COLOURS)]
        if len(table.parts) > MAX_LINES:
            # between purple and yellow-green, dark enough for paper
            ramp = matplotlib.colormaps["viridis"](0.88 * number / (len(table.parts) - 1))
            colour = group if len(targets) > 1 else to_hex(ramp)
            look: dict[str, Any] = {"color": colour, "linewidth": 0.6, "alpha": 0.75}
        elif len(targets) > 1:
            # the targets of a second round of colours would look like those of the first
            dash = DASHES[(nth[one.names[0]] + place // len(COLOURS)) % len(DASHES)]
            look = {"color": group, "linestyle": dash, "linewidth": 1.2}
        else:
            look = {**line_style(number), "linewidth": 1.2}
        found.append(Line(one, truth.get(one.names[0]), _name(one, table), look, group))
    return found


def _name(one: Trajectory, table: Trajectory) -> str:
    """As short as distinguishes the parts: of several targets with a part each, the target's name."""
    sole, several = len(table.of_target(one.target)) == 1, len(table.targets) > 1
    if sole and (several or (one.part == "box" and one.target)):
        return clean(one.target.replace("_", " "), 40)
    return clean((one.name if several else one.part).replace("_", " "), 40)


@dataclass(frozen=True)
class Pen:
    """Draws series over frames: `bins` points along a long one, spans at least `least` frames wide."""

    bins: int
    least: float

    def line(self, axes: Axes, frame: Whole, value: Array, dot: str = ".", **look: Any) -> None:
        """A line, with gaps where a value is unknown, a dot for one alone, a wedge for one beyond the axis. Of a long
        series the range is pale and the mean strong, so that lines do not hide each other.
        """
        x, y, means = envelope(frame, value, self.bins)
        if means is None:
            axes.plot(x, y, **look)
        else:
            axes.plot(x, y, **{**look, "linewidth": 0.7, "alpha": 0.4, "linestyle": "-"})
            axes.plot(*means, **{**look, "linewidth": min(look["linewidth"], 1.0)})
        lonely, colour = alone(y), look["color"]
        if lonely.any():
            fill: dict[str, Any] = {} if dot == "." else {"markerfacecolor": "none", "markeredgewidth": 0.8}
            axes.plot(x[lonely], y[lonely], dot, color=colour, markersize=6, zorder=look.get("zorder", 2), **fill)
        low, high = sorted(axes.get_ylim())
        for outside, place, wedge in ((y < low, low, "v"), (y > high, high, "^")):
            if outside.any():
                at = np.full(int(outside.sum()), place)
                axes.plot(x[outside], at, wedge, color=colour, markersize=4, clip_on=False, zorder=4)

    def band(self, axes: Axes, frame: Whole, low: Array, high: Array, colour: str, alpha: float) -> None:
        """The area between two lines that are known in the same rows."""
        x, y, _ = envelope(frame, low, self.bins)
        top = envelope(frame, high, self.bins).y
        if len(frame) > 2 * self.bins:  # each bin has its least and its greatest value: the band holds both
            pairs = ((y, np.fmin), (top, np.fmax))
            y, top = (np.where(np.isnan(v), np.nan, pick(v, np.append(v[1:], np.nan))) for v, pick in pairs)
        axes.fill_between(x, y, top, color=colour, alpha=alpha, linewidth=0)

    def shade(self, axes: Axes, frame: Whole, mask: Mask, status: str, alpha: float) -> None:
        """The frames of a mask, behind everything, in the colour of a status."""
        for start, end in frame_spans(frame, mask, self.least):
            axes.axvspan(start, end, color=STATUS[status], alpha=alpha, linewidth=0, zorder=0.5)

    def shade_parts(self, axes: Axes, parts: Sequence[Trajectory], status: str) -> None:
        """Pale where any part has the status, stronger where all have it; of many parts, where over half have it."""
        frame, held = stacked([(one.frame, one.status == status) for one in parts])
        share = np.nanmean(held, axis=0)
        levels = [(share > 0.5, 0.22)] if len(parts) > MAX_LINES else [(share > 0, 0.16), (share == 1, 0.22)]
        for mask, alpha in levels[-1:] if len(parts) == 1 else levels:
            self.shade(axes, frame, mask, status, alpha)

    def status(self, axes: Axes, lines: Sequence[Line]) -> None:
        """A row a part, a diamond where it was given; below it the status in the ground truth. Many are bars alone."""
        many = len(lines) > MAX_LINES
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
                axes.plot(starts, middle, "D", color=INK, markersize=3, clip_on=False)
        axes.set_ylim(len(lines) - 0.45, -0.55)
        axes.grid(False, axis="y")
        axes.spines["left"].set_visible(False)
        shown = [] if many else lines
        axes.set_yticks([row + top + tall / 2 for row in range(len(shown))], [clean(line.name, 16) for line in shown])
        for label, line in zip(axes.get_yticklabels(), shown, strict=True):
            label.set(fontsize=7.5, color=line.colour)

    def _bars(self, axes: Axes, one: Trajectory, status: str, place: tuple[float, float]) -> None:
        mask = np.isin(one.status, (status, "init") if status == "tracked" else status)
        if found := frame_spans(one.frame, mask, self.least):
            bars = [(start, end - start) for start, end in found]
            axes.broken_barh(bars, place, facecolors=STATUS[status], linewidth=0, antialiased=False)


def columns_for(labels: Sequence[str], width: float) -> tuple[int, int]:
    """(columns, rows) of a legend of these labels, filled column by column, over `width` inches."""
    lengths = [len(label) for label in labels]
    for rows in range(1, len(labels)):
        columns = math.ceil(len(labels) / rows)
        widest = [max(column) for column in np.array_split(lengths, columns)]  # as matplotlib deals them out
        if sum(0.068 * most + 0.56 for most in widest) <= width - 0.2:
            return columns, rows
    return 1, len(labels)


def stacked(series: Sequence[tuple[Whole, Array | Mask]]) -> tuple[Whole, Array]:
    """All (T,) frames of K series and their values (K, T), nan where a series does not have the frame."""
    frame = series[0][0]
    if not all(f is frame or np.array_equal(f, frame) for f, _ in series):  # nearly always they are all the same
        frame = np.unique(np.concatenate([f for f, _ in series]))
    values = np.full((len(series), len(frame)), np.nan)
    for row, (f, value) in zip(values, series, strict=True):
        row[slice(None) if len(f) == len(frame) else np.searchsorted(frame, f)] = value
    return frame, values


class Drawn(NamedTuple):
    """A line to draw: (x, y) with nan wherever it is broken; if it is thinned, the (x, y) of its means too."""

    x: Array
    y: Array
    means: tuple[Array, Array] | None = None


def envelope(frame: Whole, value: Array, bins: int) -> Drawn:
    """A line through (T,) values, broken where values or frames are missing. More than two rows a bin are thinned to
    the least and the greatest value in each of `bins` equal spans of frames, so that no peak is lost, and their means.
    """
    known = np.flatnonzero(np.isfinite(value))
    if not known.size:
        return Drawn(np.full(1, np.nan), np.full(1, np.nan))
    reach = 1.5 * _step(frame)
    f, v = frame[known].astype(np.float64), value[known].astype(np.float64)
    if len(frame) <= 2 * bins:
        return Drawn(*_broken(f, v, np.flatnonzero(np.diff(f) > reach) + 1))
    span = (frame[-1] - frame[0] + 1) / bins
    place = ((f - frame[0]) / span).astype(np.int64)
    first = np.flatnonzero(np.diff(place, prepend=-1))
    last = np.append(first[1:], len(f)) - 1
    low, high = np.minimum.reduceat(v, first), np.maximum.reduceat(v, first)
    rising = v[last] >= v[first]
    y = np.stack([np.where(rising, low, high), np.where(rising, high, low)], axis=1).ravel()
    x = np.stack([f[first], f[last]], axis=1).ravel()
    gaps = np.flatnonzero(f[first[1:]] - f[last[:-1]] > reach) + 1
    means = _broken((f[first] + f[last]) / 2, np.add.reduceat(v, first) / (last - first + 1), gaps)
    return Drawn(*_broken(x, y, 2 * gaps), means)


def _broken(x: Array, y: Array, before: Whole) -> tuple[Array, Array]:
    return np.insert(x, before, np.nan), np.insert(y, before, np.nan)


def _step(frame: Whole) -> int:
    """The usual step between frames."""
    return int(np.median(np.diff(frame))) if len(frame) > 1 else 1


def alone(y: Array) -> Mask:
    """(T,) the points of a line without a neighbour, which need a mark to be seen."""
    known = np.isfinite(np.concatenate([[np.nan], y, [np.nan]]))
    lonely: Mask = known[1:-1] & ~known[:-2] & ~known[2:]
    return lonely


def frame_spans(frame: Whole, mask: Mask, least: float = 0.0) -> list[tuple[float, float]]:
    """(start, end) of each span where `mask` holds, half a step wider at either end, and at least `least` frames wide,
    so that one frame of a long clip is seen; spans closer than that become one.
    """
    if not mask.any():
        return []
    half = _step(frame) / 2
    begins, ends = np.array(spans(mask, np.diff(frame) > 3 * half)).T  # missing frames end a span, too
    starts, stops = frame[begins] - half, frame[ends - 1] + half
    wide = np.maximum(least - (stops - starts), 0) / 2
    return union(zip((starts - wide).tolist(), (stops + wide).tolist(), strict=True), least * (1 - 1e-9))


def quantiles(values: Array, shares: Iterable[float]) -> list[Array]:
    """(T,) for each share: as numpy.nanquantile of (K, T) along K, which is a hundred times slower."""
    ordered = np.sort(values, axis=0)  # nan goes to the end
    last = np.maximum(np.isfinite(ordered).sum(axis=0) - 1, 0)
    found = []
    for share in shares:
        low = np.floor(share * last).astype(np.int64)
        below, above = (np.take_along_axis(ordered, at[None], 0)[0] for at in (low, np.minimum(low + 1, last)))
        found.append(below + (share * last - low) * (above - below))
    return found
