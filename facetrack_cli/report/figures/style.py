"""What all figures share: their style, files of them (equal numbers give equal bytes), axes, and lines over time.

Lines show gaps. matplotlib is loaded with the first figure.
"""

import io
import logging
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from facetrack_cli.core.errors import needed
from facetrack_cli.core.numbers import clock as at_clock
from facetrack_cli.core.numbers import spans, union
from facetrack_cli.core.types import Array, Mask, Whole
from facetrack_cli.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure as Figure
else:  # matplotlib is loaded with the first figure
    Axes = Figure = Any

DPI: Final = 120.0
WIDTH: Final = 10.0  # inches
BINS: Final = 1000  # about the pixels across a panel

# the annotated video's colours (video/overlay.py), in their order, darkened for white paper so that colour-blind
# readers still tell them apart; the dark one, which stands for white, comes last, since the ground truth is dark too
COLOURS: Final = ("#30A2DC", "#C49500", "#00795A", "#BE5CA6", "#2B3FC0", "#222222")
INK: Final = "#222222"
FAINT: Final = "#6B6B6B"
# vermilion is never a line's colour
STATUS: Final = {"tracked": "#D5E4EE", "lost": "#E0480A", "hidden": "#8A8A8A", "absent": "#4A4A4A"}
# where colours run out: solid, dashed, dotted, dash-dotted
DASHES: Final[tuple[Any, ...]] = ("-", (0, (5, 1.8)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)))
TRUTH: Final[Any] = {"color": INK, "linewidth": 0.9, "linestyle": (0, (1, 1.6)), "zorder": 3}
GUIDE: Final[Any] = {"color": FAINT, "linewidth": 0.8, "linestyle": (0, (4, 2.5)), "zorder": 1.5}
CORRECTED: Final[Any] = {
    "marker": "^", "color": INK, "linestyle": "none", "markersize": 5, "clip_on": False, "zorder": 5,
}  # fmt: skip

_STYLE: Final = Path(__file__).with_name("facetrack.mplstyle")


@cache
def need_matplotlib() -> None:
    """UsageError where matplotlib is missing or broken."""
    logging.getLogger("matplotlib.font_manager").setLevel(logging.ERROR)  # that it builds its cache
    with needed("figures", "matplotlib"):
        import matplotlib.font_manager  # noqa: F401 -- builds the cache


@contextmanager
def style() -> Iterator[None]:
    """The settings of all figures, instead of the user's; without warnings of overflow and of missing glyphs."""
    need_matplotlib()
    import matplotlib

    with matplotlib.rc_context(), warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        matplotlib.rc_file(_STYLE)
        yield


def new_figure(width: float, height: float) -> Figure:
    """A figure of `width` x `height` inches, made without pyplot, within `style()`."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=DPI, layout="constrained")


def render(figure: Figure, form: str = "png", *, dpi: float = DPI) -> bytes:
    """The bytes of the figure as png, svg or pdf, without a date."""
    none = {"png": ["Software"], "svg": ["Date", "Creator"], "pdf": ["CreationDate", "Creator", "Producer"]}
    into = io.BytesIO()
    with style():
        from matplotlib.transforms import Bbox

        if (engine := figure.get_layout_engine()) is not None:  # else it is rendered once more
            engine.execute(figure)
            figure.set_layout_engine(None)  # else savefig draws twice, for the engine's sake
            # rounded: the solver of the layout does not give equal last digits each time
            for axes in figure.axes:
                axes.set_position(Bbox(axes.get_position(original=True).get_points().round(6)))
        figure.savefig(into, format=form, dpi=dpi, metadata=dict.fromkeys(none[form]))
    return into.getvalue()


def line_style(index: int) -> dict[str, Any]:
    """Colour and dash of line `index`: all colours solid, then all of them dashed, and so on."""
    turn, place = divmod(index, len(COLOURS))
    return {"color": COLOURS[place], "linestyle": DASHES[turn % len(DASHES)]}


def heading(axes: Axes, title: str, note: str = "") -> None:
    """A title at the top left, and a note in grey at the top right."""
    axes.set_title(title, loc="left")
    axes.set_title(note, loc="right", color=FAINT, size=8, weight="normal")


def clean(text: str, most: int) -> str:
    """A name on one line of at most `most` characters; legends hide names that begin with an underscore."""
    text = "".join(c if c.isprintable() else "?" for c in text)
    text = text if len(text) <= most else text[: most - 1] + "…"
    return f" {text}" if text.startswith("_") else text


def _ticks(most: int, **how: Any) -> Any:
    """Round numbers of an axis, not many more than `most`."""
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(most, steps=(1, 2, 2.5, 5, 10), **how)


def limit(axes: Axes, floor: float | None = None, ticks: int = 4) -> None:
    """The vertical axis of what is drawn, from `floor` on, with few ticks."""
    axes.yaxis.set_major_locator(_ticks(ticks))
    if floor is not None:
        high = axes.get_ylim()[1]
        axes.set_ylim(floor, high + 0.06 * (high - floor))  # a line along the top is whole


def frame_axis(axes: Axes, frame: Whole, most: int = 11) -> None:
    """An axis of frames, which increase, with at most `most` ticks."""
    axes.set_xlim(float(frame[0]) - 0.5, float(frame[-1]) + 0.5)
    axes.set_xlabel("frame")
    axes.xaxis.set_major_locator(_ticks(max(2, most - 1), integer=True, min_n_ticks=1))
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
    axes.tick_params(bottom=True)


def time_axis(axes: Axes, table: Trajectory, most: int) -> None:
    """Above the axis of frames, when these are shown, where that is known."""
    timed = np.isfinite(table.times)
    if timed.any():
        above = axes.secondary_xaxis("top")
        above.xaxis.set_major_locator(_ticks(max(2, most - 1), integer=True, min_n_ticks=1))
        times = partial(np.interp, xp=table.frames[timed], fp=table.times[timed])
        above.xaxis.set_major_formatter(lambda frame, _: at_clock(float(times(frame))))
        above.tick_params(length=2, pad=2)
        above.spines["top"].set_visible(False)


def line(axes: Axes, frame: Whole | Array, value: Array, dot: str = ".", **look: Any) -> None:
    """A line, with gaps where frames or values are missing, and a dot for one alone."""
    x, y = broken(frame, value)
    axes.plot(x, y, **look)
    finite = np.isfinite(np.pad(y, 1, constant_values=np.nan))
    if (lonely := finite[1:-1] & ~finite[:-2] & ~finite[2:]).any():  # without a neighbour a point needs a mark
        fill: dict[str, Any] = {} if dot == "." else {"markerfacecolor": "none", "markeredgewidth": 0.8}
        axes.plot(x[lonely], y[lonely], dot, color=look["color"], markersize=6, **fill)


def band(axes: Axes, frame: Whole | Array, low: Array, high: Array, colour: str, alpha: float) -> None:
    """The area between two lines. matplotlib thins lines that are long, but no areas: these have BINS corners."""
    if len(frame) > 2 * BINS:
        first = np.linspace(0, len(frame), BINS, endpoint=False).astype(np.int64)
        frame, low, high = frame[first], np.fmin.reduceat(low, first), np.fmax.reduceat(high, first)
    x, bottom, top = broken(frame, low, high)
    axes.fill_between(x, bottom, top, color=colour, alpha=alpha, linewidth=0)


def shade(axes: Axes, frame: Whole, mask: Mask, status: str, alpha: float, least: float) -> None:
    """The frames of a mask, behind everything, in the colour of a status; spans are at least `least` frames wide."""
    for start, end in frame_spans(frame, mask, least):
        axes.axvspan(start, end, color=STATUS[status], alpha=alpha, linewidth=0, zorder=0.5)


def broken(frame: Whole | Array, *values: Array) -> list[Array]:
    """Frames and values, (T,) each, with nan where frames are missing, so that a line ends there."""
    before = np.flatnonzero(np.diff(frame) > 1.5 * _step(frame)) + 1
    return [np.insert(each.astype(np.float64), before, np.nan) for each in (frame, *values)]


def _step(frame: Whole | Array) -> float:
    """The usual step between frames."""
    return float(np.median(np.diff(frame))) if len(frame) > 1 else 1.0


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
    levels = []
    for share in shares:
        low = np.floor(share * last).astype(np.int64)
        below, above = (np.take_along_axis(ordered, at[None], 0)[0] for at in (low, np.minimum(low + 1, last)))
        levels.append(below + (share * last - low) * (above - below))
    return levels
