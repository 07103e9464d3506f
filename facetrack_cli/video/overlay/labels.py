"""Names beside the targets of a frame, and images of the templates in its corners (Zhou et al. 2003, fig. 3)."""

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np

from facetrack_cli.core.types import BOX, Array, Image, Mask
from facetrack_cli.trajectory.trajectory import Trajectory
from facetrack_cli.video.overlay.marks import LOST, WHITE, Colour, Font, readable, stamp

Rect = tuple[float, float, float, float]  # x0, y0, x1, y1
_MIN_STAY = 12  # frames that images stay in a corner
_MIN_HEIGHT = 12  # pixels of an image; in a smaller image nothing can be seen
_MAX_TARGETS = 4  # targets with images: one in each corner
_MAX_BOXES = 60  # boxes in the frame; with more there is no room for names of parts
_DECIDED = 0.5  # an identity less probable than that is doubtful
_DOUBTFUL: Colour = (190, 190, 190)
_PLATE = 0.65  # opacity of the dark ground below the name of a target


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
        self._places: dict[str, tuple[int, int]] = {}  # the corner of a target, and since when
        self._count = 0

    @property
    def memory(self) -> Any:
        return self._places, self._count

    @memory.setter
    def memory(self, memory: Any) -> None:
        self._places, self._count = memory

    def draw(self, image: Image, shown: Iterable[Shown], windows: Sequence[Rect]) -> list[Rect]:
        """Draw the images that have room on `image` (H, W, 3) in place, away from `windows`; the places taken."""
        self._count += 1
        taken: list[Rect] = []
        places: dict[str, tuple[int, int]] = {}
        for one in shown:
            scaled = self._scaled(one) if len(taken) < _MAX_TARGETS else []
            if not scaled:
                continue
            size = sum(p.shape[1] + self._line for _, p in scaled) + self._line, scaled[0][1].shape[0] + 2 * self._line
            corner = self._corner(one.target, size, windows, {corner for corner, _ in places.values()})
            known = self._places.get(one.target)
            places[one.target] = known if known and known[0] == corner else (corner, self._count)
            box = self._box(corner, size)
            self._lay(image, scaled, one.colour, round(box[0]), round(box[1]))
            taken.append(box)
        self._places = places
        return taken

    def _scaled(self, one: Shown) -> list[tuple[str, Image]]:
        """The images with their names, all equally high, and together no wider than 0.4 of the frame."""
        fine = [(name, p) for name, p in one.pictures if p.ndim == 2 and min(p.shape) > 0 and p.dtype == np.uint8]
        wide = sum(p.shape[1] / p.shape[0] for _, p in fine)
        height = min(self._height, int(0.4 * self._size[0] / wide)) if fine else 0
        if height < _MIN_HEIGHT:
            return []
        found = []
        for name, picture in fine:
            size = max(1, round(height * picture.shape[1] / picture.shape[0])), height
            how = cv2.INTER_CUBIC if height > picture.shape[0] else cv2.INTER_AREA
            found.append((name, np.asarray(cv2.resize(picture, size, interpolation=how), np.uint8)))
        return found

    def _box(self, corner: int, size: tuple[int, int]) -> Rect:
        """Corners are numbered from the lower left, right, then the upper right, left."""
        (width, height), gap = size, 2 * self._line
        left = gap if corner in (0, 3) else self._size[0] - width - gap
        top = self._size[1] - height - gap if corner < 2 else self._top + gap
        return left, top, left + width, top + height

    def _corner(self, target: str, size: tuple[int, int], windows: Sequence[Rect], used: set[int]) -> int:
        free = [corner for corner in range(4) if corner not in used]
        covered = {corner: _covered(self._box(corner, size), windows) for corner in free}
        now, since = self._places.get(target, (-1, 0))
        if now not in free:
            return min(free, key=lambda corner: (covered[corner], corner))
        hardly_better = min(covered.values()) > 0.5 * covered[now]
        if not covered[now] or self._count - since < _MIN_STAY or hardly_better:
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
        self._sides: dict[tuple[str, str], int] = {}
        self._low: set[str] = set()  # targets whose names stand below them

    @property
    def memory(self) -> Any:
        return self._sides, self._low

    @memory.setter
    def memory(self, memory: Any) -> None:
        self._sides, self._low = memory

    def draw(self, image: Image, shapes: Sequence[Shape], taken: Sequence[Rect], *, named: bool = False) -> None:
        """Names on `image` in place, each where it covers nothing of `taken`, or nowhere.

        A single target has a name only if it is `named`.
        """
        self._low &= {shape.target for shape in shapes}
        tags = list(taken)
        for shape in shapes:
            tags += self._tag(image, shape, named or len(shapes) > 1, tags)
        boxes = [(b[0], b[1], b[2], b[3]) for shape in shapes for b in shape.bounds.tolist()]
        full = [(0, 0, self._size[0], self._top), *boxes, *tags]
        sides: dict[tuple[str, str], int] = {}
        for shape in shapes:
            if shape.parts and len(full) <= _MAX_BOXES:
                self._parts(image, shape, full, sides)
        self._sides = sides

    def _parts(self, image: Image, shape: Shape, taken: list[Rect], sides: dict[tuple[str, str], int]) -> None:
        """The names of parts whose windows are large enough, first at the sides that face away from the middle."""
        middle = shape.centres.mean(axis=0).tolist()
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
            for side in [self._sides[key], *order] if key in self._sides else order:
                left, top = places[side]
                box = (left, top, left + sprite.size[0], top + sprite.size[1])
                if self._free(box, taken):
                    stamp(image, sprite, left, top)
                    taken.append(box)
                    sides[key] = side
                    break

    def _free(self, box: Rect, taken: Sequence[Rect], spare: int = 0) -> bool:
        """Whether a box is in the frame, and `spare` pixels or more away from what is taken."""
        x0, y0, x1, y1 = box
        if x0 < 0 or y0 < 0 or x1 > self._size[0] or y1 > self._size[1]:
            return False
        x0, y0, x1, y1 = x0 - spare, y0 - spare, x1 + spare, y1 + spare
        return not any(x0 < t[2] and t[0] < x1 and y0 < t[3] and t[1] < y1 for t in taken)

    def _tag(self, image: Image, shape: Shape, named: bool, tags: Sequence[Rect]) -> list[Rect]:
        """Name a target above it, or below where `tags` or the border are in the way; the place taken, if any."""
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
        spare = height if shape.target in self._low else 0
        clear = [self._free(box, tags, spare if i == 0 else 0) for i, box in enumerate(boxes)]
        chosen = boxes[clear.index(True)] if any(clear) else boxes[0]
        top = chosen[1]
        (self._low.add if len(tops) > 1 and top == below else self._low.discard)(shape.target)
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
    return (f"{who}?{percent}", _DOUBTFUL) if sure < _DECIDED else (f"{who}{percent}", shape.colour)


def _beside(bound: Sequence[float], size: tuple[int, int], gap: int) -> list[tuple[int, int]]:
    """Corners (left, top) for a label of `size` to the right of a window, below, to its left, and above."""
    (x0, y0, x1, y1), (width, height) = bound, size
    across, down = round((x0 + x1 - width) / 2), round((y0 + y1 - height) / 2)
    right, below = math.ceil(x1) + 1 + gap, math.ceil(y1) + 1 + gap
    left, above = math.floor(x0) - gap - width, math.floor(y0) - gap - height
    return [(right, down), (across, below), (left, down), (across, above)]
