"""A picture of a shape prior: where each part goes, and the few ways in which most of it moves."""

from __future__ import annotations

from typing import TypeAlias

import cv2
import numpy as np

from facetrack_cli.core.types import Array, Image
from facetrack_cli.tracking.models.shape_prior import ShapePrior

# displacements have no place of their own: a neutral face, in mouth widths from the nose, to draw them on
PLACES = {
    "nose": (0.0, 0.0),
    "mouth_left": (-0.5, 0.63),
    "mouth_right": (0.5, 0.63),
    "lip_upper": (0.0, 0.48),
    "lip_lower": (0.0, 0.84),
}
OUTLINE = ("mouth_left", "lip_upper", "mouth_right", "lip_lower")
# blue, green, red; told apart by colour-blind eyes too (Okabe and Ito)
COLOURS = ((90, 90, 90), (178, 114, 0), (0, 94, 213), (115, 158, 0), (167, 121, 204), (0, 159, 230), (233, 180, 86))
INK, FAINT, PAPER = (40, 40, 40), (205, 205, 205), (255, 255, 255)

WIDTH, HEIGHT, CLOUDS = 1280, 760, 700  # pixels; the clouds take the left CLOUDS of them
FINE = 2  # everything is drawn this much larger and shrunk, for clean edges
MODES, EXTENT = 4, 2.0  # modes shown, each from -EXTENT to +EXTENT standard deviations
Colour: TypeAlias = tuple[int, int, int]
Place: TypeAlias = Array | tuple[float, float]  # pixels of the picture


def draw_prior(prior: ShapePrior, title: str, sigma: float) -> Image:
    """(HEIGHT, WIDTH, 3): the training shapes as clouds of points, and the principal modes as small sketches.

    `sigma`, in mouth widths, is drawn as a ring beside the scale bar.
    """
    canvas = np.full((HEIGHT * FINE, WIDTH * FINE, 3), 255, np.uint8)
    base = np.array([PLACES.get(name, _elsewhere(i, len(prior.parts))) for i, name in enumerate(prior.parts)])
    _text(canvas, title, (32, 44), 0.72, INK, 2)
    unit = f"unit: {prior.scale[0]} to {prior.scale[1]} in the first frame; registered by {prior.stable}"
    _text(canvas, f"{len(prior.shapes)} shapes; {unit}", (32, 72), 0.45, INK)
    _clouds(canvas, prior, base, sigma)
    cv2.line(canvas, (CLOUDS * FINE, 100 * FINE), (CLOUDS * FINE, (HEIGHT - 30) * FINE), FAINT, FINE)
    _modes(canvas, prior, base)
    return np.asarray(cv2.resize(canvas, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA), np.uint8)


def _elsewhere(index: int, count: int) -> tuple[float, float]:
    angle = 2.0 * np.pi * index / count
    return float(np.cos(angle)), float(np.sin(angle))


def _clouds(canvas: Image, prior: ShapePrior, base: Array, sigma: float) -> None:
    places = base + prior.shapes
    low, high = places.min((0, 1)), places.max((0, 1))
    zoom = float(min((CLOUDS - 110) / max(high[0] - low[0], 0.5), (HEIGHT - 290) / max(high[1] - low[1], 0.5)))
    origin = np.array([CLOUDS / 2, 120 + (HEIGHT - 290) / 2]) - zoom * (low + high) / 2
    mean = origin + zoom * places.mean(0)
    _outline(canvas, prior.parts, mean, INK, 2)
    moving = [k for k, name in enumerate(prior.parts) if name != prior.stable]
    for k in moving:
        soft = tuple((c + 255) // 2 for c in _colour(prior.parts[k], k))
        for shape in places:
            _disc(canvas, origin + zoom * shape[k], 2.2, (soft[0], soft[1], soft[2]))
    for k in moving:
        _spread(canvas, origin + zoom * places[:, k], _colour(prior.parts[k], k))
    for k, name in enumerate(prior.parts):
        _disc(canvas, mean[k], 7.0, PAPER)
        _disc(canvas, mean[k], 5.5, _colour(prior.parts[k], k))
        if name == prior.stable:
            _text(canvas, name, (mean[k][0] + 14, mean[k][1] + 5), 0.55, _colour(prior.parts[k], k), 2)

    x = 40.0
    for k in moving:
        sd = prior.shapes[:, k].std(0)
        _disc(canvas, (x, HEIGHT - 122), 6.0, _colour(prior.parts[k], k))
        _text(canvas, prior.parts[k], (x + 14, HEIGHT - 117), 0.5, INK)
        _text(canvas, f"sd {sd[0]:.2f}, {sd[1]:.2f}", (x + 14, HEIGHT - 98), 0.4, INK)
        x += (CLOUDS - 60) / len(moving)
    unit = "mouth widths" if set(prior.scale) == {"mouth_left", "mouth_right"} else "units"
    bar, y = (0.25 if zoom > 200 else 2.0), HEIGHT - 48
    end = 40 + bar * zoom
    _line(canvas, (40, y), (end, y), INK, 2)
    for x in (40, end):
        _line(canvas, (x, y - 5), (x, y + 5), INK, 2)
    _text(canvas, f"{bar:g} {unit}", (end + 14, y + 5), 0.45, INK)
    radius = sigma * zoom
    if radius < 40:
        cv2.circle(canvas, _at((end + 230, y)), round(radius * FINE * 16), INK, FINE, cv2.LINE_AA, 4)
    _text(canvas, f"kernel of sigma {sigma:.3f}", (end + 242 + (radius if radius < 40 else 0), y + 5), 0.45, INK)


def _modes(canvas: Image, prior: ShapePrior, base: Array) -> None:
    flat = prior.shapes.reshape(len(prior.shapes), -1)
    centred = flat - flat.mean(0)
    _, strength, ways = np.linalg.svd(centred, full_matrices=False)
    ways = ways * np.where(ways[np.arange(len(ways)), np.abs(ways).argmax(1)] < 0, -1.0, 1.0)[:, None]  # a fixed sign
    variance = strength**2 / len(flat)
    share = variance / max(float(variance.sum()), 1e-12)
    count = min(MODES, int((share > 0.005).sum()))
    left, row = CLOUDS + 30, (HEIGHT - 150) / MODES
    _text(canvas, "Principal modes, and their share of the variance", (left, 112), 0.55, INK, 2)
    if not count:
        _text(canvas, "none: all shapes are the same", (left, 150), 0.45, INK)
        return
    column = (WIDTH - left - 60) / 3
    offsets = (-EXTENT, 0.0, EXTENT)
    mean = base + prior.shapes.mean(0)
    faces = {
        (m, s): mean + s * np.sqrt(variance[m]) * ways[m].reshape(mean.shape) for m in range(count) for s in offsets
    }
    every = np.stack(list(faces.values()))
    low, high = every.min((0, 1)), every.max((0, 1))
    zoom = float(min((column - 40) / max(high[0] - low[0], 0.5), (row - 44) / max(high[1] - low[1], 0.5)))
    for m in range(count):
        top = 140 + m * row
        _text(canvas, f"{100 * share[m]:.0f} %", (left, top + 10 + row / 2), 0.5, INK)
        for c, s in enumerate(offsets):
            origin = np.array([left + 50 + (c + 0.5) * column, top + 22 + (row - 40) / 2]) - zoom * (low + high) / 2
            _outline(canvas, prior.parts, origin + zoom * mean, FAINT, 1)
            places = origin + zoom * faces[m, s]
            _outline(canvas, prior.parts, places, INK, 2)
            for k in range(len(prior.parts)):
                _disc(canvas, places[k], 3.5, _colour(prior.parts[k], k))
            if not m:
                _text(canvas, f"{s:+g} sd" if s else "mean", (left + 50 + (c + 0.5) * column - 18, top + 10), 0.45, INK)


def _outline(canvas: Image, parts: tuple[str, ...], places: Array, colour: Colour, width: int) -> None:
    """Both lips as parabolas through their middle, from corner to corner, where the prior has a mouth."""
    if not set(OUTLINE) <= set(parts):
        return
    left, upper, right, lower = (places[parts.index(name)] for name in OUTLINE)
    t = np.linspace(0.0, 1.0, 33)[:, None]
    for middle in (upper, lower):
        control = 2.0 * middle - 0.5 * (left + right)
        curve = (1 - t) ** 2 * left + 2 * t * (1 - t) * control + t**2 * right
        line = np.round(curve * FINE * 16).astype(np.int32)
        cv2.polylines(canvas, [line[:, None]], False, colour, width * FINE, cv2.LINE_AA, 4)


def _spread(canvas: Image, places: Array, colour: Colour) -> None:
    """The ellipse of two standard deviations."""
    values, vectors = np.linalg.eigh(np.cov(places.T) if len(places) > 1 else np.zeros((2, 2)))
    axes = 2.0 * np.sqrt(np.maximum(values, 0.0))
    angle = np.linspace(0.0, 2.0 * np.pi, 73)
    ring = (
        places.mean(0)
        + np.outer(np.cos(angle) * axes[0], vectors[:, 0])
        + np.outer(np.sin(angle) * axes[1], vectors[:, 1])
    )
    cv2.polylines(canvas, [np.round(ring * FINE * 16).astype(np.int32)[:, None]], True, colour, 3, cv2.LINE_AA, 4)


def _colour(name: str, k: int) -> Colour:
    known = list(PLACES)
    return COLOURS[(known.index(name) if name in known else len(known) + k) % len(COLOURS)]


def _at(place: Place) -> tuple[int, int]:
    return round(float(place[0]) * FINE * 16), round(float(place[1]) * FINE * 16)


def _disc(canvas: Image, centre: Place, radius: float, colour: Colour) -> None:
    cv2.circle(canvas, _at(centre), round(radius * FINE * 16), colour, -1, cv2.LINE_AA, 4)


def _line(canvas: Image, a: Place, b: Place, colour: Colour, width: int) -> None:
    cv2.line(canvas, _at(a), _at(b), colour, width * FINE, cv2.LINE_AA, 4)


def _text(canvas: Image, text: str, place: Place, size: float, colour: Colour, bold: int = 1) -> None:
    at = round(float(place[0]) * FINE), round(float(place[1]) * FINE)
    plain = text.encode("ascii", "replace").decode()  # OpenCV's letters are ASCII
    cv2.putText(canvas, plain, at, cv2.FONT_HERSHEY_SIMPLEX, size * FINE, colour, bold + 1, cv2.LINE_AA)
