"""Figures that set recipes, runs and seeds side by side. Axes: S seeds, T frames, n thresholds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from facetrack_cli.core.types import Array, Mask, Whole
from facetrack_cli.evaluation.trust import Trust
from facetrack_cli.report.figures.data import envelope, frame_spans, quantiles
from facetrack_cli.report.figures.lines import columns_for, limit
from facetrack_cli.report.figures.style import (
    COLOURS,
    FAINT,
    HIDDEN,
    INK,
    LOST,
    clean,
    heading,
    line_style,
    new_figure,
    style,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Curves = Mapping[str, tuple[Array, Array]]
BINS = 1000
SQUARE = (6.4, 4.6)  # inches, with the legend beside
WIDE = (10.0, 4.0)


def success_figure(curves: Curves, *, title: str = "Success") -> Figure:
    """Share of frames whose overlap with the truth is above a threshold, for each recipe.

    `curves` are thresholds (n,) 0..1 and shares (S, n) by label; the band is the range over seeds, the line their mean,
    and the legend, best first, has the area under the curve as the mean over thresholds and seeds.
    """
    scores = {label: float(np.mean(values)) for label, (_, values) in curves.items()}
    with style():
        return _curves(curves, scores, "AUC", title, ("overlap threshold (IoU)", "share of frames above it"), None)


def precision_figure(curves: Curves, *, title: str = "Precision", at: float = 20.0) -> Figure:
    """Share of frames whose centre is within a threshold of the true one; the legend has the share within `at` pixels.

    `curves` are thresholds (n,) in pixels and shares (S, n) by label; band and line as in `success_figure`.
    """
    scores = {
        label: float(np.mean([np.interp(at, thresholds, row) for row in np.atleast_2d(values)]))
        for label, (thresholds, values) in curves.items()
    }
    names = ("distance threshold (px)", "share of frames within it")
    with style():
        return _curves(curves, scores, f"at {at:g} px", title, names, at)


def cumulative_error_figure(
    curves: Curves, *, threshold: float | None = None, unit: str = "px", title: str = "Cumulative error"
) -> Figure:
    """Share of rows whose error is below a value, for each recipe; the legend has the share below `threshold`.

    `curves` are values (n,) in `unit` and shares (S, n) by label; without a threshold the legend has the mean share
    over the values. Band and line as in `success_figure`.
    """
    scores = {}
    for label, (at, values) in curves.items():
        rows = np.atleast_2d(values)
        scores[label] = float(np.mean(rows if threshold is None else [np.interp(threshold, at, row) for row in rows]))
    measure = "AUC" if threshold is None else f"below {threshold:.3g} {unit}"
    with style():
        return _curves(curves, scores, measure, title, (f"error ({unit})", "share of rows below it"), threshold)


def _curves(
    curves: Curves, scores: Mapping[str, float], measure: str, title: str, names: tuple[str, str], mark: float | None
) -> Figure:
    from matplotlib.lines import Line2D
    from matplotlib.ticker import PercentFormatter

    longest = max((len(label) for label in curves), default=0)
    figure = new_figure(SQUARE[0] + 0.055 * max(0, min(longest, 40) - 12), SQUARE[1])
    axes = figure.subplots()
    handles = {}
    for number, (label, (at, values)) in enumerate(curves.items()):
        look = line_style(number)
        rows = np.atleast_2d(values)
        if len(rows) > 1:
            axes.fill_between(at, rows.min(axis=0), rows.max(axis=0), color=look["color"], alpha=0.15, linewidth=0)
        axes.plot(at, rows.mean(axis=0), linewidth=1.6, **look)
        handles[label] = Line2D([], [], linewidth=1.6, **look)
    if mark is not None:
        axes.axvline(mark, color=FAINT, linewidth=0.9, linestyle=(0, (3, 2)), zorder=1)
    every = [at for at, _ in curves.values() if len(at)]
    axes.set_xlim(min((float(at.min()) for at in every), default=0), max((float(at.max()) for at in every), default=1))
    axes.set_ylim(0, 1.015)
    axes.yaxis.set_major_formatter(PercentFormatter(1, symbol=" %"))
    axes.set_xlabel(names[0])
    axes.set_ylabel(names[1])
    heading(axes, title, "band: range over seeds" if any(len(np.atleast_2d(v)) > 1 for _, v in curves.values()) else "")
    best = sorted(curves, key=lambda label: -scores[label])
    figure.legend(
        [handles[label] for label in best],
        [f"{scores[label]:.3f}  {clean(label, 40)}" for label in best],
        loc="outside right upper",
        title=measure,
        alignment="left",
        title_fontproperties={"weight": "bold", "size": 9},
        handlelength=2.8,
    )
    return figure


def error_over_time_figure(
    frames: Whole,
    errors: Mapping[str, Array],
    hidden: Sequence[tuple[int, int]] | Mask = (),
    unit: str = "px",
    *,
    title: str = "Error over time",
) -> Figure:
    """Median over seeds of the error in each frame, and the band between the 10 and the 90 % quantile.

    `errors` are (S, T) by label, in `unit`, nan where not known. Where the target is `hidden` is shaded: (first, last)
    frames, both included, or a mask (T,).
    """
    with style():
        figure, axes, step = _over_time(frames, list(errors))
        if isinstance(hidden, np.ndarray):
            covered = frame_spans(frames, hidden, (frames[-1] - frames[0] + 1) / BINS)
        else:
            covered = [(first - step / 2, last + step / 2) for first, last in hidden]
        for start, end in covered:
            axes.axvspan(start, end, color=HIDDEN, alpha=0.2, linewidth=0, zorder=0.5)
        drawn = {label: quantiles(np.atleast_2d(e).astype(np.float64), (0.1, 0.5, 0.9)) for label, e in errors.items()}
        several = any(len(np.atleast_2d(e)) > 1 for e in errors.values())
        limit(axes, [q for low, middle, high in drawn.values() for q in (low, middle, high)], 0.0, 6)
        for number, (low, middle, high) in enumerate(drawn.values()):
            look = line_style(number)
            if several:
                _band(axes, frames, low, high, look["color"])
            x, y, mean_x, mean_y = envelope(frames, middle, BINS)
            if mean_x is not None and mean_y is not None:
                axes.plot(x, y, color=look["color"], linewidth=0.6, alpha=0.4)
                x, y = mean_x, mean_y
            axes.plot(x, y, linewidth=1.3, **look)
        notes = ["line: median over seeds, band: 10 to 90 %" if several else "", "shaded: hidden" if covered else ""]
        heading(axes, title, "; ".join(filter(None, notes)))
        axes.set_ylabel(f"error ({unit})")
        return figure


def spread_figure(
    frames: Whole,
    distances: Mapping[str, Array],
    parting: int | None = None,
    limit_px: float | Mapping[str, float] | None = None,
    *,
    title: str = "Spread over seeds",
) -> Figure:
    """How far the farthest run is from the median of all, in each frame and for each part.

    `distances` (T,) in pixels by part; `parting` is the frame where the first run leaves the others, and `limit_px` how
    far a run may be from them, of all parts or of each.
    """
    with style():
        figure, axes, _ = _over_time(frames, list(distances))
        limit(axes, list(distances.values()), 0.0, 6)
        for number, value in enumerate(distances.values()):
            look = line_style(number)
            x, y, mean_x, mean_y = envelope(frames, value, BINS)
            if mean_x is not None and mean_y is not None:
                axes.plot(x, y, color=look["color"], linewidth=0.6, alpha=0.4)
                x, y = mean_x, mean_y
            axes.plot(x, y, linewidth=1.2, **look)
        ends = (
            sorted(set(limit_px.values())) if isinstance(limit_px, Mapping) else [] if limit_px is None else [limit_px]
        )
        for end in ends:
            if end < axes.get_ylim()[1]:
                axes.axhline(end, color=FAINT, linewidth=0.9, linestyle=(0, (3, 2)), zorder=1)
        if parting is not None:
            axes.axvline(parting, color=LOST, linewidth=1.2, zorder=1)
            late = parting > (float(frames[0]) + float(frames[-1])) / 2
            axes.annotate(
                f"runs part ways at frame {parting:,}",
                (parting, 1),
                xycoords=("data", "axes fraction"),
                xytext=(-5 if late else 5, -3),
                textcoords="offset points",
                ha="right" if late else "left",
                va="top",
                color=INK,
                fontsize=8.5,
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.5},
            )
        heading(axes, title, "the farthest run's distance from the median" + ("; dashed: limit" if ends else ""))
        axes.set_ylabel("distance (px)")
        return figure


def calibration_figure(trust: Trust, *, title: str = "Confidence against the truth") -> Figure:
    """The shares of rows that are near the truth and visible in each bin of confidence, and how many rows there are.

    On the diagonal, confidence is the chance of being near. Bins without rows are left out.
    """
    with style():
        figure = new_figure(5.6, 5.8)
        upper, lower = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [3.2, 1]})
        measures = trust.confidence
        filled = [] if measures is None else [b for b in measures.bins if b.rows]
        mean = _known([b.mean_confidence for b in filled])
        near, visible = _known([b.near for b in filled]), _known([b.visible for b in filled])
        upper.plot(
            [0, 1],
            [0, 1],
            color=FAINT,
            linewidth=0.9,
            linestyle=(0, (3, 2)),
            zorder=1,
            label="ideal: equal to confidence",
        )
        upper.vlines(mean, mean, near, color=LOST, linewidth=1.0, alpha=0.55, zorder=1.5)
        upper.plot(mean, near, "o-", color=COLOURS[0], linewidth=1.5, markersize=5, label="near the truth")
        if any(share < 1 for share in visible):
            upper.plot(mean, visible, "s--", color=COLOURS[1], linewidth=1.2, markersize=4, label="visible in truth")
        if not filled:
            upper.text(0.5, 0.45, "no row has a confidence between 0 and 1", ha="center", color=FAINT)
        upper.set_xlim(-0.02, 1.02)
        upper.set_ylim(-0.02, 1.04)
        upper.set_ylabel("share of rows")
        ece = None if measures is None else measures.ece
        heading(upper, title, "" if ece is None else f"expected calibration error {ece:.3f}")
        lower.bar([(b.low + b.high) / 2 for b in filled], [b.rows for b in filled], 0.09, color=HIDDEN, linewidth=0)
        if filled:
            lower.set_yscale("log")
            lower.set_ylim(0.7, 1.8 * max(b.rows for b in filled))
            lower.yaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
            lower.yaxis.minorticks_off()
        else:
            lower.set_yticks([])
        lower.set_ylabel("rows")
        lower.set_xlabel("confidence")
        heading(lower, "Rows", "log scale" if filled else "")
        handles, labels = upper.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(handles), handlelength=2.6)
        return figure


def _known(shares: Sequence[float | None]) -> list[float]:
    return [float("nan") if share is None else share for share in shares]


def _over_time(frames: Whole, labels: Sequence[str]) -> tuple[Figure, Axes, float]:
    """A wide figure with a legend above and frames below; the step between frames."""
    from matplotlib.lines import Line2D
    from matplotlib.ticker import MaxNLocator

    columns, rows = columns_for([clean(label, 40) for label in labels], WIDE[0])
    top = 0.1 + 0.2 * rows
    figure = new_figure(WIDE[0], WIDE[1] + top)
    pieces: Any = figure.subfigures(2, 1, height_ratios=[top, WIDE[1]])
    handles = [Line2D([], [], linewidth=1.5, **line_style(number)) for number in range(len(labels))]
    pieces[0].legend(
        handles,
        [clean(label, 40) for label in labels],
        loc="center left",
        ncols=columns,
        handlelength=2.8,
        borderaxespad=0.3,
    )
    axes = pieces[1].subplots()
    first, last = float(frames[0]), float(frames[-1])
    margin = max(0.5, 0.004 * (last - first), 1e-9 * last)
    axes.set_xlim(first - margin, last + margin)
    axes.xaxis.set_major_locator(MaxNLocator(10, integer=True, min_n_ticks=1, steps=[1, 2, 2.5, 5, 10]))
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")
    axes.set_xlabel("frame")
    return figure, axes, float(np.median(np.diff(frames))) if len(frames) > 1 else 1.0


def _band(axes: Axes, frames: Whole, low: Array, high: Array, colour: str) -> None:
    x, bottom, *_ = envelope(frames, low, BINS)
    _, top, *_ = envelope(frames, high, BINS)
    axes.fill_between(x, bottom, top, color=colour, alpha=0.15, linewidth=0)
