"""The figure of `facetrack prior show`: where each part goes, and the few ways in which most of it moves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, cast

import numpy as np

from facetrack_cli.core.types import Array
from facetrack_cli.report.figures.lines import columns_for
from facetrack_cli.report.figures.style import FAINT, INK, WIDTH, Axes, Figure, clean, line_style, new_figure, style
from facetrack_cli.trackers.points.shape_prior import ShapePrior

# displacements have no place of their own: a neutral face, in mouth widths from the nose, to draw them on
PLACES: Final = {
    "nose": (0.0, 0.0),
    "mouth_left": (-0.5, 0.63),
    "mouth_right": (0.5, 0.63),
    "lip_upper": (0.0, 0.48),
    "lip_lower": (0.0, 0.84),
}
OUTLINE: Final = ("mouth_left", "lip_upper", "mouth_right", "lip_lower")
MAX_MODES, EXTENT = 4, 2.0  # modes shown, each from -EXTENT to +EXTENT standard deviations
MIN_SHARE: Final = 0.005  # of the variance, of a mode that is shown


def prior_figure(prior: ShapePrior, sigma: float, *, title: str) -> Figure:
    """The training shapes as a cloud for each part, with ellipses of two standard deviations, and the principal modes.
    `sigma`, the standard deviation of the kernel in the prior's unit, is the radius of the ring in the corner. Parts
    without a place in PLACES stand on a circle around the stable one.
    """
    moving = [k for k, name in enumerate(prior.parts) if name != prior.stable]
    around = {k: 2 * np.pi * number / len(moving) for number, k in enumerate(moving)}
    circle = [(np.cos(around[k]), np.sin(around[k])) if k in around else (0, 0) for k in range(len(prior.parts))]
    base = np.array([PLACES.get(name, place) for name, place in zip(prior.parts, circle, strict=True)])
    looks: list[dict[str, Any]] = [{"color": FAINT} for _ in prior.parts]
    for number, k in enumerate(moving):
        looks[k] = line_style(number)
    labels = {k: f"{clean(prior.parts[k], 30)}, sd {x:.2f}, {y:.2f}" for k, (x, y) in enumerate(prior.shapes.std(0))}
    labels[prior.parts.index(prior.stable)] = clean(prior.stable, 30)
    with style():
        columns, rows = columns_for(list(labels.values()), WIDTH)
        heights = (0.55, 5.0, 0.1 + 0.2 * rows)
        figure = new_figure(WIDTH, sum(heights))
        head, body, foot = cast("Any", figure.subfigures(3, 1, height_ratios=heights))
        head.text(0.012, 0.85, clean(title, 80), va="top", weight="bold", size=12)
        ends = " to ".join(clean(name, 30) for name in prior.scale)
        count = "1 shape" if len(prior.shapes) == 1 else f"{len(prior.shapes)} shapes"
        said = f"{count}; unit: {ends} in the first frame; registered by {clean(prior.stable, 30)}"
        head.text(0.012, 0.38, said, va="top", size=8.5, color=FAINT)
        left, right = body.subfigures(1, 2, width_ratios=(1.15, 1))
        handles = _clouds(left.subplots(), prior, base, sigma, looks)
        _modes(right, prior, base, looks)
        foot.legend(handles, list(labels.values()), loc="center", ncols=columns, handlelength=1.8)
        return figure


def _clouds(axes: Axes, prior: ShapePrior, base: Array, sigma: float, looks: Sequence[dict[str, Any]]) -> list[Any]:
    """A cloud, an ellipse and the mean of each part, all in the prior's unit; the handles of a legend."""
    from matplotlib.patches import Circle

    places = base + prior.shapes
    mean = places.mean(0)
    _outline(axes, prior.parts, mean, INK)
    handles = []
    for k, look in enumerate(looks):
        x, y = places[:, k].T
        if prior.parts[k] != prior.stable:
            axes.plot(x, y, ".", color=look["color"], alpha=0.35, markersize=3.5, markeredgewidth=0)
            axes.plot(*_ellipse(places[:, k]), linewidth=1.4, **look)
        axes.plot(*mean[k], "o", color=look["color"], markersize=7, markeredgecolor="white", zorder=4)
        handles += axes.plot([], [], marker="o", markersize=6, **look)
    low, high = places.min((0, 1)), places.max((0, 1))
    centre, half = (low + high) / 2, 0.56 * max(*(high - low), 0.5)
    axes.set(xlim=(centre[0] - half, centre[0] + half), ylim=(centre[1] + half, centre[1] - half), aspect="equal")
    unit = "mouth widths" if set(prior.scale) == {"mouth_left", "mouth_right"} else "units"
    axes.set(xlabel=f"to the right ({unit})", ylabel=f"down ({unit})")
    axes.set_title("Training shapes", size=9)
    x, y = centre[0] + half - 1.2 * sigma, centre[1] - half + 1.2 * sigma + 0.03 * half
    axes.add_patch(Circle((x, y), sigma, fill=False, edgecolor=INK, linewidth=1.2))
    axes.text(x - 1.1 * sigma, y, f"kernel, sigma {sigma:.3f} ", ha="right", va="center", size=8)
    return handles


def _modes(figure: Any, prior: ShapePrior, base: Array, looks: Sequence[dict[str, Any]]) -> None:
    """A row for each principal mode: its share of the variance, and the shapes at its ends beside the mean."""
    figure.suptitle("Principal modes, and their share of the variance", size=9, weight="bold", ha="left", x=0.04)
    flat = prior.shapes.reshape(len(prior.shapes), -1)
    _, strength, ways = np.linalg.svd(flat - flat.mean(0), full_matrices=False)
    largest = ways[np.arange(len(ways)), np.abs(ways).round(6).argmax(1)]
    ways = ways * np.where(largest < 0, -1.0, 1.0)[:, None]  # a fixed sign
    variance = strength**2 / len(flat)
    share = variance / max(float(variance.sum()), 1e-12)
    count = min(MAX_MODES, int((share > MIN_SHARE).sum()))
    if not count:
        figure.text(0.5, 0.5, "none: all shapes are the same", ha="center", color=FAINT)
        return
    mean = base + prior.shapes.mean(0)
    grid = figure.subplots(count, 3, sharex=True, sharey=True, squeeze=False)
    for row, (panels, part) in enumerate(zip(grid, share, strict=False)):
        for axes, extent in zip(panels, (-EXTENT, 0.0, EXTENT), strict=True):
            places = mean + extent * np.sqrt(variance[row]) * ways[row].reshape(mean.shape)
            _outline(axes, prior.parts, mean, "#C8C8C8")
            axes.plot(*mean.T, ".", color="#C8C8C8", markersize=4)
            _outline(axes, prior.parts, places, INK)
            for place, look in zip(places, looks, strict=True):
                axes.plot(*place, "o", color=look["color"], markersize=4)
            axes.set_aspect("equal")
            axes.margins(0.12)
            axes.set_axis_off()
            if not row:
                name = f"{extent:+g} sd".replace("-", "\N{MINUS SIGN}") if extent else "mean"
                axes.set_title(name, loc="center", weight="normal", size=8.5)
        panels[0].text(-0.02, 0.5, f"{100 * part:.0f} %", transform=panels[0].transAxes, ha="right", va="center")
    grid[0, 0].invert_yaxis()


def _outline(axes: Axes, parts: tuple[str, ...], places: Array, colour: str) -> None:
    """Both lips as parabolas through their middle, from corner to corner, where the prior has a mouth."""
    if not set(OUTLINE) <= set(parts):
        return
    left, upper, right, lower = (places[parts.index(name)] for name in OUTLINE)
    t = np.linspace(0.0, 1.0, 33)[:, None]
    for middle in (upper, lower):
        control = 2.0 * middle - 0.5 * (left + right)
        axes.plot(*((1 - t) ** 2 * left + 2 * t * (1 - t) * control + t**2 * right).T, color=colour, linewidth=1.2)


def _ellipse(places: Array) -> Array:
    """(2, n) points of the ellipse of two standard deviations of places (M, 2)."""
    values, vectors = np.linalg.eigh(np.cov(places.T) if len(places) > 1 else np.zeros((2, 2)))
    angle = np.linspace(0.0, 2.0 * np.pi, 73)
    ring = 2.0 * np.sqrt(np.maximum(values, 0.0)) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.asarray(places.mean(0)[:, None] + vectors @ ring.T)
