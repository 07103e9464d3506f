"""The figure of `facetrack gallery show`: what a gallery holds."""

from __future__ import annotations

import math
import textwrap
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.report.figures import style
from facetrack_cli.report.figures.style import Axes, Figure, clean
from facetrack_cli.trackers.appearance.gallery import Gallery, Subspace

EIGENFACES: Final = 8  # of a space, at most
MOST, LEAST = 8, 0.8  # faces in a row, and what is the height of one, in inches


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
