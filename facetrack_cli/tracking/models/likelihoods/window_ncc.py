"""Normalised correlation of windows in brightness and redness, with several templates of each part (ours).

The channels are log(grey + 16) and 2 log((red + 8) / (green + 8)): lips stand out from skin by their redness, and a
factor on the light is a constant. r(x) is the zero-mean normalised cross-correlation of the window at x with a
template, both channels together, and the greatest over the templates of the part. With v, how visible the part was in
the frame before, and `sharpness` s,

    p(y | x) ~ v exp(s (r(x) - 1)) + (1 - v) exp(-0.5 s)

so that a window that matches nothing says nothing, and the other sources place the part. The mean of r at the part
(g), and the mean of r beside it (b), follow the clip slowly. v is the state of a chain of two states, visible and
hidden, whose evidence in a frame is

    log p(y | visible) - log p(y | hidden) = (0.45 - q) / 0.1 + told,    q = (g - r) / (g - b) at the estimate

where `told` is what a sensor says of it. Both terms are bounded.

A part that is visible, and looks like none of its templates, gives a new one: an open mouth, a smile. It may be what
covers the part: it does not count in q for three frames, and is forgotten if the part is hidden before. The first
frame's template stays; of the others the one that has matched least is replaced when there is no room.

A frame is looked at once: r is computed on a grid of whole pixels around the estimate, and read bilinearly.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array, Frame, Mask, Particles
from facetrack_cli.recipe import face
from facetrack_cli.tracking.kernels.orientations import looks
from facetrack_cli.tracking.models.spaces import Context

Channels = NDArray[np.float32]  # (H, W, 2)
MEMORY: Final = 50.0  # frames over which g and b are learned
NEW_BELOW: Final = 0.7  # correlation with all templates below which a visible part gives a new one
SURE: Final = 0.06  # standard deviation of a part, in reaches, up to which a new template is learned
HIDDEN, SOFT = 0.45, 0.1
BY_WINDOW, BY_TOLD = (-1.0, 6.0), (-4.0, 4.0)  # bounds of the terms of the evidence: looks change
YOUNG: Final = 3  # frames
UNLIKE: Final = 2.0  # below what a sensor usually says of a part, which then may be half covered
HIDE, SHOW = 0.01, 0.1  # probabilities a frame
BOUNDS: Final = (0.001, 0.98)  # of v
FLOOR: Final = 0.5  # 1 - r of a hidden part
MAX_OFF: Final = 0.55  # of the reach: from there on a window shows what is beside the part
USED: Final = 0.02  # rate at which it is learned how often a template matches best


class PartTemplates(NamedTuple):
    """Of one part: windows of unit norm, that of the first frame first; how often each matched best, and its age."""

    windows: tuple[Channels, ...]
    used: tuple[float, ...]
    age: tuple[int, ...]


class WindowState(NamedTuple):
    """Templates of each part, g and b (K,), v (K,); `told` (K,), what a sensor says of them in this frame, and `usual`.

    Of the frame that was looked at last, r and where it begins.

    `maps` (K, S, S): r on a grid of whole pixels; `corner` (K, 2): the place of the first value of each map.
    """

    templates: tuple[PartTemplates, ...]
    good: Array
    beside: Array
    visible: Array
    told: Array
    usual: Array
    maps: NDArray[np.float32] | None = None
    corner: Array | None = None


class WindowNcc:
    """Windows of `sides` (K, 2) odd pixels, whose middles lie `shift` (K, 2) pixels from the parts."""

    def __init__(self, settings: face.WindowNcc, context: Context) -> None:
        windows = context.placed.windows
        self.settings, self.reach = settings, max(round(settings.reach.pixels(context.placed.unit)), 2)
        self.sides = np.maximum(2 * np.round((windows - 1) / 2).astype(np.int64) + 1, 3)
        self.shift = np.array([settings.shift.of(part) for part in context.settings.points]) * windows

    def init(self, frame: Frame, x0: Array) -> WindowState:
        """Templates at x0 (K, 2) in the first frame."""
        templates = tuple(
            PartTemplates((_unit(self._window(frame, k, at)),), (1.0,), (YOUNG,)) for k, at in enumerate(x0)
        )
        ones = np.ones(len(x0))
        learned = WindowState(templates, 0.9 * ones, 0 * ones, ones, 0 * ones, 0 * ones)
        return learned._replace(beside=self._beside(self.look(learned, frame, x0), x0).mean(axis=1))

    def look(self, learned: WindowState, frame: Frame, expected: Array) -> WindowState:
        """With r around `expected` (K, 2)."""
        corner = np.round(expected) - self.reach
        maps = [self._map(frame, k, templates, corner[k]) for k, templates in enumerate(learned.templates)]
        return learned._replace(maps=np.stack(maps), corner=corner)

    def correlation(self, learned: WindowState, x: Array) -> Array:
        """r at x (N, K, 2), in the frame that was looked at last -> (N, K); beyond the reach, r at its border."""
        assert learned.maps is not None and learned.corner is not None
        last = 2 * self.reach
        at = np.clip(x - learned.corner, 0, last - 1e-6)
        whole = at.astype(np.int64)
        (u, v), k = np.moveaxis(at - whole, -1, 0), np.arange(x.shape[1])
        i, j, m = whole[..., 1], whole[..., 0], learned.maps
        upper = (1 - u) * m[k, i, j] + u * m[k, i, j + 1]
        return np.asarray((1 - v) * upper + v * ((1 - u) * m[k, i + 1, j] + u * m[k, i + 1, j + 1]))

    def score(self, learned: WindowState, frame: Frame, x: Array, parents: Array) -> Array:
        """log p(y | x) of each part but for a constant, x (N, K, 2) -> (N, K); parents do not matter."""
        v, s = np.clip(learned.visible, *BOUNDS), self.settings.sharpness
        return np.logaddexp(np.log(v) + s * (self.correlation(learned, x) - 1), np.log1p(-v) - FLOOR * s)

    def distances(self, learned: WindowState, frame: Frame, x: Array) -> Array:
        """1 - r of windows at x (N, K, 2) -> (N, K)."""
        centre = x.mean(axis=0)
        return np.asarray(1 - self.correlation(self.look(learned, frame, centre), x))

    def visible(self, learned: WindowState) -> Array:
        """v (K,) of the frame that was learned last."""
        return learned.visible

    def presence(self, learned: WindowState, windows: Sequence[Channels]) -> Array:
        """v (K,) of parts that look like `windows`, of unit norm, at the estimate."""
        r = np.empty(len(windows))
        for k, (known, window) in enumerate(zip(learned.templates, windows, strict=True)):
            old = [one for one, age in zip(known.windows, known.age, strict=True) if age >= YOUNG]
            r[k] = max(_like(old, window))
        q = (learned.good - r) / np.maximum(learned.good - learned.beside, 0.05)
        evidence = np.clip((HIDDEN - q) / SOFT, *BY_WINDOW) + np.clip(learned.told, *BY_TOLD)
        return visible_after(learned.visible, evidence)

    def learn(self, learned: WindowState, frame: Frame, state: Array, particles: Particles) -> WindowState:
        """g where a part is visible, b always, and new templates."""
        if learned.maps is None:  # a track that begins again has no maps of the frame yet
            learned = self.look(learned, frame, state)
        windows = [_unit(self._window(frame, k, at)) for k, at in enumerate(state)]
        visible, r = self.presence(learned, windows), self.correlation(learned, state[None])[0]
        good = learned.good + visible / MEMORY * (r - learned.good)
        beside = learned.beside + (self._beside(learned, state).mean(axis=1) - learned.beside) / MEMORY
        w = np.exp(particles.log_w)
        spread = np.sqrt(np.einsum("n,nkd->kd", w, (particles.x - state) ** 2)).max(axis=1)
        usual = learned.usual + visible / MEMORY * (np.clip(learned.told, *BY_TOLD) - learned.usual)
        clear = (visible > 0.5) & (spread < SURE * 2 * self.reach) & (learned.told >= usual - UNLIKE)
        templates = []
        for k, known in enumerate(learned.templates):
            templates.append(self._kept(known, windows[k] if clear[k] else None, hidden=bool(visible[k] < 0.5)))
        return WindowState(tuple(templates), good, beside, visible, learned.told, usual)

    def relearn(self, learned: WindowState, frame: Frame, x0: Array, parts: Mask) -> WindowState:
        """With all that is known of `parts` (K,) as they look in `frame` at x0 (K, 2)."""
        anew = self.init(frame, x0)
        templates = tuple(new if is_new else old for new, old, is_new in zip(*(
            anew.templates, learned.templates, parts.tolist()), strict=True))  # fmt: skip
        good, beside, visible = (
            np.where(parts, new, old)
            for new, old in ((anew.good, learned.good), (anew.beside, learned.beside), (anew.visible, learned.visible))
        )
        return WindowState(templates, good, beside, visible, learned.told, learned.usual)

    def _kept(self, known: PartTemplates, window: Channels | None, *, hidden: bool) -> PartTemplates:
        """The templates after one more frame; `window`, of unit norm: how the part looks, where it is clear."""
        each = [one for one in zip(*known, strict=True) if not (hidden and one[2] < YOUNG)]
        windows, used, age = zip(*((w, n, age + 1) for w, n, age in each), strict=True)
        if window is None:
            return PartTemplates(windows, used, age)
        like, most = _like(windows, window), self.settings.templates
        if max(like) >= NEW_BELOW or most == 1:
            best = int(np.argmax(like))
            return PartTemplates(windows, tuple((1 - USED) * n + USED * (i == best) for i, n in enumerate(used)), age)
        kept = list(range(len(windows)))
        if len(kept) == most:
            kept.remove(1 + int(np.argmin(used[1:])))
        found = ((*(windows[i] for i in kept), window), (*(used[i] for i in kept), 0.5), (*(age[i] for i in kept), 0))
        return PartTemplates(*found)

    def _beside(self, learned: WindowState, state: Array) -> Array:
        """r at 16 places around the parts at `state` (K, 2) -> (K, 16)."""
        turns = np.arange(16) * (2 * np.pi / 16)
        ring = (MAX_OFF + 0.4 * (np.arange(16) % 2))[:, None] * np.stack([np.cos(turns), np.sin(turns)], axis=1)
        return self.correlation(learned, state + self.reach * ring[:, None]).T

    def _window(self, frame: Frame, k: int, at: Array) -> Channels:
        """The channels of the window of part k at a place (2,), read bilinearly."""
        return _read(frame, at + self.shift[k], *self.sides[k].tolist())

    def _map(self, frame: Frame, k: int, templates: PartTemplates, corner: Array) -> NDArray[np.float32]:
        """(S, S): the greatest r over the templates, for the places that begin at `corner` (2,)."""
        w, h = self.sides[k].tolist()
        side = 2 * self.reach + 1
        region = _read(frame, corner + self.reach + self.shift[k], w + side - 1, h + side - 1)
        inner = np.s_[h // 2 : h // 2 + side, w // 2 : w // 2 + side]
        sums = cv2.boxFilter(region, cv2.CV_64F, (w, h), normalize=False)[inner]
        squares = cv2.sqrBoxFilter(region, cv2.CV_64F, (w, h), normalize=False)[inner]
        energy = np.maximum(squares - sums**2 / (w * h), 0).sum(axis=2)
        best = np.max([cv2.matchTemplate(region, one, cv2.TM_CCORR) for one in templates.windows], axis=0)
        return np.asarray(best / np.sqrt(energy + 1e-6), np.float32)


def visible_after(before: Array, evidence: Array) -> Array:
    """P(visible) a frame later than `before`, given the log ratio of the likelihoods of visible and hidden."""
    return _weighed(before * (1 - HIDE) + (1 - before) * SHOW, evidence)


def doubted(learned: WindowState, odds: Array) -> WindowState:
    """Where other senses say by log `odds` (K,) below 0, nan where they do not, that windows follow something else."""
    against = np.clip(np.nan_to_num(odds), -BY_WINDOW[1], 0)
    return learned._replace(visible=_weighed(np.clip(learned.visible, *BOUNDS), against))


def _weighed(p: Array, evidence: Array) -> Array:
    """Probabilities after evidence in log odds."""
    return np.asarray(1 / (1 + (1 - p) / p * np.exp(-evidence)))


def _read(frame: Frame, centre: Array, w: int, h: int) -> Channels:
    """The channels (h, w, 2) of a region around `centre` (2,), read bilinearly; outside the frame, its border.

    A centre outside is taken to the border.
    """
    height, width = frame.bgr.shape[:2]
    x, y = centre.tolist()
    at = min(max(x, 0.0), width - 1.0), min(max(y, 0.0), height - 1.0)
    return channels(np.asarray(cv2.getRectSubPix(frame.bgr, (w, h), at), np.uint8))


def channels(image: NDArray[np.uint8]) -> Channels:
    """log(grey + 16) and 2 log((red + 8) / (green + 8)) of an image (H, W, 3)."""
    grey, red = looks(image)
    return np.stack([grey, 2 * red], axis=2)


def _like(templates: Sequence[Channels], window: Channels) -> list[float]:
    """r of a window of unit norm with each template."""
    return [float(np.vdot(one, window)) for one in templates]


def _unit(window: Channels) -> Channels:
    """The window without the mean of each channel, of unit norm."""
    centred = window - window.mean(axis=(0, 1))
    return np.asarray(centred / np.sqrt(np.sum(centred**2) + 1e-9), np.float32)
