"""A picture of a gallery: the mean face, the first eigenfaces of its three spaces, and everyone who is in it."""

from __future__ import annotations

import math
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Image
from facetrack_cli.tracking.identity.gallery import Gallery
from facetrack_cli.tracking.identity.subspaces import Subspace
from facetrack_cli.video.overlay.marks import Colour, Font, plain, stamp

WIDTH, MARGIN, GAP = 1280, 32, 12  # pixels
MEAN: Final = 250  # height of the mean face, and its width at most
EIGENFACE: Final = 122  # and of each eigenface
SHOWN: Final = 8  # eigenfaces of a space, at most
TALLEST, SMALL, SMALLEST = 190, 100, 72  # height of a person's face: many are drawn smaller, and
MANY: Final = 60  # more than so many smallest
INK, FAINT, PAPER, RULE = (40, 40, 40), (115, 115, 115), 255, (215, 215, 215)
TITLE, HEAD, BODY = Font(15), Font(11), Font(9)


def draw_gallery(gallery: Gallery, title: str) -> Image:
    """(H, WIDTH, 3), all of it grey; H grows with the number of persons.

    A name that has no room on two lines is cut; the numbers are those of the list that `gallery show` prints.
    """
    above = _heading(gallery, title)
    spaces = _spaces(gallery)
    people = _people(gallery)
    rule = np.full((1, WIDTH, 3), PAPER, np.uint8)
    rule[:, MARGIN:-MARGIN] = RULE
    return np.concatenate([above, spaces, rule, people, _paper(MARGIN // 2)])


def _heading(gallery: Gallery, title: str) -> Image:
    page = _paper(74)
    _write(page, TITLE, _cut(TITLE, title, WIDTH - 2 * MARGIN), MARGIN, 24)
    rows, cols = gallery.shape
    told = f"{len(gallery.names)} persons, {sum(gallery.counts)} pictures; template {rows} points high, {cols} wide"
    _write(page, HEAD, told, MARGIN, 50, FAINT)
    return page


def _spaces(gallery: Gallery) -> Image:
    """The mean face at the left; beside it a row of eigenfaces for each space."""
    row = EIGENFACE + 58
    page = _paper(3 * row + 6)
    mean = _face(gallery.frontal.mean, gallery.shape, _within(MEAN, gallery.shape))
    _write(page, HEAD, "Mean face", MARGIN, 6)
    _tile(page, mean, MARGIN, 30)
    column = max(mean.shape[1], 200)
    told = [*_wrapped(calibrated(gallery), column), "", *_wrapped(stranger(gallery), column)]
    for number, text in enumerate(told):
        _write(page, BODY, text, MARGIN, 46 + mean.shape[0] + number * BODY.height, FAINT)
    left = MARGIN + column + 46
    spaces = (
        ("Frontal faces", "what a face looks like", gallery.frontal),
        ("Intra-personal", "how pictures of one person differ", gallery.intra),
        ("Extra-personal", "how persons differ", gallery.extra),
    )
    for number, (name, what, space) in enumerate(spaces):
        top = number * row + 6
        end = _write(page, HEAD, name, left, top)
        _write(page, BODY, f"{what}: {kept(space)}", end + 12, top + 1, FAINT)
        _eigenfaces(page, space, gallery.shape, left, top + 24)
    return page


def _eigenfaces(page: Image, space: Subspace, shape: tuple[int, int], left: int, top: int) -> None:
    total = _total(space)
    for vector, value in zip(space.vectors[:SHOWN], space.values[:SHOWN], strict=True):
        # the sign of a component means nothing; one is kept, so that the same space looks the same
        towards = vector if vector[np.abs(vector).argmax()] > 0 else -vector
        face = _face(
            2.2 * towards / max(float(np.quantile(np.abs(towards), 0.98)), 1e-9), shape, _within(EIGENFACE, shape)
        )
        if left + face.shape[1] > WIDTH - MARGIN:
            return
        _tile(page, face, left, top)
        _write(page, BODY, f"{100 * value / total:.1f} %", left, top + EIGENFACE + 4, FAINT)
        left += face.shape[1] + GAP
    if not len(space.vectors):
        _write(page, BODY, "no component", left, top + 10, FAINT)


def _people(gallery: Gallery) -> Image:
    """Everyone's face I_n, with number, name and how many pictures it is made from."""
    rows, cols = gallery.shape
    count, wide = len(gallery.names), WIDTH - 2 * MARGIN + 2 * GAP
    columns = _columns(count, wide, cols / rows)
    height = min(TALLEST, int((wide / columns - 2 * GAP) * rows / cols))
    face_width = round(height * cols / rows)
    step, line = face_width + 2 * GAP, BODY.height
    row = height + 3 * line + 14
    page = _paper(44 + row * -(-count // columns))
    _write(page, HEAD, "Who is in it", MARGIN, 14)
    for number, (name, face, pictures) in enumerate(zip(gallery.names, gallery.faces, gallery.counts, strict=True)):
        top, left = 42 + row * (number // columns), MARGIN + step * (number % columns)
        _tile(page, _face(face, gallery.shape, height), left, top)
        top += height + 4
        lines = _lines(f"{number + 1} {name}", step - GAP)
        for at, text in enumerate(lines):
            _write(page, BODY, text, left, top + at * line)
        told = f"{pictures} pictures" if pictures != 1 else "1 picture"
        _write(page, BODY, _cut(BODY, told, step - GAP), left, top + len(lines) * line, FAINT)
    return page


def _columns(count: int, wide: int, aspect: float) -> int:
    """As many columns as make rows of about equal length, with faces no smaller than they must be."""
    least = SMALL if count <= MANY else SMALLEST
    most = max(int(wide / (least * aspect + 2 * GAP)), 1)
    return -(-count // -(-count // most))


def kept(space: Subspace) -> str:
    """How much of a space its components keep, in words."""
    number = len(space.vectors)
    components = "1 component" if number == 1 else f"{number} components"
    return f"{components}, {100 * float(space.values.sum()) / _total(space):.0f} % of the variance to be expected"


def calibrated(gallery: Gallery) -> str:
    """When a patch counts as a frontal face in its place, in words."""
    slope, offset = gallery.calibration
    if not slope:
        return (
            f"p_f is {gallery.most_frontal / 2:.2f} for whatever is seen: the gallery does not tell faces from others"
        )
    half, tenths = -offset / slope, math.log(9) / slope
    return (
        f"p_f is half of its most at a log density of {half:.0f}, a tenth at {half - tenths:.0f} and nine tenths at "
        f"{half + tenths:.0f}; its most is {gallery.most_frontal:g}"
    )


def stranger(gallery: Gallery) -> str:
    """Who is none of them, in words."""
    return (
        f"none of them: below a log ratio of {gallery.threshold:.0f}; {100 * gallery.errors:.0f} % of either error here"
    )


def _total(space: Subspace) -> float:
    return max(float(space.values.sum() + space.rho * (space.mean.size - len(space.vectors))), 1e-12)


def _face(patch: NDArray[np.floating], shape: tuple[int, int], height: int) -> Image:
    """A patch (d,) of zero mean and unit variance as a grey picture (height, w, 3), smoothly enlarged."""
    rows, cols = shape
    grey = 128.0 + 52.0 * np.asarray(patch, np.float32).reshape(rows, cols)
    large = cv2.resize(grey, (max(round(height * cols / rows), 1), height), interpolation=cv2.INTER_CUBIC)
    return np.repeat(np.clip(np.round(large), 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def _within(side: int, shape: tuple[int, int]) -> int:
    """The height of a face that is nowhere longer than `side`."""
    return max(min(side, side * shape[0] // shape[1]), 1)


def _tile(page: Image, face: Image, left: int, top: int) -> None:
    height, width = face.shape[:2]
    page[top - 1 : top + height + 1, left - 1 : left + width + 1] = RULE
    page[top : top + height, left : left + width] = face


def _lines(text: str, wide: int) -> list[str]:
    """A name on one line or, broken where it has a gap if it can be, on two; the second is cut."""
    text = plain(text)
    if BODY.width(text) <= wide:
        return [text]
    fits = max((at for at in range(1, len(text)) if BODY.width(text[:at]) <= wide), default=1)
    gaps = [at for at in range(fits // 2 + 1, fits + 1) if text[at] in " _-"]
    at = gaps[-1] if gaps else fits
    return [text[:at], _cut(BODY, text[at:].lstrip(), wide)]


def _wrapped(text: str, wide: int) -> list[str]:
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        lines = [*lines[:-1], longer] if BODY.width(longer) <= wide else [*lines, word]
    return lines


def _cut(font: Font, text: str, wide: int) -> str:
    text = plain(text)
    if font.width(text) <= wide:
        return text
    while text and font.width(text + "..") > wide:
        text = text[:-1]
    return text + ".."


def _write(page: Image, font: Font, text: str, left: int, top: int, colour: Colour = INK) -> int:
    """Where the text ends."""
    stamp(page, font.sprite(text, colour), left, top)
    return left + font.width(text)


def _paper(height: int) -> Image:
    return np.full((height, WIDTH, 3), PAPER, np.uint8)
