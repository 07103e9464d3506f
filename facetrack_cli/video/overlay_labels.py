"""What is written on a frame, names, the status bar, templates in the corners; and colours, strokes and letters for it.

Status shows by form as well as by colour: a dot where tracked, a cross where lost, a hollow diamond at the start, a
filled one where a correction gave it, a dash for what is absent. Letters are Pillow's own, Aileron.

Templates are shown as in Zhou et al. 2003, fig. 3.
"""

import math
import unicodedata
from collections.abc import Sequence
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
_CAP_SHARE = 0.7  # of the size of the type: the height of a capital
_KEPT = 256  # sprites


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
    """`text` in the characters that the font has: accents dropped, the rest as question marks."""
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
        from PIL import ImageFont  # only where something is drawn: a short run takes as long as its imports

        self.cap, self.top = cap, math.ceil(0.2 * cap)
        self.height = self.top + cap + math.ceil(0.4 * cap)
        self._type = ImageFont.load_default(cap / _CAP_SHARE)
        self.sprite = lru_cache(_KEPT)(self._render)

    def width(self, text: str) -> int:
        """The width of `text` in pixels."""
        return max(math.ceil(self._type.getlength(plain(text))), 1)

    def _render(self, text: str, colour: Colour, halo: int = 0) -> Sprite:
        """Text in `colour` (blue, green, red), with a dark rim of `halo` pixels which widens it on all sides."""
        from PIL import Image as Pictures
        from PIL import ImageDraw

        picture = Pictures.new("L", (self.width(text) + 2 * halo, self.height + 2 * halo))
        at = halo, halo + self.top + self.cap
        ImageDraw.Draw(picture).text(at, plain(text), 255, self._type, anchor="ls")
        mask = np.asarray(picture)
        rim = mask
        if halo:
            disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * halo + 1, 2 * halo + 1))
            rim = np.maximum(mask, (0.85 * cv2.dilate(mask, disc)).astype(np.uint8))
        ink = np.round(mask[..., None] * (np.array(colour) / 255)).astype(np.uint8)
        return Sprite(ink, np.asarray(cv2.cvtColor(cv2.bitwise_not(rim), cv2.COLOR_GRAY2BGR), np.uint8))


Rect = tuple[float, float, float, float]  # x0, y0, x1, y1
_MIN_HEIGHT = 12  # pixels of an image; in a smaller image nothing can be seen
_DECIDED = 0.5  # an identity less probable than that is doubtful
_QUIET: Colour = (190, 190, 190)  # of names in doubt, and what is written beside the status
_PLATE = 0.65  # opacity of the dark ground below the name of a target
LOST_TEXT: Colour = (110, 165, 255)  # vermilion itself is too dark to read on the strip


def lay_insets(image: Image, shapes: Sequence["Shape"], line: int, font: Font) -> None:
    """Draw the images of the first target that has some into the lower left corner of `image` (H, W, 3), in place."""
    shape = next((shape for shape in shapes if shape.insets), None)
    if shape is None:
        return
    (height, width), gap = image.shape[:2], 2 * line
    wide = sum(picture.shape[1] / picture.shape[0] for _, picture in shape.insets)
    high = min(round(0.2 * min(height, 0.75 * width)), int(0.4 * width / wide))
    if high < _MIN_HEIGHT:
        return
    left, top = gap + line, height - high - line - gap
    for name, picture in shape.insets:
        across = max(1, round(high * picture.shape[1] / picture.shape[0]))
        how = cv2.INTER_CUBIC if high > picture.shape[0] else cv2.INTER_AREA
        small = cv2.cvtColor(cv2.resize(picture, (across, high), interpolation=how), cv2.COLOR_GRAY2BGR)
        framed = cv2.copyMakeBorder(small, line, line, line, line, cv2.BORDER_CONSTANT, None, WHITE)
        stamp(image, Sprite(np.asarray(framed, np.uint8), np.zeros_like(framed)), left - line, top - line)
        sprite = font.sprite(name[:12], WHITE, line)
        if name and sprite.size[0] <= across and sprite.size[1] <= 0.5 * high:
            stamp(image, sprite, left + across - sprite.size[0], top)
        left += across + line


class Shape(NamedTuple):
    """The K drawable parts of a target: centres, sizes (K, 2), corners (K, 4, 2)."""

    target: str
    rows: Trajectory
    parts: tuple[str, ...]
    cloud: Array
    insets: tuple[tuple[str, Image], ...]
    centres: Array
    sizes: Array
    corners: Array
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


def write_names(image: Image, shapes: Sequence[Shape], top: int, line: int, font: Font, *, named: bool) -> None:
    """Name targets above them, below `top` rows, or below them where names or the border are there.

    A single target has a name only if it is `named`.
    """
    (bottom, right), tags = image.shape[:2], list[Rect]()
    for shape in shapes:
        text, colour = _name(shape, named or len(shapes) > 1) if shape.parts else ("", shape.colour)
        low, high = shape.corners.min(axis=(0, 1), initial=np.inf), shape.corners.max(axis=(0, 1), initial=-np.inf)
        if not text or (high < 0).any() or (low > (right, bottom)).any():
            continue
        sprite = font.sprite(text, colour, line)
        width, height = sprite.size
        x = int(min(max((low[0] + high[0] - width) / 2, 0), max(right - width, 0)))
        above, below = int(low[1]) - height - 2 * line, min(int(high[1]) + 2 * line, bottom - height)
        places = [y for y in (above, below) if y >= top] or [below]
        free = (y for y in places if not any(_meet((x, y, x + width, y + height), tag) for tag in tags))
        y = next(free, places[0])
        tags.append((x, y, x + width, y + height))
        plate = image[max(y, 0) : max(y + height, 0), max(x - line, 0) : max(x + width + line, 0)]
        if plate.size:
            cv2.convertScaleAbs(plate, plate, 1 - _PLATE)
        stamp(image, sprite, x, y)


def _meet(a: Rect, b: Rect) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _name(shape: Shape, named: bool) -> tuple[str, Colour]:
    """Who a target is, with the probability, pale and with a question mark where that is low; else its name."""
    who, sure = str(shape.rows.identity[0]), float(shape.rows.identity_prob[0])
    if not who:
        return (readable(shape.target) if named else ""), shape.colour
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
        """Darken the top `height` rows of `image` (H, W, 3) and write on them, in place: frame, time and status from
        the left, the mean confidence and the title from the right, as far as there is room.
        """
        font, cap, rows = self._font, self._font.cap, result.rows
        strip = image[: self.height]
        cv2.convertScaleAbs(strip, strip, 0.28)
        status, saying = summary(rows)
        gap, icon, row = round(0.8 * cap), round(1.5 * cap), (self.height - cap) // 2 - font.top
        left, right = gap, self._width - gap
        sure = rows.confidence[np.isfinite(rows.confidence)]  # 0 % would be a lie of a tracker that does not say
        frame, time = f"frame {result.frame.index}", clock(result.frame.time_s)
        percent, room, shown = f"{sure.mean():.0%}" if len(sure) else "", right - icon, set[str]()
        for text in (saying, frame, time, percent, self._title):
            if text and font.width(text) + gap <= room:
                room -= font.width(text) + gap
                shown.add(text)
        for text in (frame, time):
            if text in shown:
                stamp(strip, font.sprite(text, WHITE), left, row)
                left += font.width(text) + gap
        sign = LOST_TEXT if status == "lost" else _QUIET if status == "absent" else PALETTE[0]
        middle = (self.height - cap) // 2 + (cap - 1) / 2
        mark(strip, (left + 0.4 * cap, middle), status, sign, 0.37 * cap, self._line, bool(rows.by_hand.any()))
        if saying in shown:
            stamp(strip, font.sprite(saying, LOST_TEXT if status == "lost" else WHITE), left + icon, row)
        for text, colour in ((percent, WHITE), (self._title, _QUIET)):
            if text in shown:
                stamp(strip, font.sprite(text, colour), right - font.width(text), row)
                right -= font.width(text) + gap


def summary(rows: Trajectory) -> tuple[Status, str]:
    """The status of all that is not absent, and what the bar says: what is not tracked, of how many."""
    if not len(rows):
        return "lost", "no target"
    absent, by_hand = rows.status == "absent", rows.by_hand & (rows.status == "init")
    if absent.all():
        return "absent", "absent"
    begins = by_hand.any() or (absent | (rows.status == "init")).all()
    shown: Status = "init" if begins else "tracked"
    unseen: Status
    for unseen in ("hidden", "lost"):
        shown = unseen if (rows.status == unseen).any() else shown
    of = {"lost": rows.status == "lost", "hidden": rows.status == "hidden", "by hand": by_hand, "absent": absent}
    return shown, next((f"{what} {chosen.sum()}/{len(rows)}" for what, chosen in of.items() if chosen.any()), shown)
