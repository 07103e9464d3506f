"""What a correlation filter sees of a frame: windows resampled to a fixed size, and their channels.

Channels are histograms of oriented gradients (Felzenszwalb et al. 2010), grey, and a and b of CIELAB where the clip has
colours, reduced to the principal components of the first frame (as Danelljan et al. 2014, fDSST, and 2017, ECO).

Colours: Per-pixel colours of the target and of its surroundings (Bertinetto et al. 2016, Staple, section 3.4).

A pixel's colour u is the target's with probability P(O | u) / (P(O | u) + P(B | u)), by histograms of the target's box
and of the rest of the window (eq. 23 to 26 there); the score of a place is its mean over the box there.

Scale: The one-dimensional filter of scale (Danelljan et al. 2014, DSST; 2017, fDSST).

The target is read at S scales a^n, n from -(S - 1) / 2 to (S - 1) / 2, each window resampled to one size; its
gradients are a signal over the scales with many channels. A correlation filter of that signal, in closed form, has its
peak at the scale at which the target is as large as it was learned (DSST, eq. 3 to 6):

    A = conj(Y) X,  B = sum_d |X^d|^2,  R = F^-1 [ sum_d conj(A^d) Z^d / (B + lambda) ]

A and B are moved by the learning rate.

The filter: spatially regularised correlation, kept from forgetting by a memory.

The response of filters f^d to a window with channels x^d is R = sum_d f^d * x^d (circular correlation). It should be
y(c) = exp(-|c|^2 / (2 sigma_y^2)), a peak where the target is. Sought are the filters of

    sum_k pi_k |sum_d f^d * x_k^d - y|^2 + sum_d |w f^d|^2       (Danelljan et al. 2015, SRDCF, eq. 4; 2017, ECO, eq. 7)

with w small inside of the target's box and large outside, and pi_k the weights of the windows seen so far. ECO keeps
some 30 to 50 of them and merges the most alike. Here all are kept, by their sufficient statistics: after PCA there are
so few channels C that for each frequency sum_k pi_k x_k x_k^H, a matrix (C, C), is small, and a new window moves it by
the learning rate. So nothing is merged, and memory is the same after any number of frames. The normal equations

    (sum_k pi_k x_k x_k^H) f + F[w^2 F^-1 f] = sum_k pi_k x_k conj(y)

are solved by conjugate gradients from the filters of the last frame on, a few steps each time. What is left of them is
carried on: a window x of weight a makes the residual r = (1 - a) r - a g + a x (conj(y) - x^H f), g = F[w^2 F^-1 f].
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array, Frame, Image, Whole, factor_for
from facetrack_cli.trackers.box import box_kernels as kernel
from facetrack_cli.trackers.box.box_kernels import CHANNELS
from facetrack_cli.trackers.face.stabilized import Similarity

Single: TypeAlias = NDArray[np.float32]
CELL = 4  # pixels of a resampled window
_COLOURS = 2.0  # grey levels by which channels differ on average in a clip with colours


def spectrum(x: Single) -> Single:
    """The Fourier transform (2, C, F) of x (C, G, G): real and imaginary parts of the F = G (G / 2 + 1) frequencies."""
    # NumPy transforms in single precision where the factor is no integer, as the 1 of other norms is: in half the time
    found = np.fft.rfft(x, norm="ortho")
    found = np.fft.fft(found, axis=1, norm="ortho", out=found).reshape(len(x), -1)
    both = np.empty((2, *found.shape), np.float32)
    np.multiply(found.real, np.float32(x.shape[1]), out=both[0])
    np.multiply(found.imag, np.float32(x.shape[1]), out=both[1])
    return both


def inverse(v: Single, cells: int) -> Single:
    """`spectrum` undone: (2, C, F) -> (C, G, G)."""
    whole: Any = joined(v).reshape(-1, cells, cells // 2 + 1)
    return np.fft.irfft(np.fft.ifft(whole, axis=1, out=whole), cells).astype(np.float32, copy=False)


def joined(v: Single) -> NDArray[np.complex64]:
    """Real and imaginary parts (2, ...) as complex numbers (...)."""
    found = np.empty(v.shape[1:], np.complex64)
    found.real, found.imag = v
    return found


def moved(v: Single, by: Array, cells: int) -> Single:
    """The spectrum v (2, C, F) of channels as they are at places moved by `by` (x, y) cells."""
    phases = []
    for k, step in zip((np.fft.rfftfreq(cells), np.fft.fftfreq(cells)), by.tolist(), strict=True):
        phase = np.exp(2j * math.pi * step * k)
        phase[cells // 2] = math.cos(math.pi * step)  # of the highest frequency only the cosine is there
        phases.append(phase)
    phase = np.outer(phases[1], phases[0]).ravel()
    real, imaginary = phase.real.astype(np.float32), phase.imag.astype(np.float32)
    return np.stack([v[0] * real - v[1] * imaginary, v[0] * imaginary + v[1] * real])


@dataclass(frozen=True, eq=False)
class Features:
    """How windows of `cells` x `cells` cells become channels: `components` (C, L) of L features, tapered by `taper`."""

    cells: int
    colour: bool
    components: Single
    taper: Single  # (G * G,), with the scale that gives the first window a mean energy of 1 a cell

    @classmethod
    def learn(cls, frame: Frame, centre: Array, side: float, cells: int, count: int) -> Features:
        """The `count` principal components of the window of the first frame."""
        image = Similarity(centre, side / (CELL * cells)).read(frame, CELL * cells).bgr
        colour = float(np.abs(image[..., 0].astype(np.int16) - image[..., 2]).mean()) > _COLOURS
        hann = np.hanning(cells + 2)[1:-1].astype(np.float32)
        taper = np.outer(hann, hann).ravel()
        read = image if colour else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
        whole = _features(read, cells)
        features = whole * np.sqrt(taper)
        products = np.einsum("if,jf->ij", features, features, dtype=np.float64)  # BLAS rounds by its threads
        _, vectors = np.linalg.eigh(products)
        kept = np.ascontiguousarray(vectors[:, ::-1][:, :count].T.astype(np.float32))
        kept *= np.sign(kept[np.arange(len(kept)), np.abs(kept).argmax(axis=1)])[:, None]  # LAPACK leaves it open
        plain = cls(cells, colour, kept, taper)
        energy = float(np.mean(np.sum(plain._project(whole) ** 2, axis=0)))
        return cls(cells, colour, kept, taper / np.float32(np.sqrt(max(energy, 1e-12))))

    def read(self, frame: Frame, centre: Array, side: float) -> tuple[Single, Image]:
        """The channels' spectrum (2, C, F) of the window of `side` pixels around `centre`, and the window itself."""
        n = CELL * self.cells
        window = Similarity(centre, side / n)
        image = window.read(frame, n).bgr if self.colour else window.read_grey(frame, n)
        channels = self._project(_features(image, self.cells))
        return spectrum(channels.reshape(-1, self.cells, self.cells)), image

    def _project(self, features: Single) -> Single:
        out = np.empty((len(self.components), features.shape[1]), np.float32)
        kernel.project(self.components, features, self.taper, out)
        return out


def _features(image: Image, cells: int) -> Single:
    """(L, G * G): the features of an image (4 G, 4 G), or (4 G, 4 G, 3)."""
    colour, small = image.ndim == 3, (cells, cells)
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if colour else image, np.uint8)
    out = np.empty((CHANNELS + 1 + 2 * colour, cells, cells), np.float32)
    kernel.gradients(np.multiply(grey, np.float32(1 / 255), dtype=np.float32), CELL, out[:CHANNELS])
    np.multiply(cv2.resize(grey, small, interpolation=cv2.INTER_AREA), np.float32(1 / 255), out=out[CHANNELS])
    out[CHANNELS] -= np.float32(0.5)
    if colour:
        kernel.chroma(np.asarray(cv2.resize(image, small, interpolation=cv2.INTER_AREA), np.uint8), out[CHANNELS + 1 :])
    return out.reshape(len(out), -1)


_SIDE = 80  # pixels of a window that is read for colours; of 40 cells it is half as large, which OpenCV does fast
_RATE = 0.04
_TELLS = 0.2  # how much more likely the target's pixels must be than those around, on average


class Colours(NamedTuple):
    """Histograms (32768,) of the target and of its surroundings, and how far they tell the two apart, 0..1."""

    target: Single
    around: Single
    tells: float = 0.0


class ColourModel:
    """`box`: width and height of the target as shares of the window's side."""

    def __init__(self, box: tuple[float, float]) -> None:
        self.box = box
        half = np.abs(np.arange(_SIDE) - (_SIDE - 1) / 2) / _SIDE
        w, h = (max(side, 2.5 / _SIDE) for side in box)
        inside = np.outer(half <= 0.4 * h, half <= 0.4 * w)
        outside = ~np.outer(half <= 0.55 * h, half <= 0.55 * w)
        # the pixels of the target, and those around it
        self._parts = np.flatnonzero(inside), np.flatnonzero(outside if outside.any() else ~outside)

    def learn(self, known: Colours | None, window: Image, rate: float) -> Colours:
        """From a shrunk window in whose middle the target is; `rate` 1 as Staple learns, 0 not at all."""
        share, learned = np.float32(1.0 if known is None else _RATE * rate), np.empty((2, kernel.COLOURS), np.float32)
        before = known or Colours(*np.zeros_like(learned))
        bins, _ = _looked_up(before, window)
        for part, histogram, out in zip(self._parts, before[:2], learned, strict=True):
            kernel.tally(histogram, bins, part, share, out)
        _, p = _looked_up(found := Colours(learned[0], learned[1]), window)
        inside, outside = (float(p[part].mean()) for part in self._parts)
        return found._replace(tells=max(inside - outside, 0.0))

    def respond(self, known: Colours, window: Image, samples: int) -> Single | None:
        """The score (samples, samples) of the box around each place of a shrunk window; None: colour tells nothing."""
        if known.tells < _TELLS:
            return None
        w, h = (max(round(0.8 * side * _SIDE), 1) | 1 for side in self.box)
        _, each = _looked_up(known, window)
        mean = cv2.blur(each.reshape(_SIDE, -1), (w, h), borderType=cv2.BORDER_REPLICATE)
        return np.asarray(cv2.resize(mean, (samples, samples), interpolation=cv2.INTER_LINEAR), np.float32)


def shrunk(window: Image) -> Image:
    """A window as it is read for colours."""
    return np.asarray(cv2.resize(window, (_SIDE, _SIDE), interpolation=cv2.INTER_AREA), np.uint8)


def _looked_up(known: Colours, window: Image) -> tuple[Whole, Single]:
    """Of each pixel of a shrunk window, by rows, its colour, and the probability that it is the target's."""
    pixels = window.shape[0] * window.shape[1]
    bins, p = np.empty(pixels, np.int64), np.empty(pixels, np.float32)
    kernel.colours(window, known.target, known.around, bins, p)
    return bins, p


_LAMBDA = 0.01


class TrainedScale(NamedTuple):
    """A (S / 2 + 1, D) and B (S / 2 + 1,) of the D numbers that a window has at each scale."""

    numerator: NDArray[np.complex64]
    denominator: Single


class ScaleTrainer:
    """`size`: width and height of the target at scale 1, in pixels; `area`: pixels of a resampled window."""

    def __init__(self, size: tuple[float, float], scales: int, step: float, area: float = 512.0) -> None:
        self.size, self.scales, self.step = size, scales, step
        self.log_scales: Array = np.asarray((np.arange(scales) - (scales - 1) / 2) * math.log(step), np.float64)
        y = np.exp(-0.5 * (np.fft.fftfreq(scales, 1 / scales) / (scales / 16)) ** 2)
        self._y: Single = np.fft.rfft(y).real.astype(np.float32)[:, None]
        k, s = np.arange(scales // 2 + 1), np.arange(scales) - scales // 2
        turns = np.hanning(scales + 2)[1:-1] * np.exp(-2j * np.pi * k[:, None] * s / scales)
        # (S + 1, S): what makes the spectrum of a signal, tapered: real parts, then imaginary ones
        self._transform: Single = np.concatenate([turns.real, turns.imag]).astype(np.float32)
        # (S, S / 2 + 1): of a spectrum the real part of this times it is the signal
        self._back = np.exp(2j * np.pi * k * s[:, None] / scales) * np.where(k, 2, 1) / scales
        by = math.sqrt(area / (size[0] * size[1]))
        self._shape = tuple(min(max(round(side * by / CELL), 2), 64) * CELL for side in size)

    def read(self, frame: Frame, centre: Array, scale: float) -> NDArray[np.complex64]:
        """The spectrum (S / 2 + 1, D) of the target around `centre` at `scale` times each of the scales."""
        w, h = self._shape
        sides = scale * np.exp(self.log_scales)[:, None] * np.array(self.size)
        factor = factor_for(max(scale * self.size[0] / w, 1e-6), 2.0) if scale * self.size[0] >= 2 * w else 1
        (x, y), (right, lower) = centre.tolist(), (sides[-1] / 2 + 2 * factor).tolist()
        grey, left, top = frame.grey(factor, (x - right, y - lower, x + right, y + lower))
        at = (np.array([x - left, y - top]) - 0.5 * (factor - 1)) / factor
        signal = np.empty((self.scales, CHANNELS, h // CELL, w // CELL), np.float32)
        kernel.gradients_of_scales(grey, at[0], at[1], sides / factor, CELL, signal)
        flat = signal.reshape(self.scales, -1)
        found = np.empty((len(self._transform), flat.shape[1]), np.float32)
        kernel.project(self._transform, flat, np.ones(flat.shape[1], np.float32), found)
        return joined(found.reshape(2, -1, flat.shape[1]))

    def moved(self, x: NDArray[np.complex64], by: float) -> NDArray[np.complex64]:
        """The spectrum x (S / 2 + 1, D) as it is at log scales larger by `by`."""
        turns = np.fft.rfftfreq(self.scales) * by / math.log(self.step)
        return np.asarray(np.exp(2j * np.pi * turns)[:, None] * x, np.complex64)

    def learn(self, known: TrainedScale | None, x: NDArray[np.complex64], rate: float) -> TrainedScale:
        a, b = self._y * x, np.vecdot(x, x).real
        if known is None:
            return TrainedScale(a, b)
        keep, new = np.float32(1 - rate), np.float32(rate)
        return TrainedScale(keep * known.numerator + new * a, keep * known.denominator + new * b)

    def respond(self, known: TrainedScale, z: NDArray[np.complex64]) -> Array:
        """The response (S,), from the least scale to the largest."""
        found = np.vecdot(known.numerator, z) / (known.denominator + np.float32(_LAMBDA))
        return np.asarray((self._back @ found).real, np.float64)


# --- the filter over the channels

UPSAMPLED = 2  # samples of a response for a cell
_FIRST_STEPS = 50
_INSIDE, _OUTSIDE = 0.1, 100.0  # w^2 inside of the target's box, and a whole box around it


class Trained(NamedTuple):
    """`filters` f (2, C, F), the memory, matrices (P, 2, F), the `residual` (2, C, F), and g, the `walled` filters."""

    filters: Single
    matrices: Single
    residual: Single
    walled: Single


class Trainer:
    """`box`: the target's width and height in cells; `sigma`: sigma_y in cells; `steps` of conjugate gradients."""

    def __init__(self, cells: int, box: tuple[float, float], sigma: float, steps: int = 2) -> None:
        self.cells, self.sigma, self.steps = cells, sigma, steps
        d, half = np.fft.fftfreq(cells, 1 / cells), np.abs(np.arange(cells) - (cells - 1) / 2)
        y = np.exp(-0.5 * (d[:, None] ** 2 + d[None] ** 2) / sigma**2)
        self.y: Single = np.fft.rfft2(y).real.ravel().astype(np.float32)  # y is even
        # 1 on the border of the box
        out = np.maximum((half / (box[1] / 2))[:, None], (half / (box[0] / 2))[None])
        rise = np.clip(out - 1, 0, 1) ** 2
        self.wall: Single = (_INSIDE + (_OUTSIDE - _INSIDE) * rise).astype(np.float32)  # w^2 of each cell
        # what moves place 0 into the middle
        signs = (-1.0) ** (np.arange(cells)[:, None] + np.arange(cells // 2 + 1))
        self._middle: Single = (UPSAMPLED**2 * signs).astype(np.float32)
        counts = np.full((cells, cells // 2 + 1), 2, np.float32)
        counts[:, [0, -1]] = 1
        self._counts: Single = counts.ravel()  # of how many frequencies of the whole transform each stands for

    def begin(self, x: Single) -> Trained:
        """From the first window's spectrum x (2, C, F)."""
        channels, frequencies = x.shape[1:]
        matrices = np.zeros((channels * (channels + 1) // 2, 2, frequencies), np.float32)
        kernel.remember(matrices, x, np.float32(1.0), matrices)
        return self._solve(Trained(np.zeros_like(x), matrices, self.y * x, np.zeros_like(x)), _FIRST_STEPS)

    def learn(self, known: Trained, x: Single, rate: float) -> Trained:
        """With a window more, of weight `rate` in the memory."""
        filters, memory, residual, walled = known
        matrices, off, share = np.empty_like(memory), np.empty((2, x.shape[2]), np.float32), np.float32(rate)
        kernel.remember(memory, x, share, matrices)
        kernel.respond(x, filters, off)
        off *= -share
        off[0] += share * self.y
        more = (1 - share) * residual - share * walled
        more[0] += off[0] * x[0] - off[1] * x[1]
        more[1] += off[0] * x[1] + off[1] * x[0]
        return self._solve(Trained(filters.copy(), matrices, more, walled.copy()), self.steps)

    def respond(self, x: Single, *filters: Single) -> Single:
        """The responses (n, 2 G, 2 G) of n filters, with place 0 in the middle, [G, G]: between the cells by its
        Fourier series.
        """
        g, half = self.cells, self.cells // 2
        found = np.empty((len(filters), 2, x.shape[2]), np.float32)
        for one, out in zip(filters, found, strict=True):
            kernel.respond(one, x, out)
        few = joined(found.swapaxes(0, 1)).reshape(-1, g, half + 1) * self._middle
        many = np.zeros((len(few), UPSAMPLED * g, half), few.dtype)
        many[:, :half], many[:, 1 - half :] = few[:, :half, :half], few[:, half + 1 :, :half]
        return np.fft.irfft(np.fft.ifft(many, axis=1, out=many), UPSAMPLED * g).astype(np.float32, copy=False)

    def _solve(self, known: Trained, steps: int) -> Trained:
        """`known` by conjugate gradients, preconditioned by the diagonal; its arrays change."""
        v, matrices, r, walled = known
        p, product, least = np.zeros_like(v), 0.0, np.float32(_INSIDE)
        for _ in range(steps):
            product = kernel.turn(r, matrices, least, self._counts, product, p)
            cells = inverse(p, self.cells)
            cells *= self.wall
            kernel.descend(matrices, p, spectrum(cells), self._counts, product, v, r, walled)
        return known


def peaks(response: Single, least: float, most: int) -> Array:
    """At most `most` local maxima of at least `least` times the highest, the highest first: (column, row, height)."""
    top = float(response.max())
    if count := kernel.highest(response, np.float32(max(least * top, 1e-6)), found := np.empty((most, 3))):
        return found[:count]
    row, column = np.unravel_index(int(response.argmax()), response.shape)  # the highest is on the border
    return np.array([[float(column), float(row), top]])
