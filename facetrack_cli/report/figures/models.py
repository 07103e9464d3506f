"""The figures of `facetrack gallery show` and `facetrack prior show`: what a gallery and a shape prior hold."""

from __future__ import annotations

import math
import textwrap
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array
from facetrack_cli.report.figures import style
from facetrack_cli.report.figures.style import Axes, Figure, clean
from facetrack_cli.trackers.appearance.gallery import Gallery, Subspace
from facetrack_cli.trackers.points.shape_prior import ShapePrior

EIGENFACES: Final = 8  # of a space, at most
MOST, LEAST = 8, 0.8  # faces in a row, and what is the height of one, in inches
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


def gallery_figure(gallery: Gallery, *, title: str) -> Figure:
    """The mean face, the first eigenfaces of each space, and everybody's face, numbered as in `gallery show`."""
    spaces = (
        ("Frontal faces: what a face looks like", gallery.frontal),
        ("Intra-personal: how images of one person differ", gallery.intra),
        ("Extra-personal: how persons differ", gallery.extra),
    )
    count, columns = len(gallery.names), min(MOST, len(gallery.names))
    rows = math.ceil(count / columns)
    heights = (0.6, *3 * (LEAST + 0.65,), rows * (LEAST + 0.65) + 0.3)
    with style.style():
        figure = style.new_figure(style.WIDTH, sum(heights))
        head, *rest, foot = cast("Any", figure.subfigures(5, 1, height_ratios=heights))
        head.text(0.012, 0.9, clean(title, 80), va="top", weight="bold", size=12)
        text = f"{count} persons, {sum(gallery.counts)} images; template {gallery.shape[0]} points high, "
        text += f"{gallery.shape[1]} wide; {calibrated(gallery)}; {stranger(gallery)}"
        head.text(0.012, 0.45, "\n".join(textwrap.wrap(text, 150)), va="top", size=7.5, color=style.FAINT)
        for part, (name, space) in zip(rest, spaces, strict=True):
            part.suptitle(f"{name}; {kept(space)}", size=9, x=0.012, ha="left")
            grid = part.subplots(1, EIGENFACES + 1)
            _face(grid[0], space.mean, gallery.shape, "mean")
            total = _total(space)
            for axes, vector, value in zip(grid[1:], space.vectors, space.values, strict=False):
                # the sign of a component means nothing; one is kept, so that the same space looks the same
                towards = vector if vector[np.abs(vector).argmax()] > 0 else -vector
                scaled = 2.2 * towards / max(float(np.quantile(np.abs(towards), 0.98)), 1e-9)
                _face(axes, scaled, gallery.shape, f"{100 * value / total:.1f} %")
            for axes in grid:
                axes.set_axis_off()
        foot.suptitle("Who is in it", size=9, weight="bold", x=0.012, ha="left")
        everyone = foot.subplots(rows, columns, squeeze=False).ravel()
        for number, (axes, name, patch, images) in enumerate(
            zip(everyone, gallery.names, gallery.faces, gallery.counts, strict=False), 1
        ):
            lines = textwrap.wrap(clean(f"{number} {name}", 60), 16, max_lines=2, placeholder="…")
            _face(axes, patch, gallery.shape, "\n".join([*lines, f"{images} image{'s' * (images > 1)}"]))
        for axes in everyone:
            axes.set_axis_off()
        return figure


def _face(axes: Axes, patch: NDArray[Any], shape: tuple[int, int], title: str) -> None:
    """A patch (d,) of zero mean and unit variance in grey, smoothly enlarged."""
    axes.imshow(np.reshape(patch, shape), cmap="gray", vmin=-2.46, vmax=2.44, interpolation="bicubic")
    axes.set_title(title, loc="center", size=7.5, weight="normal")


def kept(space: Subspace) -> str:
    """How much of a space its components keep, in words."""
    number = len(space.vectors)
    components = "1 component" if number == 1 else f"{number} components"
    return f"{components}, {100 * float(space.values.sum()) / _total(space):.0f} % of the variance to be expected"


def calibrated(gallery: Gallery) -> str:
    """When a patch counts as a frontal face in its place, in words."""
    slope, offset = gallery.calibration
    if not slope:
        return f"p_f is {gallery.most_frontal / 2:.2f} for any patch: the gallery does not tell faces from others"
    half, tenths = -offset / slope, math.log(9) / slope
    return (
        f"p_f is half of its most at a log density of {half:.0f}, a tenth at {half - tenths:.0f} and nine tenths at "
        f"{half + tenths:.0f}; its most is {gallery.most_frontal:g}"
    )


def stranger(gallery: Gallery) -> str:
    """When a face is called a stranger, in words."""
    errors = f"equal error rate {100 * gallery.errors:.0f} %"
    return f"a face is of none of them below a log likelihood ratio of {gallery.threshold:.0f} ({errors})"


def _total(space: Subspace) -> float:
    return max(float(space.values.sum() + space.rho * (space.mean.size - len(space.vectors))), 1e-12)


def prior_figure(prior: ShapePrior, sigma: float, *, title: str) -> Figure:
    """The training shapes as a cloud for each part, with ellipses of two standard deviations, and the principal modes.
    `sigma`, the standard deviation of the kernel in the prior's unit, is the radius of the ring in the corner. Parts
    without a place in PLACES stand on a circle around the stable one.
    """
    angles = np.linspace(0, 2 * np.pi, len(prior.parts) + 1)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    base = np.array([PLACES.get(name, place) for name, place in zip(prior.parts, circle, strict=False)])
    with style.style():
        figure = style.new_figure(style.WIDTH, 5.6)
        ends = " to ".join(clean(name, 30) for name in prior.scale)
        said = f"{clean(title, 80)}: {len(prior.shapes)} shapes; unit: {ends}; registered by {clean(prior.stable, 30)}"
        figure.suptitle(said, ha="left", x=0.012, size=10)
        left, right = cast("Any", figure.subfigures(1, 2, width_ratios=(1.15, 1)))
        _clouds(left.subplots(), prior, base, sigma)
        _modes(right, prior, base)
        return figure


def _clouds(axes: Axes, prior: ShapePrior, base: Array, sigma: float) -> None:
    """A cloud, an ellipse and the mean of each part, all in the prior's unit."""
    from matplotlib.patches import Circle

    places, std = base + prior.shapes, prior.shapes.std(0)
    _outline(axes, prior.parts, places.mean(0), style.INK)
    for k, name in enumerate(prior.parts):
        look = style.line_style(k)
        axes.plot(*places[:, k].T, ".", color=look["color"], alpha=0.35, markersize=3.5, markeredgewidth=0)
        label = f"{clean(name, 30)}, sd {std[k][0]:.2f}, {std[k][1]:.2f}"
        axes.plot(*_ellipse(places[:, k]), linewidth=1.4, label=label, **look)
        axes.plot(*places[:, k].mean(0), "o", color=look["color"], markersize=7, markeredgecolor="white", zorder=4)
    axes.set_aspect("equal", "datalim")
    axes.invert_yaxis()
    unit = "mouth widths" if set(prior.scale) == {"mouth_left", "mouth_right"} else "units"
    axes.set(xlabel=f"to the right ({unit})", ylabel=f"down ({unit})")
    axes.set_title(f"Training shapes, and a kernel of sigma {sigma:.3f}")
    x, y = places.max((0, 1))[0] - sigma, places.min((0, 1))[1] + sigma
    axes.add_patch(Circle((x, y), sigma, fill=False, edgecolor=style.INK, linewidth=1.2))
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2, fontsize=7.5)


def _modes(figure: Any, prior: ShapePrior, base: Array) -> None:
    """A row for each principal mode: its share of the variance, and the shapes at its ends beside the mean."""
    flat = prior.shapes.reshape(len(prior.shapes), -1)
    _, strength, ways = np.linalg.svd(flat - flat.mean(0), full_matrices=False)
    largest = ways[np.arange(len(ways)), np.abs(ways).round(6).argmax(1)]
    ways = ways * np.where(largest < 0, -1.0, 1.0)[:, None]  # a fixed sign
    variance = strength**2 / len(flat)
    share = variance / max(float(variance.sum()), 1e-12)
    count = min(MAX_MODES, int((share > MIN_SHARE).sum()))
    figure.suptitle("Principal modes, and their share of the variance" if count else "All shapes are the same", size=9)
    mean = base + prior.shapes.mean(0)
    grid = figure.subplots(max(count, 1), 3, sharex=True, sharey=True, squeeze=False)
    for axes in grid.ravel():
        axes.set_axis_off()
        axes.set_aspect("equal")
    for row in range(count):
        for axes, extent in zip(grid[row], (-EXTENT, 0.0, EXTENT), strict=True):
            places = mean + extent * np.sqrt(variance[row]) * ways[row].reshape(mean.shape)
            _outline(axes, prior.parts, mean, "#C8C8C8")
            _outline(axes, prior.parts, places, style.INK)
            for k, place in enumerate(places):
                axes.plot(*place, "o", color=style.line_style(k)["color"], markersize=4)
            name = f"{extent:+g} sd".replace("-", "\N{MINUS SIGN}") if extent else f"mean, {100 * share[row]:.0f} %"
            axes.set_title(name, loc="center", weight="normal", size=8.5)
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
