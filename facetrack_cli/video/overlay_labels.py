"""What is written on a frame, names, the status bar, templates in the corners; and colours, strokes and letters for it.

Status shows by form as well as by colour: a dot where tracked, a cross where lost, a hollow diamond at the start, a
filled one where a correction gave it, a dash for what is absent. Since `cv2.putText` smears text of 8 px, glyphs are
drawn four times too large at every quarter of a pixel and averaged down, and the crispest is kept.

Templates are shown as in Zhou et al. 2003, fig. 3.
"""

import math
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.numbers import clock
from facetrack_cli.core.types import BOX, Array, Image, Mask, Point
from facetrack_cli.trajectory.trajectory import FrameResult, Status, Trajectory

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
LOST: Colour = (25, 110, 255)  # vermilion
WHITE: Colour = (255, 255, 255)
GREY: Colour = (175, 175, 175)  # of a face that is lost
_SHIFT = 4  # cv2's fixed point: sixteenths of a pixel
_CROSS = np.array([[(-1, -1), (1, 1)], [(-1, 1), (1, -1)]])
_DASH = np.array([[(-1, 0), (1, 0)]])
_DIAMOND = 1.2 * np.array([[(0, -1), (1, 0), (0, 1), (-1, 0), (0, -1)]])
_FINER = 4
_FACE = cv2.FONT_HERSHEY_SIMPLEX
_HERSHEY_CAP = 21  # units from baseline to the top of a capital
_OUTLINE_CAP = 20.5  # the same of OpenCV 5, whose letters are outlines: a stroke adds nothing to their height
_KEPT = 256


def fixed(points: Array) -> Points:
    """Pixels as cv2's fixed point numbers, any shape (..., 2)."""
    return np.rint(points * (1 << _SHIFT)).astype(np.int32)


def ink(colour: Colour, opacity: float) -> Ink:
    """`colour` for a layer of four channels: times its opacity 0..1, and the opacity as 0..255."""
    return colour[0] * opacity, colour[1] * opacity, colour[2] * opacity, 255 * opacity


def polylines(image: Image, lines: Sequence[Points], colour: Ink, thickness: int, *, closed: bool = False) -> None:
    """Smooth lines through `lines`, each (n, 2) from `fixed`, drawn on `image` (H, W, 3 or 4) in place."""
    if len(lines):
        cv2.polylines(image, lines, closed, colour, thickness, cv2.LINE_AA, _SHIFT)


def dashes(corners: Array, pitch: float) -> Array:
    """A polygon's outline (n, 2) as dashes (m, 2, 2) about `pitch` pixels apart, one at either end of every side."""
    sides = np.roll(corners, -1, axis=0) - corners
    longest = float(np.hypot(sides[:, 0], sides[:, 1]).max())
    n = min(max(2, round(longest / pitch) + 1), 40)
    ends = np.arange(2 * n).reshape(n, 2) / (2 * n - 1)
    dashed: Array = corners[:, None, None] + ends[..., None] * sides[:, None, None]
    return dashed.reshape(-1, 2, 2)


def mark(image: Image, at: Point, status: Status, colour: Ink, size: float, line: int, by_hand: bool) -> None:
    """The sign of `status` at (x, y), about `size` pixels to each side, with lines `line` wide, in place."""
    if status in ("tracked", "hidden"):
        x, y, radius = (round(value * (1 << _SHIFT)) for value in (*at, size))
        cv2.circle(image, (x, y), radius, colour, -1 if status == "tracked" else line, cv2.LINE_AA, _SHIFT)
    else:
        shape = {"lost": _CROSS, "absent": _DASH}.get(status, _DIAMOND)
        strokes = list(fixed(size * shape + at))
        if by_hand and status == "init":
            cv2.fillPoly(image, strokes, colour, cv2.LINE_AA, _SHIFT)
        polylines(image, strokes, colour, line)


class Sprite(NamedTuple):
    """An image to lay over another: its colours times opacity, and 255 minus opacity; (h, w, 3) uint8 each."""

    ink: Image
    keep: Image

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.ink.shape[1], self.ink.shape[0]


def stamp(image: Image, sprite: Sprite, left: int, top: int) -> None:
    """Lay `sprite` over `image` (h, w, 3) in place, its corner at (left, top); what falls outside is cut off."""
    x0, y0 = max(left, 0), max(top, 0)
    x1, y1 = min(left + sprite.ink.shape[1], image.shape[1]), min(top + sprite.ink.shape[0], image.shape[0])
    if x0 >= x1 or y0 >= y1:
        return
    under = image[y0:y1, x0:x1]
    part = np.s_[y0 - top : y1 - top, x0 - left : x1 - left]
    cv2.multiply(under, sprite.keep[part], under, 1 / 255)
    cv2.add(under, sprite.ink[part], under)


def plain(text: str) -> str:
    """`text` in the characters that the Hershey fonts have: accents dropped, the rest as question marks."""
    if text.isascii() and text.isprintable():
        return text
    bare = "".join(c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))
    return "".join(c if c.isascii() and c.isprintable() else "?" for c in bare)


def readable(name: str) -> str:
    """The name of a part or a target as people read it."""
    return name.replace("_", " ")


class Font:
    """One size of type: capitals `cap` pixels high, their tops at row `top` of `height`, and digits of equal width."""

    def __init__(self, cap: int) -> None:
        self.cap = cap
        self.top = math.ceil(0.2 * cap)
        self.height = self.top + cap + math.ceil(0.4 * cap)
        self.sprite = lru_cache(_KEPT)(self._render)
        self.width = lru_cache(_KEPT)(self._width)
        self._glyph = lru_cache(None)(self._draw_glyph)

    def _width(self, text: str) -> int:
        """The width of `text` in pixels."""
        return sum(self._glyph(c).shape[1] for c in plain(text))

    def mask(self, text: str) -> Image:
        """The opacity of `text`, (height, width) uint8."""
        glyphs = [self._glyph(c) for c in plain(text)]
        return np.concatenate(glyphs, axis=1) if glyphs else np.zeros((self.height, 1), np.uint8)

    def passing(self, text: str) -> Sprite:
        """White text that will be another in the next frame, and so is not kept."""
        ink = _grey(self.mask(text))
        return Sprite(ink, np.asarray(cv2.bitwise_not(ink), np.uint8))

    def _render(self, text: str, colour: Colour, halo: int = 0) -> Sprite:
        """Text in `colour` (blue, green, red), with a dark rim of `halo` pixels which widens it on all sides."""
        mask = np.pad(self.mask(text), halo)
        rim = mask
        if halo:
            disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * halo + 1, 2 * halo + 1))
            rim = np.maximum(mask, (0.85 * cv2.dilate(mask, disc)).astype(np.uint8))
        ink = np.round(mask[..., None] * (np.array(colour) / 255)).astype(np.uint8)
        return Sprite(ink, _grey(cv2.bitwise_not(rim)))

    def _draw_glyph(self, char: str) -> Image:
        stroke = max(1, round(_FINER * max(1.1, 0.12 * self.cap)))
        strokes = cv2.__version__.startswith("4.")
        scale = (self.cap * _FINER - stroke) / _HERSHEY_CAP if strokes else self.cap * _FINER / _OUTLINE_CAP
        (wide, _), _ = cv2.getTextSize(char, _FACE, scale, stroke)
        # Hershey sets widely; below 10 px each pixel between letters is needed
        advance = max(2, round(wide / _FINER - max(0.0, 0.08 * (self.cap - 9))))
        if char == " ":
            advance = max(3, round(0.45 * self.cap))
        baseline = (self.top + self.cap) * _FINER - (stroke + 1) // 2 * strokes
        margin = self.cap
        best, sharpest = np.zeros((self.height, advance), np.uint8), -1.0
        for shift in range(_FINER):
            canvas = np.zeros((self.height * _FINER, (advance + 2 * margin) * _FINER), np.uint8)
            at = (margin * _FINER + shift, baseline)
            cv2.putText(canvas, char, at, _FACE, scale, 255, stroke, cv2.LINE_AA)
            small = cv2.resize(canvas, (advance + 2 * margin, self.height), interpolation=cv2.INTER_AREA)
            glyph = small[:, margin : margin + advance].astype(np.float32) / 255
            sharpness = float(np.square(glyph).sum())
            if sharpness > sharpest:
                # light text on dark looks thinner than it is: lift the half tones
                best, sharpest = np.round(255 * glyph**0.8).astype(np.uint8), sharpness
        return best


def _grey(mask: Image | cv2.typing.MatLike) -> Image:
    return np.asarray(cv2.cvtColor(mask, cv2.COLOR_GRAY2BGR), np.uint8)


Rect = tuple[float, float, float, float]  # x0, y0, x1, y1
_MIN_STAY = 12  # frames that images stay in a corner
_MIN_HEIGHT = 12  # pixels of an image; in a smaller image nothing can be seen
_MAX_TARGETS = 4  # targets with images: one in each corner
_MAX_BOXES = 60  # boxes in the frame; with more there is no room for names of parts
_DECIDED = 0.5  # an identity less probable than that is doubtful
_QUIET: Colour = (190, 190, 190)  # of names in doubt, and what is written beside the status
_PLATE = 0.65  # opacity of the dark ground below the name of a target
_TROUGH: Colour = (130, 130, 130)
LOST_TEXT: Colour = (110, 165, 255)  # vermilion itself is too dark to read on the strip
_WORDY = 28  # heights of capitals: where a bar is as wide, the number of the frame is said to be one
# items in the bar beside the status; in a narrow bar the last items are left out first
_ITEMS = ("frame", "gauge", "clock", "title", "percent", "scale")


class Shown(NamedTuple):
    """The images of one target, each with its name, and the colour of their frame."""

    target: str
    pictures: tuple[tuple[str, Image], ...]
    colour: Colour


class Insets:
    """Lays images into corners of frames of `size`; below `top` rows, which are the status bar's.

    Each target has a corner of its own, and keeps it until a window comes to lie there; then it goes where there is
    most room, and stays there for a while whatever comes. Where no corner is free it covers as little as it can.
    """

    def __init__(self, size: tuple[int, int], top: int, line: int, font: Font) -> None:
        self._size, self._top, self._line, self._font = size, top, line, font
        self._height = round(0.2 * min(size[1], 0.75 * size[0]))
        # the corner of each target, and since when; how many frames there were
        self.memory: tuple[dict[str, tuple[int, int]], int] = {}, 0

    def draw(self, image: Image, shown: Iterable[Shown], windows: Sequence[Rect]) -> list[Rect]:
        """Draw the images that have room on `image` (H, W, 3) in place, away from `windows`; the places taken."""
        (before, count), taken = self.memory, list[Rect]()
        places: dict[str, tuple[int, int]] = {}
        for template in shown:
            scaled = self._scaled(template.pictures) if len(taken) < _MAX_TARGETS else []
            if not scaled:
                continue
            size = sum(p.shape[1] + self._line for _, p in scaled) + self._line, scaled[0][1].shape[0] + 2 * self._line
            free = [corner for corner in range(4) if corner not in {taken for taken, _ in places.values()}]
            now, since = before.get(template.target, (-1, 0))
            corner = self._corner(now, count + 1 - since, size, windows, free)
            places[template.target] = corner, since if corner == now else count + 1
            box = self._box(corner, size)
            self._lay(image, scaled, template.colour, round(box[0]), round(box[1]))
            taken.append(box)
        self.memory = places, count + 1
        return taken

    def _scaled(self, pictures: Sequence[tuple[str, Image]]) -> list[tuple[str, Image]]:
        """The images with their names, all equally high, and together no wider than 0.4 of the frame."""
        wide = sum(picture.shape[1] / picture.shape[0] for _, picture in pictures)
        height = min(self._height, int(0.4 * self._size[0] / wide))
        scaled = []
        for name, picture in pictures if height >= _MIN_HEIGHT else ():
            size = max(1, round(height * picture.shape[1] / picture.shape[0])), height
            how = cv2.INTER_CUBIC if height > picture.shape[0] else cv2.INTER_AREA
            scaled.append((name, np.asarray(cv2.resize(picture, size, interpolation=how), np.uint8)))
        return scaled

    def _box(self, corner: int, size: tuple[int, int]) -> Rect:
        """Corners are numbered from the lower left, right, then the upper right, left."""
        (width, height), gap = size, 2 * self._line
        left = gap if corner in (0, 3) else self._size[0] - width - gap
        top = self._size[1] - height - gap if corner < 2 else self._top + gap
        return left, top, left + width, top + height

    def _corner(self, now: int, stays: int, size: tuple[int, int], windows: Sequence[Rect], free: Sequence[int]) -> int:
        """A free corner for a target that has stood in `now`, -1 for none, for so many frames."""
        covered = {corner: _covered(self._box(corner, size), windows) for corner in free}
        if now not in free:
            return min(free, key=lambda corner: (covered[corner], corner))
        hardly_better = min(covered.values()) > 0.5 * covered[now]
        if not covered[now] or stays < _MIN_STAY or hardly_better:
            return now
        return min(free, key=lambda corner: (covered[corner], -_room(self._box(corner, size), windows)))

    def _lay(self, image: Image, scaled: Sequence[tuple[str, Image]], colour: Colour, left: int, top: int) -> None:
        line, font = self._line, self._font
        x = left + line
        for name, picture in scaled:
            height, width = picture.shape
            cv2.rectangle(image, (x - line, top), (x + width + line - 1, top + height + 2 * line - 1), colour, -1)
            under = image[max(top + line, 0) : top + line + height, max(x, 0) : x + width]
            under[:] = cv2.cvtColor(picture[: under.shape[0], : under.shape[1]], cv2.COLOR_GRAY2BGR)
            sprite = font.sprite(name[:12], WHITE, line)
            if name and sprite.size[0] <= width and sprite.size[1] <= 0.5 * height:
                stamp(image, sprite, x + width - sprite.size[0], top + line)
            x += width + line


def _covered(box: Rect, windows: Iterable[Rect]) -> float:
    """Pixels of the box that windows cover, each counted by itself."""
    shared = ((min(box[2], w[2]) - max(box[0], w[0]), min(box[3], w[3]) - max(box[1], w[1])) for w in windows)
    return sum(max(0.0, across) * max(0.0, down) for across, down in shared)


def _room(box: Rect, windows: Iterable[Rect]) -> float:
    """How far the nearest window is, in pixels along the axis on which it is farther."""
    return min((max(w[0] - box[2], box[0] - w[2], w[1] - box[3], box[1] - w[3]) for w in windows), default=float("inf"))


class Shape(NamedTuple):
    """The K drawable parts of a target: centres, sizes (K, 2), corners (K, 4, 2), bounds (K, 4) as x0, y0, x1, y1."""

    target: str
    rows: Trajectory
    parts: tuple[str, ...]
    cloud: Array
    insets: tuple[tuple[str, Image], ...]
    centres: Array
    sizes: Array
    corners: Array
    bounds: Array
    lost: Mask
    colours: tuple[Colour, ...]

    @property
    def colour(self) -> Colour:
        """That of the whole target: of its box, which comes last."""
        return self.colours[-1]

    @property
    def side(self) -> Array:
        """(K,) the shorter side of each window."""
        shorter: Array = self.sizes.min(axis=1)
        return shorter

    @property
    def is_face(self) -> bool:
        """Whether there are points in a box."""
        return len(self.parts) > 1 and BOX in self.parts


class Labels:
    """Writes names on frames of `size`, below `top` rows, which are the status bar's; a name stays where it was."""

    def __init__(self, size: tuple[int, int], top: int, line: int, font: Font) -> None:
        self._size, self._top, self._line, self._font = size, top, line, font
        # the side of each part on which its name stands; the targets whose names stand below them
        self.memory: tuple[dict[tuple[str, str], int], set[str]] = {}, set()

    def draw(self, image: Image, shapes: Sequence[Shape], taken: Sequence[Rect], *, named: bool = False) -> None:
        """Names on `image` in place, each where it covers nothing of `taken`, or nowhere.

        A single target has a name only if it is `named`.
        """
        before, low = self.memory
        low &= {shape.target for shape in shapes}
        tags = list(taken)
        for shape in shapes:
            tags += self._tag(image, shape, named or len(shapes) > 1, tags, low)
        boxes = [(b[0], b[1], b[2], b[3]) for shape in shapes for b in shape.bounds.tolist()]
        full = [(0, 0, self._size[0], self._top), *boxes, *tags]
        sides: dict[tuple[str, str], int] = {}
        for shape in shapes:
            if shape.parts and len(full) <= _MAX_BOXES:
                sides |= self._parts(image, shape, full, before)
        self.memory = sides, low

    def _parts(
        self, image: Image, shape: Shape, taken: list[Rect], before: Mapping[tuple[str, str], int]
    ) -> dict[tuple[str, str], int]:
        """The names of parts whose windows are large enough, first at the sides that face away from the middle."""
        middle, sides = shape.centres.mean(axis=0).tolist(), dict[tuple[str, str], int]()
        columns = (shape.parts, shape.bounds.tolist(), shape.centres.tolist(), shape.lost.tolist(), shape.colours)
        for part, bound, centre, lost, colour in zip(*columns, strict=True):
            small = shape.is_face or min(bound[2] - bound[0], bound[3] - bound[1]) < 2.4 * self._font.cap
            if small or part in (shape.target, BOX):  # the latter say nothing more
                continue
            sprite = self._font.sprite(readable(part), LOST if lost else colour, self._line)
            places = _beside(bound, sprite.size, 2 * self._line)
            key = (shape.target, part)
            x, y = centre[0] - middle[0], centre[1] - middle[1]
            order = sorted(range(4), key=(x, y, -x, -y).__getitem__, reverse=True)
            for side in [before[key], *order] if key in before else order:
                left, top = places[side]
                box = (left, top, left + sprite.size[0], top + sprite.size[1])
                if self._free(box, taken):
                    stamp(image, sprite, left, top)
                    taken.append(box)
                    sides[key] = side
                    break
        return sides

    def _free(self, box: Rect, taken: Sequence[Rect], spare: int = 0) -> bool:
        """Whether a box is in the frame, and `spare` pixels or more away from what is taken."""
        x0, y0, x1, y1 = box
        if x0 < 0 or y0 < 0 or x1 > self._size[0] or y1 > self._size[1]:
            return False
        x0, y0, x1, y1 = x0 - spare, y0 - spare, x1 + spare, y1 + spare
        return not any(x0 < t[2] and t[0] < x1 and y0 < t[3] and t[1] < y1 for t in taken)

    def _tag(self, image: Image, shape: Shape, named: bool, tags: Sequence[Rect], under: set[str]) -> list[Rect]:
        """Name a target above it, or below where `tags` or the border are in the way; the place taken, if any.

        `under` are the targets that are named below.
        """
        text, colour = _name(shape, named) if shape.parts else ("", shape.colour)
        low, high = shape.bounds[:, :2].min(axis=0, initial=np.inf), shape.bounds[:, 2:].max(axis=0, initial=-np.inf)
        if not text or (high < 0).any() or (low > self._size).any():
            return []
        sprite = self._font.sprite(text, colour, self._line)
        width, height = sprite.size
        left = int(min(max((low[0] + high[0] - width) / 2, 0), max(self._size[0] - width, 0)))
        gap = 2 * self._line
        above, below = int(low[1]) - height - gap, min(int(high[1]) + gap, self._size[1] - height)
        tops = [above, below] if above >= self._top else [below]
        boxes = [(left, top, left + width, top + height) for top in tops]
        # back above only once there is room to spare, or it would flicker
        spare = height if shape.target in under else 0
        clear = [self._free(box, tags, spare if i == 0 else 0) for i, box in enumerate(boxes)]
        chosen = boxes[clear.index(True)] if any(clear) else boxes[0]
        top = chosen[1]
        (under.add if len(tops) > 1 and top == below else under.discard)(shape.target)
        plate = image[max(top, 0) : max(top + height, 0), max(left - self._line, 0) : max(left + width + self._line, 0)]
        if plate.size:
            cv2.convertScaleAbs(plate, plate, 1 - _PLATE)
        stamp(image, sprite, left, top)
        return [chosen]


def _name(shape: Shape, named: bool) -> tuple[str, Colour]:
    """Who a target is, with the probability, pale and with a question mark where that is low; else its name."""
    who, sure = str(shape.rows.identity[0]), float(shape.rows.identity_prob[0])
    if not who:
        return (readable(shape.target) if named else ""), shape.colour
    if not math.isfinite(sure):
        return who, shape.colour
    percent = " >99%" if sure >= 0.995 else f" {sure:.0%}"  # no posterior is certain
    return (f"{who}?{percent}", _QUIET) if sure < _DECIDED else (f"{who}{percent}", shape.colour)


def _beside(bound: Sequence[float], size: tuple[int, int], gap: int) -> list[tuple[int, int]]:
    """Corners (left, top) for a label of `size` to the right of a window, below, to its left, and above."""
    (x0, y0, x1, y1), (width, height) = bound, size
    across, down = round((x0 + x1 - width) / 2), round((y0 + y1 - height) / 2)
    right, below = math.ceil(x1) + 1 + gap, math.ceil(y1) + 1 + gap
    left, above = math.floor(x0) - gap - width, math.floor(y0) - gap - height
    return [(right, down), (across, below), (left, down), (across, above)]


class StatusBar:
    """Writes a summary of each result over the top of images `width` pixels wide, in capitals `cap` pixels high."""

    def __init__(self, width: int, cap: int, line: int, title: str = "") -> None:
        self.height = round(1.9 * cap)
        self._width, self._line, self._title, self._font = width, line, title, Font(cap)

    def draw(self, image: Image, result: FrameResult) -> None:
        """Darken the top `height` rows of `image` (H, W, 3) and write on them, in place."""
        font, cap = self._font, self._font.cap
        strip = image[: self.height]
        cv2.convertScaleAbs(strip, strip, 0.28)
        rows = result.rows
        status, sayings = summary(rows)
        sure = rows.confidence[np.isfinite(rows.confidence)].tolist()
        mean = min(max(sum(sure) / len(sure), 0.0), 1.0) if sure else 0.0
        adapted, title = adaptation(rows), self._title
        word = "frame " if self._width >= _WORDY * cap else ""
        texts = {"frame": f"{word}{result.frame.index}", "clock": clock(result.frame.time_s), "title": title}
        texts |= {"percent": "100%", **adapted}
        gap, gauge, icon = round(0.8 * cap), round(3.5 * cap), round(1.5 * cap)
        room = {item: font.width(text) + gap if text else 0 for item, text in texts.items()} | {"gauge": gauge + gap}
        shown, saying, spare = self._fit(sayings, room, self._width - 2 * gap - icon)
        if not sure:  # 0 % would be a lie of a tracker that does not say
            shown = tuple(item for item in shown if item not in ("gauge", "percent"))
        if "title" not in shown:  # its beginning, as far as it says something
            length = next((n for n in range(len(title), 7, -1) if font.width(title[:n] + "..") <= spare - gap), 0)
            title = title[:length] + ".." if length else ""
        row, middle = (self.height - cap) // 2 - font.top, (self.height - cap) // 2 + (cap - 1) / 2
        left, right = gap, self._width - gap
        for item in ("frame", "clock"):
            if item in shown:
                stamp(strip, font.passing(texts[item]), left, row)
                left += room[item]
        sign = LOST_TEXT if status == "lost" else _QUIET if status == "absent" else PALETTE[0]
        by_hand = bool(rows.by_hand.any())
        mark(strip, (left + 0.4 * cap, middle), status, sign, 0.37 * cap, self._line, by_hand)
        stamp(strip, font.sprite(saying, LOST_TEXT if status == "lost" else WHITE), left + icon, row)
        if "gauge" in shown:
            top, bottom = (self.height - cap) // 2, (self.height - cap) // 2 + cap - 1
            full, end = right - gauge, right - gauge + round(mean * gauge)
            cv2.rectangle(strip, (full, top), (right - 1, bottom), _TROUGH, -1)
            if end > full:
                cv2.rectangle(strip, (full, top), (end - 1, bottom), PALETTE[0], -1)
            right = full - gap
        room["title"] = font.width(title) + gap
        for item, text in {"percent": f"{mean:.0%}", "title": title, **adapted}.items():
            if text and (item in shown or item == "title"):
                colour = WHITE if item == "percent" else _QUIET
                stamp(strip, font.sprite(text, colour), right - font.width(text), row)
                right -= room[item]

    def _fit(self, sayings: Sequence[str], room: dict[str, int], width: int) -> tuple[tuple[str, ...], str, int]:
        """The items and the wording of the status that fit, and the room left: rather fewer items than fewer words."""
        items = tuple(item for item in _ITEMS if item in room)
        for counts in ((6, 5, 4, 3), (2, 1, 0)):
            for saying in sayings:
                for n in counts:
                    left = width - self._font.width(saying) - sum(room[k] for k in items[:n])
                    if left >= 0:
                        return items[:n], saying, left
        return (), "", 0


def adaptation(rows: Trajectory) -> dict[str, str]:
    """The size against that of the start, of a single target that adapts; else nothing."""
    reported = rows.diagnostics.get(rows.target) if len(rows.targets) == 1 else None
    scale = math.nan if reported is None else float(reported.get("scale")[0])
    return {"scale": f"size {min(scale, 99.0):.0%}"} if math.isfinite(scale) else {}


def summary(rows: Trajectory) -> tuple[Status, list[str]]:
    """The status of all that is not absent, and ways to say it, from the longest to the shortest."""
    if not len(rows):
        return "lost", ["no target", "none"]
    absent, lost, hidden = (int(np.sum(rows.status == status)) for status in ("absent", "lost", "hidden"))
    if absent == len(rows):
        return "absent", ["absent"]
    missing = f"{', '.join(_named(rows, rows.status == 'absent'))} absent" if absent else ""
    unseen: Status
    for unseen, count in (("lost", lost), ("hidden", hidden)):
        if count:
            names = _named(rows, rows.status == unseen)
            whole = f"{unseen}: {', '.join(names)}"
            several = [f"{unseen}: {names[0]} +{len(names) - 1}"] if len(names) > 1 else []
            both = [f"{whole}; {missing}"] if missing else []
            return unseen, [*both, whole, *several, f"{unseen} {count}/{len(rows)}", unseen]
    init = rows.status == "init"
    status: Status = "init" if (init | (rows.status == "absent")).all() else "tracked"
    by_hand = rows.by_hand & init
    sayings: list[str] = [status]
    if by_hand.any():
        status, sayings = "init", [f"{', '.join(_named(rows, by_hand))} by hand", "by hand"]
    both = [f"{sayings[0]}; {missing}", missing, f"absent {absent}/{len(rows)}"] if missing else []
    return status, [*both, *sayings]


def _named(rows: Trajectory, chosen: Mask) -> list[str]:
    """The names of the `chosen` rows (R,): the name of the target alone where all of its parts are among them."""
    pairs, names = [rows.names[i] for i in rows.which.tolist()], []
    for target in rows.targets:
        own = [
            (part, is_chosen) for (name, part), is_chosen in zip(pairs, chosen.tolist(), strict=True) if name == target
        ]
        parts = [part for part, is_chosen in own if is_chosen]
        if parts and len(parts) == len(own):
            names.append(readable(target))
        else:
            names += [readable(f"{target}/{part}" if len(rows.targets) > 1 else part) for part in parts]
    return names
