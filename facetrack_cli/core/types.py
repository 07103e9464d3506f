"""The values that pass between the parts of the engine.

Axes, everywhere: N particles, K parts, D coordinates a part; x before y; pixels, pixel centres at whole numbers.
Images are (H, W, 3) uint8 in OpenCV's order, blue first.
"""

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import check_opencv
from facetrack_cli.core.face_points import DETECTORS

check_opencv(getattr(cv2, "__version__", "of nothing"))  # before anything else asks what another version has not

Array: TypeAlias = NDArray[np.float64]
Image: TypeAlias = NDArray[np.uint8]
Mask: TypeAlias = NDArray[np.bool_]
Texts: TypeAlias = NDArray[np.str_]
Whole: TypeAlias = NDArray[np.int64]
Box: TypeAlias = tuple[float, float, float, float]  # left, top, width, height
Extent: TypeAlias = tuple[float, float, float, float]  # x from, y from, x to, y to
Point: TypeAlias = tuple[float, float]
BOX = "box"  # the one part of a target that is tracked as a box
# grey levels by Y, which is 16 for black and 235 for white
_FULL_RANGE = np.clip(np.rint((np.arange(256) - 16) * 255 / 219), 0, 255).astype(np.uint8)
MAX_NAME = 100
_MARGIN = 6.0  # pixels around a part
MAX_REMEMBERED = 8  # a step asks for the particles twice, and for a few single states in between


def checked_name(name: str, of: str = "person") -> str:
    """The name, wherever it comes from. ValueError for one that could steer a terminal, a path or a table."""
    if len(name) > MAX_NAME:
        raise ValueError(f"{name[:20]!r}... has {len(name)} letters, and a name of a {of} at most {MAX_NAME}")
    if not name.strip(" .") or not name.isprintable() or "/" in name or "\\" in name:
        raise ValueError(f"{name!a} is no name of a {of}: give 1 to {MAX_NAME} printable letters without / and \\")
    return name


class Planes(NamedTuple):
    """Y (H, W), U and V (H / 2, W / 2) of 4:2:0 in limited range, views of where a decoder has put them.

    `ours` (3, 3) makes Y, Cb and Cr by BT.601 of them; None of planes by BT.601.
    """

    y: Image
    u: Image
    v: Image
    ours: Array | None = None

    @classmethod
    def of(cls, pixels: Image) -> "Planes":
        """Those in one array (H * 3 / 2, W)."""
        width, height = pixels.shape[1], pixels.shape[0] * 2 // 3
        y, u, v = np.split(pixels.ravel(), [width * height, width * height // 4 * 5])
        return cls(y.reshape(height, width), u.reshape(-1, width // 2), v.reshape(-1, width // 2))

    def part(self, columns: tuple[int, int], rows: tuple[int, int]) -> "Planes":
        """Pairs of columns and rows, each of which has one value of U and of V."""
        (x0, x1), (y0, y1) = columns, rows
        y, u, v = self.y[2 * y0 : 2 * y1, 2 * x0 : 2 * x1], self.u[y0:y1, x0:x1], self.v[y0:y1, x0:x1]
        return Planes(y, u, v, self.ours)

    @property
    def lit(self) -> Image:
        """Y by BT.601: grey stays grey, it changes by U and V alone."""
        if self.ours is None:
            return self.y
        more = self._mixed(0)
        if more.shape != self.y.shape:  # a pair of the same bytes for each, and each row twice
            more = np.repeat(np.multiply(more, 257, dtype=np.uint16).view(np.uint8), 2, axis=0)
        return np.asarray(cv2.addWeighted(self.y, 1, more, 1, -128), np.uint8)

    def _mixed(self, row: int) -> Image:
        """U and V by a row of `ours`, each about its middle."""
        assert self.ours is not None
        _, a, b = self.ours[row].tolist()
        return np.asarray(cv2.addWeighted(self.u, a, self.v, b, 128 - 128 * (a + b)), np.uint8)

    def joined(self) -> Image:
        """By BT.601 in one array (H * 3 / 2, W)."""
        tints = (self.u, self.v) if self.ours is None else (self._mixed(1), self._mixed(2))
        return np.concatenate([plane.ravel() for plane in (self.lit, *tints)]).reshape(-1, self.y.shape[1])

    @property
    def bgr(self) -> Image:
        return np.asarray(cv2.cvtColor(self.joined(), cv2.COLOR_YUV2BGR_I420), np.uint8)

    @property
    def grey(self) -> Image:
        return np.asarray(cv2.LUT(self.lit, _FULL_RANGE), np.uint8)


# parts of images, the point (left, top) of the whole at which they begin, and the extent that they serve
_Part: TypeAlias = tuple[tuple[Image, ...], int, int, Extent]


class Frame:
    """One frame of the source: its 0-based index, its time in s, its pixels, and values that were computed from them.

    `pixels` are (H, W, 3) in OpenCV's order, blue first, or the planes Y, U and V of 4:2:0 of limited range by BT.601,
    (H * 3 / 2, W). Grey is then Y, and colours are computed when they are read first. Of the planes of a decoder those
    parts are read that somebody asks for. `size` is (width, height) in pixels, `aspect` the width of a pixel over its
    height, as it is shown.
    """

    __slots__ = ("_bgr", "_parts", "_patches", "_pixels", "aspect", "index", "size", "time_s", "yuv")

    def __init__(
        self, index: int, time_s: float, pixels: Image | Planes, _bgr: Image | None = None, *, aspect: float = 1.0
    ) -> None:
        self.index, self.time_s, self.aspect = index, time_s, aspect
        self.yuv = pixels if isinstance(pixels, Planes) else Planes.of(pixels) if pixels.ndim == 2 else None
        self._pixels = None if isinstance(pixels, Planes) else pixels
        lit = self._pixels if self.yuv is None else self.yuv.y
        assert lit is not None
        self.size: tuple[int, int] = (lit.shape[1], lit.shape[0])
        self._bgr = _bgr
        self._parts: dict[tuple[str, int], _Part] = {}  # by what they are of and their factor
        self._patches: dict[Hashable, tuple[object, NDArray[np.float32]]] = {}

    @property
    def pixels(self) -> Image:
        """All of them in one array."""
        if self._pixels is None:
            assert self.yuv is not None
            self._pixels = self.yuv.joined()
        return self._pixels

    @property
    def bgr(self) -> Image:
        """The image as (H, W, 3)."""
        if self.yuv is None:
            return self.pixels
        if self._bgr is None:
            self._bgr = np.asarray(cv2.cvtColor(self.pixels, cv2.COLOR_YUV2BGR_I420), np.uint8)
        return self._bgr

    def reduced(self, factor: int, extent: Extent) -> tuple[Image, int, int]:
        """The image reduced by `factor`, a power of two (area means), at least within `extent`.

        Returns it with the point (left, top) of the whole image at which it begins. Blocks are counted from the corner
        of the image, so that a block has the same mean whatever is asked for; an incomplete last block is left out.
        """
        (image,), left, top, _ = self._part("bgr", factor, extent, _MARGIN)
        return image, left, top

    def planes(self, factor: int, extent: Extent) -> list[tuple[Image, int, int, int]] | None:
        """Y, U and V, each reduced for itself and with (left, top) and its own factor; None of what has no planes.

        As `reduced`, but that U and V are reduced by twice as much, and all are by the matrix of `yuv`.
        """
        if self.yuv is None:  # whether colours were computed meanwhile must not matter
            return None
        (lit,), x, y, _ = self._part("y", factor, extent, _MARGIN)
        half = extent[0] / 2, extent[1] / 2, extent[2] / 2, extent[3] / 2
        (u, v), left, top, _ = self._part("uv", factor, half, _MARGIN)
        own = 2 * left, 2 * top, 2 * factor
        return [(lit, x, y, factor), (u, *own), (v, *own)]

    def grey(self, factor: int, extent: Extent) -> tuple[Image, int, int]:
        """The image in grey (H, W), reduced by `factor` and beginning at (left, top), at least within `extent`."""
        (image,), left, top, _ = self._part("grey", factor, extent, _MARGIN)
        return image, left, top

    def _part(self, what: str, factor: int, extent: Extent, more: float = 0.0) -> _Part:
        """As `reduced`, of the colours ("bgr"), of grey, of the plane "y", or of "uv" in pixels of their own.

        Made with a margin of `more` pixels, which are reduced, for what this frame is asked for next.
        """
        kept = self._parts.get((what, factor))
        if kept is None or not _within(extent, kept[3]):
            x0, y0, x1, y1 = extent
            more *= factor
            make = self._in_grey if what == "grey" else self._of_whole if factor == 1 else self._smaller
            kept = self._parts[what, factor] = make(what, factor, (x0 - more, y0 - more, x1 + more, y1 + more))
        return kept

    def _smaller(self, what: str, factor: int, asked: Extent) -> _Part:
        """Parts of the images at half the factor, reduced: OpenCV halves four times as fast as by other factors."""
        own, before = 2 * factor if what == "uv" else factor, factor // 2
        across, down = self.size[0] // own or 1, self.size[1] // own or 1
        (left, right), (top, bottom) = _blocks(asked[0], asked[2], factor, across), _blocks(*asked[1::2], factor, down)
        wanted = left * factor, top * factor, right * factor - 1, bottom * factor - 1
        larger, x, y, _ = self._part(what, before, wanted)
        rows = slice(2 * top - y // before, 2 * bottom - y // before)
        columns, size = slice(2 * left - x // before, 2 * right - x // before), (right - left, bottom - top)
        halves = (cv2.resize(image[rows, columns], size, interpolation=cv2.INTER_AREA) for image in larger)
        # what begins at a border serves all beyond it
        x0, y0 = asked[0] if left else -math.inf, asked[1] if top else -math.inf
        served = x0, y0, asked[2] if right < across else math.inf, asked[3] if bottom < down else math.inf
        return tuple(np.asarray(half, np.uint8) for half in halves), left * factor, top * factor, served

    def _of_whole(self, what: str, _: int, asked: Extent) -> _Part:
        """The image itself; a part of it where less than half would have to be converted."""
        if self.yuv is not None and what != "bgr":
            return (self.yuv.y,) if what == "y" else (self.yuv.u, self.yuv.v), 0, 0, _ALL
        if self.yuv is None or self._bgr is not None:
            return (self.bgr,), 0, 0, _ALL
        width, height = self.size
        columns = _blocks(asked[0], asked[2], 2, width // 2)
        rows = _blocks(asked[1], asked[3], 2, height // 2)
        if 8 * (columns[1] - columns[0]) * (rows[1] - rows[0]) > width * height:
            return (self.bgr,), 0, 0, _ALL
        return (self.yuv.part(columns, rows).bgr,), 2 * columns[0], 2 * rows[0], asked

    def _in_grey(self, _: str, factor: int, asked: Extent) -> _Part:
        (lit,), left, top = self._part("y" if self.yuv else "bgr", factor, asked)[:3]
        height, width = lit.shape[:2]
        x0, x1 = _blocks((asked[0] - left) / factor, (asked[2] - left) / factor, 1, width)
        y0, y1 = _blocks((asked[1] - top) / factor, (asked[3] - top) / factor, 1, height)
        part, left, top = lit[y0:y1, x0:x1], left + x0 * factor, top + y0 * factor
        grey = self._grey_of(part, factor, left, top) if self.yuv else cv2.cvtColor(part, cv2.COLOR_BGR2GRAY)
        return (np.asarray(grey, np.uint8),), left, top, asked

    def _grey_of(self, lit: Image, factor: int, left: int, top: int) -> Image:
        """The grey of a part of the plane Y, reduced by `factor`, that begins at (left, top)."""
        assert self.yuv is not None
        if self.yuv.ours is None:
            return Planes(lit, lit, lit).grey
        height, width = lit.shape
        extent = (left, top, left + factor * width - 1, top + factor * height - 1)
        _, (u, x, y, own), (v, *_) = self.planes(factor, extent) or []
        # the last row and column of Y may have none of their own
        rows = np.minimum((factor * np.arange(height) + top - y) // own, len(u) - 1)[:, None]
        columns = np.minimum((factor * np.arange(width) + left - x) // own, u.shape[1] - 1)
        return Planes(lit, u[rows, columns], v[rows, columns], self.yuv.ours).grey

    def remembered(self, key: Hashable) -> NDArray[np.float32] | None:
        """What was remembered with this key."""
        pair = self._patches.get(key)
        return None if pair is None else pair[1]

    def remember(self, key: Hashable, of: object, values: NDArray[np.float32]) -> None:
        """Keep `values` for `remembered`, with the last few others, and `of`, whose id may be part of the key."""
        if len(self._patches) >= MAX_REMEMBERED:
            del self._patches[next(iter(self._patches))]
        self._patches[key] = of, values


def own_frame(frame: Frame) -> Frame:
    """The frame for somebody who looks at other parts of it: what is computed for each is kept apart."""
    return Frame(frame.index, frame.time_s, frame.yuv or frame.pixels, frame._bgr, aspect=frame.aspect)


def factor_for(longest: float, most: float | None) -> int:
    """The least power of two that reduces a length to `most` pixels or less; 1 without a bound."""
    return 1 if most is None else 2 ** math.ceil(math.log2(max(longest / most, 1.0)))


_ALL: Extent = (-math.inf, -math.inf, math.inf, math.inf)


def _within(inner: Extent, outer: Extent) -> bool:
    return inner[0] >= outer[0] and inner[1] >= outer[1] and inner[2] <= outer[2] and inner[3] <= outer[3]


def _blocks(low: float, high: float, factor: int, count: int) -> tuple[int, int]:
    """The half-open range of blocks of `factor` pixels that covers [low, high], within `count` blocks, never empty."""
    most = factor * count
    first = (count - 1 if low >= most else int(low / factor)) if low > 0 else 0
    last = count if high >= most else math.ceil(max(high, -1.0) / factor) + 1
    return min(first, count - 1), min(max(last, first + 1), count)


class Particles(NamedTuple):
    """A weighted sample of the posterior: x (N, K, D) in pixels, log_w (N,) with logsumexp 0."""

    x: Array
    log_w: Array


class Info(NamedTuple):
    """What a filter reports of one step.

    `ess` (K,): effective sample size of each part, in which particles of one origin count as one. `evidence`: log
    p(y_t | Y_{t-1}) in nats as the particles estimate it, up to a constant of the recipe; nan where a filter has none.
    """

    ess: Array
    evidence: float = math.nan


@dataclass(frozen=True, slots=True)
class TargetStart:
    """Where one target is in the first frame: a box, named points, or both; `windows` override the recipe's (w, h)."""

    box: Box | None = None
    points: Mapping[str, Point] = field(default_factory=dict)
    windows: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Correction:
    """What a user corrected of one target at one frame, from which it begins again; or what is right there.

    Parameters
    ----------
    box, points
        Its box, or some of its points, by hand.
    kept
        Where its other points were. A point that is in neither stays where the tracker has it.
    absent
        Parts that cannot be seen from there on; True for all.
    learn
        Whether to relearn the appearance at this frame. None: that of the parts by hand. Always None if all is absent.
    confirmed
        Parts that lie right in that frame, whatever the tracker calls them; True for all. Then nothing begins again,
        and nothing else is said.
    """

    frame: int
    target: str
    box: Box | None = None
    points: Mapping[str, Point] = field(default_factory=dict)
    kept: Mapping[str, Point] = field(default_factory=dict)
    absent: tuple[str, ...] | Literal[True] = ()
    learn: bool | None = None
    confirmed: tuple[str, ...] | Literal[True] = ()

    def __post_init__(self) -> None:
        if self.absent is True:  # nothing is there to be learned
            object.__setattr__(self, "learn", None)

    def hidden(self, parts: Sequence[str]) -> tuple[str, ...]:
        """Those of `parts` that cannot be seen from there on."""
        return tuple(part for part in parts if self.absent is True or part in self.absent)


@dataclass(frozen=True, slots=True)
class Start:
    """Where a track begins: the source frame, each target, and the origin of both (a file's path, "haar", "--box").

    `note` says to the user what a search took, and why. `detector`: what measures faces after a start that no detector
    found, "" for the Haar cascades; `placed`: whether it has placed the points in a box that was given.
    `corrections` are in the order of their frames, all after `frame`; no target has two in one frame.
    """

    frame: int
    targets: Mapping[str, TargetStart]
    origin: str
    corrections: tuple[Correction, ...] = ()
    note: str = ""
    detector: str = ""
    placed: bool = False

    @property
    def placed_by(self) -> str:
        """The name of the detector that has placed the points; "" if somebody did by hand."""
        return self.origin if self.origin in DETECTORS else self.detector if self.placed else ""

    @property
    def measured_by(self) -> str:
        """The name of the detector that measures faces: what has placed the points, or what the start names."""
        return self.placed_by or self.detector or DETECTORS[0]
