"""The figure of `facetrack gallery show`: the mean face, the first eigenfaces of its spaces, everyone who is in it."""

from __future__ import annotations

import math
import textwrap
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.report.figures.style import FAINT, GRID, WIDTH, Axes, Figure, clean, new_figure, style
from facetrack_cli.trackers.appearance.gallery import Gallery, Subspace

# lengths are inches
MARGIN, GAP, LINE = 0.2, 0.1, 0.14
LEFT: Final = 2.1  # width of the column with the mean face
EIGENFACES, SIDES = 8, (0.8, 0.96)  # of a space, at most; the most that one is wide and high
MAX_FACE: Final = 1.55  # a person's face; of more people they are smaller, down to
MIN_FACE, MIN_FACE_OF_MANY, FEW_PERSONS = 0.82, 0.6, 60  # the second for more than FEW_PERSONS
MIN_NAME: Final = 0.6  # least width of a name, and
MAX_NAME: Final = 1.5  # what it has where there is room


def gallery_figure(gallery: Gallery, *, title: str) -> Figure:
    """Faces in grey, numbered as in the list of `gallery show`; a name that has no room on two lines is cut."""
    rows, cols = gallery.shape
    aspect, count, inner = cols / rows, len(gallery.names), WIDTH - 2 * MARGIN + GAP
    # as many columns as make rows of about equal length, with faces no smaller than they must be
    least = max((MIN_FACE if count <= FEW_PERSONS else MIN_FACE_OF_MANY) * aspect, MIN_NAME) + GAP
    columns = math.ceil(count / math.ceil(count / max(int(inner / least), 1)))
    step = min(inner / columns, max(MAX_FACE * aspect, MAX_NAME) + GAP)
    face = min(MAX_FACE, (step - GAP) / aspect)
    top = 0.72 + 3 * (SIDES[1] + 0.5)
    row = face + 3 * LINE + 0.2
    with style():
        figure = new_figure(WIDTH, top + 0.35 + row * math.ceil(count / columns))
        figure.set_layout_engine("none")  # every place is known
        page: Axes = figure.add_axes((0, 0, 1, 1))
        page.set(xlim=(0, WIDTH), ylim=(figure.get_figheight(), 0))
        page.set_axis_off()
        _text(page, MARGIN, 0.12, clean(title, 80), size=12, weight="bold")
        text = f"{count} persons, {sum(gallery.counts)} images; template {rows} points high, {cols} wide"
        _text(page, MARGIN, 0.37, text, size=8.5, color=FAINT)
        _spaces(page, gallery, 0.72)
        page.plot((MARGIN, WIDTH - MARGIN), (top, top), color=GRID, linewidth=0.8)
        _text(page, MARGIN, top + 0.1, "Who is in it", weight="bold")
        for number, (name, patch, images) in enumerate(zip(gallery.names, gallery.faces, gallery.counts, strict=True)):
            x, y = MARGIN + step * (number % columns), top + 0.35 + row * (number // columns)
            _face(page, patch, gallery.shape, x, y, face)
            lines = _lines(f"{number + 1} {name}", step - GAP)
            _text(page, x, y + face + 0.05, *lines, size=8)
            text = _lines(f"{images} image{'s' * (images > 1)}", step - GAP)[0]
            _text(page, x, y + face + 0.05 + LINE * len(lines), text, size=8, color=FAINT)
        return figure


def _spaces(page: Axes, gallery: Gallery, top: float) -> None:
    """The mean face at the left; beside it a row of eigenfaces for each space."""
    _text(page, MARGIN, top, "Mean face", weight="bold")
    high = min(LEFT, LEFT * gallery.shape[0] / gallery.shape[1])
    _face(page, gallery.frontal.mean, gallery.shape, MARGIN, top + 0.22, high)
    text = [*textwrap.wrap(calibrated(gallery), 36), "", *textwrap.wrap(stranger(gallery), 36)]
    _text(page, MARGIN, top + high + 0.3, *text, size=8, color=FAINT)
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
        _text(page, x + 1.15, top + 0.01, f"{what}: {kept(space)}", size=8, color=FAINT)
        for vector, value in zip(space.vectors[:EIGENFACES], space.values[:EIGENFACES], strict=True):
            # the sign of a component means nothing; one is kept, so that the same space looks the same
            towards = vector if vector[np.abs(vector).argmax()] > 0 else -vector
            scaled = 2.2 * towards / max(float(np.quantile(np.abs(towards), 0.98)), 1e-9)
            wide = _face(page, scaled, gallery.shape, x, top + 0.22, high)
            _text(page, x, top + 0.25 + high, f"{100 * value / total:.1f} %", size=8, color=FAINT)
            x += max(wide, 0.4) + GAP
        if not len(space.vectors):
            _text(page, x, top + 0.3, "no component", size=8, color=FAINT)
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
    page.plot([x, x + wide, x + wide, x, x], [y, y, y + height, y + height, y], color=GRID, linewidth=0.6)
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
