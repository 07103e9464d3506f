"""The five points of a face, placed from its box by mean proportions and corrected by what the image shows.

The evidence for nose and mouth is two dark lines in the lower face: between the lips, from corner to corner, and the
shade under the nose. Nearly every face has them, and they hardly depend on the light. Lengths are in the *eye frame*:
the origin is midway between the eyes, x runs from the left eye (as seen in the image) to the right one, y down the
face, and the distance between the eyes is 1. Without evidence near the mean, the mean proportions stand.
"""

import math
from functools import lru_cache
from pathlib import Path
from threading import get_ident
from typing import Final, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array, Box, Image, Point
from facetrack_cli.tracking.start import paths

Index: TypeAlias = NDArray[np.int64]
# Fractions of a Haar box (x, y): the mean over 26 images, of 15 clips and two portraits; standard deviation 0.02.
EYES_IN_BOX: Final = ((0.309, 0.388), (0.672, 0.388))
EYE_WIDTH: Final = 100  # pixels to which a face is brought before its eyes are searched
# Each cascade with the offset of its window's centre from the eye's centre, in face widths.
_EYE_CASCADES: Final = (
    ("lefteye_2splits", 0.019, -0.030),
    ("righteye_2splits", 0.004, -0.034),
)
UNIT: Final = 64  # pixels of the rectified image of the lower face for a length of 1
LEFT, RIGHT, TOP, BOTTOM = -0.75, 0.75, 0.25, 1.75  # what it shows
WIDTH, HEIGHT = round((RIGHT - LEFT) * UNIT), round((BOTTOM - TOP) * UNIT)
xs: Final[Array] = LEFT + (np.arange(WIDTH) + 0.5) / UNIT  # of its columns
ys: Final[Array] = TOP + (np.arange(HEIGHT) + 0.5) / UNIT  # of its rows
# Mean and spread: from 1,502 frontal faces with 68 landmarks (corners at y 1.03 there) and 26 images from clips and
# portraits (1.14; in many of the clips pixels are wider than high, so that faces look long). The means lie between.
MOUTH_Y: Final = (1.12, 0.10)
SHADE_Y: Final = (0.72, 0.06)  # the dark line under the nose
SHADE_TO_MOUTH: Final = (0.43, 0.08)
HALF_WIDTH: Final = (0.415, 0.065)  # from the middle of the mouth to a corner
UPPER: Final = (0.14, 0.05)  # from the dark line, in the middle, up to the upper lip's edge
LOWER: Final = (0.23, 0.09)  # from half-way between that line and the corners down to the lower lip's edge
TIP_ABOVE_SHADE: Final = 0.15
CLEAR: Final = 0.1  # a valley this deep (in log grey) is a line beyond doubt
BEND: Final = 0.05  # price of a row up or down from one column to the next
CORNER: Final = 0.55  # beyond a corner the line has less than this share of its depth in the middle
EDGE: Final = 15.0  # weight of a lip's edge, per log grey and pixel of the rectified image


def cascade(name: str) -> cv2.CascadeClassifier:
    """OpenCV's own cascade of that name, loaded once for each thread, since it holds the image that it searches."""
    return _load(name, get_ident())


@lru_cache(maxsize=64)
def _load(name: str, thread: int) -> cv2.CascadeClassifier:
    return cv2.CascadeClassifier(str(Path(cv2.__file__).parent / "data" / f"haarcascade_{name}.xml"))


def place(image: Image, box: Box) -> dict[str, Point]:
    """All five points of the face that fills `box` as the frontal cascade draws it, in pixels of `image` (BGR)."""
    # the part of the image around the box, so that the time does not depend on the size of the frame
    x0, y0 = max(int(box[0] - 0.5 * box[2]), 0), max(int(box[1] - 0.5 * box[3]), 0)
    image = image[y0 : int(box[1] + 1.6 * box[3]) + 1, x0 : int(box[0] + 1.5 * box[2]) + 1]
    eyes = _EyeFrame(*_find_eyes(image, (box[0] - x0, box[1] - y0, box[2], box[3])))
    points = {name: eyes.to_image(*at) for name, at in read_points(eyes.rectify(image)).items()}
    return {name: (x + x0, y + y0) for name, (x, y) in points.items()}


def place_upright(image: Image, box: Box) -> dict[str, Point]:
    """As `place`, of a face that is upright: its eyes are not sought, they are where the box has them on average."""
    eyes = _EyeFrame(*mean_eyes(box))
    return {name: eyes.to_image(*at) for name, at in read_points(eyes.rectify(image)).items()}


def lips_of(image: Image, eyes: tuple[Point, Point], mouth: tuple[Point, Point]) -> dict[str, Point]:
    """The lips of a face of which eyes and corners of the mouth are known, each the left one first."""
    x0, y0 = (max(math.floor(value - math.dist(*eyes)), 0) for value in np.min([*eyes, *mouth], axis=0).tolist())
    x1, y1 = (math.ceil(value + math.dist(*eyes)) for value in np.max([*eyes, *mouth], axis=0).tolist())
    frame = _EyeFrame(*((x - x0, y - y0) for x, y in eyes))
    seen = {
        name: frame.to_image(*at) for name, at in read_points(frame.rectify(image[y0 : y1 + 1, x0 : x1 + 1])).items()
    }
    dx, dy = np.mean(mouth, axis=0) - np.mean([seen["mouth_left"], seen["mouth_right"]], axis=0)
    return {part: (seen[part][0] + float(dx), seen[part][1] + float(dy)) for part in ("lip_upper", "lip_lower")}


def shows_features(image: Image, box: Box) -> bool:
    """Whether the face in `box` shows an eye to a cascade, or a mouth: a line as dark as one between lips is."""
    x0, y0 = max(int(box[0]), 0), max(int(box[1]), 0)
    image = image[y0 : int(box[1] + box[3]) + 1, x0 : int(box[0] + box[2]) + 1]
    box = (box[0] - x0, box[1] - y0, box[2], box[3])
    if any(_detected_eyes(image, box)):
        return True
    grey = np.log(_EyeFrame(*mean_eyes(box)).rectify(image).astype(np.float64) @ (0.114, 0.587, 0.299) + 8)
    line = np.minimum(_valleys(grey) / CLEAR, 1)
    _, mouth_y = _dark_lines(line)
    rows = np.abs(ys - mouth_y) <= 0.06
    return bool(line[rows][:, np.abs(xs) <= 0.3].max(axis=0).mean() > 0.8)


def mean_eyes(box: Box) -> tuple[Point, Point]:
    """Where the eyes are in a face's box on average, in pixels."""
    x, y, w, h = box
    left, right = ((x + across * w - 0.5, y + down * h - 0.5) for across, down in EYES_IN_BOX)
    return left, right


def _find_eyes(image: Image, box: Box) -> tuple[Point, Point]:
    """The eyes of the face in `box`, in pixels: each the median of what two cascades say, else its mean place."""
    # of few detections the mean place is one more, so that a single wrong one cannot pull an eye all the way
    both = zip(mean_eyes(box), _detected_eyes(image, box), strict=True)
    left, right = (np.median([mean, *seen] if len(seen) < 3 else seen, axis=0).tolist() for mean, seen in both)
    return left, right


def _detected_eyes(image: Image, box: Box) -> tuple[list[Point], list[Point]]:
    """What the cascades see near the mean place of either eye."""
    x, y, w, h = box
    zoom, top, means = EYE_WIDTH / w, y + 0.1 * h, mean_eyes(box)
    matrix = np.array([[zoom, 0, -(x - 0.5) * zoom - 0.5], [0, zoom, -(top - 0.5) * zoom - 0.5]])
    size = (EYE_WIDTH, round(0.55 * h * zoom))
    patch = cv2.warpAffine(_smooth(image, 1 / zoom), matrix, size, borderMode=cv2.BORDER_REPLICATE)
    grey = cv2.equalizeHist(cv2.cvtColor(patch, cv2.COLOR_BGR2GRAY))
    found: tuple[list[Point], list[Point]] = ([], [])
    smallest, largest = (round(0.15 * EYE_WIDTH),) * 2, (round(0.45 * EYE_WIDTH),) * 2
    for name, dx, dy in _EYE_CASCADES:
        for ex, ey, ew, eh in cascade(name).detectMultiScale(grey, 1.1, 2, 0, smallest, largest):
            at = (x - 0.5 + (ex + ew / 2) / zoom - dx * w, top - 0.5 + (ey + eh / 2) / zoom - dy * w)
            for seen, mean in zip(found, means, strict=True):
                if abs(at[0] - mean[0]) < 0.08 * w and abs(at[1] - mean[1]) < 0.09 * h:
                    seen.append(at)
    return found


def _smooth(image: Image, shrink: float) -> Image:
    """The image, blurred against aliasing if it is to be reduced by `shrink`."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 0.5 * shrink), np.uint8) if shrink > 1 else image


class _EyeFrame:
    """The eye frame in the image: its origin in pixels, the unit vector along x, the length of 1 in pixels."""

    def __init__(self, left: Point, right: Point) -> None:
        dx, dy = right[0] - left[0], right[1] - left[1]
        self.scale = float(np.hypot(dx, dy))
        self.origin = (left[0] + right[0]) / 2, (left[1] + right[1]) / 2
        self.along = dx / self.scale, dy / self.scale

    def to_image(self, x: float, y: float) -> Point:
        (ox, oy), (ux, uy) = self.origin, self.along
        return float(ox + self.scale * (x * ux - y * uy)), float(oy + self.scale * (x * uy + y * ux))

    def rectify(self, image: Image) -> Image:
        """The lower face, upright and at UNIT pixels to a length of 1: rows TOP..BOTTOM, columns LEFT..RIGHT."""
        (ux, uy), shrink = self.along, self.scale / UNIT
        corner = self.to_image(LEFT + 0.5 / UNIT, TOP + 0.5 / UNIT)
        matrix = np.array([[ux * shrink, -uy * shrink, corner[0]], [uy * shrink, ux * shrink, corner[1]]])
        how, size = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, (WIDTH, HEIGHT)
        lower = cv2.warpAffine(_smooth(image, shrink), matrix, size, flags=how, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(lower, np.uint8)


def read_points(image: Image) -> dict[str, Point]:
    """The five points of a rectified lower face (HEIGHT, WIDTH, 3), in the eye frame."""
    # logarithms: a factor on the light is a constant, which differences drop
    grey = np.log(image.astype(np.float64) @ (0.114, 0.587, 0.299) + 8)
    valley = _valleys(grey)
    line = np.minimum(valley / CLEAR, 1)
    shade_y, mouth_y = _dark_lines(line)
    path = _follow(line, mouth_y)
    left, right = _corners(valley, path)
    upper, lower = _lips(grey, image, left, right, path)
    nose = _nose_x(grey, valley, shade_y), shade_y - TIP_ABOVE_SHADE
    return {"nose": nose, "mouth_left": left, "mouth_right": right, "lip_upper": upper, "lip_lower": lower}


def _valleys(grey: Array) -> Array:
    """How much darker each pixel is than what is above and below it, at the best of three widths."""
    deepest = np.zeros_like(grey)
    for width in (1.5, 2.5, 3.5):
        soft = cv2.GaussianBlur(grey, (0, 0), sigmaX=1.5 * width, sigmaY=width, borderType=cv2.BORDER_REPLICATE)
        bent = (soft[4:] + soft[:-4] - 2 * soft[2:-2]) * (width**2 / 4)
        np.maximum(deepest[2:-2], bent, out=deepest[2:-2])
    return deepest


def _off(value: Array, norm: tuple[float, float]) -> Array:
    """Half the squared distance from a mean, in its spreads; bounded, so that no mean overrules a clear image."""
    return np.asarray(np.minimum(0.5 * ((value - norm[0]) / norm[1]) ** 2, 8.0))


# how far each pair of heights, of the shade (rows) and of the mouth (columns), is off the means
_PAIRS_OFF: Final = _off(ys[:, None], SHADE_Y) + _off(ys, MOUTH_Y) + _off(ys - ys[:, None], SHADE_TO_MOUTH)


def _dark_lines(line: Array) -> tuple[float, float]:
    """Heights of the shade under the nose and of the line between the lips: the pair that fits image and means."""
    near = np.flatnonzero(np.abs(xs) <= 0.3)
    middle = WIDTH // 2
    right, left = line.take(near[near >= middle][::-1], axis=1), line.take(near[near < middle], axis=1)
    strength = (paths.follow(right, BEND)[0] + paths.follow(left, BEND)[0]) / near.size
    value = 4 * strength[:, None] + 8 * strength - _PAIRS_OFF
    best_shade, best_mouth = np.unravel_index(int(np.argmax(value)), value.shape)
    return float(ys[best_shade]), float(ys[best_mouth])


def _follow(line: Array, mouth_y: float) -> Index:
    """The row of the line between the lips in every column (WIDTH,), by dynamic programming around `mouth_y`."""
    away = np.abs(ys[:, None] - mouth_y)
    # without a line to follow, straight on
    gain = np.where(away <= 0.08 + 0.2 * np.abs(xs), line - 0.01 * away, -1.0)
    rows: Index = paths.follow(gain, BEND)[1]
    return rows


def _corners(valley: Array, path: Index) -> tuple[Point, Point]:
    """Where the line between the lips ends on either side: its depth inside against its depth beyond."""
    depth = valley[path, np.arange(WIDTH)]
    inside = float(np.median(depth[np.abs(xs) < 0.25]))
    # a line that can hardly be seen says little about where it ends
    share = (np.minimum(depth / max(inside, 1e-6), 1.0) - CORNER) * min(2 * inside / CLEAR, 1.0)
    ends = []
    for sign in (-1, 1):
        order = np.flatnonzero(sign * xs > 0)[::sign]
        value = np.cumsum(share[order]) - _off(np.abs(xs[order]), HALF_WIDTH)
        column = order[int(np.argmax(value))]
        ends.append((float(xs[column]), float(ys[path[column]])))
    return ends[0], ends[1]


def _lips(grey: Array, image: Image, left: Point, right: Point, path: Index) -> tuple[Point, Point]:
    """The lips' outer edges below and above the middle between the corners."""
    x, y = (left[0] + right[0]) / 2, (left[1] + right[1]) / 2
    first, end = np.searchsorted(xs, (x - 0.08, x + 0.08))
    # the blur reaches 5 pixels to either side; a middle between corners is never near the image's border
    soft = cv2.GaussianBlur(image[:, first - 5 : end + 5], (0, 0), 1.5)[:, 5:-5].astype(np.float64)
    # red over green: lips stand out, shades do not; zero everywhere in a grey image
    red = np.log((soft[..., 2] + 8) / (soft[..., 1] + 8))
    darker, redder = -_slope(grey[:, first:end].mean(axis=1)), _slope(red.mean(axis=1))
    upper = EDGE * (darker + 4 * redder)
    lower = -2 * EDGE * redder  # in grey a lower lip shades into the chin: the mean knows better
    middle = float(ys[path[first:end]].mean())
    up, down = middle - ys, ys - (middle + y) / 2
    best_up = np.argmax(np.where(up > 0.02, np.minimum(upper, 3.0) - _off(up, UPPER), -np.inf))
    best_down = np.argmax(np.where(down > 0.04, np.minimum(lower, 3.0) - _off(down, LOWER), -np.inf))
    return (x, float(ys[best_up])), (x, float(ys[best_down]))


def _slope(profile: Array) -> Array:
    """Change for a pixel down, smoothed."""
    return np.asarray(np.gradient(cv2.GaussianBlur(profile[:, None], (0, 0), 1.5).ravel()))


def _nose_x(grey: Array, valley: Array, shade_y: float) -> float:
    """Where the nose is across: the middle of the shade under it, drawn to the bright ridge above (weights: a fit)."""
    shade = np.where(np.abs(xs) <= 0.35, valley[np.abs(ys - shade_y) <= 0.06].mean(axis=0), 0.0) ** 0.5
    total = float(shade.sum())
    middle = float(shade @ xs) / total if total > 0 else 0.0
    above = (ys > shade_y - 0.3) & (ys < shade_y - 0.08)
    profile = cv2.GaussianBlur(grey[above].mean(axis=0)[None], (0, 0), 3.0).ravel()
    half, bright = round(0.17 * UNIT), np.full(WIDTH, -np.inf)
    bright[half:-half] = 2 * profile[half:-half] - profile[2 * half :] - profile[: -2 * half]
    bright[np.abs(xs - middle) > 0.2] = -np.inf
    ridge = float(xs[int(np.argmax(bright - 0.075 * ((xs - middle) / 0.15) ** 2))])
    return 0.6 * middle + 0.3 * ridge
