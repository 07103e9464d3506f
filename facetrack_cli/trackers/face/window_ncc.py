"""Normalised correlation of windows in brightness and redness, with several templates of each part (ours).

The channels are log(grey + 16) and 2 log((red + 8) / (green + 8)): lips stand out from skin by their redness, and a
factor on the light is a constant. r(x) is the zero-mean normalised cross-correlation of the window at x with a
template, both channels together, and the greatest over the templates of the part. With v, how visible the part was in
the frame before, and `sharpness` s,

    p(y | x) ~ v exp(s (r(x) - 1)) + (1 - v) exp(-0.5 s)

so that a window that matches nothing says nothing, and the other sources place the part. The mean of r at the part
(g), and the mean of r beside it (b), follow the clip slowly. v is the state of a chain of two states, visible and
hidden, whose evidence in a frame is

    log p(y | visible) - log p(y | hidden) = (0.45 - q) / 0.1 + sensor,    q = (g - r) / (g - b) at the estimate

where `sensor` is the log odds by a sensor in this frame. Both terms are bounded.

A part that is visible, and looks like none of its templates, gives a new one: an open mouth, a smile. It may be what
covers the part: it does not count in q for three frames, and is forgotten if the part is hidden before. The first
frame's template stays; of the others the one that has matched least is replaced when there is no room.

A frame is looked at once: r is computed on a grid of whole pixels around the estimate, as far as particles hardly ever
are, and read bilinearly. b is looked at in every fourth frame.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array, Frame, Mask, Particles, Whole
from facetrack_cli.engine.protocols import Likelihood
from facetrack_cli.engine.spaces import Context
from facetrack_cli.trackers.face import landmark_kernels as kernels
from facetrack_cli.trackers.face.image_kernels import looks
from facetrack_cli.trackers.face.motion import ScoredMaps
from facetrack_cli.trackers.face.settings import WindowNccSettings
from facetrack_cli.trackers.face.window_kernels import greatest, matched, stride

Channels = NDArray[np.float32]
SURE: Final = 0.06  # standard deviation of a part, in reaches, up to which a new template is learned
FLOOR: Final = 0.5  # 1 - r of a hidden part
MAX_OFF: Final = 0.55  # of the reach: from there on a window shows what is beside the part
LEAST: Final = 4  # pixels around where parts are expected, in which r is always known
RARELY: Final = 4  # frames from one look beside the parts to the next


class Templates(NamedTuple):
    """Up to T templates of K parts.

    Attributes
    ----------
    windows : (K, T, 2, L), as the kernels read them; that of the first frame comes first
    number : (K,), how many templates a part has
    used : (K, T), how often each matched best
    age : (K, T), in frames
    """

    windows: Channels
    number: Whole
    used: Array
    age: Whole


class WindowState(NamedTuple):
    """What is learned of K parts.

    Attributes
    ----------
    templates : their templates
    good, beside : g and b (K,), the mean of r at a part and beside it
    visible : v (K,)
    sensor_odds, usual_odds : (K,), log odds by a sensor that a part is visible: in this frame, and usually
    looks : frames so far
    within : pixels from where they are expected, within which the parts are in this frame
    maps : (K, S, S), r on a grid of whole pixels of the last frame
    corner : (K, 2), the place of the first value of each map
    """

    templates: Templates
    good: Array
    beside: Array
    visible: Array
    sensor_odds: Array
    usual_odds: Array
    looks: int = 0
    within: float = math.inf
    maps: Channels | None = None
    corner: Array | None = None


class WindowNcc(Likelihood):
    """Windows of `sides` (K, 2) odd pixels, whose middles lie `shift` (K, 2) whole pixels from the parts."""

    def __init__(self, settings: WindowNccSettings, context: Context) -> None:
        windows = context.placed.windows
        self.settings, self.reach = settings, max(round(settings.reach.pixels(context.placed.unit)), 2)
        self.sides = np.maximum(2 * np.round((windows - 1) / 2).astype(np.int64) + 1, 3)
        self.shift = np.round(np.array([settings.shift.of(part) for part in context.settings.points]) * windows)
        turns = np.arange(16) * (2 * np.pi / 16)
        ring = (MAX_OFF + 0.4 * (np.arange(16) % 2))[:, None] * np.stack([np.cos(turns), np.sin(turns)], axis=1)
        self._ring = self.reach * ring[:, None]

    def init(self, frame: Frame, x0: Array) -> WindowState:
        """Templates at x0 (K, 2) in the first frame."""
        k, most = len(x0), self.settings.templates
        empty = np.zeros((k, most, 2, max(stride(w) * h for w, h in self.sides.tolist())), np.float32)
        none = np.zeros((k, most), np.int64)
        templates = Templates(empty, np.ones(k, np.int64), none.astype(np.float64), none)
        empty[:, 0] = self._matched(frame, templates, x0[None])[0]
        templates.used[:, 0], templates.age[:, 0] = 1.0, kernels.YOUNG
        ones = np.ones(k)
        beside = self._beside(frame, templates, x0)
        return WindowState(templates, 0.9 * ones, beside, ones, 0 * ones, 0 * ones)

    def look(self, learned: WindowState, frame: Frame, expected: Array) -> WindowState:
        """With r around `expected` (K, 2)."""
        reach = self.reach if learned.within >= self.reach else min(max(math.ceil(learned.within), LEAST), self.reach)
        corner, side = np.rint(expected) - reach, 2 * reach + 1
        maps, templates = np.empty((len(expected), side, side), np.float32), learned.templates
        greatest(channels(frame), templates.windows, templates.number, self.sides, corner + self.shift, maps)
        return learned._replace(maps=maps, corner=corner)

    def correlation(self, learned: WindowState, x: Array) -> Array:
        """r at x (N, K, 2), in the frame that was looked at last -> (N, K); beyond the reach, r at its border."""
        assert learned.maps is not None and learned.corner is not None
        last = learned.maps.shape[1] - 1
        at = np.clip(np.nan_to_num(x - learned.corner), 0, last - 1e-6)  # a sensor may not place a part
        whole = at.astype(np.int64)
        (u, v), k = np.moveaxis(at - whole, -1, 0), np.arange(x.shape[1])
        i, j, m = whole[..., 1], whole[..., 0], learned.maps
        upper = (1 - u) * m[k, i, j] + u * m[k, i, j + 1]
        return np.asarray((1 - v) * upper + v * ((1 - u) * m[k, i + 1, j] + u * m[k, i + 1, j + 1]))

    def score(self, learned: WindowState, frame: Frame, x: Array, parents: Array) -> Array:
        """log p(y | x) of each part but for a constant, x (N, K, 2) -> (N, K); parents do not matter."""
        v, s = np.clip(learned.visible, *kernels.BOUNDS), self.settings.sharpness
        return np.logaddexp(np.log(v) + s * (self.correlation(learned, x) - 1), np.log1p(-v) - FLOOR * s)

    def scored(self, learned: WindowState) -> ScoredMaps:
        """What `score` reads."""
        assert learned.maps is not None and learned.corner is not None
        least, most = kernels.BOUNDS
        visible = np.minimum(np.maximum(learned.visible, least), most)
        return ScoredMaps(learned.maps, learned.corner, visible, self.settings.sharpness, FLOOR)

    def distances(self, learned: WindowState, frame: Frame, x: Array) -> Array:
        """1 - r of windows at x (N, K, 2) -> (N, K)."""
        centre = x.mean(axis=0)
        return np.asarray(1 - self.correlation(self.look(learned._replace(within=math.inf), frame, centre), x))

    def visible(self, learned: WindowState) -> Array:
        """v (K,) of the frame that was learned last."""
        return learned.visible

    def learn(self, learned: WindowState, frame: Frame, state: Array, particles: Particles) -> WindowState:
        """g where a part is visible, b always, and new templates."""
        if learned.maps is None:  # a track that begins again has no maps of the frame yet
            learned = self.look(learned, frame, state)
        windows, like = self._matched(frame, learned.templates, state[None])
        k, odds = len(state), np.asarray(learned.sensor_odds, np.float64)
        good, visible, usual = learned.good.copy(), learned.visible.copy(), learned.usual_odds.copy()
        new, forgets, (_, number, used, age) = np.empty(k, np.bool_), np.empty(k, np.bool_), learned.templates
        there = like[0], number, age, learned.maps, learned.corner, learned.beside, odds, state
        used = used.copy()
        after = good, visible, usual, used, new, forgets
        changes = kernels.judge(*there, particles.x, particles.log_w, SURE * 2 * self.reach, *after)
        templates = learned.templates._replace(used=used, age=age + 1)
        if changes:
            templates = _kept(templates, windows, new, forgets)
        beside = learned.beside
        if learned.looks % RARELY == 0:  # it follows slowly
            beside = beside + (self._beside(frame, learned.templates, state) - beside) * (RARELY / kernels.MEMORY)
        return WindowState(templates, good, beside, visible, odds, usual, learned.looks + 1)

    def relearn(self, learned: WindowState, frame: Frame, x0: Array, parts: Mask) -> WindowState:
        """With all that is known of `parts` (K,) as they look in `frame` at x0 (K, 2)."""
        fresh = self.init(frame, x0)

        def either(new: Any, old: Any) -> Any:
            return np.where(parts.reshape(-1, *[1] * (old.ndim - 1)), new, old)

        templates = Templates(*map(either, fresh.templates, learned.templates))
        good, beside, visible = map(either, fresh[1:4], learned[1:4])
        return WindowState(templates, good, beside, visible, learned.sensor_odds, learned.usual_odds)

    def _beside(self, frame: Frame, templates: Templates, state: Array) -> Array:
        """(K,): the mean of r at 16 places around the parts at `state` (K, 2)."""
        there = np.arange(templates.age.shape[1]) < templates.number[:, None]
        like = self._matched(frame, templates, state + self._ring)[1]
        return np.asarray(np.where(there, like, -np.inf).max(axis=2).mean(axis=0))

    def _matched(self, frame: Frame, templates: Templates, at: Array) -> tuple[Channels, Array]:
        """The windows (K, 2, L) at the last of places `at` (M, K, 2), and r of all with each template (M, K, T)."""
        stored, count = templates[:2]
        windows = np.zeros((len(stored), *stored.shape[2:]), np.float32)
        like = np.zeros((*at.shape[:2], len(stored[0])))
        matched(channels(frame), stored, count, self.sides, at + self.shift, windows, like)
        return windows, like


def _kept(templates: Templates, windows: Channels, new: Mask, forgets: Mask) -> Templates:
    """The templates, to which the windows (K, 2, L) of `new` (K,) parts come, and from which young ones go."""
    stored, number, used, age = templates
    stored, number = stored.copy(), number.copy()
    for k in np.flatnonzero(new | forgets).tolist():
        kept = np.flatnonzero(age[k, : number[k]] > kernels.YOUNG * forgets[k])
        if new[k] and len(kept) == age.shape[1]:
            kept = np.delete(kept, 1 + int(np.argmin(used[k, 1:])))
        number[k] = n = len(kept)
        stored[k, :n], used[k, :n], age[k, :n] = stored[k, kept], used[k, kept], age[k, kept]
        if new[k]:
            stored[k, n], used[k, n], age[k, n] = windows[k], 0.5, 0
            number[k] += 1
    return Templates(stored, number, used, age)


def doubted(learned: WindowState, odds: Array | None) -> WindowState:
    """After log odds (K,) by other sensors that windows follow the parts; only doubt counts, nan says nothing."""
    p = np.minimum(np.maximum(learned.visible, kernels.BOUNDS[0]), kernels.BOUNDS[1])
    if odds is not None:
        p = 1 / (1 + (1 - p) / p * np.exp(-np.maximum(np.fmin(odds, 0), -kernels.BY_WINDOW[1])))
    return learned._replace(visible=p)


def channels(frame: Frame) -> Channels:
    """log(grey + 16) and 2 log((red + 8) / (green + 8)) of a frame, (2, H, W)."""
    values = frame.remembered("looks")
    if values is None:
        values = looks(np.ascontiguousarray(frame.bgr))
        values[1] *= 2
        frame.remember("looks", frame.bgr, values)
    return values
