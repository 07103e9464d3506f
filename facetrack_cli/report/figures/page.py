"""The page of `facetrack plot`: what happened in one trajectory, a panel each over one axis of time."""

import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from pathlib import PurePath
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.geometry import iou
from facetrack_cli.core.types import Array, Whole
from facetrack_cli.evaluation.rows import NOT_SEEN, Pair, at
from facetrack_cli.report.figures import style
from facetrack_cli.report.figures.style import Axes, Figure
from facetrack_cli.trajectory.diagnostics import AFFINE, EVIDENCE, POSTERIOR, SURE, Diagnostic
from facetrack_cli.trajectory.measures import DEGREES, HAND_MEASURES, KINDS, MEASURES, Measured
from facetrack_cli.trajectory.trajectory import Trajectory, header_value

USUAL = (
    "mouth_opening", "lips_apart", "mouth_width", "smile", "brow_raise", "eye_opening", "roll", "yaw", "pitch",
)  # fmt: skip
"""The measures of a face on the page."""
MAX_LINES: Final = 12  # parts with a line of their own in every panel
MAX_UNSEEN: Final = 6  # of many parts those whose status is shown
MAX_NAMES: Final = 5  # people with a colour and a name, of more the most likely
MAX_IDENTITY_PANELS: Final = 6  # panels of identities, one for each target
SHARE: Final[dict[str, Any]] = {"ylim": (-0.03, 1.06), "yticks": [0, 0.5, 1]}  # the axis of what is from 0 to 1
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
        page = _Page(table, pairs or ())
        return page.figure(list(page.panels()), _title(table) if title is None else title, width)


def measures_figure(table: Trajectory, names: Sequence[str]) -> Figure:
    """Measures over time in a band of a standard deviation, and bars where events of `names` are.

    `names` are measures, tiers of events or their values. An event is shown in the panel of the measure that tells it.
    Raises UsageError for a name that the table has not.
    """
    there = {name: one for measured in table.measures.values() for name, one in measured.items()}
    words = ((word, kind) for tier, kind in KINDS.items() for word in (tier, kind.value, kind.longer) if word)
    by = {word: kind.measures[0] for word, kind in words}
    wanted = list(dict.fromkeys(name if name in there else by.get(name, name) for name in names))
    if missing := [name or "''" for name in wanted if name not in there]:
        choices = [*there, *(word for word, measure in by.items() if measure in there)]
        others = f"choose among {', '.join(choices)}" if choices else "it has no measures, which the recipe face gives"
        raise UsageError(f"{table.path}: has no {', '.join(missing)}; {others}")
    with style.style():
        page = _Page(table, ())
        panels = [page.measure(name, there[name].unit, 1.0, names) for name in wanted]
        return page.figure(panels, _title(table), style.WIDTH, parts=False)


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
    """(T,) intersection over union with the true box; nan as of `error`."""
    return np.where(pair.truth.status == "absent", np.nan, iou(pair.ours.boxes, pair.truth.boxes))


def is_known(value: Array) -> bool:
    return bool(np.isfinite(value).any())


def _title(table: Trajectory) -> str:
    clip, name = header_value(table, "source", "path"), header_value(table, "recipe", "name")
    if isinstance(clip, str):
        return PurePath(clip).name + (f", {name}" if isinstance(name, str) else "")
    folder = table.path.resolve().parent.name  # of a run, named after clip and recipe
    return folder if table.path.stem == "trajectory" and folder else table.path.name


class Panel(NamedTuple):
    """A plot of a page: its title, a note beside it, its height in inches, and what draws it."""

    title: str
    note: str
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


Curve: TypeAlias = tuple[Line, Whole, Array]  # frames and values (T,)


def lines_of(table: Trajectory, pairs: Sequence[Pair]) -> list[Line]:
    """A line for each part, thin if they are more than `MAX_LINES`. The parts of a single target differ by colour. Of
    several targets each has the colour of the annotated video, and its parts differ by their dashes.
    """
    truth, targets, lines = {pair.ours.names[0]: pair for pair in pairs}, table.targets, list[Line]()
    for place, target in enumerate(targets):
        parts, turn = table.of_target(target), place // len(style.COLOURS)
        for nth, part in enumerate(parts):
            look = style.line_style(nth)
            if len(targets) > 1:  # those of a second round of colours would look like those of the first
                look = style.line_style(place) | {"linestyle": style.DASHES[(nth + turn) % len(style.DASHES)]}
            look |= {"linewidth": 0.6, "alpha": 0.75} if len(table.parts) > MAX_LINES else {"linewidth": 1.2}
            # as short as distinguishes the parts
            name = part.name if len(targets) > 1 else part.part
            if len(parts) == 1 and target and (len(targets) > 1 or part.part == "box"):
                name = target
            group = style.COLOURS[place % len(style.COLOURS)]
            lines.append(Line(part, truth.get(part.names[0]), style.clean(name.replace("_", " "), 40), look, group))
    return lines


class _Page:
    def __init__(self, table: Trajectory, pairs: Sequence[Pair]) -> None:
        self.table, self.frames, self.lines = table, table.frames, lines_of(table, pairs)
        self.paired = [(line, line.pair) for line in self.lines if line.pair is not None]
        self.many = len(self.lines) > MAX_LINES
        self.colours = {line.ours.target: line.group for line in self.lines}
        self.reported = {target: each for target, each in table.diagnostics.items() if target in self.colours}
        self.least = float(self.frames[-1] - self.frames[0] + 1) / style.BINS  # frames to a pixel
        stated = np.concatenate([table.status, *(pair.truth.status for _, pair in self.paired)])
        self.gone = [status for status in ("hidden", "lost", "absent") if status in stated]
        self.corrected = np.unique(np.concatenate([line.ours.frame[line.ours.corrected] for line in self.lines]))

    def figure(self, panels: Sequence[Panel], title: str, width: float, *, parts: bool = True) -> Figure:
        """The panels below a legend, of targets alone where they show no `parts`."""
        if not panels:
            raise InputError(f"{self.table.path}: has no number that could be drawn in any row")
        legend, most = self._legend(parts), max(3, min(11, int(1.1 * width)))
        longest = 0.068 * max(map(len, legend), default=1) + 0.56  # inches; all columns are as wide
        columns = max(1, int((width - 0.2) / longest))
        words = [f"{len(self.frames):,} frame{'s' * (len(self.frames) != 1)}"]
        if (self.table.status != "").any():
            lost = 100 * (self.table.status == "lost").mean()
            words.append(f"called lost in {lost:.3g} % of rows" if lost else "never called lost")
        wrong = [error(pair)[~np.isin(pair.truth.status, NOT_SEEN)] for _, pair in self.paired]  # as in eval
        if wrong and is_known(every := np.concatenate(wrong)):
            words.append(f"median error {np.nanmedian(every):.2f} px")
        words += ["the run was cut short"] * (self.table.header.get("complete") is False)
        about = textwrap.wrap("   ·   ".join(words), int(width * 15))
        above = 0.5 + 0.18 * (len(about) - (-len(legend) // columns))
        figure = style.new_figure(width, above + 0.5 + sum(panel.height + 0.27 for panel in panels))
        figure.suptitle(style.clean(title, int(width * 8)), x=0.012, ha="left", weight="bold", size=12)
        heights = {"height_ratios": [panel.height for panel in panels]}
        column = figure.subplots(len(panels), 1, sharex=True, squeeze=False, gridspec_kw=heights)[:, 0]
        for axes, panel in zip(column, panels, strict=True):
            panel.draw(axes)
            axes.tick_params(bottom=False, left=False)
            style.heading(axes, panel.title, panel.note)
        if len(self.corrected):  # below the axis of time
            bottom = column[-1].get_xaxis_transform()
            column[-1].plot(self.corrected, 0.0 * self.corrected, transform=bottom, **style.CORRECTED)
        style.frame_axis(column[-1], self.frames, most)
        style.time_axis(column[0], self.table, most)
        place: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0, 1 + 0.38 / panels[0].height)}
        look: dict[str, Any] = {"alignment": "left", "title_fontsize": 8.5, "handlelength": 2.4, "borderpad": 0}
        column[0].legend([*legend.values()], [*legend], ncols=columns, title="\n".join(about), **place, **look)
        column[0].get_legend().get_title().set_color(style.FAINT)
        return figure

    def _legend(self, parts: bool) -> dict[str, Any]:
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        legend: dict[str, Any] = {}
        if parts and not self.many:
            legend |= {line.name: Line2D([], [], **line.look) for line in self.lines}
            legend |= {"ground truth": Line2D([], [], **style.TRUTH)} if self.paired else {}
        for target, colour in self.colours.items() if self.many or not parts else ():
            count = len(self.table.of_target(target)) if parts else 1
            name = f"{target}: {count} parts, their median, middle 80 % and range" if count > 1 else target
            legend[style.clean(name, 70)] = Line2D([], [], color=colour, linewidth=2)
        legend |= {status: Patch(color=style.STATUS[status], linewidth=0) for status in self.gone if parts}
        return legend | ({"corrected by hand": Line2D([], [], **style.CORRECTED)} if len(self.corrected) else {})

    def panels(self) -> Iterator[Panel]:
        """A panel for each thing that is known."""
        table, particles = self.table, self.table.particles[np.isfinite(self.table.particles)]
        if is_known(table.x):
            yield Panel("x (px)", "", 1.15, partial(self._places, of=_x))
        if is_known(table.y):
            yield Panel("y (px)", "up is up in the image", 1.15, partial(self._places, of=_y, down=True))
        if is_known(size(table)):
            yield Panel("size (px)", "root of width × height", 0.85, partial(self._places, of=size, floor=0.0))
        if np.nan_to_num(table.angle).any():
            yield Panel("angle (°)", "", 0.85, partial(self._places, of=_angle))
        if is_known(table.confidence):
            yield Panel("confidence", "", 0.95, self._confidence)
        lines, note = self.lines, "below each row: ground truth" if self.paired else ""
        if self.many:
            lines = sorted(filter(self._unseen, lines), key=self._unseen, reverse=True)[:MAX_UNSEEN]
            note = f"of {len(self.lines)} parts those that are seen least{'; ' * bool(note)}{note}"
        if lines and (table.status != "").any():
            yield Panel("status", note, max(0.2, 0.165 * len(lines)), partial(self._status, lines=lines))
        if is_known(table.ess):
            yield Panel("effective sample size", "log scale", 0.95, partial(self._strokes, of=_ess, log=True))
        if particles.size and (np.ptp(particles) or not is_known(table.ess)):
            yield Panel("particles", "", 0.6, partial(self._strokes, of=_particles, floor=0.0))
        if is_known(spread(table)):
            note = "standard deviation of the particles, both axes together"
            yield Panel("spread (px)", note, 0.95, partial(self._strokes, of=spread, floor=0.0))
        measured = {name for measures in table.measures.values() for name in measures}
        for name, unit, *_ in (*MEASURES, *HAND_MEASURES):
            if name in measured & {*USUAL, *(measure.name for measure in HAND_MEASURES)}:
                yield self.measure(name, unit, 0.7)
        yield from self._reported()
        if any(is_known(error(pair)) for _, pair in self.paired):
            yield Panel("error (px)", "", 1.15, self._error)
        if boxes := [(line, pair.ours.frame, overlap(pair)) for line, pair in self.paired if pair.is_box]:
            yield Panel("overlap (IoU)", "with the true box", 0.85, partial(self._draw, curves=boxes, share=True))

    def _places(self, axes: Axes, of: Of, floor: float | None = None, down: bool = False) -> None:
        """A line for each part and its ground truth; `down`: values increase downwards."""
        for line in self.lines:
            style.line(axes, line.ours.frame, of(line.ours), **line.look)
        for _, pair in () if self.many else self.paired:  # of many, it would hide the lines
            style.line(axes, pair.truth.frame, of(pair.truth), dot="o", **style.TRUTH)
        style.limit(axes, floor, 4 if floor is None else 2)
        if down:
            axes.invert_yaxis()

    def _strokes(self, axes: Axes, of: Of, **how: Any) -> None:
        self._draw(axes, [(line, line.ours.frame, of(line.ours)) for line in self.lines], **how)

    def _draw(
        self, axes: Axes, curves: Sequence[Curve], floor: float | None = None, share: bool = False, log: bool = False
    ) -> None:
        """A line each; of many parts each target's median, in bands. An axis from `floor` on, of a `share` to 1."""
        for line, frame, value in () if self.many else curves:
            style.line(axes, frame, value, **line.look)
        for target, colour in self.colours.items() if self.many else ():
            group = [(frame, value) for line, frame, value in curves if line.ours.target == target]
            if not group:
                continue
            frame = np.unique(np.concatenate([frame for frame, _ in group]))
            values = np.array([at(frame, own, value) for own, value in group])
            least, low, middle, high, most = style.quantiles(values, (0.0, 0.1, 0.5, 0.9, 1.0))
            style.band(axes, frame, least, most, colour, 0.14)
            style.band(axes, frame, low, high, colour, 0.28)
            style.line(axes, frame, middle, color=colour, linewidth=1.2)
        if share:
            axes.set(**SHARE)
        elif log:
            from matplotlib.ticker import LogLocator

            axes.set_yscale("log")
            bottom, top = axes.get_ylim()
            axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if top < 120 * bottom else (1,)))  # few ticks
            axes.yaxis.set_major_formatter(lambda value, _: f"{value:,.10g}")
            axes.yaxis.minorticks_off()
        elif floor is not None:
            style.limit(axes, floor)

    def _confidence(self, axes: Axes) -> None:
        for status in self.gone:
            self._shade(axes, [line.ours for line in self.lines], status)
        known = self.table.confidence[np.isfinite(self.table.confidence)]
        self._strokes(axes, _confidence, floor=0.0, share=known.min() >= 0 and known.max() <= 1)

    def _shade(self, axes: Axes, parts: Sequence[Trajectory], status: str) -> None:
        """Pale where any part has the status, stronger where all have it; of many parts, where over half have it."""
        frame = np.unique(np.concatenate([part.frame for part in parts]))
        share = np.nanmean([at(frame, part.frame, part.status == status) for part in parts], axis=0)
        levels = [(share > 0.5, 0.22)] if len(parts) > MAX_LINES else [(share > 0, 0.16), (share == 1, 0.22)]
        for mask, alpha in levels[-1:] if len(parts) == 1 else levels:
            style.shade(axes, frame, mask, status, alpha, self.least)

    def _unseen(self, line: Line) -> float:
        """The share of frames in which a part is not seen."""
        return float(np.isin(line.ours.status, self.gone).mean())

    def _status(self, axes: Axes, lines: Sequence[Line]) -> None:
        """A bar a part, a diamond where it was given; below it the status in the ground truth."""
        truth = bool(self.paired)
        tall = 0.44 if truth else 0.76
        for row, line in enumerate(lines):
            top = row - 0.4 if truth else row - tall / 2
            bars = [(line.ours, status, (top, tall)) for status in style.STATUS]
            if line.pair is not None:
                bars += [(line.pair.truth, status, (row + 0.1, 0.3)) for status in NOT_SEEN]
            for part, status, place in bars:
                mask = np.isin(part.status, (status, "init") if status == "tracked" else status)
                if across := [(a, b - a) for a, b in style.frame_spans(part.frame, mask, self.least)]:
                    axes.broken_barh(across, place, facecolors=style.STATUS[status], linewidth=0, antialiased=False)
            starts = line.ours.frame[line.ours.status == "init"]
            if starts.size:
                middle = np.full(len(starts), top + tall / 2)
                axes.plot(starts, middle, "D", color=style.INK, markersize=3, clip_on=False)
        axes.set_ylim(len(lines) - 0.45, -0.55)
        axes.grid(False, axis="y")
        axes.spines["left"].set_visible(False)
        names = [style.clean(line.name, 24) for line in lines]
        axes.set_yticks(np.arange(len(names)) + (tall / 2 - 0.4 if truth else 0), names, fontsize=7.5)

    def measure(self, name: str, unit: str, height: float, events: Sequence[str] = ()) -> Panel:
        """The panel of a measure, with bars where those of the `events` are that it tells."""
        measured = {target: each[name] for target, each in self.table.measures.items() if name in each}
        title = f"{'pose: ' if unit == DEGREES else ''}{name.replace('_', ' ')} ({unit})"
        draw = partial(self._measure, measured=measured, events=events)
        return Panel(title, "band: a standard deviation", height, draw)

    def _measure(self, axes: Axes, measured: Mapping[str, Measured], events: Sequence[str]) -> None:
        axes.locator_params(axis="y", nbins=3)
        for target, one in measured.items():
            colour = self.colours[target]
            style.band(axes, one.frame, one.value - one.std, one.value + one.std, colour, 0.2)
            style.line(axes, one.frame, one.value, color=colour, linewidth=1.2)
            for event in self.table.events if events else ():
                told = target == event.target and one.name in KINDS[event.tier].measures
                if told and {event.tier, event.value} & {*events}:
                    ends = event.first_frame - 0.5, event.last_frame + 0.5
                    axes.axvspan(*ends, color=colour, alpha=0.15, linewidth=0)

    def _error(self, axes: Axes) -> None:
        self._shade(axes, [pair.truth for _, pair in self.paired], "hidden")
        self._draw(axes, [(line, pair.ours.frame, error(pair)) for line, pair in self.paired], floor=0.0)

    def _reported(self) -> Iterator[Panel]:
        """A panel for each thing that the tracker reports: identities, and diagnostics but those drawn elsewhere."""
        named = [target for target in self.table.targets if is_known(self.table.beliefs(target)[2])]
        for target in named[:MAX_IDENTITY_PANELS]:
            yield Panel("identity", style.clean(target, 24), 1.3, partial(self._identity, target=target))
        for name, kind in {kind.name: kind for each in self.reported.values() for kind in each.declared}.items():
            # evidence says little but as a sum
            elsewhere = name in (POSTERIOR.name, AFFINE.name, EVIDENCE.name)
            if not elsewhere and any(is_known(each.get(name)) for each in self.reported.values()):
                title = name + (f" ({kind.unit})" if kind.unit else "")
                yield Panel(title, kind.meaning, 0.7, partial(self._diagnostic, kind=kind))

    def _diagnostic(self, axes: Axes, kind: Diagnostic) -> None:
        for target, each in self.reported.items():
            for column in np.atleast_2d(each.get(kind.name).T):
                style.line(axes, each.frame, column, color=self.colours[target], linewidth=1.2)
        style.limit(axes, ticks=3)
        axes.set(**SHARE if (kind.least, kind.most) == (0, 1) else {})

    def _identity(self, axes: Axes, target: str) -> None:
        """A line for each person; the likeliest at the end have a colour and their name, the others are grey."""
        frame, names, values = self.table.beliefs(target)
        most = np.where(np.isfinite(values), values, -1.0)
        rank: list[int] = np.lexsort((-most.max(axis=0), -np.round(most[-1], 2))).tolist()
        axes.set(ylim=(-0.04, 1.08), yticks=[0, 0.5, SURE])
        axes.axhline(SURE, **style.GUIDE)
        if (passed := self.table.recognised(target, names[rank[0]])) is not None:
            axes.axvline(passed, **style.GUIDE)
        for k in rank[MAX_NAMES:]:
            style.line(axes, frame, values[:, k], color=style.STATUS["hidden"], linewidth=0.6, alpha=0.6)
        for turn, k in enumerate(rank[:MAX_NAMES]):
            look = style.line_style(turn) | {"label": style.clean(names[k], 24)}
            style.line(axes, frame, values[:, k], linewidth=1.3, zorder=2.5, **look)
        axes.legend(loc="center right")
