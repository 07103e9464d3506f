"""A tracker's result drawn over its frame: windows, trails, spread, names, and a bar with the status.

It follows from the rows, as a file has them, so that a finished run is drawn again. A target has a colour of its own,
of a single one each part (as in the plots); what is lost is vermilion, its window dashed. Status shows by form, too: a
dot where tracked, a cross where lost, a hollow diamond at the start, a filled one where a correction gave it. Absent
parts are not drawn. Of a face, points in a box, there are a frame, thin lines and small dots alone, so that the mouth
stays visible; what is lost of it is grey.

A start has a preview (`draw_start`): the frame around its targets, their boxes, and the places of their parts.
"""

import math
import unicodedata
from collections import defaultdict, deque
from collections.abc import Sequence
from itertools import chain, pairwise
from pathlib import Path
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.face_points import LINES
from facetrack_cli.core.files import write_new
from facetrack_cli.core.geometry import centre, shown_angle
from facetrack_cli.core.numbers import clock
from facetrack_cli.core.types import BOX, Array, Frame, Image, Mask, Point, Start
from facetrack_cli.trajectory.trajectory import (
    DECIMALS,
    FrameResult,
    Status,
    TargetResult,
    Trajectory,
    mean_confidence,
    of_frame,
    recorded,
)

Colour = tuple[int, int, int]  # blue, green, red
Ink = tuple[float, ...]
Points = NDArray[np.int32]
# one a target, or of a single target one a part: after Okabe and Ito, told apart by most colour-blind people,
# lightened to stand out from video
PALETTE: tuple[Colour, ...] = (
    (255, 205, 80),  # sky blue
    (70, 232, 250),  # yellow
    (160, 225, 40),  # bluish green
    (222, 150, 240),  # reddish purple
    (255, 140, 100),  # blue
    (240, 240, 240),  # white
)
_LOST: Colour = (25, 110, 255)  # vermilion
_LOST_TEXT: Colour = (110, 165, 255)  # vermilion itself is too dark to read on the bar
_WHITE: Colour = (255, 255, 255)
_GREY: Colour = (175, 175, 175)  # of a face that is lost
_QUIET: Colour = (190, 190, 190)  # of names in doubt, and what is written beside the status
_SHIFT = 4  # cv2's fixed point: sixteenths of a pixel
_CROSS = np.array([[(-1, -1), (1, 1)], [(-1, 1), (1, -1)]])
_DASH = np.array([[(-1, 0), (1, 0)]])
_DIAMOND = 1.2 * np.array([[(0, -1), (1, 0), (0, 1), (-1, 0), (0, -1)]])
_CIRCLE = np.stack([f(np.linspace(0, 2 * np.pi, 33)[:-1]) for f in (np.cos, np.sin)], axis=1)  # (32, 2)
_READ = "x", "y", "w", "h", "angle", "std_x", "std_y", "cov_xy"
_SCALES = 10.0 ** np.array([[DECIMALS[name]] for name in _READ])
_CAP_SHARE = 0.7  # of the size of the type: the height of a capital
_FADES = 4  # steps of opacity along a trail
_MAX_SAMPLES = 32  # earlier places along a trail
_ROOM, _SMALL = 9, 18  # least side of windows with dots, and with large marks, in line widths
_MAX_DOTTED = 6  # parts: of a face with more parts, only points that no line joins have dots, which are tiny
_FACE_DOT = 0.012  # radius of a point's dot, in sizes of its face
_RIM = 0.7  # opacity of the dark rim around all lines
_PLATE = 0.65  # opacity of the dark ground below the name of a target
_DECIDED = 0.5  # an identity less probable than that is doubtful
_PREVIEW_PX: Final = 900  # pixels, about: what is shown is enlarged by a whole factor to come near it


class Shape:
    """The K parts of a target that have a place: `centres` (K, 2), `corners` (K, 4, 2), `side` (K,) the shorter side.

    `place` is that of the target among several, by which it has its colour. Nothing is farther off than `reach`.
    """

    def __init__(self, target: TargetResult, place: int | None, aspect: float, reach: float) -> None:
        every = target.rows
        fine = np.isfinite(every.x + every.y)
        self.target, self.rows = every.target, every if fine.all() else every.take(fine)
        rows = self.rows
        table = np.rint(np.array([getattr(rows, name) for name in _READ]) * _SCALES) / _SCALES
        # points of a network have no windows
        x, y, w, h, angle, *self.spread = np.where(np.isfinite(table), table, 0.0)
        self.parts = tuple(every.names[i][1] for i in rows.which.tolist())
        self.is_face = len(self.parts) > 1 and BOX in self.parts
        self.lost: Mask = rows.status == "lost"
        own = [k if place is None else place for k in np.flatnonzero(fine).tolist()] or [0]
        self.colours = [PALETTE[k % len(PALETTE)] for k in own]
        self.colour = self.colours[-1]  # of the whole target: its box comes last
        self.sizes = np.stack([w, h], axis=1)
        self.side: Array = self.sizes.min(axis=1)
        self.centres: Array = np.clip(np.stack([x, y], axis=1), -reach, reach)
        half = np.maximum(np.minimum(self.sizes, reach) - 1, 2) / 2
        lean = np.radians(shown_angle(angle, 1 / aspect))
        turned = (half[:, :1] * (-1, 1, 1, -1) + 1j * half[:, 1:] * (-1, -1, 1, 1)) * np.exp(1j * lean)[:, None]
        self.corners: Array = self.centres[:, None] + np.stack([turned.real, turned.imag], axis=-1)
        if rows.corners is not None:
            there = np.isfinite(rows.corners).all(axis=(1, 2), keepdims=True)
            self.corners = np.where(there, np.clip(rows.corners, -reach, reach), self.corners)


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
        shapes = []
        for i, target in enumerate(result.targets):
            place = None if alone else self._order.get(target.rows.target, i)
            shapes.append(Shape(target, place, frame.aspect, self._reach))
        for shape in shapes:
            trail = self._remember(shape, frame.time_s)
            if shape.is_face:
                self._features(image, shape)
            if shape.parts:
                self._lines(image, shape, trail[-1:] if shape.is_face else trail)
        names = {shape.target for shape in shapes}
        self._past = {name: past for name, past in self._past.items() if name in names}
        self._names(image, [shape for shape in shapes if shape.parts], named=bool(self._order) or len(shapes) > 1)
        if self._bar:
            self._bar.draw(image, result)
        self._count += 1
        return image

    def _remember(self, shape: Shape, now: float) -> list[_Past]:
        """The places of the target along its trail, oldest first, the present place last."""
        past = self._past.setdefault(shape.target, deque(maxlen=_MAX_SAMPLES + 1))
        # a trail ends at a correction and at an absence
        if past and (past[-1].time_s >= now or past[-1].parts != shape.parts or shape.rows.by_hand.any()):
            past.clear()
        while past and now - past[0].time_s > self.trail_s:
            past.popleft()
        present = _Past(now, self._count // self._stride, shape.parts, shape.centres, shape.lost)
        trail = [*past, present]
        if self._count % self._stride == 0 or not past:
            past.append(present)
        return trail

    def _features(self, image: Image, shape: Shape) -> None:
        """Thin lines between points of a face, and tiny dots, without a rim, which would hide it; grey where lost."""
        place = {part: k for k, part in enumerate(shape.parts)}
        for path in ([place[part] for part in path] for path in LINES if place.keys() >= {*path}):
            for both in map(list, pairwise(path)):
                colour = shape.colours[path[0]] if len(place) <= _MAX_DOTTED else shape.colour
                colour = _GREY if shape.lost[both].any() else colour
                _polylines(image, [_fixed(shape.centres[both])], colour, max(1, self._line - 1))
        dots = [part for part in place if part not in {BOX, *chain(*LINES)}] if len(place) > _MAX_DOTTED else []
        for part in dots:
            colour = _GREY if shape.lost[place[part]] else shape.colour
            mark(image, shape.centres[place[part]].tolist(), "tracked", colour, 0.5 * self._line, 1)

    def _lines(self, image: Image, shape: Shape, trail: list[_Past]) -> None:
        """Trails, ellipses, windows and marks with a dark rim around them, blended at once and only where they are."""
        line, edge = self._line, max(1, self._line // 2)
        fine = max(1, line - 1)
        rings = self._ellipses(shape)
        places = np.array([past.centres for past in trail])
        touched = np.concatenate([each.reshape(-1, 2) for each in (places, shape.corners, *rings.values())])
        signs = self._signs(shape)
        reach = math.ceil(max(signs)) + line + edge
        x0, y0 = np.maximum(np.floor(touched.min(axis=0)).astype(int) - reach, 0).tolist()
        x1, y1 = np.minimum(np.ceil(touched.max(axis=0)).astype(int) + reach + 1, self.size).tolist()
        if x0 >= x1 or y0 >= y1:
            return
        layer = np.zeros((y1 - y0, x1 - x0, 4), np.uint8)  # colours times opacity, and opacity
        origin = np.array((x0, y0), np.float64)
        for (opacity, colour), strokes in self._strokes(trail, _fixed(places - origin), shape.colours).items():
            _polylines(layer, strokes, _ink(colour, opacity), fine)
        gone = _GREY if shape.is_face else _LOST
        tints = [gone if lost else own for lost, own in zip(shape.lost.tolist(), shape.colours, strict=False)]
        for k, ring in rings.items():
            _polylines(layer, [_fixed(ring - origin)], _ink(tints[k], 0.6), fine, closed=True)
        corners = shape.corners - origin
        order = np.argsort(shape.lost, kind="stable").tolist()  # what is lost lies on top
        for k in order:
            is_box = shape.parts[k] == BOX
            if shape.is_face and not is_box:
                continue
            window = list(_fixed(_dashes(corners[k]))) if shape.lost[k] else [_fixed(corners[k])]
            _polylines(layer, window, _ink(tints[k], 1), line + is_box, closed=not shape.lost[k])
        statuses, by_hand, middles = shape.rows.status.tolist(), shape.rows.by_hand.tolist(), shape.centres - origin
        for k in order:
            status, size, at = statuses[k], signs[k], middles[k].tolist()
            if size:
                if status == "tracked" and size >= line:  # a ring of shade, or it would merge with its trail
                    mark(layer, at, status, _ink((0, 0, 0), 0.8), size + line, line)
                mark(layer, at, status, _ink(tints[k], 1), size, line, by_hand=by_hand[k])
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
        paths = np.ascontiguousarray(at.transpose(1, 0, 2))  # (K, T, 2)
        for i, (past, now) in enumerate(pairwise(trail)):
            age = (trail[-1].time_s - past.time_s) / max(self.trail_s, 1e-9)
            opacity = 0.3 + 0.65 * math.floor((1 - min(max(age, 0.0), 1.0)) * _FADES) / _FADES
            for k, (lost, colour) in enumerate(zip(now.lost.tolist(), colours, strict=False)):
                if not lost or now.number % 2:
                    strokes[opacity, _LOST if lost else colour].append(paths[k, i : i + 2])
        return strokes

    def _signs(self, shape: Shape) -> list[float]:
        """The size of each part's mark in pixels; 0 is none, in windows of a few pixels."""
        side, line = shape.side, self._line
        if shape.is_face:  # so small that the mouth between them is seen
            face = float(side[shape.parts.index(BOX)])
            dot = min(1.5 * line, max(_FACE_DOT * face, 0.6)) if len(shape.parts) <= _MAX_DOTTED else 0.0
            return [0.0 if part == BOX else dot for part in shape.parts]
        sizes = np.clip(0.25 * side, 2 * line, 10 * line)
        dots = np.where(side >= _ROOM * line, 1.25 * line, 0.0)
        return list(np.where(shape.rows.status == "tracked", dots, sizes).tolist())

    def _ellipses(self, shape: Shape) -> dict[int, Array]:
        """Two standard deviations around centres, (32, 2) by part; only where that is more than the mark."""
        (sx, sy), xy = np.minimum(shape.spread[:2], self._reach), shape.spread[2]
        # in a small window the dots say as much, with less clutter
        least = np.where(shape.side < _SMALL * self._line, 1.25 * shape.sizes.max(axis=1), 4 * self._line)
        shown = 2 * np.maximum(sx, sy) >= least
        if shape.is_face:  # only of a head that is lost
            shown &= shape.lost & (np.array(shape.parts) == BOX)
        rings = {}
        for k in np.flatnonzero(shown).tolist():
            area = sx[k] * sy[k]
            lean = min(max(xy[k] / area, -1.0), 1.0) if area > 1e-12 else 0.0
            # the Cholesky root carries the circle to the ellipse
            root = 2 * np.array([(sx[k], lean * sy[k]), (0.0, math.sqrt(1 - lean * lean) * sy[k])])
            rings[k] = _CIRCLE @ root + shape.centres[k]
        return rings

    def _names(self, image: Image, shapes: Sequence[Shape], *, named: bool) -> None:
        """Name targets above them, or below them where the bar or the border is there.

        Without an identity a target has a name only if it is `named`.
        """
        (bottom, right), top = image.shape[:2], self._bar.height if self._bar else 0
        gap = 2 * self._line
        for shape in shapes:
            text, colour = _name(shape, named=named)
            low, high = shape.corners.min(axis=(0, 1)), shape.corners.max(axis=(0, 1))
            if not text or (high < 0).any() or (low > (right, bottom)).any():
                continue
            width, height = self._font.width(text), round(1.6 * self._font.cap)
            x = int(min(max((low[0] + high[0] - width) / 2, 0), max(right - width, 0)))
            y = int(low[1]) - height - gap
            y = y if y >= top else min(int(high[1]) + gap, bottom - height)
            plate = image[max(y, 0) : max(y + height, 0), max(x - self._line, 0) : max(x + width + self._line, 0)]
            if plate.size:
                cv2.convertScaleAbs(plate, plate, 1 - _PLATE)
            self._font.write(image, text, x, y + round(1.2 * self._font.cap), colour)


def _name(shape: Shape, *, named: bool) -> tuple[str, Colour]:
    """Who a target is, with the probability, pale and with a question mark where that is low; else its name."""
    who, sure = str(shape.rows.identity[0]), float(shape.rows.identity_prob[0])
    if not who:
        return (shape.target.replace("_", " ") if named else ""), shape.colour
    if not math.isfinite(sure):
        return who, shape.colour
    percent = " >99%" if sure >= 0.995 else f" {sure:.0%}"  # no posterior is certain
    return (f"{who}?{percent}", _QUIET) if sure < _DECIDED else (f"{who}{percent}", shape.colour)


class StatusBar:
    """Writes a summary of each result over the top of images `width` pixels wide, in capitals `cap` pixels high."""

    def __init__(self, width: int, cap: int, line: int, title: str = "") -> None:
        self.height = round(1.9 * cap)
        self._width, self._line, self._title, self._font = width, line, title, Font(cap)

    def draw(self, image: Image, result: FrameResult) -> None:
        """Darken the top `height` rows of `image` (H, W, 3) and write on them, in place, as far as there is room.

        Status, frame and time stand at the left, the mean confidence and the title at the right.
        """
        font, cap, rows = self._font, self._font.cap, result.rows
        strip = image[: self.height]
        cv2.convertScaleAbs(strip, strip, 0.28)
        status, saying = summary(rows)
        gap, base = round(0.8 * cap), (self.height + cap) // 2
        left, right = gap, self._width - gap
        sign = _LOST_TEXT if status == "lost" else _QUIET if status == "absent" else PALETTE[0]
        at = left + 0.4 * cap, base - (cap + 1) / 2
        mark(strip, at, status, sign, 0.37 * cap, self._line, by_hand=bool(rows.by_hand.any()))
        left += round(1.5 * cap)
        lit = _LOST_TEXT if status == "lost" else _WHITE
        frame, time = f"frame {result.frame.index}", clock(result.frame.time_s)
        for text, colour in ((saying, lit), (frame, _WHITE), (time, _WHITE)):
            if left + font.width(text) <= right:
                font.write(strip, text, left, base, colour)
                left += font.width(text) + gap
        sure = rows.confidence[np.isfinite(rows.confidence)]  # 0 % would be a lie of a tracker that does not say
        for text, colour in ((f"{mean_confidence(sure):.0%}" if len(sure) else "", _WHITE), (self._title, _QUIET)):
            if text and left + font.width(text) <= right:
                font.write(strip, text, right - font.width(text), base, colour)
                right -= font.width(text) + gap


def summary(rows: Trajectory) -> tuple[Status, str]:
    """The status of all that is not absent, and what the bar says: what is not tracked, of how many."""
    if not len(rows):
        return "lost", "no target"
    absent, initial = rows.status == "absent", rows.status == "init"
    if absent.all():
        return "absent", "absent"
    unseen: Status
    for unseen in ("lost", "hidden"):
        if (rows.status == unseen).any():
            return unseen, f"{unseen} {(rows.status == unseen).sum()}/{len(rows)}"
    if (by_hand := rows.by_hand & initial).any():
        return "init", f"by hand {by_hand.sum()}/{len(rows)}"
    shown: Status = "init" if (absent | initial).all() else "tracked"
    return shown, f"absent {absent.sum()}/{len(rows)}" if absent.any() else shown


class Font:
    """One size of Pillow's own type, Aileron: capitals `cap` pixels high, and digits of equal width."""

    def __init__(self, cap: int) -> None:
        from PIL import ImageFont  # only where something is drawn: a short run takes as long as its imports

        self.cap = cap
        self._type = ImageFont.load_default(cap / _CAP_SHARE)

    def width(self, text: str) -> int:
        """The width of `text` in pixels."""
        return math.ceil(self._type.getlength(plain(text)))

    def write(self, image: Image, text: str, left: int, base: int, colour: Colour) -> None:
        """Write `text` on `image` (H, W, 3), in place, on the line above row `base`; what falls outside is cut off."""
        from PIL import Image as Pictures
        from PIL import ImageDraw

        x, y = max(left, 0), max(base - 2 * self.cap, 0)
        part = image[y : max(base + self.cap, 0), x : max(left + self.width(text), 0)]
        if part.size:
            picture = Pictures.fromarray(np.ascontiguousarray(part))
            ImageDraw.Draw(picture).text((left - x, base - y), plain(text), colour, self._type, anchor="ls")
            part[...] = np.asarray(picture)


def plain(text: str) -> str:
    """`text` in the characters that the font has: accents dropped, the rest as question marks."""
    bare = (c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))
    return "".join(c if c.isascii() and c.isprintable() else "?" for c in bare)


def _fixed(points: Array) -> Points:
    """Pixels as cv2's fixed point numbers, any shape (..., 2)."""
    return np.rint(points * (1 << _SHIFT)).astype(np.int32)


def _ink(colour: Colour, opacity: float) -> Ink:
    """`colour` for a layer of four channels: times its opacity 0..1, and the opacity as 0..255."""
    return colour[0] * opacity, colour[1] * opacity, colour[2] * opacity, 255 * opacity


def _polylines(image: Image, lines: Sequence[Points], colour: Ink, thickness: int, *, closed: bool = False) -> None:
    """Smooth lines through `lines`, each (n, 2) from `_fixed`, drawn on `image` (H, W, 3 or 4) in place."""
    if len(lines):
        cv2.polylines(image, lines, closed, colour, thickness, cv2.LINE_AA, _SHIFT)


def _dashes(corners: Array) -> Array:
    """A polygon's outline (n, 2) as dashes (m, 2, 2), three a side."""
    sides = np.roll(corners, -1, axis=0) - corners
    ends = np.arange(6).reshape(3, 2) / 5
    return (corners[:, None, None] + ends[..., None] * sides[:, None, None]).reshape(-1, 2, 2)


def mark(
    image: Image, at: Point, status: Status, colour: Ink, size: float, line: int, *, by_hand: bool = False
) -> None:
    """The sign of `status` at (x, y), about `size` pixels to each side, with lines `line` wide, in place."""
    if status in ("tracked", "hidden"):
        x, y, radius = (round(value * (1 << _SHIFT)) for value in (*at, size))
        cv2.circle(image, (x, y), radius, colour, -1 if status == "tracked" else line, cv2.LINE_AA, _SHIFT)
    else:
        shape = {"lost": _CROSS, "absent": _DASH}.get(status, _DIAMOND)
        strokes = list(_fixed(size * shape + at))
        if by_hand and status == "init":
            cv2.fillPoly(image, strokes, colour, cv2.LINE_AA, _SHIFT)
        _polylines(image, strokes, colour, line)


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
