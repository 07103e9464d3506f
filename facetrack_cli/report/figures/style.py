"""The style of all figures, files of them (equal numbers give equal bytes), axes: limits, ticks, frames and seconds."""

from __future__ import annotations

import contextlib
import io
import logging
import os
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from facetrack_cli.core.errors import needed
from facetrack_cli.core.types import Array, Whole
from facetrack_cli.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure as Figure
else:  # matplotlib is loaded with the first figure
    Axes = Figure = Any

DPI: Final = 120.0
WIDTH: Final = 10.0  # inches

# the annotated video's colours (video/overlay/marks.py), in their order, darkened for white paper so that colour-blind
# readers still tell them apart; the dark one, which stands for white, comes last, since the ground truth is dark too
COLOURS: Final = ("#30A2DC", "#C49500", "#00795A", "#BE5CA6", "#2B3FC0", "#222222")
INK: Final = "#222222"
FAINT: Final = "#6B6B6B"
GRID: Final = "#E3E3E3"
# vermilion is never a line's colour
STATUS: Final = {"tracked": "#D5E4EE", "lost": "#E0480A", "hidden": "#8A8A8A", "absent": "#4A4A4A"}
# where colours run out: solid, dashed, dotted, dash-dotted
DASHES: Final[tuple[Any, ...]] = ("-", (0, (5, 1.8)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)))
TRUTH: Final[Any] = {"color": INK, "linewidth": 0.9, "linestyle": (0, (1, 1.6)), "zorder": 3}
GUIDE: Final[Any] = {"color": FAINT, "linewidth": 0.8, "linestyle": (0, (4, 2.5)), "zorder": 1.5}
CORRECTED: Final[Any] = {
    "marker": "^", "color": INK, "linestyle": "none", "markersize": 5, "clip_on": False, "zorder": 5,
}  # fmt: skip

_STEPS = (1, 2, 2.5, 5, 10)
_SECONDS = (
    0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 18000, 36000,
)  # fmt: skip
_STYLE: Final = Path(__file__).with_name("facetrack.mplstyle")


@cache
def need_matplotlib() -> None:
    """UsageError where matplotlib is missing or broken. What it logs on its first import changes no figure."""
    log = logging.getLogger("matplotlib")
    before = log.level
    log.setLevel(logging.ERROR)
    backend = os.environ.pop("MPLBACKEND", None)  # none is needed, and a wrong one stops the import
    try:
        with needed("figures", "matplotlib"):
            import matplotlib.font_manager  # builds the cache

        if backend is not None:
            with contextlib.suppress(ValueError):
                matplotlib.rcParams["backend"] = backend
    finally:
        log.setLevel(before)
        if backend is not None:
            os.environ["MPLBACKEND"] = backend


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
        _lay_out(figure)
        figure.savefig(into, format=form, dpi=dpi, metadata=dict.fromkeys(none[form]))
    return into.getvalue()


def _lay_out(figure: Figure) -> None:
    """Place everything, rounded: the solver of the layout does not give equal last digits each time."""
    from matplotlib.transforms import Bbox

    engine = figure.get_layout_engine()
    if engine is None:  # it is rendered once more
        return
    engine.execute(figure)
    figure.set_layout_engine(None)  # else savefig draws twice, for the engine's sake
    for axes in figure.axes:
        axes.set_position(Bbox(axes.get_position(original=True).get_points().round(6)))
    below = list(figure.subfigs)
    while below:
        part = below.pop()
        part.bbox_relative.set_points(part.bbox_relative.get_points().round(6))
        below += part.subfigs


def line_style(index: int) -> dict[str, Any]:
    """Colour and dash of line `index`: all colours solid, then all of them dashed, and so on."""
    turn, place = divmod(index, len(COLOURS))
    return {"color": COLOURS[place], "linestyle": DASHES[turn % len(DASHES)]}


def heading(axes: Axes, title: str, note: str = "", above: float = 0.0) -> None:
    """A title at the top left, `above` points higher, and after it a note in grey."""
    from matplotlib.offsetbox import AnchoredOffsetbox, HPacker, TextArea
    from matplotlib.transforms import ScaledTranslation

    words: list[Any] = [TextArea(title, textprops={"weight": "bold", "color": INK, "size": 9})]
    if note:
        words.append(TextArea(note, textprops={"color": FAINT, "size": 8}))
    figure = axes.get_figure(root=True)
    assert figure is not None
    box = AnchoredOffsetbox(
        loc="lower left",
        child=HPacker(children=words, align="baseline", pad=0, sep=6),
        pad=0,
        borderpad=0.25,
        frameon=False,
        bbox_to_anchor=(0, 1),
        bbox_transform=axes.transAxes + ScaledTranslation(0, above / 72, figure.dpi_scale_trans),
    )
    axes.add_artist(box)


def clean(text: str, most: int) -> str:
    """A name on one line of at most `most` characters; legends hide names that begin with an underscore."""
    text = "".join(c if c.isprintable() else "?" for c in text)
    text = text if len(text) <= most else text[: most - 1] + "…"
    return f" {text}" if text.startswith("_") else text


def limit(axes: Axes, values: Iterable[Array], floor: float | None = None, ticks: int = 4) -> None:
    """The `limits` of the vertical axis, with few ticks."""
    from matplotlib.ticker import MaxNLocator

    found = limits(values, floor)
    if found is None:
        return
    axes.set_ylim(found)
    places = MaxNLocator(ticks, steps=_STEPS).tick_values(*found)
    inside = [float(place) for place in places if found[0] <= place <= found[1]]
    axes.set_yticks(inside, numbers(inside))


def limits(values: Iterable[Array], floor: float | None = None) -> tuple[float, float] | None:
    """Limits a little wider than `values`, at least 1 apart, None where nothing is known. Where the whole range is over
    eight times that of the middle 98 %, they follow the middle: a few rows far outside do not compress the others.
    """
    every = np.concatenate([v[np.isfinite(v)] for v in values] or [np.empty(0)])
    if not every.size:
        return None
    low, high = float(every.min()), float(every.max())
    middle = np.quantile(every[:: max(1, len(every) // 500_000)], (0.01, 0.99))
    tall = max(float(middle[1] - middle[0]), 1.0)
    if high - low > 8 * tall:
        low, high = max(low, float(middle[0]) - tall), min(high, float(middle[1]) + tall)
    if floor is not None:
        high += max(1.0 - (high - floor), 0)
        return floor, high + 0.06 * (high - floor)
    short = max(1.0 - (high - low), 0) / 2
    low, high = low - short, high + short
    margin = 0.06 * (high - low)
    return low - margin, high + margin


def numbers(ticks: Sequence[float]) -> list[str]:
    """Labels of ticks, with as many decimals as one of them needs."""
    if any(abs(tick) >= 1e7 for tick in ticks):
        return [f"{tick:.3g}" for tick in ticks]
    decimals = next((d for d in range(4) if all(abs(t - round(t, d)) < 1e-9 for t in ticks)), 4)
    return [f"{tick + 0.0:,.{decimals}f}".replace("-", "\N{MINUS SIGN}") for tick in ticks]


def frame_axis(axes: Axes, frame: Whole, most: int = 11) -> None:
    """An axis of frames, which increase, with at most `most` ticks."""
    from matplotlib.ticker import MaxNLocator

    first, last = float(frame[0]), float(frame[-1])
    margin = max(0.5, 0.004 * (last - first), 1e-9 * last)
    axes.set_xlim(first - margin, last + margin)
    axes.set_xlabel("frame")
    axes.xaxis.set_major_locator(MaxNLocator(max(2, most - 1), integer=True, min_n_ticks=1, steps=_STEPS))
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
    axes.tick_params(bottom=True)


def second_axis(axes: Axes, table: Trajectory, most: int) -> bool:
    """An axis of seconds above that of frames; False where seconds are not known or do not increase."""
    time_s = table.times
    known = np.isfinite(time_s)
    if known.sum() < 2 or (np.diff(time_s[known]) <= 0).any():
        return False
    above = axes.secondary_xaxis("top")
    above.set_ticks(*ticks(table.frames[known], time_s[known], most))
    above.tick_params(length=2, pad=2)
    above.spines["top"].set_visible(False)
    return True


def ticks(frame: Whole, time_s: Array, most: int = 11) -> tuple[list[float], list[str]]:
    """About `most` frames at round times, and their labels: 1.5 s, 2:30 (minutes), 1:02:30 (hours)."""
    first, last = float(time_s[0]), float(time_s[-1])
    length = last - first
    step = next((s for s in _SECONDS if length / s <= most), 36000.0 * np.ceil(length / 36000 / most))
    seconds = np.arange(np.ceil(first / step - 1e-9), np.floor(last / step + 1e-9) + 1) * step + 0.0  # no minus zero
    places = np.interp(seconds, time_s, frame).tolist()
    if last < 120 or step < 1:
        decimals = 0 if step >= 1 else 1 if step >= 0.1 else 2
        return places, [f"{t:,.{decimals}f} s" for t in seconds.tolist()]
    whole = [round(t) for t in seconds.tolist()]
    if last < 3600:
        return places, [f"{t // 60}:{t % 60:02}" for t in whole]
    return places, [f"{t // 3600}:{t // 60 % 60:02}:{t % 60:02}" for t in whole]
