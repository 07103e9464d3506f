"""A target by the response of a correlation filter, with its scale, its colours, and whether it is there.

Ours, of published pieces, in files beside this one:

    features.py  gradients, grey and colours of a window, reduced (ECO of Danelljan et al.); scale (2014, DSST);
                 colours of target and surroundings (Bertinetto et al. 2016, Staple); the filter and how it is learned
                 (2015, SRDCF; 2017, ECO)

With R the response to a window and Rm its highest value, the log-likelihood ratio of a target visible at x = (place,
log scale) against one that is hidden is

    log L(x) = log p(Rm | visible) / p(Rm | hidden) + log sum_j (R_j / Rm)^sharpness N(x; x_j, std_j^2) / c

R_j are the highest local maxima of R, as LMCF looks at several (Wang et al. 2017). Peaks of the target have a running
mean and standard deviation, as in LMCF; those of all else are what other windows of the first frame have. Each density
is Student's, so that no height is impossible, and flat beyond its mean on the side away from the other one; `evidence`
bounds their log ratio. A face that turns or puts on a hat has a peak far below its mean, and far above all else: it is
visible. std_j is that of R^sharpness beside the peak (Laplace's approximation), so that a blurred frame says less about
the place; of the scale, that of the response over scales to the power `scales.sharpness`.
The volume c makes the ratio a Bayes factor where the target is as likely in one place as in another within a box and a
tenth of log scale. Far from all peaks L is about 0, and a target there must be hidden.

The window that was looked at is learned, its spectrum moved to the estimate where that lies within half a cell; else a
window at the estimate. All is learned in proportion to P(visible), and a little while the target is hidden: a face that
turns away and one that is covered look alike, and after some seconds what is seen is taken for the target. What is
visible with a low peak is learned slower: it may be partly covered. The filter of the first frames is part of R, so
that what covers a target for some time does not replace it. While the target is hidden, windows on a lattice over the
whole frame, those near the last place first, at one size after another, are compared with both filters alike; the best
is a mode as well.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array, Frame, Image, Particles
from facetrack_cli.engine.protocols import Likelihood
from facetrack_cli.engine.spaces import Context
from facetrack_cli.trackers.box import features as models
from facetrack_cli.trackers.box.box_kernels import log_mixture, read_cubic
from facetrack_cli.trackers.box.features import UPSAMPLED, Features, Single, peaks, shrunk
from facetrack_cli.trackers.box.hidden_box import VISIBLE, ModeProposal
from facetrack_cli.trackers.box.settings import CorrelationFilterSettings

FIRST = 10  # frames from which the filter for re-detection is learned
_USUAL = (0.75, 0.15)  # mean and standard deviation of peaks, in terms of that of the first window itself
_OTHER = 0.06  # least standard deviation of such peaks in other windows
_PRIOR = 10.0  # frames that these count for
_LOW = 2.0  # standard deviations below the mean; a target with a lower peak is learned slower
_SLOWER = 0.3  # by this factor at most
_KEPT = 0.2  # weight of the first frames' response in R
_MIN_RATIO = 1e-3  # of R / Rm and of S / Sm, whose logarithms are taken
_SCALE_STD = 0.03
_OFF = 0.25  # mean sides of the box; a peak further off the middle of the window is looked at once more
_SAME_PLACE, _SAME_SCALE = 0.5, 0.02  # cells and log scale within which the window that was looked at is learned
_LEARNS = 0.05  # P(visible) below which nothing is learned
_SIGHTED = 3.0  # log of how much likelier a detector sees a face there if it is the target
_LATTICE = 0.4  # distance of two windows of re-detection, in sides of the window
_SIZES = (1.0, 0.7, 1.0, 1.4)  # of what returns, in terms of its last size, one after another
_MAX_LATTICE = 64  # windows of the lattice along a side of the frame, of a target that is tiny
_MAX_COMPARED = 64  # windows at most that the first frame is compared with
_SOON = 25  # frames within which what returns has its last size
_SPEED = 0.5  # mean sides of the box a frame, by which re-detection widens


MIN_OTHER_STD = 0.02  # standard deviation of what is not the target, in terms of the mean of its peaks
_MEMORY = 50.0  # frames over which it is learned how high peaks are
_SIGMA = (0.1, 0.2)  # the least and the largest standard deviation of peaks, in terms of their mean
_FREEDOM = 3.0  # degrees of freedom of both densities


class Heights(NamedTuple):
    """Running mean and standard deviation of peaks, and how many frames they are learned from."""

    mean: float
    std: float
    frames: float

    def z(self, height: float) -> float:
        """How many standard deviations a height is below the mean; 0 above it."""
        return max(self.mean - height, 0.0) / self.spread

    @property
    def spread(self) -> float:
        """The standard deviation, within bounds."""
        least, most = (share * self.mean for share in _SIGMA)
        return max(min(max(self.std, least), most), 1e-9)

    def learn(self, height: float, share: float) -> Heights:
        frames = min(self.frames + share, _MEMORY)
        rate = share / frames
        off = min(max(height - self.mean, -2 * self.std), 2 * self.std)  # a mean that few bad frames do not move
        return Heights(self.mean + rate * off, math.sqrt((1 - rate) * (self.std**2 + rate * off**2)), frames)


class ResponseView(NamedTuple):
    """A window around `centre` (2,): R, the response of the filter of `now`, and that of the first frames.

    `spectrum` (2, C, F) is the window itself; `image`, too, as it is read for colours.
    """

    centre: Array
    spectrum: Single
    image: Image
    response: Single
    now: Single
    first: Single

    def heights(self, peak: Array) -> tuple[float, float]:
        """Those of both filters within a cell of a peak (column, row, height)."""
        column, row = round(float(peak[0])), round(float(peak[1]))
        rows, columns = (slice(max(k - UPSAMPLED, 0), k + UPSAMPLED + 1) for k in (row, column))
        return float(self.now[rows, columns].max()), float(self.first[rows, columns].max())


class Usual(NamedTuple):
    """How high peaks usually are: of the target, by both filters; in other windows of the first frame, and since."""

    now: Heights
    first: Heights
    others: Heights
    elsewhere: Heights

    def learn(self, heights: tuple[float, float], elsewhere: float | None, visible: float) -> Usual:
        """After a frame in which the target is visible with this probability; `elsewhere`: as in `Seen`."""
        now, first = (usual.learn(height, visible) for usual, height in zip(self[:2], heights, strict=True))
        since = self.elsewhere if elsewhere is None else self.elsewhere.learn(elsewhere, 1 - visible)
        return Usual(now, first, self.others, since)


def evidence(seen: Heights, other: Heights, height: float, bound: float) -> float:
    """log p(height | the target) - log p(height | something else), of peaks of either, within a bound."""
    spread = max(other.std, MIN_OTHER_STD * seen.mean, 1e-9)
    ratio = log_student(seen.z(height)) - math.log(seen.spread)
    ratio -= log_student(max(height - other.mean, 0.0) / spread) - math.log(spread)
    return min(max(ratio, -bound), bound)


def log_student(z: float) -> float:
    """The logarithm of Student's density at z over that at 0."""
    return -0.5 * (_FREEDOM + 1) * math.log1p(z * z / _FREEDOM)


class Seen(NamedTuple):
    """What a frame shows: its modes, with log L at each, and how high both filters respond at the highest one.

    Where it was sought `elsewhere`, so high is the response of both together, at the last mode. `view` is the window
    that was read at `scale`, and `scales` the spectrum over scales at its highest mode.
    """

    guides: ModeProposal
    heights: tuple[float, float]
    elsewhere: float | None
    view: ResponseView
    scale: float
    scales: NDArray[np.complex64]


class CorrelationState(NamedTuple):
    """What is known of the clip. `first` are the filters of the first frames, `hidden` how long it has been hidden.

    `last` is the index of the frame that was learned last.

    `candidate` (3,) is the best place and log scale elsewhere of the last frame, which is looked at again; `sighted`
    are places where another sensor has seen something like the target in this one; `external_log_odds` are those by
    which other sensors see it at its place.
    """

    features: Features
    filters: models.Trained
    first: Single
    scales: models.TrainedScale
    colours: models.Colours | None
    heights: Usual
    frames: int = 1
    last: int = 0
    hidden: int = 0
    candidate: Array | None = None
    sighted: tuple[Array, ...] = ()
    external_log_odds: float = 0.0
    seen: Seen | None = None


class CorrelationFilter(Likelihood):
    """A box by the response of a filter to the window around it."""

    def __init__(self, settings: CorrelationFilterSettings, context: Context) -> None:
        self.settings, self.context = settings, context
        w, h = context.placed.size
        self._unit = math.sqrt(w * h)  # the mean side of the box at the start, in pixels
        side = settings.window * self._unit
        box = max(w * (settings.cells / side), 1.0), max(h * (settings.cells / side), 1.0)
        sigma = max(settings.peak * settings.cells / settings.window, 0.3)
        self._trainer = models.Trainer(settings.cells, box, sigma)
        self._scale_trainer = models.ScaleTrainer((w, h), settings.scales.count, settings.scales.step)
        self._colour_model = models.ColourModel((w / side, h / side))

    def _side(self, scale: float) -> float:
        """Side of the window in pixels."""
        return self.settings.window * self._unit * scale

    def init(self, frame: Frame, x0: Array) -> CorrelationState:
        centre, scale = x0[0, :2], float(x0[0, 2])
        features = Features.learn(frame, centre, self._side(scale), self.settings.cells, self.settings.components)
        x, window = features.read(frame, centre, self._side(scale))
        filters = self._trainer.begin(x)
        top = float(self._trainer.respond(x, filters.filters).max())
        others = [0.0]
        for place in self._lattice(frame, centre, scale)[:_MAX_COMPARED]:
            if float(np.abs(place - centre).max()) > 0.5 * self._side(scale):
                there, _ = features.read(frame, place, self._side(scale))
                others.append(float(self._trainer.respond(there, filters.filters).max()))
        one = Heights(_USUAL[0] * top, _USUAL[1] * top, _PRIOR)
        other = Heights(float(np.mean(others)), max(float(np.std(others)), _OTHER * top), _PRIOR)
        heights = Usual(one, one, other, other)
        colours = None
        if features.colour and self.settings.colour > 0:
            colours = self._colour_model.learn(None, shrunk(window), 1.0)
        scales = self._scale_trainer.learn(None, self._scale_trainer.read(frame, centre, scale), 1.0)
        return CorrelationState(features, filters, filters.filters, scales, colours, heights, last=frame.index)

    def look(self, learned: CorrelationState, frame: Frame, expected: Array) -> CorrelationState:
        """With what the frame shows around the place (1, D) where the target is `expected`."""
        least, most = self.context.placed.scale
        one, centre, scale = self.settings, expected[0, :2], min(max(float(expected[0, 2]), least), most)
        view = self._view(learned, frame, centre, scale)
        found = peaks(view.response, 0.5, one.modes)
        off = (found[0, :2] - len(view.response) // 2) * self._sample(scale)
        if float(np.hypot(*off)) > _OFF * self._unit * scale:  # near the border of a window responses are low
            view = self._view(learned, frame, centre + off, scale)
            found = peaks(view.response, 0.5, one.modes)
        heights, usual = view.heights(found[0]), learned.heights
        log_l: Any = evidence(usual.now, usual.others, heights[0], one.evidence) + learned.external_log_odds
        log_l = log_l + one.sharpness * np.log(np.maximum(found[:, 2] / found[0, 2], _MIN_RATIO))
        modes = [self._modes(view, scale, found, log_l)]
        scales = self._scale_trainer.read(frame, modes[0].mean[0, :2], scale)
        log_s, std = self._scale_at(learned, scales)
        modes[0].mean[:, 2] += log_s
        modes[0].std[:, 2] = std
        elsewhere: float | None = None
        if (redetection := self._detect(learned, frame, expected, scale)) is not None:
            mode, elsewhere = redetection
            modes.append(mode)
        guides = ModeProposal(*(np.concatenate(column) for column in zip(*modes, strict=True)))
        return learned._replace(seen=Seen(guides, heights, elsewhere, view, scale, scales))

    def _sample(self, scale: float) -> float:
        """Pixels between two samples of a response."""
        return self._side(scale) / (UPSAMPLED * self.settings.cells)

    def _view(self, learned: CorrelationState, frame: Frame, centre: Array, scale: float) -> ResponseView:
        x, window = learned.features.read(frame, centre, self._side(scale))
        now, first = self._trainer.respond(x, learned.filters.filters, learned.first)
        response, (usual, usual_first) = now, learned.heights[:2]
        if learned.colours is not None:
            window = shrunk(window)
            score = self._colour_model.respond(learned.colours, window, len(now))
            if score is not None:
                share = self.settings.colour
                response = (1 - share) * now + np.float32(share * usual.mean) * score
        response = response + np.float32(_KEPT * usual.mean / max(usual_first.mean, 1e-9)) * first
        return ResponseView(centre, x, window, response, now, first)

    def _detect(
        self, learned: CorrelationState, frame: Frame, expected: Array, scale: float
    ) -> tuple[ModeProposal, float] | None:
        """A mode found elsewhere, where the target is hidden, and how high it is: the best of a few windows."""
        middle = UPSAMPLED * self.settings.cells // 2
        places = [(place, False) for place in self._elsewhere(learned, frame, expected)]
        if learned.hidden:
            places += [(place, True) for place in learned.sighted]
            if (last := learned.candidate) is not None:  # once more, and at the last size
                places += [(last, False), (np.array([*last[:2], math.log(scale)]), False)]
        if not places:
            return None
        best, at, size, sighted = -math.inf, places[0][0], 1.0, False
        for place, by_others in places:
            own = float(np.clip(math.exp(place[2]), *self.context.placed.scale))
            [top] = peaks(self._both(learned, self._view(learned, frame, place[:2], own)), 1.0, 1)
            if top[2] > best:
                best, at, size, sighted = top[2], place[:2] + (top[:2] - middle) * self._sample(own), own, by_others
        size = math.exp(math.log(size))  # to the bit that of a mode
        view = self._view(learned, frame, at, size)
        found = peaks(self._both(learned, view), 1.0, 1)
        height, heights = float(found[0, 2]), learned.heights
        log_l = evidence(heights.now, heights.elsewhere, height, self.settings.evidence) + _SIGHTED * sighted
        # what others see of the target's own place holds for what is found there again
        if float(np.hypot(*(at - expected[0, :2]))) < 0.5 * self._unit * scale:
            log_l += learned.external_log_odds
        return self._modes(view, size, found, np.array([log_l]), redetected=True), height

    def _both(self, learned: CorrelationState, view: ResponseView) -> Single:
        """What both filters respond to, as high as R usually is."""
        usual, first = learned.heights[:2]
        return np.float32(0.5) * (view.now + np.float32(usual.mean / max(first.mean, 1e-9)) * view.first)

    def _modes(
        self, view: ResponseView, scale: float, found: Array, log_l: Array, *, redetected: bool = False
    ) -> ModeProposal:
        """The peaks `found` (J, 3) of a response as Gaussians of place and log scale, which is left open."""
        sample, (mean, std) = self._sample(scale), np.empty((2, len(found), 3))
        mean[:, :2], mean[:, 2] = view.centre + (found[:, :2] - len(view.response) // 2) * sample, math.log(scale)
        widths = _widths(view.response, found, UPSAMPLED * self._trainer.sigma)
        std[:, :2], std[:, 2] = widths * (sample / math.sqrt(self.settings.sharpness)), _SCALE_STD
        return ModeProposal(mean, std, log_l, np.full(len(found), redetected))

    def _scale_at(self, learned: CorrelationState, scales: NDArray[np.complex64]) -> tuple[float, float]:
        """Mean and standard deviation of the change of log scale, by S^sharpness times a broad prior."""
        trainer, settings = self._scale_trainer, self.settings.scales
        response = trainer.respond(learned.scales, scales)
        response -= response.min()
        if (top := float(response.max())) < 1e-9:  # flat, as far outside of the frame
            return 0.0, _SCALE_STD
        w = (response / top) ** settings.sharpness * np.exp(-0.5 * (trainer.log_scales / _SCALE_STD) ** 2)
        w /= np.add.reduce(w)
        mean = float(np.sum(w * trainer.log_scales))
        between = math.log(settings.step) ** 2 / 12  # of a scale that is known to the nearest one
        variance = max(float(np.sum(w * (trainer.log_scales - mean) ** 2)), between)
        # the prior of the motion comes once more: it is taken out here
        precision = max(1 / variance - 1 / _SCALE_STD**2, 1 / (4 * _SCALE_STD) ** 2)
        return mean / (variance * precision), 1 / math.sqrt(precision)

    def _elsewhere(self, learned: CorrelationState, frame: Frame, expected: Array) -> list[Array]:
        """Where else to look for a target that is hidden, places and log scales (3,): a few of a lattice, in turn.

        The nearest are first; after all the next size.
        """
        count = self.settings.detect
        if not learned.hidden or not count:
            return []
        places = self._lattice(frame, expected[0, :2], float(expected[0, 2]))
        away = np.hypot(*(places - expected[0, :2]).T)
        step = _LATTICE * self._side(float(expected[0, 2]))
        reach = step + _SPEED * self._unit * float(expected[0, 2]) * learned.hidden
        places = places[: max(int(np.sum(away <= reach)), 1)]
        begin = (learned.hidden - 1) * count
        found, size = [], math.log(float(expected[0, 2]))
        for k in range(begin, begin + min(count, len(places))):
            turn, at = divmod(k, len(places))
            factor = _SIZES[turn % len(_SIZES)] if learned.hidden > _SOON else 1.0
            found.append(np.array([*places[at], size + math.log(factor)]))
        return found

    def _lattice(self, frame: Frame, near: Array, scale: float) -> Array:
        """Middles (M, 2) of windows all over the frame, the nearest to a place (2,) first."""
        step = _LATTICE * self._side(scale)
        across, down = (np.arange(min(max(round(n / step), 1), _MAX_LATTICE)) for n in frame.size)
        x, y = np.meshgrid((across + 0.5) / len(across) * frame.size[0], (down + 0.5) / len(down) * frame.size[1])
        places = np.column_stack([x.ravel(), y.ravel()])
        return places[np.argsort(np.hypot(*(places - near).T), kind="stable")]

    def score(self, learned: CorrelationState, frame: Frame, x: Array, parents: Array) -> Array:
        """(N, 1): log L of x (N, 1, D), the Gaussians of the modes; 0 far from all."""
        guides = self.guides(learned)
        z = np.column_stack([x[:, 0, :2], np.log(x[:, 0, 2])])
        # so that the mean of L over a box and a tenth of log scale is its evidence
        room = 0.1 * self._unit**2 * np.exp(2 * guides.mean[:, 2])
        volume = (2 * math.pi) ** 1.5 * np.prod(guides.std, axis=1) / room
        log_mixture(z, guides.mean, guides.std, guides.log_w - np.log(volume), out := np.empty(len(z)))
        return out[:, None]

    def guides(self, learned: CorrelationState) -> ModeProposal:
        assert learned.seen is not None
        return learned.seen.guides

    def learn(self, learned: CorrelationState, frame: Frame, state: Array, particles: Particles) -> CorrelationState:
        """In proportion to P(visible), the last number of the `state` (1, D)."""
        one, seen = self.settings, learned.seen
        visible = min(max(float(state[0, VISIBLE]), 0.0), 1.0)
        frames = learned.frames + 1
        if seen is not None:
            learned = learned._replace(heights=learned.heights.learn(seen.heights, seen.elsewhere, visible))
        hidden = learned.hidden + 1 if visible < 0.5 else 0
        candidate = seen.guides.mean[-1] if hidden and seen is not None and seen.elsewhere is not None else None
        learned = learned._replace(
            hidden=hidden, candidate=candidate, sighted=(), external_log_odds=0.0, seen=None, frames=frames
        )
        share = one.hidden_rate + (1 - one.hidden_rate) * visible
        if seen is not None:
            low = max(learned.heights.now.z(seen.heights[0]) - _LOW, 0.0)
            share *= max(math.exp(log_student(low)), _SLOWER)
        step = abs(frame.index - learned.last)  # a track may run backward
        if share < _LEARNS or (frames > FIRST and step < one.every):
            return learned
        learned, step = learned._replace(last=frame.index), min(step, 2 * one.every)
        centre, scale = state[0, :2], float(state[0, 2])
        x, window, across = self._at(learned, frame, centre, scale, seen)
        filters = self._trainer.learn(learned.filters, x, min(step * share * one.rate, 1.0))
        scales = self._scale_trainer.learn(learned.scales, across, min(step * share * one.scales.rate, 1.0))
        colours = learned.colours and self._colour_model.learn(learned.colours, window, step * share)
        if frames <= FIRST:
            learned = learned._replace(first=filters.filters)
        return learned._replace(filters=filters, scales=scales, colours=colours)

    def _at(
        self, learned: CorrelationState, frame: Frame, centre: Array, scale: float, seen: Seen | None
    ) -> tuple[Single, Image, NDArray[np.complex64]]:
        """Spectrum and window of the target, and its spectrum over scales: those `seen`, moved, if they are near."""
        trainer = self._scale_trainer
        if seen is not None:
            grown, cell = math.log(scale / seen.scale), self._side(seen.scale) / self.settings.cells
            off, mode = (centre - seen.view.centre) / cell, (centre - seen.guides.mean[0, :2]) / cell
            if abs(grown) < _SAME_SCALE and max(np.abs(off).max(), np.abs(mode).max()) < _SAME_PLACE:
                spectrum = models.moved(seen.view.spectrum, off, self.settings.cells)
                return spectrum, seen.view.image, trainer.moved(seen.scales, grown)
        x, window = learned.features.read(frame, centre, self._side(scale))
        window = window if learned.colours is None else shrunk(window)
        return x, window, trainer.read(frame, centre, scale)

    def distances(self, learned: CorrelationState, frame: Frame, x: Array) -> Array:
        """(N, 1) of zeros: whether the target is visible is part of the state."""
        return np.zeros(x.shape[:2])


_BESIDE = np.array([(-1.0, 1.0, 0.0, 0.0), (0.0, 0.0, -1.0, 1.0)])


def _widths(response: Single, found: Array, usual: float) -> Array:
    """(J, 2): standard deviations, in samples, of the Gaussians that fall as the response does beside its peaks."""
    x, y = ((found[:, k, None] + usual * _BESIDE[k]).ravel() for k in range(2))
    read_cubic(response, x, y, values := np.empty(len(x)))
    shares = values.reshape(-1, 2, 2).sum(axis=2) / (2 * found[:, 2:])
    return np.asarray(usual / np.sqrt(-2 * np.log(np.minimum(np.maximum(shares, 0.3), 0.9))))
