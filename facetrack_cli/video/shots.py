"""Shots of an edited clip: where one camera's image follows another's, at once (a cut) or by blending (a dissolve).

A frame is compared as a small image in brightness and colour. At a cut the images before and after differ far more than
neighbours do, for more than half a second, and by more than brightness. In a dissolve the images lie on the line from
the last image of the one shot to the first image of the other, at even steps, and have less texture than both: edges of
two images that are blended fade. A pan or a person that moves leaves that line and keeps its texture. All this is ours.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache
from typing import Final, Literal, NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Frame, Image, Whole

SIDE: Final = (32, 18)  # pixels of the small images
MIN_STEP: Final = 5.0  # grey levels, mean over the image, that two shots differ by at least
BESIDE: Final = 0.5  # share of the step at a cut that its neighbours' steps reach at most
FLASH_S: Final = 0.5  # seconds that a flash, a whip pan and back, or a hand before the lens last at most
SAME_STRUCTURE: Final = 0.93  # correlation of two images that differ in brightness alone
SPANS: Final = (6, 8, 12, 16, 24, 36)  # frames of a dissolve
UNEVEN: Final = 0.3  # lengths of the line by which a step of a dissolve is early or late at most
SURE: Final = 3.0  # log odds of a dissolve
ONE_FRAMES: Final = 6  # between two dissolves, at most, that are one
SAME_SCENE: Final = 0.7  # correlation of two images between which there is no dissolve
_AFTER: Final = 4  # frames after which a cut of a clip that passes is decided
_LATE: Final = 12  # frames from one look for a dissolve to the next; it has ended half as many ago, at least
_KEPT: Final = SPANS[-1] + 2 * _LATE  # images that are kept of a clip that passes
READ: Final = 5  # pixels a row and column that a pixel of a small image is the mean of; of colours one row
_MARGIN: Final = 2 * SPANS[-1]  # frames on either side that a decision rests on
_BLOCK: Final = 1000  # frames that are decided at a time


# log odds of a dissolve, by logistic regression on clips joined at random: always; by the texture in its middle over
# that at its ends, the correlation of the ends, the logarithm of their mean difference in grey levels, the mean
# distance from the line, and how far the images move outside of it, both in lengths of the line
_AT, _BLENDED, _ALIKE, _STEP, _OFF, _MOVES = 53.2, -49.5, -5.4, 2.38, -44.4, -2.93


class Cut(NamedTuple):
    """A shot begins at `frame`; frames `first` to `last` show both shots, none if `last` is before `first`."""

    frame: int
    first: int
    last: int


class Shot(NamedTuple):
    """Frames [first, stop); stop None: the end of the clip. Those of [clear, until) show no other shot."""

    first: int
    stop: int | None
    clear: int
    until: int | None

    def is_clear(self, frame: int) -> bool:
        return frame >= self.clear and (self.until is None or frame < self.until)


Event: TypeAlias = Literal["", "maybe", "none", "cut"]


class Passing(NamedTuple):
    """Cuts and dissolves of a clip as it passes; `images` are the last small ones, `waits` the frames to a decision.

    `step` is the mean difference of the last two images. A cut is known when some frames after it are there. Until then
    it is a `maybe`, since a flash and fast motion look alike; then it was a "cut" or "none". A dissolve is known half a
    second after its end.
    """

    images: tuple[Image, ...]
    frames: int = 0
    waits: int = 0
    step: float = 0.0

    def after(self, image: Image) -> tuple[Passing, Event]:
        """With the small image of the next frame, and what is known with it."""
        images = (*self.images[-_KEPT:], image)
        step = cv2.norm(images[-1], images[-2], cv2.NORM_L1) / images[-1].size
        passing = Passing(images, self.frames + 1, max(self.waits - 1, 0), step)
        if step >= MIN_STEP and self.step <= BESIDE * step and _alike(*_flat(images[-2:])) < SAME_STRUCTURE:
            return passing._replace(waits=_AFTER - 1), "maybe"
        if self.waits == 1:
            last = images[-2 * _AFTER - 2 :]
            return passing, "cut" if len(last) - _AFTER in _hard(_flat(last), _AFTER) else "none"
        late = passing.frames % _LATE == 0 and len(images) > SPANS[0]
        if late and _alike(*_flat((images[0], images[-1]))) < SAME_SCENE:
            flat, ends = _flat(images), range(len(images) - 3 * _LATE // 2, len(images) - _LATE // 2)
            # which of all it is matters only where there may be any
            there = _dissolves(flat, ends) and any(last in ends for _, _, last in _dissolves(flat))
            return passing, "cut" if there else ""
        return passing, ""


def passing_shots(frames: Iterable[Frame]) -> Iterator[tuple[int, Frame]]:
    """Each frame of a clip that passes with the number of its shot, as late as a cut is known; dissolves come later."""
    passing, waiting, shot = Passing(()), deque[Frame](), 0
    for frame in frames:
        passing, event = passing.after(small(frame)) if passing.images else (Passing((small(frame),)), "")
        shot += event == "cut"  # which the first that waits begins
        waiting.append(frame)
        if len(waiting) == _AFTER:
            yield shot, waiting.popleft()
    yield from ((shot, frame) for frame in waiting)


def find_cuts(
    frames: Iterable[Frame], looked: Callable[[int], None] = lambda done: None, fps: float = 25.0
) -> Iterator[Cut]:
    """The cuts and dissolves of a clip, in order. Memory is bounded; `looked` hears of the frames gone by."""
    flash = min(max(round(FLASH_S * fps), 1), _MARGIN)
    waiting: list[NDArray[np.float32]] = []
    first, decided = 0, 0  # of the clip: the first that waits, the first that is not decided
    for done, frame in enumerate(frames, 1):
        if done == 1:
            first = decided = frame.index
        waiting.append(small(frame).astype(np.float32).ravel())
        looked(done)
        if len(waiting) == _BLOCK + 2 * _MARGIN:
            until = first + len(waiting) - _MARGIN
            yield from (cut for cut in _cuts(np.array(waiting), first, flash) if decided <= cut.frame < until)
            decided = until
            del waiting[:_BLOCK]
            first += _BLOCK
    if waiting:
        yield from (cut for cut in _cuts(np.array(waiting), first, flash) if decided <= cut.frame)


def shots_of(cuts: Iterable[Cut], first: int, stop: int | None) -> list[Shot]:
    """The shots between cuts of the frames from `first` to before `stop`."""
    cuts = [cut for cut in cuts if cut.frame > first]
    ends = [*((cut.frame, min(cut.first, cut.frame)) for cut in cuts), (stop, stop)]
    shots = zip([Cut(first, first, first - 1), *cuts], ends, strict=True)
    return [Shot(cut.frame, end, max(cut.frame, cut.last + 1), until) for cut, (end, until) in shots]


def small(frame: Frame) -> Image:
    """(18, 32, 3) brightness and two colours of a frame."""
    if frame.yuv is None:
        return np.asarray(cv2.cvtColor(_shrunk(frame.bgr), cv2.COLOR_BGR2YUV), np.uint8)
    y, u, v, _ = frame.yuv
    return np.asarray(cv2.merge([_shrunk(y), _shrunk(u, 1), _shrunk(v, 1)]), np.uint8)


def _flat(images: Sequence[Image]) -> NDArray[np.float32]:
    """(T, P): small images side by side."""
    return np.asarray(images, np.float32).reshape(len(images), -1)


def _shrunk(image: Image, rows: int = READ) -> Image:
    """(18, 32, ...): means of so many rows and of five columns; what costs are rows that the processor has to fetch."""
    few = SIDE[0] * READ, SIDE[1] * rows
    if image.shape[1] > few[0] and image.shape[0] > few[1]:
        # whole rows are fetched in half the time of their pixels
        image = image[_nearest(len(image), few[1])]
        image = np.asarray(cv2.resize(image, few, interpolation=cv2.INTER_NEAREST), np.uint8)
    return np.asarray(cv2.resize(image, SIDE, interpolation=cv2.INTER_AREA), np.uint8)


@lru_cache
def _nearest(height: int, rows: int) -> Whole:
    """Which of so many rows OpenCV takes as the nearest ones of a smaller image."""
    return (np.arange(rows) * (1 / (rows / height))).astype(np.int64)


def _cuts(images: NDArray[np.float32], first: int, flash: int) -> list[Cut]:
    """The cuts of successive images (T, P), of which the first is frame `first`."""
    hard = [Cut(first + at, first + at, first + at - 1) for at in _hard(images, flash)]
    soft = [Cut(first + at, first + a, first + b) for at, a, b in _dissolves(images)]
    soft = [blend for blend in soft if not any(blend.first - 1 <= cut.frame <= blend.last + 1 for cut in hard)]
    return sorted([*hard, *soft])


def _hard(images: NDArray[np.float32], flash: int) -> list[int]:
    """The first frames after cuts; what is followed by what was before, within `flash` frames, was none."""
    steps = np.abs(np.diff(images, axis=0)).mean(axis=1)  # [t]: from t to t + 1
    cuts = []
    for before in np.flatnonzero(steps >= MIN_STEP).tolist():
        step = steps[before]
        beside = np.concatenate([steps[max(before - 2, 0) : before], steps[before + 1 : before + 3]])
        if beside.size and beside.max() > BESIDE * step:
            continue
        earlier = images[max(before + 1 - flash, 0) : before + 1]
        later = images[before + 1 : before + 1 + flash]
        apart = np.abs(earlier[:, None] - later[None]).mean(axis=2)
        if apart.min() >= BESIDE * step and _alike(earlier[:, None], later[None]).max() < SAME_STRUCTURE:
            cuts.append(before + 1)
    return cuts


def _alike(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    """Correlation of the brightness of images along the last axis; 0 of an image without structure."""
    a, b = (lit - lit.mean(axis=-1, keepdims=True) for lit in (a[..., ::3], b[..., ::3]))
    norm = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    return np.asarray(np.sum(a * b, axis=-1) / np.maximum(norm, a.shape[-1]), np.float32)


def _dissolves(images: NDArray[np.float32], lasts: range | None = None) -> list[tuple[int, int, int]]:
    """The frame at the middle, the first and the last of each dissolve; of those alone whose last is in `lasts`."""
    lasts = lasts or range(len(images) - 1)
    lit = images.reshape(-1, SIDE[1], SIDE[0], 3)[..., 0]
    texture = sum(np.abs(np.diff(lit, axis=axis)).mean(axis=(1, 2)) for axis in (1, 2)) + 1e-6
    candidates: list[tuple[float, int, int]] = []
    for span in (span for span in SPANS if span < len(images)):
        first, stop = (max(last - span + 1, 0) for last in (lasts.start, lasts.stop))
        a, b = images[first:stop], images[first + span : stop + span]
        step, alike = np.abs(b - a).mean(axis=1), np.maximum(_alike(a, b), 0)
        ends = texture[first:stop] + texture[first + span : stop + span]
        blended = 2 * texture[first + span // 2 :][: len(a)] / ends
        odds = _AT + _BLENDED * blended + _ALIKE * alike + _STEP * np.log(np.maximum(step, 1))
        for k in np.flatnonzero((step >= MIN_STEP) & (odds > SURE)).tolist():
            at, line = first + k, b[k] - a[k]
            length = float(np.linalg.norm(line))
            between = images[at + 1 : at + span] - a[k]
            share = between @ line / length**2
            if np.abs(share - np.arange(1, span) / span).max() > UNEVEN:
                continue
            off = float(np.linalg.norm(between - share[:, None] * line, axis=1).mean()) / length
            beyond = images[max(at - span // 2 - 1, 0)], images[min(at + span + span // 2 + 1, len(images) - 1)]
            moves = min(float(np.linalg.norm(x - y)) for x, y in zip(beyond, (a[k], b[k]), strict=True)) / length
            if (whole_odds := odds[k] + _OFF * off + _MOVES * moves) > SURE:
                candidates.append((-float(whole_odds), at + 1, at + span - 1))
    best: list[tuple[int, int]] = []
    for _, first, last in sorted(candidates):
        if not any(first <= other[1] and other[0] <= last for other in best):
            best.append((first, last))
    whole: list[tuple[int, int]] = []
    for first, last in sorted(best):  # a fade by way of black is two on the line, and one dissolve
        if whole and first - whole[-1][1] <= ONE_FRAMES:
            first = whole.pop()[0]
        whole.append((first, last))
    return [((first + last) // 2 + 1, first, last) for first, last in whole]
