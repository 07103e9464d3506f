"""Figures that set recipes, runs and seeds side by side. Axes: S seeds, T frames, n thresholds."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from facetrack_cli.core.types import Array, Mask, Whole
from facetrack_cli.evaluation.accuracy import FAILURE, PRECISION_THRESHOLDS, SUCCESS_THRESHOLDS
from facetrack_cli.evaluation.compare import CUMULATIVE_AT, Comparison
from facetrack_cli.evaluation.rows import at
from facetrack_cli.evaluation.summary import clip_name
from facetrack_cli.report.figures import style
from facetrack_cli.report.figures.style import Axes, Figure, quantiles, render

Curves = Mapping[str, tuple[Array, Array]]
Lines = Sequence[Sequence[Any]]  # x, low, middle and high of each, (n,)
_MARK: Final[Any] = {**style.GUIDE, "linewidth": 0.9, "linestyle": (0, (3, 2)), "zorder": 1}


def _figure(lines: Lines, names: Mapping[int, str], several: bool, width: float, over: str = "") -> tuple[Figure, Axes]:
    """The lines, with bands where there are `several` seeds, and at the right the `names`, by the numbers of lines."""
    from matplotlib.lines import Line2D

    figure = style.new_figure(width + 0.055 * max(map(len, names.values()), default=0), 4.6)
    axes = figure.subplots()
    for number, (x, low, middle, high) in enumerate(lines):
        look = style.line_style(number)
        if several:
            style.band(axes, x, low, high, look["color"], 0.15)
        style.line(axes, x, middle, linewidth=1.5, **look)
    handles = [Line2D([], [], linewidth=1.5, **style.line_style(number)) for number in names]
    bold: Any = {"title": over, "title_fontproperties": {"weight": "bold", "size": 9}, "alignment": "left"}
    figure.legend(handles, [*names.values()], loc="outside right upper", handlelength=2.8, **bold)
    return figure, axes


def curves_figure(
    curves: Curves, title: str, labels: tuple[str, str], measure: str = "AUC", mark: float | None = None
) -> Figure:
    """Shares of frames or rows over thresholds, for each recipe, as success and precision are drawn.

    `curves` are thresholds (n,) and shares (S, n) by label; the band is the range over seeds, the line their mean. The
    legend, best first, has the mean over seeds of the share at the threshold `mark`, or over the whole curve.
    """
    read = [each if mark is None else [np.interp(mark, at, row) for row in each] for at, each in curves.values()]
    scores = [float(np.mean(values)) for values in read]
    best = np.argsort(np.negative(scores), kind="stable").tolist()
    names = {k: f"{scores[k]:.3f}  {style.clean([*curves][k], 40)}" for k in best}
    several = any(len(values) > 1 for _, values in curves.values())
    with style.style():
        lines = [(at, values.min(axis=0), values.mean(axis=0), values.max(axis=0)) for at, values in curves.values()]
        figure, axes = _figure(lines, names, several, 5.6, measure)
        if mark is not None:
            axes.axvline(mark, **_MARK)
        axes.margins(x=0)
        axes.set(ylim=(0, 1.015), xlabel=labels[0], ylabel=labels[1])
        axes.yaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f} %")
        style.heading(axes, title, "band: range over seeds" if several else "")
        return figure


def error_over_time_figure(
    frames: Whole, errors: Mapping[str, Array], hidden: Mask, *, title: str = "Error over time"
) -> Figure:
    """Median over seeds of `errors` (S, T) in pixels by label, in a band of 10 to 90 % of them; `hidden` is shaded."""
    several = any(len(e) > 1 for e in errors.values())
    with style.style():
        lines = [(frames, *quantiles(e.astype(np.float64), (0.1, 0.5, 0.9))) for e in errors.values()]
        names = {k: style.clean(label, 40) for k, label in enumerate(errors)}
        figure, axes = _figure(lines, names, several, 9.0)
        style.frame_axis(axes, frames)
        style.shade(axes, frames, hidden, "hidden", 0.2, float(frames[-1] - frames[0] + 1) / style.BINS)
        style.limit(axes, 0.0, 6)
        notes = ["line: median over seeds, band: 10 to 90 %"] * several + ["shaded: hidden"] * bool(hidden.any())
        style.heading(axes, title, "; ".join(notes))
        axes.set_ylabel("error (px)")
        return figure


CURVES: Final = (  # of Score, thresholds, title, labels, what the legend has, and the threshold that it is read off at
    ("success", SUCCESS_THRESHOLDS, "Success", ("overlap threshold (IoU)", "share of frames above it"), "AUC", None),
    ("precision", PRECISION_THRESHOLDS, "Precision", ("distance threshold (px)", "share of frames within it"),
     "at 20 px", 20.0),
    ("cumulative", 100 * CUMULATIVE_AT, "Cumulative error", ("error (% of the size)", "share of rows below it"),
     f"below {100 * FAILURE:.3g} % of the size", 100 * FAILURE),
)  # fmt: skip


def compare_figures(comparison: Comparison) -> Iterator[tuple[str, bytes]]:
    """Success, precision, cumulative error and error over time, of what is measured; recipes in their order."""
    entries = [entry for entry, _ in comparison.places if entry.scores]
    clip = clip_name(comparison.clip)
    for name, thresholds, title, labels, measure, mark in CURVES:
        values = {entry.label: [getattr(score, name) for score in entry.scores] for entry in entries}
        curves = {label: (thresholds, np.stack(each)) for label, each in values.items() if each[0] is not None}
        if curves:
            yield f"{name}.png", render(curves_figure(curves, f"{title} on {clip}", labels, measure, mark))
    scores = [score for entry in entries for score in entry.scores]
    frame, hidden = (np.unique(np.concatenate([getattr(score, of) for score in scores])) for of in ("frame", "hidden"))
    errors = {each.label: np.array([at(frame, one.frame, one.error) for one in each.scores]) for each in entries}
    yield "error.png", render(error_over_time_figure(frame, errors, np.isin(frame, hidden), title=f"Error on {clip}"))
