"""A tracker's result drawn over its frame: windows, trails, spread of the particles, status.

A target has a colour of its own, of a single one each part (as in the plots); what is lost is vermilion, its window
dashed. Absent parts are not drawn. Of a face, points in a box, there are a frame, thin lines and small dots alone, so
that the mouth stays visible; what is lost of it is grey.

A start has a preview (`draw_start`): the frame around its targets, their boxes, and the places of their parts.
"""

import math
from collections import defaultdict, deque
from collections.abc import Sequence
from itertools import chain, pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple

import cv2
import numpy as np

from facetrack_cli.core.face_points import LINES
from facetrack_cli.core.files import write_new
from facetrack_cli.core.geometry import centre, shown_angle
from facetrack_cli.core.types import BOX, Array, Frame, Image, Mask, Start
from facetrack_cli.trajectory.trajectory import FrameResult, TargetResult, of_frame, recorded
from facetrack_cli.video.overlay_labels import (
    GREY,
    LOST,
    PALETTE,
    Colour,
    Font,
    Points,
    Shape,
    StatusBar,
    dashes,
    fixed,
    ink,
    lay_insets,
    mark,
    polylines,
    write_names,
)

_FADES = 4  # steps of opacity along a trail
_MAX_SAMPLES = 32  # earlier places along a trail
_MAX_DOTS = 150  # particles shown of a part
_ROOM, _SMALL = 9, 18  # least side of windows with dots, and with large marks, in line widths
_MAX_DOTTED = 6  # parts: of a face with more parts, only points that no line joins have dots, which are tiny
_FACE_DOT = 0.012  # radius of a point's dot, in sizes of its face
_RIM = 0.7  # opacity of the dark rim around all lines
_CIRCLE = np.stack([f(np.linspace(0, 2 * np.pi, 33)[:-1]) for f in (np.cos, np.sin)], axis=1)  # (32, 2)


class _Past(NamedTuple):
    time_s: float
    number: int
    parts: tuple[str, ...]
    centres: Array
    lost: Mask


class Overlay:
    """Draws results over their frames; it keeps the last `trail_s` seconds of them, and no more.

    Give the results in their order; a time that goes back starts the trails again. Lines and type follow the height.

    Parameters
    ----------
    size : (width, height) of all frames, in pixels.
    fps : their nominal rate, in frames per second.
    title : stands in the status bar.
    trail_s : the length of trails, in seconds.
    order : names of targets; colours follow their places in it, else in the result.
    """

    def __init__(
        self,
        size: tuple[int, int],
        *,
        fps: float = 25.0,
        title: str = "",
        trail_s: float = 1.0,
        order: Sequence[str] = (),
    ) -> None:
        self.size = size
        self._order = {name: place for place, name in enumerate(order)}
        self.trail_s = trail_s
        width, height = size
        scale = min(height, 0.75 * width)  # of portrait frames the width counts
        self._line = line = max(1, round(scale / 480))
        cap = 7 if scale < 160 else 8
        self._font = Font(max(cap, round(0.017 * scale)))
        bar = StatusBar(width, max(cap, round(0.019 * scale)), line, title)
        self._bar = bar if height >= 48 and width >= 48 else None  # in tiny frames there is no room for it
        self._stride = max(1, math.ceil(fps * trail_s / _MAX_SAMPLES)) if math.isfinite(fps * trail_s) else 1
        self._past: dict[str, deque[_Past]] = {}
        self._reach = 4.0 * max(size)
        self._count = 0

    @property
    def memory(self) -> Any:
        """What it keeps of the frames so far, so that another one goes on in its place."""
        return self._count, self._past

    @memory.setter
    def memory(self, memory: Any) -> None:
        self._count, self._past = memory

    def draw(self, result: FrameResult) -> Image:
        """An image of the frame with its result; parts without a finite place are left out.

        Parameters
        ----------
        result : of the next frame.

        Returns
        -------
        (H, W, 3) uint8, blue first : a new image of the frame's size; the frame stays as it is.

        Raises
        ------
        ValueError : for a frame that is not of this overlay's size.
        """
        frame = result.frame
        if frame.size != tuple(self.size):
            raise ValueError(f"frame {frame.index} is {frame.size}, the overlay {self.size}")
        image: Image = frame.bgr.copy()
        alone = len(result.targets) == 1 and not self._order
        places = [self._order.get(target.rows.target, i) for i, target in enumerate(result.targets)]
        pairs = zip(result.targets, places, strict=True)
        shapes = [self._shape(target, place, frame.aspect, alone=alone) for target, place in pairs]
        style = self._bar.height if self._bar else 0, self._line, self._font
        lay_insets(image, shapes, self._line, self._font)  # below the lines, where they have to cross
        for shape in shapes:
            trail = self._remember(shape, frame.time_s)
            if shape.parts:
                (self._features if shape.is_face else self._cloud)(image, shape)
                self._lines(image, shape, trail[-1:] if shape.is_face else trail)
        names = {shape.target for shape in shapes}
        self._past = {name: past for name, past in self._past.items() if name in names}
        write_names(image, shapes, *style, named=bool(self._order))
        if self._bar:
            self._bar.draw(image, result)
        self._count += 1
        return image

    def _shape(self, target: TargetResult, place: int, aspect: float = 1.0, *, alone: bool) -> Shape:
        every = target.rows
        fine = np.isfinite(every.x + every.y)
        rows = every if fine.all() else every.take(fine)
        sizes = np.nan_to_num(np.stack([rows.w, rows.h], axis=1))  # points of a network have no windows
        table = np.clip(np.column_stack([rows.x, rows.y, sizes]), -self._reach, self._reach)
        half = np.maximum(table[:, 2:] - 1, 2) / 2
        corners = half[:, None] * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
        angle = np.radians(shown_angle(np.where(np.isfinite(rows.angle), rows.angle, 0.0), 1 / aspect))
        if angle.any():
            cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
            x, y = corners[..., 0], corners[..., 1]
            corners = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
        corners = corners + table[:, None, :2]
        if rows.corners is not None:
            turned = np.isfinite(rows.corners).all(axis=(1, 2), keepdims=True)
            corners = np.where(turned, np.clip(rows.corners, -self._reach, self._reach), corners)
        shown = np.flatnonzero(fine)
        cloud = target.cloud[:, shown[shown < target.cloud.shape[1]]] if target.cloud.ndim == 3 else target.cloud
        parts = tuple(every.names[i][1] for i in rows.which.tolist())
        lost: Mask = rows.status == "lost"
        centres = table[:, :2]
        colours = tuple(PALETTE[(k if alone else place) % len(PALETTE)] for k in shown.tolist()) or (PALETTE[0],)
        return Shape(every.target, rows, parts, cloud, target.insets, centres, sizes, corners, lost, colours)

    def _remember(self, shape: Shape, now: float) -> list[_Past]:
        """The places of the target along its trail, oldest first, the present place last."""
        past = self._past.setdefault(shape.target, deque(maxlen=_MAX_SAMPLES + 1))
        if past and not past[-1].time_s < now:
            past.clear()
        # a trail ends at a correction and at an absence
        if past and (past[-1].parts != shape.parts or shape.rows.by_hand.any()):
            past.clear()
        while past and now - past[0].time_s > self.trail_s:
            past.popleft()
        present = _Past(now, self._count // self._stride, shape.parts, shape.centres, shape.lost)
        trail = [*past, present]
        if self._count % self._stride == 0 or not past:
            past.append(present)
        return trail

    def _cloud(self, image: Image, shape: Shape) -> None:
        """Faint dots at the particles, evenly thinned out."""
        cloud = shape.cloud
        if cloud.ndim != 3 or not len(cloud):
            return
        shown = (shape.side >= _ROOM * self._line)[: cloud.shape[1]]
        if not shown.any():
            return
        width, height = self.size
        dots = cloud[:: math.ceil(len(cloud) / _MAX_DOTS), shown]  # (n, K, 2)
        # fmin and fmax pass over NaN, which lands outside
        at = np.rint(np.fmax(np.fmin(dots, max(self.size) + 9), -9)).astype(np.int64)
        spread = np.arange(self._line) - (self._line - 1) // 2
        x = at[..., 0, None, None] + spread
        y = at[..., 1, None, None] + spread[:, None]
        x, y = np.broadcast_arrays(x, y)  # (n, K, line, line)
        inside = (x.astype(np.uint64) < width) & (y.astype(np.uint64) < height)  # negative ones wrap to huge
        lost = shape.lost[: len(shown)][shown]
        own = np.array(shape.colours)[: len(shown)][shown]
        tints = (100 * np.where(lost[:, None], LOST, own)).astype(np.uint16)
        part = np.broadcast_to(np.arange(len(lost))[:, None, None], inside.shape)
        spots, flat = (y * width + x)[inside], image.reshape(-1, 3)
        flat[spots] = (flat[spots] * np.uint16(156) + tints[part[inside]]) >> np.uint16(8)

    def _features(self, image: Image, shape: Shape) -> None:
        """Thin lines between points of a face, and tiny dots, without a rim, which would hide it; grey where lost."""
        place = {part: k for k, part in enumerate(shape.parts)}
        for path in ([place[part] for part in path] for path in LINES if place.keys() >= {*path}):
            for both in map(list, pairwise(path)):
                colour = shape.colours[path[0]] if len(place) <= _MAX_DOTTED else shape.colour
                colour = GREY if shape.lost[both].any() else colour
                polylines(image, [fixed(shape.centres[both])], colour, max(1, self._line - 1))
        dots = [part for part in place if part not in {BOX, *chain(*LINES)}] if len(place) > _MAX_DOTTED else []
        for part in dots:
            colour = GREY if shape.lost[place[part]] else shape.colour
            mark(image, shape.centres[place[part]].tolist(), "tracked", colour, 0.5 * self._line, 1, False)

    def _lines(self, image: Image, shape: Shape, trail: list[_Past]) -> None:
        """Trails, ellipses, windows and marks with a dark rim around them, blended at once and only where they are."""
        line, edge = self._line, max(1, self._line // 2)
        fine = max(1, line - 1)
        rings, ring_parts = self._ellipses(shape)  # (R, 32, 2)
        places = [p.centres for p in trail]
        touched = np.concatenate([*places, shape.corners.reshape(-1, 2), rings.reshape(-1, 2)])
        signs = self._signs(shape)
        reach = math.ceil(max(signs)) + line + edge
        x0, y0 = np.maximum(np.floor(touched.min(axis=0)).astype(int) - reach, 0).tolist()
        x1, y1 = np.minimum(np.ceil(touched.max(axis=0)).astype(int) + reach + 1, self.size).tolist()
        if x0 >= x1 or y0 >= y1:
            return
        layer = np.zeros((y1 - y0, x1 - x0, 4), np.uint8)  # colours times opacity, and opacity
        origin = np.array((x0, y0), np.float64)
        for (opacity, colour), strokes in self._strokes(trail, fixed(np.array(places) - origin), shape.colours).items():
            polylines(layer, strokes, ink(colour, opacity), fine)
        gone = GREY if shape.is_face else LOST
        tints = [gone if lost else own for lost, own in zip(shape.lost.tolist(), shape.colours, strict=False)]
        for ring, k in zip(fixed(rings - origin), ring_parts, strict=True):
            polylines(layer, [ring], ink(tints[k], 0.6), fine, closed=True)
        local = shape.corners - origin
        windows, middles = fixed(local), (shape.centres - origin).tolist()
        order = np.argsort(shape.lost, kind="stable").tolist()  # what is lost lies on top
        for k in order:
            tint, part = tints[k], shape.parts[k]
            if shape.is_face and part != BOX:
                continue
            weight = line + (part == BOX)
            if shape.lost[k]:
                polylines(layer, list(fixed(dashes(local[k], 10 * line))), ink(tint, 1), weight)
            else:
                polylines(layer, [windows[k]], ink(tint, 1), weight, closed=True)
        statuses, by_hand = shape.rows.status.tolist(), shape.rows.by_hand.tolist()
        for k in order:
            status, size, at = statuses[k], signs[k], middles[k]
            if size:
                if status == "tracked" and size >= line:  # a ring of shade, or it would merge with its trail
                    mark(layer, at, status, ink((0, 0, 0), 0.8), size + line, line, False)
                mark(layer, at, status, ink(tints[k], 1), size, line, by_hand[k])
        cover = cv2.extractChannel(layer, 3)
        dark = cv2.dilate(cover, np.ones((2 * edge + 1, 2 * edge + 1), np.uint8))
        keep = cv2.bitwise_not(cv2.max(cover, cv2.convertScaleAbs(dark, None, _RIM)))
        under = image[y0:y1, x0:x1]
        cv2.multiply(under, cv2.cvtColor(keep, cv2.COLOR_GRAY2BGR), under, 1 / 255)
        cv2.add(under, cv2.cvtColor(layer, cv2.COLOR_BGRA2BGR), under)

    def _strokes(
        self, trail: list[_Past], at: Points, colours: Sequence[Colour]
    ) -> dict[tuple[float, Colour], list[Points]]:
        """The trail's lines by opacity and colour, faint to strong; where a part was lost, dashes in vermilion."""
        strokes: dict[tuple[float, Colour], list[Points]] = defaultdict(list)
        paths = np.ascontiguousarray(at.reshape(len(trail), -1, 2).transpose(1, 0, 2))  # (K, T, 2)
        for i, (past, now) in enumerate(pairwise(trail)):
            age = (trail[-1].time_s - past.time_s) / max(self.trail_s, 1e-9)
            opacity = 0.3 + 0.65 * math.floor((1 - min(max(age, 0.0), 1.0)) * _FADES) / _FADES
            for k, (lost, colour) in enumerate(zip(now.lost.tolist(), colours, strict=False)):
                if not lost or now.number % 2:
                    strokes[opacity, LOST if lost else colour].append(paths[k, i : i + 2])
        return strokes

    def _signs(self, shape: Shape) -> list[float]:
        """The size of each part's mark in pixels; 0 is none, in windows of a few pixels."""
        side = shape.side
        if shape.is_face:  # so small that the mouth between them is seen
            face = float(shape.side[shape.parts.index(BOX)])
            dot = min(1.5 * self._line, max(_FACE_DOT * face, 0.6)) if len(shape.parts) <= _MAX_DOTTED else 0.0
            return [0.0 if part == BOX else dot for part in shape.parts]
        share = np.where(shape.lost & (side >= _SMALL * self._line), 0.3, 0.2)
        large = np.maximum(2 * self._line, share * np.minimum(side, 40 * self._line))
        dots = np.where(side >= _ROOM * self._line, 1.25 * self._line, 0.0)
        sizes: list[float] = np.where(shape.rows.status == "tracked", dots, large).tolist()
        return sizes

    def _ellipses(self, shape: Shape) -> tuple[Array, list[int]]:
        """Two standard deviations around centres, (R, 32, 2), and whose; only where that is more than the mark."""
        rows = shape.rows
        spreads = np.array([rows.std_x, rows.std_y])
        sx, sy = np.minimum(np.where(np.isfinite(spreads), spreads, 0.0), self._reach)
        # in a small window the dots say as much, with less clutter
        least = np.where(shape.side < _SMALL * self._line, 1.25 * shape.sizes.max(axis=1), 4 * self._line)
        shown = 2 * np.maximum(sx, sy) >= least
        if shape.is_face:  # only of a head that is lost
            shown &= shape.lost & (np.array(shape.parts) == BOX)
        whose = np.flatnonzero(shown)
        if not len(whose):
            return np.empty((0, len(_CIRCLE), 2)), []
        sx, sy, xy = sx[whose], sy[whose], np.nan_to_num(rows.cov_xy[whose])
        spread = sx * sy > 1e-12
        lean = np.where(spread, np.clip(xy / np.where(spread, sx * sy, 1.0), -1.0, 1.0), 0.0)
        # the Cholesky root carries the circle to the ellipse
        roots = np.zeros((len(whose), 2, 2))
        roots[:, 0] = np.stack([2 * sx, 2 * lean * sy], axis=1)
        roots[:, 1, 1] = 2 * np.sqrt(1 - lean * lean) * sy
        rings: Array = _CIRCLE @ roots + shape.centres[whose, None]
        return rings, whose.tolist()


_PREVIEW_PX: Final = 900  # pixels, about: what is shown is enlarged by a whole factor to come near it


def write_preview(path: Path, frame: Frame, start: Start, *, overwrite: bool = False) -> None:
    """`draw_start` as a PNG file. OutputError if it exists and `overwrite` is not set, or cannot be written."""
    write_new(path, cv2.imencode(".png", draw_start(frame, start))[1].tobytes(), overwrite=overwrite)


def draw_start(frame: Frame, start: Start) -> Image:
    """The start, drawn as in a run, on what is around its targets, enlarged by a whole factor; BGR."""
    rows: list[tuple[str, str, float, float, float, float]] = []
    for name, target in start.targets.items():
        rows += [(name, part, x, y, 0.0, 0.0) for part, (x, y) in target.points.items()]
        if target.box is not None:
            rows.append((name, BOX, *centre(target.box), *target.box[2:]))
    at, size = np.split(np.array([row[2:] for row in rows]), 2, axis=1)
    low, high = (at - size / 2).min(axis=0), (at + size / 2).max(axis=0)
    around = max(20.0, 0.7 * float((high - low).max()))
    x0, y0 = np.clip((low - around).astype(int), 0, np.array(frame.size) - 1).tolist()
    x1, y1 = np.clip((high + around).astype(int) + 1, (x0 + 1, y0 + 1), frame.size).tolist()
    part = frame.bgr[y0:y1, x0:x1]
    zoom = max(1, round(_PREVIEW_PX / max(part.shape[:2])))
    # a pixel covers zoom x zoom pixels
    shown = Frame(start.frame, frame.time_s, np.repeat(np.repeat(part, zoom, axis=0), zoom, axis=1))
    x, y, w, h = np.hstack([(at - (x0, y0) + 0.5) * zoom - 0.5, zoom * size]).T
    names = tuple((name, part) for name, part, *_ in rows)
    table = of_frame(names, shown, {}, x=x, y=y, w=w, h=h, status=["init"] * len(rows))
    return Overlay(shown.size, order=[*start.targets]).draw(FrameResult(shown, recorded(start.frame, table)))
