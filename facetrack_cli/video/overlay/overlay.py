"""What the tracker says of a frame, drawn over it: windows, trails, spread of the particles, status.

Status shows by form as well as by colour: a tracked part has a solid window and a dot, a lost one a dashed window and a
cross, one at its start a solid window and a diamond, which is filled where a correction gave it. What is absent is not
drawn. Each target has its own colour, of those that most colour-blind people tell apart; vermilion is kept for what is
lost.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import cv2
import numpy as np

from facetrack_cli.core.types import BOX, Array, Image, Mask
from facetrack_cli.trajectory.trajectory import FrameResult, TargetResult, Trajectory
from facetrack_cli.video.overlay.insets import Insets, Rect, Shown
from facetrack_cli.video.overlay.marks import LOST, PALETTE, WHITE, Colour, Points, dashes, fixed, ink, mark, polylines
from facetrack_cli.video.overlay.status_bar import StatusBar
from facetrack_cli.video.overlay.text import Font, stamp

_FADES = 4  # steps of opacity along a trail
_SAMPLES = 32  # of the past, at most, for a trail
_DOTS = 150  # particles shown a part, at most
_DECIDED = 0.5  # a name less probable than that is a guess
_DOUBTFUL: Colour = (190, 190, 190)
_PLATE = 0.65  # opacity of the dark ground below a name
_RIM = 0.7  # opacity of the dark rim around all lines
_CIRCLE = np.stack([f(np.linspace(0, 2 * np.pi, 33)[:-1]) for f in (np.cos, np.sin)], axis=1)  # (32, 2)


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
    colour: Colour


class _Past(NamedTuple):
    time_s: float
    number: int
    parts: tuple[str, ...]
    centres: Array
    lost: Mask


class Overlay:
    """Draws results over their frames; it remembers the last `trail_s` seconds of them, and no more.

    `size` is (width, height) of all frames, `fps` their nominal rate, `title` stands in the status bar. Lines and type
    follow the picture's height. Give the results in their order; a time that goes back starts the trails anew.
    """

    def __init__(self, size: tuple[int, int], *, fps: float = 25.0, title: str = "", trail_s: float = 1.0) -> None:
        self.size = size
        self.trail_s = trail_s
        width, height = size
        scale = min(height, 0.75 * width)  # portrait pictures are measured by their width
        self._line = max(1, round(scale / 480))
        cap = 7 if scale < 160 else 8
        self._label_font = Font(max(cap, round(0.017 * scale)))
        # a picture of a few lines has none to spare
        bar = StatusBar(width, max(cap, round(0.019 * scale)), self._line, title)
        self._bar = bar if height >= 48 and width >= 48 else None
        self._insets = Insets(size, bar.height if self._bar else 0, self._line, self._label_font)
        self._stride = max(1, math.ceil(fps * trail_s / _SAMPLES)) if math.isfinite(fps * trail_s) else 1
        self._past: dict[str, deque[_Past]] = {}
        self._slots: dict[tuple[str, str], int] = {}
        self._low: set[str] = set()  # targets whose names stand below them
        self._weights: dict[tuple[str, str], int] = {}
        self._reach = 4.0 * max(size)
        self._count = 0

    def draw(self, result: FrameResult) -> Image:
        """A new picture of the frame's size, (H, W, 3) uint8, with `result` drawn on it; the frame is left as it was.

        Parts without a finite place are left out. Raises ValueError if the frame is not of this overlay's size.
        """
        frame = result.frame
        if frame.size != tuple(self.size):
            raise ValueError(f"frame {frame.index} is {frame.size}, the overlay {self.size}")
        image: Image = frame.bgr.copy()
        shapes = [self._shape(t, PALETTE[i % len(PALETTE)]) for i, t in enumerate(result.targets)]
        corners = self._corner_pictures(image, shapes)  # below the lines, where they have to cross
        for shape in shapes:
            trail = self._remember(shape, frame.time_s)
            if shape.parts:
                self._cloud(image, shape)
                self._lines(image, shape, trail)
        self._forget({shape.target for shape in shapes})
        self._labels(image, shapes, corners)
        if self._bar:
            self._bar.draw(image, result)
        self._count += 1
        return image

    # the geometry of a target

    def _shape(self, target: TargetResult, colour: Colour) -> Shape:
        every = target.rows
        fine = np.isfinite(every.x + every.y + every.w + every.h)
        rows = every.take(fine)
        table = np.clip(np.stack([rows.x, rows.y, rows.w, rows.h], axis=1), -self._reach, self._reach)
        half = np.maximum(table[:, 2:] - 1, 2) / 2
        corners = half[:, None] * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
        angle = np.radians(np.nan_to_num(rows.angle, posinf=0, neginf=0))
        if angle.any():
            cos, sin = np.cos(angle)[:, None], np.sin(angle)[:, None]
            x, y = corners[..., 0], corners[..., 1]
            corners = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
        corners = corners + table[:, None, :2]
        if rows.corners is not None:
            known = np.isfinite(rows.corners).all(axis=(1, 2), keepdims=True)
            corners = np.where(known, np.clip(rows.corners, -self._reach, self._reach), corners)
        bounds = np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=1)
        shown = np.flatnonzero(fine)
        cloud = target.cloud[:, shown[shown < target.cloud.shape[1]]] if target.cloud.ndim == 3 else target.cloud
        parts = tuple(every.names[i][1] for i in rows.which.tolist())
        sizes = np.stack([rows.w, rows.h], axis=1)
        lost: Mask = rows.status == "lost"
        return Shape(
            every.target, rows, parts, cloud, target.insets, table[:, :2], sizes, corners, bounds, lost, colour
        )

    # trails

    def _remember(self, shape: Shape, now: float) -> list[_Past]:
        """The target's past and its present, oldest first."""
        past = self._past.setdefault(shape.target, deque(maxlen=_SAMPLES + 1))
        if past and not past[-1].time_s < now:
            self._weights = {key: line for key, line in self._weights.items() if key[0] != shape.target}
            past.clear()
        # a trail leads neither to a place that a correction gave nor past what was absent meanwhile
        if past and (past[-1].parts != shape.parts or shape.rows.by_hand.any()):
            past.clear()
        while past and now - past[0].time_s > self.trail_s:
            past.popleft()
        present = _Past(now, self._count // self._stride, shape.parts, shape.centres, shape.lost)
        trail = [*past, present]
        if self._count % self._stride == 0 or not past:
            past.append(present)
        return trail

    def _forget(self, names: set[str]) -> None:
        for name in [n for n in self._past if n not in names]:
            del self._past[name]
        for key in [key for key in self._weights if key[0] not in names]:
            del self._weights[key]
        self._low &= names

    # particles, then lines over them

    def _cloud(self, image: Image, shape: Shape) -> None:
        """Faint dots at the particles, evenly thinned out."""
        cloud = shape.cloud
        if cloud.ndim != 3 or not len(cloud):
            return
        shown = self._roomy(shape)[: cloud.shape[1]]
        if not shown.any():
            return
        width, height = self.size
        dots = cloud[:: math.ceil(len(cloud) / _DOTS), shown]  # (n, K, 2)
        # fmin and fmax pass over NaN, which lands outside
        at = np.rint(np.fmax(np.fmin(dots, max(self.size) + 9), -9)).astype(np.int64)
        spread = np.arange(self._line) - (self._line - 1) // 2
        x = at[..., 0, None, None] + spread
        y = at[..., 1, None, None] + spread[:, None]
        x, y = np.broadcast_arrays(x, y)  # (n, K, line, line)
        inside = (x.astype(np.uint64) < width) & (y.astype(np.uint64) < height)  # negative ones wrap to huge
        lost = shape.lost[: len(shown)][shown]
        tints = (100 * np.where(lost[:, None], LOST, shape.colour)).astype(np.uint16)
        part = np.broadcast_to(np.arange(len(lost))[:, None, None], inside.shape)
        spots, flat = (y * width + x)[inside], image.reshape(-1, 3)
        flat[spots] = (flat[spots] * np.uint16(156) + tints[part[inside]]) >> np.uint16(8)

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
        for strokes, colour, opacity in self._strokes(trail, fixed(np.stack(places) - origin), shape.colour):
            polylines(layer, strokes, ink(colour, opacity), fine)
        tints = [LOST if lost else shape.colour for lost in shape.lost.tolist()]
        for ring, k in zip(fixed(rings - origin), ring_parts, strict=True):
            polylines(layer, [ring], ink(tints[k], 0.6), fine, closed=True)
        local = shape.corners - origin
        windows, middles = fixed(local), (shape.centres - origin).tolist()
        order = np.argsort(shape.lost, kind="stable").tolist()  # what is lost lies on top
        for k in order:
            tint, weight = tints[k], self._weight(shape, k)
            if shape.lost[k]:
                polylines(layer, list(fixed(dashes(local[k], 10 * line))), ink(tint, 1), weight)
            else:
                polylines(layer, [windows[k]], ink(tint, 1), weight, closed=True)
        statuses, by_hand = shape.rows.status.tolist(), shape.rows.by_hand.tolist()
        for k in order:
            status, tint, size, (x, y) = statuses[k], tints[k], signs[k], middles[k]
            if size:
                if status == "tracked":  # a ring of shade, or the dot would merge with the trail that ends in it
                    mark(layer, x, y, status, ink((0, 0, 0), 0.8), size + line, line)
                mark(layer, x, y, status, ink(tint, 1), size, line, by_hand=by_hand[k])
        cover = cv2.extractChannel(layer, 3)
        dark = cv2.dilate(cover, np.ones((2 * edge + 1, 2 * edge + 1), np.uint8))
        keep = cv2.bitwise_not(cv2.max(cover, cv2.convertScaleAbs(dark, None, _RIM)))
        under = image[y0:y1, x0:x1]
        cv2.multiply(under, cv2.cvtColor(keep, cv2.COLOR_GRAY2BGR), under, 1 / 255)
        cv2.add(under, cv2.cvtColor(layer, cv2.COLOR_BGRA2BGR), under)

    def _strokes(
        self, trail: list[_Past], places: Points, colour: Colour
    ) -> Iterator[tuple[list[Points], Colour, float]]:
        """The trail's lines of equal opacity, faint to strong; where a part was lost, dashes in vermilion."""
        paths = np.ascontiguousarray(places.reshape(len(trail), -1, 2).transpose(1, 0, 2))  # (K, T, 2)
        lost = np.stack([p.lost for p in trail], axis=1)  # (K, T)
        fresh = [1 - (trail[-1].time_s - p.time_s) / max(self.trail_s, 1e-9) for p in trail]
        ends = [bisect_left(fresh, (b + 1) / _FADES) for b in range(_FADES - 1)] + [len(trail) - 1]
        start = 0
        for b, end in enumerate(ends):
            if end <= start:
                continue
            opacity = 0.3 + 0.65 * b / (_FADES - 1)
            gaps = lost[:, start + 1 : end + 1]
            whole: list[Points] = []
            broken: list[Points] = []
            for path, gone, any_gone in zip(paths, gaps, [bool(g.any()) for g in gaps], strict=True):
                if not any_gone:
                    whole.append(path[start : end + 1])
                    continue
                for i, is_lost in enumerate(gone.tolist(), start + 1):
                    if not is_lost:
                        whole.append(path[i - 1 : i + 1])
                    elif trail[i].number % 2:
                        broken.append(path[i - 1 : i + 1])
            yield whole, colour, opacity
            yield broken, LOST, opacity
            start = end

    def _weight(self, shape: Shape, k: int) -> int:
        """The thickness of a part's window, in pixels: as its size is when it is first seen, or it would flicker."""
        strong = (24 if shape.parts[k] == BOX else 60) * self._line
        thickness = self._line + bool(shape.sizes[k].min() >= strong)
        return self._weights.setdefault((shape.target, shape.parts[k]), thickness)

    def _roomy(self, shape: Shape) -> Mask:
        """(K,) whether a part's window has room for dots."""
        found: Mask = shape.sizes.min(axis=1) >= 9 * self._line
        return found

    def _small(self, shape: Shape) -> Mask:
        found: Mask = shape.sizes.min(axis=1) < 18 * self._line
        return found

    def _signs(self, shape: Shape) -> list[float]:
        """The size of each part's mark in pixels; 0 is none, since in a few pixels the window says it all."""
        share = np.where(shape.lost & ~self._small(shape), 0.3, 0.2)
        large = np.maximum(2 * self._line, share * np.minimum(shape.sizes.min(axis=1), 40 * self._line))
        dots = np.where(self._roomy(shape), 1.25 * self._line, 0.0)
        found: list[float] = np.where(shape.rows.status == "tracked", dots, large).tolist()
        return found

    def _ellipses(self, shape: Shape) -> tuple[Array, list[int]]:
        """Two standard deviations around centres, (R, 32, 2), and whose; only where that is more than the mark."""
        rows = shape.rows
        sx, sy = (np.minimum(np.nan_to_num(std, posinf=0.0), self._reach) for std in (rows.std_x, rows.std_y))
        # in a small window the dots say as much, with less clutter
        least = np.where(self._small(shape), 1.25 * shape.sizes.max(axis=1), 4 * self._line)
        whose = np.flatnonzero(2 * np.maximum(sx, sy) >= least)
        sx, sy, xy = sx[whose], sy[whose], np.nan_to_num(rows.cov_xy[whose])
        spread = sx * sy > 1e-12
        lean = np.where(spread, np.clip(xy / np.where(spread, sx * sy, 1.0), -1.0, 1.0), 0.0)
        # the Cholesky root carries the circle to the ellipse
        roots = np.zeros((len(whose), 2, 2))
        roots[:, 0] = np.stack([2 * sx, 2 * lean * sy], axis=1)
        roots[:, 1, 1] = 2 * np.sqrt(1 - lean * lean) * sy
        rings: Array = _CIRCLE @ roots + shape.centres[whose, None]
        return rings, whose.tolist()

    # words

    def _corner_pictures(self, image: Image, shapes: Sequence[Shape]) -> list[Rect]:
        """What a target's tracker shows of what it knows, in corners that no window covers; the places taken."""
        shown = [Shown(s.target, s.insets, s.colour if len(shapes) > 1 else WHITE) for s in shapes if s.insets]
        windows = [(b[0], b[1], b[2], b[3]) for s in shapes for b in s.bounds.tolist()]
        return self._insets.draw(image, shown, windows) if shown else []

    def _labels(self, image: Image, shapes: Sequence[Shape], corners: Sequence[Rect]) -> None:
        """Names beside the windows that are large enough for it, each where it covers nothing, or nowhere."""
        font, edge = self._label_font, self._line
        bar = self._bar.height if self._bar else 0
        taken: list[Rect] = [(0, 0, self.size[0], bar), *corners]
        for shape in shapes:
            taken += [(b[0], b[1], b[2], b[3]) for b in shape.bounds.tolist()]
        slots: dict[tuple[str, str], int] = {}
        tags = list(corners)
        for shape in shapes:
            tags += self._tag(image, shape, len(shapes) > 1, tags)
        taken += tags[len(corners) :]
        for shape in shapes:
            if not shape.parts or len(taken) > 60:
                continue
            middle = shape.centres.mean(axis=0)
            columns = (shape.parts, shape.bounds.tolist(), shape.centres, shape.lost.tolist())
            for part, bound, centre, lost in zip(*columns, strict=True):
                if part in (shape.target, BOX):  # says nothing more
                    continue
                if min(bound[2] - bound[0], bound[3] - bound[1]) < 2.4 * font.cap:
                    continue
                sprite = font.sprite(_short(part), LOST if lost else shape.colour, edge)
                places = _beside(bound, sprite.size, 2 * edge)
                key = (shape.target, part)
                order = _outward(centre - middle)
                if key in self._slots:  # stay where it was, if that is still free
                    order = [self._slots[key], *order]
                for slot in order:
                    left, top = places[slot]
                    box = (left, top, left + sprite.size[0], top + sprite.size[1])
                    if self._free(box, taken):
                        stamp(image, sprite, left, top)
                        taken.append(box)
                        slots[key] = slot
                        break
        self._slots = slots

    def _free(self, box: Rect, taken: list[Rect], spare: int = 0) -> bool:
        """Whether a box is in the picture, and `spare` pixels or more away from what is taken."""
        x0, y0, x1, y1 = box
        if x0 < 0 or y0 < 0 or x1 > self.size[0] or y1 > self.size[1]:
            return False
        x0, y0, x1, y1 = x0 - spare, y0 - spare, x1 + spare, y1 + spare
        return not any(x0 < t[2] and t[0] < x1 and y0 < t[3] and t[1] < y1 for t in taken)

    def _tag(self, image: Image, shape: Shape, named: bool, tags: list[Rect]) -> list[Rect]:
        """Who a target is, if the tracker says so, or its name where there are several; the place that it took, if any.

        It stands above the target, or below where another's `tags` or the picture's border are in the way.
        """
        if not shape.parts:
            return []
        text, colour = shape.target if named else "", shape.colour
        if who := str(shape.rows.identity[0]):
            text, sure = who, float(shape.rows.identity_prob[0])
            if math.isfinite(sure):
                if sure < _DECIDED:  # pale, and with a question mark: more likely somebody else
                    text, colour = f"{text}?", _DOUBTFUL
                text += " >99%" if sure >= 0.995 else f" {sure:.0%}"  # no posterior is certain
        if not text:
            return []
        sprite = self._label_font.sprite(text, colour, self._line)
        width, height = sprite.size
        low, high = shape.bounds[:, :2].min(axis=0), shape.bounds[:, 2:].max(axis=0)
        if high[0] < 0 or high[1] < 0 or low[0] > self.size[0] or low[1] > self.size[1]:
            return []
        left = int(min(max((low[0] + high[0] - width) / 2, 0), max(self.size[0] - width, 0)))
        gap, bar = 2 * self._line, self._bar.height if self._bar else 0
        above, below = int(low[1]) - height - gap, min(int(high[1]) + gap, self.size[1] - height)
        tops = [above, below] if above >= bar else [below]
        boxes = [(left, top, left + width, top + height) for top in tops]
        # back above only once there is room to spare, or it would jump to and fro
        spare = height if shape.target in self._low else 0
        clear = [self._free(box, tags, spare if i == 0 else 0) for i, box in enumerate(boxes)]
        chosen = boxes[clear.index(True)] if any(clear) else boxes[0]
        (self._low.add if len(tops) > 1 and chosen[1] == below else self._low.discard)(shape.target)
        _shade(image, (left - self._line, int(chosen[1]), left + width + self._line, int(chosen[1]) + height))
        stamp(image, sprite, left, int(chosen[1]))
        return [chosen]


def _shade(image: Image, box: tuple[int, int, int, int]) -> None:
    """Darken a box of `image` in place: who it is must be read on any ground."""
    x0, y0, x1, y1 = (max(v, 0) for v in box)
    under = image[y0:y1, x0:x1]
    if under.size:
        cv2.convertScaleAbs(under, under, 1 - _PLATE)


def _short(name: str) -> str:
    """A part's name as one says it: mouth_left is "mouth L"."""
    return " ".join({"left": "L", "right": "R"}.get(word, word) for word in name.split("_"))


def _beside(bound: Sequence[float], size: tuple[int, int], gap: int) -> list[tuple[int, int]]:
    """Corners (left, top) for a picture of `size` to the right of a window, below, to its left, and above."""
    (x0, y0, x1, y1), (width, height) = bound, size
    across, down = round((x0 + x1 - width) / 2), round((y0 + y1 - height) / 2)
    right, below = math.ceil(x1) + 1 + gap, math.ceil(y1) + 1 + gap
    return [
        (right, down),
        (across, below),
        (math.floor(x0) - gap - width, down),
        (across, math.floor(y0) - gap - height),
    ]


def _outward(away: Array) -> list[int]:
    """The sides of `_beside`, first those that face away from the target's middle."""
    x, y = float(away[0]), float(away[1])
    facing = (x, y, -x, -y)
    return sorted(range(4), key=lambda side: -facing[side])
