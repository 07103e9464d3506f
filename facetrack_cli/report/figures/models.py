"""The figures of `facetrack gallery show` and `facetrack prior show`: what a gallery and a shape prior hold."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array
from facetrack_cli.report.figures import style
from facetrack_cli.report.figures.style import Axes, Figure, clean
from facetrack_cli.trackers.appearance.gallery import Gallery, Subspace
from facetrack_cli.trackers.points.shape_prior import ShapePrior

# lengths are inches
MARGIN, GAP, LINE = 0.2, 0.1, 0.14
LEFT: Final = 2.1  # width of the column with the mean face
EIGENFACES, SIDES = 8, (0.8, 0.96)  # of a space, at most; the most that one is wide and high
MAX_FACE: Final = 1.55  # a person's face; of more people they are smaller, down to
MIN_FACE, MIN_FACE_OF_MANY, FEW_PERSONS = 0.82, 0.6, 60  # the second for more than FEW_PERSONS
MIN_NAME: Final = 0.6  # least width of a name, and
MAX_NAME: Final = 1.5  # what it has where there is room
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
    """Faces in grey, numbered as in the list of `gallery show`; a name that has no room on two lines is cut."""
    rows, cols = gallery.shape
    aspect, count, inner = cols / rows, len(gallery.names), style.WIDTH - 2 * MARGIN + GAP
    # as many columns as make rows of about equal length, with faces no smaller than they must be
    least = max((MIN_FACE if count <= FEW_PERSONS else MIN_FACE_OF_MANY) * aspect, MIN_NAME) + GAP
    columns = math.ceil(count / math.ceil(count / max(int(inner / least), 1)))
    step = min(inner / columns, max(MAX_FACE * aspect, MAX_NAME) + GAP)
    face = min(MAX_FACE, (step - GAP) / aspect)
    top = 0.72 + 3 * (SIDES[1] + 0.5)
    row = face + 3 * LINE + 0.2
    with style.style():
        figure = style.new_figure(style.WIDTH, top + 0.35 + row * math.ceil(count / columns))
        figure.set_layout_engine("none")  # every place is known
        page: Axes = figure.add_axes((0, 0, 1, 1))
        page.set(xlim=(0, style.WIDTH), ylim=(figure.get_figheight(), 0))
        page.set_axis_off()
        _text(page, MARGIN, 0.12, clean(title, 80), size=12, weight="bold")
        text = f"{count} persons, {sum(gallery.counts)} images; template {rows} points high, {cols} wide"
        _text(page, MARGIN, 0.37, text, size=8.5, color=style.FAINT)
        _spaces(page, gallery, 0.72)
        page.plot((MARGIN, style.WIDTH - MARGIN), (top, top), color=style.GRID, linewidth=0.8)
        _text(page, MARGIN, top + 0.1, "Who is in it", weight="bold")
        for number, (name, patch, images) in enumerate(zip(gallery.names, gallery.faces, gallery.counts, strict=True)):
            x, y = MARGIN + step * (number % columns), top + 0.35 + row * (number // columns)
            _face(page, patch, gallery.shape, x, y, face)
            lines = _lines(f"{number + 1} {name}", step - GAP)
            _text(page, x, y + face + 0.05, *lines, size=8)
            text = _lines(f"{images} image{'s' * (images > 1)}", step - GAP)[0]
            _text(page, x, y + face + 0.05 + LINE * len(lines), text, size=8, color=style.FAINT)
        return figure


def _spaces(page: Axes, gallery: Gallery, top: float) -> None:
    """The mean face at the left; beside it a row of eigenfaces for each space."""
    _text(page, MARGIN, top, "Mean face", weight="bold")
    high = min(LEFT, LEFT * gallery.shape[0] / gallery.shape[1])
    _face(page, gallery.frontal.mean, gallery.shape, MARGIN, top + 0.22, high)
    text = [*textwrap.wrap(calibrated(gallery), 36), "", *textwrap.wrap(stranger(gallery), 36)]
    _text(page, MARGIN, top + high + 0.3, *text, size=8, color=style.FAINT)
    spaces = (
        ("Frontal faces", "what a face looks like", gallery.frontal),
        ("Intra-personal", "how images of one person differ", gallery.intra),
        ("Extra-personal", "how persons differ", gallery.extra),
    )
    rows, cols = gallery.shape
    high = min(SIDES[1], SIDES[0] * rows / cols)
    for name, what, space in spaces:
        x, total = MARGIN + LEFT + 0.3, _total(space)
        _text(page, x, top, name, weight="bold")
        _text(page, x + 1.15, top + 0.01, f"{what}: {kept(space)}", size=8, color=style.FAINT)
        for vector, value in zip(space.vectors[:EIGENFACES], space.values[:EIGENFACES], strict=True):
            # the sign of a component means nothing; one is kept, so that the same space looks the same
            towards = vector if vector[np.abs(vector).argmax()] > 0 else -vector
            scaled = 2.2 * towards / max(float(np.quantile(np.abs(towards), 0.98)), 1e-9)
            wide = _face(page, scaled, gallery.shape, x, top + 0.22, high)
            _text(page, x, top + 0.25 + high, f"{100 * value / total:.1f} %", size=8, color=style.FAINT)
            x += max(wide, 0.4) + GAP
        if not len(space.vectors):
            _text(page, x, top + 0.3, "no component", size=8, color=style.FAINT)
        top += SIDES[1] + 0.5


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


def _face(page: Axes, patch: NDArray[Any], shape: tuple[int, int], x: float, y: float, height: float) -> float:
    """Draw a patch (d,) of zero mean and unit variance in grey, smoothly enlarged, in a frame; how wide it is."""
    wide = height * shape[1] / shape[0]
    grey = np.asarray(patch, np.float64).reshape(shape)
    page.imshow(grey, cmap="gray", vmin=-2.46, vmax=2.44, interpolation="bicubic", extent=(x, x + wide, y + height, y))
    page.plot([x, x + wide, x + wide, x, x], [y, y, y + height, y + height, y], color=style.GRID, linewidth=0.6)
    return wide


def _lines(text: str, inches: float, size: float = 8.0) -> list[str]:
    """A text on at most two lines of that width; what has no room is cut."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    points = text_to_path.get_text_width_height_descent(text, FontProperties(size=size), ismath=False)[0]
    letters = max(int(72 * inches / max(points / len(text), 1)), 3)
    return textwrap.wrap(clean(text, 2 * letters - 2), letters, max_lines=2, placeholder="…")


def _text(page: Axes, x: float, y: float, *lines: str, size: float = 9.0, **look: Any) -> None:
    """Lines at equal distances, whatever marks their letters have; y is the top of the first."""
    for number, line in enumerate(lines):
        page.text(x, y + size * (0.013 + 0.0174 * number), line, va="baseline", size=size, **look)


def prior_figure(prior: ShapePrior, sigma: float, *, title: str) -> Figure:
    """The training shapes as a cloud for each part, with ellipses of two standard deviations, and the principal modes.
    `sigma`, the standard deviation of the kernel in the prior's unit, is the radius of the ring in the corner. Parts
    without a place in PLACES stand on a circle around the stable one.
    """
    moving = [k for k, name in enumerate(prior.parts) if name != prior.stable]
    around = {k: 2 * np.pi * number / len(moving) for number, k in enumerate(moving)}
    circle = [(np.cos(around[k]), np.sin(around[k])) if k in around else (0, 0) for k in range(len(prior.parts))]
    base = np.array([PLACES.get(name, place) for name, place in zip(prior.parts, circle, strict=True)])
    looks: list[dict[str, Any]] = [{"color": style.FAINT} for _ in prior.parts]
    for number, k in enumerate(moving):
        looks[k] = style.line_style(number)
    labels = {k: f"{clean(prior.parts[k], 30)}, sd {x:.2f}, {y:.2f}" for k, (x, y) in enumerate(prior.shapes.std(0))}
    labels[prior.parts.index(prior.stable)] = clean(prior.stable, 30)
    with style.style():
        columns, rows = style.columns_for(list(labels.values()), style.WIDTH)
        heights = (0.55, 5.0, 0.1 + 0.2 * rows)
        figure = style.new_figure(style.WIDTH, sum(heights))
        head, body, foot = cast("Any", figure.subfigures(3, 1, height_ratios=heights))
        head.text(0.012, 0.85, clean(title, 80), va="top", weight="bold", size=12)
        ends = " to ".join(clean(name, 30) for name in prior.scale)
        count = "1 shape" if len(prior.shapes) == 1 else f"{len(prior.shapes)} shapes"
        said = f"{count}; unit: {ends} in the first frame; registered by {clean(prior.stable, 30)}"
        head.text(0.012, 0.38, said, va="top", size=8.5, color=style.FAINT)
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
    _outline(axes, prior.parts, mean, style.INK)
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
    axes.add_patch(Circle((x, y), sigma, fill=False, edgecolor=style.INK, linewidth=1.2))
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
        figure.text(0.5, 0.5, "none: all shapes are the same", ha="center", color=style.FAINT)
        return
    mean = base + prior.shapes.mean(0)
    grid = figure.subplots(count, 3, sharex=True, sharey=True, squeeze=False)
    for row, (panels, part) in enumerate(zip(grid, share, strict=False)):
        for axes, extent in zip(panels, (-EXTENT, 0.0, EXTENT), strict=True):
            places = mean + extent * np.sqrt(variance[row]) * ways[row].reshape(mean.shape)
            _outline(axes, prior.parts, mean, "#C8C8C8")
            axes.plot(*mean.T, ".", color="#C8C8C8", markersize=4)
            _outline(axes, prior.parts, places, style.INK)
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
